"""The command line as people type it: Ctrl-C, closed pipes, terminals without Unicode."""

from __future__ import annotations

import ast
import asyncio
import io
import json
import logging
import os
import re
import signal
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from m100link import errors
from m100link.apps.cli.terminal import (
    _TYPED,
    ExitCode,
    ReaderGone,
    complain,
    print_json,
    read_line,
    speak_to_anybody,
)
from m100link.flight.guards import Envelope
from tests.apps.cli.conftest import ROOT, CommandLine, Simulator
from tests.apps.cli.terminal import terminal
from tests.test_house import MODULES, programs, tree
from tests.waiting import PATIENCE

FRAME = "aa230000000000000400757f0103480000803f000000000000003f0000204163c2ab89"

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}


# -- a closed pipe ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",),
        ("--version",),
        ("fly", "--help"),
        ("decode", "AA"),
        ("info", "sim://"),
        ("activate", "sim://"),
        ("takeoff", "sim://"),
        ("release", "sim://"),
        ("echo", "sim://", "--csv"),
        ("echo", "sim://"),
        ("monitor", "sim://"),
        ("hz", "sim://", "--duration", "0.2"),
        ("plot", "sim://", "--duration", "0.5"),
        ("sim", "ctl"),
        ("serve", "--show-config"),
    ],
    ids=" ".join,
)
def test_a_closed_pipe_ends_quietly_with_0(arguments: tuple[str, ...]) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    kept = {k: v for k, v in os.environ.items() if not k.startswith("M100LINK_")}
    with os.fdopen(theirs, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "m100link", *arguments],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=kept,
            timeout=PATIENCE,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    assert "Traceback" not in done.stderr


def _closed_pipe() -> io.TextIOWrapper:
    ours, theirs = os.pipe()
    os.close(ours)
    return io.TextIOWrapper(os.fdopen(theirs, "wb"), encoding="ascii")


def test_data_that_nobody_reads_end_a_command_and_talk_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, err = _closed_pipe(), _closed_pipe()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with speak_to_anybody():
        for word in ("take-off", "landing"):
            sys.stderr.write(word)
            sys.stderr.flush()
        sys.stdout.write("data")
        with pytest.raises(ReaderGone):
            sys.stdout.flush()
    assert (sys.stdout, sys.stderr) == (out, err)
    out.close()  # does not raise: what was left went nowhere
    err.close()


def _full_disk() -> io.TextIOWrapper:
    return Path("/dev/full").open("w", encoding="ascii")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a full disk to write to")
def test_a_full_disk_keeps_no_talk_from_going_on_and_is_told_of_data(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A landing first says which mission it stopped: it is ordered all the same."""
    out, err = _full_disk(), _full_disk()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with speak_to_anybody():
        for word in ("stopped: waypoint mission\n", "landing\n"):
            sys.stderr.write(word)
            sys.stderr.flush()
        sys.stdout.write("data")
        with pytest.raises(ReaderGone, match="No space left"):
            sys.stdout.flush()
    out.close()
    err.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a full disk to write to")
def test_data_that_a_full_disk_does_not_take_are_an_error_of_the_command() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "m100link", "decode", "--table", FRAME],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            timeout=PATIENCE,
            check=False,
        )
    assert done.returncode == ExitCode.FAILED
    assert "standard output takes no more: No space left" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_before_it_began_end_no_command(closed: str) -> None:
    """As a service or a script may start it: it ordered no landing, and reported nothing."""
    command = f'exec "$0" -m m100link decode --table {FRAME} {closed}'
    done = subprocess.run(
        ["sh", "-c", command, sys.executable],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=PATIENCE,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_what_is_opened_next_gets_the_number_of_no_closed_stream() -> None:
    """A port that has the number of standard error would be sent what Python says there."""
    program = (
        "from m100link.apps.cli.terminal import speak_to_anybody\n"
        "import os\n"
        "with speak_to_anybody():\n"
        "    os._exit(os.open(os.devnull, os.O_RDONLY))\n"
    )
    done = subprocess.run(
        ["sh", "-c", 'exec "$0" -c "$1" <&- >&- 2>&-', sys.executable, program],
        cwd=ROOT,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode > 2


# -- few characters -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\u2800\u2801\u2880\u28ff", " '.:"),
        ("12.5° m/s² ✓ … —", "12.5d m/s2 + ~ -"),
        ("山", "?"),
        ("\udcff", "?"),
    ],
    ids=["braille", "signs", "others", "a file name that is not text"],
)
def test_what_cannot_be_encoded_is_one_ascii_character(
    monkeypatch: pytest.MonkeyPatch, text: str, shown: str
) -> None:
    binary = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(binary, encoding="ascii"))
    with speak_to_anybody():
        sys.stdout.write(text)
    assert binary.getvalue().decode() == shown


@pytest.mark.pty
@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("plot", "sim://", "quaternion.yaw_deg", "--duration", "1"), " |"),
        (("demo", "--side", "1"), "mission flown"),
        (("monitor", "sim://", "--duration", "1"), "yaw "),
        (("sim", "--duration", "1"), "attitude"),
        (("sim", "ctl"), "rc-mode"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_terminal_that_is_not_utf_8_gets_ascii(arguments: tuple[str, ...], part: str) -> None:
    with terminal(*arguments, environment=ASCII) as running:
        assert running.end() == 0, running.shown
        assert part in running.shown
        assert running.shown.isascii()


# -- Ctrl-C ---------------------------------------------------------------------------------------


@pytest.mark.pty
@pytest.mark.parametrize("keys", ["\x03", "n\n", "\n", "\x04"], ids=["^C", "n", "Enter", "^D"])
def test_ctrl_c_and_everything_but_yes_end_a_question(
    simulator: Simulator, app: list[str], keys: str
) -> None:
    with terminal("takeoff", simulator.port, *app) as running:
        running.read_until("Really take off? [y/N]")
        running.type(keys)
        status = running.end()
        assert status == (ExitCode.INTERRUPTED if keys == "\x03" else ExitCode.USAGE)
        assert "Traceback" not in running.shown
        assert "done:" not in running.shown


@pytest.mark.smoke
@pytest.mark.pty
def test_yes_flies(simulator: Simulator, app: list[str]) -> None:
    with terminal("takeoff", simulator.port, *app) as running:
        running.read_until("Really take off? [y/N]")
        running.type("y\n")
        assert running.end() == 0
        assert "done: take off" in running.shown


@pytest.mark.pty
def test_ctrl_c_ends_a_plot_without_a_traceback() -> None:
    with terminal("plot", "sim://") as running:
        running.read_until("position.height_m")
        running.type("\x03")
        assert running.end() == ExitCode.INTERRUPTED
        assert "interrupted" in running.shown
        assert "Traceback" not in running.shown
        assert "never retrieved" not in running.shown


# -- 40 columns -----------------------------------------------------------------------------------


@pytest.mark.pty
@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("monitor", "sim://", "--duration", "1"), ("angular_velocity", "standby")),
        (("hz", "sim://", "--duration", "1"), ("angular_velocity", "count")),
        (("plot", "sim://", "--duration", "1"), ("1.0 s", "\u2524\u2800")),
        (("demo", "--side", "1"), ("mission flown", "setpoints sent", "height")),
        (("sim", "--duration", "1"), ("attitude", "velocity", "battery, GPS")),
        (("info", "sim://"), ("flight_status",)),
    ],
    ids=lambda value: value[0] if value and value[0].isalpha() else "",
)
def test_40_columns_are_enough(arguments: tuple[str, ...], parts: tuple[str, ...]) -> None:
    with terminal(*arguments, columns=40) as running:
        assert running.end() == 0, running.shown
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", running.shown)
    for part in parts:
        assert part in shown
    assert "\u2026" not in shown.replace("\u2026  ", "")  # nothing is cut off


@pytest.mark.parametrize(("typed", "line"), [(b" land now \n", "land now"), (b"", "")])
def test_what_is_typed_is_read_whole(
    monkeypatch: pytest.MonkeyPatch, typed: bytes, line: str
) -> None:
    reading, writing = os.pipe()
    os.write(writing, typed)
    os.close(writing)

    async def read() -> tuple[str, bool]:
        return await read_line(), asyncio.get_running_loop().remove_reader(reading)

    with os.fdopen(reading) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        assert asyncio.run(read()) == (line, False)  # nobody reads the next line in its place


def test_ctrl_c_that_interrupts_no_wait_ends_a_question_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # In another thread it is marked and wakes nobody, as one does that comes just before the wait.
    reading, writing = os.pipe()
    asked = threading.Event()

    def strike() -> None:
        asked.wait(PATIENCE)
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    async def ask() -> None:
        asyncio.get_running_loop().call_later(0.2, asked.set)
        await read_line()

    striking = threading.Thread(target=strike)
    with os.fdopen(reading) as stdin, os.fdopen(writing, "w"):
        monkeypatch.setattr(sys, "stdin", stdin)
        striking.start()
        with pytest.raises(KeyboardInterrupt):
            asyncio.run(ask())
    striking.join()


# -- how a command ends: its exit status by what went wrong, and JSON that every reader takes ------


def test_an_error_is_printed_on_standard_error_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert complain(errors.BadURL("[bold]x[/]", remedy="write y")) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "error: [bold]x[/]\n  what to do:   write y\n  code:         M100-BAD-URL\n"


def test_a_remedy_for_programs_is_shown_as_a_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    complain(errors.UsageError("x", remedy="take off first: await control.take_off()"))
    assert "take off first: m100link takeoff\n" in capsys.readouterr().err


@pytest.mark.parametrize("written", _TYPED)
def test_what_is_reported_otherwise_is_what_the_library_says(written: str) -> None:
    said = "".join(path.read_text() for path in programs("m100link") if "cli" not in path.parts)
    for beyond in ({"height": 1e6}, {"far": 1e6}, {"speed": 1e6}):
        with pytest.raises(errors.GuardRefused) as caught:
            Envelope().check("a flight", **beyond)
        said += str(caught.value)
    assert written in said


@pytest.mark.parametrize(
    ("encoding", "text", "written"),
    [
        ("utf-8", "20 m/s … 30°", '{"text": "20 m/s … 30°"}'),
        ("utf-8", "… \x9b2J\u202e", r'{"text": "\u2026 \u009b2J\u202e"}'),  # orders of a terminal
        ("cp1252", "20 m/s …", r'{"text": "20 m/s \u2026"}'),  # JSON is UTF-8
    ],
)
def test_json_is_plain_text_where_each_sign_prints(
    encoding: str, text: str, written: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    print_json({"text": text})
    assert raw.getvalue().decode(encoding).strip() == written


def test_json_has_no_number_that_json_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": float("nan"), "b": [float("-inf"), 1.5], "c": {"d": (float("inf"),)}})
    told = json.loads(capsys.readouterr().out)
    assert told == {"a": "nan", "b": ["-inf", 1.5], "c": {"d": ["inf"]}}


# -- --log-level and --log-json, and that no secret is in what they show ---------------------------


APP_ID = 3_141_592_653
KEY = "c0ffee5a" * 8
BUNDLE_ID = "org.example.secret"


@pytest.fixture
def secretive(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> CommandLine:
    """A command line with an app of its own."""
    monkeypatch.setenv("M100LINK_APP_ID", str(APP_ID))
    monkeypatch.setenv("M100LINK_KEY", KEY)
    return cli


def find_secrets(text: str) -> list[str]:
    """The secrets that a text has, however they are written."""
    raw = bytes.fromhex(KEY)
    secrets = {
        "app id": [str(APP_ID), f"{APP_ID:x}", struct.pack("<I", APP_ID).hex(), repr(APP_ID)],
        "key": [KEY[:8], repr(raw)[2:8], str(list(raw[:3]))[1:-1]],
        "bundle id": [BUNDLE_ID, BUNDLE_ID[:5].encode().hex()],
    }
    return [name for name, ways in secrets.items() for way in ways if way in text.lower()]


def test_secrets_would_be_found() -> None:
    assert find_secrets(f"x{APP_ID}x") == ["app id", "app id"]
    assert find_secrets("4DE640BB".lower()) == ["app id"]
    assert find_secrets(KEY.upper()) == ["key"]


@pytest.mark.parametrize("form", [(), ("--log-json",)])
@pytest.mark.parametrize("has_other_app", [False, True], ids=["activated", "refused"])
def test_everything_that_is_logged_of_an_activation_has_no_secret(
    secretive: CommandLine, form: tuple[str, ...], has_other_app: bool
) -> None:
    url = f"sim://?app_id={APP_ID + has_other_app}&key={KEY}"
    words = ("release", url, "--bundle-id", BUNDLE_ID, "--log-level", "debug", *form)
    outcome = secretive(*words)
    assert outcome.status == (ExitCode.ACTIVATION if has_other_app else ExitCode.OK), outcome.err
    assert "0001…" in outcome.err.replace("\\u2026", "…")
    assert find_secrets(outcome.err + outcome.out) == []
    if form:
        lines = [json.loads(line) for line in outcome.err.splitlines() if line.startswith("{")]
        assert {line["aircraft"] for line in lines} == {"sim://?app_id=…&key=…"}
        assert {line["level"] for line in lines} >= {"DEBUG", "INFO"}


def test_the_environment_says_the_level_of_json_lines(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("M100LINK_LOG", "INFO")
    demo = ("demo", "--speed", "max", "--side", "1", "--json", "--no-record")  # a disk may warn
    outcome = cli(*demo, "--log-json")
    lines = [json.loads(line) for line in outcome.err.splitlines()]
    assert {line["level"] for line in lines} == {"INFO"}
    assert outcome.objects[0]["flown"]


def test_a_level_that_does_not_exist_is_refused(cli: CommandLine) -> None:
    outcome = cli("info", "sim://", "--log-level", "loud")
    assert outcome.status == ExitCode.USAGE
    assert "warning" in outcome.err


LONG = ("serve", "console", "sim", "demo", "takeoff", "fly", "land", "home", "monitor", "echo")


@pytest.mark.parametrize("verb", [*LONG, "hz", "plot", "activate", "doctor", "info", "mission fly"])
def test_verbs_that_run_long_have_the_options(cli: CommandLine, verb: str) -> None:
    told = cli(*verb.split(), "--help").out
    assert "--log-level" in told
    assert "--log-json" in told


def test_every_logger_is_that_of_its_module() -> None:
    """So that one room, or one module, can be asked for its log."""
    package = {"m100link.link", "m100link.apps.cli.terminal", "m100link.apps.station.log_output"}
    package.add("m100link.flight.reserves")  # it hands the records of others to their loggers
    for module, path in MODULES.items():
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "logging.getLogger":
                asked = ast.unparse(node.args[0])
                is_right = asked in {"__name__", "JOURNAL_LOG"} or module in package
                assert is_right, f"{module}: {asked}"
    assert logging.getLogger("m100link.flight.control").parent is not logging.root
