"""Another clock and the way to it: what holds for certain, whatever clocks and networks do.

The promises are those of the manual. An order says when it was made at the earliest, and is refused
after five seconds (docs/reference/fleet-wire.md). A setpoint is refused 0.3 s behind the fastest, a
pressed button after two seconds (docs/howto/console.md). A show begins by a clock that is known to
a bound (docs/howto/fly-a-formation.md).
"""

from __future__ import annotations

import math
import random

import pytest

from m100link.apps.agent.latency import (
    DRIFT,
    MAX_LATE,
    MAX_ORDER_LATE,
    MAX_ROUND_TRIP,
    MAX_UNHEARD,
    PAGE_GRAIN,
    ClockEstimate,
)
from m100link.apps.agent.messages import Steer
from m100link.apps.agent.orders import AfterStop
from m100link.apps.fleet.expiry import MAX_AGE_S, MOST_AGE_S, OrderExpiry, SetpointStream
from m100link.errors import GuardRefused
from m100link.protocol.setpoint import Setpoint

SEEDS = pytest.mark.parametrize("seed", range(8))
FORGOTTEN_S = 30.0  # "half a minute"
STILL = Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
NONSENSE = [math.nan, math.inf, -math.inf, 1e300, -1e300, 1.7e308]


class Other:
    """Another machine's clock, and the way there and back."""

    def __init__(self, seed: int, offset: float | None = None) -> None:
        self.chance = random.Random(seed)
        self.offset = self.chance.uniform(-1e6, 1e6) if offset is None else offset
        self.drift = self.chance.uniform(-0.9, 0.9) * DRIFT
        self.estimate = ClockEstimate()

    def read(self, now: float) -> float:
        return now * (1 + self.drift) + self.offset

    def delay(self) -> float:
        """Mostly milliseconds, sometimes seconds: a mobile network."""
        mean = self.chance.choice((0.005, 0.005, 0.005, 0.1, 3.0))
        return 0.0002 + self.chance.expovariate(1 / mean)

    def ask(self, now: float) -> float:
        """One round trip; returns when it ended."""
        there = now + self.delay()
        back = there + self.delay()
        if self.chance.random() < 0.3:  # the answer is lost
            return now
        assert self.estimate.heard(now, self.read(there), back)
        return back


# -- what the other clock shows --------------------------------------------------------------------


@SEEDS
def test_the_true_time_is_always_within_the_bound(seed: int) -> None:
    other, now = Other(seed), 1000.0
    for _ in range(200):
        now = other.ask(now)
        for later in (now, now + other.chance.uniform(0, 60)):
            found = other.estimate.offset(later)
            if found is not None:
                assert abs(other.read(later) - later - found.seconds) <= found.bound + 1e-9
        now += other.chance.uniform(0.05, 20)
    assert other.estimate.steps == 0


def test_the_bound_is_half_of_the_round_trip_and_more_trips_narrow_it() -> None:
    estimate = ClockEstimate()
    assert estimate.offset(10.0) is None
    assert estimate.heard(10.0, 110.004, 10.010)  # 4 ms there, 6 ms back
    found = estimate.offset(10.010)
    assert found is not None
    assert (found.seconds, found.bound) == pytest.approx((99.999, 0.005), abs=2e-5)
    assert estimate.heard(11.0, 111.001, 11.010)  # 1 ms there, 9 ms back
    narrower = estimate.offset(11.010)
    assert narrower is not None
    assert narrower.bound < 0.0037
    assert abs(narrower.seconds - 100.0) <= narrower.bound


def test_the_bound_widens_while_nobody_answers() -> None:
    estimate = ClockEstimate()
    estimate.heard(0.0, 100.0, 0.002)
    first, later = estimate.offset(0.002), estimate.offset(100.002)
    assert first is not None
    assert later is not None
    assert later.bound - first.bound == pytest.approx(0.01), "6 ms a minute"
    assert later.seconds == pytest.approx(first.seconds)
    earlier = estimate.offset(-1e3)
    assert earlier is not None
    assert earlier.bound == 0.0, "what was not measured yet is no bound below nothing"


@SEEDS
def test_what_it_shows_at_the_earliest_is_never_later_and_never_goes_back(seed: int) -> None:
    other, now, before = Other(seed, 1e6), 1000.0, 0.0
    assert other.estimate.at_least(now) == 0.0, "nobody knows"
    for _ in range(200):
        now = other.ask(now)
        for later in (now, now + other.chance.uniform(0, 0.05)):
            found = other.estimate.at_least(later)
            assert before <= found <= other.read(later) + 1e-9
            before = found
        now += other.chance.uniform(0.06, 20)


@SEEDS
def test_no_order_of_more_than_five_seconds_ago_is_heard(seed: int) -> None:
    other, now, heard = Other(seed, 1e6), 1000.0, 0
    for _ in range(300):
        now = other.ask(now) + other.chance.uniform(0.05, 5.0)
        stamp, known = other.estimate.at_least(now), other.estimate.offset(now)
        waited = other.chance.uniform(0.0, 8.0)
        try:
            OrderExpiry().hear(0, AfterStop.ANEW, stamp, other.read(now + waited))
        except GuardRefused:
            assert known is None or waited > MOST_AGE_S - 2 * known.bound - 0.01
        else:
            heard += 1
            assert waited <= MOST_AGE_S + 8 * DRIFT
    assert heard > 50


@SEEDS
def test_no_setpoint_is_flown_that_was_longer_on_its_way_than_the_bound_allows(seed: int) -> None:
    """What is stamped at the middle of the bound is wrong by the bound at most."""
    other, now, flown = Other(seed, 1e6), 1000.0, 0
    stream = SetpointStream()
    for _ in range(300):
        now = other.ask(now) + other.chance.uniform(0.05, 2.0)
        known = other.estimate.offset(now)
        if known is None:
            continue
        waited = other.chance.uniform(0.0, 0.5)
        steer = Steer(5, now + known.seconds, 0.3, STILL)
        if stream.drop(steer, begins=True, fence=5, now=other.read(now + waited)) is None:
            flown += 1
            assert waited <= MAX_AGE_S + known.bound + DRIFT
    assert flown > 30


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.3, -0.3])
@pytest.mark.parametrize("whose", ["theirs", "ours"])
@SEEDS
def test_a_clock_that_was_set_is_noticed_by_the_next_answer(
    seed: int, whose: str, step: float
) -> None:
    other, now = Other(seed), 1e5
    for _ in range(20):
        now = other.ask(now) + 1.0
    other.estimate.heard(now, other.read(now + 0.002), now + 0.004)
    assert other.estimate.steps == 0
    jump = 0.0
    if whose == "theirs":
        other.offset += step
    else:
        jump = step  # what our clock says more
    asked = now + 1.0
    other.estimate.heard(asked + jump, other.read(asked + 0.1), asked + 0.2 + jump)
    found = other.estimate.offset(asked + 0.2 + jump)
    assert other.estimate.steps == 1
    assert found is not None
    assert abs(other.read(asked) - (asked + jump) - found.seconds) <= found.bound + 1e-4
    earliest = other.estimate.at_least(asked + 0.2 + jump)
    assert earliest <= other.read(asked + 0.2) + 1e-6


@SEEDS
def test_a_step_that_is_too_small_to_be_seen_is_forgotten_with_what_was_before(seed: int) -> None:
    other, now = Other(seed), 1e5
    for _ in range(20):
        now += 1.0
        other.estimate.heard(now, other.read(now + 0.05), now + 0.1)
    other.offset += other.chance.uniform(-0.09, 0.09)
    until = now + FORGOTTEN_S + 1.0
    while now < until:
        now += 1.0
        other.estimate.heard(now, other.read(now + 0.05), now + 0.1)
    found = other.estimate.offset(now)
    assert found is not None
    assert abs(other.read(now) - now - found.seconds) <= found.bound


def test_after_a_clock_was_set_the_earliest_counts_anew() -> None:
    estimate = ClockEstimate()
    estimate.heard(0.0, 500.0, 0.002)
    assert estimate.at_least(0.002) == pytest.approx(500.0, abs=0.003)
    estimate.heard(1.0, 20.0, 1.002)  # its computer was started anew
    assert estimate.at_least(1.002) == pytest.approx(20.0, abs=0.003)


def test_a_way_that_became_slow_is_slow_however_well_the_clock_is_known() -> None:
    estimate = ClockEstimate()
    assert (estimate.way_s, estimate.silent_s(0.0)) == (math.inf, math.inf)
    estimate.heard(0.0, 100.005, 0.01)
    for second in range(1, 8):
        estimate.heard(second, second + 101.0, second + 2.0)
    assert estimate.way_s == pytest.approx(0.005, abs=1e-5)
    estimate.heard(8.0, 109.0, 10.0)
    assert estimate.way_s == pytest.approx(1.0, abs=1e-3)
    assert estimate.silent_s(12.5) == 2.5
    found = estimate.offset(10.0)
    assert found is not None
    assert found.bound < 0.01


def test_the_limits_are_those_of_the_manual() -> None:
    found = (MAX_LATE, MAX_ROUND_TRIP, MAX_UNHEARD, MAX_ORDER_LATE, PAGE_GRAIN, DRIFT)
    assert found == (0.3, 0.4, 1.0, 2.0, 0.1, 0.0001)


# -- how late a message is -------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 1e9, -5e4])
def test_a_message_is_judged_against_the_fastest(offset: float) -> None:
    way = ClockEstimate()
    delays = [0.08, 0.05, 0.06, 1.0, 0.05]
    late = [way.late(at + offset, at + delay) for at, delay in enumerate(delays)]
    assert late == pytest.approx([0.0, 0.0, 0.01, 0.95, 0.0], abs=5 * DRIFT)


@SEEDS
def test_what_is_much_later_than_the_fastest_of_lately_is_refused(seed: int) -> None:
    other, now = Other(seed), 1000.0
    delays: list[tuple[float, float]] = []
    refused = 0
    for _ in range(600):
        now += other.chance.uniform(0.02, 0.3)
        delay = 0.01 + other.chance.expovariate(10)
        late = other.estimate.late(other.read(now), now + delay)
        delays.append((now + delay, delay))
        lately = [one for at, one in delays if at >= now + delay - FORGOTTEN_S / 2]
        known = [one for at, one in delays if at >= now + delay - FORGOTTEN_S - 1.0]
        assert delay - min(lately) - 1e-6 - FORGOTTEN_S * 2 * DRIFT <= late
        assert 0.0 <= late <= delay - min(known) + FORGOTTEN_S * 2 * DRIFT
        refused += late > MAX_LATE
    assert refused > 10


def test_clocks_that_drift_are_learned_anew() -> None:
    way = ClockEstimate()
    for second in range(3600):
        assert way.late(second * (1 - 1e-4), float(second)) < 0.01


@pytest.mark.parametrize("step", [3600.0, -3600.0, -5.0])
def test_a_clock_that_stepped_is_believed_after_half_a_minute(step: float) -> None:
    way = ClockEstimate()
    way.late(0.0, 0.0)
    first = way.late(1.0 + step, 1.0)
    assert first == pytest.approx(max(0.0, -step), abs=0.001)
    late = [way.late(second + step, second) for second in range(2, 40)]
    assert late[-1] == 0.0


def test_a_way_that_became_slow_is_the_fastest_after_half_a_minute() -> None:
    way = ClockEstimate()
    late = [way.late(second - (0.5 if second else 0.0), second) for second in range(32)]
    assert late == pytest.approx([0.0, *[0.5] * 29, 0.0, 0.0], abs=0.01)


def test_a_constant_instead_of_times_is_late_for_ever() -> None:
    way = ClockEstimate()
    late = [way.late(5.0, 5.0 + number * 0.05) for number in range(4000)]
    assert all(one > MAX_LATE for one in late[8:])


def test_a_receiver_that_stood_still_for_ten_seconds_takes_nothing_that_waited() -> None:
    way = ClockEstimate()
    sent = [number * 0.05 for number in range(200)]
    for at in sent:
        way.late(at, at + 0.01)
    waited = [10.0 + number * 0.05 for number in range(200)]
    late = [way.late(at, 20.0) for at in waited]
    flown = [at for at, one in zip(waited, late, strict=True) if one <= MAX_LATE]
    assert min(flown) >= 20.0 - MAX_LATE - 0.02
    assert way.late(20.0, 20.01) <= MAX_LATE, "the next one flies"


def test_a_sender_that_stood_still_for_ten_seconds_is_not_late() -> None:
    way = ClockEstimate()
    way.late(0.0, 0.01)
    assert way.late(10.0, 10.01) == 0.0


# -- a page that says when it heard us -------------------------------------------------------------


def test_the_round_trip_leaves_out_what_the_other_side_waited() -> None:
    way = ClockEstimate(PAGE_GRAIN)
    assert way.round_trip is None
    came = [(10.0 + 0.5, 10.7), (11.0 + 0.5, 11.45), (11.0 + 5.0, 12.0)]
    found = [(way.heard(asked_at, 77.0, now), way.round_trip) for asked_at, now in came]
    # A browser rounds its times; and it never had a time for longer than there is.
    assert found == [(True, pytest.approx(0.2)), (True, 0.0), (False, None)]


@SEEDS
def test_nothing_is_older_than_is_said(seed: int) -> None:
    """By a clock that is rounded, messages that are lost, and echoes of long ago."""
    other, now = Other(seed, 0.0), 1000.0
    grain = other.chance.choice((0.0, 1e-4, 0.016, PAGE_GRAIN))
    way = ClockEstimate(PAGE_GRAIN)

    def page(at: float) -> float:
        read = other.read(at)
        return read - read % grain if grain else read

    assert way.oldest(page(now), now) == math.inf, "nobody knows"
    heard = told = now
    for _ in range(500):
        now += other.chance.uniform(0.02, 0.5)
        if other.chance.random() < 0.7:
            told, heard = now, now + other.delay()
        sent = max(now, heard) + other.chance.uniform(0.0, 0.05)
        came = now = sent + other.delay()
        if other.chance.random() < 0.3:
            continue
        held = page(sent) - page(heard)
        way.late(page(sent), came)
        if way.heard(told + held, page(sent), came):
            trip = came - told - (sent - heard)
            assert way.round_trip is not None
            assert way.round_trip >= trip - PAGE_GRAIN - 1e-3
        for made in (sent, sent - other.chance.uniform(0.0, 5.0)):
            later = came + other.chance.uniform(0.0, 3.0)
            assert way.oldest(page(made), later) >= later - made
    assert way.steps == 0


# -- who lies, and what is nonsense ----------------------------------------------------------------


@SEEDS
def test_a_client_that_lies_about_its_time_makes_no_round_trip_shorter(seed: int) -> None:
    chance, way, now = random.Random(seed), ClockEstimate(), 1000.0
    for _ in range(300):
        now += chance.uniform(0.01, 1.0)
        trip = chance.expovariate(5)
        lie = chance.choice((now, now + chance.uniform(-1e4, 1e4), chance.choice(NONSENSE)))
        believed = way.heard(now - trip, lie, now)
        assert way.round_trip == (pytest.approx(trip) if believed else None)
        late = way.late(chance.choice((lie, chance.uniform(-1e9, 1e9))), now)
        assert late >= 0.0, "never younger than now, and always a number that is compared"
        known = way.offset(now)
        assert known is None or (math.isfinite(known.seconds) and known.bound >= 0.0)
        assert math.isfinite(way.at_least(now))
    for _ in range(40):  # who speaks the truth again is believed after half a minute
        now += 1.0
        way.heard(now - 0.01, now + 50.0, now)
    found = way.offset(now)
    assert found is not None
    assert abs(found.seconds - 50.0) <= found.bound + 1e-9 < 0.02
    assert way.late(now + 50.0, now) < 0.02


@pytest.mark.parametrize("nonsense", NONSENSE)
def test_what_no_clock_shows_is_refused_and_changes_nothing(nonsense: float) -> None:
    way = ClockEstimate()
    way.heard(0.0, 100.0, 0.01)
    before = way.offset(1.0)
    assert way.late(nonsense, 1.0) == math.inf
    assert not way.heard(0.99, nonsense, 1.0)
    assert not way.heard(nonsense, 101.0, 1.0) or nonsense < 0
    if nonsense > 0:
        assert way.offset(1.0) == before
    assert way.late(101.0, 1.01) <= MAX_LATE
    assert way.oldest(nonsense, 1.0) >= 0.0


@pytest.mark.parametrize("asked_at", [1.0, -math.inf])
def test_an_answer_of_before_its_question_is_refused(asked_at: float) -> None:
    """And one to a question that was never asked."""
    way = ClockEstimate()
    assert not way.heard(asked_at, 101.0, 0.9)
    assert (way.offset(1.1), way.round_trip, way.silent_s(1.1)) == (None, None, math.inf)


def test_what_is_made_at_a_time_that_is_not_yet_has_no_age() -> None:
    way = ClockEstimate()
    way.heard(0.0, 100.0, 0.01)
    assert way.oldest(100.5, 0.6) < 0.2
    assert way.oldest(100.7, 0.6) == math.inf
