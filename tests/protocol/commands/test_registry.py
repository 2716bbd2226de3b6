"""Commands of later firmware against vectors made by an independent model."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import pytest

from m100link.errors import UsageError
from m100link.protocol import (
    Command,
    FirmwareProfile,
    Request,
    Unrecognised,
    commands,
    parse_command,
    profile,
)
from m100link.protocol.commands.registry import COMMANDS
from m100link.wire import FrameDecoder
from tests.support import load_vectors

FIRMWARE: FirmwareProfile = profile("3.1")
RAW_NAMES = {command.NAME: address for address, command in COMMANDS.items()}
ROWS = [row for row in load_vectors("later-commands") if row["name"] in RAW_NAMES]
SENT = [row for row in ROWS if row["kind"] == "command"]
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
    assert len({kind.ADDRESS for kind in ours}) == len(ours)


def name_of(row: dict[str, Any]) -> str:
    return f"{row['name']}-{row['value'][:16]}"


def test_the_vectors_cover_every_command_that_later_firmware_added() -> None:
    later = {c.NAME: c for c in COMMANDS.values() if not c.is_known_to(profile("1.0"))}
    assert {row["name"] for row in SENT} == set(later)
    for row in SENT:
        assert (row["set"], row["id"]) == later[row["name"]].ADDRESS
        assert row["since"] == str(later[row["name"]].SINCE)


@pytest.mark.parametrize("row", SENT, ids=name_of)
def test_a_published_value_is_read_and_written_both_ways(row: dict[str, Any]) -> None:
    """A value inside its ranges comes back as it went; any other is shown or says what is wrong."""
    value = bytes.fromhex(row["value"])
    [frame] = FrameDecoder().feed(bytes.fromhex(row["frame"]))
    assert frame.data[2:] == value
    command = parse_command(frame.data, FIRMWARE)
    if isinstance(command, Unrecognised):
        assert not row["legal"]
        assert command.reason
        return
    assert row["name"] == command.NAME
    ignored_byte = row["fields"].keys() == {"any"}
    uninitialised_bits = row["name"] == "virtual_rc_settings"
    try:
        encoded = command.value(FIRMWARE)
    except UsageError:
        assert not row["legal"]
        return
    if ignored_byte:
        assert encoded == b"\0"
    elif uninitialised_bits:
        assert encoded[0] == value[0] & 0b11
    else:
        assert encoded == value


@pytest.mark.parametrize("row", ACKS, ids=name_of)
def test_a_published_ack_is_its_code(row: dict[str, Any]) -> None:
    kind = COMMANDS[RAW_NAMES[row["name"]]]
    assert issubclass(kind, Request)
    payload = bytes.fromhex(row["value"])
    answer = kind.parse_ack(payload)
    assert answer == row["fields"]["code"]
    assert kind.encode_ack(answer) == payload
