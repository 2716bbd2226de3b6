"""The buttons that one flies with."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.fields import say_options
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.take_over import TakeOverDialog
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import say
from m100link.protocol.commands.control import Task

__all__ = ["ActionsPart"]

_SIMPLE = (0, 1, 4)


class ActionsPart:
    """Control, take-off, landing, go home and simple tasks.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._take_over = TakeOverDialog(deck.tab, deck.wording)

    def build(self) -> None:
        """Lay it out."""
        tab, add = self._deck.tab, self._deck.buttons.add
        with ui.element("div").classes("acts"):
            add("activate", "actions.activate", tab.activate, kind="plain")
            add("obtain", "actions.obtain", self._take_over.obtain)
            add("release", "actions.release", tab.release, kind="plain")
            add("take_off", "actions.take_off", self._deck.take_off)
            add("land", "actions.land", lambda: tab.fly(Task.LAND))
            add("go_home", "actions.go_home", lambda: tab.fly(Task.GO_HOME))
        with ui.element("div").classes("acts simple"):
            add(
                "simple_task",
                "actions.simple_task",
                lambda: tab.simple_task(int(self._number.value)),
            )
            self._number = ui.select(list(_SIMPLE), value=0).classes("task-number")
            self._number.props("dense outlined id=task-number")
            keys = {number: f"page.simple.{number}" for number in _SIMPLE}
            say_options(self._number, keys, self._deck.wording)
            self._deck.wording.put(attribute(self._number), "page.which_task")
        # Behind the buttons: it comes and goes, and they stay where the finger is.
        with ui.element("div").classes("told"):
            self._activation = ui.label().props("id=activation")
            with ui.element("button").props("type=button data-go=check id=why-not") as why_not:
                self._why_not = ui.label()
            self._why_not_button = why_not.classes("see")
            why_not.on("click", lambda: self._deck.show("check"), args=[])

    def update(self, view: View) -> None:
        """Show what is."""
        self._take_over.update()
        wording = self._deck.wording
        self._activation.set_text(wording(view.activation))
        missing = len(view.checklist.missing)
        is_asked = view.situation.is_on_ground is not False and not view.checklist.may_take_off
        self._why_not_button.set_visibility(is_asked)
        self._why_not.set_text(wording(say("actions.why_not", count=missing)))
