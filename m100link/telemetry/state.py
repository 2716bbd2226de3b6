"""The newest value of every telemetry item, its age, and how it arrives."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, TypeVar

from m100link.protocol.items import BY_RECORD, ITEMS, RecordViews
from m100link.protocol.packet import remember
from m100link.protocol.records import (
    Attitude,
    Battery,
    FlightPhase,
    FlightStatus,
    Position,
    Time,
    Velocity,
)
from m100link.telemetry.integrity import Integrity, IntegrityMonitor
from m100link.telemetry.sample import Sample

__all__ = ["AircraftState", "ItemStatistics"]

R = TypeVar("R", bound=tuple[Any, ...])

_WINDOW_S = 2.5  # long enough for the rate of an item at 1 Hz
_ARRIVALS = 512  # twice what an item at 100 Hz has in that time
_TRIMMED = 16  # after so many: of a thousand aircraft at 5 Hz, all of them would be 50 MB


# -- how long a value is believed: one table for the guards, and for every front -------------------

_ONE_PERIOD_S = 1.2
"""An item that is sent once a second, the slowest rate of the PC assistant, is known all the time.
Values that move with the aircraft may not be older: at 10 m/s it is 12 m elsewhere by then."""

FRESH_S: Mapping[type[Any], float] = MappingProxyType(
    dict.fromkeys(BY_RECORD, _ONE_PERIOD_S)
    | {
        # One package of an item at 1 Hz may be lost, and not two: it changes a few times in a
        # flight, and where it is unknown the watchdog of setpoints does not judge.
        FlightStatus: 2.5,
        # The charge falls by a percent in ten seconds at the most, and may miss four packages.
        Battery: 5.0,
    }
)
"""Seconds after which the newest value of an item is known to nobody, by its record."""

STEER_S = 0.5
"""The same for what a closed loop steers by: at 5 m/s it would aim 2.5 m beside the place."""


def is_finite(record: tuple[Any, ...]) -> bool:
    """Whether there is none of NaN and infinity in it: those are no values, however new."""
    # Nothing and zero are left out, and no call for each number: fronts ask in each of their steps.
    return all(map(math.isfinite, filter(None, record)))


def is_possible(record: tuple[Any, ...]) -> bool:
    """Whether a record can be true: finite numbers, an attitude that is one, a place, a charge."""
    if isinstance(record, (Position, Battery)):
        return record.is_possible
    if isinstance(record, Attitude):
        return 0.5 < sum([part * part for part in record]) < 2.0  # a unit quaternion, roughly
    return is_finite(record)


# -- when a status of standing is believed: one rule for the flight and for every front ------------
# One wrong status in the air must not end a landing, nor let anybody put a hand to the propellers.

_STANDS_SAMPLES = 3  # so many in a row
_STANDS_S = 0.5  # over so many seconds
_STANDS_UP_M_S = 0.5  # a faster climb or descent contradicts it
_STANDS_M_S = 2.0  # a faster velocity over ground too; a person who carries it is slower
_STANDS_M = 0.3  # by which the height may change in that time


def _shown(field: tuple[str, object]) -> str:
    name, value = field
    return f"{name} {value:z.6g}" if isinstance(value, float) else f"{name} {value}"


@dataclass(frozen=True, slots=True)
class ItemStatistics:
    """How an item arrives."""

    name: str  #: Item name.
    count: int  #: Arrivals in all.
    rate_hz: float | None  #: Arrivals per second lately; None before the second one.
    #: Mean deviation of the intervals from their mean lately, s; None before the third arrival.
    jitter_s: float | None
    longest_gap_s: float  #: Longest interval so far, s; 0 before the second arrival.


class _Cell:
    """The newest sample and the arrivals of items that have always come together."""

    __slots__ = ("arrivals", "count", "items", "longest_gap_s", "received_at", "sample")

    def __init__(self, items: int) -> None:
        self.items = items  # the bits of these items
        self.sample: Sample | None = None  # the newest package with them
        # When it arrived; infinite before the first, so that no gap ends with it.
        self.received_at = math.inf
        self.longest_gap_s = 0.0
        self.count = 0
        # When the newest of them arrived, oldest first.
        self.arrivals: deque[float] = deque(maxlen=_ARRIVALS)

    def trim(self) -> None:
        """Forget the arrivals of which no rate is made any more."""
        while self.received_at - self.arrivals[0] > _WINDOW_S:
            self.arrivals.popleft()

    def split(self, items: int) -> _Cell:
        """Leave these items to a cell of their own; so far they came together with the others."""
        other = _Cell(items)
        self.items &= ~items
        other.sample, other.received_at = self.sample, self.received_at
        other.longest_gap_s, other.count = self.longest_gap_s, self.count
        other.arrivals.extend(self.arrivals)
        return other


class AircraftState(RecordViews):
    """The newest value of every telemetry item.

    An item that never arrived is None, never zero. Every value knows its age.

    Items that always come together share a cell, and a package is entered once for each cell and
    not once for each item. The first package with only some of the items of a cell splits it.

    Attributes:
        newest_at: When any telemetry arrived last, on the event loop's clock; None: never.
        believed_status: The newest flight status, except one of standing on the ground: that counts
            after three in a row over half a second, while velocity and height do not contradict.
            Until then this is the one before; None where there is none, and nobody knows.
    """

    __slots__ = (
        *("__dict__", "__weakref__", "_cells", "_cells_of", "_clock", "_first", "_monitor"),
        *("_standing", "believed_status", "newest_at"),
    )

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.forget()

    def forget(self) -> None:
        """Begin anew, as if nothing had ever arrived."""
        whole = _Cell(sum(1 << item.bit for item in ITEMS))
        self._cells: dict[type[Any], _Cell] = dict.fromkeys(BY_RECORD, whole)
        self._cells_of: dict[int, tuple[_Cell, ...]] = {}  # by flag word; few ever occur
        self.newest_at: float | None = None
        self._first: Sample | None = None  # that has a time
        self._monitor: IntegrityMonitor | None = None  # few ever ask
        self.believed_status: FlightStatus | None = None
        # Of the statuses of standing in a row: how many, when the first and the newest arrived, and
        # the height at the first.
        self._standing: tuple[int, float, float, float | None] | None = None

    def __repr__(self) -> str:
        known = {name: value for name, value in self.situation().items() if value is not None}
        age = "no telemetry" if self.newest_age is None else f"{self.newest_age:.2f} s old"
        return f"<AircraftState {age}{''.join(f', {name} {known[name]}' for name in known)}>"

    def _repr_html_(self) -> str:
        """The table for a notebook: every item with its value, age and rate."""
        from html import escape  # which few programs need, and brings a table of all entities

        rows = []
        for record, item in BY_RECORD.items():
            value, age, rate = self.get(record), self.age(record), self.statistics(record).rate_hz
            shown = "" if value is None else escape(", ".join(map(_shown, value._asdict().items())))
            cells = (item.name, shown, "never" if age is None else f"{age:.2f} s")
            known_rate = "" if rate is None else f"{rate:.1f}"
            rows.append("".join(f"<td>{cell}</td>" for cell in (*cells, known_rate)))
        head = "".join(f"<th>{title}</th>" for title in ("item", "value", "age", "Hz"))
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"

    def update(self, sample: Sample) -> None:
        """Take over what the sample carries."""
        now, plan = sample.received_at, sample._plan
        self.newest_at = now
        cells = self._cells_of.get(plan.flags)
        if cells is None:
            cells = self._split(sample)
        for cell in cells:
            if now - cell.received_at > cell.longest_gap_s:
                cell.longest_gap_s = now - cell.received_at
            cell.sample = sample
            cell.received_at = now
            cell.count += 1
            cell.arrivals.append(now)
            if not cell.count % _TRIMMED:
                cell.trim()
        take = plan.status
        if take is not None:
            known = self.believed_status
            # A status in flight that is believed already changes nothing.
            if known is None or self._standing or take(sample.value) != known.status:
                self._look_at_status(sample[FlightStatus], now)

    def _look_at_status(self, status: FlightStatus, now: float) -> None:
        if status.status != FlightPhase.STANDBY:
            self.believed_status, self._standing = status, None
            return
        count, since, newest, height_m = self._standing or (0, now, now, None)
        position = self.fresh(Position, now=now)
        here_m = None if position is None else position.height_m
        moved_m = 0.0 if here_m is None or height_m is None else abs(here_m - height_m)
        is_whole = 0.0 <= now - newest <= FRESH_S[FlightStatus]
        moves = self._moves(now)
        # A barometer is noisier than a velocity: it decides only where nothing else does.
        if (moved_m > _STANDS_M if moves is None else moves) or not is_whole:
            count, since, height_m = 0, now, None
            if self.believed_status == status:
                self.believed_status = None
        first_m = here_m if height_m is None else height_m
        if count + 1 >= _STANDS_SAMPLES and now - since >= _STANDS_S:
            self.believed_status, first_m = status, None  # a barometer drifts while it stands
        self._standing = count + 1, since, now, first_m

    def _moves(self, now: float) -> bool | None:
        """Whether the velocity is none of a stand; None where the aircraft vouches for none."""
        found = self.fresh(Velocity, within=STEER_S, now=now)
        if found is None or found.is_valid is False:
            return None
        return abs(found.up_m_s) > _STANDS_UP_M_S or found.ground_speed_m_s > _STANDS_M_S

    def _split(self, sample: Sample) -> tuple[_Cell, ...]:
        """The cells of packages with these flags, made so that each is of them whole or not at all.

        That happens at most as often as there are items, besides once for each flag word.
        """
        if self._first is None and sample.get(Time) is not None:
            self._first = sample
        flags = sample.flags
        for cell in set(self._cells.values()):
            apart = cell.items & ~flags
            if apart and cell.items & flags:
                other = cell.split(apart)
                self._cells.update((i.record, other) for i in ITEMS if apart >> i.bit & 1)
                self._cells_of.clear()
        cells = tuple({cell for cell in self._cells.values() if cell.items & flags})
        return remember(self._cells_of, flags, cells)

    def get(self, record: type[R]) -> R | None:
        """The newest record of that class, None when it never arrived."""
        sample = self._cells[record].sample
        return None if sample is None else sample.get(record)

    def sample(self, record: type[Any]) -> Sample | None:
        """The newest package with that record, None when it never arrived."""
        return self._cells[record].sample

    @property
    def integrity(self) -> Integrity:
        """Whether telemetry can be true: time advances, and the position agrees with velocity.

        It is judged when it is asked for, from what came since it was asked for last: ask at least
        once a second.
        """
        if self._monitor is None:
            self._monitor = IntegrityMonitor(self.sample, self._flown, self._first)
        return self._monitor.look(self.newest_at)

    def _flown(self) -> FlightStatus | None:
        return self.believed_status or self.flight_status

    def received_at(self, record: type[Any]) -> float | None:
        """When the newest record arrived, on the event loop's clock."""
        sample = self._cells[record].sample
        return None if sample is None else sample.received_at

    def age(self, record: type[Any]) -> float | None:
        """Seconds since the newest record arrived, None when it never did."""
        received_at = self.received_at(record)
        return None if received_at is None else self._clock() - received_at

    @property
    def newest_age(self) -> float | None:
        """Seconds since any telemetry arrived, None when none ever did."""
        return None if self.newest_at is None else self._clock() - self.newest_at

    def fresh(
        self, record: type[R], *, within: float | None = None, now: float | None = None
    ) -> R | None:
        """The newest record if it is at most ``within`` seconds old, else None.

        Args:
            record: Its class.
            within: Seconds; by default those of the item in the table of the library: 1.2 s, for
                :class:`FlightStatus` 2.5 s and for :class:`Battery` 5 s.
            now: Time on the event loop's clock, s; by default that clock is read.
        """
        sample = self._cells[record].sample
        if sample is None:
            return None
        age = (self._clock() if now is None else now) - sample.received_at
        limit = FRESH_S[record] if within is None else within
        # A sample without a time, or from the future, is as unknown as an old one.
        return sample.get(record) if -limit <= age <= limit else None

    def statistics(self, record: type[Any]) -> ItemStatistics:
        """Measured rate, jitter and longest gap of an item."""
        cell = self._cells[record]
        oldest = cell.received_at - _WINDOW_S
        arrivals = [at for at in cell.arrivals if at >= oldest]
        gaps = [later - earlier for earlier, later in pairwise(arrivals)]
        mean = sum(gaps) / len(gaps) if gaps else 0.0
        return ItemStatistics(
            name=BY_RECORD[record].name,
            count=cell.count,
            rate_hz=1 / mean if mean > 0 else None,
            jitter_s=sum(abs(gap - mean) for gap in gaps) / len(gaps) if len(gaps) > 1 else None,
            longest_gap_s=cell.longest_gap_s,
        )

    def situation(self) -> dict[str, object]:
        """Details of a refusal, for errors: status, battery, GPS health, mode switch, holder."""
        phase = self.flight_status and (self.flight_status.phase or self.flight_status.status)
        device = self.control_device and self.control_device.device
        rc = self.remote_control
        return {
            "flight_status": getattr(phase, "name", phase),
            "height_m": self.position and round(self.position.height_m, 2) + 0.0,  # no -0.0
            "battery_percent": self.battery and self.battery.percent,
            "gps_health": self.position and self.position.gps_health,
            "mode_switch": rc.mode_switch.name if rc and rc.is_heard else None,
            "control_device": getattr(device, "name", device),
        }
