"""What actions fly: each a few orders to the agent, one after the other, and a way to end them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.guided import ChangeHeight, FlyTo, GuidedOrder
from m100link.apps.ros2.helm import Helm
from m100link.errors import UsageError
from m100link.protocol.commands.control import Task
from m100link.protocol.records import Position

__all__ = ["FLIGHTS", "Flight"]

_CLOSE_M = 0.3
"""A climb of less than this after the take-off is not asked for."""

_MOST_WAYPOINTS = 500
_SPEED, _FASTEST = 5.0, 10.0
_LONGEST_WAIT_S = 600.0


class Flight(Protocol):
    """A goal that flies."""

    async def run(self) -> None:
        """Fly it; done when it is there.

        Raises:
            M100Error: It was refused, or ended before its end.
        """

    def end(self, why: str) -> None:
        """End it with a hover; the autopilot's take-off is waited for."""

    @property
    def is_ours(self) -> bool:
        """Whether control is still that under which it was asked for."""
        ...

    def feedback(self) -> Mapping[str, Any]:
        """How far it is."""
        ...


class _Guided:
    """Orders to the agent under the lease of their beginning, which end by a hover."""

    def __init__(self, agent: AgentClient, helm: Helm) -> None:
        self._agent, self._lease = agent, helm.held()
        self.is_ended = False
        self._hovering = asyncio.Event()

    def end(self, why: str) -> None:
        """End what flies; nothing more is ordered."""
        self.is_ended = True
        self._hovering.set()
        if self.is_ours:  # what somebody else flies by now goes on
            self._agent.halt(why)  # not under the lease, by which setpoints would fly after STOP

    @property
    def is_ours(self) -> bool:
        """Whether the lease of its beginning is in force."""
        return self._agent.holds(self._lease)

    async def guide(self, order: GuidedOrder) -> None:
        """Fly one order, unless it was ended."""
        if not self.is_ended:
            await self._agent.guide(self._lease, order)

    async def wait(self, seconds: float) -> None:
        """Hover for a while."""
        try:
            async with asyncio.timeout(seconds):
                await self._hovering.wait()
        except TimeoutError:
            return

    def progress(self) -> Mapping[str, Any]:
        """What remains of the order."""
        guided = self._agent.state.guided
        known = (None, None) if guided is None else (guided.distance_m, guided.seconds)
        distance, seconds = (math.nan if one is None else one for one in known)
        return {"distance": distance, "seconds": seconds}


class _TakeOff(_Guided):
    def __init__(self, agent: AgentClient, helm: Helm, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, helm)
        self._height = _finite("a height", goal["height"])
        if self._height < 0.0:
            raise UsageError("a height below the take-off point")

    async def run(self) -> None:
        await self._agent.fly(self._lease, Task.TAKE_OFF)
        if self._height and abs(self._now() - self._height) >= _CLOSE_M:
            await self.guide(ChangeHeight(self._height))

    def _now(self) -> float:
        telemetry = self._agent.telemetry
        position = None if telemetry is None else telemetry.fresh(Position, within=1.0)
        return math.nan if position is None else position.height_m

    def feedback(self) -> Mapping[str, Any]:
        return {"height": self._now()}


class _FlyTo(_Guided):
    def __init__(self, agent: AgentClient, helm: Helm, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, helm)
        self._order = _order(goal, goal["speed"])

    async def run(self) -> None:
        await self.guide(self._order)

    def feedback(self) -> Mapping[str, Any]:
        return self.progress()


class _FlyMission(_Guided):
    def __init__(self, agent: AgentClient, helm: Helm, goal: Mapping[str, Any]) -> None:
        super().__init__(agent, helm)
        points = goal["waypoints"]
        if not 0 < len(points) <= _MOST_WAYPOINTS:
            raise UsageError(f"a mission has 1 to {_MOST_WAYPOINTS} waypoints, not {len(points)}")
        self._legs = [(_order(one, goal["speed"]), _wait(one["wait"])) for one in points]
        self._place = 0

    async def run(self) -> None:
        for place, (order, wait) in enumerate(self._legs):
            self._place = place
            await self.guide(order)
            if wait and not self.is_ended:
                await self.wait(wait)

    def feedback(self) -> Mapping[str, Any]:
        return {"waypoint": self._place, **self.progress()}


def _finite(what: str, value: float) -> float:
    if not math.isfinite(value):
        raise UsageError(f"{what} that is not a number")
    return value


def _wait(seconds: float) -> float:
    if not 0.0 <= _finite("a time", seconds) <= _LONGEST_WAIT_S:
        raise UsageError(f"a wait of {seconds:g} s", remedy=f"0 to {_LONGEST_WAIT_S:g} s")
    return seconds


def _order(place: Mapping[str, Any], speed: float) -> FlyTo:
    latitude = _finite("a latitude", place["latitude"])
    longitude = _finite("a longitude", place["longitude"])
    height = _finite("a height", place["height"])
    if abs(latitude) > 89.0 or abs(longitude) > 180.0:
        raise UsageError(f"{latitude:g}, {longitude:g} is not a place", remedy="degrees are needed")
    if not 0.0 <= _finite("a speed", speed) <= _FASTEST:
        raise UsageError(f"a speed of {speed:g} m/s", remedy=f"0 to {_FASTEST:g} m/s")
    return FlyTo(latitude, longitude, height, speed or _SPEED)


FLIGHTS: Mapping[str, tuple[str, Callable[[AgentClient, Helm, Mapping[str, Any]], Flight], str]] = {
    "~/take_off": ("m100_msgs/action/TakeOff", _TakeOff, "take off, and climb to a height"),
    "~/fly_to": ("m100_msgs/action/FlyTo", _FlyTo, "fly straight to a place, and hover there"),
    "~/fly_mission": (
        "m100_msgs/action/FlyMission",
        _FlyMission,
        "fly from place to place by the agent, with every firmware; hover at the last one",
    ),
}
"""Actions: type, what flies, and what it does for the manual."""
