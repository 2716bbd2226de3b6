"""What was signed and taken, kept on disk: what is recorded now is not obeyed after a restart.

The specification has the time of signatures kept, and started with at the next start. That alone
lets a minute pass in which what was recorded is taken again, and on a computer without a clock of
its own more. So the newest time of each sender is kept too, a little ahead of what was taken: it
holds even if this process is killed before it is written again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

from m100link.apps.mavlink.codec import LAST_SIGNATURE, NEW_WITHIN, Sender, Signer
from m100link.errors.texts import read_json

__all__ = ["AHEAD", "SignatureMemory", "Snapshot"]

AHEAD = 2_000_00
"""How far ahead times are kept while it runs, in 10 microseconds: 2 s."""

_LONGEST = 65536
_PARTS = 3


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What is written.

    Attributes:
        sent: Newest time that was signed or taken.
        newest: Newest time of each sender; what is not later is not taken.
    """

    sent: int
    newest: dict[Sender, int]


class SignatureMemory:
    """The file of one key.

    Args:
        folder: Where; it is made when it is not there.
        signer: Whose times are kept.

    Attributes:
        path: The file. Its name tells which key it belongs to, and nothing of the key.
    """

    def __init__(self, folder: Path, signer: Signer) -> None:
        self._signer = signer
        named = hashlib.sha256(b"m100link MAVLink signatures" + signer.key).hexdigest()[:16]
        self.path = folder / f"signatures-{named}.json"
        self._written: dict[Sender, int] = {}

    def recall(self, now: int) -> str:
        """Give the signer what was kept. Returns why that cannot be, empty where it can.

        Args:
            now: Time of signatures. What cannot be read may hide anything that was signed up to
                now, and then nothing of that is taken.
        """
        try:
            found = _read(self.path)
        except FileNotFoundError:
            return ""
        except (OSError, ValueError) as error:
            self._signer.oldest = now
            return f"{self.path} cannot be read: {error}"
        self._signer.sent = max(self._signer.sent, found.sent)
        for sender, when in found.newest.items():
            self._signer.newest[sender] = max(self._signer.newest.get(sender, 0), when)
        self._written = found.newest
        return ""

    def due(self) -> Snapshot | None:
        """What has to be written now, so that no frame that was taken is later; None for nothing.

        A sender that does not stop is written for once in two seconds.
        """
        newest = self._newest()
        if all(when <= self._written.get(sender, -1) for sender, when in newest.items()):
            return None
        return Snapshot(self._signer.sent, {one: when + AHEAD for one, when in newest.items()})

    def last(self) -> Snapshot | None:
        """What is written at the end: the times as they are, so that nobody waits for them."""
        newest = self._newest()
        return Snapshot(self._signer.sent, newest) if newest else None

    def _newest(self) -> dict[Sender, int]:
        """Those that count: whoever is further behind is refused for that."""
        since = self._signer.sent - NEW_WITHIN
        return {one: when for one, when in self._signer.newest.items() if when > since}

    def write(self, snapshot: Snapshot) -> None:
        """Write it; takes as long as the disk takes.

        Raises:
            OSError: It cannot be written.
        """
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        newest, sent = dict(snapshot.newest), snapshot.sent
        with contextlib.suppress(OSError, ValueError):
            # Another bridge with this key may keep its senders here.
            kept = _read(self.path)
            sent = max(sent, kept.sent)
            for sender, when in kept.newest.items():
                is_ours = sender in newest and when == self._written.get(sender)
                if not is_ours and when > sent - NEW_WITHIN:
                    newest[sender] = max(when, newest.get(sender, 0))
        told = {".".join(map(str, one)): when for one, when in newest.items()}
        handle, name = tempfile.mkstemp(dir=self.path.parent, prefix=self.path.name)
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                json.dump({"sent": sent, "newest": told, "crc32": _checksum(sent, told)}, file)
            Path(name).replace(self.path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        self._written = newest


def _checksum(sent: object, newest: dict[str, Any]) -> int:
    return crc32(json.dumps([sent, newest]).encode())


def _read(path: Path) -> Snapshot:
    """What a file tells.

    Raises:
        OSError, ValueError: It cannot be read, or is not one of these.
    """
    with path.open("rb") as file:
        data = file.read(_LONGEST + 1)
    if len(data) > _LONGEST:
        raise ValueError("it is too long")
    told: Any = read_json(data)
    if not (isinstance(told, dict) and isinstance(told.get("newest"), dict)):
        raise ValueError("it is not a memory of signatures")
    # A version before this one wrote no checksum; under any other name it is damaged.
    checksum = _checksum(told.get("sent"), told["newest"])
    if told.keys() - {"sent", "newest"} and told != told | {"crc32": checksum}:
        raise ValueError("its checksum is wrong")
    if told.keys() - {"sent", "newest", "crc32"}:
        raise ValueError("it holds what is not known")
    newest: dict[Sender, int] = {}
    for name, when in told["newest"].items():
        parts = [int(part) for part in str(name).split(".")]
        if len(parts) != _PARTS:
            raise ValueError(f"{name!r} is not a sender")
        newest[parts[0], parts[1], parts[2]] = _time(when)
    return Snapshot(_time(told.get("sent")), newest)


def _time(value: object) -> int:
    if not isinstance(value, int) or not 0 <= value <= LAST_SIGNATURE + AHEAD:
        raise ValueError(f"{value!r} is not a time")
    return value
