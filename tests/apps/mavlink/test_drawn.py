"""Drawn at random: orders, losses and broken-off waits; then nobody wants the aircraft any more."""

from __future__ import annotations

import math
from contextlib import AsyncExitStack
from random import Random

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlState
from m100link.apps.mavlink.translator.numbers import MavCommand
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.errors import M100Error
from tests.apps.mavlink.conftest import Ground, Rig
from tests.apps.mavlink.test_bridge import send_velocity
from tests.apps.mavlink.translator.test_missions import Exchange, waypoint

pytestmark = pytest.mark.anyio

FAR = [waypoint(40.0, 0.1), waypoint(40.0, 40.0), waypoint(60.0, 40.0)]
MODES = (Mode.HOLD, Mode.MISSION, Mode.RTL, Mode.LAND, Mode.OFFBOARD, Mode.POSCTL, Mode.TAKEOFF)
EVENTS = (
    *("arm", "arm", "disarm", "take off", "take off", "mode", "mode", "mode", "setpoints", "goto"),
    *("stop", "halt", "pilot", "take over", "cable", "lost", "cancel", "cancel", "standstill"),
    "agent",
)
_FREE = (ControlState.ABSENT, ControlState.LOST, ControlState.TAKEN_OVER)
GAPS = (0.0, 0.0, 0.003, 0.02, 0.1, 0.5, 2.0, 4.0)


class Drawn:
    """One flight of events, by a seed."""

    def __init__(self, rig: Rig, page: AgentClient, seed: int) -> None:
        self.rig, self.page, self.draw = rig, page, Random(seed)
        self.other = Ground(rig, ("127.0.0.1", 7000), 246)
        self.log: list[str] = []

    @property
    def ground(self) -> Ground:
        return self.rig.ground if self.draw.random() < 0.8 else self.other

    async def event(self) -> None:
        what = self.draw.choice(EVENTS)
        rig, ground = self.rig, self.ground
        self.log.append(f"{rig.client.now:.2f} {what}")
        if what in ("arm", "disarm"):
            ground.command(MavCommand.COMPONENT_ARM_DISARM, what == "arm")
        elif what == "take off":
            ground.command(MavCommand.NAV_TAKEOFF)
        elif what == "mode":
            mode = self.draw.choice(MODES)
            self.log[-1] += f" {mode.value}"
            ground.set_mode_now(mode)
        elif what == "setpoints":
            for _ in range(self.draw.choice((1, 10, 40))):
                send_velocity(ground, vx=self.draw.choice((-3.0, 0.0, 3.0)))
                await anyio.sleep(0.05)
        elif what == "goto":
            args = (-1.0, 1.0, 0.0, math.nan, math.nan, math.nan, rig.ground_altitude + 20.0)
            ground.command(MavCommand.DO_REPOSITION, *args)
        else:
            await self.happens(what)

    async def happens(self, what: str) -> None:
        rig, remote = self.rig, self.rig.aircraft.vehicle.remote
        gap = self.draw.choice(GAPS)
        if what == "stop":
            await self.page.stop()
        elif what == "halt":
            self.page.hover("the page")
        elif what == "pilot":
            remote.set_mode("P")
            await anyio.sleep(gap)
            remote.set_mode("F")
        elif what == "take over":
            await self.take_over(gap)
        elif what == "cable":
            rig.aircraft.unplug()
            await anyio.sleep(gap)
            rig.aircraft.replug()
        elif what == "lost":
            rig.ground.is_silent = True
            await anyio.sleep(gap)
            rig.ground.is_silent = False
            rig.ground.beat()
        elif what == "cancel":
            tasks = [*rig.client.background._tasks]
            if tasks:
                self.draw.choice(tasks).cancel()
        elif what == "standstill":
            step = rig.bridge.step
            rig.bridge.step = lambda: None  # type: ignore[method-assign] # it stands
            await anyio.sleep(gap)
            rig.bridge.step = step  # type: ignore[method-assign] # and goes on
        else:
            rig.client._channel.close("killed")
            rig.client._closed("killed")
            await anyio.sleep(gap)
            rig.client.reopen(rig.way())

    async def take_over(self, gap: float) -> None:
        try:
            if self.page.holder.number:
                offer = await self.page.ask_take_over("the page")
                lease = await self.page.confirm(offer.token)
            else:
                lease = await self.page.acquire("the page")
            await self.page.ask(orders.Obtain(), lease)
        except M100Error:
            return
        await anyio.sleep(min(gap, 2.0))
        self.page.let_go(lease)

    def stands(self, place: tuple[float, float, float]) -> bool:
        rig = self.rig
        return math.dist(place, (*rig.aircraft.position, rig.height)) < 0.5 and rig.speed < 0.2

    async def ends(self) -> None:
        """Nobody wants it any more: it stands, and nobody has control."""
        rig, how = self.rig, self.draw.choice(("bridge", "agent", "silence"))
        self.log.append(f"{rig.client.now:.2f} ends: {how}")
        if how == "bridge":
            rig.work.cancel()
        elif how == "agent":
            rig.client._channel.close("killed")
            rig.client._closed("killed")
        else:
            rig.ground.is_silent = self.other.is_silent = True
            await anyio.sleep(45.0)  # ways to the ground go on
        await anyio.sleep(15.0)
        place = (*rig.aircraft.position, rig.height)
        await anyio.sleep(5.0)
        assert self.stands(place), "it moves"
        holder = rig.agent.leases.holder(rig.agent.now)
        if how != "silence" or not rig.motors_on:
            assert holder is None, holder
            assert not rig.agent.holding.has_authority
            session = rig.vehicle.world.session
            assert session.state in _FREE, session.state
            assert not session.is_changing


async def fly(seed: int, firmware: str = "3.1", late: float = 0.0) -> None:
    async with Rig(firmware=firmware, late=late).running() as rig, AsyncExitStack() as stack:
        page = await stack.enter_async_context(AgentClient(rig.way(), "console"))
        drawn = Drawn(rig, page, seed)
        drawn.other.beat()
        if drawn.draw.random() < 0.7:
            assert await Exchange(rig.ground).upload(FAR) == 0
        if drawn.draw.random() < 0.5:
            await rig.ground.fly(5.0)
        for _ in range(drawn.draw.randrange(1, 12)):
            await drawn.event()
            await anyio.sleep(drawn.draw.choice(GAPS))
        try:
            assert not rig.work.done(), "the bridge has ended"
            await drawn.ends()
        except AssertionError as error:
            raise AssertionError(f"seed {seed}: {error}\n" + "\n".join(drawn.log)) from error


@pytest.mark.parametrize("seed", [1, 3])
async def test_nobody_wants_it_any_more(seed: int) -> None:
    await fly(seed)


@pytest.mark.parametrize("seed", range(10, 26))
async def test_nobody_wants_it_any_more_drawn_longer(seed: int) -> None:
    late = (0.0, 0.004, 0.03, 0.15)[seed // 4 % 4]
    await fly(seed, ("1.0", "2.3", "3.1", "3.1")[seed % 4], late)
