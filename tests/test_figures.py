"""Figures in sentences of the manual are those of the code, which ``tests/limits.toml`` has.

``tests/figures.toml`` has, by page, words with a place for each figure, and the names of the
figures. ``*1000`` makes milliseconds of seconds. A table that is made of the code needs no row.
"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import pytest

from tests.limits import agreed

DOCS = Path(__file__).parent.parent / "docs"
FIGURES: dict[str, dict[str, str | list[str]]] = tomllib.loads(
    Path(__file__).with_name("figures.toml").read_text(encoding="utf-8")
)


@cache
def text(page: str) -> str:
    return " ".join((DOCS / page).read_text(encoding="utf-8").split())


def figure(key: str) -> str:
    module, _, name = key.partition(":")
    name, _, factor = name.partition("*")
    value = agreed()[module][name]
    assert isinstance(value, int | float)
    return f"{value * float(factor or 1):.6g}"


@pytest.mark.parametrize(
    ("page", "words"), [(page, words) for page, rows in FIGURES.items() for words in rows]
)
def test_a_figure_of_the_manual_is_that_of_the_code(page: str, words: str) -> None:
    keys = FIGURES[page][words]
    figures = [figure(key) for key in ([keys] if isinstance(keys, str) else keys)]
    assert words.format(*figures) in text(page)
