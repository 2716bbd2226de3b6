"""What a stream says, whatever pieces it comes in; each kind of frame:
tests/apps/cli/test_decode.py."""

from __future__ import annotations

import pytest

from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.describing import Describer
from m100link.protocol.firmware import FIRMWARE_1_0, profile
from m100link.wire import Cipher, encode_frame

CIPHER = Cipher(bytes(range(32)))
ASKED = encode_frame(b"\x00\x00\x00", session=2, sequence=7)
SEALED = encode_frame(b"\x01\x00\x01", session=2, sequence=8, cipher=CIPHER)


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_the_pieces_of_a_stream_do_not_matter(size: int) -> None:
    stream = b"junk" + ASKED + SEALED
    whole = Describer(FIRMWARE_1_0)
    pieces = Describer(FIRMWARE_1_0)
    found = [
        frame for at in range(0, len(stream), size) for frame in pieces.feed(stream[at : at + size])
    ]
    assert found == whole.feed(stream)
    assert [one["command"] for one in found] == [GetVersion.NAME, None]
    assert found[1]["frame_crc"] == f"0x{int.from_bytes(SEALED[-4:], 'little'):08X}"


def test_an_ack_of_one_direction_answers_what_the_other_asked() -> None:
    sent, received = Describer(FIRMWARE_1_0, CIPHER), Describer(FIRMWARE_1_0, CIPHER)
    received.answered = sent.asked
    sent.feed(SEALED)
    [answer] = received.feed(encode_frame(b"\x02\x00", session=2, sequence=8, is_ack=True))
    assert answer["command"] == "request_authority"
    assert answer["ack"]["name"] == "OBTAINED"


def test_an_ack_of_a_code_alone_says_that_the_rest_did_not_come() -> None:
    """A refusal may be one byte where five are due; no radius of 0 m is read into it."""
    asked = encode_frame(b"\x03\x20" + bytes(51), session=2, sequence=9)
    ack = {size: bytes.fromhex("e700000080")[:size] for size in (1, 5)}
    found = {}
    for size, payload in ack.items():
        describer = Describer(profile("3.1"))
        describer.feed(asked)
        answer = encode_frame(payload, session=2, sequence=9, is_ack=True)
        [found[size]] = describer.feed(answer)
    assert found[1]["command"] == found[5]["command"] == "hotpoint_start"
    assert found[1]["ack"] == found[5]["ack"]
    assert found[1]["note"] == "its code alone: the rest did not come"
    assert list(found[1]["raw"]) == ["code"]
    assert "max_radius" in found[5]["raw"]


def test_an_ack_that_cannot_be_read_keeps_the_name_of_what_it_answers() -> None:
    describer = Describer(FIRMWARE_1_0, CIPHER)
    describer.feed(SEALED)
    [answer] = describer.feed(encode_frame(b"\x02", session=2, sequence=8, is_ack=True))
    assert answer["command"] == "request_authority"
    assert "request_authority" in answer["problem"]
    assert "ack" not in answer
