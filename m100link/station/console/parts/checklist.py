"""What is looked at before take-off."""

from __future__ import annotations

from m100link.station.console.parts.fields import ReadingRow, card
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.instruments import FIELDS
from m100link.station.console.view.view import View

__all__ = ["ChecklistPart"]

_CHECKED = ("gps", "battery", "mode_switch", "control_device", "flight_status")


class ChecklistPart:
    """Values that decide whether to take off.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[str, ReadingRow] = {}

    def build(self) -> None:
        """Lay it out."""
        with card("Before take-off"):
            for one in FIELDS:
                if one.name in _CHECKED:
                    self._rows[one.name] = ReadingRow(one.name, one.label)

    def update(self, view: View) -> None:
        """Show what is."""
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])
