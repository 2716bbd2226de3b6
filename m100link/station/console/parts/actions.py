"""The buttons that one flies with."""

from __future__ import annotations

from nicegui import ui

from m100link.protocol.commands.control import Task
from m100link.station.console.parts.part import Deck
from m100link.station.console.parts.take_over import TakeOverDialog
from m100link.station.console.view.view import View

__all__ = ["ActionsPart"]

_LEGS = {0: "0: legs, angles", 1: "1: legs, velocity", 4: "4: whole flight"}


class ActionsPart:
    """Control, take-off, landing, go home and simple tasks.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._take_over = TakeOverDialog(deck.tab)

    def build(self) -> None:
        """Lay it out."""
        tab, add = self._deck.tab, self._deck.buttons.add
        with ui.element("div").classes("told"):
            self._activation = ui.label().props("id=activation")
            self._task = ui.label().props("id=task role=status")
        with ui.element("div").classes("acts"):
            add("activate", "Activate", tab.activate, kind="plain")
            add("obtain", "Obtain control", self._take_over.obtain)
            add("release", "Release control", tab.release, kind="plain")
            add("take_off", "Take off (hold)", lambda: tab.fly(Task.TAKE_OFF), hold=True)
            add("land", "Land (hold)", lambda: tab.fly(Task.LAND), hold=True)
            add("go_home", "Go home", lambda: tab.fly(Task.GO_HOME))
        with ui.element("div").classes("acts simple"):
            add("simple_task", "Simple task", lambda: tab.simple_task(int(self._number.value)))
            self._number = (
                ui.select(_LEGS, value=0)
                .props('dense outlined id=task-number aria-label="which simple task"')
                .classes("task-number")
            )

    def update(self, view: View) -> None:
        """Show what is."""
        self._take_over.update()
        task = view.status.task
        self._task.set_text(f"flying: {task}" if task else "")
        self._activation.set_text(view.status.activation)
