"""Carries out orders of the flight mode manager: one at a time, the newest wins."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import MissionReport
from m100link.apps.agent.orders import ChangeHeight, GuidedOrder, Order
from m100link.apps.agent.preview import preview_plan
from m100link.apps.mavlink.translator.codec import Peer
from m100link.apps.mavlink.translator.flight_mode_manager import FlightModeManager
from m100link.apps.mavlink.translator.missions import MissionProtocol
from m100link.apps.mavlink.translator.numbers import Severity
from m100link.apps.mavlink.translator.orders import (
    CancelTakeOff,
    Drop,
    FlightSequence,
    HoldPosition,
    LandInPlace,
    MissionCommand,
    ModeRequest,
    ObtainControl,
    PayloadOrder,
    ReleaseControl,
    ReturnToLaunch,
    TakeOffAndClimb,
    VehicleOrder,
)
from m100link.apps.mavlink.translator.route import (
    Refused,
    Route,
    RoutePoint,
    Unfit,
    flies_missions,
    plan_of,
)
from m100link.apps.mavlink.translator.vehicle_state import FlightSource, Mode, VehicleState
from m100link.missions.plan import WaypointPlan
from m100link.protocol.setpoint import Setpoint

_TAKES_OFF_WITHIN_S = 2.5
"""Seconds after its order in which a take-off shows, if it is flown (DJI's samples wait for 2)."""
_LASTS_S = 0.25  # a setpoint on its own: the bridge renews it many times in that
_CLOSE_M = 0.3  # a climb of less than this after the take-off is not asked for


class OrderExecutor:
    def __init__(
        self,
        agent: AgentClient,
        world: VehicleState,  # what is known of the aircraft, with the control over it
        manager: FlightModeManager,
        flights: MissionFlights,  # takes how far a flight is
    ) -> None:
        self._agent = agent
        self._world = world
        self._session = world.session
        self._manager = manager
        self._flights = flights
        # The order under way; a new one ends it.
        self._work: asyncio.Task[None] | None = None
        # When it was wanted at the earliest, s: a STOP since then overtakes each of its steps.
        self._asked_at = self._looked_at = self._armed_at = agent.now
        # From before a mission's start leaves until its end is reported, or its stop is heard.
        self._owes_a_stop = False
        # Orders to a mission go out in the order in which they were wanted.
        self._telling = asyncio.Lock()
        self._activating = asyncio.Lock()
        self._doing: dict[type[Any], Callable[[Any, Lease | None], Awaitable[None]]] = {
            ObtainControl: self._arm,
            ReleaseControl: self._disarm,
            CancelTakeOff: self._call_off,
            TakeOffAndClimb: self._take_off,
            LandInPlace: self._land,
            ReturnToLaunch: self._go_home,
            HoldPosition: self._hold,
            FlightSequence: self._fly,
        }

    def advance(self) -> None:
        """Carry out what was ordered, and keep the lease."""
        wanted, self._manager.orders = self._manager.orders, []
        for order in wanted:
            if isinstance(order, Setpoint):
                self._steer(order)
            elif isinstance(order, MissionCommand):
                self._agent.background.spawn(self._tell(order), order.order.label)
            elif isinstance(order, PayloadOrder):
                self._agent.background.spawn(self._use(order), order.order.label)
            elif isinstance(order, Drop):
                self._drop()
            elif isinstance(order, ObtainControl):
                self._armed_at = self._looked_at
                self._agent.background.spawn(self._carry_out(order), "arming")
            else:
                self._replace(order)
        if self._owes_a_stop and self._agent.is_connected and not self._session.is_obeyed:
            self._owes_a_stop = False  # the agent ends the mission of a client that lost control
        self._session.heard()
        self._looked_at = self._agent.now

    def _steer(self, setpoint: Setpoint) -> None:
        if not self._owes_a_stop:  # a mission ignores setpoints: none before its stop is heard
            with suppress(errors.NoAuthority):  # the agent fell silent since the manager looked
                self._session.steer(setpoint, _LASTS_S)

    def _drop(self) -> None:
        if self._owes_a_stop and self._session.has_lease:
            # Where the agent was only not heard for a while, it flies on what nobody wants now.
            self._agent.hover(
                "the bridge does not know whether it has control", self._session.lease
            )
        if self._work is not None:
            self._work.cancel()

    async def _tell(self, command: MissionCommand) -> None:
        async with self._telling:
            if not self._flights.is_due(command):
                return
            try:
                await self._session.ask(command.order)
                if command.flight is not None and self._flights.is_due(command):
                    self._manager.way_made()
            except errors.M100Error as error:
                self._flights.failed(command, error)

    async def _use(self, payload: PayloadOrder) -> None:
        error: errors.M100Error | None = None
        try:
            async with self._activating:  # they obey without authority, and not without this
                if not self._agent.state.is_activated:
                    await self._session.ask(orders.Activate())
            await self._session.ask(payload.order)
        except errors.M100Error as met:
            error = met
        payload.done(error)

    def _replace(self, order: VehicleOrder) -> None:
        if self._work is not None:
            self._work.cancel()
        self._asked_at = self._looked_at
        self._work = self._agent.background.spawn(self._carry_out(order), type(order).__name__)

    async def _ask(self, order: Order, lease: Lease | None, accepted: Any = None) -> None:
        await self._agent.ask(order, lease, accepted, self._asked_at)

    async def _carry_out(self, order: VehicleOrder) -> None:
        error: errors.M100Error | None = errors.NoAuthority("it was broken off")
        try:
            # All of it under the lease of its beginning: it does not go on under a later one.
            await self._doing[type(order)](order, self._session.lease)
            error = None
        except errors.M100Error as met:
            error = met
            if isinstance(met, errors.GuardRefused) and met.guard == "stopped":
                self._session.begin_anew(at=self._agent.now)  # its sender hears of it by that
        finally:
            if isinstance(order, ObtainControl):
                self._manager.armed(order, error, self._agent.now)
            else:
                self._manager.ended(order, error, self._agent.now)

    async def _arm(self, order: ObtainControl, _: object) -> None:
        self._session.name = order.name
        await self._session.obtain(asked_at=self._armed_at)

    async def _disarm(self, *_: object) -> None:
        await self._session.give_back()
        self._owes_a_stop = False  # the agent stops the mission of a lease that ends

    async def _call_off(self, order: CancelTakeOff, lease: Lease | None) -> None:
        self._world.may_take_off = True
        try:
            await self._ask(orders.Release(), lease)
            # It may have been taking off until now: what counts is what it does after a while.
            await asyncio.sleep(_TAKES_OFF_WITHIN_S)
            if self._world.known.view.is_on_ground is not True:
                await self._ask(orders.Obtain(), lease)
                # The aircraft refuses a landing until its take-off is over.
                await self._session.bring_down(orders.Land(), self._asked_at)
        finally:
            self._world.may_take_off = False
        await self._disarm()

    # -- flying ----------------------------------------------------------------------------------

    async def _make_way(self, lease: Lease | None, is_interrupting: bool = False) -> None:
        """End what the aircraft flies by itself: its task, or its mission.

        Giving authority back is the only end of a task. A mission of any program gets a stop.
        Raises AckTimeout, MissionRefused: it may be flying on. Raises LinkError, NoAuthority: see
        each class.
        """
        if is_interrupting:
            self._asked_at = await self._agent.end_task(self._asked_at)
            # A stop keeps it where no task is known.
            await self._ask(orders.Release(), lease)
            await self._ask(orders.Obtain(), lease)
        elif self._owes_a_stop or self._world.flies_mission:
            await self._ask(orders.StopMission(), lease)
        self._owes_a_stop = False
        self._manager.way_made()

    async def _take_off(self, order: TakeOffAndClimb, lease: Lease | None) -> None:
        await self._ask(orders.TakeOff(), lease)
        self._manager.took_off(order, self._agent.now)
        height = self._world.height
        if order.height is None or (height is not None and abs(height - order.height) < _CLOSE_M):
            return
        await self._ask(ChangeHeight(order.height), lease)

    async def _land(self, order: LandInPlace, lease: Lease | None) -> None:
        with suppress(errors.AckTimeout, errors.MissionRefused):
            # The agent reports it; and a landing breaks off what a stop did not end.
            await self._make_way(lease, order.is_interrupting)
        self._manager.way_made()
        self._agent.hover("landing", self._session.lease)
        await self._ask(orders.Land(), lease)

    async def _go_home(self, order: ReturnToLaunch, lease: Lease | None) -> None:
        await self._make_way(lease, order.is_interrupting)
        self._agent.hover("going home", self._session.lease)
        await self._ask(orders.GoHome(), lease)

    async def _hold(self, order: HoldPosition, lease: Lease | None) -> None:
        await self._make_way(lease, order.is_interrupting)
        # That of a STOP says to the stations that their flight is over; others are no answer to it.
        at = math.inf if order.follows_stop else self._asked_at
        self._session.begin_anew(order.why or "hold", at)

    async def _fly(self, order: FlightSequence, lease: Lease | None) -> None:
        await self._make_way(lease)
        if order.takes_off:
            await self._ask(orders.TakeOff(), lease)
            self._manager.took_off(order, self._agent.now)
        for number, leg in enumerate(order.legs[: order.by_agent]):
            self._flights.leg(order, number, False)
            await self._ask(leg, lease)
            if number < len(order.waits):
                await asyncio.sleep(order.waits[number])
            self._flights.leg(order, number, True)
        if order.plan is not None:
            await self._fly_plan(order, order.plan, lease)

    async def _fly_plan(
        self, order: FlightSequence, plan: WaypointPlan, lease: Lease | None
    ) -> None:
        """Let the aircraft fly it by itself; done when that is over."""
        upload = orders.UploadPlan.of(plan)
        await self._ask(upload, lease)
        self._owes_a_stop = True
        try:
            start = orders.StartMission(upload.digest, until_over=True)
            await self._ask(start, lease, lambda: self._flights.begun(order))
        except errors.M100Error:
            self._owes_a_stop = False  # the agent has stopped it, or reported what came of that
            raise
        self._owes_a_stop = False

    async def end(self) -> None:
        if self._work is not None:
            self._work.cancel()
        await self._session.give_back()


# -- the mission as a flight: who flies which legs, and how far it is, by items --------------------


_FINISHED, _REACHED = 1, 2
_AFTER_ACTIONS = 6  # status of the push "reached"; before them it is 4
_WAYS_DOWN: dict[Mode, LandInPlace | ReturnToLaunch] = {
    Mode.LAND: LandInPlace(),
    Mode.RTL: ReturnToLaunch(),
}


class MissionFlights:
    def __init__(
        self,
        world: VehicleState,  # what is known of the aircraft
        manager: FlightModeManager,  # what decides, and gets the orders
        missions: MissionProtocol,  # the mission that was uploaded
        tell: Callable[[Severity, str], None],  # takes what people have to know
    ) -> None:
        self._world = world
        self._manager = manager
        self._missions = missions
        self._tell = tell
        self.flown: GuidedOrder | None = None  # that began last, and is not done
        world.target = self.target
        # Waypoints of the plan that flies which are done, counted from the first.
        self._done = 0

    # -- mode requests ---------------------------------------------------------------------------

    def mission_request(self, peer: Peer, first: int | None) -> ModeRequest | None:
        """The request that flies the mission on, from ``first`` if given; None without a mission.

        Raises UsageError: it cannot be flown any more.
        """
        missions = self._missions
        try:
            route = missions.route()
        except Refused as refused:
            raise errors.UsageError(f"mission: {refused.why}") from None
        if route is None or (first is not None and first >= len(missions.items)):
            return None
        if first is not None:
            missions.begin_at(first)
        elif missions.is_over:
            missions.restart()
        flight = self._flight(route)
        flies = self._manager.flight
        return ModeRequest(
            Mode.MISSION, flight, peer, flies is None or flies.edition != flight.edition
        )

    def _flight(self, route: Route) -> FlightSequence:
        missions = self._missions
        legs = [leg for leg in route.legs if leg.item >= missions.current]
        plan, why = self._plan(legs, route.then)
        flown: list[GuidedOrder] = [leg.order for leg in legs]
        waits, items = [leg.wait for leg in legs], [leg.item for leg in legs]
        takes_off = self._world.known.view.is_on_ground is not False
        climb: list[None] = []
        if takes_off and legs:
            # Up first, in place: what stands between the ground and the first leg is not known.
            height = legs[0].order.height if route.height is None else route.height
            flown, waits, climb = [ChangeHeight(height), *flown], [0.0, *waits], [None]
        return FlightSequence(
            tuple(flown),
            tuple(waits),
            takes_off,
            _WAYS_DOWN.get(route.then),
            items=(*climb, *items),
            edition=missions.edition,
            plan=plan,
            why=why,
        )

    def _plan(self, legs: list[RoutePoint], then: Mode) -> tuple[WaypointPlan | None, str]:
        """The plan that the aircraft flies by itself; None with the reason where it does not."""
        view = self._world.known.view
        firmware = view.state.firmware
        if not flies_missions(firmware):
            return None, f"firmware {firmware or 'unknown'} has no missions"
        try:
            plan = plan_of(legs, then, yaw_deg=self._world.yaw_deg)
        except Unfit as unfit:
            return None, str(unfit)
        for refusal in preview_plan(plan, view.telemetry, view.state.limits):
            if refusal.guard == "allow_far":
                return None, f"it begins {refusal.measured:.0f} m from here"
        return plan, ""

    # -- progress --------------------------------------------------------------------------------

    def target(self) -> GuidedOrder | None:
        flight, flies = self._manager.flight, (FlightSource.FLIGHT, FlightSource.MISSION)
        is_ours = flight is not None and self.flown in flight.legs
        return self.flown if is_ours and self._manager.running in flies else None

    def leg(self, flight: FlightSequence, number: int, is_done: bool) -> None:
        if self._manager.flight is not flight:
            return
        self.flown = None if is_done else flight.legs[number]
        if not flight.items:
            return
        item = flight.items[number]
        if item is None:
            return
        if not is_done:
            self._missions.flies_to(item)
            return
        self._missions.reached(item)
        if number == len(flight.items) - 1:
            self._missions.over()

    def begun(self, flight: FlightSequence) -> None:
        self._done = 0
        if self._manager.mission_begun(flight):
            self._tell(Severity.NOTICE, "mission: the aircraft flies it by itself")
            self.leg(flight, flight.by_agent, False)

    def is_due(self, command: MissionCommand) -> bool:
        """Whether a command to a mission on its way is still wanted."""
        if command.flight is None:
            return self._manager.is_flown_by_aircraft
        is_pause = isinstance(command.order, orders.PauseMission)
        wanted = FlightSource.PAUSED if is_pause else FlightSource.MISSION
        return command.flight is self._manager.flight and self._manager.running is wanted

    def failed(self, command: MissionCommand, error: errors.M100Error) -> None:
        """It was not taken: nobody knows what an aircraft flies that does not pause or go on."""
        if self.is_due(command):
            self._tell(Severity.ERROR, f"mission: {error.seen}")
            if command.flight is not None:
                self._manager.interrupt("hold: the mission is stopped")

    def report(self, reported: MissionReport) -> None:
        flight = self._manager.flight
        if flight is None or flight.plan is None or not self._manager.is_flown_by_aircraft:
            return
        last = len(flight.plan.waypoints)
        if reported.event == _FINISHED:
            self._pass(flight, last)
            self._manager.mission_flown(flight)
        elif reported.event == _REACHED and reported.data[0] < last:
            index, status = reported.data[:2]
            waits = flight.waits[flight.by_agent + index] > 0.0
            self._pass(flight, index if waits and status != _AFTER_ACTIONS else index + 1)

    def _pass(self, flight: FlightSequence, count: int) -> None:
        """So many waypoints are done: one whose push was lost is reported with the next."""
        for index in range(self._done, count):
            self._done = index + 1
            number = flight.by_agent + index
            self.leg(flight, number, True)
            if number + 1 < len(flight.legs):
                self.leg(flight, number + 1, False)
                speed = flight.speed_of(number + 1)
                if speed != flight.speed_of(number):
                    self._manager.orders.append(MissionCommand(orders.SetMissionSpeed(speed)))
