"""Every header with a right CRC16 is found, and no other place, however dense the start bytes."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.wire import frame as hunt
from m100link.wire.frame import HEADER_SIZE, right_headers
from tests.support import crc16, raw_frame

SPARSE = st.binary(max_size=40).map(lambda noise: noise.replace(b"\xaa", b"\x55"))
DENSE = st.lists(st.sampled_from(b"\xaa\xaa\xaa\x00\x07"), max_size=80).map(bytes)
HEADERS = st.builds(
    lambda session, version, sequence: raw_frame(
        session=session, version=version, sequence=sequence
    ),
    st.integers(0, 31),
    st.integers(0, 63),
    st.integers(0, 0xFFFF),
)
STREAMS = st.lists(st.one_of(SPARSE, DENSE, HEADERS), min_size=1, max_size=12).map(b"".join)


def model(data: bytes, begin: int, end: int) -> list[int]:
    """What :func:`right_headers` finds, one checksum after the other."""
    return [
        place
        for place in range(begin, end)
        if data[place] == 0xAA and crc16(data[place : place + HEADER_SIZE]) == 0
    ]


def dense() -> bytearray:
    """A header with a right CRC16 at every third byte, the first at 0."""
    made = bytearray(b"\xaa" * 10)
    while len(made) < 1000:
        made += crc16(bytes(made[-10:])).to_bytes(2, "little") + b"\xaa"
    return made


@given(STREAMS, st.data())
def test_the_places_are_those_of_the_simple_model(data: bytes, draw: st.DataObject) -> None:
    last = max(0, len(data) - HEADER_SIZE + 1)
    begin = draw.draw(st.integers(0, last))
    end = draw.draw(st.integers(begin, last))
    assert list(right_headers(data, begin, end)) == model(data, begin, end)


@pytest.mark.parametrize("starts", range(15))
def test_few_and_many_start_bytes_hide_no_header(starts: int) -> None:
    """Beyond some number of them all places are computed at once."""
    header = raw_frame(session=3, sequence=0x1234)
    for before in (b"\xaa" * starts, b"\xaa\x01" * starts):
        data = before + header + b"\xaa" * starts
        found = list(right_headers(data, 0, len(data) - HEADER_SIZE + 1))
        assert len(before) in found
        assert found == model(data, 0, len(data) - HEADER_SIZE + 1)


@pytest.mark.parametrize("filler", [b"\xaa", b"\x00"], ids=["flood", "zeros"])
def test_a_header_at_any_place_of_a_long_read_is_found(filler: bytes) -> None:
    """Places are looked at in blocks; a header may lie across two."""
    header = raw_frame(session=9, sequence=77)
    for place in range(200, 300):
        data = filler * place + header + filler * (600 - place)
        found = list(right_headers(data, 0, len(data) - HEADER_SIZE + 1))
        assert place in found
        assert found == model(data, 0, len(data) - HEADER_SIZE + 1)


@pytest.mark.parametrize("bit", range(8, 96))
def test_a_header_with_any_flipped_bit_is_not_among_them(bit: int) -> None:
    broken = bytearray(raw_frame(session=1, sequence=500))
    broken[bit // 8] ^= 1 << bit % 8
    for flood in (b"", b"\xaa" * 40):
        data = flood + broken
        assert len(flood) not in right_headers(data, 0, len(flood) + 1)


def test_where_right_headers_are_dense_each_is_found_and_none_twice() -> None:
    """Whole blocks are computed at once."""
    hunt._shares.cache_clear()  # so that it is this test that computes them
    made = dense()
    for begin in (0, 1, 65):
        data = bytes(made)
        end = len(data) - HEADER_SIZE + 1
        wanted = model(data, begin, end)
        assert len(wanted) > 290 - begin // 3
        assert list(right_headers(data, begin, end)) == wanted


@pytest.mark.parametrize("bit", range(16))
def test_where_right_headers_are_dense_a_wrong_bit_of_a_checksum_is_seen(bit: int) -> None:
    made = dense()
    made[250 + bit // 8] ^= 1 << bit % 8
    data = bytes(made)
    end = len(data) - HEADER_SIZE + 1
    assert 240 not in right_headers(data, 0, end)
    assert list(right_headers(data, 0, end)) == model(data, 0, end)


def test_a_header_at_the_beginning_of_a_block_is_found_in_that_block_alone() -> None:
    """The bytes behind a block, which its last headers reach into, are looked at with it."""
    data = bytearray(300)
    for place in range(64, 128, 3):
        data[place] = 0xAA
    for place in (94, 128):
        data[place : place + HEADER_SIZE] = raw_frame(session=3)
    end = len(data) - HEADER_SIZE + 1
    assert list(right_headers(bytes(data), 0, end)) == model(bytes(data), 0, end) == [94, 128]


def test_they_are_found_when_they_are_asked_for() -> None:
    """What was found stands, whatever is behind it; nothing is computed beyond its block."""
    dice = random.Random(12)
    data = raw_frame() + dice.randbytes(100_000)
    assert next(right_headers(data, 0, len(data) - HEADER_SIZE + 1)) == 0
