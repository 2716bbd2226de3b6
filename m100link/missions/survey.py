"""Patterns as plans: a survey, whose photographs overlap, and an orbit that looks at its centre."""

from __future__ import annotations

import math
from collections.abc import Sequence

from m100link.errors import UsageError
from m100link.geodesy import LocalFrame, normalize_degrees
from m100link.missions.checks import FASTEST_M_S, NEAREST_M
from m100link.missions.patterns import survey as lines_over
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import AtEnd, GimbalPitch, Heading, TakePhoto, Trace, Waypoint

_MOST_POINTS = 10_000  # more are a mistake in the units

_DOWN = -90.0
_DEGREES = "degrees north, -90 to 90, and degrees east, -180 to 180"

_AROUND = 24  # waypoints of an orbit without photographs: within 1 % of the circle

Place = tuple[float, float]  # latitude and longitude, °


def line_spacing(height: float, overlap: float, field_of_view_deg: float) -> float:
    """How far apart lines may be, m, so that photographs of neighbours overlap.

    >>> from m100link.missions.survey import line_spacing
    >>> round(line_spacing(30.0, 0.7, 81.0), 1)
    15.4

    Args:
        height: Above the ground, m.
        overlap: Part of a photograph that its neighbour shows again, 0 to less than 1.
        field_of_view_deg: Of the camera across the lines, °: about 81 for a Zenmuse X3.

    Raises:
        UsageError: One of them is out of range.
    """
    if not 0 < height < math.inf or not 0 <= overlap < 1 or not 0 < field_of_view_deg < 180:
        raise UsageError(
            f"height {height:g} m, overlap {overlap:g} and a field of view of "
            f"{field_of_view_deg:g}° make no survey",
            remedy="a height above 0, an overlap of 0 to 0.95, a field of view below 180°",
        )
    seen = 2.0 * height * math.tan(math.radians(field_of_view_deg) / 2.0)
    return seen * (1.0 - overlap)


def survey(
    area: Sequence[Place],
    *,
    height: float,
    spacing: float,
    angle_deg: float = 0.0,
    photo_every: float | None = None,
    speed: float = 5.0,
    start: Place | None = None,
    at_end: AtEnd = AtEnd.HOVER,
) -> WaypointPlan:
    """Parallel lines over an area, to and fro.

    >>> from m100link.missions.survey import line_spacing, survey
    >>> field = [(52.1, 4.31), (52.1005, 4.31), (52.1005, 4.3108), (52.1, 4.3108)]
    >>> plan = survey(field, height=30, spacing=line_spacing(30, 0.7, 81))
    >>> len(plan.waypoints), round(plan.length_m)
    (8, 264)

    Args:
        area: Corners of a polygon in their order, latitude and longitude, °; 3 or more. Edges must
            not cross. It may be concave: the way between two parts of a line leads outside of it.
        height: Of all waypoints above the take-off point, m.
        spacing: Between lines, m; they lie half of it from the edges, or nearer.
        angle_deg: Direction of the lines, ° clockwise from north.
        photo_every: Metres between photographs along a line at most, which are waypoints with the
            camera straight down; None takes none. Where that would put waypoints nearer than 2 m,
            there is one photograph less on the line. A plan has 99 waypoints at most.
        speed: Along the way, m/s.
        start: Where the aircraft comes from: the pattern begins at its end nearest to that.
        at_end: Action after the last waypoint.

    Raises:
        UsageError: No polygon, or a spacing that makes no lines.
        BadPlan: The aircraft would refuse it: more than 99 waypoints, or too far between them.
    """
    if len(area) < 3:
        raise UsageError(f"{len(area)} corners make no polygon", remedy="3 or more")
    photo_every = _checked_distance(photo_every)
    try:
        frame = LocalFrame(*area[0])
        for corner in area:
            LocalFrame(*corner)  # which knows what a place is
        corners = [frame.to_local(*corner) for corner in area]
        origin = (0.0, 0.0) if start is None else frame.to_local(*start)
    except ValueError as error:
        raise UsageError(f"a corner is not a place: {error}", remedy=_DEGREES) from None
    ends = lines_over(corners, spacing=spacing, height=height, angle_deg=angle_deg, start=origin)
    way = [point[:2] for point in ends]
    if photo_every is not None:
        way = _with_photographs(way, photo_every)
    actions = () if photo_every is None else (TakePhoto(),)
    first = () if photo_every is None else (GimbalPitch(_DOWN), TakePhoto())
    return WaypointPlan(
        [
            Waypoint(*frame.to_geodetic(*place), height=height, actions=actions if index else first)
            for index, place in enumerate(_apart(way))
        ],
        speed=speed,
        max_speed=_fastest(speed),
        at_end=at_end,
    )


def orbit(
    centre: Place,
    *,
    radius: float,
    height: float,
    photo_every: float | None = None,
    speed: float = 5.0,
    start: Place | None = None,
    at_end: AtEnd = AtEnd.HOVER,
) -> WaypointPlan:
    """Once around a place, clockwise; nose and camera point to its ground.

    >>> from m100link.missions.survey import orbit
    >>> plan = orbit((52.1, 4.31), radius=40, height=30)
    >>> len(plan.waypoints), round(plan.length_m)
    (25, 251)

    Args:
        centre: Latitude and longitude, °.
        radius: 5 to 500 m.
        height: Of all waypoints above the take-off point, m. The camera looks so far down, as if
            the ground of the centre were as high as that point.
        photo_every: Metres between photographs along the circle at most; the aircraft stops at
            each. None takes none, and the aircraft rounds the waypoints.
        speed: Along the way, m/s.
        start: Where the aircraft comes from: the orbit begins at its point nearest to that.
        at_end: Action after the last waypoint, which is the first one.

    Raises:
        UsageError: A value out of range.
        BadPlan: The aircraft would refuse it: more than 99 waypoints.
    """
    if not 5.0 <= radius <= 500.0:
        raise UsageError(f"an orbit of {radius:g} m cannot be flown", remedy="5 to 500 m")
    photo_every = _checked_distance(photo_every)
    try:
        frame = LocalFrame(*centre)
        north, east = (1.0, 0.0) if start is None else frame.to_local(*start)
    except ValueError as error:
        raise UsageError(f"the centre is not a place: {error}", remedy=_DEGREES) from None
    # Corners of a regular polygon, further apart than neighbours have to be.
    most = math.floor(math.pi / math.asin(0.51 * NEAREST_M / radius))
    wanted = _AROUND if photo_every is None else max(3, math.ceil(math.tau * radius / photo_every))
    count = min(wanted, most)
    step, first = 360.0 / count, math.degrees(math.atan2(east, north))
    damping = 0.0 if photo_every is not None else 0.4 * math.tau * radius / count
    pitch = -math.degrees(math.atan2(max(height, 0.0), radius))
    points = []
    for angle in (math.radians(first + index * step) for index in range(count + 1)):
        place = frame.to_geodetic(radius * math.cos(angle), radius * math.sin(angle))
        points.append(
            Waypoint(
                *place,
                height=height,
                heading_deg=normalize_degrees(round(math.degrees(angle) + 180.0)),
                gimbal_pitch_deg=pitch,
                damping=damping,
                actions=() if photo_every is None else (TakePhoto(),),
            )
        )
    return WaypointPlan(
        points,
        speed=speed,
        max_speed=_fastest(speed),
        heading=Heading.BY_WAYPOINT,
        trace=Trace.COORDINATED_TURNS if photo_every is None else Trace.STOP_AT_POINTS,
        at_end=at_end,
        gimbal_by_waypoint=True,
    )


def _checked_distance(photo_every: float | None) -> float | None:
    if photo_every is not None and not photo_every >= NEAREST_M:
        raise UsageError(
            f"photographs cannot be {photo_every:g} m apart",
            remedy=f"{NEAREST_M:g} m or more: each is a waypoint",
        )
    return photo_every


def _fastest(speed: float) -> float:
    return min(max(speed, 10.0), FASTEST_M_S)


def _with_photographs(ends: Sequence[Place], every: float) -> list[Place]:
    """Each line, which is two of the ends, with points at most so far apart, or hardly further."""
    found: list[Place] = []
    for here, there in zip(ends[::2], ends[1::2], strict=True):
        length = math.dist(here, there)
        # Points that are too near to each other would be left out, and with them photographs.
        most = math.floor(length / NEAREST_M - 1e-6)
        parts = max(1, min(math.ceil(length / every - 1e-9), most))
        if len(found) + parts > _MOST_POINTS:
            raise UsageError(
                f"photographs every {every:g} m are more than {_MOST_POINTS}",
                remedy="further apart, or a smaller area",
            )
        found += [
            (
                here[0] + (there[0] - here[0]) * part / parts,
                here[1] + (there[1] - here[1]) * part / parts,
            )
            for part in range(parts + 1)
        ]
    return found


def _apart(way: Sequence[Place]) -> list[Place]:
    """Without what is too near to the place before, as in the tip of a triangle."""
    found = [way[0]]
    for place in way[1:]:
        if math.dist(place, found[-1]) > NEAREST_M:
            found.append(place)
    return found
