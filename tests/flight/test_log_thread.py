"""The log while something flies: handlers of a program that raise, block or are slow."""

from __future__ import annotations

import asyncio
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from unittest.mock import MagicMock

import pytest

from m100link.flight import reserves as log_thread
from m100link.flight.reserves import MOST_WAITING, LogThread
from m100link.sim import VirtualClockEventLoop
from tests.waiting import PATIENCE

NAME = "m100link.flight.block"
FLUSH_S = log_thread.FLUSH_S


class Heard(logging.Handler):
    """Keeps its records, and their threads."""

    def __init__(self, do: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.do = do
        self.told: list[tuple[str, bool]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.told.append((record.getMessage(), threading.current_thread() is main_thread))
        self.do()


main_thread = threading.main_thread()


@pytest.fixture
def heard() -> Iterator[Heard]:
    """A handler of the program on the logger of the package."""
    handler = Heard()
    logger = logging.getLogger("m100link")
    logger.addHandler(handler)
    yield handler
    logger.removeHandler(handler)


@pytest.fixture
def thread(monkeypatch: pytest.MonkeyPatch) -> Iterator[LogThread]:
    """One that is not that of the process; a machine that keeps it from running is waited for."""
    monkeypatch.setattr(log_thread, "FLUSH_S", PATIENCE)
    one = LogThread()
    yield one
    for logger in list(one._covered):
        logger.removeFilter(one)


def log(text: str, name: str = NAME, level: int = logging.WARNING) -> None:
    logging.getLogger(name).log(level, "%s", text)


def test_only_while_something_flies_another_thread_handles_the_log(
    heard: Heard, thread: LogThread
) -> None:
    log("before")
    thread.hold()
    thread.hold()
    log("in flight")
    thread.release()
    log("the other one flies")
    thread.release()
    log("after")
    assert heard.told == [
        ("before", True),
        ("in flight", False),
        ("the other one flies", False),
        ("after", True),
    ]


def test_loggers_of_the_package_and_of_asyncio_are_covered_and_no_others(
    thread: LogThread,
) -> None:
    names = ("m100link", NAME, "m100link.of_a_module_loaded_in_flight", "asyncio", "program")
    handlers = {name: Heard() for name in names}
    for name in names[:2]:
        logging.getLogger(name)
    thread.hold()
    log("it is there now", "m100link")
    for name, handler in handlers.items():
        logging.getLogger(name).addHandler(handler)
    try:
        log("another module logs first", "m100link")
        for name in names:
            log("x", name)
        thread.release()
        by_main = {name for name, one in handlers.items() if ("x", True) in one.told}
        assert by_main == {"program"}
        assert all(any(text == "x" for text, _ in one.told) for one in handlers.values())
    finally:
        for name, handler in handlers.items():
            logging.getLogger(name).removeHandler(handler)


def test_levels_and_filters_of_the_program_hold_in_flight(heard: Heard, thread: LogThread) -> None:
    logger = logging.getLogger(NAME)
    logger.setLevel(logging.ERROR)
    secret = logging.Filter("nobody")
    try:
        thread.hold()
        log("too quiet")
        log("loud", level=logging.ERROR)
        logger.addFilter(secret)
        log("filtered", level=logging.ERROR)
        thread.release()
    finally:
        logger.setLevel(logging.NOTSET)
        logger.removeFilter(secret)
    # A filter counts from the moment at which the record is handled.
    assert [text for text, _ in heard.told if text != "loud"] == []


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit, KeyboardInterrupt])
def test_a_handler_that_raises_costs_its_record_and_that_is_said(
    error: type[BaseException],
    heard: Heard,
    thread: LogThread,
    capsys: pytest.CaptureFixture[str],  # no file, as in a notebook
) -> None:
    def fail() -> None:
        raise error

    thread.hold()
    thread.dropped = 3  # before that
    heard.do = fail
    log("one")
    log("two")
    thread.release()
    assert [text for text, _ in heard.told] == ["one", "two"], "the thread goes on"
    assert thread.failed == 2
    assert "5 log records of flights were lost" in capsys.readouterr().err
    assert error.__name__ in thread._lost or thread._lost == ""


def test_a_handler_that_blocks_delays_nobody_and_what_is_too_much_is_dropped(
    heard: Heard, thread: LogThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert FLUSH_S <= 0.25, "so long the end of a flight waits"
    monkeypatch.setattr(log_thread, "FLUSH_S", FLUSH_S)
    free = threading.Event()

    def block() -> None:
        free.wait()

    heard.do = block
    thread.hold()
    for number in range(MOST_WAITING + 60):
        log(str(number))
    thread.release()
    log("behind the flight it waits in the queue, and not the program")
    assert thread.dropped >= 59
    free.set()  # it came here: neither the flight nor its end waited for the handler
    monkeypatch.setattr(log_thread, "FLUSH_S", PATIENCE)
    assert thread._flush()
    assert len(heard.told) <= MOST_WAITING + 2


def test_where_time_is_simulated_the_caller_waits_for_its_handlers(
    heard: Heard, thread: LogThread
) -> None:
    thread.hold(is_simulated=True)
    log("one")
    assert heard.told == [("one", False)]
    thread.hold()  # another one flies in real time
    heard.do = lambda: time.sleep(0.01)
    log("two")
    assert [text for text, _ in heard.told] in (["one"], ["one", "two"])
    thread.release()
    thread.release()


def test_a_loop_with_a_clock_of_its_own_simulates_time(monkeypatch: pytest.MonkeyPatch) -> None:
    held = MagicMock()
    monkeypatch.setattr(log_thread, "LOG_THREAD", held)

    async def fly() -> None:
        log_thread.reserve("control", fly)
        log_thread.free(fly)

    for make in (asyncio.new_event_loop, VirtualClockEventLoop):
        with asyncio.Runner(loop_factory=make) as runner:
            runner.run(fly())
    assert [one.kwargs["is_simulated"] for one in held.hold.mock_calls] == [False, True]
    assert held.release.call_count == 2


def test_the_child_of_a_fork_logs_by_itself() -> None:
    assert run(
        "thread.hold(); child = os.fork()\n"
        "logging.getLogger('m100link.x').addHandler(logging.StreamHandler(sys.stdout))\n"
        "if child == 0: log('of the child'); sys.stdout.flush(); os._exit(0)\n"
        "os.waitpid(child, 0); thread.release()"
    ) == ("of the child\n", "")


@pytest.mark.parametrize("level", ["ERROR", "WARNING"])
def test_without_a_handler_errors_of_a_flight_reach_stderr(level: str) -> None:
    said, errors = run(
        "logging.getLogger('m100link').addHandler(logging.NullHandler()); thread.hold()\n"
        f"log('it did not land', 'm100link.flight.stop_path', logging.{level})\n"
        "thread.release()"
    )
    assert said == ""
    assert ("it did not land" in errors) == (level == "ERROR")


def run(program: str) -> tuple[str, str]:
    """What a process says on stdout and stderr."""
    head = "import logging, os, sys\n"
    head += "import m100link.flight.stop_path\n"
    head += "from m100link.flight.reserves import LOG_THREAD as thread\n"
    head += "def log(text, name='m100link.x', level=logging.WARNING):\n"
    head += "    logging.getLogger(name).log(level, text)\n"
    # Python 3.12 and later warn of the fork beside threads that is asked for here.
    quiet = "-Wignore:This process:DeprecationWarning"
    done = subprocess.run(
        [sys.executable, quiet, "-c", head + program],
        capture_output=True,
        text=True,
        check=True,
        env=dict(os.environ),
    )
    return done.stdout, done.stderr
