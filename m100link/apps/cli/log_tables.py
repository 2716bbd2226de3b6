"""``m100link log csv`` and ``parquet``: telemetry as tables, a row per package."""

from __future__ import annotations

import contextlib
import csv as csv_module
import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated

from cyclopts import Parameter

from m100link.apps.cli.common import out
from m100link.apps.cli.log_plot import new_file
from m100link.apps.cli.options import Firmware, offered
from m100link.apps.cli.progress import reading, status
from m100link.apps.cli.values import items_named
from m100link.log.parquet import write_parquet
from m100link.protocol.items import BY_NAME

__all__ = ["csv", "parquet"]


def csv(
    file: Path,
    /,
    *items: Annotated[str, offered(BY_NAME)],
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
    firmware: Firmware | None = None,
) -> int:
    """Print telemetry as CSV: every package, decoded from its bytes.

    Columns are those of ``m100link echo --csv``; what a package does not have is empty.

    Args:
        file: The log.
        items: Item names, such as position; all without one.
        output: A file instead of standard output.
        firmware: Profile to read it by; by default that of the flight.
    """
    records = items_named(items)
    with reading(file) as flight, contextlib.ExitStack() as stack:
        names, rows = flight.rows(*records, firmware=firmware)
        stream: IO[str] = sys.stdout
        if output is not None:
            stream = stack.enter_context(_new_text(output))
        writer = csv_module.writer(stream, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            writer.writerow("" if value != value else round(value, 9) for value in row)
    return status(flight)


@contextlib.contextmanager
def _new_text(path: Path) -> Iterator[IO[str]]:
    with new_file(path) as stream:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
        yield text
        text.flush()
        text.detach()


def parquet(
    file: Path,
    /,
    *items: Annotated[str, offered(BY_NAME)],
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
    firmware: Firmware | None = None,
) -> int:
    """Write telemetry as a Parquet file: every package, decoded from its bytes.

    Columns are those of ``m100link log csv``; what a package does not have is null.

    Args:
        file: The log.
        items: Item names, such as position; all without one.
        output: A new file; by default FILE with .parquet.
        firmware: Profile to read it by; by default that of the flight.
    """
    records = items_named(items)
    target = output or file.with_suffix(".parquet")
    with reading(file) as flight, new_file(target) as stream:
        count = write_parquet(flight, stream, *records, firmware=firmware)
    out.print(f"{count} rows in {target}", soft_wrap=True)
    return status(flight)
