"""What a stream says, whatever pieces it comes in; each kind of frame:
tests/apps/cli/test_decode.py."""

from __future__ import annotations

import pytest

from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.describing import Describer
from m100link.protocol.firmware import FIRMWARE_1_0, profile
from m100link.wire import Cipher, encode_frame
from tests.support import encrypted_frame, raw_frame

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


def test_acks_that_come_in_another_order_answer_each_its_own_command() -> None:
    """Sessions hold several requests: the number of an ack is that of its command (1.4)."""
    describer = Describer(FIRMWARE_1_0, CIPHER)
    for data, sequence in ((b"\x01\x00\x01", 8), (b"\x01\x01\x01\x04", 9)):
        describer.feed(encode_frame(data, session=2, sequence=sequence))
    acks = [encode_frame(b"\x02\x00", session=2, sequence=at, is_ack=True) for at in (9, 8)]
    found = [one["command"] for ack in acks for one in describer.feed(ack)]
    assert found == ["start_task", "request_authority"]


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


# -- encrypted frames -----------------------------------------------------------------------------

KEYED = encrypted_frame(b"\x01\x00\x01", key=bytes(range(32)), session=2, sequence=8)
EMPTY = raw_frame(b"", encryption=1, session=2, sequence=3)  # a header alone
TOO_LONG = raw_frame(bytes(16), encryption=1, padding=16, session=2, sequence=4)  # padding alone


@pytest.mark.parametrize("cipher", [None, CIPHER])
@pytest.mark.parametrize("first", [(), (EMPTY,), (EMPTY, EMPTY), (TOO_LONG,), (EMPTY, TOO_LONG)])
def test_a_frame_that_says_encrypted_and_has_no_data_does_not_shift_those_after_it(
    cipher: Cipher | None, first: tuple[bytes, ...]
) -> None:
    found = Describer(FIRMWARE_1_0, cipher).feed(b"".join(first) + KEYED + EMPTY + KEYED)
    assert [one["sequence"] for one in found[-3:]] == [8, 3, 8]
    assert all(one["encrypted"] for one in found)
    assert (found[-2]["data"], found[-2]["command"]) == ("", None)
    ciphertext = KEYED[12:-4].hex()
    for one in (found[-3], found[-1]):
        if cipher is None:
            assert (one["ciphertext"], one["command"]) == (ciphertext, None)
        else:
            assert (one["data"], one["command"]) == ("010001", "request_authority")


def test_without_a_key_a_frame_is_described_as_it_travelled() -> None:
    """2 + 1 bytes of data in one block of 16; header 12 and checksum 4 bytes around it."""
    [sealed] = Describer(FIRMWARE_1_0).feed(KEYED)
    assert (sealed["length"], sealed["data_length"], sealed["padding"]) == (32, 3, 13)
    assert sealed["header_crc"] == f"0x{int.from_bytes(KEYED[10:12], 'little'):04X}"
    assert sealed["frame_crc"] == f"0x{int.from_bytes(KEYED[28:], 'little'):08X}"
    assert sealed["problem"] == "encrypted, and no key was given"
    # Three bits say encrypted, any but 0 is AES. Ours have 1: of others the checksum is not known.
    other = raw_frame(KEYED[12:-4], encryption=3, padding=13, session=2, sequence=8)
    [unlike] = Describer(FIRMWARE_1_0).feed(other)
    assert (unlike["header_crc"], unlike["frame_crc"], unlike["data_length"]) == (None, None, 3)


def test_a_frame_of_many_reads_is_known_as_it_was_sent() -> None:
    """The longest has 1023 bytes: 62 blocks of data."""
    longest = encrypted_frame(bytes(991), key=bytes(range(32)), session=1, sequence=9)
    assert len(longest) == 1008
    describer = Describer(FIRMWARE_1_0)
    describer.feed(bytes(3000))
    found = [one for at in range(len(longest)) for one in describer.feed(longest[at : at + 1])]
    assert [one["frame_crc"] for one in found] == [
        f"0x{int.from_bytes(longest[-4:], 'little'):08X}"
    ]


def test_what_the_document_does_not_have_is_said_with_each_command() -> None:
    """Later commands have their fields as on the wire; a note names firmware that lacks one."""
    rates = encode_frame(b"\x00\x10" + bytes(range(16)), session=2, sequence=1)
    later, old = (Describer(profile(name)).feed(rates)[0] for name in ("3.1", "1.0"))
    assert later["command"] == old["command"] == "set_telemetry_rates"
    assert later["raw"] == old["raw"]
    assert "firmware_note" not in later
    assert "does not know this command: it came with" in old["firmware_note"]
    [first] = Describer(profile("3.1")).feed(ASKED)
    assert "raw" not in first
    unknown = encode_frame(b"\x07\x07\x00", session=2, sequence=1)
    [strange] = Describer(profile("3.1")).feed(unknown)
    assert (strange["command"], strange["data"]) == (None, "070700")
    assert strange["problem"]
    [empty] = Describer(profile("3.1")).feed(raw_frame(b"", sequence=5))
    assert (empty["data"], empty["command"], "problem" in empty) == ("", None, False)
    [stray] = Describer(profile("3.1")).feed(
        encode_frame(b"\x00\x00", session=2, sequence=1, is_ack=True)
    )
    assert (stray["data"], stray["command"], "ack" in stray) == ("0000", None, False)
