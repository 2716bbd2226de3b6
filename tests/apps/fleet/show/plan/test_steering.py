"""Steering by a timed track: no aircraft, only arithmetic."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from m100link.apps.fleet.show.plan.steering import LeftShow, ShowRefused, TrackSteering, Why
from tests.apps.fleet.show.shows import track

FLOWN = track("a1", (0, 0, 0, 5), (10, 20, 0, 5), (20, 40, 0, 5), (30, 40, 0, 9))


def steering(fastest: float = 10.0) -> TrackSteering:
    return TrackSteering(FLOWN, fastest)


def test_before_the_beginning_it_is_kept_at_its_first_point() -> None:
    assert steering().step(-5.0, 0.0, (0, 0, 5)) == (0.0, 0.0, 0.0)
    pulled = steering().step(-5.0, 0.0, (0.5, -0.5, 5.5))
    assert pulled is not None
    north, east, up = pulled
    assert north < 0 < east
    assert up < 0


def test_it_asks_for_what_the_track_does_when_the_velocity_has_followed() -> None:
    asked = steering().step(10.0, 0.0, (20, 0, 5))
    assert asked == pytest.approx(FLOWN.moment(10.65).velocity, abs=1e-9)


def test_it_never_asks_for_more_than_it_may_horizontally() -> None:
    asked = steering(fastest=1.0).step(10.0, 0.0, (19, 1, 5))
    assert asked is not None
    assert math.hypot(*asked[:2]) == pytest.approx(1.0)


@pytest.mark.parametrize(("begin", "end", "most"), [(5, 65, 3.0), (65, 5, -3.0)])
def test_it_never_asks_for_more_than_3_m_s_up_or_down(
    begin: float, end: float, most: float
) -> None:
    steep = track("a1", (0, 0, 0, begin), (10, 0, 0, end))
    asked = TrackSteering(steep, 10.0).step(5.0, 0.0, (0, 0, 35))
    assert asked is not None
    assert asked[2] == pytest.approx(most)


@pytest.mark.parametrize("axis", range(3))
def test_at_the_wall_of_the_tube_it_leaves(axis: int) -> None:
    here = [20.0, 0.0, 5.0]
    here[axis] += 1.499
    assert steering().step(10.0, 0.0, (here[0], here[1], here[2])) is not None
    here[axis] += 0.002
    with pytest.raises(LeftShow) as caught:
        steering().step(10.0, 0.0, (here[0], here[1], here[2]))
    assert (caught.value.why, caught.value.at, caught.value.limit) == (Why.TUBE, 10.0, 1.5)


def test_an_unsure_clock_comes_before_the_place() -> None:
    with pytest.raises(LeftShow) as caught:
        steering().step(math.nan, math.inf, (99, 0, 5))
    assert caught.value.why is Why.CLOCK
    assert steering().step(10.0, 0.05, (20, 0, 5)) is not None


@pytest.mark.parametrize("at", [-5.0, 35.0])
@pytest.mark.parametrize(
    ("off", "asked"),
    [
        ((0.5, 0.0, 0.0), (-0.3, 0.0, 0.0)),
        ((0.0, -0.25, 0.0), (0.0, 0.15, 0.0)),
        ((0.0, 0.0, 0.75), (0.0, 0.0, -0.75)),
        ((0.0, 0.0, -0.5), (0.0, 0.0, 0.5)),
    ],
)
def test_each_metre_off_asks_for_0_6_m_s_back_and_upwards_for_1(
    at: float, off: tuple[float, float, float], asked: tuple[float, float, float]
) -> None:
    first, second = (0.0, 2.0, 6.0, 5.0), (40.0, 9.0, 8.0, 12.0)
    place = first if at < 0 else second
    one = track("a1", first, (30.0, *second[1:]))
    here = (place[1] + off[0], place[2] + off[1], place[3] + off[2])
    # A second after its end it counts as flown; before its begin it stands, too.
    steers = TrackSteering(one, 10.0)
    assert steers.step(min(at, 30.9), 0.0, here) == pytest.approx(asked)
    assert steers.farthest_m == pytest.approx(max(map(abs, off)))


def test_upwards_it_asks_for_what_comes_in_0_3_s_and_sideways_in_0_65_s() -> None:
    one = track("a1", (0, 0, 0, 5), (10, 20, -12, 14))
    asked = TrackSteering(one, 10.0).step(4.0, 0.0, one.moment(4.0).place)
    north, east, _ = one.moment(4.65).velocity
    assert asked == pytest.approx((north, east, one.moment(4.3).velocity[2]), abs=1e-9)


@pytest.mark.parametrize(
    ("early", "bound", "here", "why", "measured", "limit", "seen"),
    [
        (120.1, 0.0, (0, 0, 5), Why.EARLY, 120.1, 120.0, "would begin in 120 s; 120 s are"),
        (0.0, 0.0, (0, 0, 5), Why.LATE, 0.0, 0.0, "should have begun 0.00 s ago"),
        (-2.5, 0.0, (0, 0, 5), Why.LATE, 2.5, 0.0, "should have begun 2.50 s ago"),
        (9.0, 0.0625, (0, 0, 5), Why.CLOCK, 0.0625, 0.05, "by 62 ms; 50 ms are allowed"),
        (9.0, math.inf, (0, 0, 5), Why.CLOCK, math.inf, 0.05, "by any amount; 50 ms are"),
        (9.0, -0.01, (0, 0, 5), Why.CLOCK, -0.01, 0.05, "by any amount; 50 ms are"),
        (9.0, 0.0, (0, 0, 7), Why.PLACE, 2.0, 1.5, "is 2.0 m from where its track begins; 1.5 m"),
        (9.0, 0.0, (1.5, 0.5, 5), Why.PLACE, math.sqrt(2.5), 1.5, "is 1.6 m from where"),
    ],
)
def test_what_is_not_ready_says_what_was_measured_and_what_is_allowed(
    early: float,
    bound: float,
    here: tuple[float, float, float],
    why: Why,
    measured: float,
    limit: float,
    seen: str,
) -> None:
    for ready in ((120.0, 0.05, (1.5, 0.0, 5.0)), (0.01, 0.0, (0.0, 0.0, 3.5))):
        steering().require_ready(*ready)
    with pytest.raises(ShowRefused) as caught:
        steering().require_ready(early, bound, here)
    assert (caught.value.why, caught.value.limit) == (why, limit)
    assert caught.value.measured == pytest.approx(measured)
    assert seen in caught.value.seen


def test_it_takes_off_below_its_first_point_at_any_height_and_nowhere_else() -> None:
    one = TrackSteering(track("a1", (0, 30, -20, 5), (10, 40, -20, 5)), 10.0)
    for height in (-3.0, 0.0, 50.0):
        one.require_below((30.0, -18.5, height))
        one.require_below((31.5, -20.0, height))
    for here, off in (((30.0, -18.4, 5.0), 1.6), ((-20.0, 30.0, 5.0), 50 * math.sqrt(2))):
        with pytest.raises(ShowRefused) as caught:
            one.require_below(here)
        assert (caught.value.why, caught.value.limit) == (Why.PLACE, 1.5)
        assert caught.value.measured == pytest.approx(off)


def test_a_track_that_is_faster_than_the_guards_allow_is_refused() -> None:
    """From rest to rest 40 m in 10 s: 6 m/s in the middle."""
    fast = track("a1", (0, 0, 0, 5), (10, 0, -40, 25))
    TrackSteering(fast, 6.1).require_fast_enough()
    with pytest.raises(ShowRefused) as caught:
        TrackSteering(fast, 5.9).require_fast_enough()
    assert (caught.value.why, caught.value.limit) == (Why.SPEED, 5.9)
    assert caught.value.measured == pytest.approx(6.0, abs=0.05)


@pytest.mark.parametrize("bound", [0.051, math.nan])
def test_a_bound_that_is_too_wide_or_none_ends_it(bound: float) -> None:
    with pytest.raises(LeftShow, match=r"by 51 ms|by any amount") as caught:
        steering().step(10.0, bound, (20, 0, 5))
    assert (caught.value.at, caught.value.limit) == (10.0, 0.05)
    assert caught.value.measured == pytest.approx(bound, nan_ok=True)
    with pytest.raises(ShowRefused):
        steering().require_ready(5.0, bound, (0, 0, 5))


def test_a_place_that_is_no_number_ends_it() -> None:
    with pytest.raises(LeftShow):
        steering().step(10.0, 0.0, (math.nan, 0, 5))
    with pytest.raises(ShowRefused):
        steering().require_below((math.nan, 0, 0))
    with pytest.raises(ShowRefused):
        steering().require_ready(5.0, 0.0, (0, math.nan, 5))


def test_it_is_flown_a_second_after_its_last_point() -> None:
    one = steering()
    assert one.step(30.99, 0.0, (40, 0, 9)) is not None
    assert one.step(31.0, 0.0, (40, 0, 9)) is None


def test_what_it_keeps_is_the_worst() -> None:
    one = steering()
    for at, bound, off in ((-1.0, 0.01, 0.2), (0.015, 0.03, 0.9), (1.0, 0.02, 0.1)):
        place = FLOWN.moment(at).place
        one.step(at, bound, (place[0], place[1] + off, place[2]))
    assert one.farthest_m == pytest.approx(0.9)


def test_a_model_with_the_lag_that_is_assumed_keeps_to_the_track() -> None:
    """Velocity follows with 0.65 s, upwards with 0.3 s; it stays within 10 cm."""
    one, place, velocity, step = steering(), [0.0, 0.0, 5.0], [0.0, 0.0, 0.0], 0.02
    for index in range(round(30 / step)):
        asked = one.step(index * step, 0.0, (place[0], place[1], place[2]))
        assert asked is not None
        for axis, lag in enumerate((0.65, 0.65, 0.3)):
            velocity[axis] += (asked[axis] - velocity[axis]) * step / lag
            place[axis] += velocity[axis] * step
    assert one.farthest_m < 0.1
    speeds = [FLOWN.moment(index / 10).velocity[0] for index in range(300)]
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.2
