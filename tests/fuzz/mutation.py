"""Changes to inputs, from one source of chance."""

from __future__ import annotations

import re
import struct
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

_WORDS = re.compile(
    rb'"(?:[^"\\\n]|\\.)*"|\b(?:true|false|null)\b|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?'
)
_BRACKETS = re.compile(rb"\{[^{}]*\}|\[[^][]*\]")
"""Values of JSON, TOML and the like: those without parts, keys too, and those without others."""

_VALUES = (
    *(b"null", b"true", b"false", b"0", b"1", b"-1", b"256", b"65536", b"4294967296", b"1e308"),
    *(b"-1e308", b"5e-324", b"-0.0", b"NaN", b"Infinity", b"18446744073709551616", b"1e400"),
    *(b'""', b'"1"', b'"\\u0000"', b'"\\ud800"', b'"\xc3\xa9"', b"[]", b"{}", b"[[]]", b"[null]"),
    *(b'{"":0}', b'{"a":[1]}', b'"' + b"x" * 5000 + b'"', b"[" + b"0," * 1500 + b"0]"),
)

_NUMBERS = (
    *(struct.pack("<f", one) for one in (float("nan"), float("inf"), -3e38, 1e-45, 181.0)),
    *(struct.pack("<d", one) for one in (float("nan"), float("-inf"), 1e308, 5e-324, -181.0)),
    *(struct.pack("<q", one)[:size] for one in (-1, 1 << 31, (1 << 63) - 1) for size in (2, 4, 8)),
)
"""Of frames and CDR, which have them in place, not between others."""


def _with_another_value(data: bytearray, dice: Random, other: bytes) -> None:
    """One value becomes another one, which may be of another kind or of another seed."""
    kind, given = dice.choice((_WORDS, _BRACKETS)), dice.choice((_WORDS, _BRACKETS))
    places = [one.span() for one in kind.finditer(data)]
    if places:
        begin, end = dice.choice(places)
        values = given.findall(other) if dice.randrange(3) == 0 else ()
        data[begin:end] = dice.choice(values or _VALUES)


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
        match dice.randrange(12):
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
            case 7 | 8 | 9:
                _with_another_value(data, dice, dice.choice(seeds))
            case 10:
                number = dice.choice(_NUMBERS)
                data[at : at + len(number)] = number
            case _:
                data += dice.choice(seeds)
    return bytes(data[:MOST])
