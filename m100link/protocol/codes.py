"""Ack codes as enums: each knows what it means, its likely cause and what to do.

A code that no source lists keeps its number: ``ActivationCode(77)`` is a member-like value whose
name says that it is unknown. The system codes 0xFF00 to 0xFF02 can replace the code of any command
of the sets 0x00 and 0x01, so every enum knows them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Self

__all__ = [
    "AckCode",
    "ActivationCode",
    "ArmCode",
    "AuthorityCode",
    "MissionCode",
    "MobileDataCode",
    "RatesCode",
    "SystemCode",
    "TaskResultCode",
    "TaskStartCode",
    "VersionCode",
]


class AckCode(IntEnum):
    """Base of the ack-code enums; an ``int`` with ``meaning``, ``cause`` and ``remedy``.

    Attributes:
        meaning: The statement of the aircraft that this code stands for.
        cause: The usual reason for it, or an empty string.
        remedy: The remedy, or an empty string.
    """

    meaning: str
    cause: str
    remedy: str

    def __new__(cls, value: int, meaning: str = "", cause: str = "", remedy: str = "") -> Self:
        """A member from its row in the class body."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.meaning, member.cause, member.remedy = meaning, cause, remedy
        return member

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        if not isinstance(value, int) or not 0 <= value <= 0xFFFF:
            return None
        if cls is not SystemCode and value in SystemCode._value2member_map_:
            system = SystemCode(value)
            name, text = system.name, (system.meaning, system.cause, system.remedy)
        else:
            name = f"UNKNOWN_0x{value:04X}"
            text = (
                f"a code that no published source lists (0x{value:04X})",
                "a firmware that is not among the known profiles",
                "note the firmware version and the number; please report both",
            )
        member = int.__new__(cls, value)
        member._value_, member._name_ = value, name
        member.meaning, member.cause, member.remedy = text
        return member

    @property
    def is_system(self) -> bool:
        """One of the codes that can replace any command's own (high byte 0xFF)."""
        return self >> 8 == 0xFF

    @property
    def is_known(self) -> bool:
        """False for a number that no source lists."""
        return not self.name.startswith("UNKNOWN_")


class SystemCode(AckCode):
    """Codes that can stand in the place of any command's own."""

    NOT_SUPPORTED = (
        0xFF00,
        "command not supported, or it could not be decrypted",
        "the firmware does not have this command, or the keys on both sides differ",
        "compare the firmware version; if other encrypted commands fail too, activate again",
    )
    NOT_ACTIVATED = (
        0xFF01,
        "the aircraft is not activated for this app",
        "activation was not done since power-on, or it failed",
        "activate first",
    )
    LEVEL_TOO_LOW = (
        0xFF02,
        "the authorization level of this app id is too low for the command",
        "flight control needs level 2",
        "apply for the level at the developer site and activate again",
    )


class VersionCode(AckCode):
    """Ack of the version query; the version is filled in whatever the code says (errata 18)."""

    ACTIVATED = 0x0000, "activated"


class ActivationCode(AckCode):
    """Ack of the activation request (document 2.2.1.2)."""

    SUCCESS = 0, "activated"
    INVALID_PARAMETERS = (
        1,
        "the request has the wrong length or parameters",
        "another firmware than the chosen profile",
        "let the profile be chosen from the version answer",
    )
    ENCRYPTED = (
        2,
        "the request was encrypted, or could not be recognised",
        "activation travels plain: the aircraft has no key yet",
        "send it plain; this library always does",
    )
    NEW_DEVICE = (
        3,
        "first activation of this aircraft; it is asking DJI's server",
        "normal on a new aircraft or app id; if it stays: no internet at the phone, or no login",
        "open the DJI app, log in, give it internet, and try again after some seconds",
    )
    APP_NOT_CONNECTED = (
        4,
        "the DJI app does not answer",
        "no mobile device at the remote controller, or the app is not open",
        "connect the mobile device to the remote controller and open the DJI app",
    )
    NO_INTERNET = (
        5,
        "the DJI app has no internet",
        "the server is reached through the mobile device",
        "give the mobile device internet access",
    )
    SERVER_REFUSED = (
        6,
        "the server refused",
        "unknown app id, wrong key, or the app id has reached its device limit (DAN, 5 by default)",
        "check app id and key; ask for a higher limit at the developer site",
    )
    LEVEL_TOO_HIGH = (
        7,
        "the registration does not cover the requested level",
        "the app id was registered for a lower level",
        "request the level that the developer site shows for this app id",
    )
    VERSION_MISMATCH = (
        8,
        "the SDK version in the request is not the firmware's",
        "another firmware than the chosen profile",
        "let the profile be chosen from the version answer",
    )


class MobileDataCode(AckCode):
    """Ack of data to the mobile device (document 2.2.1.3)."""

    SUCCESS = 0, "taken for transmission"


class RatesCode(AckCode):
    """Ack of the telemetry-rate request of firmware 3.1."""

    SUCCESS = 0, "rates set"
    INVALID_PARAMETERS = 1, "a rate is not among 0, 1, 10, 50 and 100 Hz"


class AuthorityCode(AckCode):
    """Ack of a control-authority request (document 2.2.2.1 and errata 24, 25)."""

    NOT_IN_F = (
        0x0000,
        "refused: the remote controller is not in F position, or API control is not enabled",
        "mode switch not in F, or F since power-on without a toggle",
        "move the mode switch out of F and back; tick 'enable API control' in the PC assistant",
    )
    RELEASED = 0x0001, "released"
    OBTAINED = 0x0002, "obtained"
    NOT_CHANGED = (
        0x0003,
        "authority did not change (firmware 1.0), or obtaining is in progress (2.3, 3.1)",
        "mode switch not in F, F since power-on without a toggle, the app or its mission controls",
        "move the mode switch out of F and back; let the mobile app release control",
    )
    RELEASING = 0x0004, "releasing is in progress"
    IOC_ON = (
        0x00C9,
        "refused: IOC is on",
        "intelligent orientation control is active",
        "turn IOC off in the DJI app",
    )


class TaskStartCode(AckCode):
    """Immediate ack of a flight mode command (document 2.2.2.2)."""

    REJECTED = (
        0x0001,
        "received and rejected",
        "no authority, another task is running, or the aircraft is not in a state for it",
        "obtain authority first; in the air leave take-off out; landing needs to be in the air",
    )
    STARTED = 0x0002, "execution begins"


class TaskResultCode(AckCode):
    """Ack of a result query (document 2.2.2.2)."""

    NOT_CURRENT = (
        0x0001,
        "the sequence number is not that of the current task",
        "another task was started since",
        "",
    )
    EXECUTING = 0x0003, "executing"
    FAILED = (
        0x0004,
        "failed",
        "the task was interrupted: mode switch, pilot's sticks or the aircraft's own safety logic",
        "look at flight status, battery and GPS health",
    )
    SUCCEEDED = 0x0005, "succeeded"


class ArmCode(AckCode):
    """Ack of the arm command of firmware 3.1."""

    DONE = 0, "done"
    AUTHORITY_NEEDED = 1, "control authority is needed", "", "obtain authority first"
    ALREADY = 2, "already in that state"
    IN_THE_AIR = 3, "refused: the aircraft is in the air", "", "land first"


class MissionCode(AckCode):
    """First byte of every ack of command set 0x03, and the reason in a mission's status push.

    From DJI's list for firmware 3.1, with the readings of D4, D5 and others that its libraries and
    the phone's agree on.
    """

    SUCCESS = 0x00, "done"
    WRONG_INDEX = 0x01, "no waypoint has that index", "", "upload each index below the count once"

    IOC_TOO_NEAR_HOME = 0xA0, "IOC: too near to the home point", "", "fly farther away from it"
    IOC_WRONG_TYPE = 0xA1, "IOC: this type does not exist"
    BAD_NUMBER = 0xA2, "a number is not finite", "NaN or infinity was sent"
    BAD_POSITION = (
        0xA3,
        "latitude or longitude is out of range",
        "degrees were sent for radians, or a position without GPS, which is 0, 0",
        "give the centre as a valid position",
    )
    BAD_DIRECTION = 0xA6, "the direction is neither clockwise nor counter-clockwise"
    ALREADY_PAUSED = 0xA9, "the hotpoint is paused already"
    NOT_PAUSED = 0xAA, "the hotpoint is not paused"

    TARGET_TOO_FAR = 0xB0, "the target is farther than 20 km away", "", "go nearer to the target"
    TARGET_LOST = (
        0xB1,
        "the target has been silent for too long",
        "its GPS or the link to it was lost",
        "send its position once a second or more often",
    )
    GIMBAL_PITCH_TOO_LARGE = 0xB2, "the gimbal would have to point too far up or down"

    TOO_HIGH = (
        0xC0,
        "higher than the height limit",
        "the limit of the DJI app, 120 m by default; about 30 m where nobody ever logged in",
        "fly lower, or raise the limit in the DJI app",
    )
    TOO_LOW = (
        0xC1,
        "too low for this mission",
        "a hotpoint and a target need 5 m",
        "choose a greater height",
    )
    BAD_RADIUS = 0xC2, "the radius is outside 5 to 500 m"
    RATE_TOO_HIGH = (
        0xC3,
        "too many degrees per second for the radius",
        "the aircraft would be faster than about 10 m/s along the circle",
        "stay below 573 divided by the radius in metres, and below 30",
    )
    BAD_START_POINT = 0xC4, "this start point of a circle does not exist"
    BAD_YAW_MODE = 0xC5, "this heading on a circle does not exist"
    TOO_FAR_FROM_CIRCLE = (
        0xC6,
        "too far from the circle to resume it",
        "the aircraft was moved meanwhile",
        "fly nearer, or start the hotpoint again",
    )
    TOO_FAR_FROM_HOME = (
        0xC7,
        "farther from home than the radius limit",
        "the app's flight radius: 500 m is usual, even where it is off; 50 m without any login",
        "plan nearer to home, or raise the radius in the DJI app",
    )
    NOT_SUPPORTED = 0xC8, "this mission is not supported", "a firmware without it"
    TOO_FAR_AWAY = (
        0xC9,
        "the mission begins too far from the present position",
        "",
        "fly nearer to its first point",
    )
    BEGINNER_MODE = (
        0xCA,
        "the aircraft is in beginner mode",
        "it is switched on in the DJI app",
        "switch it off in the DJI app",
    )

    RC_NOT_IN_F = (
        0xD0,
        "the remote controller is not in F position",
        "the mode switch is in P or A",
        "move the mode switch to F and obtain authority",
    )
    AUTHORITY_NEEDED = (
        0xD1,
        "control authority is needed, or was lost",
        "missions need API control, which DJI also calls navigation mode",
        "obtain authority first",
    )
    IOC_ON = 0xD2, "IOC is on", "", "turn IOC off in the DJI app"
    NOT_INITIALISED = 0xD3, "the mission is not initialised", "", "upload it first"
    NOT_RUNNING = 0xD4, "no such mission is running", "it has ended, or was never started"
    RUNNING = 0xD5, "such a mission is running already", "", "stop it first"
    TAKES_TOO_LONG = (
        0xD6,
        "the mission takes longer than the battery lasts",
        "a long way at low speed, or an aged battery",
        "shorten it, fly faster or change the battery",
    )
    OTHER_RUNNING = 0xD7, "a mission of another kind is running", "", "stop that one first"
    GPS_TOO_WEAK = (
        0xD8,
        "GPS is too weak",
        "its health is below 3 of 5",
        "wait for more satellites, under open sky",
    )
    BATTERY_LOW = 0xD9, "the battery is at its warning level", "", "change the battery"
    NOT_IN_THE_AIR = 0xDA, "the aircraft is not in the air", "", "take off first"
    BAD_PARAMETERS = (
        0xDB,
        "the request has the wrong length or parameters",
        "another firmware than the chosen profile",
    )
    BUSY = (
        0xDC,
        "the aircraft is not in a state for it",
        "it takes off, lands or goes home",
        "wait until that has ended",
    )
    CROSSES_NO_FLY_ZONE = 0xDD, "the route crosses a no-fly zone", "", "plan around it"
    HOME_NOT_RECORDED = (
        0xDE,
        "the home point is not recorded",
        "GPS has been too weak since power-on",
        "wait for GPS until the DJI app says that home is recorded",
    )
    IN_NO_FLY_ZONE = 0xDF, "the aircraft is in a no-fly zone"

    BAD_MISSION = (
        0xE0,
        "a value of the waypoint mission is out of range",
        "nothing of it was stored, and an earlier mission is gone as well",
        "look at count, speeds and modes",
    )
    BAD_POINT = (
        0xE1,
        "a value of the waypoint is out of range",
        "height outside -200 to 500 m, a position, a heading or a turn that does not exist",
    )
    LEG_TOO_LONG = (
        0xE2,
        "first and last waypoint are too far apart",
        "15 km by DJI's document, 30 km by its code",
    )
    ROUTE_TOO_LONG = (
        0xE3,
        "the route is too long",
        "15 km by DJI's document; by its code 60 km with the ways from home and back",
    )
    INDEX_TOO_LARGE = 0xE4, "the index is not below the count", "", "count from 0"
    POINTS_TOO_CLOSE = 0xE5, "two neighbouring waypoints are closer than 2 m"
    POINTS_TOO_FAR = 0xE6, "two neighbouring waypoints are farther apart than 2000 m"
    BAD_DAMPING = (
        0xE7,
        "the corners of two neighbouring waypoints overlap",
        "their damping distances together are longer than the way between them",
        "choose smaller ones",
    )
    BAD_ACTION = 0xE8, "an action of the waypoint or its parameter does not exist"
    POINTS_MISSING = 0xE9, "not all waypoints were uploaded"
    NO_MISSION = (
        0xEA,
        "there is no waypoint mission",
        "it was not uploaded, was refused, or has ended",
        "upload the mission, then its points",
    )
    NO_POINTS = (
        0xEB,
        "the waypoints are not there, or did not pass the check as a whole",
        "points are missing, or the last one was refused",
        "upload the mission and all its points",
    )
    ALREADY_SO = 0xEC, "the waypoint mission runs, is paused or is resumed already"
    NOT_STARTED = 0xED, "no waypoint mission is running"
    BAD_SPEED = 0xEE, "the speed is beyond the mission's largest speed"

    TAKING_OFF = 0xF0, "the aircraft takes off", "", "wait until it has ended"
    LANDING = 0xF1, "the aircraft lands", "", "wait until it has ended"
    GOING_HOME = 0xF2, "the aircraft goes home", "", "wait until it has ended"
    STARTING_MOTORS = 0xF3, "the aircraft starts its motors", "", "wait until it has ended"
    WRONG_VALUE = 0xF4, "start or stop, pause or resume is neither 0 nor 1"
    UNKNOWN = 0xFF, "a reason that the aircraft does not name"
