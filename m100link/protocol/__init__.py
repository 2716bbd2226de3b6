"""The meaning of the data bytes: command sets, setpoints, telemetry, firmware profiles."""

from typing import TYPE_CHECKING

from m100link.protocol import codes, records
from m100link.protocol.codes import *  # noqa: F403 (all of its __all__, nothing else)
from m100link.protocol.records import *  # noqa: F403

if TYPE_CHECKING:  # a program that makes setpoints needs no other command
    from m100link.protocol.command import (
        Address,
        Command,
        Movement,
        Notification,
        Problem,
        Push,
        Request,
        Unrecognised,
        encode_code,
    )
    from m100link.protocol.commands.activation import (
        Activate,
        Credentials,
        GetVersion,
        SendToMobile,
        SetTelemetryRates,
        Version,
    )
    from m100link.protocol.commands.control import (
        Arm,
        Move,
        QueryTask,
        RequestAuthority,
        StartTask,
        Task,
    )
    from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile, PushTelemetry
    from m100link.protocol.commands.registry import parse_command
    from m100link.protocol.firmware import PROFILES, FirmwareProfile, profile
    from m100link.protocol.packet import TelemetryPacket, encode_telemetry
    from m100link.protocol.setpoint import (
        ControlMode,
        Horizontal,
        ReferenceFrame,
        Setpoint,
        Vertical,
        Yaw,
    )

__all__ = [
    "PROFILES",
    "Activate",
    "Address",
    "Arm",
    "AuthorityChanged",
    "Command",
    "ControlMode",
    "Credentials",
    "FirmwareProfile",
    "FromMobile",
    "GetVersion",
    "Horizontal",
    "Move",
    "Movement",
    "Notification",
    "Problem",
    "Push",
    "PushTelemetry",
    "QueryTask",
    "ReferenceFrame",
    "Request",
    "RequestAuthority",
    "SendToMobile",
    "SetTelemetryRates",
    "Setpoint",
    "StartTask",
    "Task",
    "TelemetryPacket",
    "Unrecognised",
    "Version",
    "Vertical",
    "Yaw",
    "encode_code",
    "encode_telemetry",
    "parse_command",
    "profile",
]

__all__ += codes.__all__
__all__ += records.__all__

if not TYPE_CHECKING:  # a checker that saw it would take every misspelt name for a name
    from m100link.errors.usage import loads

    __getattr__ = loads(
        __name__,
        *("setpoint", "command", "firmware", "packet", "commands.registry", "commands.control"),
        *("commands.activation", "commands.monitor"),
    )
