"""Before take-off: the list, what mends it, and take-off itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nicegui import ui

from m100link.apps.station.console.parts.fields import card
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.take_over import TakeOverDialog
from m100link.apps.station.console.view.checklist import ITEMS, Check, Checklist, Item, ItemState
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text, say

__all__ = ["ChecklistPart"]

_SHAPES = {ItemState.RIGHT: "✔", ItemState.WRONG: "✖", ItemState.UNKNOWN: "?"}


@dataclass(slots=True)
class _Row:
    """One line of the list on the page."""

    box: Any
    shape: Any
    state: Any
    seen: Any
    remedy: Any
    shown: ItemState | None = None


class ChecklistPart:
    """What :class:`~m100link.apps.station.console.view.checklist.Checklist` says.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[Item, _Row] = {}
        self._take_over = TakeOverDialog(deck.tab, deck.wording)

    def build(self) -> None:
        """Lay it out."""
        wording, desk = self._deck.wording, self._deck.memory.checklist
        with card("checklist.title", wording):
            self._summary = ui.label().classes("summary").props("id=check-summary role=status")
            with ui.element("ul").classes("checks").props("id=checks"):
                for item, is_needed in ITEMS.items():
                    self._rows[item] = self._build_row(item, is_needed=is_needed)
            free = ui.checkbox(on_change=lambda event: self._say_free(is_free=bool(event.value)))
            self._free = free.props("id=free-said").classes("free")
            wording.put(self._free.set_text, "checklist.free.box")
            self._why = ui.input(on_change=lambda event: desk.say_why(str(event.value or "")))
            self._why.props("for=why outlined maxlength=200").classes("w-full")
            wording.put(lambda text: self._why.props(f'label="{text}"'), "checklist.why")
            wording.put(lambda text: self._why.props(f'hint="{text}"'), "checklist.why.note")
            with ui.element("div").classes("acts"):
                add = self._deck.buttons.add
                add("activate", "actions.activate", self._deck.tab.activate, kind="plain")
                add("obtain", "actions.obtain", self._take_over.obtain, kind="plain")
                add("take_off", "actions.take_off", self._deck.take_off)

    def _build_row(self, item: Item, *, is_needed: bool) -> _Row:
        wording = self._deck.wording
        with ui.element("li").classes("check").props(f"data-check={item.value}") as box:
            shape = ui.label().classes("shape").props("aria-hidden=true")
            with ui.element("div"):
                with ui.element("div").classes("check-head"):
                    name = ui.label().classes("name")
                    state = ui.label().classes("unseen")
                    seen = ui.label().classes("seen")
                    if is_needed:
                        needed = ui.label().classes("needed")
                        wording.put(needed.set_text, "checklist.needed")
                remedy = ui.label().classes("remedy")
        wording.put(name.set_text, f"checklist.{item.value}")
        return _Row(box, shape, state, seen, remedy)

    def _say_free(self, *, is_free: bool) -> None:
        deck, desk, now = self._deck, self._deck.memory.checklist, self._deck.agent.now
        if is_free is desk.is_free(now):
            return  # the box follows what was said, and says nothing by itself
        desk.say_free(now, is_free=is_free)
        deck.tabs.looks.say(deck.tab.person, deck.tab.aircraft, deck.agent, is_free=is_free)

    def update(self, view: View) -> None:
        """Show what is."""
        self._take_over.update()
        checklist, wording = view.checklist, self._deck.wording
        for check in checklist.checks:
            self._show(self._rows[check.item], check)
        self._summary.set_text(wording(_summary(checklist)))
        if bool(self._free.value) is not checklist.is_free_said:
            self._free.set_value(checklist.is_free_said)
        self._why.set_visibility(not checklist.is_green and checklist.is_possible)
        if not checklist.reason and self._why.value and view.checklist.is_green:
            self._why.set_value("")

    def _show(self, row: _Row, check: Check) -> None:
        wording = self._deck.wording
        row.seen.set_text(wording(check.seen))
        row.remedy.set_text(wording(check.remedy) if check.remedy is not None else "")
        row.state.set_text(wording(Text(f"checklist.state.{check.state.value}")))
        if check.state is not row.shown:
            row.box.classes(remove=row.shown.value if row.shown else "", add=check.state.value)
            row.shape.set_text(_SHAPES[check.state])
            row.shown = check.state


def _summary(checklist: Checklist) -> Text:
    if checklist.is_green:
        return say("checklist.green")
    if not checklist.is_possible:
        return say("checklist.impossible")
    return say("checklist.missing", count=len(checklist.missing))
