"""``m100link fleet monitor``, ``watch`` and ``lease``: what goes on until Ctrl-C."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Annotated, Any

from cyclopts import Parameter
from rich.live import Live
from rich.table import Table

from m100link.apps.cli.common import Told, err, out, run_async
from m100link.apps.cli.fleet import NO_OPTIONS, FleetOptions
from m100link.apps.cli.fleet_lease import shared
from m100link.apps.cli.options import Above0
from m100link.apps.cli.outcome import print_json
from m100link.apps.cli.terminal import ReaderGone
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import Keys, in_order
from m100link.apps.fleet.telemetry import FleetTelemetry
from m100link.protocol.items import BY_RECORD
from m100link.protocol.records import Battery, FlightStatus, Position, Velocity
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

__all__ = ["lease", "monitor", "watch"]

_OLD_S = 2.0


async def _until(ended: asyncio.Event, seconds: float) -> bool:
    """Wait; whether it goes on."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await ended.wait()
    return not ended.is_set()


def monitor(
    *,
    rate: Annotated[float, Above0] = 2.0,
    duration: Annotated[float | None, Above0] = None,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Watch all aircraft until Ctrl-C: what each said last, and how old that is.

    Agents send each item five times a second for this, whatever its own rate is. With --json one
    object for each aircraft and second.

    Args:
        rate: Times a second that the table is drawn.
        duration: Seconds until it ends by itself.
        options: Which fleet.
    """

    async def run() -> None:
        ended = Told()
        if duration is not None:
            asyncio.get_running_loop().call_later(duration, ended.set)
        async with options.open() as fleet:
            heard = FleetTelemetry(fleet.bus, fleet.keys)
            if options.json_output:
                while await _until(ended, 1.0):
                    for name in in_order(fleet.present | set(heard.states)):
                        print_json(_told(fleet, heard, name))
                return
            with Live(console=out, auto_refresh=False) as live:
                while await _until(ended, 1 / rate):
                    live.update(_table(fleet, heard), refresh=True)

    return run_async(run())


def _told(fleet: Fleet, heard: FleetTelemetry, name: str) -> dict[str, Any]:
    state = heard.states.get(name)
    told: dict[str, Any] = {"name": name, "is_there": name in fleet.present}
    told["received"] = heard.received[name]
    if state is not None:
        told["age"] = state.newest_age
        told |= {
            BY_RECORD[kind].name: _plain(state, kind) for kind in (Position, Velocity, Battery)
        }
        told[BY_RECORD[FlightStatus].name] = _plain(state, FlightStatus)
    return told


def _plain(state: AircraftState, kind: type[Any]) -> dict[str, Any] | None:
    value = state.get(kind)
    return None if value is None else value._asdict()


def _table(fleet: Fleet, heard: FleetTelemetry) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("name", "age", "phase", "height", "speed", "battery", "place"):
        table.add_column(title)
    for name in in_order(fleet.present | set(heard.states)):
        state = heard.states.get(name)
        if state is None:
            table.add_row(name, "never heard")
            continue
        age, status, position = state.newest_age or 0.0, state.get(FlightStatus), state.position
        velocity, battery = state.velocity, state.battery
        phase = status.phase if status is not None else None
        row = [
            name,
            f"{age:.1f} s" if name in fleet.present else f"gone, {age:.0f} s",
            "" if phase is None else phase.name.lower().replace("_", " "),
            "" if position is None else f"{position.height_m:.1f} m",
            "" if velocity is None else f"{velocity.ground_speed_m_s:.1f} m/s",
            "" if battery is None else f"{battery.percent} %",
            "" if position is None else f"{position.latitude_deg:.6f} {position.longitude_deg:.6f}",
        ]
        is_old = age > _OLD_S or name not in fleet.present
        table.add_row(*row, style="red" if is_old else "")
    return table


def watch(
    name: str,
    /,
    *,
    duration: Annotated[float | None, Above0] = None,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Print every telemetry package of one aircraft until Ctrl-C: one JSON object for each.

    Args:
        name: Which.
        duration: Seconds until it ends by itself.
        options: Which fleet.
    """

    async def run() -> None:
        ended = Told()
        gone: ReaderGone | None = None

        def tell(_: str, sample: Sample) -> None:
            nonlocal gone
            if gone is not None:
                return
            try:
                print_json(_package(sample))
            except ReaderGone as error:
                # Whoever brings a sample takes no error, and later ones would go nowhere for ever.
                gone = error
                ended.set()

        if duration is not None:
            asyncio.get_running_loop().call_later(duration, ended.set)
        async with options.open() as fleet:
            keys = Keys(fleet.keys.site, name)
            heard = FleetTelemetry(fleet.bus, keys, full=True, on_sample=tell)
            await ended.wait()
            heard.close()
            err.print(f"{heard.received[name]} packages", markup=False)
        if gone is not None:
            raise gone

    return run_async(run())


def _package(sample: Sample) -> dict[str, Any]:
    told: dict[str, Any] = {"received_at": sample.received_at}
    for kind, item in BY_RECORD.items():
        value = sample.get(kind)
        if value is not None:
            told[item.name] = value._asdict()
    return told


def lease(
    name: str,
    /,
    *,
    take_over: Annotated[bool, Parameter(negative=())] = False,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Take control of one aircraft and hold it, hovering, until Ctrl-C.

    Meanwhile `fleet mission upload` and `start` of the same account act under this lease.

    Args:
        name: Which.
        take_over: Take it from whoever has it.
        options: Which fleet.
    """

    async def run() -> None:
        ended = Told()
        async with options.open() as fleet, fleet[name].control(take_over=take_over) as control:
            if options.json_output:
                print_json({"name": name, "fence": control.fence})
            else:
                out.print(f"{name}: lease {control.fence}, until Ctrl-C", markup=False)
            with shared(options.site, name, control.proof):
                await ended.wait()
                if not options.json_output:
                    err.print(f"{name}: control goes back: it hovers", markup=False)

    return run_async(run())
