"""A flight log as a bag of ROS 2: an MCAP file with its messages in CDR.

The ground is ``map``, the body ``base_link``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import IO, Any, NamedTuple

from m100link.errors import BadSetpoint
from m100link.log.cdr import Template, definition, encode, full_name
from m100link.log.channels import COMMAND, EVENT
from m100link.log.reading import FlightLog
from m100link.log.records import mcap_module
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Velocity,
    in_body,
    quaternion,
)
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReceivedMove,
    ReferenceFrame,
    Vertical,
    Yaw,
)
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample

# -- an aircraft's state as messages of ROS 2: for flight logs, and for live listeners -------------
# Frames and units of REP 103 and 105: east, north, up on the ground; forward, left, up in the body.
# Values that the wire does not carry are marked as unknown, as each message defines it.


Stamp = tuple[int, int]  # seconds and nanoseconds of POSIX time

Vector = tuple[float, float, float]

_GRAVITY_M_S2 = 9.80665
_NO_FIX, _FIX, _GPS = -1, 0, 1
_NOT_KNOWN, _APPROXIMATED = 0, 1  # covariance types of NavSatFix
_TESLA = 32e-9  # for each raw unit: DJI calls 1000 to 2000 normal, and the Earth has 25 to 65 µT
_STICK = 10_000.0
_ZERO = (0.0, 0.0, 0.0)
_LEVEL = (0.0, 0.0, 0.0, 1.0)
_UNKNOWN = [0.0] * 9
_NOT_THERE = [-1.0] + [0.0] * 8  # as sensor_msgs/Imu says it
_VECTOR = dict.fromkeys("xyz", 0.0)
_ROTATION = dict.fromkeys("xyzw", 0.0)
_TWIST = {"linear": _VECTOR, "angular": _VECTOR}
_TRANSFORM = {"translation": _VECTOR, "rotation": _ROTATION}
_POSE = {"position": _VECTOR, "orientation": _ROTATION}
_FIX_MESSAGE: dict[str, Any] = {
    "status": {"status": 0, "service": _GPS},
    **dict.fromkeys(("latitude", "longitude", "altitude"), 0.0),
    "position_covariance": _UNKNOWN,
    "position_covariance_type": 0,
}
_BATTERY: dict[str, Any] = {
    **dict.fromkeys(("voltage", "temperature", "current"), math.nan),
    **dict.fromkeys(("charge", "capacity", "design_capacity"), math.nan),
    "percentage": math.nan,
    **{f"power_supply_{what}": 0 for what in ("status", "health", "technology")},
    "present": True,
    **{"cell_voltage": [], "cell_temperature": [], "location": "", "serial_number": ""},
}


class Deviations(NamedTuple):
    """Standard deviations for the covariances, because the wire has none. 0: unknown.

    They are what PX4 and ArduPilot take for aircraft of this kind, so that a filter does not
    believe a value for certain. Nobody has measured them on an M100.
    """

    position_m: float = 2.5  # horizontal; GPS alone, and what telemetry checks allow
    height_m: float = 2.0  # of a barometer: EK3_ALT_M_NSE
    velocity_m_s: float = 0.3  # EKF2_GPS_V_NOISE
    tilt_rad: float = 0.1  # of roll and pitch: EKF2_ANGERR_INIT
    heading_rad: float = 0.3  # EKF2_HEAD_NOISE
    rates_rad_s: float = 0.015  # EKF2_GYR_NOISE
    acceleration_m_s2: float = 0.35  # EKF2_ACC_NOISE


def _diagonal(*deviations: float) -> list[float]:
    """A covariance matrix without correlations, by rows."""
    size = len(deviations)
    made = [0.0] * size**2
    made[:: size + 1] = [one**2 for one in deviations]
    return made


def _header(frame: str) -> Mapping[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def _charge(battery: Battery) -> float:
    return battery.percent / 100.0 if battery.is_possible else math.nan


class Messages:
    """Makes the messages, with the names of two frames.

    ``ground``: frame of what is east, north, up. ``body``: frame of what is forward, left, up.
    """

    def __init__(self, ground: str, body: str) -> None:
        self.ground, self.body = ground, body
        made = self._stamped
        twist, vector = ("twist.linear", "twist.angular"), "geometry_msgs/Vector3Stamped"
        self._velocity = made("geometry_msgs/TwistStamped", ground, *twist, twist=_TWIST)
        self._acceleration = made(vector, ground, "vector", vector=_VECTOR)
        pose = ("pose.position", "pose.orientation")
        self._pose = made("geometry_msgs/PoseStamped", ground, *pose, pose=_POSE)
        named = {"header": _header(ground), "child_frame_id": body, "transform": _TRANSFORM}
        parts = ("header.stamp", "transform.translation", "transform.rotation")
        changing = (f"transforms.0.{part}" for part in parts)
        self._transform = Template("tf2_msgs/TFMessage", {"transforms": [named]}, *changing)
        magnetic = {"magnetic_field": _VECTOR, "magnetic_field_covariance": _UNKNOWN}
        self._magnetometer = made("sensor_msgs/MagneticField", body, "magnetic_field", **magnetic)
        turned = {"quaternion": _ROTATION}
        self._gimbal = made("geometry_msgs/QuaternionStamped", ground, "quaternion", **turned)
        self._battery = made("sensor_msgs/BatteryState", body, "percentage", **_BATTERY)
        self._imus: dict[tuple[bool, ...], Template] = {}
        self._attitude: Attitude | None = None
        self._rotation = _LEVEL
        self.deviate(Deviations())

    def deviate(self, of: Deviations) -> None:
        """Have these standard deviations in the covariances from now on."""
        turned = of.tilt_rad, of.tilt_rad, of.heading_rad
        where = of.position_m, of.position_m, of.height_m
        moves, rates = (of.velocity_m_s,) * 3, (of.rates_rad_s,) * 3
        self._covariances = {
            "orientation": _diagonal(*turned),
            "angular_velocity": _diagonal(*rates),
            "linear_acceleration": _diagonal(*(of.acceleration_m_s2,) * 3),
        }
        self._imus.clear()
        self._is_known = of.position_m > 0.0
        place = ("status.status", "latitude", "longitude", "altitude", "position_covariance_type")
        about = _FIX_MESSAGE | {"position_covariance": _diagonal(*where)}
        self._fix = self._stamped("sensor_msgs/NavSatFix", self.body, *place, **about)
        self._odometry = self._stamped(
            *("nav_msgs/Odometry", self.ground),
            *("pose.pose.position", "pose.pose.orientation", "twist.twist"),
            child_frame_id=self.body,
            pose={"pose": _POSE, "covariance": _diagonal(*where, *turned)},
            twist={"twist": _TWIST, "covariance": _diagonal(*moves, *rates)},
        )

    def _stamped(self, name: str, frame: str, /, *changing: str, **message: Any) -> Template:
        """A message with a header, whose time changes as well."""
        message = {"header": _header(frame), **message}
        return Template(name, message, "header.stamp", *changing)

    def _turned(self, attitude: Attitude) -> tuple[float, float, float, float]:
        """The attitude for ROS; four messages of a package have the same one."""
        if attitude is not self._attitude:
            self._attitude, self._rotation = attitude, attitude.enu_flu_xyzw
        return self._rotation

    # -- position and motion ---------------------------------------------------------------------

    def fix(self, stamp: Stamp, position: Position) -> bytes:
        """sensor_msgs/NavSatFix; the altitude is the aircraft's, by its barometer."""
        place = (position.latitude_deg,), (position.longitude_deg,), (position.altitude_m,)
        is_there = has_fix(position)
        kind = _APPROXIMATED if is_there and self._is_known else _NOT_KNOWN
        return self._fix.fill(stamp, (_FIX if is_there else _NO_FIX,), *place, (kind,))

    def velocity(self, stamp: Stamp, velocity: Velocity) -> bytes:
        """geometry_msgs/TwistStamped over ground; it does not turn there."""
        return self._velocity.fill(stamp, velocity.enu, _ZERO)

    def acceleration(self, stamp: Stamp, acceleration: Acceleration) -> bytes:
        """geometry_msgs/Vector3Stamped over ground, without gravity."""
        return self._acceleration.fill(stamp, acceleration.enu)

    def odometry(
        self,
        stamp: Stamp,
        place: Vector,  # east, north, up of the origin, m
        attitude: Attitude,  # how it is turned
        velocity: Velocity,
        rates: AngularVelocity,  # about the body axes
    ) -> bytes:
        """nav_msgs/Odometry: the pose over ground, the motion in body axes."""
        turned = self._turned(attitude)
        motion = (*in_body(turned, velocity.enu), *_flu(rates))
        return self._odometry.fill(stamp, place, turned, motion)

    def pose(self, stamp: Stamp, place: Vector, attitude: Attitude) -> bytes:
        """geometry_msgs/PoseStamped over ground; the place as in :meth:`odometry`."""
        return self._pose.fill(stamp, place, self._turned(attitude))

    def transform(self, stamp: Stamp, place: Vector, attitude: Attitude) -> bytes:
        """tf2_msgs/TFMessage from the ground to the body; the place as in :meth:`odometry`."""
        return self._transform.fill(stamp, place, self._turned(attitude))

    # -- sensors ---------------------------------------------------------------------------------

    def _imu(self, *known: bool) -> Template:
        """The message in which so much is known: attitude, rates, acceleration."""
        template = self._imus.get(known)
        if template is None:
            names = ("orientation", "angular_velocity", "linear_acceleration")
            covariances = {
                f"{name}_covariance": self._covariances[name] if one else _NOT_THERE
                for name, one in zip(names, known, strict=True)
            }
            empty = dict(zip(names, (_ROTATION, _VECTOR, _VECTOR), strict=True))
            message = {**empty, **covariances}
            template = self._stamped("sensor_msgs/Imu", self.body, *names, **message)
            self._imus[known] = template
        return template

    def imu(
        self,
        stamp: Stamp,
        attitude: Attitude | None,
        rates: AngularVelocity | None,
        acceleration: Acceleration | None,
    ) -> bytes:
        """sensor_msgs/Imu; the acceleration is what a sensor in the body feels, with gravity."""
        turned = None if attitude is None else self._turned(attitude)
        felt = None
        if turned is not None and acceleration is not None:
            east, north, up = acceleration.enu
            felt = in_body(turned, (east, north, up + _GRAVITY_M_S2))
        return self._imu(turned is not None, rates is not None, felt is not None).fill(
            stamp, turned or _LEVEL, _ZERO if rates is None else _flu(rates), felt or _ZERO
        )

    def magnetometer(self, stamp: Stamp, found: Magnetometer) -> bytes:
        """sensor_msgs/MagneticField, forward, left, up: its direction counts, its size is nominal.

        The raw numbers have no unit.
        """
        forward, right, down = (_TESLA * one for one in found)
        return self._magnetometer.fill(stamp, (forward, -right, -down))

    def gimbal(self, stamp: Stamp, gimbal: Gimbal) -> bytes:
        """geometry_msgs/QuaternionStamped: how the camera is turned over ground."""
        angles = gimbal.roll_deg, gimbal.pitch_deg, gimbal.yaw_deg
        turned = Attitude(*quaternion(*map(math.radians, angles)))
        return self._gimbal.fill(stamp, turned.enu_flu_xyzw)

    def battery(self, stamp: Stamp, battery: Battery) -> bytes:
        """sensor_msgs/BatteryState: the wire has the percentage alone; NaN beyond 100 %."""
        return self._battery.fill(stamp, (_charge(battery),))

    def joy(self, stamp: Stamp, rc: RemoteControl) -> bytes:
        """sensor_msgs/Joy of the remote: roll, pitch, yaw, throttle; mode switch and gear raw.

        Firmware that does not tell the gear leaves that button away.
        """
        header = {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}, "frame_id": self.body}
        sticks = [one / _STICK for one in (rc.roll, rc.pitch, rc.yaw, rc.throttle)]
        switches = [one for one in (rc.mode, rc.gear) if one is not None]
        return encode("sensor_msgs/Joy", {"header": header, "axes": sticks, "buttons": switches})


def _flu(rates: AngularVelocity) -> Vector:
    return (rates.forward_rad_s, -rates.right_rad_s, -rates.down_rad_s)


# -- what DJI's own node ``dji_sdk`` tells, by its names: for ROS 1 and ROS 2 ----------------------
# Frames and units are those of that node: degrees of the wire for the gimbal, mode and gear raw in
# ``rc``.

DJI_GROUND, DJI_BODY = "ground_ENU", "body_FLU"


class DjiTopic(NamedTuple):
    """A topic of that node, as a package of telemetry fills it."""

    kind: str
    frame: str | None  # of its header; None where it has none
    # The message without its header; None where the package has nothing for it.
    make: Callable[[Sample], dict[str, Any] | None]


def _of(item: str, make: Callable[[Any], dict[str, Any]]) -> Callable[[Sample], Any]:
    def made(sample: Sample) -> dict[str, Any] | None:
        record = getattr(sample, item)
        return None if record is None else make(record)

    return made


def _vector_of(
    frame: str, item: str, read: Callable[[Any], Vector] = attrgetter("enu")
) -> DjiTopic:
    make = _of(item, lambda record: {"vector": _named(read(record))})
    return DjiTopic("geometry_msgs/Vector3Stamped", frame, make)


def _named(values: tuple[float, ...]) -> dict[str, float]:
    return dict(zip("xyzw", values, strict=False))


def _dji_imu(sample: Sample) -> dict[str, Any] | None:
    attitude, rates, ground = sample.attitude, sample.angular_velocity, sample.acceleration
    if attitude is None or rates is None or ground is None:
        return None
    # An accelerometer feels what keeps the aircraft from falling: gravity is added.
    east, north, up = ground.enu
    made = {
        "orientation": attitude.enu_flu_xyzw,
        "angular_velocity": _flu(rates),
        "linear_acceleration": in_body(attitude.enu_flu_xyzw, (east, north, up + _GRAVITY_M_S2)),
    }
    unknown = {f"{name}_covariance": _UNKNOWN for name in made}
    return {name: _named(values) for name, values in made.items()} | unknown


def _dji_fix(position: Position) -> dict[str, Any]:
    return _FIX_MESSAGE | {
        "status": {"status": _FIX if has_fix(position) else _NO_FIX, "service": _GPS},
        "latitude": position.latitude_deg,
        "longitude": position.longitude_deg,
        "altitude": position.altitude_m,
    }


def _dji_health(sample: Sample) -> dict[str, Any] | None:
    health = sample.position and sample.position.gps_health
    return None if health is None else {"data": health}


def _dji_remote(rc: RemoteControl) -> dict[str, Any]:
    sticks = [one / _STICK for one in (rc.roll, rc.pitch, rc.yaw, rc.throttle)]
    axes = [*sticks, float(rc.mode), math.nan if rc.gear is None else float(rc.gear)]
    return {"axes": axes, "buttons": []}


def battery_state(battery: Battery, whole: float = 1.0) -> dict[str, Any]:
    """A ``sensor_msgs/BatteryState``; ``whole``: the percentage of a full battery."""
    return _BATTERY | {"percentage": whole * _charge(battery)}


DJI_TOPICS: Mapping[str, DjiTopic] = {
    "attitude": DjiTopic(
        *("geometry_msgs/QuaternionStamped", DJI_BODY),
        _of("attitude", lambda one: {"quaternion": _named(one.enu_flu_xyzw)}),
    ),
    "imu": DjiTopic("sensor_msgs/Imu", DJI_BODY, _dji_imu),
    "gps_position": DjiTopic("sensor_msgs/NavSatFix", "gps", _of("position", _dji_fix)),
    "gps_health": DjiTopic("std_msgs/UInt8", None, _dji_health),
    "height_above_takeoff": DjiTopic(
        "std_msgs/Float32", None, _of("position", lambda one: {"data": one.height_m})
    ),
    "velocity": _vector_of(DJI_GROUND, "velocity"),
    "angular_velocity_fused": _vector_of(DJI_BODY, "angular_velocity", _flu),
    "acceleration_ground_fused": _vector_of(DJI_GROUND, "acceleration"),
    "rc": DjiTopic("sensor_msgs/Joy", "rc", _of("remote_control", _dji_remote)),
    "gimbal_angle": _vector_of(
        DJI_GROUND, "gimbal", attrgetter("roll_deg", "pitch_deg", "yaw_deg")
    ),
    "flight_status": DjiTopic(
        "std_msgs/UInt8", None, _of("flight_status", lambda one: {"data": one.status})
    ),
    # 0 to 1 is the standard; DJI's node puts 0 to 100 there.
    "battery_state": DjiTopic(
        *("sensor_msgs/BatteryState", ""), _of("battery", lambda one: battery_state(one, 100.0))
    ),
}
"""By its name below ``dji_sdk/``."""


def joy_move(flag: int, x: float, y: float, z: float, yaw: float) -> ReceivedMove:
    """A movement command from ROS frames (DJI's ``flight_control_setpoint_*`` topics).

    ``x``: east or forward (m, m/s), or roll (rad). ``y``: north or left (m, m/s), or pitch (rad, as
    DJI's node has it: negated). ``z``: up (m, m/s) or thrust (%). ``yaw``: counter-clockwise from
    east (rad), or rate (rad/s).

    Raises ``BadSetpoint``: the flag names no mode or no frame.
    """
    try:
        horizontal, vertical = Horizontal(flag >> 6 & 3), Vertical(flag >> 4 & 3)
    except ValueError:
        raise BadSetpoint(f"control flag 0x{flag:02X} names no control mode") from None
    if flag & 0x04:
        raise BadSetpoint(f"control flag 0x{flag:02X} names no frame: its bit 2 is reserved")
    yaw_mode, frame = Yaw(flag >> 3 & 1), ReferenceFrame(flag >> 1 & 1)
    if horizontal is Horizontal.TILT:
        first, second, frame = math.degrees(x), math.degrees(-y), ReferenceFrame.BODY
    elif frame is ReferenceFrame.GROUND:
        first, second = y, x
    else:
        first, second = x, -y
    if yaw_mode is Yaw.RATE:
        turn = math.degrees(-yaw)
    else:
        turn = math.remainder(90.0 - math.degrees(yaw), 360.0)
    return ReceivedMove(ControlMode(horizontal, vertical, yaw_mode), first, second, z, turn, frame)


# -- ros2 ------------------------------------------------------------------------------------------

TOPICS = {
    "/m100/fix": "sensor_msgs/NavSatFix",
    "/m100/imu": "sensor_msgs/Imu",
    "/m100/velocity": "geometry_msgs/TwistStamped",
    "/m100/acceleration": "geometry_msgs/Vector3Stamped",
    "/m100/battery": "sensor_msgs/BatteryState",
    "/m100/joy": "sensor_msgs/Joy",
    "/m100/flight_status": "std_msgs/UInt8",
    "/m100/events": "std_msgs/String",
    "/tf": "tf2_msgs/TFMessage",
}
"""The content of a bag: topic and message."""

_MESSAGES = Messages("map", "base_link")
_OF_ONE_RECORD: tuple[tuple[str, type[Any], Callable[[Stamp, Any], bytes]], ...] = (
    ("/m100/velocity", Velocity, _MESSAGES.velocity),
    ("/m100/acceleration", Acceleration, _MESSAGES.acceleration),
    ("/m100/battery", Battery, _MESSAGES.battery),
    ("/m100/joy", RemoteControl, _MESSAGES.joy),
    (
        "/m100/flight_status",
        FlightStatus,
        lambda _, status: encode("std_msgs/UInt8", {"data": status.status}),
    ),
)


def write_bag(
    flight: FlightLog, stream: IO[bytes], *, firmware: str | FirmwareProfile | None = None
) -> int:
    """Write a bag that ``rosbags``, ``ros2 bag`` and Foxglove read.

    A message per package and item, with the time at which the package arrived; what a package does
    not have is not made up. Commands, answers and events are JSON on ``/m100/events``.

    Args:
        flight: The log.
        stream: The file that takes the bytes.
        firmware: As for :meth:`FlightLog.samples`.

    Returns:
        How many messages.
    """
    writer: Any = mcap_module("writer").Writer(stream)
    writer.start(profile="ros2", library="m100link log ros2")
    channels = {}
    for topic, name in TOPICS.items():
        schema = writer.register_schema(full_name(name), "ros2msg", definition(name).encode())
        channels[topic] = writer.register_channel(
            topic, "cdr", schema, {"offered_qos_profiles": ""}
        )
    count = 0
    for topic, at_ns, data in _messages(flight, firmware):
        writer.add_message(
            channel_id=channels[topic],
            log_time=at_ns,
            publish_time=at_ns,
            data=data,
        )
        count += 1
    writer.finish()
    return count


def _messages(
    flight: FlightLog, firmware: str | FirmwareProfile | None
) -> Iterator[tuple[str, int, bytes]]:
    for message in flight.messages(COMMAND, EVENT):
        text = encode("std_msgs/String", {"data": message.data.decode("utf-8", "replace")})
        yield "/m100/events", max(0, round(message.utc * 1e9)), text
    first = next(flight.messages(), None)
    if first is None:
        return
    offset = first.utc - first.at
    for sample in flight.samples(firmware=firmware):
        at_ns = max(0, round((sample.received_at + offset) * 1e9))
        for topic, data in _messages_of(sample, divmod(at_ns, 10**9)):
            yield topic, at_ns, data


def _messages_of(sample: Sample, stamp: Stamp) -> Iterator[tuple[str, bytes]]:
    made = _MESSAGES
    position, attitude = sample.get(Position), sample.get(Attitude)
    if position is not None:
        yield "/m100/fix", made.fix(stamp, position)
    rates, acceleration = sample.get(AngularVelocity), sample.get(Acceleration)
    if attitude is not None or rates is not None:
        yield "/m100/imu", made.imu(stamp, attitude, rates, acceleration)
    if attitude is not None and position is not None and position.is_possible:
        yield "/tf", made.transform(stamp, (0.0, 0.0, position.height_m), attitude)
    for topic, kind, make in _OF_ONE_RECORD:
        record = sample.get(kind)
        if record is not None:
            yield topic, make(stamp, record)
