"""A flight as one picture, by matplotlib."""

from __future__ import annotations

import io
import time
from importlib import import_module
from typing import Any

from m100link.errors import UsageError
from m100link.log.drawing import PHASE_COLOURS, clock, facts, panels
from m100link.log.story import Story

__all__ = ["picture"]

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
