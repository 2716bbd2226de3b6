"""Values over time in few points, however long the flight: its peaks stay, and so do its holes."""

from __future__ import annotations

import math
from collections.abc import Iterator

__all__ = ["Curve", "Track"]

_MOST_BUCKETS = 800
_MOST_PLACES = 3000
_LEAST_STEP_M = 0.1  # what moves less stands still


class Curve:
    """One value over time: its least and its largest in each of at most 800 spans.

    Args:
        gap_s: What is not heard for longer leaves a hole.
    """

    __slots__ = ("_buckets", "_gap_s", "_width_s")

    def __init__(self, gap_s: float = 2.0) -> None:
        self._gap_s = gap_s
        self._width_s = 0.02
        # By number of the span: first and last time, and time and value of the least and largest.
        self._buckets: dict[int, tuple[float, float, float, float, float, float]] = {}

    def __len__(self) -> int:
        return len(self._buckets)

    def add(self, at_s: float, value: float) -> None:
        """A value later than those before it; what is not a finite number is passed over."""
        if not math.isfinite(value):
            return
        self._put(int(at_s / self._width_s), (at_s, at_s, at_s, value, at_s, value))
        if len(self._buckets) > _MOST_BUCKETS:
            self._width_s *= 2.0
            before, self._buckets = self._buckets, {}
            for bucket in before.values():
                self._put(int(bucket[0] / self._width_s), bucket)

    def _put(self, number: int, new: tuple[float, float, float, float, float, float]) -> None:
        old = self._buckets.get(number)
        if old is not None:
            least = new[2:4] if new[3] < old[3] else old[2:4]
            largest = new[4:6] if new[5] > old[5] else old[4:6]
            new = (old[0], new[1], *least, *largest)
        self._buckets[number] = new

    def points(self) -> Iterator[tuple[float, float]]:
        """Time, s, and value, in order; NaN stands in a hole."""
        last = math.inf
        for first, end, least_at, least, largest_at, largest in self._buckets.values():
            if first - last > max(self._gap_s, 2.0 * self._width_s):
                yield (first + last) / 2.0, math.nan
            both = sorted({(least_at, least), (largest_at, largest)})
            yield from both
            last = end


class Track:
    """Places that were passed, each a step from the one before.

    Attributes:
        length_m: How long it is.
    """

    __slots__ = ("_places", "_step_m", "length_m")

    def __init__(self) -> None:
        self.length_m = 0.0
        self._step_m = _LEAST_STEP_M
        self._places: list[tuple[float, float, float]] = []

    def add(self, at_s: float, north_m: float, east_m: float) -> None:
        """Where it was at a time, s."""
        new = (at_s, north_m, east_m)
        if self._places:
            step = _apart(self._places[-1], new)
            if step < self._step_m:
                return
            self.length_m += step
        self._places.append(new)
        if len(self._places) > _MOST_PLACES:
            self._step_m *= 2.0
            kept = self._places[:1]
            for place in self._places:
                if _apart(kept[-1], place) >= self._step_m:
                    kept.append(place)
            self._places = kept

    def places(self) -> list[tuple[float, float, float]]:
        """Time, s, and metres north and east, in order."""
        return list(self._places)


def _apart(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    return math.hypot(other[1] - one[1], other[2] - one[2])
