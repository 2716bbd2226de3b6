"""What commands with an aircraft share: where it is, whose app it is, two consoles."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass, fields
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from m100link import errors
from m100link.cli.options import Above0, Counted, options_of
from m100link.cli.outcome import ExitCode, complain
from m100link.errors import UsageError
from m100link.protocol.commands.activation import Credentials
from m100link.sim.vehicle.mobile import DEMO_APP_ID, DEMO_KEY
from m100link.station.config import ENVIRONMENT, Settings

__all__ = ["AppOptions", "LinkOptions", "Url", "err", "out", "run_async"]

out = Console(highlight=False)
"""Standard output: data."""

err = Console(stderr=True, highlight=False)
"""Standard error: talk."""


Url = Annotated[
    str | None,
    Parameter(
        help="Where the aircraft is: serial:///dev/ttyUSB0:230400, /dev/ttyUSB0, "
        "tcp://host:port, sim://; without it, that of --url or M100LINK_URL",
    ),
]


@Parameter(name="*")
@dataclass
class LinkOptions:
    """How to talk to it.

    Attributes:
        url: Where the aircraft is (M100LINK_URL), if no argument says it.
        firmware: Force a firmware profile instead of choosing it from the version answer.
        baud: Baud rate when the URL has none.
        timeout: Seconds until an aircraft has to answer.
    """

    url: str | None = None
    firmware: Annotated[str | None, Parameter(env_var="M100LINK_PROFILE")] = None
    baud: Annotated[int | None, Counted] = None
    timeout: Annotated[float, Above0] = 3.0

    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of :func:`m100link.connect`."""
        return {"firmware": self.firmware, "baud_rate": self.baud, "timeout": self.timeout}

    def place(self, argument: str | None) -> str:
        """Where the aircraft is: the argument, else ``--url``, else the environment.

        Raises:
            UsageError: Nobody says it, or argument and option name two.
        """
        if None not in (argument, self.url) and argument != self.url:
            raise UsageError(
                f"two aircraft are named: {argument} and {self.url}", remedy="leave out one of them"
            )
        url = argument or self.url or os.environ.get("M100LINK_URL")
        if not url:
            raise UsageError(
                "no URL says where the aircraft is",
                remedy="give it as first argument or with --url, or set M100LINK_URL",
            )
        return url

    def place_among(
        self, words: Iterable[str], is_other: Callable[[str], bool]
    ) -> tuple[str, tuple[str, ...]]:
        """Where the aircraft is, and the words that follow.

        Args:
            words: Arguments of which the first may be a URL.
            is_other: Whether a word has the shape of what follows.
        """
        first, *rest = words = tuple(words) or ("",)
        if not first or is_other(first):
            return self.place(None), tuple(filter(None, words))
        return self.place(first), tuple(rest)


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
