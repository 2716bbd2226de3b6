"""Data that outlives a page: what was flown, and recorded flights."""

from __future__ import annotations

import asyncio
import csv
import io
import math
import pickle
import subprocess
import sys
import time
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from m100link.errors import M100Error
from m100link.log.channels import TELEMETRY, Curve
from m100link.log.reading import FlightLog, Message, read
from m100link.log.story import Curves, FlightPath, FlightSummary, read_move, read_story
from m100link.protocol.firmware import FIRMWARE_1_0, PROFILES
from m100link.protocol.items import ITEMS
from m100link.protocol.records import Attitude, FlightPhase, FlightStatus, Position
from m100link.protocol.setpoint import Horizontal, ReferenceFrame, Vertical, Yaw
from m100link.telemetry.columns import columns_of
from m100link.telemetry.integrity import has_fix
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import FRESH_S, AircraftState

if TYPE_CHECKING:  # the process that reads a file needs none of it
    from m100link.apps.agent.client import AgentClient, VehicleView

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


def _numbers(newest: Callable[[type[Any]], Any]) -> Iterator[Any]:
    """A value for each column of telemetry; None where no record is new."""
    for record, readers in _READERS:
        # Of what has a NaN the other numbers are drawn all the same.
        found = newest(record)
        for read_one in readers:
            yield None if found is None else read_one(found)


class PlotHistory:
    """Rows of numbers, the newest :data:`KEPT_S` seconds of them, and where it flew.

    Of a replay it has neither: :attr:`recorded` is one analysis of the file.
    """

    def __init__(self) -> None:
        self._size = round(KEPT_S / INTERVAL)
        self.count = 0  # of rows ever added; a reader begins with those it has not seen
        self._times = array("d", [math.nan]) * self._size
        self._columns = {name: array("d", [math.nan]) * self._size for name in COLUMNS}
        # Seconds that the event loop of this process was late, at worst in the last second.
        self.lag = 0.0
        self.newest = -math.inf  # time of the newest row, as :attr:`path` has it, s
        self.path = FlightPath()
        self.recorded: Recorded | None = None  # of a replay, once its file was read
        self.fault = ""  # why a file could not be read
        self._file = ""

    async def keep(self, agent: AgentClient) -> None:
        """Add a row ten times a second, or read the file of a replay; until cancelled."""
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
            replay = agent.state.replay
            if replay is None:
                self.add(agent.now + to_utc, agent.view)
            elif replay.path != self._file:
                self._file, self.recorded = replay.path, None
                agent.background.spawn(self._read(replay.path, agent.state.firmware), "analysis")

    async def _read(self, path: str, firmware: str) -> None:
        async for found in analysed(path, firmware):
            if isinstance(found, str):
                self.fault = found
            else:
                self.recorded = found

    def add(self, utc: float, view: VehicleView) -> None:
        """Add a row. ``utc``: seconds since 1970."""
        place, self.newest = self.count % self._size, utc
        self._times[place] = utc
        for name, value in zip(COLUMNS, self._row(view), strict=True):
            self._columns[name][place] = math.nan if value is None else float(value)
        self.count += 1
        is_on_ground, position = view.is_on_ground, view.get(Position)
        if is_on_ground is not None:
            self.path.hear_phase(utc, is_off_ground=not is_on_ground)
        if position is not None and has_fix(position):
            self.path.add(utc, position)

    def _row(self, view: VehicleView) -> Iterator[Any]:
        telemetry, state = view.telemetry, view.state
        if telemetry is not None and view.is_connected:
            yield from _numbers(lambda record: telemetry.fresh(record, now=view.now))
        else:
            yield from _numbers(lambda _: None)
        if telemetry is None or view.is_gone:
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
        return as_csv(names, self.rows(names, last_s=last_s, until=until))


def as_csv(names: Sequence[str], rows: Sequence[tuple[float, ...]]) -> str:
    """Rows of POSIX time, s, and values as text, as :meth:`PlotHistory.csv`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["utc", *names])
    for utc, *values in rows:
        stamp = datetime.fromtimestamp(utc, UTC).isoformat(timespec="milliseconds")
        writer.writerow(
            [
                stamp.replace("+00:00", "Z"),
                *(f"{v:.9g}" if math.isfinite(v) else "" for v in values),
            ]
        )
    return text.getvalue()


# -- a recorded flight: one analysis of its file, from which a replay shows all that lasts ---------
# A process of its own reads the file, once: two hours take seconds, in which pages are built. Then
# a page looks up the place of its replay. No clock of this computer is in it.

COMMANDED = {
    "position.height_m": "commanded.height_m",
    "velocity.north_m_s": "commanded.north_m_s",
    "velocity.east_m_s": "commanded.east_m_s",
    "velocity.up_m_s": "commanded.up_m_s",
    "velocity.ground_speed_m_s": "commanded.ground_speed_m_s",
    "quaternion.roll_deg": "commanded.roll_deg",
    "quaternion.pitch_deg": "commanded.pitch_deg",
    "quaternion.yaw_deg": "commanded.yaw_deg",
    "angular_velocity.yaw_rate_deg_s": "commanded.yaw_rate_deg_s",
}
"""Numbers that setpoints command, by the numbers that follow them."""

INTERVAL_S, LONG_INTERVAL_S = 0.2, 1.0  # between packages that are looked into
LARGE = 100_000_000  # bytes of a file, about an hour and a half, from which on it is the longer one
OUTLINED = 20_000_000  # bytes of a file, a second of reading, from which on it is outlined first
MOST_ROWS = 10_000  # of a recorded flight: with more, every second one is dropped
_FLOWN_FOR_S = 0.5  # after a setpoint nothing is commanded any more
_HOLE_S = 2.0
_OF_CURVES = {"line.packages_per_s": "packages_per_s", "line.round_trip_ms": "round_trip_ms"}


@dataclass
class Recorded:
    """One flight by its file: times are s after the beginning of the log."""

    story: FlightSummary  # phases, alarms, commands, track
    times: array[float]  # of the rows
    columns: Mapping[str, array[float]]  # their values; NaN where there was none
    is_whole: bool = True  # else the file is still being read: alarms and commands are missing

    def at(self, utc: float) -> float:
        """The time of the log at a POSIX time of the flight, s."""
        return utc - (self.story.began_utc or 0.0)

    def between(
        self, names: Sequence[str], begin_s: float, end_s: float, most: int
    ) -> list[tuple[float, ...]]:
        """Rows of a part of the flight, at most so many, as ``(time, value, …)``."""
        first, last = bisect_left(self.times, begin_s), bisect_left(self.times, end_s)
        first, last = max(0, first - 1), min(len(self.times), last + 1)
        columns = [self.times, *(self.columns[name] for name in names)]
        step = max(1, math.ceil((last - first) / most))
        return [tuple(column[n] for column in columns) for n in range(first, last, step)]

    def near(self, names: Sequence[str], at_s: float) -> list[float]:
        """The values at a time; NaN where there is none within two seconds before."""
        number = bisect_right(self.times, at_s) - 1
        if number < 0 or at_s - self.times[number] > _HOLE_S:
            return [math.nan] * len(names)
        return [self.columns[name][number] for name in names]


@dataclass
class _Rows:
    firmware: str
    interval: float = INTERVAL_S
    times: array[float] = field(default_factory=lambda: array("d"))
    _rows: list[tuple[float | None, ...]] = field(default_factory=list)
    _state: AircraftState = field(default_factory=lambda: AircraftState(lambda: 0.0))
    _commanded: dict[str, float] = field(default_factory=dict)
    _commanded_at: float = -math.inf

    def hear(self, at: float, one: Sample | Message) -> None:
        if isinstance(one, Sample):
            self._state.update(one)
            last = self.times[-1] if self.times else -math.inf
            if at - last >= 0.999 * self.interval:
                if at - last > _HOLE_S and self.times:
                    self.add(last + _HOLE_S / 2, (None,) * (len(COLUMNS) + len(COMMANDED)))
                commanded = self._commanded if at - self._commanded_at <= _FLOWN_FOR_S else {}
                self.add(
                    at,
                    (
                        *_numbers(lambda record: self._state.fresh(record, now=one.received_at)),
                        *(None for _ in LINE_COLUMNS),
                        *map(commanded.get, COMMANDED.values()),
                    ),
                )
        else:
            self._commanded_at, self._commanded = at, self._read(one)

    def add(self, at: float, row: tuple[float | None, ...]) -> None:
        self.times.append(at)
        self._rows.append(row)
        if len(self.times) > MOST_ROWS:
            self.interval *= 2.0
            del self.times[1::2], self._rows[1::2]

    def columns(self, curves: Curves) -> dict[str, array[float]]:
        """The rows by column, with the curves of the line."""
        names = (*COLUMNS, *COMMANDED.values())
        turned = zip(*self._rows, strict=True) if self._rows else [()] * len(names)
        found = {
            name: array("d", [math.nan if value is None else value for value in column])
            for name, column in zip(names, turned, strict=True)
        }
        return found | {
            name: self._beside(getattr(curves, curve)) for name, curve in _OF_CURVES.items()
        }

    def _read(self, message: Message) -> dict[str, float]:
        """The numbers that a setpoint commands; none where it is of another writer."""
        sent = read_move(message, PROFILES.get(self.firmware, FIRMWARE_1_0))
        if sent is None:
            return {}
        mode, x, y, z, yaw, frame, _ = sent
        found: dict[str, float] = {}
        if mode.horizontal is Horizontal.TILT:
            found |= {"roll_deg": x, "pitch_deg": y}
        elif mode.horizontal is Horizontal.VELOCITY:
            found["ground_speed_m_s"] = math.hypot(x, y)
            attitude = self._state.get(Attitude)
            if frame is ReferenceFrame.GROUND:
                found |= {"north_m_s": x, "east_m_s": y}
            elif attitude is not None:
                heading = math.radians(attitude.yaw_deg)
                cos, sin = math.cos(heading), math.sin(heading)
                found |= {"north_m_s": x * cos - y * sin, "east_m_s": x * sin + y * cos}
        if mode.vertical is not Vertical.THRUST:
            found["height_m" if mode.vertical is Vertical.HEIGHT else "up_m_s"] = z
        found["yaw_deg" if mode.yaw is Yaw.ANGLE else "yaw_rate_deg_s"] = yaw
        return {f"commanded.{name}": value for name, value in found.items()}

    def _beside(self, curve: Curve) -> array[float]:
        """The last point of a curve before each row."""
        column, points = array("d"), iter(curve.points())
        value, following = math.nan, next(points, None)
        for at in self.times:
            while following is not None and following[0] <= at:
                value, following = following[1], next(points, None)
            column.append(value)
        return column


def analyse(
    path: str, firmware: str, on_outline: Callable[[Recorded], None] = lambda _: None
) -> Recorded | str:
    """Read a file, or return why it cannot be read.

    ``firmware``: name of the profile, or empty. ``on_outline`` gets the flight of a large file
    without alarms and commands, after a third of the time.
    """
    rows = _Rows(firmware)
    try:
        flight = read(path)
        size = flight.path.stat().st_size
        interval_s = min(max(INTERVAL_S, LONG_INTERVAL_S * size / LARGE), LONG_INTERVAL_S)
        if size > OUTLINED:
            with suppress(M100Error, TypeError, ValueError):  # of another writer, or damaged
                on_outline(_outline(flight, 2.0 * interval_s))
        story = read_story(
            flight,
            firmware=firmware or None,
            interval_s=interval_s,
            listener=lambda _, at, one: rows.hear(at, one),
        )
    except M100Error as error:
        return error.seen
    except OSError as error:
        return f"{path} cannot be read: {error.strerror}"
    return Recorded(story, rows.times, rows.columns(story.curves))


def _outline(flight: FlightLog, interval_s: float) -> Recorded:
    """The track and the rows by the telemetry that a log has as JSON beside the bytes."""
    story, rows, due_s = FlightSummary(flight.path.name), _Rows(""), -math.inf
    first = next(flight.messages(), Message("", 0.0, 0.0, b""))
    story.began_utc = first.utc
    newest: dict[type[Any], tuple[float, Any]] = {}
    for message in flight.messages(TELEMETRY, pause_s=interval_s / 2):
        at = message.at - first.at
        if at < due_s and b'"battery.' not in message.data:  # once a second, and in few rows
            continue
        row = {name: math.nan if one is None else one for name, one in message.content().items()}
        for item in ITEMS:
            names = [f"{item.name}.{name}" for name in item.fields]
            if names[0] in row:
                more = [getattr(FIRMWARE_1_0, name) for name in item.profile_fields]
                newest[item.record] = at, item.record(*map(row.get, names), *more)
        if at < due_s:
            continue
        due_s = story.duration_s = at + 0.999 * interval_s
        new = {one: found for one, (heard, found) in newest.items() if at - heard <= FRESH_S[one]}
        rows.add(at, (*_numbers(new.get), *[None] * (len(LINE_COLUMNS) + len(COMMANDED))))
        if (status := new.get(FlightStatus)) is not None:
            story.path.hear_phase(at, is_off_ground=status.phase is not FlightPhase.STANDBY)
        if (position := new.get(Position)) is not None and has_fix(position):
            story.path.add(at, position)
    return Recorded(story, rows.times, rows.columns(story.curves), is_whole=False)


_CHILD = (
    "import gc, os, signal, sys; gc.disable(); "  # it makes no circles, and walks many tuples
    "signal.signal(signal.SIGPIPE, signal.SIG_DFL); "  # nobody waits for it any more
    "from m100link.apps.station.console.kept import analyse, send; "
    # The page that shows the outline comes first.
    "send(analyse(*sys.argv[1:], lambda found: (send(found), os.nice(10))))"
)

_begun: dict[str, subprocess.Popen[bytes]] = {}  # by file, until somebody asks for the analysis


def send(found: Recorded | str) -> None:
    """Write it to the process that asked."""
    data = pickle.dumps(found)
    sys.stdout.buffer.write(len(data).to_bytes(8, "little") + data)
    sys.stdout.buffer.flush()


def begin_analysis(path: str, firmware: str) -> None:
    """Start the process that reads a file, before anybody asks for its flight."""
    if path not in _begun:
        _begun[path] = subprocess.Popen(
            (sys.executable, "-c", _CHILD, path, firmware),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )


async def analysed(path: str, firmware: str) -> AsyncIterator[Recorded | str]:
    """The same by a process of its own, which ends with the iterator: outline, then the whole."""
    if sys.platform == "win32":  # its loop reads no pipe
        yield await asyncio.to_thread(analyse, path, firmware, lambda _: None)
        return
    begin_analysis(path, firmware)
    process, reader = _begun.pop(path), asyncio.StreamReader()
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), process.stdout
    )
    found: Recorded | str = ""
    try:
        with suppress(asyncio.IncompleteReadError):
            while True:
                size = int.from_bytes(await reader.readexactly(8), "little")
                found = pickle.loads(await reader.readexactly(size))  # of our own process
                yield found
        await asyncio.to_thread(process.wait)
        if not found or (isinstance(found, Recorded) and not found.is_whole):
            yield f"the process that read {path} ended with {process.returncode}"
    finally:
        transport.close()
        process.kill()
        process.wait()
