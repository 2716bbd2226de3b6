"""The control block without ``await``. Written by ``nox -s sync``: do not edit.

It has the one with ``await`` and hands every call to the thread in which that lives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from m100link.errors import M100Error
from m100link.flight import control as aio
from m100link.flight.guards import Guards
from m100link.flight.guidance import Arrival, Progress
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.hotpoint import CircleHeading, CircleStart, Target
from m100link.flight.missions.waypoint import UploadListener
from m100link.flight.pacing import MAX_RATE_HZ, Tick
from m100link.flight.setpoints import SETPOINT_LIFETIME, Pace
from m100link.flight.tasks import TaskListener
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.control import Task
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Portal
from m100link.sync.signals import SIGNALS
from m100link.sync.steering import FollowFlight, Hold, HotpointFlight, Ticks, WaypointFlight, asked
from m100link.telemetry.state import AircraftState

__all__ = ["Control"]


class Control:
    """Control of the aircraft without ``await``: ``with aircraft.control() as control:``.

    Leaving takes the stop path, after an error, Ctrl-C and SIGTERM too. The reason that would
    cancel a block with ``await`` is raised here by the call that waits, or by the next one.
    """

    def __init__(self, portal: Portal, control: aio.Control, *, handle_signals: bool) -> None:
        self._portal = portal
        self._control = control
        self._handles_signals = handle_signals

    def __repr__(self) -> str:
        return repr(self._control)

    def __enter__(self) -> Self:
        return self.obtain()

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.release()
        except M100Error:
            if exc is None:
                raise

    @property
    def is_flying(self) -> bool:
        """Whether nothing has ended it."""
        return self._control.is_flying

    @property
    def is_over(self) -> bool:
        """Whether its stop path has ended."""
        return self._control.is_over

    def interrupt(self) -> None:
        """Begin the stop path without waiting for its end: for signal handlers, other threads."""
        self._portal.soon(self._control.interrupt)

    def obtain(self) -> Self:
        """Obtain authority without a block: at a prompt, in a notebook, in a service.

        ::

            control = aircraft.control().obtain()
            ...
            control.release()

        The causes that end a block end this too, by the same stop path: lost authority, a lost
        line, stalled telemetry, Ctrl-C, closing the aircraft. There is no block to be cancelled
        then: a call of this object that waits raises the reason at once, otherwise the next call
        does. A program that forgets :meth:`release` keeps the aircraft until it disconnects or
        ends; its setpoints expire all the same, and the aircraft hovers.

        Returns:
            This object.

        Raises: as ``aircraft.control()`` on entering.
        """
        if self._handles_signals:
            SIGNALS.join(self)
        try:
            self._portal.wait(lambda _: self._control.obtain())
        except Exception:
            SIGNALS.leave(self)
            raise
        return self

    def release(self) -> None:
        """Take the stop path and give authority back: what leaving a block does.

        May be called any number of times, and on what was never obtained.

        Raises:
            M100Error: The error that ended it before, unless a call has raised that.
        """
        try:
            self._portal.wait(lambda _: self._control.release())
        finally:
            SIGNALS.leave(self)

    @property
    def is_stopping(self) -> bool:
        """Whether its stop path runs."""
        return self._control.is_stopping

    @property
    def has_guardian(self) -> bool:
        """Whether a process of its own would end the flight if this program could not."""
        return self._control.has_guardian

    @property
    def has_authority(self) -> bool:
        """Whether setpoints are obeyed."""
        return self._control.has_authority

    @property
    def unended_task(self) -> Task | None:
        """The task that the autopilot may be flying: asked for here, and not seen to end.

        It may fly on when the call that awaited it was cancelled; giving authority back ends it.
        """
        return self._control.unended_task

    @property
    def is_paused(self) -> bool:
        """With ``on_pause="wait"``: the pilot took the aircraft and :meth:`resume` is needed."""
        return self._control.is_paused

    @property
    def state(self) -> AircraftState:
        """Telemetry of the aircraft."""
        return self._control.state

    @property
    def guards(self) -> Guards:
        """Which guards are on."""
        return self._control.guards

    @property
    def origin(self) -> tuple[float, float] | None:
        """Latitude and longitude from which the envelope is measured, °; None before good GPS."""
        return self._control.origin

    @property
    def setpoints_sent(self) -> int:
        """Movement frames sent in this block, neutrals included."""
        return self._control.setpoints_sent

    @property
    def setpoints_expired(self) -> int:
        """Setpoints that the program did not renew in time."""
        return self._control.setpoints_expired

    @property
    def pace(self) -> Pace:
        """Whether setpoints go out at the rate that is asked for: ``missed``, ``rate_hz``."""
        return self._control.pace

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
        return self._portal.call(
            self._control.send,
            setpoint,
            lifetime=lifetime,
            rate_hz=rate_hz,
            allow_long_lifetime=allow_long_lifetime,
        )

    def ticks(self, rate_hz: float = MAX_RATE_HZ) -> Ticks:
        """Ticks for a control loop in the caller's own task.

        Raises:
            UsageError: Not within 0 to 50 Hz.
        """
        return Ticks(self._portal, self._portal.call(self._control.ticks, rate_hz))

    def hold(
        self,
        setpoint: Setpoint,
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float = SETPOINT_LIFETIME,
        allow_long_lifetime: bool = False,
    ) -> Hold:
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
        return Hold(
            self._portal,
            self._control.hold(
                setpoint,
                rate_hz=rate_hz,
                lifetime=lifetime,
                allow_long_lifetime=allow_long_lifetime,
            ),
        )

    def follow(
        self,
        source: Callable[[Tick], Setpoint | None],
        *,
        rate_hz: float = MAX_RATE_HZ,
        lifetime: float | None = None,
        allow_long_lifetime: bool = False,
    ) -> None:
        """Send what a source gives until it ends, then the mode's neutral.

        Args:
            source: A callable that gets each :class:`Tick` and returns a setpoint, or None to end.
            rate_hz: Ticks per second for a callable.
            lifetime: Seconds that each setpoint lasts when the next one does not come; by default
                0.2 s, or two ticks where these are longer.
            allow_long_lifetime: Allow more than 1 s, as a rate below 2 Hz needs it.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint, UsageError: See :meth:`send`.
        """
        self._portal.wait(
            lambda caller: self._control.follow(
                asked(caller, source, self._control.ticks(rate_hz)),
                rate_hz=rate_hz,
                lifetime=lifetime,
                allow_long_lifetime=allow_long_lifetime,
            )
        )

    def stop(self) -> None:
        """Send the neutral of the present mode for a moment, then nothing: the aircraft hovers.

        A closed loop that is flying in another task ends with :class:`NotObserved`. A program that
        goes on sending setpoints flies on. It stops a mission that flies, also somebody else's.

        Raises:
            MissionRefused, AckTimeout, NoAuthority: A mission may be flying on.
        """
        return self._portal.wait(lambda _: self._control.stop())

    def wait_resumable(self) -> None:
        """With ``on_pause="wait"``: wait until the pilot has given the aircraft back."""
        return self._portal.wait(lambda _: self._control.wait_resumable())

    def resume(self) -> None:
        """With ``on_pause="wait"``: setpoints may be sent again.

        The pilot's return to F gives authority back without a request, but nothing flies before
        the program says so here.

        Raises:
            NoAuthority: The pilot has not given the aircraft back.
        """
        return self._portal.call(self._control.resume)

    def local_frame(self) -> LocalFrame:
        """Metres north and east of where the aircraft is now, for targets of several flights.

        Legs that are each given from where the aircraft is add up what each one missed its target
        by; targets in one frame do not.

        Raises:
            TelemetryStalled: The position does not arrive.
        """
        return self._portal.call(self._control.local_frame)

    def fly_to(
        self,
        *,
        north: float | None = None,
        east: float | None = None,
        up: float | None = None,
        latitude_deg: float | None = None,
        longitude_deg: float | None = None,
        height: float | None = None,
        frame: LocalFrame | None = None,
        yaw_deg: float | None = None,
        speed: float | None = None,
        tolerance_m: float = 0.5,
        timeout: float = 120.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly to an offset from here, or to a place, and hover there.

        Args:
            north: With ``east``: metres from where the aircraft is now, or in ``frame``.
            east: See ``north``.
            up: Metres from the present height; or ``height``.
            latitude_deg: With ``longitude_deg``, instead of the offset: a place, WGS 84.
            longitude_deg: See ``latitude_deg``.
            height: Metres above the take-off point.
            frame: Where ``north`` and ``east`` count from; see ``Control.local_frame()``.
            yaw_deg: Heading to fly with; by default the present one.
            speed: Horizontally, at most, m/s up to 10; by default as the autopilot flies.
            tolerance_m: Distance and height error that count as arrived.
            timeout: Seconds until it gives up, hovering.
            progress: Called at each tick.

        Raises:
            NotObserved: It did not arrive in time and hovers where it is, or it was stopped or
                landed.
            TelemetryStalled: Position or attitude do not arrive.
            GuardRefused: The target lies outside the envelope, or as :meth:`Control.send`.
            UsageError: The target is none, the aircraft stands on the ground, or another closed
                loop is flying.
            NoAuthority: See :meth:`Control.send`.
        """
        return self._portal.wait(
            lambda caller: self._control.fly_to(
                north=north,
                east=east,
                up=up,
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                height=height,
                frame=frame,
                yaw_deg=yaw_deg,
                speed=speed,
                tolerance_m=tolerance_m,
                timeout=timeout,
                progress=caller.callback(progress),
            )
        )

    def fly_path(
        self,
        points: Sequence[tuple[float, float, float]],
        *,
        speed: float,
        corner_radius: float = 2.0,
        frame: LocalFrame | None = None,
        face_ahead: bool = False,
        yaw_deg: float | None = None,
        tolerance_m: float = 0.5,
        timeout: float | None = None,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly through points without stopping at each, and hover at the last one.

        It begins where the aircraft is, and slows down before corners, steep legs and the end.

        Args:
            points: North and east, m, and height above take-off, m, of each.
            speed: On straight legs, m/s, up to 10.
            corner_radius: Corners of 90° and more are rounded by it, m, shallower ones by more, as
                far from the corner; smaller where a leg is too short. 0: each is flown to.
            frame: Where ``north`` and ``east`` count from; by default where the aircraft is now.
            face_ahead: Look along the path.
            yaw_deg: Otherwise, the heading to fly with; by default the present one.
            tolerance_m: Distance and height error that count as arrived.
            timeout: Seconds until it gives up, hovering; by default 60 and three times what the
                path takes at its speed.
            progress: Called at each tick; the distance is what remains of the path.

        Raises: as :meth:`fly_to`. A point outside the envelope, or one that cannot be flown to, is
        named, and nothing is sent.
        """
        return self._portal.wait(
            lambda caller: self._control.fly_path(
                points,
                speed=speed,
                corner_radius=corner_radius,
                frame=frame,
                face_ahead=face_ahead,
                yaw_deg=yaw_deg,
                tolerance_m=tolerance_m,
                timeout=timeout,
                progress=caller.callback(progress),
            )
        )

    def climb_to(
        self,
        height: float,
        *,
        tolerance_m: float = 0.3,
        timeout: float = 60.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Climb or descend in place to a height above the take-off point, m.

        Raises: as :meth:`fly_to`.
        """
        return self._portal.wait(
            lambda caller: self._control.climb_to(
                height, tolerance_m=tolerance_m, timeout=timeout, progress=caller.callback(progress)
            )
        )

    def turn_to(
        self,
        yaw_deg: float,
        *,
        tolerance_deg: float = 2.0,
        timeout: float = 30.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Turn in place to a heading, −180 to 180°, 0 north, 90 east.

        Raises: as :meth:`fly_to`.
        """
        return self._portal.wait(
            lambda caller: self._control.turn_to(
                yaw_deg,
                tolerance_deg=tolerance_deg,
                timeout=timeout,
                progress=caller.callback(progress),
            )
        )

    def orbit(
        self,
        *,
        center_north: float,
        center_east: float,
        frame: LocalFrame | None = None,
        radius: float | None = None,
        height: float | None = None,
        start_deg: float | None = None,
        speed: float = 2.0,
        turns: float = 1.0,
        clockwise: bool = True,
        timeout: float = 300.0,
        progress: Progress | None = None,
        approach: Progress | None = None,
    ) -> Arrival:
        """Fly a circle around a point, looking at it.

        By default the circle goes through where the aircraft is now; otherwise it flies to where
        the circle begins. It turns to the centre first, then accelerates along the circle.

        Args:
            center_north: Metres to the centre, north, from here or in ``frame``.
            center_east: Metres to the centre, east, from here or in ``frame``.
            frame: Where the centre counts from; see ``Control.local_frame()``.
            radius: Of the circle, m, 1 or more; by default the present distance from the centre.
            height: Above the take-off point, m; by default the present one.
            start_deg: Where the circle begins, seen from the centre, ° clockwise from north; by
                default in the present direction.
            speed: Along the circle, up to 10 m/s; at most 0.7/s times the radius, and v²/r at most
                3.6 m/s², a tilt of 20°.
            turns: How many, more than 0.
            clockwise: Seen from above.
            timeout: Seconds until it gives up, hovering; for the flight to its beginning as well.
            progress: Called at each tick on the circle.
            approach: Called at each tick on the way to it, with what remains of that.

        Raises: as :meth:`fly_to`.
        """
        return self._portal.wait(
            lambda caller: self._control.orbit(
                center_north=center_north,
                center_east=center_east,
                frame=frame,
                radius=radius,
                height=height,
                start_deg=start_deg,
                speed=speed,
                turns=turns,
                clockwise=clockwise,
                timeout=timeout,
                progress=caller.callback(progress),
                approach=approach,
            )
        )

    def waypoint_mission(
        self,
        plan: WaypointPlan,
        *,
        take_off: bool = False,
        allow_far: bool = False,
        progress: UploadListener | None = None,
    ) -> WaypointFlight:
        """Let the aircraft fly a plan of waypoints by itself, for the time of a block.

        ::

            with control.waypoint_mission(plan) as mission:
                for event in mission:
                    print(event)

        Entering asks the guards about the whole plan, uploads it and starts it. While it flies,
        everything else that moves the aircraft raises :class:`MissionRunning`. Leaving stops it if
        it still flies, and the aircraft hovers. **It flies on when this program is killed, loses
        its power or its cable**: only the pilot, its own end or a stop ends it.

        Args:
            plan: The waypoints.
            take_off: Take off first when the aircraft stands on the ground, once the plan is
                uploaded. Without it a mission on the ground is refused.
            allow_far: Let the first waypoint be more than 500 m away.
            progress: Called for each waypoint that the aircraft has taken.

        Raises:
            GuardRefused: The plan leaves the envelope, begins too far away, or battery or GPS do
                not allow it: nothing was sent. Or a guard ended it, and the control block, in
                flight.
            CommandNotSupported: Firmware before 3.1; nothing was sent.
            MissionRefused: The aircraft's reason, with the waypoint; nothing flies.
            MissionRunning, NoAuthority, UsageError, TelemetryStalled: Another mission flies; no
                authority; on the ground; the flight status is unknown.
            AckTimeout, LinkError: See each class. A start that may have been heard is stopped.
            MissionAborted: While it flew the aircraft broke it off, with its reason.
        """
        return WaypointFlight(
            self._portal,
            lambda caller: self._control.waypoint_mission(
                plan, take_off=take_off, allow_far=allow_far, progress=caller.callback(progress)
            ),
        )

    def hotpoint(
        self,
        *,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        radius: float,
        rate_deg_s: float,
        clockwise: bool = True,
        start: CircleStart = CircleStart.NEAREST,
        heading: CircleHeading = CircleHeading.TO_CENTRE,
        allow_far: bool = False,
    ) -> HotpointFlight:
        """Let the aircraft circle around a place by itself: an orbit, DJI's hotpoint.

        ::

            with control.hotpoint(
                latitude_deg=52.1, longitude_deg=4.31, height=20, radius=30, rate_deg_s=10
            ) as circle:
                time.sleep(30)
                circle.set_radius(40)

        It flies to the circle at that height and then along it until it is stopped; leaving the
        block does that. **It flies on when this program is killed.** While it flies, everything
        else that moves the aircraft raises :class:`MissionRunning`.

        Args:
            latitude_deg: Of the centre, WGS 84.
            longitude_deg: Of the centre, WGS 84.
            height: 5 to 500 m **above the take-off point**, and not above the sea, which
                ``aircraft.state`` tells as well.
            radius: 5 to 500 m.
            rate_deg_s: 0 to 30 °/s, and no more than 10 m/s along the circle: 573 divided by the
                radius.
            clockwise: Direction, seen from above.
            start: Where the circle is entered.
            heading: Where the nose points.
            allow_far: Let the centre be more than 500 m away.

        Raises:
            UsageError: A value out of range, or too fast for the radius; on the ground.
            GuardRefused, CommandNotSupported, MissionRefused, MissionRunning, NoAuthority,
            TelemetryStalled, AckTimeout, MissionAborted: See :meth:`waypoint_mission`.
        """
        return HotpointFlight(
            self._portal,
            lambda _: self._control.hotpoint(
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                height=height,
                radius=radius,
                rate_deg_s=rate_deg_s,
                clockwise=clockwise,
                start=start,
                heading=heading,
                allow_far=allow_far,
            ),
        )

    def follow_target(
        self, source: Target, *, face_target: bool = True, allow_far: bool = False
    ) -> FollowFlight:
        """Let the aircraft follow a target by itself, at the distance that it has at the beginning.

        ::

            with control.follow_target(first) as mission:
                for event in mission:
                    print(event)

        It is stopped when the block is left; the aircraft hovers. When
        nothing new comes for 6 s, the aircraft waits where it is. ``Control.follow`` is another
        thing: it sends setpoints.

        Args:
            source: The first one, to be renewed by :meth:`m100link.FollowFlight.set_target`.
            face_target: The nose points to the target; otherwise the pilot's stick turns it.
            allow_far: Let the first target be more than 500 m away.

        Raises:
            UsageError: Below 5 m; the source is empty, a target is not a place, or jumps by more
                than 200 m.
            GuardRefused, CommandNotSupported, MissionRefused, MissionRunning, NoAuthority,
            TelemetryStalled, AckTimeout, MissionAborted: See :meth:`waypoint_mission`.
        """
        return FollowFlight(
            self._portal,
            lambda _: self._control.follow_target(
                source, face_target=face_target, allow_far=allow_far
            ),
        )

    def stop_mission(self) -> MissionKind:
        """Stop any mission that flies, also somebody else's: the aircraft hovers.

        :attr:`m100link.Aircraft.mission` shows a mission of a phone, or of a program that is gone.
        Where the aircraft pushes nothing, it gets a stop for every kind.

        Returns:
            The kind that was stopped; :attr:`MissionKind.NONE` when the aircraft knows of none.

        Raises:
            MissionRefused: With the aircraft's reason.
            NoAuthority, AckTimeout, LinkError: See each class.
        """
        return self._portal.wait(lambda _: self._control.stop_mission())

    def pause_mission(self) -> MissionKind:
        """Pause any mission that flies, also somebody else's. Raises as :meth:`stop_mission`."""
        return self._portal.wait(lambda _: self._control.pause_mission())

    def resume_mission(self) -> MissionKind:
        """Let it go on. Raises as :meth:`stop_mission`."""
        return self._portal.wait(lambda _: self._control.resume_mission())

    def detach_mission(self) -> MissionKind:
        """Leave whatever mission flies in flight when this control block ends.

        Authority is not given back then: that would break it off. See
        :meth:`m100link.MissionFlight.detach`.

        Raises:
            UsageError: No mission flies, as far as the aircraft tells.
        """
        return self._portal.call(self._control.detach_mission)

    def arm(self) -> None:
        """Start the motors on the ground; they idle, and the aircraft stays where it is.

        Only for programs that take off by setpoints of their own: a setpoint with thrust, height or
        a climb rate lifts it from there. ``take_off()`` starts the motors itself, and **fails while
        they run** (seen on an M100). With nothing commanded they stop by themselves after about
        20 s; when the block ends on the ground they are stopped. Firmware 3.1.

        Raises:
            NoAuthority: Authority is not held.
            GuardRefused: As for a take-off.
            TaskRefused: With the code; or another task, or a closed loop, is under way.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they run.
        """
        return self._portal.wait(lambda _: self._control.arm())

    def disarm(self) -> None:
        """Stop the motors on the ground; landing stops them by itself.

        **In the air nothing is sent**: the aircraft would refuse it, and this does not
        rely on that.

        Raises:
            NoAuthority: Authority is not held.
            TaskRefused: It is in the air (code 3), or another task is under way.
            TelemetryStalled: Nobody knows whether it is on the ground; nothing was sent.
            CommandNotSupported: The firmware is older; nothing was sent.
            AckTimeout: Nobody knows whether they stand.
        """
        return self._portal.wait(lambda _: self._control.disarm())

    def take_off(
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
        return self._portal.wait(
            lambda caller: self._control.take_off(
                timeout=timeout, progress=caller.callback(progress)
            )
        )

    def land(self, *, timeout: float | None = None, progress: TaskListener | None = None) -> None:
        """Land in place and stop the motors; 60 s. See :meth:`take_off` for the errors.

        Refused while a mission flies, unless this block ordered it to stop in vain: a landing
        breaks it off as well.
        """
        return self._portal.wait(
            lambda caller: self._control.land(timeout=timeout, progress=caller.callback(progress))
        )

    def go_home(
        self, *, timeout: float | None = None, progress: TaskListener | None = None
    ) -> None:
        """Fly to the home point and land; 300 s. See :meth:`take_off` for the errors."""
        return self._portal.wait(
            lambda caller: self._control.go_home(
                timeout=timeout, progress=caller.callback(progress)
            )
        )
