"""The picture of a flight."""

from __future__ import annotations

import json
import re
import struct
import sys
from dataclasses import fields
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from m100link.errors import UsageError
from m100link.log import read
from m100link.log.channels import Curve
from m100link.log.picture import (
    _draw_strip,
    _draw_track,
    _write_facts,
    facts,
    page,
    panels,
    picture,
)
from m100link.log.story import FlightSummary, Maxima, Moment, Span, read_story
from tests.log.flight import flown


def size_of(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


@pytest.mark.anyio
async def test_a_flight_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `analysis` is not installed")
    await flown(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    assert size_of(picture(story, width_px=700)) == (700, 450)
    assert size_of(picture(FlightSummary("$empty$.mcap"), width_px=700)) == (700, 450)


def test_facts_stand_in_two_columns_of_six_from_the_top_down() -> None:
    """In shares of the axes, from the lower left; a value stands to the right of its name."""
    story, found = FlightSummary("a.mcap", 0.0, 60.0), list[tuple[float, float, str]]()
    story.maxima = Maxima(**{one.name: 1 for one in fields(Maxima)})
    story.phases = [Span("flight", 0.0, 60.0)]
    axes = SimpleNamespace(
        set_axis_off=lambda: None,
        transAxes=None,
        text=lambda x, y, text, **_: found.append((round(x, 2), round(y, 2), text)),
    )
    _write_facts(story, axes)
    names, values = found[::2], found[1::2]
    assert [(name, value) for (*_, name), (*_, value) in zip(names, values, strict=True)] == facts(
        story
    )[:12]
    tops = [0.92, 0.75, 0.58, 0.41, 0.24, 0.07]
    assert [one[:2] for one in names] == [(0.0, y) for y in tops] + [(0.5, y) for y in tops]
    assert [one[:2] for one in values] == [(0.24, y) for y in tops] + [(0.74, y) for y in tops]


def test_without_matplotlib_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match="matplotlib") as caught:
        picture(FlightSummary("flight.mcap"))
    assert "'.[analysis]'" in str(caught.value)


# -- the page of a flight: whole, without the network, and whatever the flight was -----------------


class Balanced(HTMLParser):
    """Every element that begins ends."""

    EMPTY = ("meta", "circle", "path", "line", "rect", "polyline")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def checked(story: FlightSummary) -> str:
    text = page(story)
    parser = Balanced()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    assert "http" not in text.replace("http-equiv", "")
    assert "nan" not in re.sub(r"<(style|script).*?</\1>", "", text, flags=re.DOTALL).lower()
    return text


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'id="flight">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


@pytest.mark.anyio
async def test_a_flight_is_a_page_with_its_track_and_what_happened(tmp_path: Path) -> None:
    await flown(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    text = checked(story)
    assert len(text) < 200_000
    for word in ("take-off", "start_task", "obeyed the program", "Highest", "round trip"):
        assert word in text
    assert len(data_of(text)["track"]) == len(story.track.places())


@pytest.mark.parametrize("duration", [0.0, 1.0, 7200.0, 1e6])
def test_a_story_of_nothing_but_time_is_a_page(duration: float) -> None:
    text = checked(FlightSummary("empty.mcap", 0.0 if duration else None, duration))
    assert "No position that can be trusted" in text


@pytest.mark.parametrize(
    ("climb", "descent", "shown"),
    [
        (3.21, 1.5, "3.2 / 1.5 m/s"),
        (-0.4, 1.0, "0.0 / 1.0 m/s"),  # it never climbed
        (3.21, None, None),
        (None, 1.5, None),
        (None, None, None),
    ],
)
def test_a_climb_is_shown_with_its_descent_or_not_at_all(
    climb: float | None, descent: float | None, shown: str | None
) -> None:
    story = FlightSummary("a.mcap")
    story.maxima.climb_m_s, story.maxima.descent_m_s = climb, descent
    assert dict(facts(story)).get("Climb / descent") == shown


def test_what_a_log_says_is_text_and_no_markup() -> None:
    evil = '</script><img src=x onerror="alert(1)">'
    story = FlightSummary(evil, 0.0, 10.0)
    story.alarms = [Span(evil, 1.0, 2.0, evil)]
    story.phases = [Span(evil, 0.0, 10.0)]
    story.commands = [Moment(1.0, evil, {evil: evil}, evil, 0.1)]
    assert "<img" not in checked(story)


def test_a_hole_in_a_curve_is_a_hole_in_the_line() -> None:
    story = FlightSummary("holes.mcap", 0.0, 30.0)
    for at in (1.0, 2.0, 20.0, 21.0):
        story.curves.height_m.add(at, 3.0)
    text = checked(story)
    [path] = [one for one in re.findall(r'<path d="([^"]*)"', text) if one.count("M") == 2]
    assert path.count("L") == 2
    assert [value for _, value in data_of(text)["lines"][0]] == [3.0, 3.0, None, 3.0, 3.0]


def test_what_was_heard_once_can_be_seen() -> None:
    story = FlightSummary("once.mcap", 0.0, 1.0)
    story.curves.battery_percent = Curve()
    story.curves.battery_percent.add(0.5, 80.0)
    assert re.search(r'd="M500.0 [\d.]+h2"', checked(story))


# -- where each thing stands on the page, of a flight of 50 s --------------------------------------


def marked() -> FlightSummary:
    """Curves, phases, an alarm, a command and places, each with numbers of its own."""
    story = FlightSummary("flight.mcap", 1_795_420_800.0, 50.0)
    story.phases = [Span("ground", 0.0, 10.0), Span("flight", 10.0, 50.0)]
    story.control = [Span("pilot", 0.0, 20.0), Span("program", 20.0, 50.0)]
    story.streams = [Span("move", 25.0, 30.0, "9 × move")]
    story.alarms = [Span("gps", 15.0, 25.0, "GPS health 2"), Span("link_old", 40.0, 40.05, "late")]
    story.commands = [Moment(12.5, "arm", {"on": True}, "DONE", 0.1)]
    for at, height, climb in ((5.0, 0.5, -1.0), (20.0, 8.0, 2.0), (21.0, 4.0, 0.0)):
        story.curves.height_m.add(at, height)
        story.curves.climb_m_s.add(at, climb)
    for place in ((5.0, 0.0, 0.0), (12.0, 0.0, 10.0), (20.0, 20.0, 10.0), (30.0, 20.0, -10.0)):
        story.track.add(*place)
    return story


def test_a_panel_spans_its_values_with_a_little_room() -> None:
    """Four hundredths above, and below where a value lies lower than the scale begins."""
    drawn = {panel.title: panel for panel in panels(marked())}
    assert drawn["Height, m"].span() == pytest.approx((0.0, 8.0 + 0.04 * 8.0))
    assert drawn["Speed, m/s"].span() == pytest.approx((-1.0 - 0.04 * 3.0, 2.0 + 0.04 * 3.0))
    assert drawn["Battery, %"].span() == pytest.approx((0.0, 104.0))
    assert [one.name for one in drawn["Line"].lines] == ["round trip, ms", "bytes lost per s"]


def test_times_and_values_stand_at_their_places_in_a_chart_of_1000_by_100() -> None:
    text = page(marked())
    # 8.32 m high: 0.5 m is 6.01 of 100 from below, 8 m 96.15; 5 s of 50 are 100 of 1000. Fifteen
    # seconds without a value are a hole.
    assert 'd="M100.0 94.0M400.0 3.8L420.0 51.9" stroke="#3b7dd8"' in text
    assert 'd="M100.0 96.3M400.0 3.7L420.0 65.4" stroke="#e8a33d"' in text  # of 3.24, from −1.12
    strip, *charts = text.split('<div class="title">')
    rect = '<rect x="{}" y="{}" width="{}" height="{}" fill="{}" opacity="{}"><title>{}</title>'
    for values in (
        ("0.0", 4, "200.0", 28, "#9aa0a6", 0.85, "ground"),
        ("200.0", 4, "800.0", 28, "#3b7dd8", 0.85, "flight"),
        ("0.0", 36, "400.0", 28, "#9aa0a6", 0.85, "pilot"),
        ("400.0", 36, "600.0", 28, "#3b7dd8", 0.85, "program"),
        ("500.0", 68, "100.0", 28, "#b07cc6", 0.85, "9 × move"),
        ("300.0", 0, "200.0", 100, "var(--alarm)", 0.15, "GPS health 2"),
        ("800.0", 0, "3.0", 100, "var(--alarm)", 0.15, "late"),  # else it could not be seen
    ):
        assert rect.format(*values) in strip, values
    for chart in charts[:5]:
        assert rect.format("200.0", 0, "800.0", 100, "#3b7dd8", 0.1, "flight") in chart
        assert rect.format("300.0", 0, "200.0", 100, "var(--alarm)", 0.15, "GPS health 2") in chart
        assert '<line class="command" x1="250.0" x2="250.0" y1="0" y2="100"/>' in chart
    for label in ("phase", "control", "setpoints"):
        assert f">{label}</span>" in strip
    tops = re.findall(r'class="row" style="top:([\d.]+)%"', strip)
    assert tops == ["18", "50", "82"]
    heights = [re.findall(r'class="y" style="bottom:([\d.]+)%">([-\d.]+)<', c) for c in charts]
    assert heights[0] == [("0.0", "0"), ("60.1", "5")]
    assert heights[1] == [("3.7", "-1"), ("34.6", "0"), ("65.4", "1"), ("96.3", "2")]
    assert '<line x1="0" x2="1000" y1="39.9" y2="39.9"/>' in charts[0]
    assert '<line x1="0" x2="1000" y1="34.6" y2="34.6"/>' in charts[1]  # 1 m/s up
    assert ['<div class="chart last">' in chart for chart in charts] == [False] * 4 + [True]


def test_the_picture_has_east_to_the_right_north_up_and_a_bar_for_each_span() -> None:
    """Both directions of the track in one scale, with a tenth of its larger side for an edge."""
    axes = MagicMock()
    _draw_track(marked(), axes)
    ground, flown, _, last = (call.args[:2] for call in axes.plot.call_args_list)
    assert ground == ([0.0], [0.0])
    assert flown == (pytest.approx([10.0, 10.0, -10.0]), pytest.approx([0.0, 20.0, 20.0]))
    assert last == pytest.approx((-10.0, 20.0))
    assert axes.set_xlim.call_args.args == pytest.approx((-11.0, 11.0))
    assert axes.set_ylim.call_args.args == pytest.approx((-1.0, 21.0))
    _draw_strip(marked(), axes)
    bars = [(*call.args, call.kwargs["left"]) for call in axes.barh.call_args_list]
    assert bars == [
        *((0, 10.0, 0.0), (0, 40.0, 10.0), (1, 20.0, 0.0), (1, 30.0, 20.0), (2, 5.0, 25.0)),
        *((3, 10.0, 15.0), (3, pytest.approx(50.0 / 300), 40.0)),  # else it could not be seen
    ]
    assert axes.set_ylim.call_args.args == (3.5, -0.5), "the phase is on top"
    for east, north in ((-30.0, -12.0), (-12.0, -30.0)):  # to 10 m beyond the take-off point
        story = FlightSummary("flight.mcap", 0.0, 50.0)
        story.track.add(1.0, north, east)
        story.track.add(2.0, 10.0 if north < east else 0.0, 10.0 if east < north else 0.0)
        _draw_track(story, axes)
        limits = axes.set_xlim.call_args.args, axes.set_ylim.call_args.args
        wide, narrow = pytest.approx((-32.0, 12.0)), pytest.approx((-28.0, 16.0))
        assert limits == ((wide, narrow) if east < north else (narrow, wide))


def test_the_picture_has_a_panel_below_the_other_and_times_below_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plots = MagicMock()
    monkeypatch.setattr("m100link.log.picture.of_extra", lambda *_: plots)
    picture(marked(), width_px=700)
    assert plots.Figure.call_args.kwargs["figsize"] == (14, 9)
    assert plots.Figure.call_args.kwargs["dpi"] == 50.0, "700 of 14 inches"
    figure = plots.Figure.return_value
    assert figure.add_gridspec.call_args.args == (6, 2)
    grid, axes = figure.add_gridspec.return_value, figure.add_subplot.return_value
    places = [call.args[0] for call in grid.__getitem__.call_args_list]
    assert places[2:] == [(row, 1) for row in range(6)]
    labels = [call.kwargs.get("labelbottom") for call in axes.tick_params.call_args_list]
    assert labels[-5:] == [False] * 4 + [True]
    alarms = [one.args for one in axes.axvspan.call_args_list if one.kwargs["color"] == "#d64545"]
    assert alarms[:2] == [(15.0, 25.0), (40.0, pytest.approx(40.0 + 50.0 / 300))]


@pytest.mark.parametrize(
    ("duration", "shown"),
    [
        (21.0, "0.00% 0.0 s, 23.81% 5.0 s, 47.62% 10.0 s, 71.43% 15.0 s, 95.24% 20.0 s !"),
        (3.0, "0.00% 0.0 s, 25.00% 0.8 s, 50.00% 1.5 s, 75.00% 2.2 s, 100.00% 3.0 s !"),
        (320.0, "0.00% 0.0 s, 18.75% 1:00, 37.50% 2:00, 56.25% 3:00, 75.00% 4:00, 93.75% 5:00"),
        (318.0, "0.00% 0.0 s, 18.87% 1:00, 37.74% 2:00, 56.60% 3:00, 75.47% 4:00, 94.34% 5:00 !"),
    ],
)
def test_at_most_eight_round_times_stand_below_the_last_chart(duration: float, shown: str) -> None:
    """What stands in the last 6 % ends there (!), or it would be cut off on a telephone."""
    text = page(FlightSummary("flight.mcap", 0.0, duration))
    found = re.findall(r'class="x( end)?" style="left:([\d.]+)%">([^<]*)<', text)
    told = (f"{left}% {said}{' !' if end else ''}" for end, left, said in found)
    assert ", ".join(told) == shown


def test_the_track_is_drawn_with_north_up_in_pieces_of_a_phase() -> None:
    """20 m north and from 10 m west to 10 m east, in a square of 400 with an edge of 24."""
    text = page(marked())
    track = data_of(text)["track"]
    assert [at for at, _, _ in track] == [5.0, 12.0, 20.0, 30.0]
    (x0, y0), east, there, west = [tuple(one[1:]) for one in track]
    assert east[0] - x0 == pytest.approx(x0 - west[0], abs=0.1) == pytest.approx(176.0, abs=0.2)
    assert (there[0], west[1]) == (east[0], there[1])
    assert y0 - there[1] == pytest.approx(352.0, abs=0.3)
    assert (min(west[0], there[1]), max(east[0], y0)) == pytest.approx((24.0, 376.0), abs=0.2)
    flown = re.search(r'<section class="track">(.*?)</section>', text, re.DOTALL)
    assert flown is not None
    assert flown[1].index("#9aa0a6") < flown[1].index("#3b7dd8"), "the ground first"
    for drawn in (
        '<circle cx="200.0" cy="376.0" r="6"',
        '<text x="209.0" y="370.0" text-anchor="start" fill="currentColor">home</text>',
        '<circle cx="24.0" cy="24.0" r="3.5" fill="currentColor"',  # where it is at last
        '<path d="M12 388v4h176.0v-4"',  # ten metres
        '<text x="392.0" y="14.0" text-anchor="end"',
    ):
        assert drawn in flown[1]
    later = marked()
    later.phases = [Span("ground", 0.0, 9.0), Span("take-off", 9.0, 15.0), Span("flight", 15.0, 50)]
    pieces = re.findall(r'polyline points="(\S+ \S+)" fill="none" stroke="([^"]*)"', page(later))
    assert [colour for _, colour in pieces] == ["#9aa0a6", "#e8a33d", "#3b7dd8"], "two places each"
    later.phases = []
    assert "#b07cc6" in page(later).split("Over time")[0].split("Track over")[1]


def test_what_happened_stands_in_order_and_500_rows_are_the_most() -> None:
    story = marked()
    rows = re.findall(r"<tr([^>]*)><td>([^<]*)</td><td>([^<]*)</td></tr>", page(story))
    assert rows == [
        ("", "0.0 s", "The aircraft was in phase ground."),
        ("", "0.0 s", "The aircraft obeyed the pilot."),
        ("", "10.0 s", "The aircraft was in phase flight."),
        ("", "12.5 s", "Sent to the aircraft: arm on=True: DONE."),
        (' class="alarm"', "15.0 s", "Alarm gps for 10.0 s: GPS health 2."),
        ("", "20.0 s", "The aircraft obeyed the program."),
        ("", "25.0 s", "Sent for 5.0 s: 9 × move."),
        (' class="alarm"', "40.0 s", "Alarm link_old: late."),
    ]
    story.commands = [Moment(12.0, "arm", {}, None, None)] * 494
    many = re.findall(r"<td>([^<]*)</td></tr>", page(story))
    assert (len(many), many[-1]) == (501, "and 1 more: m100link log report")
    story.commands.pop()
    assert "more: m100link log report" not in page(story)
    assert "2026-11-23" in page(story)
    assert "Nothing was recorded." in page(FlightSummary("empty.mcap"))
