"""The estimated state of the aircraft: the values that telemetry reports, with sensor noise.

How they travel is not its business (:mod:`m100link.sim.line`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import cycle
from random import Random
from typing import Any

from m100link.geodesy import LocalFrame
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import AccelerationMode, Device, in_body, quaternion
from m100link.sim.vehicle.dynamics import GRAVITY, STEPS_PER_SECOND
from m100link.sim.vehicle.flight import GOOD_GPS, FlightController
from m100link.sim.vehicle.gimbal import GimbalMount
from m100link.sim.vehicle.remote import ControlArbiter, PilotRemote
from m100link.sim.vehicle.settings import AircraftSettings

# -- what sensors get wrong: white noise, and errors that wander -----------------------------------


_AXES = 3
_NO_NOISE = (0.0, 0.0, 0.0)
_ALL_ZERO = (0, 0, 0, 0, 0, 0)
_TABLE = 4093  # prime, so that the columns of a packet do not repeat together


@lru_cache(maxsize=4)
def _table(state: Any) -> tuple[list[float], Any]:
    """Noise by a generator in this state, and its state then; aircraft of one seed share it."""
    (random := Random()).setstate(state)
    table = [random.gauss(0.0, 1.0) for _ in range(_TABLE)]
    return table + table[:_AXES], random.getstate()


def noise_source(random: Random) -> Callable[[], list[float]]:
    """A function that returns three samples of normal noise of unit variance, one for each axis.

    Out of a table: repeatable, and ten times as fast as drawing each sample.
    """
    table, after = _table(random.getstate())
    random.setstate(after)
    position = 0

    def sample() -> list[float]:
        nonlocal position
        begin = position + 1
        position = (position + _AXES) % _TABLE
        return table[begin : begin + _AXES]

    return sample


class Wander:
    """A first-order Gauss-Markov process: an error with a memory.

    Over a time t short against the memory it changes by deviation x sqrt(2 t / memory).

    ``deviation``: standard deviation in the long run. ``memory_s``: seconds after which 1/e of an
    error is left. ``step_s``: time from one :meth:`advance` to the next.
    """

    __slots__ = ("_keep", "_kick", "_random", "value")

    def __init__(self, random: Random, deviation: float, memory_s: float, step_s: float) -> None:
        self._random = random  # where it gets its chance from
        self._keep = math.exp(-step_s / memory_s)
        self._kick = deviation * math.sqrt(1.0 - self._keep**2)
        self.value = 0.0

    def advance(self) -> None:
        """Let one step pass."""
        self.value = self._keep * self.value + self._kick * self._random.gauss(0.0, 1.0)


# -- sensors ---------------------------------------------------------------------------------------

Values = tuple[float, ...]  # the fields of one item

# With noise = 1: decent sensors, well fused. The noise of a filtered value wanders: standard
# deviation, and memory in seconds. That of an inertial sensor is white, and its airframe has it.
_PLACE = 0.2, 60.0
_HEIGHT = 0.03, 300.0
_VELOCITY = 0.03, 3.0
_TILT = math.radians(0.2), 30.0
_HEADING = math.radians(0.6), 60.0
_FIELD = 6.0, 20.0
_POOR_GPS = 20.0  # times as far off

_TO_RADIANS = math.pi / 180.0

# The Earth's magnetic field, north and down, in the raw numbers of the item (1500 in all).
_FIELD_NORTH, _FIELD_DOWN = 1100.0, 1020.0


class _Errors:
    """The present errors of the fused values.

    A fourth of them moves on at each step, in turn: they change slowly, and draws cost time.
    """

    def __init__(self, random: Random, scale: float, step_s: float) -> None:
        def wander(of: tuple[float, float]) -> Wander:
            return Wander(random, scale * of[0], of[1], 4 * step_s)

        self.north, self.east, self.height = wander(_PLACE), wander(_PLACE), wander(_HEIGHT)
        self.velocity = wander(_VELOCITY), wander(_VELOCITY), wander(_VELOCITY)
        self.roll, self.pitch, self.yaw = wander(_TILT), wander(_TILT), wander(_HEADING)
        self.field = wander(_FIELD), wander(_FIELD), wander(_FIELD)
        place, attitude = (self.north, self.east, self.height), (self.roll, self.pitch, self.yaw)
        self._turns = cycle((place, self.velocity, attitude, self.field))

    def advance(self) -> None:
        for error in next(self._turns):
            error.advance()


class Sensors:
    """The estimated state of the aircraft: the values of every item, in its record's order."""

    def __init__(
        self,
        profile: FirmwareProfile,
        settings: AircraftSettings,
        random: Random,
        *,
        flight: FlightController,
        authority: ControlArbiter,
        remote: PilotRemote,
        gimbal: GimbalMount,
        step_s: float,
    ) -> None:
        self.ticks = 0  # steps since the autopilot started: its clock
        self._profile = profile
        self._settings = settings
        self._flight = flight
        self._motion = flight.dynamics
        self._authority = authority
        self._remote = remote
        self._gimbal = gimbal
        self._noise = noise_source(random)
        self._scale = settings.noise
        self._errors = _Errors(random, settings.noise, step_s)
        # The last quaternion read: q and -q are the same attitude, and the next one is chosen so
        # that no component jumps when the heading passes south.
        self._quaternion = (1.0, 0.0, 0.0, 0.0)
        self._down = -1.0 if settings.vertical_down else 1.0
        self._tick_hz = profile.tick_hz
        self._site = LocalFrame(settings.latitude_deg, settings.longitude_deg)

    def advance(self) -> None:
        """Let the errors wander on by ``step_s``."""
        if not self._scale:
            return
        self._errors.advance()
        if not self._motion.motors_on:
            self._errors.height.value = 0.0  # height counts from where it stands

    def reader(self, name: str) -> Callable[[], Values]:
        """The function that reads one item: every field that it has in any firmware, in order."""
        read: Callable[[], Values] = getattr(self, f"_read_{name}")
        return read

    def _read_time(self) -> Values:
        # Nobody published how the nanoseconds of 3.1 relate to the tick; here they count the
        # same time within its second.
        tick = self.ticks * self._tick_hz // STEPS_PER_SECOND & 0xFFFFFFFF
        return tick, self.ticks % STEPS_PER_SECOND * 10_000_000, 0

    def _read_quaternion(self) -> Values:
        motion, errors = self._motion, self._errors
        if self._scale:
            q = quaternion(
                motion.roll + errors.roll.value,
                motion.pitch + errors.pitch.value,
                motion.yaw + errors.yaw.value,
            )
        else:
            q = motion.quaternion()
        last = self._quaternion
        if q[0] * last[0] + q[1] * last[1] + q[2] * last[2] + q[3] * last[3] < 0.0:
            q = -q[0], -q[1], -q[2], -q[3]
        self._quaternion = q
        return q

    def _read_acceleration(self) -> Values:
        motion = self._motion
        scale = self._scale * motion.airframe.accelerometer_noise
        x, y, z = self._noise() if scale else _NO_NOISE
        if self._authority.assistant.acceleration is AccelerationMode.RAW:
            felt = self._specific_force()
            return tuple(
                (one + scale * off) / GRAVITY for one, off in zip(felt, (x, y, z), strict=True)
            )
        return (
            motion.acceleration_north + scale * x,
            motion.acceleration_east + scale * y,
            motion.acceleration_up * self._down + scale * z,
        )

    def _specific_force(self) -> Values:
        """The force per mass that keeps it from falling: forward, right, down, m/s²."""
        motion = self._motion
        q0, q1, q2, q3 = motion.quaternion()
        down = -motion.acceleration_up - GRAVITY
        ground = motion.acceleration_north, motion.acceleration_east, down
        return in_body((q1, q2, q3, q0), ground)

    def _read_velocity(self) -> Values:
        motion = self._motion
        north, east, up = motion.velocity_north, motion.velocity_east, motion.velocity_up
        up *= self._down
        status = 0
        if self._flight.gps_health >= GOOD_GPS:
            status = 0x07 if self._profile.velocity_names_sensor else 0x01  # 3 is GPS
        if not self._scale:
            return north, east, up, status
        x, y, z = self._errors.velocity
        return north + x.value, east + y.value, up + z.value, status

    def _read_angular_velocity(self) -> Values:
        motion = self._motion
        if not self._scale:
            return motion.rate_x, motion.rate_y, motion.rate_z
        scale = self._scale * motion.airframe.gyro_noise
        x, y, z = self._noise()
        return motion.rate_x + scale * x, motion.rate_y + scale * y, motion.rate_z + scale * z

    def _read_position(self) -> Values:
        motion, flight = self._motion, self._flight
        north, east, height = motion.north, motion.east, motion.height
        if self._scale:
            errors = self._errors
            worse = 1.0 if flight.gps_health >= GOOD_GPS else _POOR_GPS
            north += worse * errors.north.value
            east += worse * errors.east.value
            height += errors.height.value
        if flight.gps_health == 0:
            latitude = longitude = 0.0
        else:
            latitude, longitude = self._site.to_geodetic(north, east)
        altitude = self._settings.ground_altitude + height
        return latitude * _TO_RADIANS, longitude * _TO_RADIANS, altitude, height, flight.gps_health

    def _read_magnetometer(self) -> Values:
        motion = self._motion
        cr, sr = math.cos(motion.roll), math.sin(motion.roll)
        cp, sp = math.cos(motion.pitch), math.sin(motion.pitch)
        cy, sy = math.cos(motion.yaw), math.sin(motion.yaw)
        north, down = _FIELD_NORTH, _FIELD_DOWN
        x, y, z = self._errors.field  # at 0 without noise
        return (
            round(north * cp * cy - down * sp + x.value),
            round(north * (sr * sp * cy - cr * sy) + down * sr * cp + y.value),
            round(north * (cr * sp * cy + sr * sy) + down * cr * cp + z.value),
        )

    def _read_rc(self) -> Values:
        if self._settings.rc_lost_reads == "zeros" and not self._remote.is_connected:
            return _ALL_ZERO
        return self._remote.channels()

    def _read_gimbal(self) -> Values:
        gimbal = self._gimbal
        heading = math.degrees(self._motion.yaw) + gimbal.yaw
        if heading > 180.0:
            heading -= 360.0
        elif heading <= -180.0:
            heading += 360.0
        return gimbal.roll, gimbal.pitch, heading, gimbal.limits

    def _read_flight_status(self) -> Values:
        return (self._flight.phase,)

    def _read_battery(self) -> Values:
        return (math.ceil(self._flight.battery_percent),)

    def _read_control_device(self) -> Values:
        authority, flight = self._authority, self._flight
        control = int(authority.device)
        if self._profile.shows_authority_request and (
            authority.is_requested or authority.is_pending
        ):
            control |= 0x08
        if self._remote.virtual.is_on:
            control |= 0x10
        mode = 0
        if authority.device is Device.ONBOARD and flight.setpoint is not None:
            mode = flight.setpoint.mode.number
        return control, mode
