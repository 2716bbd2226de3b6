"""A suspended computer stands still with its clock, and nothing that it knew moves an aircraft."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import cast

import pytest

from m100link import Control
from m100link.errors import ComputerSuspended
from m100link.flight import guards as suspension
from m100link.flight.guards import SuspendWatch
from tests.rig import NORTH, Rig, rig

pytestmark = pytest.mark.anyio


class Computer:
    """Both clocks of a computer."""

    def __init__(self) -> None:
        self.awake_s = 1000.0
        self.asleep_s = 50.0
        self.stopped_s: Iterator[float] = iter(())

    def monotonic(self) -> float:
        self.awake_s += next(self.stopped_s, 0.0)  # this process is stopped between two readings
        return self.awake_s

    def clock_gettime(self, clock: int) -> float:
        del clock
        return self.awake_s + self.asleep_s


@pytest.fixture
def computer(monkeypatch: pytest.MonkeyPatch) -> Computer:
    made = Computer()
    monkeypatch.setattr("m100link.flight.guards.time.monotonic", made.monotonic)
    monkeypatch.setattr("m100link.flight.guards.time.clock_gettime", made.clock_gettime)
    return made


def test_time_that_passes_awake_is_no_suspend(computer: Computer) -> None:
    watch = SuspendWatch()
    computer.awake_s += 3600.0
    assert watch.slept_s() == 0.0


@pytest.mark.parametrize("slept", [0.2, 6.0, 3600.0])
def test_a_suspend_is_noticed_and_measured(computer: Computer, slept: float) -> None:
    watch = SuspendWatch()
    computer.asleep_s += slept
    assert watch.slept_s() == pytest.approx(slept)
    assert watch.slept_s() == pytest.approx(slept), "and stays so"


def test_a_process_that_is_stopped_between_two_readings_saw_no_suspend(computer: Computer) -> None:
    computer.stopped_s = iter([0.0, 5.0, 0.0, 7.0])
    watch = SuspendWatch()
    assert watch.slept_s() == 0.0
    assert watch.slept_s() == 0.0


def test_this_computer_is_awake() -> None:
    watch = SuspendWatch()
    time.sleep(0.02)
    assert watch.slept_s() == 0.0


async def fly_to(flown: Rig, control: Control) -> None:
    await control.fly_to(north=40.0, east=0.0, up=0.0)


async def ticks(flown: Rig, control: Control) -> None:
    await flown.fly_on(control)


async def hold(flown: Rig, control: Control) -> None:
    async with control.hold(NORTH, lifetime=1.0) as held:
        for _ in range(100):
            held.set(NORTH)
            await asyncio.sleep(0.5)


@pytest.mark.parametrize("stop", ["hover", "land"])
@pytest.mark.parametrize("flight", [fly_to, ticks, hold], ids=lambda f: cast(str, f.__name__))
async def test_after_a_suspend_nothing_that_moves_leaves(
    flight: Callable[[Rig, Control], Awaitable[None]], stop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asleep = suspension.asleep_s
    woke: list[int] = []
    async with rig() as flown:

        def sleep() -> None:
            woke.append(len(flown.moves))
            monkeypatch.setattr(suspension, "asleep_s", lambda: asleep() + 6.0)

        with pytest.raises(ComputerSuspended, match=r"suspended for 6\.0 s"):
            async with flown.aircraft.control(
                stop="land" if stop == "land" else "hover"
            ) as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.01, sleep)
                await flight(flown, control)
        sent = list(flown.moves)[woke[0] :]
        assert sent, "the neutral"
        assert all(flown.is_neutral(move) for move in sent)
        assert flown.is_released
        assert flown.is_running is (stop == "hover")


async def test_a_sleep_before_control_is_obtained_ends_no_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asleep = suspension.asleep_s
    async with rig() as flown:
        block = flown.aircraft.control()
        monkeypatch.setattr(suspension, "asleep_s", lambda: asleep() + 6.0)
        async with block as control:
            await control.take_off()
        await flown.assert_hovers()
