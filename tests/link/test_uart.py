"""A receiver that expects 1 when idle, on a line where 0 is."""

from __future__ import annotations

import random

import pytest

from m100link.link.serial_transport import read_inverted


@pytest.mark.parametrize(
    ("sent", "read"),
    [
        (b"", b""),
        (b"\xff", b"\x00"),  # nothing but the start bit, which idle follows
        (b"\x00", b"\x00"),  # 1 from the start bit to the last data bit, and idle
        (b"\xaa", b"\x15"),
    ],
)
def test_what_is_read_of_single_bytes(sent: bytes, read: bytes) -> None:
    assert read_inverted(sent) == read


def read_as_a_receiver(data: bytes) -> bytes:
    """The same, level by level: idle, start, eight bits, stop; after a stop bit of 0 it waits."""
    line = "0" + "".join("1" + f"{byte ^ 0xFF:08b}"[::-1] + "0" for byte in data) + "0" * 12
    read, before, bits = bytearray(), "0", ""
    for level in line:
        if bits:
            bits += level
            if len(bits) == 10:
                read.append(int(bits[8:0:-1], 2))
                bits, before = "", level
        elif before == "1" and level == "0":
            bits = level
        else:
            before = level
    return bytes(read)


def test_it_is_what_a_receiver_samples() -> None:
    for seed in range(200):
        dice = random.Random(seed)
        data = dice.randbytes(dice.randrange(1, 12))
        assert read_inverted(data) == read_as_a_receiver(data), seed


def test_the_same_frame_is_always_read_as_the_same_bytes() -> None:
    frame = bytes.fromhex("aa130001000000000500302e000000b493113d")
    once = read_inverted(frame)
    assert read_inverted(frame) == once
    assert once.startswith(b"\x95")  # 0xAA without its first two edges, then the next start bit
    assert frame[:2] not in once


def test_frames_of_any_length_begin_recognisably() -> None:
    for length in range(13, 256):
        read = read_inverted(bytes([0xAA, length, *bytes(10)]))
        assert read[0] == 0x95, length
        assert set(read[2:6]) <= {0xFF, 0xFE, 0xFC, 0xF8, 0xF0, 0xE0, 0xC0, 0x80, 0x7F}, length
