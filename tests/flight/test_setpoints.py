"""The task that sends setpoints: once per period, never stale, neutral, then silence."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import sys
from collections.abc import AsyncIterator
from itertools import pairwise
from random import Random
from types import FrameType
from typing import cast

import pytest

from m100link.errors import UsageError
from m100link.flight.setpoints import (
    NEUTRAL_TIME,
    SETPOINT_LIFETIME,
    Pace,
    SetpointLoop,
    check_lifetime,
)
from m100link.protocol.setpoint import ReferenceFrame, Setpoint
from m100link.sim import VirtualClockEventLoop

pytestmark = pytest.mark.anyio

PERIOD = 0.02
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
EAST = Setpoint.velocity(north=0.0, east=1.0, up=0.0, yaw_rate_deg_s=0.0)
STILL = Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


class Rig:
    """A setpoint loop and what it put on the line, with times."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.frames: list[tuple[float, Setpoint]] = []
        self.is_admitted = True
        self.failures: list[Exception] = []
        self.is_failing = False
        self.setpoints = SetpointLoop(
            self._send, lambda _: self.is_admitted, self.failures.append, self.loop
        )

    def _send(self, setpoint: Setpoint) -> bool:
        if self.is_failing:
            raise RuntimeError("a bug")
        self.frames.append((self.loop.time(), setpoint))
        return True

    def set(self, setpoint: Setpoint, *, lifetime: float = SETPOINT_LIFETIME) -> None:
        self.setpoints.set(setpoint, lifetime=lifetime)

    @property
    def times(self) -> list[float]:
        return [time for time, _ in self.frames]

    @property
    def gaps(self) -> list[float]:
        return [later - earlier for earlier, later in pairwise(self.times)]

    def during(self, start: float, end: float) -> list[Setpoint]:
        return [setpoint for time, setpoint in self.frames if start <= time < end]


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    rig = Rig()
    yield rig
    await rig.setpoints.stop()


@pytest.mark.parametrize("lifetime", [-1.0, -0.5, 0.0, float("nan"), float("inf")])
async def test_what_is_not_a_time_that_ends_is_not_a_lifetime(lifetime: float) -> None:
    for is_long_allowed in (False, True):
        with pytest.raises(UsageError, match="not a time that ends"):
            check_lifetime(lifetime, is_long_allowed=is_long_allowed)


@pytest.mark.parametrize("lifetime", [1e-6, 0.02, 1.0])
async def test_up_to_a_second_a_setpoint_may_live_without_a_word(lifetime: float) -> None:
    check_lifetime(lifetime, is_long_allowed=False)


async def test_a_longer_life_has_to_be_allowed() -> None:
    with pytest.raises(UsageError, match="flies on for that long"):
        check_lifetime(1.001, is_long_allowed=False)
    check_lifetime(1.001, is_long_allowed=True)


async def test_a_setpoint_goes_out_at_once(rig: Rig) -> None:
    await asyncio.sleep(1.0)
    rig.set(NORTH)
    assert rig.frames == [(1.0, NORTH)]


async def test_a_program_that_sets_one_has_checked_it_and_each_repetition_is_asked_for(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def admit(setpoint: Setpoint) -> bool:
        asked.append(rig.loop.time())
        return True

    monkeypatch.setattr(rig.setpoints, "_admits", admit)
    rig.set(NORTH)
    assert (rig.times, asked) == ([0.0], [])
    await asyncio.sleep(1.0)
    assert asked == rig.times[1:]


async def test_it_is_repeated_at_50_hz_for_its_lifetime_then_neutral_then_silence(rig: Rig) -> None:
    rig.set(NORTH, lifetime=0.19)
    await asyncio.sleep(5.0)
    sent = [setpoint for _, setpoint in rig.frames]
    assert sent[:10] == [NORTH] * 10
    assert sent[10:] == [STILL] * round(NEUTRAL_TIME / PERIOD)
    assert rig.times[9] < 0.19
    assert rig.times[-1] < 0.19 + NEUTRAL_TIME
    assert rig.setpoints.current is None
    assert rig.setpoints.expired == 1
    assert rig.setpoints.sent == len(sent)


async def test_nothing_older_than_its_lifetime_is_ever_sent(rig: Rig) -> None:
    rig.set(NORTH, lifetime=0.05)
    await asyncio.sleep(1.0)
    assert max(time for time, setpoint in rig.frames if setpoint == NORTH) < 0.05


async def test_expiry_is_reported(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        rig.set(NORTH)
        await asyncio.sleep(1.0)
    assert [record.message for record in caplog.records] == [
        "a setpoint was not renewed in time: sending neutral"
    ]


async def test_a_neutral_setpoint_that_runs_out_is_no_expiry(rig: Rig) -> None:
    rig.set(STILL)
    await asyncio.sleep(1.0)
    assert rig.setpoints.expired == 0
    assert 0 < SETPOINT_LIFETIME + NEUTRAL_TIME - rig.times[-1] < 1.5 * PERIOD


async def test_renewal_keeps_it_going(rig: Rig) -> None:
    for _ in range(10):
        rig.set(NORTH)
        await asyncio.sleep(0.19)
    assert {setpoint for _, setpoint in rig.frames} == {NORTH}
    assert rig.gaps == pytest.approx([PERIOD] * len(rig.gaps), abs=0.2 * PERIOD)


async def test_ten_minutes_of_a_held_setpoint_are_30000_frames_without_drift(rig: Rig) -> None:
    rig.set(NORTH, lifetime=600.0)
    await asyncio.sleep(600.0 - PERIOD / 2)
    assert len(rig.frames) in (29_999, 30_000, 30_001)
    assert rig.times[-1] - rig.times[2] == pytest.approx((len(rig.frames) - 3) * PERIOD, abs=1e-6)
    assert rig.gaps[2:] == pytest.approx([PERIOD] * len(rig.gaps[2:]), abs=1e-6)


@pytest.mark.parametrize("interval", [0.001, 0.003, 0.005, 0.01, 0.015, 0.017, 0.019, 0.0199])
async def test_a_program_that_sends_faster_than_50_hz_does_not_raise_the_rate(
    rig: Rig, interval: float
) -> None:
    """At 100 Hz the autopilot of a user's aircraft ignored commands at random."""
    steps = round(2.0 / interval)
    for step in range(steps):
        rig.set(NORTH if step % 2 else EAST)
        await asyncio.sleep(interval)
    assert len(rig.frames) <= 2.0 / PERIOD + 1
    assert min(rig.gaps) >= 0.8 * PERIOD - 1e-9


async def test_between_two_frames_the_newest_setpoint_wins(rig: Rig) -> None:
    rig.set(NORTH)
    await asyncio.sleep(0.005)
    rig.set(STILL)
    rig.set(EAST)
    await asyncio.sleep(0.02)
    assert [setpoint for _, setpoint in rig.frames] == [NORTH, EAST]


@pytest.mark.parametrize("lateness", [0.0, 0.0005, 0.0015], ids=["exact", "0.5 ms", "1.5 ms"])
async def test_a_program_that_ticks_at_50_hz_itself_is_never_a_period_stale(
    rig: Rig, lateness: float
) -> None:
    """What goes out is what the program has just set, not its value of the tick before."""
    ages = []
    for step in range(100):
        await asyncio.sleep(max(0.0, step * PERIOD + (step % 2) * lateness - rig.loop.time()))
        set_at = rig.loop.time()
        count = len(rig.frames)
        rig.set(Setpoint.velocity(north=step / 100, east=0.0, up=0.0, yaw_rate_deg_s=0.0))
        ages.append(rig.loop.time() - set_at if len(rig.frames) > count else PERIOD)
    assert max(ages) == 0.0
    assert len(rig.frames) == 100


async def stand_still(rig: Rig, begin: float, end: float) -> None:
    """The process runs up to a moment, and then not before another."""
    await asyncio.sleep(begin - rig.loop.time())
    assert isinstance(rig.loop, VirtualClockEventLoop)
    rig.loop._jumping.now = end


async def test_a_slow_rate_keeps_its_grid_through_small_lateness(rig: Rig) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=0.1)
    await stand_still(rig, 0.099, 0.105)
    await asyncio.sleep(0.2)
    assert rig.times == pytest.approx([0.0, 0.105, 0.2, 0.3])


async def test_news_at_a_slow_rate_keep_the_grid_of_50_hz_through_small_lateness(rig: Rig) -> None:
    rig.setpoints.set(NORTH, lifetime=0.9, period=0.5)
    await asyncio.sleep(0.005)
    rig.setpoints.set(EAST, lifetime=0.9, period=0.5)
    await stand_still(rig, 0.019, 0.025)
    await asyncio.sleep(0.001)
    rig.setpoints.set(STILL, lifetime=0.9, period=0.5)
    await asyncio.sleep(0.03)
    assert rig.times == pytest.approx([0.0, 0.025, 0.04])


async def test_a_blocked_program_makes_a_gap_not_a_burst(rig: Rig) -> None:
    rig.set(NORTH, lifetime=10.0)
    await asyncio.sleep(0.1)
    loop = rig.loop
    assert isinstance(loop, VirtualClockEventLoop)
    loop._jumping.now += 0.13  # time passes and nothing runs
    await asyncio.sleep(0.2)
    assert sum(gap > 1.5 * PERIOD for gap in rig.gaps) == 1
    assert min(rig.gaps) >= 0.5 * PERIOD - 1e-9


async def test_a_program_blocked_beyond_the_lifetime_sends_neutral_not_the_old_setpoint(
    rig: Rig,
) -> None:
    rig.set(NORTH)
    await asyncio.sleep(0.05)
    loop = rig.loop
    assert isinstance(loop, VirtualClockEventLoop)
    loop._jumping.now += 0.3
    blocked_until = loop.time()
    await asyncio.sleep(1.0)
    late = rig.during(blocked_until, 99)
    assert set(late) == {STILL}
    assert late


async def test_blocked_beyond_everything_it_sends_neutral_and_nothing_old(rig: Rig) -> None:
    rig.set(NORTH)
    await asyncio.sleep(0.05)
    loop = rig.loop
    assert isinstance(loop, VirtualClockEventLoop)
    loop._jumping.now += 10.0
    count = len(rig.frames)
    await asyncio.sleep(1.0)
    assert {setpoint for _, setpoint in rig.frames[count:]} == {NORTH.neutral()}
    lasted = rig.frames[-1][0] - rig.frames[count][0]
    assert NEUTRAL_TIME - 1.5 * PERIOD < lasted <= NEUTRAL_TIME


async def test_blocked_in_its_neutral_it_stays_silent(rig: Rig) -> None:
    rig.set(NORTH, lifetime=0.05)
    await asyncio.sleep(0.1)
    loop = rig.loop
    assert isinstance(loop, VirtualClockEventLoop)
    loop._jumping.now += 10.0
    count = len(rig.frames)
    await asyncio.sleep(1.0)
    assert len(rig.frames) == count


async def test_neutralise_replaces_the_setpoint_from_now_on_and_falls_silent(rig: Rig) -> None:
    rig.set(NORTH, lifetime=10.0)
    await asyncio.sleep(0.105)
    at = rig.loop.time()
    rig.setpoints.neutralise()
    await asyncio.sleep(1.0)
    assert rig.during(at, at + PERIOD) == [STILL]
    assert set(rig.during(at, 99)) == {STILL}
    assert rig.times[-1] < at + NEUTRAL_TIME + 1e-9
    assert rig.setpoints.expired == 0


@pytest.mark.parametrize("since", [0.0, 0.005, 0.015, 0.02, 0.05])
async def test_the_neutral_is_repeated_each_period_and_never_later(rig: Rig, since: float) -> None:
    """No program ticks it, and no slack is left for one."""
    rig.set(NORTH)
    await asyncio.sleep(since)
    rig.setpoints.neutralise()
    await asyncio.sleep(NEUTRAL_TIME + 0.1)
    neutral = [time for time, setpoint in rig.frames if setpoint == STILL]
    gaps = [later - earlier for earlier, later in pairwise(neutral)]
    assert gaps == pytest.approx([PERIOD] * len(gaps), abs=1e-6)
    assert len(gaps) >= NEUTRAL_TIME / PERIOD - 2


async def test_neutralise_goes_out_at_once_when_its_period_has_had_no_frame(rig: Rig) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=1.0)
    await asyncio.sleep(0.95)
    rig.setpoints.neutralise()
    assert rig.frames[-1] == (0.95, STILL)


async def test_entering_and_leaving_at_any_pace_keeps_to_one_frame_per_period(rig: Rig) -> None:
    for _ in range(1000):
        rig.set(NORTH)
        await asyncio.sleep(0.001)
        rig.setpoints.neutralise()
    assert len(rig.frames) <= 1.0 / PERIOD + 1


async def test_neutralise_in_silence_sends_nothing(rig: Rig) -> None:
    rig.setpoints.neutralise()
    await asyncio.sleep(1.0)
    assert rig.frames == []


async def test_a_neutral_that_may_not_go_out_does_not(rig: Rig) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=1.0)
    await asyncio.sleep(0.3)  # its period had no frame: it could go out at once
    rig.is_admitted = False
    rig.setpoints.neutralise()
    await asyncio.sleep(1.0)
    assert rig.frames == [(0.0, NORTH)]


async def test_what_was_refused_once_does_not_come_back_by_itself(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Setpoint] = []

    def refuse(setpoint: Setpoint) -> bool:
        asked.append(setpoint)
        if len(asked) > 3:
            raise RuntimeError("asked again and again")
        return False

    rig.set(NORTH, lifetime=10.0)
    await asyncio.sleep(0.1)
    with monkeypatch.context() as patch:
        patch.setattr(rig.setpoints, "_admits", refuse)
        await asyncio.sleep(0.1)
    count = len(rig.frames)
    assert (asked, rig.setpoints.current) == ([NORTH], None)
    await asyncio.sleep(1.0)
    assert len(rig.frames) == count


async def test_a_neutral_that_never_went_out_is_owed_and_one_that_did_is_not(rig: Rig) -> None:
    """The process stands still from before its turn until after its time."""
    rig.set(NORTH)
    rig.setpoints.neutralise()
    await stand_still(rig, 0.001, 10.0)
    await asyncio.sleep(0.1)
    assert [setpoint for _, setpoint in rig.frames] == [NORTH]
    rig.setpoints.pay()
    rig.setpoints.pay()
    assert [setpoint for _, setpoint in rig.frames] == [NORTH, STILL]


async def test_what_the_line_did_not_take_was_not_sent_and_goes_out_when_it_does(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=1.0)
    await asyncio.sleep(0.1)
    with monkeypatch.context() as patch:
        patch.setattr(rig.setpoints, "_send", lambda _: False)
        rig.setpoints.set(EAST, lifetime=10.0, period=1.0)
        await asyncio.sleep(0.1)
        assert rig.setpoints.sent == len(rig.frames) == 1
    await asyncio.sleep(1.1 * PERIOD)
    assert [setpoint for _, setpoint in rig.frames] == [NORTH, EAST]
    with monkeypatch.context() as patch:
        patch.setattr(rig.setpoints, "_send", lambda _: False)
        rig.setpoints.neutralise()
        await asyncio.sleep(1.0)
    rig.setpoints.pay()
    assert [setpoint for _, setpoint in rig.frames] == [NORTH, EAST, STILL]
    assert rig.setpoints.sent == 3


@pytest.mark.parametrize("after", [0.0, 0.011, 0.105, 0.111])
async def test_behind_a_halt_there_is_silence(rig: Rig, after: float) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=0.5)
    await asyncio.sleep(after)
    await rig.setpoints.hover()
    assert rig.setpoints.current is None
    assert rig.frames[-1][1] == STILL


async def test_silence_is_at_once_and_a_new_setpoint_breaks_it(rig: Rig) -> None:
    rig.set(NORTH, lifetime=10.0)
    await asyncio.sleep(0.1)
    rig.setpoints.silence()
    count = len(rig.frames)
    await asyncio.sleep(5.0)
    assert len(rig.frames) == count
    rig.set(EAST)
    assert rig.frames[-1] == (rig.loop.time(), EAST)
    await asyncio.sleep(0.1)
    assert rig.frames[-1][1] == EAST
    assert len(rig.frames) > count + 3


async def test_a_slower_rate_is_kept(rig: Rig) -> None:
    rig.setpoints.set(NORTH, lifetime=10.0, period=0.1)
    await asyncio.sleep(1.95)
    assert len(rig.frames) == 20
    assert rig.gaps == pytest.approx([0.1] * 19, abs=0.011)


@pytest.mark.parametrize("period", [0.021, 0.1, 0.5, 1.0, 10.0])
async def test_at_a_slow_rate_a_newer_setpoint_goes_out_one_50_hz_period_after_the_last(
    rig: Rig, period: float
) -> None:
    rig.setpoints.set(NORTH, lifetime=0.9, period=period)
    await asyncio.sleep(0.001)
    rig.setpoints.set(STILL, lifetime=0.9, period=period)
    await asyncio.sleep(PERIOD)
    assert rig.frames == [(0.0, NORTH), (pytest.approx(PERIOD), STILL)]


async def test_at_a_slow_rate_news_behind_news_wait_for_one_50_hz_period_and_no_more(
    rig: Rig,
) -> None:
    rig.setpoints.set(NORTH, lifetime=0.9, period=0.5)
    await asyncio.sleep(0.033)
    rig.setpoints.set(EAST, lifetime=0.9, period=0.5)
    await asyncio.sleep(0.012)
    rig.setpoints.set(STILL, lifetime=0.9, period=0.5)
    await asyncio.sleep(0.1)
    assert rig.times == pytest.approx([0.0, 0.033, 0.053])


async def test_at_a_slow_rate_a_newer_setpoint_goes_out_at_once_when_the_line_is_free(
    rig: Rig,
) -> None:
    rig.setpoints.set(NORTH, lifetime=0.9, period=1.0)
    await asyncio.sleep(0.301)
    rig.setpoints.set(EAST, lifetime=0.9, period=1.0)
    assert rig.frames == [(0.0, NORTH), (pytest.approx(0.301), EAST)]


@pytest.mark.parametrize("period", [0.021, 0.1, 0.5, 1.0, 10.0])
@pytest.mark.parametrize("after", [0.0, 0.001, 0.07, 0.15])
async def test_at_a_slow_rate_neutral_is_sent_at_50_hz_from_when_it_is_asked_for(
    rig: Rig, period: float, after: float
) -> None:
    rig.setpoints.set(NORTH, lifetime=0.9, period=period)
    await asyncio.sleep(after)
    last, at = rig.times[-1], rig.loop.time()
    rig.setpoints.neutralise()
    await asyncio.sleep(1.0)
    neutrals = [time for time, setpoint in rig.frames if setpoint == STILL]
    assert neutrals[0] == pytest.approx(max(at, last + PERIOD), abs=0.1 * PERIOD)
    assert neutrals[-1] < at + NEUTRAL_TIME + 1e-9
    assert len(neutrals) >= NEUTRAL_TIME / PERIOD - 1


@pytest.mark.parametrize("period", [0.021, 0.1, 0.5, 1.0, 10.0])
async def test_at_a_slow_rate_expiry_is_not_late(rig: Rig, period: float) -> None:
    rig.setpoints.set(NORTH, lifetime=0.2, period=period)
    await asyncio.sleep(20.0)
    neutrals = [time for time, setpoint in rig.frames if setpoint == STILL]
    assert 0.2 <= neutrals[0] <= 0.2 + PERIOD
    assert neutrals[-1] < 0.2 + NEUTRAL_TIME
    assert len(neutrals) >= NEUTRAL_TIME / PERIOD - 1
    assert rig.setpoints.expired == 1


async def test_at_a_slow_rate_renewing_the_same_setpoint_does_not_raise_the_rate(rig: Rig) -> None:
    for _ in range(200):
        rig.setpoints.set(NORTH, lifetime=0.2, period=0.1)
        await asyncio.sleep(0.01)
    assert len(rig.frames) in (20, 21)


async def test_any_mixture_of_rates_stays_below_50_hz_and_hears_the_newest(rig: Rig) -> None:
    random = Random(3)
    for _ in range(3000):
        speed = random.randrange(4)
        wanted = Setpoint.velocity(north=speed, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
        period = random.choice([PERIOD, 0.025, 0.1, 0.5, 2.0])
        rig.setpoints.set(wanted, lifetime=random.uniform(0.01, 1.0), period=period)
        await asyncio.sleep(random.choice([0.0, 0.003, 0.02, 0.021, 0.2]))
        if random.random() < 0.1:
            rig.setpoints.neutralise()
            wanted = STILL
        at = rig.loop.time()
        await asyncio.sleep(random.choice([0.0, 0.03]))
        if rig.loop.time() > at:
            assert rig.frames[-1][1] in (wanted, STILL)
    for first, last in zip(rig.times, rig.times[100:], strict=False):
        assert last - first >= 100 * PERIOD - 1.0 * PERIOD
    assert min(rig.gaps) >= 0.5 * PERIOD - 1e-9


async def test_stop_ends_the_task_and_may_be_called_twice(rig: Rig) -> None:
    rig.set(NORTH, lifetime=10.0)
    await asyncio.sleep(0.1)
    await rig.setpoints.stop()
    names = {task.get_name() for task in asyncio.all_tasks()}
    assert "m100link setpoints" not in names
    await rig.setpoints.stop()
    count = len(rig.frames)
    await asyncio.sleep(1.0)
    assert len(rig.frames) == count


@pytest.mark.parametrize(
    ("setpoint", "neutral"),
    [
        (
            Setpoint.tilt(roll_deg=5, pitch_deg=-3, thrust_percent=60, yaw_rate_deg_s=10),
            Setpoint.tilt(roll_deg=0, pitch_deg=0, up=0, yaw_rate_deg_s=0),
        ),
        (
            Setpoint.tilt(
                roll_deg=5, pitch_deg=0, height=9, yaw_deg=10, frame=ReferenceFrame.GROUND
            ),
            Setpoint.tilt(
                roll_deg=0, pitch_deg=0, up=0, yaw_rate_deg_s=0, frame=ReferenceFrame.GROUND
            ),
        ),
        (
            Setpoint.velocity(forward=3, right=1, height=9, yaw_deg=10, stable=True),
            Setpoint.velocity(forward=0, right=0, up=0, yaw_rate_deg_s=0, stable=True),
        ),
        (
            Setpoint.position_offset(north=3, east=1, up=2, yaw_deg=10),
            Setpoint.position_offset(north=0, east=0, up=0, yaw_rate_deg_s=0),
        ),
    ],
    ids=["thrust", "tilt", "velocity", "position"],
)
async def test_the_neutral_keeps_horizontal_mode_and_frame_and_nothing_else(
    rig: Rig, setpoint: Setpoint, neutral: Setpoint
) -> None:
    rig.set(setpoint)
    await asyncio.sleep(1.0)
    assert rig.frames[0][1] == setpoint
    assert rig.frames[-1][1] == neutral


# -- failures -------------------------------------------------------------------------------------


async def test_a_task_that_others_cancel_says_so(rig: Rig) -> None:
    """As programs do that cancel every task but their own."""
    rig.set(NORTH, lifetime=1.0)
    await asyncio.sleep(0.1)
    for task in asyncio.all_tasks():
        if task.get_name() == "m100link setpoints":
            task.cancel()
    await asyncio.sleep(0.1)
    assert [str(failure) for failure in rig.failures] == [
        "the task that repeats setpoints was cancelled"
    ]
    rig.set(NORTH)
    await asyncio.sleep(0.1)
    await rig.setpoints.stop()
    assert len(rig.failures) == 1


async def test_a_task_that_fails_says_so_and_the_next_setpoint_begins_another(rig: Rig) -> None:
    rig.set(NORTH, lifetime=1.0)
    rig.is_failing = True
    await asyncio.sleep(0.1)
    assert [str(failure) for failure in rig.failures] == ["a bug"]
    rig.is_failing = False
    await asyncio.sleep(0.1)
    assert len(rig.frames) == 1, "nobody asked for more"
    rig.setpoints.neutralise()
    await asyncio.sleep(0.1)
    assert {setpoint for _, setpoint in rig.frames[1:]} == {STILL}
    assert len(rig.frames) >= 5


async def test_a_neutral_that_is_asked_for_by_who_hears_of_a_failure_goes_out_for_its_time(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the stop path does it: within the task that has failed, which sends nothing more."""

    def stop(failure: Exception) -> None:
        rig.failures.append(failure)
        rig.is_failing = False
        rig.setpoints.neutralise()

    monkeypatch.setattr(rig.setpoints, "_on_failure", stop)
    rig.set(NORTH, lifetime=1.0)
    rig.is_failing = True
    await asyncio.sleep(1.0)
    assert len(rig.failures) == 1
    assert [setpoint for _, setpoint in rig.frames] == [NORTH] + [STILL] * (len(rig.frames) - 1)
    assert len(rig.frames) >= NEUTRAL_TIME / PERIOD - 1


async def test_a_send_that_blocks_for_longer_than_a_period_does_not_starve_the_others(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = rig.loop
    assert isinstance(loop, VirtualClockEventLoop)

    def block(setpoint: Setpoint) -> bool:
        loop._jumping.now += 2.5 * PERIOD
        return True

    monkeypatch.setattr(rig.setpoints, "_send", block)
    rig.set(NORTH, lifetime=1.0)
    turns = 0
    while loop.time() < 0.9 and turns < 1000:
        await asyncio.sleep(0)
        turns += 1
    assert 15 <= turns < 100


# -- the rate -------------------------------------------------------------------------------------


async def renewed_each(rig: Rig, period: float, seconds: float) -> None:
    """A computer that lets nothing of the loop run but so often."""
    begin = rig.loop.time()
    for turn in range(round(seconds / period)):
        rig.set(NORTH)
        await stand_still(rig, begin + turn * period + 1e-4, begin + (turn + 1) * period)


def test_a_rate_is_the_frames_by_the_time_that_they_took() -> None:
    pace = Pace(print, lambda: None)
    for turn in range(4):
        pace.sent(0.35 * turn, 0.35)
    assert pace.rate_hz == pytest.approx(1 / 0.35)


async def test_a_rate_that_is_not_kept_is_reported_once_a_minute_and_counted(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    """At 2 % of a core it flew at half rate, and nothing said so."""
    missed: list[int] = []
    rig.setpoints.pace._on_missed = missed.append
    with caplog.at_level(logging.WARNING):
        await renewed_each(rig, 0.04, 5.0)
        told = [record.message for record in caplog.records]
    assert [one.partition(",")[0] for one in told] == ["setpoints go out at 25 Hz"]
    assert "too busy, or the program blocks its event loop. End other programs" in told[0]
    pace = rig.setpoints.pace
    assert pace.rate_hz == pytest.approx(25.0, abs=0.5)
    assert pace.missed == sum(missed) == pytest.approx(125, abs=2)
    assert [pace.is_kept] == [False]
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(5):  # a loop that hangs again and again
            await renewed_each(rig, PERIOD, 3.0)
            assert pace.is_kept
            await renewed_each(rig, 0.04, 3.0)
            assert not pace.is_kept
        assert len(caplog.records) == 0
        rig.setpoints.silence()
        await asyncio.sleep(30.0)
        await renewed_each(rig, 0.04, 3.0)
    assert len(caplog.records) == 1, "a minute later"
    await rig.setpoints.stop()


@pytest.mark.parametrize("period", [0.02, 0.1, 0.5])
async def test_a_rate_that_is_kept_is_no_news(
    rig: Rig, period: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever it is, however it is renewed, and with silence between."""
    chance = Random(period)
    with caplog.at_level(logging.WARNING):
        for _ in range(4):
            for _ in range(30):
                rig.setpoints.set(chance.choice((NORTH, EAST)), lifetime=2.0, period=period)
                await asyncio.sleep(chance.uniform(0.0, 0.15))
            await rig.setpoints.hover()
            await asyncio.sleep(chance.uniform(0.0, 3.0))
    pace = rig.setpoints.pace
    assert [record.message for record in caplog.records] == []
    assert pace.is_kept
    assert pace.missed == 0


async def test_a_log_that_raises_costs_no_frame(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []

    def fail() -> None:
        told.append(len(rig.frames))
        raise RuntimeError("a handler of the program")

    monkeypatch.setattr(rig.setpoints, "_tell_slow", fail)
    rig.loop.set_exception_handler(lambda *_: None)
    await renewed_each(rig, 0.04, 3.0)
    assert len(told) == 1
    assert rig.failures == []
    assert len(rig.frames) == pytest.approx(75, abs=1)


@pytest.mark.parametrize("left", range(1, 40))
async def test_a_setpoint_on_the_last_frames_of_a_stack_is_ended_like_any_other(
    rig: Rig, left: int
) -> None:
    """A task that has no room to be woken there must not sleep for ever."""
    rig.set(NORTH)
    await asyncio.sleep(2.0)
    here, frame = 0, cast("FrameType | None", sys._getframe())
    while frame is not None:
        here, frame = here + 1, frame.f_back
    limit = sys.getrecursionlimit()
    with contextlib.suppress(RecursionError):
        try:
            sys.setrecursionlimit(here + left)
            rig.set(EAST)
        finally:
            sys.setrecursionlimit(limit)
    await asyncio.sleep(2.0)
    assert rig.frames[-1][1] == STILL
    rig.set(NORTH)
    await asyncio.sleep(2.0)
    assert rig.frames[-1][1] == STILL
