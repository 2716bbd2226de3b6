"""A timed track: where it is when, what it never does between points, its bytes and their hash."""

from __future__ import annotations

import hashlib
import math
import random
import struct
from itertools import pairwise

import pytest

from m100link.apps.fleet.show.plan.track import (
    BadShow,
    TimedPoint,
    TimedTrack,
    Windows,
    apart,
    closest,
    under,
)
from tests.apps.fleet.show.shows import ORIGIN, random_track, track

BACK_AND_FORTH = track("a1", (0, 0, 0, 5), (10, 10, 0, 5), (20, 0, 0, 5))


def test_it_is_at_its_points_at_their_times_and_rests_at_both_ends() -> None:
    found = track("a1", (2, 0, 0, 5), (10, 10, 4, 5), (20, 30, 4, 9))
    for point in found.points:
        assert found.moment(point.at).place == pytest.approx(point.place)
    for at in (0.0, 2.0, 20.0, 99.0):
        assert found.moment(at).velocity == (0, 0, 0)
    assert found.moment(0.0).place == (0, 0, 5)
    assert found.moment(99.0).place == (30, 4, 9)


def test_it_flies_on_through_a_point_and_stops_where_it_turns_back() -> None:
    on = track("a1", (0, 0, 0, 5), (10, 20, 0, 5), (20, 40, 0, 5), (30, 60, 0, 5))
    assert on.moment(10).velocity == pytest.approx((2, 0, 0))
    assert on.moment(15).velocity == pytest.approx((2, 0, 0))
    assert BACK_AND_FORTH.moment(10).velocity == pytest.approx((0, 0, 0))


def test_speed_is_how_the_place_changes() -> None:
    chance = random.Random(1)
    for _ in range(20):
        found = random_track(chance)
        for _ in range(20):
            at, step = chance.uniform(found.begin + 1e-3, found.end - 1e-3), 1e-5
            before, after = found.moment(at - step), found.moment(at + step)
            slope = [(b - a) / (2 * step) for a, b in zip(before.place, after.place, strict=True)]
            assert found.moment(at).velocity == pytest.approx(slope, abs=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_between_two_points_it_stays_in_their_box_and_within_what_it_says(seed: int) -> None:
    found = random_track(random.Random(seed))
    across, upright = found.fastest
    hardest = max(leg.hardest_m_s2 for leg in found.legs)
    for before, after in pairwise(found.points):
        speeds = []
        for index in range(101):
            moment = found.moment(before.at + (after.at - before.at) * index / 100)
            for place, a, b in zip(moment.place, before.place, after.place, strict=True):
                assert min(a, b) - 1e-9 <= place <= max(a, b) + 1e-9
            north, east, up = moment.velocity
            assert math.hypot(north, east) <= across + 1e-9
            assert abs(up) <= upright + 1e-9
            speeds.append(moment.velocity)
        step = (after.at - before.at) / 100
        assert all(math.dist(a, b) / step <= hardest + 1e-6 for a, b in pairwise(speeds))


def test_the_speed_that_it_says_is_nearly_what_it_flies() -> None:
    """From rest to rest a cubic is 1.5 times as fast in the middle."""
    found = track("a1", (0, 0, 0, 5), (10, 20, 0, 5))
    across, upright = found.fastest
    assert 3.0 <= across < 3.02
    assert upright == 0.0
    assert found.legs[0].hardest_m_s2 == pytest.approx(6 * 20 / 100)
    faster = track("a1", (0, 0, 0, 5), (10, 10, 0, 5), (20, 60, 0, 5), (30, 70, 0, 5))
    assert faster.legs[0].fastest[0] >= faster.moment(10.0).velocity[0] > 1.5, "to the very end"


# -- bytes ----------------------------------------------------------------------------------------


def test_its_bytes_are_as_the_manual_says() -> None:
    found = track("ä1", (0, -0.0, 2, 5), (10, 10, 0, 6), ground_m=1.5, heading_deg=90)
    by_hand = b"m100link track 1\n\x00\x03\xc3\xa41" + struct.pack(">4d", *ORIGIN, 1.5, 1.5)
    by_hand += b"\x01" + struct.pack(">d", 90) + b"\x00\x00\x00\x02"
    by_hand += struct.pack(">8d", 0, 0.0, 2, 5, 10, 10, 0, 6)
    assert found.to_bytes() == by_hand
    assert found.digest == hashlib.sha256(by_hand).hexdigest()
    zeros = [
        TimedTrack("a1", (zero, zero), found.points, ground_m=zero, heading_deg=zero).to_bytes()
        for zero in (0.0, -0.0)
    ]
    assert zeros[0] == zeros[1], "zero is positive"
    without = track("a1", (0, 0, 2, 5), (10, 10, 0, 6)).to_bytes()
    assert without[17 + 2 + 2 + 32 :][:9] == bytes(9)


@pytest.mark.parametrize("seed", range(10))
def test_what_is_read_from_its_bytes_is_the_same_track(seed: int) -> None:
    found = random_track(random.Random(seed))
    assert TimedTrack.from_bytes(found.to_bytes()) == found


def test_no_change_of_the_bytes_is_read_as_the_same_track() -> None:
    data = track("a1", (0, 0, 2, 5), (10, 10, 0, 6)).to_bytes()
    digest = TimedTrack.from_bytes(data).digest
    changed = [data[:end] for end in range(len(data))] + [data + b"\0"]
    for place in range(len(data)):
        for bit in range(8):
            one = bytearray(data)
            one[place] ^= 1 << bit
            changed.append(bytes(one))
    for one_changed in changed:
        try:
            found = TimedTrack.from_bytes(one_changed)
        except BadShow:
            continue
        assert found.digest != digest
    with pytest.raises(BadShow, match="cannot be read: they begin differently"):
        TimedTrack.from_bytes(data.replace(b"track 1", b"track 2"))


# -- no tracks ------------------------------------------------------------------------------------

GOOD = ((0.0, 0.0, 0.0, 5.0), (10.0, 10.0, 0.0, 5.0))


@pytest.mark.parametrize(
    ("points", "more", "said"),
    [
        (GOOD[:1], {}, "2 to 10000 points, not 1"),
        (GOOD, {"ground_m": math.nan}, "the ground is at nan m"),
        (GOOD, {"heading_deg": 181}, "the heading is 181°"),
        (GOOD, {"tube_m": 0}, "the tube is 0 m"),
        (((-1, 0, 0, 5), GOOD[1]), {}, "point 0 is at -1 s"),
        (((0, math.inf, 0, 5), GOOD[1]), {}, "point 0 is (inf, 0, 5)"),
        ((GOOD[1], GOOD[0]), {}, "point 1 is at 0 s, the one before at 10 s"),
        ((GOOD[0], (0.01, 1, 0, 5)), {}, "20 ms later"),
    ],
)
def test_what_cannot_be_flown_is_no_track(
    points: tuple[tuple[float, float, float, float], ...], more: dict[str, float], said: str
) -> None:
    with pytest.raises(BadShow) as caught:
        track("a1", *points, **more)
    assert said in caught.value.seen
    assert caught.value.aircraft == ("a1",)


@pytest.mark.parametrize("name", ["", "a\n1", "a" * 65])
def test_names_can_be_distinguished(name: str) -> None:
    with pytest.raises(BadShow, match="1 to 64 characters"):
        track(name, *GOOD)


def test_an_origin_is_on_the_earth() -> None:
    with pytest.raises(BadShow, match="latitude within"):
        TimedTrack("a1", (90.0, 0.0), tuple(TimedPoint(*point) for point in GOOD))


# -- how near two tracks come: against arithmetic, and against looking everywhere ------------------


def test_two_that_cross_meet_where_arithmetic_says() -> None:
    """One flies north through the middle, the other east, 2 m higher and as fast."""
    first = track("a1", (0, -20, 0, 5), (10, 20, 0, 5), (20, 60, 0, 5))
    second = track("a2", (0, 0, -20, 7), (10, 0, 20, 7), (20, 0, 60, 7))
    found = closest(first, second)
    assert found is not None
    distance, at = found
    # By symmetry both are at the middle at the same time, above each other.
    assert distance == pytest.approx(2.0, abs=2e-3)
    assert first.moment(at).place[0] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("seed", range(25))
def test_no_moment_is_nearer_than_the_nearest(seed: int) -> None:
    chance = random.Random(seed)
    first, second = random_track(chance, "a"), random_track(chance, "b")
    found = closest(first, second)
    assert found is not None
    distance, when = found
    last = max(first.end, second.end)

    def at(time: float) -> float:
        return apart(
            first.moment(time).place,
            second.moment(time).place,
            first_ended=time >= first.end,
            second_ended=time >= second.end,
        )

    everywhere = [at(last * index / 5000) for index in range(5001)]
    assert min(everywhere) >= distance - 1.1e-3
    assert distance == pytest.approx(at(when), abs=1e-9)
    fastest = math.hypot(*first.fastest) + math.hypot(*second.fastest)
    assert distance >= min(everywhere) - fastest * last / 5000 - 1.1e-3


def test_boxes_of_one_that_has_ended_and_of_one_that_passes_below_are_near() -> None:
    """2 m beside and 4 m below its last point, 40 m east of the origin, 10 s after its end."""
    ended = track("a1", (0, 0, 40, 9), (5, 30, 40, 9), (10, 60, 43, 9))
    below = track("a2", (0, 0, 90, 5), (20, 60, 41, 5), (30, 90, 41, 5))
    for two in ((ended, below), (below, ended)):
        assert Windows(two).near(5.0) == {(0, 1): [(10, 20), (20, 30)]}
        assert Windows(two).near(2.0 + 5e-7) == {(0, 1): [(10, 20), (20, 30)]}, "rounding is spared"
        assert Windows(two).near(2.0 - 2e-6) == {(0, 1): [(10, 20)]}


def test_an_aircraft_that_has_ended_may_be_anywhere_below_its_last_point() -> None:
    ended = track("a1", (0, 0, 0, 10), (5, 1, 0, 10))
    below = track("a2", (0, -20, 0, 3), (10, -20, 0, 3), (20, 20, 0, 3), (30, 40, 0, 3))
    above = track("a3", (0, -20, 0, 14), (10, -20, 0, 14), (20, 20, 0, 14), (30, 40, 0, 14))
    for first, second in ((ended, below), (below, ended)):
        found = closest(first, second)
        assert found is not None
        assert found[0] == pytest.approx(0.0, abs=2e-3)  # flown under, where it may be landing
        assert 10 < found[1] < 20
    over = closest(above, ended)
    assert over is not None
    assert over[0] == pytest.approx(4.0, abs=2e-3)


def test_two_that_land_are_as_near_as_their_spots() -> None:
    high = track("a1", (0, 0, 0, 5), (10, 10, 0, 20))
    low = track("a2", (0, 20, 0, 5), (10, 13, 0, 2))
    found = closest(high, low)
    assert found is not None
    assert found[0] == pytest.approx(3.0, abs=2e-3)
    assert found[1] == 10


def test_an_aircraft_that_is_far_enough_is_of_no_interest() -> None:
    first = track("a1", (0, 0, 0, 5), (10, 10, 0, 5))
    second = track("a2", (0, 0, 8, 5), (10, 10, 8, 5))
    third = track("a3", (0, 0, 30, 5), (10, 10, 30, 5))
    assert closest(first, second, below=8.0) is None
    found = closest(first, second, below=8.01)
    assert found is not None
    assert found[0] == pytest.approx(8.0)
    three = [first, second, third]
    pairs = list(under(three, lambda _a, _b: 9.0, Windows(three).near(9.0)))
    assert [(a.name, b.name) for a, b, *_ in pairs] == [("a1", "a2")]
