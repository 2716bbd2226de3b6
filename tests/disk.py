"""What is left on a disk when a computer loses its power."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


class Disk:
    """A disk that keeps nothing that no `fsync` asked it to keep.

    A file has the bytes that it had at its last `fsync`, and a folder the names. Real disks keep
    more as a rule; no program may count on that.

    Args:
        patch: Puts itself in the place of `os.fsync`.
        folder: What is watched.

    Attributes:
        moments: What a loss of power would have left in the folder after each `fsync`: bytes by
            name.
    """

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path) -> None:
        self._folder, self._wait = folder, os.fsync
        self._bytes: dict[int, bytes] = {}
        self._names: dict[str, int] = {}
        self.moments: list[dict[str, bytes]] = []
        patch.setattr(os, "fsync", self._fsync)

    def _fsync(self, handle: int) -> None:
        self._wait(handle)
        told, here = os.fstat(handle), list(self._folder.iterdir())
        if os.path.samestat(told, self._folder.stat()):
            self._names = {one.name: one.stat().st_ino for one in here}
        for path in here:
            if path.is_file() and os.path.samestat(told, path.stat()):
                self._bytes[told.st_ino] = path.read_bytes()
        self.moments.append(self.files)

    @property
    def files(self) -> dict[str, bytes]:
        """What a loss of power would leave in the folder now: bytes by name."""
        return {name: self._bytes.get(number, b"") for name, number in self._names.items()}

    def content(self, path: Path) -> bytes:
        """The bytes that are kept of a file, under whatever name."""
        return self._bytes.get(path.stat().st_ino, b"")
