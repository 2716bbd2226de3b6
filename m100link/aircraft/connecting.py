"""Opening a line and looking for an aircraft at its end: :func:`connect`."""

from __future__ import annotations

import asyncio
import math
import os
import re
from collections.abc import Callable, Coroutine, Generator, Iterable
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from m100link.errors import UsageError
from m100link.errors.base import of_the_system

if TYPE_CHECKING:  # all that a connection needs is loaded when one is made
    from m100link.aircraft.aircraft import Aircraft
    from m100link.link import Direction, Link, Tap
    from m100link.log.channels import Entry
    from m100link.protocol.firmware import FirmwareProfile
    from m100link.protocol.records import AccelerationMode


# The text of an error may quote its input: an address with its options, a key.
_SECRET = re.compile(r"\b((?:key|app[-_ ]?id)[=: ]+)[^\s&,;]+", re.IGNORECASE)
_KEY = re.compile(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])", re.IGNORECASE)

_LONGEST = 1000  # characters of a text
COUNTERS_S = 1.0  # between two records of the counters of the link


class Recording(Protocol):
    """A log that keeps a flight: :class:`m100link.log.Recorder`."""

    def begin(self) -> None:
        """Be the log of one connection, or raise UsageError."""

    def tap(self, direction: Direction, data: bytes, now: float) -> None:
        """See :data:`m100link.link.Tap`."""

    def watch(
        self,
        link: Link,
        firmware: Callable[[], FirmwareProfile],
        look: Callable[[], Iterable[Entry]],
        acceleration: Callable[[], AccelerationMode | None],
    ) -> None:
        """Log the events and counters of a connection besides its bytes."""

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

    async def __aexit__(self, *_: object) -> None:
        if self._aircraft is not None:
            await self._aircraft.aclose()


def connect(
    line: str | Link,
    *,
    firmware: str | FirmwareProfile | None = None,
    baud_rate: int | None = None,
    timeout: float | None = None,
    tap: Tap | None = None,
    record: str | os.PathLike[str] | Recording | None = None,
    acceleration: str | None = None,
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
        timeout: Seconds until an aircraft has to answer. By default 15 if it is heard within 3 s,
            by a network within 8 s: the line may be slow.
        tap: Called with the bytes of every read and write, which way they went and when, on the
            event loop's clock: see :data:`m100link.link.Tap`. The activation carries the app id in
            clear.
        record: File for a flight log, or a folder for one that is named by the time; or a
            :class:`m100link.log.Recorder`. Needs the extra ``log``.
        acceleration: ``"raw"`` or ``"fused"``, as the PC assistant is set; by default one second at
            rest shows it. Telemetry has it fused in both cases: see :class:`AccelerationMode`.

    Raises (when it is entered or awaited):
        BadURL, UsageError: A wrong string or profile name; no asyncio, but trio; a tap on a link.
        PortNotFound, PortPermissionDenied, PortBusy, PortFailed: The port cannot be opened.
        SilentLine, NoValidFrame, NoAnswer: It can, but no aircraft answers; each names the cause.
    """
    name = line if isinstance(line, str) else line.name
    return Connecting(
        partial(_open, line, firmware, baud_rate, timeout, tap, record, acceleration), name
    )


async def _open(
    line: str | Link,
    firmware: str | FirmwareProfile | None,
    baud_rate: int | None,
    timeout: float | None,
    tap: Tap | None,
    record: str | os.PathLike[str] | Recording | None,
    acceleration: str | None,
) -> Aircraft:
    _require_asyncio()
    from m100link.aircraft.aircraft import Aircraft
    from m100link.link import Link, open_link
    from m100link.protocol.firmware import profile
    from m100link.telemetry.sample import acceleration_mode

    forced = None if firmware is None else profile(firmware)
    mode = acceleration_mode(acceleration)
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
        from m100link.aircraft.replaying import open_replay  # few programs look back

        return await open_replay(line, firmware=forced, tap=tap, acceleration=mode)
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
    aircraft = Aircraft(link, firmware=forced, acceleration=mode)
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
    known = aircraft._telemetry.acceleration
    recorder.watch(aircraft.link, lambda: aircraft.firmware, observer(aircraft), lambda: known.mode)
    aircraft._at_end.append(recorder.aclose)


def observer(aircraft: Aircraft) -> Callable[[], list[Entry]]:
    """The function that gives the log new records: each event and note, counters once a second.

    A record with its own time has it as ``at``, s on the clock of the event loop.
    """
    from m100link.log.channels import EVENT, LINK  # few programs record

    events = aircraft.events()
    counted_at = -math.inf

    def look() -> list[Entry]:
        nonlocal counted_at
        entries: list[Entry] = [
            (EVENT, _written(note)) for take in aircraft._noters for note in take()
        ]
        while (event := events.get_nowait()) is not None:
            kind = type(event).__name__.removesuffix("Event").lower()
            values = {name: _plain(value) for name, value in event._asdict().items()}
            entries.append((EVENT, {"event": kind, **values}))
        now = aircraft.link.loop.time()
        if now - counted_at >= COUNTERS_S:
            counted_at = now
            counters = asdict(aircraft.statistics())
            known = {"firmware": aircraft.firmware.name, "acceleration": aircraft.acceleration_mode}
            entries.append((LINK, {**known, **counters}))
        return entries

    return look


def _written(note: dict[str, Any]) -> dict[str, Any]:
    try:
        return {name: _plain(value) for name, value in note.items()}
    except Exception as error:  # noqa: BLE001 (a value that has no text costs its note alone)
        return {"event": "note", "at": note["at"], "problem": type(error).__name__}


def _plain(value: Any) -> Any:
    """A value as JSON takes it, without its secrets: those are fields that repr does not show."""
    if isinstance(value, Enum):
        value = value.value if isinstance(value.value, str) else value.name.lower()
    if value is None or isinstance(value, bool | int | float):
        return value
    if isinstance(value, dict):
        return {str(name): _plain(one) for name, one in value.items()}
    if is_dataclass(value):
        value = [(one.name, getattr(value, one.name)) for one in fields(value) if one.repr]
        return {name: _plain(one) for name, one in value}
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    text = _SECRET.sub(r"\1…", str(value)[:_LONGEST])
    return _KEY.sub("…", text)


def _recorder(record: str | os.PathLike[str] | Recording) -> Recording:
    with of_the_system("a recording"):
        from m100link.log.recorder import Recorder

    return Recorder(record) if isinstance(record, str | os.PathLike) else record


def _both(tap: Tap | None, recorder: Recording | None) -> Tap | None:
    if tap is None or recorder is None:
        return tap if recorder is None else recorder.tap
    from m100link.link.statistics import TapListener

    write, also = recorder.tap, TapListener(tap)

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
