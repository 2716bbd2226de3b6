from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.sync.signals import SyncSignals


class Block:
    """A control block whose stop path hears when it ends."""

    def __init__(self) -> None:
        self.is_flying = True
        self.is_stopping = False
        self.is_over = False
        self.interrupted = 0

    def interrupt(self) -> None:
        self.interrupted += 1
        self.is_flying = False
        self.is_stopping = True

    def end(self) -> None:
        self.is_flying = self.is_stopping = False
        self.is_over = True


@pytest.fixture
def watch() -> Iterator[SyncSignals]:
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield SyncSignals()
    after = {number: signal.getsignal(number) for number in before}
    for number, handler in before.items():
        signal.signal(number, handler)
    assert after == before


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (signal.SIGINT, KeyboardInterrupt),
        (signal.SIGTERM, SystemExit),
        (signal.SIGHUP, SystemExit),
    ],
)
def test_a_signal_interrupts_every_block_and_the_program(
    watch: SyncSignals, number: signal.Signals, kind: type[BaseException]
) -> None:
    blocks = [Block(), Block()]
    for block in blocks:
        watch.join(block)
    with pytest.raises(kind) as caught:
        signal.raise_signal(number)
    if isinstance(caught.value, SystemExit):
        assert caught.value.code == 128 + number
    assert [block.interrupted for block in blocks] == [1, 1]
    for block in blocks:
        block.end()
        watch.leave(block)


def test_while_the_stop_path_runs_a_signal_does_nothing(watch: SyncSignals) -> None:
    block = Block()
    watch.join(block)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)
    assert block.interrupted == 1
    block.end()
    watch.leave(block)


def test_a_block_that_has_ended_does_not_keep_signals_from_acting(watch: SyncSignals) -> None:
    block = Block()
    watch.join(block)
    block.is_flying, block.is_over = False, True
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert block.interrupted == 0
    block.end()
    watch.leave(block)


def test_each_cell_of_a_notebook_takes_again_what_was_put_back_before_it(
    watch: SyncSignals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cell that only sleeps calls no method of an aircraft, whose mission flies meanwhile."""
    begins: dict[str, Callable[..., object]] = {}
    shell = SimpleNamespace(events=SimpleNamespace(register=begins.__setitem__))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    before, aircraft, block = signal.getsignal(signal.SIGINT), object(), Block()
    watch.connected(aircraft)
    watch.join(block)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # as ipykernel does
    begins["pre_run_cell"]("about the cell")
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert block.interrupted == 1
    block.end()
    watch.leave(block)
    watch.closed(aircraft)
    begins["pre_run_cell"]("about the cell")
    assert signal.getsignal(signal.SIGINT) == before


def test_a_second_block_goes_on_being_watched(watch: SyncSignals) -> None:
    first, second = Block(), Block()
    watch.join(first)
    watch.join(second)
    first.end()
    watch.leave(first)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert (first.interrupted, second.interrupted) == (0, 1)
    second.end()
    watch.leave(second)


def test_what_the_program_handles_itself_is_left_alone(watch: SyncSignals) -> None:
    caught: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: caught.append(number))
    block = Block()
    watch.join(block)
    signal.raise_signal(signal.SIGTERM)
    assert caught == [signal.SIGTERM]
    assert block.interrupted == 0
    block.end()
    watch.leave(block)
    signal.signal(signal.SIGTERM, before)


def test_what_another_thread_flies_is_stopped_too(watch: SyncSignals) -> None:
    aircraft, block = object(), Block()
    watch.connected(aircraft)
    thread = threading.Thread(target=lambda: watch.join(block))
    thread.start()
    thread.join()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert block.interrupted == 1
    block.end()
    watch.leave(block)
    watch.closed(aircraft)


def test_what_was_left_before_its_end_is_still_stopped(watch: SyncSignals) -> None:
    block = Block()
    watch.join(block)
    watch.join(block)
    watch.leave(block)  # as where it was obtained a second time, which is refused
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert block.interrupted == 1
    watch.leave(block)
    signal.raise_signal(signal.SIGINT)  # nothing: its stop path runs
    block.end()
    watch.leave(block)


def test_the_first_signal_in_a_stop_path_acts_behind_it(watch: SyncSignals) -> None:
    block = Block()
    watch.join(block)
    block.is_flying, block.is_stopping = False, True  # the program left it
    signal.raise_signal(signal.SIGINT)
    block.end()
    with pytest.raises(KeyboardInterrupt):
        watch.leave(block)
    watch.leave(block)  # once


def test_a_signal_in_a_stop_path_acts_behind_the_last_one(watch: SyncSignals) -> None:
    first, last = Block(), Block()
    for block in (first, last):
        watch.join(block)
        block.is_flying, block.is_stopping = False, True
    signal.raise_signal(signal.SIGINT)
    first.end()
    watch.leave(first)
    last.end()
    with pytest.raises(KeyboardInterrupt):
        watch.leave(last)


def test_a_second_signal_before_the_stop_path_began_does_nothing(watch: SyncSignals) -> None:
    block = Block()
    watch.join(block)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    block.is_flying, block.is_stopping = True, False  # its thread has not come to it
    signal.raise_signal(signal.SIGINT)
    assert block.interrupted == 1
    block.end()
    watch.leave(block)


def test_before_it_flies_a_signal_acts(watch: SyncSignals) -> None:
    block = Block()
    block.is_flying = False
    watch.join(block)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    watch.leave(block)
    block.end()
    watch.leave(block)


def test_while_nothing_flies_a_signal_does_what_it_did_before(watch: SyncSignals) -> None:
    aircraft = object()
    caught: list[int] = []
    watch.connected(aircraft)
    watch._previous[signal.SIGTERM] = lambda number, frame: caught.append(number)
    signal.raise_signal(signal.SIGTERM)
    assert caught == [signal.SIGTERM]
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    watch.closed(aircraft)


def test_outside_the_main_thread_nothing_is_taken(watch: SyncSignals) -> None:
    block = Block()
    thread = threading.Thread(target=lambda: watch.join(block))
    thread.start()
    thread.join()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    block.end()
    watch.leave(block)


def test_ctrl_c_that_ends_the_main_thread_ends_what_other_threads_fly(
    watch: SyncSignals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python asks this hook about it, and then waits for those threads."""
    told: list[type[BaseException]] = []

    def of_the_program(kind: type[BaseException], error: BaseException, traceback: object) -> None:
        told.append(kind)

    monkeypatch.setattr(sys, "excepthook", of_the_program)
    aircraft, block, over = object(), Block(), Block()
    over.end()

    def fly() -> None:
        watch.connected(aircraft)
        watch.join(over)
        watch.join(block)

    thread = threading.Thread(target=fly)
    thread.start()
    thread.join()
    sys.excepthook(ZeroDivisionError, ZeroDivisionError(), None)
    assert block.interrupted == 0
    sys.excepthook(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert (block.interrupted, over.interrupted) == (1, 0)
    assert told == [ZeroDivisionError, KeyboardInterrupt]
    block.end()
    watch.leave(block)
    watch.closed(aircraft)
    assert sys.excepthook is of_the_program


def test_a_hook_that_hands_on_to_ours_stays_and_is_not_asked_twice(
    watch: SyncSignals, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    monkeypatch.setattr(sys, "excepthook", lambda *_: told.append("program"))
    aircraft = object()

    def connect_elsewhere() -> None:
        thread = threading.Thread(target=lambda: watch.connected(aircraft))
        thread.start()
        thread.join()

    connect_elsewhere()
    ours = sys.excepthook

    def above(kind: type[BaseException], error: BaseException, traceback: Any) -> None:
        told.append("above")
        ours(kind, error, traceback)

    monkeypatch.setattr(sys, "excepthook", above)
    connect_elsewhere()
    sys.excepthook(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert told == ["above", "program"]
    watch.closed(aircraft)
    assert sys.excepthook is above
