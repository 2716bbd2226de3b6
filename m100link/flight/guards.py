"""Safety guards, which refuse an order before a byte is sent.

All are on by default. Each is switched off by its own name, so that a program that flies without
one says so in its source: ``aircraft.control(guards=Guards(gps=False))``. Landing and going home
are never guarded.
"""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from m100link.errors import GuardRefused, UsageError
from m100link.geodesy import LocalFrame
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Attitude, Battery, Position
from m100link.protocol.setpoint import Horizontal, ReferenceFrame, Setpoint, Vertical
from m100link.telemetry.state import FRESH_S, is_possible

if TYPE_CHECKING:
    from m100link.link import Latency
    from m100link.telemetry.state import AircraftState

__all__ = ["Envelope", "Guards"]


# -- known values of the aircraft: a value that is old, or impossible, is unknown ------------------


R = TypeVar("R", bound=tuple[Any, ...])


def known(state: AircraftState, record: type[R], *, within: float | None = None) -> R | None:
    """The newest value of an item, None when it is old or impossible: nobody knows it then.

    ``within``: seconds that it may be old; by default those of the table that all share.
    """
    value = state.fresh(record, within=within)
    return value if value is not None and is_possible(value) else None


def over_ground(forward: float, right: float, attitude: Attitude) -> tuple[float, float]:
    """North and east of what lies ahead of the nose and to its right."""
    yaw = math.radians(attitude.yaw_deg)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return forward * cos - right * sin, forward * sin + right * cos


# -- guards ----------------------------------------------------------------------------------------

GPS_HEALTH_NEEDED = 3  # from this health on the autopilot holds a position (document 2.2.3.1)

MAX_COMMAND_M_S = 10.0  # of velocity setpoints on each axis (document 3.2)

# Each setpoint asks for them, and Python 3.11 finds no member in its class in less than 0.07 µs.
_TILT, _VELOCITY, _OFFSET = Horizontal
_CLIMB, _HEIGHT, _THRUST = Vertical
_A_SETPOINT = {one: f"a {one.name.lower().replace('_', ' ')} setpoint" for one in Horizontal}

_OFFSET_M_S = 5.0  # as fast as the autopilot flies offsets, at most

STICK_SPEED = 17.0  # m/s by full deflection in P: the fastest that the maker states
FIRST_VALUES_S = 1.5  # for the first value of an item: that of the battery is sent once a second

_OFF = {
    "gps": "Guards(gps=False)",
    "envelope": "Guards(envelope=None)",
    "battery_floor_percent": "Guards(battery_floor_percent=None)",
}

_TAKE_OFF_POLL_S = 0.02
MISSION_MARGIN_M = 5.0  # beyond the envelope a mission is ended: along the edge it overshoots


@dataclass(frozen=True, slots=True)
class Envelope:
    """How far a program may fly."""

    max_height_m: float = 50.0  #: Height above the take-off point, m.
    max_radius_m: float = 150.0  #: Horizontal distance from where control was obtained, m.
    max_speed_m_s: float = 10.0  #: Horizontal speed of velocity setpoints, m/s.

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not getattr(self, name) > 0:
                raise UsageError(f"{name} must be more than 0, not {getattr(self, name)}")

    def check(
        self,
        what: str,
        *,
        height: float | None = None,
        far: float | None = None,
        speed: float = 0.0,
    ) -> None:
        """Refuse a target outside; a value of None is unknown.

        Args:
            what: Name of the flight.
            height: Metres above the take-off point.
            far: Metres from where control was obtained.
            speed: On the way, m/s.

        Raises:
            GuardRefused: Outside, with the target and what widens the envelope.
        """
        inside = "a target inside"
        for value, name, seen, better in (
            (height, "max_height_m", "a height of {:.1f} m", inside),
            (far, "max_radius_m", "{:.0f} m from the start", inside),
            (speed, "max_speed_m_s", "a speed of {:.1f} m/s", "fly slower"),
        ):
            if value is not None and value > getattr(self, name) + 1e-9:
                raise self._refusal(seen.format(value), name, value, better, f"{what} to ")

    def _refusal(
        self, what: str, name: str, measured: float | None, better: str, flight: str = ""
    ) -> GuardRefused:
        """The refusal of a target outside, by the limit of that name."""
        limit = getattr(self, name)
        ends = f"allows {limit:g} m/s" if name == "max_speed_m_s" else f"ends at {limit:g} m"
        outside = f"{what} was refused: the envelope {ends}"
        return GuardRefused(
            f"{flight}{outside}",
            guard="envelope",
            outside=outside,
            measured=measured,
            limit=limit,
            remedy=better,
            off=f"control(guards=Guards(envelope=Envelope({name}=…)))",
        )


@dataclass(frozen=True, slots=True)
class Guards:
    """Which guards are on."""

    #: Velocity and position setpoints need a GPS health of 3 (switch it off to fly them by a
    #: Guidance unit).
    gps: bool = True
    #: Limits of height, radius and speed; None switches them off.
    envelope: Envelope | None = Envelope()
    #: Below it no take-off and no setpoints; None switches it off.
    battery_floor_percent: int | None = 20
    #: Control ends when no new telemetry came for so many seconds, or when it comes ever later;
    #: None switches it off.
    stale_telemetry_s: float | None = 1.0
    #: Control ends when the position cannot be true, or nothing begins to follow the setpoints
    #: (switch it off for a simulator whose position and velocity disagree).
    integrity: bool = True
    #: Flights that are steered by what telemetry shows (``fly_to``, ``fly_path``, ``orbit``, tilt,
    #: thrust, sticks) need a line whose answers take no longer, s; None switches it off.
    round_trip_s: float | None = 0.8


class GuardKeeper:
    """Checks setpoints against the guards and the newest telemetry.

    A guard refuses when a value that it compares is unknown: old, impossible, or not received
    within 1.5 s of the beginning.
    """

    def __init__(
        self,
        guards: Guards,
        state: AircraftState,
        origin: LocalFrame | None = None,
        latency: Latency | None = None,  # of the line; None: nobody measures it
    ) -> None:
        self.guards = guards
        self._state = state
        self._latency = latency
        self._origin = origin  # where control began; by default where GPS first knows the aircraft
        self._began_at = -math.inf

    def start(self) -> None:
        """Control begins here: distances are measured from this place, once GPS knows it."""
        self._began_at = asyncio.get_running_loop().time()
        self._from_start(known(self._state, Position))

    @property
    def origin(self) -> tuple[float, float] | None:
        """Latitude and longitude of where control began, °; None while nobody knows."""
        start = self._origin
        return None if start is None else (start.latitude_deg, start.longitude_deg)

    @property
    def fastest_m_s(self) -> float:
        """The highest speed that a velocity setpoint may ask for, m/s."""
        envelope = self.guards.envelope
        return min(MAX_COMMAND_M_S, envelope.max_speed_m_s if envelope else math.inf)

    async def admit_take_off(self) -> None:
        """Wait up to 1.5 s for the values of the guards, then admit a take-off or refuse it.

        Raises ``GuardRefused``: battery below its floor; battery or position unknown.
        """
        await self._admit("take-off")

    async def admit_mission(self, what: str) -> None:
        """As :meth:`admit_take_off`, for a mission, which besides needs GPS."""
        await self._admit(what)
        if self.guards.gps:
            self._check_gps(what, known(self._state, Position))

    def check_mission(self, what: str) -> None:
        """Raise ``GuardRefused`` where the battery, or 5 m beyond the envelope, ends a mission."""
        self._check_battery(what, known(self._state, Battery))
        envelope = self.guards.envelope
        if envelope is None:
            return
        position = known(self._state, Position)
        if position is None:
            raise self._unknown(what, Position, guard="envelope", limit=None)
        place = self._from_start(position)
        far = None if place is None else math.hypot(*place)
        for measured, limit, which in (
            (position.height_m, envelope.max_height_m, "above the take-off point"),
            (far, envelope.max_radius_m, "from the start"),
        ):
            if measured is not None and measured > limit + MISSION_MARGIN_M:
                raise GuardRefused(
                    f"{what} is ended: the aircraft is {measured:.0f} m {which}, the envelope ends "
                    f"at {limit:g} m",
                    guard="envelope",
                    measured=measured,
                    limit=limit,
                    cause="the pilot's stick, wind, or a curve; what was planned lies inside",
                    remedy="fly back by hand, or widen the envelope",
                )

    async def _admit(self, what: str) -> None:
        needed: list[type[Any]] = []
        if self.guards.battery_floor_percent is not None:
            needed.append(Battery)
        envelope = self.guards.envelope
        if self.guards.gps or (envelope is not None and envelope.max_height_m < math.inf):
            needed.append(Position)
        clock = asyncio.get_running_loop().time
        deadline = clock() + FIRST_VALUES_S
        while None in (found := {item: known(self._state, item) for item in needed}).values():
            if clock() >= deadline:
                break
            await asyncio.sleep(_TAKE_OFF_POLL_S)
        self._check_battery(what, found.get(Battery), on_ground=True)
        if Position in found and found[Position] is None:
            guard = "gps" if self.guards.gps else "envelope"
            raise self._unknown(what, Position, guard=guard, limit=None)

    def check_round_trip(self, what: str) -> None:
        """Raise ``GuardRefused`` where the line is too slow to steer by what telemetry shows."""
        limit, latency = self.guards.round_trip_s, self._latency
        measured = None if latency is None else latency.round_trip_s
        if limit is None or measured is None or measured <= limit:
            return
        raise GuardRefused(
            f"{what} was refused: {latency}, the limit is {limit:g} s",
            guard="round_trip_s",
            measured=measured,
            limit=limit,
            cause="what steers by places of so long ago swings around its target, or passes it",
            remedy="take-off, landing, go-home, missions, climb_to, turn_to and velocities fly at "
            "any latency",
            off="Guards(round_trip_s=…)",
        )

    @property
    def _late_s(self) -> float:
        """Seconds for which the aircraft flies on when a guard refuses by what it sees."""
        latency = self._latency
        if latency is None or not latency.is_slow:
            return 0.0
        return latency.round_trip_s or 0.0

    def check(self, setpoint: Setpoint) -> None:
        """Raise ``GuardRefused`` unless a setpoint may be sent now."""
        steers = setpoint.mode
        if steers.vertical is _THRUST or (
            steers.horizontal is _TILT and (setpoint.x or setpoint.y)
        ):
            self.check_round_trip("a setpoint of tilt or thrust")
        self._check_battery("a setpoint", known(self._state, Battery))
        position = known(self._state, Position)
        # Without GPS the autopilot ignores velocities and offsets, without a notice; tilt it flies.
        if steers.horizontal is not _TILT and self.guards.gps:
            self._check_gps(_A_SETPOINT[steers.horizontal], position)
        envelope = self.guards.envelope
        if envelope is not None:
            self._check_height(setpoint, envelope, position)
            self._check_speed(setpoint, envelope)
            self._check_radius(setpoint, envelope, position)

    def check_sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Whether sticks may be moved now; nobody says how fast they fly, so 17 m/s are assumed.

        ``roll``: deflection, -1 to 1, like the others. Raises ``GuardRefused``: with the guard's
        name, the measured value and the limit.
        """
        self.check_round_trip("moving the sticks")
        deflection = math.hypot(roll, pitch)
        speed = deflection * STICK_SPEED
        envelope = self.guards.envelope
        if envelope is not None and speed > envelope.max_speed_m_s + 1e-9:
            raise GuardRefused(
                f"a deflection of {deflection:.2f} was refused: it may fly {speed:.1f} m/s, the "
                f"envelope allows {envelope.max_speed_m_s:g} m/s",
                guard="envelope",
                measured=speed,
                limit=envelope.max_speed_m_s,
                remedy="move them less",
                off="Guards(envelope=Envelope(max_speed_m_s=…))",
            )
        least = max(1.0, deflection)  # the direction counts
        self.check(
            Setpoint.velocity(
                forward=pitch / least,
                right=roll / least,
                up=throttle,
                yaw_rate_deg_s=yaw,
            )
        )

    def check_target(
        self,
        what: str,  # name of the flight
        place: tuple[float, float] | None = None,  # latitude and longitude, °
        *,
        height: float | None = None,  # metres above the take-off point
        radius: float = 0.0,  # of a circle around the place, m
        speed: float = 0.0,  # on the way, m/s
    ) -> None:
        """Refuse a flight to a target outside; the path to it is checked as it is flown.

        Raises ``GuardRefused``: outside the envelope, with the target and what widens it.
        """
        envelope = self.guards.envelope
        if envelope is None:
            return
        far = None
        here = self._from_start(known(self._state, Position))
        if place is not None and here is not None and self._origin is not None:
            far = math.hypot(*self._origin.to_local(*place)) + radius
        envelope.check(what, height=height, far=far, speed=speed)

    def _may_still_come(self, record: type[Any]) -> bool:
        """Whether an item has never come, and had no time yet."""
        if self._began_at == -math.inf or self._state.get(record) is not None:
            return False
        return asyncio.get_running_loop().time() - self._began_at < FIRST_VALUES_S

    def _unknown(
        self, what: str, record: type[Any], *, guard: str, limit: object, off: str = ""
    ) -> GuardRefused:
        """The refusal for a value that the guard compares and nobody knows."""
        age, name = self._state.age(record), BY_RECORD[record].name
        if age is None:
            seen = f"the {name} item has never come"
        elif age > FRESH_S[record]:
            seen = f"the {name} item is {age:.1f} s old"
        else:
            seen = f"the {name} item is impossible: {self._state.get(record)}"
        return GuardRefused(
            f"{what} was refused: {seen}",
            guard=guard,
            measured=None,
            limit=limit,
            cause="the item is not sent, or the sensor does not work (yet)",
            remedy="set the item to 1 Hz or more in the PC assistant",
            off=off or _OFF[guard],
        )

    def _check_battery(
        self, what: str, battery: Battery | None, *, on_ground: bool = False
    ) -> None:
        floor = self.guards.battery_floor_percent
        if floor is None:
            return
        if battery is None:
            # Sent once a second: for a program that takes over in flight it is on its way.
            if not on_ground and self._may_still_come(Battery):
                return
            raise self._unknown(what, Battery, guard="battery_floor_percent", limit=floor)
        if battery.percent < floor:
            raise GuardRefused(
                f"{what} was refused: the battery has {battery.percent} %, the floor is {floor} %",
                guard="battery_floor_percent",
                measured=battery.percent,
                limit=floor,
                remedy="charge the battery or put in a full one"
                if on_ground
                else "land; landing and going home are never refused",
            )

    def _check_gps(self, what: str, position: Position | None) -> None:
        health = None if position is None else position.gps_health
        if health is None or health < GPS_HEALTH_NEEDED:
            seen = "unknown" if health is None else str(health)
            raise GuardRefused(
                f"{what} was refused: GPS health is {seen}, {GPS_HEALTH_NEEDED} is needed",
                guard="gps",
                measured=health,
                limit=GPS_HEALTH_NEEDED,
                cause="the autopilot ignores such setpoints without GPS; or the position item "
                "is not sent, old or impossible",
                remedy="wait for GPS, or fly tilt setpoints",
                off="Guards(gps=False) with Guidance",
            )

    def _check_height(
        self, setpoint: Setpoint, envelope: Envelope, position: Position | None
    ) -> None:
        limit = envelope.max_height_m
        if limit == math.inf:
            return
        measured = None if position is None else position.height_m
        mode = setpoint.mode.vertical
        if mode is _HEIGHT:
            wanted: float | None = setpoint.z
        # Thrust holds no height: whatever its value, it counts as a climb from here.
        elif mode is _THRUST or setpoint.z > 0:
            wanted = measured
            if measured is None and not self._may_still_come(Position):
                raise self._unknown(
                    "a setpoint that climbs" if mode is _CLIMB else "thrust",
                    Position,
                    guard="envelope",
                    limit=limit,
                    off="Guards(envelope=Envelope(max_height_m=math.inf))",
                )
            if measured is not None and mode is _CLIMB:
                wanted = measured + setpoint.z * self._late_s
        else:
            return  # level or down: the path back below the limit stays open
        if wanted is not None and wanted > limit:
            seen = f"a setpoint to or above {wanted:.1f} m"
            raise envelope._refusal(seen, "max_height_m", measured, "descend")

    def _check_speed(self, setpoint: Setpoint, envelope: Envelope) -> None:
        if setpoint.mode.horizontal is not _VELOCITY:
            return
        speed = math.hypot(setpoint.x, setpoint.y)
        if speed > envelope.max_speed_m_s + 1e-9:
            seen = f"a velocity of {speed:.1f} m/s"
            raise envelope._refusal(seen, "max_speed_m_s", speed, "fly slower")

    def _from_start(self, position: Position | None) -> tuple[float, float] | None:
        """Metres north and east of where control began, None while nobody knows."""
        if position is None:
            return None
        if position.gps_health is not None and position.gps_health < GPS_HEALTH_NEEDED:
            return None  # without reception the coordinates mean nothing
        here = position.latitude_deg, position.longitude_deg
        if self._origin is None:
            self._origin = LocalFrame(*here)
        return self._origin.to_local(*here)

    def _check_radius(
        self, setpoint: Setpoint, envelope: Envelope, position: Position | None
    ) -> None:
        limit = envelope.max_radius_m
        if limit == math.inf or (setpoint.x, setpoint.y) == (0.0, 0.0):
            return
        place = self._from_start(position)
        if place is None:
            if self._origin is not None and position is None:
                raise self._unknown(
                    "a setpoint that moves",
                    Position,
                    guard="envelope",
                    limit=limit,
                    off="Guards(envelope=Envelope(max_radius_m=math.inf))",
                )
            return  # without reception nobody can tell, and tilt is how one flies then
        there, here = self._reach(setpoint, *place), math.hypot(*place)
        if there > limit and there >= here:  # from outside, a step towards the start is allowed
            seen = f"a setpoint {there:.0f} m from the start"
            raise envelope._refusal(seen, "max_radius_m", there, "fly back")

    def _reach(self, setpoint: Setpoint, north: float, east: float) -> float:
        """How far from the start a setpoint leads from there; a path back counts as 0 m."""
        step = self._ground(setpoint)
        is_offset = setpoint.mode.horizontal is _OFFSET
        if step is None:  # without a heading it may lead anywhere
            return math.hypot(north, east) + is_offset * math.hypot(setpoint.x, setpoint.y)
        late = self._late_s * min(math.hypot(*step), _OFFSET_M_S if is_offset else math.inf)
        if is_offset:
            return math.hypot(north + step[0], east + step[1]) + late
        # Outside, a velocity or a tilt is allowed only if it does not lead further away.
        is_outward = north * step[0] + east * step[1] > 0
        return math.hypot(north, east) + late if is_outward else 0.0

    def _ground(self, setpoint: Setpoint) -> tuple[float, float] | None:
        """The way of a setpoint as north and east: velocity, offset, or direction of a tilt."""
        forward, right = setpoint.x, setpoint.y
        if setpoint.mode.horizontal is _TILT:
            forward, right = -setpoint.y, setpoint.x  # negative pitch flies forward
        if setpoint.frame is ReferenceFrame.GROUND:
            return forward, right
        attitude = known(self._state, Attitude)
        if attitude is None:
            return None
        return over_ground(forward, right, attitude)


# -- detect that the computer slept: the event loop's clock stopped, the aircraft did not ----------


# On macOS the other one counts sleep, too, on Windows that of `time.monotonic`.
_WITH_SLEEP = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
_NOTICED_S = 0.1
_READINGS = 3

SUSPENDED_S = 1.0
"""Seconds by which what was sent during a suspend may seem to be from after it."""


def since_boot_s() -> float:
    """Return the seconds since the computer started, also those for which it was suspended."""
    return time.monotonic() if _WITH_SLEEP is None else time.clock_gettime(_WITH_SLEEP)


def asleep_s() -> float:
    """Return the seconds for which the computer was suspended since it started, plus a constant."""
    # In this order: a process that is stopped between the two readings makes the result smaller, so
    # no sleep is seen where there was none.
    with_sleep = since_boot_s()
    return with_sleep - time.monotonic()


class SuspendWatch:
    """Notices a suspend after it was made.

    The event loop's clock counts every age and lifetime of a flight. It is CLOCK_MONOTONIC, which
    stops while the computer is suspended: on waking, a setpoint of an hour ago is a tenth of a
    second old. So nothing relies on ages after a suspend.
    """

    def __init__(self) -> None:
        # The largest of some readings is the one between which the process was not stopped.
        self._before_s = max(asleep_s() for _ in range(_READINGS))
        self._void_until = -math.inf

    def slept_s(self) -> float:
        """Return for how long the computer was suspended, s; 0 when it was not."""
        slept = asleep_s() - self._before_s
        return slept if slept > _NOTICED_S else 0.0

    def void_until(self, now: float) -> float:
        """Up to when orders may be from before the computer woke, s of the event loop's clock.

        An order that was sent in the first second of a suspend waits in the line, and looks new by
        a clock that stood still. To be asked once a second, and before each order. ``now``: s.
        """
        slept = asleep_s() - self._before_s
        if slept > _NOTICED_S:
            self._before_s += slept
            self._void_until = now + SUSPENDED_S
        return self._void_until
