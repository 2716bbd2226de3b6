"""Cancelling the program's block from outside, and waiting although others cancel."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any

import anyio

__all__ = ["Errand", "ProgramTask", "new_task", "undisturbed"]

_logger = logging.getLogger(__name__)

_ATTEMPTS = 3
_LOOK_S = 0.1


class ProgramTask:
    """The task in whose block the program runs, cancelled once as ``asyncio.timeout()`` does it.

    It may be left by another task (an async generator that is closed by the event loop, an
    ExitStack that somebody else unwinds); a scope of anyio would refuse that.

    Args:
        loop: Where it runs; at a prompt, nothing runs yet when this is made.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._task: asyncio.Task[object] | None = None  # None before the block and after it
        self._host: asyncio.Task[object] | None = None
        self._requests_before = 0  # cancellations of others that were under way at the start
        self._is_cancelled = False

    def enter(self) -> None:
        """The block begins in the present task."""
        self._task = self._host = asyncio.current_task()
        self._requests_before = self._host.cancelling() if self._host else 0

    def cancel(self) -> None:
        """Raise CancelledError where the program waits."""
        # Later: a task that cancels itself would meet the cancellation on its way out.
        self._loop.call_soon(self._deliver)

    def _deliver(self) -> None:
        if self._task is not None and not self._is_cancelled:
            self._is_cancelled = self._task.cancel()

    def leave(self) -> None:
        """The block was left, by whatever task: nobody is cancelled any more."""
        self._task = None

    def take_back(self, error: BaseException | None) -> bool:
        """Take the cancellation back. Returns whether ``error`` is it, and nobody else's."""
        if not self._is_cancelled or self._host is None:
            return False
        self._is_cancelled = False
        remaining = self._host.uncancel()
        return (
            isinstance(error, asyncio.CancelledError)
            and self._host is asyncio.current_task()
            and remaining <= self._requests_before
        )


async def undisturbed(task: asyncio.Task[None]) -> asyncio.CancelledError | None:
    """Wait for the end of a task whatever cancels the caller; return the last cancellation.

    A shielded scope alone holds off cancellation by scopes, not by ``Task.cancel()``.
    """
    cancelled: asyncio.CancelledError | None = None
    with anyio.CancelScope(shield=True):
        while not task.done():
            try:
                await asyncio.wait([task])
            except asyncio.CancelledError as error:
                cancelled = error
    return cancelled


def new_task(work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
    """A task of the running event loop that no task factory of the program makes or refuses.

    A factory may raise, or run the first lines at once, on the stack of its caller.
    """
    return asyncio.Task(work, loop=asyncio.get_running_loop(), name=name)


class Errand:
    """Work in a task of its own that is carried to its end, whatever is cancelled meanwhile.

    asyncio.run cancels every task there is on its way out, the one that works among them: then the
    work is begun again, a few times. Every wait in it should be bounded, then this is too.

    Args:
        work: May be begun again after it was cancelled.
        on_end: Called once, when it has ended in whatever way.
    """

    def __init__(
        self, work: Callable[[], Coroutine[Any, Any, None]], on_end: Callable[[], None]
    ) -> None:
        self._work = work
        self._on_end = on_end
        self._has_ended = False
        self._is_wanted = False  # whether it was begun
        self._task: asyncio.Task[None] | None = None  # the present attempt, or parked for the first
        self._parked: asyncio.Future[None] | None = None  # what the parked task waits for
        self._timer: asyncio.TimerHandle | None = None

    def park(self, on_cancelled: Callable[[], None]) -> None:
        """Make the task now, which waits to be begun: then that takes nothing of the system.

        Args:
            on_cancelled: Called when somebody cancels the task before it was begun, as asyncio.run
                does on its way out; it should lead to :meth:`begin`.
        """
        self._parked = asyncio.get_running_loop().create_future()
        self._task = new_task(self._wait(self._parked, on_cancelled), "m100link stop path")
        self._look()

    def begin(self) -> asyncio.Task[None]:
        """Begin, or begin again. One that is parked needs no frame of the stack for it.

        Where there is none for the call either, it begins a tenth of a second later. Nothing here
        completes what the parked task waits for: with too little stack that task would never be
        woken, not even by its cancellation.
        """
        self._is_wanted = True
        if self._task is None or self._task.done():
            self._task = new_task(self._run(), "m100link stop path")
        elif self._parked is not None:
            self._parked.get_loop().call_soon(self._look)
        return self._task

    def _look(self) -> None:
        """Begin, if that is wanted; called by the event loop, with all of the stack."""
        if self._parked is None or self._parked.done():
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._parked.get_loop().call_later(_LOOK_S, self._look)
        if self._is_wanted:
            self._parked.set_result(None)

    async def ended(self) -> None:
        """Wait for the end, then let on what cancelled the caller meanwhile.

        Raises what the work raised.
        """
        task = self._task or self.begin()
        cancelled: asyncio.CancelledError | None = None
        while not self._has_ended:
            if task.done():
                task = self.begin()  # it was cancelled before its first line
            cancelled = await undisturbed(task) or cancelled
        if cancelled is not None:
            # Ctrl-C that acted behind the stop path is out of the event loop already.
            error = None if task.cancelled() else task.exception()
            if error is not None and not isinstance(error, KeyboardInterrupt | SystemExit):
                _logger.error("the stop path failed, and its caller was cancelled: %r", error)
            raise cancelled
        if not task.cancelled():
            task.result()

    async def _wait(self, begun: asyncio.Future[None], on_cancelled: Callable[[], None]) -> None:
        cancelled: asyncio.CancelledError | None = None
        try:
            await begun
        except asyncio.CancelledError as error:
            cancelled = error
            if not self._is_wanted:
                on_cancelled()
        if self._timer is not None:
            self._timer.cancel()
        await self._run(cancelled)

    async def _run(self, cancelled: asyncio.CancelledError | None = None) -> None:
        try:
            for _ in range(_ATTEMPTS):
                attempt = new_task(self._work(), "m100link attempt of the stop path")
                cancelled = await undisturbed(attempt) or cancelled
                if not attempt.cancelled():
                    attempt.result()
                    break
            else:
                _logger.error("the stop path was cancelled %d times and given up", _ATTEMPTS)
        finally:
            self._has_ended = True
            self._on_end()
        if cancelled is not None:
            raise cancelled
