"""``m100link log csv`` and ``parquet`` as people type them, and the recipes of the manual."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from m100link.apps.cli.outcome import ExitCode
from tests.apps.cli.conftest import CommandLine

pytest.importorskip("mcap", reason="the extra `log` is not installed")

MANUAL = Path(__file__).parents[3] / "docs/howto/flight-logs.md"


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    path = tmp_path / "flight.mcap"
    assert cli("record", "sim://", "-o", str(path), "--duration", "0.5").status == ExitCode.OK
    return path


def test_parquet_holds_what_csv_holds(cli: CommandLine, flight: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `analysis` is not there")
    outcome = cli("log", "parquet", str(flight), "position")
    assert outcome.status == ExitCode.OK
    table = parquet.read_table(flight.with_suffix(".parquet"))
    rows = list(csv.DictReader(cli("log", "csv", str(flight), "position").out.splitlines()))
    assert table.column_names == list(rows[0])
    assert table.num_rows == len(rows)
    assert f"{len(rows)} rows in" in outcome.out


def test_a_file_that_is_there_stays(cli: CommandLine, flight: Path) -> None:
    there = flight.with_suffix(".parquet")
    there.write_bytes(b"mine")
    outcome = cli("log", "parquet", str(flight))
    assert outcome.status == ExitCode.USAGE
    assert "is there already" in outcome.err
    assert there.read_bytes() == b"mine"


def test_half_of_a_table_is_not_left_behind(cli: CommandLine, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `analysis` is not installed")
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"\x89MCAP0\r\n")  # no firmware is known
    for verb in ("parquet", "csv"):
        target = tmp_path / f"table.{verb}"
        outcome = cli("log", verb, str(junk), "-o", str(target))
        assert outcome.status == ExitCode.USAGE
        assert "firmware" in outcome.err
        assert not target.exists()


@pytest.mark.parametrize("library", ["pandas", "polars", "numpy"])
def test_the_recipes_of_the_manual_run(
    library: str, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(library, reason="only the recipe needs it")
    blocks = re.findall(r"```python\n(.*?)```", MANUAL.read_text("utf-8"), re.DOTALL)
    recipes = [block for block in blocks if f"import {library}\n" in block]
    assert recipes
    monkeypatch.chdir(flight.parent)
    for recipe in recipes:
        exec(compile(recipe, str(MANUAL), "exec"), {})
