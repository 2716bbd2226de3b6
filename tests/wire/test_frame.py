"""Encoding, decoding and what the decoder says about what it passes over."""

from __future__ import annotations

import itertools
import random
from typing import Any

import pytest

from m100link.errors import PayloadTooLarge, UsageError
from m100link.wire import MAX_DATA_SIZE, Cipher, Discard, Frame, FrameDecoder, encode_frame
from m100link.wire import frame as module
from tests import limits
from tests.support import (
    KEY,
    all_frames,
    crc16,
    encrypted_frame,
    load_vectors,
    raw_frame,
)

FRAMES = load_vectors("frames")
STREAMS = load_vectors("streams")


def decode(stream: bytes, key: bytes | None = None) -> tuple[list[Frame], FrameDecoder]:
    """All frames of a stream that ends."""
    decoder = FrameDecoder(None if key is None else Cipher(key))
    return decoder.feed(stream) + decoder.close(), decoder


def faults(decoder: FrameDecoder) -> dict[str, int]:
    """The discards that happened, by name."""
    return {str(cause): count for cause, count in decoder.discards.items() if count}


def chunks_of(stream: bytes, dice: random.Random) -> list[bytes]:
    """The stream in pieces of 1 to 80 bytes."""
    pieces, at = [], 0
    while at < len(stream):
        size = dice.choice((1, 2, 7, 16, 62, 80))
        pieces.append(stream[at : at + size])
        at += size
    return pieces


# -- golden vectors --------------------------------------------------------------------------------


@pytest.mark.parametrize("vector", FRAMES, ids=range(len(FRAMES)))
def test_golden_frame_encodes_and_decodes(vector: dict[str, Any]) -> None:
    data, wire = bytes.fromhex(vector["data"]), bytes.fromhex(vector["frame"])
    cipher = Cipher(vector["key"]) if vector["key"] else None
    fields = {"session": vector["session"], "sequence": vector["seq"]}
    encoded = encode_frame(data, **fields, is_ack=bool(vector["ack"]), cipher=cipher)
    assert encoded == wire
    (frame,), decoder = decode(wire, vector["key"] and bytes.fromhex(vector["key"]))
    assert (frame.session, frame.is_ack, frame.sequence) == (
        vector["session"],
        bool(vector["ack"]),
        vector["seq"],
    )
    assert frame.data == data
    assert faults(decoder) == {}


@pytest.mark.parametrize("vector", STREAMS, ids=range(len(STREAMS)))
@pytest.mark.parametrize("chunking", ["whole", "bytes", "random"])
def test_golden_stream_gives_its_frames(vector: dict[str, Any], chunking: str) -> None:
    stream = bytes.fromhex(vector["bytes"])
    seed = len(stream)  # fixed per vector: a failure repeats
    chunks = {
        "whole": [stream],
        "bytes": [stream[at : at + 1] for at in range(len(stream))],
        "random": chunks_of(stream, random.Random(seed)),
    }[chunking]
    decoder = FrameDecoder(Cipher(vector["key"]))
    found = [frame for chunk in chunks for frame in decoder.feed(chunk)]
    assert found == [
        Frame(
            wanted["session"],
            bool(wanted["ack"]),
            wanted["seq"],
            bool(wanted["enc"]),
            wanted["padding"],
            bytes.fromhex(wanted["data"]),
        )
        for wanted in vector["frames"]
    ]
    assert decoder.pending == 0


# -- published frames ------------------------------------------------------------------------------

REAL_FRAMES = (
    # Sent to a real Matrice 100 in 2015 and published; their key was not, so they show checksums.
    ("aa200001 2d000000 0100 7462 f0fe9c002116e7b2b048a49831354f49 2ac1ba63", 1),
    ("aa200001 2d000000 0200 7492 6225f5a0560dfbea27891e0497dc6926 bcfb5119", 2),
)


@pytest.mark.parametrize(("text", "sequence"), REAL_FRAMES)
def test_a_frame_captured_from_a_real_aircraft_has_good_checksums(text: str, sequence: int) -> None:
    wire = bytes.fromhex(text)
    (frame,), _ = decode(wire, KEY)  # any key opens it, to nonsense
    assert (frame.session, frame.is_ack, frame.sequence) == (1, False, sequence)
    assert (frame.encrypted, frame.padding, len(frame.data)) == (True, 13, 3)
    assert decode(wire)[1].discards[Discard.NO_KEY] == 1


# -- encoding --------------------------------------------------------------------------------------


def test_an_empty_payload_is_a_header_alone_and_never_encrypted() -> None:
    plain = encode_frame(b"", session=0, sequence=0)
    assert plain == bytes.fromhex("aa0c0000000000000000af8e")
    assert encode_frame(b"", session=0, sequence=0, cipher=Cipher(KEY)) == plain


def test_the_largest_payload_fills_the_length_field() -> None:
    wire = encode_frame(bytes(MAX_DATA_SIZE), session=0, sequence=0)
    assert (MAX_DATA_SIZE, len(wire)) == (1007, 1023)
    assert decode(wire)[0][0].data == bytes(1007)
    with pytest.raises(PayloadTooLarge, match="1008 bytes"):
        encode_frame(bytes(1008), session=0, sequence=0)


def test_the_largest_encrypted_payload_leaves_room_for_padding() -> None:
    cipher = Cipher(KEY)
    wire = encode_frame(bytes(991), session=0, sequence=0, cipher=cipher)
    assert len(wire) == 12 + 992 + 4
    with pytest.raises(PayloadTooLarge, match=r"992 bytes.*\n.*at most 991 bytes encrypted"):
        encode_frame(bytes(992), session=0, sequence=0, cipher=cipher)


@pytest.mark.parametrize("session", [-1, 32])
def test_a_session_that_does_not_exist_is_refused(session: int) -> None:
    with pytest.raises(UsageError, match=str(session)):
        encode_frame(b"", session=session, sequence=0)


@pytest.mark.parametrize("sequence", [-1, 0x10000])
def test_a_sequence_number_beyond_16_bits_is_refused(sequence: int) -> None:
    with pytest.raises(UsageError, match=str(sequence)):
        encode_frame(b"", session=0, sequence=sequence)


# -- each cause of a discard -----------------------------------------------------------------------

GOOD = raw_frame(b"good", session=2, sequence=7)
GOOD_DECODED = Frame(2, False, 7, False, 0, b"good")

# Every frame here has good checksums, except where a checksum is the fault.
FAULTY = {
    "header_crc": raw_frame(b"abc", crc16_error=1),
    "frame_crc": raw_frame(b"abc", crc32_error=1),
    "version": raw_frame(b"abc", version=1),
    "reserved_bits": raw_frame(b"abc", reserved0=1),
    "length": raw_frame(b"abc", length=11),
    "padding": raw_frame(bytes(32), sequence=1, padding=17, encryption=1),
}


@pytest.mark.parametrize("cause", FAULTY)
def test_each_fault_is_counted_under_its_own_name_and_costs_no_other_frame(cause: str) -> None:
    frames, decoder = decode(GOOD + FAULTY[cause] + GOOD, KEY)
    assert frames == [GOOD_DECODED, GOOD_DECODED]
    assert faults(decoder) == {cause: 1}
    assert decoder.discarded_bytes == len(FAULTY[cause])


@pytest.mark.parametrize("bits", [1 << n for n in range(6)])
def test_any_version_but_0_is_refused(bits: int) -> None:
    assert faults(decode(raw_frame(b"abc", version=bits))[1]) == {"version": 1}


@pytest.mark.parametrize(
    "fields", [{"reserved0": 1}, {"reserved0": 2}] + [{"reserved1": 1 << n} for n in range(24)]
)
def test_any_reserved_bit_is_refused(fields: dict[str, int]) -> None:
    frame = raw_frame(b"abc", **fields)  # type: ignore[arg-type]  # names are drawn from a list
    assert faults(decode(frame)[1]) == {"reserved_bits": 1}


@pytest.mark.parametrize("length", [*range(12), 13, 14, 15])
def test_a_length_that_no_frame_has_is_refused_at_once(length: int) -> None:
    wire = raw_frame(b"abc", length=length)
    decoder = FrameDecoder()
    # With the header alone: nothing is waited for. DJI's parser would wait for ever below 12.
    decoder.feed(wire[:12])
    assert faults(decoder) == {"length": 1}
    assert decoder.pending == 0


def test_a_frame_of_16_bytes_has_a_checksum_and_no_data() -> None:
    (frame,), decoder = decode(raw_frame(b"", length=16))
    assert frame == Frame(0, False, 0, False, 0, b"")
    assert faults(decoder) == {}


@pytest.mark.parametrize("padding", [17, 31])
def test_more_padding_than_a_block_is_refused(padding: int) -> None:
    wire = raw_frame(b"\x11" * 32, sequence=5, padding=padding, encryption=1)
    frames, decoder = decode(wire, KEY)
    assert (frames, faults(decoder)) == ([], {"padding": 1})


def test_more_padding_than_data_is_refused_where_dji_would_underflow() -> None:
    assert faults(decode(raw_frame(bytes(4), padding=5, encryption=1), KEY)[1]) == {"padding": 1}
    assert faults(decode(raw_frame(b"", padding=1), KEY)[1]) == {"padding": 1}


def test_padding_means_nothing_where_nothing_is_encrypted_as_in_djis_codec() -> None:
    plain = raw_frame(b"abc", padding=2)
    empty = raw_frame(b"", encryption=1)
    frames, decoder = decode(plain + empty)
    assert [(frame.encrypted, frame.padding, frame.data) for frame in frames] == [
        (False, 2, b"abc"),
        (True, 0, b""),
    ]
    assert faults(decoder) == {}


def test_an_encrypted_frame_without_padding_is_decrypted() -> None:
    """No codec of DJI sends it; nothing in the document forbids it."""
    data = bytes(range(16))
    ciphertext, _ = Cipher(KEY).encrypt(data)
    whole = raw_frame(ciphertext[:16], encryption=1, padding=0)
    assert decode(whole, KEY)[0][0].data == data
    assert faults(decode(whole)[1]) == {"no_key": 1}


def test_padding_without_encryption_needs_no_key() -> None:
    for data, padding in ((b"\x02\x01\x04", 2), (bytes(20), 16)):
        found, decoder = decode(raw_frame(data, padding=padding))
        assert [(frame.data, frame.encrypted) for frame in found] == [(data, False)]
        assert faults(decoder) == {}


def test_padding_of_all_the_data_leaves_nothing() -> None:
    (frame,), _ = decode(encrypted_frame(b""), KEY)
    assert (frame.padding, frame.data) == (16, b"")


def test_what_the_padding_holds_is_ignored() -> None:
    for pad in (bytes(16), b"\xaa" * 16, bytes(range(16))):
        assert decode(encrypted_frame(b"abc", pad=pad), KEY)[0][0].data == b"abc"


@pytest.mark.parametrize("encryption", range(1, 8))
def test_any_encryption_value_but_0_means_aes_as_in_djis_codec(encryption: int) -> None:
    ciphertext = encrypted_frame(b"abc")[12:-4]
    (frame,), _ = decode(raw_frame(ciphertext, padding=13, encryption=encryption), KEY)
    assert (frame.encrypted, frame.data) == (True, b"abc")


def test_without_a_key_an_encrypted_frame_is_counted_and_passed_over_whole() -> None:
    """Ciphertext may be anything, a whole plain frame too: it was not sent, so it is not found."""
    hidden = raw_frame(b"\x02\x01\x04" + bytes(13), sequence=7)
    outer = raw_frame(hidden.ljust(48, b"\x55"), encryption=1, padding=1, sequence=6)
    behind = raw_frame(b"\x02\x01\x04", sequence=8)
    found, decoder = decode(outer + behind)
    assert [frame.sequence for frame in found] == [8]
    assert faults(decoder) == {"no_key": 1}
    assert decoder.discarded_bytes == len(outer)


def test_a_stream_of_encrypted_frames_without_a_key_is_counted_frame_by_frame() -> None:
    """The second of a kind takes the short way through the decoder."""
    decoder = FrameDecoder()
    wire = encrypted_frame(b"abc")
    assert [decoder.feed(wire) for _ in range(3)] == [[], [], []]
    assert faults(decoder) == {"no_key": 3}
    assert decoder.discarded_bytes == 3 * len(wire)


def test_a_key_applies_to_frames_completed_after_it_is_set() -> None:
    wire = encrypted_frame(b"abc")
    decoder = FrameDecoder()
    assert decoder.feed(wire + wire[:-1]) == []
    decoder.cipher = Cipher(KEY)
    assert [frame.data for frame in decoder.feed(wire[-1:])] == [b"abc"]


def test_a_frame_nested_in_a_damaged_frame_is_found() -> None:
    outer = raw_frame(b"xx" + GOOD + b"yy", crc32_error=1)
    frames, decoder = decode(outer)
    assert frames == [GOOD_DECODED]
    assert faults(decoder) == {"frame_crc": 1}
    assert decoder.discarded_bytes == len(outer) - len(GOOD)


@pytest.mark.parametrize("key", [None, KEY], ids=["no key", "key"])
def test_a_frame_nested_in_one_with_impossible_padding_is_found(key: bytes | None) -> None:
    outer = raw_frame(b"xx" + GOOD + b"yy", padding=31, encryption=1)
    frames, decoder = decode(outer, key)
    assert frames == [GOOD_DECODED]
    assert faults(decoder) == {"padding": 1}


def test_a_frame_nested_in_a_good_frame_is_its_data_and_nothing_else() -> None:
    frames, _ = decode(raw_frame(GOOD))
    assert [frame.data for frame in frames] == [GOOD]


# -- waiting and giving up -------------------------------------------------------------------------


@pytest.mark.parametrize("is_warm", [False, True], ids=["cold", "warm"])
def test_each_start_byte_is_counted_by_the_fault_of_what_it_begins(is_warm: bool) -> None:
    """The length of this frame is 0xAA, so that a start byte follows its start byte."""
    wire = bytearray(encode_frame(bytes(154), session=0, sequence=0))
    assert wire[:2] == b"\xaa\xaa"
    decoder = FrameDecoder()
    if is_warm:
        assert len(decoder.feed(bytes(wire))) == 1
    wire[20] ^= 1
    assert decoder.feed(bytes(wire) + bytes(20)) == []
    assert {cause: n for cause, n in decoder.discards.items() if n} == {
        Discard.FRAME_CRC: 1,
        Discard.HEADER_CRC: 1,
    }
    assert decoder.discarded_bytes == 190


def test_a_frame_is_delivered_with_its_last_byte() -> None:
    decoder = FrameDecoder()
    for at in range(len(GOOD) - 1):
        assert decoder.feed(GOOD[at : at + 1]) == []
        assert decoder.pending == at + 1
    assert decoder.feed(GOOD[-1:]) == [GOOD_DECODED]
    assert decoder.pending == 0


def test_what_a_false_header_swallowed_is_found_when_its_length_is_reached() -> None:
    false_header = raw_frame(bytes(1007))[:12]
    decoder = FrameDecoder()
    assert decoder.feed(false_header + GOOD * 3) == []
    assert decoder.pending == 12 + 3 * len(GOOD)
    rest = decoder.feed(bytes(1023 - decoder.pending))
    assert rest == [GOOD_DECODED] * 3
    assert faults(decoder) == {"frame_crc": 1}


def test_at_most_one_incomplete_frame_is_kept() -> None:
    decoder = FrameDecoder()
    decoder.feed(raw_frame(bytes(1007))[:-1])
    assert decoder.pending == 1022
    decoder.feed(b"\x01")
    assert decoder.pending == 0


def test_the_end_of_the_stream_gives_up_on_the_incomplete_and_looks_inside_it() -> None:
    decoder = FrameDecoder()
    assert decoder.feed(raw_frame(bytes(1007))[:12] + GOOD + GOOD[:5]) == []
    assert decoder.close() == [GOOD_DECODED]
    assert faults(decoder) == {"truncated": 2}
    assert (decoder.pending, decoder.discarded_bytes) == (0, 12 + 5)
    assert decoder.close() == []


def test_more_kinds_of_headers_than_are_remembered_are_all_understood() -> None:
    kinds = itertools.product(range(16, 20), range(32), (False, True), range(17))
    stream = b"".join(
        raw_frame(bytes(size), session=session, is_ack=is_ack, padding=padding)
        for size, session, is_ack, padding in kinds
    )
    frames, decoder = decode(stream + stream[:1000])
    assert frames == all_frames(stream + stream[:1000])
    assert decoder.frames > 4352  # which is more than it remembers
    assert len(decoder._headers) <= 4096


def test_what_is_remembered_of_frames_to_send_is_bounded() -> None:
    for size, session, is_ack in itertools.product(range(80), range(32), (False, True)):
        encode_frame(bytes(size), session=session, sequence=1, is_ack=is_ack)
    assert 0 < len(module._kinds) <= 4096


def test_feeding_nothing_gives_nothing() -> None:
    decoder = FrameDecoder()
    assert decoder.feed(b"") == []
    decoder.feed(GOOD[:5])
    assert decoder.feed(b"") == []
    assert decoder.feed(GOOD[5:]) == [GOOD_DECODED]


def test_the_simple_model_agrees_with_the_golden_streams() -> None:
    # The properties in test_frame_properties.py are judged by it.
    for vector in STREAMS:
        key = bytes.fromhex(vector["key"])
        found = all_frames(bytes.fromhex(vector["bytes"]), key)
        wanted = [bytes.fromhex(frame["data"]) for frame in vector["frames"]]
        assert [frame.data for frame in found] == wanted


@pytest.mark.parametrize("bit", range(8))
def test_a_header_with_another_start_byte_begins_nothing(bit: int) -> None:
    """Its checksum is right: that alone makes no frame."""
    header = bytes((0xAA ^ 1 << bit, *raw_frame(sequence=7)[1:10]))
    wire = header + crc16(header).to_bytes(2, "little")
    for stream in (wire, GOOD + wire, wire + GOOD):
        frames, _ = decode(stream)
        assert frames == [GOOD_DECODED] * (stream != wire)


# -- kinds that are known --------------------------------------------------------------------------

OF_ALL_KINDS = {
    "header alone": raw_frame(session=3, is_ack=True),
    "no data": raw_frame(b"", length=16),
    "no data, encrypted": raw_frame(b"", length=16, encryption=1),
    "plain": GOOD,
    "encrypted": encrypted_frame(b"abc"),
    "encrypted, no whole block": raw_frame(bytes(range(21)), encryption=1, padding=2),
}


@pytest.mark.parametrize("key", [None, KEY], ids=["no key", "key"])
@pytest.mark.parametrize("name", OF_ALL_KINDS)
def test_a_frame_of_a_known_kind_is_read_and_counted_as_the_first_one(
    name: str, key: bytes | None
) -> None:
    wire = OF_ALL_KINDS[name]
    for size in range(1, len(wire) + 1):
        decoder = FrameDecoder(None if key is None else Cipher(key))
        first, before = decoder.feed(wire), decoder.discards
        for end in range(size, len(wire), size):
            assert decoder.feed(wire[end - size : end]) == []
            assert (decoder.pending, decoder.bytes) == (end, len(wire) + end)
        assert decoder.feed(wire[(len(wire) - 1) // size * size :]) == first
        assert decoder.discards == {cause: 2 * count for cause, count in before.items()}
        assert (decoder.frames, decoder.bytes) == (2 * len(first), 2 * len(wire))
        assert decoder.discarded_bytes == (0 if first else 2 * len(wire))


def test_an_encrypted_frame_without_data_needs_no_key() -> None:
    (frame,), decoder = decode(OF_ALL_KINDS["no data, encrypted"])
    assert (frame.encrypted, frame.data) == (True, b"")
    assert faults(decoder) == {}


@pytest.mark.parametrize("encryption", [0, 1])
def test_padding_without_data_is_refused_in_pieces_too(encryption: int) -> None:
    wire = raw_frame(b"", length=16, padding=1, encryption=encryption)
    for at in range(1, len(wire)):
        decoder = FrameDecoder(Cipher(KEY))
        assert decoder.feed(wire[:at]) + decoder.feed(wire[at:]) == []
        assert faults(decoder) == {"padding": 1}


@pytest.mark.parametrize("sequence", [1, 2, 0x5555, 0xFFFF])
def test_a_known_header_whose_checksum_is_joined_wrongly_begins_nothing(sequence: int) -> None:
    """Its CRC16 is that of the kind xor a share of the sequence number, and not their and or or."""
    kind, right = crc16(raw_frame()[:10]), crc16(raw_frame(sequence=sequence)[:10])
    share = kind ^ right
    for wrong in (kind & share, kind | share, kind, share):
        decoder = FrameDecoder()
        assert len(decoder.feed(raw_frame())) == 1
        assert decoder.feed(raw_frame(sequence=sequence, crc16_error=right ^ wrong)) == []


def test_behind_a_damaged_frame_a_start_byte_alone_begins_nothing() -> None:
    """The length of this frame is 0xAA, and what follows reads as a header but for its checksum."""
    wire = bytearray(encode_frame(bytes(154), session=1, sequence=0))
    assert wire[1] == 0xAA
    decoder = FrameDecoder()
    assert len(decoder.feed(bytes(wire))) == 1
    wire[20] ^= 1
    assert decoder.feed(bytes(wire) + bytes(200)) == []
    assert decoder.frames == 1


def test_an_end_that_is_too_short_for_a_header_is_kept_whatever_its_checksum_is() -> None:
    short = b"\xaa\x64" + bytes(7)
    short += crc16(short).to_bytes(2, "little")
    decoder = FrameDecoder()
    assert decoder.feed(b"\xaa" * 6 + bytes(40) + short) == []
    assert decoder.pending == len(short) == 11


@pytest.mark.parametrize("name", OF_ALL_KINDS)
def test_behind_a_flood_of_start_bytes_each_kind_is_found(name: str) -> None:
    found, _ = decode(b"\xaa" * 40 + OF_ALL_KINDS[name], KEY)
    assert found == decode(OF_ALL_KINDS[name], KEY)[0] != []


def test_frames_in_one_piece_are_counted() -> None:
    decoder = FrameDecoder()
    assert decoder.feed(b"noise" + GOOD * 3) == [GOOD_DECODED] * 3
    assert (decoder.frames, decoder.bytes) == (3, 5 + 3 * len(GOOD))
    assert decoder.discarded_bytes == 5


# -- checksums, bit by bit -------------------------------------------------------------------------


@pytest.mark.parametrize("is_warm", [False, True], ids=["first of its kind", "kind known"])
@pytest.mark.parametrize("bit", range(16))
def test_a_header_with_any_wrong_checksum_begins_nothing(bit: int, is_warm: bool) -> None:
    """Too high or too low: a header alone has no other checksum that would notice."""
    for sequence in (0, 1, 0x5555, 0xFFFF):
        decoder = FrameDecoder()
        if is_warm:
            assert decoder.feed(raw_frame(sequence=sequence))
        assert decoder.feed(raw_frame(sequence=sequence, crc16_error=1 << bit)) == []
        assert decoder.close() == []
        assert decoder.discards[Discard.HEADER_CRC] >= 1


@pytest.mark.parametrize("bit", range(32))
def test_a_frame_with_any_wrong_checksum_is_not_delivered(bit: int) -> None:
    for sequence in range(8):
        found, decoder = decode(raw_frame(b"\x02\x01\x04", sequence=sequence, crc32_error=1 << bit))
        assert found == []
        assert decoder.discards[Discard.FRAME_CRC] == 1


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("wire") == []
