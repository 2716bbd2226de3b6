"""Ends control when telemetry stops, cannot be true, or shows that setpoints are ignored."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from m100link.errors import (
    ComputerSuspended,
    M100Error,
    NavigationLost,
    SetpointsIgnored,
    TelemetryStalled,
)
from m100link.flight.guards import Guards, SuspendWatch, known, over_ground
from m100link.flight.lifecycle import StopCause
from m100link.geodesy import normalize_degrees
from m100link.link import Latency
from m100link.protocol.records import Attitude, FlightPhase, FlightStatus, Position, Velocity
from m100link.protocol.setpoint import Horizontal, ReferenceFrame, Setpoint, Vertical, Yaw
from m100link.telemetry.state import STEER_S, AircraftState

# -- whether the aircraft follows setpoints: the wire to it may be broken, and all else work -------


FOLLOW_S = 1.2
"""Seconds in which something has to follow. The recorded flights of a Matrice 100 in
caomuqing/mav_system_identification-DJI_M100_sysID show a tilt 0.24 s after it was asked for; the
failsafes of ArduPilot act after one second (ekf_check: ten in a row at 10 Hz)."""

_LEAST_M_S = 1.0  # slower setpoints drown in gusts
_LEAST_CLIMB_M_S = 0.5
_LEAST_TURN_DEG = 20.0
_LEAST_TURN_DEG_S = 10.0
_LEAST_TILT_DEG = 5.0
_LEAST_OFFSET_M = 3.0
_OFFSET_M_S = 1.5  # an autopilot flies a larger offset at least as fast
_OFFSET_UP_M_S = 1.0  # and one of height
_FAST_OFFSET_M_S = 5.0  # and at most as fast as that
_FOLLOWS = 0.25  # the share of a demand that counts as followed: the rest is wind
_BEGINS = 0.25  # and the share of the missing rest that shows that it is on its way
_TURNED_DEG = 3.0
_TILTED_DEG = 3.0
_LEANS_DEG = 8.0  # a tilt towards it that says that wind, and not a wire, is in the way
_LANDS_BELOW_M = 3.0  # near the ground an autopilot descends as it likes
_STILL_M = 0.5
_NOWHERE = 0.0, 0.0
_UNSEEN_M = 10.0  # without a velocity, how far it may fly and not be seen to move,
_UNSEEN_S = 2.5  # for so long: an aircraft that turns round is within half a metre for 1.6 s


class _Deadline:
    """Something is asked for, and has to grow by so much within :data:`FOLLOW_S`.

    ``slack``: seconds that a slow line adds.
    """

    def __init__(self, slack: Callable[[], float]) -> None:
        self._slack = slack
        self._since: float | None = None
        self._from = 0.0
        self._asked = _NOWHERE

    def is_over(
        self, now: float, seen: float | None, needed: float, asked: tuple[float, float]
    ) -> bool:
        """Whether it did not; ``seen`` is how much there is, None while it need not grow.

        ``asked`` is the direction.
        """
        if seen is None:
            self._since = None
            return False
        # Asked to go back, it has that time anew: no aircraft follows a direction that changes
        # faster than it can tilt, and a tracker that hunts around its target asks for that.
        goes_back = asked[0] * self._asked[0] + asked[1] * self._asked[1] <= 0.0
        if self._since is None or goes_back or seen - self._from >= needed:
            self._since, self._from, self._asked = now, seen, asked
        self._from = min(self._from, seen)
        return now - self._since >= FOLLOW_S + self._slack()


class FollowCheck:
    """Compares setpoints with what telemetry shows of them.

    A contradiction is a demand that the aircraft does not even begin to follow. An aircraft that is
    slow, leans into the wind, or is held back by the wind follows all the same.
    """

    def __init__(
        self,
        state: AircraftState,
        setpoint: Callable[[], Setpoint | None],  # the one that is being sent; None: none
        clock: Callable[[], float],  # seconds
        # Seconds by which an order shows later than by a cable.
        slack: Callable[[], float] = float,
    ) -> None:
        self._state = state
        self._slack = slack
        self._setpoint = setpoint
        self._clock = clock
        self._looked_at = clock()
        self._asked: Setpoint | None = None
        self._begin()

    def _begin(self) -> None:
        self._way, self._climb, self._turn, self._tilt = (_Deadline(self._slack) for _ in range(4))
        self._lean: tuple[float, float] | None = None  # north and east, °, when the way began
        self._heading: float | None = None  # when the turn began
        self._rightward = 0.0  # which turn is asked for
        self._place: Position | None = None
        self._unseen, self._unseen_s = 0j, 0.0  # north and east, m, and for how long

    def look(self) -> str:
        """A demand that is not followed, with figures, or nothing; to be asked at 5 to 10 Hz."""
        now = self._clock()
        passed, self._looked_at = now - self._looked_at, now
        setpoint = self._setpoint()
        status = known(self._state, FlightStatus)
        if setpoint is None or status is None or status.status != FlightPhase.IN_AIR:
            if self._asked is not None:
                self._asked = None
                self._begin()
            return ""
        self._asked = setpoint
        velocity = known(self._state, Velocity, within=STEER_S)
        return (
            self._look_at_way(now, passed, setpoint, velocity)
            or self._look_at_climb(now, setpoint, velocity)
            or self._look_at_turn(now, setpoint)
        )

    def _attitude(self) -> Attitude | None:
        return known(self._state, Attitude, within=STEER_S)

    # -- horizontally ----------------------------------------------------------------------------

    def _look_at_way(
        self, now: float, passed: float, setpoint: Setpoint, velocity: Velocity | None
    ) -> str:
        if setpoint.mode.horizontal is Horizontal.TILT:
            self._way.is_over(now, None, 0.0, _NOWHERE)
            return self._look_at_tilt(now, setpoint)
        self._tilt.is_over(now, None, 0.0, _NOWHERE)
        north, east, fast = self._wanted(setpoint)
        wanted = math.hypot(north, east)
        if wanted < _LEAST_M_S:
            self._unseen = 0j
            self._way.is_over(now, None, 0.0, _NOWHERE)
            return ""
        north, east = north / wanted, east / wanted
        if velocity is None:
            return self._look_at_place(passed, complex(north, east) * fast)
        self._unseen = 0j
        along = velocity.north_m_s * north + velocity.east_m_s * east
        seen: float | None = along
        if along >= _FOLLOWS * wanted or self._leans(north, east):
            seen = None
        if not self._way.is_over(now, seen, _BEGINS * (wanted - along), (north, east)):
            return ""
        return f"{wanted:.1f} m/s are asked for, and {along:z.1f} m/s flown, without a begin"

    def _wanted(self, setpoint: Setpoint) -> tuple[float, float, float]:
        """The least velocity asked for, north and east, m/s, and how fast it may be flown."""
        x, y = setpoint.x, setpoint.y
        if setpoint.frame is ReferenceFrame.BODY:
            attitude = self._attitude()
            if attitude is None:
                return 0.0, 0.0, 0.0
            x, y = over_ground(x, y, attitude)
        fast = math.hypot(x, y)
        if setpoint.mode.horizontal is Horizontal.VELOCITY:
            return x, y, fast
        if fast < _LEAST_OFFSET_M:
            return 0.0, 0.0, 0.0
        return x / fast * _OFFSET_M_S, y / fast * _OFFSET_M_S, min(fast / 2, _FAST_OFFSET_M_S)

    def _leans(self, north: float, east: float) -> bool:
        """Whether it tilts towards that direction, or has begun to."""
        attitude = self._attitude()
        if attitude is None:
            return False
        lean = over_ground(-attitude.pitch_deg, attitude.roll_deg, attitude)
        before, self._lean = self._lean or lean, lean if self._lean is None else self._lean
        more = (lean[0] - before[0]) * north + (lean[1] - before[1]) * east
        if more >= _TILTED_DEG:
            self._lean = lean
        return more >= _TILTED_DEG or lean[0] * north + lean[1] * east >= _LEANS_DEG

    def _look_at_place(self, passed: float, asked: complex) -> str:
        """Without a velocity, the place has to change while it is flown to another one."""
        place = known(self._state, Position)
        if place is None:
            self._unseen, self._place = 0j, None
            return ""
        if self._place is None or apart_m(self._place, place) > _STILL_M:
            self._place, self._unseen = place, 0j
            return ""
        passed = min(passed, STEER_S)
        self._unseen_s = self._unseen_s + passed if self._unseen else passed
        self._unseen += asked * passed
        unseen = abs(self._unseen)
        if unseen < _UNSEEN_M or self._unseen_s < _UNSEEN_S + self._slack():
            return ""
        return f"setpoints of {unseen:.0f} m were flown, and the position did not change"

    def _look_at_tilt(self, now: float, setpoint: Setpoint) -> str:
        wanted, attitude = math.hypot(setpoint.x, setpoint.y), self._attitude()
        if attitude is None or wanted < _LEAST_TILT_DEG or setpoint.frame is ReferenceFrame.GROUND:
            self._tilt.is_over(now, None, 0.0, _NOWHERE)
            return ""
        along = (attitude.roll_deg * setpoint.x + attitude.pitch_deg * setpoint.y) / wanted
        seen = along if along < _FOLLOWS * wanted else None
        asked = setpoint.x, setpoint.y
        if not self._tilt.is_over(now, seen, _BEGINS * (wanted - along), asked):
            return ""
        return f"a tilt of {wanted:.0f}° is asked for, and {along:z.0f}° flown, without a begin"

    # -- climbing and turning --------------------------------------------------------------------

    def _look_at_climb(self, now: float, setpoint: Setpoint, velocity: Velocity | None) -> str:
        wanted, climb, seen = self._wanted_climb(setpoint), 0.0, None
        is_asked = abs(wanted) >= _LEAST_CLIMB_M_S and (wanted > 0.0 or self._is_high())
        if velocity is not None and is_asked:
            climb = abs(velocity.up_m_s)  # the sources do not settle its sign
            seen = climb if climb < _FOLLOWS * abs(wanted) else None
        needed = _BEGINS * (abs(wanted) - climb)
        if not self._climb.is_over(now, seen, needed, (wanted, 0.0)):
            return ""
        return f"a climb of {wanted:.1f} m/s is asked for, and {climb:.1f} m/s flown"

    def _wanted_climb(self, setpoint: Setpoint) -> float:
        """The least climb asked for, m/s."""
        if setpoint.mode.vertical is Vertical.VELOCITY:
            return setpoint.z
        position = known(self._state, Position)
        if setpoint.mode.vertical is not Vertical.HEIGHT or position is None:
            return 0.0
        missing = setpoint.z - position.height_m
        return 0.0 if abs(missing) < _LEAST_OFFSET_M else math.copysign(_OFFSET_UP_M_S, missing)

    def _is_high(self) -> bool:
        position = known(self._state, Position)
        return position is not None and position.height_m > _LANDS_BELOW_M

    def _look_at_turn(self, now: float, setpoint: Setpoint) -> str:
        seen, asked, is_by_rate = None, 0.0, setpoint.mode.yaw is Yaw.RATE
        is_slow = is_by_rate and abs(setpoint.yaw) < _LEAST_TURN_DEG_S
        attitude = None if is_slow else self._attitude()
        if attitude is None:
            self._heading = None
        else:
            heading = attitude.yaw_deg
            asked = setpoint.yaw if is_by_rate else normalize_degrees(setpoint.yaw - heading)
            is_asked = is_by_rate or abs(asked) >= _LEAST_TURN_DEG
            goes_back, self._rightward = asked * self._rightward < 0.0, asked
            if self._heading is None or not is_asked or goes_back:
                self._heading = heading
            turned = abs(normalize_degrees(heading - self._heading))
            seen = turned if is_asked and turned < _TURNED_DEG else None
            if seen is None:
                self._heading = heading
        if not self._turn.is_over(now, seen, _TURNED_DEG, (asked, 0.0)):
            return ""
        return "a turn is asked for, and the heading stays"


def apart_m(one: Position, other: Position) -> float:
    """Horizontal distance, m."""
    north = one.latitude_rad - other.latitude_rad
    east = math.remainder(one.longitude_rad - other.longitude_rad, 2 * math.pi)
    return math.hypot(north, east * math.cos(one.latitude_rad)) * 6_378_137.0


# -- watchdog --------------------------------------------------------------------------------------

_SLACK_S = 0.01  # so that a timer that is on time finds the limit passed
_BLOCKED_S = 0.1  # a timer that is later than this says that the program itself did not run
_GRACE_S = 0.05  # after that, time to read what came meanwhile
_LOOK_S = 0.1  # as ArduPilot's ekf_check
_WAIT_S = 0.2  # while nothing is sent: a mission, a take-off, a program that waits


class TelemetryWatchdog:
    """Looks at telemetry when asked, before each frame, and by a timer when nobody asks.

    It must be new: by its arrival, before each frame; and by the clock of the aircraft. It must be
    possible: see :class:`m100link.Integrity`. And the aircraft must begin to follow. These
    are looked at ten times a second, five while nothing is sent: before each frame they would cost
    half of what flying does.

    Telemetry that never came cannot be missed. When this program itself did not run, what came
    meanwhile is read first: only telemetry that is still missing then counts as a stall. When the
    computer was suspended, no age says anything, and that alone is the end.
    """

    def __init__(
        self,
        state: AircraftState,
        # ``stale_telemetry_s`` is the limit of its age, ``integrity`` whether the rest is looked
        # at.
        guards: Guards,
        # Called with cause and error at each look that finds something.
        end: Callable[[StopCause, M100Error], None],
        loop: asyncio.AbstractEventLoop,  # whose clock and timers are used
        # Whether setpoints are followed; None where nobody can know.
        following: FollowCheck | None = None,
        latency: Latency | None = None,  # of the line; None: nobody measures it
    ) -> None:
        self._state = state
        self._latency = latency
        self._limit = guards.stale_telemetry_s
        self._checks_integrity = guards.integrity
        self._following = following if guards.integrity else None
        self._suspended = SuspendWatch()
        self._end = end
        self._loop = loop
        self._clock = loop.time
        self._timer: asyncio.TimerHandle | None = None
        # Until when old telemetry is forgiven; None while it is not old.
        self._grace_ends_at: float | None = None
        self._looks_at = -math.inf  # when at what costs more

    def start(self) -> None:
        """Look now, and on and on; until something was found, or :meth:`stop`."""
        if self._timer is None:  # a sleep before the flight is not the flight's
            self._suspended = SuspendWatch()
        if self.is_quiet():
            rest = _WAIT_S
            age = self._state.newest_age or 0.0
            if self._limit is not None:
                rest = self._limit - age if age <= self._limit else _GRACE_S
            self._timer = self._loop.call_later(min(rest + _SLACK_S, _WAIT_S), self.start)

    def stop(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()

    def hurry(self) -> None:
        """Look at all of it when asked next: something is strange, and this may be why."""
        self._looks_at = -math.inf

    def is_quiet(self) -> bool:
        """False when something is found here and now."""
        now = self._clock()
        # First: the loop's clock stood still meanwhile, so every age is too small.
        slept = self._suspended.slept_s()
        if slept:
            seen = f"this computer was suspended for {slept:.1f} s while flying"
            self._end(StopCause.SUSPENDED, ComputerSuspended.usual(seen))
            return False
        return self._is_heard(now) and (now < self._looks_at or self._is_right(now))

    def _is_right(self, now: float) -> bool:
        self._looks_at = now + _LOOK_S - _SLACK_S
        return (self._limit is None or self._is_timely()) and self._is_true()

    def _is_heard(self, now: float) -> bool:
        newest_at = self._state.newest_at
        if self._limit is None or newest_at is None:
            return True
        age = now - newest_at
        if age <= self._limit:
            self._grace_ends_at = None
            return True
        if self._is_forgiven():
            return True
        cause = "the line from the aircraft is broken, or this program was blocked"
        remedy = "check the line; a program that blocks must not fly"
        if self._latency is not None and self._latency.is_slow:
            cause += f"; or {self._latency}, and a network repeated what it had lost"
            remedy += "; Guards(stale_telemetry_s=…) above the round trip waits for a repeat"
        seen = f"no telemetry for {age:.1f} s while flying"
        error = TelemetryStalled(seen, cause=cause, remedy=remedy)
        self._end(StopCause.TELEMETRY_STALLED, error)
        return False

    def _is_forgiven(self) -> bool:
        now = self._clock()
        if self._grace_ends_at is None:
            # A timer this late: the program did not run, and packages wait in the line to be read.
            was_blocked = self._timer is not None and now - self._timer.when() > _BLOCKED_S
            self._grace_ends_at = now + _GRACE_S if was_blocked else now
        return now < self._grace_ends_at

    def _is_timely(self) -> bool:
        integrity = self._state.integrity
        if integrity.is_timely:
            return True
        self._end(
            StopCause.TELEMETRY_STALLED,
            TelemetryStalled(
                f"{integrity.seen} while flying",
                cause="a relay repeats what it has, or a radio or bridge carries less than is sent",
                remedy="connect directly, or set lower rates in the PC assistant",
            ),
        )
        return False

    def _is_true(self) -> bool:
        if not self._checks_integrity:
            return True
        integrity = self._state.integrity
        if not integrity.is_plausible:
            self._end(StopCause.NAVIGATION_LOST, NavigationLost.usual(integrity.seen))
            return False
        ignored = self._following.look() if self._following is not None else ""
        if ignored:
            self._end(StopCause.SETPOINTS_IGNORED, SetpointsIgnored.usual(ignored))
        return not ignored
