"""Standard output and error as people have them: closed pipes, terminals without Unicode.

Reading:
    :func:`speak_to_anybody` puts :class:`_Told` around both streams before a verb runs. What a
    stream cannot encode becomes ASCII (:func:`_in_ascii`); that nobody reads standard output any
    more is :class:`ReaderGone`, wherever it was written, and never mistaken for a line to an
    aircraft that broke.
"""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import TextIO, cast

_LOOK_S = 0.2

_BRAILLE = range(0x2800, 0x2900)
_UPPER, _LOWER = 0x1B, 0xE4
"""Dots of a braille character's upper and lower two rows."""

# One character for one: what was laid out in columns stays in them.
_ASCII = {
    "°": "d",
    "²": "2",
    "µ": "u",
    "×": "x",
    "±": "~",
    "·": ".",
    "…": "~",
    "–": "-",
    "—": "-",
    "→": ">",
    "✓": "+",
    "≤": "<",
    "≥": ">",
    "•": "*",
    "−": "-",
    "“": '"',
    "”": '"',
    "↑": "^",
    "▲": "^",
    "▼": "v",
    "✗": "x",
    "█": "#",
    "░": ".",
    "├": "|",
    "└": "`",
    "│": "|",
    "┤": "|",
    "─": "-",
}


class ReaderGone(OSError):
    """Nobody reads standard output any more, as behind ``| head``. Not an error of the command.

    It is no BrokenPipeError: rich would end the process with 1.
    """


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    """What a stream of few characters shows in place of those that it lacks."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(map(_replacement, lacking)), error.end


def _replacement(character: str) -> str:
    code = ord(character)
    if code not in _BRAILLE:
        return _ASCII.get(character, "?")
    dots = code - _BRAILLE.start
    return (" ", "'", ".", ":")[bool(dots & _UPPER) + 2 * bool(dots & _LOWER)]


codecs.register_error("m100link.ascii", _in_ascii)


class _Told:
    """A stream that says that its reader is gone, or keeps it to itself."""

    def __init__(self, stream: TextIO, *, raises: bool) -> None:
        self._stream = stream
        self._raises = raises

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As the stream does."""
        with self._watched():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """As the stream does."""
        with self._watched():
            self._stream.flush()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError as error:
            # What is still buffered would fail once more when the interpreter ends.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if self._raises:
                raise ReaderGone(*error.args) from None


@contextlib.contextmanager
def speak_to_anybody() -> Iterator[None]:
    """While the block runs, output fits its terminal, and a closed pipe is told as what it is.

    Raises:
        ReaderGone: From any write to standard output. Standard error passes it over: a flight does
            not end because nobody hears its talk.
    """
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="m100link.ascii")
    sys.stdout = cast(TextIO, _Told(before[0], raises=True))
    sys.stderr = cast(TextIO, _Told(before[1], raises=False))
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = before


async def read_line() -> str:
    """What a person types on the terminal of standard input, up to Enter; empty after Ctrl-D.

    The loop runs meanwhile: Ctrl-C ends it at once, and the link is served.
    """
    import asyncio

    loop = asyncio.get_running_loop()
    descriptor = sys.stdin.fileno()
    line: asyncio.Future[bytes] = loop.create_future()

    def on_readable() -> None:
        if not line.done():
            line.set_result(os.read(descriptor, 1024))

    loop.add_reader(descriptor, on_readable)
    try:
        while not line.done():
            # Python looks for signals when the wait ends: a Ctrl-C just before it began would be
            # taken with the next key, and nothing would end.
            await asyncio.wait([line], timeout=_LOOK_S)
        return line.result().decode(errors="replace").strip()
    finally:
        loop.remove_reader(descriptor)
