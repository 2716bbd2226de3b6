"""A line that loses, damages, delays and repeats, between the aircraft and its peer.

No I/O and no clock: bytes go in with the present time, bytes come out when they are due. Every
random choice comes from the one :class:`random.Random` that is passed in, so a seed repeats a bad
day exactly.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from operator import itemgetter
from random import Random
from struct import Struct
from typing import Any

from m100link.link.serial_transport import read_inverted
from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.items import ITEMS
from m100link.protocol.packet import remember
from m100link.sim.vehicle.dynamics import STEPS_PER_SECOND
from m100link.sim.vehicle.sensors import Sensors
from m100link.wire.crc import SEQUENCE_CRC16, frame_crc32, header_crc16
from m100link.wire.frame import HEADER_SIZE, SOF

# -- the telemetry push: which items are due, what they say, and a quick road to the bytes ---------
# Each item has its own rate; packets go out at the highest rate among them and carry only what is
# due (document 2.2.3.1), so the flag word changes from packet to packet. This is the one place of
# the virtual aircraft where microseconds count: a hundred aircraft send ten thousand packets a
# second. One frame is therefore packed in one go, by a plan that is made once per flag word; that
# it equals the ordinary encoder's frame is a test.


_CRC32 = Struct("<I")
_ADDRESS = bytes(PushTelemetry.ADDRESS)


class _Plan:
    """How to build the packet of one flag word."""

    __slots__ = ("crc16", "flags", "pack", "pick", "readers", "word")

    def __init__(self, flags: int, profile: FirmwareProfile, sensors: Sensors) -> None:
        self.flags = flags
        items = [item for item in ITEMS if flags >> item.bit & 1]
        layouts = [profile.items[item.name] for item in items]
        self.readers = [sensors.reader(item.name) for item in items]
        # A layout leaves fields out (1.0 has no status byte) or reorders them (1.0-document).
        places, start = [], 0
        for item, layout in zip(items, layouts, strict=True):
            places += [start + item.fields.index(field) for field in layout.fields]
            start += len(item.fields)
        self.pick = _picker(places, start)
        body = Struct("<QHH2sH" + "".join(layout.format for layout in layouts))
        self.pack = body.pack
        length = body.size + _CRC32.size
        self.word = SOF | length << 8  # session 0, plain, no ack: the rest is zero
        self.crc16 = header_crc16(self.word.to_bytes(10, "little"))


def _picker(places: list[int], count: int) -> Callable[[Sequence[float]], Sequence[float]] | None:
    """Takes the values at these places out of so many; None where that is all of them, in order."""
    if places == list(range(count)):
        return None
    if len(places) == 1:  # itemgetter would return it bare
        return itemgetter(slice(places[0], places[0] + 1))
    return itemgetter(*places)


class TelemetryPusher:
    """Makes the telemetry frame of each tick."""

    def __init__(
        self, profile: FirmwareProfile, sensors: Sensors, rates_hz: dict[str, int]
    ) -> None:
        self._profile = profile
        self._sensors = sensors
        # Per flag word. That of every item is made at once: an item without a reader fails here.
        every = profile.item_flags
        self._plans = {every: _Plan(every, profile, sensors)}
        self._schedule: list[_Plan | None] = []
        self.rates_hz: dict[str, int] = {}  # rate per item name in force
        self.packets = 0  # packets made since power-on
        self.set_rates(rates_hz)

    def set_rates(self, rates_hz: dict[str, int]) -> None:
        """Change rates; items that are not named keep theirs."""
        self.rates_hz = self.rates_hz | rates_hz
        self._schedule = [self._plan_of(tick) for tick in range(STEPS_PER_SECOND)]

    def _plan_of(self, tick: int) -> _Plan | None:
        flags = 0
        for item in ITEMS:
            rate = self.rates_hz.get(item.name, 0)
            if rate and tick % (STEPS_PER_SECOND // rate) == 0:
                flags |= 1 << item.bit
        flags &= self._profile.item_flags
        if not flags:
            return None
        plan = self._plans.get(flags)
        if plan is None:
            plan = remember(self._plans, flags, _Plan(flags, self._profile, self._sensors))
        return plan

    def frame(self, sequence: int) -> bytes | None:
        """The frame of this tick with that sequence number, None when no item is due."""
        plan = self._schedule[self._sensors.ticks % STEPS_PER_SECOND]
        if plan is None:
            return None
        values: list[float] = []
        for read in plan.readers:
            values += read()
        sent = values if plan.pick is None else plan.pick(values)
        crc16 = plan.crc16 ^ SEQUENCE_CRC16[sequence]
        body = plan.pack(plan.word, sequence, crc16, _ADDRESS, plan.flags, *sent)
        self.packets += 1
        return body + _CRC32.pack(frame_crc32(body))


def is_telemetry(frame: bytes) -> bool:
    """Whether the bytes of a whole frame are a plain telemetry push."""
    return frame[HEADER_SIZE : HEADER_SIZE + 2] == _ADDRESS and not frame[3] & 0x3F


# -- line ------------------------------------------------------------------------------------------

_BITS_PER_BYTE = 10  # 8N1
_BUFFER_S = 0.5  # of bytes that a slow sender keeps; beyond it frames are dropped
_TELEMETRY_WAITS_S = 0.02  # telemetry that would wait longer is not sent at all
_RADIO_TURNAROUND_S = 0.002
_RADIO_BAUD_RATE = 230_400


def _probability() -> Any:
    return field(default=0.0, metadata={"most": 1.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFaults:
    """The faults of a line. Probabilities are per frame.

    A field added here is an option of ``m100link sim`` and a word of its ``faults`` order, and its
    range is checked; ``LineDirection`` gives it its effect.

    Attributes:
        loss: Probability that a frame does not arrive, 0 to 1.
        damage: Probability that one to four bits of a frame are flipped.
        duplicate: Probability that a frame arrives twice.
        delay: Delay of all bytes, seconds.
        jitter: Greatest random delay of a frame on top of that, seconds; the order stays.
        noise: Bursts of random bytes per second.
        noise_bytes: Length of the longest burst.
        baud_rate: Bits per second of a slow device on the line (8N1). It drops bytes that it
            cannot send within half a second.
        radio: The half-duplex 433 MHz modules of the document's quick start: while one side
            transmits, the other cannot, and half of what starts in that time is lost.
        mute: The wire from the aircraft carries nothing.
        deaf: The wire to the aircraft carries nothing.
        inverted: The levels of both wires are inverted, as those of RS-232 are.
    """

    loss: float = _probability()
    damage: float = _probability()
    duplicate: float = _probability()
    delay: float = 0.0
    jitter: float = 0.0
    noise: float = 0.0
    noise_bytes: int = 32
    baud_rate: int | None = None
    radio: bool = False
    mute: bool = False
    deaf: bool = False
    inverted: bool = False

    def __post_init__(self) -> None:
        for one in fields(self):
            value, most = getattr(self, one.name), one.metadata.get("most")
            if value is None or (0.0 <= value < math.inf and (most is None or value <= most)):
                continue
            span = "finite and not negative" if most is None else f"0 to {most:g}"
            raise ValueError(f"{one.name} is {span}, not {value}")
        if self.noise_bytes < 1:
            raise ValueError("a burst of noise has at least one byte")
        if self.baud_rate is not None and self.baud_rate <= 0:
            raise ValueError(f"a line of {self.baud_rate} baud carries nothing")

    @property
    def is_clean(self) -> bool:
        """Whether bytes pass untouched and at once."""
        return self == NO_FAULTS


NO_FAULTS = LineFaults()


def split_frames(data: bytes) -> list[bytes]:
    """Cut a chunk of bytes where frames begin, so that faults strike frames and not reads.

    Checksums are not looked at: what does not look like whole frames stays one piece.
    """
    pieces = []
    start = 0
    while len(data) - start >= HEADER_SIZE and data[start] == SOF:
        length = data[start + 1] | (data[start + 2] & 0x03) << 8
        if length < HEADER_SIZE:
            break
        pieces.append(data[start : start + length])
        start += length
    if start < len(data):
        pieces.append(data[start:])
    return pieces


class LineDirection:
    """One direction of a line.

    ``frames``: pieces sent into it. ``lost``: pieces that do not arrive. ``damaged``: pieces that
    arrive with flipped bits. ``duplicated``: pieces that arrive twice.
    """

    def __init__(
        self, random: Random, faults: LineFaults = NO_FAULTS, *, baud_rate: int | None = None
    ) -> None:
        self._random = random
        # When each piece arrives, in order.
        self._waiting: deque[tuple[float, bytes]] = deque()
        # Jitter never lets a piece overtake the one before.
        self._last_arrival = -math.inf
        # When the next burst comes; None while there is no noise.
        self._next_noise: float | None = None
        self.busy_until = -math.inf  # when the last bit sent so far has left
        self.faults = faults  # may be replaced at any time
        # Of the port (8N1): a frame arrives when its last bit could. None takes no time.
        self.baud_rate = baud_rate
        self.is_stalled = False  # nothing passes; bytes wait, up to half a second's worth
        self.is_cut = False  # nothing passes, and nothing waits
        self.frames = self.lost = self.damaged = self.duplicated = 0

    @property
    def is_clean(self) -> bool:
        """Whether bytes pass untouched and at once, with none waiting."""
        return (
            self.faults is NO_FAULTS
            and self.baud_rate is None
            and not self.is_stalled
            and not self._waiting
        )

    def put(self, piece: bytes, now: float, other: LineDirection | None = None) -> None:
        """Send a frame, or any piece of bytes, into the line."""
        faults, random = self.faults, self._random
        self.frames += 1
        if self.is_cut or (faults.loss and random.random() < faults.loss):
            self.lost += 1
            return
        if faults.damage and random.random() < faults.damage:
            piece = self._damage(piece)
        if faults.inverted:
            piece = read_inverted(piece)
        copies = 1
        if faults.duplicate and random.random() < faults.duplicate:
            copies = 2
            self.duplicated += 1
        for _ in range(copies):
            sent = self._transmit(piece, now, other)
            if sent is None:
                self.lost += 1
                continue
            arrival = sent + faults.delay
            if faults.jitter:
                arrival += faults.jitter * random.random()
            # A serial line has no overtaking.
            self._last_arrival = arrival = max(arrival, self._last_arrival)
            self._waiting.append((arrival, piece))

    def _transmit(self, piece: bytes, now: float, other: LineDirection | None) -> float | None:
        """When the last byte has left, or None when it never does."""
        faults = self.faults
        start = max(now, self.busy_until)
        if faults.radio and other is not None and other.busy_until > now:
            if self._random.random() < 0.5:
                return None
            start = max(start, other.busy_until + _RADIO_TURNAROUND_S)
        if start - now > _BUFFER_S or (self.is_stalled and len(self._waiting) > 50):
            return None
        baud_rate = self._slowest()
        if baud_rate is None:
            return now
        self.busy_until = start + len(piece) * _BITS_PER_BYTE / baud_rate
        return self.busy_until

    def _slowest(self) -> int | None:
        faults = self.faults
        radio = _RADIO_BAUD_RATE if faults.radio else None
        rates = (faults.baud_rate, self.baud_rate, radio)
        return min((rate for rate in rates if rate is not None), default=None)

    def _damage(self, piece: bytes) -> bytes:
        damaged = bytearray(piece)
        for _ in range(self._random.randint(1, 4)):
            bit = self._random.randrange(8 * len(damaged))
            damaged[bit // 8] ^= 1 << bit % 8
        self.damaged += 1
        return bytes(damaged)

    def take(self, now: float) -> list[bytes]:
        """The frames that have arrived by now, in order."""
        if self.is_stalled:
            return []
        self._make_noise(now)
        waiting = self._waiting
        if not waiting or waiting[0][0] > now + 1e-9:
            return []
        arrived = []
        while waiting and waiting[0][0] <= now + 1e-9:
            arrived.append(waiting.popleft()[1])
        return arrived

    def _make_noise(self, now: float) -> None:
        rate = self.faults.noise
        if not rate:
            self._next_noise = None
            return
        if self._next_noise is None:
            self._next_noise = now + self._random.expovariate(rate)
        while self._next_noise <= now:
            burst = self._random.randbytes(self._random.randint(1, self.faults.noise_bytes))
            entries = [*self._waiting, (self._next_noise, burst)]
            self._waiting = deque(sorted(entries, key=lambda entry: entry[0]))
            self._next_noise += self._random.expovariate(rate)

    def next_wakeup(self) -> float | None:
        """When something will have arrived."""
        noise = self._next_noise if self.faults.noise else None
        if self.is_stalled or not self._waiting:
            return None if self.is_stalled else noise
        arrival = self._waiting[0][0]
        return arrival if noise is None else min(arrival, noise)

    def clear(self) -> None:
        """Forget frames that are under way, as when the plug is pulled."""
        self.lost += len(self._waiting)
        self._waiting.clear()
        self.busy_until = self._last_arrival = -math.inf


class Line:
    """Both directions of the line between the aircraft and the onboard device."""

    def __init__(
        self,
        random: Random,
        faults: LineFaults = NO_FAULTS,
        *,
        to_aircraft: LineFaults | None = None,
        baud_rate: int | None = None,
    ) -> None:
        self.to_host = LineDirection(random, baud_rate=baud_rate)
        self.to_aircraft = LineDirection(random, baud_rate=baud_rate)
        self.set_faults(faults, to_aircraft=to_aircraft)
        self.is_plugged = True  # unplugged, everything is lost both ways
        self.skipped = 0  # packets of telemetry that were not sent: it was busy

    def set_faults(
        self, faults: LineFaults = NO_FAULTS, *, to_aircraft: LineFaults | None = None
    ) -> None:
        """Replace the faults of the line, in both directions or each its own."""
        self.to_host.faults = NO_FAULTS if faults.is_clean else faults
        back = faults if to_aircraft is None else to_aircraft
        self.to_aircraft.faults = NO_FAULTS if back.is_clean else back
        self.to_host.is_cut, self.to_aircraft.is_cut = faults.mute, back.deaf

    def stall(self, *, to_host: bool = True, to_aircraft: bool = True) -> None:
        """Stop the line, or let it go on (both False)."""
        self.to_host.is_stalled = to_host
        self.to_aircraft.is_stalled = to_aircraft

    def unplug(self) -> None:
        """Pull the plug; frames that are under way are lost."""
        self.is_plugged = False
        self.to_host.clear()
        self.to_aircraft.clear()

    def replug(self) -> None:
        """Plug it in again."""
        self.is_plugged = True

    def from_aircraft(self, frames: list[bytes], now: float) -> list[bytes]:
        """Send frames of the aircraft; returns what arrives at the host by now.

        Answers do not queue behind old telemetry: a packet that would have to wait is skipped, as
        by a sender who looks whether its port is free.
        """
        line = self.to_host
        if self.is_plugged and line.is_clean:
            line.frames += len(frames)
            return frames
        if not self.is_plugged:
            return self._lose(line, frames)
        for frame in frames:
            if line.busy_until > now + _TELEMETRY_WAITS_S and is_telemetry(frame):
                self.skipped += 1
            else:
                line.put(frame, now, self.to_aircraft)
        return line.take(now)

    def from_host(self, data: bytes, now: float) -> list[bytes]:
        """Send bytes of the host; returns what arrives at the aircraft by now."""
        line = self.to_aircraft
        if self.is_plugged and line.is_clean:
            line.frames += bool(data)
            return [data] if data else []
        pieces = split_frames(data)
        if not self.is_plugged:
            return self._lose(line, pieces)
        for piece in pieces:
            line.put(piece, now, self.to_host)
        return line.take(now)

    def _lose(self, direction: LineDirection, pieces: list[bytes]) -> list[bytes]:
        """Nobody is at the other end."""
        direction.frames += len(pieces)
        direction.lost += len(pieces)
        return []

    def next_wakeup(self) -> float | None:
        """When something will have arrived at either end."""
        if not self.is_plugged:
            return None
        first, second = self.to_host.next_wakeup(), self.to_aircraft.next_wakeup()
        if first is None or second is None:
            return second if first is None else first
        return min(first, second)
