"""All commands under one name."""

from __future__ import annotations

import inspect
import signal
import sys

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

# Verb → where it is, and the first sentence of its help. A module is loaded when its verb is used,
# and none for the list of verbs.
VERBS = {
    "demo": (
        "demo:demo",
        "Fly the virtual aircraft over a real pseudo-terminal: a square, from take-off to landing.",
    ),
    "info": (
        "connection:info",
        "Show what is at the other end: version, firmware profile, telemetry items, line quality.",
    ),
    "link": (
        "connection:link",
        "Measure the line: damage and its causes, how long answers take, rates of telemetry.",
    ),
    "doctor": (
        "connection:doctor",
        "Find out why the line is silent: stage by stage, the first that fails with its cause.",
    ),
    "ports": ("connection:ports", "List serial ports: adapter, who may open it, who has it open."),
    "udev": (
        "connection:udev",
        "Print a udev rule for the adapter: a stable name, its group, no ModemManager, no delay.",
    ),
    "activate": (
        "connection:activate",
        "Activate the aircraft for an app; waits while the aircraft asks DJI's server.",
    ),
    "monitor": (
        "telemetry:monitor",
        "Watch telemetry: every item with its value, age, measured rate and jitter.",
    ),
    "echo": (
        "telemetry:echo",
        "Print telemetry as it arrives: one JSON object, or one row of CSV, per package.",
    ),
    "hz": (
        "telemetry:hz",
        "Measure how the items arrive: rate, jitter, longest gap, and the aircraft's clock.",
    ),
    "plot": (
        "telemetry:plot",
        "Plot columns over time: live from an aircraft, or of a recorded span.",
    ),
    "takeoff": (
        "flight:takeoff",
        "Start the motors and climb to about 1.2 m; the aircraft hovers there.",
    ),
    "land": ("flight:land", "Land in place and stop the motors."),
    "home": ("flight:home", "Fly to the home point and land there."),
    "fly": ("flight:fly", "Fly so many metres north, east and up from here, and hover there."),
    "release": (
        "flight:release",
        "Give control authority back; the aircraft hovers and the pilot flies on.",
    ),
    "gimbal": (
        "flight:gimbal",
        "Point the gimbal, and show where it looks; without an angle it only shows that.",
    ),
    "camera": (
        "flight:camera",
        "Take a photograph, start or stop video. It is sent; nobody confirms it.",
    ),
    "rates": (
        "flight:rates",
        "Set telemetry rates (firmware 3.1), and show how items arrive; without any only that.",
    ),
    "plan": (
        "plan:app",
        "Look at plans of waypoints, check and convert them; no aircraft is needed.",
    ),
    "mission": (
        "mission:app",
        "Let the aircraft fly a plan by itself, and act on a mission that flies (firmware 3.1).",
    ),
    "record": (
        "log:record",
        "Record what goes over the line, until Ctrl-C: every byte, and what the bytes say.",
    ),
    "replay": (
        "replay:replay",
        "Show a recorded flight in the console, as it was: pause, move, change its speed.",
    ),
    "log": (
        "log:app",
        "Look at flight logs, make tables of them, mend damaged ones; no aircraft is needed.",
    ),
    "decode": (
        "decode:decode",
        "Decode frames from hex: one stream per argument, or per line of standard input.",
    ),
    "config": (
        "manual:config",
        "Show the configuration file: where it is, which aircraft it names, what is in force.",
    ),
    "completion": (
        "manual:completion",
        "Print what completes verbs, options and aircraft in a shell, or install it there.",
    ),
    "docs": (
        "manual:docs",
        "Read the manual: a page by its topic, or the list of topics. Needs no network.",
    ),
    "sim": ("sim:app", "A virtual Matrice 100, for people and other programs."),
    "serve": (
        "serve:serve",
        "Own the serial port and share the aircraft: rosbridge v2 for any number of clients.",
    ),
    "mavlink": (
        "serve:mavlink",
        "Let MAVSDK, QGroundControl and other MAVLink programs see and fly the aircraft.",
    ),
    "ros2": ("serve:ros2", "Be a node of ROS 2, without a ROS installation, until Ctrl-C."),
    "fleet": (
        "fleet_verbs:app",
        "Many aircraft on many machines: a router, agents on board, pilots, formations.",
    ),
    "console": (
        "serve:console",
        "Serve the console for browsers, beside everything that `serve` serves, and open it.",
    ),
}

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
    for verb, (place, sentence) in VERBS.items():
        plain = sentence.replace("`", "")
        # What is given here takes the place of the verb's own help.
        made.command(f"m100link.apps.cli.{place}", name=verb, help=plain if overview else None)
    return made


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
    except KeyboardInterrupt:  # of a verb that flies nothing
        sys.stderr.write("interrupted\n")
        return ExitCode.INTERRUPTED
    return status if isinstance(status, int) else ExitCode.OK
