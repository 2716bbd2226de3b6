"""The Data and Events views: telemetry, the link, plots of any number, and what happened."""

from __future__ import annotations

import json
import math
from functools import partial
from itertools import product
from typing import Any

from nicegui import events, ui

from m100link.apps.station.console.components.component import PageContext, ReadingRow, attribute
from m100link.apps.station.console.kept import (
    COLUMNS,
    COMMANDED,
    INTERVAL,
    MOST_ROWS,
    Recorded,
    as_csv,
)
from m100link.apps.station.console.view.data import (
    FIRST_CHOICE,
    FLIGHT,
    LEVELS,
    LINK_ITEMS,
    MOST,
    MOST_OF_WHOLE,
    RANGES,
    WHOLE,
    EventLine,
    chart,
    export,
    height,
    known,
    label,
    points,
    select,
    step,
    window,
)
from m100link.apps.station.console.view.fly import FIELDS
from m100link.apps.station.console.view.situation import RecordedFlight
from m100link.apps.station.console.view.texts import Text, tr
from m100link.apps.station.console.view.view_model import ViewModel

# -- every value of the telemetry ------------------------------------------------------------------

_CHANNELS = ("roll", "pitch", "yaw", "throttle")


class TelemetryPart:
    def __init__(self, page: PageContext) -> None:
        self._wording = wording = page.wording
        with wording.card("instruments.title"):
            self._rows = {one.name: ReadingRow(one.name, wording) for one in FIELDS}
        with wording.card("instruments.attitude"):
            self._age = ui.label().classes("note").props("id=attitude-age")
            self._frame = ui.element("div").classes("attitude")
            with self._frame:
                self._build_scene()
        with wording.card("instruments.remote_control"):
            for name in _CHANNELS:
                with ui.row().classes("w-full items-center gap-2 no-wrap"):
                    wording.label(f"instruments.rc.{name}").classes("w-20")
                    ui.element("div").classes("grow").props(f"data-rc={name}")

    def _build_scene(self) -> None:
        with ui.scene(
            width=320, height=180, grid=(10, 10), background_color="#dfe6ee", fps=10
        ) as scene:
            with scene.group() as self._model:
                for turn in (math.pi / 4, -math.pi / 4):
                    scene.box(1.6, 0.16, 0.1).material("#444").rotate(0, 0, turn)
                scene.box(0.5, 0.35, 0.25).material("#666")
                scene.box(0.35, 0.1, 0.1).material("#c62828").move(0.5, 0, 0.05)
                for x, y in product((0.57, -0.57), repeat=2):
                    scene.cylinder(0.38, 0.38, 0.04).material(
                        "#c62828" if x > 0 else "#1565c0", opacity=0.6
                    ).rotate(math.pi / 2, 0, 0).move(x, y, 0.12)
            # Seen from behind a north-facing aircraft, a little from above: east to the right.
            scene.move_camera(0, -2.6, 1.4, 0, 0, 0, duration=0)

    def update(self, view: ViewModel) -> None:
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])
        attitude = view.instruments.attitude
        old = self._wording(tr("instruments.no_attitude"))
        self._age.set_text("" if attitude is not None else old)
        if attitude is None:
            self._frame.classes(add="stale")
            return
        self._frame.classes(remove="stale")
        roll, pitch, yaw = attitude
        self._model.rotate(math.radians(roll), -math.radians(pitch), math.radians(90.0 - yaw))


# -- the link in numbers ---------------------------------------------------------------------------

_RATE_COLUMNS = ("item", "rate", "jitter", "longest_gap")


class LinkPart:
    def __init__(self, page: PageContext) -> None:
        self._wording = wording = page.wording
        self._tables: dict[str, tuple[Any, tuple[Any, ...]]] = {}
        with wording.card("link.title"):
            self._numbers = {name: wording.field(name, f"link.{name}")[1] for name in LINK_ITEMS}
            wording.field("age", "link.age")  # the page itself fills in what it measures
            self._reason = ui.label().classes("problem").props("id=connection-error")
        for name in ("causes", "rates", "dropped"):
            with wording.card(f"link.{name}"):
                box = ui.element("div").props(f"id=link-{name}").classes("w-full")
                self._tables[name] = box, ()

    def update(self, view: ViewModel) -> None:
        speak = self._wording
        for name, text in view.link.texts.items():
            self._numbers[name].set_text(speak(text))
        self._reason.set_text(view.link.reason)
        causes = view.link.causes or ((tr("link.none"), ""),)
        self._fill("causes", ("", ""), tuple((speak(cause), count) for cause, count in causes))
        heads = tuple(speak(Text(f"link.{name}")) for name in _RATE_COLUMNS)
        rows = tuple(
            (speak(one.name), one.rate, one.jitter, one.longest_gap) for one in view.link.rates
        )
        self._fill("rates", heads, rows)
        heads = tuple(speak(Text(f"link.{name}")) for name in ("client", "not_got"))
        self._fill("dropped", heads, view.link.dropped)

    def _fill(self, name: str, heads: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> None:
        """A table of texts: its cells stay as long as it has as many."""
        box, cells = self._tables[name]
        texts = [text for row in ((heads, *rows) if any(heads) else rows) for text in row]
        if len(cells) != len(texts):
            box.clear()
            with (
                box,
                ui.element("div")
                .classes("table")
                .style(f"grid-template-columns: 1fr{' auto' * (len(heads) - 1)}"),
            ):
                cells = tuple(ui.label() for _ in texts)
            self._tables[name] = box, cells
        for cell, text in zip(cells, texts, strict=True):
            cell.set_text(text)


# -- plots of any numbers of the telemetry and of the link -----------------------------------------


class PlotsPart:
    """A chart with a stripe for each number that was chosen; only new points go to the page."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._names = list(FIRST_CHOICE)
        self._seconds = 60
        # How many rows there were when it was paused.
        self._until: int | None = None
        # Rows of the history that the page has.
        self._sent = 0
        self._is_whole_wanted = True
        self._version = 0  # of what is drawn: what comes late of another one is passed over
        self._flight: Recorded | None = None  # of a replay
        self._drawn: object = None  # of it
        self._window = 0.0, 0.0  # which part of it, s after the beginning of its log
        wording = page.wording
        with wording.card("plots.title").props("id=plots-card"):
            with ui.row().classes("w-full items-center gap-2"):
                self._chosen = ui.select(
                    list(COLUMNS),
                    value=self._names,
                    multiple=True,
                    with_input=True,
                    on_change=self._choose,
                )
                self._chosen.props("id=plot-names dense use-chips").classes("grow")
                wording.follow(
                    lambda: self._chosen.set_options({one: wording(label(one)) for one in COLUMNS})
                )
                wording.put(attribute(self._chosen, "label"), "plots.numbers", most=MOST)
                seconds = ui.select(RANGES, value=self._seconds, on_change=self._set_range)
                self._range = seconds
                wording.put(attribute(seconds.props("id=plot-range dense"), "label"), "plots.range")
                with ui.element("button").classes("act plain") as self._pause:
                    self._pause_text = ui.label()
                self._pause.props("type=button id=plot-pause").on("click", self._toggle, args=[])
                csv = wording.button("plots.csv", "id=plot-csv", self._download)
                wording.put(attribute(csv, "title"), "plots.csv.note")
            self._chart: Any = ui.echart({}).classes("w-full").props("id=plots role=img")
            wording.put(attribute(self._chart), "plots.chart")
            page.load("instruments.js")
            ui.on("plot_pointed", self._pointed)
            wording.follow(self._say_again)

    def _say_again(self) -> None:
        """In another language, or other units: then every point is another one, too."""
        self._name_pause()
        self._draw_anew()

    def _draw_anew(self) -> None:
        self._drawn = None
        self._set_chart(chart(self._names, self._page.wording.settings.speaker))

    def _set_chart(self, options: dict[str, Any]) -> None:
        self._chart.options.clear()
        self._chart.options.update(options)
        self._chart.style(f"height: {height(self._names)}px")
        self._chart.update()
        self._is_whole_wanted = True

    def _choose(self, event: events.ValueChangeEventArguments[Any]) -> None:
        names = known(event.value or ())
        if names != list(event.value or ()):
            self._chosen.set_value(names)  # comes back here
            return
        self._names = names
        self._draw_anew()

    def _set_range(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._seconds = int(event.value)
        self._is_whole_wanted, self._drawn = True, None

    def _toggle(self) -> None:
        is_paused = self._until is None
        self._until = self._page.history.count if is_paused else None
        self._name_pause()
        self._is_whole_wanted = True

    def _name_pause(self) -> None:
        key = "plots.pause" if self._until is None else "plots.go_on"
        self._pause_text.set_text(self._page.wording(Text(key)))

    def _download(self) -> None:
        if self._flight is None:
            text = self._page.history.csv(self._names, last_s=self._seconds, until=self._until)
        else:
            began = self._flight.story.began_utc or 0.0
            rows = self._flight.between(self._names, *self._window, MOST_ROWS)
            text = as_csv(self._names, [(began + at, *values) for at, *values in rows])
        ui.download.content(text, "m100link.csv", "text/csv")

    def update(self, view: ViewModel) -> None:
        """Send the points that the page does not have."""
        history = self._page.history
        if view.replay is not None:
            if view.flight is not None and history.recorded is not None:
                self._update_recorded(view.flight, history.recorded)
            return
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
            drawn = points(rows, self._names, self._page.wording.settings.units)
            given = json.dumps([self._version, drawn, 1000 * self._seconds], separators=(",", ":"))
            ui.run_javascript(
                f'import("/console/instruments.js").then((m)=>m.addRows({self._chart.id},...{given}))'
            )

    # -- a recorded flight, whole or a part of it, with a cursor where the replay is -------------

    def _pointed(self, event: events.GenericEventArguments) -> None:
        """Somebody pointed at a time of the chart: the replay goes on from there."""
        if self._flight is not None and isinstance(event.args, int | float):
            self._page.seek(event.args / 1000.0)

    def _update_recorded(self, flight: RecordedFlight, recorded: Recorded) -> None:
        if self._flight is None:
            self._pause.set_visibility(False)
            whole = {WHOLE: self._page.wording(tr("plots.whole"))}
            self._range.set_options(whole | RANGES, value=WHOLE)
            self._seconds = WHOLE
        self._flight = recorded
        self._window = window(flight, self._seconds, self._window)
        other = self._page.history_of(self._page.memory.compared).recorded if flight.other else None
        wanted = recorded, other, tuple(self._names), self._window
        if wanted != self._drawn:
            self._drawn = wanted
            self._send_recorded(recorded, other)
        cursor = round(1000.0 * ((recorded.story.began_utc or 0.0) + flight.at))
        given = f"{self._chart.id}, {len(self._names)}, {cursor}"
        ui.run_javascript(f'import("/console/instruments.js").then((m)=>m.setCursor({given}))')

    def _send_recorded(self, recorded: Recorded, other: Recorded | None) -> None:
        names, speaker = self._names, self._page.wording.settings.speaker
        began, story = recorded.story.began_utc or 0.0, recorded.story
        twins = [(n, COMMANDED[name]) for n, name in enumerate(names) if name in COMMANDED]
        beside = [(n, tr("plots.commanded"), "#888") for n, _ in twins]
        drawn = [*names, *(name for _, name in twins)]
        rows = recorded.between(drawn, *self._window, MOST_OF_WHOLE)
        if other is not None:
            beside += [(n, tr("plots.other"), "#00897b") for n in range(len(names))]
            shift = (other.story.took_off_s or 0.0) - (story.took_off_s or 0.0)
            rows = [(*row, *other.near(names, row[0] + shift)) for row in rows]
            drawn += names
        spans = [
            (1000.0 * (began + one.begin_s), 1000.0 * (began + one.end_s)) for one in story.alarms
        ]
        self._set_chart(chart(names, speaker, beside, spans))
        self._version += 1
        utc = [(began + at, *values) for at, *values in rows]
        begin, end = self._window
        points_of = points(utc, drawn, self._page.wording.settings.units)
        given = json.dumps([self._version, points_of, 1000 * (end - begin)], separators=(",", ":"))
        ui.run_javascript(
            f'import("/console/instruments.js").then((m)=>m.addRows({self._chart.id},...{given}))'
        )


# -- what happened ---------------------------------------------------------------------------------

_SHOWN = 200
_SHAPES = {"info": "·", "warning": "▲", "error": "◆"}


class EventsPart:
    """The newest lines that were asked for, oldest first."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._least = LEVELS[0]
        self._words = ""
        # The last line that was looked at, the settings it was said in, and what is on the page.
        self._last = 0
        self._said_in: object = None
        self._placed: list[Any] = []
        wording = page.wording
        with wording.card("events.title"):
            with ui.row().classes("items-end gap-2 w-full"):
                level = ui.select({name: name for name in LEVELS}, value=self._least)
                level.props("outlined dense for=event-level").classes("min-w-32")
                level.on_value_change(lambda event: self._choose(least=str(event.value)))
                wording.put(attribute(level, "label"), "events.level")
                wording.options(level, {name: f"events.level.{name}" for name in LEVELS})
                words = ui.input().props("outlined dense clearable for=event-words").classes("grow")
                words.on_value_change(lambda event: self._choose(words=str(event.value or "")))
                wording.put(attribute(words, "label"), "events.words")
            with ui.element("div").classes("acts"):
                wording.button("events.export", "data-save=csv", self._save, how="CSV")
            self._count = ui.label().props("id=event-count role=status").classes("note-plain")
            self._list = ui.element("div").classes("events w-full")
            self._list.props("id=events role=log tabindex=0 aria-live=off")
            wording.put(attribute(self._list, "aria-label"), "events.title")

    def _choose(self, *, least: str | None = None, words: str | None = None) -> None:
        self._least = self._least if least is None else least
        self._words = self._words if words is None else words
        self._said_in = None  # all of it anew

    def _selected(self, lines: tuple[EventLine, ...]) -> list[EventLine]:
        speaker = self._page.wording.settings.speaker
        return select(lines, speaker, least=self._least, words=self._words)

    def _save(self) -> None:
        lines = self._selected(tuple(self._page.memory.diary.lines))
        wording = self._page.wording
        text = export(lines, wording.settings.speaker, wording.utc_offset_min)
        ui.download.content(text, "m100link-events.csv", "text/csv")

    def update(self, view: ViewModel) -> None:
        wording = self._page.wording
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
        self._count.set_text(wording(tr("events.count", shown=shown, all=known)))
        if new:
            ui.run_javascript('document.querySelector("#events").scrollTop = 1e9')

    def _place(self, line: EventLine) -> Any:
        wording = self._page.wording
        time = line.time(wording.utc_offset_min).strftime("%H:%M:%S")
        text = f"{time} {_SHAPES[line.level]} {line.said(wording.settings.speaker)}"
        placed = ui.label(text).classes(line.level)
        if line.source == FLIGHT:  # the replay goes on from there
            placed.classes("jump").on("click", partial(self._page.seek, line.at), args=[])
        return placed
