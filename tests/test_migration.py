"""The page on the way from 0.2 to 1.0: each pair of its tables is run."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import m100link

pytest.importorskip("cyclopts")
from cyclopts import CycloptsError

from m100link.apps.cli.app import _FORMER, _renamed, app
from m100link.apps.cli.serve import StationOptions, aircraft_of
from m100link.errors import UsageError

PAGE = (Path(__file__).parents[1] / "docs/howto/move-from-0-2.md").read_text(encoding="utf-8")


def table(heading: str) -> list[list[str]]:
    """The rows below a heading: code of each cell, or its words."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*) \|$", section, re.MULTILINE)
    assert rows, heading
    return [
        [(re.findall("`(.*?)`", cell) or [cell])[0] for cell in row.split(" | ")] for row in rows
    ]


COMMANDS, MODULES = table("Command lines"), table("Modules")
KEPT, GONE = table("Names that still work"), table("Names that are gone")


def understood(words: list[str]) -> tuple[Any, ...]:
    """The verb and its arguments."""
    command, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
    return command, bound.arguments


@pytest.mark.parametrize(("before", "after", "fate"), COMMANDS, ids=[row[0] for row in COMMANDS])
def test_a_command_line_of_0_2_means_the_new_one_or_is_refused(
    before: str, after: str, fate: str, caplog: pytest.LogCaptureFixture
) -> None:
    _, *old = shlex.split(before)
    _, *new = shlex.split(after)
    if fate == "refused":
        with pytest.raises(CycloptsError):
            understood(_renamed(old))
        assert not caplog.records
        understood(new)
    else:
        assert fate == "warns"
        assert understood(_renamed(old)) == understood(new)
        assert len(caplog.records) == 1


def test_each_renamed_option_has_a_row() -> None:
    rows = [shlex.split(before)[1:] for before, *_ in COMMANDS]
    for verb, renamed in _FORMER.items():
        for option in renamed:
            assert any(words[0] == verb and option in words for words in rows), (verb, option)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("form", [" ", "="])
def test_an_old_name_beside_that_of_today_is_refused(form: str, order: int) -> None:
    """Neither value wins in silence. Items of a list are all kept, and two aircraft are two."""
    values = {"--item-rate": ("a=1", "b=2"), "": ("one=sim://", "two=sim://")}
    for verb, renamed in _FORMER.items():
        for option, today in renamed.items():
            old, new = values.get(today, ("3", "4"))
            both = [f"{option}{form}{old}", f"{today}{form}{new}" if today else new][::order]
            words = _renamed([verb, *" ".join(both).split()])
            if today not in values:
                with pytest.raises(CycloptsError, match="multiple times"):
                    understood(words)
                continue
            understood(words)
            assert "".join(words).count(old) == "".join(words).count(new) == 1


def test_a_file_of_settings_that_only_0_2_reads_is_no_silent_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without its limits, token and certificate the station would serve by others."""
    monkeypatch.setenv("M100LINK_CONFIG", "station.toml")
    with pytest.raises(UsageError, match="M100LINK_CONFIG names a file"):
        aircraft_of(StationOptions(), ["sim://"])


LOOK = """
import importlib, json, sys, warnings
told = {}
for old, now in json.loads(sys.argv[1]):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        same = importlib.import_module(old) is importlib.import_module(now)
    told[old] = same, sorted({str(one.message) for one in heard if f"{old} is" in str(one.message)})
print(json.dumps(told))
"""


def test_a_module_of_0_2_is_that_of_today_and_warns_as_the_page_says() -> None:
    pairs = json.dumps([row[:2] for row in MODULES])
    asked = subprocess.run(
        [sys.executable, "-c", LOOK, pairs], capture_output=True, text=True, check=True
    )
    for (old, now, fate), (name, (same, warned)) in zip(
        MODULES, json.loads(asked.stdout).items(), strict=True
    ):
        assert (name, same) == (old, True)
        assert warned == ([f"{old} is {now} now"] if fate == "warns" else []), old


def test_each_module_that_moved_since_0_2_has_a_row() -> None:
    listed = {row[0].removeprefix("m100link.") for row in MODULES}
    since = {"doctor", "fleet"}  # documented under the short name
    assert m100link._MOVED.keys() - since | m100link._JOINED.keys() <= listed


def found(name: str) -> Any:
    """The value of this name."""
    parts = name.split(".")
    for at in range(len(parts) - 1, 0, -1):
        try:
            value: Any = importlib.import_module(".".join(parts[:at]))
        except ImportError:
            continue
        for part in parts[at:]:
            value = getattr(value, part)
        return value
    raise ImportError(name)


@pytest.mark.filterwarnings("ignore:m100link:DeprecationWarning")
@pytest.mark.parametrize(("old", "now"), KEPT)
def test_a_name_that_is_kept_is_that_of_today(old: str, now: str) -> None:
    assert found(old) is found(now)


@pytest.mark.filterwarnings("ignore:m100link:DeprecationWarning")
@pytest.mark.parametrize(("old", "now"), GONE)
def test_a_name_that_is_gone_has_the_place_that_the_page_names(old: str, now: str) -> None:
    assert found(now) is not None
    with pytest.raises((ImportError, AttributeError)):
        found(old)
