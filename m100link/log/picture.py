"""A flight as one picture, by matplotlib."""

from __future__ import annotations

import io
import math
import time
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from difflib import SequenceMatcher
from importlib import import_module
from statistics import fmean
from typing import Any, NamedTuple

from m100link.errors import UsageError
from m100link.log.story import Curve, Story

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
"""Colour of a phase, and of who has control."""


class Line(NamedTuple):
    """A curve with its name and colour."""

    name: str
    colour: str
    curve: Curve


class Panel(NamedTuple):
    """Curves over one scale."""

    title: str  # what they are, with the unit
    lines: tuple[Line, ...]
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


def panels(story: Story) -> list[Panel]:
    """What is drawn over time."""
    curves = story.curves
    return [
        Panel("Height, m", (Line("height", "#3b7dd8", curves.height_m),), (0.0, 2.0)),
        Panel(
            "Speed, m/s",
            (
                Line("over ground", "#3b7dd8", curves.ground_speed_m_s),
                Line("climb", "#e8a33d", curves.climb_m_s),
            ),
            (0.0, 1.0),
        ),
        Panel("Battery, %", (Line("charge", "#2a9d8f", curves.battery_percent),), (0.0, 100.0)),
        Panel(
            "Telemetry, packages/s", (Line("arrived", "#3b7dd8", curves.packages_per_s),), (0, 10)
        ),
        Panel(
            "Line",
            (
                Line("round trip, ms", "#e8a33d", curves.round_trip_ms),
                Line("bytes lost per s", "#d64545", curves.discarded_bytes_per_s),
            ),
            (0.0, 5.0),
        ),
    ]


def facts(story: Story) -> list[tuple[str, str]]:
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
    """How far two flights were apart.

    Attributes:
        after_s: Seconds after the take-off of each.
        metres: How far apart over ground, each measured from its own take-off point.
    """

    after_s: float
    metres: float


@dataclass(frozen=True)
class Difference:
    """One value of both flights.

    Attributes:
        name: What it is, with its unit at the end.
        first, second: Of each; None where it was never heard.
    """

    name: str
    first: float | None
    second: float | None

    @property
    def by(self) -> float | None:
        """The second less the first; None where one of them is not known."""
        if self.first is None or self.second is None:
            return None
        return self.second - self.first


@dataclass
class Comparison:
    """Two flights beside each other.

    Attributes:
        values: Durations, maxima and the line.
        apart: Twice a second; empty when one of them did not take off.
        commands: Lines of what was commanded: beginning with ``-`` only in the first, with ``+``
            only in the second.
        alarms: The same of alarms.
    """

    values: list[Difference] = field(default_factory=list)
    apart: list[Apart] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)

    @property
    def mean_apart_m(self) -> float | None:
        """How far apart they were in the mean."""
        return fmean(one.metres for one in self.apart) if self.apart else None

    @property
    def most_apart(self) -> Apart | None:
        """When they were farthest apart, and how far."""
        return max(self.apart, key=lambda one: one.metres) if self.apart else None


def compare(first: Story, second: Story) -> Comparison:
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


def _lasted(story: Story, phase: str) -> float:
    return sum(span.end_s - span.begin_s for span in story.phases if span.name == phase)


def _rate(story: Story) -> float | None:
    return story.packages / story.duration_s if story.duration_s else None


def _mean_trip(story: Story) -> float | None:
    found = [value for _, value in story.curves.round_trip_ms.points() if not math.isnan(value)]
    return fmean(found) if found else None


def _apart(first: Story, second: Story) -> Iterator[Apart]:
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


def _place_at(places: list[tuple[float, float, float]], at_s: float) -> tuple[float, float, float]:
    return places[max(0, bisect_right(places, at_s, key=lambda place: place[0]) - 1)]


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


def picture(story: Story, *, width_px: int = 1400) -> bytes:
    """Draw it as PNG.

    Args:
        story: The flight.
        width_px: Width of the picture.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        figures = import_module("matplotlib.figure")
        patches = import_module("matplotlib.patches")
    except ModuleNotFoundError:
        raise UsageError(
            "a picture needs matplotlib, which is not installed",
            remedy="pip install '.[analysis]' in a clone of m100link, or -o flight.html",
        ) from None
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
    began = "nothing recorded"
    if story.began_utc is not None:
        began = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(story.began_utc))
    figure.suptitle(f"{story.name}   {began}", fontsize=11, parse_math=False)
    drawn_into = io.BytesIO()
    figure.savefig(drawn_into, format="png")
    return drawn_into.getvalue()


def _colour(name: str) -> str:
    return PHASE_COLOURS.get(name, PHASE_COLOURS["unknown"])


def _draw_strip(story: Story, axes: Any) -> None:
    """Phases, control, setpoints and alarms as bars."""
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


def _draw_track(story: Story, axes: Any) -> None:
    axes.set_title("Track over the take-off point, m", fontsize=9)
    axes.set_xlabel("east", fontsize=8)
    axes.set_ylabel("north", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    places = story.track.places()
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


def _write_facts(story: Story, axes: Any) -> None:
    axes.set_axis_off()
    for number, (name, value) in enumerate(facts(story)[:_MOST_FACTS]):
        x, y = (number // 6) * 0.5, 0.92 - (number % 6) * 0.17
        axes.text(x, y, name, fontsize=9, color="#667", transform=axes.transAxes)
        axes.text(x + 0.24, y, value, fontsize=9, weight="bold", transform=axes.transAxes)
