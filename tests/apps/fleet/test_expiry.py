"""Orders that come too late."""

from __future__ import annotations

import pytest

from m100link.apps.agent.messages import Steer
from m100link.apps.agent.orders import AfterStop
from m100link.apps.fleet.expiry import (
    Dropped,
    OrderExpiry,
    SetpointStream,
    require_young,
)
from m100link.errors import GuardRefused
from m100link.protocol.setpoint import Setpoint

ANEW = AfterStop.ANEW


@pytest.fixture
def ages() -> OrderExpiry:
    return OrderExpiry()


def test_what_is_in_order_is_heard(ages: OrderExpiry) -> None:
    ages.hear(0, ANEW, 9.5, 9.5)  # a landing needs no lease
    ages.hear(1, ANEW, 10.0, 10.1)
    ages.hear(1, ANEW, 10.0, 10.2)  # two at once
    ages.hear(1, ANEW, 11.0, 16.0)
    ages.revoke(20.0)
    ages.hear(1, ANEW, 20.01, 20.1)  # after the answer of what revoked


def test_what_is_old_is_refused(ages: OrderExpiry) -> None:
    with pytest.raises(GuardRefused, match="older than 5 s") as caught:
        ages.hear(1, ANEW, 10.0, 15.1)
    assert caught.value.guard == "order_age"
    with pytest.raises(GuardRefused, match="does not say when it was made"):
        ages.hear(1, ANEW, 0.0, 1e6)


def test_what_was_revoked_is_refused(ages: OrderExpiry) -> None:
    ages.hear(1, ANEW, 10.0, 10.0)
    ages.revoke(10.5)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.check(ANEW, 10.0, 10.6)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.hear(2, ANEW, 10.4, 10.6)
    with pytest.raises(GuardRefused, match="asked for after"):
        ages.check(AfterStop.IF_NEWER, 10.5, 10.6)  # of what is asked at one instant it comes last
    ages.hear(2, AfterStop.DONE, 10.4, 10.6)


def test_of_one_asker_the_newer_one_counts_and_a_later_lease_begins_anew(ages: OrderExpiry) -> None:
    ages.hear(1, ANEW, 10.0, 10.0)
    with pytest.raises(GuardRefused, match="later was heard before"):
        ages.hear(1, ANEW, 9.9, 10.1)
    ages.hear(2, ANEW, 9.9, 10.1)


def test_a_landing_is_asked_for_its_age_alone(ages: OrderExpiry) -> None:
    ages.revoke(20.0)
    require_young(16.0, 20.5)  # STOP came between: both want it to be safe
    for made_at in (10.0, float("nan"), -1.0):
        with pytest.raises(GuardRefused, match="older than 5 s"):
            require_young(made_at, 20.5)
    with pytest.raises(GuardRefused, match="of unknown age"):
        require_young(0.0, 20.5)


def test_what_was_made_by_the_clock_of_before_a_start_is_refused(ages: OrderExpiry) -> None:
    require_young(20.9, 20.0)  # who reckons its time from an answer is wrong by a little
    with pytest.raises(GuardRefused, match=r"980\.0 s in the future") as caught:
        ages.hear(1, ANEW, 1000.0, 20.0)
    assert caught.value.guard == "order_age"
    ages.hear(1, ANEW, 20.0, 20.1)
    with pytest.raises(GuardRefused, match="in the future"):
        require_young(float("inf"), 20.0)


@pytest.mark.parametrize(
    ("made_at", "now", "seen", "measured", "limit"),
    [
        (3.0, 8.0, None, 0.0, 0.0),  # five seconds old, and not more
        (3.0, 8.25, "an order of 5.2 s ago", 5.25, 5.0),
        (9.0, 8.0, None, 0.0, 0.0),  # a second ahead, and not more
        (9.25, 8.0, "an order from 1.2 s in the future", -1.25, -1.0),
    ],
)
def test_an_order_is_done_from_five_seconds_after_to_a_second_before_it_was_made(
    made_at: float, now: float, seen: str | None, measured: float, limit: float
) -> None:
    if seen is None:
        require_young(made_at, now)
        return
    with pytest.raises(GuardRefused, match=seen) as caught:
        require_young(made_at, now)
    assert (caught.value.measured, caught.value.limit) == (measured, limit)


def test_a_step_is_as_old_as_the_request_that_it_is_of(ages: OrderExpiry) -> None:
    ages.revoke(10.0)
    ages.check(ANEW, 10.5, 10.5, began_at=10.25)
    with pytest.raises(GuardRefused, match="asked for after") as caught:
        ages.check(ANEW, 10.5, 10.75, began_at=9.5)
    assert (caught.value.measured, caught.value.limit) == (0.25, 5.0)
    ages.check(AfterStop.DONE, 10.5, 10.5, began_at=9.5)


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


@pytest.mark.parametrize(
    ("sent_at", "now", "dropped"),
    [
        (0.0, 0.2, None),
        (0.2, 0.0, None),
        (10.3, 10.51, Dropped.LATE),
        (10.51, 10.3, Dropped.LATE),
        (10.0, 11.0, Dropped.LATE),
    ],
)
def test_what_was_more_than_0_2_s_on_its_way_or_is_from_the_future_is_late(
    sent_at: float, now: float, dropped: Dropped | None
) -> None:
    assert drop(SetpointStream(), sent_at, now, begins=True) is dropped


@pytest.mark.parametrize("sent_at", [10.0, 9.95])
def test_what_came_or_was_overtaken_is_repeated(stream: SetpointStream, sent_at: float) -> None:
    assert drop(stream, sent_at, 10.1, begins=True) is Dropped.REPEATED


def test_a_stream_that_was_cut_does_not_go_on_until_it_is_begun(stream: SetpointStream) -> None:
    assert drop(stream, 11.04, 11.04) is None, "a second without one ends it"
    again = 12.05
    assert drop(stream, again, again) is Dropped.BROKEN
    assert drop(stream, again + 0.05, again + 0.05) is Dropped.BROKEN, "that does not begin it"
    assert drop(stream, again + 0.1, again + 0.1, begins=True) is None
    assert drop(stream, again + 0.15, again + 0.15) is None


@pytest.mark.parametrize("ahead_s", [-4.0, 0.0, 0.5, 0.99])
def test_what_was_sent_in_the_first_second_of_a_suspend_is_not_begun(
    monkeypatch: pytest.MonkeyPatch, ahead_s: float
) -> None:
    """The clock of its asker went on; that of a suspended agent stood still, and looks new."""
    slept = [0.0]
    monkeypatch.setattr("m100link.flight.guards.asleep_s", lambda: slept[0])
    ages = OrderExpiry()
    ages.hear(1, ANEW, 10.0, 10.1)
    slept[0] = 3600.0
    with pytest.raises(GuardRefused, match="this computer was suspended meanwhile"):
        ages.hear(1, ANEW, 20.0 + ahead_s, 20.0)
    with pytest.raises(GuardRefused, match="this computer was suspended meanwhile"):
        ages.require_young(AfterStop.IF_NEWER, 20.0 + ahead_s, 20.0)
    ages.require_young(AfterStop.DONE, 20.0 + ahead_s, 20.0)  # what ends something is done
    ages.hear(1, ANEW, 21.1, 21.1)
    ages.hear(1, ANEW, 22.0, 22.0)
