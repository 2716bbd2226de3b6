"""The command line as a whole: what it knows, and what it says when it is asked wrongly."""

from __future__ import annotations

import ast
import contextlib
import errno
import io
import logging
import random
import re
import shlex
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from threading import current_thread, main_thread
from typing import cast
from unittest.mock import MagicMock

import pytest
from cyclopts import App, Group

import m100link
from m100link.apps.cli import connection, end_at_once
from m100link.apps.cli.app import _FORMER, EXAMPLES, VERBS, app, application
from m100link.apps.cli.manual import _rows
from m100link.apps.cli.terminal import AS_IT_IS, ExitCode, logging_as_asked
from m100link.apps.station import log_output
from m100link.sim.ports import driver
from tests.apps.cli.conftest import CommandLine
from tests.promised import FILE, named, read
from tests.waiting import PATIENCE


@pytest.mark.parametrize(
    "arguments",
    [
        ("no-such-command",),
        ("info", "sim://", "--no-such-option"),
        ("info", "sim://", "--duration", "soon"),
        ("info", "sim://", "--duration", "0"),
        ("info", "sim://", "--timeout", "0"),
        ("info", "sim://", "--timeout", "-1"),
        ("info", "sim://", "--baud", "0"),
        ("activate", "sim://", "--wait", "0"),
        ("monitor", "sim://", "--duration", "-1"),
        ("echo", "sim://", "--packages", "0"),
        ("echo", "sim://", "--rate", "0"),
        ("echo", "sim://", "--duration", "nan"),
        ("hz", "sim://", "--duration", "inf"),
        ("plot", "sim://", "--duration", "0"),
        ("fly", "sim://", "1", "0", "0", "--max-height", "0"),
        ("sim", "--duration", "0"),
        ("sim", "--count", "0"),
        ("sim", "--latitude", "95"),
        ("demo", "--speed", "0"),
        ("demo", "--speed", "1000"),
        ("demo", "--side", "0.5"),
        ("info", "sim://?wind=3"),
        ("info", "sim://?seed=x"),
        ("info", "sim://", "--firmware", "9.9"),
        ("echo", "sim://", "no_such_item"),
        ("echo", "sim://", "--csv", "--json"),
        ("plot", "sim://", "position.colour"),
    ],
    ids=" ".join,
)
def test_what_is_asked_wrongly_is_a_usage_error_without_a_traceback(
    cli: CommandLine, arguments: tuple[str, ...]
) -> None:
    outcome = cli(*arguments)
    assert outcome.status == ExitCode.USAGE
    assert "Traceback" not in outcome.err + outcome.out
    assert outcome.err + outcome.out


def test_a_word_too_many_is_named_with_its_verb(cli: CommandLine) -> None:
    outcome = cli("hz", "sim://", "attitude")
    assert outcome.status == ExitCode.USAGE
    assert "m100link hz has no use for attitude" in outcome.err
    assert "m100link hz --help" in outcome.err


_INNER = (
    *(("sim", "compare"), ("fleet", "takeoff"), ("mission", "resume")),
    *(("log", "parquet"), ("plan", "survey")),
)


def _typing_errors() -> list[tuple[str, str, str]]:
    """Each verb, and verbs of verbs, with one letter left out, doubled or swapped."""
    chance, found = random.Random(33), []
    for verb, inner in (*((one, "") for one in VERBS), *_INNER):
        word = inner or verb
        if len(word) < 4:
            continue
        at = chance.randrange(1, len(word) - 1)
        head, letter, tail = word[:at], word[at], word[at + 1 :]
        swapped = head[:-1] + letter + head[-1] + tail
        wrong = chance.choice([head + tail, head + 2 * letter + tail, swapped])
        if wrong not in VERBS and wrong != word:
            found.append((verb, inner, wrong))
    return found


@pytest.mark.parametrize(("verb", "inner", "wrong"), _typing_errors())
def test_a_verb_that_is_mistyped_names_the_nearest(
    cli: CommandLine, verb: str, inner: str, wrong: str
) -> None:
    outcome = cli(*([verb, wrong] if inner else [wrong]))
    assert outcome.status == ExitCode.USAGE
    meant = f"m100link {verb} {inner}".strip()
    assert f"did you mean {meant}?" in " ".join(outcome.err.split()), outcome.err


def test_an_option_that_is_mistyped_names_the_nearest(cli: CommandLine) -> None:
    outcome = cli("info", "--firmwear", "3.1")
    assert outcome.status == ExitCode.USAGE
    assert "Did you mean --firmware?" in outcome.err + outcome.out


@pytest.mark.parametrize(
    ("verb", "former", "today"),
    [(verb, *names) for verb, renamed in _FORMER.items() for names in renamed.items()],
)
def test_an_option_is_known_by_its_former_name_which_warns(
    cli: CommandLine, verb: str, former: str, today: str
) -> None:
    value, sign = "no://" if former == "--url" else "x", "= "[verb == "sim"]
    warned = cli(verb, *f"{former}{sign}{value}".split())
    first, _, rest = warned.err.partition("\n")
    assert first == f"WARNING: {former} is {today or 'an argument'} in 1.0"
    same = cli(verb, *f"{today}{sign if today else ' '}{value}".split())
    assert (warned.status, warned.out, rest) == (ExitCode.USAGE, same.out, same.err)
    arguments = app[verb].assemble_argument_collection(default_parameter=app.default_parameter)
    assert former not in {name for argument in arguments for name in argument.names}


def test_a_process_that_may_open_no_more_files_says_so(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 12 of them a station ended by a traceback."""

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(connection, "serial_ports", refused)
    told = cli("ports")
    assert told.status == ExitCode.FAILED
    assert "may open no more files" in told.err
    assert "ulimit -n 1024" in told.err


def test_a_word_that_is_like_no_verb_is_named(cli: CommandLine) -> None:
    assert "m100link has no verb 'xyzzy'" in cli("xyzzy").err
    assert "did you mean" not in cli("xyzzy").err


def test_a_column_that_is_almost_one_is_named(cli: CommandLine) -> None:
    assert "did you mean position.height_m?" in cli("plot", "sim://", "heigt").err


def test_help_and_version(cli: CommandLine) -> None:
    version = cli("--version")
    told = rf"{re.escape(m100link.__version__)} \((commit [0-9a-f]{{12}}\+?|no commit is known)\)\n"
    assert version.status == 0
    assert re.fullmatch(told, version.out)  # it is known where a build installed the package
    overview = cli("--help")
    for command in ("demo", "info", "activate", "monitor", "decode", "sim", "takeoff", "fly"):
        assert command in overview.out
    assert cli("fleet", "log", "--help").status == 0


def test_a_wheel_says_of_which_commit_it_is(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "manual").mkdir()
    (tmp_path / "manual" / "COMMIT").write_text("5ffc7ccf00aa+")
    monkeypatch.setattr(m100link, "__file__", str(tmp_path / "__init__.py"))
    assert cli("--version").out == f"{m100link.__version__} (commit 5ffc7ccf00aa+)\n"


def test_each_verb_is_listed_with_the_first_sentence_of_its_own_help(cli: CommandLine) -> None:
    overview = cli("--help").out
    for verb in VERBS:
        sentence = (app[verb].help or "").split("\n\n")[0]
        assert sentence
        assert sentence.replace("`", "") in overview
    assert application(overview=True)["sim"].name == ("sim",)
    assert "hex" in cli("decode", "--help").out


def verbs(above: App = app, *words: str) -> Iterator[tuple[str, App]]:
    """Every verb that does something, with its words."""
    for name in above:
        if not name.startswith("-"):
            verb = above[name]
            if verb.default_command is not None:
                yield " ".join((*words, name)), verb
            yield from verbs(verb, *words, name)


def test_the_list_of_verbs_is_in_groups_in_the_order_of_their_table(cli: CommandLine) -> None:
    overview = cli("--help").out
    titles = ("Fly", "Watch", "Missions", "Serve", "Logs", "Virtual aircraft", "Set up")
    places = [overview.index(f"─ {title} ─") for title in titles]
    assert places == sorted(places)
    assert "Commands" not in overview
    rows = [line.split()[1] for line in overview.splitlines() if line.startswith("│ ")]
    assert rows == [*VERBS, "--help", "--version"]


def test_the_help_of_each_verb_ends_with_two_examples(cli: CommandLine) -> None:
    assert {verb for verb, _ in verbs()} == set(EXAMPLES)
    for verb in ("ports", "sim", "plan check", "fleet acl zenoh"):
        first, second = EXAMPLES[verb]
        assert cli(*verb.split(), "--help").out.endswith(f"Examples:\n  {first}\n  {second}\n")
    assert cli("fleet", "--help").out.endswith("  m100link fleet takeoff a1 a2\n")


@pytest.mark.parametrize("verb", EXAMPLES)
def test_examples_are_command_lines_that_are_understood(verb: str) -> None:
    assert len(set(EXAMPLES[verb])) == 2
    for example in EXAMPLES[verb]:
        program, *words = shlex.split(example)
        assert (program, words[: len(verb.split())]) == ("m100link", verb.split())
        command, _, _ = app.parse_args(words, exit_on_error=False, print_error=False)
        assert command is dict(verbs())[verb].default_command


def test_examples_run(cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of their table: some read what others wrote."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    elsewhere = {"mavlink", "ros2", "fleet agent", "replay", "log compare", "log wireshark", "sim"}
    files = ("plan", "log", "decode", "demo", "ports", "config", "completion", "docs")
    ran = []
    for verb, (example, _) in EXAMPLES.items():
        is_here = "sim://" in example or verb.startswith(files)
        if is_here and verb not in elsewhere and "field.plan" not in example:
            outcome = cli(*shlex.split(example)[1:])
            assert outcome.status == ExitCode.OK, (example, outcome.err)
            ran.append(verb)
    assert {"takeoff", "echo", "plan check", "record", "log info", "doctor"} <= set(ran)


def test_a_setting_shows_the_default_that_holds_if_no_source_has_one(cli: CommandLine) -> None:
    told = " ".join(cli("serve", "--help").out.split())
    assert "Greatest height above the take-off point, m. [default: 50.0]" in told
    assert "Port of rosbridge (M100LINK_PORT). [default: 9090]" in told
    assert "[default: ]" not in told
    assert "[default: False]" not in told


# Options that say the same of different things, each with a reason why no other name is better.
HOMONYMS = {
    "--acceleration": "sim has no other source of settings, so it knows its values by type",
    "--app-id": "the virtual aircraft knows the registration of which the other verbs name the id",
    "--baud": "both ends of one line",
    "--connect": "a router, of which a router needs none, and an operator may have a fleet file",
    "--count": "virtual aircraft, in the fleet with names and on ports with numbers",
    "--duration": "sim counts by its own clock",
    "--firmware": "to read by, and to be",
    "--folder": "that of the authority, which push needs in part",
    "--install": "in the place where its reader looks",
    "--key": "the app's AES key, of the aircraft, of the program, of a reader of its frames",
    "--key-file": "as --key",
    "--level": "the registration's, and the one that is asked for",
    "--link": "of a pseudo-terminal anywhere, of a serial port in /dev",
    "--listen": "addresses have the form of their protocol",
    "--name": "of the aircraft, in the fleet and in the configuration file",
    "--output": "a file or a folder, as the verb makes them",
    "--rate": "so many a second: packages, requests, rows",
    "--record": "the folder of flight logs; the station has other sources, too",
    "--seed": "demo has one by default, so that each demo is the same flight",
    "--speed": "times real time; other programs wait for sim, so it has no max",
    "--yes": "land had it in 0.2, and asks nothing",
}


def test_an_option_has_one_meaning_one_type_and_one_sentence_in_the_whole_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # It reads the sources of classes for texts that none of ours has, for half of the time.
    monkeypatch.setattr("docstring_parser.parser.add_attribute_docstrings", lambda *_: None)
    seen: dict[str, set[tuple[object, ...]]] = {}
    without_title = Counter[str]()
    for verb, found in verbs():
        arguments = found.assemble_argument_collection(
            default_parameter=app.default_parameter, parse_docstring=True
        )
        for argument in arguments:
            name = argument.names[0]
            if name.startswith("-") and argument.show:
                assert argument.parameter.group, f"{verb} --help has no {name}"
                assert argument.parameter.help, f"{verb} --help does not say what {name} is"
                kind = named(argument.hint).replace(" | None", "")
                seen.setdefault(name, set()).add((argument.names, kind, argument.parameter.help))
                groups = cast("tuple[Group, ...]", argument.parameter.group)
                without_title[verb] += "Parameters" in [group.name for group in groups]
    assert max(without_title.values()) <= 10, "more need a panel with a title"
    assert {name for name, told in seen.items() if len(told) > 1} == HOMONYMS.keys()


@pytest.mark.slow
def test_the_manual_has_a_table_of_all_options() -> None:
    table = _rows("option-table", "", Path(m100link.__file__).parents[1] / "docs")
    if not table:
        pytest.skip("the builder of the manual is not installed")
    rows = {(names, verbs): text for names, text, verbs in table}
    assert rows["`--until`", "replay"] == "Where to end, in seconds from the first byte."
    assert rows["`--json`, `--table`", "all"] == "Print JSON, one object per line, or text."
    listed = {name.strip("`") for names, _ in rows for name in names.split(", ")}
    assert {"--to", "--cruise-speed", "--takeoff", "--no-pace", "-o", "-y"} <= listed
    assert listed.isdisjoint({"--for", "--baud-rate", "--take-off"})


def test_two_names_differ_by_more_than_a_hyphen() -> None:
    """No verb is called takeoff beside an option --take-off."""
    told = "\n".join(read(FILE.read_text("utf-8")))
    verbs_of_it = re.findall(r"^m100link ([a-z][\w ]*)$", told, re.MULTILINE)
    names = {word for verb in verbs_of_it for word in verb.split()}
    names |= set(re.findall(r"^option --([\w-]+)", told, re.MULTILINE))
    assert {"takeoff", "take-over", "fly"} <= names
    bare = Counter(name.replace("-", "") for name in names)
    assert [name for name, times in bare.items() if times > 1] == []


def test_a_log_level_that_does_not_exist(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("M100LINK_LOG", "LOUD")
    outcome = cli("info", "sim://")
    assert outcome.status == ExitCode.USAGE
    assert "DEBUG, INFO, WARNING or ERROR" in outcome.err


def test_a_warning_goes_to_what_standard_error_is_then(cli: CommandLine) -> None:
    """A live display takes it over, and writes above itself."""
    cli("decode", "aa")
    # No monkeypatch, which puts back a stream that the capture has closed by then.
    with contextlib.redirect_stderr(io.StringIO()) as shown:
        logging.getLogger("m100link.link").warning("noise on the line")
    assert shown.getvalue() == "WARNING: noise on the line\n"


def test_a_warning_of_a_verb_with_an_aircraft_waits_for_no_reader(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full pipe stops a thread alone, whether or not the log is asked for."""
    said, stream = list[tuple[str, bool]](), MagicMock()
    stream.write = lambda text: said.append((text, current_thread() is main_thread()))
    with contextlib.ExitStack() as log:
        log.enter_context(logging_as_asked([AS_IT_IS]))
        with contextlib.redirect_stderr(stream):
            logging.getLogger("m100link.link").warning("noise on the line")
            log.close()
    assert said == [("WARNING: noise on the line\n", False)]
    writing = MagicMock()
    monkeypatch.setattr(log_output, "writing_log", writing)
    for words, count in ((("decode", "aa"), 0), (("info", "/dev/none"), 1)):
        cli(*words)
        assert writing.call_count == count


@pytest.mark.parametrize(
    "module", ["cyclopts", "m100link.apps.cli.app", "m100link.apps.cli.telemetry"]
)
@pytest.mark.parametrize("passes_over", [True, False])
def test_ctrl_c_while_it_is_loaded_ends_it_with_a_line(module: str, passes_over: bool) -> None:
    """Also where what is loaded would not let an exception through."""
    program = f"""
import contextlib, os, signal, sys
class Person:
    def find_spec(self, name, *_):
        if name == {module!r}:
            with contextlib.suppress(*[KeyboardInterrupt] * {passes_over}):
                os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Person())
sys.argv = ["m100link", "echo", "sim://", "--packages", "1"]
from m100link.apps.cli import main
main()
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stdout) == (ExitCode.INTERRUPTED, "")
    assert done.stderr == "interrupted\n"


def test_a_verb_that_flies_nothing_is_interrupted_with_a_line(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("m100link.apps.cli.plan.read_plan", interrupted)
    outcome = cli("plan", "check", "survey.json")
    assert (outcome.status, outcome.err) == (ExitCode.INTERRUPTED, "interrupted\n")


@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        (("gimbal", "--pitch", "-200"), ExitCode.USAGE, "stay within -90 to 30"),
        (("gimbal", "--pitch", "nan"), ExitCode.USAGE, "stay within -90 to 30"),
        (("gimbal", "--yaw", "10", "--seconds", "30"), ExitCode.USAGE, "0.1 to 25.5 s"),
        (("gimbal", "--yaw", "200", "--rates"), ExitCode.USAGE, "-180 to 180"),
        (("gimbal", "--yaw", "20", "--rates", "--seconds", "1e9"), ExitCode.USAGE, "3600 s"),
        (("camera", "foto"), ExitCode.USAGE, "no action 'foto'"),
        (("rates", "attitude=7"), ExitCode.USAGE, "cannot be sent at 7 Hz"),
        (("rates", "altitude=50"), ExitCode.USAGE, "no telemetry item is called 'altitude'"),
        (("rates", "rc=1", "remote_control=1"), ExitCode.USAGE, "two rates"),
        (("fly", "500", "0", "1"), ExitCode.REFUSED, "or --max-radius"),
        (("fly", "5", "0", "1", "--max-radius", "4.9"), ExitCode.REFUSED, "envelope ends at 4.9"),
        (("plot", "attitude"), ExitCode.USAGE, "one of: quaternion.q0"),
        (("mission", "download", "-o", "/proc/nowhere/x"), ExitCode.USAGE, "there is no folder"),
        (("echo", "positon"), ExitCode.USAGE, "did you mean position"),
        (("serve", "--timeout", "0"), ExitCode.USAGE, "a number above 0"),
        (("serve", "--baud", "0"), ExitCode.USAGE, "a whole number above 0"),
    ],
)
def test_what_no_aircraft_is_needed_to_refuse_is_refused_before_a_port_is_opened(
    cli: CommandLine, app: list[str], words: tuple[str, ...], status: int, says: str
) -> None:
    verbs = 2 if words[0] == "mission" else 1
    names_app = words[0] in ("gimbal", "camera", "fly", "mission")
    place = (*words[:verbs], "/dev/no-such-port", *words[verbs:])
    outcome = cli(*place, *(app if names_app else ()))
    assert (outcome.status, outcome.out) == (status, "")
    assert says in outcome.err
    assert "/dev/no-such-port" not in outcome.err


@pytest.mark.parametrize("verb", ["takeoff", "land", "home", "release", "activate"])
def test_a_missing_app_is_reported_before_a_port_is_opened(cli: CommandLine, verb: str) -> None:
    outcome = cli(verb, "/dev/no-such-port")
    assert outcome.status == ExitCode.USAGE
    assert "no app id was given" in outcome.err


def test_ctrl_c_ends_a_verb_by_its_stop_path_and_not_at_once(cli: CommandLine) -> None:
    """Before a verb is known, Ctrl-C ends the program in one line; a verb that flies has more."""
    before = signal.signal(signal.SIGINT, end_at_once)
    try:
        cli("udev", "--link", "left")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell sets it for a job behind `&`
        cli("udev", "--link", "left")
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("missing", ["cyclopts", "rich"])
def test_without_its_extra_the_command_says_how_to_install_it(missing: str) -> None:
    """Status 2 is that of a wrong use, as documented; a traceback would have 1."""
    program = (
        f"import sys; sys.modules[{missing!r}] = None; from m100link.apps.cli import main; main()"
    )
    ended = subprocess.run((sys.executable, "-c", program), capture_output=True, text=True)
    assert ended.returncode == 2
    assert f"needs {missing}, which is not installed" in ended.stderr
    assert "pip install '.[cli]'" in ended.stderr


# -- command lines in texts of the program ---------------------------------------------------------

TEXTS_THAT_NAME_A_VERB = {"log csv", "log report", "log recover", "log ros2"}
"""Names of the program in files, and hints that name the log elsewhere."""

COMMAND = re.compile(r"m100link ([^`\n;|]+)")
VALUE = re.compile(r" [^a-z ]| [a-z]+[\d.:/]| --| sim")  # FILE, a1, fleet.toml, /dev/ttyUSB0


def texts(path: Path, word: str) -> Iterator[str]:
    """The strings of a module that has a word, but for docstrings; a field of one is X."""
    source = path.read_text(encoding="utf-8")
    if re.search(word, source) is None:  # to parse all of them takes two seconds
        return
    program = ast.parse(source)
    parts = {
        id(part)
        for node in ast.walk(program)
        for part in (
            node.values
            if isinstance(node, ast.JoinedStr)
            else [node.value]
            if isinstance(node, ast.Expr)
            else []
        )
    }
    for node in ast.walk(program):
        if isinstance(node, ast.JoinedStr):
            values = [getattr(part, "value", None) for part in node.values]
            yield "".join(one if isinstance(one, str) else "X" for one in values)
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts
        ):
            yield node.value


def test_a_command_line_in_a_text_has_the_arguments_that_its_verb_needs() -> None:
    needs = {
        verb
        for verb, found in verbs()
        for one in found.assemble_argument_collection(default_parameter=app.default_parameter)
        if one.required and not one.names[0].startswith("--")
    }
    lacking, seen = set(), 0
    word = f"m100link ({'|'.join(sorted(needs - TEXTS_THAT_NAME_A_VERB))})"
    for path in Path(m100link.__file__).parent.rglob("*.py"):
        for line in (
            f"{found[1]} " for one in texts(path, word) for found in COMMAND.finditer(one)
        ):
            verb = max((one for one in needs if line.startswith(f"{one} ")), key=len, default=None)
            if verb is not None and verb not in TEXTS_THAT_NAME_A_VERB:
                seen += 1
                if not VALUE.match(line.removeprefix(verb)):
                    lacking.add(f"{path.name}: m100link {line}")
    assert lacking == set()
    assert seen > 30


def options(path: Path) -> Iterator[str]:
    for text in texts(path, "--"):
        yield from re.findall(r"(?<![\w-])--[a-z][a-z0-9-]+", text)


@pytest.mark.parametrize(
    ("room", "begins"),
    [
        ("fleet", ("fleet ",)),
        ("mavlink", ("mavlink",)),
        ("ros2", ("ros2",)),
        ("doctor", ("doctor", "udev", "first-contact")),
    ],
)
def test_options_that_texts_of_an_application_name_are_those_of_its_verbs(
    room: str, begins: tuple[str, ...]
) -> None:
    has = {
        name
        for verb, found in verbs()
        if verb.startswith(begins)
        for one in found.assemble_argument_collection(default_parameter=app.default_parameter)
        for name in one.names
    }
    folder = Path(m100link.__file__).parent / "apps" / room
    lacking = {
        f"{path.name}: {option}"
        for path in folder.rglob("*.py")
        for option in options(path)
        if option not in has
    }
    assert lacking == OF_OTHER_PROGRAMS.get(room, set())


OF_OTHER_PROGRAMS = {"doctor": {"port.py: --device", "port.py: --now"}, "fleet": {"pki.py: --now"}}
"""Of docker and systemctl."""


def test_a_url_of_a_virtual_aircraft_lacks_the_options_of_sim_that_the_page_names() -> None:
    arguments = app["sim"].assemble_argument_collection(default_parameter=app.default_parameter)
    names = {one.names[0].removeprefix("--") for one in arguments if not one.children}
    page = Path(__file__).parents[3] / "docs" / "reference" / "sim.md"
    told = re.search(r"A URL has no (.+?)\.", page.read_text("utf-8"), re.DOTALL)
    assert told is not None
    of_every_verb = {"json", "log-level", "log-json"}
    assert names - set(driver._kinds()) == {*re.findall(r"`(.+?)`", told[1]), *of_every_verb}
