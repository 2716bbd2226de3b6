"""Messages of ROS 2 as bytes: their definitions, and CDR made from them.

Field by field as rosidl has them, of Humble to the newest; constants, which do not travel, are left
out.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from struct import calcsize, pack
from typing import Any, NamedTuple

__all__ = ["DEFINITIONS", "definition", "encode"]

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
    "sensor_msgs/BatteryState": "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\n"
    "float32 current\nfloat32 charge\nfloat32 capacity\nfloat32 design_capacity\n"
    "float32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\n"
    "uint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
    "float32[] cell_temperature\nstring location\nstring serial_number",
    "sensor_msgs/Imu": "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\n"
    "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity\n"
    "float64[9] angular_velocity_covariance\ngeometry_msgs/Vector3 linear_acceleration\n"
    "float64[9] linear_acceleration_covariance",
    "sensor_msgs/Joy": "std_msgs/Header header\nfloat32[] axes\nint32[] buttons",
    "sensor_msgs/NavSatFix": "std_msgs/Header header\nsensor_msgs/NavSatStatus status\n"
    "float64 latitude\nfloat64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
    "uint8 position_covariance_type",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "std_msgs/UInt8": "uint8 data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
"""Fields of each message, in the language of ``.msg`` files."""

_LETTERS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}


class _Field(NamedTuple):
    name: str
    type: str
    many: int | None  # None: one; 0: as many as there are


@cache
def _fields(name: str) -> tuple[_Field, ...]:
    made = []
    for line in DEFINITIONS[name].splitlines():
        kind, field = line.split()
        kind, _, many = kind.partition("[")
        made.append(_Field(field, kind, int(many.rstrip("]") or 0) if many else None))
    return tuple(made)


def definition(name: str) -> str:
    """The text of a message and of all that stand in it, as a bag holds it."""
    found: dict[str, None] = {}

    def look(one: str) -> None:
        for field in _fields(one):
            if field.type in DEFINITIONS and field.type not in found:
                found[field.type] = None
                look(field.type)

    look(name)
    line = "=" * 80
    parts = [DEFINITIONS[name], *(f"MSG: {one}\n{DEFINITIONS[one]}" for one in found)]
    return f"\n{line}\n".join(parts) + "\n"


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """A message as CDR, little-endian, with its header.

    Args:
        name: Such as ``sensor_msgs/Imu``.
        message: Its fields by name; nested messages are mappings.
    """
    body = bytearray()
    _message(body, name, message)
    return b"\x00\x01\x00\x00" + bytes(body)


def _message(body: bytearray, name: str, message: Mapping[str, Any]) -> None:
    for field in _fields(name):
        value = message[field.name]
        if field.many is None:
            _value(body, field.type, value)
            continue
        if field.many == 0:
            _value(body, "uint32", len(value))
        elif len(value) != field.many:
            raise ValueError(f"{name}.{field.name} has {field.many} values, not {len(value)}")
        for each in value:
            _value(body, field.type, each)


def _value(body: bytearray, kind: str, value: Any) -> None:
    if kind == "string":
        data = value.encode() + b"\0"
        _value(body, "uint32", len(data))
        body += data
    elif kind in _LETTERS:
        size = calcsize(f"<{_LETTERS[kind]}")
        body += bytes(-len(body) % size)
        body += pack(f"<{_LETTERS[kind]}", value)
    else:
        _message(body, kind, value)
