"""The catalogue: every text in both languages, with the same braces, and every key in use."""

from __future__ import annotations

import ast
import re
import string
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.console.fate import Fate
from m100link.apps.station.console.view.catalogue import CATALOGUE, PARTS
from m100link.apps.station.console.view.units import (
    Language,
    LengthUnit,
    Quantity,
    SpeedUnit,
    Units,
)
from m100link.apps.station.console.view.words import Speaker, for_browser, say

CONSOLE = Path(__file__).parents[5] / "m100link/apps/station/console"
KEY = r"[a-z_]+(\.[a-z_]+)+(?<!\.js)"
PREFIXES = tuple(f"{part.__name__.rpartition('.')[2]}." for part in PARTS)


def braces(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}


def sources() -> Iterator[ast.AST]:
    for path in CONSOLE.rglob("*.py"):
        if path.parent.name != "catalogue":
            yield from ast.walk(ast.parse(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("key", CATALOGUE)
def test_both_languages_say_the_same_things(key: str) -> None:
    english, german = CATALOGUE[key]
    assert english.strip() == english != ""
    assert german.strip() == german != ""
    assert braces(english) == braces(german)
    assert not any(name == "" or name.isdigit() for name in braces(english))


def test_a_key_stands_once_and_in_the_file_of_its_name() -> None:
    assert sum(len(part.WORDS) for part in PARTS) == len(CATALOGUE)
    for part, prefix in zip(PARTS, PREFIXES, strict=True):
        assert [key for key in part.WORDS if not key.startswith(prefix)] == []


def test_every_text_that_is_said_is_in_the_catalogue_and_filled_as_it_wants() -> None:
    wrong = []
    for node in sources():
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            is_key = node.value.startswith(PREFIXES) and re.fullmatch(KEY, node.value)
            if is_key and node.value not in CATALOGUE:
                wrong.append(f"unknown: {node.value}")
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "say" and node.args:
            [key] = node.args
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                given = {keyword.arg for keyword in node.keywords}
                if given != braces(CATALOGUE[key.value][0]):
                    wrong.append(f"{key.value} is filled with {given}")
    assert wrong == []


def test_a_speaker_fills_in_numbers_quantities_and_other_texts() -> None:
    english, german = Speaker(), Speaker(Language.GERMAN, Units(LengthUnit.FOOT))
    near = say("alarms.guard_near.height", value=Quantity.length(46.2), limit=Quantity.length(50.0))
    assert english(near) == "Near the limit: 46 m high of 50 m"
    assert german(near) == "Nahe der Grenze: 152 ft hoch von 164 ft"
    waiting = say("unit.seconds", seconds=1.5)
    assert (english(waiting), german(waiting)) == ("1.5 s", "1,5 s")
    inner = say("alarms.passed", alarm=say("alarms.gps"))
    assert german(inner) == "GPS ist schwach: das Fluggerät kann abtreiben (vorbei)"


def test_what_strangers_wrote_is_not_taken_for_braces() -> None:
    taken = say("alarms.lease_taken.taken", name="{0.__class__} {name}")
    assert Speaker()(taken) == "{0.__class__} {name} took control from you"


def test_the_page_is_told_its_words_its_units_and_its_decimal_sign() -> None:
    told: dict[str, Any] = for_browser(
        Speaker(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    )
    assert told["speed"] == [3.6, "km/h"]
    assert told["length"] == [pytest.approx(3.2808, abs=1e-4), "ft"]
    assert (told["point"], told["words"]["old"]) == (",", "alt")


def test_what_the_page_asks_for_is_what_it_is_told() -> None:
    told: dict[str, Any] = for_browser(Speaker())
    asked = {f"fate_{fate}" for fate in Fate}  # by their names, in steer.js
    for path in (CONSOLE / "static").glob("*.js"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if re.search(r"\b(words|go)\(", line) or "? " in line:
                asked |= set(re.findall(r'"([a-z_]{3,})"', line))
    assert set(told["words"]) - asked == set()
    for path in (CONSOLE / "static").glob("*.js"):
        for key in re.findall(r'\bwords\("(\w+)"', path.read_text(encoding="utf-8")):
            assert key in told["words"]


SAME = (
    *("actions.stop", "click.radius", "link.firmware", "link.jitter", "link.cause.version"),
    *("plan.title", "plan.pause", "plan.mission", "plan.actions_hint"),
    *("plots.csv", "plots.item.position", "plots.item.magnetometer", "plots.field.phase"),
    *("settings.language.en", "settings.language.de", "instruments.device.app"),
    *("alarms.event.raised", "checklist.gps"),
)
"""What reads the same in both languages: names, and words that German has as well."""


def test_what_has_letters_is_another_text_in_german() -> None:
    same = [key for key, (english, german) in CATALOGUE.items() if english == german]
    plain = {key: re.sub(r"{.*?}", "", CATALOGUE[key][0]) for key in same}
    unexpected = {
        key: text
        for key, text in plain.items()
        if re.search("[A-Za-z]{3}", text) and key not in SAME
    }
    assert unexpected == {}
