"""The last minutes of every number of the telemetry and of the link, for plots.

One for each aircraft, kept by the front whether somebody looks or not: a page that is opened, or
loaded again, has what went before. Values are taken ten times a second; what was too old then is
not a number, so that a gap stays a gap.
"""

from __future__ import annotations

import asyncio
import csv
import io
import math
import time
from array import array
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from operator import attrgetter
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import State
from m100link.protocol.items import ITEMS
from m100link.telemetry.columns import columns_of
from m100link.telemetry.state import AircraftState

__all__ = ["COLUMNS", "INTERVAL", "KEPT_S", "LINE_COLUMNS", "History"]

INTERVAL = 0.1
"""Seconds between two rows."""

KEPT_S = 600.0
"""Seconds that are kept."""

_STALE_AFTER = 2.0  # items at 1 Hz are drawn as a line, not as points

LINE_COLUMNS = (
    *("line.packages_per_s", "line.round_trip_ms", "line.discards", "line.late_acks"),
    *("line.dropped_writes", "line.front_lag_ms"),
)
"""Numbers of the way to the aircraft, beside those of the telemetry."""

COLUMNS = (*columns_of(item.record for item in ITEMS), *LINE_COLUMNS)
"""What can be drawn, as ``item.field``."""

_READERS = [
    (item.record, [attrgetter(name) for name in (*item.record._fields, *item.views)])
    for item in ITEMS
]


class History:
    """Rows of numbers, the newest :data:`KEPT_S` seconds of them.

    Attributes:
        lag: Seconds that the event loop of this process was late, at worst in the last second.
    """

    def __init__(self) -> None:
        self._size = round(KEPT_S / INTERVAL)
        self._count = 0  # of rows ever added
        self._times = array("d", [math.nan]) * self._size
        self._columns = {name: array("d", [math.nan]) * self._size for name in COLUMNS}
        self._lags: list[float] = []
        self.lag = 0.0

    @property
    def count(self) -> int:
        """Rows that were ever added; a reader begins with what it has not seen."""
        return self._count

    async def keep(self, agent: AgentClient) -> None:
        """Add a row ten times a second, until cancelled."""
        # The clock of the event loop stands still for nobody, and shows no date.
        to_utc = time.time() - agent.now
        while True:
            due = agent.now + INTERVAL
            await asyncio.sleep(INTERVAL)
            self._note_lag(agent.now - due)
            telemetry = agent.telemetry if not agent.is_gone else None
            self.add(agent.now + to_utc, telemetry, agent.state)

    def _note_lag(self, lag: float) -> None:
        self._lags.append(max(0.0, lag))
        if len(self._lags) >= 1.0 / INTERVAL:
            self.lag = max(self._lags)
            self._lags.clear()

    def add(self, utc: float, telemetry: AircraftState | None, state: State) -> None:
        """Add a row.

        Args:
            utc: Seconds since 1970.
            telemetry: Newest values and their ages; None while there are none.
            state: Where the agent stands.
        """
        place = self._count % self._size
        self._times[place] = utc
        for name, value in zip(COLUMNS, self._row(telemetry, state), strict=True):
            self._columns[name][place] = math.nan if value is None else float(value)
        self._count += 1

    def _row(self, telemetry: AircraftState | None, state: State) -> Iterator[Any]:
        for record, readers in _READERS:
            found = None if telemetry is None else telemetry.fresh(record, within=_STALE_AFTER)
            for read in readers:
                yield None if found is None else read(found)
        if telemetry is None:
            yield from [None] * (len(LINE_COLUMNS) - 1)
        else:
            rates = (telemetry.statistics(record).rate_hz for record, _ in _READERS)
            yield max((rate for rate in rates if rate is not None), default=0.0)
            yield None if state.round_trip is None else 1000.0 * state.round_trip
            yield from (state.discards, state.late_acks, state.dropped_writes)
        yield 1000.0 * self.lag

    def rows(
        self,
        names: Sequence[str],
        *,
        since: int = 0,
        until: int | None = None,
        last_s: float = KEPT_S,
        step: int = 1,
    ) -> list[tuple[float, ...]]:
        """Rows as ``(utc, value, …)``, oldest first; NaN where there was no value.

        Args:
            names: Columns, as in :data:`COLUMNS`.
            since: Rows that were seen before, see :attr:`count`.
            until: As if no row had come after so many: what a plot that stands still shows.
            last_s: Only the newest seconds.
            step: Only each row whose number is a multiple of it: a window that moves on keeps them.
        """
        end = self._count if until is None else min(until, self._count)
        first = max(since, end - round(last_s / INTERVAL), self._count - self._size, 0)
        columns = [self._times, *(self._columns[name] for name in names)]
        return [
            tuple(column[number % self._size] for column in columns)
            for number in range(first + -first % step, end, step)
        ]

    def csv(self, names: Sequence[str], *, last_s: float = KEPT_S, until: int | None = None) -> str:
        """The same as text for a spreadsheet: times as ISO 8601 in UTC, empty for no value.

        Args:
            names: Columns.
            last_s: Only the newest seconds.
            until: As in :meth:`rows`.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["utc", *names])
        for utc, *values in self.rows(names, last_s=last_s, until=until):
            stamp = datetime.fromtimestamp(utc, UTC).isoformat(timespec="milliseconds")
            writer.writerow(
                [
                    stamp.replace("+00:00", "Z"),
                    *(f"{v:.9g}" if math.isfinite(v) else "" for v in values),
                ]
            )
        return text.getvalue()
