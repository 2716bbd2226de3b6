"""The mission as a flight: who flies which legs, and how far it is, by items."""

from __future__ import annotations

from collections.abc import Callable

from m100link.apps.agent.actions import Action
from m100link.apps.agent.guided import ChangeHeight, GuidedOrder
from m100link.apps.agent.messages import MissionTold
from m100link.apps.agent.preview import preview_plan
from m100link.apps.mavlink.deck import Deck
from m100link.apps.mavlink.missions import Missions
from m100link.apps.mavlink.modes import Mode, Running
from m100link.apps.mavlink.numbers import Severity
from m100link.apps.mavlink.orders import Do, Errand, Flight, GoHome, Land, Pause
from m100link.apps.mavlink.peers import Peer
from m100link.apps.mavlink.plans import Unfit, flies_missions, plan_of
from m100link.apps.mavlink.route import Leg, Refused, Route
from m100link.apps.mavlink.wishes import Wish
from m100link.apps.mavlink.world import World
from m100link.errors import M100Error, UsageError
from m100link.missions.plan import WaypointPlan

__all__ = ["MissionFlights"]

_FINISHED, _REACHED = 1, 2
_AFTER_ACTIONS = 6  # status of the push "reached"; before them it is 4
_WAYS_DOWN: dict[Mode, Land | GoHome] = {Mode.LAND: Land(), Mode.RTL: GoHome()}


class MissionFlights:
    """Flights of the mission of one aircraft.

    Args:
        world: What is known of the aircraft.
        deck: What decides, and gets the orders.
        missions: The mission that was uploaded.
        tell: Takes what people have to know.
    """

    def __init__(
        self,
        world: World,
        deck: Deck,
        missions: Missions,
        tell: Callable[[Severity, str], None],
    ) -> None:
        self._world = world
        self._deck = deck
        self._missions = missions
        self._tell = tell
        # Waypoints of the plan that flies which are done, counted from the first.
        self._done = 0

    # -- the wish --------------------------------------------------------------------------------

    def wish(self, peer: Peer, first: int | None) -> Wish | None:
        """What flies the mission on, from an item on if one is named; None without a mission.

        Raises:
            UsageError: It cannot be flown any more.
        """
        missions = self._missions
        try:
            route = missions.route()
        except Refused as refused:
            raise UsageError(f"mission: {refused.why}") from None
        if route is None or (first is not None and first >= len(missions.items)):
            return None
        if first is not None:
            missions.begin_at(first)
        elif missions.is_over:
            missions.restart()
        flight = self._flight(route)
        flies = self._deck.flight
        return Wish(Mode.MISSION, flight, peer, flies is None or flies.edition != flight.edition)

    def _flight(self, route: Route) -> Flight:
        missions = self._missions
        legs = [leg for leg in route.legs if leg.item >= missions.current]
        plan, why = self._plan(legs, route.then)
        orders: list[GuidedOrder] = [leg.order for leg in legs]
        waits, items = [leg.wait for leg in legs], [leg.item for leg in legs]
        takes_off = self._world.is_on_ground is not False
        climb: list[None] = []
        if takes_off and legs:
            # Up first, in place: what stands between the ground and the first leg is not known.
            height = legs[0].order.height if route.height is None else route.height
            orders, waits, climb = [ChangeHeight(height), *orders], [0.0, *waits], [None]
        return Flight(
            tuple(orders),
            tuple(waits),
            takes_off,
            _WAYS_DOWN.get(route.then),
            items=(*climb, *items),
            edition=missions.edition,
            plan=plan,
            why=why,
        )

    def _plan(self, legs: list[Leg], then: Mode) -> tuple[WaypointPlan | None, str]:
        """What the aircraft flies by itself; None with the reason where it does not."""
        firmware = self._world.known.state.firmware
        if not flies_missions(firmware):
            return None, f"firmware {firmware or 'unknown'} has no missions"
        try:
            plan = plan_of(legs, then, yaw_deg=self._world.yaw_deg)
        except Unfit as unfit:
            return None, str(unfit)
        for refusal in preview_plan(
            plan, self._world.known.telemetry, self._world.known.state.limits
        ):
            if refusal.guard == "allow_far":
                return None, f"it begins {refusal.measured:.0f} m from here"
        return plan, ""

    # -- progress --------------------------------------------------------------------------------

    def leg(self, flight: Flight, number: int, is_done: bool) -> None:
        """A leg of a flight begins, or is done."""
        if self._deck.flight is not flight or not flight.items:
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

    def begun(self, flight: Flight) -> None:
        """The aircraft has begun to fly the mission by itself."""
        self._done = 0
        if self._deck.mission_begun(flight):
            self._tell(Severity.NOTICE, "mission: the aircraft flies it by itself")
            self.leg(flight, flight.by_agent, False)

    def is_due(self, errand: Errand) -> bool:
        """Whether something that is told to a mission on its way is still wanted."""
        if isinstance(errand, Do):
            return self._deck.is_flown_by_aircraft
        wanted = Running.PAUSED if isinstance(errand, Pause) else Running.MISSION
        return errand.flight is self._deck.flight and self._deck.running is wanted

    def failed(self, errand: Errand, error: M100Error) -> None:
        """It was not taken: nobody knows what an aircraft flies that does not pause or go on."""
        if self.is_due(errand):
            self._tell(Severity.ERROR, f"mission: {error.seen}")
            if not isinstance(errand, Do):
                self._deck.interrupt("hold: the mission is stopped")

    def told(self, told: MissionTold) -> None:
        """The aircraft told of the mission that it flies for us."""
        flight = self._deck.flight
        if flight is None or flight.plan is None or not self._deck.is_flown_by_aircraft:
            return
        last = len(flight.plan.waypoints)
        if told.event == _FINISHED:
            self._pass(flight, last)
            self._deck.mission_flown(flight)
        elif told.event == _REACHED and told.data[0] < last:
            index, status = told.data[:2]
            waits = flight.waits[flight.by_agent + index] > 0.0
            self._pass(flight, index if waits and status != _AFTER_ACTIONS else index + 1)

    def _pass(self, flight: Flight, count: int) -> None:
        """So many waypoints are done: whose push was lost is told with the next one."""
        for index in range(self._done, count):
            self._done = index + 1
            number = flight.by_agent + index
            self.leg(flight, number, True)
            if number + 1 < len(flight.legs):
                self.leg(flight, number + 1, False)
                speed = flight.speed_of(number + 1)
                if speed != flight.speed_of(number):
                    self._deck.orders.append(Do(Action.MISSION_SPEED, round(speed * 1000)))
