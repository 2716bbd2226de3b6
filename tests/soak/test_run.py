"""The short form of the soak; `nox -s soak` is the long one."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from m100link.sim import VirtualClockEventLoop
from tests.soak.run import Grown, Level, connects, day, require_flat

FLAT = Level(blocks=100_000, memory_kb=50_000, tasks=5, descriptors=9)


def silent(text: str) -> None:
    print(text)  # noqa: T201 (pytest shows it when the test fails)


def test_a_quarter_of_a_simulated_hour_with_flights_holds_what_it_held() -> None:
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        require_flat(runner.run(day(0.25, silent)))


def test_fifty_connections_leave_nothing() -> None:
    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        require_flat(runner.run(connects(50, silent)))


@pytest.mark.parametrize(
    ("what", "step"), [("tasks", 1), ("descriptors", 1), ("blocks", 2000), ("memory_kb", 2000)]
)
def test_what_grows_is_found(what: str, step: int) -> None:
    levels = [replace(FLAT, **{what: getattr(FLAT, what) + step * n}) for n in range(10)]
    with pytest.raises(Grown, match=what):
        require_flat(levels)


def test_what_fills_once_is_not_growth() -> None:
    require_flat([replace(FLAT, blocks=90_000), *[FLAT] * 9])
