"""Which command an address stands for."""

from __future__ import annotations

from m100link.protocol.command import Address, Command, Unrecognised
from m100link.protocol.commands.activation import (
    Activate,
    GetVersion,
    SendToMobile,
    SetTelemetryRates,
)
from m100link.protocol.commands.camera import StartVideo, StopVideo, TakePhoto
from m100link.protocol.commands.control import Arm, Move, QueryTask, RequestAuthority, StartTask
from m100link.protocol.commands.follow import (
    FollowPauseResume,
    FollowStart,
    FollowStop,
    FollowTarget,
)
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import (
    HotpointAutoRadius,
    HotpointDownload,
    HotpointPauseResume,
    HotpointResetYaw,
    HotpointSetRadius,
    HotpointSetRate,
    HotpointStart,
    HotpointStop,
)
from m100link.protocol.commands.missions import MissionStatus, WaypointEvent
from m100link.protocol.commands.monitor import AuthorityChanged, FromMobile, PushTelemetry
from m100link.protocol.commands.sync import Sync
from m100link.protocol.commands.virtual_rc import VirtualRcData, VirtualRcSettings
from m100link.protocol.commands.waypoint import (
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointGetIdleSpeed,
    WaypointMission,
    WaypointPauseResume,
    WaypointPoint,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.protocol.firmware import FirmwareProfile

__all__ = ["COMMANDS", "address_of", "parse_command"]

COMMANDS: dict[Address, type[Command]] = {
    command.ADDRESS: command
    for command in (
        GetVersion,
        Activate,
        SetTelemetryRates,
        SendToMobile,
        RequestAuthority,
        StartTask,
        QueryTask,
        Move,
        Arm,
        GimbalSpeed,
        GimbalAngle,
        TakePhoto,
        StartVideo,
        StopVideo,
        PushTelemetry,
        AuthorityChanged,
        FromMobile,
        MissionStatus,
        WaypointEvent,
        WaypointMission,
        WaypointPoint,
        WaypointStartStop,
        WaypointPauseResume,
        WaypointDownloadMission,
        WaypointDownloadPoint,
        WaypointSetIdleSpeed,
        WaypointGetIdleSpeed,
        HotpointStart,
        HotpointStop,
        HotpointPauseResume,
        HotpointSetRate,
        HotpointSetRadius,
        HotpointResetYaw,
        HotpointDownload,
        HotpointAutoRadius,
        FollowStart,
        FollowStop,
        FollowPauseResume,
        FollowTarget,
        Sync,
        VirtualRcSettings,
        VirtualRcData,
    )
}
"""Every command and push by its address."""


def address_of(data: bytes) -> Address | None:
    """Command set and id of the data of a frame that is not an ack; None when it is too short."""
    return Address(data[0], data[1]) if len(data) >= 2 else None


def parse_command(data: bytes, profile: FirmwareProfile) -> Command | Unrecognised:
    """Read the data of a frame that is not an ack. Never raises: what cannot be read says why."""
    address = address_of(data)
    if address is None:
        return Unrecognised(None, data, "too short for a command set and id")
    command = COMMANDS.get(address)
    if command is None:
        return Unrecognised(address, data[2:], f"{address} is not a command of the document")
    try:
        return command.parse(data[2:], profile)
    except ValueError as error:
        reason = getattr(error, "seen", None) or str(error)
        return Unrecognised(address, data[2:], reason)
