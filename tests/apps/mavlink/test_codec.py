"""Frames of MAVLink: as others write and read them, and nothing that is not one."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import pytest

from m100link.apps.mavlink.translator import codec
from m100link.apps.mavlink.translator.codec import (
    LAYOUTS,
    Message,
    Reading,
    Signer,
    read_datagram,
    write_frame,
)

KEY = bytes(range(32))


def frame(name: str = "PING", *, sequence: int = 0, **fields: Any) -> bytes:
    return write_frame(Message(name, fields), system=7, sequence=sequence)


def test_a_message_comes_out_as_it_went_in() -> None:
    fields: dict[str, Any] = {"severity": 4, "text": "no more than fifty", "id": 3, "chunk_seq": 1}
    [message] = read_datagram(frame("STATUSTEXT", **fields))
    assert message == Message("STATUSTEXT", fields, 7, 1)


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_message_is_read_as_it_was_written(name: str) -> None:
    layout = LAYOUTS[name]
    values = layout.read(bytes(Random(name).choices(range(1, 60), k=layout.size)))
    [message] = read_datagram(frame(name, **values))
    assert message.fields == values
    [empty] = read_datagram(frame(name))
    assert set(empty.fields) == set(layout.fields)


def test_values_at_the_end_that_are_zero_are_not_sent() -> None:
    assert len(frame("PING")) == 10 + 1 + 2
    [message] = read_datagram(frame("PING"))
    assert message["seq"] == 0


def test_a_frame_of_the_first_version_is_read() -> None:
    heartbeat = bytes.fromhex("fe09 2a ff 00 00 00000000 06 08 c0 04 03".replace(" ", ""))
    crc = LAYOUTS["HEARTBEAT"].crc_extra
    whole = heartbeat + codec._CHECKSUM.pack(codec._crc(heartbeat[1:] + bytes([crc])))
    [message] = read_datagram(whole)
    assert (message.name, message.system, message["mavlink_version"]) == ("HEARTBEAT", 255, 3)


def test_damage_is_refused() -> None:
    whole = frame("COMMAND_LONG", command=400, param1=1.0)
    for place in range(len(whole)):
        for bit in range(8):
            hurt = bytearray(whole)
            hurt[place] ^= 1 << bit
            found = [one for one in read_datagram(bytes(hurt)) if one.name == "COMMAND_LONG"]
            # The flags of compatibility and the sequence are covered, too: nothing passes.
            assert found == []


def test_a_false_start_swallows_nothing_behind_it() -> None:
    random, valid = Random(2), frame("COMMAND_LONG", command=400, param1=1.0)
    for _ in range(500):
        junk = bytes(random.choices((0xFD, 0xFE, 0, 9, 76, 255), k=random.randrange(60)))
        [message] = read_datagram(junk + valid + junk)
        assert message["command"] == 400


def test_junk_is_nothing() -> None:
    random = Random(4)
    for _ in range(3000):
        data = random.randbytes(random.randrange(300))
        assert list(read_datagram(data)) == []


def test_reading_tells_what_it_cost() -> None:
    """Bytes that were checked as a frame: those of a frame once, of overlapping ones many times."""
    valid = frame("COMMAND_LONG", command=400, param1=1.0)
    reading = Reading(bytes(500) + valid + bytes(500))
    assert [message.name for message in reading] == ["COMMAND_LONG"]
    assert reading.checked == len(valid)
    overlapping = Reading(b"\xfe\xf0\0\0\0\0" * 230)
    assert list(overlapping) == []
    assert overlapping.checked > 30 * 1380


def test_a_datagram_is_left_when_it_cost_too_much() -> None:
    valid = frame("COMMAND_LONG", command=400, param1=1.0)
    hostile = b"\xfe\xf0\0\0\0\0" * 10_000
    reading = Reading(valid + hostile, most=16_384)
    assert len(list(reading)) == 1, "what stands before it is read"
    assert reading.checked < 17_000


# -- signatures -----------------------------------------------------------------------------------


def signed(signer: Signer, now: int, name: str = "PING") -> bytes:
    return write_frame(Message(name, {}), system=7, sequence=0, signer=signer, now=now)


def taken(reader: Signer, data: bytes, now: int = 1000) -> int:
    return len(list(read_datagram(data, signer=reader, now=now)))


def test_what_is_signed_with_the_key_is_taken_once() -> None:
    writer, reader = Signer(KEY), Signer(KEY)
    first, second = signed(writer, 1000), signed(writer, 1000)
    assert taken(reader, first) == 1
    assert taken(reader, first) == 0, "it was recorded and sent again"
    assert taken(reader, second) == 1
    assert reader.refused == 1


def test_what_is_not_signed_or_with_another_key_is_refused_heartbeats_excepted() -> None:
    reader = Signer(KEY)
    assert taken(reader, frame("PING")) == 0
    assert taken(reader, signed(Signer(bytes(32)), 1000)) == 0
    assert taken(reader, signed(Signer(bytes(32)), 1000, "HEARTBEAT")) == 0
    assert taken(reader, frame("HEARTBEAT")) == 1


def of_the_first_version(name: str) -> bytes:
    """Which knows no signatures."""
    layout = LAYOUTS[name]
    payload = bytes(layout.size)
    head = bytes([0xFE, len(payload), 0, 255, 190, layout.number])
    crc = codec._crc(head[1:] + payload + bytes([layout.crc_extra]))
    return head + payload + codec._CHECKSUM.pack(crc)


@pytest.mark.parametrize(
    ("name", "data", "has_key", "expected"),
    [
        ("HEARTBEAT", frame("HEARTBEAT"), True, [False]),
        ("HEARTBEAT", frame("HEARTBEAT"), False, [False]),
        ("HEARTBEAT", of_the_first_version("HEARTBEAT"), True, [False]),
        ("HEARTBEAT", of_the_first_version("HEARTBEAT"), False, [False]),
        ("HEARTBEAT", signed(Signer(KEY), 1000, "HEARTBEAT"), True, [True]),
        # Nobody looked at it: what has no key trusts all, and says of none that it was signed.
        ("HEARTBEAT", signed(Signer(KEY), 1000, "HEARTBEAT"), False, [False]),
        ("PING", signed(Signer(KEY), 1000), True, [True]),
        ("PING", signed(Signer(KEY), 1000), False, [False]),
        ("PING", of_the_first_version("PING"), True, []),
        ("PING", of_the_first_version("PING"), False, [False]),
    ],
)
def test_signed_is_what_came_with_a_signature_of_the_key(
    name: str, data: bytes, has_key: bool, expected: list[bool]
) -> None:
    reading = Reading(bytes(20) + data, signer=Signer(KEY) if has_key else None, now=1000)
    assert [(one.name, one.is_signed) for one in reading] == [(name, one) for one in expected]
    assert reading.checked == len(data)


def test_a_wrong_signature_does_not_lock_out_the_right_one() -> None:
    reader = Signer(KEY)
    assert taken(reader, signed(Signer(bytes(32)), 10**12)) == 0
    assert taken(reader, signed(Signer(KEY), 1000)) == 1


def test_a_sender_that_is_new_may_not_be_a_minute_old() -> None:
    reader = Signer(KEY)
    assert taken(reader, signed(Signer(KEY), 1000), now=1000 + 6_000_001) == 0


def test_of_more_senders_than_are_remembered_the_old_ones_give_way_after_a_minute() -> None:
    """Times are in 10 µs. One that is heard first again is refused what it said before."""
    reader, begin, minute = Signer(KEY), 10**9, 6_000_000
    recorded = [signed(Signer(KEY, link=link), begin) for link in range(64)]
    assert [taken(reader, one, begin) for one in recorded] == [1] * 64
    late = [signed(Signer(KEY, link=64), begin + minute - back) for back in (1, 0)]
    assert [taken(reader, late[0], begin + minute - 1), len(reader.newest)] == [0, 64]
    assert [taken(reader, late[1], begin + minute), len(reader.newest)] == [1, 1]
    assert [taken(reader, one, begin + minute) for one in recorded] == [0] * 64


def test_the_key_is_not_shown() -> None:
    assert "\\x01" not in repr(Signer(KEY))


# -- pymavlink ------------------------------------------------------------------------------------


@pytest.fixture
def dialects() -> list[Any]:
    return [
        pytest.importorskip(f"pymavlink.dialects.v20.{name}") for name in ("common", "development")
    ]


def test_the_definitions_are_those_of_pymavlink(dialects: list[Any]) -> None:
    for name, layout in LAYOUTS.items():
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
    assert reader.decode(bytearray(signed(Signer(KEY), 10**10))).get_type() == "PING"


def test_what_pymavlink_writes_is_read(dialects: list[Any]) -> None:
    common = dialects[0]
    writer = common.MAVLink(None, srcSystem=9, srcComponent=4)
    data = common.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 7.5, 9).pack(writer)
    [message] = read_datagram(bytes(data))
    assert (message.system, message.component) == (9, 4)
    assert (message["param_id"], message["param_value"]) == ("MIS_TAKEOFF_ALT", 7.5)
    writer.signing.secret_key, writer.signing.sign_outgoing = KEY, True
    writer.signing.timestamp = 1000
    signed_ping = common.MAVLink_ping_message(1, 2, 0, 0).pack(writer)
    assert taken(Signer(KEY), bytes(signed_ping)) == 1
