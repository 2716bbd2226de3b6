"""``m100link echo``, ``hz``, ``plot`` and ``monitor``."""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
from csv import DictWriter
from difflib import get_close_matches
from functools import partial
from typing import Annotated, Any

from rich.live import Live
from rich.table import Table
from rich.text import Text

from m100link.aircraft import Aircraft
from m100link.apps.cli.common import (
    BY_LINK,
    ConnectionOptions,
    LinkOptions,
    Url,
    err,
    out,
    until,
)
from m100link.apps.cli.display import Items, items_named, line_plot, row
from m100link.apps.cli.options import Above0, AtMost, Counted, Duration, offered
from m100link.apps.cli.terminal import ExitCode, OutputFormat, as_json, print_json, tell
from m100link.errors import UsageError
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    Time,
    Velocity,
)
from m100link.telemetry.columns import ITEM_NAMES, column_named, columns_of
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Lossless

_SILENT_S = 2.0
"""The slowest rate that can be set is 1 Hz: what was silent for so long is at 0."""

_SCALE_COLUMNS = 14
"""Left of a plot: eleven digits and the axis."""

_WIDE = 64
"""Columns of a terminal that has room for everything that is measured."""


async def echo(
    url: Url = None,
    /,
    *items: Items,
    link: LinkOptions = BY_LINK,
    rate: Annotated[float | None, Above0] = None,
    duration: AtMost = None,
    packages: Annotated[int | None, Counted] = None,
    csv: bool = False,
) -> None:
    """Print each telemetry package as a JSON object or a CSV row.

    Every column is named item.field; ``received_at`` is this computer's monotonic clock, s, and
    ``utc`` the same as POSIX time.

    Args:
        rate: Packages per second, at most.
        packages: Packages until the command ends by itself.
        csv: Print CSV with a header line, as --table does.
    """
    if csv and OutputFormat.json:
        raise UsageError("--csv and --json exclude each other", remedy="give one of them")
    csv = csv or OutputFormat.json is False
    place, names = link.place_among([url or "", *items], lambda word: word.lower() in ITEM_NAMES)
    records = items_named(names)
    writer = DictWriter(
        sys.stdout, ["received_at", "utc", *columns_of(records)], lineterminator="\n"
    )

    def tell_silent(aircraft: Aircraft) -> None:
        if names and aircraft.link.is_open:
            _tell(_silent(aircraft, records))

    async def print_all(aircraft: Aircraft) -> None:
        printed = 0
        async with aircraft.telemetry(*records, policy=Lossless(2000), rate_hz=rate) as samples:
            asyncio.get_running_loop().call_later(_SILENT_S, tell_silent, aircraft)
            async for sample in samples:
                values = {
                    "received_at": round(sample.received_at, 6),
                    "utc": round(sample.received_at + aircraft.utc_offset_s, 6),
                    **_values(sample, records),
                }
                if csv:
                    writer.writerow(values)
                else:
                    print_json(values)
                printed += 1
                if printed == packages:
                    return

    async with place.connect() as aircraft:
        if csv:
            writer.writeheader()
        await until(duration, print_all(aircraft))
    sys.stdout.flush()


def _silent(aircraft: Aircraft, records: list[type[Any]]) -> list[str]:
    return [
        BY_RECORD[record].name for record in records if not aircraft.state.statistics(record).count
    ]


def _tell(silent: list[str]) -> None:
    for name in silent:
        err.print(
            f"{name} is at 0 Hz: no package carries it; set its rate in the PC assistant",
            style="yellow",
        )


def _values(sample: Sample, records: list[type[Any]]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for record in records:
        found = sample.get(record)
        if found is not None:
            values |= row(found)
    return values


async def hz(url: Url = None, /, *, link: LinkOptions = BY_LINK, duration: Duration = 5.0) -> None:
    """Measure item rates, jitter and gaps, and the aircraft's clock."""
    place = link.place(url)
    async with place.connect() as aircraft:
        await until(duration, aircraft.wait_closed())
        if aircraft.link.failure is not None:
            raise aircraft.link.failure.again()
        measured = _rates(aircraft)
    tell(measured, lambda: out.print(_rates_table(measured)))


def _rates(aircraft: Aircraft) -> dict[str, Any]:
    items = {}
    for record, item in BY_RECORD.items():
        statistics = aircraft.state.statistics(record)
        items[item.name] = {
            "count": statistics.count,
            "rate_hz": statistics.rate_hz,
            "jitter_s": statistics.jitter_s,
            "longest_gap_s": statistics.longest_gap_s if statistics.count > 1 else None,
        }
    clock = aircraft.device_clock
    known_to = clock.uncertainty_s
    return {
        "items": items,
        "device_clock": {
            "tick_hz": clock.tick_hz,
            "offset_s": clock.offset_s,
            "skew_ppm": clock.skew_ppm,
            "uncertainty_s": known_to if math.isfinite(known_to) else None,
            "resets": clock.resets,
        },
        "telemetry_mismatches": aircraft.telemetry_mismatches,
    }


def _rates_table(measured: dict[str, Any]) -> Table:
    clock = measured["device_clock"]
    known_to = _number(clock["uncertainty_s"], 1000, 1)
    table = Table(
        box=None,
        caption=f"device clock {clock['tick_hz']} Hz, skew {clock['skew_ppm']:.1f} ppm, "
        + (f"known to {known_to} ms" if known_to else "not known yet"),
    )
    titles: tuple[str, ...] = ("item", "Hz", "count", "jitter ms", "longest gap ms")
    titles = titles if out.width >= _WIDE else titles[:3]
    for title in titles:
        table.add_column(title, justify="left" if title == "item" else "right", no_wrap=True)
    for name, values in measured["items"].items():
        if not values["count"]:
            table.add_row(name, "0", "0", style="dim")
            continue
        cells = (
            name,
            _number(values["rate_hz"], 1, 1),
            str(values["count"]),
            _number(values["jitter_s"], 1000, 2),
            _number(values["longest_gap_s"], 1000, 1),
        )
        table.add_row(*cells[: len(titles)])
    return table


def _number(value: float | None, factor: float, digits: int) -> str:
    return "" if value is None else f"{value * factor:.{digits}f}"


async def plot(
    url: Url = None,
    /,
    *fields: Annotated[str, offered(columns_of(BY_RECORD))],
    link: LinkOptions = BY_LINK,
    duration: Duration = 10.0,
) -> int:
    """Plot telemetry columns over time, live. `log plot` draws a recorded flight.

    Args:
        fields: Columns; position.height_m by default.
    """
    if url is not None and column_named(url):
        fields, url = (url, *fields), None
    wanted = []
    for field in fields or ("position.height_m",):
        column = column_named(field)
        if column is None:
            raise _unknown_column(field)
        wanted.append(column)
    return await _plot_live(link.place(url), tuple(wanted), duration)


def _unknown_column(field: str) -> UsageError:
    known = columns_of(BY_RECORD)
    if field.lower() in ITEM_NAMES:
        item = ITEM_NAMES[field.lower()].name
        columns = [name for name in known if name.partition(".")[0] == item]
        return UsageError(
            f"{field} is an item, not a column", remedy=f"one of: {', '.join(columns)}"
        )
    by_end = {name.rpartition(".")[2]: name for name in known} | {name: name for name in known}
    near = [by_end[end] for end in get_close_matches(field.lower(), by_end, n=2, cutoff=0.7)]
    meant = f"did you mean {' or '.join(dict.fromkeys(near))}? " if near else ""
    return UsageError(
        f"no column is called {field!r}", remedy=f"{meant}columns: {', '.join(known)}"
    )


async def _plot_live(place: ConnectionOptions, fields: tuple[str, ...], duration: float) -> int:
    records = items_named(dict.fromkeys(field.partition(".")[0] for field in fields))
    points: dict[str, list[tuple[float, float]]] = {field: [] for field in fields}

    async def collect(aircraft: Aircraft) -> None:
        async with aircraft.telemetry(*records, policy=Lossless(2000), rate_hz=50) as samples:
            async for sample in samples:
                values = _values(sample, records)
                for field in fields:
                    value = values.get(field)
                    if isinstance(value, int | float):
                        points[field].append((sample.received_at, float(value)))

    async with place.connect() as aircraft:
        shown = None if as_json() else Live(console=out, refresh_per_second=5)
        shown = shown if sys.stdout.isatty() else None
        with shown or contextlib.nullcontext():
            task = asyncio.ensure_future(until(duration, collect(aircraft)))
            try:
                while not task.done():
                    await asyncio.wait([task], timeout=0.2)
                    if shown is not None:
                        shown.update(Text("\n".join(_lines(points))))
            finally:
                task.cancel()
                await asyncio.wait([task])
        task.result()
        silent = _silent(aircraft, records) if duration >= _SILENT_S else []
    if shown is None:
        _draw(points)
    _tell(silent)
    return ExitCode.OK if any(points.values()) else ExitCode.FAILED


def _lines(points: dict[str, list[tuple[float, float]]]) -> list[str]:
    lines = []
    for field, values in points.items():
        lines.append(field)
        width = max(8, min(60, out.width - _SCALE_COLUMNS))
        lines += line_plot(values, columns=width) if values else ["  nothing received"]
    return lines


def _draw(points: dict[str, list[tuple[float, float]]]) -> None:
    for field, values in points.items():
        drawn = Text("\n".join(_lines({field: values})))
        tell({"column": field, "values": values}, partial(out.print, drawn))


# -- ``m100link monitor``: what the aircraft says, live --------------------------------------------


_STALE_S = 2.0

_MONITOR_WIDE = 96
"""Columns of a terminal that has room for every value on a line, with rate and jitter beside it."""


async def monitor(
    url: Url = None, /, *, link: LinkOptions = BY_LINK, duration: AtMost = None
) -> None:
    """Watch every telemetry item: value, age, measured rate and jitter.

    It needs no activation. Ctrl-C ends it.
    """
    place = link.place(url)
    async with place.connect() as aircraft:
        await until(duration, _print_lines(aircraft) if as_json() else _show(aircraft))
        failure = aircraft.link.failure
        if failure is not None:
            raise failure.again()


async def _print_lines(aircraft: Aircraft) -> None:
    while aircraft.link.is_open:
        await asyncio.sleep(1.0)
        print_json(
            {
                item.name: {
                    "age_s": round(aircraft.state.age(record) or 0.0, 3),
                    "rate_hz": round(aircraft.state.statistics(record).rate_hz or 0.0, 1),
                    "value": value._asdict(),
                }
                for record, item in BY_RECORD.items()
                if (value := aircraft.state.get(record)) is not None
            }
        )


async def _show(aircraft: Aircraft) -> None:
    with Live(console=out, refresh_per_second=10) as live:
        while aircraft.link.is_open:
            live.update(_table(aircraft))
            await asyncio.sleep(0.1)


def _table(aircraft: Aircraft) -> Table:
    numbers = aircraft.statistics()
    table = Table(
        title=f"{aircraft.link.name}, firmware {aircraft.firmware}",
        caption=f"{numbers.frames_received} frames, {numbers.discarded_bytes} bytes discarded, "
        f"{aircraft.telemetry_mismatches} packages refused",
        box=None,
    )
    titles = ("item", "value", "age", "Hz", "jitter")[: 5 if out.width >= _MONITOR_WIDE else 3]
    for title in titles:
        table.add_column(title, justify="left" if title in ("item", "value") else "right")
    table.columns[0].no_wrap = True
    if out.width >= _MONITOR_WIDE:
        table.columns[1].min_width = 56
    for record, item in BY_RECORD.items():
        value, age = aircraft.state.get(record), aircraft.state.age(record)
        statistics = aircraft.state.statistics(record)
        if value is None or age is None:
            table.add_row(item.name, "0 Hz so far", style="dim")
            continue
        style = "dim" if age > _STALE_S else ""
        rate = statistics.rate_hz
        cells = (
            item.name,
            describe(value),
            f"{age * 1000:.0f} ms" if age < _STALE_S else Text(f"{age:.1f} s", "red"),
            "" if rate is None else f"{rate:.1f}",
            "" if statistics.jitter_s is None else f"{statistics.jitter_s * 1000:.1f} ms",
        )
        table.add_row(*cells[: len(titles)], style=style)
    return table


_WORDED = {
    Time: "tick {0.tick} = {0.seconds:.2f} s",
    Attitude: "roll {0.roll_deg:z6.1f}°  pitch {0.pitch_deg:z6.1f}°  yaw {0.yaw_deg:z6.1f}°",
    Acceleration: "north {0.north_m_s2:z6.2f}  east {0.east_m_s2:z6.2f}  up {0.up_m_s2:z6.2f} m/s²",
    Velocity: "north {0.north_m_s:z6.2f}  east {0.east_m_s:z6.2f}  up {0.up_m_s:z6.2f} m/s",
    AngularVelocity: "roll {0.roll_rate_deg_s:z6.1f}  pitch {0.pitch_rate_deg_s:z6.1f}  "
    "yaw {0.yaw_rate_deg_s:z6.1f} °/s",
    Position: "{0.latitude_deg:.7f}° {0.longitude_deg:.7f}°  height {0.height_m:z.2f} m  "
    "GPS {0.gps_health}",
    Magnetometer: "{0.x:6.0f} {0.y:6.0f} {0.z:6.0f}",
    RemoteControl: "{0.mode_switch.name}  roll {0.roll}  pitch {0.pitch}  yaw {0.yaw}  "
    "throttle {0.throttle}",
    Gimbal: "roll {0.roll_deg:z6.1f}°  pitch {0.pitch_deg:z6.1f}°  yaw {0.yaw_deg:z6.1f}°",
    Battery: "{0.percent} %",
}


def describe(value: Any) -> str:
    """A record in words, with units."""
    match value:
        case FlightStatus():
            return value.phase.name.lower().replace("_", " ") if value.phase else str(value.status)
        case ControlDevice():
            return value.device.name if value.device is not None else f"0x{value.control:02X}"
        case _:
            return _WORDED.get(type(value), "{0}").format(value)
