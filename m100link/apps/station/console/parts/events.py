"""What happened, by the clock on the wall: looked through, and saved."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from m100link.apps.station.console.parts.fields import card, say_options
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.events import LEVELS, MIME, Format, Line, export, select
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import say

__all__ = ["EventsPart"]

_SHOWN = 200
_SHAPES = {"info": "·", "warning": "▲", "error": "◆"}


class EventsPart:
    """The newest lines that were asked for, oldest first.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._least = LEVELS[0]
        self._words = ""
        # The last line that was looked at, the settings it was said in, and what is on the page.
        self._last = 0
        self._said_in: object = None
        self._placed: list[Any] = []

    def build(self) -> None:
        """Lay it out."""
        wording = self._deck.wording
        with card("events.title", wording):
            with ui.row().classes("items-end gap-2 w-full"):
                level = ui.select({name: name for name in LEVELS}, value=self._least)
                level.props("outlined dense for=event-level").classes("min-w-32")
                level.on_value_change(lambda event: self._choose(least=str(event.value)))
                wording.put(attribute(level, "label"), "events.level")
                say_options(level, {name: f"events.level.{name}" for name in LEVELS}, wording)
                words = ui.input().props("outlined dense clearable for=event-words").classes("grow")
                words.on_value_change(lambda event: self._choose(words=str(event.value or "")))
                wording.put(attribute(words, "label"), "events.words")
            with ui.element("div").classes("acts"):
                for how in Format:
                    self._build_save(how)
            self._count = ui.label().props("id=event-count role=status").classes("note-plain")
            self._list = ui.element("div").classes("events w-full")
            self._list.props("id=events role=log tabindex=0 aria-live=off")
            wording.put(attribute(self._list, "aria-label"), "events.title")

    def _build_save(self, how: Format) -> None:
        with (
            ui.element("button")
            .classes("act plain")
            .props(f"type=button data-save={how.value}") as save
        ):
            label = ui.label()
        self._deck.wording.put(label.set_text, "events.export", how=how.value.upper())
        save.on("click", lambda: self._save(how))

    def _choose(self, *, least: str | None = None, words: str | None = None) -> None:
        self._least = self._least if least is None else least
        self._words = self._words if words is None else words
        self._said_in = None  # all of it anew

    def _selected(self, lines: tuple[Line, ...]) -> list[Line]:
        speaker = self._deck.wording.settings.speaker
        return select(lines, speaker, least=self._least, words=self._words)

    def _save(self, how: Format) -> None:
        lines = self._selected(tuple(self._deck.memory.diary.lines))
        wording = self._deck.wording
        text = export(lines, how, wording.settings.speaker, wording.utc_offset_min)
        ui.download.content(text, f"m100link-events.{how.value}", MIME[how])

    def update(self, view: View) -> None:
        """Show what is."""
        wording = self._deck.wording
        newest = view.events[-1].number if view.events else 0
        if (newest, wording.settings) == (self._last, self._said_in):
            return
        chosen = self._selected(view.events)
        if self._said_in != wording.settings:
            self._list.clear()
            self._placed, new = [], chosen[-_SHOWN:]
        else:
            new = [line for line in chosen if line.number > self._last][-_SHOWN:]
        self._last, self._said_in = newest, wording.settings
        with self._list:
            self._placed += [self._place(line) for line in new]
        for old in self._placed[:-_SHOWN]:
            old.delete()
        self._placed = self._placed[-_SHOWN:]
        shown, known = len(self._placed), len(view.events)
        self._count.set_text(wording(say("events.count", shown=shown, all=known)))
        if new:
            ui.run_javascript('document.querySelector("#events").scrollTop = 1e9')

    def _place(self, line: Line) -> Any:
        wording = self._deck.wording
        time = line.time(wording.utc_offset_min).strftime("%H:%M:%S")
        text = f"{time} {_SHAPES[line.level]} {line.said(wording.settings.speaker)}"
        return ui.label(text).classes(line.level)
