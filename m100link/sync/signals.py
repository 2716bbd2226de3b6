"""Ctrl-C, SIGTERM and their like while a program without ``await`` flies."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any, Protocol

from m100link.flight.cancellation import NUMBERS, OtherWatch

_HUNG_S = 1.0


class Flying(Protocol):
    """A control block, as this watch sees it; every one of these may be asked in any thread."""

    @property
    def is_flying(self) -> bool:
        """Whether nothing has ended it."""
        ...

    @property
    def is_stopping(self) -> bool:
        """Whether its stop path runs."""
        ...

    @property
    def is_over(self) -> bool:
        """Whether its stop path has ended too."""
        ...

    def interrupt(self) -> None:
        """Begin the stop path, without waiting."""


class SyncSignals(OtherWatch):
    """A signal begins the stop path of every aircraft at once, and then ends the program.

    The aircraft live in threads of their own, so the program may be interrupted wherever it is: it
    gets KeyboardInterrupt, or SystemExit for what would have killed it, and its blocks wait for the
    end of their stop path on the way out. Until that has come, further signals do nothing; one that
    is the first, because the program left its block by itself, acts then.

    Signals can be taken in the main thread alone, which often waits while others fly: so they are
    taken when it connects, until it closes. While nothing flies they do what they did before. A
    signal that the program handles itself is left alone.

    When only other threads connect, Ctrl-C is seen when it ends the main thread: Python then waits
    for those threads, however long they fly.
    """

    def __init__(self) -> None:
        # Lists are replaced, not changed: a signal comes between any two lines.
        self._blocks: list[Flying] = []
        self._aircraft: list[object] = []  # that are connected
        self._changes = threading.Lock()  # of the two: several threads fly
        self._previous: dict[signal.Signals, Any] = {}  # dispositions to put back
        self._excepthook: Any = None  # that of the program, while ours is in its place
        self._interrupted: list[Flying] = []  # their stop path begins in their own thread
        self._interrupted_at = 0.0
        self._has_acted = False  # since a block joined last: the program knows that it is to end
        self._pending: int | None = None  # came during a stop path, and acts behind it
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._after_fork)

    def _after_fork(self) -> None:
        """The child flies nothing: signals do to it what they did before it was connected."""
        self._changes = threading.Lock()  # another thread may have held it, which is not here
        self._blocks, self._aircraft, self._interrupted, self._pending = [], [], [], None
        self._put_back()

    def connected(self, aircraft: object) -> None:
        """It may be flown from now on, in whatever thread."""
        with self._changes:
            self._aircraft = [*self._aircraft, aircraft]
        self._take()
        shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
        if shell is not None:  # a cell that only computes calls nothing here, and a mission flies
            shell.events.register("pre_run_cell", self.take_again)

    def closed(self, aircraft: object) -> None:
        """It will not fly any more."""
        with self._changes:
            self._aircraft = [other for other in self._aircraft if other is not aircraft]
        self._put_back()

    def take_again(self, *_: object) -> None:
        """Take what was put back meanwhile: a notebook does so with SIGINT behind every cell."""
        if self._aircraft and threading.current_thread() is threading.main_thread():
            self._take()

    def join(self, block: Flying) -> None:
        """Interrupt that block when a signal comes."""
        with self._changes:
            self._blocks = [*self._without(block), block]
            self._has_acted = False
        self._take()

    def leave(self, block: Flying) -> None:
        """That block was left; it is watched until it has ended."""
        if block.is_flying or block.is_stopping:
            return
        with self._changes:
            self._blocks = self._without(block)
            self._interrupted = [other for other in self._interrupted if other in self._blocks]
            pending = self._pending
            if pending is not None and any(other.is_stopping for other in self._blocks):
                pending = None
            if pending is not None:
                self._pending = None
        self._put_back()
        if pending is not None:
            signal.raise_signal(pending)

    def _without(self, block: Flying) -> list[Flying]:
        return [other for other in self._blocks if other is not block and not other.is_over]

    def _take(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            with self._changes:
                if self._excepthook is None:
                    self._excepthook, sys.excepthook = sys.excepthook, self._on_unhandled
            return
        for number in NUMBERS:
            previous = signal.getsignal(number)
            if previous in (signal.SIG_DFL, signal.default_int_handler):
                self._previous[number] = previous
                signal.signal(number, self._on_signal)

    def _put_back(self) -> None:
        if self._aircraft or not all(block.is_over for block in self._blocks):
            return
        with self._changes:
            if sys.excepthook == self._on_unhandled:  # else somebody hands on to ours
                sys.excepthook, self._excepthook = self._excepthook, None
        if threading.current_thread() is not threading.main_thread():
            return
        for number, previous in self._previous.items():
            if signal.getsignal(number) == self._on_signal:
                signal.signal(number, previous)
        self._previous.clear()

    def stop_blocks(self) -> None:
        """Begin the stop path of everything that flies; no lock is taken."""
        for block in self._blocks:
            if block.is_flying:
                block.interrupt()

    def _on_unhandled(self, kind: type[BaseException], *details: Any) -> None:
        if issubclass(kind, KeyboardInterrupt):
            self.stop_blocks()
        (self._excepthook or sys.__excepthook__)(kind, *details)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # No lock is taken here: whatever holds one may be what was interrupted.
        flying = [block for block in self._blocks if block.is_flying]
        now = time.monotonic()
        if now > self._interrupted_at + _HUNG_S:
            self._interrupted = []  # a thread that hangs can be broken off by hand
        fresh = [block for block in flying if block not in self._interrupted]
        if fresh:
            self._interrupted, self._interrupted_at = [*self._interrupted, *fresh], now
        for block in fresh:
            block.interrupt()
        if not fresh and (flying or any(block.is_stopping for block in self._blocks)):
            if not self._has_acted:
                self._pending = number
            return  # the stop path runs, and is not cut short
        self._has_acted = True
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        if not self._blocks:  # as if this had never been here
            signal.signal(number, self._previous.pop(signal.Signals(number), signal.SIG_DFL))
            signal.raise_signal(number)
            return
        raise SystemExit(128 + number)


SIGNALS = SyncSignals()
"""The watch of this process."""
