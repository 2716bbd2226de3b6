"""A stranger cannot fill the log."""

from __future__ import annotations

import logging

import pytest

from m100link.apps.station.web.logs import SparingLogger


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_few_lines_of_a_kind_then_one_in_a_while_with_a_number(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = Clock()
    log = SparingLogger(logging.getLogger("test"), at_once=3, interval=5.0, clock=clock)
    for number in range(100):
        log.warning("refused %d", number)
    log.warning("something else")
    assert [one.getMessage() for one in caplog.records] == [
        *("refused 0", "refused 1", "refused 2", "something else")
    ]
    caplog.clear()
    clock.now = 5.0
    for _ in range(2):
        log.warning("refused %d", 7)
    assert [one.getMessage() for one in caplog.records] == ["refused 7 (and 97 more before it)"]
    caplog.clear()
    clock.now = 1000.0
    for number in range(10):
        log.warning("refused %d", number)
    assert len(caplog.records) == 3


def test_below_its_least_level_nothing_is_written_nor_made(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "test")
    log = SparingLogger(logging.getLogger("test"), least=logging.WARNING)
    assert [log.isEnabledFor(level) for level in (10, 20, 30, 40)] == [False, False, True, True]
    log.info("WebSocket /?token=%s", "secret")
    log.debug("authorization: %s", "secret")
    log.warning("a warning")
    assert [one.getMessage() for one in caplog.records] == ["a warning"]
