"""Acquire what the end of a flight needs before the flight: the system may refuse it later."""

from __future__ import annotations

import asyncio
import atexit
import os
import time
from collections.abc import Callable, Coroutine
from typing import Any

import anyio

from m100link.errors.base import of_the_system
from m100link.flight.log_thread import LOG_THREAD

__all__ = ["free", "reserve"]

Close = Callable[[], Coroutine[Any, Any, None]]

_NOW_S = 1.0  # by how much an event loop's clock may differ from the system's, which it mostly is


_flying: dict[Close, asyncio.AbstractEventLoop] = {}


def reserve(what: str, close: Close) -> None:
    """Load and start what ends a flight, so that it need not load, open or start anything later.

    Python loads modules from a disk that may fail, with file descriptors that may run out. So this
    loads the modules of the stop path and starts the thread of the log. After the flight, call
    :func:`free`.

    Args:
        what: Names the request in the error.
        close: Ends the flight and waits for that. It is run when the program falls off its end
            between two runs of its event loop.

    Raises:
        OutOfResources: The system has no more.
    """
    for dead in [one for one, loop in _flying.items() if loop.is_closed()]:
        free(dead)  # its event loop was closed before it ended
    loop = asyncio.get_running_loop()
    with of_the_system(what):
        anyio.CancelScope()  # which loads what it stands on when the first one is made
        LOG_THREAD.hold(is_simulated=abs(loop.time() - time.monotonic()) > _NOW_S)
    _flying[close] = loop


def free(close: Close) -> None:
    """Note that the flight has ended."""
    _flying.pop(close, None)
    LOG_THREAD.release()


def _end_flights() -> None:
    """The interpreter ends. A loop that runs is its owner's to end, one that is closed gone."""
    for close, loop in list(_flying.items()):
        if not loop.is_running() and not loop.is_closed():
            loop.run_until_complete(close())


atexit.register(_end_flights)
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_flying.clear)
