"""A folder of flight logs that stays of a bounded size, for recording that nobody asked for."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
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
                raise UsageError(f"{self.folder}: the disk does not answer within {DISK_S:g} s")
            return await asyncio.shield(making)
        except (asyncio.CancelledError, M100Error, OSError) as error:
            making.add_done_callback(self._abandon)
            if isinstance(error, asyncio.CancelledError):
                raise
            why = error.seen if isinstance(error, M100Error) else f"{error}"
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
        threading.Thread(target=self.make_room, name="m100link: old logs", daemon=True).start()

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
