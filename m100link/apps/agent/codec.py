"""Values of messages as JSON, read strictly: a field of the wrong type or size is an error.

Readers and writers are made from the annotations of a dataclass, once for each class.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import math
import types
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, get_args, get_origin, get_type_hints

__all__ = ["MAX_TEXT", "BadValue", "Fields"]

MAX_TEXT = 4096
"""Longest text of a field, characters."""

MAX_BYTES = 2048
"""Longest bytes of a field: a frame of the protocol carries no more than 1007."""

MAX_ENTRIES = 32
"""Most entries of a mapping."""

MAX_PIECES = 99
"""Most bytes of a list: the waypoints of the longest plan."""

_MAX_INTEGER = 1 << 63

_Codec = tuple[Callable[[Any], Any], Callable[[Any], Any]]


class BadValue(ValueError):
    """A value that does not fit its field; the text does not repeat it."""


def _same(value: Any) -> Any:
    return value


def _read_int(value: Any) -> int:
    if type(value) is not int or not -_MAX_INTEGER <= value < _MAX_INTEGER:
        raise BadValue("not an integer of 64 bits")
    return value


def _read_float(value: Any) -> float:
    if type(value) not in (int, float) or not -1e300 <= value <= 1e300:
        raise BadValue("not a finite number")
    return float(value)


def _write_float(value: float) -> float:
    if not math.isfinite(value):
        raise BadValue("not a finite number")
    return value


def _read_bool(value: Any) -> bool:
    if type(value) is not bool:
        raise BadValue("neither true nor false")
    return value


def _read_text(value: Any) -> str:
    if type(value) is not str or len(value) > MAX_TEXT:
        raise BadValue(f"not a text of at most {MAX_TEXT} characters")
    return value


def _write_text(value: str) -> str:
    return value if len(value) <= MAX_TEXT else f"{value[: MAX_TEXT - 1]}…"


def _write_bytes(value: bytes) -> str:
    if len(value) > MAX_BYTES:
        raise BadValue(f"more than {MAX_BYTES} bytes")
    return base64.b64encode(value).decode("ascii")


def _read_bytes(value: Any) -> bytes:
    if type(value) is str and len(value) <= 2 * MAX_BYTES:
        try:
            data = base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError):
            data = None
        if data is not None and len(data) <= MAX_BYTES:
            return data
    raise BadValue(f"not base64 of at most {MAX_BYTES} bytes")


def _read_scalar(value: Any) -> str | int | float | bool | None:
    if value is None or type(value) is bool:
        return value
    if type(value) is str:
        return _read_text(value)
    return _read_int(value) if type(value) is int else _read_float(value)


def _write_details(value: Mapping[str, Any]) -> dict[str, Any]:
    return {
        _write_text(name): _write_text(one)
        if isinstance(one, str)
        else str(one)
        if isinstance(one, float) and not math.isfinite(one)
        else one
        for name, one in list(value.items())[:MAX_ENTRIES]
    }


def _read_details(value: Any) -> Mapping[str, Any]:
    if type(value) is not dict or len(value) > MAX_ENTRIES:
        raise BadValue(f"not a mapping of at most {MAX_ENTRIES} entries")
    return {_read_text(name): _read_scalar(one) for name, one in value.items()}


def _write_pieces(value: tuple[bytes, ...]) -> list[str]:
    if len(value) > MAX_PIECES:
        raise BadValue(f"more than {MAX_PIECES} pieces")
    return [_write_bytes(one) for one in value]


def _read_pieces(value: Any) -> tuple[bytes, ...]:
    if type(value) is not list or len(value) > MAX_PIECES:
        raise BadValue(f"not a list of at most {MAX_PIECES} pieces")
    return tuple(_read_bytes(one) for one in value)


_PLAIN: dict[Any, _Codec] = {
    int: (_same, _read_int),
    float: (_write_float, _read_float),
    bool: (_same, _read_bool),
    str: (_write_text, _read_text),
    bytes: (_write_bytes, _read_bytes),
}


def _optional(codec: _Codec) -> _Codec:
    write, read = codec
    return (
        lambda value: None if value is None else write(value),
        lambda value: None if value is None else read(value),
    )


def _choice(kind: type[Enum]) -> _Codec:
    def read(value: Any) -> Enum:
        if type(value) in (str, int):
            try:
                return kind(value)
            except ValueError:
                pass
        raise BadValue(f"not a {kind.__name__}")

    return lambda value: value.value, read


def _codec(kind: Any) -> _Codec:
    if kind in _PLAIN:
        return _PLAIN[kind]
    if isinstance(kind, types.UnionType):
        (one,) = (part for part in get_args(kind) if part is not type(None))
        return _optional(_codec(one))
    if kind == tuple[bytes, ...]:
        return _write_pieces, _read_pieces
    if isinstance(kind, type) and issubclass(kind, Enum):
        return _choice(kind)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        nested = Fields(kind)
        return nested.write, nested.read
    if get_origin(kind) is Mapping:
        return _write_details, _read_details
    raise TypeError(f"a message cannot carry {kind}")


class Fields:
    """The fields of one dataclass.

    Args:
        kind: The dataclass.
    """

    def __init__(self, kind: type[Any]) -> None:
        hints = get_type_hints(kind)
        self._kind = kind
        self._codecs = {field.name: _codec(hints[field.name]) for field in dataclasses.fields(kind)}

    def write(self, value: Any) -> dict[str, Any]:
        """The fields as JSON takes them.

        Raises:
            BadValue: A number is not finite, or bytes are too long. Texts are cut.
        """
        return {name: write(getattr(value, name)) for name, (write, _) in self._codecs.items()}

    def read(self, value: Any) -> Any:
        """The object of these fields; all of them, and no others.

        Raises:
            BadValue: See there; the field is named.
        """
        if type(value) is not dict or value.keys() != self._codecs.keys():
            raise BadValue(f"{self._kind.__name__} has the fields {', '.join(self._codecs)}")
        found = {}
        for name, (_, read) in self._codecs.items():
            try:
                found[name] = read(value[name])
            except BadValue as error:
                raise BadValue(f"{name}: {error}") from None
        return self._kind(**found)
