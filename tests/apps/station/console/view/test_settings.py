"""What the browser keeps: everything that can be chosen, and nothing that harms."""

from __future__ import annotations

import json
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.apps.station.console.view.settings import Settings, Theme
from m100link.apps.station.console.view.units import Language, LengthUnit, SpeedUnit, Units


def test_whatever_was_chosen_comes_back() -> None:
    for language, length, speed, theme, sound, speech in product(
        Language, LengthUnit, SpeedUnit, Theme, (False, True), (False, True)
    ):
        chosen = Settings(language, length, speed, theme, sound, speech, "Anna")
        assert Settings.from_text(chosen.to_text()) == chosen
        assert chosen.speaker.language is language
        assert chosen.units == Units(length, speed)


@pytest.mark.parametrize(
    "kept",
    [
        None,
        7,
        "",
        "[",
        "[" * 5000,
        "[]",
        '"de"',
        '{"language": "fr", "sound": "yes", "theme": ["dark"], "name": 7, "speed": null}',
        json.dumps({"name": "x" * 2000}),
    ],
)
def test_what_cannot_be_read_is_as_by_default(kept: object) -> None:
    assert Settings.from_text(kept) == Settings()


def test_what_can_be_read_is_kept_beside_what_cannot() -> None:
    kept = '{"language": "de", "length": "mile", "sound": false, "name": "' + "x" * 100 + '"}'
    assert Settings.from_text(kept) == Settings(
        language=Language.GERMAN, sound=False, name="x" * 64
    )


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=5,
)


@given(st.text() | st.dictionaries(st.sampled_from([*Settings.__slots__]), _JSON).map(json.dumps))
def test_nonsense_raises_nothing(kept: str) -> None:
    assert isinstance(Settings.from_text(kept), Settings)
