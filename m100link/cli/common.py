"""What the commands share: where the aircraft is, whose app it is, how errors are told."""

from __future__ import annotations

import asyncio
import json
import math
import os
import sys
from collections.abc import Coroutine
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Console

from m100link import errors
from m100link.cli.options import options_of
from m100link.errors import UsageError
from m100link.protocol.commands.activation import Credentials
from m100link.protocol.firmware import PROFILES
from m100link.sim.vehicle.mobile import DEMO_APP_ID, DEMO_KEY
from m100link.station.config import ENVIRONMENT, Settings

__all__ = [
    "AppOptions",
    "ExitCode",
    "Firmware",
    "LinkOptions",
    "Url",
    "complain",
    "err",
    "exit_code",
    "out",
    "print_json",
    "run_async",
]

if TYPE_CHECKING:
    Firmware = str
else:
    Firmware = Literal[tuple(PROFILES)]  # checkers want it spelt out, people want them all offered

out = Console(highlight=False)
"""Standard output: data."""

err = Console(stderr=True, highlight=False)
"""Standard error: talk."""


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
    err.print("[bold red]error:[/] ", end="")
    err.print(str(error), markup=False)
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


Url = Annotated[
    str,
    Parameter(
        help="Where the aircraft is: serial:///dev/ttyUSB0:230400, /dev/ttyUSB0, "
        "tcp://host:port, sim://",
        env_var="M100LINK_URL",
    ),
]


@Parameter(name="*")
@dataclass
class LinkOptions:
    """How to talk to it.

    Attributes:
        firmware: Force a firmware profile instead of choosing it from the version answer.
        baud: Baud rate when the URL has none.
        timeout: Seconds until an aircraft has to answer.
    """

    firmware: Annotated[str | None, Parameter(env_var="M100LINK_PROFILE")] = None
    baud: int | None = None
    timeout: float = 3.0

    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of :func:`m100link.connect`."""
        return {"firmware": self.firmware, "baud_rate": self.baud, "timeout": self.timeout}


_OfTheApp: Any = options_of(
    Settings,
    ("app_id", "key_file", "key", "level", "app_version", "bundle_id"),
    environment={name: ENVIRONMENT[name] for name in ("app_id", "key_file", "key")},
)


@Parameter(name="*")
@dataclass(frozen=True)
class AppOptions(_OfTheApp):  # type: ignore[misc] # a class that is made has no type
    """The app that is registered with DJI: fields of the station's settings."""

    def credentials(self, url: str = "") -> Credentials:
        """The credentials, checked; those of the demo app for a ``sim://`` without any.

        Raises:
            UsageError, BadKey: Something is missing or cannot be right.
        """
        if url.startswith("sim:") and (self.app_id, self.key, self.key_file) == (None,) * 3:
            return Credentials(DEMO_APP_ID, DEMO_KEY, level=self.level)
        if self.key_file is None and self.key is not None and "M100LINK_KEY" not in os.environ:
            err.print("[yellow]warning:[/] --key shows the key to everybody who lists processes")
        given = {one.name: getattr(self, one.name) for one in fields(_OfTheApp)}
        credentials = Settings(**given).credentials()
        if credentials is None:
            raise UsageError("no app id was given", remedy="give --app-id, or set M100LINK_APP_ID")
        return credentials


def run_async(work: Coroutine[Any, Any, int | None]) -> int:
    """Run a command's coroutine; errors become a message and an exit status."""
    try:
        return asyncio.run(work) or ExitCode.OK
    except errors.M100Error as error:
        return complain(error)
    except KeyboardInterrupt:
        err.print("interrupted")
        return ExitCode.INTERRUPTED
