"""The search for the worst input: what it looks at is what it says."""

from __future__ import annotations

import random

from benchmarks.hostile import READ, crc16, mutant, name_of, overlapping, patterns, stream
from m100link.wire import Discard, FrameDecoder, encode_frame


def test_the_checksum_is_that_of_headers() -> None:
    header = encode_frame(bytes(900), session=5, sequence=0xAA55)[:12]
    assert crc16(header[:10]).to_bytes(2, "little") == header[10:]


def test_overlapping_headers_are_good_ones() -> None:
    decoder = FrameDecoder()
    decoder.feed(overlapping(20) * 20)
    discards = decoder.discards
    # Where the twenty begin anew, checksum and length are of two headers; a few frames wait.
    assert discards[Discard.FRAME_CRC] + discards[Discard.LENGTH] > 200
    assert discards[Discard.HEADER_CRC] <= 20


def test_every_pattern_fills_its_reads() -> None:
    found = patterns(random.Random(1))
    assert len(found) > 500
    for name, pieces in found.items():
        reads = stream(pieces, 500)
        assert sum(map(len, reads)) == 500, name
        assert {len(read) for read in reads[:-1]} == {READ}


def test_a_mutant_differs_by_one_byte() -> None:
    dice = random.Random(1)
    piece = bytes(range(20))
    lengths = {len(mutant(piece, dice)) for _ in range(50)}
    assert lengths == {19, 20, 21}


def test_a_long_piece_has_a_short_name() -> None:
    assert name_of(bytes(3)) == "000000"
    assert name_of(bytes(100)).endswith("…, 100 B")
