"""Values over time."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.parts.fields import card
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.view import View

__all__ = ["PlotsPart"]


class PlotsPart:
    """The last minute of four values, drawn by ``static/plots.js`` from the socket.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""
        with card("Last minute"), ui.element("div").classes("plots"):
            for name in ("height", "speed", "yaw", "link"):
                ui.element("canvas").classes("plot").props(
                    f'id=plot-{name} role=img aria-label="{name} in the last minute"'
                )
        self._deck.load("plots.js")

    def update(self, view: View) -> None:
        """What it shows comes by the socket."""
