"""``m100link record`` and ``m100link log``: write flight logs, and read what was written."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from m100link.aircraft import Aircraft, connect
from m100link.apps.cli.common import LinkOptions, Place, Url, err, out, run_async
from m100link.apps.cli.log_exports import layout, ros2
from m100link.apps.cli.log_frames import compare_files, frames
from m100link.apps.cli.log_plot import plot
from m100link.apps.cli.log_tables import csv, parquet
from m100link.apps.cli.log_wireshark import wireshark
from m100link.apps.cli.options import Above0, Firmware
from m100link.apps.cli.outcome import ExitCode, complain, print_json
from m100link.apps.cli.progress import reading, status
from m100link.errors import LinkError, UsageError
from m100link.log import FlightLog, Recorder, read, recover
from m100link.log.channels import COMMAND, EVENT
from m100link.log.drawing import clock, facts
from m100link.log.story import read_story

__all__ = ["app", "record"]

app = cyclopts.App(
    name="log",
    help="Look at flight logs, make tables of them, mend damaged ones; no aircraft is needed.",
    version_flags=(),
)

app.command(plot)
app.command(csv)
app.command(parquet)
app.command(wireshark)
app.command(ros2)
app.command(layout)
app.command(frames)
app.command(compare_files, name="compare")

_SPANS = ("phases", "control", "alarms")

Log = Path
"""A file that ``m100link record`` or ``connect(record=…)`` wrote."""


def record(
    url: Url = None,
    /,
    *,
    link: LinkOptions | None = None,
    output: Annotated[Path, Parameter(name=("--output", "-o"))] = Path(),
    rate: float = 10.0,
    duration: Annotated[float | None, Above0] = None,
) -> int:
    """Record what goes over the line, until Ctrl-C: every byte, and what the bytes say.

    It asks for the version once, and sends nothing else.

    Args:
        url: Where the aircraft is.
        link: How to talk to it.
        output: A file that is not there yet, or a folder for one that is named by the time; by
            default a file in the folder where you are.
        rate: Decoded telemetry at most so often, Hz; 0 for every package. The bytes of every
            package are recorded whatever it is.
        duration: Seconds until it ends by itself.
    """
    return run_async(_record((link or LinkOptions()).place(url), output, rate, duration))


async def _record(place: Place, output: Path, rate: float, duration: float | None) -> int:
    recorder = Recorder(output, rate_hz=rate)
    lost: LinkError | None = None
    ended = asyncio.Event()  # by whoever ends services, or closes the terminal
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, ended.set)
    try:
        async with connect(place.url, record=recorder, **place.arguments()) as aircraft:
            err.print(f"recording {place.url} into {recorder.path}; Ctrl-C ends it")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(duration):
                    lost = await _lost_or(aircraft, ended)
    finally:
        await recorder.aclose()
        if recorder.path.exists():  # where nothing was heard, nothing is left
            err.print(f"{recorder.path}: {recorder.path.stat().st_size:,} bytes")
    if recorder.failure is not None:
        return complain(UsageError(f"recording ended early: {recorder.failure}"))
    if lost is not None:
        return complain(lost)
    return ExitCode.OK


async def _lost_or(aircraft: Aircraft, ended: asyncio.Event) -> LinkError | None:
    """Wait until the line is lost, or it is ended: None."""
    lost = asyncio.ensure_future(aircraft.wait_closed())
    told = asyncio.ensure_future(ended.wait())
    try:
        await asyncio.wait((lost, told), return_when=asyncio.FIRST_COMPLETED)
        return lost.result() if lost.done() else None
    finally:
        for one in (lost, told):
            one.cancel()
        await asyncio.gather(lost, told, return_exceptions=True)


@app.command
def info(file: Log, /, *, firmware: Firmware | None = None, json: bool = False) -> int:
    """Say what a log holds: when, how long, phases, who had control, alarms, maxima.

    The exit status is 0 whatever happened on the flight, and 1 for a file that is damaged.

    Args:
        file: The log.
        firmware: Profile to read it by; by default that of the flight.
        json: One JSON object.
    """
    with reading(file, passes=4) as flight:
        summary, story = flight.summary(), read_story(flight, firmware=firmware)
    if json:
        spans = {name: [one._asdict() for one in getattr(story, name)] for name in _SPANS}
        maxima = {"maxima": asdict(story.maxima), "ended": story.ended}
        print_json(asdict(summary) | spans | maxima)
        return status(flight)
    began = summary.began_utc
    when = (
        "unknown" if began is None else time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(began))
    )
    out.print(f"{file}: began {when}, {summary.duration_s:.1f} s")
    out.print(f"firmware {summary.firmware or 'unknown'}")
    for name, value in facts(story)[1:-1]:
        out.print(f"  {name:<16} {value}")
    for name in _SPANS:
        for span in getattr(story, name):
            text = f"  {span.text}" if span.text else ""
            times = f"{clock(span.begin_s):>8} to {clock(span.end_s):<8}"
            out.print(f"  {name:<8} {times} {span.name}{text}", markup=False, soft_wrap=True)
    if story.ended is not None:
        out.print(f"ended: {story.ended}", markup=False)
    out.print(f"{summary.bytes_received:,} bytes received, {summary.bytes_sent:,} sent")
    for topic, count in sorted(summary.messages.items()):
        out.print(f"  {count:>8}  {topic}")
    if not summary.is_whole:
        out.print(f"not whole: {summary.damage}", markup=False, soft_wrap=True)
        out.print(f"what is there as a whole file: m100link log recover {file}", soft_wrap=True)
    return status(flight)


@app.command
def events(file: Log, /) -> int:
    """Print what happened, a JSON object on a line: commands, answers, authority, connection.

    Args:
        file: The log.
    """
    flight = read(file)
    for one in _told(flight):
        print_json(one)
    return status(flight)


def _told(flight: FlightLog) -> Iterator[dict[str, Any]]:
    for message in flight.messages(COMMAND, EVENT):
        yield {"utc": round(message.utc, 6), "at": round(message.at, 6), **message.content()}


@app.command(name="recover")
def recover_file(
    file: Log,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"))] = None,
) -> int:
    """Write a whole file from one that was cut off or damaged; the old one stays as it is.

    The exit status is 1 for a damaged file: what is missing there is missing in the new one.

    Args:
        file: The log.
        output: The new file; by default FILE with ``-recovered`` before its suffix.
    """
    target = output or file.with_stem(f"{file.stem}-recovered")
    saved = recover(file, target)
    out.print(f"{saved} messages saved in {target}", soft_wrap=True)
    return status(read(file))
