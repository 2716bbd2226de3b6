"""How far a log is read: a bar on a terminal, for what takes longer than a second."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from m100link.apps.cli.common import err
from m100link.apps.cli.outcome import ExitCode
from m100link.log import FlightLog, read

__all__ = ["reading", "status"]

_PATIENCE_S = 1.0


def status(*flights: FlightLog) -> int:
    """The exit status of a verb that read logs: of a damaged one it did what could be done."""
    return ExitCode.FAILED if any(flight.damage for flight in flights) else ExitCode.OK


@contextlib.contextmanager
def reading(file: Path, *, passes: int = 1) -> Iterator[FlightLog]:
    """A log; while the block runs, a terminal shows how far it is read. A pipe shows nothing.

    Args:
        file: The log.
        passes: How often it will be read.

    Raises:
        UsageError: As :func:`m100link.log.read`.
    """
    flight = read(file)
    if not err.is_terminal:
        yield flight
        return
    words = TextColumn("reading [progress.percentage]{task.percentage:>3.0f} %")
    bar = Progress(words, BarColumn(), TimeRemainingColumn(), console=err, transient=True)
    try:
        yield _Watched(flight.path, bar, passes)
    finally:
        bar.stop()


class _Watched(FlightLog):
    """A log that shows how far its file is read."""

    def __init__(self, path: Path, bar: Progress, passes: int) -> None:
        super().__init__(path)
        self._bar = bar
        self._began = time.monotonic()
        self._size = max(1, path.stat().st_size)
        self._task = bar.add_task("", total=passes * self._size)
        self._done = 0  # bytes of passes that came to their end

    def _open(self) -> IO[bytes]:
        return _Shown(self.path, self)

    def show(self, position: int) -> None:
        """So many bytes of this pass are read."""
        if time.monotonic() - self._began > _PATIENCE_S:
            self._bar.start()
            self._bar.update(self._task, completed=self._done + min(position, self._size))

    def end(self, position: int) -> None:
        """A pass is over, perhaps before the end."""
        if position >= self._size:
            self._done += self._size


class _Shown(io.BufferedReader):
    def __init__(self, path: Path, watched: _Watched) -> None:
        super().__init__(io.FileIO(path))
        self._watched = watched
        self._farthest = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self._farthest = max(self._farthest, self.tell())
        self._watched.show(self._farthest)
        return data

    def close(self) -> None:
        if not self.closed:
            self._watched.end(self._farthest)
        super().close()
