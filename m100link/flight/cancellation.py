"""Cancelling the program's block from outside, and waiting although others cancel."""

from __future__ import annotations

import asyncio
import functools
import logging
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from types import FrameType
from typing import Any

import anyio

_logger = logging.getLogger(__name__)

# asyncio.run cancels every task once as it leaves. A program that does so again and again must
# come to an end as well, and each attempt is bounded by the waits of the stop path.
_ATTEMPTS = 3
_LOOK_S = 0.1


class ProgramTask:
    """The task in whose block the program runs, cancelled once as ``asyncio.timeout()`` does it.

    It may be left by another task (an async generator that is closed by the event loop, an
    ExitStack that somebody else unwinds); a scope of anyio would refuse that.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop  # where it runs; at a prompt, nothing runs yet when this is made
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
        # More requests than at the start are somebody else's (asyncio.timeout() around the block),
        # and so is a cancellation that is raised in another task: neither may be swallowed.
        return (
            isinstance(error, asyncio.CancelledError)
            and self._host is asyncio.current_task()
            and remaining <= self._requests_before
        )


async def undisturbed(task: asyncio.Task[None]) -> asyncio.CancelledError | None:
    """Wait for the end of a task whatever cancels the caller; return the last cancellation."""
    cancelled: asyncio.CancelledError | None = None
    # The shield holds off scopes, which cancel at every await; the loop holds off Task.cancel().
    with anyio.CancelScope(shield=True):
        while not task.done():
            try:
                await asyncio.wait([task])
            except asyncio.CancelledError as error:
                cancelled = error
    return cancelled


def new_task(work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
    """A task of the running event loop that no task factory of the program makes or refuses."""
    # A factory may raise, or run the first lines at once, on the stack of its caller.
    return asyncio.Task(work, loop=asyncio.get_running_loop(), name=name)


class ShieldedTask:
    """Work in a task of its own that is carried to its end, whatever is cancelled meanwhile.

    asyncio.run cancels every task there is on its way out, the one that works among them: then the
    work is begun again, a few times. Every wait in it should be bounded, then this is too.
    """

    def __init__(
        self, work: Callable[[], Coroutine[Any, Any, None]], on_end: Callable[[], object]
    ) -> None:
        self._work = work  # may be begun again after it was cancelled
        self._on_end = on_end  # called once, when it has ended in whatever way
        self._has_ended = False
        self.is_wanted = False  # whether it was begun
        self._task: asyncio.Task[None] | None = None  # the present attempt, or parked for the first
        self._parked: asyncio.Future[None] | None = None  # what the parked task waits for
        self._timer: asyncio.TimerHandle | None = None

    def park(self, on_cancelled: Callable[[], None]) -> None:
        """Make the task now, which waits to be begun: then that takes nothing of the system.

        ``on_cancelled``: called when somebody cancels the task before it was begun, as asyncio.run
        does on its way out; it should lead to :meth:`begin`.
        """
        self._parked = asyncio.get_running_loop().create_future()
        self._task = new_task(self._wait(self._parked, on_cancelled), "m100link stop path")
        self._look()

    def begin(self) -> asyncio.Task[None]:
        """Begin, or begin again. One that is parked needs no frame of the stack for it."""
        # The future of the parked task is not completed here: with too little stack the task would
        # never be woken, not even by its cancellation. Without a frame for call_soon() either, the
        # timer of _look() finds this flag a tenth of a second later.
        self.is_wanted = True
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
        # Again and again: begin() may find no stack to call for it.
        self._timer = self._parked.get_loop().call_later(_LOOK_S, self._look)
        if self.is_wanted:
            self._parked.set_result(None)

    async def ended(self) -> None:
        """Wait for the end, raise the work's error, and pass a cancellation of the caller on."""
        self.is_wanted = True  # also where an end had no memory to begin it: its timer sees that
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
            if not self.is_wanted:
                on_cancelled()
        if self._timer is not None:
            self._timer.cancel()
        await self._run(cancelled)

    async def _run(self, cancelled: asyncio.CancelledError | None = None) -> None:
        attempt, failed = None, None
        try:
            for _ in range(_ATTEMPTS):
                try:
                    if attempt is None or attempt.done():
                        attempt = new_task(self._work(), "m100link attempt of the stop path")
                    cancelled = await undisturbed(attempt) or cancelled
                    if not attempt.cancelled():
                        attempt.result()
                        break
                except (MemoryError, RecursionError) as error:  # perhaps over in a moment
                    failed = failed or error
            else:
                _logger.error("the stop path was broken off %d times and given up", _ATTEMPTS)
        finally:
            self._has_ended = True
            self._on_end()
        if (ended_by := failed or cancelled) is not None:
            raise ended_by


# -- signals take the stop path of every control block of the process, and act when it ended -------


NUMBERS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU", "SIGBREAK")
    if hasattr(signal, name)
)
"""By which a person, a terminal, a service manager or the kernel ends a program: all of them are
taken. SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM, SIGPROF and SIGIO end a program as well, but one that
has them sent mostly handles them in C (faulthandler, profilers), which Python cannot see: to take
them would break that, or end a flight at a tick of a profiler. SIGBREAK is Windows' own."""

# Seconds without a pass of the event loop after which a second Ctrl-C interrupts the program; a
# loop that runs takes the stop path (page on safety).
_HUNG_S = 1.0

Stop = Callable[[], object]


class OtherWatch(ABC):
    """A watch of the same signals for blocks of another kind, which gives way to this one.

    Its handler is put back and acts when the blocks here have ended; its own blocks are not to
    wait for that.
    """

    @abstractmethod
    def stop_blocks(self) -> None:
        """Begin the stop path of every block of it, without waiting. Called in a handler."""


class SignalWatch:
    """While a control block runs, the signals of :data:`NUMBERS` stop it instead of the program.

    (SIGHUP is what a closed terminal sends, SIGQUIT that of Ctrl and the backslash, SIGXCPU the end
    of the processor time that a limit allows.) Dispositions belong to the process, so there is one
    watch for all blocks: the first one takes the signals, all are stopped by one, and when the last
    has ended a signal that came does what it would have done. Meanwhile nothing raises
    KeyboardInterrupt: that could come between any two lines, of the stop path or of the event loop,
    which loses the callback that it was about to run and with it the task that waits.

    A signal that the program handles itself is left alone, and so are all of them outside the main
    thread. An :class:`OtherWatch` gives way, and its blocks are stopped by the same signal.
    """

    def __init__(self) -> None:
        self._blocks: dict[Stop, asyncio.AbstractEventLoop] = {}
        # Dispositions to put back. Kept behind the last block: a program may put our handler back,
        # which it found while one flew.
        self._previous: dict[signal.Signals, Any] = {}
        self._received: list[signal.Signals] = []
        self._received_at = 0.0
        self._is_seen = False  # by the event loop, since the first one came
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._after_fork)

    def _after_fork(self) -> None:
        """The child flies nothing: signals act on it as before the first block."""
        self._blocks.clear()
        self._received.clear()
        self._let_go()

    def join(self, stop: Stop) -> None:
        """Call ``stop`` in the present event loop when a signal comes, or has come to others."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._forget_the_dead()
        if not self._blocks:
            self._let_go()  # nothing, unless the last block died with its event loop
            self._take()
        loop = asyncio.get_running_loop()
        self._blocks[stop] = loop
        # A signal came before this block began: it must not fly while the others stop.
        if self._received:
            loop.call_soon(stop)

    def leave(self, stop: Stop) -> None:
        """That block has ended. After the last one, signals that came act."""
        if self._blocks.pop(stop, None) is not None and not self._blocks:
            self._let_go()

    def _forget_the_dead(self) -> None:
        """Blocks whose event loop was closed before they ended cannot be stopped any more."""
        self._blocks = {stop: loop for stop, loop in self._blocks.items() if not loop.is_closed()}

    def _let_go(self) -> None:
        for number, previous in self._previous.items():
            # The program may have put a handler of its own there meanwhile: that one stays.
            if signal.getsignal(number) == self._on_signal:
                signal.signal(number, _as_it_is_now(previous))
        received, self._received = self._received, []
        # SIGINT raises and so ends this loop: a signal that ends the process comes before it.
        for number in sorted(received, key=lambda number: number == signal.SIGINT):
            signal.raise_signal(number)

    def _take(self) -> None:
        self._is_seen = False
        for number in NUMBERS:
            previous = signal.getsignal(number)
            if _would_end_the_program(number, previous):
                self._previous[number] = previous
                signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # This runs between any two lines of the program: the event loop does the work.
        now = time.monotonic()
        self._forget_the_dead()
        is_first = not self._received
        if signal.Signals(number) not in self._received:
            self._received.append(signal.Signals(number))
        if is_first:
            self._received_at = now
            other = _other_watch(self._previous.get(signal.Signals(number)))
            if other is not None:
                other.stop_blocks()
            for stop, loop in self._blocks.items():
                loop.call_soon_threadsafe(self._stop, stop, signal.Signals(number))
            # The program put our handler back, behind the last block: the signal acts at once.
            if not self._blocks:
                self._let_go()
        elif number == signal.SIGINT and not self._is_seen and now > self._received_at + _HUNG_S:
            raise KeyboardInterrupt  # a program that blocks its loop can be broken into by hand

    def _stop(self, stop: Stop, number: signal.Signals) -> None:
        is_first, self._is_seen = not self._is_seen, True
        if stop in self._blocks:
            stop()
        if is_first:  # behind the stop: a log can raise, or block for ever
            _logger.warning("%s: stopping the aircraft", number.name)


def _would_end_the_program(number: signal.Signals, handler: Any) -> bool:
    if _other_watch(handler) is not None:
        return True
    if number != signal.SIGINT:
        return handler is signal.SIG_DFL
    # The handler of asyncio.run cancels the main task once, and then raises.
    owner = getattr(getattr(handler, "func", None), "__self__", None)
    return handler is signal.default_int_handler or isinstance(owner, asyncio.Runner)


def _other_watch(handler: Any) -> OtherWatch | None:
    owner = getattr(handler, "__self__", None)
    return owner if isinstance(owner, OtherWatch) else None


def _as_it_is_now(handler: Any) -> Any:
    """The handler, or Python's own when that of asyncio.run has outlived its main task."""
    task = handler.keywords.get("main_task") if isinstance(handler, functools.partial) else None
    return signal.default_int_handler if task is not None and task.done() else handler


SIGNALS = SignalWatch()  # the watch of this process
