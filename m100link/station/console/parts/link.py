"""The link in numbers."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from m100link.station.console.parts.fields import card, field
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.link import LINK_ITEMS
from m100link.station.console.view.view import View

__all__ = ["LinkPart"]


class LinkPart:
    """How the ways to the aircraft and to the browser do.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._numbers: dict[str, Any] = {}

    def build(self) -> None:
        """Lay it out. The page itself fills in the two that it measures."""
        with card("Link"):
            for name, label in LINK_ITEMS:
                self._numbers[name] = field(name, label)[1]
            field("browser_ms", "Browser and back")
            field("age", "Newest package")
            self._reason = ui.label().classes("problem").props("id=connection-error")

    def update(self, view: View) -> None:
        """Show what is."""
        for name, text in view.link.texts.items():
            self._numbers[name].set_text(text)
        self._reason.set_text(view.link.reason)
