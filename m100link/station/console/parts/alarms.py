"""The header: the status line, and what is alarming."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.parts.part import Deck
from m100link.station.console.view.view import View

__all__ = ["AlarmsPart"]


class AlarmsPart:
    """Always on the page, above every view.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""
        self._banner = ui.label().classes("banner").props("id=banner role=status")
        self._problem = ui.label().classes("problem").props("id=problem role=alert")
        self._kind = ""

    def update(self, view: View) -> None:
        """Show what is."""
        self._banner.set_text(view.status.text)
        self._problem.set_text(view.status.problem)
        if view.status.kind != self._kind:
            self._banner.classes(remove=self._kind, add=view.status.kind)
            self._kind = view.status.kind
