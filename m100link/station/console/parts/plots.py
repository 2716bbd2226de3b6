"""Plots of any numbers of the telemetry and of the link."""

from __future__ import annotations

import json
from typing import Any

from nicegui import events, ui

from m100link.station.console.history import COLUMNS, INTERVAL
from m100link.station.console.parts.fields import card
from m100link.station.console.parts.part import Deck
from m100link.station.console.view.plots import (
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
from m100link.station.console.view.view import View

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
        with card("Plots").props("id=plots-card"):
            with ui.row().classes("w-full items-center gap-2"):
                self._chosen = ui.select(
                    {name: label(name) for name in COLUMNS},
                    value=self._names,
                    multiple=True,
                    with_input=True,
                    label=f"numbers, at most {MOST}",
                    on_change=self._choose,
                )
                self._chosen.props("id=plot-names dense use-chips").classes("grow")
                ui.select(
                    RANGES, value=self._seconds, label="shows", on_change=self._set_range
                ).props("id=plot-range dense")
                self._pause = ui.button("Pause", on_click=self._toggle).props(
                    "id=plot-pause outline aria-pressed=false"
                )
                ui.button("CSV", on_click=self._download).props(
                    'id=plot-csv outline title="download what is drawn"'
                )
            self._chart: Any = ui.echart(chart(self._names)).classes("w-full")
            self._chart.props('id=plots role=img aria-label="plots of the chosen numbers"')
            self._resize()

    def _resize(self) -> None:
        self._chart.style(f"height: {height(self._names)}px")

    # -- what is chosen --------------------------------------------------------------------------

    def _choose(self, event: events.ValueChangeEventArguments[Any]) -> None:
        names = known(event.value or ())
        if names != list(event.value or ()):
            self._chosen.set_value(names)  # comes back here
            return
        self._names = names
        self._chart.options.clear()
        self._chart.options.update(chart(names))
        self._resize()
        self._chart.update()
        self._is_whole_wanted = True

    def _set_range(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._seconds = int(event.value)
        self._is_whole_wanted = True

    def _toggle(self) -> None:
        is_paused = self._until is None
        self._until = self._deck.history.count if is_paused else None
        self._pause.set_text("Go on" if is_paused else "Pause")
        self._pause.props(f"aria-pressed={str(is_paused).lower()}")
        self._is_whole_wanted = True

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
            given = json.dumps(
                [self._version, points(rows), 1000 * self._seconds], separators=(",", ":")
            )
            ui.run_javascript(
                f'import("/console/plots.js").then((m)=>m.add({self._chart.id},...{given}))'
            )
