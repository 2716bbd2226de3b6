"""Layouts of records: every value comes back, what is outside is named, people read degrees."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from m100link.errors import BadValue, LayoutMismatch
from m100link.protocol import fields as parts
from m100link.protocol.fields import (
    Layout,
    Nibbles,
    Number,
    Numbers,
    Record,
    Reserved,
    latitude,
    longitude,
)
from m100link.protocol.firmware import PROFILES
from m100link.protocol.packet import TelemetryPacket
from tests import limits
from tests.known import package


@dataclass(frozen=True)
class Example(Record):
    LAYOUT: ClassVar[Layout] = Layout(
        Number("choice", words=("left", "right")),
        latitude(),
        longitude(),
        Number("height", "f", -200.0, 500.0, "m"),
        Number("damping", "f", 0.2, 10.0, "m", besides=(0.0,)),
        Number("any_float", "f"),
        Number("word", "h", unit="°"),
        Reserved(3),
        Nibbles("low", "high"),
        Numbers("list", 2, Number("each", "B", 0, 5)),
        Number("radius_cm", "H", unit="cm"),
        Number("rate", unit="0.1 °/s"),
    )

    choice: int = 1
    latitude: float = 0.5
    longitude: float = -0.5
    height: float = 20.0
    damping: float = 0.0
    any_float: float = 1.5
    word: int = -3
    low: int = 2
    high: int = 11
    list: tuple[int, ...] = (1, 5)
    radius_cm: int = 2850
    rate: int = 115


def test_bytes_and_back() -> None:
    written = Example().to_wire("example")
    assert len(written) == Example.LAYOUT.size == 1 + 16 + 12 + 2 + 3 + 1 + 2 + 2 + 1
    assert Example.from_wire(written) == Example()
    assert written[31:35] == b"\0\0\0\xb2"


def test_reserved_bytes_are_ignored() -> None:
    written = bytearray(Example().to_wire("example"))
    written[31:34] = b"\xff\xff\xff"
    assert Example.from_wire(bytes(written)) == Example()


def test_raw_is_the_wire_with_lists_as_lists() -> None:
    raw = Example().raw()
    assert raw["list"] == [1, 5]
    assert (raw["low"], raw["high"], raw["word"]) == (2, 11, -3)
    assert list(raw) == [field.name for field in fields(Example)]


def test_people_read_degrees_metres_and_words() -> None:
    shown = Example().shown()
    assert shown["choice"] == "right"
    assert shown["latitude_deg"] == pytest.approx(math.degrees(0.5))
    assert shown["height_m"] == 20.0
    assert shown["radius_m"] == 28.5
    assert shown["rate_deg_s"] == 11.5
    assert Example(choice=7).shown()["choice"] == 7


@pytest.mark.parametrize(
    ("change", "field", "limit"),
    [
        ({"choice": 2}, "choice", "0 left, 1 right"),
        ({"latitude": 1.6}, "latitude", "-1.5708 to 1.5708 rad"),
        ({"latitude": math.nan}, "latitude", "-1.5708 to 1.5708 rad"),
        ({"longitude": -math.inf}, "longitude", "-3.14159 to 3.14159 rad"),
        ({"height": 500.1}, "height", "-200 to 500 m"),
        ({"damping": 0.1}, "damping", "0 or 0.2 to 10 m"),
        ({"any_float": math.inf}, "any_float", "a finite number"),
        ({"any_float": 3.5e38}, "any_float", "a finite number"),
        ({"word": 1.5}, "word", "-32768 to 32767 °"),
        ({"word": 40000}, "word", "-32768 to 32767 °"),
        ({"low": 16}, "low", "0 to 15"),
        ({"list": (1, 6)}, "list[1]", "0 to 5"),
        ({"list": (1,)}, "list", "2 numbers"),
        ({"rate": -1}, "rate", "0 to 255 0.1 °/s"),
    ],
)
def test_what_is_outside_is_named_and_not_written(
    change: dict[str, Any], field: str, limit: str
) -> None:
    record = Example(**change)
    [problem] = record.problems()
    assert (problem.field, problem.limit) == (field, limit)
    with pytest.raises(BadValue, match="cannot be sent") as caught:
        record.to_wire("example")
    error = caught.value
    assert (error.field, error.limit) == (field, limit)
    assert error.value is problem.value
    assert str(error).startswith(f"example: {field} ")
    assert limit in str(error)
    assert field in str(problem)


@pytest.mark.parametrize(
    ("part", "limit"),
    [
        (Number("speed", "f", 0.0, 15.0, "m/s"), "0 to 15 m/s"),
        (Number("frequency", "I"), "0 to 4294967295"),
        (Number("mode", words=("off", "on")), "0 off, 1 on"),
        (Numbers("actions", 16, Number("action", "B", 0, 5)), "each 0 to 5"),
        (Nibbles("count", "repeat"), "low and high four bits, each 0 to 15"),
        (Reserved(8), "sent as 0, ignored"),
    ],
)
def test_each_part_says_what_it_may_be(
    part: Number | Numbers | Nibbles | Reserved, limit: str
) -> None:
    assert part.limit == limit


def test_single_numbers_are_found_by_their_names_the_halves_of_a_byte_too() -> None:
    layout = Layout(Number("a", "h", -1, 1), Reserved(2), Nibbles("low", "high"))
    assert {name: number.bounds for name, number in layout.numbers.items()} == {
        "a": (-1, 1),
        "low": (0, 15),
        "high": (0, 15),
    }


def test_a_number_without_a_documented_range_ends_where_its_type_does() -> None:
    """By the standard sizes of struct, and IEEE 754."""
    single, double = 2.0**127 * (2 - 2.0**-23), 2.0**1023 * (2 - 2.0**-52)
    ends: dict[str, tuple[float, float]] = {
        "b": (-0x80, 0x7F),
        "B": (0, 0xFF),
        "h": (-0x8000, 0x7FFF),
        "H": (0, 0xFFFF),
        "i": (-0x8000_0000, 0x7FFF_FFFF),
        "I": (0, 0xFFFF_FFFF),
        "f": (-single, single),
        "d": (-double, double),
    }
    assert {letter: Number("", letter).bounds for letter in ends} == ends
    for letter, (low, high) in ends.items():
        assert Number("", letter, low / 2, high / 2).bounds == (low / 2, high / 2)


def test_words_halves_and_places_end_where_the_documents_end_them() -> None:
    """A number behind the last word is shown as it came; a half has four bits, a latitude 90°."""
    layout = parts.Layout(parts.Number("kind", words=("a", "b")), parts.Nibbles("low", "high"))
    for value, shown in ((1, "b"), (2, 2), (255, 255)):
        record = SimpleNamespace(**layout.read(bytes((value, 0x9F))))
        assert layout.shown(record) == {"kind": shown, "low": 15, "high": 9}
    assert parts.latitude().bounds == (-math.pi / 2, math.pi / 2)
    assert parts.longitude().bounds == (-math.pi, math.pi)


@pytest.mark.parametrize("change", [-1, 1])
def test_a_package_is_as_long_as_its_flags_say_however_often_they_were_seen(change: int) -> None:
    whole = package("3.1")
    assert TelemetryPacket(whole, PROFILES["3.1"]).value == whole
    wrong = whole[:-1] if change < 0 else whole + b"\0"
    with pytest.raises(LayoutMismatch):
        TelemetryPacket(wrong, PROFILES["3.1"])


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("protocol") == []
