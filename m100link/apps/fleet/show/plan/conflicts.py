"""Which aircraft come too near in the next ten seconds of a show (pure logic, times are arguments).

The check of a show holds for its tracks. In the air an aircraft may be blown off its track, or may
have left and hover or land in the path of another one. So each publishes where it will be and
compares that with the others; one that would come nearer to another than the show allows, leaves.
None relies on the other to give way. An aircraft that is silent may stand anywhere on the path that
it published last; below, :class:`RestOfTrack` decides about it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from m100link.apps.fleet.show.plan.track import BadShow, TimedTrack, Vector, apart
from m100link.errors.texts import read_json
from m100link.geodesy import LocalFrame

AHEAD_S = 10.0
"""Seconds that are looked ahead."""

SILENT_S = 1.0
"""Seconds of silence after which it is unknown whether an aircraft flies on."""

SETTLED_S = 8.0
"""Seconds of silence after which the others decide: one that leaves then has stopped on the path
that it published last, which is as long as :data:`AHEAD_S`."""

_THERE_S = 2.0
_EVADED_S = 5.0
"""Seconds before it would come to where a silent one may stand; it stops in two."""
_STEP_S = 0.5
_STEPS = round(AHEAD_S / _STEP_S)
_FINE_S = 0.1
"""Between two looks: in that time two of 10 m/s come 2 m nearer, which changes 3 m by 0.2 m."""
_LOOK_S = 0.2
_MOST = 1000
_MOST_BYTES = 4096
_MOST_M = 1e6


@dataclass(frozen=True, slots=True)
class ConflictMonitor:
    show: str  # which show, by its digest
    name: str  # of the aircraft
    at: float  # when the first place is, s from the beginning of the show; each half a second later
    places: tuple[Vector, ...]  # north, east and height, m, from the show's origin
    # From when it may be landing, s from the beginning of the show: then it counts as everywhere
    # below its place.
    down_from: float
    origin: tuple[float, float] | None = None  # latitude and longitude of the show's origin, °

    def seen_from(self, origin: tuple[float, float], now: float, show: str) -> ConflictMonitor:
        """An aircraft of another show, as one that flies this show: by its origin and its time.

        Nobody knows the height of the other origin: it counts as everywhere above and below.
        """
        assert self.origin is not None
        there, here = LocalFrame(*self.origin), LocalFrame(*origin)
        spots = [here.to_local(*there.to_geodetic(*place[:2])) for place in self.places]
        places = tuple((north, east, _MOST_M) for north, east in spots)
        return ConflictMonitor(f"{show}, beside", self.name, now, places, -math.inf)

    def place(self, at: float) -> Vector:
        """Where it will be at a time; behind the last place it stays there."""
        steps = max(0.0, min(len(self.places) - 1.0, (at - self.at) / _STEP_S))
        before = int(steps)
        after, share = min(before + 1, len(self.places) - 1), steps - before
        a, b = self.places[before], self.places[after]
        return (
            a[0] + (b[0] - a[0]) * share,
            a[1] + (b[1] - a[1]) * share,
            a[2] + (b[2] - a[2]) * share,
        )

    def stands(self) -> list[Vector]:
        """Where it may stand if nobody flies it any more: its way, each tenth of a second."""
        many = round((len(self.places) - 1) * _STEP_S / _FINE_S)
        return [self.place(self.at + index * _FINE_S) for index in range(many + 1)]

    @property
    def way(self) -> float:
        """How long its way is, m."""
        return sum(map(math.dist, self.places, self.places[1:]))

    def to_bytes(self) -> bytes:
        places = [[round(one, 2) for one in place] for place in self.places]
        fields = [self.show, self.name, round(self.at, 3), round(self.down_from, 3), places]
        if self.origin is not None:
            fields += self.origin
        return json.dumps(fields, separators=(",", ":")).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        try:
            if len(data) > _MOST_BYTES:
                raise ValueError("too long")
            show, name, at, down_from, places, *origin = read_json(data)
            found = tuple((float(n), float(e), float(h)) for n, e, h in places)
            times = float(at), float(down_from)
            place = None
            if origin:
                place = float(origin[0]), float(origin[1])
                LocalFrame(*place)  # raises where it cannot be one
        except (ValueError, TypeError, OverflowError, IndexError) as error:
            raise BadShow(f"the path of an aircraft cannot be read: {error}") from None
        numbers = [*times, *(one for place in found for one in place)]
        if not found or not all(abs(one) <= _MOST_M for one in numbers):  # NaN is no number
            raise BadShow("the path of an aircraft has no possible positions")
        return cls(str(show), str(name), times[0], found, times[1], place)


def by_track(show: str, track: TimedTrack, at: float, here: Vector) -> ConflictMonitor:
    """Where one will be that flies its track, as far beside it as it is now."""
    wanted = track.moment(at).place
    off = [b - a for a, b in zip(wanted, here, strict=True)]
    places = []
    for step in range(_STEPS + 1):
        north, east, height = track.moment(at + step * _STEP_S).place
        places.append((north + off[0], east + off[1], height + off[2]))
    return ConflictMonitor(show, track.name, at, tuple(places), track.end, track.origin)


def by_speed(show: str, name: str, at: float, here: Vector, speed: Vector) -> ConflictMonitor:
    """Where one will be that has left its track: it hovers, lands, or is flown by somebody."""
    places = []
    for step in range(_STEPS + 1):
        north, east, up = (a + b * step * _STEP_S for a, b in zip(here, speed, strict=True))
        places.append((north, east, up))
    return ConflictMonitor(show, name, at, tuple(places), at)


@dataclass(frozen=True, slots=True)
class Near:
    """Another aircraft will come too near."""

    name: str
    at: float  # when it first is nearer than allowed, s from the beginning of the show
    distance_m: float  # how near it is then
    # For how long it has been silent, if it is one that may stand there; else 0.
    silent_s: float = 0.0


class Neighbours:
    """The other aircraft of a show, as one of them hears them.

    ``least_m``: how near two may come to each other, m. ``count``: how many others there are; 0
    where it did not report that. Raises BadShow: that is no distance.
    """

    def __init__(self, show: str, name: str, least_m: float, count: int = 0) -> None:
        if not 0 <= least_m <= 1000:
            raise BadShow(f"{least_m:g} m is no distance of two aircraft", remedy="0 to 1000 m")
        self.show, self.name, self.least_m, self.count = show, name, least_m, count
        self._heard: dict[str, tuple[ConflictMonitor, float]] = {}
        # Of silent ones that were decided about: their last word.
        self._settled: dict[str, float] = {}

    def hear(self, ahead: ConflictMonitor, now: float) -> None:
        """One tells where it will be; of another show it has to be seen from this one."""
        if ahead.show not in (self.show, f"{self.show}, beside") or ahead.name == self.name:
            return
        known = self._heard.get(ahead.name)
        if known is None and len(self._heard) >= _MOST:
            return
        if known is None or ahead.at >= known[0].at:  # the network may bring an older one later
            self._heard[ahead.name] = ahead, now

    def missing(self, now: float) -> int:
        """How many of the others have not reported in the last two seconds where they will be."""
        own = [at for ahead, at in self._heard.values() if ahead.show == self.show]
        heard = sum(now - at <= _THERE_S for at in own)
        return max(0, self.count - heard)

    def near(
        self, own: ConflictMonitor, now: float, rest: RestOfTrack | None = None
    ) -> Near | None:
        """The first that comes too near; None for nobody.

        ``now``: s, by the clock of :meth:`hear`. ``rest``: the rest of its track; None if it
        flies no track.
        """
        found: list[Near] = []
        for ahead, heard_at in self._heard.values():
            if own.at < ahead.at + AHEAD_S:
                found += filter(None, [self._meets(own, ahead)])
            # A message that was long on its way is as old as it says.
            silent = max(now - heard_at, own.at - ahead.at)
            if silent > SILENT_S:
                found += filter(None, [self._stands(own, ahead, silent)])
            if silent > SETTLED_S and rest and self._settled.get(ahead.name) != ahead.at:
                self._settled[ahead.name] = ahead.at
                at = rest.meets(ahead.stands(), self.least_m, own.at)
                if at is not None:
                    found.append(Near(ahead.name, at, self.least_m, silent))
        return min(found, key=lambda near: near.at, default=None)

    def _is_far(self, own: ConflictMonitor, other: ConflictMonitor) -> bool:
        between = math.dist(own.places[0][:2], other.place(own.at)[:2])
        return between > self.least_m + own.way + other.way

    def _meets(self, own: ConflictMonitor, other: ConflictMonitor) -> Near | None:
        """Whether the two come too near if each flies on as it reported."""
        if self._is_far(own, other):
            return None
        for step in range(round(AHEAD_S / _FINE_S) + 1):
            at = own.at + step * _FINE_S
            distance = apart(
                own.place(at),
                other.place(at),
                first_ended=at >= own.down_from,
                second_ended=at >= other.down_from,
            )
            if distance < self.least_m:
                return Near(other.name, at, distance)
        return None

    def _stands(self, own: ConflictMonitor, other: ConflictMonitor, silent: float) -> Near | None:
        """Whether this one comes too near to where the other one may have stopped by then."""
        if self._is_far(own, other):
            return None
        stands = other.stands()
        for step in range(round(_EVADED_S / _LOOK_S) + 1):
            at = own.at + step * _LOOK_S
            # It is not farther on its way than it would be if it flew.
            by_then = stands[: max(1, round((at - other.at) / _FINE_S) + 1)]
            distance = nearest(own.place(at), by_then, has_ended=at >= own.down_from)
            if distance < self.least_m:
                return Near(other.name, at, distance, silent)
        return None


# -- whether the rest of a track comes near to where a silent aircraft may stand -------------------
# The state of a silent aircraft is unknown. It may have been killed, and hover or land on the spot.
# It may be cut off and fly on, as was checked. While it finds out that it is cut off, it may stop
# anywhere on the path that it published last. So each other aircraft decides within that time, too.
# Either the rest of its own track keeps away from that path, and it flies on to the end. Or it
# leaves while it is still on the path that it published last itself. Then the two do not meet,
# whatever the silent one does. Pure logic, no clock.


_MOST_MOMENTS = 4096
_LEAST_STEP_S = 0.25
_CHUNK = 64

_Box = tuple[float, float, float, float]


class RestOfTrack:
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

        Returns seconds from the beginning of the show; None if it never does.

        ``least_m``: how near it may come, m. ``begin``: from when on, s from the beginning of the
        show.
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
    """How near one is to the nearest place where somebody may stand or land, m."""
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
