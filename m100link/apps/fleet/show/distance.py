"""How near two tracks come to each other, and when. Exact to a millimetre; no I/O, no clock.

A distance changes no faster than the way between the two gets longer, and a Bézier curve is no
longer than the way by its control points. So whatever piece of time cannot hold a lesser distance
than one that is known is left out, and the others are halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from m100link.apps.fleet.show.track import Cubic, TimedTrack, Vector

__all__ = ["apart", "closest", "under"]

_EXACT_M = 1e-3

Metric = Callable[[Vector], float]


def _between(place: Vector) -> float:
    return math.hypot(*place)


def _from_column(place: Vector) -> float:
    """From whatever is above a place on the ground, up to where it hovers."""
    north, east, up = place
    return math.hypot(north, east, max(0.0, up))


def _on_the_ground(place: Vector) -> float:
    return math.hypot(place[0], place[1])


def apart(first: Vector, second: Vector, *, first_ended: bool, second_ended: bool) -> float:
    """How far two places are from each other, m.

    An aircraft whose track has ended may be landing: it counts as everywhere between its last point
    and the ground.
    """
    metric, sign = _metric(first_ended, second_ended)
    north, east, up = (sign * (b - a) for a, b in zip(first, second, strict=True))
    return metric((north, east, up))


def _metric(first_ended: bool, second_ended: bool) -> tuple[Metric, float]:
    """What counts as their distance, of the way from the first times a sign."""
    if first_ended and second_ended:
        return _on_the_ground, 1.0
    if first_ended:
        return _from_column, 1.0
    return (_from_column, -1.0) if second_ended else (_between, 1.0)


def _apart_at(first: TimedTrack, second: TimedTrack, at: float) -> float:
    return apart(
        first.moment(at).place,
        second.moment(at).place,
        first_ended=at >= first.end,
        second_ended=at >= second.end,
    )


def closest(
    first: TimedTrack, second: TimedTrack, *, below: float = math.inf
) -> tuple[float, float] | None:
    """The least distance of two tracks and when it is, m and s.

    Args:
        first: One of them.
        second: The other one.
        below: Farther is of no interest: None then, and quickly.
    """
    last = max(first.end, second.end)
    found = (_apart_at(first, second, last), last)  # hovering or landing, from then on
    for begin, end in pairwise(_breaks(first, second)):
        metric, sign = _metric(begin >= first.end, begin >= second.end)
        a, b = _piece(first, begin, end), _piece(second, begin, end)
        curve = _apart(a, b, sign)
        found = min(found, _least(curve, begin, end, metric, min(found[0], below)), key=_distance)
    return found if found[0] < below else None


def _distance(found: tuple[float, float]) -> float:
    return found[0]


def under(
    tracks: Sequence[TimedTrack], needed: Callable[[TimedTrack, TimedTrack], float]
) -> Iterator[tuple[TimedTrack, TimedTrack, float, float]]:
    """The pairs that come nearer to each other than they may: both, distance and time."""
    for index, first in enumerate(tracks):
        for second in tracks[index + 1 :]:
            found = closest(first, second, below=needed(first, second))
            if found is not None:
                yield first, second, *found


def _breaks(first: TimedTrack, second: TimedTrack) -> list[float]:
    """Times between which both are one curve."""
    times = {0.0, *(point.at for track in (first, second) for point in track.points)}
    return sorted(times)


def _piece(track: TimedTrack, begin: float, end: float) -> Cubic:
    """A track between two times with none of its points in between."""
    middle = (begin + end) / 2
    if middle <= track.begin or middle >= track.end:
        place = track.moment(middle).place
        return place, place, place, place
    leg = track.leg_at(middle)
    third = (end - begin) / 3
    here, there = leg.moment(begin), leg.moment(end)
    n0, e0, h0 = (p + v * third for p, v in zip(here.place, here.velocity, strict=True))
    n1, e1, h1 = (p - v * third for p, v in zip(there.place, there.velocity, strict=True))
    return here.place, (n0, e0, h0), (n1, e1, h1), there.place


def _apart(first: Cubic, second: Cubic, sign: float) -> Cubic:
    """The way from one to the other, which is a curve of the same kind."""
    p0, p1, p2, p3 = (
        (sign * (b[0] - a[0]), sign * (b[1] - a[1]), sign * (b[2] - a[2]))
        for a, b in zip(first, second, strict=True)
    )
    return p0, p1, p2, p3


def _least(
    curve: Cubic, begin: float, end: float, metric: Metric, below: float
) -> tuple[float, float]:
    """The least distance from the origin and when; what is not below the limit may be anywhere."""
    best = min((metric(curve[0]), begin), (metric(curve[3]), end))
    waiting = [(curve, begin, end)]
    while waiting:
        piece, start, stop = waiting.pop()
        length = sum(math.dist(a, b) for a, b in pairwise(piece))
        lowest = (metric(piece[0]) + metric(piece[3]) - length) / 2
        if lowest >= min(best[0], below) - _EXACT_M:
            continue
        middle = (start + stop) / 2
        left, right = _halved(piece)
        best = min(best, (metric(right[0]), middle))
        waiting += (left, start, middle), (right, middle, stop)
    return best


def _halved(curve: Cubic) -> tuple[Cubic, Cubic]:
    """The two halves of a curve (de Casteljau)."""
    p0, p1, p2, p3 = curve
    a, b, c = _middle(p0, p1), _middle(p1, p2), _middle(p2, p3)
    d, e = _middle(a, b), _middle(b, c)
    f = _middle(d, e)
    return (p0, a, d, f), (f, e, c, p3)


def _middle(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2
