"""One watch of signals per process: every block stops, and the signal acts after the last.

Signals are raised in this process, on virtual time. Whole processes are in ``test_processes.py``.
"""

from __future__ import annotations

import asyncio
import functools
import signal
from collections.abc import Callable, Iterator

import pytest

from m100link import Control, NoAuthority
from m100link.flight import cancellation as module
from m100link.flight.cancellation import OtherWatch, SignalWatch
from m100link.flight.handover import obtain_authority
from m100link.flight.tasks import Commander
from m100link.sim import VirtualClockEventLoop
from tests.rig import NORTH, Rig, rig

# Every one that a person, a terminal, a service manager or the kernel ends a program by.
NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU)


@pytest.fixture
def acted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[signal.Signals]]:
    """Signals that acted after all, instead of ending the test run."""
    acted: list[signal.Signals] = []
    monkeypatch.setattr(signal, "raise_signal", acted.append)
    before = {number: signal.getsignal(number) for number in NUMBERS}
    yield acted
    after = {number: signal.getsignal(number) for number in NUMBERS}
    for number, handler in before.items():
        signal.signal(number, handler)
    assert after == before, "a disposition was not put back"


def come(number: signal.Signals) -> None:
    """The signal comes now, as from outside."""
    handler = signal.getsignal(number)
    assert callable(handler)
    handler(number, None)


async def fly_north(flown: Rig, *, stop: str = "hover") -> Control:
    async with flown.aircraft.control(stop="land" if stop == "land" else "hover") as control:
        await control.take_off()
        await flown.fly_on(control)
    return control


@pytest.mark.anyio
@pytest.mark.parametrize("number", NUMBERS)
async def test_one_signal_stops_every_block_and_acts_after_the_last(
    number: signal.Signals, acted: list[signal.Signals]
) -> None:
    async with rig() as first, rig(seed=2) as second:
        tasks = [
            asyncio.create_task(fly_north(first)),
            asyncio.create_task(fly_north(second, stop="land")),
        ]
        await asyncio.sleep(8.0)
        come(number)
        await asyncio.sleep(1.5)
        assert first.is_released
        first.assert_stopped_in_order()
        assert second.virtual.height > 0.3
        assert acted == [], "the second aircraft is still landing"
        await asyncio.wait(tasks)
        assert second.virtual.height == 0.0
        assert second.is_released
        assert acted == [number]
        assert all(task.cancelled() for task in tasks), "no program goes on behind its block"


@pytest.mark.anyio
async def test_a_block_that_ends_first_leaves_the_others_protected(
    acted: list[signal.Signals],
) -> None:
    async with rig() as first, rig(seed=2) as second:
        task = asyncio.create_task(fly_north(second))
        async with first.aircraft.control():
            await asyncio.sleep(8.0)
        come(signal.SIGTERM)
        await asyncio.wait([task])
        second.assert_stopped_in_order()
        assert second.is_released
        assert acted == [signal.SIGTERM]


@pytest.mark.anyio
async def test_any_number_of_signals_at_any_time_leaves_the_stop_path_whole(
    acted: list[signal.Signals], caplog: pytest.LogCaptureFixture
) -> None:
    async with rig() as flown:
        task = asyncio.create_task(fly_north(flown))
        await asyncio.sleep(8.0)
        for _ in range(15):
            come(signal.SIGINT)
            await asyncio.sleep(0.02)
        await asyncio.wait([task])
        flown.assert_stopped_in_order()
        assert flown.is_released
        assert caplog.text.count("SIGINT: stopping the aircraft") == 1
        assert acted == [signal.SIGINT]


@pytest.mark.anyio
async def test_what_ends_the_process_acts_before_what_raises(acted: list[signal.Signals]) -> None:
    async with rig() as flown:
        task = asyncio.create_task(fly_north(flown))
        await asyncio.sleep(8.0)
        come(signal.SIGINT)
        come(signal.SIGTERM)
        await asyncio.wait([task])
        assert acted == [signal.SIGTERM, signal.SIGINT]


@pytest.mark.anyio
async def test_a_block_entered_after_the_signal_is_stopped_too(acted: list[signal.Signals]) -> None:
    async with rig() as first, rig(seed=2) as second:
        landing = asyncio.create_task(fly_north(first, stop="land"))
        await asyncio.sleep(8.0)
        come(signal.SIGTERM)
        await asyncio.sleep(1.0)
        entering = asyncio.create_task(fly_north(second))
        await asyncio.wait([entering])
        assert entering.cancelled()
        assert second.is_released
        assert second.virtual.height == 0.0
        assert acted == []
        await asyncio.wait([landing])
        assert acted == [signal.SIGTERM]


@pytest.mark.anyio
async def test_a_signal_in_the_moment_of_the_grant_keeps_the_program_out_of_its_block(
    acted: list[signal.Signals], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def obtain(commander: Commander) -> None:
        await obtain_authority(commander)
        come(signal.SIGTERM)
        await asyncio.sleep(0)  # the watch stops the block now, and can cancel nobody yet

    monkeypatch.setattr("m100link.flight.block.obtain_authority", obtain)
    async with rig() as flown:
        task = asyncio.create_task(fly_north(flown))
        await asyncio.wait([task])
        assert task.cancelled(), "fly_north was refused by name: it was let into the block"
        assert flown.is_released
        assert flown.virtual.height == 0.0
        assert acted == [signal.SIGTERM]


@pytest.mark.anyio
async def test_a_signal_stops_what_was_obtained_by_hand(acted: list[signal.Signals]) -> None:
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        await control.take_off()
        control.send(NORTH, lifetime=1.0)
        await asyncio.sleep(0.5)
        come(signal.SIGINT)
        await asyncio.sleep(1.0)
        assert flown.is_released
        assert acted == [signal.SIGINT]
        with pytest.raises(NoAuthority):
            control.send(NORTH)


@pytest.mark.anyio
async def test_a_signal_stops_a_block_whose_task_is_gone(acted: list[signal.Signals]) -> None:
    async with rig() as flown:
        control = flown.aircraft.control()

        async def begin() -> None:
            await control.__aenter__()
            await control.take_off()

        await asyncio.create_task(begin())
        come(signal.SIGTERM)
        await asyncio.sleep(2.0)
        assert flown.is_released
        assert acted == [signal.SIGTERM]


@pytest.mark.anyio
async def test_a_block_that_does_not_want_it_is_not_stopped(acted: list[signal.Signals]) -> None:
    async with rig() as flown, flown.aircraft.control(handle_signals=False) as control:
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        await control.take_off()
        assert control.has_authority


def test_ctrl_c_acts_as_asyncio_run_has_it_once_the_aircraft_is_given_back() -> None:
    """The main task is cancelled and KeyboardInterrupt comes out, after the release."""
    said: list[str] = []

    async def main() -> None:
        async with rig() as flown:
            loop = asyncio.get_running_loop()
            for after in (8.0, 8.01, 8.05, 8.2):
                loop.call_later(after, signal.raise_signal, signal.SIGINT)
            try:
                await fly_north(flown)
                said.append("went on behind the block")
            finally:
                flown.assert_stopped_in_order()
                said.append("released" if flown.is_released else "not released")

    with pytest.raises(KeyboardInterrupt):
        with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
            runner.run(main())
    assert said == ["released"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_breaks_into_a_program_that_blocks_its_event_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr("m100link.flight.cancellation.time.monotonic", lambda: now)
    watch = SignalWatch()
    stopped: list[str] = []

    async def main() -> None:
        nonlocal now

        def stop() -> None:
            stopped.append("stop")

        watch.join(stop)
        try:
            for moment in (0.0, 0.3, 0.9, 1.0):
                now = moment
                come(signal.SIGINT)  # the loop does not run meanwhile
            now = 1.1
            with pytest.raises(KeyboardInterrupt):
                come(signal.SIGINT)
            await asyncio.sleep(0)
            assert stopped == ["stop"]
            now = 5.0
            come(signal.SIGINT)  # it runs again
        finally:
            monkeypatch.setattr(signal, "raise_signal", lambda number: None)
            watch.leave(stop)

    asyncio.run(main())


def test_only_handlers_that_would_end_the_program_are_taken() -> None:
    def own(number: int, frame: object) -> None:
        """Whatever the program does."""

    takes = module._would_end_the_program
    assert takes(signal.SIGTERM, signal.SIG_DFL)
    assert not takes(signal.SIGTERM, signal.SIG_IGN)
    assert not takes(signal.SIGTERM, own)
    assert takes(signal.SIGINT, signal.default_int_handler)
    of_asyncio = functools.partial(asyncio.Runner().close)  # a partial of its own method, too
    assert takes(signal.SIGINT, of_asyncio)
    assert not takes(signal.SIGINT, signal.SIG_IGN)
    assert not takes(signal.SIGINT, signal.SIG_DFL)
    assert not takes(signal.SIGINT, own)
    assert not takes(signal.SIGINT, functools.partial(own, 2))


@pytest.mark.anyio
async def test_a_handler_that_the_program_set_meanwhile_stays() -> None:
    def own(number: int, frame: object) -> None:
        """Whatever the program does."""

    try:
        async with rig() as flown, flown.aircraft.control():
            signal.signal(signal.SIGTERM, own)
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def test_a_block_whose_event_loop_was_closed_does_not_keep_the_signals(
    acted: list[signal.Signals],
) -> None:
    watch = SignalWatch()

    async def begin(stop: Callable[[], None]) -> None:
        watch.join(stop)

    def stop() -> None:
        pytest.fail("called in a closed loop")

    asyncio.run(begin(stop))
    come(signal.SIGTERM)
    assert acted == [signal.SIGTERM]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_new_block_is_protected_although_an_older_one_died_with_its_loop(
    acted: list[signal.Signals],
) -> None:
    watch = SignalWatch()
    stopped: list[str] = []

    async def begin(name: str) -> None:
        stop = functools.partial(stopped.append, name)
        watch.join(stop)
        if name == "new":
            come(signal.SIGTERM)
            await asyncio.sleep(0)
            watch.leave(stop)

    asyncio.run(begin("old"))
    asyncio.run(begin("new"))
    assert stopped == ["new"]
    assert acted == [signal.SIGTERM]


def test_a_signal_whose_block_died_with_its_loop_acts_before_another_begins(
    acted: list[signal.Signals],
) -> None:
    watch = SignalWatch()
    stopped: list[str] = []

    async def begin() -> None:
        watch.join(functools.partial(stopped.append, "old"))
        come(signal.SIGTERM)

    async def begin_another() -> None:
        stop = functools.partial(stopped.append, "new")
        watch.join(stop)
        assert acted == [signal.SIGTERM]
        await asyncio.sleep(0)
        watch.leave(stop)

    asyncio.run(begin())
    assert acted == []
    asyncio.run(begin_another())
    assert (stopped, acted) == (["old"], [signal.SIGTERM])


def test_our_handler_that_the_program_puts_back_after_the_last_block_lets_the_signal_act(
    acted: list[signal.Signals],
) -> None:
    """A library that handles a signal for a while puts back what it found, which may be ours."""
    watch = SignalWatch()

    async def fly() -> object:
        watch.join(print)
        found = signal.signal(signal.SIGTERM, lambda number, frame: None)
        watch.leave(print)
        return found

    signal.signal(signal.SIGTERM, asyncio.run(fly()))  # type: ignore[arg-type] # what it found
    come(signal.SIGTERM)
    assert acted == [signal.SIGTERM]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL, "or it would come again for ever"


def test_another_watch_has_to_say_how_its_blocks_stop() -> None:
    with pytest.raises(TypeError):
        OtherWatch()  # type: ignore[abstract] # which is what is refused


class Beside(OtherWatch):
    """A watch that was there first, as that of programs without ``await`` is."""

    def __init__(self) -> None:
        self.stopped = 0
        self.acted: list[int] = []

    def stop_blocks(self) -> None:
        self.stopped += 1

    def on_signal(self, number: int, frame: object) -> None:
        self.acted.append(number)


@pytest.mark.anyio
@pytest.mark.parametrize("number", NUMBERS)
async def test_another_watch_gives_way_and_its_blocks_do_not_wait_for_these(
    number: signal.Signals, acted: list[signal.Signals]
) -> None:
    beside = Beside()
    before = signal.signal(number, beside.on_signal)
    try:
        async with rig() as flown:
            task = asyncio.create_task(fly_north(flown))
            await asyncio.sleep(8)
            come(number)
            come(number)
            assert (beside.stopped, beside.acted, acted) == (1, [], [])
            await asyncio.wait([task])
            assert acted == [number]
            assert signal.getsignal(number) == beside.on_signal
    finally:
        signal.signal(number, before)
