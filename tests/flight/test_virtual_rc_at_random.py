"""Virtual RC cut at any moment by anything: sticks go on for nobody."""

from __future__ import annotations

import asyncio
import contextlib
import random
from itertools import pairwise
from typing import Any

import pytest

from m100link import Guards, LinkError, M100Error
from m100link.flight.virtual_rc import VirtualRc
from tests.flight.test_virtual_rc import NEUTRAL, frames, in_the_air, is_on, sticks, switches
from tests.rig import Rig

pytestmark = pytest.mark.anyio

SEEDS = range(60)

Wanted = list[tuple[float, float]]
"""From when to when the program wanted sticks anywhere but in the centre."""


async def program(flown: Rig, chance: random.Random, wanted: Wanted) -> None:
    """Puts sticks anywhere, for any time; notes from when to when it wanted that."""
    guards = Guards(envelope=None) if chance.random() < 0.5 else Guards()
    async with flown.aircraft.virtual_rc(guards=guards) as rc:
        for _ in range(chance.randrange(1, 12)):
            await step(flown, rc, chance, wanted)


async def step(flown: Rig, rc: VirtualRc, chance: random.Random, wanted: Wanted) -> None:
    deflections = {name: chance.uniform(-0.6, 0.6) for name in ("roll", "pitch", "yaw", "throttle")}
    choice = chance.randrange(5)
    with contextlib.suppress(M100Error):
        if choice == 0:
            rc.set(**deflections)
            wanted.append((flown.virtual.vehicle.time, flown.virtual.vehicle.time))
        elif choice == 1:
            seconds, now = chance.uniform(0.0, 3.0), flown.virtual.vehicle.time
            wanted.append((now, now + seconds))
            await rc.hold(seconds, **deflections)
        elif choice == 2:
            rc.set()
        elif choice == 3:
            await rc.toggle_motors()
    if not rc.is_flying:
        raise KeyError("over")
    await asyncio.sleep(chance.uniform(0.0, 2.0))


async def strike(flown: Rig, chance: random.Random, task: asyncio.Task[None]) -> str:
    """Something happens; returns what."""
    what = chance.choice(
        ["nothing", "cancel", "leave F", "line", "telemetry", "close", "battery", "twice", "RC off"]
    )
    virtual, autopilot = flown.virtual, flown.virtual.autopilot
    if what in ("cancel", "twice"):
        task.cancel()
        if what == "twice":
            await asyncio.sleep(chance.uniform(0.0, 1.0))
            task.cancel()
    elif what == "leave F":
        virtual.leave_f()
        if chance.random() < 0.5:
            await asyncio.sleep(chance.uniform(0.0, 0.5))
            virtual.return_to_f()
    elif what == "line":
        await flown.aircraft.link.close()
    elif what == "telemetry":
        autopilot.set_rates(dict.fromkeys(autopilot.rates_hz, 0))
    elif what == "close":
        await flown.aircraft.aclose()
    elif what == "battery":
        virtual.vehicle.flight.battery_percent = 15.0
    elif what == "RC off":
        virtual.rc_lost()
    return what


def judge(flown: Rig, wanted: Wanted) -> None:
    """Nobody is flown by sticks that nobody wants, and the aircraft is never locked."""
    moved = [at for at, where in sticks(flown) if where != NEUTRAL and not is_corner(where)]
    for at in moved:
        assert any(since - 0.02 <= at <= until + 0.53 for since, until in wanted), at
    assert not flown.virtual.vehicle.remote.virtual.is_locked
    times = [at for at, _ in switches(flown)]
    assert all(later - earlier >= 2.0 for earlier, later in pairwise(times))
    assert not is_on(flown)


def is_corner(where: tuple[int, ...]) -> bool:
    return where == (364, 364, 364, 1684)


@pytest.mark.parametrize("seed", SEEDS)
async def test_sticks_go_on_for_nobody(seed: int) -> None:
    chance = random.Random(seed)
    options: dict[str, Any] = {"seed": seed}
    async with in_the_air(**options) as flown:
        for _ in range(2):
            wanted: Wanted = []
            task = asyncio.create_task(program(flown, chance, wanted))
            await asyncio.sleep(chance.uniform(0.0, 9.0))
            what = await strike(flown, chance, task)
            print(what)  # noqa: T201 (pytest shows it when the test fails)
            ended, _ = await asyncio.wait([task], timeout=60.0)
            assert ended, f"{what}: it does not end"
            ended_at = flown.virtual.vehicle.time
            await asyncio.sleep(1.5)
            judge(flown, wanted)
            late = [at for at, where in sticks(flown) if at > ended_at + 0.05]
            assert late == [], f"{what}: channels after its end"
            if not task.cancelled() and isinstance(task.exception(), LinkError):
                break
            if not flown.aircraft.is_connected:
                break
            names = {one.get_name() for one in asyncio.all_tasks()}
            assert "m100link stop path" not in names
            flown.virtual.autopilot.received_commands.clear()
            assert frames(flown, object) == []
