"""Texts of others: whatever is wrong with one is a ValueError."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from m100link.errors.texts import (
    printable,
    read_json,
    read_path,
    read_toml,
    shortened,
    without_nan,
)
from tests import limits
from tests.test_house import PACKAGE, ROOT


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"a":' * 100_000,
        "9" * 301,
        "9" * 5000,
        '{"a": -' + "9" * 400 + "}",
        '"\\ud800"',
        '{"\\uDC00": 1}',
        "\ud800",
        '"\ud800"',
        b'"\xed\xa0\x80"',
        b"\xff",
        b"\xff\xfe1\x00",  # JSON is UTF-8 (RFC 8259, 8.1)
        "",
        "{",
    ],
)
def test_what_is_wrong_with_json_is_a_value_error(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_json(text)


def test_json_has_null_for_what_is_no_number() -> None:
    inf = float("inf")
    value = {"a": float("nan"), 2: (inf, -inf, -2.5), "c": [True, None, "nan", {"d": inf}]}
    plain = {"a": None, "2": [None, None, -2.5], "c": [True, None, "nan", {"d": None}]}
    assert without_nan(value) == plain


def test_json_is_read_as_it_is_meant() -> None:
    whole = "9" * 300
    assert read_json(b'{"a": [1, 2.5, null, true], "b": "\xc3\xa4"}') == {
        "a": [1, 2.5, None, True],
        "b": "ä",
    }
    assert read_json(whole) == int(whole)
    assert read_json('"\\ud83d\\ude00"') == "\U0001f600"
    assert read_json('"' + "9" * 500 + '"') == "9" * 500
    assert read_json('[{"a": 1}]', pairs=tuple) == [(("a", 1),)]
    assert read_json("NaN", constant=lambda name: name) == "NaN"


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000,
        "a = " + "{b=" * 5000,
        "a = " + "9" * 5000,
        "a = 0x" + "f" * 400,
        "a = [{b = 0x" + "f" * 400 + "}]",
        "a",
        b"a = '\xff'",
    ],
)
def test_what_is_wrong_with_toml_is_a_value_error(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_toml(text)


@pytest.mark.parametrize("sign", ["", "-"])
@pytest.mark.parametrize("reads", [read_json, lambda text: read_toml(f"a = {text}")["a"]])
def test_an_integer_that_no_float_holds_is_refused_on_both_sides_of_0(
    reads: Callable[[str], object], sign: str
) -> None:
    """A float holds up to 308 digits; what comes behind would raise an OverflowError."""
    largest = sign + "9" * 270
    assert reads(largest) == int(largest)
    with pytest.raises(ValueError, match="an integer"):
        reads(sign + "9" * 309)


def test_toml_is_read_as_it_is_meant() -> None:
    assert read_toml(b'a = 0x10\n[b]\nc = [1.5, "\xc3\xa4"]') == {"a": 16, "b": {"c": [1.5, "ä"]}}


def test_a_home_of_nobody_stays_as_it_is() -> None:
    assert read_path("~nobody_of_that_name/x") == Path("~nobody_of_that_name/x")
    assert read_path("~/x") == Path.home() / "x"


def test_a_text_of_a_stranger_is_one_line_that_no_terminal_obeys() -> None:
    assert printable("Ann\u00e9 3 \u00b0") == "Ann\u00e9 3 \u00b0"
    assert printable("a\x1b[2Jb\nc\u202ed\x9be\ud800") == "a\ufffd[2Jb\ufffdc\ufffdd\ufffde\ufffd"


def test_nothing_else_in_the_package_parses_texts() -> None:
    """Each place that did forgot one of the errors."""
    words = ("json.loads", "json.load(", "tomllib", ".expanduser(", "JSONDecoder")
    found = {
        f"{path.relative_to(ROOT)}: {word}"
        for path in PACKAGE.rglob("*.py")
        for word in words
        if word in path.read_text(encoding="utf-8") and path.name != "texts.py"
    }
    assert found == set()


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("errors") == []


@pytest.mark.parametrize(("length", "said"), [(0, ""), (10, "x" * 10), (11, "x" * 7 + "...")])
def test_a_text_that_is_cut_says_so(length: int, said: str) -> None:
    assert shortened("x" * length, 10) == said
