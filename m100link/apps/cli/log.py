"""``m100link record`` and ``m100link log``: write flight logs, and read what was written."""

from __future__ import annotations

import asyncio
import contextlib
import csv as csv_module
import json
import os
import sys
import time
from codecs import StreamWriter, getwriter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import IO, Annotated, Any, TextIO

from cyclopts import Parameter

from m100link.aircraft import Aircraft
from m100link.apps.agent.background import when_signalled
from m100link.apps.cli.common import BY_LINK, LinkOptions, Url, err, out
from m100link.apps.cli.display import Items, items_named, reading, status
from m100link.apps.cli.options import OUTPUT, AtMost, Firmware, group
from m100link.apps.cli.terminal import ExitCode, OutputFormat, as_json, print_json, tell, tell_text
from m100link.errors import LinkError, UsageError
from m100link.errors.texts import read_json
from m100link.link.keyfile import read_key
from m100link.log import Recorder, read, recover
from m100link.log.channels import COMMAND, EVENT
from m100link.log.channels import layout as layout_of_panels
from m100link.log.pcapng import dissector, read_frames, write_pcapng
from m100link.log.picture import Comparison, clock, compare, facts, line_quality
from m100link.log.reading import write_parquet
from m100link.log.report import report
from m100link.log.ros2 import write_bag
from m100link.log.share import share
from m100link.log.story import FlightSummary, read_story
from m100link.wire import Cipher

Log = Annotated[Path, Parameter(help="A flight log.")]
"""A file that ``m100link record`` or ``connect(record=…)`` wrote."""

AsFlown = Annotated[
    Firmware | None, Parameter(help="Firmware profile to read by; by default that of the flight.")
]

KeyFile = Annotated[
    Path | None, Parameter(help="File with the AES key; with it, encrypted frames are decoded.")
]

Output = Annotated[Path | None, OUTPUT, Parameter(help="A new file; by default one beside FILE.")]
ToFile = Annotated[Path | None, OUTPUT, Parameter(help="A new file; by default standard output.")]


# -- ``m100link log ros2`` and ``layout``: flights for the tools of others -------------------------


def ros2(file: Log, /, *, output: Output = None, firmware: AsFlown = None) -> int:
    """Write a ROS 2 bag: MCAP with CDR messages, for ros2 bag, rosbags and Foxglove.

    By default its name is FILE with ``-ros2`` before the suffix.
    """
    target = output or file.with_stem(f"{file.stem}-ros2")
    with reading(file) as flight, new_file(target) as stream:
        count = write_bag(flight, stream, firmware=firmware)
    tell({"messages": count, "file": str(target)}, f"{count} messages in {target}")
    return status(flight)


def layout(*, output: ToFile = None) -> int:
    """Print a layout for Foxglove and Lichtblick: map, height, speed, battery, attitude, events.

    Import it there: Layouts, Import from file.
    """
    text = json.dumps(layout_of_panels(), indent=2) + "\n"
    if output is None:
        return tell_text(text, read_json(text))
    write_new(output, text.encode())
    return tell({"file": str(output)}, f"layout in {output}")


# -- ``m100link log csv`` and ``parquet``: telemetry as tables, a row per package ------------------


def csv(file: Log, /, *items: Items, output: ToFile = None, firmware: AsFlown = None) -> int:
    """Print telemetry as CSV: every package, decoded from its bytes.

    The columns are those of ``m100link echo --csv``; a value that a package lacks is empty.
    """
    records = items_named(items)
    with reading(file) as flight, contextlib.ExitStack() as stack:
        names, rows = flight.rows(*records, firmware=firmware)
        stream: TextIO | StreamWriter = sys.stdout
        if output is not None:
            stream = getwriter("utf-8")(stack.enter_context(new_file(output)))
        if output is None and OutputFormat.json:
            for row in rows:
                known = zip(names, row, strict=True)
                print_json({name: value for name, value in known if value == value})
            return status(flight)
        writer = csv_module.writer(stream, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            writer.writerow("" if value != value else round(value, 9) for value in row)
    if output is not None:
        tell({"file": str(output)})
    return status(flight)


def parquet(file: Log, /, *items: Items, output: Output = None, firmware: AsFlown = None) -> int:
    """Write telemetry as a Parquet file: every package, decoded from its bytes.

    The columns are those of ``m100link log csv``; a value that a package lacks is null.
    """
    records = items_named(items)
    target = output or file.with_suffix(".parquet")
    with reading(file) as flight, new_file(target) as stream:
        count = write_parquet(flight, stream, *records, firmware=firmware)
    tell({"rows": count, "file": str(target)}, f"{count} rows in {target}")
    return status(flight)


# -- ``m100link log wireshark``: a log for Wireshark, and the plugin that reads it -----------------


_PLUGIN = "m100.lua"


def wireshark(
    file: Path | None = None,
    /,
    *,
    output: Output = None,
    key_file: KeyFile = None,
    firmware: AsFlown = None,
    install: bool = False,
    plugin: Path | None = None,
) -> int:
    """Write a log as pcapng, a packet per frame, and the plugin with which Wireshark reads it.

    With a key, a second interface has each encrypted frame decrypted, after the frame itself.

    Args:
        file: A flight log; none with ``--install`` or ``--plugin`` alone.
        install: Install the plugin in Wireshark's folder, in place of an older one.
        plugin: Write the plugin into this new file: ``tshark -X lua_script:FILE -r …``.
    """
    if file is None and not install and plugin is None:
        raise UsageError("no log is named", remedy="name one, or give --install alone")
    cipher = None if key_file is None else Cipher(read_key(key_file))
    if plugin is not None:
        with new_file(plugin) as stream:
            stream.write(dissector().encode())
        tell({"plugin": str(plugin)}, f"plugin in {plugin}")
    if install:
        there = _install()
        words = f"plugin in {there}; Wireshark: Analyze, Reload Lua Plugins"
        tell({"plugin": str(there)}, words)
    if file is not None:
        target = output or file.with_suffix(".pcapng")
        with reading(file) as flight, new_file(target) as stream:
            count = write_pcapng(flight, stream, firmware=firmware, cipher=cipher)
        tell({"packets": count, "file": str(target)}, f"{count} packets in {target}")
        return status(flight)
    return ExitCode.OK


def _install() -> Path:
    place = Path.home() / ".local/lib/wireshark/plugins" / _PLUGIN
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(dissector(), encoding="utf-8")
    except OSError as error:
        raise cannot_write(place, error) from error
    return place


# -- ``m100link log frames`` and ``compare``: what went over the line, and how flights differ ------


_HEAD = {"utc", "at", "direction", "session", "is_ack", "sequence", "encrypted", "padding"}
_BODY = {"data", "command", "raw", "ciphertext"}


def frames(file: Log, /, *, key_file: KeyFile = None, firmware: AsFlown = None) -> int:
    """Print every frame as ``m100link decode`` does, and where bytes were lost."""
    cipher = None if key_file is None else Cipher(read_key(key_file))
    flight = read(file)
    for frame in read_frames(flight, firmware=firmware, cipher=cipher):
        tell(frame, _line(frame))
    return status(flight)


def _line(frame: dict[str, Any]) -> str:
    head = f"{frame['at']:>11.3f} {frame['direction']}"
    if "cause" in frame:
        return f"{head} lost: {frame['cause']} ({frame['discards']})"
    marks = ("ack" if frame["is_ack"] else "   ") + (" aes" if frame["encrypted"] else "    ")
    known = ", ".join(
        f"{name}={value}" for name, value in frame.items() if name not in _HEAD | _BODY
    )
    said = frame["command"] or "?"
    return (
        f"{head} {frame['session']:>2}/{frame['sequence']:<5} {marks} {said:<18} {known}".rstrip()
    )


def compare_files(first: Log, second: Log, /) -> int:
    """Compare two flights: durations, maxima, tracks, line, commands, alarms.

    Each track counts from its own take-off point and time.
    """
    flights, stories = [], []
    for file in (first, second):
        with reading(file) as flight:
            flights.append(flight)
            stories.append(read_story(flight))
    found = compare(*stories)
    if as_json():
        shown = asdict(found) | {"mean_apart_m": found.mean_apart_m}
        shown["apart"] = [one._asdict() for one in found.apart]
        shown["values"] = [asdict(one) | {"by": one.by} for one in found.values]
        print_json(shown)
    else:
        _print_comparison(found, first.name, second.name)
    return status(*flights)


def _print_comparison(found: Comparison, first: str, second: str) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for title in (first, second, "difference"):
        table.add_column(title, justify="right", overflow="fold")
    for one in found.values:
        if one.first is not None or one.second is not None:
            table.add_row(one.name, _shown(one.first), _shown(one.second), _shown(one.by, "+"))
    out.print(table)
    if found.most_apart is not None:
        after, metres = found.most_apart
        out.print(
            f"apart over ground: {found.mean_apart_m:.1f} m on average, "
            f"at most {metres:.1f} m, {after:.1f} s after take-off"
        )
    for title, lines in (("commands", found.commands), ("alarms", found.alarms)):
        out.print(f"{title}: {'the same' if not lines else ''}")
        for line in lines:
            out.print(f"  {line}", soft_wrap=True)


def _shown(value: float | None, sign: str = "") -> str:
    return "" if value is None else f"{value:{sign}.4g}" if value % 1 else f"{value:{sign}.0f}"


# -- ``m100link log plot``: a flight as a page or a picture ----------------------------------------


def plot(file: Log, /, *, output: Output = None, firmware: AsFlown = None) -> int:
    """Draw a flight: track, height, speeds, battery, line, phases, alarms, commands.

    By default it is a page (.html), which needs only a browser and no network. A picture (.png)
    needs matplotlib.
    """
    target = output or file.with_suffix(".html")
    if target.suffix.lower() not in (".html", ".htm", ".png"):
        raise UsageError(
            f"{target} is neither a page nor a picture", remedy="end the name in .html or .png"
        )
    if os.path.exists(target):
        raise _is_there(target)
    with reading(file) as flight:
        story = read_story(flight, firmware=firmware)
    write_new(target, _drawn(story, target))
    tell({"file": str(target)}, f"drawn into {target}")
    return status(flight)


def _drawn(story: FlightSummary, target: Path) -> bytes:
    if target.suffix.lower() == ".png":
        from m100link.log.picture import picture  # loads matplotlib

        return picture(story)
    from m100link.log.picture import page

    return page(story).encode()


def write_new(target: Path, data: bytes) -> None:
    """Write a new file. Raises UsageError: it is there already, or it cannot be written."""
    with new_file(target) as stream:
        stream.write(data)


@contextlib.contextmanager
def new_file(target: Path) -> Iterator[IO[bytes]]:
    """A new file, whole or not at all. Raises UsageError: it is there, or it cannot be written."""
    try:
        stream = target.open("xb")
    except OSError as error:
        raise cannot_write(target, error) from error
    try:
        with stream:
            yield stream
    except OSError as error:
        target.unlink()
        raise cannot_write(target, error) from error
    except BaseException:
        target.unlink()
        raise


def cannot_write(target: Path, error: OSError) -> UsageError:
    """The error for a file that cannot be written."""
    if isinstance(error, FileExistsError):
        return _is_there(target)
    return UsageError(
        f"{target} cannot be written: {error.strerror or error}", remedy="name another file with -o"
    )


def _is_there(target: Path) -> UsageError:
    return UsageError(f"{target} is there already", remedy="name another file with -o")


# -- log -------------------------------------------------------------------------------------------

app = group("log", "Read, convert, compare and repair flight logs, without an aircraft.")

for _verb in (plot, csv, parquet, wireshark, ros2, layout, frames):
    app.command(_verb)
app.command(compare_files, name="compare")

_SPANS = ("phases", "control", "alarms")


async def record(
    url: Url = None,
    /,
    *,
    link: LinkOptions = BY_LINK,
    output: Annotated[Path, OUTPUT] = Path(),
    rate: float = 10.0,
    duration: AtMost = None,
) -> None:
    """Record every byte on the line, and its meaning, until Ctrl-C.

    The command asks for the version once, and sends nothing else.

    Args:
        output: A new file, or a folder for a file named by the time; by default this folder.
        rate: Decoded telemetry at most so often, Hz; 0 for every package. The log has the bytes
            of every package in any case.
    """
    place = link.place(url)
    recorder = Recorder(output, rate_hz=rate)
    lost: LinkError | None = None
    size = 0
    ended = asyncio.Event()  # by SIGTERM, or a closed terminal
    when_signalled(ended.set, "SIGTERM", "SIGHUP")
    try:
        async with place.connect(recorder) as aircraft:
            err.print(f"recording {place.url} into {recorder.path}; Ctrl-C ends it")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(duration):
                    lost = await _lost_or(aircraft, ended)
    finally:
        await recorder.aclose()
        if recorder.path.exists():  # where nothing was heard, nothing is left
            size = recorder.path.stat().st_size
            err.print(f"{recorder.path}: {size:,} bytes")
    if recorder.failure is not None:
        raise UsageError(
            f"recording ended early: {recorder.failure}",
            remedy="make room, or name another folder with -o",
        )
    if lost is not None:
        raise lost
    tell({"file": str(recorder.path), "bytes": size})


async def _lost_or(aircraft: Aircraft, ended: asyncio.Event) -> LinkError | None:
    """Wait until the line is lost, or it is ended: None."""
    lost = asyncio.ensure_future(aircraft.wait_closed())
    waiting = asyncio.ensure_future(ended.wait())
    try:
        await asyncio.wait((lost, waiting), return_when=asyncio.FIRST_COMPLETED)
        return lost.result() if lost.done() else None
    finally:
        for one in (lost, waiting):
            one.cancel()
        await asyncio.gather(lost, waiting, return_exceptions=True)


@app.command
def info(file: Log, /, *, firmware: AsFlown = None) -> int:
    """Summarize a log: time, duration, phases, holders of control, alarms, maxima.

    The exit status is 0 whatever happened on the flight, and 1 for a damaged file.
    """
    with reading(file) as flight:
        summary, story = flight.summary(), read_story(flight, firmware=firmware)
    if as_json():
        spans = {name: [one._asdict() for one in getattr(story, name)] for name in _SPANS}
        maxima = {"maxima": asdict(story.maxima), "ended": story.ended}
        line = {"line": story.line, "lost_share": story.lost_share}
        print_json(asdict(summary) | spans | maxima | line)
        return status(flight)
    began = summary.began_utc
    when = (
        "unknown" if began is None else time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(began))
    )
    out.print(f"{file}: began {when}, {summary.duration_s:.1f} s")
    out.print(f"firmware {summary.firmware or 'unknown'}")
    out.print(f"acceleration came {summary.acceleration or 'in an unknown mode'}")
    for name, value in facts(story)[1:-1]:
        out.print(f"  {name:<16} {value}")
    for name in _SPANS:
        for span in getattr(story, name):
            text = f"  {span.text}" if span.text else ""
            times = f"{clock(span.begin_s):>8} to {clock(span.end_s):<8}"
            out.print(f"  {name:<8} {times} {span.name}{text}", soft_wrap=True)
    if story.ended is not None:
        out.print(f"ended: {story.ended}")
    out.print(f"{summary.bytes_received:,} bytes received, {summary.bytes_sent:,} sent")
    if story.line:
        out.print(f"line: {line_quality(story)}", soft_wrap=True)
    for topic, count in sorted(summary.messages.items()):
        out.print(f"  {count:>8}  {topic}")
    if not summary.is_whole:
        out.print(f"not whole: {summary.damage}", soft_wrap=True)
        out.print(f"to save the rest as a whole file: m100link log recover {file}", soft_wrap=True)
    return status(flight)


@app.command(name="report")
def report_file(file: Log, /, *, firmware: AsFlown = None) -> int:
    """Tell a flight in sentences: holders of control, orders and outcomes, and the end.

    In brackets is what the aircraft did then, by its telemetry: place from the take-off point,
    height above it, velocity over ground, battery, GPS.

    Names of clients are in logs of `serve`, `console`, `mavlink`, `ros2` and fleets. The last line
    has the quality of the line.
    """
    with reading(file) as flight:
        story = read_story(flight, firmware=firmware)
        said = report(flight, story, firmware=firmware)
    shown_at = -1.0
    for one in said:
        if as_json():
            print_json(one._asdict() | {"flown": one.flown._asdict()})
            continue
        flown = str(one.flown) if one.at_s - shown_at >= 0.1 else ""
        shown_at = one.at_s if flown else shown_at
        text = f"{one.at_s:9.2f} s  {one.text}" + (f"\n{'':13}[{flown}]" if flown else "")
        out.print(text, soft_wrap=True, highlight=False)
    if not as_json():
        out.print(f"line: {line_quality(story)}", soft_wrap=True)
    return status(flight)


@app.command
def events(file: Log, /) -> int:
    """Print the events: commands, answers, authority, connection."""
    flight = read(file)
    for message in flight.messages(COMMAND, EVENT):
        times, content = (
            {"utc": round(message.utc, 6), "at": round(message.at, 6)},
            message.content(),
        )
        words = ", ".join(f"{name}={value}" for name, value in content.items())
        tell(times | content, f"{message.at:>11.3f} {words}")
    return status(flight)


@app.command(name="share")
def share_file(file: Log, /, *, output: Output = None, firmware: AsFlown = None) -> int:
    """Write a copy for strangers: place moved, names, serial numbers and the app id out.

    By default its name is FILE with ``-shared`` before the suffix. The shape of the flight, its
    heights and its times stay, and the magnetic field as it was measured.
    """
    target = output or file.with_stem(f"{file.stem}-shared")
    with reading(file) as flight, new_file(target) as stream:
        removed = share(flight, stream, firmware=firmware)
    streams = "bytes sent, and those received but telemetry", "all"
    lines = [f"  {count:>8}  {what}" for what, count in [*sorted(removed.items()), streams]]
    facts = {"removed": dict(removed), "file": str(target)}
    tell(facts, "removed, or changed as it says:", *lines, f"the copy is {target}")
    return status(flight)


@app.command(name="recover")
def recover_file(file: Log, /, *, output: Output = None) -> int:
    """Write a whole file from a damaged or cut one, which stays as it is.

    By default its name is FILE with ``-recovered`` before the suffix. The exit status is 1 for a
    damaged file: the new one lacks what the old one lacks.
    """
    target = output or file.with_stem(f"{file.stem}-recovered")
    saved = recover(file, target)
    tell({"messages": saved, "file": str(target)}, f"{saved} messages saved in {target}")
    return status(read(file))
