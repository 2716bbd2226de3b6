"""Plots of any numbers of the telemetry and of the link."""

from __future__ import annotations

import json
from typing import Any

from nicegui import events, ui

from m100link.apps.station.console.history import COLUMNS, INTERVAL
from m100link.apps.station.console.parts.fields import card
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.plots import (
    FIRST_CHOICE,
    MOST,
    RANGES,
    chart,
    height,
    known,
    label,
    points,
    step,
)
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text

__all__ = ["PlotsPart"]


class PlotsPart:
    """A chart with a stripe for each number that was chosen; only new points go to the page.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._names = list(FIRST_CHOICE)
        self._seconds = 60
        # How many rows there were when it was paused.
        self._until: int | None = None
        # Rows of the history that the page has.
        self._sent = 0
        self._is_whole_wanted = True
        self._version = 0  # of what is drawn: what comes late of another one is passed over

    def build(self) -> None:
        """Lay it out."""
        wording = self._deck.wording
        with card("plots.title", wording).props("id=plots-card"):
            with ui.row().classes("w-full items-center gap-2"):
                self._chosen = ui.select(
                    list(COLUMNS),
                    value=self._names,
                    multiple=True,
                    with_input=True,
                    on_change=self._choose,
                )
                self._chosen.props("id=plot-names dense use-chips").classes("grow")
                wording.follow(self._name_options)
                wording.put(attribute(self._chosen, "label"), "plots.numbers", most=MOST)
                seconds = ui.select(RANGES, value=self._seconds, on_change=self._set_range)
                wording.put(attribute(seconds.props("id=plot-range dense"), "label"), "plots.range")
                with ui.element("button").classes("act plain") as self._pause:
                    self._pause_text = ui.label()
                self._pause.props("type=button id=plot-pause").on("click", self._toggle, args=[])
                with ui.element("button").classes("act plain") as csv:
                    wording.put(ui.label().set_text, "plots.csv")
                csv.props("type=button id=plot-csv").on("click", self._download, args=[])
                wording.put(attribute(csv, "title"), "plots.csv.note")
            self._chart: Any = ui.echart({}).classes("w-full").props("id=plots role=img")
            wording.put(attribute(self._chart), "plots.chart")
            wording.follow(self._say_again)

    def _name_options(self) -> None:
        said = self._deck.wording
        self._chosen.set_options({name: said(label(name)) for name in COLUMNS})

    def _say_again(self) -> None:
        """In another language, or other units: then every point is another one, too."""
        self._name_pause()
        self._draw_anew()

    def _draw_anew(self) -> None:
        self._chart.options.clear()
        self._chart.options.update(chart(self._names, self._deck.wording.settings.speaker))
        self._resize()
        self._chart.update()
        self._is_whole_wanted = True

    def _resize(self) -> None:
        self._chart.style(f"height: {height(self._names)}px")

    # -- what is chosen --------------------------------------------------------------------------

    def _choose(self, event: events.ValueChangeEventArguments[Any]) -> None:
        names = known(event.value or ())
        if names != list(event.value or ()):
            self._chosen.set_value(names)  # comes back here
            return
        self._names = names
        self._draw_anew()

    def _set_range(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._seconds = int(event.value)
        self._is_whole_wanted = True

    def _toggle(self) -> None:
        is_paused = self._until is None
        self._until = self._deck.history.count if is_paused else None
        self._name_pause()
        self._is_whole_wanted = True

    def _name_pause(self) -> None:
        key = "plots.pause" if self._until is None else "plots.go_on"
        self._pause_text.set_text(self._deck.wording(Text(key)))

    def _download(self) -> None:
        text = self._deck.history.csv(self._names, last_s=self._seconds, until=self._until)
        ui.download.content(text, "m100link.csv", "text/csv")

    # -- what is new -----------------------------------------------------------------------------

    def update(self, view: View) -> None:
        """Send the points that the page does not have."""
        history = self._deck.history
        if (self._until is not None and not self._is_whole_wanted) or not self._names:
            return
        is_whole = self._is_whole_wanted or history.count - self._sent > self._seconds / INTERVAL
        since = 0 if is_whole else self._sent
        rows = history.rows(
            self._names,
            since=since,
            until=self._until,
            last_s=self._seconds,
            step=step(self._seconds),
        )
        self._sent, self._is_whole_wanted = history.count, False
        self._version += is_whole
        if rows:
            drawn = points(rows, self._names, self._deck.wording.settings.units)
            given = json.dumps([self._version, drawn, 1000 * self._seconds], separators=(",", ":"))
            ui.run_javascript(
                f'import("/console/plots.js").then((m)=>m.add({self._chart.id},...{given}))'
            )
