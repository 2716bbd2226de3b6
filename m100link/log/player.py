"""Plays a flight log: the bytes of the line come again, at the times at which they came."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from m100link.errors import LinkClosed, OnlyRecorded, ReplayEnded, UsageError
from m100link.errors.usage import unread
from m100link.link import Direction, Tap
from m100link.link.link import Link
from m100link.link.url import FASTEST, SLOWEST
from m100link.log.channels import EVENT
from m100link.log.damage import Damage
from m100link.log.reading import Chunk, FlightLog, Message
from m100link.protocol.commands.activation import GetVersion, Version
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode
from m100link.session.events import SessionMode
from m100link.wire import Frame, FrameDecoder

RUN_UP_S = 2.5
"""Messages from so long before the beginning come at once: items of 1 Hz are known then."""

_BATCH = 50  # frames until the event loop has its turn; consumers may keep no more
_APART_S = 0.001  # between the packages before a seek and its run-up
_LATE_S = 0.25  # later than this, nothing is caught up: the computer was busy, not the flight
_EAGER = 20  # turns of the event loop in which a consumer may take what it got, before pauses
_LONGEST_PAUSE_S = 0.02
_BEGIN_WITHIN_S = 1.0  # at any speed, without anybody who takes telemetry
_ANSWERED_WITHIN_S = 60.0
_LARGE = 2_000_000  # bytes of a file that is looked through in a thread

_VERSION = bytes(GetVersion.ADDRESS)


class Begin(NamedTuple):
    """The facts of a recording that are known before it is played."""

    at: float  #: The time of the recording's event loop at which it begins, s.
    utc: float  #: The same as POSIX time, s.
    duration_s: float  #: How long it goes on.
    damage: Damage  #: The parts missing from the file; whether it was ended is there, too.
    #: The aircraft's first answer; None when it did not answer in the first minute.
    version: Version | None
    #: By which telemetry was read; None when that was never known.
    firmware: FirmwareProfile | None
    #: Control authority over time; for playing from elsewhere than the beginning.
    events: tuple[Message, ...] = ()
    #: The mode in which it was sent; None when that was never known.
    acceleration: AccelerationMode | None = None

    @property
    def is_ended(self) -> bool:
        """Whether the file was ended."""
        return self.damage.is_ended


async def begin_of(
    flight: FlightLog,
    *,
    is_moved: bool = True,  # it may be played from elsewhere than its beginning
    holds: bool = False,  # it stands still at its end, and says nothing of the file then
    firmware: FirmwareProfile | None = None,  # to read telemetry by, if not that of the flight
) -> Begin:
    """Look through a recording.

    Raises ``UsageError``: it holds no bytes of a line, or cannot be read.
    """
    try:
        if flight.path.stat().st_size > _LARGE:
            return await asyncio.to_thread(_begin_of, flight, is_moved, holds, firmware)
        return _begin_of(flight, is_moved, holds, firmware)
    except OSError as error:
        raise unread(flight.path, error) from error


def _begin_of(
    flight: FlightLog, is_moved: bool, holds: bool, firmware: FirmwareProfile | None
) -> Begin:
    indexed = flight.indexed(EVENT) if holds else None  # of two hours all takes more than a second
    if indexed is not None:
        events, damage = indexed
    else:
        # Before the damage, which is then known: a large file is read through once.
        events = tuple(flight.messages(EVENT)) if is_moved else ()
        damage = flight.damage
    first: Chunk | None = None
    version: Version | None = None
    asked: set[tuple[int, int]] = set()
    decoders = {one: FrameDecoder() for one in Direction}
    for chunk in flight.chunks():
        first = first or chunk
        for frame in decoders[chunk.direction].feed(chunk.data):
            exchange = frame.session, frame.sequence
            if chunk.direction is Direction.SENT:
                if frame.data.startswith(_VERSION) and not frame.is_ack:
                    asked.add(exchange)
            elif frame.is_ack and exchange in asked and version is None:
                version = _version(frame)
        if version is not None or chunk.at > first.at + _ANSWERED_WITHIN_S:
            break
    if first is None:
        raise UsageError(
            f"{flight.path} holds no bytes of a line: there is nothing to replay",
            cause=f"damage: {damage}"
            if damage
            else "nothing was recorded in it, or another program wrote it",
            remedy="name a file that `m100link record` or connect(record=…) wrote; "
            "m100link log info FILE says what it holds",
        )
    duration = max(0.0, (damage.ended_utc or 0.0) - first.utc)
    known = flight.firmware
    chosen = firmware or known
    mode = None if chosen is None else flight.acceleration_by(chosen)
    return Begin(first.at, first.utc, duration, damage, version, known, events, mode)


def _version(frame: Frame) -> Version | None:
    try:
        return GetVersion.parse_ack(frame.data)
    except ValueError:
        return None


class PlaybackTarget(NamedTuple):
    """The consumer of a playback."""

    # Makes frames of the bytes of a read, and of the time when they came.
    decode: Callable[[bytes, float], Sequence[Frame]]
    deliver: Callable[[Frame, float], None]  # takes a frame, and the time when it came
    tell: Callable[[dict[str, Any]], None]  # takes what happened beside the bytes
    forget: Callable[[], None]  # called before it begins anywhere: all that was delivered is void
    end: Callable[[ReplayEnded], None]  # called with why there is no more
    has_consumers: Callable[[], bool]  # whether somebody takes packages
    room: Callable[[], float]  # how many packages nobody would lose an older one by
    tap: Tap | None  # hears the bytes of both directions; None for nobody


class Player:
    """Plays one recording, once.

    Its clock is that of the recorded flight, moved so that it stood where the event loop's stands
    when playing begins. It never passes a moment of the recording that was not delivered. So ages
    are as old as they were then, at any speed and however late the event loop is.

    Args:
        flight: The recording.
        begin: Its facts, as read before.
        speed: Times as fast as it was flown; infinity: as fast as it is taken.
        from_s: Where to begin, seconds from its first byte.
        to_s: Where to end.
        holds: Stand still at the end, instead of ending.

    Attributes:
        flight, begin: As given.
        is_at_end: Whether everything was played.
        speed: Times as fast as it was flown; :meth:`set_speed` changes it.
        is_paused: Whether it stands still on purpose.
    """

    def __init__(
        self,
        flight: FlightLog,
        begin: Begin,
        *,
        speed: float = 1.0,
        from_s: float = 0.0,
        to_s: float = math.inf,
        holds: bool = False,
    ) -> None:
        self.flight = flight
        self.begin = begin
        self.is_at_end = False
        self._loop = asyncio.get_running_loop()
        self._from = min(from_s, begin.duration_s)
        self._to = min(to_s, begin.duration_s)
        self._holds = holds
        self.speed = speed
        self._shift = self._loop.time() - (begin.at + self._from)
        # Where the recorded clock stood when the event loop's stood there: the last change of both.
        self._here = begin.at + self._from, self._loop.time()
        self.is_paused = False
        self._stage: PlaybackTarget | None = None  # None before it is played, and after it
        self._moments: Iterator[Chunk | Message] = iter(())
        self._next: Chunk | Message | None = None
        self._frames: deque[tuple[Frame, float]] = deque()  # of the newest read
        self._timer: asyncio.Handle | None = None
        self._broken = ""  # the fault that broke it off
        self._waits = 0  # for room, since there was some
        self._begins_by = 0.0
        self.run_began_at = self.time()  #: packages of an earlier time are void, s by :meth:`time`

    # -- time --------------------------------------------------------------------------------------

    @property
    def utc_offset_s(self) -> float:
        """POSIX time of the recorded flight minus :meth:`time`, s."""
        return self.begin.utc - self.begin.at - self._shift

    @property
    def position_s(self) -> float:
        """Seconds of the recording that were played, or passed over."""
        return min(max(self._from, self._then() - self.begin.at), self._to)

    def time(self) -> float:
        """The clock of the recorded flight, moved to where the event loop's stood."""
        return self._then() + self._shift

    def _then(self) -> float:
        then, since = self._here
        if self.is_at_end:
            return then
        if not self.is_paused and math.isfinite(self.speed):
            then += (self._loop.time() - since) * self.speed
        return min(then, self._due())

    def _due(self) -> float:
        """The recorded time of what comes next; that of the end when nothing does."""
        if self._frames:
            return self._frames[0][1] - self._shift
        return self.begin.at + self._to if self._next is None else self._next.at

    def _set_clock(self, then: float) -> None:
        self._here = then, self._loop.time()

    def pause(self, is_paused: bool = True) -> None:
        """Stand still; its clock does, too."""
        self._set_clock(self._then())
        self.is_paused = is_paused
        self._schedule()

    def resume(self) -> None:
        """Go on."""
        self.pause(False)

    def set_speed(self, speed: float) -> None:
        """Go on at another speed.

        Raises:
            UsageError: There is no such speed.
        """
        check_speed(speed)
        self._set_clock(self._then())
        self.speed = speed
        self._schedule()

    # -- playing -----------------------------------------------------------------------------------

    def play(self, stage: PlaybackTarget) -> None:
        """Begin, on the next turn of the event loop.

        At the highest speed it waits up to a second for somebody who takes telemetry.
        """
        self._stage = stage
        self._begins_by = self._loop.time() + _BEGIN_WITHIN_S
        self._open(stage)

    def _open(self, stage: PlaybackTarget) -> None:
        """Stand where it begins, with who had control there."""
        since = self.begin.at + self._from - RUN_UP_S
        self._broken = ""
        moments = self.flight.moments(since_utc=since + self.begin.utc - self.begin.at - 1.0)
        self._moments = (moment for moment in moments if moment.at >= since)
        stage.forget()
        for message in self.begin.events:
            if message.at < since:
                stage.tell(message.content())
        self._advance()
        self._set_clock(self.begin.at + self._from)
        self._schedule()

    def seek(self, to_s: float) -> None:
        """Go on from another place; the run-up to it begins where its clock stood.

        Args:
            to_s: Seconds from its first byte; what is beyond either end is that end.
        """
        self.run_began_at = self.time() + _APART_S
        self._from = min(max(0.0, to_s), self._to)
        # The run-up is later than every package so far: times tell the two apart.
        self._shift = self.run_began_at + RUN_UP_S - (self.begin.at + self._from)
        self._set_clock(self.begin.at + self._from)
        self._frames.clear()
        self.is_at_end = False
        if self._stage is not None:
            self._open(self._stage)

    def stop(self) -> None:
        """Play no more."""
        self._stage = None
        self._moments = iter(())
        self._frames.clear()
        self._schedule()

    def _advance(self) -> None:
        """Look at the next moment; what cannot be read ends it."""
        self._next = None
        try:
            moment = next(self._moments, None)
        except (OSError, UsageError) as error:
            why = error.seen if isinstance(error, UsageError) else error.strerror
            self._broken = f"it cannot be read any further: {why}"
        else:
            if moment is not None and moment.at <= self.begin.at + self._to:
                self._next = moment

    def _schedule(self, delay: float | None = None) -> None:
        """Have the next moment come when it is due."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._stage is None or self.is_at_end:
            return
        if self.is_paused:
            # Where it was moved to is shown all the same.
            if self._frames or (self._next is not None and self._next.at <= self._here[0]):
                self._timer = self._loop.call_soon(self._go)
        elif delay is not None:
            self._timer = self._loop.call_later(delay, self._go)
        elif self._frames or math.isinf(self.speed):
            self._timer = self._loop.call_soon(self._go)
        else:
            then, since = self._here
            self._timer = self._loop.call_at(since + (self._due() - then) / self.speed, self._go)

    def _go(self) -> None:
        self._timer = None
        pause: float | None = None
        then, since = self._here
        due = max(then, self._due())
        if self._loop.time() - since > (due - then) / self.speed + _LATE_S and not self.is_paused:
            self._set_clock(due)
        try:
            pause = self._play_some()
        finally:  # whatever a callback raised: the recording goes on
            self._schedule(pause)

    def _play_some(self) -> float | None:
        """Play the reads that are due; returns seconds to wait, or None."""
        is_as_fast_as_taken = math.isinf(self.speed) and not self.is_paused
        if is_as_fast_as_taken and self._begins_by and not self._is_awaited():
            return _LONGEST_PAUSE_S / 10
        self._begins_by = 0.0
        room = 0.0  # packages that nobody would lose an older one by, as far as was asked
        for _ in range(_BATCH):
            stage = self._stage
            if stage is None:
                return None
            if self._frames:
                if is_as_fast_as_taken:
                    room = room - 1 if room > 1 else stage.room()
                    if room < 1:
                        return self._wait()
                    self._waits = 0
                stage.deliver(*self._frames.popleft())
            elif self._next is None:
                if self.is_paused:
                    return None
                if is_as_fast_as_taken or self._then() >= self.begin.at + self._to - 1e-6:
                    self._end()
                return None
            elif is_as_fast_as_taken:
                then, since = self._here
                self._here = max(then, self._next.at), since
                self._take(self._next, stage)
            elif self._next.at <= self._then() + 1e-6:
                self._take(self._next, stage)
            else:
                return None
        return 0.0

    def _is_awaited(self) -> bool:
        assert self._stage is not None
        return self._stage.has_consumers() or self._loop.time() >= self._begins_by

    def _wait(self) -> float:
        self._waits += 1
        return min(_LONGEST_PAUSE_S, 0.0005 * max(0, self._waits - _EAGER))

    def _take(self, moment: Chunk | Message, stage: PlaybackTarget) -> None:
        self._advance()
        at = moment.at + self._shift
        if isinstance(moment, Chunk):
            if stage.tap is not None:
                stage.tap(moment.direction, moment.data, at)
            if moment.direction is Direction.RECEIVED:
                for frame in stage.decode(moment.data, at):
                    self._frames.append((frame, at))
        elif moment.topic == EVENT:
            stage.tell(moment.content())

    def _end(self) -> None:
        broken = self._broken
        self._set_clock(self.begin.at + self._to if not broken else self._then())
        self.is_at_end = True
        if self._holds or self._stage is None:
            return
        stage, self._stage = self._stage, None
        cause = broken or "it was played to where its end was asked for"
        if not broken and self._to >= self.begin.duration_s:
            cause = "everything was played"
            if self.begin.damage or not self.begin.damage.is_ended:
                cause = f"the file is not whole: {self.begin.damage}"
        stage.end(
            ReplayEnded(
                f"the recording {self.flight.path.name} has ended, after {self.position_s:.1f} s",
                cause=cause,
                remedy=ReplayEnded.usual_remedy,
            )
        )


def check_speed(speed: float) -> None:
    """Whether there is such a speed.

    Raises ``UsageError``: there is not.
    """
    if not (SLOWEST <= speed <= FASTEST or speed == math.inf):
        raise UsageError(
            f"a recording is not played at a speed of {speed:g}",
            remedy=f"{SLOWEST:g} to {FASTEST:g} times as fast as it was flown, or max",
        )


def only_recorded(what: str) -> OnlyRecorded:
    """The error for whatever is asked of the aircraft of a replay."""
    return OnlyRecorded.usual(f"{what}: this aircraft is a recording; nothing was sent")


# -- the line of a replay: it gives what came, and takes nothing -----------------------------------


class ReplayedLink(Link):
    """A line whose other end is a recording."""

    is_recorded = True

    def __init__(self, player: Player) -> None:
        super().__init__(first_sequence=0)
        self.player = player  # what plays it: how far it is, and how fast
        self.name = f"replay of {player.flight.path.name}"
        self._connected.set_result(None)

    @property
    def clock(self) -> Callable[[], float]:
        """That of the recorded flight."""
        return self.player.time

    @property
    def is_open(self) -> bool:
        """Whether there is more to come."""
        return self._failure is None

    async def request(
        self,
        data: bytes,
        *,
        name: str = "request",
        mode: SessionMode = SessionMode.RELIABLE,
        encrypted: bool = False,
        timeout: float = 0.5,
        tries: int = 3,
    ) -> bytes:
        """Refused.

        Raises ``OnlyRecorded``: always. Raises ``ReplayEnded, LinkClosed``: it is over.
        """
        raise self._refusal(name)

    def push(self, data: bytes, *, encrypted: bool = False) -> bool:
        """Refused, as :meth:`request`."""
        raise self._refusal("a push")

    def _refusal(self, what: str) -> Exception:
        self.require_loop()
        return only_recorded(what) if self._failure is None else self._failure.again()

    def acknowledge(self, command: Frame, payload: bytes, *, encrypted: bool | None = None) -> None:
        """Nobody is there to be answered."""

    def decode(self, data: bytes, now: float) -> Sequence[Frame]:
        """The frames of a read, for :meth:`deliver`."""
        self.last_received_at = now
        events = self._endpoint.receive_data(data, now)
        return [event for event in events if type(event) is Frame]

    def deliver(self, frame: Frame, now: float) -> None:
        """Hand a frame on."""
        self.on_received(frame, now)

    def end(self, error: ReplayEnded) -> None:
        """There is no more."""
        if self._failure is None:
            self._failure = error
            self._disconnected.set()
            self._tell_of_failure()

    async def close(self) -> None:
        """Play no more."""
        self.require_loop()
        self.player.stop()
        if self._failure is None:
            self._failure = LinkClosed("the replay was closed by this side")
        self._disconnected.set()
        self._tell_of_failure()
