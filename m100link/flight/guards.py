"""Safety guards: what is refused before a byte is sent, and why.

All are on by default. Each is switched off by its own name, so that a program that flies without
one says so in its source: ``aircraft.control(guards=Guards(gps=False))``. Landing and going home
are never guarded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from m100link.errors import GuardRefused, UsageError
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Battery, Position
from m100link.protocol.setpoint import Horizontal, ReferenceFrame, Setpoint, Vertical
from m100link.telemetry.state import AircraftState

__all__ = ["Envelope", "Guards"]

GPS_HEALTH_NEEDED = 3
"""From this health on the autopilot holds a position (document 2.2.3.1)."""

_FRESH_S = 1.0


@dataclass(frozen=True, slots=True)
class Envelope:
    """How far a program may fly.

    Attributes:
        max_height_m: Height above the take-off point, m.
        max_radius_m: Horizontal distance from where control was obtained, m.
        max_speed_m_s: Horizontal speed of velocity setpoints, m/s.
    """

    max_height_m: float = 50.0
    max_radius_m: float = 150.0
    max_speed_m_s: float = 10.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not getattr(self, name) > 0:
                raise UsageError(f"{name} must be more than 0, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Guards:
    """Which guards are on.

    Attributes:
        gps: Velocity and position setpoints need a GPS health of 3 (switch it off to fly them by
            a Guidance unit).
        envelope: Limits of height, radius and speed; None switches them off.
        battery_floor_percent: Below it no take-off and no setpoints; None switches it off.
        stale_telemetry_s: Control ends when no telemetry came for so many seconds; None switches
            it off.
    """

    gps: bool = True
    envelope: Envelope | None = Envelope()
    battery_floor_percent: int | None = 20
    stale_telemetry_s: float | None = 1.0


class GuardKeeper:
    """Checks setpoints against the guards and the newest telemetry.

    Args:
        guards: Which are on.
        state: Telemetry.
    """

    def __init__(self, guards: Guards, state: AircraftState) -> None:
        self.guards = guards
        self._state = state
        self._origin: LocalFrame | None = None

    def check_take_off(self) -> None:
        """Whether a take-off may begin.

        Raises:
            GuardRefused: Battery below its floor.
        """
        self._check_battery("take-off")

    def check(self, setpoint: Setpoint) -> None:
        """Whether a setpoint may be sent.

        Raises:
            GuardRefused: With the guard's name, the measured value and the limit.
        """
        self._check_battery("a setpoint")
        needs_gps = setpoint.mode.horizontal is not Horizontal.TILT
        if needs_gps and self.guards.gps:
            self._check_gps(setpoint)
        envelope = self.guards.envelope
        if envelope is not None:
            self._check_height(setpoint, envelope)
            self._check_speed(setpoint, envelope)
            self._check_radius(setpoint, envelope)

    def _check_battery(self, what: str) -> None:
        floor = self.guards.battery_floor_percent
        battery = self._state.get(Battery)
        if floor is not None and battery is not None and battery.percent < floor:
            raise GuardRefused(
                f"{what} was refused: the battery has {battery.percent} %, the floor is {floor} %",
                guard="battery_floor_percent",
                measured=battery.percent,
                limit=floor,
                remedy="land; landing and going home are never refused",
            )

    def _check_gps(self, setpoint: Setpoint) -> None:
        position = self._state.fresh(Position, within=_FRESH_S)
        health = None if position is None else position.gps_health
        if health is None or health < GPS_HEALTH_NEEDED:
            mode = setpoint.mode.horizontal.name.lower().replace("_", " ")
            seen = "unknown" if health is None else str(health)
            raise GuardRefused(
                f"a {mode} setpoint was refused: GPS health is {seen}, "
                f"{GPS_HEALTH_NEEDED} is needed",
                guard="gps",
                measured=health,
                limit=GPS_HEALTH_NEEDED,
                cause="the autopilot ignores such setpoints without GPS; or the position item "
                "is not sent",
                remedy="wait for GPS, fly tilt setpoints, or Guards(gps=False) with Guidance",
            )

    def _check_height(self, setpoint: Setpoint, envelope: Envelope) -> None:
        limit = envelope.max_height_m
        position = self._state.get(Position)
        measured = None if position is None else position.height_m
        wanted: float | None = None
        if setpoint.mode.vertical is Vertical.HEIGHT:
            wanted = setpoint.z
        elif (
            setpoint.mode.vertical is Vertical.VELOCITY and setpoint.z > 0
        ) or setpoint.mode.vertical is Vertical.THRUST:
            wanted = measured
        if wanted is not None and wanted > limit:
            raise GuardRefused(
                f"a setpoint to or above {wanted:.1f} m was refused: the envelope ends at "
                f"{limit:g} m",
                guard="envelope",
                measured=measured,
                limit=limit,
                remedy="descend, or control(guards=Guards(envelope=Envelope(max_height_m=…)))",
            )

    def _check_speed(self, setpoint: Setpoint, envelope: Envelope) -> None:
        if setpoint.mode.horizontal is not Horizontal.VELOCITY:
            return
        speed = math.hypot(setpoint.x, setpoint.y)
        if speed > envelope.max_speed_m_s + 1e-9:
            raise GuardRefused(
                f"a velocity of {speed:.1f} m/s was refused: the envelope allows "
                f"{envelope.max_speed_m_s:g} m/s",
                guard="envelope",
                measured=speed,
                limit=envelope.max_speed_m_s,
                remedy="fly slower, or control(guards=Guards(envelope=Envelope(max_speed_m_s=…)))",
            )

    def start(self) -> None:
        """Control begins here: distances are measured from this place, once GPS knows it."""
        self._from_start()

    def _from_start(self) -> tuple[float, float] | None:
        """Metres north and east of where control began, None while nobody knows."""
        position = self._state.fresh(Position, within=_FRESH_S)
        if position is None:
            return None
        if position.gps_health is not None and position.gps_health < GPS_HEALTH_NEEDED:
            return None  # without reception the coordinates mean nothing
        here = position.latitude_deg, position.longitude_deg
        if self._origin is None:
            self._origin = LocalFrame(*here)
        return self._origin.to_local(*here)

    def _check_radius(self, setpoint: Setpoint, envelope: Envelope) -> None:
        place = self._from_start()
        if place is None:
            return
        north, east = place
        here = math.hypot(north, east)
        step_north, step_east = self._ground(setpoint)
        if setpoint.mode.horizontal is Horizontal.POSITION_OFFSET:
            there = math.hypot(north + step_north, east + step_east)
        else:
            # Outside, a velocity or a tilt is allowed only if it does not lead further away.
            is_outward = north * step_north + east * step_east > 0
            there = here if is_outward else 0.0
        if there > envelope.max_radius_m and there >= here:
            raise GuardRefused(
                f"a setpoint {there:.0f} m from the start was refused: the envelope ends at "
                f"{envelope.max_radius_m:g} m",
                guard="envelope",
                measured=there,
                limit=envelope.max_radius_m,
                remedy="fly back, or control(guards=Guards(envelope=Envelope(max_radius_m=…)))",
            )

    def _ground(self, setpoint: Setpoint) -> tuple[float, float]:
        """The way of a setpoint as north and east: velocity, offset, or direction of a tilt."""
        forward, right = setpoint.x, setpoint.y
        if setpoint.mode.horizontal is Horizontal.TILT:
            forward, right = -setpoint.y, setpoint.x  # negative pitch flies forward
        if setpoint.frame is ReferenceFrame.GROUND:
            return forward, right
        attitude = self._state.get(Attitude)
        yaw = 0.0 if attitude is None else math.radians(attitude.yaw_deg)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return forward * cos - right * sin, forward * sin + right * cos
