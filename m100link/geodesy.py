"""Where things are on the Earth: metres north and east, latitude and longitude, distance, bearing.

Pure functions of plain numbers, shared by both ends of the cable: the virtual aircraft turns its
track into the position item, a host turns two positions into a setpoint. Angles are degrees here;
the wire has radians, and the telemetry layout converts them.

Three answers of different worth:

* :class:`LocalFrame`: metres north and east of one point along the WGS84 ellipsoid. Within 0.01 mm
  at 1 km and 3 mm at 5 km, up to 80 degrees of latitude.
* :func:`geodesic`: length and bearing of the shortest line on the ellipsoid, any two points.
* :func:`dji_offset`: the sphere that DJI's sample programs use. Up to 0.7 % wrong (7 m in a
  kilometre) but it is what those programs compute, so it has a name.

The maps of plans, shows, logs and notebooks are drawn by :class:`MapView`: text in, text out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

__all__ = [
    "DJI_EARTH_RADIUS_M",
    "WGS84_FLATTENING",
    "WGS84_SEMI_MAJOR_AXIS_M",
    "LocalFrame",
    "bearing_deg",
    "destination",
    "distance_m",
    "dji_offset",
    "geodesic",
    "normalize_degrees",
]

WGS84_SEMI_MAJOR_AXIS_M = 6_378_137.0
WGS84_FLATTENING = 1 / 298.257223563
DJI_EARTH_RADIUS_M = 6_378_137.0
"""The radius in DJI's position-loop samples (their programming guide, 2016)."""

_E2 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)
_MAXIMUM_FRAME_LATITUDE_DEG = 89.0
_SERIES_REACH_M = 200_000.0
_POLAR_REACH = 0.3  # of the distance in which meridians meet, beyond which no step gets nearer


def normalize_degrees(angle: float) -> float:
    """The same direction in -180 (excluded) to 180 (included) degrees.

    >>> normalize_degrees(270.0), normalize_degrees(-180.0)
    (-90.0, 180.0)
    """
    angle = math.fmod(angle, 360.0)
    if angle > 180.0:
        return angle - 360.0
    return angle + 360.0 if angle <= -180.0 else angle


class LocalFrame:
    """The plane that touches the WGS84 ellipsoid at one point: metres north and east of it.

    The conversion is the series of the tangent plane around the origin, to third order, its
    coefficients computed once; each call is a handful of multiplications, cheap enough for every
    telemetry packet. (Multiplying degrees by two radii, the usual six lines, is the same
    series cut after the first order: 14 cm wrong at 1 km and 60 degrees of latitude, because a
    parallel of latitude curves away from the east axis.)

    >>> frame = LocalFrame(22.54, 113.95)
    >>> latitude, longitude = frame.to_geodetic(1000.0, 0.0)
    >>> round(latitude, 7), longitude
    (22.5490303, 113.95)
    """

    __slots__ = (
        "_ee",
        "_eee",
        "_longitude_e",
        "_longitude_ne",
        "_longitude_nne",
        "_n",
        "_nee",
        "_nn",
        "_reach_m",
        "latitude_deg",
        "longitude_deg",
    )

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        """Touch the ellipsoid at this point.

        Args:
            latitude_deg: -89 to 89; nearer to a pole, east has no useful meaning.
            longitude_deg: -360 to 360; results are normalised to -180...180. Far beyond, the
                difference of two longitudes loses one of them.

        Raises:
            ValueError: The latitude or the longitude is outside its range.
        """
        if not abs(latitude_deg) <= _MAXIMUM_FRAME_LATITUDE_DEG:
            raise ValueError(f"latitude must lie within ±89 degrees, got {latitude_deg}")
        if not abs(longitude_deg) <= 360:
            raise ValueError(f"longitude must lie within ±360 degrees, got {longitude_deg}")
        self.latitude_deg = latitude_deg
        self.longitude_deg = normalize_degrees(longitude_deg)
        latitude = math.radians(latitude_deg)
        sine, cosine = math.sin(latitude), math.cos(latitude)
        tangent = sine / cosine
        w2 = 1.0 - _E2 * sine * sine
        across = WGS84_SEMI_MAJOR_AXIS_M / math.sqrt(w2)  # radius in the prime vertical, N
        along = across * (1.0 - _E2) / w2  # radius in the meridian, M
        to_degrees = math.degrees(1.0)
        # Latitude: the meridian's own curvature changes with latitude (nn), a step to the east
        # leaves the parallel towards the equator (ee).
        self._n = to_degrees / along
        self._nn = -to_degrees * 1.5 * _E2 * sine * cosine / (w2 * along * along)
        self._ee = -to_degrees * tangent / (2.0 * along * across)
        self._nee = -to_degrees * (1.0 + 3.0 * tangent * tangent) / (6.0 * along * across * across)
        # Longitude: meridians close up towards the pole (ne, nne), so does the east axis (eee).
        self._longitude_e = to_degrees / (across * cosine)
        self._longitude_ne = to_degrees * tangent / (across * across * cosine)
        third = to_degrees / (across**3 * cosine)
        self._longitude_nne = third * (1.0 + 3.0 * tangent * tangent) / 3.0
        self._eee = -third * tangent * tangent / 3.0
        meeting = across / abs(tangent) if tangent else math.inf
        self._reach_m = min(_SERIES_REACH_M, _POLAR_REACH * meeting)

    def to_geodetic(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude in degrees of a point given in metres from the origin."""
        nn, ee = north * north, east * east
        latitude = (
            self.latitude_deg
            + self._n * north
            + self._nn * nn
            + (self._ee + self._nee * north) * ee
        )
        longitude = self.longitude_deg + east * (
            self._longitude_e
            + self._longitude_ne * north
            + self._longitude_nne * nn
            + self._eee * ee
        )
        if not -180.0 < longitude <= 180.0:
            longitude = normalize_degrees(longitude)
        return latitude, longitude

    def to_local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Metres north and east of the origin of a point in degrees: the inverse, to a micrometre.

        Newton steps with the first-order coefficients: each shrinks the error by about the ratio
        of distance to the Earth's radius, so three or four are the rule. Beyond 200 km (33 km at 89
        degrees of latitude), where the series means nothing any more: distance and direction of the
        shortest line.
        """
        east_of_origin = normalize_degrees(longitude_deg - self.longitude_deg)
        north = (latitude_deg - self.latitude_deg) / self._n
        east = east_of_origin / self._longitude_e
        if math.hypot(north, east) > self._reach_m:
            distance, bearing = geodesic(
                self.latitude_deg, self.longitude_deg, latitude_deg, longitude_deg
            )
            bearing = math.radians(bearing)
            return distance * math.cos(bearing), distance * math.sin(bearing)
        for _ in range(20):
            latitude, longitude = self.to_geodetic(north, east)
            step_north = (latitude_deg - latitude) / self._n
            step_east = normalize_degrees(longitude_deg - longitude) / self._longitude_e
            north += step_north
            east += step_east
            if abs(step_north) + abs(step_east) < 1e-7:
                break
        return north, east


def geodesic(
    latitude_1_deg: float, longitude_1_deg: float, latitude_2_deg: float, longitude_2_deg: float
) -> tuple[float, float]:
    """Length in metres of the shortest line between two points and its bearing at the first.

    Vincenty's inverse formula on WGS84, good to a millimetre. Nearly opposite points, where its
    iteration does not settle, get the great circle of the mean sphere instead (0.5 %).

    Returns:
        The distance in metres and the bearing in -180...180 degrees, 0 north, 90 east.

    >>> distance, bearing = geodesic(0.0, 0.0, 0.0, 1.0)
    >>> round(distance, 3), bearing
    (111319.491, 90.0)
    """
    flattening = WGS84_FLATTENING
    reduced_1 = math.atan((1 - flattening) * math.tan(math.radians(latitude_1_deg)))
    reduced_2 = math.atan((1 - flattening) * math.tan(math.radians(latitude_2_deg)))
    sin_1, cos_1 = math.sin(reduced_1), math.cos(reduced_1)
    sin_2, cos_2 = math.sin(reduced_2), math.cos(reduced_2)
    difference = math.radians(normalize_degrees(longitude_2_deg - longitude_1_deg))
    lam = difference
    for _ in range(50):
        sin_lam, cos_lam = math.sin(lam), math.cos(lam)
        y, x = cos_2 * sin_lam, cos_1 * sin_2 - sin_1 * cos_2 * cos_lam
        sin_sigma = math.hypot(x, y)
        if sin_sigma == 0.0:
            return 0.0, 0.0
        cos_sigma = sin_1 * sin_2 + cos_1 * cos_2 * cos_lam
        sigma = math.atan2(sin_sigma, cos_sigma)
        sin_alpha = cos_1 * cos_2 * sin_lam / sin_sigma
        cos2_alpha = 1.0 - sin_alpha * sin_alpha
        cos_2m = cos_sigma - 2.0 * sin_1 * sin_2 / cos2_alpha if cos2_alpha > 1e-15 else 0.0
        c = flattening / 16 * cos2_alpha * (4 + flattening * (4 - 3 * cos2_alpha))
        series = cos_2m + c * cos_sigma * (2 * cos_2m * cos_2m - 1)
        previous, lam = (
            lam,
            difference + (1 - c) * flattening * sin_alpha * (sigma + c * sin_sigma * series),
        )
        if abs(lam - previous) < 1e-13:
            distance = _vincenty_length(cos2_alpha, sigma, sin_sigma, cos_sigma, cos_2m)
            return distance, normalize_degrees(math.degrees(math.atan2(y, x)))
    return _great_circle(latitude_1_deg, latitude_2_deg, difference)


def _vincenty_length(
    cos2_alpha: float, sigma: float, sin_sigma: float, cos_sigma: float, cos_2m: float
) -> float:
    semi_minor = WGS84_SEMI_MAJOR_AXIS_M * (1 - WGS84_FLATTENING)
    u2 = cos2_alpha * (WGS84_SEMI_MAJOR_AXIS_M**2 - semi_minor**2) / semi_minor**2
    a = 1 + u2 / 16384 * (4096 + u2 * (-768 + u2 * (320 - 175 * u2)))
    b = u2 / 1024 * (256 + u2 * (-128 + u2 * (74 - 47 * u2)))
    last = b / 6 * cos_2m * (4 * sin_sigma * sin_sigma - 3) * (4 * cos_2m * cos_2m - 3)
    correction = cos_2m + b / 4 * (cos_sigma * (2 * cos_2m * cos_2m - 1) - last)
    return semi_minor * a * (sigma - b * sin_sigma * correction)


def _great_circle(latitude_1: float, latitude_2: float, difference: float) -> tuple[float, float]:
    phi_1, phi_2 = math.radians(latitude_1), math.radians(latitude_2)
    y = math.cos(phi_2) * math.sin(difference)
    x = math.cos(phi_1) * math.sin(phi_2) - math.sin(phi_1) * math.cos(phi_2) * math.cos(difference)
    z = math.sin(phi_1) * math.sin(phi_2) + math.cos(phi_1) * math.cos(phi_2) * math.cos(difference)
    mean_radius = WGS84_SEMI_MAJOR_AXIS_M * (1 - WGS84_FLATTENING / 3)
    bearing = normalize_degrees(math.degrees(math.atan2(y, x)))
    return mean_radius * math.atan2(math.hypot(x, y), z), bearing


def distance_m(
    latitude_1_deg: float, longitude_1_deg: float, latitude_2_deg: float, longitude_2_deg: float
) -> float:
    """Metres along the ellipsoid between two points (see :func:`geodesic`)."""
    return geodesic(latitude_1_deg, longitude_1_deg, latitude_2_deg, longitude_2_deg)[0]


def bearing_deg(
    latitude_1_deg: float, longitude_1_deg: float, latitude_2_deg: float, longitude_2_deg: float
) -> float:
    """Direction of the second point seen from the first, -180...180 degrees, 90 is east."""
    return geodesic(latitude_1_deg, longitude_1_deg, latitude_2_deg, longitude_2_deg)[1]


def destination(
    latitude_deg: float, longitude_deg: float, north: float, east: float
) -> tuple[float, float]:
    """The point so many metres north and east of another, in degrees."""
    return LocalFrame(latitude_deg, longitude_deg).to_geodetic(north, east)


def dji_offset(
    from_latitude_deg: float,
    from_longitude_deg: float,
    to_latitude_deg: float,
    to_longitude_deg: float,
) -> tuple[float, float]:
    """Metres north and east between two points the way DJI's sample programs compute them.

    A sphere of radius 6378137 m, the cosine of the mean latitude. For comparing with those
    programs; :meth:`LocalFrame.to_local` is the right one.
    """
    mean = math.radians((from_latitude_deg + to_latitude_deg) / 2.0)
    north = math.radians(to_latitude_deg - from_latitude_deg) * DJI_EARTH_RADIUS_M
    turn = normalize_degrees(to_longitude_deg - from_longitude_deg)
    return north, math.radians(turn) * DJI_EARTH_RADIUS_M * math.cos(mean)


# -- maps: SVG, north up and equal scales, in the colours of the text around them ------------------

Spot = tuple[float, float]
"""A place in a drawing: to the right and down from its upper left corner, in its units."""

_TRACK, _MARGIN, _FOOT = 300.0, 12.0, 34.0
_MOST_POINTS = 600


class MapView:
    """Where metres north and east of one point stand in a box of a drawing: as large as fits.

    ``least_m``: less is not drawn larger; what stands still is a point, not its noise.
    """

    def __init__(
        self,
        places: Sequence[tuple[float, float]],
        size: tuple[float, float],
        edge: float,
        *,
        least_m: float = 1.0,
    ) -> None:
        norths, easts = zip(*places, strict=True)
        width, height = size
        north, east = max(norths) - min(norths), max(easts) - min(easts)
        room_x, room_y = width - 2 * edge, height - 2 * edge
        self.scale = min(room_x / max(east, least_m), room_y / max(north, least_m))
        self._left = (width - east * self.scale) / 2 - min(easts) * self.scale
        self._top = (height - north * self.scale) / 2 + max(norths) * self.scale

    def spot(self, north: float, east: float) -> Spot:
        """Where a place is in the drawing."""
        return self._left + east * self.scale, self._top - north * self.scale

    def bar(self, x: float, y: float, most: float) -> str:
        """A scale bar from there to the right, at most so long in the drawing, and its length."""
        metres = round_length(most / self.scale)
        long = metres * self.scale
        drawn = f'<path d="M{x:g} {y - 4:g}v4h{long:.1f}v-4" fill="none" stroke="currentColor"/>'
        return drawn + svg_text((x + long + 6, y), f"{metres:g} m")


def round_length(most: float) -> float:
    """The longest of 1, 2, 5, 10, … that is not longer."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1, 2, 5) if step * power <= most)


def svg(size: tuple[float, float], label: str, parts: Iterable[str]) -> str:
    """A drawing of those parts; ``label`` is for those who do not see it."""
    width, height = size
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width:g}" style="max-width:100%;height:auto" role="img" '
        f'aria-label="{escaped(label)}" font-family="sans-serif" font-size="11" '
        f'fill="currentColor">{"".join(parts)}</svg>'
    )


def svg_line(
    spots: Iterable[Spot], colour: str = "currentColor", width: float = 1.5, more: str = ""
) -> str:
    """A line through all of them."""
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in spots)
    more = f'stroke="{colour}" stroke-width="{width:g}"{more}'
    return f'<polyline points="{points}" fill="none" {more}/>'


def svg_text(spot: Spot, words: str, at: str = "start", colour: str = "currentColor") -> str:
    """Words that begin, have their middle or end there: ``start``, ``middle``, ``end``."""
    x, y = spot
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{at}" fill="{colour}">{escaped(words)}</text>'
    )


def svg_dot(
    spot: Spot, radius: float, fill: str = "none", stroke: str = "currentColor", title: str = ""
) -> str:
    """A ring or a dot there; ``title`` is what a pointer over it shows."""
    end = f"><title>{escaped(title)}</title></circle>" if title else "/>"
    x, y = spot
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="{fill}" stroke="{stroke}"{end}'


def escaped(words: str) -> str:
    """Without ``html.escape``, whose module brings a table of all entities."""
    for plain, written in ("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;"):
        words = words.replace(plain, written)
    return words


def track_svg(places: Iterable[tuple[float, float]]) -> str:
    """A track seen from above, for a notebook; empty of none.

    A ring is where it begins, a dot where it ends. ``places`` are latitude and longitude, degrees,
    in order; what is not a number, or so near to a pole that no frame is there, is passed over.
    """
    known = [
        place
        for place in places
        if all(map(math.isfinite, place)) and abs(place[0]) <= _MAXIMUM_FRAME_LATITUDE_DEG
    ]
    if not known:
        return ""
    frame = LocalFrame(*known[0])
    track = [frame.to_local(*place) for place in known[:: 1 + len(known) // _MOST_POINTS]]
    track.append(frame.to_local(*known[-1]))
    side = _TRACK + 2 * _MARGIN
    view = MapView(track, (side, side), _MARGIN)
    spots = [view.spot(*place) for place in track]
    parts = (
        svg_line(spots),
        svg_dot(spots[0], 5),
        svg_dot(spots[-1], 3, "currentColor"),
        view.bar(_MARGIN, side + _FOOT - _MARGIN, _TRACK / 2),
        svg_text((side - _MARGIN, side + _FOOT - _MARGIN), "N ↑", "end"),
    )
    return svg((side, side + _FOOT), "The track from above, north up", parts)


# -- ways ------------------------------------------------------------------------------------------

_MOST_PLACES = 3000
_LEAST_STEP_M = 0.1  # what moves less stands still
_GAP_S = 2.0  # after a longer silence nobody knows how it came there


class Place(NamedTuple):
    """A place: time, s, metres north, east and up, and whether no silence was before it."""

    at_s: float
    north_m: float
    east_m: float
    height_m: float
    is_joined: bool


class Track:
    """Places that were passed, each a step from the one before.

    Attributes:
        length_m: How long it is.
        thinned: How often every second place was dropped, so far.
    """

    __slots__ = ("_heard_at_s", "_places", "_step_m", "length_m", "thinned")

    def __init__(self) -> None:
        self.length_m = 0.0
        self.thinned = 0
        self._step_m = _LEAST_STEP_M
        self._places: list[Place] = []
        self._heard_at_s = 0.0

    def add(self, at_s: float, north_m: float, east_m: float, height_m: float = 0.0) -> None:
        """It was there at a time, s: joined to the earlier places, unless it was silent for 2 s."""
        is_joined = at_s - self._heard_at_s <= _GAP_S
        self._heard_at_s = at_s
        new = Place(at_s, north_m, east_m, height_m, is_joined and bool(self._places))
        if self._places:
            step = _apart(self._places[-1], new)
            if is_joined and step < self._step_m:
                return
            self.length_m += step
        self._places.append(new)
        if len(self._places) > _MOST_PLACES:
            self._step_m *= 2.0
            self.thinned += 1
            kept = self._places[:1]
            for place in self._places[1:]:
                if not place.is_joined or _apart(kept[-1], place) >= self._step_m:
                    kept.append(place)
            self._places = kept[-_MOST_PLACES:]

    def places(self, since: int = 0) -> list[Place]:
        """The places in order, without the first so many."""
        return self._places[since:]


def _apart(one: Place, other: Place) -> float:
    return math.hypot(other.north_m - one.north_m, other.east_m - one.east_m)
