"""The list of events: the wall's clock, what is selected, what is written down."""

from __future__ import annotations

import csv
import io
import json

import pytest

from m100link.apps.agent.messages import Event
from m100link.apps.station.console.view.events import LEVELS, MIME, Diary, Format, export, select
from m100link.apps.station.console.view.units import Language
from m100link.apps.station.console.view.words import Speaker, say

WALL = 1_800_000_000.0  # 2027-01-15 08:00 UTC
ENGLISH, GERMAN = Speaker(), Speaker(Language.GERMAN)


def diary() -> Diary:
    one = Diary()
    one.take(
        [Event(1, 10.0, "info", "connected"), Event(2, 12.5, "error", "connection lost: cable")],
        now=20.0,
        wall=WALL,
    )
    one.write(say("alarms.gps"), WALL + 1.0, "warning")
    return one


def test_an_event_has_the_time_of_the_wall_and_is_taken_once() -> None:
    one = diary()
    one.take([Event(2, 12.5, "error", "connection lost: cable")], now=30.0, wall=WALL + 7.0)
    assert [line.at - WALL for line in one.lines] == [-10.0, -7.5, 1.0]
    assert [line.number for line in one.lines] == [1, 2, 3]


def test_a_clock_that_is_set_moves_no_event() -> None:
    one = diary()
    one.take([Event(3, 21.0, "info", "later")], now=21.0, wall=WALL + 3600.0)
    assert [line.at - WALL for line in one.lines] == [-10.0, -7.5, 1.0, 3600.0]


def test_very_many_events_are_bounded() -> None:
    one = Diary()
    one.take([Event(number, 0.0, "info", "") for number in range(1, 3000)], 0.0, WALL)
    assert len(one.lines) == 1000
    assert one.lines[-1].number == 2999


@pytest.mark.parametrize(
    ("least", "words", "numbers"),
    [
        ("info", "", [1, 2, 3]),
        ("warning", "", [2, 3]),
        ("error", "", [2]),
        ("info", "CABLE", [2]),
        ("info", "lost cable", [2]),
        ("info", "cable nothing", []),
        ("warning", "gps", [3]),
    ],
)
def test_lines_are_selected_by_level_and_words(least: str, words: str, numbers: list[int]) -> None:
    chosen = select(diary().lines, ENGLISH, least=least, words=words)
    assert [line.number for line in chosen] == numbers


def test_words_are_found_in_the_language_that_is_shown() -> None:
    assert len(select(diary().lines, GERMAN, words="schwach")) == 1
    assert select(diary().lines, ENGLISH, words="schwach") == []


def test_the_list_as_text_has_the_operators_clock() -> None:
    assert export(diary().lines, Format.TEXT, GERMAN, utc_offset_min=60) == (
        "2027-01-15T08:59:50.000+01:00  info     connected\n"
        "2027-01-15T08:59:52.500+01:00  error    connection lost: cable\n"
        "2027-01-15T09:00:01.000+01:00  warning  GPS ist schwach: das Fluggerät kann abtreiben\n"
    )


def test_the_list_as_json_and_as_a_table_hold_the_same() -> None:
    rows = json.loads(export(diary().lines, Format.JSON, ENGLISH, -90))
    table = csv.DictReader(io.StringIO(export(diary().lines, Format.CSV, ENGLISH, -90)))
    assert rows == list(table)
    assert rows[0] == {
        "time": "2027-01-15T06:29:50.000-01:30",
        "level": "info",
        "source": "station",
        "text": "connected",
    }
    assert [row["source"] for row in rows] == ["station", "station", "page"]


@pytest.mark.parametrize("name", ["=1+1", "+cmd", "-2", "@sum", "\tx", 'say "hi", all'])
def test_what_strangers_wrote_is_no_formula(name: str) -> None:
    one = Diary()
    one.take([Event(1, 0.0, "info", name)], 0.0, WALL)
    [row] = csv.DictReader(io.StringIO(export(one.lines, Format.CSV, ENGLISH)))
    assert row["text"].lstrip("'") == name
    assert row["text"][0] not in "=+-@\t"


def test_every_format_has_a_type_and_every_level_words() -> None:
    assert set(MIME) == set(Format)
    assert {Speaker()(say(f"events.level.{level}")) for level in LEVELS} == {
        "all",
        "warnings",
        "errors",
    }
