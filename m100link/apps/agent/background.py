"""Tasks that run beside the one that started them, and end with their owner."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal

from m100link.errors import M100Error


class TokenBucket:
    """Fills with time up to a limit, and is spent (pure logic, ``now`` is an argument)."""

    __slots__ = ("_at", "_burst", "_level", "_rate")

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._level = burst
        self._at: float | None = None

    def _fill(self, now: float) -> None:
        if self._at is not None:
            self._level = min(self._burst, self._level + (now - self._at) * self._rate)
        self._at = now

    def take(self, now: float, cost: float = 1.0) -> bool:
        """Spend its cost; False, and nothing is spent, if too little is there."""
        self._fill(now)
        if self._level < cost:
            return False
        self._level -= cost
        return True

    def spend(self, now: float, cost: float) -> None:
        """Spend a cost that arose already; that may be more than there is."""
        self._fill(now)
        self._level -= cost

    def wait(self, now: float) -> float:
        self._fill(now)
        return max(0.0, -self._level / self._rate)


class SparingLogger(logging.LoggerAdapter[logging.Logger]):
    """A logger that writes so many lines of a kind at once, and then one in a while.

    The kind of a line is its text before the arguments stand in it. The next line of a kind says
    how many were left out before it.
    """

    def __init__(
        self,
        logger: logging.Logger,  # where the lines go
        *,
        at_once: int = 10,  # lines of a kind that are written however fast they come
        interval: float = 6.0,  # seconds after which one more may be written
        clock: Callable[[], float] = time.monotonic,  # seconds of a clock that never goes back
        least: int = logging.NOTSET,  # the lowest level that is written, whatever the log shows
    ) -> None:
        super().__init__(logger, None)
        self._least = least
        self._at_once, self._interval, self._clock = at_once, interval, clock
        # By kind: when the allowance will be full again, and lines left out. The kinds are the
        # texts in this program: strangers add none.
        self._kinds: dict[str, tuple[float, int]] = {}

    @property
    def level(self) -> int:
        return self.logger.level

    def isEnabledFor(self, level: int) -> bool:  # noqa: N802 - the name that logging gives it
        return level >= self._least and super().isEnabledFor(level)

    def log(self, level: int, msg: object, *args: object, **keywords: Any) -> None:
        if not self.isEnabledFor(level):
            return
        kind, now = str(msg), self._clock()
        full_at, left_out = self._kinds.get(kind, (now, 0))
        full_at = max(full_at, now) + self._interval
        if full_at - now > self._at_once * self._interval:
            self._kinds[kind] = (full_at - self._interval, left_out + 1)
            return
        self._kinds[kind] = (full_at, 0)
        if left_out:
            msg = f"{msg} (and {left_out} more before it)"
        super().log(level, msg, *args, **keywords)


_logger = logging.getLogger(__name__)
_sparing = SparingLogger(_logger)


class TaskSet:
    """The tasks of one owner. An error that is not one of this package is logged, never lost.

    Errors of this package are for the starter of the task: it has reported them, or awaits it.
    """

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()

    def spawn(self, work: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        task = asyncio.create_task(work, name=f"m100link: {name}")
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    async def begin(
        self, work: Callable[[asyncio.Event], Coroutine[Any, Any, Any]], name: str
    ) -> asyncio.Task[Any]:
        """Run work that sets an event as it begins; returns its task then.

        Raises the error of its beginning. A caller that stops waiting ends nothing.
        """
        begun = asyncio.Event()
        task, beginning = self.spawn(work(begun), name), self.spawn(begun.wait(), name)
        try:
            await asyncio.wait((task, beginning), return_when=asyncio.FIRST_COMPLETED)
        finally:
            beginning.cancel()
        if task.done():
            task.result()
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if task.cancelled():
            return
        error = task.exception()
        if error is not None and not isinstance(error, M100Error):
            _logger.error("%s ended by an error", task.get_name(), exc_info=error)

    def cancel(self) -> None:
        for task in list(self._tasks):
            task.cancel()

    async def end(self) -> None:
        self.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


async def is_set_within(event: asyncio.Event, seconds: float | None) -> bool:
    """Whether an event is set within so many seconds; None waits for as long as it takes."""
    try:
        async with asyncio.timeout(seconds):
            return await event.wait()
    except TimeoutError:
        return False


class Ended(asyncio.Event):
    """Set by Ctrl-C, SIGTERM, and SIGHUP of a terminal that is closed.

    A task that has not come to wait for it yet is cancelled instead: it may wait for a router or an
    aircraft that never answers. Made in the task of the verb or process.
    """

    def __init__(self, tell: Callable[[], object] = lambda: None) -> None:
        super().__init__()
        self._beginning, self._tell = asyncio.current_task(), tell
        when_signalled(self.end, "SIGINT", "SIGTERM", "SIGHUP")

    def end(self) -> None:
        self.set()
        beginning, self._beginning = self._beginning, None
        if beginning is not None:  # once: a second signal would cut short how it ends
            beginning.cancel()
            self._tell()

    async def wait(self) -> Literal[True]:
        self._beginning = None
        return await super().wait()


def call_each(callbacks: Iterable[Callable[..., object]], *arguments: object) -> None:
    """Call each of them, and raise the first error afterwards."""
    # Whatever one of them raises: the next one may hold control, or end it.
    failed: Exception | None = None
    for callback in tuple(callbacks):
        try:
            callback(*arguments)
        except Exception as error:  # noqa: BLE001 (raised below)
            failed = failed or error
    if failed is not None:
        raise failed


@contextmanager
def goes_on(what: str) -> Iterator[None]:
    """One step of a loop on which safety depends: an error is logged, and the next step comes."""
    try:
        yield
    except Exception:  # noqa: BLE001 (logged)
        # A handler of the log may raise, too, and must not end the loop in its place.
        with suppress(Exception):
            _sparing.exception(f"{what} failed, and goes on")


def ignore(*_: object) -> None:
    """Nobody wants to hear it."""


def when_signalled(act: Callable[[], object], *names: str) -> None:
    """Call ``act`` in the running event loop when one of these signals comes.

    A system lacks some. Ctrl-Break of Windows, where nobody sends SIGTERM, is always among them.
    SIGHUP stays ignored where it is: nohup lets a program outlive its terminal.
    """
    loop = asyncio.get_running_loop()

    def look() -> None:  # no signal wakes a loop that waits there
        loop.call_later(0.2, look)

    if sys.platform == "win32":
        look()
    for number in (getattr(signal, name) for name in (*names, "SIGBREAK") if hasattr(signal, name)):
        if number.name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN:
            continue
        if sys.platform == "win32":
            signal.signal(number, lambda *_: loop.is_closed() or loop.call_soon_threadsafe(act))
        else:
            loop.add_signal_handler(number, act)
