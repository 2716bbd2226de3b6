"""Ending well: signals take the stop path, and nothing cuts the stop path short."""

from __future__ import annotations

import asyncio
import logging
import signal
import threading
from collections.abc import Awaitable, Callable

import anyio

__all__ = ["SignalWatch", "finish"]

_logger = logging.getLogger("m100link.flight")

_STOP_ATTEMPTS = 3


_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class SignalWatch:
    """While it runs, SIGTERM and SIGHUP call ``stop``; afterwards they do what they would have.

    (SIGHUP is what a closed terminal sends. SIGINT needs nothing: asyncio.run cancels the main
    task on Ctrl-C.) Nothing happens where the program handles the signal itself, outside the main
    thread, and on event loops without signal handlers.

    Args:
        stop: Begins the stop path.
    """

    def __init__(self, stop: Callable[[], object]) -> None:
        self._stop = stop
        self._watched: list[signal.Signals] = []
        self._received: signal.Signals | None = None

    def begin(self) -> None:
        """Take the signals."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in _SIGNALS:
            if signal.getsignal(number) is not signal.SIG_DFL:
                continue
            try:
                asyncio.get_running_loop().add_signal_handler(number, self._on_signal, number)
            except NotImplementedError:
                return  # event loops of Windows
            self._watched.append(number)

    def _on_signal(self, number: signal.Signals) -> None:
        self._received = number
        _logger.warning("%s: stopping the aircraft", number.name)
        self._stop()

    def end(self) -> None:
        """Let the signals go; one that came meanwhile ends the process now that it is safe."""
        for number in self._watched:
            asyncio.get_running_loop().remove_signal_handler(number)
        self._watched.clear()
        if self._received is not None:
            signal.raise_signal(self._received)


async def finish(how: Callable[[], Awaitable[None]]) -> None:
    """Await work to its end whatever cancels the caller meanwhile, then let the cancellation on.

    A shielded scope alone holds off cancellation by scopes; a second ``Task.cancel()`` would still
    cut the stop path short, and asyncio.run cancels every task there is after a second Ctrl-C: then
    the work is begun again. Every wait in it is bounded, so this is too.
    """
    cancelled: asyncio.CancelledError | None = None
    with anyio.CancelScope(shield=True):
        for _ in range(_STOP_ATTEMPTS):
            task = asyncio.ensure_future(how())
            while not task.done():
                try:
                    await asyncio.wait([task])
                except asyncio.CancelledError as error:
                    cancelled = error
            if not task.cancelled():
                task.result()
                break
        else:
            _logger.error("the stop path was cancelled %d times and given up", _STOP_ATTEMPTS)
    if cancelled is not None:
        raise cancelled
