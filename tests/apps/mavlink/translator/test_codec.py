"""Frames of MAVLink: as others write and read them; and what was signed before a restart."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from random import Random
from typing import Any
from zlib import crc32

import pytest

from m100link.apps.mavlink.bridge import AHEAD, SignatureMemory
from m100link.apps.mavlink.translator import codec
from m100link.apps.mavlink.translator.codec import (
    LAST_SIGNATURE,
    LAYOUTS,
    NEW_WITHIN,
    MavlinkMessage,
    MessageReader,
    PacketSigner,
    ending_command,
    write_frame,
)
from m100link.apps.mavlink.translator.vehicle import MavlinkVehicle
from tests.apps.mavlink.conftest import session_of
from tests.known import Known

KEY = bytes(range(32))


def frame(name: str = "PING", /, *, sequence: int = 0, **fields: Any) -> bytes:
    return write_frame(MavlinkMessage(name, fields), system=7, sequence=sequence)


def test_a_message_comes_out_as_it_went_in() -> None:
    fields: dict[str, Any] = {"severity": 4, "text": "no more than fifty", "id": 3, "chunk_seq": 1}
    [message] = MessageReader(frame("STATUSTEXT", **fields))
    assert message == MavlinkMessage("STATUSTEXT", fields, 7, 1)


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_message_is_read_as_it_was_written(name: str) -> None:
    layout = LAYOUTS[name]
    values = layout.read(bytes(Random(name).choices(range(1, 60), k=layout.size)))
    [message] = MessageReader(frame(name, **values))
    assert message.fields == values
    [empty] = MessageReader(frame(name))
    assert set(empty.fields) == set(layout.fields)


def test_values_at_the_end_that_are_zero_are_not_sent() -> None:
    assert len(frame("PING")) == 10 + 1 + 2
    [message] = MessageReader(frame("PING"))
    assert message["seq"] == 0


def test_a_frame_of_the_first_version_is_read() -> None:
    heartbeat = bytes.fromhex("fe09 2a ff 00 00 00000000 06 08 c0 04 03".replace(" ", ""))
    crc = LAYOUTS["HEARTBEAT"].crc_extra
    whole = heartbeat + codec._CHECKSUM.pack(codec._crc(heartbeat[1:] + bytes([crc])))
    [message] = MessageReader(whole)
    assert (message.name, message.system, message["mavlink_version"]) == ("HEARTBEAT", 255, 3)


def test_damage_is_refused() -> None:
    whole = frame("COMMAND_LONG", command=400, param1=1.0)
    for place in range(len(whole)):
        for bit in range(8):
            hurt = bytearray(whole)
            hurt[place] ^= 1 << bit
            found = [one for one in MessageReader(bytes(hurt)) if one.name == "COMMAND_LONG"]
            # The flags of compatibility and the sequence are covered, too: nothing passes.
            assert found == []


def test_a_false_start_swallows_nothing_behind_it() -> None:
    random, valid = Random(2), frame("COMMAND_LONG", command=400, param1=1.0)
    for _ in range(500):
        junk = bytes(random.choices((0xFD, 0xFE, 0, 9, 76, 255), k=random.randrange(60)))
        [message] = MessageReader(junk + valid + junk)
        assert message["command"] == 400


def test_junk_is_nothing() -> None:
    random = Random(4)
    for _ in range(3000):
        data = random.randbytes(random.randrange(300))
        assert list(MessageReader(data)) == []


def test_reading_tells_what_it_cost() -> None:
    """Bytes that were checked as a frame: those of a frame once, of overlapping ones many times."""
    valid = frame("COMMAND_LONG", command=400, param1=1.0)
    reading = MessageReader(bytes(500) + valid + bytes(500))
    assert [message.name for message in reading] == ["COMMAND_LONG"]
    assert reading.checked == len(valid)
    broken = MessageReader(bytes(500) + valid[:-1] + bytes([valid[-1] ^ 1]))
    assert list(broken) == []
    assert broken.checked == len(valid)
    old = of_the_first_version("PING")
    broken = MessageReader(bytes(500) + old[:-1] + bytes([old[-1] ^ 1]))
    assert list(broken) == []
    assert broken.checked == len(old)
    foreign = signed(PacketSigner(bytes(32)), 1)
    forged = MessageReader(bytes(500) + foreign, signer=PacketSigner(KEY))
    assert list(forged) == []
    assert forged.checked == len(foreign)
    overlapping = MessageReader(b"\xfe\xf0\0\0\0\0" * 230)
    assert list(overlapping) == []
    assert overlapping.checked > 30 * 1380


def test_a_datagram_is_left_when_it_cost_too_much() -> None:
    valid = frame("COMMAND_LONG", command=400, param1=1.0)
    hostile = b"\xfe\xf0\0\0\0\0" * 10_000
    reading = MessageReader(valid + hostile, most=16_384)
    assert len(list(reading)) == 1, "what stands before it is read"
    assert reading.checked < 17_000


@pytest.mark.parametrize("version", [1, 2])
def test_a_command_that_may_end_a_flight_is_found_by_its_bytes(version: int) -> None:
    """MAVLink 1: sender at 3 and 4, number at 5, payload from 6; 2: at 5 and 6, 7 to 9, 10."""

    def framed(name: str, **fields: Any) -> bytes:
        whole = write_frame(MavlinkMessage(name, fields, component=190), system=245, sequence=3)
        if version == 2:
            return whole
        payload = whole[10:-2].ljust(LAYOUTS[name].size, b"\0")  # zeros are sent, too
        return bytes((0xFE, len(payload), 3, 245, 190, whole[7])) + payload + whole[-2:]

    to_us = {"target_system": 7, "target_component": 1}
    for command in (20, 21, 176, 192, 193, 262, 400):
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            found = ending_command(framed(name, command=command, **to_us))
            assert found == (245, 190, 7, command), (name, command)
    assert ending_command(framed("SET_MODE", custom_mode=1, target_system=7, base_mode=1)) == (
        245,
        190,
        7,
        176,
    )
    for other in (22, 16, 178, 300):
        assert ending_command(framed("COMMAND_LONG", command=other, **to_us)) is None
    assert ending_command(framed("MANUAL_CONTROL", x=21, target=7)) is None
    whole = framed("COMMAND_LONG", command=21, **to_us)
    assert ending_command(whole + bytes(64)) is None, "more than one"
    assert ending_command(bytes((1,)) + whole[1:]) is None


# -- signatures -----------------------------------------------------------------------------------


def signed(signer: PacketSigner, now: int, name: str = "PING") -> bytes:
    return write_frame(MavlinkMessage(name, {}), system=7, sequence=0, signer=signer, now=now)


def taken(reader: PacketSigner, data: bytes, now: int = 1000) -> int:
    return len(list(MessageReader(data, signer=reader, now=now)))


def test_what_is_signed_with_the_key_is_taken_once() -> None:
    writer, reader = PacketSigner(KEY), PacketSigner(KEY)
    first, second = signed(writer, 1000), signed(writer, 1000)
    assert taken(reader, first) == 1
    assert taken(reader, first) == 0, "it was recorded and sent again"
    assert taken(reader, second) == 1
    assert reader.refused == 1


def test_what_is_not_signed_or_with_another_key_is_refused() -> None:
    reader = PacketSigner(KEY)
    assert taken(reader, frame("PING")) == 0
    assert taken(reader, signed(PacketSigner(bytes(32)), 1000)) == 0
    assert taken(reader, signed(PacketSigner(bytes(32)), 1000, "HEARTBEAT")) == 0
    assert taken(reader, frame("HEARTBEAT")) == 0, "by that alone anybody could look"


def of_the_first_version(name: str) -> bytes:
    """Which knows no signatures."""
    layout = LAYOUTS[name]
    payload = bytes(layout.size)
    head = bytes([0xFE, len(payload), 0, 255, 190, layout.number])
    crc = codec._crc(head[1:] + payload + bytes([layout.crc_extra]))
    return head + payload + codec._CHECKSUM.pack(crc)


@pytest.mark.parametrize(
    ("name", "data", "with_key", "without"),
    [
        ("HEARTBEAT", frame("HEARTBEAT"), 0, 1),
        ("HEARTBEAT", of_the_first_version("HEARTBEAT"), 0, 1),
        ("HEARTBEAT", signed(PacketSigner(KEY), 1000, "HEARTBEAT"), 1, 1),
        ("PING", signed(PacketSigner(KEY), 1000), 1, 1),
        ("PING", of_the_first_version("PING"), 0, 1),
    ],
)
def test_a_key_takes_what_came_with_its_signature_alone(
    name: str, data: bytes, with_key: int, without: int
) -> None:
    for signer, count in ((PacketSigner(KEY), with_key), (None, without)):
        reading = MessageReader(bytes(20) + data, signer=signer, now=1000)
        assert [one.name for one in reading] == [name] * count
        assert reading.checked == len(data)


def test_a_wrong_signature_does_not_lock_out_the_right_one() -> None:
    reader = PacketSigner(KEY)
    assert taken(reader, signed(PacketSigner(bytes(32)), 10**12)) == 0
    assert taken(reader, signed(PacketSigner(KEY), 1000)) == 1


def test_a_sender_that_is_new_may_not_be_a_minute_old() -> None:
    reader = PacketSigner(KEY)
    assert taken(reader, signed(PacketSigner(KEY), 1000), now=1000 + 6_000_001) == 0


def test_of_more_senders_than_are_remembered_the_old_ones_give_way_after_a_minute() -> None:
    """Times are in 10 µs. One that is heard first again is refused what it said before."""
    reader, begin, minute = PacketSigner(KEY), 10**9, 6_000_000
    recorded = [signed(PacketSigner(KEY, link=link), begin) for link in range(64)]
    assert [taken(reader, one, begin) for one in recorded] == [1] * 64
    late = [signed(PacketSigner(KEY, link=64), begin + minute - back) for back in (1, 0)]
    assert [taken(reader, late[0], begin + minute - 1), len(reader.newest)] == [0, 64]
    assert [taken(reader, late[1], begin + minute), len(reader.newest)] == [1, 1]
    assert [taken(reader, one, begin + minute) for one in recorded] == [0] * 64


def test_the_key_is_not_shown() -> None:
    assert "\\x01" not in repr(PacketSigner(KEY))


# -- pymavlink ------------------------------------------------------------------------------------


@pytest.fixture
def dialects() -> list[Any]:
    return [
        pytest.importorskip(f"pymavlink.dialects.v20.{name}") for name in ("common", "development")
    ]


def test_the_definitions_are_those_of_pymavlink(dialects: list[Any]) -> None:
    # Which pymavlink 2.4.50 leaves out; from the C library of MAVLink.
    metadata = LAYOUTS["COMPONENT_METADATA"]
    assert (metadata.number, metadata.crc_extra, metadata.size) == (397, 182, 108)
    assert metadata.fields == ("time_boot_ms", "file_crc", "uri")
    for name, layout in LAYOUTS.items():
        if layout is metadata:
            continue
        known = [
            kind
            for dialect in dialects
            for kind in dialect.mavlink_map.values()
            if kind.msgname == name
        ]
        assert known, name
        theirs = known[0]
        assert (layout.number, layout.crc_extra) == (theirs.id, theirs.crc_extra), name
        assert (layout.size, layout.fields) == (
            theirs.unpacker.size,
            tuple(theirs.ordered_fieldnames),
        )


def test_pymavlink_reads_what_is_written_signed_or_not(dialects: list[Any]) -> None:
    reader = dialects[0].MAVLink(None)
    plain = reader.decode(bytearray(frame("ATTITUDE", roll=0.5, yaw=math.nan)))
    assert (plain.get_type(), plain.roll, plain.get_srcSystem()) == ("ATTITUDE", 0.5, 7)
    reader.signing.secret_key = KEY
    assert reader.decode(bytearray(signed(PacketSigner(KEY), 10**10))).get_type() == "PING"


def test_what_pymavlink_writes_is_read(dialects: list[Any]) -> None:
    common = dialects[0]
    writer = common.MAVLink(None, srcSystem=9, srcComponent=4)
    data = common.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 7.5, 9).pack(writer)
    [message] = MessageReader(bytes(data))
    assert (message.system, message.component) == (9, 4)
    assert (message["param_id"], message["param_value"]) == ("MIS_TAKEOFF_ALT", 7.5)
    writer.signing.secret_key, writer.signing.sign_outgoing = KEY, True
    writer.signing.timestamp = 1000
    signed_ping = common.MAVLink_ping_message(1, 2, 0, 0).pack(writer)
    assert taken(PacketSigner(KEY), bytes(signed_ping)) == 1


# -- what was recorded before a restart is not obeyed after it -------------------------------------


SECOND = 100_000
NOW = 10**12


def ping(at: int, system: int = 245) -> bytes:
    message = MavlinkMessage("PING", {}, component=190)
    return write_frame(message, system=system, sequence=0, signer=PacketSigner(KEY), now=at)


def is_taken(signer: PacketSigner, frame: bytes, now: int) -> bool:
    return bool(list(MessageReader(frame, signer=signer, now=now)))


def started(folder: Path, now: int = NOW) -> tuple[PacketSigner, SignatureMemory]:
    signer = PacketSigner(KEY)
    memory = SignatureMemory(folder, signer)
    assert memory.recall(now) == ""
    return signer, memory


def work(memory: SignatureMemory) -> None:
    """One turn of what runs beside the bridge."""
    snapshot = memory.due()
    if snapshot is not None:
        memory.write(snapshot)


def test_what_was_recorded_is_not_taken_after_the_process_was_killed(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    recorded = [ping(NOW + step * SECOND) for step in range(10)]
    for step, frame in enumerate(recorded):
        assert is_taken(signer, frame, NOW + step * SECOND)
        if step in (0, 8):  # the last of them is newer than what is written
            work(memory)
    signer, memory = started(tmp_path)
    now = NOW + 10 * SECOND
    assert not any(is_taken(signer, frame, now) for frame in recorded)
    ahead = NOW + 8 * SECOND + AHEAD
    assert is_taken(signer, ping(ahead + 1), now)


def test_without_a_memory_a_minute_passes_in_which_it_is_taken(tmp_path: Path) -> None:
    """Which is what the specification asks for, and not enough."""
    recorded = ping(NOW)
    assert is_taken(started(tmp_path)[0], recorded, NOW)
    assert is_taken(started(tmp_path)[0], recorded, NOW + NEW_WITHIN - 1)
    assert not is_taken(started(tmp_path)[0], recorded, NOW + NEW_WITHIN)


def test_after_a_proper_end_nobody_waits(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    recorded = ping(NOW)
    assert is_taken(signer, recorded, NOW)
    work(memory)
    last = memory.last()
    assert last is not None
    memory.write(last)
    signer, _ = started(tmp_path)
    assert not is_taken(signer, recorded, NOW)
    assert is_taken(signer, ping(NOW + 1), NOW)


def test_a_clock_that_was_set_back_takes_and_signs_nothing_old(tmp_path: Path) -> None:
    """A computer without a clock of its own begins in the past."""
    signer, memory = started(tmp_path)
    recorded = ping(NOW - 2 * NEW_WITHIN, system=246)
    assert is_taken(signer, ping(NOW), NOW)
    work(memory)
    past = NOW - 3 * NEW_WITHIN
    signer, _ = started(tmp_path, past)
    assert not is_taken(signer, recorded, past), "it was never heard, and is two minutes old"
    signer.sign(b"", past)
    assert signer.sent > NOW


def test_a_station_that_has_a_later_clock_does_not_refuse_what_is_signed_here() -> None:
    signer = PacketSigner(KEY)
    assert is_taken(signer, ping(NOW + 10 * NEW_WITHIN), NOW)
    signer.sign(b"", NOW)
    assert signer.sent > NOW + 10 * NEW_WITHIN
    assert not is_taken(signer, ping(LAST_SIGNATURE + 1), NOW), "the field would be at its end"


@pytest.mark.parametrize(
    "spoilt",
    [
        *("", "{", "[" * 60000, "x" * 70000, "[]", '{"sent": 1}', '{"sent": 1, "newest": []}'),
        *('{"sent": 1, "newest": {"1.2": 3}}', '{"sent": 1, "newest": {"1.2.x": 3}}'),
        *('{"sent": -1, "newest": {}}', '{"sent": "now", "newest": {}}', "\xff"),
        f'{{"sent": 1, "newest": {{"1.1.1": {2**48}}}}}',
        '{"sent": 1, "newest": {}, "crc32": 7}',
        f'{{"sent": 1, "newest": {{}}, "crc32": {crc32(b"[1, {}]")}, "more": 1}}',
    ],
)
def test_a_memory_that_cannot_be_read_hides_nothing(tmp_path: Path, spoilt: str) -> None:
    signer = PacketSigner(KEY)
    memory = SignatureMemory(tmp_path, signer)
    memory.path.write_text(spoilt, "latin-1")
    assert "cannot be read" in memory.recall(NOW)
    assert not is_taken(signer, ping(NOW - SECOND), NOW)
    assert is_taken(signer, ping(NOW + SECOND), NOW)
    work(memory)
    assert not is_taken(started(tmp_path)[0], ping(NOW + SECOND), NOW)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_memory_has_a_greatest_time_and_a_greatest_size(tmp_path: Path, beyond: int) -> None:
    """The last one that fits, and what the clock may be behind it; 64 kB."""
    latest = LAST_SIGNATURE + AHEAD
    for text in (
        f'{{"sent": {latest + beyond}, "newest": {{}}}}',
        f'{{"sent": 1, "newest": {{"1.1.1": {latest + beyond}}}}}',
        '{"sent": 1, "newest": {}}'.ljust(65536 + beyond),
    ):
        memory = SignatureMemory(tmp_path, PacketSigner(KEY))
        memory.path.write_text(text)
        assert ("cannot be read" in memory.recall(NOW)) is bool(beyond)


def test_no_bit_of_it_turns_over_unnoticed(tmp_path: Path) -> None:
    """A time that became less would let in again what was recorded."""
    signer, memory = started(tmp_path)
    assert is_taken(signer, ping(NOW + SECOND), NOW)
    work(memory)
    whole = memory.path.read_bytes()
    assert SignatureMemory(tmp_path, PacketSigner(KEY)).recall(NOW) == ""
    for at in range(len(whole)):
        for bit in range(8):
            memory.path.write_bytes(whole[:at] + bytes((whole[at] ^ 1 << bit,)) + whole[at + 1 :])
            told = SignatureMemory(tmp_path, PacketSigner(KEY)).recall(NOW)
            if not told:  # what stands between values may be any white space
                assert json.loads(memory.path.read_bytes()) == json.loads(whole), (at, bit)


def test_one_of_an_older_version_is_read(tmp_path: Path) -> None:
    signer = PacketSigner(KEY)
    memory = SignatureMemory(tmp_path, signer)
    memory.path.write_text(f'{{"sent": {NOW + SECOND}, "newest": {{}}}}')
    assert memory.recall(NOW) == ""
    assert signer.sent == NOW + SECOND


def test_the_file_is_ours_alone_and_small_and_tells_no_key(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "for it"
    signer, memory = started(folder)
    for system in range(1, 251):
        at = NOW + system * 60 * SECOND // 25
        assert is_taken(signer, ping(at, system), at)
        work(memory)
    assert memory.path.stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700
    text = memory.path.read_text()
    assert len(json.loads(text)["newest"]) < 30, "who is older is refused for that"
    assert KEY.hex() not in text + memory.path.name
    assert [one.name for one in folder.iterdir()] == [memory.path.name]
    other = SignatureMemory(folder, PacketSigner(bytes(32)))
    assert other.path != memory.path


def test_two_bridges_with_one_key_forget_nothing_of_each_other(tmp_path: Path) -> None:
    first, first_memory = started(tmp_path)
    second, second_memory = started(tmp_path)
    assert is_taken(first, ping(NOW, 245), NOW)
    assert is_taken(second, ping(NOW + SECOND, 246), NOW)
    work(first_memory)
    work(second_memory)
    for memory in (first_memory, second_memory):
        last = memory.last()
        assert last is not None
        memory.write(last)
    later, _ = started(tmp_path)
    assert not is_taken(later, ping(NOW, 245), NOW)
    assert not is_taken(later, ping(NOW + SECOND, 246), NOW)


def test_of_one_sender_that_two_bridges_hear_the_later_word_counts(tmp_path: Path) -> None:
    bridges = [started(tmp_path), started(tmp_path)]
    for (signer, memory), at in zip(bridges, (NOW, NOW + SECOND), strict=True):
        assert is_taken(signer, ping(at), at)
        work(memory)
    for _, memory in reversed(bridges):
        last = memory.last()
        assert last is not None
        memory.write(last)
    later, _ = started(tmp_path, NOW + SECOND)
    assert not is_taken(later, ping(NOW + SECOND), NOW + SECOND)


def test_it_is_written_once_in_a_while_and_at_once_for_somebody_new(tmp_path: Path) -> None:
    signer, memory = started(tmp_path)
    writes = 0
    for step in range(600):
        is_taken(signer, ping(NOW + step * SECOND // 10), NOW)
        snapshot = memory.due()
        if snapshot is not None:
            writes += 1
            memory.write(snapshot)
    assert writes == pytest.approx(60 * SECOND / AHEAD, abs=2)
    assert is_taken(signer, ping(NOW, 246), NOW)
    assert memory.due() is not None


def test_a_disk_that_does_not_take_it_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    signer = PacketSigner(KEY)
    memory = SignatureMemory(tmp_path / "file" / "folder", signer)
    assert memory.recall(NOW)
    assert is_taken(signer, ping(NOW + 1), NOW)
    snapshot = memory.due()
    assert snapshot is not None
    with pytest.raises(OSError):  # noqa: PT011 - whichever it is
        memory.write(snapshot)
    assert memory.due() is not None


# -- the definitions, and what uses them -----------------------------------------------------------


ROOM = "".join(
    path.read_text(encoding="utf-8") for path in Path(codec.__file__).parents[1].rglob("*.py")
)


def test_each_message_that_is_defined_is_sent_or_read() -> None:
    # Setpoints by latitude and longitude are not flown; their frames are skipped as a whole.
    unread = ["SET_POSITION_TARGET_GLOBAL_INT"]
    assert [name for name in LAYOUTS if f'"{name}"' not in ROOM] == unread


def test_each_message_that_is_sent_or_read_is_defined() -> None:
    """A message without a definition would end the bridge when it is sent for the first time."""
    made = set(re.findall(r'\bMavlinkMessage\(\s*"(\w+)"', ROOM))
    assert len(made) > 15
    assert made - LAYOUTS.keys() == set()
    known: Any = Known()
    read = MavlinkVehicle(known, session_of(known), 1, 12)._handlers
    assert read.keys() - LAYOUTS.keys() == set()
