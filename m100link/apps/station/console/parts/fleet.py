"""The aircraft that this station serves, when there are several."""

from __future__ import annotations

import json
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from m100link.apps.station.console.parts.buttons import ORDER, answer
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.fleet import FleetRow
from m100link.apps.station.console.view.settings import Settings
from m100link.apps.station.console.view.view import View

__all__ = ["FleetPart"]


class FleetPart:
    """A row of aircraft: a press turns to one, and each can be stopped without that.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[str, _Row] = {}  # as they came

    def build(self) -> None:
        """Lay it out."""
        self._place = ui.element("nav").props("id=fleet")
        self._place.set_visibility(False)  # of one aircraft there is no list
        self._deck.wording.put(attribute(self._place), "fleet.label")

    def update(self, view: View) -> None:
        """Show what is; of a fleet more may come."""
        for row in view.fleet:
            if not self._rows:
                self._place.set_visibility(True)
                self._deck.load("ships.js")
            if row.name not in self._rows:
                with self._place:
                    self._rows[row.name] = _Row(self._deck, row.name)
            self._rows[row.name].show(row)


class _Row:
    def __init__(self, deck: Deck, name: str) -> None:
        self._deck, self._name = deck, name
        self._shown: tuple[FleetRow, Settings] | None = None  # and what it was said in
        with ui.element("div").classes("ship") as self._box:
            turn = ui.element("button").props(f'type=button data-ship="{name}"')
            deck.wording.put(attribute(turn, "title"), "fleet.show", name=name)
            with turn:
                ui.label(name).classes("ship-name")
                self._control = ui.label().classes("ship-control")
                self._flies = ui.label().classes("ship-flies")
                self._battery = ui.label()
            self._turn: Any = turn
            turn.on("click", self._turn_to, args=[])
            stop = (
                ui.element("button").classes("ship-stop").props(f'type=button data-halt="{name}"')
            )
            deck.wording.put(attribute(stop), "fleet.stop", name=name)
            with stop:
                deck.wording.put(ui.label().set_text, "actions.stop")
            stop.on("click", self._stop, js_handler=ORDER)

    def _turn_to(self) -> None:
        if self._name != self._deck.tab.aircraft:
            address = self._deck.tabs.move(self._deck.tab, self._name)
            ui.run_javascript(f"location.replace({json.dumps(address)})")

    def _stop(self, event: GenericEventArguments) -> None:
        answer(event)
        agent, tab = self._deck.tabs.agents[self._name], self._deck.tab
        agent.background.spawn(tab.attempt(agent.stop), f"stop of {tab.name}")

    def show(self, row: FleetRow) -> None:
        """Show what has changed."""
        said = self._deck.wording
        before, self._shown = self._shown, (row, said.settings)
        if self._shown == before:
            return
        self._control.set_text(said(row.control))
        self._flies.set_text(said(row.flies))
        self._battery.set_text(said(row.battery))
        self._battery.classes(add="low") if row.is_low else self._battery.classes(remove="low")
        self._turn.props(f"aria-current={'page' if row.is_shown else 'false'}")
        self._box.classes(remove="mine theirs free lost", add=row.kind)
