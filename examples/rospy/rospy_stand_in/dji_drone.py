"""The module ``dji_sdk.dji_drone`` of a program: DJI's helper for its node of 2016, by its names.

Where DJI's own file lies beside the program, that one is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rospy_stand_in import actionlib, node
from rospy_stand_in.genpy import message_class, service_class

_TOPICS = {
    "acceleration": "dji_sdk/Acceleration",
    "attitude_quaternion": "dji_sdk/AttitudeQuaternion",
    "compass": "dji_sdk/Compass",
    "flight_control_info": "dji_sdk/FlightControlInfo",
    "flight_status": "std_msgs/UInt8",
    "gimbal": "dji_sdk/Gimbal",
    "global_position": "dji_sdk/GlobalPosition",
    "local_position": "dji_sdk/LocalPosition",
    "power_status": "dji_sdk/PowerStatus",
    "rc_channels": "dji_sdk/RCChannels",
    "velocity": "dji_sdk/Velocity",
    "activation": "std_msgs/UInt8",
    "odometry": "nav_msgs/Odometry",
    "time_stamp": "dji_sdk/TimeStamp",
}

# Method, service, type, the request by the method's arguments, and what the method always sends.
_CALLS: tuple[tuple[str, str, str, tuple[str, ...], dict[str, int]], ...] = (
    ("arm_drone", "drone_arm_control", "DroneArmControl", (), {"arm": 1}),
    ("disarm_drone", "drone_arm_control", "DroneArmControl", (), {"arm": 0}),
    ("takeoff", "drone_task_control", "DroneTaskControl", (), {"task": 4}),
    ("landing", "drone_task_control", "DroneTaskControl", (), {"task": 6}),
    ("gohome", "drone_task_control", "DroneTaskControl", (), {"task": 1}),
    ("take_picture", "camera_action_control", "CameraActionControl", (), {"camera_action": 0}),
    ("start_video", "camera_action_control", "CameraActionControl", (), {"camera_action": 1}),
    ("stop_video", "camera_action_control", "CameraActionControl", (), {"camera_action": 2}),
    *(
        (f"{name}_sdk_permission_control", "sdk_permission_control", "SDKPermissionControl", (),
         {"control_enable": number})
        for name, number in (("request", 1), ("release", 0))
    ),
    *(
        (f"vrc_{name}", "virtual_rc_enable_control", "VirtualRCEnableControl", (),
         {"enable": number, "if_back_to_real": 1})
        for name, number in (("start", 1), ("stop", 0))
    ),
    ("sync_timestamp", "sync_flag_control", "SyncFlagControl", ("frequency",), {}),
    ("attitude_control", "attitude_control", "AttitudeControl", ("flag", "x", "y", "z", "yaw"), {}),
    ("velocity_control", "velocity_control", "VelocityControl",
     ("frame", "vx", "vy", "vz", "yawRate"), {}),
    ("local_position_control", "local_position_control", "LocalPositionControl",
     ("x", "y", "z", "yaw"), {}),
    ("global_position_control", "global_position_control", "GlobalPositionControl",
     ("latitude", "longitude", "altitude", "yaw"), {}),
    ("gimbal_angle_control", "gimbal_angle_control", "GimbalAngleControl",
     ("yaw", "roll", "pitch", "duration", "absolute_or_incremental", "yaw_cmd_ignore",
      "roll_cmd_ignore", "pitch_cmd_ignore"), {"absolute_or_incremental": True}),
    ("gimbal_speed_control", "gimbal_speed_control", "GimbalSpeedControl",
     ("yaw_rate", "roll_rate", "pitch_rate"), {}),
)  # fmt: skip

_NAVIGATION = {
    "local_position": ("LocalPositionNavigation", ("x", "y", "z")),
    "global_position": ("GlobalPositionNavigation", ("latitude", "longitude", "altitude")),
    "waypoint": ("WaypointNavigation", ("waypoint_list",)),
}


class DJIDrone:
    """The newest telemetry as attributes, and a method for each service and goal of the node."""

    HORIZ_ATT, HORIZ_VEL, HORIZ_POS = 0x00, 0x40, 0x80
    VERT_VEL, VERT_POS, VERT_TRU = 0x00, 0x10, 0x20
    YAW_ANG, YAW_RATE = 0x00, 0x08
    HORIZ_GND, HORIZ_BODY = 0x00, 0x02
    STABLE_OFF, STABLE_ON = 0x00, 0x01
    YAW_GND, YAW_BODY = 0x00, 0x01  # of version 2.3

    def __init__(self, namespace: str = "") -> None:
        node.init_node("dji_sdk_connector")
        self.namespace = namespace
        for name, kind in _TOPICS.items():
            setattr(self, name, message_class(kind)())
            taken = partial(setattr, self, name)
            node.Subscriber(f"dji_sdk/{name}", message_class(kind), taken)
        self._clients = {
            name: actionlib.SimpleActionClient(
                f"dji_sdk/{name}_navigation_action", message_class(f"dji_sdk/{kind}Action")
            )
            for name, (kind, _) in _NAVIGATION.items()
        }
        for name, client in self._clients.items():
            client.wait_for_server()
            setattr(self, f"{name}_navigation_action_client", client)

    def vrc_control(
        self, roll: int = 1024, pitch: int = 1024, throttle: int = 1024, yaw: int = 1024,
        gear: int = 1324, mode: int = 496,
    ) -> None:  # fmt: skip
        channels = [roll, pitch, throttle, yaw, gear, 0, mode, *[0] * 9]
        kind = service_class("dji_sdk/VirtualRCDataControl")
        node.ServiceProxy("dji_sdk/virtual_rc_data_control", kind)(channel_data=channels)


def _caller(
    service: str, kind: str, names: tuple[str, ...], always: dict[str, int]
) -> Callable[..., Any]:
    def call(self: DJIDrone, *values: Any, **named: Any) -> Any:
        request = always | dict(zip(names, values, strict=False)) | named
        return node.ServiceProxy(f"dji_sdk/{service}", service_class(f"dji_sdk/{kind}"))(**request)

    return call


def _navigator(name: str, kind: str, names: tuple[str, ...]) -> Callable[..., Any]:
    def send(self: DJIDrone, *values: Any, **named: Any) -> None:
        given = dict(zip(names, values, strict=False)) | named
        if name == "waypoint":
            there = message_class("dji_sdk/WaypointList")(waypoint_list=given["waypoint_list"])
            given = {"waypoint_list": there}
        self._clients[name].send_goal(message_class(f"dji_sdk/{kind}Goal")(**given))

    return send


for _method, _service, _kind, _names, _always in _CALLS:
    setattr(DJIDrone, _method, _caller(_service, _kind, _names, _always))
for _name, (_kind, _names) in _NAVIGATION.items():
    setattr(DJIDrone, f"{_name}_navigation_send_request", _navigator(_name, _kind, _names))
