"""Event loops with a time of their own."""

from __future__ import annotations

import asyncio
import itertools
import os
import random
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from m100link.sim import (
    LockstepEventLoop,
    ScaledEventLoop,
    VirtualClockEventLoop,
    clock,
    loop_factory,
)


async def sleeper(seconds: float, count: int = 1) -> float:
    loop = asyncio.get_running_loop()
    start = loop.time()
    for _ in range(count):
        await asyncio.sleep(seconds)
    return loop.time() - start


def run(loop: asyncio.AbstractEventLoop, seconds: float, count: int = 1) -> tuple[float, float]:
    """Loop time and real time of some sleeping."""
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        began = time.perf_counter()
        elapsed = runner.run(sleeper(seconds, count))
        return elapsed, time.perf_counter() - began


def test_virtual_time_jumps_and_is_exact() -> None:
    elapsed, real = run(VirtualClockEventLoop(), 3600.0, count=100)
    assert elapsed == pytest.approx(360_000.0)
    assert real < elapsed / 10_000


def test_in_lockstep_time_passes_only_while_somebody_waits() -> None:
    async def main() -> list[float]:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, LockstepEventLoop)
        times = []
        loop.begin_waiting()
        await asyncio.sleep(100.0)
        times.append(loop.time())
        loop.end_waiting()
        # Nobody waits: only what another thread brings wakes it, and no time has passed.
        waker = threading.Timer(0.05, loop.call_soon_threadsafe, [loop.begin_waiting])
        waker.start()
        await asyncio.sleep(1.0)
        times.append(loop.time())
        return times

    with asyncio.Runner(loop_factory=LockstepEventLoop) as runner:
        assert runner.run(main()) == [100.0, 101.0]


def test_virtual_time_begins_at_zero_and_keeps_the_order_of_timers() -> None:
    async def main() -> list[tuple[float, int]]:
        loop = asyncio.get_running_loop()
        fired: list[tuple[float, int]] = []

        def fire(number: int) -> None:
            fired.append((round(loop.time(), 9), number))

        for number, delay in enumerate((0.3, 0.1, 0.2, 0.1)):
            loop.call_later(delay, fire, number)
        await asyncio.sleep(1.0)
        return fired

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        assert runner.run(main()) == [(0.1, 1), (0.1, 3), (0.2, 2), (0.3, 0)]


def test_virtual_time_waits_for_a_thread_when_there_is_no_timer() -> None:
    async def main() -> int:
        return await asyncio.get_running_loop().run_in_executor(None, lambda: 42)

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        assert runner.run(main()) == 42


@pytest.mark.parametrize("make", [VirtualClockEventLoop, LockstepEventLoop])
@pytest.mark.parametrize("seed", range(3))
def test_no_timer_passes_while_a_thread_works(
    seed: int, make: Callable[[], VirtualClockEventLoop]
) -> None:
    """A busy machine opened a log, thirty virtual seconds passed, and a lease had ended."""
    rng, at_work, passed = random.Random(seed), [0], list[str]()

    def work(seconds: float, loop: asyncio.AbstractEventLoop) -> None:
        time.sleep(seconds)
        if rng.random() < 0.5:  # it reports before it is done, as a download does
            loop.call_soon_threadsafe(lambda: None)
            time.sleep(seconds)

    async def job(loop: asyncio.AbstractEventLoop) -> None:
        at_work[0] += 1
        began = loop.time()
        await asyncio.sleep(0)
        seconds = rng.uniform(0.0, 0.004)
        match rng.randrange(3):
            case 0:
                await asyncio.to_thread(work, seconds, loop)
            case 1:
                with ThreadPoolExecutor(1) as pool:
                    await loop.run_in_executor(pool, work, seconds, loop)
            case _:
                await loop.getaddrinfo("127.0.0.1", 1)
        if loop.time() != began:
            passed.append(f"{loop.time() - began} s")
        at_work[0] -= 1

    def timer() -> None:
        if at_work[0]:
            passed.append("a timer")

    async def main() -> float:
        loop = asyncio.get_running_loop()
        if isinstance(loop, LockstepEventLoop):
            loop.begin_waiting()
        for _ in range(8):
            for _ in range(5):
                loop.call_later(10.0 ** rng.uniform(-4.0, 4.0), timer)
            await asyncio.gather(*(job(loop) for _ in range(rng.randint(1, 4))))
            await asyncio.sleep(rng.uniform(0.0, 100.0))
        began = loop.time()
        await asyncio.sleep(2e4)  # and all timers come
        return loop.time() - began

    with asyncio.Runner(loop_factory=make) as runner:
        assert runner.run(main()) == pytest.approx(2e4)
    assert passed == [], f"seed {seed}"


def test_a_thread_that_hangs_is_told_and_holds_time_no_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(clock, "_HANGS_S", 0.05)
    may_end = threading.Event()

    async def main() -> float:
        loop = asyncio.get_running_loop()
        hung = loop.run_in_executor(None, may_end.wait)
        with pytest.warns(RuntimeWarning, match=r"has worked for 0\.05 s: virtual time goes on"):
            await asyncio.sleep(60.0)
        at = loop.time()
        await asyncio.sleep(60.0)  # nobody waits for it again
        assert not hung.done()
        may_end.set()
        await hung
        return at

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        assert runner.run(main()) == 60.0


def test_time_does_not_stand_still_for_a_result_that_nobody_wants() -> None:
    may_end = threading.Event()

    async def main() -> None:
        unwanted = asyncio.get_running_loop().run_in_executor(None, may_end.wait)
        unwanted.cancel()
        await asyncio.sleep(60.0)
        may_end.set()

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(main())


def test_a_callback_that_comes_for_ever_is_ended_by_the_time_limit_of_a_test() -> None:
    passes = itertools.count()

    async def main() -> None:
        def spin() -> None:
            asyncio.get_running_loop().call_soon(spin)
            if next(passes) == 100:  # here the signal of pytest-timeout arrives
                pytest.fail("the time limit")

        spin()
        await asyncio.sleep(1.0)

    limit = pytest.raises(pytest.fail.Exception, match="the time limit")
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner, limit:
        runner.run(main())


def test_the_end_waits_for_a_thread_in_real_time() -> None:
    may_end, has_ended = threading.Event(), threading.Event()

    def work() -> None:
        may_end.wait()
        has_ended.set()

    async def main() -> None:
        asyncio.get_running_loop().run_in_executor(None, work)
        threading.Timer(0.2, may_end.set).start()

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(main())
    assert has_ended.is_set()


def test_a_loop_that_never_rests_lets_threads_run() -> None:
    """A flight log took 17 s of a processor: its thread was starved."""

    def work() -> None:
        with Path(os.devnull).open("wb", buffering=0) as stream:
            for _ in range(200):  # each call gives up the interpreter's lock
                stream.write(b"x")

    async def main() -> None:
        thread = threading.Thread(target=work)
        thread.start()
        began = time.thread_time()
        while thread.is_alive():
            await asyncio.sleep(0.001)
            sum(range(500))  # some work, as an aircraft has
            assert time.thread_time() - began < 3.0

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(main())


def test_what_comes_by_a_descriptor_is_read_before_the_next_timer() -> None:
    async def main() -> None:
        loop, (ours, its) = asyncio.get_running_loop(), socket.socketpair()
        with ours, its:
            for one in (ours, its):
                one.setblocking(False)
            for _ in range(3):
                reading = asyncio.ensure_future(loop.sock_recv(ours, 10))
                await asyncio.sleep(0.0)
                its.send(b"x")
                async with asyncio.timeout(1.0):
                    await reading

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(main())


def test_virtual_timeouts_time_out() -> None:
    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(60.0):
                await asyncio.get_running_loop().create_future()
        return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        assert runner.run(main()) == pytest.approx(60.0)


@pytest.mark.parametrize("speed", [20.0, 200.0])
def test_scaled_time_waits_but_shorter(speed: float) -> None:
    elapsed, real = run(ScaledEventLoop(speed), 0.1 * speed)
    assert elapsed >= 0.1 * speed
    assert 0.09 < real < elapsed


def test_scaled_time_starts_at_the_monotonic_clock() -> None:
    before = time.monotonic()
    loop = ScaledEventLoop(5.0)
    try:
        assert before <= loop.time() <= before + 5.0 * (time.monotonic() - before)
        assert loop.speed == 5.0
    finally:
        loop.close()


@pytest.mark.parametrize(
    ("speed", "absent", "counted"),
    [(20.0, 0.05, 0.1), (20.0, 0.004, 0.08), (200.0, 3.0, 0.1), (0.5, 3.0, 1.5), (1.0, 3.0, 3.0)],
)
def test_a_moment_in_which_a_fast_loop_was_not_run_is_short(
    speed: float, absent: float, counted: float
) -> None:
    now = 1000.0
    loop = ScaledEventLoop(speed, real_time=lambda: now)
    began = loop.time()
    now += absent
    assert loop.time() - began == pytest.approx(counted)
    loop.close()


def test_a_wait_that_was_asked_for_counts_whole() -> None:
    looks = itertools.count(start=1.0)  # a second of the wall goes by between any two
    elapsed, _ = run(ScaledEventLoop(20.0, real_time=lambda: next(looks)), 2.0)
    assert 2.0 <= elapsed < 3.0  # not the twenty of each look


def test_twenty_times_faster_an_answer_is_not_late_because_the_machine_is_busy() -> None:
    """Two ends in one loop that is not run for 60 ms at a time, more than a second of its own."""
    looks = itertools.count()

    def busy() -> float:
        return 0.06 * next(looks)

    async def main() -> bytes:
        loop = asyncio.get_running_loop()
        question, answer = socket.socketpair()
        for end in (question, answer):
            end.setblocking(False)
        try:

            async def answers() -> None:
                await loop.sock_sendall(answer, await loop.sock_recv(answer, 10))

            async with asyncio.TaskGroup() as group:
                group.create_task(answers())
                await loop.sock_sendall(question, b"?")
                async with asyncio.timeout(1.0):
                    return await loop.sock_recv(question, 10)
        finally:
            question.close()
            answer.close()

    loop = ScaledEventLoop(20.0, real_time=busy)
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        assert runner.run(main()) == b"?"


def test_loop_factory_chooses_by_speed() -> None:
    kinds = []
    for speed in (1.0, 10.0, float("inf")):
        loop = loop_factory(speed)()
        kinds.append(type(loop))
        loop.close()
    assert kinds[0] not in kinds[1:]
    assert kinds[1:] == [ScaledEventLoop, VirtualClockEventLoop]


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_time_does_not_stand_still_or_run_backwards(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        loop_factory(speed)
    with pytest.raises(ValueError, match="speed"):
        ScaledEventLoop(speed)
