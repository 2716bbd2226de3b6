"""Data that outlives a page: words before take-off, and the last minutes."""

from __future__ import annotations

import asyncio
import csv
import io
import math
import secrets
import time
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from operator import attrgetter
from typing import Any

from m100link.apps.agent.client import AgentClient, Hearing, VehicleView
from m100link.apps.station.console.view.fly import FREE_FOR_S
from m100link.protocol.items import ITEMS
from m100link.protocol.records import FlightPhase
from m100link.telemetry.columns import columns_of
from m100link.telemetry.state import AircraftState

# -- what operators said of the place before take-off ----------------------------------------------
# A word counts for one person, one aircraft and one connection, for as long as it would have
# without the reload, and only while the aircraft was seen to stand on the ground all the time: in a
# flight, or in a gap of the telemetry, it may have come to another place. The person is the
# browser's tab: it keeps a secret that no other tab has, so nobody takes off on what somebody else
# has seen.

MOST = 256  # persons that are remembered

_STATUS = "flight_status.status"
_LONGEST_GAP_S = 1.0


@dataclass(frozen=True, slots=True)
class _Look:
    at: float  # when it was said, on the agent's clock, s
    connection: AircraftState  # the telemetry of the connection then: each connection has another


class Preferences:
    """Words that places are free, by person and aircraft."""

    def __init__(self) -> None:
        self._persons: dict[str, dict[str, _Look]] = {}

    def person(self, secret: object) -> str:
        """The person of whom a tab kept this secret; another one if nobody here knows it."""
        known = secret if isinstance(secret, str) and secret in self._persons else ""
        person = known or secrets.token_urlsafe(16)
        self._persons[person] = self._persons.pop(person, {})  # the newest is the last to go
        while len(self._persons) > MOST:
            del self._persons[next(iter(self._persons))]
        return person

    def say(self, person: str, aircraft: str, agent: AgentClient, *, is_free: bool) -> None:
        """A person looked around now, or takes that back."""
        words = self._persons.get(person)
        if words is None:
            return
        words.pop(aircraft, None)
        if is_free and agent.telemetry is not None:
            words[aircraft] = _Look(agent.now, agent.telemetry)

    def said_at(
        self, person: str, aircraft: str, agent: AgentClient, history: PlotHistory
    ) -> float | None:
        """When that person looked around, on the agent's clock, s; None: look again."""
        look = self._persons.get(person, {}).get(aircraft)
        if look is None or agent.is_gone or agent.telemetry is not look.connection:
            return None
        age = agent.now - look.at
        if age > FREE_FOR_S:
            return None
        rows = history.rows([_STATUS], last_s=age)
        times = [utc for utc, _ in rows]
        stood = all(status == FlightPhase.STANDBY for _, status in rows)
        longest = max((after - before for before, after in pairwise(times)), default=0.0)
        is_whole = math.isfinite(longest) and longest <= _LONGEST_GAP_S
        return look.at if rows and stood and is_whole else None


# -- the last minutes of every number of the telemetry and of the link -----------------------------
# One for each aircraft, kept by the front whether somebody looks or not: a page that is opened, or
# loaded again, has what went before. Values are taken ten times a second; what was too old then is
# not a number, so that a gap stays a gap.

INTERVAL = 0.1  # seconds between two rows
KEPT_S = 600.0  # seconds that are kept

LINE_COLUMNS = (
    *("line.packages_per_s", "line.round_trip_ms", "line.discards", "line.late_acks"),
    *("line.dropped_writes", "line.front_lag_ms"),
)
"""Numbers of the way to the aircraft, beside those of the telemetry."""

COLUMNS = (*columns_of(item.record for item in ITEMS), *LINE_COLUMNS)
"""The values that can be drawn, as ``item.field``."""

_READERS = [
    (item.record, [attrgetter(name) for name in (*item.record._fields, *item.views)])
    for item in ITEMS
]


class PlotHistory:
    """Rows of numbers, the newest :data:`KEPT_S` seconds of them."""

    def __init__(self) -> None:
        self._size = round(KEPT_S / INTERVAL)
        self.count = 0  # of rows ever added; a reader begins with those it has not seen
        self._times = array("d", [math.nan]) * self._size
        self._columns = {name: array("d", [math.nan]) * self._size for name in COLUMNS}
        # Seconds that the event loop of this process was late, at worst in the last second.
        self.lag = 0.0

    async def keep(self, agent: AgentClient) -> None:
        """Add a row ten times a second, until cancelled."""
        # The clock of the event loop stands still for nobody, and shows no date.
        to_utc = time.time() - agent.now
        lags: list[float] = []
        while True:
            due = agent.now + INTERVAL
            await asyncio.sleep(INTERVAL)
            lags.append(max(0.0, agent.now - due))
            if len(lags) >= 1.0 / INTERVAL:
                self.lag = max(lags)
                lags.clear()
            self.add(agent.now + to_utc, agent.view)

    def add(self, utc: float, view: VehicleView) -> None:
        """Add a row. ``utc``: seconds since 1970."""
        place = self.count % self._size
        self._times[place] = utc
        for name, value in zip(COLUMNS, self._row(view), strict=True):
            self._columns[name][place] = math.nan if value is None else float(value)
        self.count += 1

    def _row(self, view: VehicleView) -> Iterator[Any]:
        telemetry, state = view.telemetry, view.state
        for record, readers in _READERS:
            # Of what has a NaN the other numbers are drawn all the same.
            found = telemetry.get(record) if telemetry and view.is_new(record) else None
            for read in readers:
                yield None if found is None else read(found)
        if telemetry is None or view.hearing is Hearing.GONE:
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
        since: int = 0,  # rows that were seen before, see :attr:`count`
        until: int | None = None,
        last_s: float = KEPT_S,  # only the newest seconds
        step: int = 1,
    ) -> list[tuple[float, ...]]:
        """Rows as ``(utc, value, …)``, oldest first; NaN where there was no value."""
        end = self.count if until is None else min(until, self.count)
        first = max(since, end - round(last_s / INTERVAL), self.count - self._size, 0)
        columns = [self._times, *(self._columns[name] for name in names)]
        return [
            tuple(column[number % self._size] for column in columns)
            for number in range(first + -first % step, end, step)
        ]

    def csv(self, names: Sequence[str], *, last_s: float = KEPT_S, until: int | None = None) -> str:
        """The same as text for a spreadsheet: times as ISO 8601 in UTC, empty for no value.

        ``last_s``: only the newest seconds.
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
