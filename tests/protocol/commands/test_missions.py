"""Refusals of missions have the shape of their acks, as vectors of an independent model have it."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.protocol.commands.missions import COMMAND_SET, NOT_SUPPORTED, refusal
from tests.support import load_vectors

ROWS = [row for row in load_vectors("later-commands") if row.get("set") == COMMAND_SET]
ACKS = {row["name"]: row for row in ROWS if row["kind"] == "ack"}
COMMANDS = {row["name"]: row for row in ROWS if row["kind"] == "command"}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_refusal_is_as_long_as_the_ack(name: str) -> None:
    row = COMMANDS[name]
    value = bytes.fromhex(row["value"])
    payload = refusal(row["id"], value)
    if name == "follow_target":
        assert payload is None
        return
    assert payload is not None
    assert len(payload) == len(bytes.fromhex(ACKS[name]["value"]))
    assert payload[0] == NOT_SUPPORTED == 0xC8
    if name == "waypoint_point":
        assert payload[1] == row["fields"]["index"]


@pytest.mark.parametrize(("command_id", "value"), [(0x11, b""), (0x40, b"abc"), (0xFF, b"")])
def test_whatever_comes_the_first_byte_is_not_success(command_id: int, value: bytes) -> None:
    payload: Any = refusal(command_id, value)
    assert payload[0] == NOT_SUPPORTED
