"""Numbers of MAVLink that the bridge uses, by their names in the public definitions."""

from __future__ import annotations

from enum import IntEnum, IntFlag

from m100link.missions.qgroundcontrol import MavCommand as MavCommand

AUTOPILOT_GENERIC, AUTOPILOT_PX4 = 0, 12  # MAV_AUTOPILOT


class MavResult(IntEnum):
    """MAV_RESULT: what becomes of a command."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class ParamError(IntEnum):
    """MAV_PARAM_ERROR: why a parameter was not read or set."""

    DOES_NOT_EXIST = 1
    VALUE_OUT_OF_RANGE = 2
    PERMISSION_DENIED = 3
    READ_ONLY = 5


class Severity(IntEnum):
    """MAV_SEVERITY: of texts."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class SystemStatus(IntEnum):
    """MAV_STATE."""

    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5


class BaseMode(IntFlag):
    """MAV_MODE_FLAG."""

    CUSTOM = 1
    AUTO = 4
    GUIDED = 8
    MANUAL = 64
    ARMED = 128


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Sensor(IntFlag):
    """MAV_SYS_STATUS_SENSOR: those that the aircraft tells of."""

    GYRO = 0x01
    ACCELEROMETER = 0x02
    MAGNETOMETER = 0x04
    GPS = 0x20
    RC = 0x10000
    GEOFENCE = 0x100000
    PREARM = 0x10000000


class Estimator(IntFlag):
    """ESTIMATOR_STATUS_FLAGS: those that are ever set here."""

    ATTITUDE = 0x1
    VELOCITY_HORIZ = 0x2
    VELOCITY_VERT = 0x4
    POS_HORIZ_ABS = 0x10
    POS_VERT_ABS = 0x20
    GPS_GLITCH = 0x400


class Capability(IntFlag):
    """MAV_PROTOCOL_CAPABILITY: those that are there."""

    MISSION_INT = 0x4
    COMMAND_INT = 0x8
    PARAM_ENCODE_BYTEWISE = 0x10
    FTP = 0x20
    SET_ATTITUDE_TARGET = 0x40
    SET_POSITION_TARGET_LOCAL_NED = 0x80
    MAVLINK2 = 0x2000
    MISSION_FENCE = 0x4000


class CameraCap(IntFlag):
    """CAMERA_CAP_FLAGS: those that are ever set here."""

    CAPTURE_VIDEO = 1
    CAPTURE_IMAGE = 2
    CAN_CAPTURE_VIDEO_IN_IMAGE_MODE = 16


class GimbalCap(IntFlag):
    """GIMBAL_MANAGER_CAP_FLAGS and GIMBAL_DEVICE_CAP_FLAGS: those that are set here."""

    HAS_NEUTRAL = 0x2
    HAS_ROLL_AXIS = 0x4
    HAS_ROLL_LOCK = 0x10
    HAS_PITCH_AXIS = 0x20
    HAS_PITCH_LOCK = 0x80
    HAS_YAW_AXIS = 0x100
    HAS_YAW_FOLLOW = 0x200
    HAS_YAW_LOCK = 0x400
    SUPPORTS_YAW_IN_EARTH_FRAME = 0x1000
    CAN_POINT_LOCATION_GLOBAL = 0x20000


class GimbalFlag(IntFlag):
    """GIMBAL_MANAGER_FLAGS and GIMBAL_DEVICE_FLAGS: those with a meaning here."""

    RETRACT = 1
    NEUTRAL = 2
    ROLL_LOCK = 4
    PITCH_LOCK = 8
    YAW_LOCK = 16
    YAW_IN_VEHICLE_FRAME = 32
    YAW_IN_EARTH_FRAME = 64
    ACCEPTS_YAW_IN_EARTH_FRAME = 128


class MavFrame(IntEnum):
    """MAV_FRAME: what coordinates count from."""

    GLOBAL = 0
    LOCAL_NED = 1
    MISSION = 2
    GLOBAL_RELATIVE_ALT = 3
    GLOBAL_INT = 5
    GLOBAL_RELATIVE_ALT_INT = 6
    BODY_NED = 8
    BODY_OFFSET_NED = 9
    BODY_FRD = 12


SEA_LEVEL = (MavFrame.GLOBAL, MavFrame.GLOBAL_INT)
RELATIVE = (MavFrame.GLOBAL_RELATIVE_ALT, MavFrame.GLOBAL_RELATIVE_ALT_INT)


class MissionType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2
    ALL = 255


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15
