"""``m100link decode``: golden bytes in, the documented JSON out."""

from __future__ import annotations

import io
import json
import math
import struct
import sys
from typing import Any

import pytest

from m100link.wire import FrameDecoder
from tests.apps.cli.conftest import CommandLine, process
from tests.support import KEY, crc16, crc32, encrypted_frame, load_vectors, raw_frame

FRAMES = load_vectors("frames")
MOVEMENT = load_vectors("movement")
STREAMS = load_vectors("streams")
TELEMETRY = load_vectors("telemetry")
LATER = [row for row in load_vectors("later-commands") if row["kind"] != "dialogue"]


def test_every_golden_frame(cli: CommandLine) -> None:
    plain = [vector for vector in FRAMES if not vector["key"]]
    outcomes = [(plain, cli("decode", *(vector["frame"] for vector in plain)))]
    for vector in FRAMES:
        if vector["key"]:
            outcomes += [([vector], cli("decode", "--key", vector["key"], vector["frame"]))]
    assert {(outcome.status, outcome.err) for _, outcome in outcomes} == {(0, "")}
    for vector, decoded in (
        pair for asked, outcome in outcomes for pair in zip(asked, outcome.objects, strict=True)
    ):
        [frame] = decoded["frames"]
        assert decoded["discarded_bytes"] == 0
        assert decoded["discards"] == {}
        assert frame["session"] == vector["session"]
        assert frame["is_ack"] is bool(vector["ack"])
        assert frame["sequence"] == vector["seq"]
        assert frame["data"] == vector["data"]
        assert frame["encrypted"] is bool(vector["key"] and vector["data"])
        assert "command" in frame


def test_every_golden_stream(cli: CommandLine) -> None:
    """Noise, damage and frames nested in frames: the list of frames is the judge."""
    for vector in STREAMS:
        [decoded] = cli("decode", "--key", vector["key"], vector["bytes"]).objects
        found = [
            (f["session"], f["is_ack"], f["encrypted"], f["padding"], f["sequence"], f["data"])
            for f in decoded["frames"]
        ]
        expected = [
            (f["session"], bool(f["ack"]), bool(f["enc"]), f["padding"], f["seq"], f["data"])
            for f in vector["frames"]
        ]
        assert found == expected
        on_wire = sum(
            12 if not f["data"] and not f["encrypted"] else 16 + len(f["data"]) // 2 + f["padding"]
            for f in decoded["frames"]
        )
        assert on_wire + decoded["discarded_bytes"] == len(vector["bytes"]) // 2


def test_every_golden_telemetry_package(cli: CommandLine) -> None:
    for firmware in ("1.0", "2.3", "3.1"):
        vectors = [vector for vector in TELEMETRY if vector["firmware"] == firmware]
        frames = (raw_frame(b"\x02\x00" + bytes.fromhex(one["value"])).hex() for one in vectors)
        told = cli("decode", "--firmware", firmware, *frames).objects
        for vector, decoded in zip(vectors, told, strict=True):
            [found] = decoded["frames"]
            assert found["command"] == "telemetry"
            assert found["telemetry"] == vector["items"]


@pytest.mark.parametrize(
    ("firmware", "value"),
    [
        ("1.0", "value"),
        ("2.3", "value"),
        ("3.1", "value"),
        ("1.0-document", "value_in_document_order"),
    ],
)
def test_every_golden_movement(cli: CommandLine, firmware: str, value: str) -> None:
    """The default order on the wire is throttle before yaw; the document prints the other."""
    names = ("control_flag", "roll_or_x", "pitch_or_y", "throttle_or_z", "yaw")
    frames = (raw_frame(b"\x01\x03" + bytes.fromhex(vector[value])).hex() for vector in MOVEMENT)
    told = cli("decode", "--firmware", firmware, *frames).objects
    for vector, decoded in zip(MOVEMENT, told, strict=True):
        [found] = decoded["frames"]
        assert found["command"] == "move"
        assert found["movement"] == {name: vector[name] for name in names}


def test_the_example_of_the_issue(cli: CommandLine) -> None:
    """``{"session": 2, "is_ack": false, "sequence": 7, "encrypted": true, "padding": 13, …}``."""
    frame = encrypted_frame(b"\x01\x00\x01", session=2, sequence=7)
    [decoded] = cli("decode", "--key", KEY.hex(), frame.hex()).objects
    assert list(decoded) == ["frames", "discarded_bytes", "discards"]
    [found] = decoded["frames"]
    assert found == {
        "session": 2,
        "is_ack": False,
        "sequence": 7,
        "encrypted": True,
        "padding": 13,
        "data": "010001",
        "command": "request_authority",
        "obtain": True,
    }


def test_an_ack_is_read_by_the_command_that_it_answers(cli: CommandLine) -> None:
    command = raw_frame(b"\x01\x00\x01", session=2, sequence=7)
    ack = raw_frame(b"\x03\x00", session=2, sequence=7, is_ack=True)
    [both] = cli("decode", (command + ack).hex()).objects
    assert both["frames"][1]["command"] == "request_authority"
    assert both["frames"][1]["ack"]["code"] == 3
    [alone] = cli("decode", ack.hex()).objects
    assert alone["frames"][0]["command"] is None


STREAMED = [row.get("request", "") + row["frame"] for row in LATER]
OUTSIDE = {"session", "is_ack", "sequence", "encrypted", "padding", "data", "command", "raw"}


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_every_golden_row_of_later_firmware(cli: CommandLine, firmware: str) -> None:
    """Fields as on the wire, whatever the profile; an ack is read with its request."""
    for row, decoded in zip(
        LATER, cli("decode", "--firmware", firmware, *STREAMED).objects, strict=True
    ):
        assert decoded["discarded_bytes"] == 0
        found = decoded["frames"][-1]
        assert (found["command"], found["raw"]) == (row["name"], row["fields"])
        assert "problem" not in found
        assert ("firmware_note" in found) is (row["since"] > firmware)
        if row["kind"] == "ack":
            assert found["ack"]["code"] == row["fields"]["code"]


def test_golden_rows_of_later_firmware_encrypted_and_in_one_stream(cli: CommandLine) -> None:
    plain_frames, sealed = [], b""
    for sequence, row in enumerate(LATER):
        for frame in filter(None, (row.get("request"), row["frame"])):
            [inner] = FrameDecoder().feed(bytes.fromhex(frame))
            sealed += encrypted_frame(
                inner.data, session=inner.session, sequence=sequence, is_ack=inner.is_ack
            )
            plain_frames.append((row, frame))
    [decoded] = cli("decode", "--key", KEY.hex(), sealed.hex()).objects
    assert len(decoded["frames"]) == len(plain_frames)
    for found, (row, frame) in zip(decoded["frames"], plain_frames, strict=True):
        assert found["encrypted"]
        assert found["command"] == row["name"]
        if frame == row["frame"]:
            assert found["raw"] == row["fields"]


def test_values_outside_their_range_are_shown_with_a_note(cli: CommandLine) -> None:
    for row, decoded in zip(LATER, cli("decode", *STREAMED).objects, strict=True):
        found = decoded["frames"][-1]
        assert "note" not in found or not row["legal"]
    frame = raw_frame(b"\x03\x24" + struct.pack("<f", math.nan))
    [found] = cli("decode", frame.hex()).objects[0]["frames"]
    assert found["raw"] == {"radius": "nan"}
    assert found["note"] == "radius is nan, allowed: 5 to 500 m"
    frame = raw_frame(b"\x01\x1a" + struct.pack("<3hB", 1801, 0, -1900, 0x80))
    [found] = cli("decode", frame.hex()).objects[0]["frames"]
    assert found["yaw_deg_s"] == 180.1
    for words in ("yaw is 1801", "pitch is -1900", "-1800 to 1800"):
        assert words in found["note"]


def test_degrees_metres_and_words_stand_beside_the_wire(cli: CommandLine) -> None:
    for row, decoded in zip(LATER, cli("decode", *STREAMED).objects, strict=True):
        friendly = decoded["frames"][-1].keys() - OUTSIDE - {"note", "firmware_note"}
        meaningless = row["fields"].keys() == {"any"} and row["set"] == 0x01
        assert bool(friendly) is not meaningless, row
    row = next(row for row in LATER if row["name"] == "hotpoint_start")
    [found] = cli("decode", row["frame"]).objects[0]["frames"]
    assert found["latitude_deg"] == pytest.approx(math.degrees(row["fields"]["latitude"]))
    assert found["radius_m"] == 5.0
    assert found["start_point"] == "west"


def test_an_ack_is_read_even_when_its_command_cannot_be(cli: CommandLine) -> None:
    request = raw_frame(b"\x03\x12", session=2, sequence=7)
    ack = raw_frame(b"\xdb", session=2, sequence=7, is_ack=True)
    first, second = cli("decode", (request + ack).hex()).objects[0]["frames"]
    assert first["command"] == second["command"] == "waypoint_start_stop"
    assert "takes 1 byte(s), there are 0" in first["problem"]
    assert second["raw"] == {"code": 0xDB}
    assert second["ack"]["name"] == "BAD_PARAMETERS"


@pytest.mark.parametrize(
    ("payload", "code", "name"),
    [(b"\xea", 0xEA, "NO_MISSION"), (b"\x01\xff", 0xFF01, "NOT_ACTIVATED")],
)
def test_of_an_ack_that_is_a_code_alone_nothing_is_invented(
    cli: CommandLine, payload: bytes, code: int, name: str
) -> None:
    request = raw_frame(b"\x03\x14\x00", session=2, sequence=7)
    ack = raw_frame(payload, session=2, sequence=7, is_ack=True)
    found = cli("decode", (request + ack).hex()).objects[0]["frames"][1]
    assert found["raw"] == {"code": code}
    assert found["ack"]["name"] == name


def test_one_stream_per_argument_and_per_line_of_standard_input(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = [vector["frame"] for vector in FRAMES if vector["key"] is None][:3]
    by_arguments = cli("decode", *frames)
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n".join(frames) + "\n"))
    by_lines = cli("decode")
    assert by_lines == by_arguments
    assert len(by_lines.objects) == 3


def test_standard_input_of_a_real_pipe() -> None:
    frames = [vector["frame"] for vector in FRAMES if vector["key"] is None][:3]
    outcome = process("decode", stdin="\n".join(frames))
    assert (outcome.status, outcome.err) == (0, "")
    assert [o["frames"][0]["data"] for o in outcome.objects] == [
        vector["data"] for vector in FRAMES if vector["key"] is None
    ][:3]


@pytest.mark.parametrize("form", ["{0}", "{0} ", "{1}", "{2}", "0x{0}"])
def test_ways_in_which_people_write_hex(cli: CommandLine, form: str) -> None:
    frame = FRAMES[0]["frame"]
    pairs = [frame[at : at + 2] for at in range(0, len(frame), 2)]
    text = form.format(frame, ":".join(pairs), " ".join(pairs).upper())
    [decoded] = cli("decode", text).objects
    assert len(decoded["frames"]) == 1


@pytest.mark.parametrize("text", ["zz", "aa0", "hello world", "0xgg"])
def test_what_is_not_hex_is_reported_and_does_not_stop_the_rest(
    cli: CommandLine, text: str
) -> None:
    outcome = cli("decode", text, FRAMES[0]["frame"])
    assert outcome.status == 2
    assert "this is not hex" in outcome.err
    assert "pairs of 0-9 and a-f" in outcome.err
    bad, good = outcome.objects
    assert "not hex" in bad["error"]
    assert len(good["frames"]) == 1


@pytest.mark.parametrize("key", ["00", "0" * 63, "0" * 65, "g" * 64])
def test_a_key_that_is_none_is_reported_without_being_repeated(cli: CommandLine, key: str) -> None:
    outcome = cli("decode", "--key", key, FRAMES[0]["frame"])
    assert outcome.status == 2
    assert outcome.out == ""
    assert "64" in outcome.err
    assert "error: the key" in outcome.err
    if len(key) > 2:
        assert key not in outcome.err


def test_an_unknown_firmware_is_a_usage_error(cli: CommandLine) -> None:
    outcome = cli("decode", "--firmware", "9.9", FRAMES[0]["frame"])
    assert outcome.status == 2
    assert "1.0-document" in outcome.out + outcome.err


def test_garbage_is_counted_by_cause(cli: CommandLine) -> None:
    damaged = bytearray(raw_frame(b"\x01\x00\x01"))
    damaged[-1] ^= 1
    [decoded] = cli("decode", (b"\x00\x01\x02" + damaged).hex()).objects
    assert decoded["frames"] == []
    assert decoded["discarded_bytes"] == 3 + len(damaged)
    assert sum(decoded["discards"].values()) >= 1


def test_telemetry_that_does_not_fit_names_the_profile_that_does(cli: CommandLine) -> None:
    vector = next(v for v in TELEMETRY if v["firmware"] == "3.1" and v["flags"] == 4095)
    frame = raw_frame(b"\x02\x00" + bytes.fromhex(vector["value"]))
    [decoded] = cli("decode", "--firmware", "1.0", frame.hex()).objects
    [found] = decoded["frames"]
    assert "problem" in found
    assert found["fitting_firmware"] == ["3.1"]


def test_encrypted_frames_without_a_key_show_all_but_their_data(cli: CommandLine) -> None:
    wire = encrypted_frame(b"\x01\x00\x01", session=2, sequence=7)
    command = raw_frame(b"\x01\x02\x05", session=3, sequence=8)
    ack = encrypted_frame(b"\x05\x00", session=3, sequence=8, is_ack=True)
    [decoded] = cli("decode", (b"\x55" + wire + command + ack).hex()).objects
    assert (decoded["discarded_bytes"], decoded["discards"]) == (1, {})
    sealed, plain, sealed_ack = decoded["frames"]
    assert sealed == {
        "session": 2,
        "is_ack": False,
        "sequence": 7,
        "encrypted": True,
        "padding": 13,
        "data": None,
        "command": None,
        "length": 32,
        "data_length": 3,
        "header_crc": f"0x{crc16(wire[:10]):04X}",
        "frame_crc": f"0x{crc32(wire[:-4]):08X}",
        "ciphertext": wire[12:-4].hex(),
        "problem": "encrypted, and no key was given",
    }
    assert plain["command"] == "query_task"
    assert sealed_ack["is_ack"]
    assert (sealed_ack["length"], sealed_ack["data_length"]) == (32, 2)


def test_a_table_of_frames_without_a_key(cli: CommandLine) -> None:
    outcome = cli("decode", "--table", encrypted_frame(b"\x01\x00\x01", sequence=7).hex())
    assert outcome.status == 0
    assert "0 bytes discarded" in outcome.out
    assert "no key" in " ".join(outcome.out.split())


def test_every_golden_stream_without_its_key_has_the_same_frames(cli: CommandLine) -> None:
    told = cli("decode", *(vector["bytes"] for vector in STREAMS)).objects
    for vector, decoded in zip(STREAMS, told, strict=True):
        frames, expected = decoded["frames"], vector["frames"]
        found = [(f["session"], f["is_ack"], f["padding"], f["sequence"]) for f in frames]
        assert found == [(f["session"], bool(f["ack"]), f["padding"], f["seq"]) for f in expected]
        stream = bytes.fromhex(vector["bytes"])
        for shown in frames:
            if shown["data"] is None:
                assert bytes.fromhex(shown["ciphertext"]) in stream
                checksum = bytes.fromhex(shown["frame_crc"][2:])[::-1]
                assert bytes.fromhex(shown["ciphertext"]) + checksum in stream


def test_nan_in_a_movement_is_json_all_the_same(cli: CommandLine) -> None:
    value = bytes((0x48,)) + b"\x00\x00\xc0\x7f" * 4
    outcome = cli("decode", raw_frame(b"\x01\x03" + value).hex())

    def refuse(name: str) -> Any:
        pytest.fail(f"{name} is no JSON")

    decoded = json.loads(outcome.out, parse_constant=refuse)
    assert decoded["frames"][0]["movement"]["yaw"] == "nan"


def test_a_table_for_people(cli: CommandLine) -> None:
    outcome = cli("decode", "--table", raw_frame(b"\x01\x00\x01", session=2, sequence=7).hex())
    assert outcome.status == 0
    assert "request_authority" in outcome.out
    assert "0 bytes discarded" in outcome.out


def test_nothing_to_decode_prints_nothing(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert cli("decode") == (0, "", "")
