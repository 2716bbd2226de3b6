"""Messages as ROS 1 has them in bytes, and their definitions as text."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from m100link.apps.station.ros.messages import MESSAGES, Field, Message, MessageType

__all__ = ["definition", "serialise"]

_LETTERS = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_RULE = "=" * 80


def serialise(kind: MessageType, message: Message) -> bytes:
    """The bytes of a message: fields in order, little-endian, lengths before what has none."""
    return b"".join(_pieces(kind, message))


def _pieces(kind: MessageType, message: Message) -> Iterator[bytes]:
    for field in kind.fields:
        value = message[field.name]
        if field.length is None:
            yield from _scalar(field.type, value)
            continue
        if not field.length:
            yield struct.pack("<I", len(value))
        if field.type in _LETTERS:
            yield struct.pack(f"<{len(value)}{_LETTERS[field.type]}", *value)
        else:
            for one in value:
                yield from _scalar(field.type, one)


def _scalar(kind: str, value: Any) -> Iterator[bytes]:
    if kind in _LETTERS:
        yield struct.pack(f"<{_LETTERS[kind]}", value)
    elif kind == "string":
        data = value.encode()
        yield struct.pack("<I", len(data)) + data
    elif kind in ("time", "duration"):
        yield struct.pack("<II", value["secs"], value["nsecs"])
    else:
        yield from _pieces(MESSAGES[kind], value)


def definition(kind: MessageType) -> str:
    """The text of a ``.msg`` file, followed by those of every type in it."""
    texts = [_own(kind)]
    texts += [f"MSG: {one.name}\n{_own(one)}" for one in nested(kind)]
    return f"\n{_RULE}\n".join(texts)


def _own(kind: MessageType) -> str:
    return "\n".join(f"{_written(field)} {field.name}" for field in kind.fields)


def _written(field: Field) -> str:
    # Inside a definition a header goes by its last name: readers of the text know it by that.
    name = "Header" if field.type == "std_msgs/Header" else field.type
    return name if field.length is None else f"{name}[{field.length or ''}]"


def nested(kind: MessageType) -> list[MessageType]:
    """The message types inside one, at any depth, each once."""
    found: dict[str, MessageType] = {}
    for field in kind.fields:
        if field.type in MESSAGES:
            inner = MESSAGES[field.type]
            found |= {one.name: one for one in (inner, *nested(inner))}
    return list(found.values())
