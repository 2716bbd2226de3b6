"""A flight to look at: one picture, by matplotlib, or one HTML page that needs nothing else."""

from __future__ import annotations

import io
import json
import math
import time
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from difflib import SequenceMatcher
from html import escape
from importlib.resources import files
from statistics import fmean
from typing import Any, NamedTuple

from m100link.errors.usage import of_extra
from m100link.geodesy import MapView, Place, svg_dot, svg_line, svg_text
from m100link.log.channels import Curve
from m100link.log.report import happened
from m100link.log.story import FlightSummary, Span

# -- what is drawn of a flight, whether as a picture or as a page: panels, their curves, colour ----


PHASE_COLOURS = {
    "ground": "#9aa0a6",
    "take-off": "#e8a33d",
    "flight": "#3b7dd8",
    "landing": "#2a9d8f",
    "unknown": "#b07cc6",
    "pilot": "#9aa0a6",
    "app": "#b07cc6",
    "program": "#3b7dd8",
}
"""Colour of a phase, and of an owner of control."""


class PlotLine(NamedTuple):
    """A curve with its name and colour."""

    name: str
    colour: str
    curve: Curve


class Panel(NamedTuple):
    """Curves over one scale."""

    title: str  # what they are, with the unit
    lines: tuple[PlotLine, ...]
    least: tuple[float, float]  # values that the scale has at least

    def span(self) -> tuple[float, float]:
        """The scale: from the least to the largest value."""
        low, high = self.least
        for line in self.lines:
            for _, value in line.curve.points():
                if not math.isnan(value):
                    low, high = min(low, value), max(high, value)
        room = 0.04 * (high - low)
        return (low if low == self.least[0] else low - room), high + room


def panels(story: FlightSummary) -> list[Panel]:
    """The panels that are drawn over time."""
    curves = story.curves
    sent = {
        "height": PlotLine("sent height", "#d64545", curves.sent_height_m),
        "speed": PlotLine("sent", "#d64545", curves.sent_speed_m_s),
        "climb": PlotLine("sent climb", "#8a5a00", curves.sent_climb_m_s),
    }
    asked = {name: (line,) if len(line.curve) else () for name, line in sent.items()}
    return [
        Panel(
            "Height, m",
            (PlotLine("height", "#3b7dd8", curves.height_m), *asked["height"]),
            (0.0, 2.0),
        ),
        Panel(
            "Speed, m/s",
            (
                PlotLine("over ground", "#3b7dd8", curves.ground_speed_m_s),
                *asked["speed"],
                PlotLine("climb", "#e8a33d", curves.climb_m_s),
                *asked["climb"],
            ),
            (0.0, 1.0),
        ),
        Panel("Battery, %", (PlotLine("charge", "#2a9d8f", curves.battery_percent),), (0.0, 100.0)),
        Panel(
            "Telemetry, packages/s",
            (PlotLine("arrived", "#3b7dd8", curves.packages_per_s),),
            (0, 10),
        ),
        Panel(
            "Line",
            (
                PlotLine("round trip, ms", "#e8a33d", curves.round_trip_ms),
                PlotLine("bytes lost per s", "#d64545", curves.discarded_bytes_per_s),
            ),
            (0.0, 5.0),
        ),
    ]


def facts(story: FlightSummary) -> list[tuple[str, str]]:
    """The flight in numbers: what, and how much; what was never heard is left out."""
    most = story.maxima
    battery = None
    if most.battery_first_percent is not None:
        battery = f"{most.battery_first_percent} → {most.battery_last_percent} %"
    vertical = None
    if most.climb_m_s is not None and most.descent_m_s is not None:
        vertical = f"{max(0.0, most.climb_m_s):.1f} / {max(0.0, most.descent_m_s):.1f} m/s"
    found = [
        ("Recorded", clock(story.duration_s)),
        ("In the air", clock(most.airborne_s) if story.phases else None),
        ("Highest", _unit(most.height_m, "m")),
        ("Farthest", _unit(most.distance_m, "m")),
        ("Way over ground", _unit(most.track_m, "m")),
        ("Fastest", _unit(most.ground_speed_m_s, "m/s")),
        ("Climb / descent", vertical),
        ("Largest tilt", _unit(most.tilt_deg, "°")),
        ("Battery", battery),
        ("Longest silence", _unit(most.silence_s, "s", 2)),
        ("Repeats", str(story.repeats)),
        ("Firmware", story.firmware or "unknown"),
    ]
    return [(name, value) for name, value in found if value is not None]


def line_quality(story: FlightSummary) -> str:
    """The quality of the line in words; a counter that the log lacks counts as 0."""
    line = story.line
    causes = line.get("discards", {})
    damaged, whole = sum(causes.values()), line.get("frames_received", 0)
    share = 100.0 * damaged / max(1, damaged + whole)
    rates = [value for _, value in story.curves.packages_per_s.points() if not math.isnan(value)]
    named = ", ".join(f"{name} {count}" for name, count in causes.items() if count)
    lost = (
        f"{100.0 * story.lost_share:.1f} % of frames lost; " if story.lost_share is not None else ""
    )
    return (
        f"{lost}{damaged} frames damaged or cut off ({share:.1f} %), "
        f"{line.get('discarded_bytes', 0):,} bytes discarded" + (f" ({named})" if named else "")
        + f"; {line.get('repeats', 0)} repeats, {line.get('expired', 0)} requests without an "
        f"answer, {line.get('late_acks', 0)} answers late, "
        f"{line.get('dropped_writes', 0)} frames not written; "
        f"telemetry {min(rates, default=0):.0f} to {max(rates, default=0):.0f} packages/s"
    )  # fmt: skip


def _unit(value: float | None, unit: str, digits: int = 1) -> str | None:
    return None if value is None else f"{value:.{digits}f} {unit}"


def clock(seconds: float) -> str:
    """A time as people say it: ``38.8 s``, ``2:05``, ``1:02:05``."""
    if round(seconds, 1) < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers between two others: at most so many steps of 1, 2 or 5 and zeros."""
    width = (high - low) / most
    if not 0 < width < math.inf:
        return [low]
    power = 10.0 ** math.floor(math.log10(width))
    step = next(one * power for one in (1, 2, 5, 10) if one * power >= width)
    first = math.ceil(low / step - 1e-9)
    return [n * step for n in range(first, math.floor(high / step + 1e-9) + 1)]


# -- what differs between two flights --------------------------------------------------------------


_STEP_S = 0.5


class Apart(NamedTuple):
    """How far two flights were apart."""

    after_s: float  #: Seconds after the take-off of each.
    metres: float  #: How far apart over ground, each measured from its own take-off point.


@dataclass(frozen=True)
class Difference:
    """One value of both flights."""

    name: str  #: The value's name, with its unit at the end.
    first: float | None  #: Of each; None where it was never heard.
    second: float | None  #: Of each; None where it was never heard.

    @property
    def by(self) -> float | None:
        """The second less the first; None where one of them is not known."""
        if self.first is None or self.second is None:
            return None
        return self.second - self.first


@dataclass
class Comparison:
    """Two flights beside each other."""

    values: list[Difference] = field(default_factory=list)  #: Durations, maxima and the line.
    #: Twice a second; empty when one of them did not take off.
    apart: list[Apart] = field(default_factory=list)
    #: Lines of the commands, beginning with ``-`` only in the first, with ``+`` only in the second.
    commands: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)  #: The same of alarms.

    @property
    def mean_apart_m(self) -> float | None:
        """How far apart they were in the mean."""
        return fmean(one.metres for one in self.apart) if self.apart else None

    @property
    def most_apart(self) -> Apart | None:
        """When they were farthest apart, and how far."""
        return max(self.apart, key=lambda one: one.metres) if self.apart else None


def compare(first: FlightSummary, second: FlightSummary) -> Comparison:
    """Lay two flights beside each other, aligned at their take-offs."""
    values = [Difference("duration_s", first.duration_s, second.duration_s)]
    for name in ("ground", "take-off", "flight", "landing"):
        values.append(Difference(f"{name}_s", _lasted(first, name), _lasted(second, name)))
    ours, theirs = asdict(first.maxima), asdict(second.maxima)
    values += [Difference(name, ours[name], theirs[name]) for name in ours]
    values += [
        Difference("packages", first.packages, second.packages),
        Difference("packages_per_s", _rate(first), _rate(second)),
        Difference("discarded_bytes", first.discarded_bytes, second.discarded_bytes),
        Difference("repeats", first.repeats, second.repeats),
        Difference("round_trip_ms", _mean_trip(first), _mean_trip(second)),
    ]
    return Comparison(
        values,
        list(_apart(first, second)),
        _changes([str(one) for one in first.commands], [str(one) for one in second.commands]),
        _changes([one.name for one in first.alarms], [one.name for one in second.alarms]),
    )


def _lasted(story: FlightSummary, phase: str) -> float:
    return sum(span.end_s - span.begin_s for span in story.phases if span.name == phase)


def _rate(story: FlightSummary) -> float | None:
    return story.packages / story.duration_s if story.duration_s else None


def _mean_trip(story: FlightSummary) -> float | None:
    found = [value for _, value in story.curves.round_trip_ms.points() if not math.isnan(value)]
    return fmean(found) if found else None


def _apart(first: FlightSummary, second: FlightSummary) -> Iterator[Apart]:
    one, other = first.took_off_s, second.took_off_s
    ours, theirs = first.track.places(), second.track.places()
    if one is None or other is None or not ours or not theirs:
        return
    ends = [spans[-1].end_s if spans[-1].name != "ground" else spans[-1].begin_s
            for spans in (first.phases, second.phases)]  # fmt: skip
    until = min(ends[0] - one, ends[1] - other)
    for step in range(int(until / _STEP_S) + 1):
        after = step * _STEP_S
        a, b = _place_at(ours, one + after), _place_at(theirs, other + after)
        yield Apart(after, math.hypot(a[1] - b[1], a[2] - b[2]))


def _place_at(places: list[Place], at_s: float) -> Place:
    return places[max(0, bisect_right(places, at_s, key=lambda place: place.at_s) - 1)]


def _changes(first: list[str], second: list[str]) -> list[str]:
    lines: list[str] = []
    for kind, a, b, c, d in SequenceMatcher(a=first, b=second, autojunk=False).get_opcodes():
        if kind != "equal":
            lines += [f"- {line}" for line in first[a:b]]
            lines += [f"+ {line}" for line in second[c:d]]
    return lines


# -- picture ---------------------------------------------------------------------------------------

_ALARM = "#d64545"
_MOST_FACTS = 12


def picture(story: FlightSummary, *, width_px: int = 1400) -> bytes:
    """Draw it as PNG.

    Args:
        story: The flight.
        width_px: Width of the picture.

    Raises:
        UsageError: matplotlib is not installed.
    """
    instead = ", or a page: -o flight.html"
    figures = of_extra("matplotlib.figure", "a picture", "analysis", instead)
    patches = of_extra("matplotlib.patches", "a picture", "analysis", instead)
    drawn = panels(story)
    figure = figures.Figure(figsize=(14, 9), layout="constrained", dpi=width_px / 14)
    grid = figure.add_gridspec(len(drawn) + 1, 2, width_ratios=(2, 3))
    _draw_track(story, figure.add_subplot(grid[:4, 0]))
    _write_facts(story, figure.add_subplot(grid[4:, 0]))
    first = figure.add_subplot(grid[0, 1])
    _draw_strip(story, first)
    duration = max(story.duration_s, 1e-3)
    for number, panel in enumerate(drawn):
        axes = figure.add_subplot(grid[number + 1, 1], sharex=first)
        for span in story.phases:
            axes.axvspan(span.begin_s, span.end_s, color=_colour(span.name), alpha=0.1, lw=0)
        for span in story.alarms:
            axes.axvspan(span.begin_s, max(span.end_s, span.begin_s + duration / 300), color=_ALARM,
                         alpha=0.15, lw=0)  # fmt: skip
        for one in story.commands:
            axes.axvline(one.at_s, color="#667", lw=0.6, ls=":")
        for line in panel.lines:
            points = list(line.curve.points())
            mark = "." if len(points) == 1 else ""
            axes.plot([p[0] for p in points], [p[1] for p in points], color=line.colour,
                      label=line.name, lw=1.3, marker=mark)  # fmt: skip
        axes.set_ylim(*panel.span())
        axes.set_ylabel(panel.title, fontsize=8)
        axes.grid(alpha=0.3)
        if len(panel.lines) > 1:
            axes.legend(fontsize=7, loc="upper right")
        axes.tick_params(labelsize=8, labelbottom=panel is drawn[-1])
    first.set_xlim(0.0, duration)
    axes.xaxis.set_major_formatter(lambda seconds, _: clock(seconds))
    names = dict.fromkeys(span.name for span in (*story.phases, *story.control))
    first.legend(
        handles=[patches.Patch(color=_colour(name), label=name) for name in names],
        fontsize=7, ncols=max(1, len(names)), loc="lower right", bbox_to_anchor=(1.0, 1.0),
    )  # fmt: skip
    began = _began(story, "nothing recorded")
    figure.suptitle(f"{story.name}   {began}", fontsize=11, parse_math=False)
    drawn_into = io.BytesIO()
    figure.savefig(drawn_into, format="png")
    return drawn_into.getvalue()


def _began(story: FlightSummary, nothing: str) -> str:
    if story.began_utc is None:
        return nothing
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(story.began_utc))


def _colour(name: str) -> str:
    return PHASE_COLOURS.get(name, PHASE_COLOURS["unknown"])


def _draw_strip(story: FlightSummary, axes: Any) -> None:
    rows = (
        ("phase", story.phases),
        ("control", story.control),
        ("setpoints", story.streams),
        ("alarms", story.alarms),
    )
    least = max(story.duration_s, 1e-3) / 300
    for number, (name, spans) in enumerate(rows):
        for span in spans:
            colour = _ALARM if name == "alarms" else _colour(span.name)
            width = max(span.end_s - span.begin_s, least)
            axes.barh(number, width, left=span.begin_s, color=colour, height=0.8)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(labelbottom=False)


def _draw_track(story: FlightSummary, axes: Any) -> None:
    axes.set_title("Track over the take-off point, m", fontsize=9)
    axes.set_xlabel("east", fontsize=8)
    axes.set_ylabel("north", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    places = [place[:3] for place in story.track.places()]
    if not places:
        axes.text(0.5, 0.5, "no position that can be trusted", ha="center",
                  transform=axes.transAxes, color="#667")  # fmt: skip
        return
    for span in story.phases or ():
        inside = [place for place in places if span.begin_s <= place[0] <= span.end_s]
        axes.plot([p[2] for p in inside], [p[1] for p in inside], color=_colour(span.name), lw=1.4)
    if not story.phases:
        axes.plot([p[2] for p in places], [p[1] for p in places], color=_colour("unknown"), lw=1.4)
    axes.plot(0, 0, "o", mfc="none", color="#222")
    axes.annotate("home", (0, 0), textcoords="offset points", xytext=(6, 6), fontsize=8)
    axes.plot(places[-1][2], places[-1][1], ".", color="#222")
    east, north = [p[2] for p in places] + [0.0], [p[1] for p in places] + [0.0]
    half = max(max(east) - min(east), max(north) - min(north), 4.0) * 0.55
    for values, limit in ((east, axes.set_xlim), (north, axes.set_ylim)):
        middle = (max(values) + min(values)) / 2
        limit(middle - half, middle + half)
    axes.set_aspect("equal")


def _write_facts(story: FlightSummary, axes: Any) -> None:
    axes.set_axis_off()
    for number, (name, value) in enumerate(facts(story)[:_MOST_FACTS]):
        x, y = (number // 6) * 0.5, 0.92 - (number % 6) * 0.17
        axes.text(x, y, name, fontsize=9, color="#667", transform=axes.transAxes)
        axes.text(x + 0.24, y, value, fontsize=9, weight="bold", transform=axes.transAxes)


# -- the page: no network, no other file, no library ----------------------------------------------


_HEIGHT = 100.0  # of a chart, in its own units; width is 1000
_WIDTH = 1000.0
_TRACK, _EDGE = 400.0, 24.0
_NOWHERE = '<p class="over">No position that can be trusted was heard.</p>'
_MOST_ROWS = 500
_TIME_STEPS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400)


def page(story: FlightSummary) -> str:
    """The page. It opens from a disk as well as from a server, on a telephone as on a desk."""
    here = files("m100link.log")
    drawn = panels(story)
    track, places = _track(story)
    duration = max(story.duration_s, 1e-3)
    data = {
        "duration": duration,
        "lines": [_points(line) for panel in drawn for line in panel.lines],
        "track": places,
    }
    return (
        (here / "page.html")
        .read_text("utf-8")
        .format(
            name=escape(story.name),
            css=(here / "page.css").read_text("utf-8"),
            js=(here / "page.js").read_text("utf-8"),
            began=_began(story, "Nothing was recorded."),
            facts="".join(
                f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
                for name, value in facts(story)
            ),
            track=track,
            charts=_charts(story, drawn, duration),
            events="".join(_rows(story)),
            data=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        )
    )


def _points(line: PlotLine) -> list[tuple[float, float | None]]:
    return [
        (round(at, 2), None if math.isnan(value) else round(value, 3))
        for at, value in line.curve.points()
    ]


# -- over time ------------------------------------------------------------------------------------


def _charts(story: FlightSummary, drawn: list[Panel], duration: float) -> str:
    shade = "".join(_rect(span, duration, 0.0, _HEIGHT, 0.10) for span in story.phases)
    shade += "".join(_alarm(span, duration) for span in story.alarms)
    shade += "".join(
        f'<line class="command" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{_HEIGHT:g}"/>'
        for x in (_WIDTH * one.at_s / duration for one in story.commands[:_MOST_ROWS])
    )
    made = [_strip(story, duration)]
    number = 0
    for panel in drawn:
        low, high = panel.span()
        scale = _HEIGHT / (high - low)
        lines = "".join(
            f'<line x1="0" x2="{_WIDTH:g}" y1="{y:.1f}" y2="{y:.1f}"/>'
            for y in (_HEIGHT - (value - low) * scale for value in ticks(low, high, 4))
        )
        labels = "".join(
            f'<span class="y" style="bottom:{(value - low) * scale:.1f}%">{value:g}</span>'
            for value in ticks(low, high, 4)
        )
        title, paths = "", ""
        for line in panel.lines:
            title += (
                f'<span><i style="background:{line.colour}"></i>{escape(line.name)} '
                f'<b id="value{number}"></b></span>'
            )
            number += 1
            path = _path(line, duration, low, scale)
            if path:
                paths += f'<path d="{path}" stroke="{line.colour}"/>'
        is_last = panel is drawn[-1]
        if is_last:
            labels = _times(duration) + labels
        made.append(
            f'<div class="title">{escape(panel.title)}{title}</div>'
            f'<div class="chart{" last" if is_last else ""}">{_svg(shade + lines + paths)}'
            f'{labels}<div class="cursor"></div></div>'
        )
    return "".join(made)


def _svg(inner: str) -> str:
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" preserveAspectRatio="none" '
        f'aria-hidden="true">{inner}</svg>'
    )


def _path(line: PlotLine, duration: float, low: float, scale: float) -> str:
    pieces: list[str] = []
    pen = "M"
    for at, value in line.curve.points():
        if math.isnan(value):
            pen = "M"
            continue
        x = _WIDTH * at / duration
        pieces.append(f"{pen}{x:.1f} {_HEIGHT - (value - low) * scale:.1f}")
        pen = "L"
    # A value that was heard once is a dot that can be seen.
    return "".join(pieces) + ("h2" if len(pieces) == 1 else "")


def _rect(span: Span, duration: float, top: float, height: float, opacity: float) -> str:
    x, width = _WIDTH * span.begin_s / duration, _WIDTH * (span.end_s - span.begin_s) / duration
    colour = _colour(span.name)
    return (
        f'<rect x="{x:.1f}" y="{top:g}" width="{width:.1f}" height="{height:g}" fill="{colour}" '
        f'opacity="{opacity:g}"><title>{escape(span.text or span.name)}</title></rect>'
    )


def _alarm(span: Span, duration: float) -> str:
    x = _WIDTH * span.begin_s / duration
    width = max(3.0, _WIDTH * (span.end_s - span.begin_s) / duration)
    return (
        f'<rect x="{x:.1f}" y="0" width="{width:.1f}" height="{_HEIGHT:g}" '
        f'fill="var(--alarm)" opacity="0.15"><title>{escape(span.text)}</title></rect>'
    )


def _strip(story: FlightSummary, duration: float) -> str:
    """Phases, control and setpoints as three bars."""
    rows = (("phase", story.phases), ("control", story.control), ("setpoints", story.streams))
    inner, labels = "", ""
    for number, (name, spans) in enumerate(rows):
        top = 4.0 + 32.0 * number
        inner += "".join(_rect(span, duration, top, 28.0, 0.85) for span in spans)
        labels += f'<span class="row" style="top:{top + 14.0:g}%">{name}</span>'
    inner += "".join(_alarm(span, duration) for span in story.alarms)
    shown = dict.fromkeys(span.name for _, spans in rows[:2] for span in spans)
    key = "".join(
        f'<span><i style="background:{PHASE_COLOURS.get(name, "")}"></i>{escape(name)}</span>'
        for name in shown
    )
    return (
        f'<div class="chart strip">{_svg(inner)}{labels}<div class="cursor"></div></div>'
        f'<div class="key over">{key}</div>'
    )


def _times(duration: float) -> str:
    step = next((one for one in _TIME_STEPS if duration / one <= 7), duration)
    if duration < 4.0:
        step = duration / 4.0
    labels = ""
    for number in range(int(duration / step + 1e-9) + 1):
        share = 100 * number * step / duration
        kind = "x end" if share > 94 else "x"  # else it would stand out of a telephone
        labels += f'<span class="{kind}" style="left:{share:.2f}%">{clock(number * step)}</span>'
    return labels


# -- from above -----------------------------------------------------------------------------------


def _track(story: FlightSummary) -> tuple[str, list[tuple[float, float, float]]]:
    """The drawing, and time and place in it of each point."""
    places = [place[:3] for place in story.track.places()]
    if not places:
        return _NOWHERE, []
    home = 0.0, 0.0
    view = MapView([home, *((n, e) for _, n, e in places)], (_TRACK, _TRACK), _EDGE, least_m=4.0)
    spots = [(at, *view.spot(north, east)) for at, north, east in places]
    drawn = [(at, round(x, 1), round(y, 1)) for at, x, y in spots]
    left, top = view.spot(*home)
    lines = "".join(
        svg_line(points, PHASE_COLOURS.get(name, "#888"), 2)
        for name, points in _by_phase(story, drawn)
    )
    svg = (
        f'<svg viewBox="0 0 {_TRACK:g} {_TRACK:g}" role="img" aria-label="track, north up">{lines}'
        f"{svg_dot((left, top), 6)}{svg_text((left + 9, top - 6), 'home')}"
        f"{svg_dot(drawn[-1][1:], 3.5, 'currentColor', 'none')}"
        '<circle id="place" r="5" fill="var(--alarm)" style="display:none"/>'
        f"{view.bar(12, _TRACK - 8, _TRACK / 2)}"
        f"{svg_text((_TRACK - 8, 14), 'N ↑', 'end')}</svg>"
    )
    return svg, drawn


def _by_phase(
    story: FlightSummary, drawn: list[tuple[float, float, float]]
) -> Iterator[tuple[str, list[tuple[float, float]]]]:
    """Pieces of the track that were flown in one phase; each begins where the last ended."""
    spans = story.phases or [Span("unknown", 0.0, math.inf)]
    number, points = 0, []
    for at, x, y in drawn:
        points.append((x, y))
        while number + 1 < len(spans) and at >= spans[number + 1].begin_s:
            yield spans[number].name, points
            number, points = number + 1, [(x, y)]
    yield spans[number].name, points


# -- in words -------------------------------------------------------------------------------------


def _rows(story: FlightSummary) -> Iterator[str]:
    said = sorted(happened(story), key=lambda one: one.at_s)
    for one in said[:_MOST_ROWS]:
        kind = ' class="alarm"' if one.kind == "alarm" else ""
        yield f"<tr{kind}><td>{clock(one.at_s)}</td><td>{escape(one.text)}</td></tr>"
    if len(said) > _MOST_ROWS:
        rest = f"and {len(said) - _MOST_ROWS} more: m100link log report"
        yield f"<tr><td></td><td>{rest}</td></tr>"
