"""The telemetry of one aircraft: read once, kept as the newest state, handed to every consumer."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any

from m100link.errors import LayoutMismatch, LinkError, TelemetryStalled, UsageError
from m100link.protocol.firmware import FIRMWARE_1_0, FirmwareProfile
from m100link.protocol.items import item_of
from m100link.protocol.packet import field_span, remember
from m100link.protocol.records import Time
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState
from m100link.telemetry.subscription import ANY, Hub, Latest, Policy, Subscription

_logger = logging.getLogger(__name__)

_PACKAGE = 1 << 16  # what a package with no item is, for those who want every package


_Place = tuple[int, Callable[[bytes, int], tuple[int]]]
_UNSIGNED = {
    size: Struct(code).unpack_from for size, code in ((1, "<B"), (2, "<H"), (4, "<I"), (8, "<Q"))
}


def _tick_place(flags: int, firmware: FirmwareProfile) -> _Place | None:
    """Where packages with these flags have their tick, and how it is read; None: they have none."""
    span = field_span(Time, "tick", flags, firmware) or slice(0, 0)
    unpack = _UNSIGNED.get(span.stop - span.start)
    return None if unpack is None else (span.start, unpack)


class TelemetryStream:
    """Takes packages as they arrive."""

    __slots__ = (
        *("_clock", "_firmware", "_hub", "_observe", "_ticks"),
        *("mismatches", "state", "utc_offset_s"),
    )

    def __init__(self, observe: Callable[[Sample], None], clock: Callable[[], float]) -> None:
        # Called with each package when state and clock know it, before the consumers.
        self._observe = observe
        self.state = AircraftState(clock)  # newest value and age of every item
        self.mismatches = 0  # packages refused because they do not fit the firmware profile
        # Once: a wall clock that is set during a flight must not bend its columns.
        self.utc_offset_s = time.time() - clock()  # see :attr:`m100link.Aircraft.utc_offset_s`
        self._hub: Hub[Sample] = Hub()
        # What packages have been read as, or the clock was asked for, last.
        self._firmware = FIRMWARE_1_0
        self._clock = DeviceClock(FIRMWARE_1_0.tick_hz)  # by which packages arrive, s
        self._ticks: dict[int, _Place | None] = {}  # where such packages have their tick, by flags

    def clock_of(self, firmware: FirmwareProfile) -> DeviceClock:
        """The clock of the aircraft; a firmware with another tick rate begins a new one."""
        if firmware is not self._firmware:
            self._firmware = firmware
            self._ticks.clear()
            if firmware.tick_hz != self._clock.tick_hz:
                self._clock = DeviceClock(firmware.tick_hz)
        return self._clock

    def receive(self, value: bytes, firmware: FirmwareProfile, now: float) -> None:
        """A package arrived now: everybody inside learns what it says, then every consumer.

        One that does not fit the firmware is counted, and the first of them logged.
        """
        try:
            sample = Sample(value, firmware, now)
        except LayoutMismatch as error:
            self.mismatches += 1
            if self.mismatches == 1:
                _logger.warning("telemetry refused: %s", error)
            return
        flags = sample.flags
        self.state.update(sample)
        clock = self._clock if firmware is self._firmware else self.clock_of(firmware)
        try:
            place = self._ticks[flags]
        except KeyError:
            place = remember(self._ticks, flags, _tick_place(flags, firmware))
        if place is not None:
            # Of its record, which costs ten times as much, the clock wants nothing else.
            at, unpack = place
            clock.update(unpack(value, at)[0], now)
        self._observe(sample)
        self._hub.publish(sample, now, flags or _PACKAGE)

    @property
    def has_consumers(self) -> bool:
        """Whether somebody takes packages."""
        return self._hub.has_consumers

    @property
    def room(self) -> float:
        """How many packages no consumer would lose an older one by; infinite without any."""
        return self._hub.room

    def fail(self, error: LinkError) -> None:
        """End every subscription with the error."""
        self._hub.fail(error)

    def subscribe(
        self, records: Sequence[type[Any]], policy: Policy, rate_hz: float | None
    ) -> Subscription[Sample]:
        """See :meth:`m100link.Aircraft.telemetry`."""
        wanted = 0
        for record in records:
            wanted |= 1 << item_of(record).bit
        if rate_hz is not None and not rate_hz > 0:
            raise UsageError(f"a rate of {rate_hz} Hz is not a rate")
        return self._hub.subscribe(
            policy,
            min_interval=1.0 / rate_hz if rate_hz else 0.0,
            wanted=wanted or ANY,
        )

    async def wait_for(
        self, predicate: Callable[[AircraftState], bool], timeout: float | None, what: str
    ) -> None:
        """See :meth:`m100link.Aircraft.wait_for`."""
        if predicate(self.state):
            return
        try:
            async with asyncio.timeout(timeout), self.subscribe((), Latest(), None) as samples:
                async for _ in samples:
                    if predicate(self.state):
                        return
        except TimeoutError as error:
            if isinstance(error, LinkError):
                raise
            raise TelemetryStalled(
                f"{what} was not seen within {timeout:g} s; now: {self.state.situation()}",
                cause="it did not happen, or the items that show it are not sent",
                remedy="see which items arrive: m100link hz",
            ) from None
