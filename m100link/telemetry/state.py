"""The newest value of every telemetry item, its age, and how it arrives."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

from m100link.protocol.items import BY_RECORD, ITEMS, RecordViews
from m100link.telemetry.sample import Sample

__all__ = ["AircraftState", "ItemStatistics"]

R = TypeVar("R", bound=tuple[Any, ...])

_WINDOW_S = 2.5  # long enough for the rate of an item at 1 Hz


@dataclass(frozen=True, slots=True)
class ItemStatistics:
    """How an item arrives.

    Attributes:
        name: Item name.
        count: Arrivals in all.
        rate_hz: Arrivals per second lately; None before the second one.
        jitter_s: Mean deviation of the intervals from their mean lately, s; None before the third
            arrival.
        longest_gap_s: Longest interval so far, s; 0 before the second arrival.
    """

    name: str
    count: int
    rate_hz: float | None
    jitter_s: float | None
    longest_gap_s: float


class AircraftState(RecordViews):
    """The newest value of every telemetry item.

    An item that never arrived is None, never zero. Every value knows its age.

    Attributes:
        newest_at: When any telemetry arrived last, on the event loop's clock; None: never.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._samples: list[Sample | None] = [None] * len(ITEMS)
        self._longest_gaps = [0.0] * len(ITEMS)
        self._counts: dict[int, int] = {}  # packages per flag word; few flag words ever occur
        self._recent: deque[tuple[float, int]] = deque(maxlen=512)
        self.newest_at: float | None = None

    def update(self, sample: Sample) -> None:
        """Take over what the sample carries."""
        now, flags = sample.received_at, sample.flags
        self.newest_at = now
        self._counts[flags] = self._counts.get(flags, 0) + 1
        self._recent.append((now, flags))
        samples, longest_gaps = self._samples, self._longest_gaps
        for index in sample.indices:
            before = samples[index]
            if before is not None and now - before.received_at > longest_gaps[index]:
                longest_gaps[index] = now - before.received_at
            samples[index] = sample

    def get(self, record: type[R]) -> R | None:
        """The newest record of that class, None when it never arrived."""
        sample = self._samples[BY_RECORD[record].bit]
        return None if sample is None else sample.get(record)

    def received_at(self, record: type[Any]) -> float | None:
        """When the newest record arrived, on the event loop's clock."""
        sample = self._samples[BY_RECORD[record].bit]
        return None if sample is None else sample.received_at

    def age(self, record: type[Any]) -> float | None:
        """Seconds since the newest record arrived, None when it never did."""
        received_at = self.received_at(record)
        return None if received_at is None else self._clock() - received_at

    @property
    def newest_age(self) -> float | None:
        """Seconds since any telemetry arrived, None when none ever did."""
        return None if self.newest_at is None else self._clock() - self.newest_at

    def fresh(self, record: type[R], *, within: float) -> R | None:
        """The newest record if it is at most ``within`` seconds old, else None."""
        sample = self._samples[BY_RECORD[record].bit]
        if sample is None or self._clock() - sample.received_at > within:
            return None
        return self.get(record)

    def statistics(self, record: type[Any]) -> ItemStatistics:
        """Measured rate, jitter and longest gap of an item."""
        item = BY_RECORD[record]
        arrivals = [at for at, flags in self._recent if flags >> item.bit & 1]
        if arrivals:
            oldest = arrivals[-1] - _WINDOW_S
            arrivals = [at for at in arrivals if at >= oldest]
        gaps = [later - earlier for earlier, later in pairwise(arrivals)]
        mean = sum(gaps) / len(gaps) if gaps else 0.0
        return ItemStatistics(
            name=item.name,
            count=sum(count for flags, count in self._counts.items() if flags >> item.bit & 1),
            rate_hz=1 / mean if mean > 0 else None,
            jitter_s=sum(abs(gap - mean) for gap in gaps) / len(gaps) if len(gaps) > 1 else None,
            longest_gap_s=self._longest_gaps[item.bit],
        )

    def situation(self) -> dict[str, object]:
        """What explains a refusal, for errors: status, battery, GPS health, mode switch, holder."""
        phase = self.flight_status and (self.flight_status.phase or self.flight_status.status)
        device = self.control_device and self.control_device.device
        rc = self.remote_control
        return {
            "flight_status": getattr(phase, "name", phase),
            "height_m": self.position and round(self.position.height_m, 2),
            "battery_percent": self.battery and self.battery.percent,
            "gps_health": self.position and self.position.gps_health,
            "mode_switch": rc.mode_switch.name if rc else None,
            "control_device": getattr(device, "name", device),
        }
