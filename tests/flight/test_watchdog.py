"""Telemetry that is missing ends control, and a program that did not run misses none by that."""

from __future__ import annotations

import asyncio
import time
from typing import cast

import pytest

from m100link.errors import TelemetryStalled
from m100link.flight.watchdog import TelemetryWatchdog
from m100link.sim import VirtualClockEventLoop
from m100link.telemetry.state import AircraftState

pytestmark = pytest.mark.anyio

LIMIT = 0.3


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: a virtual clock is never late


class State:
    """When telemetry came last."""

    def __init__(self) -> None:
        self._clock = asyncio.get_running_loop().time
        self.newest_at = self._clock()

    @property
    def newest_age(self) -> float:
        return self._clock() - self.newest_at

    def arrive(self) -> None:
        self.newest_at = self._clock()


def watch(state: State) -> tuple[TelemetryWatchdog, list[TelemetryStalled]]:
    stalls: list[TelemetryStalled] = []
    watchdog = TelemetryWatchdog(
        cast(AircraftState, state), LIMIT, stalls.append, asyncio.get_running_loop()
    )
    watchdog.start()
    return watchdog, stalls


def block() -> None:
    """The program does not run for twice the limit."""
    time.sleep(2 * LIMIT)


async def test_telemetry_that_came_while_the_program_did_not_run_was_not_missing() -> None:
    state = State()
    watchdog, stalls = watch(state)
    await asyncio.sleep(0)
    block()
    assert watchdog.is_quiet()  # the sending path may look first
    asyncio.get_running_loop().call_soon(state.arrive)  # what waited is read now
    await asyncio.sleep(0.15)
    assert stalls == []
    watchdog.stop()


async def test_telemetry_that_is_missing_then_too_is_a_stall() -> None:
    watchdog, stalls = watch(State())
    await asyncio.sleep(0)
    block()
    await asyncio.sleep(0.3)
    assert len(stalls) == 1
    assert not watchdog.is_quiet()


async def test_without_a_block_nothing_is_forgiven() -> None:
    state = State()
    watchdog, stalls = watch(state)
    watchdog.stop()  # nobody but the sending path looks
    state.newest_at -= 2 * LIMIT
    assert not watchdog.is_quiet()
    assert len(stalls) == 1


def stalls_of_a_moment(*, is_stopped: bool) -> int:
    """What is reported when telemetry has 50 ms left, on virtual time."""

    async def watched() -> int:
        state = State()
        state.newest_at -= LIMIT - 0.05
        watchdog, stalls = watch(state)
        if is_stopped:
            watchdog.stop()
        await asyncio.sleep(0.07)
        return len(stalls)

    loop = VirtualClockEventLoop()
    try:
        return loop.run_until_complete(watched())
    finally:
        loop.close()


def test_it_looks_again_when_the_newest_telemetry_would_be_too_old() -> None:
    assert stalls_of_a_moment(is_stopped=False) == 1


def test_once_stopped_it_looks_no_more() -> None:
    assert stalls_of_a_moment(is_stopped=True) == 0
