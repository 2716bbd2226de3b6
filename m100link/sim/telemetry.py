"""The telemetry push: which items are due, what they say, and a quick road to the bytes.

Each item has its own rate; packets go out at the highest rate among them and carry only what is due
(document 2.2.3.1), so the flag word changes from packet to packet.

This is the one place of the virtual aircraft where microseconds count: a hundred aircraft send ten
thousand packets a second. One frame is therefore packed in one go, by a plan that is made once per
flag word; that it equals the ordinary encoder's frame is a test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from struct import Struct

from m100link.protocol.commands.monitor import PushTelemetry
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.items import ITEMS
from m100link.protocol.packet import remember
from m100link.sim.vehicle.dynamics import STEPS_PER_SECOND
from m100link.sim.vehicle.sensors import Sensors
from m100link.wire.crc import frame_crc32, header_crc16_of_word, sequence_crc16
from m100link.wire.frame import HEADER_SIZE, SOF

__all__ = ["TelemetryPusher", "is_telemetry"]

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
        self.crc16 = header_crc16_of_word(self.word.to_bytes(8, "little"))


def _picker(places: list[int], count: int) -> Callable[[Sequence[float]], Sequence[float]] | None:
    """Takes the values at these places out of so many; None where that is all of them, in order."""
    if places == list(range(count)):
        return None
    if len(places) == 1:  # itemgetter would return it bare
        return itemgetter(slice(places[0], places[0] + 1))
    return itemgetter(*places)


class TelemetryPusher:
    """Makes the telemetry frame of each tick.

    Attributes:
        rates_hz: Rate per item name in force.
        packets: Packets made since power-on.
    """

    def __init__(
        self, profile: FirmwareProfile, sensors: Sensors, rates_hz: dict[str, int]
    ) -> None:
        self._profile = profile
        self._sensors = sensors
        # Per flag word. That of every item is made at once: an item without a reader fails here.
        every = profile.item_flags
        self._plans = {every: _Plan(every, profile, sensors)}
        self._schedule: list[_Plan | None] = []
        self.rates_hz: dict[str, int] = {}
        self.packets = 0
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
        crc16 = plan.crc16 ^ sequence_crc16(sequence)
        body = plan.pack(plan.word, sequence, crc16, _ADDRESS, plan.flags, *sent)
        self.packets += 1
        return body + _CRC32.pack(frame_crc32(body))


def is_telemetry(frame: bytes) -> bool:
    """Whether the bytes of a whole frame are a plain telemetry push."""
    return frame[HEADER_SIZE : HEADER_SIZE + 2] == _ADDRESS and not frame[3] & 0x3F
