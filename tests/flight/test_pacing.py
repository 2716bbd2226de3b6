"""Ticks: absolute deadlines, missed ones skipped and counted, never early, never a burst."""

from __future__ import annotations

import asyncio
import gc
import inspect
import math
import os
import random
import select
import sys
import time
from itertools import islice, pairwise
from pathlib import Path
from types import FrameType
from unittest.mock import MagicMock

import pytest

from m100link.errors import UsageError
from m100link.flight import pacing
from m100link.flight.pacing import MAX_RATE_HZ, DeadlineTimer, Lead, Tick, Ticker
from m100link.sim import VirtualClockEventLoop
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio


def virtual_loop() -> VirtualClockEventLoop:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    return loop


def block(seconds: float) -> None:
    """What a blocking call does to the loop: time passes and nothing runs."""
    virtual_loop()._jumping.now += seconds


async def take(ticker: Ticker, count: int) -> list[Tick]:
    ticks: list[Tick] = []
    async for tick in ticker:
        ticks.append(tick)
        if len(ticks) == count:
            break
    return ticks


async def test_ten_minutes_at_50_hz_are_exactly_30000_ticks_without_drift() -> None:
    start = virtual_loop().time()
    ticks = await take(Ticker(50), 30_001)
    assert ticks[-1].index == 30_000
    assert ticks[-1].missed == 0
    assert virtual_loop().time() - start == pytest.approx(600.0, abs=1e-6)


async def test_first_tick_comes_at_once() -> None:
    ticker = Ticker(10)
    await asyncio.sleep(1.0)
    before = virtual_loop().time()
    (tick,) = await take(ticker, 1)
    assert virtual_loop().time() == before
    assert tick == Tick(index=0, elapsed=0.0, missed=0, lateness=0.0)


async def test_deadlines_are_absolute_work_does_not_shift_them() -> None:
    times = []
    async for tick in Ticker(50):
        times.append(virtual_loop().time())
        await asyncio.sleep(0.013)  # work of the caller
        if tick.index == 500:
            break
    assert times[-1] - times[0] == pytest.approx(10.0, abs=1e-6)


async def test_a_stall_of_six_and_a_half_periods_is_one_gap_and_counted_not_a_burst() -> None:
    ticker = Ticker(50)
    times, ticks = [], []
    async for tick in ticker:
        times.append(virtual_loop().time())
        ticks.append(tick)
        if tick.index == 10:
            block(6.5 * 0.02)
        if tick.index >= 30:
            break
    gaps = [later - earlier for earlier, later in pairwise(times)]
    assert [tick.index for tick in ticks][10:13] == [10, 17, 18]
    assert ticks[11].missed == 6
    assert ticker.missed == 6
    assert gaps[10] == pytest.approx(0.14)
    assert min(gaps) == pytest.approx(0.02)
    assert ticks[11].elapsed == pytest.approx(17 * 0.02)


async def test_less_than_a_period_late_is_made_up_for_on_the_grid() -> None:
    times = []
    async for tick in Ticker(50):
        times.append(virtual_loop().time())
        if tick.index == 5:
            block(0.03)  # tick 6 is 10 ms late, tick 7 on time
        if tick.index == 8:
            break
    gaps = [round(later - earlier, 6) for earlier, later in pairwise(times)]
    assert gaps == [0.02] * 5 + [0.03, 0.01, 0.02]


async def test_lateness_is_measured_from_the_deadline() -> None:
    latenesses = []
    async for tick in Ticker(50):
        latenesses.append(round(tick.lateness, 6))
        if tick.index == 1:
            block(0.025)
        if tick.index == 3:
            break
    assert latenesses == [0.0, 0.0, 0.005, 0.0]


@pytest.mark.parametrize("busy_s", [0.1, 0.0201])
async def test_a_consumer_that_is_always_late_does_not_starve_others(busy_s: float) -> None:
    others = 0

    async def other() -> None:
        nonlocal others
        while True:
            await asyncio.sleep(0.001)
            others += 1

    task = asyncio.create_task(other())
    async for tick in Ticker(50):
        block(busy_s)
        if tick.index > 50:
            break
    task.cancel()
    assert others >= 10


@pytest.mark.parametrize(
    "rate", [0, -1, 50.0001, 100, float("nan"), float("inf")], ids=lambda r: f"{r:g}"
)
async def test_a_rate_that_the_autopilot_does_not_take_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="up to 50 Hz"):
        Ticker(rate)


async def test_slow_rates_are_fine() -> None:
    start = virtual_loop().time()
    await take(Ticker(0.1), 3)
    assert virtual_loop().time() - start == pytest.approx(20.0)


async def test_cancelling_a_wait_leaves_the_ticker_usable() -> None:
    ticker = Ticker(1)
    await take(ticker, 1)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.5):
            await anext(ticker)
    tick = await anext(ticker)
    assert tick.missed + tick.index >= 1


@pytest.mark.parametrize(("fastest", "slowest"), [(50e-6, 60e-6), (30e-6, 150e-6)])
def test_the_lead_follows_the_lower_quartile_of_what_waking_takes(
    fastest: float, slowest: float
) -> None:
    dice, lead, early = random.Random(1), Lead(), 0
    for number in range(4000):
        too_early = dice.uniform(fastest, slowest) < lead.seconds
        lead.woke(too_early)
        early += too_early and number >= 200
    assert early / 3800 == pytest.approx(0.25, abs=0.03)
    assert fastest - 6e-6 < lead.seconds < fastest + (slowest - fastest) / 2


def test_the_lead_has_bounds() -> None:
    lead = Lead()
    lead.woke(too_early=True)
    assert lead.seconds == 0
    for _ in range(1000):
        lead.woke(too_early=False)
    assert lead.seconds == Lead.MOST == 200e-6


def test_an_alarm_without_an_event_loop_is_refused_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unraisable: list[object] = []
    monkeypatch.setattr("sys.unraisablehook", unraisable.append)
    with pytest.raises(RuntimeError, match="no running event loop"):
        DeadlineTimer()
    gc.collect()
    assert unraisable == []


class TestOnTheRealClock:
    """The timerfd path, where there is one. Real time, some tens of milliseconds."""

    @pytest.fixture
    def anyio_backend(self) -> object:
        return "asyncio"

    async def test_never_early(self) -> None:
        loop = asyncio.get_running_loop()
        start = loop.time()
        async for tick in Ticker(MAX_RATE_HZ):
            assert loop.time() >= start + tick.index * 0.02
            assert tick.lateness >= 0
            if tick.index >= 10:
                break

    async def test_never_early_with_any_lead_and_others_are_served_meanwhile(self) -> None:
        loop = asyncio.get_running_loop()
        served = 0

        async def be_served() -> None:
            nonlocal served
            while True:
                await asyncio.sleep(0)
                served += 1

        other = asyncio.create_task(be_served())
        with DeadlineTimer() as alarm:
            for lead in (0.0, 1e-6, 50e-6, Lead.MOST, 0.01):
                alarm._lead.seconds = lead
                for _ in range(3):
                    before = served
                    deadline = loop.time() + 0.005
                    await alarm.sleep_until(deadline)
                    assert loop.time() >= deadline
                    assert served > before
        other.cancel()

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs timerfd")
    async def test_the_timer_is_set_once_and_ahead_of_the_deadline_by_its_lead(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        arm = MagicMock(wraps=pacing._arm_timer)
        monkeypatch.setattr(pacing, "_arm_timer", arm)
        with DeadlineTimer() as alarm:
            alarm._lead.seconds = 0.003
            deadline = asyncio.get_running_loop().time() + 0.005
            await alarm.sleep_until(deadline)
        assert arm.mock_calls[0].args[1] == pytest.approx(deadline - 0.003, abs=1e-6)
        assert arm.call_count <= 2, "one that rings at once is set again and again"

    async def test_an_alarm_in_the_past_rings_at_once(self) -> None:
        with DeadlineTimer() as alarm:
            loop = asyncio.get_running_loop()
            await alarm.sleep_until(loop.time() - 1)
            await alarm.sleep_until(loop.time())

    async def test_an_alarm_survives_cancellation_and_rings_at_its_next_time(self) -> None:
        loop = asyncio.get_running_loop()
        with DeadlineTimer() as alarm:
            sleeping = asyncio.create_task(alarm.sleep_until(loop.time() + 0.02))
            await asyncio.sleep(0)
            sleeping.cancel()
            await asyncio.wait([sleeping])
            deadline = loop.time() + 0.03
            await alarm.sleep_until(deadline)
            assert loop.time() >= deadline

    @pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
    async def test_tickers_that_are_dropped_give_their_timer_back(self) -> None:
        """A program makes one per leg of a flight; a descriptor each would end it after a day."""

        def descriptors() -> int:
            return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 (counting only)

        await take(Ticker(50), 1)
        gc.collect()
        before = descriptors()
        for _ in range(20):
            await take(Ticker(50), 1)
        gc.collect()
        assert descriptors() <= before

    @pytest.mark.skipif(not hasattr(os, "get_blocking"), reason="needs POSIX")
    @pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
    async def test_its_timer_blocks_nobody_and_is_not_inherited(self) -> None:
        """A read of it between two rings would stop the loop; a child would keep it open."""

        def descriptors() -> set[str]:
            return {link.name for link in Path("/proc/self/fd").iterdir() if link.is_symlink()}

        before = descriptors()
        with DeadlineTimer() as alarm:
            timers = {int(name) for name in descriptors() - before}
            assert len(timers) == sys.platform.startswith("linux")
            for timer in timers:
                assert not os.get_blocking(timer)
                assert not os.get_inheritable(timer)
            await alarm.sleep_until(asyncio.get_running_loop().time() + 0.001)
            assert select.select(timers, [], [], 0.01)[0] == [], "it rings once"

    async def test_giving_it_back_again_gives_back_nothing_else(self) -> None:
        """A number that stood for the timer may stand for another file by then."""
        alarm = DeadlineTimer()
        alarm.close()
        before = os.fstat(0)
        alarm.close()
        assert os.fstat(0) == before

    async def test_a_timer_that_was_given_back_is_not_watched_any_more(self) -> None:
        """The next file gets its number, and its reader must be heard."""
        loop = asyncio.get_running_loop()
        with DeadlineTimer() as alarm:
            await alarm.sleep_until(loop.time() + 0.001)
        heard = asyncio.Event()
        ends = os.pipe()
        try:
            loop.add_reader(ends[0], heard.set)
            os.write(ends[1], b"x")
            async with asyncio.timeout(PATIENCE):
                await heard.wait()
            loop.remove_reader(ends[0])
        finally:
            for end in ends:
                os.close(end)

    @pytest.mark.parametrize("number", range(3))
    async def test_a_call_that_finds_no_memory_leaves_nobody_asleep(self, number: int) -> None:
        """Between the alarm and the task that it wakes; setpoints would end without a neutral."""
        loop, left, before = asyncio.get_running_loop(), number, sys.gettrace()
        loop.set_exception_handler(lambda *_: None)

        def trace(frame: FrameType, event: str, _: object) -> None:
            nonlocal left
            code = frame.f_code
            is_call = event == "call" and not code.co_flags & inspect.CO_COROUTINE
            if is_call and code.co_filename.endswith("flight/pacing.py"):
                left -= 1
                if left < 0:
                    sys.settrace(before)
                    raise MemoryError(code.co_name)

        with DeadlineTimer() as alarm:
            task = asyncio.create_task(alarm.sleep_until(loop.time() + 0.02))
            await asyncio.sleep(0)
            sys.settrace(trace)
            try:
                await asyncio.wait([task], timeout=PATIENCE)
            finally:
                sys.settrace(before)
            assert task.done()
            assert isinstance(task.exception(), MemoryError | None)

    async def test_a_blocking_stall_gives_no_burst(self) -> None:
        loop = asyncio.get_running_loop()
        times = []
        async for tick in Ticker(50):
            times.append(loop.time())
            if tick.index == 2:
                time.sleep(0.07)  # noqa: ASYNC251 (the fault that is tested)
            if len(times) == 6:
                break
        after_stall = times[3:]
        gaps = [later - earlier for earlier, later in pairwise(after_stall)]
        assert max(islice(gaps, 2)) < 2.0
        # Two ticks in one period would be a burst; the one right after a stall may come late and
        # the next one on its grid point.
        assert times[-1] - times[3] > 0.02


async def test_a_sleeper_woken_beside_another_timer_does_not_sleep_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An event loop takes a nanosecond for none; loops of one grid fall into it all the time."""
    loop, slept, sleep = virtual_loop(), list[float](), asyncio.sleep

    async def counted(seconds: float) -> None:
        slept.append(seconds)
        await sleep(seconds)

    monkeypatch.setattr(asyncio, "sleep", counted)
    first = loop.time() + 0.3
    loop.call_at(first, slept.clear)
    with DeadlineTimer() as alarm:
        await alarm.sleep_until(math.nextafter(first, math.inf))
    assert slept == []
    assert loop.time() >= first
