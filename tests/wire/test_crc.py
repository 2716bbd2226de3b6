"""Both checksums against the check values of the fact sheet and against each other."""

from __future__ import annotations

import importlib.util
import sys
import zlib
from typing import Any

import crcmod
import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.wire import crc
from tests import support

CHECK = b"123456789"
CRC32_POLYNOMIAL = 0x104C11DB7

by_crcmod = crcmod.mkCrcFun(CRC32_POLYNOMIAL, initCrc=crc.START_VALUE, rev=True, xorOut=0)


def test_check_values_of_both_checksums() -> None:
    assert crc.header_crc16(CHECK) == 0x2752
    assert crc.frame_crc32(CHECK) == 0xE4D9DC14
    assert by_crcmod(CHECK) == 0xE4D9DC14


def test_nothing_leaves_the_start_value() -> None:
    assert crc.header_crc16(b"") == 0x3AA3
    assert crc.frame_crc32(b"") == 0x3AA3


@given(st.binary(max_size=1100))
def test_zlib_and_crcmod_give_the_same_frame_checksum(data: bytes) -> None:
    assert crc.frame_crc32(data) == by_crcmod(data)


@given(st.binary(max_size=300))
def test_both_checksums_are_those_of_a_bit_by_bit_model(data: bytes) -> None:
    assert crc.header_crc16(data) == support.crc16(data)
    assert crc.frame_crc32(data) == support.crc32(data)


@given(st.binary(max_size=300))
def test_a_checksum_behind_its_data_leaves_the_residue(data: bytes) -> None:
    header = data + crc.header_crc16(data).to_bytes(2, "little")
    assert crc.header_crc16(header) == crc.HEADER_RESIDUE
    frame = data + crc.frame_crc32(data).to_bytes(4, "little")
    assert zlib.crc32(frame, crc.ZLIB_START) == crc.FRAME_RESIDUE


@given(st.binary(min_size=1, max_size=300), st.data())
def test_any_changed_bit_leaves_another_residue(data: bytes, draw: st.DataObject) -> None:
    frame = bytearray(data + crc.frame_crc32(data).to_bytes(4, "little"))
    bit = draw.draw(st.integers(0, len(frame) * 8 - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert zlib.crc32(bytes(frame), crc.ZLIB_START) != crc.FRAME_RESIDUE


@given(st.binary(min_size=8, max_size=8), st.integers(0, 0xFFFF))
def test_a_header_checksum_is_that_of_its_word_xor_that_of_its_sequence(
    word: bytes, sequence: int
) -> None:
    apart = crc.header_crc16(word + bytes(2)) ^ crc.SEQUENCE_CRC16[sequence]
    assert apart == crc.header_crc16(word + sequence.to_bytes(2, "little"))


def test_the_shares_of_all_sequence_numbers_are_in_the_table() -> None:
    none = support.crc16(bytes(10))
    for sequence in (*range(0, 0x10000, 251), 0xFFFF):
        alone = support.crc16(bytes(8) + sequence.to_bytes(2, "little"))
        assert crc.SEQUENCE_CRC16[sequence] == alone ^ none
    assert len(crc.SEQUENCE_CRC16) == 0x10000
    assert crc.sequence_crc16_numbers() == list(crc.SEQUENCE_CRC16)
    assert crc.sequence_crc16_numbers() is crc.sequence_crc16_numbers(), "2.4 MB, once"


def _crcmod_without_extension(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A second copy of crcmod's module, loaded as where its C extension was not built."""
    monkeypatch.setitem(sys.modules, "crcmod._crcfunext", None)
    spec = importlib.util.find_spec("crcmod.crcmod")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("polynomial", "value"),
    [(crc.CRC16_POLYNOMIAL, 0x2752), (CRC32_POLYNOMIAL, 0xE4D9DC14)],
)
def test_crcmod_gives_the_check_value_with_and_without_its_c_extension(
    polynomial: int, value: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = crcmod.mkCrcFun(polynomial, initCrc=crc.START_VALUE, rev=True, xorOut=0)
    plain_python = _crcmod_without_extension(monkeypatch)
    assert not plain_python._usingExtension
    function = plain_python.mkCrcFun(polynomial, initCrc=crc.START_VALUE, rev=True, xorOut=0)
    assert installed(CHECK) == function(CHECK) == value
