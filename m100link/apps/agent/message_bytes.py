"""The bytes of messages between an agent and its fronts, for carriers that take bytes.

What goes seldom is JSON, one object for each message: its kind and its fields. A setpoint and a
telemetry package go fifty and a hundred times a second, and somebody waits for the setpoint: they
are packed, after a first byte that no JSON begins with. Reading never raises anything but
:class:`~m100link.apps.agent.fault.MessageError`; what is longer than :data:`MAX_SIZE` is not read.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from itertools import product
from typing import Any

from m100link.apps.agent.codec import MAX_BYTES, BadValue, Fields
from m100link.apps.agent.fault import MessageError
from m100link.apps.agent.messages import Message, Steer, Telemetry
from m100link.apps.agent.possible import require_possible
from m100link.errors.texts import read_json
from m100link.protocol.setpoint import (
    ControlMode,
    Horizontal,
    ReferenceFrame,
    Setpoint,
    Vertical,
    Yaw,
)

__all__ = ["MAX_SIZE", "decode", "encode"]

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
        raise BadValue("not a finite number")
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
    if not (math.isfinite(sent_at) and math.isfinite(lifetime)):
        raise BadValue("not a finite number")
    if flag not in _MODES:
        raise BadValue(f"control flag 0x{flag:02X} names no control mode")
    mode, frame, stable = _MODES[flag]
    return Steer(fence, sent_at, lifetime, Setpoint(mode, x, y, z, yaw, frame, stable))


def _pack_telemetry(message: Telemetry) -> bytes:
    if len(message.value) > MAX_BYTES:
        raise BadValue(f"more than {MAX_BYTES} bytes")
    if not math.isfinite(message.received_at):
        raise BadValue("not a finite number")
    profile = message.profile.encode()
    return (
        _TELEMETRY.pack(_IS_TELEMETRY, message.received_at, len(profile)) + profile + message.value
    )


def _unpack_telemetry(data: bytes) -> Telemetry:
    _, received_at, length = _TELEMETRY.unpack_from(data)
    begin = _TELEMETRY.size + length
    if not math.isfinite(received_at):
        raise BadValue("not a finite number")
    if not begin <= len(data) <= begin + MAX_BYTES:
        raise BadValue("not the bytes of a telemetry package")
    return Telemetry(data[begin:], data[_TELEMETRY.size : begin].decode(), received_at)


_PACK: dict[type[Any], Callable[[Any], bytes]] = {Steer: _pack_steer, Telemetry: _pack_telemetry}
_UNPACK: dict[int, tuple[type[Any], Callable[[bytes], Message]]] = {
    _IS_STEER: (Steer, _unpack_steer),
    _IS_TELEMETRY: (Telemetry, _unpack_telemetry),
}
_FIELDS = {kind: Fields(kind) for kind in Message.__args__ if kind not in _PACK}
_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in _FIELDS}


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
        text = json.dumps(
            {"kind": kind.__name__, **_FIELDS[kind].write(message)}, separators=(",", ":")
        )
    except (BadValue, struct.error) as error:
        raise MessageError(f"{kind.__name__} cannot be sent: {error}") from None
    data = text.encode("ascii")
    if len(data) > MAX_SIZE:
        raise MessageError(f"{kind.__name__} would have {len(data)} bytes, at most {MAX_SIZE} go")
    return data


def decode(data: bytes) -> Message:
    """The message of these bytes.

    Raises:
        MessageError: They are none.
    """
    if len(data) > MAX_SIZE:
        raise MessageError(f"{len(data)} bytes are not a message: at most {MAX_SIZE} are")
    packed = _UNPACK.get(data[0]) if data else None
    if packed is not None:
        kind, unpack = packed
        try:
            return unpack(data)
        except (ValueError, struct.error) as error:  # a setpoint out of range is a ValueError, too
            raise MessageError(f"not a message: {kind.__name__}: {str(error)[:200]}") from None
    return _from_json(data)


def _from_json(data: bytes) -> Message:
    try:
        value = read_json(data, constant=_refuse)
    except ValueError:
        raise MessageError("not a message: this is not JSON") from None
    name = value.pop("kind", None) if isinstance(value, dict) else None
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise MessageError("not a message: it names no kind that this version knows")
    try:
        message: Message = _FIELDS[kind].read(value)
        require_possible(message)
    except BadValue as error:
        raise MessageError(f"not a message: {kind.__name__}: {error}") from None
    return message


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not JSON")
