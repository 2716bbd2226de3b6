"""The ROS message and service types that the station speaks, and checks of values against them.

``types.txt`` has them as ROS writes them, one field after the other. Where generations of DJI's
node differ, published is the longer array of the first type. A value is checked field by field:
what is missing gets its default, what is unknown or of the wrong type or size is an error that
names the field. Values live in Python form: a dict per message, ``bytes`` for ``uint8[]``, NaN for
the JSON ``null`` of a float.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from m100link.errors.texts import read_json, without_nan

Message = dict[str, Any]  # a ROS message: field names and values

_PARTS = ("Goal", "Result", "Feedback")  # of an action

_INTEGERS = {
    name: (-(1 << bits - 1), (1 << bits - 1) - 1) if name.startswith("i") else (0, (1 << bits) - 1)
    for name, bits in [(f"{sign}int{bits}", bits) for sign in ("", "u") for bits in (8, 16, 32, 64)]
} | {"byte": (-128, 127), "char": (0, 255)}
_FLOAT32_MAX = 3.4028235677973366e38
_MAX_ARRAY = 1000  # elements of an array without a bound of its own

# Letter of struct, and the RFC 8746 tag of a little-endian typed array: 0 for what has none.
_SCALARS = {
    "bool": ("?", 0),
    "byte": ("b", 72),
    "char": ("B", 0),
    "int8": ("b", 72),
    "uint8": ("B", 0),
    "int16": ("h", 77),
    "uint16": ("H", 69),
    "int32": ("i", 78),
    "uint32": ("I", 70),
    "int64": ("q", 79),
    "uint64": ("Q", 71),
    "float32": ("f", 85),
    "float64": ("d", 86),
}


class BadMessage(ValueError):
    """A value that does not fit its type; the text names the field."""


@dataclass(frozen=True, slots=True)
class MessageField:
    name: str
    type: str  # type of the value, or of the elements of an array
    # None for a single value, 0 for an array of any length, else the exact length.
    length: int | None
    bound: int = _MAX_ARRAY  # elements that an array of any length may have when a client sends it
    least: int = 0  # elements that an array of exact length has at least when a client sends it
    also: str = ""  # type of the elements that do not fit the type; empty for none

    @property
    def is_bytes(self) -> bool:
        """Whether JSON carries it as a base64 string."""
        return self.length is not None and self.type in ("uint8", "char")


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type, or one half of a service type."""

    name: str
    fields: tuple[MessageField, ...]  # in their order
    constants: tuple[tuple[str, int | float], ...] = ()  # names and values

    @property
    def type_name(self) -> str:
        """Its name as rosapi tells it; half of a service is ``package/NameRequest``."""
        name, _, half = self.name.partition(" ")
        return name + half.capitalize()

    def default(self) -> Message:
        return {field.name: _default(field) for field in self.fields}

    def read(self, value: Any, where: str = "") -> Message:
        """A complete, checked message from what JSON or CBOR gave.

        Raises ``BadMessage``: an unknown field, or a value of the wrong type or size.
        """
        if not isinstance(value, dict):
            raise BadMessage(f"{where or self.name} is not an object")
        names = {field.name for field in self.fields}
        if unknown := [name for name in value if name not in names]:
            raise BadMessage(f"{self.name} has no field {str(unknown[0])[:64]!r}")
        message = {}
        if self.name == "std_msgs/Header" and "stamp" not in value:
            value = {**value, "stamp": "now"}
        for field in self.fields:
            path = f"{where}.{field.name}" if where else field.name
            if field.name in value:
                message[field.name] = _read(field, value[field.name], path)
            else:
                message[field.name] = _default(field)
        return message

    def to_json(self, message: Message) -> str:
        """JSON text of a message; NaN and infinities become null, bytes become base64."""
        try:
            return json.dumps(message, allow_nan=False, separators=(",", ":"), default=_base64)
        except ValueError:
            return json.dumps(without_nan(message), separators=(",", ":"), default=_base64)

    def to_cbor(self, message: Message) -> Message:
        """The message with its numeric arrays as RFC 8746 typed arrays, to be dumped by cbor2."""
        return {field.name: _for_cbor(field, message[field.name]) for field in self.fields}


@dataclass(frozen=True, slots=True)
class ServiceType:
    name: str
    request: MessageType  # what is sent
    response: MessageType  # what comes back

    def read_request(self, args: Any) -> Message:
        """The request from the ``args`` of a call: an object, a list in field order, or nothing.

        Raises ``BadMessage``: see :meth:`MessageType.read`.
        """
        if args is None:
            args = {}
        if isinstance(args, list):
            fields = self.request.fields
            if len(args) > len(fields):
                raise BadMessage(f"{self.name} takes {len(fields)} values, there are {len(args)}")
            args = {field.name: value for field, value in zip(fields, args, strict=False)}
        return self.request.read(args)


def _fields(text: str) -> tuple[MessageField, ...]:
    fields = []
    for part in text.split(","):
        if not part.strip():
            continue
        kind, name = part.split()
        kind, bracket, size = kind.rstrip("]").partition("[")
        bound = int(size[2:]) if size.startswith("<=") else _MAX_ARRAY
        shorter, _, size = size.rpartition("..")
        length = int(size) if size.isdecimal() else 0
        kind, _, also = kind.partition("|")
        least = int(shorter or length)
        fields.append(MessageField(name, kind, length if bracket else None, bound, least, also))
    return tuple(fields)


def message_type(name: str, text: str) -> MessageType:
    """A type from its fields and constants, as ``types.txt`` writes them."""
    fields, _, constants = text.partition(";")
    pairs = (one.partition("=") for one in constants.split())
    return MessageType(
        name, _fields(fields), tuple((key, read_json(value)) for key, _, value in pairs)
    )


def action_types(name: str, parts: Iterable[str]) -> Iterator[MessageType]:
    """The types of an action: goal, result and feedback, and what actionlib puts around them."""
    header, status = "std_msgs/Header header", "actionlib_msgs/GoalStatus status"
    for part, text in zip(_PARTS, parts, strict=True):
        identity = "actionlib_msgs/GoalID goal_id" if part == "Goal" else status
        yield message_type(f"{name}{part}", text)
        around = f"{header}, {identity}, {name}{part} {part.lower()}"
        yield message_type(f"{name}Action{part}", around)
    whole = (f"{name}Action{part} action_{part.lower()}" for part in _PARTS)
    yield message_type(f"{name}Action", ", ".join(whole))


def types_of(file: Path) -> tuple[dict[str, MessageType], dict[str, ServiceType]]:
    """The message types and service types of a file like ``types.txt``, by name."""
    messages: dict[str, MessageType] = {}
    services = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        name, _, text = line.partition(":")
        if not name or name.startswith("#"):
            continue
        if "=>" in text:
            messages |= {one.name: one for one in action_types(name, text.split("=>"))}
        elif "->" in text:
            halves = zip(("request", "response"), text.split("->"), strict=True)
            services[name] = ServiceType(
                name, *(message_type(f"{name} {half}", part) for half, part in halves)
            )
        else:
            messages[name] = message_type(name, text)
    return messages, services


MESSAGES, SERVICES = types_of(Path(__file__).with_name("types.txt"))


def canonical_type(name: str) -> str:
    """``package/Name``; ROS 2 clients write ``package/msg/Name`` for it."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[2]}" if len(parts) == 3 and parts[1] in ("msg", "srv") else name


def present() -> Message:
    """The present time, as the ROS type ``time`` has it."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    return {"secs": seconds, "nsecs": nanoseconds}


def _default(field: MessageField) -> Any:
    if field.length is not None:
        if field.is_bytes:
            return bytes(field.length)
        return [_scalar_default(field.type) for _ in range(field.length)]
    return _scalar_default(field.type)


def _scalar_default(kind: str) -> Any:
    if kind in ("time", "duration"):
        return {"secs": 0, "nsecs": 0}
    if kind in MESSAGES:
        return MESSAGES[kind].default()
    return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(kind, 0)


def _read(field: MessageField, value: Any, path: str) -> Any:
    if field.length is None:
        return _read_scalar(field.type, value, path)
    # The size is judged before any element is read: reading costs what a stranger sends.
    if field.is_bytes and not isinstance(value, list | str | bytes):
        raise BadMessage(_NO_BYTES.format(path))
    if not field.is_bytes and not isinstance(value, list):
        raise BadMessage(f"{path} is not a list")
    most = field.length or field.bound
    if len(value) > (4 * (most // 3 + 1) if isinstance(value, str) else most):
        raise BadMessage(f"{path} has more than {most} elements")
    if field.is_bytes:
        value = _read_bytes(value, path)
    if len(value) < field.least:
        raise BadMessage(f"{path} has {len(value)} elements, it takes {field.length}")
    if field.is_bytes:
        return value
    return [_read_scalar(_kind(field, one), one, f"{path}[{i}]") for i, one in enumerate(value)]


def _kind(field: MessageField, value: Any) -> str:
    is_below = field.also and isinstance(value, int | float) and value < 0
    return field.also if is_below else field.type


_NO_BYTES = "{} is neither base64 nor a list of bytes"


def _read_bytes(value: Any, path: str) -> bytes:
    try:
        return base64.b64decode(value, validate=True) if isinstance(value, str) else bytes(value)
    except (binascii.Error, ValueError, TypeError):
        raise BadMessage(_NO_BYTES.format(path)) from None


def _fail(path: str, wanted: str) -> Any:
    raise BadMessage(f"{path} is not {wanted}")


def _read_scalar(kind: str, value: Any, path: str) -> Any:
    reader = _READERS.get(kind)
    if reader is not None:
        return reader(value, path)
    if kind in MESSAGES:
        return MESSAGES[kind].read(value, path)
    low, high = _INTEGERS[kind]
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool):
        return _fail(path, f"of type {kind}")
    if not low <= value <= high:
        raise BadMessage(f"{path} is {value}, outside {low} to {high}")
    return value


def _read_float(limit: float) -> Callable[[Any, str], float]:
    def read(value: Any, path: str) -> float:
        if value is None:
            return math.nan
        if not isinstance(value, int | float) or isinstance(value, bool):
            return float(_fail(path, "a number"))
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number) and abs(number) > limit:
            raise BadMessage(f"{path} does not fit into a float32")
        return number

    return read


def _read_string(value: Any, path: str) -> str:
    return value if isinstance(value, str) else str(_fail(path, "a string"))


def _read_bool(value: Any, path: str) -> bool:
    return value if isinstance(value, bool) else bool(_fail(path, "true or false"))


def _read_time(value: Any, path: str) -> Message:
    """ROS 1 writes secs and nsecs, ROS 2 sec and nanosec; ``"now"`` is the present time."""
    if value == "now":
        return present()
    if not isinstance(value, dict) or not set(value) <= {"secs", "nsecs", "sec", "nanosec"}:
        raise BadMessage(f"{path} is not a time")
    return {
        "secs": _read_scalar("uint32", value.get("secs", value.get("sec", 0)), path),
        "nsecs": _read_scalar("uint32", value.get("nsecs", value.get("nanosec", 0)), path),
    }


_READERS: dict[str, Callable[[Any, str], Any]] = {
    "string": _read_string,
    "bool": _read_bool,
    "float32": _read_float(_FLOAT32_MAX),
    "float64": _read_float(math.inf),
    "time": _read_time,
    "duration": _read_time,
}


def _base64(value: Any) -> str:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    raise TypeError(f"{type(value).__name__} is not a value of a ROS message")


def _for_cbor(field: MessageField, value: Any) -> Any:
    if field.type in MESSAGES:
        nested = MESSAGES[field.type]
        if field.length is None:
            return nested.to_cbor(value)
        return [nested.to_cbor(one) for one in value]
    letter, tag = _SCALARS.get(field.type, ("", 0))
    if field.length is None or not tag:
        return value
    from cbor2 import CBORTag

    return CBORTag(tag, struct.pack(f"<{len(value)}{letter}", *value))


# -- messages as ROS 1 has them in bytes -----------------------------------------------------------

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
        if field.type in _SCALARS:
            yield struct.pack(f"<{len(value)}{_SCALARS[field.type][0]}", *value)
        else:
            for one in value:
                yield from _scalar(field.type, one)


def _scalar(kind: str, value: Any) -> Iterator[bytes]:
    if kind in _SCALARS:
        yield struct.pack(f"<{_SCALARS[kind][0]}", value)
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


def _written(field: MessageField) -> str:
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


# -- how rosbridge packs a message beyond plain JSON -----------------------------------------------

MAX_FRAGMENTS = 1000
FRAGMENT_TIMEOUT = 10.0  # seconds after which a message whose fragments stopped coming is forgotten

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
    """Puts fragments of one client together again; bounded in number, size and time."""

    def __init__(self, max_size: int) -> None:
        self._max_size = max_size
        self._unfinished: dict[str, tuple[float, list[str | None]]] = {}

    def add(self, fragment: dict[str, Any], now: float) -> str | None:
        """Take a fragment; returns the whole text with the last one.

        Raises ``ValueError``: the fragment is malformed, or the message too long.
        """
        identity, data = fragment.get("id"), fragment.get("data")
        number, total = fragment.get("num"), fragment.get("total")
        if not isinstance(identity, str | int) or not isinstance(data, str):
            raise ValueError("a fragment needs id and data")
        if type(number) is not int or type(total) is not int:
            raise ValueError("a fragment needs the integers num and total")
        if not 0 <= number < total <= MAX_FRAGMENTS:
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
