"""Orders that come too late."""

from __future__ import annotations

import math
import random

import pytest

from m100link.apps.agent.messages import Steer
from m100link.apps.fleet.expiry import (
    BROKEN_S,
    DRIFT,
    MAX_AGE_S,
    MOST_AGE_S,
    ClockEstimate,
    Dropped,
    OrderAges,
    SetpointStream,
    require_young,
)
from m100link.errors import GuardRefused
from m100link.protocol.setpoint import Setpoint


@pytest.fixture
def ages() -> OrderAges:
    return OrderAges()


def test_what_is_in_order_is_heard(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.1)
    ages.hear(1, 10.0, 10.2)  # two at once
    ages.hear(1, 11.0, 11.0 + MOST_AGE_S)
    ages.revoke(20.0)
    ages.hear(1, 20.0, 20.1)  # after the answer of what revoked


def test_what_is_old_is_refused(ages: OrderAges) -> None:
    with pytest.raises(GuardRefused, match="nobody waits") as caught:
        ages.hear(1, 10.0, 10.1 + MOST_AGE_S)
    assert caught.value.guard == "order_age"
    with pytest.raises(GuardRefused, match="nobody waits"):
        ages.hear(1, 0.0, 1e6)  # who does not say when


def test_what_was_revoked_is_refused(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.0)
    ages.revoke(10.5)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.check(10.0, 10.6)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.hear(2, 10.4, 10.6)


def test_of_one_asker_the_newer_one_counts_and_a_later_lease_begins_anew(ages: OrderAges) -> None:
    ages.hear(1, 10.0, 10.0)
    with pytest.raises(GuardRefused, match="later was heard before"):
        ages.hear(1, 9.9, 10.1)
    ages.hear(2, 9.9, 10.1)


def test_a_landing_is_asked_for_its_age_alone(ages: OrderAges) -> None:
    ages.revoke(20.0)
    require_young(16.0, 20.5)  # STOP came between: both want it to be safe
    for made_at in (10.0, 0.0, float("nan"), -1.0):
        with pytest.raises(GuardRefused, match="nobody waits"):
            require_young(made_at, 20.5)


def test_what_was_made_by_the_clock_of_before_a_start_is_refused(ages: OrderAges) -> None:
    require_young(20.9, 20.0)  # who reckons its time from an answer is wrong by a little
    with pytest.raises(GuardRefused, match=r"made 980\.0 s from now") as caught:
        ages.hear(1, 1000.0, 20.0)
    assert caught.value.guard == "order_age"
    ages.hear(1, 20.0, 20.1)
    with pytest.raises(GuardRefused, match="from now"):
        require_young(float("inf"), 20.0)


# -- which setpoints fly: each that could be wrong, beside one that is not -------------------------


NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def drop(
    stream: SetpointStream, sent_at: float, now: float, *, begins: bool = False, fence: int = 5
) -> Dropped | None:
    return stream.drop(Steer(fence, sent_at, 0.2, NORTH), begins=begins, fence=5, now=now)


@pytest.fixture
def stream() -> SetpointStream:
    made = SetpointStream()
    assert drop(made, 10.0, 10.05, begins=True) is None
    return made


def test_a_stream_goes_on(stream: SetpointStream) -> None:
    for number in range(1, 200):
        assert drop(stream, 10.0 + number / 20, 10.05 + number / 20) is None


def test_nothing_flies_that_was_not_begun() -> None:
    assert drop(SetpointStream(), 10.0, 10.0) is Dropped.BROKEN


@pytest.mark.parametrize("fence", [4, 6])
def test_another_lease_is_stale(stream: SetpointStream, fence: int) -> None:
    assert drop(stream, 10.1, 10.1, begins=True, fence=fence) is Dropped.STALE


@pytest.mark.parametrize("late", [MAX_AGE_S + 0.01, -MAX_AGE_S - 0.01])
def test_what_was_long_on_its_way_or_is_from_the_future_is_late(
    stream: SetpointStream, late: float
) -> None:
    assert drop(stream, 10.5 - late, 10.5, begins=True) is Dropped.LATE


@pytest.mark.parametrize("sent_at", [10.0, 9.95])
def test_what_came_or_was_overtaken_is_repeated(stream: SetpointStream, sent_at: float) -> None:
    assert drop(stream, sent_at, 10.1, begins=True) is Dropped.REPEATED


def test_a_stream_that_was_cut_does_not_go_on_until_it_is_begun(stream: SetpointStream) -> None:
    again = 10.06 + BROKEN_S
    assert drop(stream, again, again) is Dropped.BROKEN
    assert drop(stream, again + 0.05, again + 0.05) is Dropped.BROKEN, "that does not begin it"
    assert drop(stream, again + 0.1, again + 0.1, begins=True) is None
    assert drop(stream, again + 0.15, again + 0.15) is None


# -- the time elsewhere: the bound is kept whatever the network does, and what is nonsense is n ----


class Other:
    """Another machine's clock, and the way there and back."""

    def __init__(self, chance: random.Random, offset: float, drift: float) -> None:
        self.chance = chance
        self.offset = offset
        self.drift = drift

    def read(self, now: float) -> float:
        return now * (1 + self.drift) + self.offset

    def ask(self, now: float, estimate: ClockEstimate, fastest: float = 0.0002) -> float:
        """One round trip with ways of any length; returns when it ended."""
        there, stay, back = (fastest + self.chance.expovariate(1 / 0.005) for _ in range(3))
        arrived, left = now + there, now + there + stay
        assert estimate.heard(now, self.read(arrived), self.read(left), left + back)
        return left + back


@pytest.mark.parametrize("seed", range(30))
def test_the_true_time_is_always_within_the_bound(seed: int) -> None:
    chance = random.Random(seed)
    drift = chance.uniform(-0.9, 0.9) * DRIFT
    other, estimate, now = Other(chance, chance.uniform(-1e6, 1e6), drift), ClockEstimate(), 1000.0
    for _ in range(200):
        now = other.ask(now, estimate)
        for later in (0.0, chance.uniform(0, 60)):
            found = estimate.offset(now + later)
            assert found is not None
            wrong = other.read(now + later) - (now + later) - found.seconds
            assert abs(wrong) <= found.bound + 1e-9
        now += chance.uniform(0.05, 20)
    assert (estimate.steps, estimate.refused) == (0, 0)


def test_the_bound_is_half_of_the_round_trip_and_more_trips_narrow_it() -> None:
    estimate = ClockEstimate()
    assert estimate.heard(10.0, 110.004, 110.004, 10.010)  # 4 ms there, 6 ms back
    found = estimate.offset(10.010)
    assert found is not None
    assert found.bound == pytest.approx(0.005, abs=1e-5)
    assert found.seconds == pytest.approx(99.999, abs=1e-5)
    assert estimate.heard(11.0, 111.001, 111.001, 11.010)  # 1 ms there, 9 ms back
    narrower = estimate.offset(11.010)
    assert narrower is not None
    assert narrower.bound < 0.0037
    assert abs(narrower.seconds - 100.0) <= narrower.bound


def test_the_bound_widens_while_nobody_answers() -> None:
    estimate = ClockEstimate()
    assert estimate.offset(0.0) is None
    estimate.heard(0.0, 100.0, 100.0, 0.002)
    first, later = estimate.offset(0.002), estimate.offset(100.002)
    assert first is not None
    assert later is not None
    assert later.bound - first.bound == pytest.approx(100 * DRIFT)
    assert later.seconds == pytest.approx(first.seconds)


@pytest.mark.parametrize(
    "times",
    [
        (1.0, 101.0, 101.0, 0.9),  # came before it left
        (1.0, 101.0, 100.9, 1.1),  # there, too
        (1.0, 101.0, 102.0, 1.1),  # kept there for longer than all of it took
        (1.0, math.nan, 101.0, 1.1),
        (1.0, 101.0, math.inf, 1.1),
    ],
)
def test_what_no_clock_says_is_not_believed(times: tuple[float, float, float, float]) -> None:
    estimate = ClockEstimate()
    assert not estimate.heard(*times)
    assert estimate.refused == 1
    assert estimate.offset(1.1) is None


def test_a_clock_that_was_set_is_noticed_and_measured_anew() -> None:
    estimate = ClockEstimate()
    for second in range(5):
        estimate.heard(second, second + 100, second + 100, second + 0.002)
    estimate.heard(5.0, 135.0, 135.0, 5.002)
    assert estimate.steps == 1
    found = estimate.offset(5.002)
    assert found is not None
    assert found.seconds == pytest.approx(130.0, abs=0.002)


@pytest.mark.parametrize("seed", range(30))
def test_what_it_shows_at_the_earliest_is_never_later_and_never_goes_back(seed: int) -> None:
    """Order ages count from it: too late a time would let an old order move the aircraft."""
    chance = random.Random(seed)
    drift = chance.uniform(-0.9, 0.9) * DRIFT
    other, estimate, now, before = Other(chance, 1e3, drift), ClockEstimate(), 1000.0, 0.0
    assert estimate.at_least(now) == 0.0, "nobody knows"
    assert (estimate.way_s, estimate.silent_s(now)) == (math.inf, math.inf)
    for _ in range(200):
        now = other.ask(now, estimate)
        assert estimate.silent_s(now) == 0.0
        for later in (now, now + chance.uniform(0, 0.05)):
            found = estimate.at_least(later)
            assert before <= found <= other.read(later) + 1e-9
            before = found
        now += chance.uniform(0.05, 20)
    assert estimate.silent_s(now) <= 20.0


def test_after_a_clock_was_set_the_earliest_counts_anew() -> None:
    estimate = ClockEstimate()
    estimate.heard(0.0, 500.0, 500.0, 0.002)
    assert estimate.at_least(0.002) == pytest.approx(500.0, abs=0.003)
    estimate.heard(1.0, 20.0, 20.0, 1.002)  # its computer was started anew
    assert estimate.at_least(1.002) == pytest.approx(20.0, abs=0.003)


def test_a_way_that_became_slow_is_slow_however_well_the_clock_is_known() -> None:
    estimate = ClockEstimate()
    estimate.heard(0.0, 100.005, 100.005, 0.01)
    for second in range(1, 8):
        estimate.heard(second, second + 101.0, second + 101.0, second + 2.0)
    assert estimate.way_s == pytest.approx(0.005, abs=1e-5)
    estimate.heard(8.0, 109.0, 109.0, 10.0)
    assert estimate.way_s == pytest.approx(1.0, abs=1e-3)
    found = estimate.offset(10.0)
    assert found is not None
    assert found.bound < 0.01
