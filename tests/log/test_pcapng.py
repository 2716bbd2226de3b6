"""A log as packets: every byte of the line once, frames cut where they end."""

from __future__ import annotations

import io
import random
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.link import Direction
from m100link.log import read
from m100link.log.pcapng import (
    _letters,
    _lua,
    _Tables,
    begin_pcapng,
    cut,
    dissector,
    in_order,
    packet,
    read_frames,
    write_pcapng,
)
from m100link.log.reading import Chunk
from m100link.protocol.firmware import PROFILES
from m100link.wire import Cipher, FrameDecoder, encode_frame
from tests.log.flight import KEY, URL, fly

FRAMES = [encode_frame(bytes([2, 0, n]), session=0, sequence=n) for n in range(4)]


def packets(data: bytes) -> list[tuple[int, bytes, int]]:
    """Interface, bytes and direction of each packet, read as the format's text says."""
    found, at = [], 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        assert struct.unpack_from("<I", data, at + size - 4) == (size,)
        assert size % 4 == 0
        if kind == 6:
            interface, _, _, length, _ = struct.unpack_from("<5I", data, at + 8)
            begin = at + 28
            code, many, flag = struct.unpack_from("<HHI", data, begin + length + -length % 4)
            assert (code, many) == (2, 4)
            found.append((interface, data[begin : begin + length], flag))
        at += size
    return found


@pytest.mark.parametrize("kept", [9, 14])
@pytest.mark.parametrize("lost", [None, 0, 5, 14])
def test_frames_are_cut_where_they_end(lost: int | None, kept: int) -> None:
    second = FRAMES[1] if lost is None else FRAMES[1][:lost] + FRAMES[1][lost + 1 :]
    stream = b"noise" + FRAMES[0] + second + FRAMES[2] + FRAMES[3][:kept]
    pieces, rest = cut(stream)
    assert b"".join(pieces) + rest == stream
    assert pieces[:2] == [b"noise", FRAMES[0]]
    assert FRAMES[2] in pieces
    assert rest == FRAMES[3][:kept]
    assert cut(rest, is_end=True) == ([rest], b"")


def test_whatever_comes_every_byte_is_in_one_piece_and_every_frame_is_found() -> None:
    chance = random.Random(20261122)
    for _ in range(200):
        parts = [
            chance.choice(
                (
                    chance.randbytes(chance.randrange(30)),
                    encode_frame(chance.randbytes(chance.randrange(1, 60)), session=0, sequence=7),
                    b"\xaa" * chance.randrange(4),
                )
            )
            for _ in range(8)
        ]
        stream = b"".join(parts)
        pieces, rest = cut(stream, is_end=True)
        assert b"".join(pieces) + rest == stream
        found = [frame for piece in pieces for frame in FrameDecoder().feed(piece)]
        decoder = FrameDecoder()
        assert found == decoder.feed(stream) + decoder.close()


@pytest.mark.anyio
async def test_the_packets_are_the_bytes_of_the_line(tmp_path: Path) -> None:
    await fly(tmp_path / "flight.mcap", f"{URL}&loss=0.02&damage=0.01")
    flight = read(tmp_path / "flight.mcap")
    stream = io.BytesIO()
    count = write_pcapng(flight, stream, cipher=Cipher(KEY))
    found = packets(stream.getvalue())
    assert count == sum(interface == 0 for interface, _, _ in found)
    for direction, flag in ((Direction.RECEIVED, 1), (Direction.SENT, 2)):
        whole = b"".join(one.data for one in flight.chunks() if one.direction is direction)
        assert b"".join(data for i, data, way in found if (i, way) == (0, flag)) == whole
    plain = [data for interface, data, _ in found if interface == 1]
    assert len(plain) > 100
    decoded = [FrameDecoder().feed(data)[0] for data in plain]
    assert {frame.data[:2] for frame in decoded} >= {b"\x01\x03", b"\x01\x01"}


def test_the_unit_of_time_is_the_one_that_the_interface_says() -> None:
    """By the format: option 9, one byte: of a number n without its high bit 10 to the minus n s.

    Without it a reader takes microseconds, and a flight for one of a thousandth of its time.
    """
    stream, at = io.BytesIO(), 1_800_000_000.123456
    flight = SimpleNamespace(
        firmware=None,
        chunks=lambda: iter([SimpleNamespace(utc=at, data=FRAMES[0], direction=Direction.SENT)]),
    )
    write_pcapng(cast(Any, flight), stream)
    data, at_byte, units, found = stream.getvalue(), 0, [], []
    while at_byte < len(data):
        kind, size = struct.unpack_from("<II", data, at_byte)
        if kind == 1:
            options = at_byte + 16
            while struct.unpack_from("<H", data, options)[0]:
                code, length = struct.unpack_from("<HH", data, options)
                if code == 9:
                    assert length == 1
                    units.append(data[options + 4])
                options += 4 + length + -length % 4
        if kind == 6:
            _, high, low = struct.unpack_from("<3I", data, at_byte + 8)
            found.append((high << 32) + low)
        at_byte += size
    [unit], [time] = units, found
    assert unit < 0x80
    assert time / 10**unit == pytest.approx(at, abs=1e-6)


# -- frames of a log ------------------------------------------------------------------------------


def flight_of(*chunks: Chunk) -> Any:
    return SimpleNamespace(firmware=PROFILES["1.0"], chunks=lambda: iter(chunks))


def test_of_the_same_two_microseconds_what_was_sent_comes_first() -> None:
    rx, tx = Direction.RECEIVED, Direction.SENT
    given = [
        *(
            Chunk(rx, 1.0, 0.0, b"0"),
            Chunk(tx, 1.000001, 0.0, b"1"),
            Chunk(rx, 1.000002, 0.0, b"2"),
        ),
        *(Chunk(rx, 2.0, 0.0, b"3"), Chunk(tx, 2.000003, 0.0, b"4"), Chunk(rx, 3.0, 0.0, b"5")),
        *(Chunk(tx, 3.001, 0.0, b"6"), Chunk(tx, 4.0, 0.0, b"7"), Chunk(tx, 4.0, 0.0, b"8")),
    ]
    assert b"".join(one.data for one in in_order(given)) == b"102345678"


def test_each_frame_has_its_times_and_damaged_ones_their_place_cause_and_count() -> None:
    """What a later read brings is not counted with an earlier one, nor with the other direction."""
    rx, tx = Direction.RECEIVED, Direction.SENT
    asked = encode_frame(b"\x00\x00\x00", session=2, sequence=7)
    answer = encode_frame(b"\x00\x00" + bytes(36), session=2, sequence=7, is_ack=True)
    broken = FRAMES[2][:-1] + bytes([FRAMES[2][-1] ^ 0x10])
    wrong = broken[:10] + bytes([broken[10] ^ 0x10]) + broken[11:]  # in the checksum of its header
    found = read_frames(
        flight_of(
            Chunk(tx, 41.1234567, 1801.7654321, asked),
            Chunk(rx, 42.25, 1802.5, broken + broken + answer),
            Chunk(rx, 43.25, 1803.5, broken + wrong + FRAMES[1]),
            Chunk(tx, 44.0, 1804.0, broken + asked),
            Chunk(rx, 45.0, 1805.0, FRAMES[3][:9]),
        )
    )
    shown = [
        (one["at"], one["utc"], one["direction"], one.get("cause"), one.get("discards"))
        if "cause" in one
        else (one["at"], one["utc"], one["direction"], one["command"])
        for one in found
    ]
    assert shown == [
        (41.123457, 1801.765432, "tx", "get_version"),
        (42.25, 1802.5, "rx", "get_version"),
        (42.25, 1802.5, "rx", "frame_crc", 2),
        (43.25, 1803.5, "rx", "telemetry"),
        (43.25, 1803.5, "rx", "header_crc", 1),
        (43.25, 1803.5, "rx", "frame_crc", 1),
        (44.0, 1804.0, "tx", "get_version"),
        (44.0, 1804.0, "tx", "frame_crc", 1),
        (45.0, 1805.0, "rx", "truncated", 1),
    ]


def test_a_head_names_the_firmware_if_it_is_known() -> None:
    """An interface, or two. A packet has its bytes, padded to four, and their number."""
    heads = []
    for known, is_decrypted in ((None, False), (PROFILES["2.3"], True)):
        stream = io.BytesIO()
        begin_pcapng(stream, known, is_decrypted=is_decrypted)
        heads.append(stream.getvalue())
    assert heads[0].count(struct.pack("<HHI", 147, 0, 0)) == 1
    assert b"firmware" not in heads[0]
    assert heads[1].count(struct.pack("<HHI", 147, 0, 0)) == 2
    assert heads[1].count(b", firmware 2.3") == 2
    made = packet(1, b"\x01\x02\x03\x04\x05", 0x0123456789ABCDEF, Direction.SENT)
    options = struct.pack("<HHIHH", 2, 4, 2, 0, 0)
    size = 12 + 20 + 8 + len(options)
    body = struct.pack("<5I", 1, 0x01234567, 0x89ABCDEF, 5, 5) + b"\x01\x02\x03\x04\x05\0\0\0"
    assert made == struct.pack("<II", 6, size) + body + options + struct.pack("<I", size)


# -- the dissector's tables, by DJI's documents ---------------------------------------------------

POINT = (
    "index:B@0 latitude:d@1 longitude:d@9 altitude:f@17 damping:f@21 yaw:h@25 gimbal_pitch:h@27 "
    "turn_mode:B@29 has_action:B@38 action_time_limit:H@39 action_count:low@41 "
    "action_repeat:high@41 actions:B*"
)
PLAN = (
    "51 count:B@0 max_speed:f@1 idle_speed:f@5 finish_action:B@9 repeat:B@10 yaw_mode:B@11 "
    "trace_mode:B@12 rc_lost_action:B@13 gimbal_pitch_mode:B@14 focus_latitude:d@15 "
    "focus_longitude:d@23 focus_altitude:f@31"
)
CIRCLE = (
    "51 version:B@0 latitude:d@1 longitude:d@9 altitude:d@17 radius:d@25 angular_rate:f@33 "
    "clockwise:B@37 start_point:B@38 yaw_mode:B@39"
)
PLACE = "latitude:d@{} longitude:d@{} altitude:H@{} angle:H@{}"
ANGLES = "yaw:h@0 roll:h@2 pitch:h@4"
OWN = {
    **{0x0001: {"44 app_id:I@0 level:I@4 version:I@8 bundle_id:s*32@12"}},
    **{0x0010: {"16 rates:B*16@0"}, 0x00FE: {"-1 mobile_data:bytes*0@0"}},
    **{0x0100: {"1 obtain:B@0"}, 0x0101: {"2 task_sequence:B@0 task:B@1"}},
    **{0x0102: {"1 task_sequence:B@0"}, 0x0105: {"1 on:B@0"}},
    **{0x0103: {"17 flag:B@0 x:f@1 y:f@5 throttle:f@9 yaw:f@13"}},
    **{0x011A: {f"7 {ANGLES} flags:B@6"}, 0x011B: {f"8 {ANGLES} mode:B@6 duration:B@7"}},
    **{address: {"1 any:B@0", "0"} for address in (0x0120, 0x0121, 0x0122)},
    **{0x0201: {"1 code:B@0"}, 0x0202: {"-1 mobile_data:bytes*0@0"}},
    **{address: {"1 any:B@0"} for address in (0x0000, 0x0314, 0x0317, 0x0321, 0x0325, 0x0326)},
    0x0310: {PLAN},
    # The documents print 15 actions and 15 parameters, all libraries send 16.
    0x0311: {f"90 {POINT}16@42 parameters:h*16@58", f"87 {POINT}15@42 parameters:h*15@57"},
    **{0x0312: {"1 stop:B@0"}, 0x0315: {"1 index:B@0"}, 0x0316: {"4 idle_speed:f@0"}},
    **{address: {"1 resume:B@0"} for address in (0x0313, 0x0322, 0x0332)},
    **{0x0320: {CIRCLE}, 0x0323: {"5 clockwise:B@0 angular_rate:f@1"}, 0x0324: {"4 radius:f@0"}},
    **{0x0327: {"2 enable:B@0 rate:b@1"}, 0x0331: {"1 any:B@0"}},
    0x0330: {f"23 mode:B@0 yaw_mode:B@1 {PLACE.format(2, 10, 18, 20)} sensitivity:B@22"},
    0x0333: {f"20 {PLACE.format(0, 8, 16, 18)}"},
    **{0x0400: {"4 frequency:I@0"}, 0x0500: {"1 flags:B@0"}, 0x0501: {"64 channels:I*16@0"}},
}
"""Forms of the value of each command, by their size; 3.1's libraries have most of them."""
BEHIND_THE_CODE = {
    0x0000: {"36 crc:I@0 version:s*32@4", "47 crc:I@0 serial:s*11@4 version:s*32@15"},
    **{0x0311: {"1 index:B@0"}, 0x0314: {PLAN}, 0x0326: {CIRCLE}},
    0x0315: {f"90 {POINT}16@42 parameters:h*16@58"},
    **{0x0316: {"4 idle_speed:f@0"}, 0x0317: {"4 idle_speed:f@0"}},
    0x0320: {"4 largest_radius:f@0"},
}
"""What follows the code of an ack."""
IOC = "5 last_mission:B@0 flags:B@1 reason:B@2"
PUSHED = {
    (0x0203, 0): {IOC},
    (0x0203, 1): {"5 index:B@0 status:B@1 error:B@2"},
    (0x0203, 2): {"5 status:B@0 radius_cm:H@1 reason:B@3 rate:B@4"},
    (0x0203, 3): {"5"},
    (0x0203, 4): {IOC},
    (0x0204, 0): {"5 valid:B@0 estimated_time:H@1"},
    (0x0204, 1): {"5 repeat:B@0"},
    (0x0204, 2): {"5 index:B@0 status:B@1", "4 index:B@0 status:B@1"},  # 6 and 5 with the kind
}
"""What follows the kind of a push."""


def forms_of(made: dict[int, list[dict[str, Any]]]) -> set[str]:
    found = set()
    for size, parts in made.items():
        words = [str(size)]
        for part in parts:
            name = part["abbreviation"].rpartition(".")[2]
            many = "" if part["many"] == 1 else f"*{part['many']}"
            words.append(f"{name}:{part['format']}{many}@{part['offset']}")
        found.add(" ".join(words))
    return found


def test_wireshark_finds_each_field_of_each_command_where_the_documents_have_it() -> None:
    commands = _Tables().made()["commands"]
    assert {at: forms_of(one["forms"]) for at, one in commands.items() if "forms" in one} == OWN
    acks = {at: one["ack"] for at, one in commands.items() if "ack" in one}
    forms = {at: forms_of(one["forms"]) for at, one in acks.items() if "forms" in one}
    assert {at: one for at, one in forms.items() if one} == BEHIND_THE_CODE
    kinds = {
        (at, kind): forms_of(forms)
        for at, one in commands.items()
        for kind, forms in one.get("kinds", {}).items()
    }
    assert kinds == PUSHED
    # Acks of missions begin with a code of one byte, the others with one of two.
    assert {at for at, one in acks.items() if one["is_byte"]} == {
        *(0x0310 + number for number in range(8)),
        *(0x0320 + number for number in range(8)),
        *(0x0330 + number for number in range(4)),
    }
    words = {one["abbreviation"]: one["words"] for one in _Tables().made()["fields"]}
    for name, said in {
        "waypoint_mission.finish_action": ["hover", "go_home", "land", "first_point", "endless"],
        "waypoint_mission.yaw_mode": ["along_path", "as_at_start", "by_rc", "by_point"],
        "waypoint_point.turn_mode": ["clockwise", "counter_clockwise"],
        "hotpoint_start.clockwise": ["counter_clockwise", "clockwise"],
        "hotpoint_start.start_point": ["north", "south", "west", "east", "nearest"],
        "follow_start.yaw_mode": ["by_rc", "to_target"],
        "waypoint_start_stop.stop": ["start", "stop"],
        "waypoint_pause_resume.resume": ["pause", "resume"],
    }.items():
        assert words[f"m100.{name}"] == dict(enumerate(said))
    for at, code, name in (
        *(
            (0x0100, 2, "OBTAINED"),
            (0x0100, 0xFF01, "NOT_ACTIVATED"),
            (0x0310, 0xD0, "RC_NOT_IN_F"),
        ),
        *((0x0320, 0xFF00, "NOT_SUPPORTED"), (0x0000, 0, "ACTIVATED")),
    ):
        assert acks[at]["codes"][code] == name


def test_the_plugin_is_lua() -> None:
    assert _letters("2d2fB") == "ddffB"
    assert _letters("12sh") == "s" * 12 + "h"
    assert _lua({"a": [1, True, None], 2: 'x"\\y', "b": None, False: 0.0 or -3}) == (
        '{["a"]={1,\ntrue,\nnil},[2]="x\\"\\\\y",[false]=-3}'
    )
    text = dissector()
    assert text.startswith("-- Made by m100link; not to be edited.\nlocal M = {")
    kinds = {one["abbreviation"]: one["kind"] for one in _Tables().made()["fields"]}
    assert kinds["m100.gimbal_angle.yaw"] == "int32"
    assert kinds["m100.activate.bundle_id"] == "string"
    assert kinds["m100.waypoint_point.latitude"] == "double"
    assert kinds["m100.waypoint_point.action_repeat"] == "uint32"
    assert kinds["m100.send_to_mobile.mobile_data"] == "bytes"
    assert kinds["m100.mission_status.kind"] == "uint32"
