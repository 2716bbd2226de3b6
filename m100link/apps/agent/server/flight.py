"""A flight with control authority in hand: a setpoint, a task, or a program."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import anyio

from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet, ignore
from m100link.apps.agent.lease import Flown
from m100link.apps.agent.messages import GuardLimits, Journal
from m100link.apps.agent.preview import preview
from m100link.apps.agent.server.mission import ActiveMission
from m100link.errors import (
    GuardRefused,
    M100Error,
    MissionRunning,
    NotObserved,
    TaskRefused,
    UsageError,
)
from m100link.flight import foresight
from m100link.flight.control import Control
from m100link.flight.guards import Guards
from m100link.flight.guidance import GuidanceProgress
from m100link.flight.missions.mission_guard import MissionFlight
from m100link.flight.tasks import is_on_ground, task_name
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.setpoint import Setpoint

MissionOrder = Literal["pause", "resume", "stop"]

# Seconds that the neutral of a hover lives: it expires at once, and silence follows after 0.3 s.
_AT_ONCE = 1e-3

Pattern = Callable[[Control, Callable[[Setpoint], None]], Coroutine[Any, Any, None]]
"""A program that flies: takes the control and the function that sends a setpoint."""


class ActiveFlight:
    """The flight of one control block; made when it is entered, ended before it is left."""

    def __init__(self, control: Control, journal: Journal, background: TaskSet) -> None:
        self._control = control
        self._journal = journal
        self._background = background
        # Name of the task that was asked of the aircraft and has not ended, or None.
        self.task: str | None = None
        self.mission = ActiveMission(control, journal, background)
        self.guiding = GuidedFlightManager(control, journal, background)
        # The setpoint to neutralise when motion has to stop; None when nothing was sent.
        self._last: Setpoint | None = None
        self._steered: Setpoint | None = None  # the newest one of the holder of the lease
        self._running_task: asyncio.Task[None] | None = None
        self._pattern: tuple[str, asyncio.Task[None]] | None = None
        self._has_armed = False  # the motors, or is about to
        self._is_ended = False
        self.only_ends = False  # no guardian could be started: a flight may only be ended

    @property
    def has_authority(self) -> bool:
        return not self._is_ended and self._control.has_authority

    @property
    def limits(self) -> GuardLimits:
        return limits_of(self._control.guards, self._control.origin)

    @property
    def pattern(self) -> str | None:
        return self._pattern[0] if self._pattern is not None else None

    @property
    def is_in_task(self) -> bool:
        """Whether the autopilot may fly a task, or motors may idle: the block's end ends both."""
        # A program or a mission that was ended does not end the take-off that it had begun.
        if self.task is not None or self._control.unended_task is not None:
            return True
        return self._has_armed and is_on_ground(self._control.state) is not False

    @property
    def is_steered(self) -> bool:
        """Whether a setpoint of the holder of the lease is being sent: not refused, not expired."""
        return self._steered is not None and self._control.setpoint is self._steered

    @property
    def seen_task(self) -> str | None:
        """The task that the autopilot flies, also before and behind a mission."""
        if self.task is not None:
            return self.task
        flown = self.mission.task
        return None if flown is None else task_name(flown)

    @property
    def flown(self) -> Flown:
        if self.task is not None:
            return Flown(self.task)
        if self.mission.is_flying:
            return Flown.MISSION
        if self.guiding.order is not None:
            return Flown.GUIDED
        if self._pattern is not None:
            return Flown.PROGRAM
        last = self._last
        return Flown.NOTHING if last is None or last == last.neutral() else Flown.SETPOINTS

    # -- setpoints -------------------------------------------------------------------------------

    def steer(self, setpoint: Setpoint, lifetime: float = orders.SETPOINT_LIFETIME) -> None:
        """Fly this setpoint until it is renewed or its lifetime ends. Ends a program."""
        # Letting go of a stick is not steering: a neutral setpoint leaves a program alone.
        is_flown = self._pattern is not None or self.guiding.order is not None
        if is_flown or self.mission.watch is not None or self.mission.stopping is not None:
            if setpoint == setpoint.neutral():
                return
            self.mission.require_none("a setpoint")  # which the aircraft would ignore
            self._end_program("setpoints took over")
        self._send(setpoint, lifetime)
        self._steered = setpoint

    def _send(self, setpoint: Setpoint, lifetime: float) -> None:
        try:
            self._control.send(setpoint, lifetime=lifetime)
        except M100Error as error:
            self.hover(error.seen)  # the flight until now is not wanted any more
            raise
        self._last = setpoint

    def hover(self, why: str = "") -> None:
        """Hover: end a program or mission, replace the setpoint in force by its neutral.

        A take-off, landing or go-home goes on in the autopilot.
        """
        try:
            self._end_setpoints()
        finally:  # behind it, in the same turn: both report
            self.mission.end(why or "hover was ordered")
            self._end_program(why or "hover was ordered")

    def _end_setpoints(self) -> None:
        """The neutral instead of the setpoint in force, which may live for a second more."""
        last, self._last = self._last, None
        try:
            if last is not None:
                self._control.send(last.neutral(), lifetime=_AT_ONCE)
        except GuardRefused:
            # Guards do not keep it from stopping.
            self._background.spawn(self._control.stop(), "neutral")
        except M100Error:
            pass  # without authority nothing moves

    # -- tasks -----------------------------------------------------------------------------------

    async def fly(self, task: Task, accepted: Callable[[], None] = ignore) -> None:
        """Take off, land or go home; done when seen to be done. A way down stops any mission."""
        name = task.name.lower().replace("_", " ")
        self._make_room(name, ends_mission=task is not Task.TAKE_OFF)
        self.task = name
        work = self._running_task = self._background.spawn(self._fly(task, name, accepted), name)
        try:
            await asyncio.wait([work])  # the autopilot flies on when the asking front has gone
            work.result()
        except asyncio.CancelledError:
            if work.cancelled():
                # Not NoAuthority, which says that nothing was sent.
                raise NotObserved(
                    f"{name}: control ended before it was seen to end",
                    cause="the lease ended, STOP was pressed, or control was given back or lost",
                    remedy="look at the aircraft: it may go on with what it had begun",
                ) from None
            raise

    def _make_room(self, name: str, *, ends_mission: bool = False) -> None:
        """End a program for another order; a task or a mission refuses that one instead."""
        if self.task is not None:
            raise TaskRefused(
                f"{name} was asked for during {self.task}", remedy="wait for its end, or stop it"
            )
        if not ends_mission or self.mission.is_landing:
            self.mission.require_none(name)
        self._end_program(f"{name} was asked for")
        self._end_setpoints()

    async def _fly(self, task: Task, name: str, accepted: Callable[[], None]) -> None:
        control = self._control
        run = {Task.TAKE_OFF: control.take_off, Task.LAND: control.land}.get(task, control.go_home)
        has_begun = False

        def progress(_: object) -> None:
            nonlocal has_begun
            if not has_begun:
                has_begun = True
                accepted()

        outcome, level = f"{name} is done", "info"
        try:
            self._journal.note(f"{name} begins")
            listener = None if accepted is ignore else progress
            if task is not Task.TAKE_OFF:
                await self.mission.let_go()
            try:
                await run(progress=listener)
            except MissionRunning:  # somebody else's
                if task is Task.TAKE_OFF:
                    raise
                with suppress(M100Error):  # a way down breaks off what does not answer
                    await control.stop_mission()
                await run(progress=listener)
        except M100Error as error:
            outcome, level = f"{name}: {error.seen}", "error"
            raise
        except asyncio.CancelledError:
            stands = is_on_ground(control.state)  # as where control is given back at status 1
            outcome = f"{name}: control was given back before its end was seen"
            level = "info" if stands else "warning"
            raise
        finally:
            self.task = self._running_task = None
            self._journal.note(outcome, level)

    async def switch_motors(self, *, on: bool) -> None:
        if on:
            self._make_room("arm")
        else:  # whatever flies as far as is known here: somebody may stand beside the blades
            self._end_program("disarm was asked for")
            self._end_setpoints()
        self._has_armed = self._has_armed or on
        await (self._control.arm() if on else self._control.disarm())
        self._has_armed = on
        self._journal.note("the motors were started" if on else "the motors were stopped")

    # -- programs --------------------------------------------------------------------------------

    def start_pattern(self, name: str, fly: Pattern) -> None:
        """Let a program fly, until it ends, the stick is moved, or anything stops it."""
        self._make_room(name)
        self._pattern = (name, self._background.spawn(self._run_pattern(name, fly), name))

    async def _run_pattern(self, name: str, fly: Pattern) -> None:
        def send(setpoint: Setpoint) -> None:
            self._send(setpoint, orders.SETPOINT_LIFETIME)

        outcome, level = f"{name} ended: the agent failed", "error"
        try:
            self._journal.note(f"{name} begins")
            await fly(self._control, send)
            outcome, level = f"{name} is done", "info"
        except M100Error as error:
            outcome = f"{name} ended: {error.seen}"
        finally:
            # A setpoint that was refused has ended the program already, and said so.
            if self._pattern is not None and self._pattern[1] is asyncio.current_task():
                self._pattern = None
                self._journal.note(outcome, level)

    def _end_program(self, why: str, *, hovers: bool = True) -> None:
        self.guiding.end(why, hovers=hovers)
        pattern, self._pattern = self._pattern, None
        if pattern is not None:
            name, work = pattern
            work.cancel()
            self._journal.note(f"{name} ended: {why}")

    # -- guided flights --------------------------------------------------------------------------

    async def guide(self, order: orders.GuidedOrder, accepted: Callable[[], None] = ignore) -> None:
        """Fly to where somebody points; done when it is there. Ends a program; the newest wins."""
        self._make_room(f"a {order.label}")
        await self.guiding.fly(order, accepted)

    # -- missions --------------------------------------------------------------------------------

    async def start_mission(
        self, plan: WaypointPlan, *, take_off: bool, begun: Callable[[], None] | None = None
    ) -> None:
        """Upload a plan and let the aircraft fly it; done when it has begun. Ends a program.

        With ``begun``, which is called when it has begun, this is done when the mission is over,
        and raises the error that ended it.
        """
        self._make_room("a waypoint mission")
        over = await self.mission.start(plan, take_off=take_off)
        if begun is not None:
            begun()
            await asyncio.wait([over])
            over.result()

    async def start_hotpoint(self, request: HotpointStart) -> None:
        """Let the aircraft fly around a place; done when it has begun. Ends a program."""
        self._make_room("a hotpoint")
        await self.mission.circle(request)

    async def order_mission(self, what: MissionOrder) -> None:
        """Pause, resume or stop the mission that flies, also somebody else's.

        A stop is done when something else may fly. Raises UsageError: it has not begun yet; a stop
        ends that. Raises MissionRefused, MissionAborted, AckTimeout, NoAuthority: see each class.
        """
        control, own = self._control, self.mission
        if own.is_flying and what == "stop":
            await own.stop()
        elif own.is_flying:
            # Every kind of mission will do: the class is only compared with, never made.
            flight: MissionFlight = own.flight(MissionFlight)  # type: ignore[type-abstract]
            await (flight.pause() if what == "pause" else flight.resume())
        elif what == "stop":
            await control.stop_mission()
        else:
            await (control.pause_mission() if what == "pause" else control.resume_mission())

    # -- the end ---------------------------------------------------------------------------------

    async def end(self, *, is_lost: bool = False) -> str:
        """Control ends, and so do its users. Returns the mission that a loss broke off."""
        self._is_ended = True
        broken_off = ""
        if is_lost:
            broken_off = self.mission.cut_off()
        else:
            self.mission.control_ended()
        self._end_program("control was lost" if is_lost else "control ended", hovers=not is_lost)
        if self._running_task is not None:
            self._running_task.cancel()
            with anyio.CancelScope(shield=True):  # a lost authority cancels this block, too
                await asyncio.wait([self._running_task])
        with anyio.CancelScope(shield=True):
            await self.guiding.ended()
            await self.mission.let_alone()
        return broken_off


def limits_of(guards: Guards, origin: tuple[float, float] | None) -> GuardLimits:
    """Guards as a front gets them, with latitude and longitude of the start, °."""
    envelope = guards.envelope
    limits = [math.inf] * 3
    if envelope is not None:
        limits = [envelope.max_height_m, envelope.max_radius_m, envelope.max_speed_m_s]
    height, radius, speed = [limit if math.isfinite(limit) else None for limit in limits]
    latitude, longitude = origin if origin is not None else (None, None)
    return GuardLimits(height, radius, speed, guards.battery_floor_percent, latitude, longitude)


# -- flying to where an operator points: one at a time, and the newest wins ------------------------


_PATIENCE = 3.0  # times its estimated duration, until it gives up
_PATIENCE_S = 30.0


@dataclass(slots=True, eq=False)
class _Flight:
    order: orders.GuidedOrder
    accepted: Callable[[], None]  # called when it has begun
    work: asyncio.Task[None] | None = None  # the task in which it flies
    progress: GuidanceProgress | None = None  # how far it is; None before it has begun
    ended_because: str = ""  # why something else ended it; empty while nothing did
    hovers: bool = True  # whether the aircraft hovers then, as far as this side decides it


class GuidedFlightManager:
    def __init__(self, control: Control, journal: Journal, background: TaskSet) -> None:
        self._control = control
        self._journal = journal
        self._background = background
        self._flight: _Flight | None = None
        # Those whose neutral may still be going out: the next one waits for them.
        self._works: set[asyncio.Task[None]] = set()

    @property
    def order(self) -> orders.GuidedOrder | None:
        return None if self._flight is None else self._flight.order

    async def fly(self, order: orders.GuidedOrder, accepted: Callable[[], None]) -> None:
        """Fly there; done when it is there. Ends the flight before."""
        self.end("another place was pointed at")
        flight = self._flight = _Flight(order, accepted)
        work = flight.work = self._background.spawn(self._run(flight), order.label)
        self._works.add(work)
        work.add_done_callback(self._works.discard)
        try:
            await asyncio.wait([work])
            work.result()
        except asyncio.CancelledError:
            if work.cancelled():
                state = ", and the aircraft hovers" if flight.hovers else ""
                why = flight.ended_because or "the agent ends"
                raise NotObserved(f"the {order.label} was ended{state}: {why}") from None
            self.end("nobody waits for it")
            raise

    async def _run(self, flight: _Flight) -> None:
        name = flight.order.label
        ended, level = f"{name} is done", "info"
        try:
            before = self._works - {asyncio.current_task()}
            # The neutral of the flight before may still be going out: this one waits for its end.
            if before:
                await asyncio.wait(before)
            await self._steer(flight)
        except M100Error as error:
            ended, level = f"{name} ended: {error.seen}", "error"
            raise
        except asyncio.CancelledError:
            ended = f"{name} ended: {flight.ended_because or 'the agent ends'}"
            raise
        finally:
            if self._flight is flight:
                self._flight = None
            if flight.progress is not None:
                self._journal.note(ended, level)

    async def _steer(self, flight: _Flight) -> None:
        control, order = self._control, flight.order

        def progress(found: GuidanceProgress) -> None:
            is_first, flight.progress = flight.progress is None, found
            if is_first:
                self._journal.note(f"{order.label} begins")
                flight.accepted()

        # Nothing of the estimate was measured on an aircraft: it may take three times as long.
        expected = preview(order, control.state, GuardLimits()).seconds
        timeout = _PATIENCE_S + _PATIENCE * expected
        if isinstance(order, orders.FlyTo):
            await control.fly_to(**asdict(order), timeout=timeout, progress=progress)
        elif isinstance(order, orders.FlyAround):
            await control.orbit(
                center_north=0.0,
                center_east=0.0,
                frame=foresight.frame_at(order.latitude_deg, order.longitude_deg),
                radius=order.radius,
                height=order.height,
                speed=order.speed,
                turns=order.turns,
                clockwise=order.clockwise,
                timeout=timeout,
                progress=progress,
                approach=lambda found: progress(
                    replace(found, heading_error_deg=360.0 * order.turns)
                ),
            )
        elif isinstance(order, orders.ChangeHeight):
            await control.climb_to(order.height, timeout=timeout, progress=progress)
        else:
            turn = math.remainder(order.yaw_deg, 360.0)
            await control.turn_to(turn, timeout=timeout, progress=progress)

    def current(self) -> orders.GuidedFlight | None:
        """The order that flies, with the rest of it; None for nothing."""
        if self._flight is None:
            return None
        order, found = self._flight.order, self._flight.progress
        place: tuple[float | None, float | None] = None, None
        if isinstance(order, orders.FlyTo | orders.FlyAround):
            place = order.latitude_deg, order.longitude_deg
        far, seconds = (None, None) if found is None else _left(order, found)
        return orders.GuidedFlight(
            order.label,
            *place,
            height=None if isinstance(order, orders.ChangeHeading) else order.height,
            radius=order.radius if isinstance(order, orders.FlyAround) else 0.0,
            yaw_deg=getattr(order, "yaw_deg", None),
            distance_m=far,
            seconds=seconds,
        )

    def end(self, why: str, *, hovers: bool = True) -> None:
        """End it: neutral goes out. Not waited for.

        The aircraft hovers then; where control is lost somebody else flies, or nobody sees it.
        """
        flight, self._flight = self._flight, None
        if flight is not None and flight.work is not None:
            flight.ended_because, flight.hovers = why, hovers
            flight.work.cancel()

    async def ended(self) -> None:
        if self._works:
            await asyncio.wait(self._works)


def _left(order: orders.GuidedOrder, found: GuidanceProgress) -> tuple[float | None, float]:
    """Metres and seconds that remain, roughly."""
    climbing = foresight.seconds_climbing(found.height_error_m)
    if isinstance(order, orders.FlyTo):
        straight = foresight.seconds_straight(found.distance_m, order.speed)
        return found.distance_m, max(straight, climbing)
    if isinstance(order, orders.FlyAround):
        turns = max(0.0, found.heading_error_deg) / 360.0
        far = found.distance_m + math.tau * order.radius * turns
        there = max(foresight.seconds_straight(found.distance_m, foresight.APPROACH_M_S), climbing)
        return far, there + foresight.seconds_around(order.radius, order.speed, turns)
    if isinstance(order, orders.ChangeHeight):
        return abs(found.height_error_m), climbing
    return None, foresight.seconds_turning(found.heading_error_deg)


# -- the simple tasks of DJI's node of 2015: what ``/sdk_request_simple_task`` flies ---------------
# ======  ==========================================================================================
# Number  What it does
# ======  ==========================================================================================
# 0       legs of 5 s in angle mode: right, left, back, forward, up, down, clockwise, anticlockwise
# 1       the same legs in velocity mode, starting north
# 2       take-off, landing, take-off, go-home, over and over
# 3       random commands: refused here
# 4       take-off, 28 s of task 0, 40 s of task 1, go-home
# 5       one activation
# 6       one version query
# ======  ==========================================================================================


LEG_TIME = 5.0
"""Seconds of each leg: 250 ticks of the node's 50 Hz timer."""

Send = Callable[[Setpoint], None]


def _legs(mode: int) -> list[Setpoint]:
    """Eight legs in DJI's order; first and second value, climb rate, yaw rate."""
    reach = 2.0 if mode == orders.ANGLE_MODE else 0.5
    moves = [
        (reach, 0.0, 0.0, 0.0),
        (-reach, 0.0, 0.0, 0.0),
        (0.0, reach, 0.0, 0.0),
        (0.0, -reach, 0.0, 0.0),
        (0.0, 0.0, 0.5, 0.0),
        (0.0, 0.0, -0.5, 0.0),
        (0.0, 0.0, 0.0, 90.0),
        (0.0, 0.0, 0.0, -90.0),
    ]
    return [orders.setpoint_of(mode, y, x, yaw, up) for x, y, up, yaw in moves]


async def _fly_legs(control: Control, send: Send, mode: int, seconds: float) -> None:
    legs = _legs(mode)
    async for tick in control.ticks():
        if tick.elapsed >= seconds:
            return
        send(legs[int(tick.elapsed / LEG_TIME) % len(legs)])


async def _commands(control: Control, send: Send) -> None:
    while True:
        await control.take_off()
        await control.land()
        await control.take_off()
        await control.go_home()


async def _everything(control: Control, send: Send) -> None:
    await control.take_off()
    await _fly_legs(control, send, orders.ANGLE_MODE, 28.0)
    await _fly_legs(control, send, orders.VELOCITY_MODE, 40.0)
    await asyncio.sleep(0.5)  # neutral goes out before the autopilot takes over
    await control.go_home()


def pattern(number: int) -> Pattern:
    """The program behind a number. Raises UsageError: there is none, or it is not flown here."""
    if number == 3:
        raise UsageError(
            "task 3 sends random commands every 20 ms, take-off and landing among them",
            cause="it was made to test a protocol, not to fly",
            remedy="use a test rig; see the virtual aircraft's line faults",
        )
    programs: dict[int, Pattern] = {
        0: lambda control, send: _fly_legs(control, send, orders.ANGLE_MODE, math.inf),
        1: lambda control, send: _fly_legs(control, send, orders.VELOCITY_MODE, math.inf),
        2: _commands,
        4: _everything,
    }
    if number not in programs:
        raise UsageError(f"there is no simple task {number}", remedy="tasks are 0 to 6")
    return programs[number]
