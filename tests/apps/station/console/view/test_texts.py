"""The texts: every one in each language with the same braces, every key in use, and units."""

from __future__ import annotations

import ast
import json
import re
import string
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link import errors
from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.apps.station.console.tab import Fate
from m100link.apps.station.console.view.texts import (
    DisplaySettings,
    Language,
    LengthUnit,
    Quantity,
    QuantityKind,
    SpeedUnit,
    Theme,
    Translator,
    Units,
    for_browser,
    number,
    problem_text,
    reason_text,
    tr,
    translations,
)
from m100link.apps.station.web.tiles import TileFault
from m100link.errors import (
    AuthorityLost,
    GuardRefused,
    LossReason,
    M100Error,
    NotActivated,
    PortBusy,
)

CONSOLE = Path(__file__).parents[5] / "m100link/apps/station/console"
KEY = r"[a-z_]+(\.[a-z_]+)+(?<!\.js)"
ENGLISH_TEXTS, GERMAN_TEXTS = translations(Language.ENGLISH), translations(Language.GERMAN)
PREFIXES = tuple({f"{key.partition('.')[0]}." for key in ENGLISH_TEXTS})


def braces(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}


def sources() -> Iterator[ast.AST]:
    for path in CONSOLE.rglob("*.py"):
        yield from ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def test_there_is_a_file_for_each_language_and_no_other() -> None:
    assert {path.name for path in (CONSOLE / "texts").iterdir()} == {
        f"{language.value}.toml" for language in Language
    }


def test_each_language_has_each_key_in_the_same_order_and_with_the_same_braces() -> None:
    for language in Language:
        texts = translations(language)
        assert list(texts) == list(ENGLISH_TEXTS)
        for key, text in texts.items():
            assert text.strip() == text != "", key
            assert braces(text) == braces(ENGLISH_TEXTS[key]), key
            assert not any(name == "" or name.isdigit() for name in braces(text)), key


def test_every_text_that_is_said_is_in_the_files_and_filled_as_it_wants() -> None:
    wrong = []
    for node in sources():
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            is_key = node.value.startswith(PREFIXES) and re.fullmatch(KEY, node.value)
            if is_key and node.value not in ENGLISH_TEXTS:
                wrong.append(f"unknown: {node.value}")
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "tr" and node.args:
            [key] = node.args
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                given = {keyword.arg for keyword in node.keywords}
                if given != braces(ENGLISH_TEXTS[key.value]):
                    wrong.append(f"{key.value} is filled with {given}")
    assert wrong == []


def test_a_speaker_fills_in_numbers_quantities_and_other_texts() -> None:
    english, german = Translator(), Translator(Language.GERMAN, Units(LengthUnit.FOOT))
    near = tr("alarms.guard_near.height", value=Quantity.length(46.2), limit=Quantity.length(50.0))
    assert english(near) == "Near the limit: height 46 m of 50 m"
    assert german(near) == "Nahe der Grenze: Höhe 152 ft von 164 ft"
    waiting = tr("unit.seconds", seconds=1.5)
    assert (english(waiting), german(waiting)) == ("1.5 s", "1,5 s")
    inner = tr("alarms.passed", alarm=tr("alarms.gps"))
    assert german(inner) == "GPS ist schwach: das Fluggerät kann abtreiben (vorbei)"


def test_what_strangers_wrote_is_not_taken_for_braces() -> None:
    taken = tr("alarms.lease_taken.taken", name="{0.__class__} {name}")
    assert Translator()(taken) == "{0.__class__} {name} took control from you"


def test_the_page_gets_its_words_its_units_and_its_decimal_sign() -> None:
    told: dict[str, Any] = for_browser(
        Translator(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    )
    assert told["speed"] == [3.6, "km/h"]
    assert told["length"] == [pytest.approx(3.2808, abs=1e-4), "ft"]
    assert (told["point"], told["words"]["old"]) == (",", "alt")


def test_what_the_page_asks_for_is_what_it_gets() -> None:
    told: dict[str, Any] = for_browser(Translator())
    asked = {f"fate_{fate}" for fate in Fate}  # by their names, in steer.js
    asked |= {f"tiles_{fault}" for fault in TileFault}  # as the station found them
    for path in (CONSOLE / "static").glob("*.js"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if re.search(r"\b(words|go)\(", line) or "? " in line:
                asked |= set(re.findall(r'"([a-z_]{3,})"', line))
    assert set(told["words"]) - asked == set()
    for path in (CONSOLE / "static").glob("*.js"):
        for key in re.findall(r'\bwords\("(\w+)"', path.read_text(encoding="utf-8")):
            assert key in told["words"]


SAME = (
    *(
        "actions.stop",
        "click.radius",
        "plan.radius",
        "link.firmware",
        "link.jitter",
        "link.cause.version",
    ),
    *("plan.title", "plan.radius", "actions.pause", "plan.mission", "plan.actions_hint"),
    *("plots.csv", "plots.item.position", "plots.item.magnetometer", "plots.field.phase"),
    *("settings.language.en", "settings.language.de", "settings.gamepad"),
    *("alarms.event.raised", "checklist.gps", "instruments.device.app"),
)
"""What reads the same in both languages: names, and words that German has as well."""


def test_what_has_letters_is_another_text_in_german() -> None:
    same = [key for key, text in ENGLISH_TEXTS.items() if text == GERMAN_TEXTS[key]]
    plain = {key: re.sub(r"{.*?}", "", ENGLISH_TEXTS[key]) for key in same}
    unexpected = {
        key: text
        for key, text in plain.items()
        if re.search("[A-Za-z]{3}", text) and key not in SAME
    }
    assert unexpected == {}


# -- lengths and speeds in each unit ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "text"), [(LengthUnit.METRE, "30.5 m"), (LengthUnit.FOOT, "100.0 ft")]
)
def test_a_height_in_each_unit(unit: LengthUnit, text: str) -> None:
    assert Units(length=unit).text(Quantity.length(30.48, 1)) == text


@pytest.mark.parametrize(
    ("unit", "text"),
    [(SpeedUnit.M_S, "10.0 m/s"), (SpeedUnit.KM_H, "36.0 km/h"), (SpeedUnit.KNOT, "19.4 kn")],
)
def test_a_speed_in_each_unit(unit: SpeedUnit, text: str) -> None:
    assert Units(speed=unit).text(Quantity.speed(10.0)) == text


@pytest.mark.parametrize(
    ("units", "shown", "kind", "si"),
    [
        (Units(), 40.0, QuantityKind.LENGTH, 40.0),
        (Units(LengthUnit.FOOT), 40.0, QuantityKind.LENGTH, 12.192),
        (Units(), 5.0, QuantityKind.SPEED, 5.0),
        (Units(speed=SpeedUnit.KM_H), 36.0, QuantityKind.SPEED, 10.0),
        (Units(speed=SpeedUnit.KNOT), 18.0, QuantityKind.SPEED, 9.26),
    ],
)
def test_what_is_typed_in_a_unit_is_flown_in_metres(
    units: Units, shown: float, kind: QuantityKind, si: float
) -> None:
    assert units.to_si(shown, kind) == pytest.approx(si, rel=1e-9)
    assert units.convert(si, kind) == pytest.approx(shown, rel=1e-9)


def test_what_rises_has_a_plus_and_a_zero_has_no_minus() -> None:
    units = Units()
    assert units.text(Quantity.speed(1.26, signed=True)) == "+1.3 m/s"
    assert units.text(Quantity.speed(-1.26, signed=True)) == "-1.3 m/s"
    assert units.text(Quantity.speed(-0.01, signed=True)) == "+0.0 m/s"
    assert number(-0.01, 1) == "0.0"


def test_a_german_number_has_a_comma() -> None:
    assert number(1.5, 1, Language.GERMAN) == "1,5"
    assert Units().text(Quantity.length(1.5, 1), Language.GERMAN) == "1,5 m"


def test_every_unit_converts_and_has_a_sign() -> None:
    for length in LengthUnit:
        for speed in SpeedUnit:
            units = Units(length, speed)
            assert units.convert(1.0, QuantityKind.LENGTH) > 0
            assert units.convert(1.0, QuantityKind.SPEED) > 0
            assert (units.unit(QuantityKind.LENGTH), units.unit(QuantityKind.SPEED)) == (
                length.value,
                speed.value,
            )


# -- errors in the language of the operator --------------------------------------------------------

ENGLISH, GERMAN = Translator(), Translator(Language.GERMAN)

CLASSES = [
    one
    for name in vars(errors)["__all__"]
    if isinstance(one := getattr(errors, name), type) and issubclass(one, M100Error)
]


def made(kind: type[M100Error]) -> M100Error:
    error = kind.__new__(kind)
    M100Error.__init__(error, "it was seen", cause="a cause", remedy="a remedy")
    vars(error)["guard"] = ""
    return error


@pytest.mark.parametrize("kind", [*CLASSES, LeaseRefused, LeaseHeld])
def test_every_class_is_said_in_german_with_its_original(kind: type[M100Error]) -> None:
    error = made(kind)
    assert ENGLISH(problem_text(error)) == str(error)
    assert ENGLISH(reason_text(error)) == "it was seen"
    meaning, _, original = GERMAN(problem_text(error)).partition("\n")
    assert original == str(error)
    assert meaning != ""


@pytest.mark.parametrize(
    ("error", "meaning"),
    [
        (AuthorityLost("gone", reason=LossReason.APP), "Die Steuerung ist verloren"),
        (NotActivated("0xFF01", command="take off", code=0xFF01), "ist nicht aktiviert"),
        (PortBusy("busy"), "Die Leitung zum Fluggerät ist gestört"),  # as its base
        (GuardRefused("far", guard="envelope"), "Die Grenzen erlauben das nicht"),
        (GuardRefused("no", guard="one that is new"), "Abgelehnt, geflogen wurde es nicht"),
        (M100Error("{0} {name}"), "Das ging nicht"),  # no braces are filled in what was seen
    ],
)
def test_the_nearest_meaning_is_said(error: M100Error, meaning: str) -> None:
    assert meaning in GERMAN(problem_text(error))
    assert error.seen in GERMAN(reason_text(error))


# -- what the browser keeps ------------------------------------------------------------------------


def test_whatever_was_chosen_comes_back() -> None:
    for language, length, speed, theme, sound, speech in product(
        Language, LengthUnit, SpeedUnit, Theme, (False, True), (False, True)
    ):
        chosen = DisplaySettings(language, length, speed, theme, sound, speech, "Anna")
        assert DisplaySettings.from_text(chosen.to_text()) == chosen
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
    assert DisplaySettings.from_text(kept) == DisplaySettings()


def test_what_can_be_read_is_kept_beside_what_cannot() -> None:
    kept = '{"language": "de", "length": "mile", "sound": false, "name": "' + "x" * 100 + '"}'
    assert DisplaySettings.from_text(kept) == DisplaySettings(
        language=Language.GERMAN, sound=False, name="x" * 64
    )


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=5,
)


@given(
    st.text()
    | st.dictionaries(st.sampled_from([*DisplaySettings.__slots__]), _JSON).map(json.dumps)
)
def test_nonsense_raises_nothing(kept: str) -> None:
    assert isinstance(DisplaySettings.from_text(kept), DisplaySettings)
