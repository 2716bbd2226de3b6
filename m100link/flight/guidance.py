"""The course of every closed loop: one at a time, measure, steer, settle, report the end."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from m100link.errors import NotObserved, SetpointsIgnored, TelemetryStalled, UsageError
from m100link.flight.guards import known
from m100link.flight.pacing import Ticker
from m100link.flight.tasks import describe_situation, is_on_ground
from m100link.flight.watchdog import apart_m
from m100link.geodesy import normalize_degrees
from m100link.protocol.records import Attitude, Position, Velocity
from m100link.protocol.setpoint import Horizontal, Setpoint
from m100link.telemetry.state import STEER_S

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["Arrival", "GuidanceProgress"]

STOOD_STILL_S = 0.25  # a loop that ticks so late stood still: packages of that time wait for it
# One that flies through its target has not arrived: so long within tolerance, and at most so fast.
_SETTLED_S = 0.5
_SETTLED_M_S = 0.3


@dataclass(frozen=True, slots=True)
class GuidanceProgress:
    """How far a closed loop is."""

    elapsed: float  #: Seconds since it began.
    #: Horizontal distance that remains, m; on an orbit, distance from the circle.
    distance_m: float
    height_error_m: float  #: Height that remains, m, positive when it has to climb.
    heading_error_deg: float  #: Turn that remains, °, positive clockwise; on an orbit, angle to go.


@dataclass(frozen=True, slots=True)
class Arrival:
    """How a closed loop ended well (otherwise it raises)."""

    elapsed: float  #: Seconds that it took.
    distance_m: float  #: Horizontal distance from the target at the end, m.
    height_error_m: float  #: Height that was missing at the end, m.
    heading_error_deg: float  #: Turn that was missing at the end, °.


Progress = Callable[[GuidanceProgress], None]
Call = tuple[str, int]  # of a loop: its name, and the interruptions that there were before it


def position_of(state: AircraftState) -> Position:
    """Where the aircraft is now; ``TelemetryStalled`` where that is unknown, or impossible."""
    position = known(state, Position, within=STEER_S)
    if position is None:
        age = state.age(Position)
        raise TelemetryStalled(
            "the position is needed and "
            + (
                "was never received"
                if age is None
                else f"is {age:.1f} s old"
                if age > STEER_S
                else f"is impossible: {state.get(Position)}"
            ),
            cause="the position item is not sent, or the line is broken",
            remedy="set the item to 10 Hz or more in the PC assistant",
        )
    return position


def heading_of(state: AircraftState) -> float:
    """Where its nose points now, °; ``TelemetryStalled`` where that is unknown, or impossible."""
    attitude = known(state, Attitude, within=STEER_S)
    if attitude is None:
        raise TelemetryStalled(
            "the heading is needed and the attitude item does not arrive, or is impossible",
            remedy="set the item to 10 Hz or more in the PC assistant",
        )
    return attitude.yaw_deg


def require_in_the_air(state: AircraftState, name: str) -> None:
    """Raise ``UsageError`` on the ground, where setpoints mean nothing."""
    if is_on_ground(state):
        raise UsageError(
            f"{name} was asked for on the ground ({describe_situation(state.situation())})",
            cause="on the ground the aircraft ignores setpoints",
            remedy="take off first: await control.take_off()",
        )


class _Settling:
    """True once the error stayed within tolerance for a moment, at low speed."""

    def __init__(self, state: AircraftState) -> None:
        self._state = state
        self._since: float | None = None

    def update(self, is_within: bool) -> bool:
        velocity = known(self._state, Velocity, within=STEER_S)
        # The item may be switched off (PC assistant): the time within tolerance then has to do.
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


_STILL_S = 6.0  # for so long nothing may move while more than this is missing
_ASKED_M, _ASKED_UP_M, _ASKED_DEG = 1.0, 0.5, 6.0
_MOVED_M, _MOVED_UP_M, _MOVED_DEG = 0.5, 0.3, 3.0  # more than sensors wander in that time
_Pose = tuple[Position | None, Attitude | None]


class _Stillness:
    """Notices that the setpoints of a loop bring no movement, however small the demand is."""

    def __init__(self, state: AircraftState) -> None:
        self._state = state
        self._from: _Pose = None, None  # from which any pose is a movement: the first look begins
        self._since = self._looked_at = 0.0
        self._way = 0j  # that velocities have led since, m north and east

    def is_too_long(
        self, now: float, slack: float, setpoint: Setpoint, found: GuidanceProgress
    ) -> bool:
        is_asked = (
            found.distance_m >= _ASKED_M
            or abs(found.height_error_m) >= _ASKED_UP_M
            or abs(found.heading_error_deg) >= _ASKED_DEG
        )
        here = known(self._state, Position), known(self._state, Attitude)
        if not is_asked or _has_moved(self._from, here):
            self._since, self._from, self._way, self._looked_at = now, here, 0j, now
        if setpoint.mode.horizontal is Horizontal.VELOCITY:
            self._way += complex(setpoint.x, setpoint.y) * (now - self._looked_at)
        self._looked_at = now
        # A slow flight needs its time for a metre, and corrections to and fro are no way.
        return now - self._since >= slack + _STILL_S and not 0.0 < abs(self._way) < _ASKED_M


def _has_moved(before: _Pose, after: _Pose) -> bool:
    (place, attitude), (new_place, new_attitude) = before, after
    if place is not None and new_place is not None:
        risen = abs(new_place.height_m - place.height_m)
        if risen >= _MOVED_UP_M or apart_m(place, new_place) >= _MOVED_M:
            return True
    if attitude is None or new_attitude is None:
        return place is None or new_place is None  # nobody knows
    return abs(normalize_degrees(new_attitude.yaw_deg - attitude.yaw_deg)) >= _MOVED_DEG


class Guidance:
    """Runs one closed loop at a time, over whatever takes setpoints."""

    def __init__(
        self,
        state: AircraftState,
        *,
        # Sends a setpoint until it expires or the next one comes.
        steer: Callable[[Setpoint], None],
        hover: Callable[[], Awaitable[None]],  # neutral for a moment, then silence
        # Seconds by which an order shows later than by a cable.
        slack: Callable[[], float] = float,
    ) -> None:
        self._slack = slack
        self._state = state
        self._steer = steer
        self._hover = hover
        # Name of the loop that is flying, or nothing: two would fight for the aircraft.
        self.flying = ""
        self._task: asyncio.Task[object] | None = None  # in which it flies
        self._interruptions = 0
        self.follower: asyncio.Task[object] | None = None  # in which follow() may send

    def require_idle(self, what: str) -> None:
        """Raise ``UsageError`` while a loop is flying, unless its task is being cancelled."""
        if self.flying and not (self._task is not None and self._task.cancelling()):
            raise UsageError(
                f"{what} was sent while a closed loop is flying: {self.flying}; nothing was sent",
                cause="the two would fight for the aircraft",
                remedy="await the loop, cancel its task, or await control.stop()",
            )

    def interrupt(self) -> None:
        """End the loop that is flying, or about to: it raises NotObserved at its next tick."""
        self._interruptions += 1
        if self.follower is not asyncio.current_task():  # its source may fly a task in between
            self.follower = None

    def admit(self, name: str) -> Call:
        """Raise ``UsageError`` while another loop flies, or the aircraft stands on the ground."""
        if self.flying:
            raise UsageError(
                f"{name} was asked for while another closed loop is flying: {self.flying}",
                remedy="await one before the next, or cancel its task",
            )
        require_in_the_air(self._state, name)
        return name, self._interruptions

    async def prepare(self, name: str) -> Call:
        """As :meth:`admit`, after the packages that wait in the line were read."""
        # A program that stood still has an old position, and a new one on its way: the loop waits
        # for it, for as long as one is fresh, and blames the line only then.
        call = self.admit(name)
        if self._has_fresh_position():
            return call
        clock = asyncio.get_running_loop().time
        until = clock() + STEER_S
        async for _ in Ticker():
            if self._has_fresh_position() or clock() >= until:
                break
        # Again: another loop may have begun, or the aircraft have landed, while this one waited.
        self.admit(name)
        return call

    def _has_fresh_position(self) -> bool:
        """Whether no newer one is to be awaited: there is one, or there has never been one."""
        age = self._state.age(Position)
        return age is None or age <= STEER_S

    async def run(
        self,
        call: Call,  # made before the first wait: what ended it meanwhile is not forgotten
        step: Callable[[], tuple[Setpoint, GuidanceProgress]],
        is_within: Callable[[GuidanceProgress], bool],
        timeout: float,
        progress: Progress | None,
    ) -> Arrival:
        """Send what ``step`` computes at each tick until its error settles within tolerance."""
        clock = asyncio.get_running_loop().time
        began_at = ticked_at = reading_until = clock()
        settling, stillness = _Settling(self._state), _Stillness(self._state)
        name, interruptions = call
        self.flying, self._task = name, asyncio.current_task()
        try:
            async for _ in Ticker():
                now = clock()
                # The tick is ahead of the packages that arrived meanwhile: they are read first.
                if now - ticked_at > STOOD_STILL_S:
                    reading_until = now + STEER_S
                ticked_at = now
                try:
                    setpoint, found = step()
                except TelemetryStalled:
                    if now >= reading_until:
                        raise
                    continue  # old telemetry steers nothing
                elapsed = clock() - began_at
                found = replace(found, elapsed=elapsed)
                if progress is not None:
                    progress(found)
                if settling.update(is_within(found)):
                    break
                is_ended = interruptions != self._interruptions
                if is_ended or elapsed > timeout or is_on_ground(self._state):
                    raise self._not_arrived(name, None if is_ended else timeout, found)
                if stillness.is_too_long(now, self._slack(), setpoint, found):
                    left = self._left(found)
                    raise SetpointsIgnored.usual(f"{name}: nothing moves by its setpoints; {left}")
                self._steer(setpoint)
        finally:
            self.flying, self._task = "", None
            await self._hover()
        return Arrival(elapsed, found.distance_m, found.height_error_m, found.heading_error_deg)

    def _not_arrived(self, name: str, limit: float | None, found: GuidanceProgress) -> NotObserved:
        end, cause = "was stopped", "stop() or a task was called while it flew"
        if is_on_ground(self._state):
            end = "ended on the ground"
            cause = "the aircraft landed: by the pilot, a low battery, or a height near 0"
        elif limit is not None:
            end = f"did not arrive within {limit:g} s"
            cause = "wind, an envelope of the autopilot, or a mode that it ignores"
        return NotObserved(
            f"{name} {end}; {self._left(found)}", situation=self._state.situation(), cause=cause
        )

    def _left(self, found: GuidanceProgress) -> str:
        """The rest of the way, for people."""
        situation = describe_situation(self._state.situation())
        return (
            f"{found.distance_m:.1f} m, {found.height_error_m:+z.1f} m of height and "
            f"{found.heading_error_deg:+z.0f}° remain ({situation})"
        )
