"""The memory of an agent that was killed: orders that it began, its fence, the last operator.

Each is one sealed line in a file, written through to the disk before what it says happens. At some
megabytes the file is rewritten. A thread writes, so a disk that hangs holds up no setpoint. Ages
are those of a clock that nobody sets. The age of lines from before the computer started is unknown:
they are kept for as long again.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import logging
import math
import os
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zlib import crc32

from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.payloads import OrderReply
from m100link.errors import UsageError
from m100link.errors.texts import read_json
from m100link.errors.usage import unread
from m100link.flight.guards import since_boot_s
from m100link.link.keyfile import is_at, locks, replace_file

_logger = logging.getLogger(__name__)


MOST_KEPT = 20_000
"""Orders that are kept at most: more than an agent can begin in the time in which one is young."""

FENCES_AT_ONCE = 1000
"""Numbers of leases that are reserved at once: a restarted agent begins above them."""

_MOST_FENCE = 1 << 53
_CLOSE_S = 5.0


@dataclass(frozen=True, slots=True)
class LastFlightRecord:
    """The agent before ended while somebody of the fleet flew."""

    fence: int  # number of the lease that it was flown under
    ago_s: float | None  # seconds since it said so last; None when no clock tells


def since_boot() -> tuple[str, float]:
    """Which run of this computer it is, and its age in s: no clock that is set changes that."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        boot = ""  # no two of these are taken for the same
    return boot, since_boot_s()


class MemoryOrderLog:
    """Kept as long as the process lives: for virtual aircraft and tests."""

    def __init__(self, before: MemoryOrderLog | None = None) -> None:
        # Called in the event loop with what people should know of the disk.
        self.tell: Callable[[str], None] = _logger.warning
        # Orders that were begun lately, and when, s since the computer was started.
        self.begun: dict[str, float] = {} if before is None else before.begun
        # The greatest number that a lease may have had.
        self.leases_before: int = 0 if before is None else before.leases_before + FENCES_AT_ONCE
        # Words that were on the disk and cannot be read any more, or are gone: each may be an order
        # that was begun, the number of a lease, or who flew.
        self.damaged = 0
        self.flown_under: int = 0 if before is None else before.flown_under
        # How the agent before ended, if somebody flew then.
        self.last_flight = LastFlightRecord(self.flown_under, 0.0) if self.flown_under else None

    async def begin(self, identity: str) -> None:
        """Keep that an order begins; done when it is kept."""
        self.begun[identity] = 0.0

    async def granted(self, fence: int) -> None:
        """The next agent begins above the reserved numbers."""

    async def flies(self, fence: int) -> None:
        """Keep the lease it is flown under, 0 for none of the fleet."""
        self.flown_under = fence


class FileOrderLog:
    """Kept in a file, of which one process at a time is the owner.

    Beside it, in the file of the lock, stands the mark of the newest word. A file that is removed,
    replaced or emptied while the agent runs is made again at the next record, with a report. Raises
    UsageError: it cannot be read or written, or another agent has it. So do its methods: what they
    were to keep is not kept then.
    """

    def __init__(
        self,
        path: Path,  # the file; its folder is made
        utc: Callable[[], float],  # POSIX time, s
        # Which run of this computer it is, and for how long, s.
        up: Callable[[], tuple[str, float]] = since_boot,
    ) -> None:
        self._path = path
        self._utc, self._up = utc, up
        # The word that says who flies; whether the disk has it.
        self._flown: dict[str, object] = {}
        self._is_flown_kept = True
        self._is_sure_who_flew = True
        self.tell: Callable[[str], None] = _logger.warning
        self.damaged = 0
        self.last_flight: LastFlightRecord | None = None
        self._file = self._lock = -1
        self._lock_path = path.with_suffix(".lock")
        self._in_thread = threading.Lock()  # one that was cancelled goes on
        try:
            self._own()
            self.begun, self.leases_before = self._read()
            self.last_flight = self._read_last_flight()
            self._reserved = self.leases_before + FENCES_AT_ONCE
            self._renew()
        except OSError as error:
            self.close()
            raise _failed(path, error) from error
        self._writing = asyncio.Lock()

    def _own(self) -> None:
        # By a file of its own: the log is replaced as it is read.
        self._path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT, 0o600)
        if not locks(lock):
            os.close(lock)
            raise UsageError(
                f"{self._path}: another agent has it",
                cause="two agents of one name run on this computer",
                remedy="end the other one, or name another folder: fleet agent --order-log",
            )
        self._lock, before = lock, self._lock
        if before >= 0:
            os.close(before)

    def _read(self) -> tuple[dict[str, float], int]:
        begun: dict[str, float] = {}
        fence = 0
        boot, now = self._up()
        data = self._path.read_bytes() if self._path.exists() else b""
        read = words(data, os.pread(self._lock, 1000, 0))
        self.damaged, self._newest = read.damaged, read.newest
        for number, kept in read.kept.items():
            if _is_fence(kept.get("flies")):
                self._flown = kept
                self._is_sure_who_flew = number >= read.sure_from
            elif _is_fence(kept.get("fence")):
                fence = max(fence, kept["fence"])
            elif isinstance(kept.get("id"), str):
                at = _up_of(kept, boot)
                begun[kept["id"]] = now if at is None else at
            else:
                self.damaged += 1
                self._is_sure_who_flew = False
        if self._flown and not self._is_sure_who_flew:
            # A later word is lost. The next start reads no damage, and must not be surer than this.
            self._flown = {"flies": self._flown["flies"]}
        # It rises by a thousand with each start, and so stays behind the calendar.
        return begun, max(fence, int(self._utc())) if self.damaged else fence

    def _read_last_flight(self) -> LastFlightRecord | None:
        kept = self._flown
        fence, at = kept.get("flies"), kept.get("at")
        if not isinstance(fence, int) or fence <= 0:
            return None
        boot, seconds = self._up()
        up = _up_of(kept, boot)
        if up is not None:
            ago = seconds - up
        elif isinstance(at, int | float):
            ago = self._utc() - at  # the computer restarted: its calendar is all there is
        else:
            return LastFlightRecord(fence, None)  # nobody is landed for this one
        return LastFlightRecord(fence, ago if ago >= 0 else None)

    # -- in the event loop -------------------------------------------------------------------------

    async def begin(self, identity: str) -> None:
        async with self._writing:
            boot, up = self._up()
            await self._write(_begun(identity, boot, up))
            self.begun[identity] = up

    async def granted(self, fence: int) -> None:
        """Keep that a lease has this number; most need no word, for they are reserved."""
        async with self._writing:
            if fence >= self._reserved:
                await self._write({"fence": fence + FENCES_AT_ONCE})
                self._reserved = fence + FENCES_AT_ONCE

    async def flies(self, fence: int) -> None:
        """Keep who flies; a word that the disk does not take is written with the next one."""
        async with self._writing:
            boot, seconds = self._up()
            self._flown = {"flies": fence, "at": self._utc(), "boot": boot, "up": seconds}
            self._is_flown_kept = False
            await self._write()

    async def _write(self, *contents: dict[str, Any]) -> None:
        try:
            problem = await asyncio.to_thread(self._keep, *contents)
        except (OSError, RuntimeError, MemoryError) as error:  # the second: no thread is left
            raise _failed(self._path, error) from error
        if problem:
            self.tell(problem)

    # -- in a thread -------------------------------------------------------------------------------

    def _keep(self, *contents: dict[str, Any]) -> str:
        """Write words; returns a report on the disk."""
        with self._in_thread:
            has_lock = is_at(self._lock, self._lock_path)
            # A word of which a full disk took a part is cut off with the next word.
            has_all = os.fstat(self._file).st_size >= self._size
            is_there = has_lock and has_all and is_at(self._file, self._path)
            if not has_lock:
                self._own()
            if not is_there or self._newest - self._first > 2 * MOST_KEPT:
                self._renew()
            if not self._is_flown_kept:
                contents = (*contents, self._flown)
            self._append(contents)
            self._is_flown_kept = True
        return "" if is_there else f"{self._path} was removed or changed: it was written again"

    def _append(self, contents: tuple[dict[str, Any], ...]) -> None:
        """Write words to the end, all of them or none: a refused one must not be read later."""
        numbered = enumerate(contents, self._newest + 1)
        data = "".join(seal(number, self._first, one) for number, one in numbered).encode()
        os.ftruncate(self._file, self._size)
        try:
            _write_all(self._file, data, self._size)
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(data)
        self._newest += len(contents)
        self._put_mark(Mark(self._newest, self._first))

    def _put_mark(self, mark: Mark) -> None:
        """Without waiting for the disk: an older one notices less, and is as true."""
        try:
            _write_all(self._lock, bytes(mark), 0)
        except OSError as error:
            _logger.warning("%s: its mark is not written: %s", self._path, error)

    def _renew(self) -> None:
        """Write the file anew with what is still needed."""
        if not os.fstat(self._lock).st_size:
            _write_all(self._lock, bytes(Mark(0, 0)), 0)  # it may be there before the file is
            os.fsync(self._lock)
        first = self._newest + 1
        lines = [seal(number, first, one) for number, one in enumerate(self._needed(), first)]
        replace_file(self._path, "".join(lines).encode())
        self._first, self._newest = first, first + len(lines) - 1
        self._file, before = os.open(self._path, os.O_RDWR), self._file
        self._size = os.fstat(self._file).st_size
        if before >= 0:
            os.close(before)
        self._put_mark(Mark(self._newest, first))
        os.fsync(self._lock)

    def _needed(self) -> list[dict[str, Any]]:
        """The entries still needed, and the numbers that this run may give to leases."""
        boot, now = self._up()
        young = [(one, at) for one, at in self.begun.items() if now - at < KEPT_S]
        self.begun = dict(young[-MOST_KEPT:])
        kept: list[dict[str, Any]] = [{"fence": self._reserved}]
        kept += [_begun(one, boot, at) for one, at in self.begun.items()]
        return [*kept, self._flown] if self._flown else kept

    def close(self) -> None:
        """Close the file; another agent may have it then."""
        if not self._in_thread.acquire(timeout=_CLOSE_S):
            return  # a disk that hangs: the end of the process closes it
        for handle in (self._file, self._lock):
            if handle >= 0:
                os.close(handle)
        self._file = self._lock = -1
        self._in_thread.release()


class AuditLog:
    """Orders with signer, time and outcome: each line is signed, and has the digest of the last.

    So :func:`m100link.apps.fleet.signing.audited` notices a line that was altered or removed. Half
    of it is dropped when there are too many; an operator's copy has them still. A disk that takes
    nothing costs no order: its lines are written with the next ones.
    """

    def __init__(
        self,
        path: Path | None,  # None: kept as long as the process lives, as for virtual aircraft
        seal: tuple[bytes, Callable[[bytes], bytes]],  # certificate, DER, and its signature
        utc: Callable[[], float],  # POSIX time, s
    ) -> None:
        self._path, self._sign, self._utc = path, seal[1], utc
        self.tell: Callable[[str], None] = _logger.warning
        self._waiting, self._background = b"", TaskSet()
        self._writing: asyncio.Task[None] | None = None
        data = b""
        try:
            if path is not None and path.exists():
                data = path.read_bytes()
        except OSError as error:
            raise unread(path, error) from error
        whole, _, half = data.rpartition(b"\n")
        self._lines = whole.splitlines(keepends=True)
        self._is_new = bool(half) or (path is not None and not data)  # by loss of power
        if self._lines:
            self._lines[-1] = self._lines[-1].removesuffix(b"\n") + b"\n"
        self._newest = int(audit_facts(self._lines[-1]).get("number", 0)) if self._lines else 0
        self._certificate = {"certificate": base64.b64encode(seal[0]).decode()}
        self.add(self._certificate)

    def add(self, facts: dict[str, Any]) -> None:
        """Write a line; the disk gets it a moment later."""
        self._newest += 1
        half = MOST_KEPT // 2
        if self._newest % half == 1:  # where it is cut later: what is left can be verified
            facts = facts | self._certificate
        before = audit_digest(self._lines[-1]) if self._lines else ""
        said = {"number": self._newest, "before": before, "at": round(self._utc(), 3), **facts}
        text = json.dumps(said).encode()
        line = text + b"\t" + base64.b64encode(self._sign(text)) + b"\n"
        self._lines.append(line)
        if len(self._lines) > MOST_KEPT:
            kept = self._newest - audit_kept(self._newest) + 1
            self._lines, self._is_new = self._lines[-kept:], True
        self._waiting += line
        if self._path is not None and (self._writing is None or self._writing.done()):
            self._writing = self._background.spawn(self._write(self._path), "audit log")

    async def flush(self) -> None:
        """Wait for the disk, not longer than the end of an agent may take."""
        if self._writing is not None:
            await asyncio.wait({self._writing}, timeout=_CLOSE_S)

    async def _write(self, path: Path) -> None:
        while self._waiting or self._is_new:
            is_new, self._is_new = self._is_new, False
            data, self._waiting = b"".join(self._lines) if is_new else self._waiting, b""
            try:
                await asyncio.to_thread(replace_file if is_new else _append, path, data)
            except (OSError, RuntimeError, MemoryError) as error:
                self._is_new = True  # a part of it may be there
                self.tell(f"{path}: {error}: orders are not in the audit log until it is written")
                return

    def since(self, number: int, most: int) -> bytes:
        """The lines from a number on, as many as go into so many bytes, at least one."""
        first = self._newest - len(self._lines) + 1
        found = b""
        for line in self._lines[max(0, number - first) :]:
            if found and len(found) + len(line) > most:
                break
            found += line
        return found


def _append(path: Path, data: bytes) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_APPEND)
    try:
        if os.write(handle, data) != len(data):
            raise OSError("the disk is full")
    finally:
        os.close(handle)


def audit_facts(line: bytes) -> dict[str, Any]:
    """The facts of a line of the audit log, proved or not; empty where it cannot be read."""
    facts = _json(line.rpartition(b"\t")[0].decode("utf-8", "replace")) or {}
    texts = [facts.get(one, "") for one in ("before", "order", "signer", "by", "outcome")]
    is_line = all(isinstance(one, str) for one in texts) and _is_fence(facts.get("number"))
    times = facts.get("at"), facts.get("ordered_at", 0.0)
    is_line = is_line and all(map(is_time, times))
    return {"signer": "", "by": "", "outcome": ""} | facts if is_line else {}


def is_time(value: object) -> bool:
    """Whether it is a POSIX time that a line may have: no calendar has others."""
    return type(value) is float and 0 <= value < 1 << 33


def audit_kept(newest: int) -> int:
    """The number of the first line that is kept beside the newest one."""
    half = MOST_KEPT // 2
    return max(0, (newest - 1) // half - 1) * half + 1


def audit_digest(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()[:32]


OrderLog = FileOrderLog | MemoryOrderLog
"""The order log; it is written first: no later agent carries out twice what this one began."""


def _write_all(handle: int, data: bytes, at: int) -> None:
    """Write at a place. A disk that is nearly full takes a part, and then none."""
    done = 0
    while done < len(data):
        done += os.pwrite(handle, data[done:], at + done)


def _is_fence(value: object) -> bool:
    """Whether it can be the number of a lease: one that no message carries is from a bad disk."""
    return type(value) is int and 0 <= value < _MOST_FENCE


def _begun(identity: str, boot: str, up: float) -> dict[str, Any]:
    return {"id": identity, "boot": boot, "up": up}


def _up_of(kept: dict[str, object], boot: str) -> float | None:
    """When a line was written, s since the computer was started; None: before that, or never."""
    up = kept.get("up")
    if not boot or kept.get("boot") != boot or not isinstance(up, int | float):
        return None
    return float(up)


def _failed(path: Path, error: Exception) -> UsageError:
    return UsageError(
        f"{path}: {getattr(error, 'strerror', None) or str(error) or type(error).__name__}",
        cause="without this file a restarted agent could carry out an order twice",
        remedy="make it writable, or name another folder: fleet agent --order-log",
    )


# -- which orders were heard, and what became of them (pure logic, ``now`` is an argument) ---------
# An order that comes twice is carried out once: the second one is answered from here.


KEPT_S = 600.0
"""Seconds that an id is known after what it stands for has ended."""

_MOST = 20_000


class OrderCache:
    """The orders of one agent.

    ``before``: ids that an earlier agent of this name began; their outcomes are unknown.
    ``unsure_before``: some of them are lost: what was made before that time may be one, s.
    """

    def __init__(self, before: Iterable[str] = (), *, unsure_before: float = -math.inf) -> None:
        self._before = frozenset(before)
        self._unsure_before = unsure_before
        # The digest of what is under way, by id.
        self._running: dict[str, bytes] = {}
        # The replies of the others and their times, in the order in which they ended.
        self._ended: dict[str, tuple[float, OrderReply]] = {}

    def is_known(self, identity: str) -> bool:
        return identity in self._running or identity in self._ended

    def heard(self, identity: str, digest: bytes) -> bool:
        """Whether it heard this order.

        Raises MessageError: it heard another one of that id. A listener who may order anything
        could else get the answer to its own order as that to somebody else's.
        """
        if not self.is_known(identity):
            return False
        ended = self.reply(identity)
        if digest != (self._running[identity] if ended is None else ended.order):
            raise MessageError(
                f"another order came under the id {identity}; this one was not carried out",
                cause="a stranger heard the id and used it first",
                remedy="give the order again: it then has a new id",
            )
        return True

    def was_begun_before(self, identity: str) -> bool:
        return identity in self._before

    def is_unsure(self, made_at: float) -> bool:
        """Whether an agent before may have begun what was made then, and its word of it is lost."""
        return made_at < self._unsure_before

    def begin(self, identity: str, digest: bytes, now: float) -> None:
        """It is heard for the first time. Those that ended long ago are forgotten."""
        self._running[identity] = digest
        while self._ended:
            old, (at, _) = next(iter(self._ended.items()))
            if now - at < KEPT_S and len(self._ended) <= _MOST:
                break
            del self._ended[old]

    def end(self, reply: OrderReply, now: float) -> None:
        self._running.pop(reply.id, None)
        self._ended[reply.id] = now, reply

    def reply(self, identity: str) -> OrderReply | None:
        """The outcome of an order; None while it runs, or when it is not known."""
        ended = self._ended.get(identity)
        return None if ended is None else ended[1]


# -- records in a file that reveals when records were changed or are missing -----------------------
# A line has a checksum, its number, and the number of the first line of its file. Beside the file
# is a mark: the number of the newest line. So a reader notices a changed line, a missing line, an
# end that was cut off, and a file that was emptied or removed.


_LINE = re.compile(r"([0-9a-f]{8}) ((\d{1,18}) (\d{1,18}) (\{.*\}))", re.DOTALL)
_MARK = re.compile(r"([0-9a-f]{8}) ((\d{18}) (\d{18}))\n")


@dataclass(frozen=True, slots=True)
class Mark:
    """The mark: which records exist. Its file always has the same length."""

    newest: int  # number of the newest record; 0: none was written yet
    first: int  # number of the first record of the file

    def __bytes__(self) -> bytes:
        body = f"{self.newest:018d} {self.first:018d}"
        return f"{crc32(body.encode()):08x} {body}\n".encode()

    @staticmethod
    def read(data: bytes) -> Mark | None:
        """The mark in these bytes; None when they are not as they were written."""
        found = _MARK.fullmatch(data.decode("ascii", "replace"))
        if found is None or crc32(found[2].encode()) != int(found[1], 16):
            return None
        return Mark(int(found[3]), int(found[4]))


def seal(number: int, first: int, content: dict[str, Any]) -> str:
    body = f"{number} {first} {json.dumps(content)}"
    return f"{crc32(body.encode()):08x} {body}\n"


@dataclass
class Words:
    # The readable records by number, in order.
    kept: dict[int, dict[str, Any]] = field(default_factory=dict)
    damaged: int = 0  # number of records that are damaged or missing
    sure_from: int = 0  # from this number on none is lost
    newest: int = 0  # the greatest number that was ever written


def words(data: bytes, mark: bytes) -> Words:
    # Loss of power cut off a line without an end as it was written: its order had not begun.
    lines = data.decode("ascii", "replace").split("\n")[:-1]
    read = [_unsealed(line) for line in lines]
    known = {number: (first, content) for number, first, content in filter(None, read)}
    marked = Mark.read(mark)
    if not data and (not mark or (marked is not None and not marked.newest)):
        return Words()  # it is the first time
    first, newest = (0, 0) if marked is None else (marked.first, marked.newest)
    if known and max(known) >= newest:
        newest = max(known)
        first = known[newest][0]
    missing = [number for number in range(first, newest + 1) if number not in known]
    # A line of nonsense that stands for none, or a mark that is gone: nobody knows for what.
    is_odd = None in read or marked is None
    return Words(
        {number: known[number][1] for number in sorted(known)},
        len(missing) or int(is_odd),
        newest + 1 if is_odd and not missing else max(missing, default=-1) + 1,
        newest,
    )


def _unsealed(line: str) -> tuple[int, int, dict[str, Any]] | None:
    found = _LINE.fullmatch(line)
    if found is None or crc32(found[2].encode()) != int(found[1], 16):
        return None
    content = _json(found[5])
    return None if content is None else (int(found[3]), int(found[4]), content)


def _json(line: str) -> dict[str, Any] | None:
    try:
        content = read_json(line)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None
