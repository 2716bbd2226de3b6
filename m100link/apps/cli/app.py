"""All commands under one name."""

from __future__ import annotations

import inspect
import re
import signal
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING, cast

from cyclopts import App, CycloptsError, CycloptsPanel, UnusedCliTokensError

import m100link
from m100link.apps.cli import end_at_once
from m100link.apps.cli.terminal import (
    ExitCode,
    ReaderGone,
    complain,
    logging_as_asked,
    show_warnings,
    speak_to_anybody,
)
from m100link.errors import M100Error, UsageError

if TYPE_CHECKING:
    from importlib.abc import InspectLoader
    from importlib.machinery import ModuleSpec

# Modules and verbs, in the order of the manual. A module is loaded when its verb is used.
_MODULES = (
    ("demo", ("demo",)),
    ("connection", ("info", "link", "doctor", "ports", "udev", "activate")),
    ("telemetry", ("monitor", "echo", "hz", "plot")),
    ("flight", ("takeoff", "land", "home", "fly", "release", "gimbal", "camera", "rates")),
    ("plan", ("plan",)),
    ("mission", ("mission",)),
    ("log", ("record",)),
    ("replay", ("replay",)),
    ("log", ("log",)),
    ("decode", ("decode",)),
    ("manual", ("config", "completion", "docs")),
    ("sim", ("sim",)),
    ("serve", ("serve", "mavlink", "ros2")),
    ("fleet_verbs", ("fleet",)),
    ("serve", ("console",)),
)
_WITH_VERBS = ("plan", "mission", "log", "sim", "fleet")
"""These have verbs of their own: their place is the application of the module."""

VERBS = {
    verb: f"m100link.apps.cli.{module}:{'app' if verb in _WITH_VERBS else verb}"
    for module, verbs in _MODULES
    for verb in verbs
}
"""Where each verb is."""

# Options by former name, for scripts that were written with it: the help has today's only.
_FORMER = {
    "info": {"--seconds": "--duration"},
    "sim": {"--for": "--duration"},
    "serve": {"--baud-rate": "--baud"},
    "console": {"--baud-rate": "--baud"},
}


def application(*, overview: bool = False) -> App:
    """The commands under one name; with ``overview`` for the list of verbs only."""
    made = App(
        name="m100link",
        help="Fly and watch a DJI Matrice 100 through its Onboard API, or a virtual one.",
        version=m100link.__version__,
        # To load what reads Markdown takes a fifth of the time of the whole list, which has none.
        help_format="plaintext" if overview else None,
    )
    for verb, place in VERBS.items():
        # What is given here takes the place of the verb's own help.
        made.command(place, name=verb, help=_sentence(verb, place) if overview else None)
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
    except ReaderGone:
        status = ExitCode.OK
    sys.exit(status)


def _renamed(words: list[str]) -> list[str]:
    """The words with today's names of options."""
    former = _FORMER.get(words[0], {}) if words else {}
    options = words[: words.index("--")] if "--" in words else words
    made = []
    for word in options:
        name, *value = word.split("=", 1)
        made.append("=".join([former.get(name, name), *value]))
    return made + words[len(options) :]


def _status_of(words: list[str]) -> int:
    asked = app if VERBS.keys() & set(words) else application(overview=True)
    try:
        show_warnings()
        verb, bound, _ = asked.parse_args(_renamed(words), exit_on_error=False, print_error=False)
        if signal.getsignal(signal.SIGINT) is end_at_once:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        with logging_as_asked(bound.arguments.values()):
            status = verb(*bound.args, **bound.kwargs)
            if inspect.iscoroutine(status):
                from m100link.apps.cli.common import run_async  # who decodes a frame needs none

                status = run_async(status)
    except UnusedCliTokensError as error:
        called = " ".join(("m100link", *(error.command_chain or ())))
        return complain(
            UsageError(
                f"{called} has no use for {' '.join(error.unused_tokens or ())}",
                remedy=f"leave it out; {called} --help says what is taken",
            )
        )
    except CycloptsError as error:
        (error.console or asked.error_console).print(CycloptsPanel(error))
        return ExitCode.USAGE
    except M100Error as error:
        return complain(error)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return ExitCode.INTERRUPTED
    return status if isinstance(status, int) else ExitCode.OK
