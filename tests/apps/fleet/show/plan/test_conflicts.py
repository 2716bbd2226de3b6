"""Where the others of a show will be, and who of them comes too near."""

from __future__ import annotations

import json
import math
import random
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from m100link.apps.fleet.show.plan.conflicts import (
    AHEAD_S,
    SETTLED_S,
    SILENT_S,
    ConflictMonitor,
    Near,
    Neighbours,
    RestOfTrack,
    by_speed,
    by_track,
    nearest,
)
from m100link.apps.fleet.show.plan.track import BadShow, Vector
from m100link.geodesy import LocalFrame
from tests.apps.fleet.show.shows import random_track, track

NORTH = track("a1", (0, 0, 0, 4), (20, 40, 0, 4))
ACROSS = track("a2", (0, 20, -20, 4), (20, 20, 20, 4))


def neighbours(least: float = 3.0) -> Neighbours:
    return Neighbours("show", "a1", least)


def on_track(at: float, *, off: float = 0.0) -> ConflictMonitor:
    north, east, height = NORTH.moment(at).place
    return by_track("show", NORTH, at, (north, east + off, height))


def test_one_flies_on_as_far_beside_its_track_as_it_is() -> None:
    ahead = on_track(5.0, off=1.0)
    for later in (0.0, 0.2, 3.3, AHEAD_S):
        wanted = NORTH.moment(5.0 + later).place
        assert ahead.place(5.0 + later) == pytest.approx((wanted[0], 1.0, 4.0), abs=0.05)
    assert ahead.place(99.0) == ahead.places[-1]
    assert ahead.place(0.0) == ahead.places[0]


def test_two_whose_ways_cross_at_one_time_meet_and_not_at_different_times() -> None:
    ones = neighbours()
    assert ones.near(on_track(5.0), 0.0) is None
    ones.hear(by_track("show", ACROSS, 5.0, ACROSS.moment(5.0).place), 0.0)
    near = ones.near(on_track(5.0), 0.0)
    assert near is not None
    assert (near.name, near.distance_m < 3.0) == ("a2", True)
    assert 5.0 < near.at < 11.0, "both are at the crossing at 10 s"
    first = track("a2", (0, 20, 16, 4), (4, 20, 20, 4))
    gone = neighbours()
    gone.hear(by_track("show", first, 5.0, first.moment(5.0).place), 0.0)
    assert gone.near(on_track(5.0), 0.0) is None, "it is past, 20 m to the east"


def test_one_that_hovers_in_the_way_is_seen_ten_seconds_before() -> None:
    times = []
    for tenth in range(200):
        at = tenth / 10
        ones = neighbours()
        ones.hear(by_speed("show", "a2", at, (30.0, 0.5, 4.0), (0.0, 0.0, 0.0)), 0.0)
        near = ones.near(on_track(at), 0.0)
        if near is not None:
            times.append((at, near.at))
    reached = next(at / 100 for at in range(2000) if NORTH.moment(at / 100).place[0] > 27.0)
    assert times[0][0] == pytest.approx(reached - AHEAD_S, abs=0.3)
    assert times[0][1] == pytest.approx(reached, abs=0.3)


def test_one_that_may_be_landing_is_everywhere_below() -> None:
    ones = neighbours()
    ones.hear(by_speed("show", "a2", 5.0, (20.0, 0.0, 20.0), (0.0, 0.0, 0.0)), 0.0)
    assert ones.near(on_track(5.0), 0.0) is not None
    above = neighbours()
    high = track("a2", (0, 20, 0, 20), (60, 20, 9, 20))
    above.hear(by_track("show", high, 5.0, (20.0, 0.0, 20.0)), 0.0)
    assert above.near(on_track(5.0), 0.0) is None, "16 m above, and it flies"
    landed = neighbours()
    landed.hear(by_speed("show", "a2", 5.0, (20.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
    assert landed.near(on_track(5.0), 0.0) is None, "4 m below, on the ground"


def test_one_that_drifts_off_is_where_it_drifts_to() -> None:
    ones = neighbours()
    ones.hear(by_speed("show", "a2", 5.0, (20.0, 10.0, 4.0), (0.0, -1.5, 0.0)), 0.0)
    near = ones.near(on_track(5.0), 0.0)
    assert near is not None
    assert near.distance_m < 3.0


def silent(others: list[str], heard_at: dict[str, float]) -> Neighbours:
    """One flew towards the crossing, and would be past it; another one is far away."""
    ones = neighbours()
    early = track("a2", (0, 20, -10, 4), (6, 20, 2, 4), (12, 20, 20, 4))
    for name in others:
        place = early.moment(5.0).place if name == "a2" else (500.0, 0.0, 4.0)
        ahead = by_track("show", early, 5.0, place) if name == "a2" else None
        ahead = ahead or by_speed("show", name, 5.0, place, (0.0, 0.0, 0.0))
        ones.hear(ahead, heard_at[name])
    return ones


def test_one_that_alone_is_silent_may_hover_where_it_was() -> None:
    both = silent(["a2", "a3"], {"a2": 0.0, "a3": 2.0})
    assert both.near(on_track(7.0), 2.0) is not None
    heard = silent(["a2", "a3"], {"a2": 2.0 - SILENT_S, "a3": 2.0})
    assert heard.near(on_track(5.0 + SILENT_S), 2.0) is None, "it flies on, and is past"


def test_an_aircraft_that_hears_nobody_counts_them_as_there_too() -> None:
    """Of two the other one was killed, or this one is cut off: nobody here knows."""
    alone = silent(["a2", "a3"], {"a2": 0.0, "a3": 0.0})
    near = alone.near(on_track(7.0), 2.0)
    assert near is not None
    assert (near.name, near.silent_s) == ("a2", 2.0)
    ones = neighbours()
    ones.hear(by_track("show", ACROSS, 5.0, ACROSS.moment(5.0).place), 0.0)
    assert ones.near(on_track(7.0), 2.0) is not None, "its report holds for ten seconds"


def test_one_that_is_silent_may_have_stopped_anywhere_on_its_way_and_not_beyond() -> None:
    fast = track("a2", (0, 20, -24, 4), (20, 20, 40, 4))
    for at, is_near in ((8.0, True), (30.0, False)):
        there = fast.moment(5.0).place
        ones = neighbours()
        ones.hear(by_track("show", fast, 5.0, there), 5.0)
        own = by_speed("show", "a1", at, (20.0, 0.0, 4.0), (0.0, 0.0, 0.0))
        crossed = next(t / 10 for t in range(200) if fast.moment(t / 10).place[1] > -3.0)
        assert crossed < 13.0
        assert (ones.near(own, at) is not None) or not is_near
        assert (ones.near(own, at) is None) or at >= crossed - 10.0
        elsewhere = by_speed("show", "a1", at, (20.0, 45.0, 4.0), (0.0, 0.0, 0.0))
        assert ones.near(elsewhere, at) is None, "so far it reported nothing"


def test_a_silent_one_is_decided_about_in_time_and_once() -> None:
    """Its way is met half a minute later: a leaver is still where it reported to be."""
    later = track("a1", (0, 0, 0, 4), (10, 0, 9, 4), (40, 40, 9, 4), (70, 40, 0, 4))
    rest = RestOfTrack(later)

    def at(seconds: float) -> Near | None:
        own = by_track("show", later, seconds, later.moment(seconds).place)
        return ones.near(own, seconds, rest)

    ones = neighbours()
    ones.hear(by_speed("show", "a2", 0.0, (40.0, 5.0, 4.0), (0.0, 0.0, 0.0)), 0.0)
    assert at(SETTLED_S - 0.2) is None
    near = at(SETTLED_S + 0.1)
    assert near is not None
    assert 30.0 < near.at < 60.0
    assert near.silent_s == pytest.approx(SETTLED_S + 0.1)
    assert at(SETTLED_S + 0.3) is None, "one that flies on has left, or was not asked to"
    ones.hear(by_speed("show", "a2", 9.0, (40.0, 50.0, 4.0), (0.0, 0.0, 0.0)), 9.0)
    assert at(9.0 + SETTLED_S + 0.1) is None, "it was heard again, 40 m away"


def test_a_word_that_was_long_on_its_way_is_as_old_as_it_says() -> None:
    ones = neighbours()
    ones.hear(by_track("show", ACROSS, 1.0, (20.0, 0.0, 4.0)), 7.9)
    near = ones.near(on_track(8.0), 8.0)
    assert near is not None
    assert near.silent_s == pytest.approx(7.0)


def test_an_older_word_that_comes_later_changes_nothing() -> None:
    ones = neighbours()
    ones.hear(by_speed("show", "a2", 7.9, (20.0, 0.0, 4.0), (0.0, 0.0, 0.0)), 8.0)
    ones.hear(by_speed("show", "a2", 7.0, (500.0, 0.0, 4.0), (0.0, 0.0, 0.0)), 8.0)
    assert ones.near(on_track(8.0), 8.0) is not None


def test_other_shows_and_itself_are_not_compared() -> None:
    ones = neighbours()
    for show, name in (("other", "a2"), ("show", "a1")):
        ones.hear(by_speed(show, name, 5.0, (10.0, 0.0, 4.0), (0.0, 0.0, 0.0)), 0.0)
    assert ones.near(on_track(5.0), 0.0) is None


HERE = (22.5431, 113.9589)


@pytest.mark.parametrize(
    ("north", "east", "height", "near"),
    # 20 m north at 10 s is where the track of a1 is; other heights are no way out.
    [(20.0, 0.0, 4.0, True), (20.0, 0.0, 90.0, True), (20.0, 30.0, 4.0, False)],
)
def test_an_aircraft_of_another_show_is_seen_from_this_one(
    north: float, east: float, height: float, near: bool
) -> None:
    """Its origin is 100 m to the south, and its own time is another one."""
    frame = LocalFrame(*HERE)
    origin = frame.to_geodetic(-100.0, 0.0)
    place = (north + 100.0, east, height)
    other = replace(by_speed("other", "b1", 777.0, place, (0.0, 0.0, 0.0)), origin=origin)
    other = ConflictMonitor.from_bytes(other.to_bytes())
    ones = neighbours()
    ones.hear(other.seen_from(HERE, 5.0, "show"), 0.0)
    assert (ones.near(on_track(5.0), 0.0) is not None) is near
    assert ones.missing(0.0) == neighbours().missing(0.0), (
        "it is none of those that this show needs"
    )


@pytest.mark.parametrize("seed", range(5))
def test_no_origin_and_no_place_of_a_stranger_raises_anything_else(seed: int) -> None:
    chance = random.Random(seed)
    odd: list[object] = [
        0.0,
        -0.0,
        89.0,
        -89.0,
        90.0,
        180.0,
        360.0,
        1e6,
        -1e6,
        1e300,
        math.nan,
        None,
        "x",
        [],
    ]
    for _ in range(400):
        origin = [chance.choice(odd) for _ in range(chance.randint(0, 3))]
        place = [chance.choice([0.0, 1e6, -1e6, 5.0]) for _ in range(3)]
        data = json.dumps(["other", "b1", 0.0, 0.0, [place] * 21, *origin]).encode()
        try:
            found = ConflictMonitor.from_bytes(data)
        except BadShow:
            continue
        if found.origin is not None:
            seen = found.seen_from(HERE, 5.0, "show")
            ones = neighbours()
            ones.hear(seen, 0.0)
            ones.near(on_track(5.0), 0.0)


def test_what_is_sent_comes_out_as_it_went_in() -> None:
    ahead = on_track(5.0, off=0.123)
    read = ConflictMonitor.from_bytes(ahead.to_bytes())
    assert (read.show, read.name, read.at, read.down_from) == ("show", "a1", 5.0, 20.0)
    assert all(math.dist(a, b) < 0.01 for a, b in zip(read.places, ahead.places, strict=True))
    assert len(ahead.to_bytes()) < 800


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b"[1,2,3,4,5]",
        b'["s","n",0,0,[]]',
        b'["s","n",0,0,[[1,2]]]',
        b'["s","n",NaN,0,[[1,2,3]]]',
        b'["s","n",0,Infinity,[[1,2,3]]]',
        b'["s","n",0,0,[[1,2,1e300]]]',
        b'["s","n",0,0,[[1,2,"x"]]]',
        b'["s","n",0,0,[["1e999",2,3]]]',
        b"[" * 4000,
        json.dumps(["s", "n", 0, 0, [[1, 2, 3]] * 2000]).encode(),
        b"\xff",
    ],
)
def test_nonsense_is_refused(data: bytes) -> None:
    with pytest.raises(BadShow, match="the path of an aircraft"):
        ConflictMonitor.from_bytes(data)


def test_strangers_do_not_fill_the_memory() -> None:
    ones = neighbours()
    for number in range(5000):
        ones.hear(by_speed("show", f"x{number}", 5.0, (900.0, 0, 4), (0, 0, 0)), 0.0)
    assert len(ones._heard) <= 1000


def test_where_one_may_stand_is_each_tenth_of_a_second_of_its_way() -> None:
    """Two metres a second for ten seconds: a hundred and one places, 0.2 m apart."""
    ahead = by_speed("show", "a1", 5.0, (0.0, 1.0, 4.0), (2.0, 0.0, 0.0))
    stands = ahead.stands()
    assert len(stands) == 101
    assert (stands[0], stands[-1]) == (ahead.places[0], ahead.places[-1])
    apart = {round(math.dist(a, b), 3) for a, b in pairwise(stands)}
    assert apart == {0.2}
    assert ahead.way == pytest.approx(20.0, abs=0.01)


def test_a_silent_one_is_looked_for_only_as_far_as_it_can_have_come() -> None:
    """It flies from 100 s on; what comes later on its way is not where it stands now."""
    ones = neighbours()
    other = ConflictMonitor(
        "show", "a2", 100.0, tuple((0.0, 2.0 * n, 4.0) for n in range(21)), 999.0
    )
    ones.hear(other, 0.0)
    here = tuple((0.0, 12.0, 4.0) for _ in range(21))
    hovers = ConflictMonitor("show", "a1", 100.0 + SILENT_S + 0.1, here, 999.0)
    silent = ones.near(hovers, SILENT_S + 0.1)
    assert silent is not None
    assert silent.at == pytest.approx(102.3, abs=0.5), "from 9 m on it is nearer than 3 m"


# -- values: half a second between places, a tenth between looks, and from when on -----------------


def test_one_beside_its_track_is_as_far_beside_it_for_ten_seconds() -> None:
    """At each half second; it may land from the end of its track on, and a leaver at once."""
    here = tuple(a + b for a, b in zip(NORTH.moment(12.0).place, (0.75, -0.5, 0.25), strict=True))
    ahead = by_track("show", NORTH, 12.0, (here[0], here[1], here[2]))
    assert (ahead.show, ahead.name, ahead.at, ahead.down_from) == ("show", "a1", 12.0, 20.0)
    assert len(ahead.places) == 21
    for step, place in enumerate(ahead.places):
        wanted = NORTH.moment(12.0 + step / 2).place
        assert place == pytest.approx((wanted[0] + 0.75, -0.5, 4.25))
    left = by_speed("show", "a2", 7.0, (10.0, -20.0, 4.0), (1.0, -2.0, 0.5))
    assert (left.name, left.at, left.down_from, len(left.places)) == ("a2", 7.0, 7.0, 21)
    assert left.places[1] == pytest.approx((10.5, -21.0, 4.25))
    assert left.places[-1] == pytest.approx((20.0, -40.0, 9.0))
    assert left.place(8.25) == pytest.approx((11.25, -22.5, 4.625))
    assert left.way == pytest.approx(10 * math.sqrt(1 + 4 + 0.25))


def test_a_path_goes_over_the_network_in_centimetres() -> None:
    one = ConflictMonitor("s", "n", 1.23449, ((1.234, -5.678, 9.0), (0.0, 0.25, 0.5)), 7.5)
    assert one.to_bytes() == b'["s","n",1.234,7.5,[[1.23,-5.68,9.0],[0.0,0.25,0.5]]]'
    longest = b'["s","n",0,0,[[1,2,3]]]'
    padded = longest[:1] + b" " * (4096 - len(longest)) + longest[1:]
    assert ConflictMonitor.from_bytes(padded).places == ((1.0, 2.0, 3.0),)
    with pytest.raises(BadShow, match="too long"):
        ConflictMonitor.from_bytes(padded + b" ")
    edge = b'["s","n",1e6,-1e6,[[1e6,-1e6,0]]]'
    assert ConflictMonitor.from_bytes(edge).down_from == -1e6


def hovers(name: str, at: float, *place: float, down_from: float = 999.0) -> ConflictMonitor:
    return ConflictMonitor("show", name, at, ((place[0], place[1], place[2]),) * 21, down_from)


@pytest.mark.parametrize(
    ("own", "other", "distance"),
    [
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 2, 0, 4), 2.0),
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 0, 0, 6.5), 2.5),
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 0, 0, 7), None),
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 0, -3, 4), None),
        # From above one that may be landing reaches down; one that flies does not.
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 1, 0, 30, down_from=5.0), 1.0),
        (hovers("a1", 5.0, 0, 0, 4), hovers("a2", 5.0, 1, 0, 1, down_from=5.0), None),
        (hovers("a1", 5.0, 1, 0, 30, down_from=5.0), hovers("a2", 5.0, 0, 0, 4), 1.0),
        (hovers("a1", 5.0, 1, 0, 4, down_from=5.0), hovers("a2", 5.0, 0, 0, 30), None),
        (
            hovers("a1", 5.0, 0, 0, 4, down_from=5.0),
            hovers("a2", 5.0, 0, 2, 40, down_from=5.0),
            2.0,
        ),
    ],
)
def test_how_near_another_one_is(
    own: ConflictMonitor, other: ConflictMonitor, distance: float | None
) -> None:
    ones = neighbours()
    ones.hear(other, 5.0)
    near = ones.near(own, 5.0)
    assert near == (None if distance is None else Near("a2", 5.0, distance, 0.0))


def test_two_that_come_nearer_are_seen_at_the_first_tenth_of_a_second_that_is_too_near() -> None:
    """20 m apart, at 2 m/s each towards the other: nearer than 3 m after 4.25 s."""
    ones = neighbours()
    ones.hear(by_speed("show", "a2", 5.0, (20.0, 0.0, 4.0), (-2.0, 0.0, 0.0)), 5.0)
    near = ones.near(by_speed("show", "a1", 5.0, (0.0, 0.0, 4.0), (2.0, 0.0, 0.0)), 5.0)
    assert near is not None
    assert near.at == pytest.approx(9.3)
    assert near.distance_m == pytest.approx(2.8)


@pytest.mark.parametrize(
    ("silent", "at", "is_near"),
    [(1.0, 5.0, False), (1.125, 5.0, True), (1.125, 4.75, True), (1.125, 5.25, False)],
)
def test_from_a_second_of_silence_on_one_may_stand_for_the_next_five_seconds(
    silent: float, at: float, is_near: bool
) -> None:
    """The other one flew off; this one comes to where it was, at 2 m/s."""
    ones = neighbours()
    there = tuple((20.0, 4.0 * step, 4.0) for step in range(21))
    ones.hear(ConflictMonitor("show", "a2", 100.0, there, 999.0), 0.0)
    # Three metres from it ``at`` seconds from now, and nearer from then on.
    here = tuple((17.01 - 2.0 * at + step, 0.0, 4.0) for step in range(21))
    own = ConflictMonitor("show", "a1", 100.0 + silent, here, 999.0)
    near = ones.near(own, silent)
    assert (near is not None) is is_near
    if near is not None:
        assert near.silent_s == silent


@pytest.mark.parametrize(("age", "missing"), [(0.0, 1), (2.0, 1), (2.1, 2)])
def test_who_was_not_heard_for_two_seconds_is_missing(age: float, missing: int) -> None:
    ones = Neighbours("show", "a1", 3.0, 2)
    ones.hear(hovers("a2", 5.0, 0, 0, 4), 10.0)
    assert ones.missing(10.0 + age) == missing


def test_more_than_there_are_leaves_nobody_missing() -> None:
    ones = Neighbours("show", "a1", 3.0)
    ones.hear(hovers("a2", 5.0, 0, 0, 4), 10.0)
    assert ones.missing(10.0) == 0


# -- whether the rest of a track keeps away from where a silent one may stand ----------------------


def test_it_says_when_it_first_comes_near_to_a_place() -> None:
    rest = RestOfTrack(NORTH)
    reached = next(at / 100 for at in range(2000) if NORTH.moment(at / 100).place[0] > 17.0)
    assert rest.meets([(20.0, 0.0, 4.0)], 3.0, 0.0) == pytest.approx(reached, abs=0.2)
    assert rest.meets([(20.0, 3.1, 4.0)], 3.0, 0.0) is None
    assert rest.meets([(20.0, 2.9, 4.0), (90.0, 0.0, 4.0)], 3.0, 0.0) is not None


def test_what_lies_behind_it_does_not_count() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(10.0, 0.0, 4.0)], 3.0, 10.0) is None
    assert rest.meets([(10.0, 0.0, 4.0)], 3.0, 0.0) is not None


def test_it_stays_at_its_last_point_and_may_land_there() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(41.0, 1.0, 4.0)], 3.0, 60.0) == 60.0
    assert rest.meets([(40.0, 0.0, 0.0)], 3.0, 0.0) == pytest.approx(20.0, abs=0.2)


def test_one_that_stands_above_may_come_down_and_one_below_does_not_rise() -> None:
    rest = RestOfTrack(NORTH)
    assert rest.meets([(20.0, 0.0, 30.0)], 3.0, 0.0) is not None
    assert rest.meets([(20.0, 0.0, 0.0)], 3.0, 0.0) is None


def test_a_turn_between_two_moments_of_a_long_show_is_not_overlooked() -> None:
    """Of 8192 s every other second is looked at; at 21 s it is 1.25 m further than at 20 and 22."""
    points = (0, 0, 0, 4), (17, 0, 0, 4), (21, 8, 0, 4), (25, 0, 0, 4), (8192, 0, 0, 4)
    found = RestOfTrack(track("a1", *points)).meets([(10.9, 0.0, 4.0)], 3.0, 0.0)
    assert found == pytest.approx(21.0, abs=0.4)


@pytest.mark.parametrize("least", [-0.1, 1000.1, math.nan])
def test_what_is_no_distance_between_two_is_refused(least: float) -> None:
    for right in (0.0, 1000.0):
        assert neighbours(right).least_m == right
    with pytest.raises(BadShow, match="0 to 1000 m"):
        neighbours(least)


def test_no_place_that_a_track_comes_near_to_is_overlooked() -> None:
    """Against looking at each hundredth of a second."""
    seed = random.randrange(1 << 32)
    chance = random.Random(seed)
    for _ in range(60):
        one, begin = random_track(chance), chance.uniform(0, 20)
        ways: list[Vector] = [
            (chance.uniform(-40, 40), chance.uniform(-40, 40), chance.uniform(0, 20))
            for _ in range(chance.randint(1, 4))
        ]
        last = max(begin, one.end)
        times = [begin + (last - begin) * index / 2000 for index in range(2000)]
        truth = min(nearest(one.moment(at).place, ways, has_ended=False) for at in times)
        truth = min(truth, nearest(one.moment(last).place, ways, has_ended=True))
        rest = RestOfTrack(one)
        # It looks ten times a second, so no moment is further than that from one it looks at.
        between = 0.05 * math.hypot(*one.fastest)
        assert rest.meets(ways, truth + 0.05 + between, begin) is not None, f"seed {seed}"
        if truth > 0.1:
            assert rest.meets(ways, truth - 0.05, begin) is None, f"seed {seed}"


def test_a_long_track_of_which_many_are_silent_costs_little() -> None:
    """Its aircraft needs a setpoint every 20 ms."""
    points = [(10.0 * n, 8.0 * (n % 20), 5.0 * (n // 20), 4.0) for n in range(1000)]
    rest = RestOfTrack(track("a1", *points))
    rest.meets([(0.0, 900.0, 4.0)], 3.0, 0.0)
    ways = [(math.sin(n), 900.0, 4.0) for n in range(101)]
    took = []
    for _ in range(5):  # a machine that is shared makes some of them dearer
        began = time.process_time()
        for _ in range(100):
            assert rest.meets(ways, 3.0, 0.0) is None
        took.append(time.process_time() - began)
    assert min(took) < 0.1
