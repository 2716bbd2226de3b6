"""Every frame of a log is listed, decrypted when there is a key, and what was lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from m100link.errors import UsageError
from m100link.log import read
from m100link.log.pcapng import read_frames
from m100link.wire import Cipher
from tests.log.flight import KEY, URL, flown, fly

pytestmark = pytest.mark.anyio


async def test_the_frames_are_those_that_the_recorder_wrote(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    told = [one.content() for one in flight.messages("/m100/command")]
    frames = list(read_frames(flight, cipher=Cipher(KEY)))
    commands = [one for one in frames if one["command"] != "telemetry"]
    for direction in ("rx", "tx"):
        ours = [one for one in commands if one["direction"] == direction]
        theirs = [one for one in told if one["direction"] == direction]
        assert [one["command"] for one in ours] == [one["command"] for one in theirs]
        assert [one["sequence"] for one in ours] == [one["sequence"] for one in theirs]
    assert {one["command"] for one in commands} >= {"move", "start_task", "request_authority"}
    assert [one["task"] for one in commands if "task" in one] == ["take_off", "land"]
    assert sum(one["command"] == "telemetry" for one in frames) == sum(1 for _ in flight.samples())
    assert [one["at"] for one in frames] == sorted(one["at"] for one in frames)


async def test_without_the_key_what_was_encrypted_is_shown_as_it_travelled(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    frames = list(read_frames(read(tmp_path / "flight.mcap")))
    sealed = [one for one in frames if one["encrypted"]]
    assert len(sealed) > 100
    assert all(one["command"] is None and one["frame_crc"] for one in sealed)


async def test_what_was_damaged_is_reported_where_it_was(tmp_path: Path) -> None:
    await fly(tmp_path / "flight.mcap", f"{URL}&damage=0.05")
    frames = list(read_frames(read(tmp_path / "flight.mcap"), cipher=Cipher(KEY)))
    lost = [one for one in frames if "cause" in one]
    assert sum(one["discards"] for one in lost) > 20
    assert {one["direction"] for one in lost} == {"rx"}


def test_a_log_of_no_firmware_asks_for_one(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with path.open("wb") as stream:
        writer: Writer = Writer(stream)
        writer.start()
        writer.finish()  # type: ignore[no-untyped-call]  # of a package without types
    with pytest.raises(UsageError, match="firmware"):
        list(read_frames(read(path)))
    assert list(read_frames(read(path), firmware="1.0")) == []
