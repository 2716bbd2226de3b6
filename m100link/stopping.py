"""Ending well: SIGTERM takes the stop path, and nothing cuts the stop path short."""

from __future__ import annotations

import asyncio
import logging
import signal
import threading
from collections.abc import Awaitable, Callable

import anyio

__all__ = ["SigtermWatch", "finish"]

_logger = logging.getLogger("m100link.control")

_STOP_ATTEMPTS = 3


class SigtermWatch:
    """While it runs, SIGTERM calls ``stop`` instead of ending the process; at the end it does.

    Nothing happens where the program handles SIGTERM itself, outside the main thread, and on event
    loops without signal handlers. (SIGINT needs nothing: asyncio.run cancels the main task on
    Ctrl-C.)

    Args:
        stop: Begins the stop path.
    """

    def __init__(self, stop: Callable[[], object]) -> None:
        self._stop = stop
        self._is_watching = False
        self._is_terminated = False

    def begin(self) -> None:
        """Take SIGTERM."""
        if threading.current_thread() is not threading.main_thread():
            return
        if signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
            return
        try:
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self._on_sigterm)
        except NotImplementedError:
            return  # event loops of Windows
        self._is_watching = True

    def _on_sigterm(self) -> None:
        self._is_terminated = True
        _logger.warning("SIGTERM: stopping the aircraft")
        self._stop()

    def end(self) -> None:
        """Let SIGTERM go; one that came meanwhile ends the process now that it is safe."""
        if self._is_watching:
            self._is_watching = False
            asyncio.get_running_loop().remove_signal_handler(signal.SIGTERM)
            if self._is_terminated:
                signal.raise_signal(signal.SIGTERM)


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
