"""The mission of a front while it flies."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TypeVar

from m100link.apps.agent.background import TaskSet, goes_on
from m100link.apps.agent.messages import EventTopic, Journal
from m100link.errors import M100Error, MissionRunning, NotObserved, UsageError
from m100link.flight.control import Control
from m100link.flight.missions import events
from m100link.flight.missions.hotpoint import CircleHeading, CircleStart, HotpointFlight
from m100link.flight.missions.mission_guard import MissionFlight
from m100link.flight.missions.waypoint import WaypointFlight
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.hotpoint import HotpointStart

F = TypeVar("F", bound=MissionFlight)

_NAMES: dict[object, str] = {
    MissionFlight: "mission",
    WaypointFlight: "waypoint mission",
    HotpointFlight: "hotpoint",
}

_WAYS_DOWN = {AtEnd.GO_HOME: Task.GO_HOME, AtEnd.LAND: Task.LAND}

_STOP_AGAIN_S = 0.5  # between a stop that got no answer and the next one
_LEFT_GROUND_M = 0.3  # a barometer drifts by less in the seconds of a start

MissionListener = Callable[[events.MissionEvent], None]
"""Called with each event, progress excepted."""


class ActiveMission:
    def __init__(self, control: Control, journal: Journal, background: TaskSet) -> None:
        self._control = control
        self._journal = journal
        self._background = background
        self._flight: MissionFlight | None = None
        # Flies it, from its beginning to its end; None where none was begun, or it is over.
        self.watch: asyncio.Task[None] | None = None
        # Asks again for a stop that got no answer.
        self.stopping: asyncio.Task[None] | None = None
        self._what = ""  # the name of the newest one, for people
        self._is_cut_off = False  # by a caller that knows why, and reports it
        self._ended_because = ""  # why this agent ended it, for those who wait for its end
        self._way_down: Task | None = None  # behind its last waypoint, as the plan says
        self._is_landing = False
        self._is_left = False  # control ends, and its stop path stops what flies
        self.on_event: MissionListener | None = None

    @property
    def is_flying(self) -> bool:
        """Whether one was begun and is not over; one that did not answer its stop may fly on."""
        return self.watch is not None or self.stopping is not None

    @property
    def is_landing(self) -> bool:
        """Whether it was flown, and the aircraft goes home or lands, as planned."""
        return self.is_flying and self._is_landing

    @property
    def task(self) -> Task | None:
        """The task that the autopilot flies for it: before its start, and behind its end."""
        if self.is_landing:
            return self._way_down
        return self._control.unended_task if self.watch is not None and not self._flight else None

    @property
    def stands(self) -> bool:
        """Whether its take-off is under way and has not left the ground, by the height."""
        position = self._control.state.position
        is_low = position is not None and position.height_m < _LEFT_GROUND_M
        return self.task is Task.TAKE_OFF and is_low

    def require_none(self, what: str) -> None:
        """Refuse what the aircraft would ignore. Raises MissionRunning: a mission flies."""
        if self.is_flying:
            raise MissionRunning(
                f"{what} was asked for while a mission flies; nothing was sent",
                cause="the aircraft ignores movement during missions",
                remedy="stop or pause the mission",
            )

    async def start(self, plan: WaypointPlan, *, take_off: bool = False) -> asyncio.Future[None]:
        """Upload a plan and let it fly; done when the aircraft has begun.

        Returns its end: done when all of it was flown, or with the error that ended it before.
        """
        flight = self._control.waypoint_mission(plan, take_off=take_off)
        self._way_down = _WAYS_DOWN.get(plan.at_end)
        return await self._begin(flight, f"mission of {len(plan.waypoints)} waypoints")

    async def circle(self, request: HotpointStart) -> None:
        """Let it fly around a place; done when the aircraft has begun."""
        # A front may send any number: one that is no CircleStart would be a ValueError below.
        for problem in request.problems():
            raise problem.error(request.NAME)
        flight = self._control.hotpoint(
            latitude_deg=math.degrees(request.latitude),
            longitude_deg=math.degrees(request.longitude),
            height=request.altitude,
            radius=request.radius,
            rate_deg_s=request.angular_rate,
            clockwise=bool(request.clockwise),
            start=CircleStart(request.start_point),
            heading=CircleHeading(request.yaw_mode),
        )
        self._way_down = None
        await self._begin(flight, f"circle of {request.radius:g} m")

    async def _begin(self, flight: MissionFlight, what: str) -> asyncio.Future[None]:
        loop = asyncio.get_running_loop()
        begun: asyncio.Future[None] = loop.create_future()
        over: asyncio.Future[None] = loop.create_future()
        for outcome in (begun, over):  # nobody may be there to hear it
            outcome.add_done_callback(look_at)
        self._what, self._is_cut_off = what, False
        self._ended_because, self._is_landing = "", False
        self.watch = self._background.spawn(self._fly(flight, what, begun, over), "mission")
        self.watch.add_done_callback(partial(self._ended_unbegun, begun))
        try:
            await asyncio.wait([begun])
            begun.result()
        except asyncio.CancelledError:
            self.end("nobody waits for it")
            raise
        return over

    def _ended_unbegun(self, begun: asyncio.Future[None], watch: asyncio.Task[None]) -> None:
        """One that was ended in the turn of the loop in which it was asked for never ran."""
        if self.watch is watch:
            self.watch = None
            if not begun.done():
                begun.set_exception(NotObserved("the mission was stopped before it began"))

    async def _fly(
        self,
        flight: MissionFlight,
        what: str,
        begun: asyncio.Future[None],
        over: asyncio.Future[None],
    ) -> None:
        outcome, level, topic = f"the {what} is over", "info", EventTopic.NONE
        failure: M100Error | None = None
        is_flown = False
        try:
            async with flight:
                self._flight = flight
                self._journal.note(f"a {what} begins")
                if not begun.done():
                    begun.set_result(None)
                async for event in flight:
                    self._tell(event)
            is_flown = not self._ended_because
        except M100Error as error:
            failure = error
            outcome, level = f"the {what} ended: {error.seen}", "error"
            topic = EventTopic.MISSION_ABORTED if begun.done() else EventTopic.NONE
            if not begun.done():
                begun.set_exception(error)
        except asyncio.CancelledError:
            left = "is left: the aircraft lands, as planned" if self._is_landing else "was stopped"
            outcome, level = f"the {what} {left}", "warning"
            raise
        finally:
            if not begun.done():
                begun.set_exception(UsageError("control ended before the mission began"))
            self.watch = None
            why = self._ended_because or "control ended"
            stopped = f"the {what} was stopped: {why}"
            if flight.is_unstopped:
                stopped = f"the {what} may be flying on, its stop was not answered: {why}"
                outcome, level = f"the stop of the {what} was not answered", "error"
            if is_flown:
                over.set_result(None)
            else:
                over.set_exception(failure or NotObserved(stopped))
            if not self._is_owed_a_stop:
                self._flight = None
            else:
                self.stopping = self._background.spawn(self._stop_again(what), "stop")
            if not self._is_cut_off:
                self._journal.note(outcome, level, topic)

    @property
    def _is_owed_a_stop(self) -> bool:
        """Whether nobody wants it, the aircraft may fly it on, and no stop path sees to that."""
        flight, is_ours = self._flight, self._control.is_flying and not self._is_left
        return flight is not None and flight.is_unstopped and is_ours

    async def _stop_again(self, what: str) -> None:
        # A line that was bad for a second left the aircraft to fly to the end of its plan.
        try:
            while self._is_owed_a_stop and self._flight is not None:
                await asyncio.sleep(_STOP_AGAIN_S)
                with goes_on("the stop of a mission"), suppress(M100Error):
                    await self._flight.stop()
            if not self._is_left:
                self._journal.note(f"the {what} was stopped", "warning")
        finally:
            self._flight = self.stopping = None

    def _tell(self, event: events.MissionEvent) -> None:
        if isinstance(event, events.Reached):
            self._journal.note(f"waypoint {event.index} reached")
        elif isinstance(event, events.Aborted):
            self._journal.note(f"the aircraft broke the mission off: {event.reason}", "warning")
        elif isinstance(event, events.Finished):
            self._is_landing = self._way_down is not None
        elif isinstance(event, events.Stopped):
            self._ended_because = self._ended_because or "its client stopped it"
        if self.on_event is not None and not isinstance(event, events.MissionProgress):
            self.on_event(event)

    def flight(self, kind: type[F]) -> F:
        """The mission. Raises UsageError: none of that kind flies, or it has not begun yet."""
        if self.watch is not None and self._flight is None:
            raise UsageError(
                f"the {self._what} has not begun yet: it is uploaded, or takes off",
                remedy="stop the mission, or wait until it has begun",
            )
        if not isinstance(self._flight, kind):
            raise UsageError(f"no {_NAMES[kind]} flies", remedy="start one")
        return self._flight

    def end(self, why: str) -> None:
        """Stop it, and do not wait for the answer: leaving its block sends the stop."""
        if self.watch is not None:
            self._ended_because = why
            self.watch.cancel()
            if not self._is_landing:  # which leaving its block lets it do
                self._journal.note(f"the mission is stopped: {why}")

    async def stop(self) -> None:
        """Stop it, also while it begins; done when something else may fly.

        Raises AckTimeout, MissionRefused, MissionAborted, LinkError: it may be flying on.
        """
        flight = self._flight
        if flight is None:
            self.end("its client stopped it")
        else:
            try:
                await flight.stop()
            except M100Error:
                self.end("its client stopped it")  # leaving its block tries again
                await self.ended()
                raise
        await self.ended()
        if self.stopping is not None:
            raise NotObserved(
                f"the {self._what} did not answer its stop: it may be flying on",
                cause="the line is broken in one direction or in both",
                remedy="the stop goes out again; the pilot ends the mission by leaving F",
            )

    async def let_go(self) -> None:
        """As :meth:`stop`; a refusal is noted."""
        try:
            await self.stop()
        except M100Error as error:
            self._journal.note(error.seen, "error")

    def cut_off(self) -> str:
        """Control was lost, and the mission with it; returns its name, empty for none."""
        # The reason of the loss comes a moment later, from the aircraft: the caller reports it.
        work = self.watch or self.stopping
        if work is None or self._flight is None:  # it has not begun: its start fails
            self.end("control ended")
            return ""
        self._is_cut_off = True
        work.cancel()
        return self._what

    def control_ended(self) -> None:
        """As :meth:`end`: the stop path goes on with a stop that got no answer."""
        self._is_left = True
        self.end("control ended")
        if self.stopping is not None:
            self.stopping.cancel()

    async def ended(self) -> None:
        if self.watch is not None:
            await asyncio.wait([self.watch])

    async def let_alone(self) -> None:
        """Wait until nothing is sent for it any more; control has ended."""
        await self.ended()
        if self.stopping is not None:
            await asyncio.wait([self.stopping])


def look_at(future: asyncio.Future[None]) -> None:
    # Nobody may wait for it: then the journal alone tells its error, and not asyncio's log.
    if not future.cancelled():
        future.exception()


def push_of(event: events.MissionEvent) -> tuple[int, bytes] | None:
    """The push (0x02/0x04) that tells of an event; None for what only this program knows."""
    if isinstance(event, events.Uploaded):
        return 0, bytes((1, *round(event.estimated_time or 0).to_bytes(2, "little"), 0, 0))
    if isinstance(event, events.Finished):
        return 1, bytes(5)
    if isinstance(event, events.Reached):
        return 2, bytes((event.index, 4, 0, 0, 0))
    if isinstance(event, events.ActionsDone):
        return 2, bytes((event.index, 6, 0, 0, 0))
    return None
