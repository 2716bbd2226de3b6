"""Ack codes as enums: each knows what it means, its likely cause and what to do.

A code that no source lists keeps its number: ``ActivationCode(77)`` is a member-like value whose
name says that it is unknown. The system codes 0xFF00 to 0xFF02 can replace the code of any command
of the sets 0x00 and 0x01, so every enum knows them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, Self

__all__ = [
    "AckCode",
    "ActivationCode",
    "ArmCode",
    "AuthorityCode",
    "MobileDataCode",
    "RatesCode",
    "SystemCode",
    "TaskResultCode",
    "TaskStartCode",
    "VersionCode",
]


class _Text(NamedTuple):
    meaning: str
    cause: str
    remedy: str


class AckCode(IntEnum):
    """Base of the ack-code enums; an ``int`` with ``meaning``, ``cause`` and ``remedy``."""

    _text: _Text

    def __new__(cls, value: int, meaning: str = "", cause: str = "", remedy: str = "") -> Self:
        """A member from its row in the class body."""
        member = int.__new__(cls, value)
        member._value_ = value
        member._text = _Text(meaning, cause, remedy)
        return member

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        if not isinstance(value, int) or not 0 <= value <= 0xFFFF:
            return None
        member = int.__new__(cls, value)
        member._value_ = value
        if cls is not SystemCode and value in SystemCode._value2member_map_:
            system = SystemCode(value)
            member._name_, member._text = system._name_, system._text
        else:
            member._name_ = f"UNKNOWN_0x{value:04X}"
            member._text = _Text(
                f"a code that no published source lists (0x{value:04X})",
                "a firmware that is not among the known profiles",
                "note the firmware version and the number; please report both",
            )
        return member

    @property
    def meaning(self) -> str:
        """What the aircraft says with this code."""
        return self._text.meaning

    @property
    def cause(self) -> str:
        """The usual reason for it, or an empty string."""
        return self._text.cause

    @property
    def remedy(self) -> str:
        """What to do about it, or an empty string."""
        return self._text.remedy

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
        "normal on a new aircraft or with a new app id",
        "keep the DJI app connected, with internet, and try again after some seconds",
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
        "mode switch not in F, F since power-on without a toggle, or the mobile app holds control",
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
        "obtain authority first; take-off needs stopped motors, landing needs to be in the air",
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
