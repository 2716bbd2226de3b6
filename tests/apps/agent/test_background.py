"""Tasks of one owner: the report of their end, and their end with the owner."""

from __future__ import annotations

import asyncio
import logging
import signal

import pytest

from m100link.apps.agent.background import (
    Ended,
    SparingLogger,
    TaskSet,
    TokenBucket,
    call_each,
    goes_on,
    is_set_within,
    when_signalled,
)
from m100link.errors import LinkLost
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio


async def fail(error: Exception) -> None:
    raise error


async def test_an_error_of_another_kind_is_logged_and_ours_is_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    background = TaskSet()
    tasks = [
        background.spawn(fail(LinkLost("told already")), "ours"),
        background.spawn(fail(RuntimeError("a mistake")), "theirs"),
    ]
    await asyncio.wait(tasks)
    await asyncio.sleep(0)
    background.spawn(asyncio.sleep(1000), "cancelled").cancel()
    background.spawn(asyncio.sleep(0), "done")
    await asyncio.sleep(0.01)
    assert [one.getMessage() for one in caplog.records] == ["m100link: theirs ended by an error"]
    assert caplog.records[0].exc_info
    assert not background._tasks, "what has ended is not kept"


async def test_all_end_with_their_owner_also_those_that_take_a_while() -> None:
    background = TaskSet()
    ended = []

    async def work(name: str) -> None:
        try:
            await asyncio.sleep(1000)
        finally:
            await asyncio.sleep(1)
            ended.append(name)

    for name in ("a", "b"):
        background.spawn(work(name), name)
    await asyncio.sleep(0)
    await background.end()
    assert sorted(ended) == ["a", "b"]
    await background.end()


async def test_an_event_is_waited_for_so_long_and_no_longer() -> None:
    event = asyncio.Event()
    assert not await is_set_within(event, 0.01)
    event.set()
    assert await is_set_within(event, 0.01)
    assert await is_set_within(event, None)


def test_each_is_called_whatever_one_raises_and_the_first_error_is_raised() -> None:
    heard: list[tuple[str, int]] = []

    def fails(text: str, number: int) -> None:
        heard.append((text, number))
        raise RuntimeError(f"failure {len(heard)}")

    with pytest.raises(RuntimeError, match="failure 1"):
        call_each([fails, fails, lambda *what: heard.append(what)], "STOP", 7)
    assert heard == [("STOP", 7)] * 3
    call_each([], "nobody hears it")


async def test_what_begins_is_waited_for_until_then() -> None:
    background = TaskSet()

    async def fly(begun: asyncio.Event, error: Exception | None = None) -> str:
        await asyncio.sleep(0.01)
        begun.set()
        await asyncio.sleep(0.01)
        if error is not None:
            raise error
        return "flown"

    flying = await background.begin(fly, "flight")
    assert not flying.done()
    assert await flying == "flown"
    fails = await background.begin(lambda begun: fly(begun, LinkLost("later")), "flight")
    with pytest.raises(LinkLost, match="later"):
        await fails
    with pytest.raises(LinkLost, match="at once"):
        await background.begin(lambda _: fail(LinkLost("at once")), "flight")
    assert (await background.begin(lambda _: asyncio.sleep(0, "done"), "flight")).result() == "done"


async def test_a_caller_that_waits_no_more_for_a_beginning_ends_nothing_and_leaves_nothing() -> (
    None
):
    background, landed = TaskSet(), asyncio.Event()

    async def land(begun: asyncio.Event) -> None:
        await asyncio.sleep(0.02)
        landed.set()

    waiting = asyncio.create_task(background.begin(land, "landing"))
    await asyncio.sleep(0.005)
    waiting.cancel()
    await asyncio.wait({waiting})
    assert waiting.cancelled()
    await asyncio.wait_for(landed.wait(), 5.0)
    await asyncio.sleep(0.005)
    assert [task for task in asyncio.all_tasks() if task.get_name().endswith("landing")] == []


# -- a stranger cannot fill the log, nor can a callback that always fails --------------------------


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


def test_a_step_that_always_fails_is_not_logged_each_time(caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(500):
        with goes_on("the step of this test"):
            raise RuntimeError("as ever")
    assert len(caplog.records) == 10


def test_so_much_at_once_and_so_much_per_second() -> None:
    one = TokenBucket(rate=2.0, burst=5.0)
    assert [one.take(100.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert not one.take(100.4)
    assert one.take(100.5)
    assert [one.take(1000.0) for _ in range(7)] == [True] * 5 + [False] * 2


def test_what_is_too_dear_costs_nothing() -> None:
    one = TokenBucket(rate=1.0, burst=10.0)
    assert not one.take(0.0, 11.0)
    assert one.take(0.0, 10.0)


def test_what_was_used_already_has_to_be_waited_for() -> None:
    one = TokenBucket(rate=0.5, burst=1.0)
    assert one.wait(0.0) == 0.0
    one.spend(0.0, 3.0)
    assert one.wait(0.0) == pytest.approx(4.0)
    assert one.wait(3.0) == pytest.approx(1.0)
    assert one.wait(5.0) == 0.0


def test_a_signal_acts_in_the_loop_and_one_that_the_system_lacks_is_passed_over() -> None:
    async def hears() -> bool:
        came = asyncio.Event()
        when_signalled(came.set, "SIGUSR2", "SIGNONE")
        try:
            signal.raise_signal(signal.SIGUSR2)
            return await is_set_within(came, PATIENCE)
        finally:
            asyncio.get_running_loop().remove_signal_handler(signal.SIGUSR2)

    assert asyncio.run(hears())  # virtual time asks no system what came


@pytest.mark.parametrize("is_ignored", [False, True])
def test_a_closed_terminal_ends_what_was_not_begun_by_nohup(*, is_ignored: bool) -> None:
    async def ends() -> bool:
        ended = Ended()
        waiting = asyncio.create_task(is_set_within(ended, 0.05 if is_ignored else PATIENCE))
        await asyncio.sleep(0.0)  # it waits
        signal.raise_signal(signal.SIGHUP)
        return await waiting

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if is_ignored else signal.SIG_DFL)
    try:
        assert asyncio.run(ends()) is not is_ignored
    finally:
        signal.signal(signal.SIGHUP, before)
