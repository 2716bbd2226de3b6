"""Definitions of the messages of ROS 2 that are written and read here.

Field by field as rosidl has them, of Humble to the newest (own ones: as in ``m100_msgs``);
constants, which do not travel, are left out. A message is called ``package/Name``, a part of a
service or an action ``package/srv/Name_Request``.
"""

from __future__ import annotations

__all__ = ["ACTIONS", "DEFINITIONS", "OWN_PACKAGE", "SERVICES"]

OWN_PACKAGE = "m100_msgs"
"""The package of messages that nobody else has."""

_STANDARD = {
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
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "std_msgs/UInt8": "uint8 data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}

_OWN = {
    f"{OWN_PACKAGE}/FlightStatus": "std_msgs/Header header\nuint8 phase\nbool has_authority\n"
    "string holder\nstring task\nstring mode_switch\nuint8 gps_health\nuint8 battery_percent\n"
    "string firmware\nstring connection",
}

SERVICES = {
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
}
"""Request and response of each service."""

ACTIONS: dict[str, tuple[str, str, str]] = {}
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


DEFINITIONS = {
    **_STANDARD,
    **_OWN,
    **{
        part: text
        for name, (request, response) in SERVICES.items()
        for part, text in _parts_of_service(name, request, response).items()
    },
}
"""Fields of each message, in the language of ``.msg`` files."""
