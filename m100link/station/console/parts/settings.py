"""Settings of the page, and the panel of a virtual aircraft."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.parts.fields import card
from m100link.station.console.parts.part import Deck
from m100link.station.console.parts.simpanel import sim_panel
from m100link.station.console.view.view import View

__all__ = ["SettingsPart"]

_THEMES = {"auto": None, "light": False, "dark": True}


class SettingsPart:
    """Who looks, and how.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck

    def build(self) -> None:
        """Lay it out."""
        tab = self._deck.tab
        with card("This page"):
            name = ui.input("your name", value=tab.name).props("id=name").classes("w-60")
            name.on_value_change(lambda event: setattr(tab, "name", str(event.value)[:64]))
            dark = ui.dark_mode(None)
            ui.toggle(
                list(_THEMES),
                value="auto",
                on_change=lambda event: dark.set_value(_THEMES[event.value]),
            ).props('id=theme aria-label="theme"')
        if self._deck.orders is not None:
            with card("Virtual aircraft"):
                sim_panel(self._deck.orders)

    def update(self, view: View) -> None:
        """Nothing of it comes from the aircraft."""
