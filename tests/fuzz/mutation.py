"""Changes to inputs, from one source of chance."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

__all__ = ["MOST", "changed"]

MOST = 8192
"""Longest input, bytes."""

_INTERESTING = (
    *(b"\0", b"\xff", b"\x7f", b"\x80", b"\xaa", b"\xff\xff", b"\x0c\x00", b"\xff\x03"),
    *(b'"', b"{", b"}", b"[", b"]", b"\\u0000", b"NaN", b"1e999", b"-1", b"null", b"99999999999"),
    *(b"[" * 3000, b'{"a":' * 1000, b"9" * 400, b"9" * 4400, b"\\ud800", b"1e400"),
    *(b"<", b"&", b"<!", b"$(", b"\n", b"=", b"'''", b"\xef\xbb\xbf", b"\xed\xa0\x80"),
)


def changed(dice: Random, seeds: Sequence[bytes], tokens: Sequence[bytes] = ()) -> bytes:
    """One of the seeds, with one to nine changes.

    Args:
        dice: Every choice comes from it.
        seeds: What the target takes as it is.
        tokens: Words of its language.
    """
    data = bytearray(dice.choice(seeds))
    words = (*_INTERESTING, *tokens)
    # Mostly one: what is changed too much is refused at its first letter.
    for _ in range(1 + min(8, int(dice.expovariate(1.0)))):
        at = dice.randrange(len(data) + 1)
        match dice.randrange(8):
            case 0 if data:
                data[at % len(data)] ^= 1 << dice.randrange(8)
            case 1 if data:
                data[at % len(data)] = dice.randrange(256)
            case 2:
                del data[at : at + 1 + dice.randrange(16)]
            case 3:
                data[at:at] = dice.randbytes(1 + dice.randrange(16))
            case 4:
                data[at:at] = dice.choice(words)
            case 5:
                data[at:at] = data[at : at + 1 + dice.randrange(64)] * dice.randrange(1, 9)
            case 6:
                other = dice.choice(seeds)
                begin = dice.randrange(len(other) + 1)
                data[at:] = other[begin:]
            case _:
                data += dice.choice(seeds)
    return bytes(data[:MOST])
