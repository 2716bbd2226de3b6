"""Recipes of the manual, carried out: they work, and each forgotten part is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.house.trials import ORDER, RECIPES, Edit, Part, Recipe, copied, faults


@pytest.mark.slow
@pytest.mark.parametrize("recipe", RECIPES, ids=[one.name for one in RECIPES])
def test_a_recipe_works_and_each_forgotten_part_is_named(recipe: Recipe, tmp_path: Path) -> None:
    copied(tmp_path)
    assert list(faults(recipe, tmp_path)) == []


@pytest.mark.slow
def test_a_recipe_that_notices_nothing_is_reported(tmp_path: Path) -> None:
    """The trial itself: parts that nobody misses, and parts that nobody names, are faults."""
    note = Edit("m100link/note.py", "", '"""A note."""\n')
    copied(tmp_path)
    unmissed = Recipe("r", ("-c", "import m100link.note"), (Part("p", (note,), ("-c", ""), "x"),))
    assert list(faults(unmissed, tmp_path)) == ["r: nothing notices that p is missing"]
    unnamed = Recipe("r", ("-c", "1 / 0"), (Part("p", (note,), ("-c", "1 / 0"), "of a name"),))
    works, call, named = faults(unnamed, tmp_path)
    assert "it does not work" in works
    assert "('-c', '1 / 0') fails" in call
    assert "no output names 'of a name'" in named


def test_an_order_is_made_in_three_files_beside_tests_and_the_manual() -> None:
    places = {edit.place for part in ORDER.parts for edit in part.edits}
    assert len([one for one in places if one.startswith("m100link/")]) <= 3
