"""Questions about the logs on board, and their answers (pure logic).

A question is an order, and signed as all are. An answer is the version, a line of JSON, and behind
it the bytes of a log as they are.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from m100link.apps.agent.codec import parsed
from m100link.apps.agent.messages import MessageError, RemoteError
from m100link.apps.fleet import payloads
from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.link.keyfile import is_at, keep_names, locks
from m100link.log.folder import LogEntry, is_log_name

MOST_PIECE = 256 * 1024
"""Bytes of a log that go in one answer at most."""

MOST_ENTRIES = 1000
"""Logs that a list names at most, the newest."""

_MOST_HEAD = 32 * 1024
_LAST_UTC = 253_402_300_799.0
"""End of the year 9999: a later time has no date."""


@dataclass(frozen=True, slots=True)
class LogReply:
    """The head of an agent's answer; the bytes stand behind it."""

    id: str  # of the order
    name: str
    outcome: payloads.Outcome = payloads.Outcome.OK  # whether it is answered
    fault: RemoteError | None = None  # why it is not
    again_s: float = 0.0  # seconds after which to ask again, when it is not ready; 0 when it is
    offset: int = 0  # first byte of the piece
    size: int = 0  # bytes that the log has now
    is_written: bool = False  # whether it is being written still


def require_possible(question: payloads.LogQuestion) -> None:
    """Refuse what names no log, or no part of one."""
    of_log = question.what not in (payloads.What.LIST, payloads.What.AUDIT)
    if of_log and not is_log_name(question.log):
        raise MessageError(
            f"{question.log[:80]!r} is no name of a log", remedy="m100link fleet log list NAME"
        )
    is_piece = question.what is payloads.What.PIECE
    if question.offset < 0 or not 0 <= question.length <= (MOST_PIECE if is_piece else 1 << 50):
        raise MessageError(f"{question.length} bytes from {question.offset} are no part of a log")


def pack_reply(reply: LogReply, data: bytes = b"") -> bytes:
    return bytes([payloads.VERSION]) + payloads.to_json(reply) + b"\n" + data


def unpack_reply(payload: bytes) -> tuple[LogReply, bytes]:
    head, _, data = payloads.body(payload, MOST_PIECE + _MOST_HEAD).partition(b"\n")
    if len(data) > MOST_PIECE:
        raise MessageError(f"{len(data)} bytes of a log in one answer")
    return payloads.value_of(LogReply, parsed(head, "a LogReply")), data


def pack_entries(entries: list[LogEntry]) -> bytes:
    """The newest logs as an answer carries them."""
    return b"[" + b",".join(map(payloads.to_json, entries[:MOST_ENTRIES])) + b"]"


def unpack_entries(data: bytes) -> list[LogEntry]:
    """The logs of a list. None has a name that leads out of a folder: it becomes one of a file."""
    found = parsed(data, "a list of logs")
    if not isinstance(found, list) or len(found) > MOST_ENTRIES:
        raise MessageError("not a list of logs")
    entries = [payloads.value_of(LogEntry, one) for one in found]
    return [
        one
        for one in entries
        if is_log_name(one.log) and one.size >= 0 and 0.0 <= one.at <= _LAST_UTC
    ]


# -- A log that is on its way, in a file whose name ends in ``.part`` ------------------------------
# It only grows at its end, so that whatever is there after a process was killed is a beginning of
# the log. One program at a time has it. Everything here waits for a disk: it is to be called in a
# thread.


_BLOCK = 1 << 20


class LogPart:
    """The part of one log. Raises UsageError: the folder cannot be made."""

    def __init__(self, folder: Path, name: str) -> None:
        self.whole = read_path(folder) / name  # the file that it becomes
        self.path = self.whole.with_name(f"{name}.part")  # the file that it is
        self.at = 0  # bytes in it
        self._file: FileIO | None = None
        # A cancelled task closes while a thread may still be writing.
        self._lock = threading.Lock()
        with _telling(self.whole.parent):
            self.whole.parent.mkdir(parents=True, exist_ok=True)

    def open(self, size: int) -> None:
        """Go on with the bytes that are there of a log of that size.

        Raises UsageError: it cannot be written, or another program has it.
        """
        with self._lock, _telling(self.path):
            file = self._locked()
            while not is_at(file.fileno(), self.path):
                # Its owner made it the log meanwhile, or removed it: that is not this part.
                file.close()
                file = self._locked()
            self._file, self.at = file, file.seek(0, os.SEEK_END)
        if self.at > size:
            self.forget()

    def _locked(self) -> FileIO:
        file = FileIO(self.path, "a+")
        if not locks(file.fileno()):
            file.close()
            raise UsageError(
                f"{self.path}: another program fetches it", remedy="wait until it has ended"
            )
        return file

    def add(self, data: bytes) -> None:
        """The next bytes have come. Raises UsageError: the disk does not take them."""
        with self._lock, _telling(self.path):
            self._write(data)

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            written = self._opened.write(left)
            self.at += written
            left = left[written:]

    def forget(self) -> None:
        """Drop the bytes that are there: they are not of that log."""
        with self._lock, _telling(self.path):
            self._opened.truncate(0)
            self.at = 0

    def digest(self) -> bytes:
        with self._lock, _telling(self.path):
            self._opened.seek(0)
            return hashlib.file_digest(self._opened, "sha256").digest()

    def whole_digest(self) -> tuple[int, bytes]:
        """Size and SHA-256 of the file that was fetched before."""
        with _telling(self.whole), self.whole.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            return size, hashlib.file_digest(stream, "sha256").digest()

    def take_up(self) -> None:
        """Begin with the file that was fetched before: the log has grown since."""
        with self._lock, _telling(self.path), self.whole.open("rb") as stream:
            self._opened.truncate(0)
            self.at = 0
            while block := stream.read(_BLOCK):
                self._write(block)

    def finish(self) -> None:
        """All of it is there; the disk keeps it, for it may be removed where it came from."""
        with self._lock, _telling(self.path):
            os.fsync(self._opened.fileno())
            self.path.replace(self.whole)
            self._opened.close()
            self._file, self.at = None, 0
            keep_names(self.whole.parent)

    def close(self) -> None:
        """Leave it to the next one; where no byte came nothing is left."""
        with self._lock:
            file, self._file = self._file, None
            if file is None:
                return
            if not self.at:
                self.path.unlink(missing_ok=True)
            file.close()

    @property
    def _opened(self) -> FileIO:
        if self._file is None:  # it was closed here while a thread was about to go on
            raise OSError("it is closed")
        return self._file


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{path}: {error.strerror or error}",
            remedy="make room there, or name another folder by --output",
        ) from error
