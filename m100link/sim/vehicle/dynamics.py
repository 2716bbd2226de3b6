"""How the virtual Matrice 100 moves: a quadrotor reduced to what its autopilot lets one notice.

Plain Python, fixed step, no clock and no randomness of its own: equal inputs give equal flights on
every machine. What keeps the parts consistent:

* Horizontal force exists only through tilt. Velocity and position control work by asking for a
  tilt, attitude follows as a second-order system, tilt and vertical thrust make the acceleration.
* Velocity is the running sum of exactly that acceleration, position the trapezoid sum of velocity.
* The quaternion is built from the same three angles, the body rates from their derivatives.

Conventions (document 3.1): north, east, metres; *up* is positive for height, vertical velocity and
vertical acceleration; angles in radians, yaw clockwise from north, forward flight is a *negative*
pitch angle, flight to the right a *positive* roll angle.

Its numbers are those of an :class:`~m100link.sim.vehicle.dynamics.Airframe`.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import KW_ONLY, dataclass, replace
from enum import IntEnum
from math import atan, cos, exp, pi, sin, sqrt, tan

from m100link.errors import UsageError
from m100link.errors.texts import read_path, read_toml
from m100link.protocol.firmware import FirmwareProfile, Generation
from m100link.protocol.records import quaternion

# -- the numbers of the flight model ---------------------------------------------------------------
# Where each comes from, and how well it is known: docs/explanation/simulator-limits.md.


@dataclass(frozen=True, slots=True, kw_only=True)
class Airframe:
    """The numbers of the model. Replace some of them to fly a heavier or livelier aircraft.

    Without arguments it is the airframe ``document``: limits from the document, all else chosen to
    look like a Matrice 100.

    Raises:
        UsageError: A number is not finite, or outside its range.
    """

    tilt_frequency: float = 10.0
    """Natural frequency of the attitude response, rad/s."""
    tilt_damping: float = 1.0
    """Damping ratio of the attitude response; 1 is critical."""
    command_delay: float = 0.0
    """Dead time from a movement command to its effect in s, by steps of 0.01 s."""
    maximum_tilt_deg: float = 30.0
    """Limit of commanded tilt (document 3.2)."""
    cruise_tilt_deg: float = 25.0
    """Tilt that velocity and position control allow themselves."""
    steepest_tilt_deg: float = 35.0
    """Tilt that missions may take, as in the tight circles of a hotpoint (DJI's data sheet)."""
    drag: float = 0.30
    """Horizontal deceleration per m/s of airspeed, 1/s."""
    vertical_drag: float = 0.35
    """Vertical deceleration per m/s in thrust control, 1/s."""
    smooth_braking: float = 2.5
    """Deceleration that stable mode allows itself, m/s²."""
    velocity_gain: float = 1.6
    """Horizontal acceleration asked for per m/s of velocity error, 1/s."""
    horizontal_speed: float = 10.0
    """Limit of commanded velocity on each horizontal axis, m/s (document 3.2)."""
    position_gain: float = 0.8
    """Velocity asked for per metre of position error, 1/s."""
    position_speed: float = 3.0
    """Fastest approach in position control, m/s. Users of the real one report about this value."""
    vertical_time_constant: float = 0.35
    """First-order lag of vertical velocity, s."""
    vertical_acceleration: float = 5.0
    """Limit of vertical acceleration in velocity and height control, m/s²."""
    height_gain: float = 1.2
    """Vertical velocity asked for per metre of height error, 1/s."""
    vertical_speed: float = 4.0
    """Limit of vertical velocity in velocity and height control, m/s (document 3.2)."""
    yaw_time_constant: float = 0.15
    """First-order lag of the yaw rate, s."""
    yaw_gain: float = 2.0
    """Yaw rate asked for per radian of yaw error, 1/s."""
    yaw_rate_deg: float = 100.0
    """Limit of the yaw rate, degrees per second (document 3.2)."""
    hover_thrust: float = 45.0
    """Percent of full thrust that carries the aircraft with a full battery."""
    empty_hover_thrust: float = 45.0
    """The same with an empty battery; between the two it changes evenly."""
    thrust_exponent: float = 1.0
    """Lift grows with that power of thrust; 1 is in proportion."""
    hover_minutes: float = 22.0
    """Minutes that a full battery carries the aircraft."""
    gyro_noise: float = 0.005
    """Standard deviation of an angular velocity, rad/s, when sensor noise is 1."""
    accelerometer_noise: float = 0.05
    """Standard deviation of an acceleration, m/s², when sensor noise is 1."""

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(
                    f"{name} of an airframe is {value}", remedy=f"give {low:g} to {high:g}"
                )


_LAG, _GAIN, _PERCENT = (0.01, 10.0), (0.0, 20.0), (5.0, 95.0)
RANGES: dict[str, tuple[float, float]] = {
    **{"tilt_frequency": (1.0, 50.0), "tilt_damping": (0.1, 3.0), "command_delay": (0.0, 2.0)},
    **dict.fromkeys(("maximum_tilt_deg", "cruise_tilt_deg", "steepest_tilt_deg"), (1.0, 80.0)),
    **dict.fromkeys(("drag", "vertical_drag"), (0.0, 5.0)),
    **dict.fromkeys(("velocity_gain", "position_gain", "height_gain", "yaw_gain"), _GAIN),
    **dict.fromkeys(("horizontal_speed", "position_speed", "vertical_speed"), (0.0, 40.0)),
    **dict.fromkeys(("smooth_braking", "vertical_acceleration"), (0.1, 20.0)),
    **dict.fromkeys(("vertical_time_constant", "yaw_time_constant"), _LAG),
    **dict.fromkeys(("hover_thrust", "empty_hover_thrust"), _PERCENT),
    **{"yaw_rate_deg": (0.0, 500.0), "thrust_exponent": (0.1, 3.0), "hover_minutes": (0.1, 600.0)},
    **dict.fromkeys(("gyro_noise", "accelerometer_noise"), (0.0, 5.0)),
}
"""Least and most of each number of an :class:`Airframe`."""

MEASURED = "measured-3.1.10"
AIRFRAMES: dict[str, Airframe] = {
    "document": Airframe(),
    MEASURED: Airframe(
        tilt_frequency=11.7,
        tilt_damping=0.85,
        command_delay=0.10,
        maximum_tilt_deg=35.5,
        drag=0.12,
        vertical_drag=0.04,
        horizontal_speed=14.0,
        yaw_time_constant=0.12,
        hover_thrust=38.2,
        empty_hover_thrust=44.0,
        thrust_exponent=0.68,
        hover_minutes=12.7,
        gyro_noise=0.0008,
        accelerometer_noise=0.03,
    ),
}
"""The airframes by name; the second is that of firmware 3.1."""


def airframe_for(profile: FirmwareProfile) -> Airframe:
    """The airframe that a virtual aircraft of some firmware has by default."""
    return AIRFRAMES[MEASURED if profile.generation >= Generation.V3_1 else "document"]


def read_airframe(name: str) -> Airframe:
    """The airframe of a name in :data:`AIRFRAMES`, or of a TOML file.

    The keys of a file are fields of :class:`Airframe`; ``base`` names the airframe that has the
    other numbers, ``document`` without it.

    Raises:
        UsageError: There is no such airframe, or the file is not one.
    """
    if name in AIRFRAMES:
        return AIRFRAMES[name]
    try:
        content = read_toml(read_path(name).read_bytes())
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no airframe {name}: {error}", remedy=f"name {' or '.join(AIRFRAMES)}, or a TOML file"
        ) from error
    base = content.pop("base", "document")
    if not isinstance(base, str) or base not in AIRFRAMES:
        raise UsageError(
            f"{name}: no airframe is called {base!r}", remedy=f"base: {', '.join(AIRFRAMES)}"
        )
    for key, value in content.items():
        if key not in RANGES or type(value) not in (int, float):
            raise UsageError(
                f"{name}: {key} = {value!r} is no number of an airframe",
                remedy=f"numbers: {', '.join(RANGES)}",
            )
    try:
        return replace(AIRFRAMES[base], **{key: float(value) for key, value in content.items()})
    except UsageError as error:
        raise UsageError(f"{name}: {error.seen}", remedy=error.remedy) from None


# -- dynamics --------------------------------------------------------------------------------------

GRAVITY = 9.80665
STEPS_PER_SECOND = 100  # one step is one period of the fastest telemetry rate
STEP_S = 1.0 / STEPS_PER_SECOND


class ModelHorizontal(IntEnum):
    """The meaning of the two horizontal values of a :class:`DynamicsInput`."""

    TILT = 0  # roll and pitch in radians
    VELOCITY = 1  # m/s
    POSITION = 2  # a place: metres north and east of the origin
    BRAKE = 3  # stop, then hold the place where it stopped


class ModelVertical(IntEnum):
    """The meaning of the vertical value of a :class:`DynamicsInput`."""

    VELOCITY = 0  # m/s, up
    HEIGHT = 1  # metres above the ground at the origin
    THRUST = 2  # percent of full thrust


class ModelYaw(IntEnum):
    """The meaning of the yaw value of a :class:`DynamicsInput`."""

    ANGLE = 0  # radians from north, clockwise
    RATE = 1  # radians per second, clockwise


# Python 3.11 finds no member in its class in less than 0.07 µs, and each step asks for all of them.
_TILT, _VELOCITY, _POSITION, _BRAKE = ModelHorizontal
_CLIMB, _HEIGHT, _THRUST = ModelVertical
_ANGLE, _RATE = ModelYaw


@dataclass(slots=True, eq=False)
class DynamicsInput:
    """The guidance that the aircraft follows now. The three modes name the kinds of its values."""

    horizontal: ModelHorizontal = _BRAKE  # kind of ``a`` and ``b``
    a: float = 0.0  # roll, or north / forward
    b: float = 0.0  # pitch, or east / right
    _: KW_ONLY
    body: bool = False  # measure ``a`` and ``b`` along the nose (True) or along north (False)
    vertical: ModelVertical = _CLIMB
    up: float = 0.0  # vertical velocity, height or thrust
    yaw_mode: ModelYaw = _RATE
    yaw: float = 0.0  # yaw angle or rate
    smooth: bool = False  # change speed gently (stable mode)
    steep: bool = False  # tilt as far as the airframe can, and not only as in cruise


@dataclass(init=False, slots=True, eq=False, repr=False)
class Dynamics:
    """The state of motion and :meth:`step`, which moves it on by :data:`STEP_S`."""

    airframe: Airframe
    north: float  # metres from the origin
    east: float
    height: float  # the ground is at 0
    velocity_north: float  # m/s
    velocity_east: float
    velocity_up: float
    # m/s², without gravity: the derivative of the velocity.
    acceleration_north: float
    acceleration_east: float
    acceleration_up: float
    roll: float  # radians
    pitch: float
    yaw: float  # -pi to pi
    # Body rates about the forward, right and down axes, rad/s.
    rate_x: float
    rate_y: float
    rate_z: float
    motors_on: bool  # with motors off nothing moves; in the air, it falls
    on_ground: bool  # while the landing gear carries it
    thrust: float  # percent of full thrust now
    hover_thrust: float  # percent of full thrust that carries it now, by its battery
    wind_north: float  # velocity of the air in m/s; set at any time
    wind_east: float
    touchdown_speed: float  # vertical speed of the last contact with the ground, m/s, positive
    _roll_rate: float
    _pitch_rate: float
    _yaw_rate: float
    _brake: bool
    _hold_north: float
    _hold_east: float
    _tilt_decay: float
    _tilt_stretch: float
    _tilt_pull: float
    _tilt_damping: float
    _vertical_gain: float
    _yaw_settle: float
    _cruise_pull: float
    _steepest_pull: float

    def __init__(self, airframe: Airframe | None = None, *, yaw_deg: float = 0.0) -> None:
        """Stand on the ground at the origin, motors off, the nose towards ``yaw_deg``."""
        self.airframe = airframe or Airframe()
        self.hover_thrust = self.airframe.hover_thrust
        self.wind_north = self.wind_east = 0.0
        self.yaw = wrapped(math.radians(yaw_deg))
        self.north = self.east = self.height = 0.0
        self.touchdown_speed = 0.0
        self.motors_on = False
        self.on_ground = True
        self._settle()
        # Exact solutions over one step: of the attitude (decay and stretch, pull and damping), and
        # of the first-order lags of climb and yaw rate. A step response measured at the sample
        # times is therefore the closed form, whatever the step.
        w, ratio = self.airframe.tilt_frequency, self.airframe.tilt_damping
        root = w * cmath.sqrt(ratio * ratio - 1.0)
        fade = exp(-ratio * w * STEP_S)
        along = cmath.cosh(root * STEP_S).real
        across = (cmath.sinh(root * STEP_S) / root).real if root else STEP_S
        self._tilt_decay = fade * (along + ratio * w * across)
        self._tilt_stretch = fade * across
        self._tilt_pull = -fade * w * w * across
        self._tilt_damping = fade * (along - ratio * w * across)
        lag = self.airframe.vertical_time_constant
        self._vertical_gain = (1.0 - exp(-STEP_S / lag)) / STEP_S
        self._yaw_settle = exp(-STEP_S / self.airframe.yaw_time_constant)
        self._cruise_pull = GRAVITY * tan(self.airframe.cruise_tilt_deg * (pi / 180.0))
        self._steepest_pull = GRAVITY * tan(self.airframe.steepest_tilt_deg * (pi / 180.0))

    def _settle(self) -> None:
        self.velocity_north = self.velocity_east = self.velocity_up = 0.0
        self.acceleration_north = self.acceleration_east = self.acceleration_up = 0.0
        self.roll = self.pitch = 0.0
        self.rate_x = self.rate_y = self.rate_z = 0.0
        self._roll_rate = self._pitch_rate = self._yaw_rate = 0.0
        self.thrust = 0.0
        # Braking has come to its end: from now on it holds this place.
        self._brake = False
        self._hold_north = self.north
        self._hold_east = self.east

    def place(self, north: float, east: float, height: float = 0.0, yaw_deg: float = 0.0) -> None:
        """Put the aircraft somewhere, at rest and level (hovering if height is above 0)."""
        self.north, self.east, self.height = north, east, max(0.0, height)
        self.yaw = wrapped(math.radians(yaw_deg))
        self._settle()
        self.on_ground = height <= 0.0
        self.motors_on = not self.on_ground

    def resume(
        self,
        attitude: tuple[float, float, float],  # roll, pitch, yaw, rad
        turning: tuple[float, float, float],  # their derivatives, rad/s
        velocity: tuple[float, float, float],  # north, east, up, m/s
    ) -> None:
        """Fly on where it is from a state of motion that was seen elsewhere."""
        self.roll, self.pitch, yaw = attitude
        self.yaw = wrapped(yaw)
        self._roll_rate, self._pitch_rate, self._yaw_rate = turning
        self.velocity_north, self.velocity_east, self.velocity_up = velocity

    def step(self, guidance: DynamicsInput) -> None:
        """Move on by :data:`STEP_S` towards ``guidance``."""
        if not self.motors_on:
            if not self.on_ground:
                self._fall()
            return
        self._turn(guidance)
        lift = self._lift(guidance)
        if self.on_ground:
            if lift <= GRAVITY:  # too little to leave the ground, which also takes every side force
                self._stand()
                return
            self.on_ground = False
        cos_yaw, sin_yaw = cos(self.yaw), sin(self.yaw)
        if guidance.horizontal == _TILT:
            self._brake = False  # the next order that brakes holds the place where it stops then
            roll, pitch = self._commanded_tilt(guidance, cos_yaw, sin_yaw)
        else:
            roll, pitch = self._tilt_for(guidance, lift, cos_yaw, sin_yaw)
        self._tilt(roll, pitch)
        self._move(lift, cos_yaw, sin_yaw)

    # --- the three axes ---------------------------------------------------------------------

    def _turn(self, guidance: DynamicsInput) -> None:
        airframe = self.airframe
        limit = airframe.yaw_rate_deg * (pi / 180.0)
        wanted = guidance.yaw
        if guidance.yaw_mode == _ANGLE:
            wanted = airframe.yaw_gain * wrapped(wanted - self.yaw)
        if wanted > limit:
            wanted = limit
        elif wanted < -limit:
            wanted = -limit
        if self.on_ground:
            wanted = 0.0
        lead = (self._yaw_rate - wanted) * self._yaw_settle
        rate = wanted + lead
        before = self._yaw_rate
        if rate or before:
            lag = airframe.yaw_time_constant
            self.yaw = wrapped(self.yaw + wanted * STEP_S + (before - wanted - lead) * lag)
            self._yaw_rate = rate

    def _lift(self, guidance: DynamicsInput) -> float:
        """Vertical part of the thrust per mass, m/s²: gravity when the height is to stay."""
        airframe = self.airframe
        level = cos(self.roll) * cos(self.pitch)
        vertical = guidance.vertical
        if vertical == _THRUST:
            self.thrust = min(100.0, max(0.0, guidance.up))
            share: float = (self.thrust / self.hover_thrust) ** airframe.thrust_exponent
            lift = GRAVITY * share * level
            return lift - airframe.vertical_drag * self.velocity_up
        limit = airframe.vertical_speed
        wanted = guidance.up
        if vertical == _HEIGHT:
            wanted = airframe.height_gain * (wanted - self.height)
        if wanted > limit:
            wanted = limit
        elif wanted < -limit:
            wanted = -limit
        acceleration = (wanted - self.velocity_up) * self._vertical_gain
        limit = airframe.vertical_acceleration
        if acceleration > limit:
            acceleration = limit
        elif acceleration < -limit:
            acceleration = -limit
        share = (acceleration / GRAVITY + 1.0) / level
        self.thrust = self.hover_thrust * share ** (1.0 / airframe.thrust_exponent)
        return GRAVITY + acceleration

    def _commanded_tilt(
        self, guidance: DynamicsInput, cos_yaw: float, sin_yaw: float
    ) -> tuple[float, float]:
        roll, pitch = guidance.a, guidance.b
        if not guidance.body:
            # Ground frame: roll tilts to the east, pitch about the axis that points east.
            roll, pitch = (
                roll * cos_yaw + pitch * sin_yaw,
                pitch * cos_yaw - roll * sin_yaw,
            )
        limit = self.airframe.maximum_tilt_deg * (pi / 180.0)
        return min(limit, max(-limit, roll)), min(limit, max(-limit, pitch))

    def _tilt_for(
        self, guidance: DynamicsInput, lift: float, cos_yaw: float, sin_yaw: float
    ) -> tuple[float, float]:
        """Roll and pitch that make the acceleration which velocity and position control want."""
        airframe = self.airframe
        north, east = self._wanted_velocity(guidance, cos_yaw, sin_yaw)
        gain, drag = airframe.velocity_gain, airframe.drag
        north = gain * (north - self.velocity_north)
        east = gain * (east - self.velocity_east)
        if guidance.smooth:
            north, east = _at_most(airframe.smooth_braking, north, east)
        north, east = _at_most(
            self._steepest_pull if guidance.steep else self._cruise_pull,
            north + drag * (self.velocity_north - self.wind_north),
            east + drag * (self.velocity_east - self.wind_east),
        )
        if lift < 1.0:
            lift = 1.0
        forward = north * cos_yaw + east * sin_yaw
        right = east * cos_yaw - north * sin_yaw
        pitch = -atan(forward / lift)
        return atan(right * cos(pitch) / lift), pitch

    def _wanted_velocity(
        self, guidance: DynamicsInput, cos_yaw: float, sin_yaw: float
    ) -> tuple[float, float]:
        airframe = self.airframe
        horizontal = guidance.horizontal
        if horizontal == _VELOCITY:
            self._brake = False
            a, b = guidance.a, guidance.b
            if guidance.body:
                return a * cos_yaw - b * sin_yaw, a * sin_yaw + b * cos_yaw
            return a, b
        if horizontal == _POSITION:
            self._brake = False
            target_north, target_east = guidance.a, guidance.b
        else:
            if not self._brake:
                # Aim for where it will stand: braking from speed v takes about v / gain.
                square = self.velocity_north**2 + self.velocity_east**2
                if square > 0.09:
                    return 0.0, 0.0
                self._brake = True
                stop = 1.0 / airframe.velocity_gain
                self._hold_north = self.north + self.velocity_north * stop
                self._hold_east = self.east + self.velocity_east * stop
            target_north, target_east = self._hold_north, self._hold_east
        north = airframe.position_gain * (target_north - self.north)
        east = airframe.position_gain * (target_east - self.east)
        return _at_most(airframe.position_speed, north, east)

    # --- motion -----------------------------------------------------------------------------

    def _tilt(self, roll: float, pitch: float) -> None:
        decay, stretch = self._tilt_decay, self._tilt_stretch
        pull, damping = self._tilt_pull, self._tilt_damping
        error, rate = self.roll - roll, self._roll_rate
        self.roll = roll + decay * error + stretch * rate
        self._roll_rate = roll_rate = pull * error + damping * rate
        error, rate = self.pitch - pitch, self._pitch_rate
        self.pitch = pitch + decay * error + stretch * rate
        self._pitch_rate = pitch_rate = pull * error + damping * rate
        cos_roll, sin_roll = cos(self.roll), sin(self.roll)
        yaw_rate = self._yaw_rate
        sideways = yaw_rate * cos(self.pitch)
        self.rate_x = roll_rate - yaw_rate * sin(self.pitch)
        self.rate_y = pitch_rate * cos_roll + sideways * sin_roll
        self.rate_z = sideways * cos_roll - pitch_rate * sin_roll

    def _move(self, lift: float, cos_yaw: float, sin_yaw: float) -> None:
        drag = self.airframe.drag
        forward = -lift * tan(self.pitch)
        right = lift * tan(self.roll) / cos(self.pitch)
        velocity = self.velocity_north
        acceleration = forward * cos_yaw - right * sin_yaw - drag * (velocity - self.wind_north)
        self.acceleration_north = acceleration
        self.velocity_north = after = velocity + acceleration * STEP_S
        self.north += (velocity + after) * (0.5 * STEP_S)
        velocity = self.velocity_east
        acceleration = forward * sin_yaw + right * cos_yaw - drag * (velocity - self.wind_east)
        self.acceleration_east = acceleration
        self.velocity_east = after = velocity + acceleration * STEP_S
        self.east += (velocity + after) * (0.5 * STEP_S)
        velocity = self.velocity_up
        acceleration = lift - GRAVITY
        self.acceleration_up = acceleration
        self.velocity_up = after = velocity + acceleration * STEP_S
        self.height += (velocity + after) * (0.5 * STEP_S)
        if self.height <= 0.0:
            self._touch_down()

    def _touch_down(self) -> None:
        self.touchdown_speed = max(0.0, -self.velocity_up)
        self.height = 0.0
        self._stand()
        self.on_ground = True

    def _stand(self) -> None:
        thrust = self.thrust
        self._settle()
        self.thrust = thrust

    def _fall(self) -> None:
        """Motors off in the air: ballistic, with drag, as it was tilted."""
        drag = self.airframe.drag
        self.thrust = 0.0
        self._roll_rate = self._pitch_rate = self._yaw_rate = 0.0
        self.rate_x = self.rate_y = self.rate_z = 0.0
        north, east, up = self.velocity_north, self.velocity_east, self.velocity_up
        self.acceleration_north = -drag * (north - self.wind_north)
        self.acceleration_east = -drag * (east - self.wind_east)
        self.acceleration_up = -GRAVITY
        self.velocity_north = north + self.acceleration_north * STEP_S
        self.velocity_east = east + self.acceleration_east * STEP_S
        self.velocity_up = up - GRAVITY * STEP_S
        self.north += (north + self.velocity_north) * (0.5 * STEP_S)
        self.east += (east + self.velocity_east) * (0.5 * STEP_S)
        self.height += (up + self.velocity_up) * (0.5 * STEP_S)
        if self.height <= 0.0:
            self._touch_down()

    # --- views ------------------------------------------------------------------------------

    def quaternion(self) -> tuple[float, float, float, float]:
        """The attitude, scalar first, ground (north, east, down) to body (forward, right, down)."""
        return quaternion(self.roll, self.pitch, self.yaw)

    @property
    def speed(self) -> float:
        """Horizontal speed over ground, m/s."""
        return sqrt(self.velocity_north**2 + self.velocity_east**2)


def _at_most(limit: float, north: float, east: float) -> tuple[float, float]:
    """The vector, shortened to a length."""
    square = north * north + east * east
    if square <= limit * limit:
        return north, east
    shrink = limit / sqrt(square)
    return north * shrink, east * shrink


def wrapped(angle: float) -> float:
    """The same direction in -pi to pi."""
    if -pi <= angle <= pi:
        return angle
    return math.remainder(angle, 2.0 * pi)
