"""Closed loops: fly to a place, climb, turn, orbit. Each measures, corrects, and says how it ended.

The autopilot's position mode takes offsets from where the aircraft is, so the loop measures what
remains and sends that anew at each tick (document 3.2, "offset"; DJI's own samples do the same).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from m100link.errors import NotObserved, TelemetryStalled, UsageError
from m100link.flight.guards import GuardKeeper
from m100link.flight.known import known
from m100link.flight.orbit import Orbit
from m100link.flight.pacing import Ticker
from m100link.flight.tasks import describe_situation
from m100link.geodesy import LocalFrame, normalize_degrees
from m100link.protocol.records import Attitude, FlightPhase, FlightStatus, Position, Velocity
from m100link.protocol.setpoint import Setpoint

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["Arrival", "GuidanceProgress", "GuidedFlight"]

_FRESH_S = 0.5
_SETTLED_S = 0.5
_SETTLED_M_S = 0.3
_MAX_OFFSET_M = 10.0  # the autopilot flies larger offsets no faster; a wrong fix must not matter
_MAX_COMMAND_M_S = 10.0  # of velocity setpoints on each axis (document 3.2)


@dataclass(frozen=True, slots=True)
class GuidanceProgress:
    """How far a closed loop is.

    Attributes:
        elapsed: Seconds since it began.
        distance_m: Horizontal distance that remains, m; on an orbit, distance from the circle.
        height_error_m: Height that remains, m, positive when it has to climb.
        heading_error_deg: Turn that remains, °, positive clockwise; on an orbit, angle to go.
    """

    elapsed: float
    distance_m: float
    height_error_m: float
    heading_error_deg: float


@dataclass(frozen=True, slots=True)
class Arrival:
    """How a closed loop ended well (otherwise it raises).

    Attributes:
        elapsed: Seconds that it took.
        distance_m: Horizontal distance from the target at the end, m.
        height_error_m: Height that was missing at the end, m.
        heading_error_deg: Turn that was missing at the end, °.
    """

    elapsed: float
    distance_m: float
    height_error_m: float
    heading_error_deg: float


Progress = Callable[[GuidanceProgress], None]


def _position(state: AircraftState) -> Position:
    position = known(state, Position, within=_FRESH_S)
    if position is None:
        age = state.age(Position)
        raise TelemetryStalled(
            "the position is needed and "
            + (
                "was never received"
                if age is None
                else f"is {age:.1f} s old"
                if age > _FRESH_S
                else f"is impossible: {state.get(Position)}"
            ),
            cause="the position item is not sent, or the line is broken",
            remedy="set the item to 10 Hz or more in the PC assistant",
        )
    return position


def _heading(state: AircraftState) -> float:
    attitude = known(state, Attitude, within=_FRESH_S)
    if attitude is None:
        raise TelemetryStalled(
            "the heading is needed and the attitude item does not arrive, or is impossible",
            remedy="set the item to 10 Hz or more in the PC assistant",
        )
    return attitude.yaw_deg


def _is_on_ground(state: AircraftState) -> bool:
    """Whether the newest status says so; while nobody knows, it does not."""
    status = known(state, FlightStatus)
    return status is not None and status.status == FlightPhase.STANDBY


class _Settling:
    """True once the error stayed within tolerance for a moment, at low speed."""

    def __init__(self, state: AircraftState) -> None:
        self._state = state
        self._since: float | None = None

    def update(self, is_within: bool) -> bool:
        velocity = known(self._state, Velocity, within=_FRESH_S)
        is_slow = velocity is None or (
            velocity.ground_speed_m_s < _SETTLED_M_S and abs(velocity.up_m_s) < _SETTLED_M_S
        )
        if not (is_within and is_slow):
            self._since = None
            return False
        now = asyncio.get_running_loop().time()
        if self._since is None:
            self._since = now
        return now - self._since >= _SETTLED_S


def _target(
    here: Position,
    relative: tuple[float | None, float | None, float | None],
    absolute: tuple[float | None, float | None, float | None],
) -> tuple[float, float, float]:
    """Latitude, longitude and height of the target, from either way of giving it."""
    if None not in relative and absolute == (None, None, None):
        north, east, up = relative
        assert north is not None
        assert east is not None
        assert up is not None
        frame = LocalFrame(here.latitude_deg, here.longitude_deg)
        return (*frame.to_geodetic(north, east), here.height_m + up)
    if None not in absolute and relative == (None, None, None):
        latitude_deg, longitude_deg, height = absolute
        assert latitude_deg is not None
        assert longitude_deg is not None
        assert height is not None
        return latitude_deg, longitude_deg, height
    raise UsageError(
        "the target is given neither as an offset nor as a place",
        remedy="give north, east and up, or latitude_deg, longitude_deg and height",
    )


class GuidedFlight:
    """Flights that measure and correct, over whatever takes setpoints.

    Args:
        state: Telemetry.
        guards: Asked for the target before the first setpoint; each setpoint is checked besides.
        steer: Sends a setpoint until it expires or the next one comes.
        halt: Neutral for a moment, then silence.

    Attributes:
        flying: Name of the loop that is flying, or nothing: two would fight for the aircraft.
    """

    def __init__(
        self,
        state: AircraftState,
        guards: GuardKeeper,
        *,
        steer: Callable[[Setpoint], None],
        halt: Callable[[], Awaitable[None]],
    ) -> None:
        self._state = state
        self._guards = guards
        self._steer = steer
        self._halt = halt
        self.flying = ""
        self._task: asyncio.Task[object] | None = None  # in which it flies
        self._is_interrupted = False

    def require_idle(self, what: str) -> None:
        """Whether something else may steer; a loop whose task is being cancelled does not mind.

        Raises:
            UsageError: A loop is flying.
        """
        if self.flying and not (self._task is not None and self._task.cancelling()):
            raise UsageError(
                f"{what} was sent while a closed loop is flying: {self.flying}; nothing was sent",
                cause="the two would fight for the aircraft",
                remedy="await the loop, cancel its task, or await control.stop()",
            )

    def interrupt(self) -> None:
        """End the loop that is flying: it raises NotObserved at its next tick."""
        self._is_interrupted = True

    def _admit(self, name: str) -> None:
        """Whether a loop may begin.

        Raises:
            UsageError: Another one is flying, or the aircraft stands on the ground.
        """
        if self.flying:
            raise UsageError(
                f"{name} was asked for while another closed loop is flying: {self.flying}",
                remedy="await one before the next, or cancel its task",
            )
        if _is_on_ground(self._state):
            raise UsageError(
                f"{name} was asked for on the ground "
                f"({describe_situation(self._state.situation())})",
                cause="on the ground the aircraft ignores setpoints",
                remedy="take off first: await control.take_off()",
            )

    async def _run(
        self,
        name: str,
        step: Callable[[], tuple[Setpoint, GuidanceProgress]],
        is_within: Callable[[GuidanceProgress], bool],
        timeout: float,
        progress: Progress | None,
    ) -> Arrival:
        """Send what ``step`` computes at each tick until its error settles within tolerance."""
        clock = asyncio.get_running_loop().time
        began_at = clock()
        settling = _Settling(self._state)
        self.flying, self._task, self._is_interrupted = name, asyncio.current_task(), False
        try:
            async for _ in Ticker():
                setpoint, found = step()
                elapsed = clock() - began_at
                found = replace(found, elapsed=elapsed)
                if progress is not None:
                    progress(found)
                if settling.update(is_within(found)):
                    break
                if self._is_interrupted or elapsed > timeout or _is_on_ground(self._state):
                    raise self._not_arrived(name, timeout, found)
                self._steer(setpoint)
        finally:
            self.flying, self._task = "", None
            await self._halt()
        return Arrival(elapsed, found.distance_m, found.height_error_m, found.heading_error_deg)

    def _not_arrived(self, name: str, timeout: float, found: GuidanceProgress) -> NotObserved:
        situation = self._state.situation()
        is_on_ground = _is_on_ground(self._state)
        end, cause = "was stopped", "stop() was called while it flew"
        if is_on_ground:
            end = "ended on the ground"
            cause = "the aircraft landed: by the pilot, a low battery, or a height near 0"
        elif not self._is_interrupted:
            end = f"did not arrive within {timeout:g} s"
            cause = "wind, an envelope of the autopilot, or a mode that it ignores"
        return NotObserved(
            f"{name} {end}; {found.distance_m:.1f} m, {found.height_error_m:+.1f} m of height and "
            f"{found.heading_error_deg:+.0f}° remain ({describe_situation(situation)})",
            situation=situation,
            cause=cause,
        )

    async def fly_to(
        self,
        *,
        north: float | None = None,
        east: float | None = None,
        up: float | None = None,
        latitude_deg: float | None = None,
        longitude_deg: float | None = None,
        height: float | None = None,
        yaw_deg: float | None = None,
        tolerance_m: float = 0.5,
        timeout: float = 120.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly to an offset from here, or to a place, and hover there.

        Args:
            north: With ``east`` and ``up``: metres from where the aircraft is now.
            east: See ``north``.
            up: See ``north``.
            latitude_deg: With ``longitude_deg`` and ``height``: a place, WGS 84.
            longitude_deg: See ``latitude_deg``.
            height: Metres above the take-off point.
            yaw_deg: Heading to fly with; by default the present one.
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
        self._admit("fly_to")
        target = _target(
            _position(self._state), (north, east, up), (latitude_deg, longitude_deg, height)
        )
        latitude, longitude, target_height = target
        if not all(map(math.isfinite, target)) or target_height < 0 or abs(latitude) > 89:
            raise UsageError(
                f"{latitude:g}° {longitude:g}° at height {target_height:g} m cannot be flown to",
                remedy="finite numbers, height 0 m or more, latitude within ±89°",
            )
        self._guards.check_target("fly_to", (latitude, longitude), height=target_height)
        heading = _heading(self._state) if yaw_deg is None else yaw_deg
        there = LocalFrame(latitude, longitude)

        def step() -> tuple[Setpoint, GuidanceProgress]:
            here = _position(self._state)
            from_north, from_east = there.to_local(here.latitude_deg, here.longitude_deg)
            distance = math.hypot(from_north, from_east)
            scale = -min(1.0, _MAX_OFFSET_M / distance) if distance else 0.0
            setpoint = Setpoint.position_offset(
                north=from_north * scale,
                east=from_east * scale,
                height=target_height,
                yaw_deg=heading,
            )
            turn = (
                normalize_degrees(heading - _heading(self._state)) if yaw_deg is not None else 0.0
            )
            return setpoint, GuidanceProgress(0.0, distance, target_height - here.height_m, turn)

        def is_within(found: GuidanceProgress) -> bool:
            return (
                found.distance_m <= tolerance_m
                and abs(found.height_error_m) <= tolerance_m
                and abs(found.heading_error_deg) <= 5.0
            )

        return await self._run("fly_to", step, is_within, timeout, progress)

    async def climb_to(
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
        self._admit("climb_to")
        self._guards.check_target("climb_to", height=height)

        def step() -> tuple[Setpoint, GuidanceProgress]:
            here = _position(self._state)
            setpoint = Setpoint.velocity(north=0.0, east=0.0, height=height, yaw_rate_deg_s=0.0)
            return setpoint, GuidanceProgress(0.0, 0.0, height - here.height_m, 0.0)

        return await self._run(
            "climb_to",
            step,
            lambda found: abs(found.height_error_m) <= tolerance_m,
            timeout,
            progress,
        )

    async def turn_to(
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
        self._admit("turn_to")
        setpoint = Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_deg=yaw_deg)

        def step() -> tuple[Setpoint, GuidanceProgress]:
            turn = normalize_degrees(yaw_deg - _heading(self._state))
            return setpoint, GuidanceProgress(0.0, 0.0, 0.0, turn)

        return await self._run(
            "turn_to",
            step,
            lambda found: abs(found.heading_error_deg) <= tolerance_deg,
            timeout,
            progress,
        )

    async def orbit(
        self,
        *,
        center_north: float,
        center_east: float,
        speed: float = 2.0,
        turns: float = 1.0,
        clockwise: bool = True,
        timeout: float = 300.0,
        progress: Progress | None = None,
    ) -> Arrival:
        """Fly a circle around a point, looking at it.

        The circle goes through where the aircraft is now. It turns to the centre first, then
        accelerates along the circle.

        Args:
            center_north: Metres from here to the centre, north; with ``center_east`` 1 m or more.
            center_east: Metres from here to the centre, east.
            speed: Along the circle, up to 10 m/s; at most 0.7/s times the radius, and v²/r at most
                3.6 m/s², a tilt of 20°.
            turns: How many, more than 0.
            clockwise: Seen from above.
            timeout: Seconds until it gives up, hovering.
            progress: Called at each tick.

        Raises: as :meth:`fly_to`.
        """
        self._admit("orbit")
        envelope = self._guards.guards.envelope
        max_speed = min(_MAX_COMMAND_M_S, envelope.max_speed_m_s if envelope else math.inf)
        orbit = Orbit(
            radius=math.hypot(center_north, center_east),
            speed=speed,
            turns=turns,
            clockwise=clockwise,
            max_speed=max_speed,
        )
        start = _position(self._state)
        here_frame = LocalFrame(start.latitude_deg, start.longitude_deg)
        center = LocalFrame(*here_frame.to_geodetic(center_north, center_east))
        height = start.height_m
        self._guards.check_target(
            "orbit",
            (center.latitude_deg, center.longitude_deg),
            radius=math.hypot(center_north, center_east),
            speed=speed,
        )
        clock = asyncio.get_running_loop().time
        before = clock()

        def step() -> tuple[Setpoint, GuidanceProgress]:
            nonlocal before
            here = _position(self._state)
            velocity = known(self._state, Velocity, within=_FRESH_S)
            attitude = known(self._state, Attitude, within=_FRESH_S)
            now = clock()
            steering = orbit.steer(
                center.to_local(here.latitude_deg, here.longitude_deg),
                None if velocity is None else (velocity.north_m_s, velocity.east_m_s),
                None if attitude is None else attitude.yaw_deg,
                now - before,
            )
            before = now
            setpoint = Setpoint.velocity(
                north=steering.north, east=steering.east, height=height, yaw_deg=steering.yaw_deg
            )
            return setpoint, GuidanceProgress(
                0.0, steering.off_m, height - here.height_m, steering.to_go_deg
            )

        def is_within(found: GuidanceProgress) -> bool:
            return found.heading_error_deg <= 2.0

        return await self._run("orbit", step, is_within, timeout, progress)
