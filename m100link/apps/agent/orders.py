"""What an agent does when a front asks for it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from m100link.aircraft import AircraftCamera
from m100link.apps.agent.actions import TAKE_OFF_FIRST, UNTIL_OVER
from m100link.apps.agent.agent import Agent
from m100link.apps.agent.messages import Action, Ask
from m100link.apps.agent.mission import StagedPlan
from m100link.apps.agent.mission import read_command as read
from m100link.apps.agent.patterns import pattern
from m100link.errors import UsageError
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.commands.waypoint import WaypointMission, WaypointPoint

__all__ = ["Orders", "Result"]

Result = tuple[str, int]
"""Text and number of an outcome."""

_TASKS = {
    Action.TAKE_OFF: Task.TAKE_OFF,
    Action.LAND: Task.LAND,
    Action.GO_HOME: Task.GO_HOME,
}


class Orders:
    """What one front may ask for, and the plan that it has uploaded.

    Args:
        agent: What carries it out.
        on_plan: Called with each plan that is whole.
    """

    def __init__(self, agent: Agent, on_plan: Callable[[WaypointPlan], None]) -> None:
        self._agent = agent
        self._on_plan = on_plan
        self._staged, self._staged_under = StagedPlan(), 0  # the lease that it came under

    def doing(self, ask: Ask, token: str, accepted: Callable[[], None]) -> Awaitable[Result | None]:
        """What carries a question out, to be awaited.

        Args:
            ask: The question.
            token: Proof of the lease that it is asked under; empty without one.
            accepted: Called when the aircraft has begun.
        """
        agent = self._agent
        task = _TASKS.get(ask.action)
        if task is not None:
            return agent.fly(token, task, accepted)
        doing: dict[Action, Callable[[], Awaitable[Result | None]]] = {
            Action.ACTIVATE: lambda: self._activate(token),
            Action.OBTAIN: lambda: agent.obtain(token),
            Action.RELEASE: lambda: agent.release(token),
            Action.PATTERN: lambda: self._start_pattern(token, ask.number),
            Action.STOP: agent.stop,
            Action.GIMBAL_ANGLES: lambda: agent.move_gimbal(token, read(GimbalAngle, ask.data)),
            Action.GIMBAL_RATES: lambda: agent.move_gimbal(token, read(GimbalSpeed, ask.data)),
            Action.TAKE_PHOTO: lambda: agent.use_camera(token, AircraftCamera.take_photo),
            Action.START_VIDEO: lambda: agent.use_camera(token, AircraftCamera.start_video),
            Action.STOP_VIDEO: lambda: agent.use_camera(token, AircraftCamera.stop_video),
            Action.ARM: lambda: agent.switch_motors(token, on=True),
            Action.DISARM: lambda: agent.switch_motors(token, on=False),
            Action.MISSION_PLAN: lambda: self._stage(token, ask),
            Action.MISSION_POINT: lambda: self._stage(token, ask),
            Action.MISSION_START: lambda: self._start_mission(token, ask, accepted),
            Action.HOTPOINT_START: lambda: agent.fly_hotpoint(token, read(HotpointStart, ask.data)),
            Action.HOTPOINT_RADIUS: lambda: agent.set_hotpoint(token, radius=ask.number / 1000),
            Action.HOTPOINT_RATE: lambda: agent.set_hotpoint(token, rate=ask.number / 1000),
            Action.HOTPOINT_HEADING: lambda: agent.set_hotpoint(token),
            Action.MISSION_STOP: lambda: agent.order_mission(token, "stop"),
            Action.MISSION_PAUSE: lambda: agent.order_mission(token, "pause"),
            Action.MISSION_RESUME: lambda: agent.order_mission(token, "resume"),
            Action.MISSION_SPEED: lambda: self._set_speed(token, ask.number / 1000),
            Action.VERSION: self._version,
            Action.REPLAY: lambda: agent.order_replay(ask.data.decode("ascii", "replace")),
            Action.SEND_TO_MOBILE: lambda: agent.send_to_mobile(token, ask.data),
        }
        return doing[ask.action]()

    async def _activate(self, token: str) -> None:
        await self._agent.activate(token or None)

    async def _start_pattern(self, token: str, number: int) -> None:
        self._agent.start_pattern(token, f"simple task {number}", pattern(number))

    async def _stage(self, token: str, ask: Ask) -> None:
        """A piece of a plan: nothing is asked of the aircraft before the start."""
        self._agent.desk.check(token, self._agent.now)
        if ask.action is Action.MISSION_PLAN:
            self._staged_under = ask.fence
            self._staged.begin(read(WaypointMission, ask.data))
        else:
            staged = self._plan_of(ask)
            staged.add(read(WaypointPoint, ask.data))
            if staged.plan is not None:
                self._on_plan(staged.plan)

    async def _start_mission(self, token: str, ask: Ask, accepted: Callable[[], None]) -> None:
        await self._agent.fly_mission(
            token,
            self._plan_of(ask).require(),
            take_off=bool(ask.number & TAKE_OFF_FIRST),
            begun=accepted if ask.number & UNTIL_OVER else None,
        )

    def _plan_of(self, ask: Ask) -> StagedPlan:
        """The plan that came under this lease: nobody flies what somebody else left.

        Raises:
            UsageError: It came under another one.
        """
        if self._staged_under != ask.fence:
            raise UsageError(
                "no plan was uploaded under this lease", remedy="upload it again, then start"
            )
        return self._staged

    async def _set_speed(self, token: str, speed: float) -> Result:
        return "", round(await self._agent.set_mission_speed(token, speed) * 1000)

    async def _version(self) -> Result:
        version = await self._agent.version()
        return version.name, version.crc
