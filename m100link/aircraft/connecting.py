"""Opening a line and looking for an aircraft at its end: :func:`connect`."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable, Coroutine, Generator, Iterable
from dataclasses import asdict
from enum import Enum
from functools import partial
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, Protocol
from urllib.parse import parse_qsl, unquote

from m100link.aircraft.aircraft import Aircraft
from m100link.errors import BadURL, UsageError
from m100link.errors.base import of_the_system
from m100link.errors.texts import read_path
from m100link.flight.authority import TRANSITIONS, Authority, AuthorityInput, AuthorityState
from m100link.link import Direction, Link, Tap, open_link
from m100link.link.statistics import Listener
from m100link.log.channels import EVENT, LINK, Told
from m100link.log.player import FASTEST, SLOWEST, Player, ReplayedLink, Stage, begin_of
from m100link.log.reading import read
from m100link.protocol.firmware import FirmwareProfile, profile

if TYPE_CHECKING:
    from m100link.log.channels import Told

__all__ = [
    "SCHEME",
    "Connecting",
    "ReplayURL",
    "be_recorded",
    "connect",
    "observer",
    "open_replay",
    "parse_replay",
]


# -- what a flight log is told besides the bytes of the line ---------------------------------------


# What an error says may quote what it was given: an address with its options, a key.
_SECRET = re.compile(r"\b((?:key|app[-_ ]?id)[=: ]+)[^\s&,;]+", re.IGNORECASE)
_KEY = re.compile(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])", re.IGNORECASE)

COUNTERS_S = 1.0
"""Between two records of the counters of the link."""


def observer(aircraft: Aircraft) -> Callable[[], list[Told]]:
    """What to ask whenever the log wants to know: events as they came, counters once a second."""
    events = aircraft.events()
    counted_at = -math.inf

    def look() -> list[Told]:
        nonlocal counted_at
        told: list[Told] = []
        while (event := events.get_nowait()) is not None:
            kind = type(event).__name__.removesuffix("Event").lower()
            values = {name: _plain(value) for name, value in event._asdict().items()}
            told.append((EVENT, {"event": kind, **values}))
        now = aircraft.link.loop.time()
        if now - counted_at >= COUNTERS_S:
            counted_at = now
            counters = asdict(aircraft.statistics())
            told.append((LINK, {"firmware": aircraft.firmware.name, **counters}))
        return told

    return look


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool):
        return value
    text = _SECRET.sub(r"\1…", str(value))
    return _KEY.sub("…", text)


# -- ``replay://`` URLs: a recorded flight as an :class:`Aircraft` that obeys nobody ---------------


SCHEME = "replay://"

_OPTIONS = ("speed", "from", "to")
_EXAMPLE = f"{SCHEME}flight.mcap?speed=2&from=30&to=90"
_I = AuthorityInput

# What a program does; the rest follows from what comes over the line, then as now.
_OURS = (_I.OBTAIN, _I.OBTAINED, _I.REFUSED, _I.RELEASE, _I.RELEASED, _I.NOT_RELEASED)


class ReplayURL(NamedTuple):
    """A parsed ``replay://`` URL.

    Attributes:
        path: The file.
        speed: Times as fast as it was flown; infinity for max.
        from_s, to_s: From where to where, seconds from its first byte.
    """

    path: Path
    speed: float = 1.0
    from_s: float = 0.0
    to_s: float = math.inf


def parse_replay(url: str) -> ReplayURL:
    """Read a ``replay://`` URL: a path, relative or absolute, and options behind a ``?``.

    Raises:
        BadURL: It names no file, or an option that does not exist or cannot be so.
    """
    target = url.strip().removeprefix(SCHEME)
    name, mark, options = target.rpartition("?")
    if not mark or ("=" not in options and options):
        name, options = target, ""
    if not name:
        raise _bad(url, "names no file")
    path = read_path(name)
    if "%" in name and not path.exists():
        path = read_path(unquote(name))
    values: dict[str, float] = {}
    for option, text in parse_qsl(options, keep_blank_values=True):
        if option not in _OPTIONS:
            raise _bad(url, f"has the option {option!r}; there are {', '.join(_OPTIONS)}")
        values[option] = _number(url, option, text)
    begin, end = values.get("from", 0.0), values.get("to", math.inf)
    if begin >= end:
        raise _bad(url, "ends before it begins")
    return ReplayURL(path, values.get("speed", 1.0), begin, end)


def _number(url: str, option: str, text: str) -> float:
    if option == "speed" and text == "max":
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if option == "speed" and not SLOWEST <= value <= FASTEST:
        raise _bad(url, f"has the speed {text!r}, which is not {SLOWEST:g} to {FASTEST:g} or max")
    if not 0.0 <= value < math.inf:
        raise _bad(url, f"has {option}={text!r}, which is not a number of seconds")
    return value


def _bad(url: str, why: str) -> BadURL:
    return BadURL(f"{url!r} {why}", remedy=f"write it like {_EXAMPLE}")


async def open_replay(
    url: str | ReplayURL,
    *,
    firmware: FirmwareProfile | None = None,
    tap: Tap | None = None,
    holds: bool = False,
) -> Aircraft:
    """The aircraft of a recording, which is played from the next turn of the event loop on.

    Args:
        url: Which, from where, and how fast.
        firmware: By which telemetry is read; by default that of the flight.
        tap: Hears the bytes of both directions.
        holds: Stand still at the end, instead of ending with :class:`ReplayEnded`.

    Raises:
        BadURL, UsageError: It cannot be, or the file cannot be played.
    """
    wanted = parse_replay(url) if isinstance(url, str) else url
    flight = read(wanted.path)
    begin = await begin_of(flight, is_moved=holds or wanted.from_s > 0.0)
    if wanted.from_s > begin.duration_s:
        raise UsageError(
            f"{flight.path} is {begin.duration_s:.1f} s long and cannot be played from "
            f"{wanted.from_s:g} s on",
            remedy="begin earlier",
        )
    known = firmware or begin.firmware
    if known is None:
        raise flight.nameless("firmware='1.0'")
    player = Player(
        flight, begin, speed=wanted.speed, from_s=wanted.from_s, to_s=wanted.to_s, holds=holds
    )
    link = ReplayedLink(player)
    aircraft = Aircraft(link, firmware=firmware)
    aircraft._requests.take_recorded(begin.version, known)
    telemetry = aircraft._telemetry
    telemetry.utc_offset_s = player.utc_offset_s
    player.play(
        Stage(
            decode=link.decode,
            deliver=link.deliver,
            tell=lambda told: _tell(aircraft.authority, told),
            forget=lambda: _forget(aircraft.authority),
            end=link.end,
            has_consumers=lambda: telemetry.has_consumers,
            room=lambda: telemetry.room,
            tap=None if tap is None else Listener(tap).hear,
        )
    )
    return aircraft


def _forget(authority: Authority) -> None:
    if authority.state is not AuthorityState.NONE:
        authority.feed(_I.RELEASE)
        authority.feed(_I.RELEASED)


def _tell(authority: Authority, told: dict[str, Any]) -> None:
    """Who had control: what the line does not show is what the program of then did."""
    if told.get("event") != "authority":
        return
    try:
        after = AuthorityState(told.get("after"))
    except ValueError:
        return  # of a later version
    if after is authority.state:
        return
    ways = [what for what, state in TRANSITIONS[authority.state].items() if state is after]
    ways.sort(key=lambda what: what not in _OURS)
    if ways:
        authority.feed(ways[0])


# -- connecting ------------------------------------------------------------------------------------


class Recording(Protocol):
    """What keeps a flight: :class:`m100link.log.Recorder`."""

    def begin(self) -> None:
        """Be the log of one connection, or raise UsageError."""

    def tap(self, direction: Direction, data: bytes, now: float) -> None:
        """See :data:`m100link.link.Tap`."""

    def watch(
        self,
        link: Link,
        firmware: Callable[[], FirmwareProfile],
        look: Callable[[], Iterable[Told]],
    ) -> None:
        """What is known of a connection besides its bytes."""

    async def aclose(self) -> None:
        """End it, after the line has."""


class Connecting:
    """A connection to be made, by ``async with`` or ``await``: see :func:`m100link.connect`.

    Args:
        connect: Makes it.
        line: Where to, for people.
    """

    def __init__(self, connect: Callable[[], Coroutine[Any, Any, Aircraft]], line: str) -> None:
        self._connect = connect
        self._line = line
        self._aircraft: Aircraft | None = None  # while the block runs

    def __repr__(self) -> str:
        return f"<connection to {self._line}, to be made by `async with` or `await`>"

    if not TYPE_CHECKING:  # a checker names what is missing by itself

        def __getattr__(self, name: str) -> object:
            if name.startswith("_"):  # what copies and inspects asks for much
                raise AttributeError(name)
            raise AttributeError(
                f"this is {self!r} and has no {name!r} yet: write `async with connect(...) as "
                "aircraft:`, or `aircraft = await connect(...)`"
            )

        def __enter__(self) -> NoReturn:
            raise UsageError(
                f"`with` cannot make a {repr(self).strip('<>')}",
                remedy="async with; in a program without await: m100link.sync.connect(...)",
            )

        def __exit__(self, *_: object) -> None:
            """Only so that ``with`` gets as far as its error."""

    def __await__(self) -> Generator[Any, Any, Aircraft]:
        return self._connect().__await__()

    async def __aenter__(self) -> Aircraft:
        self._aircraft = await self._connect()
        return self._aircraft

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._aircraft is not None:
            await self._aircraft.aclose()


def connect(
    line: str | Link,
    *,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    timeout: float = 3.0,
    tap: Tap | None = None,
    record: str | PathLike[str] | Recording | None = None,
) -> Connecting:
    """Connect to an aircraft for the time of a block.

    ::

        async with m100link.connect("serial:///dev/ttyUSB0:230400") as aircraft:
            print(await aircraft.version())

    At a prompt, or in a service, ``aircraft = await m100link.connect(...)`` connects until
    :meth:`Aircraft.aclose`.

    Args:
        line: ``serial:///dev/ttyUSB0:230400``, a bare device path, ``tcp://host:port``, ``sim://``,
            ``replay://flight.mcap`` for a recorded flight, or a link that is open already.
        firmware: Force a profile by name; by default the version answer chooses it.
        baud_rate: Rate when the URL has none; 230400 by default.
        timeout: Seconds until an aircraft has to answer.
        tap: Called with the bytes of every read and write, which way they went and when, on the
            event loop's clock: see :data:`m100link.link.Tap`. The activation carries the app id in
            clear.
        record: File for a flight log, or a folder for one that is named by the time; or a
            :class:`m100link.log.Recorder`. Needs the extra ``log``.

    Raises (when it is entered or awaited):
        BadURL, UsageError: A wrong string or profile name; no asyncio, but trio; a tap on a link.
        PortNotFound, PortPermissionDenied, PortBusy, PortFailed: The port cannot be opened.
        SilentLine, NoValidFrame, NoAnswer: It can, but no aircraft answers; each names the cause.
    """
    name = line if isinstance(line, str) else line.name
    opening = partial(
        _open,
        line,
        firmware=firmware,
        baud_rate=baud_rate,
        timeout=timeout,
        tap=tap,
        record=record,
    )
    return Connecting(opening, name)


async def _open(
    line: str | Link,
    *,
    firmware: str | FirmwareProfile | None,
    baud_rate: int | None,
    timeout: float,
    tap: Tap | None,
    record: str | PathLike[str] | Recording | None,
) -> Aircraft:
    _require_asyncio()
    forced = None if firmware is None else profile(firmware)
    if isinstance(line, Link) and (tap is not None or record is not None):
        raise UsageError(
            f"{line.name} is open already, and can be neither tapped nor recorded",
            remedy="give the tap to open_link(), or the URL to connect()",
        )
    if isinstance(line, str) and line.strip().startswith("replay://"):
        if record is not None:
            raise UsageError(
                f"{line} is a recording already, and is not recorded again",
                remedy="leave out record=; the file is there",
            )
        from m100link.aircraft.connecting import open_replay  # few programs look back

        return await open_replay(line, firmware=forced, tap=tap)
    recorder = None if record is None else _recorder(record)
    if recorder is not None:
        recorder.begin()
    try:
        if isinstance(line, Link):
            link = line
        else:
            with of_the_system("a connection"):
                link = await open_link(line, baud_rate=baud_rate, tap=_both(tap, recorder))
    except BaseException:
        if recorder is not None:
            await recorder.aclose()
        raise
    aircraft = Aircraft(link, firmware=forced)
    if recorder is not None:
        be_recorded(aircraft, recorder)
    try:
        await aircraft._requests.find_aircraft(timeout)
    except BaseException:
        await aircraft.aclose()
        raise
    return aircraft


def be_recorded(aircraft: Aircraft, recorder: Recording) -> None:
    """Have a log, which hears the bytes already, know the rest; it ends with the connection."""
    from m100link.aircraft.connecting import observer

    recorder.watch(aircraft.link, lambda: aircraft.firmware, observer(aircraft))
    aircraft._at_end.append(recorder.aclose)


def _recorder(record: str | PathLike[str] | Recording) -> Recording:
    with of_the_system("a recording"):
        from m100link.log.recorder import Recorder  # few programs record

    return Recorder(record) if isinstance(record, str | PathLike) else record


def _both(tap: Tap | None, recorder: Recording | None) -> Tap | None:
    if tap is None or recorder is None:
        return tap if recorder is None else recorder.tap
    write, also = recorder.tap, Listener(tap)

    def hear(direction: Direction, data: bytes, now: float) -> None:
        write(direction, data, now)
        also.hear(direction, data, now)

    return hear


def _require_asyncio() -> None:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        raise UsageError(
            "there is no event loop of asyncio here",
            cause="the program runs on trio, or steps through the coroutine itself",
            remedy="asyncio.run(main()), or anyio.run(main, backend='asyncio'); without an event "
            "loop, or beside that of trio: m100link.sync",
        ) from None
