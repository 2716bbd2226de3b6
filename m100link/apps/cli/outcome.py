"""How a command ends and what it prints for programs; loads neither an aircraft nor a console."""

from __future__ import annotations

import json
import math
import sys
from typing import Any

from m100link import errors

_TYPED = {
    "await control.take_off() first; a waypoint mission takes take_off=True": "m100link takeoff "
    "first; or --take-off",
    "await control.take_off()": "m100link takeoff",
    "asyncio.Runner(loop_factory=m100link.sim.loop_factory(SPEED)), ": "leave the speed out; ",
    "infinity for max; or m100link.sync, which makes its own; or ": "an aircraft with one is ",
    "connect(..., firmware='3.1')": "--firmware 3.1",
    "control(guards=Guards(envelope=Envelope(max_height_m=…)))": "--max-height",
    "control(guards=Guards(envelope=Envelope(max_radius_m=…)))": "--max-radius",
    "fly slower, or control(guards=Guards(envelope=Envelope(max_speed_m_s=…)))": "fly slower",
    "close what is open, or fly without one: control(guardian=False)": "close other programs",
    "docs: howto/silent-line": "m100link docs silent-line",
}
"""What remedies ask a program to do, and what a person types for it."""


class ExitCode:
    """Exit status classes."""

    OK = 0
    FAILED = 1
    USAGE = 2
    PORT = 3
    NO_LINK = 4
    ACTIVATION = 5
    AUTHORITY = 6
    REFUSED = 7
    TIMEOUT = 8
    INTERRUPTED = 130


# The first class that fits decides, so subclasses stand before their bases.
_EXIT_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (errors.UsageError, ExitCode.USAGE),
    (errors.NoAircraft, ExitCode.NO_LINK),
    (errors.LinkLost, ExitCode.NO_LINK),
    (errors.LineBlocked, ExitCode.NO_LINK),
    (errors.LinkError, ExitCode.PORT),
    (errors.ActivationRefused, ExitCode.ACTIVATION),
    (errors.NotActivated, ExitCode.ACTIVATION),
    (errors.LevelTooLow, ExitCode.ACTIVATION),
    (errors.KeyRejected, ExitCode.ACTIVATION),
    (errors.AuthorityRefused, ExitCode.AUTHORITY),
    (errors.AuthorityError, ExitCode.AUTHORITY),
    (errors.GuardRefused, ExitCode.REFUSED),
    (errors.CommandRefused, ExitCode.REFUSED),
    (TimeoutError, ExitCode.TIMEOUT),
    (errors.M100Error, ExitCode.FAILED),
)


def exit_code(error: BaseException) -> int:
    """The exit status for an error."""
    return next((code for kind, code in _EXIT_CODES if isinstance(error, kind)), ExitCode.FAILED)


def complain(error: BaseException) -> int:
    """Tell an error on standard error; returns the exit status for it."""
    # The console takes longer to load than a frame to decode.
    from rich.console import Console

    err = Console(stderr=True, highlight=False)
    err.print("[bold red]error:[/] ", end="")
    text = str(error)
    for written, typed in _TYPED.items():
        text = text.replace(written, typed)
    if isinstance(error, errors.M100Error):
        text += f"\n  code:         {error.error_code}"
    err.print(text, markup=False)
    return exit_code(error)


def print_json(value: Any) -> None:
    """One JSON object on one line of standard output."""
    sys.stdout.write(json.dumps(finite(value), allow_nan=False, default=str) + "\n")
    sys.stdout.flush()


def finite(value: Any) -> Any:
    """JSON has no NaN and no infinity: they become their names."""
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
