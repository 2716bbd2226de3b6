"""The instruments over the map: horizon with tapes, and the values that a pilot wants."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.fields import ReadingRow
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.instruments import FIELDS
from m100link.apps.station.console.view.view import View

__all__ = ["InstrumentsPart"]

_SHOWN = ("flight_status", "battery", "gps", "height", "speed", "mode_switch")


class InstrumentsPart:
    """What a pilot looks at. The canvas is drawn by ``static/instruments.js`` from the socket.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[str, ReadingRow] = {}

    def build(self) -> None:
        """Lay it out."""
        horizon = ui.element("canvas").props("id=horizon role=img")
        self._deck.wording.put(attribute(horizon), "instruments.horizon")
        with ui.element("div").classes("values"):
            for one in FIELDS:
                if one.name in _SHOWN:
                    self._rows[one.name] = ReadingRow(one.name, self._deck.wording)

    def update(self, view: View) -> None:
        """Show what is."""
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])
