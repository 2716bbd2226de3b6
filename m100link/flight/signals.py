"""Signals take the stop path of every control block of the process, and act when it has ended."""

from __future__ import annotations

import asyncio
import functools
import logging
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import FrameType
from typing import Any

__all__ = ["NUMBERS", "SIGNALS", "OtherWatch", "SignalWatch"]

_logger = logging.getLogger(__name__)

NUMBERS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU")
    if hasattr(signal, name)
)
"""By which a person, a terminal, a service manager or the kernel ends a program: all of them are
taken. SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM, SIGPROF and SIGIO end a program as well, but one that
has them sent mostly handles them in C (faulthandler, profilers), which Python cannot see: to take
them would break that, or end a flight at a tick of a profiler."""

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
        """The child flies nothing: signals do to it what they did before the first block."""
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
        if self._received:
            loop.call_soon(stop)

    def leave(self, stop: Stop) -> None:
        """That block has ended. After the last one, signals that came act."""
        if self._blocks.pop(stop, None) is not None and not self._blocks:
            self._let_go()

    def _forget_the_dead(self) -> None:
        """Blocks whose event loop was closed before they ended cannot be stopped any more."""
        for stop, loop in tuple(self._blocks.items()):
            if loop.is_closed():
                self._blocks.pop(stop)

    def _let_go(self) -> None:
        for number, previous in self._previous.items():
            if signal.getsignal(number) == self._on_signal:
                signal.signal(number, _as_it_is_now(previous))
        received, self._received = self._received, []
        # What ends the process comes first: SIGINT raises.
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
    # What asyncio.run installs cancels the main task once, and then raises.
    is_of_asyncio = isinstance(handler, functools.partial) and isinstance(
        getattr(handler.func, "__self__", None), asyncio.Runner
    )
    return handler is signal.default_int_handler or is_of_asyncio


def _other_watch(handler: Any) -> OtherWatch | None:
    """The watch whose handler that is."""
    owner = getattr(handler, "__self__", None)
    return owner if isinstance(owner, OtherWatch) else None


def _as_it_is_now(handler: Any) -> Any:
    """What asyncio.run installed goes with its main task."""
    task = handler.keywords.get("main_task") if isinstance(handler, functools.partial) else None
    return signal.default_int_handler if task is not None and task.done() else handler


SIGNALS = SignalWatch()
"""The watch of this process."""
