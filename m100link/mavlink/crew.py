"""Carries out what the deck orders, by asking the agent: one order at a time, the newest wins."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from m100link.agent.client import AgentClient
from m100link.agent.guided import ChangeHeight
from m100link.errors import LinkError, M100Error, NoAuthority, TaskRefused
from m100link.mavlink.deck import Deck
from m100link.mavlink.orders import (
    Arm,
    CallOff,
    Disarm,
    Drop,
    Flight,
    GoHome,
    Halt,
    Land,
    Order,
    Steer,
    TakeOff,
)
from m100link.mavlink.world import World
from m100link.protocol.commands.control import Task

__all__ = ["Crew"]

_RENEWAL_S = 0.5
_TAKES_OFF_WITHIN_S = 2.5
"""Seconds after its order in which a take-off shows, if it is flown (DJI's samples wait for 2)."""
_LANDS_WITHIN_S, _LANDS_AGAIN_S = 30.0, 0.5
_CLOSE_M = 0.3
"""A climb of less than this after the take-off is not asked for."""


class Crew:
    """Asks the agent of one aircraft.

    Args:
        agent: The agent.
        world: What is known of the aircraft; it gets the lease.
        deck: What decides.
        on_leg: Called with a flight, the number of its leg and whether that is done, or begins.
    """

    def __init__(
        self,
        agent: AgentClient,
        world: World,
        deck: Deck,
        on_leg: Callable[[Flight, int, bool], None],
    ) -> None:
        self._agent = agent
        self._world = world
        self._deck = deck
        self._on_leg = on_leg
        # The order under way; a new one ends it.
        self._work: asyncio.Task[None] | None = None
        # Giving back ends before authority is asked for anew: they would cross.
        self._is_disarming = False
        # A request for authority is never ended: its answer decides who has it.
        self._arming: asyncio.Task[None] | None = None
        self._renewed_at = agent.now
        self._doing: dict[type[Any], Callable[[Any], Awaitable[None]]] = {
            Disarm: self._disarm,
            CallOff: self._call_off,
            TakeOff: self._take_off,
            Land: self._land,
            GoHome: self._go_home,
            Halt: self._halt,
            Flight: self._fly,
        }

    def advance(self) -> None:
        """Carry out what was ordered, and keep the lease."""
        orders, self._deck.orders = self._deck.orders, []
        for order in orders:
            if isinstance(order, Steer):
                if self._world.lease is not None and self._world.has_lease:
                    self._agent.steer(self._world.lease, order.setpoint, order.lifetime)
            elif isinstance(order, Drop):
                if self._work is not None and not self._is_disarming:
                    self._work.cancel()
            elif isinstance(order, Arm):
                self._arming = self._agent.background.spawn(self._arm(order), "arming")
            else:
                self._replace(order)
        now = self._agent.now
        if self._world.lease is not None and now - self._renewed_at >= _RENEWAL_S:
            self._renewed_at = now
            if self._world.has_lease:
                self._agent.keep(self._world.lease)

    def _replace(self, order: Order) -> None:
        if self._work is not None:
            self._work.cancel()
        self._work = self._agent.background.spawn(self._carry_out(order), type(order).__name__)
        self._is_disarming = isinstance(order, Disarm | CallOff)

    async def _carry_out(self, order: Order) -> None:
        error = None
        try:
            await self._doing[type(order)](order)
        except M100Error as met:
            error = met
        self._deck.ended(order, error, self._agent.now)

    # -- control authority -----------------------------------------------------------------------

    async def _arm(self, order: Arm) -> None:
        error = None
        if self._is_disarming and self._work is not None:
            await asyncio.wait({self._work})
        try:
            if not self._world.has_lease:
                self._world.lease = await self._agent.acquire(order.name)
            if not self._agent.state.is_activated:
                await self._agent.activate(self._world.lease)
            self._check_wanted()
            await self._agent.obtain(self._world.lease)
            self._check_wanted()
        except M100Error as met:
            error = met
            await self._let_go()
        self._deck.armed(error, self._agent.now)

    def _check_wanted(self) -> None:
        if self._deck.is_unwanted:
            raise NoAuthority(
                "it was disarmed before it was armed",
                cause="a ground station gave control back meanwhile",
                remedy="arm again",
            )

    async def _disarm(self, order: Disarm) -> None:
        await self._let_go()

    async def _call_off(self, order: CallOff) -> None:
        self._world.may_take_off = True
        try:
            await self._agent.release(self._world.lease)
            # It may have been taking off until now: what counts is what it does after a while.
            await asyncio.sleep(_TAKES_OFF_WITHIN_S)
            if self._world.is_on_ground is not True:
                await self._agent.obtain(self._world.lease)
                await self._land_at_last()
        finally:
            self._world.may_take_off = False
        await self._let_go()

    async def _land_at_last(self) -> None:
        """The aircraft refuses a landing until its take-off is over."""
        until = self._agent.now + _LANDS_WITHIN_S
        while True:
            try:
                await self._agent.fly(self._world.lease, Task.LAND)
            except TaskRefused:
                if self._world.is_on_ground:
                    return
                if self._agent.now >= until:
                    raise
                await asyncio.sleep(_LANDS_AGAIN_S)
            else:
                return

    async def _let_go(self) -> None:
        lease = self._world.lease
        try:
            if lease is not None and self._world.has_lease:
                await self._agent.release_lease(lease.token)
        except M100Error:
            pass  # it has ended meanwhile, which is what was wanted
        self._world.lease = None

    # -- flying ----------------------------------------------------------------------------------

    async def _make_way(self, is_interrupting: bool) -> None:
        """End the task of the aircraft: giving authority back is the only way that there is."""
        if not is_interrupting:
            return
        await self._agent.stop()
        await self._agent.obtain(self._world.lease)

    async def _take_off(self, order: TakeOff) -> None:
        await self._agent.fly(self._world.lease, Task.TAKE_OFF)
        self._deck.took_off(order, self._agent.now)
        height = self._world.height
        if order.height is None or (height is not None and abs(height - order.height) < _CLOSE_M):
            return
        await self._agent.guide(self._world.lease, ChangeHeight(order.height))

    async def _land(self, order: Land) -> None:
        await self._make_way(order.is_interrupting)
        self._agent.halt("landing", self._world.lease)
        await self._agent.fly(self._world.lease, Task.LAND)

    async def _go_home(self, order: GoHome) -> None:
        await self._make_way(order.is_interrupting)
        self._agent.halt("going home", self._world.lease)
        await self._agent.fly(self._world.lease, Task.GO_HOME)

    async def _halt(self, order: Halt) -> None:
        await self._make_way(order.is_interrupting)
        self._agent.halt(order.why or "hold", self._world.lease)

    async def _fly(self, order: Flight) -> None:
        lease = self._world.lease  # of this flight: it does not go on under a later one
        if order.takes_off:
            await self._agent.fly(lease, Task.TAKE_OFF)
            self._deck.took_off(order, self._agent.now)
        for number, leg in enumerate(order.legs):
            self._on_leg(order, number, False)
            await self._agent.guide(lease, leg)
            if number < len(order.waits):
                await asyncio.sleep(order.waits[number])
            self._on_leg(order, number, True)

    async def end(self) -> None:
        """Give back what is held."""
        for work in (self._work, self._arming):
            if work is not None:
                work.cancel()
        try:
            await self._let_go()
        except LinkError:
            return
