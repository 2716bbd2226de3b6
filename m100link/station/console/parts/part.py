"""What a component of the page is, and how one is plugged in.

A part is a class in a file of its own here, named in ``m100link.station.console.page`` under the
view that shows it (or inside :class:`~m100link.station.console.parts.fly.Fly`, which is a part made
of parts)::

    class Clock:
        def __init__(self, deck: Deck) -> None:
            self._deck = deck

        def build(self) -> None:
            self._text = ui.label("–").props("id=clock")

        def update(self, view: View) -> None:
            self._text.set_text(f"{view.at:.0f} s")

- ``build`` is called once, inside the element that holds the part: for the views other than Fly
  when that view is first looked at, so that the page is there soon.
- ``update`` is called four times a second with one view for the whole page, only while the part's
  view is looked at. Setting a text that stands there already costs nothing: just set.
- A rule about what is shown belongs to ``m100link.station.console.view``, where a test reads it
  without a browser.
- A button that gives an order comes from ``deck.buttons``: it is kept grey unless
  ``view.actions`` names it, and holds for a second where that is asked for.
- What runs in the browser is a module in ``static/``, loaded by ``deck.load``; it imports ``m100``
  from ``./shell.js`` (``m100.onLive``, ``m100.onMap``, ``m100.socket``, ``m100.steering``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from nicegui import ui

from m100link.agent.client import AgentClient
from m100link.station.console.history import History
from m100link.station.console.orders import Orders
from m100link.station.console.parts.buttons import Buttons
from m100link.station.console.tab import Tab
from m100link.station.console.tabs import Tabs
from m100link.station.console.view.view import View

__all__ = ["Deck", "Part"]


class Part(Protocol):
    """A component of the page."""

    def build(self) -> None:
        """Lay it out inside the present element."""

    def update(self, view: View) -> None:
        """Show what is."""


@dataclass(frozen=True, slots=True)
class Deck:
    """What parts stand on: one for each page.

    Attributes:
        agent: The agent that owns the aircraft.
        tab: Who looks at the page.
        orders: What the panel does to a virtual aircraft, or None.
        buttons: The buttons that give orders.
        has_tiles: Whether there are map tiles under ``/tiles/{z}/{x}/{y}.png``.
        history: The last minutes of every number.
        tabs: Who looks at this and at other aircraft.
    """

    agent: AgentClient
    tab: Tab
    orders: Orders | None
    buttons: Buttons
    has_tiles: bool
    history: History
    tabs: Tabs

    def load(self, module: str) -> None:
        """Load ``static/<module>`` into this page, also after it was built."""
        ui.run_javascript(f'import("/console/{module}")')
