"""A mission of an aircraft of a fleet, in the shape of :class:`m100link.WaypointFlight`.

Orders go under the lease of a control block. The program asks for the progress twice a second: if
the network loses an answer, the next one has all of it.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Self

from m100link.apps.agent import orders
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.asking import PATIENCE_S, RIGHTS, Asker, Questions
from m100link.apps.fleet.payloads import MissionCard, MissionStage, OrderReply, unpack
from m100link.errors import M100Error, MissionAborted, OutcomeUnknown
from m100link.flight.missions import events
from m100link.missions.plan import WaypointPlan

_logger = logging.getLogger(__name__)

_LOOK_S = 0.5
_AGAIN_S = 0.2

OrderUnderLease = Callable[[orders.Order], Awaitable[OrderReply]]


async def mission_card(asker: Asker, *, patience: float = PATIENCE_S) -> MissionCard:
    """Where the mission of an aircraft is.

    Raises OutcomeUnknown: it gives no answer for so many seconds. Raises MessageError: its answer
    cannot be read.
    """
    clock, keys = asyncio.get_running_loop().time, asker.keys
    until, unread = clock() + patience, None
    async with Questions(asker.bus) as questions:
        while (left := until - clock()) > 0:
            if questions.is_due:
                questions.ask(keys.mission, within=left)
            ended = await questions.answered(min(left, questions.left))
            answers = [] if ended is None else ended[1]
            for answer in filter(asker.is_of_aircraft, answers):
                try:
                    card: MissionCard = unpack(MissionCard, answer.payload)
                except MessageError as error:
                    unread = error
                    continue
                if card.name == keys.name:
                    return card
            if questions.is_due:
                await asyncio.sleep(_AGAIN_S)
    if unread is not None:
        raise unread
    raise OutcomeUnknown(
        f"{keys.name} does not report its mission",
        cause="the link is cut, its agent is gone or an old one, or the router lets no answer pass "
        "to this identity: it has no right to watch",
        remedy=f"look at the aircraft; m100link fleet stop; {RIGHTS}",
    )


class MissionOrders:
    """Orders about missions under one lease."""

    def __init__(self, ask: OrderUnderLease) -> None:
        self._ask = ask

    async def upload(self, plan: WaypointPlan) -> str:
        """Upload a plan to the agent, where it waits; the aircraft does not have it yet.

        Returns:
            Its digest.

        Raises:
            M100Error: As ``m100link.apps.fleet.asking.Asker.ask``.
        """
        return (await self._ask(orders.UploadPlan.of(plan))).text

    async def start(self, digest: str, *, take_off: bool = False) -> None:
        """Start the plan of that digest; returns when it has begun.

        Raises:
            M100Error: As :meth:`m100link.Control.waypoint_mission`, and :class:`FleetError`.
        """
        await self._ask(orders.StartMission(digest, take_off))

    async def pause(self) -> None:
        """Pause the mission; the aircraft hovers."""
        await self._ask(orders.PauseMission())

    async def resume(self) -> None:
        await self._ask(orders.ResumeMission())

    async def stop(self, why: str = "") -> None:
        """End it: the aircraft hovers. Does not wait for a disk, nor for the end."""
        await self._ask(orders.Halt(why or "its operator stopped it"))

    async def set_speed(self, speed: float) -> float:
        """Change its speed, m/s; returns the one in force."""
        return (await self._ask(orders.SetMissionSpeed(speed))).number / 1000


class FleetMission:
    """A waypoint mission: ``async with control.waypoint_mission(plan) as mission``.

    Entering uploads and starts it. ``async for event in mission`` gives the same events as a
    mission of one aircraft, until its end. Leaving the block earlier stops it.
    """

    def __init__(
        self, asker: Asker, orders: MissionOrders, plan: WaypointPlan, *, take_off: bool
    ) -> None:
        self._asker, self._keys, self._orders = asker, asker.keys, orders
        self.plan = plan
        self._take_off = take_off  # first, from the ground
        self._digest = self._boot = ""
        self._events: deque[events.MissionEvent] = deque()
        self._seen = 0
        self._was_paused = self._is_stopped = self._is_end_reported = False
        self.has_begun = False  #: whether the start was ordered, whatever its outcome
        self._end: MissionCard | None = None

    @property
    def is_over(self) -> bool:
        """Whether its end is known."""
        return self._end is not None

    async def __aenter__(self) -> Self:
        self._digest = await self._orders.upload(self.plan)
        self._events.append(events.Uploaded(len(self.plan.waypoints), None))
        self._boot = (await mission_card(self._asker)).boot
        self.has_begun = True
        try:
            await self._orders.start(self._digest, take_off=self._take_off)
        except (asyncio.CancelledError, OutcomeUnknown):
            await self._leave(is_quiet=True)  # it may have begun
            raise
        self._events.append(events.Started())
        return self

    async def __aexit__(self, exc_type: object, *_: object) -> None:
        await self._leave(is_quiet=exc_type is not None)

    async def _leave(self, *, is_quiet: bool) -> None:
        if self.is_over:
            return
        try:
            await self.stop()
        except M100Error as error:
            if not is_quiet:
                raise
            # The error that ends the block counts. A mission in flight ends with the lease.
            _logger.warning("%s: its mission was not stopped: %s", self._keys.name, error.seen)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> events.MissionEvent:
        """The next event.

        Raises MissionAborted, NotObserved: the reason of its early end. Raises OutcomeUnknown: its
        state is unknown, or its agent restarted.
        """
        while not self._events:
            if self._end is not None:
                if self._end.fault is not None and not self._is_stopped:
                    raise self._end.fault.error()
                raise StopAsyncIteration
            await asyncio.sleep(_LOOK_S)
            await self.look()
        return self._events.popleft()

    async def look(self) -> MissionCard:
        """Ask where it is, and take note of what happened since.

        Raises: as :meth:`__anext__`, but for how it ended.
        """
        card = await mission_card(self._asker)
        if card.boot != self._boot:
            raise OutcomeUnknown(
                f"the agent of {self._keys.name} restarted while its mission flew",
                remedy="look at the aircraft: it may fly on; m100link fleet stop",
            )
        if card.digest not in (self._digest, "") or card.stage is MissionStage.UPLOADED:
            raise MissionAborted(f"another plan was uploaded to {self._keys.name}", code=None)
        self._note(card)
        return card

    def _note(self, card: MissionCard) -> None:
        begin = self._seen - card.reached_count + len(card.reached)
        self._events += map(events.Reached, card.reached[max(0, begin) :])
        self._seen = card.reached_count
        if card.is_paused != self._was_paused:
            self._was_paused = card.is_paused
            self._events.append(events.Paused() if card.is_paused else events.Resumed())
        if card.is_finished and not self._is_end_reported:
            self._is_end_reported = True
            self._events.append(events.Finished())
        if card.stage in (MissionStage.OVER, MissionStage.NONE):
            if self._end is None and self._is_stopped:
                self._events.append(events.Stopped())
            self._end = card
        elif not self._events:
            values = (card.elapsed_s, card.index, card.status, card.distance_m, card.height_m)
            self._events.append(events.MissionProgress(*values))

    async def pause(self) -> None:
        """Pause it; the aircraft hovers.

        Raises:
            M100Error: As :meth:`m100link.MissionFlight.pause`, and :class:`FleetError`.
        """
        await self._orders.pause()

    async def resume(self) -> None:
        """Resume it. Raises: as a pause."""
        await self._orders.resume()

    async def set_speed(self, speed: float) -> float:
        """Change its speed, m/s; returns the one in force. Raises: as a pause."""
        return await self._orders.set_speed(speed)

    async def stop(self) -> None:
        """End it; returns when the aircraft hovers and other orders may fly it.

        Raises:
            FleetError: It may be flying on.
        """
        clock = asyncio.get_running_loop().time
        self._is_stopped = True
        await self._orders.stop()
        until = clock() + PATIENCE_S
        while not self.is_over:
            if clock() > until:
                raise OutcomeUnknown(
                    f"{self._keys.name} was asked to stop its mission, and did not report its end",
                    remedy="look at the aircraft; m100link fleet stop",
                )
            await asyncio.sleep(_AGAIN_S)
            await self.look()
