"""All commands under one name."""

from __future__ import annotations

import inspect
import logging
import re
import signal
import sys
from difflib import get_close_matches
from errno import EMFILE, ENFILE, EPIPE
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from cyclopts import (
    App,
    CycloptsError,
    Group,
    Parameter,
    UnknownCommandError,
    UnusedCliTokensError,
)

import m100link
from m100link.apps.cli import end_at_once
from m100link.apps.cli.terminal import (
    ExitCode,
    OutputFormat,
    ReaderGone,
    complain,
    logging_as_asked,
    show_warnings,
    shown_default,
    speak_to_anybody,
)
from m100link.errors import M100Error, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable
    from importlib.abc import InspectLoader
    from importlib.machinery import ModuleSpec

_AREA = "52.1,4.31 52.1,4.312 52.101,4.312 --height 30 --spacing 20"
_TILES = "'https://tiles.example/{z}/{x}/{y}.png'"
_FRAME = "aa230000000000000400757f0103480000803f000000000000003f0000204163c2ab89"

# The groups of the help, and their verbs in the order of a user's day: the verb, its module, and
# two examples of what follows it. Verbs with bars between them share these. A module is loaded when
# its verb is used; a verb of a verb has none here.
_ROWS = {
    "Fly": (
        ("takeoff", "flight", "sim://", "lab-m100 --yes"),
        ("fly", "flight", "lab-m100 5 0 1.5", "/dev/ttyUSB0 -5 0 2 --max-radius 20 --yes"),
        ("home|land|release", "flight", "lab-m100", "/dev/ttyUSB0"),
        ("gimbal", "flight", "sim://", "lab-m100 --pitch -30 --yaw 10"),
        ("camera", "flight", "sim://?firmware=3.1 photo", "lab-m100 start-video"),
    ),
    "Watch": (
        ("info", "connection", "sim://", "/dev/ttyUSB0 --duration 5"),
        ("monitor|hz", "telemetry", "sim:// --duration 5", "lab-m100"),
        ("echo", "telemetry", "sim:// position --packages 3", "lab-m100 attitude --csv --rate 5"),
        ("plot", "telemetry", "sim:// position.height_m", "/dev/ttyUSB0 attitude.yaw_deg"),
        ("rates", "flight", "sim://?firmware=3.1", "lab-m100 attitude=50 battery=1"),
        ("link", "connection", "sim:// --duration 2", "/dev/ttyUSB0 --rate 20"),
    ),
    "Missions": (
        ("plan", "plan:app", "", ""),
        ("plan survey", "", f"survey.json {_AREA}", f"survey.plan {_AREA} --photo-every 10"),
        ("plan check|show", "", "survey.json", "field.plan --leave-out geoFence --home 52.1,4.31"),
        ("plan convert", "", "field.plan survey.json", "survey.json - --format plan"),
        ("mission", "mission:app", "", ""),
        ("mission fly", "", "survey.json lab-m100", "survey.json /dev/ttyUSB0 --takeoff --yes"),
        ("mission pause|resume|stop", "", "lab-m100", "/dev/ttyUSB0"),
        ("mission download", "", "lab-m100", "lab-m100 -o stored.plan"),
    ),
    "Serve": (
        ("console", "serve", "--sim", "lab-m100 --no-open-browser"),
        ("serve", "serve", "--sim", "left=/dev/ttyUSB0 right=/dev/ttyUSB1"),
        ("map", "map:app", "", ""),
        (
            *("map download", "", f"{_TILES} 52.1,4.31 --attribution '© Anna'"),
            f"{_TILES} 52.1,4.31 52.11,4.33 --max-zoom 18 --attribution '© Anna'",
        ),
        ("mavlink", "serve", "sim://", "lab-m100 --to udp://127.0.0.1:14540"),
        ("ros2", "serve", "sim://", "lab-m100 --namespace /drones --dji-names"),
        ("fleet", "fleet_verbs:app", "", ""),
        ("fleet list", "", "", "--connect tcp/192.168.1.5:7447 --json"),
        ("fleet takeoff|land|stop", "", "a1 a2", "--all"),
        ("fleet goto", "", "a1 52.1 4.31 10", "a1 -33.9 18.4 10 --cruise-speed 3"),
        ("fleet make", "", "fleet.toml", "fleet.toml --renew"),
        ("fleet up", "", "fleet.toml", "fleet.toml a1 --real"),
        ("fleet doctor", "", "fleet.toml", "fleet.toml --json"),
        ("fleet router", "", "", "--listen tcp/0.0.0.0:7447 --connect tcp/other:7447"),
        ("fleet agent", "", "sim:// --count 3", "lab-m100 --name a1 --lost land"),
        ("fleet console", "", "", "a1 a2 --no-open-browser"),
        ("fleet monitor", "", "", "--duration 10 --json"),
        ("fleet lease|watch", "", "a1", "a1 --operator anna"),
        ("fleet mission fly", "", "a1 survey.json", "a1 survey.json --takeoff --yes"),
        ("fleet mission pause|resume|stop|progress", "", "a1", "a1 --json"),
        ("fleet show check", "", "show.json", "show.json --max-height 30"),
        (
            "fleet show import",
            "",
            "show.json a1.skyb a2.skyb --origin 52.1,4.31",
            "show.json a1.csv --origin 52.1,4.31 --orientation 90",
        ),
        ("fleet show preview", "", "show.json show.svg", "show.json -"),
        ("fleet show fly", "", "show.json", "show.json --leave hover --yes"),
        ("fleet log list", "", "a1", "--all"),
        ("fleet log audit", "", "a1", "--all --output audit"),
        ("fleet log fetch", "", "a1", "--all --output logs"),
        ("fleet pki revoke", "", "anna --folder pki", "anna bert --folder pki --json"),
        ("fleet pki push", "", "a1 --folder pki", "--all --identity anna --pki pki"),
        ("fleet acl check", "", "fleet.toml", "fleet.toml --who anna --json"),
        ("fleet acl zenoh", "", "fleet.toml router.json", "fleet.toml -"),
    ),
    "Logs": (
        ("record", "log", "sim:// -o flight.mcap --duration 2", "lab-m100"),
        ("replay", "serve", "flight.mcap", "flight.mcap --from 60 --speed 4"),
        ("log", "log:app", "", ""),
        ("log info", "", "flight.mcap", "flight.mcap --json"),
        ("log report", "", "flight.mcap", "flight.mcap --json"),
        ("log share", "", "flight.mcap", "flight.mcap -o copy.mcap"),
        ("log plot", "", "flight.mcap", "flight.mcap -o flight.png"),
        ("log events", "", "flight.mcap", "other.mcap"),
        ("log compare", "", "first.mcap second.mcap", "first.mcap second.mcap --json"),
        ("log csv|parquet", "", "flight.mcap", "flight.mcap position velocity -o table"),
        ("log frames", "", "flight.mcap", "flight.mcap --key-file m100.key --json"),
        ("log wireshark", "", "flight.mcap --install", "flight.mcap --key-file m100.key"),
        ("log ros2|recover", "", "flight.mcap", "flight.mcap -o other.mcap"),
        ("log layout", "", "", "-o layout.json"),
        ("decode", "decode", _FRAME, f"{_FRAME} --table"),
    ),
    "Virtual aircraft": (
        ("demo", "demo", "--speed max", "--side 20 --firmware 3.1"),
        ("sim", "sim:app", "--link m100", "--tcp 7000 --firmware 3.1 --wind-north 5"),
        ("sim ctl", "", "rc-mode P", "battery 12"),
        ("sim compare", "", "flight.bag", "flight.mcap --airframe document --plot both.png"),
        ("sim fit", "", "flight.bag -o mine.toml", "one.mcap two.bag --check three.bag --json"),
    ),
    "Set up": (
        ("ports", "connection", "", "--json"),
        ("udev", "connection", "/dev/ttyUSB0", "--install"),
        ("doctor", "connection", "sim://", "/dev/ttyUSB0 --report doctor.json"),
        (
            *("first-contact", "connection:first_contact", "sim:// --report first.json"),
            "/dev/ttyUSB0 --name lab-m100 --app-id 1022384 --key-file m100.key",
        ),
        ("activate", "connection", "sim://", "lab-m100 --app-id 1022384 --key-file m100.key"),
        ("config", "manual", "", "lab-m100"),
        ("completion", "manual", "bash", "--install"),
        ("docs", "manual", "safety", "--find propellers"),
    ),
}

_VERBS = [
    (title, f"{above} {verb}".lstrip(), *rest)
    for title, rows in _ROWS.items()
    for names, *rest in rows
    for above, _, last in [names.rpartition(" ")]
    for verb in last.split("|")
]
_GROUPS = {title: Group(title, sort_key=place) for place, title in enumerate(_ROWS)}
_GROUP_OF = {verb: _GROUPS[title] for title, verb, *_ in _VERBS}

VERBS = {
    verb: f"m100link.apps.cli.{place if ':' in place else f'{place}:{verb}'}"
    for _, verb, place, *_ in _VERBS
    if place
}
"""Where each verb is."""

EXAMPLES = {
    verb: tuple(f"m100link {verb} {words}".rstrip() for words in examples)
    for _, verb, _, *examples in _VERBS
    if any(examples)
}
"""Two command lines of each verb, except of those that only have verbs of their own."""

_FIRST = ("m100link demo", "m100link console --sim", "m100link takeoff --help")

# An option that is off by default needs no negative form.
_DEFAULT = Parameter(negative_bool=(), negative_iterable=(), show_default=shown_default)


_JSON = Parameter(
    name="--json",
    negative="--table",
    help="Print JSON, one object per line, or text.",
    show_default=lambda _: "JSON in a pipe",
)


def _with_format(app: App) -> App:
    """A verb and those below it, each with ``--json`` and ``--table``."""
    if app.default_command is not None and not hasattr(app.default_command, "__wrapped__"):
        app.default_command = _printing(app.default_command)
    for name in app:
        if not name.startswith("-"):
            _with_format(app[name])
    return app


def _printing(verb: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(verb)
    def run(*given: Any, json: bool | None = None, **named: Any) -> Any:
        OutputFormat.json = json
        return verb(*given, **named)

    asked = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=None)
    run.__signature__ = inspect.Signature([*inspect.signature(verb).parameters.values(), asked])  # type: ignore[attr-defined] # as inspect says
    run.__annotations__ = verb.__annotations__ | {"json": Annotated[bool | None, _JSON]}
    return run


class _Commands(App):
    """The verbs. Each has ``--json``, and its help ends with examples."""

    def __getitem__(self, key: str) -> App:
        """A verb, loaded."""
        found = super().__getitem__(key)
        return found if key.startswith("-") else _with_format(found)

    def help_print(
        self,
        tokens: Annotated[Any, Parameter(show=False)] = None,
        *,
        console: Annotated[Any, Parameter(parse=False)] = None,
    ) -> None:
        """Print what the base class prints, and the examples."""
        chain, apps, _ = self.parse_commands(tokens)
        for name in apps[-1] if chain else ():
            _ = apps[-1][name]  # loads it: a verb that is not loaded has no help in the list
        super().help_print(tokens, console=console)
        console = console or apps[-1].console
        below = " ".join((*chain, ""))
        shown = EXAMPLES.get(below.strip()) or [
            examples[0] for verb, examples in EXAMPLES.items() if verb.startswith(below)
        ]
        lines = "".join(f"\n  {line}" for line in (shown[:2] if chain else _FIRST))
        console.print(f"Examples:{lines}", highlight=False, soft_wrap=True)


def _version() -> str:
    """The release, and the commit of which it was built."""
    kept = Path(m100link.__file__).parent / "manual" / "COMMIT"
    commit = kept.read_text(encoding="utf-8") if kept.exists() else ""
    return f"{m100link.__version__} ({f'commit {commit}' if commit else 'no commit is known'})"


def application(*, overview: bool = False) -> App:
    """The commands under one name; with ``overview`` for the list of verbs only."""
    made = _Commands(
        name="m100link",
        help="Fly and watch a DJI Matrice 100 through its Onboard API, or a virtual one.",
        version=_version,
        # To load the Markdown reader takes a fifth of the time of the whole list, which has none.
        help_format="plaintext" if overview else None,
        default_parameter=_DEFAULT,
    )
    for number, (verb, place) in enumerate(VERBS.items()):
        # A help that is given here replaces the verb's own.
        help_ = _sentence(verb, place) if overview else None
        made.command(place, name=verb, help=help_, group=_GROUP_OF[verb], sort_key=number)
    for flag in ("--help", "--version"):
        made[flag].group = _GROUP_OF["docs"]
    return made


def _sentence(verb: str, place: str) -> str:
    """The first sentence of a verb's help, from its file: to load all of them takes long."""
    module, _, name = place.partition(":")
    loader = cast("InspectLoader", cast("ModuleSpec", find_spec(module)).loader)
    begin = rf'group\(\s*"{verb}",\s*"' if name == "app" else rf'\ndef {name}\(.*?\n    """'
    source = (loader.get_source(module) or "").replace("\nasync def", "\ndef")
    found = re.search(rf'{begin}(.*?)["\n]', source, re.DOTALL)
    return "" if found is None else found[1].replace("`", "")


app = application()


def run() -> None:
    """Parse the command line, run the command, exit with its status."""
    try:
        with speak_to_anybody():
            status = _status_of(sys.argv[1:])
    except ReaderGone as error:
        status = ExitCode.OK
        if error.errno != EPIPE:
            status = complain(
                M100Error(
                    f"standard output takes no more: {error.strerror}",
                    cause="the disk is full, or the terminal is gone",
                    remedy="look at the aircraft, if the command moves it, and make room",
                )
            )
    sys.exit(status)


def _useless(error: UnusedCliTokensError | UnknownCommandError) -> UsageError:
    """Words that name no verb, or that a verb has no use for; and the nearest verb."""
    called, words = " ".join(("m100link", *(error.command_chain or ()))), error.unused_tokens or []
    near = get_close_matches(words[0].lower(), error.app or (), 1)
    is_verb = isinstance(error, UnknownCommandError)
    what = f"verb {words[0]!r}" if is_verb else f"use for {' '.join(words)}"
    first = f"did you mean {called} {near[0]}?" if near else "" if is_verb else "leave it out;"
    remedy = f"{first} {called} --help lists what there is".strip()
    return UsageError(f"{called} has no {what}", remedy=remedy)


# Names of options in 0.2: scripts that have them still run, and are warned. An argument has none.
_FORMER = {
    "info": {"--seconds": "--duration"},
    "echo": {"--count": "--packages"},
    "sim": {"--for": "--duration", "--rate": "--item-rate"},
    "serve": {"--baud-rate": "--baud", "--url": ""},
    "console": {"--baud-rate": "--baud", "--url": ""},
}


def _renamed(words: list[str]) -> list[str]:
    """The words with today's names of options."""
    former, renamed = _FORMER.get(words[0], {}) if words else {}, list[str]()
    for word in words:
        name, mark, value = word.partition("=")
        now = former.get(name, name)
        if now != name:
            logging.getLogger(__name__).warning("%s is %s in 1.0", name, now or "an argument")
        renamed += [now + mark + value] if now else [value] * bool(mark)
    return renamed


def _status_of(words: list[str]) -> int:
    asked = app if VERBS.keys() & set(words) else application(overview=True)
    try:
        show_warnings()
        for name in VERBS.keys() & set(words[:1]):
            _ = asked[name]  # loads it
        verb, bound, _ = asked.parse_args(_renamed(words), exit_on_error=False, print_error=False)
        bound.apply_defaults()
        if signal.getsignal(signal.SIGINT) is end_at_once:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        with logging_as_asked(bound.arguments.values()):
            status = verb(*bound.args, **bound.kwargs)
            if inspect.iscoroutine(status):
                from m100link.apps.cli.common import run_async  # decoding a frame needs none

                status = run_async(status)
    except (UnusedCliTokensError, UnknownCommandError) as error:
        return complain(_useless(error))
    except CycloptsError as error:
        called = " ".join(("m100link", *(error.command_chain or ())))
        return complain(UsageError(str(error), remedy=f"{called} --help lists what there is"))
    except M100Error as error:
        return complain(error)
    except OSError as error:
        if error.errno not in (EMFILE, ENFILE):
            raise
        seen = f"this process may open no more files: {error.strerror}"
        return complain(M100Error(seen, remedy="close what is open, or try ulimit -n 1024"))
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return ExitCode.INTERRUPTED
    finally:
        OutputFormat.json = None
    return status if isinstance(status, int) else ExitCode.OK
