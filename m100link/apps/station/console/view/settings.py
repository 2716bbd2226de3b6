"""What an operator chose for one page: language, units, looks, sound. The browser keeps it."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

from m100link.apps.station.console.view.units import Language, LengthUnit, SpeedUnit, Units
from m100link.apps.station.console.view.words import Speaker
from m100link.errors.texts import read_json

__all__ = ["Settings", "Theme"]

_MAX_TEXT = 1000


class Theme(Enum):
    """How the page looks; the value is the attribute of the style sheet."""

    AUTO = "auto"  # as the device asks
    LIGHT = "light"
    DARK = "dark"
    SUN = "sun"  # black on white, thick lines: readable with the sun on it


@dataclass(frozen=True, slots=True)
class Settings:
    """What was chosen.

    Attributes:
        language: What is said and shown in.
        length: Of lengths and heights.
        speed: Of speeds.
        theme: How the page looks.
        sound: Whether alarms sound.
        speech: Whether alarms are spoken.
        name: Who it is, for the others; empty for what the station gave.
    """

    language: Language = Language.ENGLISH
    length: LengthUnit = LengthUnit.METRE
    speed: SpeedUnit = SpeedUnit.M_S
    theme: Theme = Theme.AUTO
    sound: bool = True
    speech: bool = True
    name: str = ""

    @property
    def units(self) -> Units:
        """The units."""
        return Units(self.length, self.speed)

    @property
    def speaker(self) -> Speaker:
        """Says texts as it was chosen."""
        return Speaker(self.language, self.units)

    def to_text(self) -> str:
        """What the browser keeps."""
        chosen = {one.name: getattr(self, one.name) for one in fields(self)}
        return json.dumps(
            {name: one.value if isinstance(one, Enum) else one for name, one in chosen.items()}
        )

    @classmethod
    def from_text(cls, text: object) -> Settings:
        """What the browser kept; what cannot be read is as it is by default. Never raises."""
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
