"""How a station is run from the command line: seen as a whole in test_station.py."""

from __future__ import annotations

import threading
from functools import partial

import pytest

pytest.importorskip("cyclopts")

from m100link.apps.cli import serve as serving
from m100link.apps.cli.serve import _MOST_UNTOLD, Teller
from tests.waiting import PATIENCE


def test_what_is_not_read_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_LAST_WORDS", PATIENCE)  # the machine may hold up the thread
    told: list[int] = []
    stopped = threading.Event()
    with Teller() as teller:
        teller.do(lambda: told.append(1))
        teller.do(partial(stopped.wait, PATIENCE))  # Ctrl-S
        for number in range(10 * _MOST_UNTOLD):
            teller.do(partial(told.append, number))
        stopped.set()
    assert told[:2] == [1, 0]
    assert len(told) <= 1 + _MOST_UNTOLD


def test_a_closed_pipe_ends_the_talk_and_nothing_else() -> None:
    def broken() -> None:
        raise BrokenPipeError

    told: list[int] = []
    with Teller() as teller:
        teller.do(broken)
        teller.do(lambda: told.append(1))
    assert told == []
