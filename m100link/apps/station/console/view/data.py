"""The Data and Events views: the link in numbers, plots, events."""

from __future__ import annotations

import csv
import io
import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from typing import Any

from m100link.apps.agent.messages import Event
from m100link.apps.station.console.kept import COLUMNS, INTERVAL
from m100link.apps.station.console.view.situation import Inputs, RecordedFlight
from m100link.apps.station.console.view.texts import QuantityKind, Text, Translator, Units, tr
from m100link.log.story import FlightSummary
from m100link.protocol.items import ITEMS
from m100link.wire.frame import Discard

# -- the link in numbers ---------------------------------------------------------------------------

_COUNTERS = (
    *("frames_received", "frames_sent", "bytes_received", "bytes_sent", "discarded_bytes"),
    *("acks", "repeats", "expired", "duplicate_acks", "late_acks", "foreign_acks"),
    "dropped_writes",
)

LINK_ITEMS = (
    *("connection", "firmware", "clients", "aircraft_ms", "page_ms", "agent_lag", "front_lag"),
    *("discards", "mismatches"),
    *_COUNTERS,
)
"""Names of the numbers, in the order of the page; ``link.<name>`` is what each is called."""


@dataclass(frozen=True, slots=True)
class ItemRate:
    name: Text  # of the item
    rate: str  # arrivals per second lately
    jitter: str  # mean deviation of their intervals, ms
    longest_gap: str  # longest interval so far, s


@dataclass(frozen=True, slots=True)
class LinkView:
    # A text by the name of each of :data:`LINK_ITEMS`; a dash for what nobody knows.
    texts: dict[str, Text]
    # Causes of damaged frames, each with how many, the most first.
    causes: tuple[tuple[Text, str], ...]
    rates: tuple[ItemRate, ...]  # how each telemetry item arrives that ever did
    # Each client of the station with what it did not get, the most first.
    dropped: tuple[tuple[str, str], ...]
    reason: str  # why there is no connection; empty when there is


def link_of(inputs: Inputs) -> LinkView:
    state, holder, counted = inputs.vehicle.state, inputs.vehicle.holder, inputs.link
    texts = dict.fromkeys(LINK_ITEMS, tr("link.nothing"))
    texts["connection"] = Text(f"link.{inputs.vehicle.connection}")
    texts["clients"] = (
        tr("link.holder", name=holder.name, seconds=round(state.lease_remaining))
        if holder.number
        else tr("link.free")
    )
    texts["front_lag"] = _ms(inputs.front_lag)
    if inputs.page_trip is not None:
        texts["page_ms"] = _ms(inputs.page_trip)
    if inputs.vehicle.telemetry is not None:
        trip = state.round_trip
        texts |= {
            "firmware": _value(state.firmware),
            "aircraft_ms": tr("link.no_answer") if trip is None else _ms(trip),
            "discards": _value(state.discards),
            "mismatches": _value(state.mismatches),
        }
    causes: dict[str, Any] = {}
    if counted is not None:
        texts["agent_lag"] = _ms(counted.loop_lag)
        texts |= {name: _value(counted.counters.get(name, "–")) for name in _COUNTERS}
        causes = dict(sorted(counted.discards.items(), key=lambda one: -one[1]))
    fault = state.connection_fault
    dropped = sorted(inputs.dropped, key=lambda client: (-client[1], client[0]))
    return LinkView(
        texts,
        tuple((_cause(cause), str(count)) for cause, count in causes.items()),
        _rates(inputs),
        tuple((name, str(count)) for name, count in dropped),
        str(fault.error()) if fault is not None else "",
    )


def _ms(seconds: float) -> Text:
    return tr("unit.ms", ms=round(1000.0 * seconds))


def _value(value: object) -> Text:
    return tr("link.value", value=str(value))


def _cause(name: str) -> Text:
    return Text(f"link.cause.{name}") if name in set(Discard) else _value(name)


def _rates(inputs: Inputs) -> tuple[ItemRate, ...]:
    if inputs.vehicle.telemetry is None:
        return ()
    statistics = [inputs.vehicle.telemetry.statistics(item.record) for item in ITEMS]
    return tuple(
        ItemRate(
            Text(f"plots.item.{one.name}"),
            "–" if one.rate_hz is None else f"{one.rate_hz:.1f}",
            "–" if one.jitter_s is None else f"{1000.0 * one.jitter_s:.1f}",
            f"{one.longest_gap_s:.2f}",
        )
        for one in statistics
        if one.count
    )


# -- plots -----------------------------------------------------------------------------------------

FIRST_CHOICE = (
    *("position.height_m", "velocity.ground_speed_m_s"),
    *("angular_velocity.yaw_rate_deg_s", "line.packages_per_s"),
)
"""The columns of the plots until somebody chooses."""

MOST = 6  # numbers that are drawn at once: more is not read, and costs the browser

WHOLE = 0
"""The range of a chart that shows a whole recorded flight."""

MOST_OF_WHOLE = 2000  # points of each line of a recorded flight

RANGES = {30: "30 s", 60: "1 min", 120: "2 min", 300: "5 min", 600: "10 min"}
"""Seconds that a chart shows, and what that is called."""

_MOST_POINTS = 600  # of a line: more than pixels are not seen

_UNITS = (
    ("_m_s2", "m/s²"),
    ("_deg_s", "°/s"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_per_s", "1/s"),
    ("_percent", "%"),
    ("_deg", "°"),
    ("_rad", "rad"),
    ("_ms", "ms"),
    ("_hz", "Hz"),
    ("_m", "m"),
)

_TOP, _HEIGHT, _GAP = 28, 88, 40  # of each line's own stripe, in pixels
_COLOURS = ("#1e88e5", "#e53935", "#43a047", "#fb8c00", "#8e24aa", "#00897b")


def kind(name: str) -> QuantityKind | None:
    """The kind of quantity in a column, where the operator chooses its unit."""
    sign = _sign(name)
    return next((one for one in QuantityKind if one.value == sign), None)


def _sign(name: str) -> str:
    if name.endswith(".percent"):
        return "%"
    return next((unit for end, unit in _UNITS if name.endswith(end)), "")


def label(name: str) -> Text:
    """A column for people: ``position: height, m``."""
    item, _, field = name.partition(".")
    sign = _sign(name)
    end = next((end for end, _ in _UNITS if field.endswith(end)), "")
    if field == "tick_hz":  # else it would be called as the tick itself
        end = ""
    values: dict[str, object] = {
        "item": Text(f"plots.item.{item}"),
        "field": Text(f"plots.field.{field.removesuffix(end)}"),
    }
    if not sign:
        return Text("plots.label", values)
    return Text("plots.label_unit", values | {"unit": kind(name) or sign})


def step(seconds: float) -> int:
    """Every how many rows of the history is drawn, so that a line has not too many points."""
    return max(1, math.ceil(seconds / INTERVAL / _MOST_POINTS))


def known(names: Iterable[str]) -> list[str]:
    """Those of the names that can be drawn, each once, at most :data:`MOST`."""
    return [name for name in dict.fromkeys(names) if name in COLUMNS][:MOST]


def points(
    rows: Sequence[tuple[float, ...]], names: Sequence[str], units: Units
) -> list[list[float | None]]:
    """Rows as the page takes them.

    ``rows``: seconds since 1970, and a value for each name; not a number where there is none.

    Returns milliseconds since 1970, and values of six digits; None where there is none.
    """
    kinds = [kind(name) for name in names]
    factors = [1.0 if one is None else units.convert(1.0, one) for one in kinds]
    return [
        [
            round(1000.0 * utc),
            *(
                float(f"{factor * value:.6g}") if math.isfinite(value) else None
                for value, factor in zip(values, factors, strict=True)
            ),
        ]
        for utc, *values in rows
    ]


def chart(
    names: Sequence[str],
    speaker: Translator,
    beside: Sequence[tuple[int, Text, str]] = (),
    spans: Sequence[tuple[float, float]] = (),
) -> dict[str, Any]:
    """The options of an ECharts chart: a stripe for each number, one time and one cursor for all.

    Its points come later, by ``static/instruments.js``: only what is new goes to the page.
    ``beside``: dashed lines in a stripe, with their names and colours. ``spans``: between these
    times, POSIX time in ms, each stripe has another ground: there was an alarm.
    """
    stripes = range(len(names))
    ground = {
        "silent": True,
        "itemStyle": {"color": "rgba(214, 69, 69, .22)"},
        "data": [[{"xAxis": begin}, {"xAxis": end}] for begin, end in spans],
    }
    labels = [speaker(label(name)) for name in names]
    return {
        "animation": False,
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "tooltip": {"trigger": "axis", "axisPointer": {"type": "cross"}},
        "dataZoom": [{"type": "inside", "xAxisIndex": list(stripes), "filterMode": "none"}],
        "grid": [
            {"left": 62, "right": 14, "top": _TOP + n * (_HEIGHT + _GAP), "height": _HEIGHT}
            for n in stripes
        ],
        "xAxis": [
            {
                "type": "time",
                "gridIndex": n,
                # A narrow chart has room for few times; they would be written over each other.
                "axisLabel": {"show": n == len(names) - 1, "hideOverlap": True},
            }
            for n in stripes
        ],
        "yAxis": [
            {
                "type": "value",
                "gridIndex": n,
                "scale": True,
                "name": labels[n],
                "nameGap": 12,
                "nameTextStyle": {"align": "left", "padding": [0, 0, 0, -54]},
                "splitNumber": 3,
            }
            for n in stripes
        ],
        "series": [
            *(
                _line(n, labels[n], _COLOURS[n % len(_COLOURS)], width=1.5) | {"markArea": ground}
                for n in stripes
            ),
            *(_line(n, speaker(one), colour, width=1, type="dashed") for n, one, colour in beside),
        ],
    }


def _line(stripe: int, name: str, colour: str, **style: object) -> dict[str, Any]:
    return {
        "type": "line",
        "name": name,
        "xAxisIndex": stripe,
        "yAxisIndex": stripe,
        "showSymbol": False,
        "connectNulls": False,
        "lineStyle": style,
        "color": colour,
        "data": [],
    }


def window(
    flight: RecordedFlight, seconds: float, before: tuple[float, float]
) -> tuple[float, float]:
    """The part of a recorded flight that is drawn, s after the beginning of its log.

    It is the same as before while the place of the replay is in it.
    """
    if seconds == WHOLE:
        return 0.0, flight.story.duration_s
    begin, end = before
    if end - begin == seconds and begin <= flight.at <= end:
        return before
    begin = max(0.0, flight.at - seconds / 10.0)
    return begin, begin + seconds


def height(names: Sequence[str]) -> int:
    """Pixels that a chart of so many stripes needs."""
    return _TOP + max(1, len(names)) * (_HEIGHT + _GAP) + 10


# -- what happened ---------------------------------------------------------------------------------
# The agent's times are on a clock that nobody reads. The wall's time is given to an event when it
# is first seen here and then kept: a clock that is set meanwhile moves no event.

LEVELS = ("info", "warning", "error")  # the levels of events, the least urgent first

_MAX_LINES = 1000

FLIGHT = "flight"
"""The source of the events of a recorded flight."""


@dataclass(frozen=True, slots=True)
class EventLine:
    number: int  # counts the lines of this page from 1
    at: float  # seconds since 1970, UTC
    level: str  # one of :data:`LEVELS`
    source: str  # ``"station"``, or ``"page"`` for what only this page knows
    # The event: English from the station; from this page, to be said in the operator's language.
    text: str | Text

    def said(self, speaker: Translator) -> str:
        return self.text if isinstance(self.text, str) else speaker(self.text)

    def time(self, utc_offset_min: int) -> datetime:
        """When, by a clock so many minutes ahead of UTC."""
        return datetime.fromtimestamp(self.at, timezone(timedelta(minutes=utc_offset_min)))


class Diary:
    """The lines of one page, oldest first; the oldest of very many are forgotten."""

    def __init__(self) -> None:
        self.lines: deque[EventLine] = deque(maxlen=_MAX_LINES)
        self._count = 0
        self._last_event = 0
        self._story: FlightSummary | None = None  # of a replay, whose events are the lines

    def take(self, events: Iterable[Event], now: float, wall: float) -> None:
        """Take over what the agent reported.

        ``now``: time on the agent's clock, s. ``wall``: the same moment in seconds since 1970.
        """
        for event in events:
            if event.number > self._last_event:
                self._last_event = event.number
                self._add(wall - (now - event.at), event.level, "station", event.text)

    def take_story(self, story: FlightSummary) -> None:
        """The events of a recorded flight, at the times of that flight."""
        if self._story is not story:
            self._story = story
            self.lines.clear()
            for at, level, text in recorded_events(story):
                self._add((story.began_utc or 0.0) + at, level, FLIGHT, text)

    def write(self, text: Text, wall: float, level: str = "info") -> None:
        """Add something that only this page knows."""
        self._add(wall, level, "page", text)

    def _add(self, at: float, level: str, source: str, text: str | Text) -> None:
        self._count += 1
        self.lines.append(EventLine(self._count, at, level, source, text))


def recorded_events(story: FlightSummary) -> list[tuple[float, str, str]]:
    """When it was, s after the beginning of the log, a level and a line for each event."""
    found = [
        *((span.begin_s, "info", f"phase: {span.name}") for span in story.phases),
        *((span.begin_s, "info", f"control: {span.name}") for span in story.control),
        *((span.begin_s, "warning", f"alarm: {span.text or span.name}") for span in story.alarms),
        *((span.end_s, "info", f"alarm has passed: {span.name}") for span in story.alarms
          if span.end_s > span.begin_s),
        *((one.at_s, "info", str(one)) for one in story.commands),
    ]  # fmt: skip
    if story.ended:
        found.append((story.duration_s, "error", f"the connection ended: {story.ended}"))
    return sorted(found, key=lambda event: event[0])


def select(
    lines: Iterable[EventLine], speaker: Translator, *, least: str = "info", words: str = ""
) -> list[EventLine]:
    """The lines of that level or above that hold every word, whatever its case."""
    wanted = words.casefold().split()
    lowest = LEVELS.index(least)
    return [
        line
        for line in lines
        if LEVELS.index(line.level) >= lowest
        and all(word in line.said(speaker).casefold() for word in wanted)
    ]


def export(lines: Iterable[EventLine], speaker: Translator, utc_offset_min: int = 0) -> str:
    """The lines as CSV; times are those of the operator's clock, with their zone."""
    written = io.StringIO()
    table = csv.writer(written)
    table.writerow(("time", "level", "source", "text"))
    for line in lines:
        time = line.time(utc_offset_min).isoformat(timespec="milliseconds")
        table.writerow((time, line.level, line.source, _harmless(line.said(speaker))))
    return written.getvalue()


def _harmless(text: str) -> str:
    """A cell that no spreadsheet takes for a formula: names of strangers stand in events."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
