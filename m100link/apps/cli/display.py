"""Pictures made of braille characters: a track seen from above, a value over time."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import IO, Annotated, Any

from cyclopts import Parameter
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from m100link.apps.cli.common import err
from m100link.apps.cli.options import offered
from m100link.apps.cli.terminal import ExitCode
from m100link.errors import UsageError
from m100link.log import FlightLog, read
from m100link.protocol.items import BY_NAME, BY_RECORD, ITEMS
from m100link.telemetry.columns import ITEM_NAMES

# Bit of each dot of a braille character, by row (0 to 3) and column (0 to 1).
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))

Point = tuple[float, float]


class _Canvas:
    """A grid of dots, two columns and four rows to a character; (0, 0) is at the bottom left."""

    def __init__(self, columns: int, rows: int) -> None:
        self.width, self.height = columns * 2, rows * 4
        self._cells = [[0] * columns for _ in range(rows)]
        self._words: dict[tuple[int, int], str] = {}

    def dot(self, x: int, y: int) -> None:
        if 0 <= x < self.width and 0 <= y < self.height:
            y = self.height - 1 - y
            self._cells[y // 4][x // 2] |= _DOTS[y % 4][x % 2]

    def line(self, x0: float, y0: float, x1: float, y1: float) -> None:
        steps = int(max(abs(x1 - x0), abs(y1 - y0))) + 1
        for step in range(steps + 1):
            part = step / steps
            self.dot(round(x0 + (x1 - x0) * part), round(y0 + (y1 - y0) * part))

    def write(self, x: float, y: float, word: str) -> None:
        """Put a word over the dots, from this one on, if no other word stands there or beside."""
        row = (self.height - 1 - round(y)) // 4
        column = min(round(x) // 2, self.width // 2 - len(word))
        taken = {(row, column + index) for index in range(-1, len(word) + 1)}
        if column >= 0 and not self._words.keys() & taken:
            for index, character in enumerate(word):
                self._words[row, column + index] = character

    def lines(self) -> list[str]:
        return [
            "".join(
                self._words.get((row, column), chr(0x2800 + cell))
                for column, cell in enumerate(cells)
            )
            for row, cells in enumerate(self._cells)
        ]


def _span(values: Iterable[float], at_least: float) -> tuple[float, float]:
    values = list(values)
    low, high = min(values), max(values)
    missing = at_least - (high - low)
    return (low, high) if missing <= 0 else (low - missing / 2, high + missing / 2)


def track_plot(
    points: Sequence[Point],  # north and east in metres
    *,
    columns: int = 44,
    rows: int = 16,
    names: Sequence[str] = (),
    marks: Sequence[tuple[Point, str]] = (),
) -> list[str]:
    """A track seen from above, equal scales, north up; names without room are left out."""
    canvas = _Canvas(columns, rows)
    everything = [*points, *(place for place, _ in marks)]
    if not everything:
        return canvas.lines()
    south, north = _span((p[0] for p in everything), 1.0)
    west, east = _span((p[1] for p in everything), 1.0)
    scale = min((canvas.width - 3) / (east - west), (canvas.height - 3) / (north - south))
    left = (canvas.width - (east - west) * scale) / 2
    bottom = (canvas.height - (north - south) * scale) / 2

    def dot(place: Point) -> Point:
        return left + (place[1] - west) * scale, bottom + (place[0] - south) * scale

    corners = [dot(place) for place in points]
    for (x0, y0), (x1, y1) in pairwise(corners):
        canvas.line(x0, y0, x1, y1)
    named = [*zip(corners, names, strict=False), *((dot(place), word) for place, word in marks)]
    for (x, y), name in named:
        canvas.write(x, y, name)
    pictured = canvas.lines()
    pictured.append(
        f"north up; {north - south:.1f} m north to south, {east - west:.1f} m east to west"
    )
    return pictured


def line_plot(
    points: Sequence[Point],  # time in seconds, and value
    *,
    unit: str = "",  # unit of the value, for the scale
    over: str = "s",
    columns: int = 44,  # width in characters, scale not included
    rows: int = 10,
) -> list[str]:
    """A value over time, or over something else."""
    canvas = _Canvas(columns, rows)
    if not points:
        return canvas.lines()
    first, last = _span((p[0] for p in points), 1e-3)
    low, high = _span((p[1] for p in points), 1e-3)
    dots = [
        (
            (t - first) / (last - first) * (canvas.width - 1),
            (value - low) / (high - low) * (canvas.height - 1),
        )
        for t, value in points
    ]
    for (x0, y0), (x1, y1) in pairwise(dots):
        canvas.line(x0, y0, x1, y1)
    labels = {0: f"{high:.2f}", rows - 1: f"{low:.2f}"}
    width = max(map(len, labels.values()))
    pictured = [
        f"{labels.get(row, ''):>{width}} ┤{line}" for row, line in enumerate(canvas.lines())
    ]
    whole = f"{last - first:.1f} {over}"
    pictured.append(f"{unit:>{width}}  0{whole:>{columns - 1}}")
    return pictured


# -- how far a log is read: a bar on a terminal, for what takes longer than a second ---------------


_PATIENCE_S = 1.0


def status(*flights: FlightLog) -> int:
    """The exit status of a verb that read logs; it fails for a damaged one."""
    return ExitCode.FAILED if any(flight.damage for flight in flights) else ExitCode.OK


@contextlib.contextmanager
def reading(file: Path) -> Iterator[FlightLog]:
    """A log; a terminal shows how far it is read. Raises as :func:`m100link.log.read`."""
    flight = read(file)
    if not err.is_terminal:
        yield flight
        return
    words = TextColumn("reading [progress.percentage]{task.percentage:>3.0f} %")
    bar = Progress(words, BarColumn(), TimeRemainingColumn(), console=err, transient=True)
    late = threading.Timer(_PATIENCE_S, bar.start)
    late.start()
    try:
        yield _Watched(flight.path, bar)
    finally:
        late.cancel()
        late.join()
        bar.stop()


class _Watched(FlightLog):
    def __init__(self, path: Path, bar: Progress) -> None:
        super().__init__(path)
        self._bar, self._task = bar, bar.add_task("")

    def _open(self) -> IO[bytes]:
        self._bar.reset(self._task)
        return self._bar.open(self.path, "rb", task_id=self._task)


# -- telemetry records as flat rows of named numbers, for JSON, CSV and plots ----------------------


def row(record: Any) -> dict[str, Any]:
    """Fields and views of a record by column name."""
    item = BY_RECORD[type(record)]
    values = {field: getattr(record, field) for field in (*record._fields, *item.views)}
    return {
        f"{item.name}.{field}": value.name if isinstance(value, Enum) else value
        for field, value in values.items()
    }


Items = Annotated[
    str, offered(BY_NAME), Parameter(help="Item names, such as position; by default all.")
]


def items_named(names: Iterable[str]) -> list[type[Any]]:
    """Record classes of items, of all without a name. Raises UsageError: there is no such item."""
    found = []
    for name in names:
        if name.lower() not in ITEM_NAMES:
            near = get_close_matches(name.lower(), ITEM_NAMES, n=2)
            meant = f"did you mean {' or '.join(near)}? " if near else ""
            raise UsageError(
                f"no telemetry item is called {name!r}",
                remedy=f"{meant}items: {', '.join(BY_NAME)}",
            )
        found.append(ITEM_NAMES[name.lower()].record)
    return found or [item.record for item in ITEMS]
