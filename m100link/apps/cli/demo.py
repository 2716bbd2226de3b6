"""``m100link demo``: a whole mission with the virtual aircraft over a real pseudo-terminal.

At ``--speed max`` the line is in memory, because a pseudo-terminal takes real time, and the clock
virtual: the same mission as fast as the machine computes, and equal for equal seeds.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import shlex
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from itertools import pairwise, starmap
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, validators
from rich.columns import Columns
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from m100link.aircraft import Aircraft
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.agent.server.connection import by_driver, by_url
from m100link.apps.cli.common import err, out
from m100link.apps.cli.display import line_plot, track_plot
from m100link.apps.cli.options import Simulated
from m100link.apps.cli.terminal import AS_IT_IS, ExitCode, LogOptions, as_json, complain, tell
from m100link.apps.station.config import RECORD_KEEP, RECORD_KEEP_MB
from m100link.errors import M100Error
from m100link.flight.control import Control
from m100link.flight.guards import Guards
from m100link.geodesy import LocalFrame
from m100link.link import LinkStatistics
from m100link.log.folder import Flights, default_folder
from m100link.protocol.records import Position
from m100link.sim import Driver, PtyPort, VirtualAircraft, loop_factory

_STAGES = ("connect", "activate", "obtain control", "take off", "square", "land", "release")

_FASTEST = 50.0
"""Beyond it, time-outs are shorter than a machine needs to wake up."""

_RETURN_TOLERANCE_M = 1.0

_PICTURE = 32
"""Columns of a picture in the summary; two stand side by side where there is room."""


@dataclass
class _Flight:
    stages: dict[str, float] = field(default_factory=dict)
    stage: str = ""
    note: str = ""
    track: list[tuple[float, float]] = field(default_factory=list)
    heights: list[tuple[float, float]] = field(default_factory=list)
    home: LocalFrame | None = None
    setpoints: int = 0
    battery_percent: int | None = None
    landed: bool = False
    firmware: Simulated = ""
    port: str = ""
    line: LinkStatistics | None = None
    flights: Flights | None = None

    @property
    def recording(self) -> str | None:
        newest = None if self.flights is None else self.flights.newest
        return None if newest is None else str(newest)

    @contextlib.contextmanager
    def during(self, stage: str) -> Iterator[None]:
        clock = asyncio.get_running_loop().time
        self.stage, self.note = stage, ""
        began_at = clock()
        yield
        self.stages[stage] = clock() - began_at
        self.stage = ""

    def add(self, position: Position, now: float) -> None:
        if not position.is_possible:
            return
        here = (position.latitude_deg, position.longitude_deg)
        if self.home is None:
            self.home = LocalFrame(*here)
        self.track.append(self.home.to_local(*here))
        self.heights.append((now, position.height_m))

    @property
    def returned_within_m(self) -> float:
        if not self.track:
            return math.inf
        return math.dist(self.track[0], self.track[-1])

    @property
    def path_length_m(self) -> float:
        return sum(starmap(math.dist, pairwise(self.track)))


def _is_speed(_: object, speed: float | str) -> None:
    if not isinstance(speed, str) and not 0.0 < speed <= _FASTEST:
        raise ValueError(f"must be above 0 and at most {_FASTEST:g}, or max")


def demo(
    *,
    speed: Annotated[float | Literal["max"], Parameter(validator=_is_speed)] = 1.0,
    side: Annotated[float, Parameter(validator=validators.Number(gte=1, lte=100))] = 8.0,
    firmware: Simulated = "1.0",
    seed: int = 1,
    record: Path | None = None,
    no_record: bool = False,
    log: LogOptions = AS_IT_IS,
) -> int:
    """Fly a square with a virtual aircraft, from take-off to landing.

    It needs no hardware: the line is a pseudo-terminal, on Windows in memory. Exit status 0 means
    that the aircraft has landed within a metre of its start.

    Args:
        speed: Speed, times real time; max waits for nothing, over a line in memory.
        side: Side of the square, m.
        seed: Seed of everything random.
        record: Folder for the flight log; by default m100link/flights of your state folder
            (~/.local/state), where the oldest logs make room.
        no_record: Record nothing.
    """
    flight = _Flight(flights=None if no_record else _flights(record))
    began_at = time.monotonic()
    failure: M100Error | None = None
    factor = math.inf if speed == "max" else float(speed)
    with asyncio.Runner(loop_factory=loop_factory(factor)) as runner:
        try:
            runner.run(_fly(flight, side, firmware, seed, factor, shows=not as_json()))
        except M100Error as error:
            failure = error
    summary = _summary(flight, speed, seed, time.monotonic() - began_at, failure)
    tell(summary, lambda: _print_summary(flight, summary))
    if failure is not None:
        return complain(failure)
    return ExitCode.OK if summary["flown"] else ExitCode.FAILED


async def _fly(
    flight: _Flight, side: float, firmware: str, seed: int, speed: float, *, shows: bool
) -> None:
    virtual = VirtualAircraft(seed=seed, firmware=firmware)
    driver = Driver(virtual)
    is_in_memory = math.isinf(speed) or sys.platform == "win32"
    flight.port = "a line in memory" if is_in_memory else PtyPort(driver).name
    shows_live = shows and not math.isinf(speed)
    display = asyncio.create_task(_display(flight, speed)) if shows_live else None
    try:
        with flight.during("connect"):
            if is_in_memory:
                aircraft = await by_driver(driver, flights=flight.flights)()
            else:
                aircraft = await by_url(f"serial://{flight.port}:230400", flights=flight.flights)()
        try:
            await _mission(aircraft, flight, virtual, side, 1.0 if math.isinf(speed) else speed)
        finally:
            flight.line = aircraft.statistics()
            await aircraft.aclose()
    finally:
        driver.stop()
        if display is not None:
            display.cancel()
            await asyncio.wait([display])


def _flights(record: Path | None) -> Flights:
    if record is not None:
        return Flights(record, tell=_say)
    return Flights(default_folder(), keep=RECORD_KEEP, keep_mb=RECORD_KEEP_MB, tell=_say)


def _say(text: str, level: str) -> None:
    if level != "info":  # where it is stands in the summary
        err.print(text, style="yellow")


async def _mission(
    aircraft: Aircraft, flight: _Flight, virtual: VirtualAircraft, side: float, speed: float
) -> None:
    flight.firmware = aircraft.firmware.name

    def tell(progress: ActivationProgress) -> None:
        flight.note = progress.code.meaning

    with flight.during("activate"):
        await aircraft.activate(virtual.credentials, progress=tell)
    await aircraft.wait_for(
        lambda state: state.position is not None and state.flight_status is not None,
        timeout=5,
        what="telemetry with position and flight status",
    )
    tracker = asyncio.create_task(_track(aircraft, flight))
    try:
        with flight.during("obtain control"):
            # A second of the clock on the wall: what is written into a pseudo-terminal comes out
            # when the kernel gets to it, however many seconds of flight go by meanwhile.
            guards = Guards(stale_telemetry_s=max(1.0, speed))
            control = await aircraft.control(stop="land", guards=guards).__aenter__()
        try:
            await _fly_square(control, flight, side)
        finally:
            with flight.during("release"):
                await control.__aexit__(*sys.exc_info())
    finally:
        tracker.cancel()
        await asyncio.wait([tracker])


async def _fly_square(control: Control, flight: _Flight, side: float) -> None:
    with flight.during("take off"):
        await control.take_off()
    home = control.local_frame()
    with flight.during("square"):
        for north, east in ((side, 0.0), (side, side), (0.0, side), (0.0, 0.0)):
            flight.note = f"to {north:g} m north, {east:g} m east"
            await control.fly_to(north=north, east=east, height=3.0, frame=home, speed=3.0)
        await control.stop()
        flight.setpoints = control.setpoints_sent
    with flight.during("land"):
        await control.land()
    flight.landed = True


async def _track(aircraft: Aircraft, flight: _Flight) -> None:
    async with aircraft.telemetry(Position, rate_hz=10) as samples:
        async for sample in samples:
            flight.add(sample[Position], sample.received_at)
            if aircraft.state.battery is not None:
                flight.battery_percent = aircraft.state.battery.percent


# -- what a person sees ------------------------------------------------------------------------


async def _display(flight: _Flight, speed: float) -> None:
    with Live(console=out, refresh_per_second=10, transient=True) as live:
        while True:
            live.update(_progress(flight))
            await asyncio.sleep(0.1 * speed)


def _progress(flight: _Flight) -> Group:
    table = Table(box=None, show_header=False, pad_edge=False)
    for stage in _STAGES:
        if stage in flight.stages:
            table.add_row(Text("✓", "green"), stage, f"{flight.stages[stage]:.1f} s")
        elif stage == flight.stage:
            table.add_row(Text("…", "yellow"), Text(stage, "bold"), flight.note)
        else:
            table.add_row("·", Text(stage, "dim"), "")
    parts: list[Any] = [table]
    if flight.track:
        north, east = flight.track[-1]
        battery = "" if flight.battery_percent is None else f"   battery {flight.battery_percent} %"
        parts.append(
            f"height {flight.heights[-1][1]:z5.2f} m   "
            f"north {north:z6.2f} m   east {east:z6.2f} m{battery}"
        )
        parts.append(Text("\n".join(track_plot(flight.track, columns=min(44, out.width), rows=10))))
    return Group(*parts)


def _summary(
    flight: _Flight, speed: float | str, seed: int, real_seconds: float, failure: M100Error | None
) -> dict[str, Any]:
    heights = [height for _, height in flight.heights]
    flown = failure is None and flight.landed and flight.returned_within_m <= _RETURN_TOLERANCE_M
    return {
        "flown": flown,
        "error": None if failure is None else failure.seen,
        "error_code": None if failure is None else failure.error_code,
        "firmware": flight.firmware,
        "seed": seed,
        "port": flight.port,
        "speed": speed,
        "seconds": round(sum(flight.stages.values()), 2),
        "real_seconds": round(real_seconds, 2),
        "stages": {stage: round(seconds, 2) for stage, seconds in flight.stages.items()},
        "returned_within_m": round(flight.returned_within_m, 3),
        "path_length_m": round(flight.path_length_m, 2),
        "max_height_m": round(max(heights, default=0.0), 2),
        "setpoints_sent": flight.setpoints,
        "battery_percent": flight.battery_percent,
        "recording": flight.recording,
        "line": None if flight.line is None else asdict(flight.line),
        "track": [[round(north, 2), round(east, 2)] for north, east in flight.track[::5]],
    }


def _print_summary(flight: _Flight, summary: dict[str, Any]) -> None:
    table = Table(title="mission flown" if summary["flown"] else "mission NOT flown", box=None)
    table.add_column("stage")
    table.add_column("seconds", justify="right")
    for stage in _STAGES:
        seconds = flight.stages.get(stage)
        table.add_row(stage, "—" if seconds is None else f"{seconds:.1f}")
    numbers = Table(box=None, show_header=False)
    line = flight.line
    for name, value in (
        ("flown over", f"{flight.port}, firmware {flight.firmware}, seed {summary['seed']}"),
        ("back within", f"{summary['returned_within_m']:.2f} m of the start"),
        ("path", f"{summary['path_length_m']:.1f} m, up to {summary['max_height_m']:z.1f} m high"),
        ("setpoints sent", str(summary["setpoints_sent"])),
        (
            "line",
            ""
            if line is None
            else f"{line.frames_received} frames in, {line.frames_sent} out, "
            f"{line.discarded_bytes} bytes discarded, {line.repeats} repeats",
        ),
        ("time", f"{summary['seconds']:.1f} s flown in {summary['real_seconds']:.1f} s"),
    ):
        numbers.add_row(Text(name, "bold"), value)
    out.print(table)
    out.print(numbers)
    if flight.track:
        track = ["track", *track_plot(flight.track, columns=_PICTURE, rows=14)]
        height = ["height", *line_plot(flight.heights, unit="m", columns=_PICTURE, rows=13)]
        out.print(Columns(Text("\n".join(picture)) for picture in (track, height)))
    if flight.recording is not None:
        quoted = shlex.quote(flight.recording)
        out.print(f"recorded in {flight.recording}", soft_wrap=True)
        out.print(f"to read it: m100link log report {quoted}", soft_wrap=True)
        text = f"to see it again, with the extra station: m100link replay {quoted}"
        out.print(text, soft_wrap=True)
