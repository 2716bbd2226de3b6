"""The Fly view: over the map, what is needed to fly."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.actions import ActionsPart
from m100link.apps.station.console.parts.click import ClickPart
from m100link.apps.station.console.parts.instruments import InstrumentsPart
from m100link.apps.station.console.parts.part import Deck, Part
from m100link.apps.station.console.parts.sticks import SticksPart
from m100link.apps.station.console.view.view import View

__all__ = ["Fly"]


class Fly:
    """A part made of parts.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._places: tuple[tuple[str, Part], ...] = (
            ("hud", InstrumentsPart(deck)),
            ("orders", ActionsPart(deck)),
            ("clicked", ClickPart(deck)),
            ("steering", SticksPart(deck.wording)),
        )

    def build(self) -> None:
        """Lay it out: where each place stands is said by the style sheet, for every size."""
        for place, part in self._places:
            with ui.element("div").classes(f"place {place}"):
                part.build()

    def update(self, view: View) -> None:
        """Show what is."""
        for _, part in self._places:
            part.update(view)
