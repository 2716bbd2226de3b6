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
