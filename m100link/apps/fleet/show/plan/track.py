"""The track of one aircraft of a show: a track that is timed, its bytes and their hash.

Between its points it is a cubic in time for each axis, with slopes that no axis overshoots by
(Fritsch and Carlson, 1980): it stays inside the box of any two neighbours, passes points without
stopping where it goes on in the same direction, and is at rest at both ends. No I/O, no clock.
"""

from __future__ import annotations

import hashlib
import math
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, takewhile
from operator import attrgetter, itemgetter
from typing import Self

from m100link.errors import UsageError

MAX_POINTS = 10_000
"""Points of a track: three hours with one a second."""
MAX_NAME = 64
_MAX_S = 86_400.0
_MAX_M = 10_000.0
"""Farther from the origin, or higher, is a mistake in the units."""
_SAMPLES = 32  # of a leg, where a greatest speed is looked for

_MAGIC = b"m100link track 1\n"
_HEAD = struct.Struct(">ddddBdI")  # origin, ground, tube, whether it has a heading, that, points
_POINT = struct.Struct(">dddd")

Vector = tuple[float, float, float]
"""North, east and up."""
Cubic = tuple[Vector, Vector, Vector, Vector]
"""A Bézier curve: where it begins, two points that pull it, and where it ends."""


class BadShow(
    UsageError,
    code="M100-BAD-SHOW",
    cause="a show that brings aircraft too near to each other, or a file that is not a show",
    remedy="`m100link fleet show check FILE` names what is wrong, the aircraft and the time",
):
    """A show that must not be flown, or a file that is not a show."""

    aircraft: tuple[str, ...] = ()  #: names of the aircraft concerned; empty for the whole show
    at: float | None = None  #: seconds from the beginning of the show; None without a moment
    measured: float | None = None  #: the measured value
    limit: float | None = None  #: its limit


@dataclass(frozen=True, slots=True)
class TimedPoint:
    """Where to be, and when."""

    at: float  #: seconds from the beginning of the show
    north: float  #: metres from the show's origin
    east: float  #: see ``north``
    height: float  #: metres above the show's origin

    @property
    def place(self) -> Vector:
        """North, east and height."""
        return self.north, self.east, self.height


@dataclass(frozen=True, slots=True)
class Moment:
    """Where a track is at one time."""

    place: Vector  #: north, east and height, m from the show's origin
    velocity: Vector  #: north, east and up, m/s


@dataclass(frozen=True, slots=True)
class TrackSegment:
    begin: float  # seconds from the beginning of the show
    end: float
    curve: Cubic  # where it goes

    @property
    def duration(self) -> float:
        return self.end - self.begin

    def moment(self, at: float) -> Moment:
        """Where it is, and how fast, at a time from its begin to its end."""
        share = (at - self.begin) / self.duration
        rest = 1.0 - share
        p0, p1, p2, p3 = self.curve
        w0, w1, w2, w3 = rest**3, 3 * rest * rest * share, 3 * rest * share * share, share**3
        north, east, up = (
            w0 * a + w1 * b + w2 * c + w3 * d for a, b, c, d in zip(p0, p1, p2, p3, strict=True)
        )
        return Moment((north, east, up), self._velocity(share))

    def _velocity(self, share: float) -> Vector:
        rest = 1.0 - share
        d0, d1, d2 = rest * rest, 2 * rest * share, share * share
        per_s = 3.0 / self.duration
        p0, p1, p2, p3 = self.curve
        north, east, up = (
            per_s * (d0 * (b - a) + d1 * (c - b) + d2 * (d - c))
            for a, b, c, d in zip(p0, p1, p2, p3, strict=True)
        )
        return north, east, up

    @property
    def _accelerations(self) -> tuple[Vector, Vector]:
        """At both ends, m/s²; in between it changes evenly."""
        p0, p1, p2, p3 = self.curve
        per_s2 = 6.0 / self.duration**2
        n0, e0, u0 = (per_s2 * (a - 2 * b + c) for a, b, c in zip(p0, p1, p2, strict=True))
        n1, e1, u1 = (per_s2 * (a - 2 * b + c) for a, b, c in zip(p1, p2, p3, strict=True))
        return (n0, e0, u0), (n1, e1, u1)

    @property
    def hardest_m_s2(self) -> float:
        """The greatest acceleration: the one at an end."""
        return max(math.hypot(*one) for one in self._accelerations)

    @property
    def fastest(self) -> tuple[float, float]:
        """The speeds that are never exceeded, horizontally and vertically, m/s.

        Looked up at 33 moments. Between two of them it is at most their mean and half of what is
        accelerated on the way, so at most the greater of what each end says here.
        """
        first, last = self._accelerations
        half = self.duration / _SAMPLES / 2
        across = upright = 0.0
        for index in range(_SAMPLES + 1):
            share = index / _SAMPLES
            north, east, up = self._velocity(share)
            n, e, u = (a + (b - a) * share for a, b in zip(first, last, strict=True))
            across = max(across, math.hypot(north, east) + half * math.hypot(n, e))
            upright = max(upright, abs(up) + half * abs(u))
        return across, upright


@dataclass(frozen=True)
class TimedTrack:
    """The timed track of one aircraft.

    Raises:
        BadShow: The values make no track.
    """

    name: str  #: of the aircraft
    origin: tuple[float, float]  #: latitude and longitude from which north and east count, °
    #: where to be and when, 2 or more; it hovers at the first one until its time, and at the last
    #: one afterwards
    points: tuple[TimedPoint, ...]
    #: height of its take-off point above the show's origin, m; the aircraft's own heights count
    #: from there. It takes off below its first point.
    ground_m: float = 0.0
    #: heading of the nose, °; None for its heading when the show begins
    heading_deg: float | None = None
    tube_m: float = 1.5  #: how far it may be from its track before it leaves the show

    def __post_init__(self) -> None:
        for problem in _problems(self):
            mend = "mend that in its file: m100link fleet show check FILE"
            raise BadShow(f"{self.name}: {problem}", aircraft=(self.name,), remedy=mend)

    @property
    def begin(self) -> float:
        """When it leaves its first point, seconds from the beginning of the show."""
        return self.points[0].at

    @property
    def end(self) -> float:
        """When it is at its last point."""
        return self.points[-1].at

    @cached_property
    def legs(self) -> tuple[TrackSegment, ...]:
        slopes = list(zip(*(self._slopes(axis) for axis in range(3)), strict=True))
        return tuple(
            _leg(before, after, leaving, arriving)
            for (before, after), (leaving, arriving) in zip(
                pairwise(self.points), pairwise(slopes), strict=True
            )
        )

    def _slopes(self, axis: int) -> list[float]:
        """Of one axis at each point, m/s: 0 where it turns back and at both ends."""
        places = [point.place[axis] for point in self.points]
        steps = [after.at - before.at for before, after in pairwise(self.points)]
        means = [(b - a) / step for (a, b), step in zip(pairwise(places), steps, strict=True)]
        found = [0.0]
        for (h0, h1), (d0, d1) in zip(pairwise(steps), pairwise(means), strict=True):
            if d0 * d1 <= 0:
                found.append(0.0)
                continue
            w0, w1 = 2 * h1 + h0, h1 + 2 * h0
            found.append((w0 + w1) / (w0 / d0 + w1 / d1))
        return [*found, 0.0]

    @cached_property
    def _begins(self) -> list[float]:
        return [leg.begin for leg in self.legs]

    def moment(self, at: float) -> Moment:
        """Where to be at a time, and how fast."""
        if at <= self.begin or at >= self.end:
            return Moment(self.points[0 if at <= self.begin else -1].place, (0.0, 0.0, 0.0))
        return self.leg_at(at).moment(at)

    def leg_at(self, at: float) -> TrackSegment:
        """The piece that is flown at a time from :attr:`begin` on, before :attr:`end`."""
        return self.legs[bisect_right(self._begins, at) - 1]

    @cached_property
    def fastest(self) -> tuple[float, float]:
        """The speeds that are never exceeded, horizontally and vertically, m/s."""
        each = [leg.fastest for leg in self.legs]
        return max(across for across, _ in each), max(upright for _, upright in each)

    def to_bytes(self) -> bytes:
        """The bytes to upload and hash: the same for the same track on every machine.

        ``m100link track 1`` and a line feed; the length of the name in two bytes, and it; latitude
        and longitude of the origin, height of the ground and width of the tube; one byte that says
        whether there is a heading, and it, or 0; the number of points in four bytes; time, north,
        east and height of each. Numbers are IEEE 754 doubles, all are big-endian, and zero is
        positive.
        """
        name = self.name.encode()
        heading = 0.0 if self.heading_deg is None else self.heading_deg
        head = _HEAD.pack(
            *(value + 0.0 for value in (*self.origin, self.ground_m, self.tube_m)),
            self.heading_deg is not None,
            heading + 0.0,
            len(self.points),
        )
        points = b"".join(
            _POINT.pack(*(value + 0.0 for value in (point.at, *point.place)))
            for point in self.points
        )
        return _MAGIC + struct.pack(">H", len(name)) + name + head + points

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read what :meth:`to_bytes` wrote, somewhere else.

        Raises:
            BadShow: It is not that, or no track.
        """
        try:
            if not data.startswith(_MAGIC):
                raise ValueError("they begin differently")
            at = len(_MAGIC) + 2
            at += (length := int.from_bytes(data[at - 2 : at], "big"))
            name = data[at - length : at].decode()
            *place, ground, tube, has_heading, heading, _ = _HEAD.unpack_from(data, at)
            values = _POINT.iter_unpack(data[at + _HEAD.size :])
            points = tuple(TimedPoint(*one) for one in values)
        except (ValueError, struct.error) as error:
            raise BadShow(
                f"the bytes of a track cannot be read: {error}",
                cause="another version wrote them, or they were damaged on their way",
                remedy="upload the track again, with the same release as the agent's",
            ) from error
        latitude, longitude = place
        made = cls(
            name, (latitude, longitude), points, ground, heading if has_heading else None, tube
        )
        if made.to_bytes() != data:  # another spelling would have another hash
            mend = "install the same release on board and here, and upload it again"
            raise BadShow("the bytes of a track are not as this version writes them", remedy=mend)
        return made

    @cached_property
    def digest(self) -> str:
        """SHA-256 of :meth:`to_bytes`, in hexadecimal digits."""
        return hashlib.sha256(self.to_bytes()).hexdigest()


def _leg(
    before: TimedPoint, after: TimedPoint, leaving: Sequence[float], arriving: Sequence[float]
) -> TrackSegment:
    third = (after.at - before.at) / 3
    n0, e0, h0 = (place + slope * third for place, slope in zip(before.place, leaving, strict=True))
    n1, e1, h1 = (place - slope * third for place, slope in zip(after.place, arriving, strict=True))
    return TrackSegment(
        before.at, after.at, (before.place, (n0, e0, h0), (n1, e1, h1), after.place)
    )


def _problems(track: TimedTrack) -> Iterator[str]:
    """Why these are no track; the first is enough."""
    if not 0 < len(track.name) <= MAX_NAME or not track.name.isprintable():
        yield f"a name has 1 to {MAX_NAME} characters that can be printed"
    if not 2 <= len(track.points) <= MAX_POINTS:
        yield f"a track has 2 to {MAX_POINTS} points, not {len(track.points)}"
    latitude, longitude = track.origin
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        yield f"the origin is {latitude:g}° {longitude:g}°: latitude within ±89°, longitude ±180°"
    if not abs(track.ground_m) <= _MAX_M:
        yield f"the ground is at {track.ground_m:g} m: within ±{_MAX_M:g} m"
    if track.heading_deg is not None and not abs(track.heading_deg) <= 180:
        yield f"the heading is {track.heading_deg:g}°: -180 to 180°"
    if not 0 < track.tube_m <= 100:
        yield f"the tube is {track.tube_m:g} m: more than 0, up to 100 m"
    for index, point in enumerate(track.points):
        if not 0 <= point.at <= _MAX_S:
            yield f"point {index} is at {point.at:g} s: 0 to {_MAX_S:g} s"
        if not all(abs(value) <= _MAX_M for value in point.place):
            yield f"point {index} is {point.place}: finite, within ±{_MAX_M:g} m of the origin"
    for index, (before, after) in enumerate(pairwise(track.points), start=1):
        if after.at - before.at < 0.02:  # a period of setpoints
            times = f"{after.at:g} s, the one before at {before.at:g} s"
            yield f"point {index} is at {times}: each 20 ms later or more"


# -- how near two tracks come to each other, and when. Exact to a millimetre; no I/O, no clock -----
# A distance changes no faster than the way between the two gets longer, and a Bézier curve is no
# longer than the way by its control points. So whatever piece of time cannot hold a lesser distance
# than one that is known is left out, and the others are halved.


_EXACT_M = 1e-3
SPARE_M = 1e-6  # more than rounding takes
_WINDOWS = 100

Box = tuple[float, float, float, float, float, float]
"""The least and the greatest north, east and height, m."""
Span = tuple[float, float]
"""From when to when, seconds from the beginning of the show."""
_AT = attrgetter("at")

Metric = Callable[[Vector], float]


def _between(place: Vector) -> float:
    return math.hypot(*place)


def _from_column(place: Vector) -> float:
    """From whatever is above a place on the ground, up to where it hovers."""
    north, east, up = place
    return math.hypot(north, east, max(0.0, up))


def apart(first: Vector, second: Vector, *, first_ended: bool, second_ended: bool) -> float:
    """How far two places are from each other, m.

    An aircraft whose track has ended may be landing: it counts as everywhere between its last point
    and the ground.
    """
    metric, sign = _metric(first_ended, second_ended)
    north, east, up = (sign * (b - a) for a, b in zip(first, second, strict=True))
    return metric((north, east, up))


def _metric(first_ended: bool, second_ended: bool) -> tuple[Metric, float]:
    """The measure of their distance, and the sign of the way from the first."""
    if first_ended and second_ended:
        return lambda place: math.hypot(place[0], place[1]), 1.0  # seen from above
    if first_ended:
        return _from_column, 1.0
    return (_from_column, -1.0) if second_ended else (_between, 1.0)


def closest(
    first: TimedTrack,
    second: TimedTrack,
    *,
    below: float = math.inf,
    during: Sequence[Span] = ((0.0, math.inf),),
) -> tuple[float, float] | None:
    """The least distance of two tracks and when it is, m and s.

    ``below``: farther is of no interest: None then, and quickly. ``during``: when they may be
    nearer.
    """
    last = max(first.end, second.end)
    ends = first.moment(last).place, second.moment(last).place
    # Hovering or landing, from then on.
    found = (apart(*ends, first_ended=True, second_ended=True), last)
    times = {0.0, *(point.at for track in (first, second) for point in track.points)}
    for begin, end in pairwise(sorted(times)):
        if not any(start < end and begin < stop for start, stop in during):
            continue
        metric, sign = _metric(begin >= first.end, begin >= second.end)
        curve = _apart(_piece(first, begin, end), _piece(second, begin, end), sign)
        least = _least(curve, begin, end, metric, min(found[0], below))
        found = min(found, least, key=itemgetter(0))
    return found if found[0] < below else None


class Windows:
    """The boxes in which tracks are in each of some windows of time.

    Two whose boxes are apart in a window are not looked at in it: of two hundred aircraft each has
    few that are near.
    """

    def __init__(self, tracks: Sequence[TimedTrack]) -> None:
        last = max(track.end for track in tracks)
        times = sorted({0.0, last} | {point.at for track in tracks for point in track.points})
        if len(times) > _WINDOWS:
            times = [last * index / _WINDOWS for index in range(_WINDOWS + 1)]
        # Behind the last one each hovers or lands.
        spans = [*pairwise(times), (last, math.inf)]
        self._boxes = [(span, [_box(track, *span) for track in tracks]) for span in spans]

    def near(self, within: float) -> dict[tuple[int, int], list[Span]]:
        """When which two may be nearer than that, m; two that never are have no entry."""
        found: dict[tuple[int, int], list[Span]] = {}
        for span, boxes in self._boxes:
            for pair in overlapping(boxes, within + SPARE_M):
                found.setdefault(pair, []).append(span)
        return dict(sorted(found.items()))


def _box(track: TimedTrack, begin: float, end: float) -> Box:
    """Where a track is in a window; one that ends in it or before is everywhere below, too."""
    last = min(end, max(track.end, begin))
    own = track.points[bisect_right(track.points, begin, key=_AT) :]
    inner = takewhile(lambda point: point.at < last, own)
    times = [begin, *(point.at for point in inner), last]
    if begin >= track.end:
        places: list[Vector] = [track.points[-1].place]
    else:
        places = [place for piece in pairwise(times) for place in _piece(track, *piece)]
    low, high = (tuple(map(each, zip(*places, strict=True))) for each in (min, max))
    floor = -math.inf if end > track.end or begin >= track.end else low[2]
    return (low[0], high[0], low[1], high[1], floor, high[2])


def overlapping(boxes: Sequence[Box], within: float) -> Iterator[tuple[int, int]]:
    """The pairs of boxes, by their places, that are nearer to each other than that, m."""
    active: list[int] = []
    for one in sorted(range(len(boxes)), key=lambda place: boxes[place][0]):
        south, _, west, east, floor, top = boxes[one]
        active = [other for other in active if boxes[other][1] > south - within]
        for other in active:
            _, north, other_west, other_east, other_floor, other_top = boxes[other]
            across = max(other_west - east, west - other_east)
            if across < within:
                upright = max(other_floor - top, floor - other_top)
                gaps = (max(0.0, gap) for gap in (south - north, across, upright))
                if math.hypot(*gaps) < within:
                    yield min(one, other), max(one, other)
        active.append(one)


def under(
    tracks: Sequence[TimedTrack],
    needed: Callable[[TimedTrack, TimedTrack], float],
    near: Mapping[tuple[int, int], Sequence[Span]],  # at most so near, and when: of `Windows`
) -> Iterator[tuple[TimedTrack, TimedTrack, float, float]]:
    """The pairs that come nearer to each other than they may: both, distance and time."""
    for (i, j), spans in near.items():
        first, second = tracks[i], tracks[j]
        found = closest(first, second, below=needed(first, second), during=spans)
        if found is not None:
            yield first, second, *found


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
