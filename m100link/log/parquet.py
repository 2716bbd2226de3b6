"""Telemetry as a Parquet file, by pyarrow: for DuckDB, pandas, polars, Spark."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import islice
from typing import IO, Any

from m100link.errors import UsageError
from m100link.log.reading import FlightLog
from m100link.protocol.firmware import FirmwareProfile

_ROWS = 50_000  # of a part of the file, about 14 MB while it is made


def write_parquet(
    flight: FlightLog,
    stream: IO[bytes],
    *records: type[Any],
    firmware: str | FirmwareProfile | None = None,
) -> int:
    """Write a row per package, a column per number; null is what the package does not have.

    Args:
        flight: The log.
        stream: The file that takes the bytes.
        records: Record classes; none at all: every item.
        firmware: As for :meth:`FlightLog.samples`.

    Returns:
        How many rows.

    Raises:
        UsageError: pyarrow is not installed; no firmware is known.
    """
    try:
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise UsageError(
            "a Parquet file needs pyarrow, which is not installed",
            remedy="pip install '.[analysis]' in a clone of m100link; "
            "m100link log csv needs nothing",
        ) from None
    names, rows = flight.rows(*records, firmware=firmware)
    number = arrow.float64()
    schema = arrow.schema([(name, number) for name in names])
    count = 0
    with parquet.ParquetWriter(stream, schema, compression="zstd") as writer:
        while part := list(islice(rows, _ROWS)):
            count += len(part)
            columns = [
                arrow.array([None if math.isnan(value) else value for value in column], number)
                for column in zip(*part, strict=True)
            ]
            writer.write_table(arrow.table(columns, schema=schema))
    return count
