"""Texts of the console, in the language and the units of its operator.

A view model holds a :class:`Text`: the key of an entry and what is filled in. The entries are
data: one file of ``console/texts/`` for each language, read when the first text is said in it.
Errors of this package keep their English everywhere, so that a log, a page and a report agree;
other languages have the meaning of the error's class before that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from m100link.errors import GuardRefused, M100Error
from m100link.errors.texts import read_json, read_toml

# -- units -----------------------------------------------------------------------------------------

FEET_PER_METRE = 1 / 0.3048  # international foot
KNOTS_PER_M_S = 3600 / 1852  # international nautical mile


class Language(Enum):
    """A language of the console; the value is its tag, as in HTML."""

    ENGLISH = "en"
    GERMAN = "de"


class LengthUnit(Enum):
    METRE = "m"
    FOOT = "ft"


class SpeedUnit(Enum):
    M_S = "m/s"
    KM_H = "km/h"
    KNOT = "kn"


class QuantityKind(Enum):
    LENGTH = "m"
    SPEED = "m/s"


_LENGTH_FACTORS = {LengthUnit.METRE: 1.0, LengthUnit.FOOT: FEET_PER_METRE}
_SPEED_FACTORS = {SpeedUnit.M_S: 1.0, SpeedUnit.KM_H: 3.6, SpeedUnit.KNOT: KNOTS_PER_M_S}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A measured number that is shown in the operator's unit."""

    value: float  # in the SI unit of its kind
    kind: QuantityKind  # what it measures
    digits: int = 0  # behind the decimal point
    is_signed: bool = False  # whether a plus is shown

    @classmethod
    def length(cls, metres: float, digits: int = 0) -> Quantity:
        """A length or height, m."""
        return cls(metres, QuantityKind.LENGTH, digits)

    @classmethod
    def speed(cls, metres_per_second: float, digits: int = 1, *, signed: bool = False) -> Quantity:
        """A speed, m/s."""
        return cls(metres_per_second, QuantityKind.SPEED, digits, signed)


@dataclass(frozen=True, slots=True)
class Units:
    length: LengthUnit = LengthUnit.METRE  # of lengths and heights
    speed: SpeedUnit = SpeedUnit.M_S

    def convert(self, value: float, kind: QuantityKind) -> float:
        if kind is QuantityKind.LENGTH:
            return value * _LENGTH_FACTORS[self.length]
        return value * _SPEED_FACTORS[self.speed]

    def to_si(self, shown: float, kind: QuantityKind) -> float:
        return shown / self.convert(1.0, kind)

    def unit(self, kind: QuantityKind) -> str:
        return self.length.value if kind is QuantityKind.LENGTH else self.speed.value

    def text(self, quantity: Quantity, language: Language = Language.ENGLISH) -> str:
        """A quantity with its unit, as the language writes numbers.

        >>> Units(LengthUnit.FOOT).text(Quantity.length(50))
        '164 ft'
        """
        shown = self.convert(quantity.value, quantity.kind)
        written = number(shown, quantity.digits, language, is_signed=quantity.is_signed)
        return f"{written} {self.unit(quantity.kind)}"


METRIC = Units()  # metres, and metres per second: the units of the protocol


def number(
    value: float, digits: int, language: Language = Language.ENGLISH, *, is_signed: bool = False
) -> str:
    """A number as the language writes it; a zero never has a minus.

    >>> number(-0.04, 1, Language.GERMAN)
    '0,0'
    """
    written = f"{value:{'+' if is_signed else ''}z.{digits}f}"
    return written.replace(".", ",") if language is Language.GERMAN else written


# -- texts -----------------------------------------------------------------------------------------

_BROWSER = "browser."

_TEXTS = Path(__file__).parents[1] / "texts"


@cache
def translations(language: Language = Language.ENGLISH) -> Mapping[str, str]:
    """Each text of the console in a language, by its key: the table and the name in its file.

    >>> translations(Language.GERMAN)["actions.land"]
    'Landen (halten)'
    """
    tables = read_toml((_TEXTS / f"{language.value}.toml").read_text(encoding="utf-8"))
    return {
        f"{table}.{name}": text for table, texts in tables.items() for name, text in texts.items()
    }


@dataclass(frozen=True, slots=True)
class Text:
    key: str  # of its entry
    # The values in its braces: a text, a whole number, a number with one digit behind the point, a
    # quantity, the unit of a kind, or another text to be said.
    values: Mapping[str, object] = field(default_factory=dict)


def tr(key: str, **values: object) -> Text:
    return Text(key, values)


@dataclass(frozen=True, slots=True)
class Translator:
    language: Language = Language.ENGLISH
    units: Units = METRIC

    def __call__(self, text: Text) -> str:
        """The text as it is shown or spoken.

        >>> Translator(Language.GERMAN)(tr("unit.seconds", seconds=1.5))
        '1,5 s'
        """
        entry = translations(self.language)[text.key]
        if not text.values:
            return entry
        return entry.format_map({name: self._filled(one) for name, one in text.values.items()})

    def _filled(self, value: object) -> str:
        if isinstance(value, Text):
            return self(value)
        if isinstance(value, Quantity):
            return self.units.text(value, self.language)
        if isinstance(value, QuantityKind):
            return self.units.unit(value)
        if isinstance(value, float):
            return number(value, 1, self.language)
        return str(value)


def for_browser(speaker: Translator) -> dict[str, object]:
    """The texts for ``static/said.js``: its words, units as factor and sign, the decimal sign."""
    units = speaker.units
    return {
        "words": {
            key.removeprefix(_BROWSER): text
            for key, text in translations(speaker.language).items()
            if key.startswith(_BROWSER)
        },
        "length": [units.convert(1.0, QuantityKind.LENGTH), units.unit(QuantityKind.LENGTH)],
        "speed": [units.convert(1.0, QuantityKind.SPEED), units.unit(QuantityKind.SPEED)],
        "language": speaker.language.value,
        "point": number(0.0, 1, speaker.language)[1],
    }


# -- errors ----------------------------------------------------------------------------------------


def problem_text(error: M100Error) -> Text:
    return Text(_key(error), {"original": str(error)})


def reason_text(error: M100Error) -> Text:
    """The observation alone, where the remedy stands elsewhere."""
    return Text(_key(error), {"original": error.seen})


def _key(error: M100Error) -> str:
    if isinstance(error, GuardRefused):
        key = f"errors.guard_refused.{error.guard}"
        if key in translations():
            return key
    codes = (kind.error_code for kind in type(error).__mro__ if issubclass(kind, M100Error))
    names = (code.removeprefix("M100-").lower().replace("-", "_") for code in codes)
    return next(key for name in names if (key := f"errors.{name}") in translations())


# -- what an operator chose for one page -----------------------------------------------------------

_MAX_TEXT = 1000


class Theme(Enum):
    """How the page looks; the value is the attribute of the style sheet."""

    AUTO = "auto"  # as the device asks
    LIGHT = "light"
    DARK = "dark"
    SUN = "sun"  # black on white, thick lines: readable with the sun on it


@dataclass(frozen=True, slots=True)
class DisplaySettings:
    language: Language = Language.ENGLISH  # what is said and shown in
    length: LengthUnit = LengthUnit.METRE  # of lengths and heights
    speed: SpeedUnit = SpeedUnit.M_S
    theme: Theme = Theme.AUTO  # how the page looks
    sound: bool = True  # whether alarms sound
    speech: bool = True  # whether alarms are spoken
    name: str = ""  # who it is, for the others; empty for what the station gave

    @property
    def units(self) -> Units:
        return Units(self.length, self.speed)

    @property
    def speaker(self) -> Translator:
        return Translator(self.language, self.units)

    def to_text(self) -> str:
        chosen = {one.name: getattr(self, one.name) for one in fields(self)}
        return json.dumps(
            {name: one.value if isinstance(one, Enum) else one for name, one in chosen.items()}
        )

    @classmethod
    def from_text(cls, text: object) -> DisplaySettings:
        """The settings that the browser kept; the default of each it cannot read. Never raises."""
        if not isinstance(text, str) or len(text) > _MAX_TEXT:
            return cls()
        try:
            kept = read_json(text)
        except ValueError:
            return cls()
        if not isinstance(kept, dict):
            return cls()
        defaults = cls()
        chosen: dict[str, Any] = {
            one.name: _read(kept.get(one.name), getattr(defaults, one.name)) for one in fields(cls)
        }
        return cls(**chosen)


def _read(value: object, default: Any) -> Any:
    """A kept value, if it is one that can be chosen."""
    if isinstance(default, Enum):
        known = {one.value: one for one in type(default)}
        return known.get(value, default) if isinstance(value, str) else default
    if type(value) is not type(default):
        return default
    return value[:64] if isinstance(value, str) else value


def clock(seconds: float) -> str:
    """Seconds as ``m:ss``, from an hour on as ``h:mm:ss``."""
    whole = int(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
