"""Resources for the end of a flight, acquired before it: the system may refuse them later."""

from __future__ import annotations

import asyncio
import atexit
import io
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import anyio

from m100link.errors.base import of_the_system

# -- A thread handles log records while something flies, so that a log costs no flight -------------


MOST_WAITING = 1000
"""Records that wait for their handlers at most; further ones are dropped, and counted."""

FLUSH_S = 0.25  # seconds that the end of a flight waits at most until its log is written

_COVERED = ("m100link", "asyncio")  # asyncio logs in the event loop that flies
_OF_FLIGHTS = "m100link.flight"


class LogThread(logging.Filter):
    """Hands log records of this package and of asyncio to a thread while something flies.

    A handler of the program may raise, take long or block for ever: a GUI, a socket, a terminal
    that is stopped by Ctrl-S, a pipe without a reader. In the event loop that would cost the
    setpoint, or the signal, that follows the logged line. The thread calls the same loggers, with
    their levels, filters and handlers. While nothing flies, logging works as usual.

    Without a handler of the program, errors of a flight (it was not landed, not released) go to
    stderr, also from the thread.

    ``dropped``: records that found the queue full. ``failed``: records at which a handler or filter
    raised.
    """

    # A filter in front of all others is the one public place that every record of a logger passes
    # before anything of the program does. It is put on each logger: filters are not inherited.

    def __init__(self) -> None:
        super().__init__()
        self.dropped = self.failed = 0
        self._begin()
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._after_fork)

    def _begin(self) -> None:
        self._records: queue.SimpleQueue[logging.LogRecord | threading.Event] = queue.SimpleQueue()
        self._changes = threading.Lock()  # of what follows; no record waits for it
        self._holders = 0  # control blocks that have begun, and not ended
        self._covered: set[logging.Logger] = set()
        self._seen = 0  # loggers of the process, when those to cover were looked for
        self._thread: threading.Thread | None = None
        self._is_patient = False
        self._lost = ""  # why records were lost since that was reported

    def hold(self, *, is_simulated: bool = False) -> None:
        """Begin a control block, whose log the thread handles from here on.

        ``is_simulated``: its event loop has a clock of its own. Raises ``RuntimeError``: the system
        has no thread left.
        """
        with self._changes:
            if self._thread is None:
                thread = threading.Thread(target=self._serve, name="m100link log", daemon=True)
                thread.start()
                self._thread = thread
            self._is_patient = is_simulated and (self._is_patient or not self._holders)
            self._holders += 1
            self._cover()

    def release(self) -> None:
        """End a control block. After the last one, logging works as usual again.

        Waits at most 0.25 s until the thread has written all records. When a handler blocks for
        longer, records stay in the queue and the program goes on.
        """
        with self._changes:
            self._holders = max(0, self._holders - 1)  # 0 in the child of a fork
            if self._holders:
                return
        self._flush()

    def _flush(self) -> bool:
        """Wait until all is written. Returns False when that takes too long."""
        written = threading.Event()
        self._records.put(written)
        return written.wait(FLUSH_S)

    def filter(self, record: logging.LogRecord) -> bool:
        """Take it to the thread; in the thread itself let it pass."""
        if threading.current_thread() is self._thread:
            return True
        if self._seen != len(logging.Logger.manager.loggerDict):
            self._cover()  # a module was loaded meanwhile
        if self._records.qsize() < MOST_WAITING:
            self._records.put(record)
        else:
            self.dropped += 1
            self._lost = "their handlers did not keep up"
        if self._is_patient:
            self._is_patient = self._flush()
        return False

    def _cover(self) -> None:
        loggers = logging.Logger.manager.loggerDict
        self._seen = len(loggers)
        for name, logger in list(loggers.items()):
            if name.partition(".")[0] not in _COVERED or not isinstance(logger, logging.Logger):
                continue
            if self not in logger.filters:
                logger.filters.insert(0, self)
            self._covered.add(logger)

    def _uncover(self) -> None:
        for logger in self._covered:
            logger.removeFilter(self)
        self._covered.clear()
        self._seen = 0

    def _serve(self) -> None:
        while True:
            item = self._records.get()
            if isinstance(item, logging.LogRecord):
                self._handle(item)
                continue
            self._report()
            with self._changes:
                if not self._holders:
                    self._uncover()
            item.set()

    def _handle(self, record: logging.LogRecord) -> None:
        logger = logging.getLogger(record.name)
        try:
            is_outcome = record.levelno >= logging.ERROR and record.name.startswith(_OF_FLIGHTS)
            if is_outcome and not _is_configured(logger):
                _say(f"{record.name}: {record.getMessage()}")
            logger.handle(record)
        except BaseException as error:  # noqa: BLE001 (whatever a handler raises: the next one)
            self.failed += 1
            self._lost = f"a handler or filter of the log raised {type(error).__name__}"

    def _report(self) -> None:
        """Report lost records where no handler can keep it from being read."""
        why, self._lost = self._lost, ""
        if why:
            lost = self.dropped + self.failed
            _say(f"m100link: {lost} log records of flights were lost: {why}")

    def leave_behind(self) -> None:
        """The interpreter ends: handlers that block for ever must not keep it from that."""
        # logging.shutdown waits for the lock of each handler, and Python for that of stderr.
        if self._thread is None or self._flush():
            return
        for handler in {one for logger in self._covered for one in _handlers(logger)}:
            if handler.lock is None:
                continue
            if handler.lock.acquire(blocking=False):
                handler.lock.release()
                continue
            handler.createLock()
            for name in ("flush", "close"):
                setattr(handler, name, _do_nothing)
            if getattr(handler, "stream", None) is sys.stderr:
                sys.stderr = io.StringIO()

    def _after_fork(self) -> None:
        """The child has no such thread."""
        self._uncover()
        self._begin()


def _handlers(logger: logging.Logger) -> Iterator[logging.Handler]:
    here: logging.Logger | None = logger
    while here is not None:
        yield from here.handlers
        here = here.parent if here.propagate else None


def _is_configured(logger: logging.Logger) -> bool:
    """Whether a record reaches a handler that is not there only to be one."""
    return any(not isinstance(handler, logging.NullHandler) for handler in _handlers(logger))


def _do_nothing() -> None:
    """Replaces ``flush`` and ``close`` of a handler that is left behind."""


def _say(text: str) -> None:
    """Write a line to stderr; without its locks, for which the end of the process would wait."""
    stream = sys.stderr
    if stream is None:
        return
    stamp = time.strftime("%H:%M:%S")
    line = f"{stamp} {text}\n"
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError, AttributeError):
        stream.write(line)  # not a file: a window, a notebook, a test
        return
    os.write(descriptor, line.encode(errors="replace"))


LOG_THREAD = LogThread()  # the one of this process

atexit.register(LOG_THREAD.leave_behind)  # before logging.shutdown, which was registered earlier


# -- reserves --------------------------------------------------------------------------------------

Close = Callable[[], Coroutine[Any, Any, None]]

_NOW_S = 1.0  # by how much an event loop's clock may differ from the system's, which it mostly is


_flying: dict[Close, asyncio.AbstractEventLoop] = {}


def reserve(what: str, close: Close) -> None:
    """Load and start the parts that end a flight, so that its end need not load or open anything.

    ``close``: ends the flight and waits for that. It is run when the program falls off its end
    between two runs of its event loop. After the flight, call :func:`free`. Raises
    ``OutOfResources``: the system has no more.
    """
    for dead in [one for one, loop in _flying.items() if loop.is_closed()]:
        free(dead)  # its event loop was closed before it ended
    loop = asyncio.get_running_loop()
    # Python loads modules from a disk that may fail, with file descriptors that may run out.
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
