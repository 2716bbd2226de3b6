from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest

from m100link import LinkClosed, M100Error, UsageError
from m100link.sim import LockstepEventLoop
from m100link.sync.portal import Caller, Portal
from tests.waiting import PATIENCE


@pytest.fixture
def portal() -> Iterator[Portal]:
    opened = Portal()
    yield opened
    opened.close()


def test_a_call_runs_in_the_thread_of_the_event_loop_and_returns(portal: Portal) -> None:
    assert portal.call(threading.get_ident) != threading.get_ident()
    assert portal.call(divmod, 7, 2) == (3, 1)


def test_what_a_call_raises_comes_out(portal: Portal) -> None:
    with pytest.raises(ZeroDivisionError):
        portal.call(divmod, 7, 0)

    async def fail() -> None:
        await asyncio.sleep(0)
        raise LookupError

    with pytest.raises(LookupError):
        portal.wait(lambda _: fail())
    assert portal.call(int, "7") == 7


def test_callbacks_run_in_the_thread_that_waits() -> None:
    portal = Portal(LockstepEventLoop)
    heard: list[tuple[int, int]] = []

    def hear(number: int) -> None:
        heard.append((number, threading.get_ident()))

    async def count(to: int, progress: Callable[[int], None] | None = None) -> str:
        for number in range(to if progress else 0):
            progress(number) if progress else None
        return "done"

    assert portal.wait(lambda caller: caller.begin(count, 3, progress=hear)) == "done"
    assert portal.wait(lambda caller: caller.begin(count, 3, progress=None)) == "done"
    assert heard == [(number, threading.get_ident()) for number in range(3)]
    portal.close()


def test_a_slow_callback_gets_the_newest_value_alone(portal: Portal) -> None:
    begun, told, heard = threading.Event(), threading.Event(), list[int]()

    def hear(number: int) -> None:
        heard.append(number)
        begun.set()
        assert told.wait(PATIENCE)

    async def count(progress: Callable[[int], None]) -> None:
        for number in range(1000):
            progress(number)
            assert begun.wait(PATIENCE)
        told.set()

    portal.wait(lambda caller: caller.begin(count, progress=hear))
    assert heard == [0, 999]


def test_a_question_is_answered_by_the_thread_that_waits(portal: Portal) -> None:
    async def ask(caller: Caller) -> int:
        return await caller.ask(lambda value: value + threading.get_ident(), 1)

    assert portal.wait(ask) == 1 + threading.get_ident()


@pytest.mark.parametrize("kind", [KeyboardInterrupt, ZeroDivisionError])
def test_what_a_callback_raises_cancels_the_call_and_comes_out(
    portal: Portal, kind: type[BaseException]
) -> None:
    ended = threading.Event()

    async def endless(caller: Caller) -> None:
        def fail(_: None) -> None:
            raise kind

        tell = caller.callback(fail)
        assert tell is not None
        tell(None)
        try:
            await asyncio.sleep(3600)
        finally:
            ended.set()

    with pytest.raises(kind):
        portal.wait(endless)
    assert ended.wait(PATIENCE)


def test_a_cancelled_call_is_not_taken_for_an_answer(portal: Portal) -> None:
    async def cancelled() -> None:
        raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        portal.wait(lambda _: cancelled())
    assert portal.call(int, "7") == 7


def test_after_the_end_every_door_says_so(portal: Portal) -> None:
    portal.close()
    portal.close()
    for call in (lambda: portal.call(int), lambda: portal.wait(lambda _: asyncio.sleep(0))):
        with pytest.raises(UsageError, match="was closed"):
            call()
    portal.soon(lambda: pytest.fail("called"))


def test_a_door_that_another_thread_closes_meanwhile_takes_nothing(portal: Portal) -> None:
    portal.close()
    portal.is_open = True  # as it was when it was asked
    portal.soon(lambda: pytest.fail("called"))


@pytest.mark.parametrize("round_", range(30))
def test_a_waiting_thread_gets_an_error_when_another_closes(round_: int) -> None:
    opened = Portal()
    ended: list[M100Error] = []

    def use(call: Callable[[], object]) -> None:
        try:
            while True:
                call()
        except M100Error as error:
            ended.append(error)

    calls: list[Callable[[], object]] = [
        lambda: opened.call(int),
        lambda: opened.wait(lambda _: asyncio.sleep(0)),
        lambda: opened.wait(lambda _: asyncio.sleep(3600)),
    ]
    threads = [threading.Thread(target=use, args=(call,), daemon=True) for call in calls]
    for thread in threads:
        thread.start()
    time.sleep(0.0005 * round_)
    opened.close()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()
    # What waited, and what was not begun any more.
    assert {type(error) for error in ended} <= {LinkClosed, UsageError}
    assert len(ended) == len(threads)


def test_a_call_in_the_thread_of_the_loop_would_wait_for_ever_and_is_refused(
    portal: Portal,
) -> None:
    with pytest.raises(UsageError, match="in the thread of the aircraft"):
        portal.call(portal.call, int)


def test_closing_awaits_what_is_to_be_closed_once(portal: Portal) -> None:
    closed: list[int] = []
    ended: list[int] = []

    async def close() -> None:
        closed.append(threading.get_ident())

    end = portal.close_after(close, lambda: ended.append(threading.get_ident()))
    end()
    end()
    assert len(closed) == 1
    assert closed[0] != threading.get_ident()
    assert threading.get_ident() in ended


def test_closing_in_the_thread_of_the_loop_is_refused_and_leaves_it_open(portal: Portal) -> None:
    closed: list[int] = []

    async def close() -> None:
        closed.append(1)

    end = portal.close_after(close, lambda: None)
    with pytest.raises(UsageError, match="in the thread of the aircraft"):
        portal.call(end)
    assert portal.is_open
    end()
    assert closed == [1]


def test_a_call_in_another_process_is_refused(
    portal: Portal, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as changed:
        changed.setattr(portal, "_process", 0)
        with pytest.raises(UsageError, match="from which this one was forked"):
            portal.call(int)


def test_in_the_child_of_a_fork_a_call_is_refused_and_its_end_waits_for_nobody() -> None:
    run = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    assert run.stdout.split() == ["ours", "default", "refused", "3", "closed"]


FORKED = """
import asyncio, os, signal, sys
from m100link.errors import UsageError
from m100link.sync.portal import Portal
from m100link.sync.signals import SIGNALS

async def close():
    print("closed", flush=True)

portal = Portal()
portal.close_after(close, lambda: None)
SIGNALS.connected(portal)

def shown():
    is_default = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    print("default" if is_default else "ours", flush=True)

shown()
with SIGNALS._changes:  # another thread may hold it as the child begins, which has no such thread
    child = os.fork()
if not child:
    shown()
    try:
        portal.call(int)
    except UsageError:
        print("refused", flush=True)
    portal.close()
    sys.exit(3)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


PROGRAM = """
import asyncio
from m100link.sync.portal import Portal

async def close():
    await asyncio.sleep(0.05)
    print("closed in order")

portal = Portal()
portal.close_after(close, lambda: print("over"))
print(portal.call(int, "7"))
"""


def test_a_program_that_closes_nothing_closes_at_its_end() -> None:
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert ended.stdout.splitlines() == ["7", "closed in order", "over"]
    assert ended.stderr == ""


def test_a_loop_that_cannot_be_made_is_the_error_of_the_caller_and_leaves_no_thread() -> None:
    def fail() -> asyncio.AbstractEventLoop:
        raise OSError(24, "Too many open files")

    before = threading.active_count()
    with pytest.raises(OSError, match="Too many open files"):
        Portal(fail)
    assert threading.active_count() == before


def test_what_ends_a_loop_that_ran_is_told_by_its_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for it there: in silence, the aircraft would be alone and nobody know."""

    class Broken(asyncio.SelectorEventLoop):
        has_run = False

        def run_forever(self) -> None:
            super().run_forever()
            if not self.has_run:
                self.has_run = True
                raise MemoryError

    told: list[object] = []
    monkeypatch.setattr(threading, "excepthook", lambda end: told.append(end.exc_type))
    portal = Portal(Broken)
    portal.close()
    assert told == [MemoryError]


def test_what_waits_in_a_task_and_fails_as_errors_do_is_silent(portal: Portal) -> None:
    """The event loop reports all other errors, as those of any task."""
    order: list[str] = []

    async def refused() -> None:
        order.append("refused")
        raise UsageError("no")

    async def other() -> None:
        order.append("other")

    portal.soon_await(refused)
    portal.soon_await(other)
    portal.wait(lambda _: asyncio.sleep(0.001))
    assert order == ["refused", "other"]
    assert [task.exception() for task in portal._tasks] == [None, None]


def test_the_clock_runs_while_somebody_waits_and_not_while_a_callback_works() -> None:
    """A question to the program takes no time of the aircraft; its clock goes on behind it."""
    steps: list[str] = []

    class Clock:
        def begin_waiting(self) -> None:
            steps.append("waits")

        def end_waiting(self) -> None:
            steps.append("works")

    portal = Portal()
    portal._lockstep = cast(Any, Clock())
    try:
        asked = portal.wait(lambda caller: caller.ask(lambda value: steps.append("asked"), 1))
    finally:
        portal.close()
    assert asked is None
    assert steps[0] == "waits"
    assert sorted(steps[1:3]) == ["asked", "works"]  # in two threads
    assert steps[3:] == ["waits", "works"]


def test_a_portal_that_is_closed_is_not_closed_again_when_the_program_ends(
    portal: Portal, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[object] = []
    monkeypatch.setattr("m100link.sync.portal.atexit.register", kept.append)
    monkeypatch.setattr("m100link.sync.portal.atexit.unregister", kept.remove)

    async def close() -> None:
        pass

    end = portal.close_after(close, lambda: None)
    assert kept == [end]
    end()
    assert kept == []
