"""Values of messages as JSON, read strictly: a field of the wrong type or size is an error.

Readers and writers are made from the annotations of a dataclass, once for each class.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import json
import math
import struct
import types
from collections.abc import Callable, Container, Iterable, Mapping
from enum import Enum
from functools import partial
from itertools import product
from operator import attrgetter
from typing import Any, get_args, get_origin, get_type_hints

from m100link.apps.agent.messages import (
    LEVELS,
    Activating,
    Event,
    LinkCounted,
    Message,
    MessageError,
    State,
    Steer,
    Telemetry,
)
from m100link.apps.agent.orders import ORDERS, Order
from m100link.errors.texts import read_json
from m100link.protocol.codes import ActivationCode
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReferenceFrame,
    Setpoint,
    Vertical,
    Yaw,
)

MAX_TEXT = 4096
"""Longest text of a field, characters."""

MAX_BYTES = 2048
"""Longest bytes of a field; a frame of the protocol carries no more than 1007."""

MAX_ENTRIES = 32
"""Most entries of a mapping."""

MAX_PIECES = 99
"""Most pieces of a list, which are the waypoints of the longest plan."""

# A double holds every integer up to here: other readers of JSON round those above.
_GREATEST = (1 << 53) - 1
_FARTHEST = 1e300

_PLAIN: dict[type[Any], tuple[float, float, str]] = {
    int: (-_GREATEST - 1, _GREATEST, "an integer below 2⁵³"),
    float: (-_FARTHEST, _FARTHEST, "a finite number"),
    bool: (False, True, "true or false"),
    str: (0, MAX_TEXT, f"a text of at most {MAX_TEXT} characters"),
}
"""What JSON writes by itself: the least and the greatest value, of a text its length."""

_Codec = tuple[Callable[[Any], Any] | None, frozenset[type[Any]], Callable[[Any], Any]]
"""The writer of a value that JSON lacks, types that are read as they come, the reader of others."""

write_json = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


class InvalidValue(ValueError):
    """A value that does not fit its field; the text does not repeat it."""


def _read_plain(kind: type[Any], value: Any) -> Any:
    least, most, what = _PLAIN[kind]
    is_one = type(value) in ((int, float) if kind is float else (kind,))
    if not is_one or not least <= (len(value) if kind is str else value) <= most:
        raise InvalidValue(f"not {what}")
    return kind(value)


def _write_text(value: str) -> str:
    return value if len(value) <= MAX_TEXT else f"{value[: MAX_TEXT - 1]}…"


def _write_bytes(value: bytes) -> str:
    if len(value) > MAX_BYTES:
        raise InvalidValue(f"more than {MAX_BYTES} bytes")
    return base64.b64encode(value).decode("ascii")


def _read_bytes(value: Any) -> bytes:
    # The length first: strangers choose it, and decoding takes memory.
    if type(value) is str and len(value) <= 2 * MAX_BYTES:
        try:
            data = base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError):
            data = None
        # Bits behind the last byte are ignored by some readers, and refused by others.
        if data is not None and len(data) <= MAX_BYTES and base64.b64encode(data).decode() == value:
            return data
    raise InvalidValue(f"not base64 of at most {MAX_BYTES} bytes")


def _read_scalar(value: Any) -> str | int | float | bool | None:
    kind = type(value) if type(value) in _PLAIN else float
    return None if value is None else _read_plain(kind, value)


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
        raise InvalidValue(f"not a mapping of at most {MAX_ENTRIES} entries")
    return {_read_plain(str, name): _read_scalar(one) for name, one in value.items()}


def _write_pieces(value: tuple[bytes, ...]) -> list[str]:
    if len(value) > MAX_PIECES:
        raise InvalidValue(f"more than {MAX_PIECES} pieces")
    return [_write_bytes(one) for one in value]


def _read_pieces(value: Any) -> tuple[bytes, ...]:
    if type(value) is not list or len(value) > MAX_PIECES:
        raise InvalidValue(f"not a list of at most {MAX_PIECES} pieces")
    return tuple(_read_bytes(one) for one in value)


def _choice(kind: type[Enum]) -> _Codec:
    def read(value: Any) -> Enum:
        if type(value) in (str, int):
            try:
                return kind(value)
            except ValueError:
                pass
        raise InvalidValue(f"not a {kind.__name__}")

    return attrgetter("value"), frozenset(), read


def _codec(kind: Any, name: str) -> _Codec:
    if kind in _PLAIN:
        return None, frozenset({kind}), partial(_read_plain, kind)
    if kind is bytes:
        return _write_bytes, frozenset(), _read_bytes
    parts = [one for one in get_args(kind) or [kind] if one is not type(None)]
    if Order in parts or (isinstance(kind, types.UnionType) and len(parts) > 1):
        kinds = Kinds([one for one in parts if one is not Order] + [*ORDERS.values()])
        return kinds.write, frozenset(), kinds.read
    if isinstance(kind, types.UnionType):
        write, plain, read = _codec(parts[0], name)
        return write, plain | {type(None)}, read
    if kind == tuple[bytes, ...]:
        return _write_pieces, frozenset(), _read_pieces
    if isinstance(kind, type) and issubclass(kind, Enum):
        return _choice(kind)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        nested = Fields(kind)
        return nested.write, frozenset(), nested.read
    if get_origin(kind) is Mapping:
        return _write_details, frozenset(), _read_details
    raise TypeError(f"{name}: a message cannot carry {kind}")


class Fields:
    """The fields of one dataclass."""

    def __init__(self, kind: type[Any], beside: Container[str] = ()) -> None:
        """``beside``: names of fields that go another way."""
        hints = get_type_hints(kind)
        self._kind = kind
        names = [one.name for one in dataclasses.fields(kind) if one.name not in beside]
        self._codecs = {one: _codec(hints[one], f"{kind.__name__}.{one}") for one in names}
        # Numbers and truth values go as they are: no turn of a loop for each of them.
        self._get = attrgetter(*names, "__class__", "__class__")  # of one name it is no tuple
        self._written = [
            (name, write or _write_text)
            for name, (write, plain, _) in self._codecs.items()
            if write is not None or str in plain
        ]

    def write(self, value: Any) -> dict[str, Any]:
        """The fields as JSON takes them.

        Raises:
            InvalidValue: Bytes are too long. Texts are cut.
        """
        found = dict(zip(self._codecs, self._get(value), strict=False))
        for name, write in self._written:
            if found[name] is not None:
                found[name] = write(found[name])
        return found

    def read(self, value: Any) -> Any:
        """The object of these fields; all of them, and no others.

        Raises:
            InvalidValue: See there; the field is named.
        """
        if type(value) is not dict or value.keys() != self._codecs.keys():
            raise InvalidValue(f"{self._kind.__name__} has the fields {', '.join(self._codecs)}")
        found = {}
        for name, (_, plain, read) in self._codecs.items():
            one = value[name]
            try:
                # Most are as they have to be: no call for each of them.
                is_plain = type(one) in plain
                if is_plain and one is not None:
                    least, most, _ = _PLAIN[type(one)]
                    is_plain = least <= (len(one) if type(one) is str else one) <= most
                found[name] = one if is_plain else read(one)
            except InvalidValue as error:
                raise InvalidValue(f"{name}: {error}") from None
        return self._kind(**found)


class Kinds:
    """Objects of several dataclasses: each names its own in the field ``kind``."""

    def __init__(self, kinds: Iterable[type[Any]]) -> None:
        self._fields = {kind.__name__: Fields(kind) for kind in kinds}

    def write(self, value: Any) -> dict[str, Any]:
        """As :meth:`Fields.write`, with the name of its class."""
        name = type(value).__name__
        return {"kind": name, **self._fields[name].write(value)}

    def read(self, value: Any) -> Any:
        """The object. Raises InvalidValue if it is of none of these classes."""
        name = value.pop("kind", None) if type(value) is dict else None
        fields = self._fields.get(name) if type(name) is str else None
        if fields is None:
            raise InvalidValue("it names no kind that this version knows")
        try:
            return fields.read(value)
        except InvalidValue as error:
            raise InvalidValue(f"{name}: {error}") from None


# -- the bytes of messages between an agent and its fronts, for carriers that take bytes -----------
# A seldom message is JSON, one object for each: its kind and its fields. A setpoint and a telemetry
# package go fifty and a hundred times a second, and the aircraft waits for the setpoint: they are
# packed, after a first byte that no JSON begins with. Reading never raises anything but
# :class:`~m100link.apps.agent.messages.MessageError`; it refuses a message above :data:`MAX_SIZE`.


MAX_SIZE = 64 * 1024
"""Longest message, bytes."""

_STEER = struct.Struct("<BQddB4d")  # kind, fence, sent_at, lifetime, control flag, four values
_TELEMETRY = struct.Struct("<BdB")  # kind, received_at, length of the profile's name; both follow
_IS_STEER, _IS_TELEMETRY = 1, 2

_MODES = {
    mode.flag | frame << 1 | stable: (mode, frame, stable)
    for mode in map(ControlMode._make, product(Horizontal, Vertical, Yaw))
    if mode.is_legal
    for frame in ReferenceFrame
    for stable in (False, True)
}
_FLAGS = {mode: flag for flag, mode in _MODES.items()}


def _pack_steer(message: Steer) -> bytes:
    setpoint = message.setpoint
    if not (math.isfinite(message.sent_at) and math.isfinite(message.lifetime)):
        raise InvalidValue("not a finite number")
    return _STEER.pack(
        _IS_STEER,
        message.fence,
        message.sent_at,
        message.lifetime,
        _FLAGS[setpoint.mode, setpoint.frame, setpoint.stable],
        setpoint.x,
        setpoint.y,
        setpoint.z,
        setpoint.yaw,
    )


def _unpack_steer(data: bytes) -> Steer:
    _, fence, sent_at, lifetime, flag, x, y, z, yaw = _STEER.unpack(data)
    # The bounds of JSON: the answer that it is not flown says the number again.
    if fence > _GREATEST or not (abs(sent_at) <= _FARTHEST and abs(lifetime) <= _FARTHEST):
        raise InvalidValue("a number that is not finite, or out of range")
    if flag not in _MODES:
        raise InvalidValue(f"control flag 0x{flag:02X} names no control mode")
    mode, frame, stable = _MODES[flag]
    return Steer(fence, sent_at, lifetime, Setpoint(mode, x, y, z, yaw, frame, stable))


def pack_telemetry(value: bytes, profile: str, received_at: float) -> bytes:
    """The bytes of a :class:`~m100link.apps.agent.messages.Telemetry`, a hundred times a second."""
    if len(value) > MAX_BYTES:
        raise InvalidValue(f"more than {MAX_BYTES} bytes")
    if not math.isfinite(received_at):
        raise InvalidValue("not a finite number")
    name = profile.encode()
    return _TELEMETRY.pack(_IS_TELEMETRY, received_at, len(name)) + name + value


def _unpack_telemetry(data: bytes) -> Telemetry:
    _, received_at, length = _TELEMETRY.unpack_from(data)
    begin = _TELEMETRY.size + length
    if not math.isfinite(received_at):
        raise InvalidValue("not a finite number")
    if not begin <= len(data) <= begin + MAX_BYTES:
        raise InvalidValue("not the bytes of a telemetry package")
    profile = data[_TELEMETRY.size : begin].decode()
    return Telemetry(data[begin:], profile, received_at)


_PACK: dict[type[Any], Callable[[Any], bytes]] = {
    Steer: _pack_steer,
    Telemetry: lambda one: pack_telemetry(one.value, one.profile, one.received_at),
}
_UNPACK: dict[int, tuple[type[Any], Callable[[bytes], Message]]] = {
    _IS_STEER: (Steer, _unpack_steer),
    _IS_TELEMETRY: (Telemetry, _unpack_telemetry),
}
_KINDS = Kinds(kind for kind in Message.__args__ if kind not in _PACK)


def encode(message: Message) -> bytes:
    """The bytes of a message, at most :data:`MAX_SIZE`.

    Raises:
        MessageError: A number in it is not finite or out of range, or it is too long. Long texts
            are cut.
    """
    kind = type(message)
    pack = _PACK.get(kind)
    try:
        if pack is not None:
            return pack(message)
        text = write_json(_KINDS.write(message))
    except (ValueError, struct.error) as error:
        raise MessageError(f"{kind.__name__} cannot be sent: {error}") from None
    data = text.encode("ascii")
    # Refused here, too: the other end would close the channel, and the lease would end with it.
    if len(data) > MAX_SIZE:
        raise MessageError(f"{kind.__name__} would have {len(data)} bytes, at most {MAX_SIZE} go")
    return data


def decode(data: bytes) -> Message:
    """The message of these bytes.

    Raises:
        MessageError: They are none.
    """
    packed = _UNPACK.get(data[0]) if data else None
    if packed is not None:
        kind, unpack = packed
        try:
            return unpack(data)
        except (ValueError, struct.error) as error:  # a setpoint out of range is a ValueError, too
            raise MessageError(f"not a message: {kind.__name__}: {str(error)[:200]}") from None
    if len(data) > MAX_SIZE:
        raise MessageError(f"{len(data)} bytes are not a message: at most {MAX_SIZE} are")
    value = parsed(data, "a message")
    try:
        message: Message = _KINDS.read(value)
        require_possible(message)
    except InvalidValue as error:
        raise MessageError(f"not a message: {error}") from None
    return message


def parsed(data: bytes, what: str) -> object:
    """The value of JSON that every reader of JSON understands alike; else MessageError."""
    try:
        return read_json(data, constant=_refuse, pairs=_object)
    except ValueError:
        raise MessageError(f"not {what}: this is not JSON, or one name stands twice") from None


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not JSON")


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Of two values with one name some readers take the first, others the last."""
    if len(found := dict(pairs)) < len(pairs):
        raise ValueError("one name stands twice")
    return found


# -- the legal values of an agent's messages, besides their types (pure logic) ---------------------
# Over a network anybody may tell something under an agent's name. A view of the console that meets
# a word or a time that cannot be would raise, and with it everything else on the page: such a
# message is refused as it is read, and costs itself alone.


_CONNECTIONS = ("connecting", "connected", "lost")
_CODES = frozenset(map(int, ActivationCode))
_LAST_UTC = 253_402_300_799.0
"""POSIX time of the end of the year 9999, s."""
_LONGEST_S = 1e10
"""No clock of an agent, nor a flight, is three centuries old."""


def _state(state: State) -> str:
    if state.connection not in _CONNECTIONS:
        return "connection is none"
    if state.activation_code is not None and state.activation_code not in _CODES:
        return "activation_code is none"
    replay = state.replay
    if replay is not None and not 0.0 <= replay.utc <= _LAST_UTC:
        return "replay: utc is no time"
    if replay is not None and not max(abs(replay.position_s), abs(replay.duration_s)) <= _LONGEST_S:
        return "replay: no flight is that long"
    return ""


def _counted(counted: LinkCounted) -> str:
    for name in ("counters", "discards", "round_trips"):
        numbers: Mapping[str, Any] = getattr(counted, name)
        if not all(type(one) in (int, float) for one in numbers.values()):
            return f"{name}: not a number"
    return ""


_WHY_NOT: dict[type[Any], Callable[[Any], str]] = {
    Event: lambda event: "" if event.level in LEVELS else "level is none",
    State: _state,
    LinkCounted: _counted,
    Activating: lambda answer: "" if answer.code in _CODES else "code is none",
}


def require_possible(message: Message) -> None:
    """Whether a message that was read can be true.

    Raises:
        InvalidValue: It cannot; the field is named.
    """
    if not abs(getattr(message, "at", 0.0)) <= _LONGEST_S:
        raise InvalidValue("at is no time")
    why_not = _WHY_NOT.get(type(message))
    why = "" if why_not is None else why_not(message)
    if why:
        raise InvalidValue(why)
