"""What a component of the page is, and how one is plugged in.

A part is a class in a file of its own here, named in ``m100link.apps.station.console.page`` under
the view that shows it (or inside :class:`~m100link.apps.station.console.parts.fly.Fly`, which is a
part made of parts)::

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
- A rule about what is shown belongs to ``m100link.apps.station.console.view``, where a test reads
it
  without a browser.
- A button that gives an order comes from ``deck.buttons``: it is kept grey unless
  ``view.actions`` names it, and has to be held for a second where that says so.
- What is shown in words comes from ``view.catalogue``: ``deck.wording.put(label.set_text, key)``
  for what stands there always, ``deck.wording(text)`` for a text of the view.
- What runs in the browser is a module in ``static/``, loaded by ``deck.load``; it imports ``m100``
  from ``./shell.js`` (``m100.onLive``, ``m100.onMap``, ``m100.socket``, ``m100.steering``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from nicegui import ui

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.console.history import History
from m100link.apps.station.console.orders import Orders
from m100link.apps.station.console.parts.buttons import Buttons
from m100link.apps.station.console.parts.wording import Wording
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.console.view.memory import Memory
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Speaker, Text, say
from m100link.errors import UsageError
from m100link.protocol.commands.control import Task

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
        memory: Its alarms, its checklist, its events.
        wording: Says everything in the operator's language and units.
        dark: Switches the dark looks of NiceGUI's own elements.
        show: Shows another view of the page, by its name.
        has_tiles: Whether there are map tiles under ``/tiles/{z}/{x}/{y}.png``.
        history: The last minutes of every number.
        tabs: Who looks at this and at other aircraft.
    """

    agent: AgentClient
    tab: Tab
    orders: Orders | None
    buttons: Buttons
    memory: Memory
    wording: Wording
    dark: ui.dark_mode
    show: Callable[[str], None]
    has_tiles: bool
    history: History
    tabs: Tabs

    async def take_off(self) -> None:
        """Take off, if the checklist offers it; why it is not green goes into the events.

        Raises:
            UsageError: It does not.
            M100Error: See :meth:`m100link.apps.agent.client.AgentClient.fly`.
        """
        checklist = self.memory.checklist.look(self.memory.situation)
        if not checklist.may_take_off:
            raise UsageError(
                "take-off is not offered: the checklist is not green",
                remedy="mend what it shows, or say there why you fly all the same",
            )
        if not checklist.is_green:
            english = Speaker()
            missing = ", ".join(
                english(Text(f"checklist.{check.item.value}")) for check in checklist.missing
            )
            said = say(
                "checklist.event.although",
                name=self.tab.name,
                missing=missing,
                reason=checklist.reason,
            )
            self.agent.note(english(said), "warning")
        await self.tab.fly(Task.TAKE_OFF)

    def load(self, module: str) -> None:
        """Load ``static/<module>`` into this page, also after it was built."""
        ui.run_javascript(f'import("/console/{module}")')
