"""``m100link monitor``: what the aircraft says, live."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from typing import Annotated, Any

from rich.live import Live
from rich.table import Table

from m100link.aircraft import Aircraft, connect
from m100link.apps.cli.common import LinkOptions, Place, Url, out, run_async
from m100link.apps.cli.options import Above0
from m100link.apps.cli.outcome import print_json
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

__all__ = ["describe", "monitor"]

_STALE_S = 2.0

_WIDE = 96
"""Columns of a terminal that has room for every value on a line, with rate and jitter beside it."""


def monitor(
    url: Url = None,
    /,
    *,
    link: LinkOptions | None = None,
    duration: Annotated[float | None, Above0] = None,
    json: bool = False,
) -> int:
    """Watch telemetry: every item with its value, age, measured rate and jitter.

    Needs no activation. Ends with Ctrl-C.

    Args:
        url: Where the aircraft is.
        link: How to talk to it.
        duration: Seconds until it ends by itself.
        json: One JSON object per second instead of the table; the default in a pipe.
    """
    as_json = json or not sys.stdout.isatty()
    link = link or LinkOptions()
    return run_async(_monitor(link.place(url), duration, as_json))


async def _monitor(place: Place, duration: float | None, as_json: bool) -> int:
    async with connect(place.url, **place.arguments()) as aircraft:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(duration):
                await (_print_lines(aircraft) if as_json else _show(aircraft))
        failure = aircraft.link.failure
        if failure is not None:
            raise failure.again()
    return 0


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
    titles = ("item", "value", "age", "Hz", "jitter")[: 5 if out.width >= _WIDE else 3]
    for title in titles:
        table.add_column(title, justify="left" if title in ("item", "value") else "right")
    table.columns[0].no_wrap = True
    if out.width >= _WIDE:
        table.columns[1].min_width = 56
    for record, item in BY_RECORD.items():
        value, age = aircraft.state.get(record), aircraft.state.age(record)
        statistics = aircraft.state.statistics(record)
        if value is None or age is None:
            table.add_row(f"[dim]{item.name}[/]", "[dim]0 Hz so far[/]")
            continue
        style = "dim" if age > _STALE_S else ""
        rate = statistics.rate_hz
        cells = (
            item.name,
            describe(value),
            f"{age * 1000:.0f} ms" if age < _STALE_S else f"[red]{age:.1f} s[/]",
            "" if rate is None else f"{rate:.1f}",
            "" if statistics.jitter_s is None else f"{statistics.jitter_s * 1000:.1f} ms",
        )
        table.add_row(*cells[: len(titles)], style=style)
    return table


def describe(value: Any) -> str:
    """A record in words, with units."""
    match value:
        case Time():
            return f"tick {value.tick} = {value.seconds:.2f} s"
        case Attitude():
            return (
                f"roll {value.roll_deg:6.1f}°  pitch {value.pitch_deg:6.1f}°  "
                f"yaw {value.yaw_deg:6.1f}°"
            )
        case Acceleration():
            return "north {:6.2f}  east {:6.2f}  up {:6.2f} m/s²".format(*value)
        case Velocity():
            return "north {:6.2f}  east {:6.2f}  up {:6.2f} m/s".format(*value[:3])
        case AngularVelocity():
            return (
                f"roll {value.roll_rate_deg_s:6.1f}  pitch {value.pitch_rate_deg_s:6.1f}  "
                f"yaw {value.yaw_rate_deg_s:6.1f} °/s"
            )
        case Position():
            return (
                f"{value.latitude_deg:.7f}° {value.longitude_deg:.7f}°  height "
                f"{value.height_m:.2f} m  GPS {value.gps_health}"
            )
        case Magnetometer():
            return "{:6.0f} {:6.0f} {:6.0f}".format(*value)
        case RemoteControl():
            return (
                f"{value.mode_switch.name}  roll {value.roll}  pitch {value.pitch}  "
                f"yaw {value.yaw}  throttle {value.throttle}"
            )
        case Gimbal():
            return "roll {:6.1f}°  pitch {:6.1f}°  yaw {:6.1f}°".format(*value[:3])
        case FlightStatus():
            return value.phase.name.lower().replace("_", " ") if value.phase else str(value.status)
        case Battery():
            return f"{value.percent} %"
        case ControlDevice():
            return value.device.name if value.device is not None else f"0x{value.control:02X}"
        case _:
            return str(value)
