"""How rosbridge packs a message beyond plain JSON: PNG, CBOR and fragments."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

__all__ = ["Reassembly", "fragments", "to_cbor", "to_png"]

MAX_FRAGMENTS = 1000
FRAGMENT_TIMEOUT = 10.0
"""Seconds after which a message whose fragments stopped coming is forgotten."""

_MAX_UNFINISHED = 4


def to_png(text: str) -> str:
    """The ``png`` frame that carries a JSON text as the RGB pixels of an image.

    The width is the root of the number of pixels; what remains of the last row is newlines, which
    JSON ignores.
    """
    data = text.encode()
    width = max(1, math.isqrt(len(data) // 3))
    height = math.ceil(len(data) / 3 / width)
    data += b"\n" * (3 * width * height - len(data))
    stride = 3 * width
    rows = b"".join(b"\0" + data[at : at + stride] for at in range(0, len(data), stride))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    image = b"\x89PNG\r\n\x1a\n" + b"".join(
        (_chunk(b"IHDR", header), _chunk(b"IDAT", zlib.compress(rows)), _chunk(b"IEND", b""))
    )
    return json.dumps({"op": "png", "data": base64.b64encode(image).decode("ascii")})


def _chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def to_cbor(value: dict[str, Any]) -> bytes:
    """A binary frame. Needs the package cbor2."""
    import cbor2

    return cbor2.dumps(value)


def fragments(text: str, size: int, identity: str) -> Iterator[str]:
    """The frames of a text that is longer than ``size``; a shorter one stays as it is."""
    if len(text) <= size:
        yield text
        return
    total = math.ceil(len(text) / size)
    for number in range(total):
        piece = text[number * size : (number + 1) * size]
        yield json.dumps(
            {"op": "fragment", "id": identity, "data": piece, "num": number, "total": total}
        )


class Reassembly:
    """Puts fragments of one client together again; bounded in number, size and time.

    Args:
        max_size: Characters of a whole message.
    """

    def __init__(self, max_size: int) -> None:
        self._max_size = max_size
        self._unfinished: dict[str, tuple[float, list[str | None]]] = {}

    def add(self, fragment: dict[str, Any], now: float) -> str | None:
        """Take a fragment; returns the whole text with the last one.

        Raises:
            ValueError: The fragment is malformed, or the message too long.
        """
        identity, data = fragment.get("id"), fragment.get("data")
        number, total = fragment.get("num"), fragment.get("total")
        if not isinstance(identity, str | int) or not isinstance(data, str):
            raise ValueError("a fragment needs id and data")
        if type(number) is not int or type(total) is not int:
            raise ValueError("a fragment needs the integers num and total")
        if not (1 <= total <= MAX_FRAGMENTS and 0 <= number < total):
            raise ValueError(f"fragment {number} of {total} cannot be")
        key = str(identity)[:256]
        self._forget_old(now)
        begun_at, pieces = self._unfinished.get(key) or (now, [None] * total)
        if len(pieces) != total or pieces[number] is not None:
            del self._unfinished[key]
            raise ValueError(f"fragment {number} of {total} does not fit those before")
        pieces[number] = data
        if sum(len(piece) for piece in pieces if piece is not None) > self._max_size:
            self._unfinished.pop(key, None)
            raise ValueError(f"the whole message is longer than {self._max_size} characters")
        if None in pieces:
            if key not in self._unfinished and len(self._unfinished) >= _MAX_UNFINISHED:
                raise ValueError(f"{_MAX_UNFINISHED} messages are unfinished already")
            self._unfinished[key] = (begun_at, pieces)
            return None
        self._unfinished.pop(key, None)
        return "".join(piece for piece in pieces if piece is not None)

    def _forget_old(self, now: float) -> None:
        for key, (begun_at, _) in list(self._unfinished.items()):
            if now - begun_at > FRAGMENT_TIMEOUT:
                del self._unfinished[key]
