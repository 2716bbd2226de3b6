"""A flight as one HTML page that needs nothing else: no network, no other file, no library."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from html import escape
from importlib.resources import files

from m100link.geodesy import MapView, svg_dot, svg_line, svg_text
from m100link.log.picture import PHASE_COLOURS, Line, Panel, clock, facts, panels, ticks
from m100link.log.story import Span, Story

_HEIGHT = 100.0  # of a chart, in its own units; width is 1000
_WIDTH = 1000.0
_TRACK, _EDGE = 400.0, 24.0
_NOWHERE = '<p class="over">No position that can be trusted was heard.</p>'
_MOST_ROWS = 500
_TIME_STEPS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400)

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{name}</title>
<style>
{css}</style>
</head>
<body>
<h1>{name}</h1>
<p>{began}</p>
<dl class="facts">{facts}</dl>
<div class="both">
<section class="track"><h2>Track over the take-off point</h2>{track}</section>
<section><h2>Over time <span id="time"></span></h2>{charts}</section>
</div>
<h2>What happened</h2>
<table>{events}</table>
<script type="application/json" id="flight">{data}</script>
<script>
{js}</script>
</body>
</html>
"""


def page(story: Story) -> str:
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
    began = "Nothing was recorded."
    if story.began_utc is not None:
        began = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(story.began_utc))
    return _PAGE.format(
        policy=_POLICY,
        name=escape(story.name),
        css=(here / "page.css").read_text("utf-8"),
        js=(here / "page.js").read_text("utf-8"),
        began=began,
        facts="".join(
            f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
            for name, value in facts(story)
        ),
        track=track,
        charts=_charts(story, drawn, duration),
        events="".join(_rows(story)),
        data=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
    )


def _points(line: Line) -> list[tuple[float, float | None]]:
    return [
        (round(at, 2), None if math.isnan(value) else round(value, 3))
        for at, value in line.curve.points()
    ]


# -- over time ------------------------------------------------------------------------------------


def _charts(story: Story, drawn: list[Panel], duration: float) -> str:
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


def _path(line: Line, duration: float, low: float, scale: float) -> str:
    pieces: list[str] = []
    pen = "M"
    for at, value in line.curve.points():
        if math.isnan(value):
            pen = "M"
            continue
        x = _WIDTH * at / duration
        pieces.append(f"{pen}{x:.1f} {_HEIGHT - (value - low) * scale:.1f}")
        pen = "L"
    # What was heard once is a dot that can be seen.
    return "".join(pieces) + ("h2" if len(pieces) == 1 else "")


def _rect(span: Span, duration: float, top: float, height: float, opacity: float) -> str:
    x, width = _WIDTH * span.begin_s / duration, _WIDTH * (span.end_s - span.begin_s) / duration
    colour = PHASE_COLOURS.get(span.name, PHASE_COLOURS["unknown"])
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


def _strip(story: Story, duration: float) -> str:
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


def _track(story: Story) -> tuple[str, list[tuple[float, float, float]]]:
    """The drawing, and time and place in it of each point."""
    places = story.track.places()
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
        f"{view.bar(12, _TRACK - 8, _TRACK / 2 - _EDGE)}"
        f"{svg_text((_TRACK - 8, 14), 'N ↑', 'end')}</svg>"
    )
    return svg, drawn


def _by_phase(
    story: Story, drawn: list[tuple[float, float, float]]
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


def _rows(story: Story) -> Iterator[str]:
    said: list[tuple[float, str, str]] = [
        *((one.begin_s, one.name, "") for one in story.phases),
        *((one.begin_s, f"control: {one.name}", "") for one in story.control),
        *(
            (one.begin_s, f"{one.text}, {clock(one.end_s - one.begin_s)}", "")
            for one in story.streams
        ),
        *((one.at_s, str(one), "") for one in story.commands),
        *((one.begin_s, f"{one.name}: {one.text}", ' class="alarm"') for one in story.alarms),
    ]
    said.sort(key=lambda one: one[0])
    for at, text, kind in said[:_MOST_ROWS]:
        yield f"<tr{kind}><td>{clock(at)}</td><td>{escape(text)}</td></tr>"
    if len(said) > _MOST_ROWS:
        rest = f"and {len(said) - _MOST_ROWS} more: m100link log events"
        yield f"<tr><td></td><td>{rest}</td></tr>"
