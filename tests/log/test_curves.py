"""A flight of any length is a few hundred points: peaks stay, and so do holes."""

from __future__ import annotations

import math

import pytest

from m100link.geodesy import Track
from m100link.log.channels import Curve
from m100link.log.story import FlightPath
from m100link.protocol.records import Position


def test_a_short_peak_of_a_long_flight_stays() -> None:
    curve = Curve()
    for number in range(200_000):
        curve.add(number / 100, 40.0 if number == 123_456 else -3.0 if number == 77_777 else 1.0)
    points = list(curve.points())
    assert len(points) <= 1600
    assert (1234.56, 40.0) in points
    assert (777.77, -3.0) in points
    assert points == sorted(points)


def test_what_was_not_heard_is_a_hole_and_no_line() -> None:
    curve = Curve(gap_s=2.0)
    for at in (0.0, 1.0, 9.0, 10.0):
        curve.add(at, 5.0)
    values = [value for _, value in curve.points()]
    assert [math.isnan(value) for value in values] == [False, False, True, False, False]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_passed_over(value: float) -> None:
    curve = Curve()
    curve.add(1.0, value)
    assert list(curve.points()) == []
    assert len(curve) == 0


def test_a_track_of_hours_keeps_its_shape_and_its_length() -> None:
    track = Track()
    for number in range(100_000):  # a circle of 100 m, ten times around
        angle = 2 * math.pi * number / 10_000
        track.add(number / 50, 100 * math.cos(angle), 100 * math.sin(angle))
    assert len(track.places()) <= 3000
    assert track.length_m == pytest.approx(10 * 2 * math.pi * 100, rel=0.02)
    assert max(place.north_m for place in track.places()) == pytest.approx(100, abs=1)


def test_an_aircraft_that_stands_still_draws_no_noise() -> None:
    track = Track()
    for number in range(1000):
        track.add(number / 100, 0.03 * (number % 2), 0.0)
    assert len(track.places()) == 1
    assert track.length_m == 0.0


@pytest.mark.parametrize(("pause", "is_hole"), [(1.9, False), (2.0, False), (2.1, True)])
def test_a_hole_is_longer_than_two_seconds_and_stands_in_its_middle(
    pause: float, is_hole: bool
) -> None:
    curve = Curve(gap_s=2.0)
    for at in (4.0, 4.0 + pause):
        curve.add(at, -5.0)
    holes = [at for at, value in curve.points() if math.isnan(value)]
    assert holes == ([pytest.approx(4.0 + pause / 2)] if is_hole else [])


def test_places_are_in_their_order_with_their_signs() -> None:
    track = Track()
    for place in ((0.0, 0.0, 0.0), (1.0, 3.0, -4.0), (2.0, 3.0, -4.0), (3.0, -3.0, 4.0)):
        track.add(*place)
    assert [place[:3] for place in track.places()] == [
        (0.0, 0.0, 0.0),
        (1.0, 3.0, -4.0),
        (3.0, -3.0, 4.0),
    ]
    assert track.length_m == pytest.approx(5.0 + 10.0)


def test_a_place_after_a_silence_is_not_joined_to_the_one_before() -> None:
    track = Track()
    for at, north in ((0.0, 0.0), (1.0, 5.0), (3.0, 9.0), (5.1, 9.05), (6.0, 12.0)):
        track.add(at, north, 0.0)
    assert [(place.at_s, place.is_joined) for place in track.places()] == [
        *((0.0, False), (1.0, True), (3.0, True)),
        *((5.1, False), (6.0, True)),  # it stands where it stood, and nobody knows what was between
    ]


def test_a_thinned_track_keeps_its_holes() -> None:
    track = Track()
    for number in range(20_000):
        track.add(10.0 * (number // 1000) + number / 100, number / 10, 0.0)
    assert track.thinned > 0
    holes = [place.at_s for place in track.places() if not place.is_joined]
    assert holes == pytest.approx([20.0 * number for number in range(20)])


def position(latitude_deg: float, longitude_deg: float, height_m: float = 0.0) -> Position:
    return Position(math.radians(latitude_deg), math.radians(longitude_deg), 0.0, height_m, 5)


def test_home_is_where_it_took_off_last_and_the_track_says_where_it_was() -> None:
    path = FlightPath()
    assert path.home(0.0) is None
    for at, north, is_off_ground in (
        *((0.0, 0.0, False), (1.0, 0.1, False), (2.0, 0.1, True), (3.0, 9.0, True)),
        *((4.0, 20.0, True), (5.0, 20.0, False), (6.0, 20.0, True), (7.0, 25.0, True)),
    ):
        path.hear_phase(at, is_off_ground=is_off_ground)
        path.add(at, position(22.5 + north / 110_740.0, 113.9, height_m=at))
    homes = {at: path.home(at) for at in (0.0, 2.0, 5.9, 6.0, 9.0)}
    norths = {at: (home.latitude_deg - 22.5) * 110_740.0 for at, home in homes.items() if home}
    assert norths == pytest.approx({0.0: 0.1, 2.0: 0.1, 5.9: 0.1, 6.0: 20.0, 9.0: 20.0}, abs=0.01)
    points = path.points()
    assert [(at, height, joined) for at, _, _, height, joined in points] == [
        (at, at, at > 2.0) for at in (2.0, 3.0, 4.0, 7.0)
    ]
    assert points[-1][1:3] == pytest.approx((22.5 + 25.0 / 110_740.0, 113.9), abs=1e-7)
    assert path.points(since=3) == points[3:]
