"""The folder of logs on board, as whoever asks over the network sees it.

Only what a recorder of this package would name so is there, and only if it is a file: a name never
leads out of the folder, and a link in it leads nowhere. Everything here waits for a disk: it is to
be called in a thread.
"""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from m100link.apps.fleet.logs.words import LogEntry
from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.log.folder import is_log_name
from m100link.log.recorder import is_being_written

__all__ = ["Shelf"]

_BLOCK = 1 << 20
_IDLE = 1.0
"""Seconds without reading for each second of reading: whoever flies has the processor, too."""


class Shelf:
    """The logs of one aircraft.

    Args:
        folder: Where they are; None: nowhere, nothing is recorded.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else read_path(folder)

    def entries(self) -> list[LogEntry]:
        """The logs, the newest first."""
        found = []
        try:
            names = [] if self._folder is None else [one.name for one in self._folder.iterdir()]
        except OSError:
            return []  # nothing was recorded yet: the first log makes the folder
        for name in filter(is_log_name, names):
            try:
                with self._opened(name) as stream:
                    told = os.fstat(stream.fileno())
            except UsageError:
                continue  # gone meanwhile, or none
            found.append(LogEntry(name, told.st_size, told.st_mtime, self._is_written(name)))
        return sorted(found, key=lambda one: (one.at, one.log), reverse=True)

    def piece(self, log: str, offset: int, length: int) -> tuple[bytes, LogEntry]:
        """Some bytes of a log, fewer at its end; and what it is now.

        Raises:
            UsageError: There is no such log, or it cannot be read.
        """
        with self._opened(log) as stream:
            # First: what is written after that may be in the bytes, and is only not promised.
            is_written = self._is_written(log)
            told = os.fstat(stream.fileno())
            try:
                data = os.pread(stream.fileno(), length, offset)
            except OSError as error:
                raise _no_log(log, error.strerror or f"{error}") from error
        return data, LogEntry(log, told.st_size, told.st_mtime, is_written)

    def digest(self, log: str, length: int, is_wanted: Callable[[], bool]) -> bytes:
        """SHA-256 of its first bytes.

        Args:
            log: Which.
            length: How many.
            is_wanted: Asked now and then; when it says no it ends.

        Raises:
            UsageError: There is no such log, it has fewer bytes, or nobody wants it any more.
        """
        found, left = hashlib.sha256(), length
        with self._opened(log) as stream:
            while left:
                began = time.monotonic()
                try:
                    block = stream.read(min(left, _BLOCK))
                except OSError as error:
                    raise _no_log(log, error.strerror or f"{error}") from error
                if not block:
                    raise _no_log(log, f"it has {length - left} bytes, not {length}")
                found.update(block)
                left -= len(block)
                if not is_wanted():
                    raise _no_log(log, "the agent ends")
                if left:
                    time.sleep(_IDLE * (time.monotonic() - began))
        return found.digest()

    def _is_written(self, log: str) -> bool:
        return self._folder is not None and is_being_written(self._folder / log)

    @contextmanager
    def _opened(self, log: str) -> Iterator[FileIO]:
        """A log.

        Raises:
            UsageError: There is none of that name.
        """
        if self._folder is None or not is_log_name(log):
            raise _no_log(log, "nothing is recorded")
        # Neither through a link, nor into what would wait for another program, such as a pipe.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            handle = os.open(self._folder / log, flags)
        except OSError as error:
            raise _no_log(log, error.strerror or f"{error}") from error
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise _no_log(log, "it is no file")
        with FileIO(handle) as stream:
            yield stream


def _no_log(log: str, why: str) -> UsageError:
    return UsageError(
        f"there is no log {log} to be read: {why}",
        cause="it made room for newer ones, or was never there",
        remedy="m100link fleet log list NAME",
    )
