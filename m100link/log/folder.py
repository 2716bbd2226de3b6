"""A folder of flight logs that stays of a bounded size, for recording that nobody asked for."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import re
import stat
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from m100link.errors import M100Error, UsageError
from m100link.errors.texts import read_path
from m100link.log.recorder import Recorder, is_being_written
from m100link.log.records import MAGIC, Header, records

_logger = logging.getLogger(__name__)

DISK_S = 2.0
"""Seconds for which an aircraft waits for the disk of its log; then it is connected without one."""

# As Recorder names a file in a folder.
_NAME = re.compile(r"m100link-\d{8}-\d{6}(-\d+)?\.mcap")


def is_log_name(name: str) -> bool:
    """Whether a recorder would name a file in a folder so; no such name leads out of one."""
    return _NAME.fullmatch(name) is not None


def state_folder(environment: Mapping[str, str] | None = None) -> Path:
    """Where programs keep what outlives them: ``m100link`` in the user's folder of state (XDG)."""
    named = (os.environ if environment is None else environment).get("XDG_STATE_HOME", "")
    base = Path(named) if Path(named).is_absolute() else read_path("~/.local/state")
    return base / "m100link"


def default_folder(environment: Mapping[str, str] | None = None) -> Path:
    """Where flights are kept: ``flights`` in the folder of the state."""
    return state_folder(environment) / "flights"


class _Kept(NamedTuple):
    at: float
    size: int
    path: Path


class Flights:
    """Makes a log for each connection. Recording never keeps anybody from flying."""

    def __init__(
        self,
        folder: Path,  # where; it is made when it is not there
        *,
        keep: int = 0,  # logs to keep; 0: all of them
        keep_mb: int = 0,  # megabytes of logs to keep; 0: all of them
        tell: Callable[[str, str], None],  # takes what people should know, and its level
    ) -> None:
        self.folder = read_path(folder)
        self._keep = keep
        self._keep_bytes = keep_mb * 1_000_000
        self._tell = tell
        self.newest: Path | None = None  # the log of the newest connection; None before the first
        self._ending: set[asyncio.Future[None]] = set()
        self._making: asyncio.Future[Recorder] | None = None  # the newest
        self._reported = ""  # why it is not recorded: once is enough

    async def begin(self) -> Recorder | None:
        """A log for the next connection; None, with a warning, when it cannot be.

        Beside the event loop, in which others may fly: a disk may stand still.
        """
        if self._making is not None and not self._making.done():
            return None  # the disk stands still, as was reported
        is_made = threading.Event()

        def make() -> Recorder:
            try:
                return self._made()
            finally:
                is_made.set()

        making = self._making = asyncio.ensure_future(asyncio.to_thread(make))
        try:
            # In real time, as the disk: the event loop's may be virtual.
            if not await asyncio.to_thread(is_made.wait, DISK_S):
                raise UsageError(
                    f"{self.folder}: the disk does not answer within {DISK_S:g} s",
                    remedy="name a folder of another disk",
                )
            await asyncio.wait([making])
            return making.result()
        except (asyncio.CancelledError, M100Error, OSError, RuntimeError, MemoryError) as error:
            making.add_done_callback(self._abandon)
            if isinstance(error, asyncio.CancelledError):
                raise
            why = error.seen if isinstance(error, M100Error) else f"{error}" or repr(error)
            remedy = error.remedy if isinstance(error, UsageError) else ""
            if why != self._reported:
                self._reported = why
                self._tell(f"not recorded: {why}" + (f" ({remedy})" if remedy else ""), "warning")
            return None

    def _made(self) -> Recorder:
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return Recorder(self.folder)

    def _abandon(self, making: asyncio.Future[Recorder]) -> None:
        """Nobody waits for it: a log that nothing was noted in leaves no file."""
        if not making.cancelled() and making.exception() is None:
            ending = asyncio.ensure_future(making.result().aclose())
            self._ending.add(ending)
            ending.add_done_callback(self._ending.discard)

    def keep(self, log: Recorder) -> None:
        """An aircraft answered: this log is kept, the oldest make room for it."""
        self._reported = ""
        self.newest = log.path
        self._tell(f"recorded into {log.path}", "info")
        try:
            threading.Thread(target=self.make_room, name="m100link: old logs", daemon=True).start()
        except (RuntimeError, MemoryError) as error:  # without a thread it flies all the same
            self._tell(f"old flight logs stay: {str(error) or repr(error)}", "warning")

    @staticmethod
    def drop(log: Recorder) -> None:
        """No aircraft answered: attempts to connect are not flights. Takes as long as the disk."""
        with suppress(OSError):
            log.path.unlink()

    def make_room(self) -> None:
        """Remove the oldest of our own logs that nobody writes, beyond what is kept.

        Takes as long as the disk does: from no event loop in which somebody flies.
        """
        try:
            kept = sorted(self._ours(), reverse=True)
        except OSError as error:
            _logger.debug("%s: %s", self.folder, error)
            return
        size = 0
        for count, one in enumerate(kept, 1):
            size += one.size
            is_beyond = (self._keep and count > self._keep) or (
                self._keep_bytes and size > self._keep_bytes
            )
            if is_beyond and count > 1 and not is_being_written(one.path) and _is_ours(one.path):
                with suppress(OSError):  # another program of ours did it
                    one.path.unlink()
                    _logger.info("%s: removed, to make room for newer ones", one.path)

    def _ours(self) -> list[_Kept]:
        found = []
        for path in self.folder.iterdir():
            if is_log_name(path.name) and path.is_file() and not path.is_symlink():
                status = path.stat()
                found.append(_Kept(status.st_mtime, status.st_size, path))
        return found


def _is_ours(path: Path) -> bool:
    """Whether this library wrote it, by what the file says of itself."""
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return False
        match next(records(stream), None):
            case Header(library=writer):
                return writer.startswith("m100link ")
    return False


# -- the folder of logs on board, as clients over the network see it -------------------------------
# Only what a recorder of this package would name so is there, and only if it is a file: a name
# never leads out of the folder, and a link in it leads nowhere. Everything here waits for a disk:
# it is to be called in a thread.


_BLOCK = 1 << 20
_IDLE = 1.0
"""Seconds without reading for each second of reading: flying needs the processor, too."""


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log on board."""

    log: str  #: its name
    size: int  #: its bytes now
    at: float  #: when it was written last, POSIX time of the computer on board, s
    is_written: bool  #: whether it is still being written


class LogDirectory:
    """The logs of one aircraft; UsageError for each that is not there, or cannot be read.

    ``folder``: where they are; None: nowhere, nothing is recorded.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else read_path(folder)

    def entries(self, most: int | None = None) -> list[LogEntry]:
        """All of them, the newest first; ``most``: so many at most, the newest by their names."""
        found = []
        try:
            names = [] if self._folder is None else [one.name for one in self._folder.iterdir()]
        except OSError:
            return []  # nothing was recorded yet: the first log makes the folder
        for name in sorted(filter(is_log_name, names), reverse=True)[:most]:
            try:
                with self._opened(name) as stream:
                    status = os.fstat(stream.fileno())
            except UsageError:
                continue  # gone meanwhile, or none
            found.append(LogEntry(name, status.st_size, status.st_mtime, self._is_written(name)))
        return sorted(found, key=lambda one: (one.at, one.log), reverse=True)

    def piece(self, log: str, offset: int, length: int) -> tuple[bytes, LogEntry]:
        """Some bytes of a log, fewer at its end; and what it is now."""
        with self._opened(log) as stream:
            # First: what is written after that may be in the bytes, and is only not promised.
            is_written = self._is_written(log)
            status = os.fstat(stream.fileno())
            try:
                stream.seek(offset)
                data = stream.read(length)
            except OSError as error:
                raise _no_log(log, error.strerror or f"{error}") from error
        return data, LogEntry(log, status.st_size, status.st_mtime, is_written)

    def digest(self, log: str, length: int, is_wanted: Callable[[], bool]) -> bytes:
        """SHA-256 of its first bytes, for as long as anybody wants it."""
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
        if self._folder is None or not is_log_name(log):
            raise _no_log(log, "nothing is recorded")
        # Neither through a link, nor into what would wait for another program, such as a pipe.
        safely = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # none on Windows
        try:
            stream = FileIO(
                self._folder / log, opener=lambda at, flags: os.open(at, flags | safely)
            )
        except OSError as error:
            raise _no_log(log, error.strerror or f"{error}") from error
        with stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise _no_log(log, "it is no file")
            yield stream


def _no_log(log: str, why: str) -> UsageError:
    return UsageError(
        f"there is no log {log} to read: {why}",
        cause="it made room for newer ones, or was never there",
        remedy="m100link fleet log list NAME",
    )
