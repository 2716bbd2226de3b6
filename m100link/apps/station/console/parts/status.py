"""The status line in the header: one sentence, what to do about it, and what flies."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.situation import Level
from m100link.apps.station.console.view.view import View

__all__ = ["SHAPES", "StatusPart"]

SHAPES = {Level.GOOD: "●", Level.NEUTRAL: "○", Level.WARNING: "▲", Level.DANGER: "◆"}
"""Beside its colour each level has a shape: not everybody sees colours."""


class StatusPart:
    """Always on the page, above every view. What it says comes from ``view.status``.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._level = ""
        self._since: float | None = None

    def build(self) -> None:
        """Lay it out."""
        with ui.element("div").classes("banner").props("id=banner") as self._banner:
            self._shape = ui.label().classes("shape").props("aria-hidden=true")
            with ui.element("div").classes("said").props("role=status"):
                self._text = ui.label().props("id=said")
                self._remedy = ui.label().classes("remedy").props("id=remedy")
            # Counted by the page itself; read aloud it would never end.
            self._counter = ui.label().classes("since").props("aria-hidden=true")
            self._flies = ui.label().classes("flies").props("id=task role=status")
            self._virtual = ui.label().classes("virtual").props("id=virtual")
        self._deck.wording.put(self._virtual.set_text, "status.virtual")
        self._problem = ui.label().classes("problem").props("id=problem role=alert")
        with ui.element("div").classes("page-lost").props("id=page-lost role=alert") as lost:
            with ui.element("div"):
                said = ui.label()
                todo = ui.label().classes("remedy")
            ui.label().classes("since").props("aria-hidden=true id=page-lost-since")
            silence = ui.element("button").props("type=button id=page-lost-seen").classes("see")
            with silence:
                seen = ui.label()
        with ui.element("div").classes("unanswered").props("id=unanswered role=alert hidden"):
            ui.label().props("id=unanswered-said")
            with ui.element("button").props("type=button id=unanswered-seen").classes("see"):
                known = ui.label()
        ui.label().classes("page-said").props("id=page-said role=status")
        self._deck.wording.put(known.set_text, "alarms.acknowledge")
        self._deck.wording.put(said.set_text, "status.page_lost")
        self._deck.wording.put(todo.set_text, "status.page_lost.remedy")
        self._deck.wording.put(seen.set_text, "alarms.acknowledge")
        self._deck.wording.put(attribute(lost, "data-text"), "status.page_lost")
        # When this view was made, on the station's clock: the page knows how old it is.
        self._beat = ui.element("i").props("id=view-beat hidden")

    def update(self, view: View) -> None:
        """Show what is."""
        line, say = view.status, self._deck.wording
        self._text.set_text(say(line.text))
        self._remedy.set_text(say(line.remedy) if line.remedy is not None else "")
        self._flies.set_text(say(line.flies) if line.flies is not None else "")
        self._virtual.set_visibility(line.is_virtual)
        self._problem.set_text("" if view.problem is None else say(view.problem))
        if line.level.value != self._level:
            self._banner.classes(remove=self._level, add=line.level.value)
            self._level = line.level.value
            self._shape.set_text(SHAPES[line.level])
        # The page counts by the station's clock: not by that of a recorded flight.
        since = line.since if view.replay is None else None
        if since != self._since:
            self._since = since
            attribute(self._counter, "data-since")("" if since is None else f"{since:.1f}")
            self._counter.set_text("")
        attribute(self._beat, "data-at")(f"{self._deck.agent.now:.1f}")
