"""Standard output and error as people have them: closed pipes, terminals without Unicode.

:func:`speak_to_anybody` puts :class:`_Told` around both streams before a verb runs. ASCII replaces
a sign that a stream cannot encode (:func:`_in_ascii`). A write to a closed standard output raises
:class:`ReaderGone`, so that no verb mistakes it for a broken line to an aircraft. Standard error
raises nothing: its reader, its disk or its terminal is no reason to end or to refuse a landing.
"""

from __future__ import annotations

import codecs
import functools
import importlib.util
import io
import json
import logging
import math
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal, TextIO, cast

from cyclopts import Group, Parameter

from m100link import errors
from m100link.errors import UsageError
from m100link.errors.texts import printable

_LOOK_S = 0.2

_BRAILLE = range(0x2800, 0x2900)
_UPPER, _LOWER = 0x1B, 0xE4
"""Dots of a braille character's upper and lower two rows."""

# One character for one, so that columns stay columns.
_DRAWN = "°²µ×±·…–—→✓≤≥•−“”↑▲▼✗█░├└│┤─"
_ASCII = dict(zip(_DRAWN, 'd2ux~.~-->+<>*-""^^vx#.|`||-', strict=True))


class ReaderGone(OSError):
    """Standard output takes no more: its reader is gone, as behind ``| head``, or its disk is full.

    A reader that is gone is no error of the command. It is no BrokenPipeError: rich would end the
    process with 1.
    """


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    """The signs that a stream shows in place of those that it lacks."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(map(_replacement, lacking)), error.end


def _replacement(character: str) -> str:
    code = ord(character)
    if code not in _BRAILLE:
        return _ASCII.get(character, "?")
    return ((" ", "."), ("'", ":"))[bool(code & _UPPER)][bool(code & _LOWER)]


codecs.register_error("m100link.ascii", _in_ascii)


class _Reported:
    """A stream that says that its reader is gone, or keeps it to itself."""

    def __init__(self, stream: TextIO, *, raises: bool) -> None:
        self._stream = stream
        self._raises = raises

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._watched():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._watched():
            self._stream.flush()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # The rest of the buffer would fail once more when the interpreter ends.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if not self._raises:
                return
            raise ReaderGone(*error.args) from None


@contextmanager
def speak_to_anybody() -> Iterator[None]:
    """While the block runs, output fits its terminal, and a closed pipe has its own error.

    Raises:
        ReaderGone: From any write to standard output. Standard error passes it over: a flight does
            not end because nobody hears its talk.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed, as ``2>&-`` does: nothing else is to get its place
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))  # for good
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="m100link.ascii")
    sys.stdout = cast(TextIO, _Reported(before[0], raises=True))
    sys.stderr = cast(TextIO, _Reported(before[1], raises=False))
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = before


async def read_line() -> str:
    """The line typed on the terminal, empty after Ctrl-D. The loop serves the link meanwhile."""
    import asyncio

    loop = asyncio.get_running_loop()
    descriptor = sys.stdin.fileno()
    line: asyncio.Future[bytes] = loop.create_future()

    def on_readable() -> None:
        if not line.done():
            loop.call_soon_threadsafe(take, os.read(descriptor, 1024))

    def take(typed: bytes) -> None:
        if not line.done():
            line.set_result(typed)

    if sys.platform == "win32":  # no loop watches a console there
        threading.Thread(target=on_readable, daemon=True).start()
    else:
        loop.add_reader(descriptor, on_readable)
    try:
        while not line.done():
            # Python looks for signals when the wait ends: a Ctrl-C just before it began would be
            # taken with the next key, and nothing would end.
            await asyncio.wait([line], timeout=_LOOK_S)
        return line.result().decode(errors="replace").strip()
    finally:
        if sys.platform != "win32":
            loop.remove_reader(descriptor)


# -- keys of a terminal, without Enter -------------------------------------------------------------


_ESCAPES = {b"\x1b[A": "UP", b"\x1b[B": "DOWN", b"\x1b[D": "LEFT", b"\x1b[C": "RIGHT"}


def read_keys(data: bytes) -> list[str]:
    """The keys in the bytes of a terminal."""
    keys = []
    while data:
        for escape, name in _ESCAPES.items():
            if data.startswith(escape):
                keys.append(name)
                data = data[len(escape) :]
                break
        else:
            keys.append(chr(data[0]))
            data = data[1:]
    return keys


@contextmanager
def keys_pressed(press: Callable[[str], object]) -> Iterator[bool]:
    """Hand on the keys that are pressed while the block runs, in the event loop.

    Whether there is a terminal, on a system that has its modes.
    """
    if importlib.util.find_spec("termios") is None or not sys.stdin.isatty():
        yield False
        return
    import asyncio  # decoding a frame needs none of these
    import termios
    import tty

    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()

    def on_keys() -> None:
        for key in read_keys(os.read(descriptor, 64)):
            press(key)

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    loop.add_reader(descriptor, on_keys)
    try:
        yield True
    finally:
        loop.remove_reader(descriptor)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


# -- how a command ends, and what it prints for programs; loads no aircraft and no console ---------


_TYPED = {
    "await control.take_off() first; a waypoint mission takes take_off=True": "m100link takeoff "
    "first; or --takeoff",
    "await control.take_off()": "m100link takeoff",
    "asyncio.Runner(loop_factory=m100link.sim.loop_factory(SPEED)), ": "leave the speed out; ",
    "infinity for max; or m100link.sync, which makes its own; or ": "an aircraft with one is ",
    "connect(..., firmware='3.1')": "--firmware 3.1",
    "control(guards=Guards(envelope=Envelope(max_height_m=…)))": "--max-height",
    "control(guards=Guards(envelope=Envelope(max_radius_m=…)))": "--max-radius",
    "fly slower, or control(guards=Guards(envelope=Envelope(max_speed_m_s=…)))": "fly slower",
    "close what is open, or fly without one: control(guardian=False)": "close other programs",
    "docs: howto/silent-line": "m100link docs silent-line",
}
"""Remedies for a program, and the same for a person at a shell."""


LINES = "\n\t"
"""Characters that text for a terminal keeps, of those that steer it."""


class ExitCode:
    """Exit status classes."""

    OK = 0
    FAILED = 1
    USAGE = 2
    PORT = 3
    NO_LINK = 4
    ACTIVATION = 5
    AUTHORITY = 6
    REFUSED = 7
    TIMEOUT = 8
    NO_ROUTER = 9
    INTERRUPTED = 130


# The first class that fits decides, so subclasses stand before their bases.
_EXIT_CODES: tuple[tuple[type[BaseException] | tuple[type[BaseException], ...], int], ...] = (
    (errors.NoRouter, ExitCode.NO_ROUTER),
    (errors.UsageError, ExitCode.USAGE),
    ((errors.NoAircraft, errors.LinkLost, errors.LineBlocked), ExitCode.NO_LINK),
    (errors.LinkError, ExitCode.PORT),
    ((errors.ActivationRefused, errors.NotActivated), ExitCode.ACTIVATION),
    ((errors.LevelTooLow, errors.KeyRejected), ExitCode.ACTIVATION),
    ((errors.AuthorityRefused, errors.AuthorityError), ExitCode.AUTHORITY),
    ((errors.GuardRefused, errors.CommandRefused), ExitCode.REFUSED),
    (TimeoutError, ExitCode.TIMEOUT),
    (errors.M100Error, ExitCode.FAILED),
)


def exit_code(error: BaseException) -> int:
    """The exit status for an error."""
    return next((code for kind, code in _EXIT_CODES if isinstance(error, kind)), ExitCode.FAILED)


def complain(error: BaseException) -> int:
    """Print an error on standard error. Returns its exit status."""
    # The console takes longer to load than a frame to decode.
    from rich.console import Console

    # A line in a pipe stays one, so that no path in it breaks.
    err = Console(stderr=True, highlight=False, markup=False, soft_wrap=not sys.stderr.isatty())
    err.print("error: ", style="bold red", end="")
    text = str(error)
    for written, typed in _TYPED.items():
        text = text.replace(written, typed)
    if isinstance(error, errors.M100Error):
        text += f"\n  code:         {error.error_code}"
    err.print(printable(text, keeps=LINES))
    return exit_code(error)


def print_json(value: Any) -> None:
    """One JSON object on one line of standard output; in ASCII where a sign would not print."""
    dump = functools.partial(json.dumps, finite(value), allow_nan=False, default=str)
    text = dump(ensure_ascii=False)
    fits = text.isprintable() and sys.stdout.encoding == "utf-8"
    sys.stdout.write((text if fits else dump()) + "\n")
    sys.stdout.flush()


class OutputFormat:
    """The format that ``--json`` or ``--table`` asks for, of the verb that runs."""

    json: bool | None = None


def as_json() -> bool:
    """Whether it prints JSON: as was asked for, by default in a pipe."""
    return not sys.stdout.isatty() if OutputFormat.json is None else OutputFormat.json


def tell(facts: dict[str, Any], *shown: str | Callable[[], object]) -> int:
    """Print an object of JSON, or for people lines and what else is shown."""
    if as_json():
        print_json(facts)
        return ExitCode.OK
    for one in shown:
        if callable(one):
            one()
        else:
            sys.stdout.write(f"{printable(one, keeps=LINES)}\n")
    return ExitCode.OK


def tell_text(text: str, facts: dict[str, Any] | None = None) -> int:
    """Print a text that is itself the result, in a pipe, too; with ``--json`` its facts, or it."""
    if OutputFormat.json:
        print_json({"text": text} if facts is None else facts)
    else:
        sys.stdout.write(text)
    return ExitCode.OK


def finite(value: Any) -> Any:
    """JSON has no NaN and no infinity: they become their names."""
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


# -- what is logged on standard error, and the options that say it ---------------------------------

_PANELS = (
    *("Aircraft", "App registered with DJI", "Safety", "rosbridge", "Console", "Access"),
    *("MAVLink", "ROS 2", "Foxglove and Prometheus", "Fleet", "Flight logs", "Port"),
    *("Site and sensors", "Missions", "Line faults", "Start and output", "Log", "Rarely needed"),
)
"""Groups of options in the order in which a help text shows them."""


def shown_default(default: Any) -> Any:
    """A default as the help shows it; None for an option that is off or not given."""
    if default is None or default is False or default in ((), ""):
        return None
    return " ".join(default) if isinstance(default, tuple) else str(default)


def panel(title: str) -> Group:
    """The group of options with this title."""
    return Group(title, sort_key=_PANELS.index(title))


@Parameter(name="*", group=panel("Log"))
@dataclass(frozen=True)
class LogOptions:
    """The log on standard error.

    Attributes:
        log_level: Lowest level to log (M100LINK_LOG), warning by default; debug has every frame,
            cut short. No key, token or app id is logged.
        log_json: Log one JSON object per line: time, level, logger, message, aircraft.
    """

    log_level: Literal["debug", "info", "warning", "error"] | None = None
    log_json: bool = False


AS_IT_IS = LogOptions()
"""Nothing was asked for."""

_LINES = logging.Formatter("%(levelname)s: %(message)s")  # unless somebody asks for others


class _ToStandardError(logging.StreamHandler[TextIO]):
    """To what standard error is now: a live display takes it over, and writes above itself."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr  # the one before is flushed by each line, and may be closed
        super().emit(record)


def _level() -> str:
    level = os.environ.get("M100LINK_LOG", "WARNING").upper()
    if level not in logging.getLevelNamesMapping():
        remedy = "set it to DEBUG, INFO, WARNING or ERROR"
        raise UsageError(f"M100LINK_LOG is {level!r}", remedy=remedy)
    return level


def show_warnings() -> None:
    """Print warnings on standard error. Raises UsageError: M100LINK_LOG is no level."""
    handler = _ToStandardError()
    handler.setFormatter(_LINES)
    logger = logging.getLogger("m100link")
    logger.addHandler(handler)
    logger.setLevel(_level())


def logging_as_asked(arguments: Iterable[Any]) -> AbstractContextManager[None]:
    """Logs as the options of a verb say while it is entered; a verb without them logs as before.

    The options are one of the verb's arguments, or the attribute ``log`` of one, or of how a
    station is run. Such a verb has an aircraft or clients, so a thread writes.
    """
    found = (getattr(run := getattr(one, "run", one), "log", run) for one in arguments)
    asked = next((one for one in found if isinstance(one, LogOptions)), None)
    if asked is None:
        return nullcontext()
    from m100link.apps.station.log_output import LogOutput, writing_log

    output = LogOutput(asked.log_level or _level().lower(), asked.log_json)
    return writing_log(output, _LINES if asked == AS_IT_IS else None)
