"""What happened."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.parts.fields import card
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.view import View

__all__ = ["EventsPart"]


class EventsPart:
    """A list that grows at its end.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._last = 0

    def build(self) -> None:
        """Lay it out."""
        with card("Events"):
            self._events = ui.log(max_lines=100).classes("events w-full").props("id=events")

    def update(self, view: View) -> None:
        """Show what is."""
        for event in view.events:
            if event.number > self._last:
                self._last = event.number
                self._events.push(f"{event.at:9.1f}  {event.text}", classes=event.level)
