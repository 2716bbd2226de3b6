"""Commands of later firmware against vectors made by an independent model."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace
from typing import Any

import pytest

from m100link.errors import BadValue
from m100link.protocol import (
    Address,
    Command,
    FirmwareProfile,
    Notification,
    commands,
    parse_command,
    profile,
)
from m100link.protocol.command import Acknowledged
from m100link.protocol.commands.registry import COMMANDS
from m100link.protocol.commands.waypoint import WaypointPoint
from m100link.protocol.fields import Laid, Nibbles, Number, Numbers, Reserved
from m100link.wire import FrameDecoder
from tests.support import load_vectors

FIRMWARE: FirmwareProfile = profile("3.1")
ROWS = [row for row in load_vectors("later-commands") if row["kind"] != "dialogue"]
SENT = [row for row in ROWS if row["kind"] == "command"]
PUSHED = [row for row in ROWS if row["kind"] == "push"]
ACKS = [row for row in ROWS if row["kind"] == "ack"]


def declared() -> list[type[Command]]:
    """Every class with an address, in whatever module of commands it stands."""
    modules = [
        importlib.import_module(module.name)
        for module in pkgutil.iter_modules(commands.__path__, commands.__name__ + ".")
    ]
    return [
        kind
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type)
        and issubclass(kind, Command)
        and hasattr(kind, "ADDRESS")
        and kind.__module__ == module.__name__
    ]


def test_every_declared_command_is_listed_under_an_address_of_its_own() -> None:
    ours = declared()
    assert set(ours) == set(COMMANDS.values())
    assert len({kind.ADDRESS for kind in ours}) == len(ours) == len(COMMANDS)
    assert {address: kind.ADDRESS for address, kind in COMMANDS.items()} == {
        address: address for address in COMMANDS
    }


def name_of(row: dict[str, Any]) -> str:
    return f"{row['name']}-{row['value'][:16]}"


def test_the_vectors_cover_every_command_that_later_firmware_added() -> None:
    later = {c.NAME: c for c in COMMANDS.values() if not c.is_known_to(profile("1.0"))}
    told = {kind.NAME for kind in later.values() if issubclass(kind, Notification)}
    assert {row["name"] for row in SENT} == set(later) - told
    assert {command_of(row).NAME for row in PUSHED} == told
    for row in SENT:
        assert (row["set"], row["id"]) == later[row["name"]].ADDRESS
        assert row["since"] == str(later[row["name"]].SINCE)


def command_of(row: dict[str, Any]) -> Command:
    command = parse_command(data_of(row["frame"]), FIRMWARE)
    assert isinstance(command, Command), command
    return command


def data_of(frame: str) -> bytes:
    [found] = FrameDecoder().feed(bytes.fromhex(frame))
    return found.data


@pytest.mark.parametrize("row", SENT + PUSHED, ids=name_of)
def test_a_published_value_is_read_and_written_both_ways(row: dict[str, Any]) -> None:
    """What is inside its ranges comes back as it went; what is not is shown, and refused."""
    value = bytes.fromhex(row["value"])
    assert data_of(row["frame"]) == bytes((row["set"], row["id"])) + value
    command = command_of(row)
    assert (command.name, command.raw()) == (row["name"], row["fields"])
    if not command.problems():
        assert command.value(FIRMWARE) == value
        return
    assert not row["legal"]
    with pytest.raises(BadValue) as caught:
        command.value(FIRMWARE)
    assert caught.value.field in str(caught.value)
    assert caught.value.limit in str(caught.value)


@pytest.mark.parametrize("row", ACKS, ids=name_of)
def test_a_published_ack_is_read_and_written_both_ways(row: dict[str, Any]) -> None:
    kind = COMMANDS[Address(row["set"], row["id"])]
    assert issubclass(kind, Acknowledged)
    payload = bytes.fromhex(row["value"])
    answer = kind.parse_ack(payload)
    assert kind.ack_raw(answer) == row["fields"]
    assert kind.code_of(answer) == row["fields"]["code"]
    assert kind.encode_ack(answer) == payload


def test_the_point_of_the_documents_is_read_as_that_of_the_wire() -> None:
    rows = [row for row in SENT if "value_in_document_layout" in row]
    assert len(rows) == 6
    for row in rows:
        value = bytes.fromhex(row["value_in_document_layout"])
        read, wanted = (
            WaypointPoint.parse(value, FIRMWARE),
            WaypointPoint.parse(bytes.fromhex(row["value"]), FIRMWARE),
        )
        assert read.actions == (*wanted.actions[:15], 0)
        assert read.parameters == (*wanted.parameters[:15], 0)
        assert replace(read, actions=wanted.actions, parameters=wanted.parameters) == wanted


ALWAYS_MOVING = {
    *("follow_start", "hotpoint_start", "hotpoint_auto_radius", "waypoint_set_idle_speed")
}


def test_what_makes_the_aircraft_fly_a_mission_is_known_of_every_command() -> None:
    """A control block asks for each of these, and sends the others without authority."""
    seen = set()
    for row in SENT:
        command = command_of(row)
        name, first = row["name"], row["value"][:2]
        moves = name in ALWAYS_MOVING
        if name.endswith("_pause_resume"):
            moves = first != "00"
        elif name == "waypoint_start_stop":
            moves = first != "01"
        assert command.sets_in_motion is moves, row
        seen.add((name, moves))
    moving = {name for name, moves in seen if moves}
    assert moving == ALWAYS_MOVING | {
        *("follow_pause_resume", "hotpoint_pause_resume"),
        *("waypoint_pause_resume", "waypoint_start_stop"),
    }
    assert {(name, False) for name in moving - ALWAYS_MOVING} <= seen


CHOICES: dict[str, list[str]] = {
    "waypoint_mission.finish_action": ["hover", "go_home", "land", "first_point", "endless"],
    "waypoint_mission.yaw_mode": ["along_path", "as_at_start", "by_rc", "by_point"],
    "waypoint_mission.trace_mode": ["stop_at_points", "rounded_corners"],
    "waypoint_mission.rc_lost_action": ["failsafe", "go_on"],
    "waypoint_mission.gimbal_pitch_mode": ["free", "by_point"],
    "waypoint_point.turn_mode": ["clockwise", "counter_clockwise"],
    "waypoint_point.actions": [
        *("stay", "take_photo", "start_video", "stop_video", "turn_to", "gimbal_pitch"),
    ],
    "waypoint_start_stop.stop": ["start", "stop"],
    "waypoint_pause_resume.resume": ["pause", "resume"],
    "hotpoint_start.clockwise": ["counter_clockwise", "clockwise"],
    "hotpoint_start.start_point": ["north", "south", "west", "east", "nearest"],
    "hotpoint_start.yaw_mode": ["along_path", "to_centre", "outwards", "by_rc", "as_at_start"],
    "hotpoint_set_rate.clockwise": ["counter_clockwise", "clockwise"],
    "hotpoint_pause_resume.resume": ["pause", "resume"],
    "hotpoint_auto_radius.enable": ["off", "on"],
    "follow_start.yaw_mode": ["by_rc", "to_target"],
    "follow_pause_resume.resume": ["pause", "resume"],
}
"""By hand, from DJI's tables of fields: what 0, 1, 2 and so on mean on the wire."""

UNITS = {
    "m/s": "max_speed idle_speed",
    "rad": "latitude longitude focus_latitude focus_longitude",
    "m": "altitude focus_altitude damping radius",
    "°": "yaw gimbal_pitch",
    "°/s": "angular_rate",
    "s": "action_time_limit",
}
"""Likewise: places are radians, and turns are degrees."""


def test_what_the_numbers_of_a_command_mean() -> None:
    """What is read of a mission, and written about it, has these words and units."""
    words, units = {}, {}
    for command in (one for one in COMMANDS.values() if issubclass(one, Laid)):
        for _, part in command.LAYOUT.offsets():
            if isinstance(part, Reserved | Nibbles):
                continue
            number: Number = part.each if isinstance(part, Numbers) else part
            if number.words:
                words[f"{command.NAME}.{part.name}"] = list(number.words)
            if number.unit:
                units[part.name] = number.unit
    assert words == CHOICES
    assert units == {name: unit for unit, names in UNITS.items() for name in names.split()}
