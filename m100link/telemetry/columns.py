"""Telemetry as rows of equal width: a number per column, NaN where nothing was received."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from typing import Any

from m100link.errors import LinkError, TelemetryStalled, UsageError
from m100link.protocol.items import ITEMS, Item, item_of
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Subscription

__all__ = ["Columns", "Table"]


# -- names of telemetry items and columns: one of each is written, several are understood ----------
# Written are item names and, for a column, ``item.field`` with the field of the record. Understood
# are also the names of :class:`~m100link.telemetry.state.AircraftState` (``attitude``,
# ``remote_control``) and those of the document's table (2.2.3.1: ``q``, ``vgx``, ``pos.lati``),
# whatever their case.


# Item → its name in the document, and its variables in the order of the record's fields. An item
# that the document does not have is known by its own names alone.
_DOCUMENT = {
    "time": ("time", "time_stamp"),
    "quaternion": ("q", "q0 q1 q2 q3"),
    "acceleration": ("acc", "agx agy agz"),
    "velocity": ("vel", "vgx vgy vgz"),
    "angular_velocity": ("w", "wx wy wz"),
    "position": ("pos", "lati longti alti height health_flag"),
    "magnetometer": ("mag", "mx my mz"),
    "rc": ("rc", "roll pitch yaw throttle mode gear"),
    "gimbal": ("gimbal", "roll pitch yaw"),
    "flight_status": ("flight_status", "status"),
    "battery": ("battery", "status"),
    "control_device": ("ctrl_device", "status"),
}


def snake(record: type[Any]) -> str:
    """The name of a record's class as a name of a value: ``remote_control``."""
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in record.__name__)
    return words.lower().removeprefix("_")


ITEM_NAMES: Mapping[str, Item] = {
    **{_DOCUMENT[item.name][0]: item for item in ITEMS if item.name in _DOCUMENT},
    **{snake(item.record): item for item in ITEMS},
    **{item.name: item for item in ITEMS},
}
"""Items by every name that is understood."""


def _columns(item: Item) -> dict[str, str]:
    """Column by the names of its field that are understood, the record's own above all."""
    fields = item.record._fields
    _, variables = _DOCUMENT.get(item.name, ("", ""))
    names = dict(zip(variables.split(), fields, strict=False))
    names |= dict(zip(item.fields, fields, strict=False))
    names |= {field: field for field in (*fields, *item.views)}
    return {name: f"{item.name}.{field}" for name, field in names.items()}


_COLUMNS = {item.name: _columns(item) for item in ITEMS}

# A variable name that the document uses in one item alone needs no item.
_VARIABLES = [name for _, names in _DOCUMENT.values() for name in names.split()]
_ALONE = {
    name: _COLUMNS[item][name]
    for item, (_, names) in _DOCUMENT.items()
    for name in names.split()
    if _VARIABLES.count(name) == 1
}


def column_named(name: str) -> str | None:
    """The column of that name, as it is written; None: there is none."""
    item, _, field = name.lower().partition(".")
    if not field:
        return _ALONE.get(item)
    known = ITEM_NAMES.get(item)
    return None if known is None else _COLUMNS[known.name].get(field)


# -- columns ---------------------------------------------------------------------------------------

_SHOWN = 10  # rows that a notebook shows


def columns_of(records: Iterable[type[Any]]) -> list[str]:
    """Names of the columns of those records, such as ``position.height_m``."""
    return [
        f"{item.name}.{field}"
        for item in map(item_of, records)
        for field in (*item.record._fields, *item.views)
    ]


class Columns:
    """Turns samples into rows of numbers that all have the same columns.

    ::

        columns = Columns(Attitude, Velocity, utc_offset_s=aircraft.utc_offset_s)
        async for sample in samples:
            writer.writerow(columns.row(sample))

    Args:
        records: Record classes, each counted once; none at all: every item.
        utc_offset_s: :attr:`Aircraft.utc_offset_s`.

    Attributes:
        names: ``received_at`` (the event loop's monotonic clock, s), ``utc`` (POSIX time, s), and
            ``item.field`` for the fields and views of each record, as in ``m100link echo --csv``.

    Raises:
        UsageError: Not a telemetry record.
    """

    __slots__ = ("_readers", "_utc_offset_s", "names")

    def __init__(self, *records: type[Any], utc_offset_s: float) -> None:
        wanted = dict.fromkeys(item_of(record).record for record in records)
        classes = tuple(wanted) or tuple(item.record for item in ITEMS)
        self.names = ("received_at", "utc", *columns_of(classes))
        self._utc_offset_s = utc_offset_s
        self._readers = [
            (record, [attrgetter(name) for name in (*record._fields, *item_of(record).views)])
            for record in classes
        ]

    def __repr__(self) -> str:
        return f"<Columns {', '.join(self.names)}>"

    def row(self, sample: Sample) -> tuple[float, ...]:
        """A number per name. NaN: the package, or its firmware, does not have the value.

        Enumerations are their numbers.
        """
        values = [sample.received_at, sample.received_at + self._utc_offset_s]
        for record, readers in self._readers:
            found = sample.get(record)
            for read in readers:
                value = None if found is None else read(found)
                values.append(math.nan if value is None else float(value))
        return tuple(values)

    async def collect(
        self,
        samples: Subscription[Sample],
        seconds: float,
        clock: Callable[[], float] | None = None,
    ) -> Table:
        """See :meth:`m100link.Aircraft.collect`."""
        if not 0 < seconds < math.inf:
            raise UsageError(
                f"nothing can be collected for {seconds} s", remedy="a finite number above 0"
            )
        end = (clock or asyncio.get_running_loop().time)() + seconds
        rows: list[tuple[float, ...]] = []
        async with samples:
            try:
                async with asyncio.timeout(seconds):
                    async for sample in samples:
                        # A program that was blocked finds packages of after the end in its queue.
                        if sample.received_at >= end:
                            break
                        rows.append(self.row(sample))
            except TimeoutError as error:
                if isinstance(error, LinkError):
                    raise
        if not rows:
            raise TelemetryStalled(
                f"none of the items wanted arrived within {seconds:g} s",
                cause="they are not sent, or more rarely than that",
                remedy="see which items arrive: m100link hz",
            )
        return Table(self.names, rows)


@dataclass(frozen=True, slots=True, repr=False)
class Table:
    """Rows of telemetry, oldest first: a row per package."""

    names: tuple[str, ...]  #: Name per column, see :class:`Columns`.
    #: The rows, as wide as there are names; NaN where nothing was received.
    rows: list[tuple[float, ...]]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"<Table of {len(self.rows)} rows: {', '.join(self.names)}>"

    def column(self, name: str) -> list[float]:
        """The values of one column, by its name or one of the document's (``vgx``, ``pos.lati``).

        Raises:
            UsageError: There is no such column; the message lists them.
        """
        name_here = name if name in self.names else column_named(name)
        if name_here not in self.names:
            raise UsageError(
                f"no column is called {name!r}", remedy=f"columns: {', '.join(self.names)}"
            )
        index = self.names.index(name_here)
        return [row[index] for row in self.rows]

    def to_numpy(self) -> Any:
        """The rows as a numpy array of float64, shape (rows, names).

        Raises:
            UsageError: numpy is not installed; m100link does not need it for anything else.
        """
        try:
            numpy = import_module("numpy")
        except ModuleNotFoundError:
            raise UsageError(
                "an array needs numpy, which is not installed", remedy="pip install numpy"
            ) from None
        return numpy.array(self.rows, dtype=float).reshape(len(self.rows), len(self.names))

    def _repr_html_(self) -> str:
        """The table for a notebook: the track, if position is among the columns; the first rows."""
        from html import escape  # which few programs need, and brings a table of all entities

        from m100link.geodesy import track_svg

        head = "".join(f"<th>{escape(name)}</th>" for name in self.names)
        body = "".join(
            f"<tr>{''.join(f'<td>{_shown(value)}</td>' for value in row)}</tr>"
            for row in self.rows[:_SHOWN]
        )
        caption = f"{min(_SHOWN, len(self.rows))} of {len(self.rows)} rows"
        places = (f"position.{axis}_deg" for axis in ("latitude", "longitude"))
        columns = [self.column(place) for place in places if place in self.names]
        track = track_svg(zip(*columns, strict=True)) if len(columns) == 2 else ""
        return f"{track}<table><caption>{caption}</caption><tr>{head}</tr>{body}</table>"


def _shown(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.12g}"
