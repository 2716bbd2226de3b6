"""Options and helpers of verbs with an aircraft: its place, its app, two consoles."""

from __future__ import annotations

import asyncio
import os
import re
import sys
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

from m100link.apps.agent.background import Ended
from m100link.apps.cli.configuration import read_configuration
from m100link.apps.cli.options import Above0, offered, options_of
from m100link.apps.cli.terminal import AS_IT_IS, LINES, ExitCode, LogOptions, panel
from m100link.apps.station.config import ENVIRONMENT, Settings, resolve
from m100link.apps.station.log_output import log_of
from m100link.errors import UsageError
from m100link.errors.texts import printable
from m100link.link.url import parse_url
from m100link.protocol.commands.activation import RATES_HZ, Credentials
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import AccelerationMode

if TYPE_CHECKING:
    from m100link.aircraft.connecting import Connecting, Recording
    from m100link.flight.guards import Envelope


class TextConsole(Console):
    """A console that shows what it is given: no text of a file or a stranger steers a terminal."""

    def print(self, *objects: Any, **options: Any) -> None:
        """As rich does; a message in a pipe stays one line, so that no path in it breaks."""
        soft_wrap = self.stderr and not self.is_terminal
        super().print(*objects, **{"soft_wrap": soft_wrap, **options})

    def render_str(self, text: str, **options: Any) -> Text:
        """As rich does, with other characters in place of those that a terminal obeys."""
        return super().render_str(printable(text, keeps=LINES), **options)


# A bracket in the text of a stranger is a bracket: nothing here has a style by its signs.
out = TextConsole(highlight=False, markup=False)
"""Standard output: data."""

err = TextConsole(stderr=True, highlight=False, markup=False)
"""Standard error: messages."""


def places() -> list[str]:
    """Where aircraft may be: those that have names, and the ports of this machine."""
    from m100link.link.transport import serial_ports

    return [*read_configuration().aircraft, *serial_ports(), "sim://"]


Url = Annotated[
    str | None,
    Parameter(
        help="Where the aircraft is: serial:///dev/ttyUSB0:230400, /dev/ttyUSB0, "
        "tcp://host:port, sim://, or its name in the configuration file; by default that of "
        "--url or M100LINK_URL."
    ),
    offered(places),
]


_OF_PANEL = {
    "Aircraft": "url sim firmware baud_rate timeout acceleration",
    "App registered with DJI": "app_id key_file key level app_version bundle_id",
    "Safety": "max_height max_radius",
    "rosbridge": "port also_ports pages max_clients",
    "Console": "console_port tiles video",
    "Access": "host token_file allow_host allow_origin tls_cert tls_key",
    "MAVLink": "mavlink mavlink_to sysid autopilot signing_key_file",
    "ROS 2": "ros2 ros2_rmw ros2_namespace ros2_node ros2_domain ros2_remap ros2_dji_names",
    "Foxglove and Prometheus": "foxglove_port metrics_port",
    "Flight logs": "record no_record record_keep record_keep_mb",
}
_RARE = panel("Rarely needed")
_PANELS = {name: panel(title) for title, names in _OF_PANEL.items() for name in names.split()}
_CALLED = {
    "baud_rate": "--baud",
    "also_ports": "--also-port",
    "metrics_port": "--metrics",
    "foxglove_port": "--foxglove",
}
_OFFERED = {
    "url": offered(places),
    "firmware": offered(PROFILES),
    "acceleration": offered(AccelerationMode),
}


def layer_of_settings(names: Iterable[str], called: Mapping[str, str] | None = None) -> Any:
    """Options that are one source of the station's settings."""
    order = {name: place for place, name in enumerate(_PANELS)}
    names = sorted(names, key=lambda name: order.get(name, len(order)))
    return options_of(
        Settings,
        names,
        environment=ENVIRONMENT,
        called=_CALLED | dict(called or {}),
        panels={name: _PANELS.get(name, _RARE) for name in names},
        extras=_OFFERED,
        is_layer=True,
    )


@Parameter(name="*")
@dataclass(frozen=True)
class AppOptions(layer_of_settings(_OF_PANEL["App registered with DJI"].split())):  # type: ignore[misc] # a class that is made
    """The app that is registered with DJI: fields of the station's settings."""


_OF_ENVELOPE: Any = options_of(
    Settings,
    ("max_height", "max_radius"),
    panels=_PANELS,
    extras={"max_height": Above0, "max_radius": Above0},
)


@Parameter(name="*")
@dataclass(frozen=True)
class EnvelopeOptions(_OF_ENVELOPE):  # type: ignore[misc] # a class that is made
    """How high and how far a flight may go."""

    @property
    def envelope(self) -> Envelope:
        """As the guards take it."""
        from m100link.flight.guards import Envelope  # a verb that only listens needs none

        return Envelope(self.max_height, self.max_radius)


WITHIN_DEFAULTS = EnvelopeOptions()


@dataclass(frozen=True)
class ConnectionOptions:
    """Where the aircraft is, how to talk to it, and whose app it is: from all sources."""

    url: str  # where the aircraft is
    settings: Settings  # everything else; each names its source

    def connect(self, record: Recording | None = None) -> Connecting:
        """As :func:`m100link.connect`."""
        from m100link.aircraft import connect  # a station loads it in another process

        url, firmware = self.url, self.settings.firmware
        if url == "sim://" and firmware:  # it has no other that could be meant
            url, firmware = f"sim://?firmware={firmware}", None
        return connect(
            url,
            firmware=firmware,
            baud_rate=self.settings.baud_rate,
            timeout=self.settings.timeout,
            record=record,
            acceleration=self.settings.acceleration,
        )

    @property
    def is_virtual(self) -> bool:
        """Whether it lives in this process, where nothing can be hurt."""
        return self.url.startswith("sim:")

    def credentials(self) -> Credentials:
        """The checked credentials; of a ``sim://`` the demo app's. Raises UsageError, BadKey."""
        app = self.settings
        if self.is_virtual and (app.app_id, app.key, app.key_file) == (None,) * 3:
            from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY  # loads the simulator

            return Credentials(DEMO_APP_ID, DEMO_KEY, level=app.level)
        if app.origins.get("key") == "command line":
            seen = "warning: --key shows the key to every user who lists processes"
            err.print(seen, style="yellow")
        credentials = app.credentials()
        if credentials is None:
            raise UsageError(
                "no app id was given",
                remedy="give --app-id and --key-file, or set M100LINK_APP_ID and "
                "M100LINK_KEY_FILE, or write both into the file that `m100link config` shows; "
                "for `m100link sim` see m100link docs simulator",
            )
        return credentials


@Parameter(name="*")
@dataclass(frozen=True)
class LinkOptions(
    layer_of_settings(("url", "firmware", "baud_rate", "timeout", "acceleration"))  # type: ignore[misc] # a class that is made
):
    """Where the aircraft is, and how to talk to it: fields of the station's settings."""

    log: LogOptions = AS_IT_IS

    def place(self, argument: str | None) -> ConnectionOptions:
        """The aircraft that the argument, ``--url``, the environment or the configuration names.

        Options come before the environment, that before the file.
        Raises UsageError: none names it, or argument and option name two; a setting cannot be.
        """
        if None not in (argument, self.url) and argument != self.url:
            raise UsageError(
                f"two aircraft are named: {argument} and {self.url}", remedy="leave out one of them"
            )
        given: dict[str, Any] = asdict(self) | {"url": argument or self.url}
        given |= given.pop("app", {})
        del given["log"]
        configuration = read_configuration()
        settings = resolve(given, os.environ, of_aircraft=configuration.sources)
        if settings.url is None:
            raise UsageError(
                "no URL says where the aircraft is",
                remedy="give one as argument (after PLAN in `mission fly`) or with --url, set "
                "M100LINK_URL, or name an aircraft in the file that `m100link config` shows",
            )
        log_of(_shown(given["url"] or settings.url))
        return ConnectionOptions(settings.url, settings)

    def place_among(
        self,
        words: Iterable[str],  # one may be a URL, a port or a name
        is_other: Callable[[str], bool],  # whether a word looks like one of the others
    ) -> tuple[ConnectionOptions, tuple[str, ...]]:
        """Where the aircraft is, and the other words; the aircraft may stand anywhere."""
        words, known = list(filter(None, words)), read_configuration().aircraft
        places = [word for word in words if _PLACE.match(word) or word in known] or words[:1]
        if not places or is_other(places[0]):
            return self.place(None), tuple(words)
        words.remove(places[0])
        return self.place(places[0]), tuple(words)


BY_LINK = LinkOptions()


@Parameter(name="*")
@dataclass(frozen=True)
class AircraftOptions(LinkOptions):
    """The app, too, for verbs that activate the aircraft."""

    app: AppOptions = AppOptions()


AS_SET = AircraftOptions()

_PLACE = re.compile(r"sim:|.*/|COM\d+$", re.IGNORECASE)
"""The begin of a word that is no item and no rate, but a URL or a port."""


def _shown(url: str) -> str:
    """A name of the configuration file as it is, a URL without what it may keep secret."""
    try:
        return url if url in read_configuration().aircraft else str(parse_url(url))
    except UsageError:
        return ""  # connecting tells its fault


def run_async(work: Coroutine[Any, Any, int | None]) -> int:
    """Run a command's coroutine; the caller reports errors and Ctrl-C."""
    try:
        # The usual loop of Windows watches no sockets for the servers of a station.
        factory = asyncio.SelectorEventLoop if sys.platform == "win32" else None
        with asyncio.Runner(loop_factory=factory) as runner:
            return runner.run(work) or ExitCode.OK
    except asyncio.CancelledError:  # a signal came before it ran
        return ExitCode.OK


def pairs(words: Iterable[str]) -> dict[str, int]:
    """Rates by item. Raises UsageError: a word is not ITEM=HZ."""
    found: dict[str, int] = {}
    for word in words:
        name, _, rate = word.partition("=")
        if not rate.isascii() or not rate.isdigit():
            raise UsageError(
                f"{word!r} is not a rate",
                remedy=f"ITEM=HZ, such as attitude=50; rates: {', '.join(map(str, RATES_HZ))}",
            )
        if name in found:
            raise UsageError(f"two rates were given for {name}", remedy="give one")
        found[name] = int(rate)
    return found


async def until(seconds: float | None, work: Any) -> None:
    """Run for these seconds at most. Raises the error that ends it earlier."""
    try:
        async with asyncio.timeout(seconds) as limit:
            await work
    except TimeoutError:
        if not limit.expired():
            raise


def ended_by_signal() -> Ended:
    """The end of a verb, which says so where the verb has not come to wait for it yet."""
    return Ended(lambda: err.print("ending"))
