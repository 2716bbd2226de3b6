"""Lengths and speeds in the units that an operator chose (pure functions of numbers)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

__all__ = ["METRIC", "Kind", "Language", "LengthUnit", "Quantity", "SpeedUnit", "Units", "number"]

FEET_PER_METRE = 1 / 0.3048
"""International foot."""

KNOTS_PER_M_S = 3600 / 1852
"""International nautical mile."""


class Language(Enum):
    """A language of the console; the value is its tag, as in HTML."""

    ENGLISH = "en"
    GERMAN = "de"


class LengthUnit(Enum):
    """What lengths and heights are shown in."""

    METRE = "m"
    FOOT = "ft"


class SpeedUnit(Enum):
    """What speeds are shown in, climb included."""

    M_S = "m/s"
    KM_H = "km/h"
    KNOT = "kn"


class Kind(Enum):
    """What a quantity measures; the value is its SI unit."""

    LENGTH = "m"
    SPEED = "m/s"


_LENGTH_FACTORS = {LengthUnit.METRE: 1.0, LengthUnit.FOOT: FEET_PER_METRE}
_SPEED_FACTORS = {SpeedUnit.M_S: 1.0, SpeedUnit.KM_H: 3.6, SpeedUnit.KNOT: KNOTS_PER_M_S}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A measured number that is shown in the operator's unit.

    Attributes:
        value: In the SI unit of its kind.
        kind: What it measures.
        digits: Behind the decimal point.
        is_signed: Whether a plus is shown.
    """

    value: float
    kind: Kind
    digits: int = 0
    is_signed: bool = False

    @classmethod
    def length(cls, metres: float, digits: int = 0) -> Quantity:
        """A length or height, m."""
        return cls(metres, Kind.LENGTH, digits)

    @classmethod
    def speed(cls, metres_per_second: float, digits: int = 1, *, signed: bool = False) -> Quantity:
        """A speed, m/s."""
        return cls(metres_per_second, Kind.SPEED, digits, signed)


@dataclass(frozen=True, slots=True)
class Units:
    """The units that an operator chose.

    Attributes:
        length: Of lengths and heights.
        speed: Of speeds.
    """

    length: LengthUnit = LengthUnit.METRE
    speed: SpeedUnit = SpeedUnit.M_S

    def convert(self, value: float, kind: Kind) -> float:
        """A number in SI units as a number in these."""
        if kind is Kind.LENGTH:
            return value * _LENGTH_FACTORS[self.length]
        return value * _SPEED_FACTORS[self.speed]

    def to_si(self, shown: float, kind: Kind) -> float:
        """A number in these units as a number in SI units."""
        return shown / self.convert(1.0, kind)

    def unit(self, kind: Kind) -> str:
        """The sign of the unit."""
        return self.length.value if kind is Kind.LENGTH else self.speed.value

    def text(self, quantity: Quantity, language: Language = Language.ENGLISH) -> str:
        """A quantity with its unit, as the language writes numbers.

        >>> Units(LengthUnit.FOOT).text(Quantity.length(50))
        '164 ft'
        """
        shown = self.convert(quantity.value, quantity.kind)
        written = number(shown, quantity.digits, language, is_signed=quantity.is_signed)
        return f"{written} {self.unit(quantity.kind)}"


METRIC = Units()
"""Metres, and metres per second: the units of the protocol."""


def number(
    value: float, digits: int, language: Language = Language.ENGLISH, *, is_signed: bool = False
) -> str:
    """A number as the language writes it; a zero never has a minus.

    >>> number(-0.04, 1, Language.GERMAN)
    '0,0'
    """
    written = f"{value:{'+' if is_signed else ''}z.{digits}f}"
    return written.replace(".", ",") if language is Language.GERMAN else written
