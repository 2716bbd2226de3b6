"""The logs of one aircraft, for operators with the right to watch it.

Flying comes first. Threads of its own read the disk, the rate is limited, and few questions wait:
of a flood most are dropped before they are read. Nothing is kept for a client, so one that is slow
or gone costs nothing.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.messages import fault_of
from m100link.apps.bus.network import Bus, Question
from m100link.apps.fleet.agent import Verify, admit
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.logs import words
from m100link.apps.fleet.order_log import AuditLog
from m100link.apps.fleet.payloads import LogQuestion, OrderMessage, What, outcome_of, unpack
from m100link.errors import M100Error, UsageError
from m100link.log.folder import LogDirectory

T = TypeVar("T")

RATE = 1_000_000
"""Bytes of logs a second that leave an aircraft, by default: 38 MB of an hour in 38 s, and a radio
of 10 Mbit/s has room for orders."""

_MOST_WAITING = 16
_MOST_WAIT_S = 0.5
_LIST_COSTS = 64 * 1024
_DIGEST_S = 0.5
_MOST_DIGESTS = 8


class LogService:
    """One aircraft's end. Raises UsageError: nothing could ever leave at that rate."""

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        folder: Path | None,  # where its logs are; None for nowhere
        *,
        # Looks at each question; without it the router alone decides who may ask.
        verify: Verify | None = None,
        rate: float = RATE,  # bytes a second, at most
        audit: AuditLog | None = None,  # None: nothing is signed here
    ) -> None:
        if not rate > 0.0:
            raise UsageError(f"logs cannot leave at {rate:g} bytes/s", remedy="more than 0")
        self._bus, self._keys, self._verify = bus, keys, verify
        self._directory = LogDirectory(folder)
        self._rate = rate
        self._clock = asyncio.get_running_loop().time
        self._free_at = self._clock()
        self._background = TaskSet()
        self._waiting = 0
        self._is_ended = False
        # A disk that hangs must not hold up what others have threads for. One makes the digest.
        self._threads = ThreadPoolExecutor(2, thread_name_prefix=f"logs of {keys.name}")
        self._digests: OrderedDict[tuple[str, int], asyncio.Task[bytes]] = OrderedDict()
        self.dropped = 0  # questions of a flood that were not read
        self._doing: dict[What, Callable[[LogQuestion, OrderMessage], Awaitable[bytes]]] = {
            What.LIST: self._list,
            What.PIECE: self._piece,
            What.DIGEST: self._digest,
            What.AUDIT: self._lines,
        }
        self._audit = audit

    async def run(self) -> None:
        with ExitStack() as stack:
            stack.callback(self._end)
            served = self._bus.serve(self._keys.log, self._on_question, depth=_MOST_WAITING)
            stack.callback(served.close)
            try:
                await asyncio.Event().wait()
            finally:
                await self._background.end()

    def _end(self) -> None:
        self._is_ended = True
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def _apart(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)

    def _on_question(self, question: Question) -> None:
        if self._waiting >= _MOST_WAITING:
            self.dropped += 1
            question.drop()
            return
        self._waiting += 1
        self._background.spawn(self._answer(question), "question about logs")

    async def _answer(self, question: Question) -> None:
        identity = ""
        try:
            order: OrderMessage = unpack(OrderMessage, question.payload)
            identity = order.id
            payload = await self._answered(order)
        except M100Error as error:
            fault = words.LogReply(identity, self._keys.name, outcome_of(error), fault_of(error))
            payload = words.pack_reply(fault)
        finally:
            self._waiting -= 1
        question.answer(self._keys.log, payload)

    async def _answered(self, order: OrderMessage) -> bytes:
        question = admit(order, self._keys, LogQuestion, self._verify, "")
        words.require_possible(question)
        return await self._doing[question.what](question, order)

    async def _may_go(self, size: int) -> float:
        """Wait for the turn of so many bytes; 0, or seconds after which to ask again."""
        now = self._clock()
        waits = max(0.0, self._free_at - now)
        if waits > _MOST_WAIT_S:
            return waits
        self._free_at = now + waits + size / self._rate
        await asyncio.sleep(waits)
        return 0.0

    async def _list(self, question: LogQuestion, order: OrderMessage) -> bytes:
        if again := await self._may_go(_LIST_COSTS):
            return self._reply(order, again_s=again)
        return self._reply(order, words.pack_entries(await self._apart(self._directory.entries)))

    async def _piece(self, question: LogQuestion, order: OrderMessage) -> bytes:
        if again := await self._may_go(question.length):
            return self._reply(order, again_s=again)
        log, offset, length = question.log, question.offset, question.length
        data, entry = await self._apart(lambda: self._directory.piece(log, offset, length))
        is_written = entry.is_written
        return self._reply(order, data, offset=offset, size=entry.size, is_written=is_written)

    async def _lines(self, question: LogQuestion, order: OrderMessage) -> bytes:
        if self._audit is None:
            raise UsageError(
                f"{self._keys.name} writes no audit log",
                cause="its agent has no certificate to sign it by",
                remedy="run it from a fleet file: m100link fleet up FILE",
            )
        data = self._audit.since(question.offset, words.MOST_PIECE)
        if again := await self._may_go(len(data)):
            return self._reply(order, again_s=again)
        return self._reply(order, data)

    async def _digest(self, question: LogQuestion, order: OrderMessage) -> bytes:
        """Of one log at a time: the client asks again until it is ready."""
        wanted = (question.log, question.length)
        task = self._digests.get(wanted)
        if task is None:
            if any(not one.done() for one in self._digests.values()):
                return self._reply(order, again_s=_DIGEST_S)
            digest = partial(self._directory.digest, *wanted, lambda: not self._is_ended)
            task = self._background.spawn(self._apart(digest), f"digest of {question.log}")
            self._digests[wanted] = task
            while len(self._digests) > _MOST_DIGESTS:
                self._digests.popitem(last=False)
        await asyncio.wait([task], timeout=_DIGEST_S)
        if not task.done():
            return self._reply(order, again_s=_DIGEST_S)
        if task.cancelled() or task.exception() is not None:
            del self._digests[wanted]  # another time the disk may do it
        return self._reply(order, await task, size=question.length)

    def _reply(self, order: OrderMessage, data: bytes = b"", **fields: Any) -> bytes:
        return words.pack_reply(words.LogReply(order.id, self._keys.name, **fields), data)
