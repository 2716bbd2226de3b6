"""Fields of commands with a fixed layout: where they stand, what they may be, how people read them.

A layout is a list of parts in the order of the wire. It writes and reads the bytes of a record,
tells which of its values lie outside the documented range, and shows it in degrees, metres,
seconds and words. Reading never refuses a value: what was sent is shown as it is.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Integral, Real
from struct import Struct, calcsize
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias

from m100link.protocol.command import Command, Problem, exactly
from m100link.protocol.firmware import FirmwareProfile

_INTEGERS = frozenset("bBhHiI")
_LARGEST_F32 = 3.4028234663852886e38

# Wire unit → what people read: the ending of the name, and how many of it make one.
_SHOWN: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0),
    "cm": ("m", 0.01),
    "m/s": ("m_s", 1.0),
    "°": ("deg", 1.0),
    "rad": ("deg", 180.0 / math.pi),
    "°/s": ("deg_s", 1.0),
    "0.1 °/s": ("deg_s", 0.1),
    "s": ("s", 1.0),
}


class Number(NamedTuple):
    """One number."""

    name: str  #: Name of the field.
    format: str = "B"  #: Its letter in :mod:`struct`.
    low: float = -math.inf  #: Documented range, inclusive; without one whatever fits.
    high: float = math.inf  #: Documented range, inclusive; without one whatever fits.
    unit: str = ""  #: Unit on the wire.
    #: Meanings of the numbers of a choice, from 0 on; no other number is legal.
    words: tuple[str, ...] = ()
    besides: tuple[float, ...] = ()  #: Legal values outside the range.

    @property
    def names(self) -> tuple[str, ...]:
        """Its name."""
        return (self.name,)

    def write(self, record: object) -> tuple[Any, ...]:
        """The values for the struct."""
        return (getattr(record, self.name),)

    def read(self, values: Iterator[Any]) -> Iterator[tuple[str, Any]]:
        """The value from the struct, under its name."""
        yield self.name, next(values)

    def problems(self, record: object) -> Iterator[Problem]:
        """Whether the value is outside."""
        value = getattr(record, self.name)
        if not self.fits(value):
            yield Problem(self.name, value, self.limit)

    def fits(self, value: Any) -> bool:
        """Whether a value is inside."""
        # The numbers of numpy are among these two, and a text is not.
        if not isinstance(value, Integral if self.format in _INTEGERS else Real):
            return False
        low, high = _bounds(self)
        return low <= float(value) <= high or value in self.besides  # nothing compares with NaN

    @property
    def bounds(self) -> tuple[float, float]:
        """The documented range, as far as the type reaches."""
        return _bounds(self)

    @property
    def limit(self) -> str:
        """The documented range in words."""
        if self.words:
            return ", ".join(f"{number} {word}" for number, word in enumerate(self.words))
        low, high = self.bounds
        if self.format not in _INTEGERS and math.isinf(self.high):
            return "a finite number"
        digits = ".0f" if self.format in _INTEGERS else ".6g"  # 4294967295, not 4.29497e+09
        text = f"{low:g}" if low == high else f"{low:{digits}} to {high:{digits}}"
        return " or ".join((*map("{:g}".format, self.besides), f"{text} {self.unit}")).rstrip()

    def shown(self, record: object) -> Iterator[tuple[str, Any]]:
        """The value for people, under a name that says its unit."""
        value = getattr(record, self.name)
        if self.words:
            yield self.name, self.words[value] if value < len(self.words) else value
        elif self.unit in _SHOWN:
            ending, factor = _SHOWN[self.unit]
            name = self.name.removesuffix(f"_{self.unit}")
            # A factor below one is one over a whole number: dividing keeps 28.5 from 28.500000001.
            number = value * factor if factor >= 1.0 else value / round(1.0 / factor)
            yield f"{name}_{ending}", number
        else:
            yield self.name, value


@cache
def _bounds(number: Number) -> tuple[float, float]:
    if number.words:
        return 0, len(number.words) - 1
    if number.format not in _INTEGERS:
        largest = _LARGEST_F32 if number.format == "f" else sys.float_info.max
        return max(number.low, -largest), min(number.high, largest)
    bits = 8 * calcsize(f"<{number.format}")
    least = -(1 << bits - 1) if number.format.islower() else 0
    return max(number.low, least), min(number.high, least + (1 << bits) - 1)


class Numbers(NamedTuple):
    """Several numbers of one kind."""

    name: str  #: Name of the field, which is a tuple.
    many: int  #: How many.
    each: Number  #: One of them; its name does not matter.

    @property
    def format(self) -> str:
        """All of them."""
        return f"{self.many}{self.each.format}"

    @property
    def names(self) -> tuple[str, ...]:
        """The name of all of them."""
        return (self.name,)

    @property
    def limit(self) -> str:
        """The documented range of each."""
        return f"each {self.each.limit}"

    def write(self, record: object) -> tuple[Any, ...]:
        """The values for the struct."""
        return tuple(getattr(record, self.name))

    def read(self, values: Iterator[Any]) -> Iterator[tuple[str, Any]]:
        """The values from the struct, as a tuple."""
        yield self.name, tuple(next(values) for _ in range(self.many))

    def problems(self, record: object) -> Iterator[Problem]:
        """Which are outside, or that they are too many or too few."""
        values: Sequence[Any] = getattr(record, self.name)
        if len(values) != self.many:
            yield Problem(self.name, values, f"{self.many} numbers")
            return
        for index, value in enumerate(values):
            if not self.each.fits(value):
                yield Problem(f"{self.name}[{index}]", value, self.each.limit)

    def shown(self, record: object) -> Iterator[tuple[str, Any]]:
        """All of them."""
        yield self.name, list(getattr(record, self.name))


class Nibbles(NamedTuple):
    """Two numbers of four bits in one byte."""

    low: str  #: Names of the fields in the low and in the high half.
    high: str  #: Names of the fields in the low and in the high half.

    @property
    def format(self) -> str:
        """One byte."""
        return "B"

    @property
    def names(self) -> tuple[str, ...]:
        """The low half, the high half."""
        return tuple(self)

    @property
    def halves(self) -> tuple[Number, ...]:
        """Each as a number."""
        return tuple(Number(name, "B", 0, 15) for name in self)

    @property
    def limit(self) -> str:
        """The documented range of each."""
        return "low and high four bits, each 0 to 15"

    def write(self, record: object) -> tuple[Any, ...]:
        """The values for the struct."""
        return (getattr(record, self.low) | getattr(record, self.high) << 4,)

    def read(self, values: Iterator[Any]) -> Iterator[tuple[str, Any]]:
        """Both halves."""
        both = next(values)
        yield self.low, both & 15
        yield self.high, both >> 4

    def problems(self, record: object) -> Iterator[Problem]:
        """Which do not fit."""
        for half in self.halves:
            yield from half.problems(record)

    def shown(self, record: object) -> Iterator[tuple[str, Any]]:
        """Both."""
        for name in self:
            yield name, getattr(record, name)


class Reserved(NamedTuple):
    """Bytes that are sent as zero and ignored: DJI's programs leave uninitialised memory there."""

    many: int  #: How many.

    @property
    def format(self) -> str:
        """Padding, in the language of :mod:`struct`."""
        return f"{self.many}x"

    @property
    def names(self) -> tuple[str, ...]:
        """None."""
        return ()

    @property
    def limit(self) -> str:
        """The rule for these bytes, in words."""
        return "sent as 0, ignored"


Part: TypeAlias = Number | Numbers | Nibbles | Reserved


class Layout:
    """Parts in the order of the wire, little-endian and packed.

    Attributes:
        size: Bytes in all.
    """

    __slots__ = ("_all", "_parts", "_struct", "size")

    def __init__(self, *parts: Part) -> None:
        self._all = parts
        self._parts = [part for part in parts if not isinstance(part, Reserved)]
        self._struct = Struct("<" + "".join(part.format for part in parts))
        self.size = self._struct.size

    def offsets(self) -> Iterator[tuple[int, Part]]:
        """Each part with the byte that it begins at."""
        offset = 0
        for part in self._all:
            yield offset, part
            offset += calcsize(f"<{part.format}")

    @property
    def numbers(self) -> dict[str, Number]:
        """The range of each single number, by name."""
        halves = (half for part in self._parts if isinstance(part, Nibbles) for half in part.halves)
        singles = (part for part in self._parts if isinstance(part, Number))
        return {number.name: number for number in (*singles, *halves)}

    def write(self, record: object) -> bytes:
        """The bytes of a record whose values fit."""
        return self._struct.pack(*(value for part in self._parts for value in part.write(record)))

    def read(self, value: bytes) -> dict[str, Any]:
        """The fields by name, from as many bytes as the layout has."""
        values = iter(self._struct.unpack(value))
        return {name: number for part in self._parts for name, number in part.read(values)}

    def problems(self, record: object) -> list[Problem]:
        """Every value outside its documented range."""
        return [problem for part in self._parts for problem in part.problems(record)]

    def shown(self, record: object) -> dict[str, Any]:
        """The fields for people."""
        return {name: value for part in self._parts for name, value in part.shown(record)}

    def raw(self, record: object) -> dict[str, Any]:
        """The fields as on the wire, lists as lists."""
        names = (name for part in self._parts for name in part.names)
        values = ((name, getattr(record, name)) for name in names)
        return {name: list(v) if isinstance(v, tuple) else v for name, v in values}


class Record:
    """Something with a fixed layout; the subclasses are dataclasses with the fields of it.

    Attributes:
        LAYOUT: Its fields on the wire.
    """

    __slots__ = ()

    LAYOUT: ClassVar[Layout]

    def raw(self) -> dict[str, Any]:
        """The fields as on the wire."""
        return self.LAYOUT.raw(self)

    def problems(self) -> list[Problem]:
        """Every value outside its documented range."""
        return self.LAYOUT.problems(self)

    def shown(self) -> dict[str, Any]:
        """The fields in degrees, metres, seconds and words."""
        return self.LAYOUT.shown(self)

    def to_wire(self, name: str) -> bytes:
        """The bytes, checked.

        Raises:
            BadValue: A value outside its documented range.
        """
        for problem in self.problems():
            raise problem.error(name)
        return self.LAYOUT.write(self)

    @classmethod
    def from_wire(cls, value: bytes) -> Self:
        """Read as many bytes as the layout has, whatever they say."""
        return cls(**cls.LAYOUT.read(value))


class Laid(Record, Command):
    """A command or push whose value is a record."""

    __slots__ = ()

    def value(self, profile: FirmwareProfile) -> bytes:
        """The record, checked.

        Raises:
            BadValue: A value outside its documented range.
        """
        return self.to_wire(self.NAME)

    @classmethod
    def parse(cls, value: bytes, profile: FirmwareProfile) -> Self:
        """As many bytes as the layout has; values outside their range are kept as they came."""
        return cls.from_wire(exactly(value, cls.LAYOUT.size, cls.NAME))

    def fields(self) -> dict[str, Any]:
        """In degrees, metres, seconds and words."""
        return self.shown()


@dataclass(frozen=True, slots=True)
class AnyByte(Laid):
    """A command whose one byte may be anything."""

    LAYOUT: ClassVar[Layout] = Layout(Number("any"))

    any: int = 0


def latitude(name: str = "latitude") -> Number:
    """A latitude in radians."""
    return Number(name, "d", -math.pi / 2, math.pi / 2, "rad")


def longitude(name: str = "longitude") -> Number:
    """A longitude in radians."""
    return Number(name, "d", -math.pi, math.pi, "rad")
