"""``m100link log frames`` and ``compare``: what went over the line, and how flights differ."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.cli.common import out
from m100link.apps.cli.options import Firmware
from m100link.apps.cli.outcome import print_json
from m100link.apps.cli.progress import reading, status
from m100link.link.keyfile import read_key
from m100link.log import read
from m100link.log.comparing import Comparison, compare
from m100link.log.frames import read_frames
from m100link.log.story import read_story
from m100link.wire import Cipher

__all__ = ["compare_files", "frames"]

_HEAD = {"utc", "at", "direction", "session", "is_ack", "sequence", "encrypted", "padding"}
_BODY = {"data", "command", "raw", "ciphertext"}


def frames(
    file: Path,
    /,
    *,
    key_file: Path | None = None,
    firmware: Firmware | None = None,
    json: Annotated[bool | None, Parameter(negative="--table")] = None,
) -> int:
    """Print every frame, decoded: telemetry, commands, setpoints, answers, and what was lost.

    Each is described as ``m100link decode`` does.

    Args:
        file: The log.
        key_file: File with the AES key, to decrypt setpoints and tasks.
        firmware: Profile to read them by; by default that of the flight.
        json: JSON lines instead of lines for people; the default when output is not a terminal.
    """
    cipher = None if key_file is None else Cipher(read_key(key_file))
    as_json = (not sys.stdout.isatty()) if json is None else json
    flight = read(file)
    for frame in read_frames(flight, firmware=firmware, cipher=cipher):
        if as_json:
            print_json(frame)
        else:
            out.print(_line(frame), soft_wrap=True, markup=False)
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


def compare_files(first: Path, second: Path, /, *, json: bool = False) -> int:
    """Say what differs between two flights: durations, maxima, track, line, commands, alarms.

    Tracks are laid over each other at take-off: each from its own take-off point and time.

    Args:
        first: A log.
        second: Another one.
        json: One JSON object.
    """
    flights, stories = [], []
    for file in (first, second):
        with reading(file, passes=2) as flight:
            flights.append(flight)
            stories.append(read_story(flight))
    found = compare(*stories)
    if json:
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
            f"apart over ground: {found.mean_apart_m:.1f} m in the mean, "
            f"{metres:.1f} m at the most, {after:.1f} s after take-off"
        )
    for title, lines in (("commands", found.commands), ("alarms", found.alarms)):
        out.print(f"{title}: {'the same' if not lines else ''}")
        for line in lines:
            out.print(f"  {line}", markup=False, soft_wrap=True)


def _shown(value: float | None, sign: str = "") -> str:
    return "" if value is None else f"{value:{sign}.4g}" if value % 1 else f"{value:{sign}.0f}"
