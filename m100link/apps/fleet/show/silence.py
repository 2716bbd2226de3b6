"""Whether the rest of a track comes near to where one may stand who is not heard any more.

Nobody knows what became of an aircraft that is silent. It may have been killed, and hovers or lands
where it was; it may be cut off and fly on, as was checked; and while it finds out that it is cut
off, it may stop anywhere on the way that it told last. So whoever misses it decides within that
time, too: either the rest of its own track keeps away from that way, and it flies on to the end, or
it leaves while it is still on the way that itself told last. Then whatever the silent one does, the
two do not meet. Pure logic, no clock.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property

from m100link.apps.fleet.show.distance import apart
from m100link.apps.fleet.show.track import TimedTrack, Vector

__all__ = ["RestOfTrack", "nearest"]

_MOST_MOMENTS = 4096
_LEAST_STEP_S = 0.25
_CHUNK = 64
_FINE_S = 0.1

_Box = tuple[float, float, float, float]


class RestOfTrack:
    """What one aircraft has to fly still.

    Args:
        track: All of it.
    """

    def __init__(self, track: TimedTrack) -> None:
        self._track = track
        self._step = max(_LEAST_STEP_S, track.end / _MOST_MOMENTS)

    @cached_property
    def _chunks(self) -> list[tuple[float, float, _Box]]:
        """From when to when, and the box it flies in meanwhile, seen from above."""
        track, step, found = self._track, self._step, []
        many = math.ceil(track.end / step)
        spare = track.fastest[0] * step / 2
        places = [track.moment(index * step).place for index in range(many + 1)]
        for first in range(0, many, _CHUNK):
            last = min(first + _CHUNK, many)
            found.append((first * step, last * step, _box(places[first : last + 1], spare)))
        return found

    def meets(self, ways: Sequence[Vector], least_m: float, begin: float) -> float | None:
        """When it first comes nearer to one of these places, or to the ground below them.

        Args:
            ways: Where somebody may stand, or land.
            least_m: How near it may come, m.
            begin: From when on, s from the beginning of the show.

        Returns:
            Seconds from the beginning of the show; None if it never does.
        """
        box = _box(ways, least_m)
        for start, end, there in self._chunks:
            if end < begin or not _overlap(box, there):
                continue
            for at in _moments(max(start, begin), end):
                place = self._track.moment(at).place
                is_near = _overlap(box, (place[0], place[0], place[1], place[1]))
                if is_near and nearest(place, ways, has_ended=False) < least_m:
                    return at
        last = max(begin, self._track.end)  # it stays there, or lands
        place = self._track.moment(last).place
        return last if nearest(place, ways, has_ended=True) < least_m else None


def nearest(own: Vector, ways: Sequence[Vector], *, has_ended: bool) -> float:
    """How near one is to the nearest place where somebody may stand or land, m.

    Args:
        own: Where it is.
        ways: The places.
        has_ended: Whether it may be landing itself.
    """
    return min(apart(own, way, first_ended=has_ended, second_ended=True) for way in ways)


def _moments(start: float, end: float) -> Iterator[float]:
    many = max(1, math.ceil((end - start) / _FINE_S))
    for index in range(many + 1):
        yield start + (end - start) * index / many


def _box(places: Sequence[Vector], spare: float) -> _Box:
    north, east = [place[0] for place in places], [place[1] for place in places]
    return min(north) - spare, max(north) + spare, min(east) - spare, max(east) + spare


def _overlap(a: _Box, b: _Box) -> bool:
    return a[0] <= b[1] and b[0] <= a[1] and a[2] <= b[3] and b[2] <= a[3]
