"""The table of what the node offers: topics out, topics in, services.

The manual's table is made from it. Names are private to the node (``~/imu``), global, or those of
REP 105 and 107.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from m100link.apps.agent import orders
from m100link.apps.ros2.graph import Qos
from m100link.log.cdr import encode
from m100link.log.ros2 import DJI_TOPICS, DjiTopic, Stamp
from m100link.telemetry.sample import Sample

SENSOR = Qos(is_reliable=False)
STATE = Qos(is_latched=True, depth=1)
EVENTS = Qos(depth=100)


@dataclass(frozen=True, slots=True)
class Output:
    kind: str
    qos: Qos  # its quality of service
    hz: float  # messages per second at most; 0 where they come when there is something to say
    text: str  # what it is, for the manual


OUTPUTS: Mapping[str, Output] = {
    "~/imu": Output(
        "sensor_msgs/Imu",
        SENSOR,
        50,
        "attitude, angular velocity, and acceleration in the body, with gravity",
    ),
    "~/fix": Output(
        "sensor_msgs/NavSatFix",
        SENSOR,
        10,
        "position by GPS; the altitude is by the barometer",
    ),
    "~/home": Output(
        "sensor_msgs/NavSatFix",
        STATE,
        0,
        "the place of take-off; the pilot may move the home point",
    ),
    "~/odom": Output(
        "nav_msgs/Odometry",
        SENSOR,
        50,
        "pose from where GPS was good first, height above take-off; motion in the body",
    ),
    "~/pose": Output("geometry_msgs/PoseStamped", SENSOR, 50, "the same pose"),
    "~/velocity": Output(
        "geometry_msgs/TwistStamped", SENSOR, 50, "velocity over ground, east, north, up"
    ),
    "~/battery": Output(
        "sensor_msgs/BatteryState", SENSOR, 1, "percentage; the wire has no voltage and no current"
    ),
    "~/magnetic_field": Output(
        "sensor_msgs/MagneticField", SENSOR, 10, "direction in the body; its size is nominal"
    ),
    "~/joy": Output(
        "sensor_msgs/Joy", SENSOR, 20, "the remote: roll, pitch, yaw, throttle; switch, gear"
    ),
    "~/gimbal": Output(
        "geometry_msgs/QuaternionStamped", SENSOR, 20, "orientation of the camera over ground"
    ),
    "~/flight_status": Output(
        "m100_msgs/FlightStatus", STATE, 1, "phase, who has control, what flies; at each change"
    ),
    "~/mission_event": Output(
        "m100_msgs/MissionEvent", EVENTS, 0, "events of a mission that the aircraft flies by itself"
    ),
    "/tf": Output("tf2_msgs/TFMessage", EVENTS, 50, "odom to base_link"),
    "/tf_static": Output("tf2_msgs/TFMessage", STATE, 0, "map to odom, which are the same"),
    "/diagnostics": Output(
        "diagnostic_msgs/DiagnosticArray", Qos(), 1, "line, clock, control, battery, this node"
    ),
    "/rosout": Output(
        "rcl_interfaces/Log", Qos(is_latched=True, depth=100), 0, "events of the aircraft"
    ),
    "/clock": Output(
        "rosgraph_msgs/Clock", Qos(is_reliable=False, depth=1), 50, "only from a virtual aircraft"
    ),
}
"""By name."""


@dataclass(frozen=True, slots=True)
class Taken:
    kind: str
    text: str  # what it does, for the manual
    ends: type[orders.Order] | None = None  # the order by which it ends something


INPUTS: Mapping[str, Taken] = {
    "~/cmd_vel": Taken(
        "geometry_msgs/TwistStamped",
        "fly at this velocity for 0.3 s: forward, left, up in base_link; east, north, up in odom "
        "or map; turn about the axis that points up",
    ),
    "~/cmd_vel_unstamped": Taken("geometry_msgs/Twist", "the same in base_link, without a header"),
    "~/setpoint_position": Taken(
        "geometry_msgs/PoseStamped",
        "fly towards this place in odom or map for 0.3 s, and turn to its heading",
    ),
    "~/gimbal_speed": Taken(
        "geometry_msgs/Vector3Stamped",
        "turn the camera for half a second, rad/s about forward, left, up (firmware 2.3 on)",
    ),
}
"""By name."""


_TRIGGER = "std_srvs/srv/Trigger"

SERVICES: Mapping[str, Taken] = {
    "~/obtain_control": Taken(_TRIGGER, "take the lease, activate, obtain control authority"),
    "~/release_control": Taken(
        _TRIGGER, "give both back: the aircraft hovers, the pilot flies", orders.Release
    ),
    "~/takeoff": Taken(_TRIGGER, "start the motors and climb to about 1.2 m"),
    "~/land": Taken(_TRIGGER, "land in place; control is given back on the ground", orders.Land),
    "~/go_home": Taken(_TRIGGER, "fly to the home point and land there", orders.GoHome),
    "~/arm": Taken(_TRIGGER, "start the motors on the ground"),
    "~/disarm": Taken(_TRIGGER, "stop the motors on the ground", orders.StopMotors),
    "~/stop": Taken(
        _TRIGGER,
        "stop everything, for any client; setpoints fly again after ~/obtain_control",
        orders.Stop,
    ),
    "~/take_photo": Taken(_TRIGGER, "take a photograph; unconfirmed"),
    "~/start_video": Taken(_TRIGGER, "start video; unconfirmed"),
    "~/stop_video": Taken(_TRIGGER, "stop video; unconfirmed"),
    "~/point_gimbal": Taken(
        "m100_msgs/srv/PointGimbal", "point the camera (firmware 2.3 on); unconfirmed"
    ),
    "~/mission/upload": Taken(
        "m100_msgs/srv/UploadMission", "check a plan for the aircraft's own missions (3.1)"
    ),
    "~/mission/start": Taken(
        "m100_msgs/srv/StartMission", "upload the plan to the aircraft, which flies it by itself"
    ),
    "~/mission/pause": Taken(_TRIGGER, "pause the mission in a hover", orders.PauseMission),
    "~/mission/resume": Taken(_TRIGGER, "resume the mission"),
    "~/mission/stop": Taken(_TRIGGER, "end the mission: the aircraft hovers", orders.StopMission),
}
"""By name."""


# -- topics by the names and types of DJI's ``dji_sdk`` node, for programs that expect them --------


DJI_OUTPUTS: Mapping[str, Output] = {
    f"dji_sdk/{name}": Output(DJI_TOPICS[name].kind, SENSOR, hz, text)
    for name, hz, text in (
        ("attitude", 50, "attitude, body over ground"),
        ("imu", 50, "as ~/imu"),
        ("gps_position", 50, "as ~/fix"),
        ("gps_health", 50, "0 to 5"),
        ("height_above_takeoff", 50, "m"),
        ("velocity", 50, "over ground"),
        ("angular_velocity_fused", 50, "in the body"),
        ("acceleration_ground_fused", 50, "without gravity"),
        ("rc", 50, "roll, pitch, yaw, throttle, mode, gear as axes"),
        ("gimbal_angle", 50, "roll, pitch, yaw in degrees"),
        ("flight_status", 50, "numbered as on the wire"),
        ("battery_state", 10, "as ~/battery, with a percentage of 0 to 100, as DJI's node has it"),
    )
}
"""By name, relative to the namespace of the node."""


def _encoded(topic: DjiTopic, sample: Sample, stamp: Stamp) -> bytes | None:
    message = topic.make(sample)
    if message is not None and topic.frame is not None:
        seconds, nanoseconds = stamp
        time = {"sec": seconds, "nanosec": nanoseconds}
        message["header"] = {"stamp": time, "frame_id": topic.frame}
    return None if message is None else encode(topic.kind, message)


def dji_makers() -> dict[str, Callable[[Sample, Stamp], bytes | None]]:
    """The maker of each of :data:`DJI_OUTPUTS` from a package; None where it has nothing for it."""
    return {f"dji_sdk/{name}": partial(_encoded, topic) for name, topic in DJI_TOPICS.items()}
