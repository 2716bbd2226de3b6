"""Pictures that move: what they show when, and what they cost. No browser is needed."""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

pytest.importorskip("rich")
from tests.browser.recording import film, record
from tests.browser.screen import settled

SVG = "{http://www.w3.org/2000/svg}"
DEMO = Path(__file__).parents[2] / "docs/images/demo.svg"


def test_a_display_that_is_drawn_over_itself_settles() -> None:
    drawn = "one\r\ntwo\r\x1b[2K\x1b[1A\x1b[2Kthree\r\nfour\r\n"
    assert settled(drawn) == "three\nfour\n"


def test_a_line_is_in_the_picture_once_however_long_it_stands() -> None:
    frames = [(0.1, ["a", "b"]), (1.0, ["a", "\x1b[32mc\x1b[0m  d"]), (2.0, ["a"])]
    svg = film(frames, title="<run>", columns=10, hold_s=2.0)
    root = ET.fromstring(svg)
    lines = root.findall(f"{SVG}defs/{SVG}g")
    texts = ["".join(line.itertext()) for line in lines]
    assert texts == ["$<run>", "a", "b", "cd"]
    green, plain = lines[3].findall(f".//{SVG}tspan")
    assert green.attrib["class"] == "g"
    assert float(plain.attrib["x"]) == pytest.approx(3 * float(green.attrib["textLength"]))
    uses = [use.attrib["href"] for use in root.iter(f"{SVG}use")]
    assert uses == ["#l0", "#l1", "#l2", "#l0", "#l1", "#l3", "#l0", "#l1"]
    stops = re.findall(r"([\d.]+)%\{transform:translateY\(-(\d+)px\)", svg)
    assert stops == [("0.00", "0"), ("25.00", "51"), ("50.00", "102"), ("100", "102")]
    assert "animation:film 4.0s step-end infinite" in svg


def test_a_program_is_recorded_with_its_times() -> None:
    program = "import time; print('one', flush=True); time.sleep(0.4); print('two')"
    frames = record([sys.executable, "-c", program], columns=40, lines=10)
    assert [lines for _, lines in frames][-2:] == [["one"], ["one", "two"]]
    assert frames[-1][0] - frames[-2][0] > 0.2


def test_the_picture_of_the_readme_is_small_and_asks_nobody_for_anything() -> None:
    text = DEMO.read_text(encoding="utf-8")
    assert len(text.encode()) < 150_000
    root = ET.fromstring(text)
    assert all(use.attrib["href"].startswith("#") for use in root.iter(f"{SVG}use"))
    assert "url(" not in text
    assert text.count("http") == 1  # its namespace
    assert "mission flown" in text
