"""A log that is on its way, in a file whose name ends in ``.part``.

It only grows at its end, so that whatever is there after a process was killed is a beginning of the
log. One program at a time has it. Everything here waits for a disk: it is to be called in a thread.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.link.keyfile import keep_names

__all__ = ["Part"]

_BLOCK = 1 << 20


class Part:
    """The part of one log.

    Args:
        folder: Where; it is made.
        name: Of the file that it becomes.

    Attributes:
        whole: The file that it becomes.
        path: The file that it is.
        at: Bytes in it.

    Raises:
        UsageError: The folder cannot be made.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.whole = read_path(folder) / name
        self.path = self.whole.with_name(f"{name}.part")
        self.at = 0
        self._file: FileIO | None = None
        # Who is cancelled closes while a thread may still be writing.
        self._lock = threading.Lock()
        with _telling(self.whole.parent):
            self.whole.parent.mkdir(parents=True, exist_ok=True)

    def open(self, size: int) -> None:
        """Go on with what is there of a log of that size.

        Raises:
            UsageError: It cannot be written, or another program has it.
        """
        with self._lock, _telling(self.path):
            file = self._locked()
            while not _is_at(file, self.path):
                # Whoever had it made it the log meanwhile, or removed it: that is not this part.
                file.close()
                file = self._locked()
            self._file, self.at = file, file.seek(0, os.SEEK_END)
        if self.at > size:
            self.forget()

    def _locked(self) -> FileIO:
        file = FileIO(self.path, "a+")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise UsageError(
                f"{self.path}: another program fetches it", remedy="wait for its end"
            ) from None
        return file

    def add(self, data: bytes) -> None:
        """The next bytes have come.

        Raises:
            UsageError: The disk does not take them.
        """
        with self._lock, _telling(self.path):
            self._write(data)

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            written = self._opened.write(left)
            self.at += written
            left = left[written:]

    def forget(self) -> None:
        """What is there is not of that log."""
        with self._lock, _telling(self.path):
            self._opened.truncate(0)
            self.at = 0

    def digest(self) -> bytes:
        """SHA-256 of what is there."""
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


def _is_at(file: FileIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{path}: {error.strerror or error}",
            remedy="make room there, or name another folder by --to",
        ) from error
