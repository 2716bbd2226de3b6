"""Messages of ROS 2 as bytes: CDR made of their definitions, and read by them.

Messages that are sent a hundred times a second go through a :class:`Template`: it encodes once all
that does not change, and fills in numbers.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from struct import Struct, calcsize, error, pack, unpack_from
from typing import Any, NamedTuple

_HEAD = b"\x00\x01\x00\x00"  # CDR, little-endian

_MOST = 65536  # values of a sequence and bytes of a text that are read: nothing here has more

_EMPTY = "uint8 structure_needs_at_least_one_member"
"""The field that rosidl puts into a message without fields."""

# Letter of struct, and number of the type in a type description.
_SCALARS = {
    "bool": ("?", 15),
    "int8": ("b", 2),
    "uint8": ("B", 3),
    "byte": ("B", 16),
    "int16": ("h", 4),
    "uint16": ("H", 5),
    "int32": ("i", 6),
    "uint32": ("I", 7),
    "int64": ("q", 8),
    "uint64": ("Q", 9),
    "float32": ("f", 10),
    "float64": ("d", 11),
}
_STRING, _BOUNDED_STRING = 17, 21
_NESTED = 1
_ARRAY, _BOUNDED, _SEQUENCE = 48, 96, 144


class _Field(NamedTuple):
    name: str
    type: str
    many: int | None  # None: one; 0: as many as there are
    most: int  # of a sequence with a bound, else 0
    longest: int  # of a string with a bound, else 0


@cache
def _fields(name: str) -> tuple[_Field, ...]:
    if name not in DEFINITIONS:
        raise LookupError(f"DEFINITIONS has no row for {name}")
    made = []
    for line in (DEFINITIONS[name] or _EMPTY).splitlines():
        kind, field = line.split()
        kind, bracket, many = kind.partition("[")
        many = many.rstrip("]")
        kind, _, longest = kind.partition("<=")
        most = int(many.removeprefix("<=")) if many.startswith("<=") else 0
        count = (0 if most else int(many or 0)) if bracket else None
        made.append(_Field(field, kind, count, most, int(longest or 0)))
    return tuple(made)


def full_name(name: str) -> str:
    """The name as rosidl has it: ``sensor_msgs/msg/Imu``."""
    package, _, rest = name.partition("/")
    return name if "/" in rest else f"{package}/msg/{rest}"


def _nested_in(name: str) -> dict[str, None]:
    """The messages in a message, and in those, in the order of its fields."""
    found: dict[str, None] = {}

    def look(one: str) -> None:
        for field in _fields(one):
            if field.type in DEFINITIONS and field.type not in found:
                found[field.type] = None
                look(field.type)

    look(name)
    return found


def definition(name: str) -> str:
    """The text of a message and of all that stand in it, as a bag holds it."""
    line = "=" * 80
    parts = [DEFINITIONS[name]]
    parts += (f"MSG: {one}\n{DEFINITIONS[one]}" for one in _nested_in(name))
    return f"\n{line}\n".join(parts) + "\n"


def describe(name: str) -> dict[str, Any]:
    """A type and all that stand in it, as type_description_interfaces/TypeDescription.

    Defaults, which do not count in hashes, are left out.
    """
    return {
        "type_description": _described(name),
        "referenced_type_descriptions": [
            _described(one) for one in sorted(_nested_in(name), key=full_name)
        ],
    }


@cache
def type_hash(name: str) -> str:
    """The hash of a type by REP 2011, ``RIHS01_…``, which ROS 2 compares to tell types apart."""
    return f"RIHS01_{hashlib.sha256(json.dumps(describe(name)).encode()).hexdigest()}"


def _described(name: str) -> dict[str, Any]:
    fields = []
    for field in _fields(name):
        nested = full_name(field.type) if field.type in DEFINITIONS else ""
        number = _NESTED if nested else _BOUNDED_STRING if field.longest else _STRING
        if field.type in _SCALARS:
            number = _SCALARS[field.type][1]
        if field.many is not None:
            number += _BOUNDED if field.most else _ARRAY if field.many else _SEQUENCE
        kind = {
            "type_id": number,
            "capacity": field.most or field.many or 0,
            "string_capacity": field.longest,
            "nested_type_name": nested,
        }
        fields.append({"name": field.name, "type": kind})
    return {"type_name": full_name(name), "fields": fields}


# -- writing --------------------------------------------------------------------------------------


class _Leaf(NamedTuple):
    path: str
    letter: str
    offset: int  # behind the header


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """A message as CDR, little-endian, with its header.

    ``message``: its fields by name; nested messages are mappings. Raises ``ValueError``: an array
    has another length.
    """
    body = bytearray()
    _message(body, name, message, "", [])
    return _HEAD + bytes(body)


def _message(
    body: bytearray, name: str, message: Mapping[str, Any], path: str, leaves: list[_Leaf]
) -> None:
    for field in _fields(name):
        if not DEFINITIONS[name]:
            _value(body, field.type, 0, path, leaves)
            continue
        value = message[field.name]
        inner = f"{path}{field.name}."
        if field.many is None:
            _value(body, field.type, value, inner, leaves)
            continue
        if field.many == 0:
            _value(body, "uint32", len(value), f"{inner}#", leaves)
        elif len(value) != field.many:
            raise ValueError(f"{name}.{field.name} has {field.many} values, not {len(value)}")
        for place, each in enumerate(value):
            _value(body, field.type, each, f"{inner}{place}.", leaves)


def _value(body: bytearray, kind: str, value: Any, path: str, leaves: list[_Leaf]) -> None:
    if kind == "string":
        data = value.encode() + b"\0"
        _value(body, "uint32", len(data), f"{path}#", leaves)
        body += data
    elif kind in _SCALARS:
        letter = _SCALARS[kind][0]
        size = calcsize(f"<{letter}")
        body += bytes(-len(body) % size)
        leaves.append(_Leaf(path, letter, len(body)))
        body += pack(f"<{letter}", value)
    else:
        _message(body, kind, value, path, leaves)


class Template:
    """A message of which only some numbers change.

    ``message``: all fields, with any numbers where they change. ``changing``: what changes: fields
    by their path (``header.stamp``), a whole message or array at once. Texts and lengths stay.
    Raises ``ValueError``: there is nothing of that path.
    """

    def __init__(self, name: str, message: Mapping[str, Any], *changing: str) -> None:
        body = bytearray()
        leaves: list[_Leaf] = []
        _message(body, name, message, "", leaves)
        self._data = _HEAD + bytes(body)
        self._runs = [self._run(leaves, f"{path}.") for path in changing]

    @staticmethod
    def _run(leaves: list[_Leaf], path: str) -> tuple[Callable[..., None], int]:
        inside = [one for one in leaves if one.path.startswith(path)]
        wanted = inside[1:] if inside and inside[0].path.endswith("#") else inside
        if not wanted or any("#" in one.path for one in wanted):
            raise ValueError(f"there are no numbers at {path}")
        layout, end = "<", wanted[0].offset
        for one in wanted:
            layout += f"{one.offset - end}x{one.letter}"
            end = one.offset + calcsize(f"<{one.letter}")
        return Struct(layout).pack_into, wanted[0].offset + len(_HEAD)

    def fill(self, *values: Sequence[Any]) -> bytes:
        """The message with these numbers: a row of them for each path, in their order."""
        data = bytearray(self._data)
        for (pack_into, offset), row in zip(self._runs, values, strict=True):
            pack_into(data, offset, *row)
        return bytes(data)


# -- reading --------------------------------------------------------------------------------------


def decode(name: str, data: bytes) -> dict[str, Any]:
    """A message of somebody else; bytes behind it are ignored.

    ``data``: CDR, little-endian, with its header. Raises ``ValueError``: it is not one.
    """
    if data[:2] != _HEAD[:2]:
        raise ValueError(f"not CDR as ROS 2 writes it: {data[:4].hex()}")
    try:
        found, _ = _read_message(name, data[len(_HEAD) :], 0)
    except error as cut:
        raise ValueError(f"{name} is cut off: {cut}") from None
    return found


def _read_message(name: str, body: bytes, at: int) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    for field in _fields(name):
        if field.many is None:
            found[field.name], at = _read(field.type, body, at)
            continue
        count = field.many
        if not count:
            count, at = _read("uint32", body, at)
            if count > (field.most or _MOST):
                raise ValueError(f"{name}.{field.name} has {count} values")
        values = []
        for _ in range(count):
            value, at = _read(field.type, body, at)
            values.append(value)
        found[field.name] = values
    return found if DEFINITIONS[name] else {}, at


def _read(kind: str, body: bytes, at: int) -> tuple[Any, int]:
    if kind == "string":
        length, at = _read("uint32", body, at)
        text = body[at : at + length]
        if not 0 < length <= _MOST or len(text) < length or text[-1]:
            raise ValueError("a text that does not end")
        return text[:-1].decode("utf-8", "replace"), at + length
    if kind not in _SCALARS:
        return _read_message(kind, body, at)
    layout = f"<{_SCALARS[kind][0]}"
    size = calcsize(layout)
    at += -at % size
    return unpack_from(layout, body, at)[0], at + size


# -- definitions of the messages of ROS 2: ``ros2_types.txt`` has them, a line for each ------------
# A message is called ``package/Name``, a part of a service or an action
# ``package/srv/Name_Request``.


OWN_PACKAGE = "m100_msgs"  # the package of messages that nobody else has


def _read_types() -> dict[str, tuple[str, ...]]:
    """By name the fields of a message; of a service, or an action, those of each part."""
    found = {}
    for line in Path(__file__).with_name("ros2_types.txt").read_text("utf-8").splitlines():
        if line and not line.startswith("#"):
            name, _, fields = line.partition(":")
            parts = re.split("->|=>", fields)
            found[name] = tuple("\n".join(part.strip().split(", ")) for part in parts)
    return found


_TYPES = _read_types()

SERVICES = {name: (parts[0], parts[1]) for name, parts in _TYPES.items() if len(parts) == 2}
"""Request and response of each service."""

ACTIONS = {name: parts for name, parts in _TYPES.items() if len(parts) == 3}
"""Goal, result and feedback of each action."""


def _parts_of_service(name: str, request: str, response: str) -> dict[str, str]:
    request_name, response_name = f"{name}_Request", f"{name}_Response"
    event_name = f"{name}_Event"
    return {
        request_name: request,
        response_name: response,
        event_name: "service_msgs/ServiceEventInfo info\n"
        f"{request_name}[<=1] request\n{response_name}[<=1] response",
        name: f"{request_name} request_message\n{response_name} response_message\n"
        f"{event_name} event_message",
    }


def _parts_of_action(name: str, goal: str, result: str, feedback: str) -> dict[str, str]:
    identity = "unique_identifier_msgs/UUID goal_id"
    return {
        f"{name}_Goal": goal,
        f"{name}_Result": result,
        f"{name}_Feedback": feedback,
        f"{name}_FeedbackMessage": f"{identity}\n{name}_Feedback feedback",
        **_parts_of_service(
            f"{name}_SendGoal",
            f"{identity}\n{name}_Goal goal",
            "bool accepted\nbuiltin_interfaces/Time stamp",
        ),
        **_parts_of_service(f"{name}_GetResult", identity, f"int8 status\n{name}_Result result"),
    }


DEFINITIONS = {
    **{name: parts[0] for name, parts in _TYPES.items() if len(parts) == 1},
    **{
        part: text
        for name, (request, response) in SERVICES.items()
        for part, text in _parts_of_service(name, request, response).items()
    },
    **{
        part: text
        for name, texts in ACTIONS.items()
        for part, text in _parts_of_action(name, *texts).items()
    },
}
"""Fields of each message, in the language of ``.msg`` files."""
