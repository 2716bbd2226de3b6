"""What the console says, in the language and the units of whoever looks at it.

A view model holds a :class:`Text`: the key of an entry and what is filled in. The entries stand in
:mod:`m100link.apps.station.console.view.catalogue`, English beside German. Errors of this package
keep their English everywhere, so that a log, a page and a report say the same; see
:mod:`m100link.apps.station.console.view.errors` for what German has before that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.units import METRIC, Kind, Language, Quantity, Units, number

__all__ = ["Speaker", "Text", "for_browser", "say"]

_BROWSER = "browser."

_INDEX = {Language.ENGLISH: 0, Language.GERMAN: 1}


@dataclass(frozen=True, slots=True)
class Text:
    """Something to be said.

    Attributes:
        key: Of the entry in the catalogue.
        values: What stands in its braces: a text, a whole number, a number with one digit behind
            the point, a quantity, the unit of a kind, or another text to be said.
    """

    key: str
    values: Mapping[str, object] = field(default_factory=dict)


def say(key: str, **values: object) -> Text:
    """A text to be said, with what is filled in."""
    return Text(key, values)


@dataclass(frozen=True, slots=True)
class Speaker:
    """Says texts in one language and one set of units.

    Attributes:
        language: The language.
        units: The units.
    """

    language: Language = Language.ENGLISH
    units: Units = METRIC

    def __call__(self, text: Text) -> str:
        """The text as it is shown or spoken.

        >>> Speaker(Language.GERMAN)(say("unit.seconds", seconds=1.5))
        '1,5 s'
        """
        entry = CATALOGUE[text.key][_INDEX[self.language]]
        if not text.values:
            return entry
        return entry.format_map({name: self._filled(one) for name, one in text.values.items()})

    def _filled(self, value: object) -> str:
        if isinstance(value, Text):
            return self(value)
        if isinstance(value, Quantity):
            return self.units.text(value, self.language)
        if isinstance(value, Kind):
            return self.units.unit(value)
        if isinstance(value, float):
            return number(value, 1, self.language)
        return str(value)


def for_browser(speaker: Speaker) -> dict[str, object]:
    """What ``static/said.js`` is told: its words, units as factor and sign, the decimal sign."""
    units = speaker.units
    keys = [key for key in CATALOGUE if key.startswith(_BROWSER)]
    return {
        "words": {
            key.removeprefix(_BROWSER): CATALOGUE[key][_INDEX[speaker.language]] for key in keys
        },
        "length": [units.convert(1.0, Kind.LENGTH), units.unit(Kind.LENGTH)],
        "speed": [units.convert(1.0, Kind.SPEED), units.unit(Kind.SPEED)],
        "language": speaker.language.value,
        "point": number(0.0, 1, speaker.language)[1],
    }
