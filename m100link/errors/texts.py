"""Read JSON, TOML and paths of others: whatever is wrong with a text is one ValueError.

:func:`printable` is for showing their texts.

The parsers of Python raise RecursionError for deep nesting, pass integers on that no float holds,
and return halves of characters, which no file and no socket takes. A home folder of nobody is a
RuntimeError. So nothing else in the package calls them.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

__all__ = ["printable", "read_json", "read_path", "read_toml", "shortened", "without_nan"]

_MOST_DIGITS = 300
"""Digits of an integer: a float holds up to 308."""

_MANY_DIGITS = re.compile(rf"[0-9]{{{_MOST_DIGITS}}}")
_HALF = re.compile(r"\\u[dD][89a-fA-F]")


def printable(text: str, *, keeps: str = "") -> str:
    """A text for people: strangers' names are in it, and a terminal obeys some characters.

    ``keeps``: those that stay, such as the end of a line.
    """
    if text.isprintable():
        return text
    lost = "\N{REPLACEMENT CHARACTER}"
    return "".join(one if one.isprintable() or one in keeps else lost for one in text)


def shortened(text: str, most: int = 40) -> str:
    """The text in at most so many characters; three dots show that it was longer."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def read_json(
    text: str | bytes,
    *,
    constant: Callable[[str], Any] | None = None,
    pairs: Callable[[list[tuple[str, Any]]], Any] | None = None,
) -> Any:
    """Return the value of a JSON text in UTF-8.

    ``constant``: called with ``NaN``, ``Infinity`` and ``-Infinity``; by default they are numbers.
    ``pairs``: makes each object of its names and values; by default a dict. Raises ``ValueError``:
    it is not JSON or not UTF-8, is nested too deeply, has an integer of more than 300 digits, or
    half of a surrogate pair.
    """
    decoded = text if isinstance(text, str) else text.decode()
    if isinstance(text, str) and not text.isascii():
        text.encode()
    whole = _whole if len(decoded) >= _MOST_DIGITS and _MANY_DIGITS.search(decoded) else None
    try:
        value = json.loads(
            decoded, parse_int=whole, parse_constant=constant, object_pairs_hook=pairs
        )
        if "\\u" in decoded and _HALF.search(decoded):
            json.dumps(value, ensure_ascii=False, default=repr).encode()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return value


def without_nan(value: Any) -> Any:
    """A value as JSON takes it, which has no NaN and no infinity: null stands for them."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(name): without_nan(one) for name, one in value.items()}
    return [without_nan(one) for one in value] if isinstance(value, list | tuple) else value


def read_toml(text: str | bytes) -> dict[str, Any]:
    """Return the tables of a TOML text in UTF-8.

    Raises ``ValueError``: it is not TOML or not UTF-8, is nested too deeply, or has an integer that
    no float holds.
    """
    decoded = text if isinstance(text, str) else text.decode()
    try:
        tables = tomllib.loads(decoded)
        _check_integers(tables)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return tables


def read_path(text: str | os.PathLike[str]) -> Path:
    """Return a path with the home folder for its ``~``; one of an unknown user stays as it is."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def _whole(digits: str) -> int:
    if len(digits) > _MOST_DIGITS:
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def _check_integers(value: object) -> None:
    if isinstance(value, Mapping):
        for one in value.values():
            _check_integers(one)
    elif isinstance(value, list):
        for one in value:
            _check_integers(one)
    elif isinstance(value, int) and value.bit_length() > 3 * _MOST_DIGITS:
        raise ValueError("an integer that is far too large")
