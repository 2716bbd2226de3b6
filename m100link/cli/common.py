"""What the commands share: where the aircraft is, whose app it is, how errors are told."""

from __future__ import annotations

import asyncio
import json
import math
import os
import stat
import sys
from collections.abc import Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from m100link import errors
from m100link.errors import UsageError
from m100link.protocol.commands.activation import Credentials
from m100link.sim.vehicle.mobile import DEMO_APP_ID, DEMO_KEY

__all__ = [
    "AppOptions",
    "ExitCode",
    "LinkOptions",
    "Url",
    "complain",
    "err",
    "exit_code",
    "out",
    "print_json",
    "run_async",
]

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


@Parameter(name="*")
@dataclass
class AppOptions:
    """The app that is registered with DJI.

    Attributes:
        app_id: App id.
        key_file: File with the key, 64 hex digits, readable by you alone.
        key: The key itself; visible to everybody on this machine, so better a file.
        level: Authorization level of the app id.
        app_version: Version of the app (firmware 1.0).
        bundle_id: Bundle id of the app.
    """

    app_id: Annotated[int | None, Parameter(env_var="M100LINK_APP_ID")] = None
    key_file: Annotated[Path | None, Parameter(env_var="M100LINK_KEY_FILE")] = None
    key: Annotated[str | None, Parameter(env_var="M100LINK_KEY")] = None
    level: int = 2
    app_version: int = 1
    bundle_id: str = "12345678901234567890123456789012"

    def credentials(self, url: str = "") -> Credentials:
        """The credentials, checked; those of the demo app for a ``sim://`` without any.

        Raises:
            UsageError, BadKey: Something is missing or cannot be right.
        """
        if url.startswith("sim:") and (self.app_id, self.key, self.key_file) == (None,) * 3:
            return Credentials(DEMO_APP_ID, DEMO_KEY, level=self.level)
        if self.app_id is None:
            raise UsageError("no app id was given", remedy="give --app-id, or set M100LINK_APP_ID")
        return Credentials(
            self.app_id,
            self._key_text(),
            level=self.level,
            app_version=self.app_version,
            bundle_id=self.bundle_id,
        )

    def _key_text(self) -> str:
        if self.key_file is not None:
            return _read_key_file(self.key_file)
        if self.key is None:
            raise UsageError("no key was given", remedy="give --key-file, or set M100LINK_KEY_FILE")
        if "M100LINK_KEY" not in os.environ:
            err.print("[yellow]warning:[/] --key shows the key to everybody who lists processes")
        return self.key


def _read_key_file(path: Path) -> str:
    try:
        text = path.expanduser().read_text(encoding="ascii")
        mode = stat.S_IMODE(path.expanduser().stat().st_mode)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"the key file cannot be read: {error}") from error
    if mode & 0o077:
        err.print(
            f"[yellow]warning:[/] {path} can be read by others (mode {mode:o}): chmod 600 {path}"
        )
    return text


def run_async(work: Coroutine[Any, Any, int | None]) -> int:
    """Run a command's coroutine; errors become a message and an exit status."""
    try:
        return asyncio.run(work) or ExitCode.OK
    except errors.M100Error as error:
        return complain(error)
    except KeyboardInterrupt:
        err.print("interrupted")
        return ExitCode.INTERRUPTED
