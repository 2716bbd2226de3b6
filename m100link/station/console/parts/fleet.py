"""The aircraft that this station serves."""

from __future__ import annotations

from m100link.station.console.parts.part import Deck
from m100link.station.console.view.view import View

__all__ = ["FleetPart"]


class FleetPart:
    """The list of aircraft: there is one.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""

    def update(self, view: View) -> None:
        """Show what is."""
