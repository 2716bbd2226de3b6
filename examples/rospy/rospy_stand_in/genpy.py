"""Times and message classes as ``genpy`` makes them for rospy."""

from __future__ import annotations

import base64
import math
import time
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from m100link.apps.station.ros.messages import (
    MESSAGES,
    SERVICES,
    Message,
    MessageField,
    MessageType,
    ServiceType,
    definition,
)

_NANO = 1_000_000_000


class SerializationError(ValueError):
    """A field has a value that its type does not have."""


class TVal:
    """Seconds and nanoseconds; the nanoseconds are 0 to 999,999,999."""

    __slots__ = ("nsecs", "secs")

    def __init__(self, secs: float = 0, nsecs: int = 0) -> None:
        if isinstance(secs, float):
            nsecs, secs = int(nsecs + (secs - math.floor(secs)) * _NANO), math.floor(secs)
        more, self.nsecs = divmod(int(nsecs), _NANO)
        self.secs = int(secs) + more

    @classmethod
    def from_sec(cls, seconds: float) -> Any:
        return cls(float(seconds))

    @classmethod
    def from_seconds(cls, seconds: float) -> Any:
        return cls(float(seconds))

    def to_sec(self) -> float:
        return self.secs + self.nsecs / _NANO

    def to_nsec(self) -> int:
        return self.secs * _NANO + self.nsecs

    to_seconds = to_sec

    def is_zero(self) -> bool:
        return self.to_nsec() == 0

    def set(self, secs: int, nsecs: int) -> None:
        self.secs, self.nsecs = secs, nsecs

    def canon(self) -> None:
        more, self.nsecs = divmod(self.nsecs, _NANO)
        self.secs += more

    def _of(self, nanoseconds: float) -> Any:
        return type(self)(0, int(nanoseconds))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.to_nsec() == self.to_nsec()

    def __hash__(self) -> int:
        return hash((type(self), self.to_nsec()))

    def __lt__(self, other: TVal) -> bool:
        return self.to_nsec() < other.to_nsec()

    def __le__(self, other: TVal) -> bool:
        return self.to_nsec() <= other.to_nsec()

    def __gt__(self, other: TVal) -> bool:
        return self.to_nsec() > other.to_nsec()

    def __ge__(self, other: TVal) -> bool:
        return self.to_nsec() >= other.to_nsec()

    def __bool__(self) -> bool:
        return not self.is_zero()

    def __repr__(self) -> str:
        return f"genpy.{type(self).__name__[3:]}[{self.to_nsec()}]"

    def __str__(self) -> str:
        return str(self.to_nsec())


class RosDuration(TVal):
    def __add__(self, other: TVal) -> Any:
        if not isinstance(other, TVal):
            return NotImplemented
        return other._of(self.to_nsec() + other.to_nsec())

    def __sub__(self, other: RosDuration) -> RosDuration:
        if not isinstance(other, RosDuration):
            return NotImplemented
        return RosDuration(0, self.to_nsec() - other.to_nsec())

    def __neg__(self) -> RosDuration:
        return RosDuration(0, -self.to_nsec())

    def __abs__(self) -> RosDuration:
        return RosDuration(0, abs(self.to_nsec()))

    def __mul__(self, factor: float) -> RosDuration:
        return RosDuration(0, int(self.to_nsec() * factor))

    __rmul__ = __mul__

    def __truediv__(self, by: Any) -> Any:
        if isinstance(by, RosDuration):
            return self.to_nsec() / by.to_nsec()
        return RosDuration(0, int(self.to_nsec() / by))

    __div__ = __truediv__


class RosTime(TVal):
    def __init__(self, secs: float = 0, nsecs: int = 0) -> None:
        super().__init__(secs, nsecs)
        if self.secs < 0:
            raise TypeError("time values must be positive")

    @classmethod
    def now(cls) -> Any:
        return cls(0, time.time_ns())

    def to_time(self) -> float:
        return self.to_sec()

    def __add__(self, other: RosDuration) -> Any:
        return self._of(self.to_nsec() + other.to_nsec())

    def __sub__(self, other: TVal) -> Any:
        if isinstance(other, RosTime):
            return RosDuration(0, self.to_nsec() - other.to_nsec())
        return self._of(self.to_nsec() - other.to_nsec())


_TIMES: dict[str, type[TVal]] = {"time": RosTime, "duration": RosDuration}


class RosMessage:
    """A message: its fields are attributes, and no others can be set."""

    __slots__: tuple[str, ...] = ()
    _kind: ClassVar[MessageType]
    _slot_types: ClassVar[list[str]]
    _type: ClassVar[str]
    _full_text: ClassVar[str]
    _has_header: ClassVar[bool]
    _md5sum: ClassVar[str] = "*"

    def __init__(self, *values: Any, **named: Any) -> None:
        fields = self._kind.fields
        if values and (named or len(values) != len(fields)):
            raise TypeError(
                f"{self._type} takes {len(fields)} values in the order {list(self.__slots__)}, or "
                "some of them by name"
            )
        if unknown := named.keys() - set(self.__slots__):
            raise AttributeError(f"{self._type} has no field {sorted(unknown)[0]}")
        given = dict(zip(self.__slots__, values, strict=True)) if values else named
        for field in fields:
            value = given.get(field.name)
            setattr(self, field.name, _default(field) if value is None else value)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in self.__slots__)

    def __repr__(self) -> str:
        return "\n".join(_lines(self))

    __str__ = __repr__

    def __getstate__(self) -> list[Any]:
        return [getattr(self, name) for name in self.__slots__]

    def __setstate__(self, state: list[Any]) -> None:
        for name, value in zip(self.__slots__, state, strict=True):
            setattr(self, name, value)

    def _check_types(self, _: object = None) -> None:
        """Raise SerializationError where a field has a value that its type does not have."""
        to_json(self)

    def _get_types(self) -> list[str]:
        return self._slot_types


def _lines(value: RosMessage, indent: str = "") -> Iterator[str]:
    for name in value.__slots__:
        found = getattr(value, name)
        if isinstance(found, RosMessage):
            yield f"{indent}{name}: "
            yield from _lines(found, indent + "  ")
        elif isinstance(found, TVal):
            yield f"{indent}{name}: "
            yield f"{indent}  secs: {found.secs}"
            yield f"{indent}  nsecs: {found.nsecs:>9}"
        elif isinstance(found, str):
            yield f'{indent}{name}: "{found}"'
        elif isinstance(found, list) and found and isinstance(found[0], RosMessage):
            yield f"{indent}{name}: "
            for one in found:
                yield f"{indent}  - "
                yield from _lines(one, indent + "    ")
        else:
            yield f"{indent}{name}: {found}"


_CLASSES: dict[str, type[RosMessage]] = {}


def message_class(name: str) -> type[RosMessage]:
    """The class of a message type, such as ``dji_sdk/Velocity``. Raises KeyError: unknown."""
    found = _CLASSES.get(name)
    if found is None:
        found = _CLASSES[name] = _made(MESSAGES[name])
    return found


def _made(kind: MessageType) -> type[RosMessage]:
    package, _, last = kind.type_name.partition("/")
    space: dict[str, Any] = {
        "__slots__": tuple(field.name for field in kind.fields),
        "__module__": f"{package}.msg",
        "_kind": kind,
        "_type": kind.type_name,
        "_slot_types": [f"{one.type}{_brackets(one)}" for one in kind.fields],
        "_full_text": definition(kind),
        "_has_header": any(one.type == "std_msgs/Header" for one in kind.fields[:1]),
        **dict(kind.constants),
    }
    return type(last, (RosMessage,), space)


def _brackets(field: MessageField) -> str:
    return "" if field.length is None else f"[{field.length or ''}]"


class ServiceKind:
    """A service type: what a program names when it calls or offers one."""

    _type: ClassVar[str]
    _request_class: ClassVar[type[RosMessage]]
    _response_class: ClassVar[type[RosMessage]]
    _md5sum: ClassVar[str] = "*"


_SERVICE_CLASSES: dict[str, type[ServiceKind]] = {}


def service_class(name: str) -> type[ServiceKind]:
    """The class of a service type. Raises KeyError: unknown."""
    found = _SERVICE_CLASSES.get(name)
    if found is None:
        kind: ServiceType = SERVICES[name]
        package, _, last = name.partition("/")
        space: dict[str, Any] = {
            "__module__": f"{package}.srv",
            "_type": name,
            "_request_class": _made(kind.request),
            "_response_class": _made(kind.response),
        }
        found = _SERVICE_CLASSES[name] = type(last, (ServiceKind,), space)
    return found


def _default(field: MessageField) -> Any:
    if field.length is None:
        return _scalar_default(field.type)
    if field.is_bytes:
        return b"\0" * field.length
    return [_scalar_default(field.type) for _ in range(field.length)]


def _scalar_default(kind: str) -> Any:
    if kind in _TIMES:
        return _TIMES[kind]()
    if kind in MESSAGES:
        return message_class(kind)()
    return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(kind, 0)


# -- to and from rosbridge -------------------------------------------------------------------------


def to_json(message: RosMessage) -> Message:
    """The message as rosbridge takes it.

    Raises ``SerializationError``: a field has a value that its type does not have.
    """
    return {
        field.name: _written(field, getattr(message, field.name)) for field in message._kind.fields
    }


def _written(field: MessageField, value: Any) -> Any:
    try:
        if field.length is None:
            return _written_scalar(field.type, value)
        if field.is_bytes:
            data = value.encode("latin-1") if isinstance(value, str) else bytes(value)
            return base64.b64encode(data).decode("ascii")
        return [_written_scalar(field.type, one) for one in value]
    except (TypeError, ValueError, AttributeError) as error:
        raise SerializationError(
            f"field {field.name} is {value!r}, which is no {field.type}{_brackets(field)}: {error}"
        ) from None


def _written_scalar(kind: str, value: Any) -> Any:
    if kind in _TIMES:
        return {"secs": int(value.secs), "nsecs": int(value.nsecs)}
    if kind in MESSAGES:
        # A class of an earlier import of the same type counts, and so does a dict.
        return dict(value) if isinstance(value, Mapping) else to_json(value)
    if kind == "string":
        return value.decode() if isinstance(value, bytes) else _checked(value, str)
    if kind == "bool":
        return bool(value)
    if hasattr(value, "item"):  # of numpy, where a matrix of one element is a number
        value = value.item()
    if kind in ("float32", "float64"):
        number = float(value)
        return number if math.isfinite(number) else None
    whole = int(value)
    if whole != value:
        raise ValueError("it is not a whole number")
    return whole


def _checked(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"it is of type {type(value).__name__}")
    return value


def from_json(kind: type[RosMessage], message: Message) -> RosMessage:
    """A message that came by rosbridge; a missing field has its default, an unknown one goes."""
    known = {field.name: field for field in kind._kind.fields}
    values = {name: _read(known[name], value) for name, value in message.items() if name in known}
    return kind(**values)


def _read(field: MessageField, value: Any) -> Any:
    if field.length is None:
        return _read_scalar(field.type, value)
    if isinstance(value, str):
        return base64.b64decode(value)
    return [_read_scalar(field.type, one) for one in value]


def _read_scalar(kind: str, value: Any) -> Any:
    if kind in _TIMES:
        return _TIMES[kind](value["secs"], value["nsecs"])
    if kind in MESSAGES:
        return from_json(message_class(kind), value)
    if kind in ("float32", "float64"):
        return math.nan if value is None else float(value)
    return value
