"""Geodesy against an independent library, against Earth-centred coordinates, and by hand."""

from __future__ import annotations

import math
import random
import xml.etree.ElementTree as ET

import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given
from hypothesis import strategies as st

from m100link import geodesy
from m100link.geodesy import (
    LocalFrame,
    MapView,
    bearing_deg,
    destination,
    distance_m,
    dji_offset,
    geodesic,
    round_length,
    svg,
    svg_dot,
    svg_text,
    track_svg,
)
from tests import limits

LATITUDES = [-80.0, -33.0, 0.0, 22.5, 47.0, 60.0, 80.0]


def earth_centred(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
    flattening = geodesy.WGS84_FLATTENING
    e2 = flattening * (2 - flattening)
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    radius = geodesy.WGS84_SEMI_MAJOR_AXIS_M / math.sqrt(1 - e2 * math.sin(latitude) ** 2)
    return (
        radius * math.cos(latitude) * math.cos(longitude),
        radius * math.cos(latitude) * math.sin(longitude),
        radius * (1 - e2) * math.sin(latitude),
    )


def tangent_plane(origin: tuple[float, float], point: tuple[float, float]) -> tuple[float, float]:
    """Metres north and east by rotation of Earth-centred coordinates."""
    dx, dy, dz = (b - a for a, b in zip(earth_centred(*origin), earth_centred(*point), strict=True))
    latitude, longitude = map(math.radians, origin)
    flat = math.cos(longitude) * dx + math.sin(longitude) * dy
    north = -math.sin(latitude) * flat + math.cos(latitude) * dz
    return north, -math.sin(longitude) * dx + math.cos(longitude) * dy


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize(("distance", "tolerance"), [(100, 1e-6), (1000, 1e-5), (5000, 3e-3)])
def test_local_frame_agrees_with_the_geodesic(
    latitude: float, distance: float, tolerance: float
) -> None:
    frame = LocalFrame(latitude, 113.9)
    for azimuth in range(0, 360, 15):
        north = distance * math.cos(math.radians(azimuth))
        east = distance * math.sin(math.radians(azimuth))
        point = frame.to_geodetic(north, east)
        line = Geodesic.WGS84.Inverse(latitude, 113.9, *point)
        along, bearing = line["s12"], math.radians(line["azi1"])
        assert along * math.cos(bearing) == pytest.approx(north, abs=tolerance)
        assert along * math.sin(bearing) == pytest.approx(east, abs=tolerance)


@pytest.mark.parametrize(
    ("latitude", "tolerance"),
    [(-60.0, 2e-3), (-33.0, 1e-3), (0.0, 1e-3), (22.5, 1e-3), (60.0, 2e-3)],
)
def test_each_term_of_the_third_order_shows_at_20_km(latitude: float, tolerance: float) -> None:
    """A term that is off by a third of itself would be a centimetre."""
    frame = LocalFrame(latitude, 113.9)
    for azimuth in range(0, 360, 15):
        turn = math.radians(azimuth)
        found = frame.to_geodetic(20_000 * math.cos(turn), 20_000 * math.sin(turn))
        line = Geodesic.WGS84.Direct(latitude, 113.9, azimuth, 20_000)
        off = Geodesic.WGS84.Inverse(*found, line["lat2"], line["lon2"])["s12"]
        assert off < tolerance, azimuth


@pytest.mark.parametrize("latitude", LATITUDES)
def test_local_frame_agrees_with_the_tangent_plane_at_1_km(latitude: float) -> None:
    frame = LocalFrame(latitude, -71.0)
    for azimuth in range(0, 360, 30):
        offset = 1000 * math.cos(math.radians(azimuth)), 1000 * math.sin(math.radians(azimuth))
        assert tangent_plane((latitude, -71.0), frame.to_geodetic(*offset)) == pytest.approx(
            offset, abs=1e-3
        )


@given(
    latitude=st.floats(-82, 82),
    longitude=st.floats(-180, 180),
    north=st.floats(-20_000, 20_000),
    east=st.floats(-20_000, 20_000),
)
def test_there_and_back_is_here(
    latitude: float, longitude: float, north: float, east: float
) -> None:
    frame = LocalFrame(latitude, longitude)
    assert frame.to_local(*frame.to_geodetic(north, east)) == pytest.approx((north, east), abs=2e-5)


@given(
    latitude=st.floats(-89, 89),
    longitude=st.floats(-180, 180),
    other_latitude=st.floats(-90, 90),
    other_longitude=st.floats(-360, 360),
)
def test_every_place_on_earth_lies_somewhere(
    latitude: float, longitude: float, other_latitude: float, other_longitude: float
) -> None:
    """A receiver that jumps to the other side must not raise out of what measures by it."""
    frame = LocalFrame(latitude, longitude)
    distance = math.hypot(*frame.to_local(other_latitude, other_longitude))
    assert distance < 25_000_000
    real = distance_m(latitude, longitude, other_latitude, other_longitude)
    if abs(latitude) < 80 and abs(other_latitude) < 80:
        assert distance == pytest.approx(real, rel=1e-3, abs=0.1)


@pytest.mark.parametrize(
    ("origin", "point"),
    [
        ((47.0, 8.0), (49.0, 3.0)),  # beyond the reach of the series, to the north-west
        ((-33.0, 151.0), (-38.0, 175.0)),  # to the south-east
        ((10.0, 179.0), (14.0, -178.0)),  # over the line of the date
        ((88.5, 20.0), (88.4, 60.0)),  # where meridians meet, nearer than the series reaches
        ((-89.0, -100.0), (-88.0, -170.0)),
    ],
)
def test_beyond_the_series_north_and_east_are_those_of_the_geodesic(
    origin: tuple[float, float], point: tuple[float, float]
) -> None:
    line = Geodesic.WGS84.Inverse(*origin, *point)
    turn = math.radians(line["azi1"])
    expected = line["s12"] * math.cos(turn), line["s12"] * math.sin(turn)
    assert LocalFrame(*origin).to_local(*point) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("latitude", [88.0, 89.0, -89.0])
def test_near_a_pole_places_are_as_far_as_they_are(latitude: float) -> None:
    """Meridians meet there, and the steps of the series led ever further away."""
    frame = LocalFrame(latitude, 0.0)
    for other in (latitude, math.copysign(88.0, latitude), math.copysign(89.9, latitude)):
        for longitude in range(-180, 181, 3):
            distance = math.hypot(*frame.to_local(other, longitude))
            assert distance == pytest.approx(distance_m(latitude, 0.0, other, longitude), rel=0.05)


def test_the_antimeridian_is_no_edge() -> None:
    frame = LocalFrame(10.0, 179.999)
    latitude, longitude = frame.to_geodetic(0.0, 1000.0)
    assert -180.0 < longitude < -179.9
    assert frame.to_local(latitude, longitude) == pytest.approx((0.0, 1000.0), abs=1e-4)
    westward = LocalFrame(10.0, -179.999)
    latitude, longitude = westward.to_geodetic(0.0, -1000.0)
    assert 179.9 < longitude < 180.0
    assert westward.to_local(latitude, longitude) == pytest.approx((0.0, -1000.0), abs=1e-4)


@pytest.mark.parametrize("latitude", [89.5, -90.0, math.nan, math.inf])
def test_no_local_frame_at_a_pole(latitude: float) -> None:
    with pytest.raises(ValueError, match="latitude"):
        LocalFrame(latitude, 0.0)


@pytest.mark.parametrize("longitude", [360.1, -361.0, 1e300, math.nan, math.inf])
def test_no_local_frame_at_a_longitude_that_is_none(longitude: float) -> None:
    """At 1e300 the difference to another longitude is 1e300: a target far away seems near."""
    with pytest.raises(ValueError, match="longitude"):
        LocalFrame(0.0, longitude)


@given(
    a=st.tuples(st.floats(-89, 89), st.floats(-180, 180)),
    b=st.tuples(st.floats(-89, 89), st.floats(-180, 180)),
)
def test_geodesic_agrees_with_geographiclib(a: tuple[float, float], b: tuple[float, float]) -> None:
    line = Geodesic.WGS84.Inverse(*a, *b)
    distance, bearing = geodesic(*a, *b)
    if line["a12"] > 178:  # nearly opposite: the documented way out, to half a percent
        assert distance == pytest.approx(line["s12"], rel=6e-3)
        return
    assert distance == pytest.approx(line["s12"], abs=2e-3)
    if line["s12"] > 1000:
        turn = geodesy.normalize_degrees(bearing - line["azi1"])
        assert abs(turn) < 1e-5


def test_geodesic_agrees_to_a_tenth_of_a_millimetre_over_long_lines() -> None:
    """What each term of its series says shows there and nowhere else."""
    chance = random.Random(5)
    lines = 0
    while lines < 100:
        ends = [chance.uniform(-89, 89), chance.uniform(-180, 180)]
        ends += [chance.uniform(-89, 89), chance.uniform(-180, 180)]
        line = Geodesic.WGS84.Inverse(*ends)
        if line["a12"] > 170:
            continue
        lines += 1
        distance, bearing = geodesic(*ends)
        assert distance == pytest.approx(line["s12"], abs=1e-4), ends
        assert abs(geodesy.normalize_degrees(bearing - line["azi1"])) < 1e-8, ends


def test_along_the_equator_it_is_an_arc_of_the_semi_major_axis() -> None:
    for degrees in (1.0, -90.0, 150.0):
        arc = 6_378_137.0 * math.radians(abs(degrees))
        assert geodesic(0.0, 10.0, 0.0, 10.0 + degrees) == pytest.approx(
            (arc, math.copysign(90.0, degrees)), abs=1e-4
        )


@pytest.mark.parametrize(
    "ends",
    [
        (10.0, 0.0, -9.9, 179.9),
        (-10.0, 0.0, 9.9, -179.9),
        (0.0, 0.0, 0.3, 179.7),
        (30.0, 20.0, -29.8, -160.4),
    ],
)
def test_of_nearly_opposite_points_the_great_circle_of_the_mean_sphere_counts(
    ends: tuple[float, float, float, float],
) -> None:
    line = Geodesic(6_371_008.7714, 0.0).Inverse(*ends)  # the mean radius of WGS84, R1
    assert geodesic(*ends) == pytest.approx((line["s12"], line["azi1"]), abs=1e-3)


def test_a_point_is_no_distance_from_itself() -> None:
    assert geodesic(22.5, 113.9, 22.5, 113.9) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("point", "bearing"),
    [((1.0, 0.0), 0.0), ((0.0, 1.0), 90.0), ((-1.0, 0.0), 180.0), ((0.0, -1.0), -90.0)],
)
def test_bearing_counts_clockwise_from_north(point: tuple[float, float], bearing: float) -> None:
    assert bearing_deg(0.0, 0.0, *point) == pytest.approx(bearing)


def test_distance_and_destination_undo_each_other() -> None:
    point = destination(47.4, 8.5, 300.0, -400.0)
    assert distance_m(47.4, 8.5, *point) == pytest.approx(500.0, abs=1e-3)


def test_opposite_points_do_not_hang() -> None:
    distance, _ = geodesic(0.0, 0.0, 0.3, 179.7)
    assert distance == pytest.approx(19_936_288.579, rel=6e-3)


@pytest.mark.parametrize(
    ("angle", "same"),
    [(0, 0), (180, 180), (-180, 180), (181, -179), (540, 180), (-540, 180), (-181, 179), (720, 0)],
)
def test_normalize_degrees(angle: float, same: float) -> None:
    assert geodesy.normalize_degrees(angle) == same


def test_djis_offset_is_their_formula_and_its_error_is_known() -> None:
    """Meridian radius at 22.5 degrees 6344.8 km, theirs 6378.1: 0.5 percent too far north."""
    latitude, longitude = LocalFrame(22.5, 113.9).to_geodetic(1000.0, 1000.0)
    north, east = dji_offset(22.5, 113.9, latitude, longitude)
    assert north == pytest.approx(math.radians(latitude - 22.5) * 6_378_137.0)
    assert north == pytest.approx(1005.2, abs=0.1)
    assert east == pytest.approx(999.5, abs=0.1)


def test_djis_offset_takes_the_short_way_and_the_mean_latitude() -> None:
    degree = math.pi / 180 * 6_378_137.0
    assert dji_offset(0.0, 179.5, 60.0, -179.5) == pytest.approx(
        (60 * degree, degree * math.cos(math.radians(30.0)))
    )
    assert dji_offset(60.0, -179.5, 0.0, 179.5) == pytest.approx(
        (-60 * degree, -degree * math.cos(math.radians(30.0)))
    )


# -- maps ------------------------------------------------------------------------------------------

SVG = "{http://www.w3.org/2000/svg}"
START = LocalFrame(22.5, 113.9)


def drawn(*track: tuple[float, float]) -> tuple[ET.Element, list[tuple[float, float]]]:
    """The drawing of metres north and east, and the points of its line."""
    root = ET.fromstring(track_svg(START.to_geodetic(*place) for place in track))
    line = root.find(f"{SVG}polyline")
    assert line is not None
    points = [point.split(",") for point in line.attrib["points"].split()]
    return root, [(float(x), float(y)) for x, y in points]


def test_north_is_up_and_both_axes_have_one_scale() -> None:
    root, points = drawn((0.0, 0.0), (10.0, 0.0), (10.0, 5.0))
    (x0, y0), (x1, y1), (x2, y2), last = points
    assert last == (x2, y2)
    assert x1 == pytest.approx(x0, abs=0.2)
    assert y0 - y1 == pytest.approx(300, abs=0.2)
    assert x2 - x1 == pytest.approx(150, abs=1.5)
    assert y2 == pytest.approx(y1, abs=0.2)
    assert [text.text for text in root.findall(f"{SVG}text")] == ["5 m", "N ↑"]
    width, height = map(float, root.attrib["viewBox"].split()[2:])
    begin, end = root.findall(f"{SVG}circle")
    assert (float(begin.attrib["cx"]), float(begin.attrib["cy"])) == (x0, y0)
    assert (float(end.attrib["cx"]), float(end.attrib["cy"])) == (x2, y2)
    for x, y in points:
        assert 0 < x < width
        assert 0 < y < height
    side = max(y for _, y in points)
    bar = root.findall(f"{SVG}path")[0].attrib["d"].split("v")[0]
    words = [tuple(float(text.attrib[axis]) for axis in "xy") for text in root.iter(f"{SVG}text")]
    for x, y in (map(float, bar[1:].split()), *words):
        assert 0 < x < width
        assert side < y < height


def test_a_map_is_as_large_as_fits_and_in_the_middle() -> None:
    """20 m of north fill 320 less twice 28: 13.2 per metre; 5 m of east have 207 on either side."""
    view = MapView([(10.0, -4.0), (30.0, 1.0)], (480, 320), 28)
    assert view.spot(30.0, -4.0) == pytest.approx((207, 28))
    assert view.spot(10.0, 1.0) == pytest.approx((273, 292))
    assert MapView([(0.0, 0.0), (1.0, 53.0)], (480, 320), 28).scale == pytest.approx(8)


def test_what_stands_still_is_not_blown_up_to_its_noise() -> None:
    _, points = drawn((0.0, 0.0), (0.01, 0.0), (0.0, 0.01))
    assert max(y for _, y in points) - min(y for _, y in points) < 5.0


def test_a_long_track_is_thinned_and_keeps_its_end() -> None:
    _, points = drawn(*((float(n), math.sin(n / 50)) for n in range(20_000)))
    assert 300 <= len(points) <= 610
    assert points[-1][1] == min(y for _, y in points)


def test_places_that_are_not_known_are_passed_over() -> None:
    assert track_svg([]) == ""
    assert track_svg([(math.nan, 113.9)]) == ""
    assert track_svg([(22.5, 113.9)]).count("<circle") == 2
    junk = [(90.0, 0.0), (22.5, 113.9), (1e9, 1e9), (22.6, 1e12), (-90.0, 0.0)]
    assert ET.fromstring(track_svg(junk)).tag == f"{SVG}svg"


@pytest.mark.parametrize(
    ("most", "length"), [(0.5, 0.5), (0.99, 0.5), (4.2, 2), (73, 50), (100, 100)]
)
def test_lengths_are_round(most: float, length: float) -> None:
    assert round_length(most) == pytest.approx(length)


def test_the_antimeridian_is_no_way_around_the_earth() -> None:
    svg = track_svg([(10.0, 179.9999), (10.0, -179.9999)])
    assert ">10 m<" in svg


def test_words_and_labels_are_no_markup() -> None:
    root = ET.fromstring(
        svg((9, 9), '<"&', [svg_text((1, 2), "<b>&"), svg_dot((3, 4), 1, title="<")])
    )
    assert root.attrib["aria-label"] == '<"&'
    assert [one.text for one in root.iter() if one.text] == ["<b>&", "<"]


@pytest.mark.parametrize("extent", [0.0, 0.3, 1.0, 7.0, 333.0, 12_345.0])
def test_a_scale_bar_is_as_long_as_it_says(extent: float) -> None:
    view = MapView([(0.0, 0.0), (extent, extent / 3)], (480, 320), 28)
    drawn = ET.fromstring(f"<g>{view.bar(8, 318, 100)}</g>")
    path, words = drawn
    start, length, tick = path.attrib["d"].split("v")
    long = float(length.removeprefix("4h"))
    assert (start, tick) == ("M8 314", "-4")
    assert float(words.attrib["x"]) == pytest.approx(8 + long + 6, abs=0.1)
    (_, y0), (x1, _) = view.spot(0, 0), view.spot(0, 1)
    metre = x1 - view.spot(0, 0)[0]
    assert y0 - view.spot(1, 0)[1] == pytest.approx(metre)
    assert 40 <= long <= 100
    assert long == pytest.approx(float((words.text or "").removesuffix(" m")) * metre, abs=0.05)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("geodesy") == []
