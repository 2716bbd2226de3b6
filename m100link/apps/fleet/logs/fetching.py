"""Fetches logs of one aircraft of a fleet; a transfer that was cut off continues.

The part that came stays in a file whose name ends in ``.part``. However a transfer ends, the next
one of the same log continues it. At the end the digests of both sides are compared.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from m100link.apps.agent.background import ignore
from m100link.apps.agent.messages import MessageError
from m100link.apps.fleet.asking import PATIENCE_S, RIGHTS, Asker, nobody_there, reason_of
from m100link.apps.fleet.logs import words
from m100link.apps.fleet.payloads import LogQuestion, Outcome, What, pack
from m100link.errors import FleetError, M100Error, Unreachable, UsageError
from m100link.log.folder import LogEntry, is_log_name

PIECE = 64 * 1024
"""Bytes that are asked for at once: little is under way when somebody else asks."""

_ANSWER_S = 2.0
_AGAIN_S = 0.2
_MOST_AGAIN_S = 2.0

Progress = Callable[[int, int], None]
"""Called with the bytes of a log that are here, and the bytes that there will be."""


@dataclass(frozen=True, slots=True)
class Fetched:
    """A log that was fetched."""

    name: str  #: name of the aircraft
    log: str  #: its name on board
    path: Path  #: the file
    size: int  #: bytes
    came: int  #: bytes that came now; the others were here already
    is_written: bool  #: whether it was still being written, so that this is its part so far


class LogFetcher:
    """Asks one aircraft for its logs."""

    def __init__(self, asker: Asker) -> None:
        self._keys, self._asker = asker.keys, asker
        self._clock = asyncio.get_running_loop().time
        self._has_answered = False

    async def logs(self) -> list[LogEntry]:
        _, data = await self._ask(LogQuestion(What.LIST))
        return words.unpack_entries(data)

    async def audit(self, number: int) -> bytes:
        lines = b""
        while True:
            _, data = await self._ask(LogQuestion(What.AUDIT, "", number))
            count = data.count(b"\n")
            if not count:
                return lines
            lines, number = lines + data, number + count

    async def fetch(
        self, log: str = "", to: Path | str = "", progress: Progress | None = None
    ) -> Fetched:
        entry = await self._entry(log)
        part = await asyncio.to_thread(words.LogPart, Path(to), f"{self._keys.name}-{entry.log}")
        try:
            await asyncio.to_thread(part.open, entry.size)
            return await self._fetch(entry, part, progress or ignore)
        except M100Error as error:
            raise _with_rest(error, part, entry.size) from error
        finally:
            part.close()  # at once: a cancelled task is cancelled at every wait

    async def _entry(self, log: str) -> LogEntry:
        if log and not is_log_name(log):
            raise UsageError(
                f"{log!r} is no name of a log", remedy=f"m100link fleet log list {self._keys.name}"
            )
        entries = await self.logs()
        if not entries:
            raise UsageError(
                f"{self._keys.name} has no logs",
                cause="its agent records nothing (--no-record), or no aircraft was connected yet",
                remedy="start the agent without --no-record, and connect its aircraft",
            )
        found = next((one for one in entries if log in ("", one.log)), None)
        if found is None:
            raise UsageError(
                f"{self._keys.name} has no log {log}",
                cause="it made room for newer ones, or belongs to another aircraft",
                remedy=f"m100link fleet log list {self._keys.name}",
            )
        return found

    async def _fetch(self, entry: LogEntry, part: words.LogPart, progress: Progress) -> Fetched:
        name, size = self._keys.name, entry.size
        fetched = Fetched(name, entry.log, part.whole, size, 0, entry.is_written)
        if await asyncio.to_thread(part.whole.exists):
            have = await self._same(entry, part)
            if have == size:
                progress(size, size)
                return fetched
            await asyncio.to_thread(part.take_up)
        at = began_at = part.at
        while True:
            progress(at, size)
            while at < size:
                data = await self._piece(entry.log, at, min(PIECE, size - at))
                await asyncio.to_thread(part.add, data)
                at += len(data)
                progress(at, size)
            if await self._digest(entry.log, size) == await asyncio.to_thread(part.digest):
                await asyncio.to_thread(part.finish)
                return replace(fetched, came=size - began_at)
            await asyncio.to_thread(part.forget)
            if not began_at:
                raise FleetError(
                    f"the copy of {entry.log} differs from the log of {name}",
                    cause="it was changed on board meanwhile, or on its way",
                    remedy="fetch it again",
                )
            at = began_at = 0  # what was here from before is of something else

    async def _same(self, entry: LogEntry, part: words.LogPart) -> int:
        """How many bytes of the log were fetched before."""
        have, digest = await asyncio.to_thread(part.whole_digest)
        if have > entry.size or await self._digest(entry.log, have) != digest:
            raise UsageError(
                f"{part.whole} is there already, and is another log",
                remedy="name another folder by --output",
            )
        return have

    async def _piece(self, log: str, at: int, length: int) -> bytes:
        reply, data = await self._ask(LogQuestion(What.PIECE, log, at, length))
        if reply.offset != at or not 0 < len(data) <= length:
            raise UsageError(
                f"{log} of {self._keys.name} ends at {reply.size} bytes",
                cause="it became shorter on board meanwhile",
                remedy="fetch it again",
            )
        return data

    async def _digest(self, log: str, length: int) -> bytes:
        _, digest = await self._ask(LogQuestion(What.DIGEST, log, 0, length))
        return digest

    async def _ask(self, question: LogQuestion) -> tuple[words.LogReply, bytes]:
        """Ask until it is answered: nothing on board changes by it."""
        name = self._keys.name
        self._asker.require(question.right)
        # An agent that has answered may come back, with the router or by a restart.
        if not self._has_answered and not await self._asker.is_there():
            raise nobody_there(self._keys)
        silent_since = self._clock()
        unread: MessageError | None = None
        while self._clock() - silent_since < PATIENCE_S:
            # A new one each time, for a signature ages.
            order = self._asker.around(question)
            found = None
            answers = await self._asker.bus.ask(self._keys.log, pack(order), timeout=_ANSWER_S)
            for answer in filter(self._asker.is_of_aircraft, answers):
                try:
                    reply, data = words.unpack_reply(answer.payload)
                except MessageError as error:
                    unread = error
                    continue
                if reply.name == name and reply.id in (order.id, ""):
                    found = reply, data
            if found is None:
                await asyncio.sleep(_AGAIN_S)
                continue
            self._has_answered = True
            reply, data = found
            if reply.outcome is not Outcome.OK:
                raise reason_of(name, reply.fault)
            if reply.again_s <= 0.0:
                return reply, data
            silent_since = self._clock()
            await asyncio.sleep(min(reply.again_s, _MOST_AGAIN_S))
        if unread is not None:
            raise unread
        raise Unreachable(
            f"{name} gave no answer about its logs for {PATIENCE_S:g} s",
            cause="the link is cut, its agent hangs or is an old one, or the router lets no answer "
            "pass to this identity",
            remedy=RIGHTS,
        )


def _with_rest(error: M100Error, part: words.LogPart, size: int) -> M100Error:
    again = error.again()
    if part.at:
        again.seen = f"{error.seen}; {part.at:,} of {size:,} bytes are in {part.path}"
        again.remedy = error.remedy or "the same command continues"
        again.args = (again.seen, again.cause, again.remedy)
    return again
