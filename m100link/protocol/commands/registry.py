"""Which command an address stands for.

A module is imported when a command in it is asked for: there are many, and a program that decodes
one frame needs one of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from m100link.protocol.command import Address, Command, Unrecognised
from m100link.protocol.firmware import FirmwareProfile

# Set, the module of its commands, and their classes by id.
_SETS: tuple[tuple[int, str, dict[int, str]], ...] = (
    (
        0x00,
        "activation",
        {0x00: "GetVersion", 0x01: "Activate", 0x10: "SetTelemetryRates", 0xFE: "SendToMobile"},
    ),
    (
        0x01,
        "control",
        {0x00: "RequestAuthority", 0x01: "StartTask", 0x02: "QueryTask", 0x03: "Move", 0x05: "Arm"},
    ),
    (0x01, "gimbal", {0x1A: "GimbalSpeed", 0x1B: "GimbalAngle"}),
    (0x01, "gimbal", {0x20: "TakePhoto", 0x21: "StartVideo", 0x22: "StopVideo"}),
    (0x02, "monitor", {0x00: "PushTelemetry", 0x01: "AuthorityChanged", 0x02: "FromMobile"}),
    (0x02, "missions", {0x03: "MissionStatus", 0x04: "WaypointEvent"}),
    (
        0x03,
        "waypoint",
        {
            0x10: "WaypointMission",
            0x11: "WaypointPoint",
            0x12: "WaypointStartStop",
            0x13: "WaypointPauseResume",
            0x14: "WaypointDownloadMission",
            0x15: "WaypointDownloadPoint",
            0x16: "WaypointSetIdleSpeed",
            0x17: "WaypointGetIdleSpeed",
        },
    ),
    (
        0x03,
        "hotpoint",
        {
            0x20: "HotpointStart",
            0x21: "HotpointStop",
            0x22: "HotpointPauseResume",
            0x23: "HotpointSetRate",
            0x24: "HotpointSetRadius",
            0x25: "HotpointResetYaw",
            0x26: "HotpointDownload",
            0x27: "HotpointAutoRadius",
        },
    ),
    (
        0x03,
        "hotpoint",
        {0x30: "FollowStart", 0x31: "FollowStop", 0x32: "FollowPauseResume", 0x33: "FollowTarget"},
    ),
    (0x04, "virtual_rc", {0x00: "Sync"}),
    (0x05, "virtual_rc", {0x00: "VirtualRcSettings", 0x01: "VirtualRcData"}),
)


class _Commands(Mapping[Address, type[Command]]):
    """The classes by address, each imported when it is asked for."""

    __slots__ = ("_known", "_places")

    def __init__(self) -> None:
        self._places = {
            Address(command_set, command_id): (module, name)
            for command_set, module, names in _SETS
            for command_id, name in names.items()
        }
        self._known: dict[Address, type[Command]] = {}

    def __getitem__(self, address: Address) -> type[Command]:
        command = self._known.get(address)
        if command is None:
            module, name = self._places[address]
            command = getattr(import_module(f"{__package__}.{module}"), name)
            self._known[address] = command
        return command

    def __iter__(self) -> Iterator[Address]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


COMMANDS: Mapping[Address, type[Command]] = _Commands()
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
