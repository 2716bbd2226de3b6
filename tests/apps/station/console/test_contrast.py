"""Colours of each look, read from the style sheet: what is written can be read (WCAG 2.2, AA)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

SHEET = Path(__file__).parents[4] / "m100link/apps/station/console/static/console.css"
TEXT, SHAPE = 4.5, 3.0  # success criteria 1.4.3 and 1.4.11

LOOKS = {"light": (":root",), "dark": (":root", "body.body--dark"), "sun": (":root", "body.sun")}

# What is written or drawn, on what, and how much it has to stand out.
PAIRS = [
    ("--ink", "--paper", TEXT),
    ("--grey", "--paper", TEXT),
    ("--right-ink", "--paper", TEXT),
    ("--wrong-ink", "--paper", TEXT),
    ("--doubt-ink", "--paper", TEXT),
    *(
        ("#ffffff", ground, TEXT)
        for ground in ("--red", "--orange", "--green", "--blue", "#555555")
    ),
    ("--focus", "--paper", SHAPE),
    ("--red", "--paper", SHAPE),
    ("--blue", "--paper", SHAPE),
]


def colours(look: str) -> dict[str, str]:
    """The variables of a look; a later block changes what an earlier one said."""
    sheet = SHEET.read_text(encoding="utf-8")
    found: dict[str, str] = {}
    for block in LOOKS[look]:
        match = re.search(rf"^{re.escape(block)} \{{(.*?)\}}", sheet, re.MULTILINE | re.DOTALL)
        assert match is not None, block
        found |= dict(re.findall(r"(--[\w-]+): (#[0-9a-f]{3,6});", match[1]))
    return found


def luminance(colour: str) -> float:
    digits = colour.removeprefix("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    parts = [int(digits[at : at + 2], 16) / 255 for at in (0, 2, 4)]
    red, green, blue = (
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    darker, lighter = sorted((luminance(one), luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


def test_the_contrast_is_that_of_the_guidelines() -> None:
    assert contrast("#000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#fff") == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize(("one", "other", "least"), PAIRS)
def test_what_is_written_stands_out(look: str, one: str, other: str, least: float) -> None:
    known = colours(look)
    assert contrast(known.get(one, one), known.get(other, other)) >= least


@pytest.mark.parametrize("ink", ["--ink", "--grey", "--right-ink", "--wrong-ink", "--doubt-ink"])
def test_with_the_sun_on_it_everything_stands_out_more(ink: str) -> None:
    known = colours("sun")
    assert contrast(known[ink], known["--paper"]) >= 7.0  # 1.4.6, AAA
