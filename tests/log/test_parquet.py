"""The same numbers in Parquet, CSV and the samples: DuckDB and Python's csv are the judges."""

from __future__ import annotations

import csv
import io
import math
import sys
from pathlib import Path

import pytest

from m100link import Position, Velocity
from m100link.errors import UsageError
from m100link.log import read
from m100link.log.reading import write_parquet
from tests.log.flight import flown

pytestmark = pytest.mark.anyio


async def test_duckdb_and_csv_give_the_sums_of_the_samples(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `analysis` is not installed")
    duckdb = pytest.importorskip("duckdb", reason="the judge is not installed")
    await flown(tmp_path / "flight.mcap")
    flight = read(tmp_path / "flight.mcap")
    path = tmp_path / "flight.parquet"
    with path.open("xb") as stream:
        count = write_parquet(flight, stream)
    table = flight.table()
    assert count == len(table) == sum(1 for _ in flight.samples())
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(table.names)
    writer.writerows(["" if math.isnan(value) else value for value in row] for row in table.rows)
    rows = list(csv.DictReader(io.StringIO(text.getvalue())))
    for name in table.names:
        known = [value for value in table.column(name) if not math.isnan(value)]
        query = f"""select count("{name}"), sum("{name}"), max("{name}") from '{path}'"""
        [(found, total, largest)] = duckdb.sql(query).fetchall()
        assert found == len(known), name
        assert (total or 0.0) == pytest.approx(math.fsum(known), rel=1e-12), name
        assert largest == max(known, default=None), name
        told = [float(row[name]) for row in rows if row[name]]
        assert math.fsum(told) == math.fsum(known), name


async def test_columns_can_be_chosen(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `analysis` is not there")
    await flown(tmp_path / "flight.mcap")
    stream = io.BytesIO()
    write_parquet(read(tmp_path / "flight.mcap"), stream, Position, Velocity)
    found = parquet.read_table(io.BytesIO(stream.getvalue()))
    assert "position.height_m" in found.column_names
    assert not [name for name in found.column_names if name.startswith("battery")]


def test_without_pyarrow_it_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    (tmp_path / "flight.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(UsageError, match="pyarrow") as caught:
        write_parquet(read(tmp_path / "flight.mcap"), io.BytesIO())
    assert "m100link log csv" in str(caught.value)
