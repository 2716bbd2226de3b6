"""The log of a process: lines, and that nobody waits for who reads them."""

from __future__ import annotations

import io
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from m100link.apps.station import log_output
from m100link.apps.station.log_output import (
    LogOutput,
    in_force,
    log_of,
    tell_elsewhere,
    writing_log,
)
from tests.waiting import PATIENCE


class Shown(io.StringIO):
    """Standard error; with ``is_stopped`` as a terminal is by Ctrl-S."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.waits = threading.Event()

    def write(self, text: str) -> int:
        self.waits.set()
        self.goes_on.wait()
        return super().write(text)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Iterator[Shown]:
    found = Shown()
    # Not the module's own: pytest puts its standard error back between fixtures and test.
    monkeypatch.setattr(log_output, "sys", SimpleNamespace(stderr=found))
    monkeypatch.setattr(log_output, "_LAST_WORDS", PATIENCE)  # the machine may hold up the thread
    yield found
    log_of("")


@pytest.fixture(autouse=True)
def logger() -> Iterator[logging.Logger]:
    package = logging.getLogger("m100link")
    handlers, level = list(package.handlers), package.level
    yield logging.getLogger("m100link.some.module")
    assert (package.handlers, package.level) == (handlers, level)


def test_lines_for_programs(shown: Shown, logger: logging.Logger) -> None:
    log_of("lab")
    with writing_log(LogOutput("info", as_json=True)):
        logger.debug("not asked for")
        logger.info("%d frames\nin two lines: é", 3)
        logger.warning("of another", extra={"aircraft": "field"})
    first, second = map(json.loads, shown.getvalue().splitlines())
    assert list(first) == ["time", "level", "logger", "message", "aircraft"]
    assert first["time"].endswith("Z")
    assert (first["level"], first["logger"]) == ("INFO", "m100link.some.module")
    assert (first["message"], first["aircraft"]) == ("3 frames\nin two lines: é", "lab")
    assert second["aircraft"] == "field"


def test_an_exception_is_in_its_line(shown: Shown, logger: logging.Logger) -> None:
    with writing_log(LogOutput(as_json=True)):
        try:
            raise ValueError("for instance")
        except ValueError:
            logger.exception("it failed")
    (line,) = map(json.loads, shown.getvalue().splitlines())
    assert line["exception"].endswith("ValueError: for instance")


def test_lines_for_people(shown: Shown, logger: logging.Logger) -> None:
    with writing_log(LogOutput("debug")):
        logger.debug("frames")
    assert shown.getvalue().endswith(" DEBUG m100link.some.module: frames\n")
    assert shown.getvalue()[2::3][:2] == "::"  # the time of day


def test_nobody_waits_for_who_does_not_read_and_what_was_left_out_is_counted(
    shown: Shown, logger: logging.Logger, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_output, "_MOST_UNREAD", 5)
    shown.goes_on.clear()
    with writing_log(LogOutput()):
        logger.warning("line 0")
        assert shown.waits.wait(PATIENCE)
        for number in range(1, 10):
            logger.warning("line %d", number)
        shown.goes_on.set()
        until = time.monotonic() + PATIENCE
        while shown.getvalue().count("\n") < 6 and time.monotonic() < until:
            time.sleep(0.001)
        logger.warning("line 10")
    lines = [line.partition(": ")[2] for line in shown.getvalue().splitlines()]
    assert lines == [
        *(f"line {number}" for number in range(6)),
        "4 lines of the log were not read in time, and left out",
        "line 10",
    ]


def test_a_reader_that_is_gone_harms_nobody(
    logger: logging.Logger, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1, closefd=False) as pipe:
        monkeypatch.setattr(sys, "stderr", pipe)
        with writing_log(LogOutput()):
            for _ in range(10):
                logger.warning("to nobody")
        os.dup2(os.open(os.devnull, os.O_WRONLY), writing)  # what it still holds goes somewhere
    os.close(writing)


def test_what_is_reported_elsewhere_is_not_in_the_log(shown: Shown) -> None:
    tell_elsewhere("m100link.told")
    with writing_log(LogOutput()):
        logging.getLogger("m100link.told").warning("an event")
    assert shown.getvalue() == ""


def test_what_is_in_force_is_known_to_those_who_start_processes(shown: Shown) -> None:
    assert in_force() is None
    with writing_log(LogOutput("debug", as_json=True)):
        assert in_force() == LogOutput("debug", as_json=True)
    assert in_force() is None
