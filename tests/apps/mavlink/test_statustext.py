"""Texts as common.xml has them: 50 characters, parts in order, and never a flood."""

from __future__ import annotations

import pytest

from m100link.apps.mavlink.translator.numbers import Severity
from m100link.apps.mavlink.translator.telemetry import Texts, severity_of


def told(text: str) -> list[tuple[str, int]]:
    one = Texts()
    one.tell(Severity.WARNING, text)
    found = list(one.due(1.0))
    assert {message["severity"] for message in found} == {4}
    assert len({message.fields.get("id", 0) for message in found}) == 1
    return [(message["text"], message.fields.get("chunk_seq", 0)) for message in found]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("short", ["short"]),
        ("a" * 50, ["a" * 50]),
        ("a" * 50 + "b", ["a" * 50, "b"]),
        # one that is full is followed by another one: an empty one says that it is over
        ("a" * 50 + "b" * 50, ["a" * 50, "b" * 50, ""]),
        ("".join(f"{n:03d}-" for n in range(70)), None),
        ("two\n lines\t and  ü", ["two lines and ?"]),
    ],
)
def test_a_text_is_told_in_parts_of_fifty(text: str, parts: list[str] | None) -> None:
    expected = [text[begin : begin + 50] for begin in range(0, 200, 50)] if parts is None else parts
    assert told(text) == [(part, number) for number, part in enumerate(expected)]


def test_parts_of_one_text_have_a_number_of_their_own() -> None:
    one, numbers = Texts(), []
    for letter in "abc":
        one.tell(Severity.INFO, letter * 60)
        numbers += [message["id"] for message in one.due(1.0)]
    assert numbers == [1, 1, 2, 2, 3, 3]


def test_none_comes_twice_in_two_seconds_and_not_more_than_ten_a_second() -> None:
    one, count = Texts(), []
    for at in (10.0, 11.0, 11.9, 12.1):
        one.tell(Severity.ERROR, "again")
        count.append(len(list(one.due(at))))
    assert count == [1, 0, 0, 1]
    flood = Texts()
    for at in range(10):
        for number in range(100):
            flood.tell(Severity.INFO, f"{at} {number}")
        count.append(len(list(flood.due(100.0 + at))))
    assert count[4] == 20
    assert set(count[5:]) == {10}


@pytest.mark.parametrize(
    ("level", "severity"), [("info", 6), ("warning", 4), ("error", 3), ("another", 6)]
)
def test_how_bad_an_event_is(level: str, severity: int) -> None:
    assert severity_of(level) == severity
