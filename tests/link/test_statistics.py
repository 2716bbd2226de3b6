"""How long answers took, in classes."""

from __future__ import annotations

import asyncio

import pytest

from m100link.link.statistics import ROUND_TRIP_BOUNDS_S, RoundTrips
from m100link.sim import LineFaults, VirtualClockEventLoop
from m100link.testing import ConnectableAircraft


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


def test_a_time_counts_in_the_class_whose_bound_it_keeps() -> None:
    trips = RoundTrips()
    for seconds in (0.0, 0.001, 0.0011, 2.0, 2.1, 60.0):
        trips = trips.plus(seconds)
    assert trips.counts == (2, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2)
    assert trips.count == 6
    assert trips.mean_s == pytest.approx(64.1021 / 6)


def test_the_classes_end_at_1_2_and_5_of_each_decade_up_to_two_seconds() -> None:
    ends = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
    for place, milliseconds in enumerate(ends):
        counts = RoundTrips().plus(milliseconds / 1000).plus(milliseconds / 1000 * 1.001).counts
        assert counts[place : place + 2] == (1, 1), milliseconds
        assert sum(counts) == 2


def test_of_none_nothing_is_said() -> None:
    trips = RoundTrips()
    assert (trips.count, trips.mean_s, trips.within_s(0.5)) == (0, None, None)
    assert RoundTrips().plus(0.1) != trips


@pytest.mark.parametrize(
    ("share", "bound"), [(0.5, 0.01), (0.9, 0.01), (0.95, 2.0), (1.0, float("inf"))]
)
def test_the_bound_that_a_share_kept(share: float, bound: float) -> None:
    counts = [0] * (len(ROUND_TRIP_BOUNDS_S) + 1)
    counts[3], counts[10], counts[11] = 90, 9, 1
    assert RoundTrips(tuple(counts), 1.0).within_s(share) == bound


@pytest.mark.anyio
async def test_requests_are_counted_from_the_call_to_the_answer_and_lost_ones_are_not() -> None:
    virtual = ConnectableAircraft(seed=1)
    async with virtual.connect() as aircraft:
        before = aircraft.statistics().round_trips
        virtual.set_faults(LineFaults(delay=0.03))
        for _ in range(5):
            await aircraft.version()
        trips = aircraft.statistics().round_trips
        assert trips.count - before.count == 5
        # 30 ms there and 30 ms back.
        assert 0.06 <= (trips.total_s - before.total_s) / 5 < 0.1
        assert trips.counts[ROUND_TRIP_BOUNDS_S.index(0.1)] == 5
        virtual.stall_line()
        asking = asyncio.create_task(aircraft.version())
        await asyncio.wait([asking])
        assert isinstance(asking.exception(), TimeoutError)
        assert aircraft.statistics().round_trips.count == trips.count
    virtual.stop()
