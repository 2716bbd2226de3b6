"""Messages of ROS 2 as bytes: CDR made of their definitions, and read by them.

Messages that are sent a hundred times a second go through a :class:`Template`: it encodes once all
that does not change, and fills in numbers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from struct import Struct, calcsize, error, pack, unpack_from
from typing import Any, NamedTuple

_HEAD = b"\x00\x01\x00\x00"  # CDR, little-endian

_MOST = 65536  # values of a sequence and bytes of a text that are read: nothing here has more

_EMPTY = "uint8 structure_needs_at_least_one_member"
"""The field that rosidl puts into a message without fields."""

# Letter of struct, and number of the type in a type description.
_SCALARS = {
    "bool": ("?", 15),
    "int8": ("b", 2),
    "uint8": ("B", 3),
    "byte": ("B", 16),
    "int16": ("h", 4),
    "uint16": ("H", 5),
    "int32": ("i", 6),
    "uint32": ("I", 7),
    "int64": ("q", 8),
    "uint64": ("Q", 9),
    "float32": ("f", 10),
    "float64": ("d", 11),
}
_STRING, _BOUNDED_STRING = 17, 21
_NESTED = 1
_ARRAY, _BOUNDED, _SEQUENCE = 48, 96, 144


class _Field(NamedTuple):
    name: str
    type: str
    many: int | None  # None: one; 0: as many as there are
    most: int  # of a sequence with a bound, else 0
    longest: int  # of a string with a bound, else 0


@cache
def _fields(name: str) -> tuple[_Field, ...]:
    if name not in DEFINITIONS:
        raise LookupError(f"DEFINITIONS has no row for {name}")
    made = []
    for line in (DEFINITIONS[name] or _EMPTY).splitlines():
        kind, field = line.split()
        kind, bracket, many = kind.partition("[")
        many = many.rstrip("]")
        kind, _, longest = kind.partition("<=")
        most = int(many.removeprefix("<=")) if many.startswith("<=") else 0
        count = (0 if most else int(many or 0)) if bracket else None
        made.append(_Field(field, kind, count, most, int(longest or 0)))
    return tuple(made)


def full_name(name: str) -> str:
    """The name as rosidl has it: ``sensor_msgs/msg/Imu``."""
    package, _, rest = name.partition("/")
    return name if "/" in rest else f"{package}/msg/{rest}"


def _nested_in(name: str) -> dict[str, None]:
    """The messages in a message, and in those, in the order of its fields."""
    found: dict[str, None] = {}

    def look(one: str) -> None:
        for field in _fields(one):
            if field.type in DEFINITIONS and field.type not in found:
                found[field.type] = None
                look(field.type)

    look(name)
    return found


def definition(name: str) -> str:
    """The text of a message and of all that stand in it, as a bag holds it."""
    line = "=" * 80
    parts = [DEFINITIONS[name]]
    parts += (f"MSG: {one}\n{DEFINITIONS[one]}" for one in _nested_in(name))
    return f"\n{line}\n".join(parts) + "\n"


def describe(name: str) -> dict[str, Any]:
    """A type and all that stand in it, as type_description_interfaces/TypeDescription.

    Defaults, which do not count in hashes, are left out.
    """
    return {
        "type_description": _described(name),
        "referenced_type_descriptions": [
            _described(one) for one in sorted(_nested_in(name), key=full_name)
        ],
    }


@cache
def type_hash(name: str) -> str:
    """The hash of a type by REP 2011, ``RIHS01_…``, which ROS 2 compares to tell types apart."""
    return f"RIHS01_{hashlib.sha256(json.dumps(describe(name)).encode()).hexdigest()}"


def _described(name: str) -> dict[str, Any]:
    fields = []
    for field in _fields(name):
        nested = full_name(field.type) if field.type in DEFINITIONS else ""
        number = _NESTED if nested else _BOUNDED_STRING if field.longest else _STRING
        if field.type in _SCALARS:
            number = _SCALARS[field.type][1]
        if field.many is not None:
            number += _BOUNDED if field.most else _ARRAY if field.many else _SEQUENCE
        kind = {
            "type_id": number,
            "capacity": field.most or field.many or 0,
            "string_capacity": field.longest,
            "nested_type_name": nested,
        }
        fields.append({"name": field.name, "type": kind})
    return {"type_name": full_name(name), "fields": fields}


# -- writing --------------------------------------------------------------------------------------


class _Leaf(NamedTuple):
    path: str
    letter: str
    offset: int  # behind the header


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """A message as CDR, little-endian, with its header.

    ``message``: its fields by name; nested messages are mappings. Raises ``ValueError``: an array
    has another length.
    """
    body = bytearray()
    _message(body, name, message, "", [])
    return _HEAD + bytes(body)


def _message(
    body: bytearray, name: str, message: Mapping[str, Any], path: str, leaves: list[_Leaf]
) -> None:
    for field in _fields(name):
        if not DEFINITIONS[name]:
            _value(body, field.type, 0, path, leaves)
            continue
        value = message[field.name]
        inner = f"{path}{field.name}."
        if field.many is None:
            _value(body, field.type, value, inner, leaves)
            continue
        if field.many == 0:
            _value(body, "uint32", len(value), f"{inner}#", leaves)
        elif len(value) != field.many:
            raise ValueError(f"{name}.{field.name} has {field.many} values, not {len(value)}")
        for place, each in enumerate(value):
            _value(body, field.type, each, f"{inner}{place}.", leaves)


def _value(body: bytearray, kind: str, value: Any, path: str, leaves: list[_Leaf]) -> None:
    if kind == "string":
        data = value.encode() + b"\0"
        _value(body, "uint32", len(data), f"{path}#", leaves)
        body += data
    elif kind in _SCALARS:
        letter = _SCALARS[kind][0]
        size = calcsize(f"<{letter}")
        body += bytes(-len(body) % size)
        leaves.append(_Leaf(path, letter, len(body)))
        body += pack(f"<{letter}", value)
    else:
        _message(body, kind, value, path, leaves)


class Template:
    """A message of which only some numbers change.

    ``message``: all fields, with any numbers where they change. ``changing``: what changes: fields
    by their path (``header.stamp``), a whole message or array at once. Texts and lengths stay.
    Raises ``ValueError``: there is nothing of that path.
    """

    def __init__(self, name: str, message: Mapping[str, Any], *changing: str) -> None:
        body = bytearray()
        leaves: list[_Leaf] = []
        _message(body, name, message, "", leaves)
        self._data = _HEAD + bytes(body)
        self._runs = [self._run(leaves, f"{path}.") for path in changing]

    @staticmethod
    def _run(leaves: list[_Leaf], path: str) -> tuple[Callable[..., None], int]:
        inside = [one for one in leaves if one.path.startswith(path)]
        wanted = inside[1:] if inside and inside[0].path.endswith("#") else inside
        if not wanted or any("#" in one.path for one in wanted):
            raise ValueError(f"there are no numbers at {path}")
        layout, end = "<", wanted[0].offset
        for one in wanted:
            layout += f"{one.offset - end}x{one.letter}"
            end = one.offset + calcsize(f"<{one.letter}")
        return Struct(layout).pack_into, wanted[0].offset + len(_HEAD)

    def fill(self, *values: Sequence[Any]) -> bytes:
        """The message with these numbers: a row of them for each path, in their order."""
        data = bytearray(self._data)
        for (pack_into, offset), row in zip(self._runs, values, strict=True):
            pack_into(data, offset, *row)
        return bytes(data)


# -- reading --------------------------------------------------------------------------------------


def decode(name: str, data: bytes) -> dict[str, Any]:
    """A message of somebody else; bytes behind it are ignored.

    ``data``: CDR, little-endian, with its header. Raises ``ValueError``: it is not one.
    """
    if data[:2] != _HEAD[:2]:
        raise ValueError(f"not CDR as ROS 2 writes it: {data[:4].hex()}")
    try:
        found, _ = _read_message(name, data[len(_HEAD) :], 0)
    except error as cut:
        raise ValueError(f"{name} is cut off: {cut}") from None
    return found


def _read_message(name: str, body: bytes, at: int) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    for field in _fields(name):
        if field.many is None:
            found[field.name], at = _read(field.type, body, at)
            continue
        count = field.many
        if not count:
            count, at = _read("uint32", body, at)
            if count > (field.most or _MOST):
                raise ValueError(f"{name}.{field.name} has {count} values")
        values = []
        for _ in range(count):
            value, at = _read(field.type, body, at)
            values.append(value)
        found[field.name] = values
    return found if DEFINITIONS[name] else {}, at


def _read(kind: str, body: bytes, at: int) -> tuple[Any, int]:
    if kind == "string":
        length, at = _read("uint32", body, at)
        text = body[at : at + length]
        if not 0 < length <= _MOST or len(text) < length or text[-1]:
            raise ValueError("a text that does not end")
        return text[:-1].decode("utf-8", "replace"), at + length
    if kind not in _SCALARS:
        return _read_message(kind, body, at)
    layout = f"<{_SCALARS[kind][0]}"
    size = calcsize(layout)
    at += -at % size
    return unpack_from(layout, body, at)[0], at + size


# -- definitions of the messages of ROS 2 that are written and read here ---------------------------
# Field by field as rosidl has them, of Humble to the newest (own ones: as in ``m100_msgs``);
# constants, which do not travel, are left out. A message is called ``package/Name``, a part of a
# service or an action ``package/srv/Name_Request``.


OWN_PACKAGE = "m100_msgs"  # the package of messages that nobody else has

_STANDARD = {
    "action_msgs/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp",
    "action_msgs/GoalStatus": "action_msgs/GoalInfo goal_info\nint8 status",
    "action_msgs/GoalStatusArray": "action_msgs/GoalStatus[] status_list",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\n"
    "diagnostic_msgs/DiagnosticStatus[] status",
    "diagnostic_msgs/DiagnosticStatus": "byte level\nstring name\nstring message\n"
    "string hardware_id\ndiagnostic_msgs/KeyValue[] values",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/QuaternionStamped": "std_msgs/Header header\n"
    "geometry_msgs/Quaternion quaternion",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
    "nav_msgs/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "rcl_interfaces/Log": "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
    "string file\nstring function\nuint32 line",
    "rcl_interfaces/FloatingPointRange": "float64 from_value\nfloat64 to_value\nfloat64 step",
    "rcl_interfaces/IntegerRange": "int64 from_value\nint64 to_value\nuint64 step",
    "rcl_interfaces/ListParametersResult": "string[] names\nstring[] prefixes",
    "rcl_interfaces/Parameter": "string name\nrcl_interfaces/ParameterValue value",
    "rcl_interfaces/ParameterDescriptor": "string name\nuint8 type\nstring description\n"
    "string additional_constraints\nbool read_only\nbool dynamic_typing\n"
    "rcl_interfaces/FloatingPointRange[<=1] floating_point_range\n"
    "rcl_interfaces/IntegerRange[<=1] integer_range",
    "rcl_interfaces/ParameterValue": "uint8 type\nbool bool_value\nint64 integer_value\n"
    "float64 double_value\nstring string_value\nbyte[] byte_array_value\n"
    "bool[] bool_array_value\nint64[] integer_array_value\nfloat64[] double_array_value\n"
    "string[] string_array_value",
    "rcl_interfaces/SetParametersResult": "bool successful\nstring reason",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
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
    "service_msgs/ServiceEventInfo": "uint8 event_type\nbuiltin_interfaces/Time stamp\n"
    "uint8[16] client_gid\nint64 sequence_number",
    "std_msgs/Float32": "float32 data",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "std_msgs/UInt8": "uint8 data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "type_description_interfaces/Field": "string name\n"
    "type_description_interfaces/FieldType type\nstring default_value",
    "type_description_interfaces/FieldType": "uint8 type_id\nuint64 capacity\n"
    "uint64 string_capacity\nstring<=255 nested_type_name",
    "type_description_interfaces/IndividualTypeDescription": "string<=255 type_name\n"
    "type_description_interfaces/Field[] fields",
    "type_description_interfaces/KeyValue": "string key\nstring value",
    "type_description_interfaces/TypeDescription": (
        "type_description_interfaces/IndividualTypeDescription type_description\n"
        "type_description_interfaces/IndividualTypeDescription[] referenced_type_descriptions"
    ),
    "type_description_interfaces/TypeSource": "string type_name\nstring encoding\n"
    "string raw_file_contents",
    "unique_identifier_msgs/UUID": "uint8[16] uuid",
}

_OWN = {
    f"{OWN_PACKAGE}/FlightStatus": "std_msgs/Header header\nuint8 phase\nbool has_authority\n"
    "string holder\nstring task\nstring mode_switch\nuint8 gps_health\nuint8 battery_percent\n"
    "string firmware\nstring connection",
    f"{OWN_PACKAGE}/MissionAction": "uint8 kind\nfloat32 value",
    f"{OWN_PACKAGE}/MissionPoint": "float64 latitude\nfloat64 longitude\nfloat32 height\n"
    "float32 heading\nfloat32 damping\nfloat32 gimbal_pitch\nbool turn_counterclockwise\n"
    f"{OWN_PACKAGE}/MissionAction[] actions",
    f"{OWN_PACKAGE}/MissionEvent": "std_msgs/Header header\nuint8 event\nuint8[5] data",
    f"{OWN_PACKAGE}/Waypoint": "float64 latitude\nfloat64 longitude\nfloat32 height\nfloat32 wait",
}

_RESULT = "bool success\nstring message"

SERVICES = {
    f"{OWN_PACKAGE}/srv/PointGimbal": (
        (
            "float32 yaw\nfloat32 pitch\nfloat32 roll\nbool is_relative\nbool keep_yaw\n"
            "bool keep_pitch\nbool keep_roll\nfloat32 duration"
        ),
        _RESULT,
    ),
    f"{OWN_PACKAGE}/srv/StartMission": ("bool take_off", _RESULT),
    f"{OWN_PACKAGE}/srv/UploadMission": (
        (
            f"{OWN_PACKAGE}/MissionPoint[] points\nfloat32 speed\nfloat32 max_speed\n"
            "uint8 heading\nuint8 trace\nuint8 at_end\nuint8 on_rc_loss\n"
            "bool gimbal_by_point\nuint8 repeat"
        ),
        _RESULT,
    ),
    "action_msgs/srv/CancelGoal": (
        "action_msgs/GoalInfo goal_info",
        "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
    ),
    "rcl_interfaces/srv/DescribeParameters": (
        "string[] names",
        "rcl_interfaces/ParameterDescriptor[] descriptors",
    ),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/srv/GetParameters": (
        "string[] names",
        "rcl_interfaces/ParameterValue[] values",
    ),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult result",
    ),
    "std_srvs/srv/Trigger": ("", _RESULT),
    "type_description_interfaces/srv/GetTypeDescription": (
        "string type_name\nstring type_hash\nbool include_type_sources",
        (
            "bool successful\nstring failure_reason\n"
            "type_description_interfaces/TypeDescription type_description\n"
            "type_description_interfaces/TypeSource[] type_sources\n"
            "type_description_interfaces/KeyValue[] extra_information"
        ),
    ),
}
"""Request and response of each service."""

ACTIONS = {
    f"{OWN_PACKAGE}/action/TakeOff": ("float32 height", _RESULT, "float32 height"),
    f"{OWN_PACKAGE}/action/FlyTo": (
        "float64 latitude\nfloat64 longitude\nfloat32 height\nfloat32 speed",
        _RESULT,
        "float32 distance\nfloat32 seconds",
    ),
    f"{OWN_PACKAGE}/action/FlyMission": (
        f"{OWN_PACKAGE}/Waypoint[] waypoints\nfloat32 speed",
        _RESULT,
        "uint16 waypoint\nfloat32 distance\nfloat32 seconds",
    ),
}
"""Goal, result and feedback of each action."""


def _parts_of_service(name: str, request: str, response: str) -> dict[str, str]:
    request_name, response_name = f"{name}_Request", f"{name}_Response"
    event_name = f"{name}_Event"
    return {
        request_name: request,
        response_name: response,
        event_name: "service_msgs/ServiceEventInfo info\n"
        f"{request_name}[<=1] request\n{response_name}[<=1] response",
        name: f"{request_name} request_message\n{response_name} response_message\n"
        f"{event_name} event_message",
    }


def _parts_of_action(name: str, goal: str, result: str, feedback: str) -> dict[str, str]:
    identity = "unique_identifier_msgs/UUID goal_id"
    return {
        f"{name}_Goal": goal,
        f"{name}_Result": result,
        f"{name}_Feedback": feedback,
        f"{name}_FeedbackMessage": f"{identity}\n{name}_Feedback feedback",
        **_parts_of_service(
            f"{name}_SendGoal",
            f"{identity}\n{name}_Goal goal",
            "bool accepted\nbuiltin_interfaces/Time stamp",
        ),
        **_parts_of_service(f"{name}_GetResult", identity, f"int8 status\n{name}_Result result"),
    }


DEFINITIONS = {
    **_STANDARD,
    **_OWN,
    **{
        part: text
        for name, (request, response) in SERVICES.items()
        for part, text in _parts_of_service(name, request, response).items()
    },
    **{
        part: text
        for name, texts in ACTIONS.items()
        for part, text in _parts_of_action(name, *texts).items()
    },
}
"""Fields of each message, in the language of ``.msg`` files."""
