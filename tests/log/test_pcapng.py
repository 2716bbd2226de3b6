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
from m100link.log.pcapng import cut, write_pcapng
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


@pytest.mark.parametrize("lost", [None, 0, 5, 14])
def test_frames_are_cut_where_they_end(lost: int | None) -> None:
    second = FRAMES[1] if lost is None else FRAMES[1][:lost] + FRAMES[1][lost + 1 :]
    stream = b"noise" + FRAMES[0] + second + FRAMES[2] + FRAMES[3][:9]
    pieces, rest = cut(stream)
    assert b"".join(pieces) + rest == stream
    assert pieces[:2] == [b"noise", FRAMES[0]]
    assert FRAMES[2] in pieces
    assert cut(rest, is_end=True) == ([FRAMES[3][:9]], b"")


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
