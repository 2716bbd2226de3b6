"""What an agent must know after it was killed: orders that were begun, its fence, who was flying.

One line of JSON for each in a file that grows to some megabytes and is written anew then, through
to the disk before what it says happens, in a thread: a disk that hangs holds up no setpoint. Ages
are those of a clock that nobody sets. Of what is from before the computer was started nobody knows
how old it is: it is kept for as long again.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from m100link.errors import UsageError
from m100link.fleet.book import KEPT_S

__all__ = [
    "FENCES_AT_ONCE",
    "MOST_KEPT",
    "FileLedger",
    "Ledger",
    "LeftAloft",
    "MemoryLedger",
    "since_boot",
]

MOST_KEPT = 20_000
"""Orders that are kept at most: more than an agent can begin in the time in which one is young."""

FENCES_AT_ONCE = 1000
"""Numbers of leases that are reserved at once: an agent that begins anew starts above them."""

_MOST_FENCE = 1 << 53


@dataclass(frozen=True, slots=True)
class LeftAloft:
    """The agent before ended while somebody of the fleet flew.

    Attributes:
        fence: Number of the lease that it was flown under.
        ago_s: Seconds since it said so last; None when no clock tells.
    """

    fence: int
    ago_s: float | None


class Ledger(Protocol):
    """What is kept.

    Attributes:
        begun: Orders that were begun lately, and when, s since the computer was started.
        leases_before: The greatest number that a lease may have had.
        aloft: How the agent before ended, if somebody flew then.
        damaged: Words that were on the disk and cannot be read any more: each may be an order that
            was begun, the number of a lease, or who flew.
    """

    begun: dict[str, float]
    leases_before: int
    aloft: LeftAloft | None
    damaged: int

    async def begin(self, identity: str) -> None:
        """Keep that an order begins; done when it is kept.

        Raises:
            UsageError: It cannot be kept.
        """

    async def granted(self, fence: int) -> None:
        """Keep that a lease has this number; done when no later agent can grant it again.

        Raises:
            UsageError: It cannot be kept.
        """

    async def flies(self, fence: int) -> None:
        """Keep under which lease the aircraft is flown now; done when it is kept.

        Args:
            fence: Its number; 0: nobody of the fleet flies.

        Raises:
            UsageError: It cannot be kept.
        """


def since_boot() -> tuple[str, float]:
    """Which run of this computer it is, and its age in s: no clock that is set changes that."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        boot = ""  # no two of these are taken for the same
    return boot, time.clock_gettime(time.CLOCK_BOOTTIME)


class MemoryLedger:
    """Kept as long as the process lives: for virtual aircraft and tests.

    Args:
        before: Of the agent before.
    """

    def __init__(self, before: MemoryLedger | None = None) -> None:
        self.begun: dict[str, float] = {} if before is None else before.begun
        self.leases_before: int = 0 if before is None else before.leases_before + FENCES_AT_ONCE
        self.damaged = 0
        self.flown_under: int = 0 if before is None else before.flown_under
        self.aloft: LeftAloft | None = None
        if self.flown_under:
            self.aloft = LeftAloft(self.flown_under, 0.0)

    async def begin(self, identity: str) -> None:
        """Keep that an order begins."""
        self.begun[identity] = 0.0

    async def granted(self, fence: int) -> None:
        """Whoever takes this over begins above what was reserved."""

    async def flies(self, fence: int) -> None:
        """Keep who flies."""
        self.flown_under = fence


class FileLedger:
    """Kept in a file, of which one process at a time is the owner.

    Args:
        path: The file; its folder is made.
        utc: POSIX time, s.
        up: Which run of this computer it is, and for how long, s.

    Raises:
        UsageError: It cannot be read or written, or another agent has it.
    """

    def __init__(
        self,
        path: Path,
        utc: Callable[[], float],
        up: Callable[[], tuple[str, float]] = since_boot,
    ) -> None:
        self._path = path
        self._utc, self._up = utc, up
        # The line that says who flies, as it was written.
        self._flown: dict[str, object] = {}
        self._is_sure_who_flew = True
        self.damaged = 0
        self.aloft: LeftAloft | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._lock = path.with_suffix(".lock").open("a")
            self._own()
            self.begun, self.leases_before = self._read()
            self.aloft = self._left_aloft()
            self._reserved = self.leases_before + FENCES_AT_ONCE
            self._rewrite(self._needed())
            self._file = path.open("a", encoding="ascii")
        except OSError as error:
            raise _failed(path, error) from error
        self._writing = asyncio.Lock()
        self._written = 0

    def _own(self) -> None:
        # Of a file of its own: the ledger is replaced as it is read.
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise UsageError(
                f"{self._path}: another agent has it",
                cause="two agents of one name run on this computer",
                remedy="end the other one, or name another folder by --ledger",
            ) from None

    def _read(self) -> tuple[dict[str, float], int]:
        begun: dict[str, float] = {}
        fence = 0
        boot, now = self._up()
        try:
            text = self._path.read_text("ascii", "replace")
        except FileNotFoundError:
            return begun, fence
        # What has no end was cut off by the loss of power as it was written: it had not begun.
        for line in text.split("\n")[:-1]:
            kept = _word(line)
            if _is_fence(kept.get("flies")):
                self._flown, self._is_sure_who_flew = kept, True
            elif _is_fence(kept.get("fence")):
                fence = max(fence, kept["fence"])
            elif isinstance(kept.get("id"), str):
                at = _up_of(kept, boot)
                begun[kept["id"]] = now if at is None else at
            else:
                self.damaged += 1
                self._is_sure_who_flew = False
        # It rises by a thousand with each start, and so stays behind the calendar.
        return begun, max(fence, int(self._utc())) if self.damaged else fence

    def _left_aloft(self) -> LeftAloft | None:
        kept = self._flown
        fence, at = kept.get("flies"), kept.get("at")
        if not isinstance(fence, int) or fence <= 0:
            return None
        boot, seconds = self._up()
        up = _up_of(kept, boot)
        if not self._is_sure_who_flew:
            return LeftAloft(fence, None)  # a later word is lost: nobody is landed for this one
        if up is not None:
            ago = seconds - up
        elif isinstance(at, int | float):
            ago = self._utc() - at  # the computer began anew: its calendar is all there is
        else:
            return LeftAloft(fence, None)
        return LeftAloft(fence, ago if ago >= 0 else None)

    def _needed(self) -> list[str]:
        """What is still needed, and the numbers that this run may give to leases."""
        boot, now = self._up()
        young = [(one, at) for one, at in self.begun.items() if now - at < KEPT_S]
        self.begun = dict(young[-MOST_KEPT:])
        lines = [json.dumps({"fence": self._reserved})]
        lines += [_begun(one, boot, at) for one, at in self.begun.items()]
        lines += [json.dumps(self._flown)] if self._flown else []
        return lines

    def _rewrite(self, lines: list[str]) -> None:
        folder = self._path.parent
        with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="ascii") as new:
            new.write("".join(f"{line}\n" for line in lines))
            new.flush()
            os.fsync(new.fileno())
        Path(new.name).replace(self._path)
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    async def begin(self, identity: str) -> None:
        """Keep that an order begins; done when the disk has it.

        Raises:
            UsageError: The disk does not take it.
        """
        boot, self.begun[identity] = self._up()
        await self._write(_begun(identity, boot, self.begun[identity]))

    async def granted(self, fence: int) -> None:
        """Keep that a lease has this number; most need no word, for they are reserved.

        Raises:
            UsageError: The disk does not take it.
        """
        if fence >= self._reserved:
            self._reserved = fence + FENCES_AT_ONCE
            await self._write(json.dumps({"fence": self._reserved}))

    async def flies(self, fence: int) -> None:
        """Keep who flies; done when the disk has it.

        Raises:
            UsageError: The disk does not take it.
        """
        boot, seconds = self._up()
        self._flown = {"flies": fence, "at": self._utc(), "boot": boot, "up": seconds}
        await self._write(json.dumps(self._flown))

    async def _write(self, line: str) -> None:
        async with self._writing:
            self._written += 1
            try:
                if self._written > 2 * MOST_KEPT:
                    self._written = 0
                    await asyncio.to_thread(self._renew, self._needed())
                else:
                    await asyncio.to_thread(self._append, line)
            except OSError as error:
                raise _failed(self._path, error) from error

    def _renew(self, lines: list[str]) -> None:
        self._rewrite(lines)
        self._file.close()
        self._file = self._path.open("a", encoding="ascii")

    def _append(self, line: str) -> None:
        self._file.write(f"{line}\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; another agent may have it then."""
        self._file.close()
        self._lock.close()


def _is_fence(value: object) -> bool:
    """Whether it can be the number of a lease: one that no message carries is from a bad disk."""
    return type(value) is int and 0 <= value < _MOST_FENCE


def _word(line: str) -> dict[str, Any]:
    """What a line says; nothing when it was damaged."""
    try:
        kept = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return kept if isinstance(kept, dict) else {}


def _begun(identity: str, boot: str, up: float) -> str:
    return json.dumps({"id": identity, "boot": boot, "up": up})


def _up_of(kept: dict[str, object], boot: str) -> float | None:
    """When a line was written, s since the computer was started; None: before that, or never."""
    up = kept.get("up")
    if not boot or kept.get("boot") != boot or not isinstance(up, int | float):
        return None
    return float(up)


def _failed(path: Path, error: OSError) -> UsageError:
    return UsageError(
        f"{path}: {error.strerror or error}",
        cause="without it an order could be carried out twice after the agent was killed",
        remedy="let it be written, or name another folder by --ledger",
    )
