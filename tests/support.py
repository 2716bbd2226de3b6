"""Frames built from the published description alone, and a decoder too simple to be wrong.

Nothing in this file calls ``m100link.wire`` (its ``Frame`` is only a tuple with names): what both
sides of a comparison share cannot be judged by it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from m100link.wire import Frame

KEY = bytes(range(32))
VECTORS = Path(__file__).parent / "vectors"


def load_vectors(name: str) -> list[dict[str, Any]]:
    """The golden vectors of one file."""
    vectors: list[dict[str, Any]] = json.loads((VECTORS / f"{name}.json").read_text())
    return vectors


def _table(polynomial: int) -> list[int]:
    table = []
    for value in range(256):
        register = value
        for _ in range(8):
            register = register >> 1 ^ (polynomial if register & 1 else 0)
        table.append(register)
    return table


_TABLE16, _TABLE32 = _table(0xA001), _table(0xEDB88320)


def crc16(data: bytes) -> int:
    """Header checksum: reflected 0x8005, start 0x3AA3, no final xor."""
    register = 0x3AA3
    for byte in data:
        register = register >> 8 ^ _TABLE16[(register ^ byte) & 0xFF]
    return register


def crc32(data: bytes) -> int:
    """Frame checksum: reflected 0x04C11DB7, start 0x3AA3, no final xor."""
    register = 0x3AA3
    for byte in data:
        register = register >> 8 ^ _TABLE32[(register ^ byte) & 0xFF]
    return register


def raw_frame(
    data: bytes = b"",
    *,
    session: int = 0,
    is_ack: bool = False,
    sequence: int = 0,
    padding: int = 0,
    encryption: int = 0,
    version: int = 0,
    reserved0: int = 0,
    reserved1: int = 0,
    length: int | None = None,
    crc16_error: int = 0,
    crc32_error: int = 0,
) -> bytes:
    """A frame with any header at all; checksums are right unless an error is xored into them."""
    if length is None:
        length = len(data) + 16 if data else 12
    header = bytes(
        (
            0xAA,
            length & 0xFF,
            length >> 8 | version << 2,
            session | is_ack << 5 | reserved0 << 6,
            padding | encryption << 5,
            *reserved1.to_bytes(3, "little"),
            *sequence.to_bytes(2, "little"),
        )
    )
    frame = header + (crc16(header) ^ crc16_error).to_bytes(2, "little") + data
    if length == 12:
        return frame
    return frame + (crc32(frame) ^ crc32_error).to_bytes(4, "little")


def encrypted_frame(
    data: bytes, *, key: bytes = KEY, pad: bytes = bytes(16), **fields: Any
) -> bytes:
    """A frame whose data are padded (with the bytes of ``pad``) and encrypted."""
    padding = 16 - len(data) % 16
    encryptor = Cipher(algorithms.AES(key), modes.ECB()).encryptor()
    ciphertext = encryptor.update(data + pad[:padding])
    return raw_frame(ciphertext, padding=padding, encryption=1, **fields)


def frame_at(stream: bytes, at: int, key: bytes | None) -> tuple[Frame, int] | None:
    """The valid frame that begins exactly there, and its length on the wire."""
    header = stream[at : at + 12]
    if len(header) < 12 or header[0] != 0xAA or crc16(header) != 0:
        return None
    length = header[1] | (header[2] & 3) << 8
    if header[2] >> 2 or header[3] >> 6 or any(header[5:8]) or (length < 16 and length != 12):
        return None
    frame = stream[at : at + length]
    if len(frame) < length or (length > 12 and crc32(frame) != 0):
        return None
    data, padding, encrypted = frame[12:-4], header[4] & 0x1F, header[4] >> 5 != 0
    if padding > 16 or padding > len(data):
        return None
    if encrypted and data:
        if key is None:
            return None
        whole = len(data) // 16 * 16
        decryptor = Cipher(algorithms.AES(key), modes.ECB()).decryptor()
        data = (decryptor.update(data[:whole]) + data[whole:])[: len(data) - padding]
    sequence = header[8] | header[9] << 8
    found = Frame(header[3] & 0x1F, bool(header[3] & 0x20), sequence, encrypted, padding, data)
    return found, length


def all_frames(stream: bytes, key: bytes | None = KEY) -> list[Frame]:
    """Every valid frame that does not overlap an earlier valid one, by trying every byte."""
    found, at = [], 0
    while at < len(stream):
        hit = frame_at(stream, at, key) if stream[at] == 0xAA else None
        if hit is None:
            at += 1
        else:
            found.append(hit[0])
            at += hit[1]
    return found
