"""Flying: authority while a block runs, setpoints that expire, one way to stop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, nullcontext
from functools import partial, update_wrapper
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from m100link.errors import NoAuthority, TaskFailed, TaskRefused, UsageError
from m100link.flight.authority import AuthorityState
from m100link.flight.block import ControlBlock, PauseAction, SetpointSender
from m100link.flight.guardian import patience_of
from m100link.flight.guards import GuardKeeper, Guards
from m100link.flight.guidance import Guidance
from m100link.flight.lifecycle import BlockClaim, BlockState, StopCause
from m100link.flight.loops import ClosedLoops
from m100link.flight.missions.context import MissionContext, require_off_ground
from m100link.flight.missions.mission_guard import MissionGuard
from m100link.flight.missions.missions import Missions
from m100link.flight.pacing import MAX_RATE_HZ, Tick, Ticker, period_of
from m100link.flight.setpoints import SETPOINT_LIFETIME, Hold, Pace
from m100link.flight.stop_path import StopAction
from m100link.flight.tasks import Commander, Motors, TaskListener, run_task, task_name
from m100link.geodesy import LocalFrame
from m100link.protocol.commands.control import Move, Task
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.state import AircraftState

__all__ = ["Control", "Hold"]

SetpointSource = Callable[[Tick], Setpoint | None] | AsyncIterable[Setpoint]
"""Feeds :meth:`Control.follow`: called at each tick until it returns None, or iterated."""


P = ParamSpec("P")
R = TypeVar("R")


def _of_part(
    part: str, method: Callable[Concatenate[Any, P], Coroutine[Any, Any, R]]
) -> Callable[Concatenate[Control, P], Coroutine[Any, Any, R]]:
    """Make a method of a part one of Control, with the arguments and docstring of the part."""

    async def call(self: Control, /, *args: P.args, **kwargs: P.kwargs) -> R:
        self._block.require_flying(method.__name__)  # what ended the block comes first
        self._mission_guard.require_none(method.__name__)
        return await method(getattr(self, part), *args, **kwargs)

    return update_wrapper(call, method)


def _mission(method: Callable[Concatenate[Missions, P], R]) -> Callable[Concatenate[Control, P], R]:
    """Make a method of :class:`Missions` one of Control."""

    def call(self: Control, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return method(self._missions, *args, **kwargs)

    return update_wrapper(call, method)


class Control:
    """Control of the aircraft while an ``async with aircraft.control()`` block runs.

    Entering obtains authority. Leaving, in whatever way and by whatever task, takes one path: the
    mode's neutral, hover or land as chosen, release; shielded from cancellation and bounded in
    time. When authority, the link or telemetry is lost, that path begins at once, the block is
    cancelled and the plain reason raised.

    While a closed loop flies (``fly_to``, ``fly_path``, ``climb_to``, ``turn_to``, ``orbit``),
    nothing else steers.
    """

    def __init__(
        self,
        commander: Commander,
        claim: BlockClaim,
        *,
        stop: StopAction = "hover",
        on_pause: PauseAction = "raise",
        guards: Guards | None = None,
        handle_signals: bool = True,
        guardian: bool | float = True,
    ) -> None:
        if stop not in ("hover", "land"):
            raise UsageError(f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'")
        if on_pause not in ("raise", "wait"):
            raise UsageError(f"on_pause cannot be {on_pause!r}", remedy="use 'raise' or 'wait'")
        self._commander = commander
        self._requests = commander.requests
        self._authority = commander.authority
        self._guards = GuardKeeper(
            guards or Guards(), commander.state, latency=commander.link.latency
        )
        mission_guard = MissionGuard(commander)
        self._steering = SetpointSender(commander, self._guards, mission_guard)
        self._setpoints = self._steering.setpoints
        self._block = self._steering.block = ControlBlock(
            commander,
            claim,
            self._setpoints,
            mission_guard,
            self._guards,
            stop=stop,
            on_pause=on_pause,
            handle_signals=handle_signals,
            patience_s=patience_of(guardian),
        )
        self._guidance = Guidance(
            commander.state,
            steer=self._steering.steer,
            hover=self._setpoints.hover,
            slack=lambda: commander.link.latency.slack_s,
        )
        self._loops = ClosedLoops(commander.state, self._guards, self._guidance)
        self._motors = Motors(commander, self._guards, self._make_way, self._block.armed)
        self._mission_guard = mission_guard
        context = MissionContext(commander, self._guards, self._block, self._make_way_for_mission)
        self._missions = Missions(context, mission_guard, self.take_off)
        self._unended_task: Task | None = None

    # -- the block -------------------------------------------------------------------------------

    def __repr__(self) -> str:
        state, authority = self._block.state.name.lower(), self._authority.state.value
        return f"<Control {state}, authority {authority}, {self.setpoints_sent} setpoints sent>"

    async def __aenter__(self) -> Self:
        await self._block.enter()
        return self

    async def __aexit__(self, kind: object, exc: BaseException | None, traceback: object) -> bool:
        return await self._block.leave(exc)

    async def obtain(self) -> Self:
        """Obtain authority without a block: at a prompt, in a notebook, in a service.

        ::

            control = await aircraft.control().obtain()
            ...
            await control.release()

        The causes that end a block end this too, by the same stop path: lost authority, a lost
        line, stalled telemetry, Ctrl-C, closing the aircraft. There is no block to be cancelled
        then: a call of this object that waits raises the reason at once, otherwise the next call
        does. A program that forgets :meth:`release` keeps the aircraft until it disconnects or
        ends; its setpoints expire all the same, and the aircraft hovers.

        Returns:
            This object.

        Raises: as ``aircraft.control()`` on entering.
        """
        await self._block.obtain()
        return self

    async def release(self) -> None:
        """Take the stop path and give authority back: what leaving a block does.

        May be called any number of times, and on what was never obtained.

        Raises:
            M100Error: The error that ended it before, unless a call has raised that.
        """
        await self._block.release()

    @property
    def is_flying(self) -> bool:
        """Whether control was asked for, and nothing has ended it."""
        return self._block.is_flying

    @property
    def is_stopping(self) -> bool:
        """Whether its stop path runs."""
        return self._block.state is BlockState.STOPPING

    @property
    def is_over(self) -> bool:
        """Whether the stop path has ended."""
        return self._block.state is BlockState.OVER

    @property
    def has_guardian(self) -> bool:
        """Whether a process of its own would end the flight if this program could not."""
        return self._block.guardian.is_watching

    def interrupt(self) -> None:
        """Begin the stop path and do not wait for its end: what a signal does."""
        self._commander.link.require_loop()
        self._block.end(StopCause.SIGNALLED)

    # -- setpoints -------------------------------------------------------------------------------

    @property
    def has_authority(self) -> bool:
        """Whether setpoints are obeyed."""
        return self._authority.state is AuthorityState.HELD

    @property
    def unended_task(self) -> Task | None:
        """The task that the autopilot may be flying: asked for here, and not seen to end.

        It may fly on when the call that awaited it was cancelled; giving authority back ends it.
        """
        return self._unended_task

    @property
    def is_paused(self) -> bool:
        """With ``on_pause="wait"``: the pilot took the aircraft and :meth:`resume` is needed."""
        return self._block.state is BlockState.PAUSED

    @property
    def state(self) -> AircraftState:
        """Telemetry of the aircraft."""
        return self._commander.state

    @property
    def guards(self) -> Guards:
        """Which guards are on."""
        return self._guards.guards

    @property
    def origin(self) -> tuple[float, float] | None:
        """Latitude and longitude from which the envelope is measured, °; None before good GPS."""
        return self._guards.origin

    @property
    def setpoint(self) -> Setpoint | None:
        """The setpoint that is being sent; its neutral after it expired, None in silence."""
        return self._setpoints.current

    @property
    def setpoints_sent(self) -> int:
        """Movement frames sent in this block, neutrals included."""
        return self._setpoints.sent

    @property
    def setpoints_expired(self) -> int:
        """Setpoints that the program did not renew in time."""
        return self._setpoints.expired

    @property
    def pace(self) -> Pace:
        """Whether setpoints go out at the rate that is asked for: ``missed``, ``rate_hz``."""
        return self._setpoints.pace

    def send(
        self,
        setpoint: Setpoint,
        *,
        lifetime: float = SETPOINT_LIFETIME,
        rate_hz: float = MAX_RATE_HZ,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send a setpoint now, and repeat it until it is renewed or expires.

        Args:
            setpoint: The setpoint to fly.
            lifetime: Seconds after which it is not repeated any more; then the mode's neutral is
                sent for 0.3 s, then nothing. At most 1 s, unless ``allow_long_lifetime``.
            rate_hz: Repetitions per second, at most 50; another setpoint and the neutral do not
                wait for it.
            allow_long_lifetime: Allow more than 1 s: a program that hangs flies on for that long.

        The guards are asked before each frame. One that refuses later replaces the setpoint by its
        neutral; the next call raises the refusal.

        Raises:
            NoAuthority: Authority is not held, is paused, or a task is flying the aircraft.
            GuardRefused: A guard said no; nothing was sent.
            UsageError: The lifetime does not end, or is longer than allowed; or a closed loop is
                flying.
            BadSetpoint: The firmware cannot express it.
        """
        if self._guidance.flying:
            self._block.require_flying("a setpoint")  # what ended the block comes first
            self._guidance.require_idle("a setpoint")
        self._steering.steer(setpoint, lifetime, rate_hz, is_long_allowed=allow_long_lifetime)

    def send_raw_move_as_expert(self, move: Move) -> bool:
        """Send one raw movement command, unchecked and unrepeated. For experts.

        No range, no guard and no lifetime protects anybody here; only authority is required.

        Returns:
            False when the line does not drain.

        Raises:
            NoAuthority: Authority is not held.
            UsageError: A closed loop is flying.
        """
        self._block.require_flying("a raw movement command")
        self._guidance.require_idle("a raw movement command")
        self._mission_guard.require_none("a raw movement command")
        return self._requests.push(move)

    def ticks(self, rate_hz: float = MAX_RATE_HZ) -> Ticker:
        """Ticks for a control loop in the caller's own task.

        Raises:
            UsageError: Not within 0 to 50 Hz.
        """
        return Ticker(rate_hz)

    @asynccontextmanager
    async def hold(
        self,
        setpoint: Setpoint,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float = SETPOINT_LIFETIME,
        allow_long_lifetime: bool = False,
    ) -> AsyncIterator[Hold]:
        """A task keeps sending a setpoint while the block runs and renews it by :meth:`Hold.set`.

        A block that only waits does not hold it: what is not renewed for ``lifetime`` seconds is
        followed by the mode's neutral, and the aircraft hovers. The neutral is sent on the way out.

        Args:
            setpoint: The first setpoint.
            rate_hz: Repetitions per second, at most 50.
            lifetime: Seconds that each setpoint lasts when it is not renewed.
            allow_long_lifetime: Allow more than 1 s.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
            GuardRefused: On the way out, when a guard ended the setpoint that was held last.
        """
        send = partial(self.send, lifetime=lifetime, rate_hz=rate_hz)
        hold = Hold(partial(send, allow_long_lifetime=allow_long_lifetime))
        hold.set(setpoint)
        with self._steering.ends_neutral():
            yield hold

    async def follow(
        self,
        source: SetpointSource,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float | None = None,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send what a source gives until it ends, then the mode's neutral.

        It ends by :meth:`stop`, by another one, and by a take-off, a landing, a go-home, motors or
        a mission that another task of the program asks for, also where that is refused.

        Args:
            source: A callable that gets each :class:`Tick` and returns a setpoint, or None to end;
                or an async iterable of setpoints, which sets its own pace.
            rate_hz: Ticks per second for a callable.
            lifetime: Seconds that each setpoint lasts when the next one does not come; by default
                0.2 s, or two ticks where these are longer.
            allow_long_lifetime: Allow more than 1 s, as a rate below 2 Hz needs it.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        if lifetime is None:
            # Two ticks: one that is a little late must not let the setpoint before it expire.
            lifetime = max(SETPOINT_LIFETIME, 2 * period_of(rate_hz))
        me = self._guidance.follower = asyncio.current_task()

        def send(setpoint: Setpoint) -> None:
            if self._guidance.follower is not me:
                self._block.require_flying("a setpoint")  # what ended the block comes first
                raise NoAuthority("follow() was ended: something else was asked for meanwhile")
            self.send(setpoint, lifetime=lifetime, allow_long_lifetime=allow_long_lifetime)

        with self._steering.ends_neutral():
            if isinstance(source, AsyncIterable):
                async for setpoint in source:
                    send(setpoint)
                return
            async for tick in self.ticks(rate_hz):
                if (wanted := source(tick)) is None:
                    return
                send(wanted)

    async def stop(self) -> None:
        """Send the neutral of the present mode for a moment, then nothing: the aircraft hovers.

        In another task a closed loop ends with :class:`NotObserved`, and :meth:`follow` with
        ``NoAuthority``. A program that goes on sending setpoints flies on. It stops a mission that
        flies, also somebody else's, and one that is being prepared does not begin.

        Raises:
            MissionRefused, AckTimeout, NoAuthority: A mission may be flying on.
        """
        self._commander.link.require_loop()
        # First: a loop that flies would send its next setpoint 20 ms behind the neutral.
        self._guidance.interrupt()
        self._mission_guard.call_off()
        if self.is_flying and self._mission_guard.flying:
            await self._missions.stop_mission()
        await self._setpoints.hover()

    async def wait_resumable(self) -> None:
        """With ``on_pause="wait"``: wait until the pilot has given the aircraft back."""
        self._commander.link.require_loop()
        with self._block.waiting("wait_resumable"):
            await self._authority.wait_for(AuthorityState.HELD)

    def resume(self) -> None:
        """With ``on_pause="wait"``: setpoints may be sent again.

        The pilot's return to F gives authority back without a request, but nothing flies before
        the program says so here.

        Raises:
            NoAuthority: The pilot has not given the aircraft back.
        """
        self._block.resume()

    # -- closed loops ----------------------------------------------------------------------------

    def local_frame(self) -> LocalFrame:
        """Metres north and east of where the aircraft is now, for targets of several flights.

        Legs that are each given from where the aircraft is add up what each one missed its target
        by; targets in one frame do not.

        Raises:
            TelemetryStalled: The position does not arrive.
        """
        return self._loops.local_frame()

    fly_to = _of_part("_loops", ClosedLoops.fly_to)
    fly_path = _of_part("_loops", ClosedLoops.fly_path)
    climb_to = _of_part("_loops", ClosedLoops.climb_to)
    turn_to = _of_part("_loops", ClosedLoops.turn_to)
    orbit = _of_part("_loops", ClosedLoops.orbit)

    # -- missions: the aircraft flies by itself --------------------------------------------------

    waypoint_mission = _mission(Missions.waypoint_mission)
    hotpoint = _mission(Missions.hotpoint)
    follow_target = _mission(Missions.follow_target)
    stop_mission = _mission(Missions.stop_mission)
    pause_mission = _mission(Missions.pause_mission)
    resume_mission = _mission(Missions.resume_mission)
    detach_mission = _mission(Missions.detach_mission)

    async def _make_way_for_mission(self, what: str) -> None:
        """Nothing else steers any more: a mission is about to start."""
        self._guidance.require_idle(what)
        # Before the start: the aircraft ignores a neutral once the mission flies.
        await self._setpoints.hover()
        self._make_way(what)
        require_off_ground(self.state, what)  # again: the plan, or a source, took its time

    # -- motors and tasks ------------------------------------------------------------------------

    arm = _of_part("_motors", Motors.arm)
    disarm = _of_part("_motors", Motors.disarm)

    async def take_off(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Start the motors and climb to about 1.2 m.

        Done when the aircraft reports success, or telemetry shows it in the air at 1 m or more;
        the ack alone proves nothing.

        Args:
            timeout: Seconds to wait after the aircraft accepted; 20 by default.
            progress: Called about four times a second.

        Raises:
            NoAuthority: Authority is not held.
            GuardRefused: Battery below its floor; battery or position did not come within 1.5 s.
            TaskRefused, TaskFailed: With the situation that explains it.
            NotObserved: Neither success nor failure showed in time.
            AckTimeout: Nobody knows whether it began.
        """
        self._block.require_flying(what := task_name(Task.TAKE_OFF))
        self._mission_guard.require_none(what)
        await self._guards.admit_take_off()
        await self._run(Task.TAKE_OFF, timeout, progress)

    async def land(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Land in place and stop the motors; 60 s. See :meth:`take_off` for the errors.

        Refused while a mission flies, unless this block ordered it to stop in vain: a landing
        breaks it off as well.
        """
        await self._run(Task.LAND, timeout, progress)

    async def go_home(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Fly to the home point and land; 300 s. See :meth:`take_off` for the errors."""
        await self._run(Task.GO_HOME, timeout, progress)

    async def _run(self, task: Task, timeout: float | None, progress: TaskListener | None) -> None:
        self._make_way(what := task_name(task), is_landing=task is not Task.TAKE_OFF)
        before, self._unended_task = self._unended_task, task
        self._steering.running_task = task
        # From the order on it counts as flown: stop="land" and the guardian land what may climb.
        watch = self._block.taking_off() if task is Task.TAKE_OFF else nullcontext()
        try:
            with watch, self._block.waiting(what):
                await run_task(self._commander, task, timeout=timeout, progress=progress)
            self._unended_task = None
        except (TaskFailed, TaskRefused) as error:  # refused: an earlier task still runs, perhaps
            self._unended_task = before if isinstance(error, TaskRefused) else None
            raise
        finally:
            self._steering.running_task = None

    def _make_way(self, what: str, *, is_landing: bool = False) -> None:
        """Setpoints end, for what the autopilot does by itself; one thing at a time."""
        # Asked again: it may have waited 1.5 s for its guards, and the block have ended.
        self._block.require_flying(what)
        if is_landing:  # also where it is refused, as during the take-off of that mission
            self._mission_guard.call_off()
        self._mission_guard.require_none(what, is_landing=is_landing)
        if (running := self._steering.running_task) is not None:
            raise TaskRefused(
                f"{what} was asked for during {task_name(running)}",
                remedy="await one task before the next",
            )
        self._guidance.interrupt()  # a loop ends also where the order is refused at once
        # Not silence: the aircraft may refuse the order, and fly on by what it heard last.
        self._setpoints.neutralise()
