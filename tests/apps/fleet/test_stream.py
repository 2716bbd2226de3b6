"""Which setpoints fly: each that could be wrong, beside one that is not."""

from __future__ import annotations

import pytest

from m100link.apps.agent.messages import Steer
from m100link.apps.fleet.stream import BROKEN_S, MAX_AGE_S, Dropped, SetpointStream
from m100link.protocol.setpoint import Setpoint

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
