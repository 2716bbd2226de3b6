"""Ctrl-C and SIGTERM while a program without ``await`` flies."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any, Protocol

__all__ = ["SIGNALS", "SyncSignals"]

_NUMBERS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class Flying(Protocol):
    """A control block, as this watch sees it; every one of these may be asked in any thread."""

    @property
    def is_flying(self) -> bool:
        """Whether nothing has ended it."""
        ...

    @property
    def is_over(self) -> bool:
        """Whether its stop path has ended too."""
        ...

    def interrupt(self) -> None:
        """Begin the stop path, without waiting."""
        ...


class SyncSignals:
    """A signal begins the stop path of every aircraft at once, and then ends the program.

    The aircraft live in threads of their own, so the program may be interrupted wherever it is: it
    gets KeyboardInterrupt, or SystemExit for what would have killed it, and its blocks wait for the
    end of their stop path on the way out. Until that has come, further signals do nothing.

    A signal that the program handles itself is left alone, and so are all of them outside the main
    thread.
    """

    def __init__(self) -> None:
        self._blocks: list[Flying] = []
        self._previous: dict[signal.Signals, Any] = {}  # dispositions to put back

    def join(self, block: Flying) -> None:
        """Interrupt that block when a signal comes."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._blocks = [other for other in self._blocks if not other.is_over]
        for number in _NUMBERS:
            previous = signal.getsignal(number)
            if previous in (signal.SIG_DFL, signal.default_int_handler):
                self._previous[number] = previous
                signal.signal(number, self._on_signal)
        self._blocks.append(block)

    def leave(self, block: Flying) -> None:
        """That block has ended."""
        if threading.current_thread() is not threading.main_thread():
            return
        self._blocks = [other for other in self._blocks if other is not block]
        if not self._blocks:
            self._put_back()

    def _put_back(self) -> None:
        for number, previous in self._previous.items():
            if signal.getsignal(number) == self._on_signal:
                signal.signal(number, previous)
        self._previous.clear()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # No lock is taken here: whatever holds one may be what was interrupted.
        flying = [block for block in self._blocks if block.is_flying]
        for block in flying:
            block.interrupt()
        if not flying and not all(block.is_over for block in self._blocks):
            return  # on its way out: the stop path runs, and is not cut short
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)


SIGNALS = SyncSignals()
"""The watch of this process."""
