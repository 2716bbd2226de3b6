"""A flight log as pcapng, for Wireshark: a packet per frame, and per run of bytes of no frame."""

from __future__ import annotations

from collections.abc import Iterator
from struct import pack
from typing import IO

from m100link.link import Direction
from m100link.log.frames import in_order
from m100link.log.reading import FlightLog
from m100link.protocol.firmware import FirmwareProfile, profile
from m100link.wire import Cipher, FrameDecoder, encode_frame
from m100link.wire.crc import HEADER_RESIDUE, frame_crc32, header_crc16
from m100link.wire.frame import HEADER_SIZE, SOF

__all__ = ["begin_pcapng", "cut", "packet", "write_pcapng"]

LINKTYPE = 147  # DLT_USER0
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_NAME, _DESCRIPTION, _RESOLUTION, _FLAGS = 2, 3, 9, 2
_INBOUND, _OUTBOUND = 1, 2
_LAST_NS = (1 << 64) - 1


def write_pcapng(
    flight: FlightLog,
    stream: IO[bytes],
    *,
    firmware: str | FirmwareProfile | None = None,
    cipher: Cipher | None = None,
) -> int:
    """Write what went over the line.

    The description of the interface says the firmware, which the dissector reads. With a key, each
    encrypted frame is followed by what it says, plain, on a second interface.

    Args:
        flight: The log.
        stream: What takes the bytes.
        firmware: Profile to name; by default that of the flight.
        cipher: Decrypts.

    Returns:
        How many packets of the line there are.
    """
    known = flight.firmware if firmware is None else profile(firmware)
    begin_pcapng(stream, known, is_decrypted=cipher is not None)
    waiting = {Direction.RECEIVED: b"", Direction.SENT: b""}
    last = 0
    count = 0
    for chunk in in_order(flight.chunks()):
        last = round(chunk.utc * 1e9)
        pieces, waiting[chunk.direction] = cut(waiting[chunk.direction] + chunk.data)
        for piece in pieces:
            count += 1
            _write(stream, piece, last, chunk.direction, cipher)
    for direction, rest in waiting.items():
        for piece in cut(rest, is_end=True)[0]:
            count += 1
            _write(stream, piece, last, direction, cipher)
    return count


def begin_pcapng(
    stream: IO[bytes], firmware: FirmwareProfile | None, *, is_decrypted: bool = False
) -> None:
    """Write what stands before the packets: a section, and one or two interfaces."""
    told = "" if firmware is None else f", firmware {firmware.name}"
    stream.write(_block(_SECTION, pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
    for name in ("m100link", "m100link decrypted")[: 2 if is_decrypted else 1]:
        options = (
            _option(_NAME, name.encode())
            + _option(_DESCRIPTION, f"{name}{told}".encode())
            + _option(_RESOLUTION, b"\x09")
            + _option(0, b"")
        )
        stream.write(_block(_INTERFACE, pack("<HHI", LINKTYPE, 0, 0) + options))


def cut(data: bytes, *, is_end: bool = False) -> tuple[list[bytes], bytes]:
    """Cut a stream into frames, damaged ones too, and runs of other bytes.

    Args:
        data: Some of the stream.
        is_end: Nothing follows.

    Returns:
        The pieces, and what may go on with the bytes that follow.
    """
    pieces: list[bytes] = []
    at = begun = 0
    while at < len(data):
        length = _length_at(data, at)
        if length is None:
            if not is_end and len(data) - at < HEADER_SIZE and data[at] == SOF:
                break
            at += 1
            continue
        if len(data) - at < length and not is_end:
            break
        if at > begun:
            pieces.append(data[begun:at])
        end = min(at + length, len(data))
        if not _is_good(data[at:end]):
            # Bytes of it were lost: the next one begins within.
            end = next((n for n in range(at + 1, end) if _length_at(data, n)), end)
        pieces.append(data[at:end])
        at = begun = end
    rest = data[at:] if at < len(data) else b""
    if at > begun:
        pieces.append(data[begun:at])
    return pieces, rest


def _length_at(data: bytes, at: int) -> int | None:
    """Length of the frame that begins there; None when none does."""
    header = data[at : at + HEADER_SIZE]
    if len(header) < HEADER_SIZE or header[0] != SOF:
        return None
    if header_crc16(header) != HEADER_RESIDUE:
        return None
    length = (header[1] | header[2] << 8) & 0x3FF
    return length if length >= HEADER_SIZE else None


def _is_good(frame: bytes) -> bool:
    return len(frame) == HEADER_SIZE or frame_crc32(frame) == 0


def _write(
    stream: IO[bytes], piece: bytes, at_ns: int, direction: Direction, cipher: Cipher | None
) -> None:
    stream.write(packet(0, piece, at_ns, direction))
    if cipher is not None:
        for plain in _plain(piece, cipher):
            stream.write(packet(1, plain, at_ns, direction))


def _plain(piece: bytes, cipher: Cipher) -> Iterator[bytes]:
    """What an encrypted frame says, as a frame that is not."""
    for frame in FrameDecoder(cipher).feed(piece):
        if frame.encrypted:
            yield encode_frame(
                frame.data, session=frame.session, sequence=frame.sequence, is_ack=frame.is_ack
            )


def packet(interface: int, data: bytes, at_ns: int, direction: Direction) -> bytes:
    """A packet of an interface at a POSIX time, ns; times have 64 bits."""
    at_ns = min(at_ns, _LAST_NS)
    flag = _INBOUND if direction is Direction.RECEIVED else _OUTBOUND
    head = pack("<IIIII", interface, at_ns >> 32, at_ns & 0xFFFFFFFF, len(data), len(data))
    options = _option(_FLAGS, pack("<I", flag)) + _option(0, b"")
    return _block(_PACKET, head + _padded(data) + options)


def _block(kind: int, body: bytes) -> bytes:
    size = pack("<I", 12 + len(body))
    return pack("<I", kind) + size + body + size


def _option(code: int, value: bytes) -> bytes:
    return pack("<HH", code, len(value)) + _padded(value)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
