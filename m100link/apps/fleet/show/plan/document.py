"""Shows as JSON: which aircraft flies where, and when.

Nothing in a file is passed over, because nobody would notice it in flight: unknown and repeated
fields are refused by name.
"""

from __future__ import annotations

import csv
import io
import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations, pairwise
from pathlib import Path
from typing import Any, Self

from m100link.apps.fleet.show.plan.track import (
    BadShow,
    Box,
    TimedPoint,
    TimedTrack,
    Vector,
    Windows,
    apart,
    closest,
    overlapping,
    under,
)
from m100link.errors import BadPlan, GuardRefused
from m100link.flight.guards import Envelope
from m100link.geodesy import LocalFrame, MapView, Spot, escaped, svg_dot, svg_line, svg_text
from m100link.geodesy import svg as drawing
from m100link.missions.document import load_object, short
from m100link.missions.document import read as read_file

FORMAT = "m100link show"
VERSION = 1
MAX_AIRCRAFT = 200
"""Every two of them are compared."""

_FIELDS = ("format", "version", "name", "origin", "least_distance_m", "tube_m", "aircraft")
_AIRCRAFT_FIELDS = ("name", "ground_m", "heading_deg", "waypoints")
_BY_METRES = ("at", "north", "east", "height")
_BY_DEGREES = ("at", "latitude_deg", "longitude_deg", "height")


@dataclass(frozen=True, slots=True)
class Show:
    """A show: several aircraft that fly together."""

    name: str  #: for people
    tracks: tuple[TimedTrack, ...]  #: the track of each aircraft, in the file's order
    #: how near two aircraft may come to each other in the air, m, from centre to centre; without
    #: the error of GPS
    least_distance_m: float = 3.0

    @property
    def duration(self) -> float:
        """Seconds from its beginning until the last aircraft is at its last point."""
        return max(track.end for track in self.tracks)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            BadShow: It cannot be read, or is not a show.
        """
        try:
            text = read_file(path)
        except BadPlan as error:
            raise BadShow(error.seen, cause=error.cause, remedy=error.remedy) from error
        return cls.parse(text)

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """Read the text of such a file.

        Raises:
            BadShow: It is not JSON, or a field is missing, unknown or out of its range.
        """
        try:
            found = load_object(text)
        except BadPlan as error:
            raise BadShow(error.seen, cause=error.cause, remedy="give a show as JSON") from error
        return cls(**_values(found))


def _values(found: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of :class:`Show`."""
    kind = found.get("format"), found.get("version")
    if kind != (FORMAT, VERSION) or isinstance(kind[1], bool):
        raise BadShow(
            f"the format is {short(kind[0])}, version {short(kind[1])}",
            cause="the file is not a show, or another version of m100link wrote it",
            remedy=f'"format": "{FORMAT}", "version": {VERSION}',
        )
    _refuse_unknown(found, _FIELDS, "the show")
    listed = found.get("aircraft")
    if not isinstance(listed, list) or not 1 <= len(listed) <= MAX_AIRCRAFT:
        raise BadShow(
            f"aircraft is {short(listed)}",
            remedy=f'"aircraft": a list of 1 to {MAX_AIRCRAFT} objects',
        )
    least = _number(found, "least_distance_m", "the show", 3.0)
    if not 0 < least <= 1000:
        raise BadShow(f"least_distance_m is {least:g}", remedy="more than 0, up to 1000 m")
    name = found.get("name", "")
    if not isinstance(name, str):
        raise BadShow(f"name is {short(name)}", remedy="a text")
    origin = _origin(found, listed)
    tube = _number(found, "tube_m", "the show", 1.5)
    tracks = tuple(_track(index, one, origin, tube) for index, one in enumerate(listed))
    names = [track.name for track in tracks]
    for one in names:
        if names.count(one) > 1:
            raise BadShow(
                f"two of the aircraft have the name {one}",
                aircraft=(one,),
                remedy="give one track for each aircraft, by its name in the fleet",
            )
    return {"name": name, "tracks": tracks, "least_distance_m": least}


def _origin(found: Mapping[str, Any], listed: Sequence[Any]) -> tuple[float, float]:
    """Latitude and longitude where north and east are 0: the file's, else the first waypoint's."""
    origin = found.get("origin")
    if origin is None:
        first = listed[0].get("waypoints") if isinstance(listed[0], dict) else None
        origin = first[0] if isinstance(first, list) and first else None
        if not isinstance(origin, dict) or "latitude_deg" not in origin:
            raise BadShow(
                "the show has no origin",
                cause="metres north and east need a place on the earth to count from",
                remedy='"origin": {"latitude_deg": …, "longitude_deg": …}, or the first waypoint '
                "of the first aircraft in degrees",
            )
        origin = {name: origin.get(name) for name in ("latitude_deg", "longitude_deg")}
    if not isinstance(origin, dict):
        raise BadShow(f"origin is {short(origin)}", remedy="an object of two numbers")
    _refuse_unknown(origin, ("latitude_deg", "longitude_deg"), "origin")
    return _degrees(origin, "the origin")


def _track(index: int, found: Any, origin: tuple[float, float], tube: float) -> TimedTrack:
    where = f"aircraft {index}"
    if not isinstance(found, dict) or not isinstance(found.get("name"), str):
        raise BadShow(f"{where} is {short(found)}", remedy='an object with "name" and "waypoints"')
    where = found["name"] or where
    _refuse_unknown(found, _AIRCRAFT_FIELDS, where)
    listed = found.get("waypoints")
    if not isinstance(listed, list):
        raise BadShow(
            f"{where}: waypoints is {short(listed)}", remedy='"waypoints": a list of objects'
        )
    frame = LocalFrame(*origin)
    heading = found.get("heading_deg")
    return TimedTrack(
        found["name"],
        origin,
        tuple(_point(f"{where}, point {at}", point, frame) for at, point in enumerate(listed)),
        ground_m=_number(found, "ground_m", where, 0.0),
        heading_deg=None if heading is None else _number(found, "heading_deg", where),
        tube_m=tube,
    )


def _point(where: str, found: Any, frame: LocalFrame) -> TimedPoint:
    if not isinstance(found, dict):
        raise BadShow(f"{where} is {short(found)}", remedy=f"an object of {', '.join(_BY_METRES)}")
    is_by_degrees = "latitude_deg" in found or "longitude_deg" in found
    _refuse_unknown(found, _BY_DEGREES if is_by_degrees else _BY_METRES, where)
    at, height = _number(found, "at", where), _number(found, "height", where)
    if not is_by_degrees:
        return TimedPoint(at, _number(found, "north", where), _number(found, "east", where), height)
    return TimedPoint(at, *frame.to_local(*_degrees(found, where)), height)


def _degrees(found: Mapping[str, Any], where: str) -> tuple[float, float]:
    latitude = _number(found, "latitude_deg", where)
    longitude = _number(found, "longitude_deg", where)
    if not (abs(latitude) <= 89 and abs(longitude) <= 180):
        raise BadShow(
            f"{where} is at {latitude:g}° {longitude:g}°",
            remedy="latitude within ±89°, longitude within ±180°",
        )
    return latitude, longitude


def _number(found: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    value = found.get(name, default)
    try:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError
        number = float(value)
    except (ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        missing = "is missing" if name not in found else f"is {short(value)}"
        raise BadShow(f"{where}: {name} {missing}", remedy="a number")
    return number


def _refuse_unknown(found: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for name in found:
        if name not in known:
            raise BadShow(
                f"{where}: there is no field {short(name)}", remedy=f"one of {', '.join(known)}"
            )


# -- what is wrong with a show: limits of each aircraft, and how near any two come -----------------


SKEW_S = 0.05
"""By how much the clock of an agent may be wrong in a show; more, and it does not begin."""
CLIMB_M_S = 2.0
"""The steepest climb or descent: slower than the aircraft sinks into its own downwash."""
ACCELERATION_M_S2 = 1.5
"""A tilt of 9°, as on the rounded corners of a path."""
_SPARE = 0.8  # of the envelope's speed: with the rest an aircraft that is late catches up
_SAMPLES = 240
"""Moments at which the least distance is drawn."""


@dataclass(frozen=True, slots=True)
class Closest:
    """The least distance of any two aircraft."""

    at: float  #: seconds from the beginning of the show
    first: str  #: name of one aircraft
    second: str  #: name of the other one
    distance_m: float  #: between their tracks
    needed_m: float  #: distance that these two need there


@dataclass(frozen=True, slots=True)
class Report:
    """The findings of the check of a show."""

    problems: tuple[BadShow, ...]  #: why it must not be flown; empty if it may be
    remarks: tuple[str, ...]  #: what is allowed and may surprise
    closest: Closest | None  #: the nearest pair; None if there is only one aircraft

    @property
    def ok(self) -> bool:
        """Whether it may be flown."""
        return not self.problems


def needed_m(show: Show, first: TimedTrack, second: TimedTrack) -> float:
    """How far apart the tracks of two have to be, m.

    The show's distance between aircraft, both tubes, and the way that either flies in the time by
    which its clock may be wrong.
    """
    late = SKEW_S * sum(math.hypot(*track.fastest) for track in (first, second))
    return show.least_distance_m + first.tube_m + second.tube_m + late


def check(show: Show, envelope: Envelope | None = None) -> Report:
    """Check each aircraft by itself, and all of them together.

    Args:
        show: The show.
        envelope: Envelope of the agents' guards; by default that of :class:`m100link.Guards`.
    """
    problems = [*chain.from_iterable(_alone(one, envelope or Envelope()) for one in show.tracks)]
    windows, there = Windows(show.tracks), places(show)
    problems += _together(show, windows)
    return Report(tuple(problems), tuple(_remarks(show, there)), _closest(show, windows, there))


# -- one aircraft ---------------------------------------------------------------------------------


def _alone(track: TimedTrack, envelope: Envelope) -> Iterator[BadShow]:
    """The faults of one track by its guards or its autopilot."""
    spots = [(point.north, point.east) for point in track.points]
    far = max(math.dist(spots[0], spot) for spot in spots)  # it takes off below its first point
    highest = max(point.height for point in track.points) - track.ground_m
    lowest = min(point.height for point in track.points) - track.ground_m
    across, upright = track.fastest
    try:
        envelope.check(track.name, height=highest, far=far)
    except GuardRefused as error:
        yield BadShow(error.seen, aircraft=(track.name,), remedy=error.remedy)
    if lowest < 1.0:
        yield BadShow(
            f"{track.name} flies {lowest:.1f} m above its take-off point",
            aircraft=(track.name,),
            measured=lowest,
            limit=1.0,
            cause="heights count from the show's origin, ground_m says where it stands",
            remedy="1 m or more above the ground",
        )
    if across > _SPARE * envelope.max_speed_m_s:
        yield _too_much(track, 0, across, _SPARE * envelope.max_speed_m_s)
    if upright > CLIMB_M_S:
        yield _too_much(track, 1, upright, CLIMB_M_S)
    for leg in track.legs:
        if leg.hardest_m_s2 > ACCELERATION_M_S2:
            needed_s = leg.duration * math.sqrt(leg.hardest_m_s2 / ACCELERATION_M_S2)
            yield BadShow(
                f"{track.name} accelerates by {leg.hardest_m_s2:.1f} m/s² between {leg.begin:g} "
                f"and {leg.end:g} s; {ACCELERATION_M_S2:g} m/s² are allowed",
                aircraft=(track.name,),
                at=leg.begin,
                measured=leg.hardest_m_s2,
                limit=ACCELERATION_M_S2,
                remedy=f"give it {needed_s:.1f} s, or add points where it turns",
            )
            return  # the others are mostly neighbours of the same corner


def _too_much(track: TimedTrack, which: int, speed: float, limit: float) -> BadShow:
    """One leg that is too fast, horizontally or vertically: the fastest."""
    leg = max(track.legs, key=lambda leg: leg.fastest[which])
    does = "climbs or descends at" if which else "flies"
    return BadShow(
        f"{track.name} {does} {speed:.1f} m/s between {leg.begin:g} and {leg.end:g} s, "
        f"{limit:g} m/s are allowed",
        aircraft=(track.name,),
        at=leg.begin,
        measured=speed,
        limit=limit,
        cause="between two points it begins and ends slowly and is 1.5 times as fast in the middle",
        remedy=f"give it {leg.duration * speed / limit:.1f} s, or a shorter path",
    )


# -- all of them ----------------------------------------------------------------------------------


def _together(show: Show, windows: Windows) -> Iterator[BadShow]:
    for first, second in combinations(show.tracks, 2):
        for which, word in ((0, "take off"), (-1, "end")):
            a, b = first.points[which], second.points[which]
            apart = math.dist((a.north, a.east), (b.north, b.east))
            needed = show.least_distance_m + first.tube_m + second.tube_m
            if apart < needed:
                yield BadShow(
                    f"{first.name} and {second.name} {word} {apart:.1f} m from each other, seen "
                    f"from above; {needed:.1f} m are needed",
                    aircraft=(first.name, second.name),
                    at=0.0 if which == 0 else show.duration,
                    measured=apart,
                    limit=needed,
                    cause="each climbs to its first point, and may land below its last one",
                    remedy="move one of them aside",
                )
    fastest = max(math.hypot(*track.fastest) for track in show.tracks)
    widest = max(track.tube_m for track in show.tracks)
    near = windows.near(show.least_distance_m + 2 * (widest + SKEW_S * fastest))
    for first, second, distance, at in under(show.tracks, partial(needed_m, show), near):
        needed = needed_m(show, first, second)
        yield BadShow(
            f"{first.name} and {second.name} come as near as {distance:.1f} m at {at:.2f} s; "
            f"{needed:.1f} m are needed",
            aircraft=(first.name, second.name),
            at=at,
            measured=distance,
            limit=needed,
            cause=f"{show.least_distance_m:g} m between aircraft, their tubes of "
            f"{first.tube_m:g} and {second.tube_m:g} m, and clocks that differ by {SKEW_S:g} s",
            remedy="move a point, or let one pass later",
        )


def _closest(show: Show, windows: Windows, there: Sequence[Places]) -> Closest | None:
    if len(show.tracks) < 2:
        return None
    # No farther than at one of these moments, and a millimetre more: that one itself is found.
    below = min(distance for _, distance in _least(show, there)) + 1e-3
    best: Closest | None = None
    for (i, j), spans in windows.near(below).items():
        first, second = show.tracks[i], show.tracks[j]
        found = closest(first, second, below=below, during=spans)
        if found is not None:
            below, at = found
            best = Closest(at, first.name, second.name, below, needed_m(show, first, second))
    return best


Places = tuple[float, list[Vector]]
"""Seconds from the beginning of the show, and where each aircraft is."""


def places(show: Show) -> list[Places]:
    """Where each one is at a few hundred moments: for a picture, and for what may surprise."""
    return [
        (at, [track.moment(at).place for track in show.tracks])
        for at in (show.duration * index / _SAMPLES for index in range(_SAMPLES + 1))
    ]


def distances(show: Show) -> list[tuple[float, float]]:
    """Time and least distance of any two at a few hundred moments; nothing for one aircraft."""
    return list(_least(show, places(show)))


def _least(show: Show, there: Sequence[Places]) -> Iterator[tuple[float, float]]:
    ends = [track.end for track in show.tracks]
    for at, spots in there if len(ends) > 1 else ():

        def distance(i: int, j: int, at: float = at, spots: Sequence[Vector] = spots) -> float:
            ended = {"first_ended": at >= ends[i], "second_ended": at >= ends[j]}
            return apart(spots[i], spots[j], **ended)

        # No farther than one of those that are neighbours from south to north.
        order = sorted(range(len(spots)), key=spots.__getitem__)
        within = min(distance(i, j) for i, j in pairwise(order))
        boxes = [_spot(spot, at >= end) for spot, end in zip(spots, ends, strict=True)]
        nearer = overlapping(boxes, within)
        yield at, min((distance(i, j) for i, j in nearer), default=within)


def _spot(spot: Vector, has_ended: bool) -> Box:
    north, east, up = spot
    return north, north, east, east, -math.inf if has_ended else up, up


def _remarks(show: Show, there: Sequence[Places]) -> Iterator[str]:
    """Ground that is not level, and aircraft above others: one that fails falls on them."""
    if any(ground := [track.ground_m for track in show.tracks]):
        points = f"take-off points are {min(ground):g} to {max(ground):g} m above the origin"
        yield f"{points}: on level ground the heights are wrong"
    reported: set[tuple[int, int]] = set()
    for at, spots in there:
        boxes = [_spot((*spot[:2], 0.0), has_ended=True) for spot in spots]
        for i, j in sorted(overlapping(boxes, show.least_distance_m)):
            pair = (i, j) if spots[i][2] > spots[j][2] else (j, i)
            if pair not in reported:
                reported.add(pair)
                upper, lower = (show.tracks[one].name for one in pair)
                words = "if it fails or lands there, it falls on it"
                yield f"{upper} is above {lower} at {at:.1f} s: {words}"


# -- A show as a picture ---------------------------------------------------------------------------

_WIDTH, _MAP, _CURVE, _EDGE = 640.0, 420.0, 150.0, 32.0
_NAMED = 30
"""So many aircraft have room for their names."""


def svg(show: Show, report: Report) -> str:
    """The tracks from above, north up and equal scales; below, the least distance over time."""
    label = f"{show.name or 'A show'}: {len(show.tracks)} aircraft, {show.duration:g} s"
    parts = [*_from_above(show), *_apart(show, report)]
    return drawing((_WIDTH, _MAP + _CURVE), label, parts) + "\n"


def _colour(index: int, count: int) -> str:
    """A colour unlike those of its neighbours, on white and on black."""
    return f"hsl({360 * index // count},70%,45%)"


def _from_above(show: Show) -> Iterator[str]:
    ways = list(zip(*(there for _, there in places(show)), strict=True))
    view = MapView([place[:2] for way in ways for place in way], (_WIDTH, _MAP), _EDGE)
    for index, (track, way) in enumerate(zip(show.tracks, ways, strict=True)):
        colour, spots = _colour(index, len(ways)), [view.spot(*place[:2]) for place in way]
        yield f"<g><title>{escaped(track.name)}</title>{svg_line(spots, colour)}"
        for point in track.points:
            spot, label = view.spot(point.north, point.east), f"{point.at:g} s: {point.height:g} m"
            yield svg_dot(spot, 2.5, colour, "none", f"{track.name}, {label}")
        yield f"{svg_dot(spots[0], 6, stroke=colour)}</g>"
        if len(ways) <= _NAMED:
            x, y = spots[0]
            yield svg_text((x + 8, y - 6), track.name, colour=colour)
    yield view.bar(8, _MAP - 2, 100)
    yield svg_text((_WIDTH - 8, 14), "N ↑", "end")


def _apart(show: Show, report: Report) -> Iterator[str]:
    found, nearest = distances(show), report.closest
    if nearest is None:
        return
    highest = max(nearest.needed_m, *(distance for _, distance in found)) * 1.05
    top, bottom, first, last = _MAP + 24, _MAP + _CURVE - 22, 44.0, _WIDTH - 12

    def spot(at: float, distance: float) -> Spot:
        return (
            first + at / show.duration * (last - first),
            bottom - distance / highest * (bottom - top),
        )

    yield svg_text((8, top - 8), "least distance of any two, m")
    yield svg_line([(first, top), (first, bottom), (last, bottom)])
    needed = [spot(at, nearest.needed_m) for at in (0.0, show.duration)]
    yield svg_line(needed, "crimson", more=' stroke-dasharray="5 4"')
    yield svg_text((last, needed[1][1] - 4), f"{nearest.needed_m:.1f} m needed", "end", "crimson")
    yield svg_line(spot(at, distance) for at, distance in found)
    x, y = spot(nearest.at, nearest.distance_m)
    words = (
        f"{nearest.first} and {nearest.second}: {nearest.distance_m:.1f} m at {nearest.at:.1f} s"
    )
    yield svg_dot((x, y), 4)
    at = "start" if x < _WIDTH / 2 else "end"
    yield svg_text((x + (8 if at == "start" else -8), min(y + 14, bottom - 4)), words, at)
    yield svg_text((first - 4, top + 4), f"{highest:.0f}", "end")
    yield svg_text((first - 4, bottom), "0", "end")
    yield svg_text((last, bottom + 14), f"{show.duration:g} s", "end")


# -- tracks of other programs, one file for each aircraft: CSV, or Skybrush's .skyb ----------------
# Both count metres from a place that they do not name. Skybrush's x points ahead, by default to the
# north, and y to the left of it.

_SAMPLE_S, _LONGEST_S = 0.25, 2500.0  # as many as a track may have points
_LARGEST = 1e5  # metres or seconds
_LEAST_M, _BEGIN_M_S2 = 1.0, 0.6  # as the check wants it: the spline makes 2.25 times that
_MS, _METRES = "time [msec]", ("x [m]", "y [m]", "z [m]")
_Sample = tuple[float, float, float, float]  # s; metres ahead, to the left and up


def imported(
    files: Sequence[Path], origin: tuple[float, float], *, orientation_deg: float = 0.0
) -> dict[str, Any]:
    """The show of these tracks, as its file has it; each aircraft is called like its file.

    An aircraft takes off and lands by itself: a track begins and ends at rest, 1 m or more above
    its first place. All begin later by as much as one needs for that.

    Args:
        files: A file for each aircraft, CSV or .skyb.
        origin: Latitude and longitude of their zero, degrees.
        orientation_deg: Where their x points, degrees clockwise from north.

    Raises:
        BadShow: A file cannot be read, or is no track.
    """
    ahead, right = math.cos(math.radians(orientation_deg)), math.sin(math.radians(orientation_deg))
    aircraft: list[dict[str, Any]] = []
    for path in files:
        try:
            samples = list(_samples(read_file(path)))
            ground = samples[0][3]
            if not all(abs(one) <= _LARGEST for one in chain.from_iterable(samples)):
                raise ValueError(f"a number is none, or is above {_LARGEST:g}")
            there = [samples[0]]
            there += (one for one in samples if one[0] - there[-1][0] >= _SAMPLE_S - 1e-9)
            there = _mirrored(_begun(_mirrored(_begun(there, ground)), ground))
        except BadPlan as error:
            raise BadShow(error.seen, cause=error.cause, remedy=error.remedy) from error
        except (ValueError, LookupError, TypeError, struct.error, csv.Error) as error:
            raise BadShow(
                f"{path} is no track: {error}",
                cause="it is damaged, or of another program",
                remedy=f"a .skyb of Skybrush, or CSV with the columns {_MS}, {', '.join(_METRES)}",
            ) from error
        points = []
        for at, x, y, z in there:
            north, east = x * ahead + y * right, x * right - y * ahead
            spot = {"at": at, "north": north, "east": east, "height": z}
            points.append({name: round(value, 3) for name, value in spot.items()})
        aircraft.append({"name": path.stem, "ground_m": round(ground, 3), "waypoints": points})
    if not aircraft:
        raise BadShow("no track was named", remedy="name a file for each aircraft")
    late = max(0.0, *(-one["waypoints"][0]["at"] for one in aircraft))  # no track begins before 0
    for point in chain.from_iterable(one["waypoints"] for one in aircraft if late):
        point["at"] = round(point["at"] + late, 3)
    place = dict(zip(("latitude_deg", "longitude_deg"), origin, strict=True))
    return {"format": FORMAT, "version": VERSION, "origin": place, "aircraft": aircraft}


def _begun(points: list[_Sample], ground: float) -> list[_Sample]:
    """A track from where it can be begun from a hover 1 m above the ground, and its way there."""
    for first in range(len(points) - 1):
        here, after = points[first : first + 2]
        velocity = [(b - a) / (after[0] - here[0]) for a, b in zip(here, after, strict=True)][1:]
        if here[3] - ground >= _LEAST_M + velocity[2] ** 2 / (2 * _BEGIN_M_S2):
            break
    else:
        raise ValueError("it is never high enough above its first place")
    lasts = math.hypot(*velocity) / _BEGIN_M_S2
    if lasts > _LONGEST_S:
        raise ValueError("nothing that flies is so fast")
    many, way = math.ceil(lasts / _SAMPLE_S), []
    for share in (step / many for step in range(many)):
        back = lasts * (1 - share * share) / 2  # s of this velocity
        x, y, z = (a - one * back for a, one in zip(here[1:], velocity, strict=True))
        way.append((here[0] - lasts * (1 - share), x, y, z))
    return way + points[first:]


def _mirrored(points: list[_Sample]) -> list[_Sample]:
    return [(-at, x, y, z) for at, x, y, z in reversed(points)]


def _samples(data: bytes) -> Iterator[_Sample]:
    if data[:4] == b"skyb":
        yield from _of_skybrush(data)
        return
    rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig")), skipinitialspace=True)
    rows.fieldnames = [name.strip().lower() for name in rows.fieldnames or ()]
    for row in rows:
        x, y, z = (float(row[name]) for name in _METRES)
        yield float(row[_MS]) / 1000, x, y, z


def _of_skybrush(data: bytes) -> Iterator[_Sample]:
    """The track in a file of version 1 or 2, as libskybrush reads it: Bézier curves.

    The first byte of each says how many points of an axis follow, two bits for x, y, z and yaw.
    """
    has_sum = data[4] == 2 and data[5] & 1
    if data[4] not in (1, 2):
        raise ValueError(f"version {data[4]} of .skyb")
    if has_sum and zlib.crc32(data[:6] + bytes(4) + data[10:], 0xFFFFFFFF) ^ 0xFFFFFFFF != (
        int.from_bytes(data[6:10], "little")
    ):
        raise ValueError("its checksum is wrong")
    at = 4 + data[4] + 4 * has_sum
    while (kind := data[at]) != 1:
        at += 3 + int.from_bytes(data[at + 1 : at + 3], "little")
    end = at + 3 + int.from_bytes(data[at + 1 : at + 3], "little")
    scale, here, when = (data[at + 3] & 0x7F) / 1000, struct.unpack_from("<hhh", data, at + 4), 0.0
    if not scale or kind != 1 or end > len(data):
        raise ValueError("it has no whole track")
    at += 12
    yield when, here[0] * scale, here[1] * scale, here[2] * scale
    while at < end:
        counts, seconds = data[at], int.from_bytes(data[at + 1 : at + 3], "little") / 1000
        axes, at = [], at + 3
        for axis in range(4):
            many = (1 << (counts >> 2 * axis & 3)) - 1
            axes.append((*here[axis : axis + 1], *struct.unpack_from(f"<{many}h", data, at)))
            at += 2 * many
        steps = math.ceil(seconds / _SAMPLE_S)
        for step in range(1, steps + 1):
            x, y, z = (_on_curve(one, step / steps) * scale for one in axes[:3])
            yield when + seconds * step / steps, x, y, z
        here, when = tuple(one[-1] for one in axes[:3]), when + seconds
        if when > _LONGEST_S:
            raise ValueError(f"it is longer than {_LONGEST_S:g} s")


def _on_curve(points: Sequence[float], share: float) -> float:
    """A Bézier curve of any degree, by de Casteljau."""
    while len(points) > 1:
        points = [a + (b - a) * share for a, b in pairwise(points)]
    return points[0]
