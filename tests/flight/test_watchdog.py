"""Telemetry that is missing ends control, and a program that did not run misses none by that."""

from __future__ import annotations

import asyncio
from typing import cast
from unittest.mock import MagicMock

import pytest

from m100link.errors import ComputerSuspended, M100Error, NavigationLost, TelemetryStalled
from m100link.flight import guards as suspension
from m100link.flight.guards import Guards
from m100link.flight.lifecycle import StopCause
from m100link.flight.watchdog import TelemetryWatchdog
from m100link.telemetry.integrity import Integrity, IntegrityState
from m100link.telemetry.state import AircraftState
from tests.flight.test_pacing import block

pytestmark = pytest.mark.anyio

LIMIT = 0.3


class State:
    """When telemetry came last."""

    def __init__(self) -> None:
        self._clock = asyncio.get_running_loop().time
        self.newest_at = self._clock()
        self.integrity = Integrity(IntegrityState.GOOD)

    @property
    def newest_age(self) -> float:
        return self._clock() - self.newest_at

    def arrive(self) -> None:
        self.newest_at = self._clock()


def watch(
    state: State, guards: Guards | None = None, loop: asyncio.AbstractEventLoop | None = None
) -> tuple[TelemetryWatchdog, list[tuple[StopCause, M100Error]]]:
    found: list[tuple[StopCause, M100Error]] = []

    def end(cause: StopCause, error: M100Error) -> None:
        found.append((cause, error))

    guards = guards or Guards(stale_telemetry_s=LIMIT)
    loop = loop or asyncio.get_running_loop()
    watchdog = TelemetryWatchdog(cast(AircraftState, state), guards, end, loop)
    watchdog.start()
    return watchdog, found


async def test_telemetry_that_came_while_the_program_did_not_run_was_not_missing() -> None:
    state = State()
    watchdog, stalls = watch(state)
    await asyncio.sleep(0)
    block(2 * LIMIT)
    assert watchdog.is_quiet()  # the sending path may look first
    asyncio.get_running_loop().call_soon(state.arrive)  # what waited is read now
    await asyncio.sleep(0.15)
    assert stalls == []
    watchdog.stop()


async def test_telemetry_that_is_missing_then_too_is_a_stall() -> None:
    watchdog, stalls = watch(State())
    await asyncio.sleep(0)
    block(2 * LIMIT)
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


@pytest.mark.parametrize("is_stopped", [False, True])
async def test_it_looks_again_when_the_newest_telemetry_would_be_too_old_unless_stopped(
    is_stopped: bool,
) -> None:
    state = State()
    state.newest_at -= LIMIT - 0.05
    watchdog, stalls = watch(state)
    if is_stopped:
        watchdog.stop()
    await asyncio.sleep(0.07)
    assert len(stalls) == (not is_stopped)


NO_STALE, NO_INTEGRITY = Guards(stale_telemetry_s=None), Guards(integrity=False)
STALLED, LOST = StopCause.TELEMETRY_STALLED, StopCause.NAVIGATION_LOST


@pytest.mark.parametrize(
    ("found", "guards", "expected"),
    [
        (IntegrityState.UNKNOWN, Guards(), None),
        (IntegrityState.GOOD, Guards(), None),
        (IntegrityState.CLOCK_STOPPED, Guards(), STALLED),
        (IntegrityState.LATE, Guards(), STALLED),
        (IntegrityState.JUMPED, Guards(), LOST),
        (IntegrityState.FROZEN, Guards(), LOST),
        (IntegrityState.INCONSISTENT, Guards(), LOST),
        (IntegrityState.CLOCK_STOPPED, NO_STALE, None),
        (IntegrityState.LATE, NO_STALE, None),
        (IntegrityState.JUMPED, NO_STALE, LOST),
        (IntegrityState.LATE, NO_INTEGRITY, STALLED),
        (IntegrityState.JUMPED, NO_INTEGRITY, None),
        (IntegrityState.FROZEN, NO_INTEGRITY, None),
    ],
)
async def test_what_cannot_be_true_ends_it_by_the_guard_of_that_name(
    found: IntegrityState, guards: Guards, expected: StopCause | None
) -> None:
    for looks in ("at first", "in a hurry", "ten times a second"):
        state = State()
        loop = MagicMock()  # no timer of which would find it, too
        loop.time.return_value = state.newest_at
        if looks == "at first":
            state.integrity = Integrity(found, "seen")
        watchdog, ends = watch(state, guards, loop)
        if looks != "at first":
            assert ends == []
            state.integrity = Integrity(found, "seen")
            loop.time.return_value += 0.089
            assert watchdog.is_quiet(), "often enough"
            loop.time.return_value += 0.002 if looks == "ten times a second" else 0.0
            if looks == "in a hurry":
                watchdog.hurry()
            assert watchdog.is_quiet() is (expected is None)
        assert [cause for cause, _ in ends] == ([] if expected is None else [expected]), looks
        kind = TelemetryStalled if expected is STALLED else NavigationLost
        assert all(isinstance(error, kind) for _, error in ends)


async def test_a_suspend_ends_it_whatever_the_clock_of_the_loop_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asleep = suspension.asleep_s
    watchdog, ends = watch(State(), Guards(stale_telemetry_s=None, integrity=False))
    assert watchdog.is_quiet()
    monkeypatch.setattr(suspension, "asleep_s", lambda: asleep() + 6.0)
    assert not watchdog.is_quiet()
    ((cause, error),) = ends
    assert cause is StopCause.SUSPENDED
    assert isinstance(error, ComputerSuspended)
    assert "suspended for 6.0 s" in error.seen
    watchdog.stop()
