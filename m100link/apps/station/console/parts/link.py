"""The link in numbers."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from m100link.apps.station.console.parts.fields import card, field
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.view.link import LINK_ITEMS
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text, say

__all__ = ["LinkPart"]

_RATE_COLUMNS = ("item", "rate", "jitter", "longest_gap")


class LinkPart:
    """How the ways to the aircraft and to the browser do.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._numbers: dict[str, Any] = {}
        self._tables: dict[str, tuple[Any, tuple[Any, ...]]] = {}

    def build(self) -> None:
        """Lay it out. The page itself fills in the age that it measures."""
        wording = self._deck.wording
        with card("link.title", wording):
            for name in LINK_ITEMS:
                self._numbers[name] = field(name, f"link.{name}", wording)[1]
            field("age", "link.age", wording)
            self._reason = ui.label().classes("problem").props("id=connection-error")
        for name in ("causes", "rates", "dropped"):
            with card(f"link.{name}", wording):
                box = ui.element("div").props(f"id=link-{name}").classes("w-full")
                self._tables[name] = box, ()

    def update(self, view: View) -> None:
        """Show what is."""
        speak = self._deck.wording
        for name, text in view.link.texts.items():
            self._numbers[name].set_text(speak(text))
        self._reason.set_text(view.link.reason)
        causes = view.link.causes or ((say("link.none"), ""),)
        self._fill("causes", ("", ""), tuple((speak(cause), count) for cause, count in causes))
        heads = tuple(speak(Text(f"link.{name}")) for name in _RATE_COLUMNS)
        rows = tuple(
            (speak(one.name), one.rate, one.jitter, one.longest_gap) for one in view.link.rates
        )
        self._fill("rates", heads, rows)
        heads = tuple(speak(Text(f"link.{name}")) for name in ("client", "not_got"))
        self._fill("dropped", heads, view.link.dropped)

    def _fill(self, name: str, heads: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> None:
        """A table of texts: its cells stay as long as it has as many."""
        box, cells = self._tables[name]
        texts = [text for row in ((heads, *rows) if any(heads) else rows) for text in row]
        if len(cells) != len(texts):
            box.clear()
            with (
                box,
                ui.element("div")
                .classes("table")
                .style(f"grid-template-columns: 1fr{' auto' * (len(heads) - 1)}"),
            ):
                cells = tuple(ui.label() for _ in texts)
            self._tables[name] = box, cells
        for cell, text in zip(cells, texts, strict=True):
            cell.set_text(text)
