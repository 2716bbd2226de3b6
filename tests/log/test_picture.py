"""The picture of a flight."""

from __future__ import annotations

import json
import re
import struct
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from m100link.errors import UsageError
from m100link.log import read
from m100link.log.picture import page, picture
from m100link.log.story import Curve, FlightSummary, Moment, Span, read_story
from tests.log.flight import fly


def size_of(png: bytes) -> tuple[int, int]:
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


@pytest.mark.anyio
async def test_a_flight_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `analysis` is not installed")
    await fly(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    assert size_of(picture(story, width_px=700)) == (700, 450)
    assert size_of(picture(FlightSummary("$empty$.mcap"), width_px=700)) == (700, 450)


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
    await fly(tmp_path / "flight.mcap")
    story = read_story(read(tmp_path / "flight.mcap"))
    text = checked(story)
    assert len(text) < 200_000
    for word in ("take-off", "start_task", "control: program", "Highest", "round trip"):
        assert word in text
    assert len(data_of(text)["track"]) == len(story.track.places())


@pytest.mark.parametrize("duration", [0.0, 1.0, 7200.0, 1e6])
def test_a_story_of_nothing_but_time_is_a_page(duration: float) -> None:
    text = checked(FlightSummary("empty.mcap", 0.0 if duration else None, duration))
    assert "No position that can be trusted" in text


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
