"""All commands under one name."""

from __future__ import annotations

import logging
import os
import sys

from cyclopts import App, CycloptsError

import m100link
from m100link.cli import aircraft, decode, demo, flight, monitor, sim, station, telemetry
from m100link.cli.common import ExitCode, complain
from m100link.errors import M100Error, UsageError

__all__ = ["app", "run"]

app = App(
    name="m100link",
    help="Fly and watch a DJI Matrice 100 through its Onboard API, or a virtual one.",
    version=m100link.__version__,
)
for _command in (
    demo.demo,
    aircraft.info,
    aircraft.activate,
    monitor.monitor,
    telemetry.echo,
    telemetry.hz,
    telemetry.plot,
    flight.takeoff,
    flight.land,
    flight.home,
    flight.fly,
    flight.release,
    decode.decode,
    sim.app,
    station.serve,
    station.console,
):
    app.command(_command)


def _show_warnings() -> None:
    """Warnings of the library go to standard error, like everything that is not data."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    logger = logging.getLogger("m100link")
    logger.addHandler(handler)
    level = os.environ.get("M100LINK_LOG", "WARNING").upper()
    if level not in logging.getLevelNamesMapping():
        raise UsageError(
            f"M100LINK_LOG is {level!r}", remedy="set it to DEBUG, INFO, WARNING or ERROR"
        )
    logger.setLevel(level)


def run() -> None:
    """Parse the command line, run the command, exit with its status."""
    try:
        _show_warnings()
        status = app(
            sys.argv[1:], exit_on_error=False, print_error=True, result_action="return_value"
        )
    except CycloptsError:
        sys.exit(ExitCode.USAGE)
    except M100Error as error:
        sys.exit(complain(error))
    sys.exit(status if isinstance(status, int) else ExitCode.OK)
