"""Work that is carried to its end, and blocks that are cancelled from outside."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from types import FrameType
from typing import cast

import anyio
import pytest

from m100link.flight.cancellation import ProgramTask, ShieldedTask

pytestmark = pytest.mark.anyio


class Work:
    """Some work of a second, and what became of it."""

    def __init__(self, error: Exception | None = None) -> None:
        self.begun = self.done = self.ended = 0
        self.error = error
        self.shielded = ShieldedTask(self.work, self.on_end)

    async def work(self) -> None:
        self.begun += 1
        await asyncio.sleep(1.0)
        self.done += 1
        if self.error is not None:
            raise self.error

    def on_end(self) -> None:
        self.ended += 1


async def test_work_is_done_once_however_often_it_is_waited_for() -> None:
    work = Work()
    work.shielded.begin()
    await asyncio.gather(work.shielded.ended(), work.shielded.ended())
    await work.shielded.ended()
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


async def test_a_cancelled_waiter_waits_on_and_then_lets_the_cancellation_out() -> None:
    """The caller's cancellation is not swallowed: it comes out when the work has ended."""
    work = Work()
    work.shielded.begin()
    waiter = asyncio.create_task(work.shielded.ended())
    for number in range(5):
        await asyncio.sleep(0.1)
        waiter.cancel(f"number {number}")
    await asyncio.sleep(0.1)
    assert not waiter.done()
    with pytest.raises(asyncio.CancelledError, match="number 4"):
        await waiter
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


async def test_a_scope_of_anyio_cannot_cut_it_short_either() -> None:
    work = Work()
    work.shielded.begin()
    with anyio.move_on_after(0.1) as scope:
        await work.shielded.ended()
        assert work.done == 1
        await asyncio.sleep(10)  # delivered at the next wait
    assert scope.cancelled_caught


async def test_work_that_is_cancelled_itself_is_begun_again() -> None:
    """What asyncio.run does on its way out: it cancels every task there is."""
    before = asyncio.all_tasks()
    work = Work()
    work.shielded.begin()
    waiter = asyncio.create_task(work.shielded.ended())
    for _ in range(2):
        await asyncio.sleep(0.5)
        for task in asyncio.all_tasks() - before:
            task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiter
    assert (work.begun, work.done, work.ended) == (3, 1, 1)


async def test_a_cancellation_comes_out_even_if_the_work_was_begun_again_since() -> None:
    before = asyncio.all_tasks()
    work = Work()
    task = work.shielded.begin()
    await asyncio.sleep(0.5)
    for one in asyncio.all_tasks() - before:
        one.cancel()
    await asyncio.wait([task])
    assert task.cancelled()
    assert (work.begun, work.done, work.ended) == (2, 1, 1)


async def test_its_caller_sees_it_cancelled_when_the_work_is_done() -> None:
    work = Work()
    task = work.shielded.begin()
    await asyncio.sleep(0.5)
    task.cancel()
    await asyncio.wait([task])
    assert task.cancelled()
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


async def test_work_that_is_cancelled_again_and_again_is_given_up_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    before = asyncio.all_tasks()
    work = Work()
    work.shielded.begin()
    for _ in range(3):
        await asyncio.sleep(0.5)
        for task in asyncio.all_tasks() - before:
            task.cancel()
    await work.shielded.ended()
    assert (work.begun, work.done, work.ended) == (3, 0, 1)
    assert "given up" in caplog.text


async def test_work_that_is_cancelled_before_its_first_line_is_begun_all_the_same() -> None:
    work = Work()
    work.shielded.begin().cancel()
    await work.shielded.ended()
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


async def test_whatever_waits_for_the_end_begins_it_where_nothing_could() -> None:
    work = Work()
    work.shielded.park(lambda: None)
    async with asyncio.timeout(2.0):  # its timer looks ten times a second
        await work.shielded.ended()
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


@pytest.mark.parametrize("left", range(1, 40))
async def test_parked_work_is_begun_however_little_of_the_stack_is_left(left: int) -> None:
    work = Work()
    work.shielded.park(lambda: None)
    await asyncio.sleep(0.25)
    # Before, one whose waking had no room slept for ever, and no cancellation woke it.
    here, frame = 0, cast("FrameType | None", sys._getframe())
    while frame is not None:
        here, frame = here + 1, frame.f_back
    limit, is_called = sys.getrecursionlimit(), True
    with contextlib.suppress(RecursionError):  # not so little
        sys.setrecursionlimit(here + left)
    try:
        work.shielded.begin()
    except RecursionError as error:
        is_called = error.__traceback__ is not None and error.__traceback__.tb_next is not None
    finally:
        sys.setrecursionlimit(limit)
    if not is_called:  # its first line had no room, and nobody can know
        work.shielded.begin()
    await asyncio.sleep(1.2)
    await work.shielded.ended()
    assert (work.begun, work.done, work.ended) == (1, 1, 1)


async def test_what_the_work_raises_comes_out_at_each_waiter() -> None:
    work = Work(ZeroDivisionError())
    work.shielded.begin()
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            await work.shielded.ended()
    assert work.ended == 1


# -- cancelling the program ----------------------------------------------------------------------


class Block:
    """A block that is cancelled from outside, and what it made of that."""

    def __init__(self) -> None:
        self.program = ProgramTask(asyncio.get_running_loop())
        self.was_ours: bool | None = None

    async def __aenter__(self) -> Block:
        self.program.enter()
        return self

    async def __aexit__(self, kind: object, error: BaseException | None, _: object) -> bool:
        self.program.leave()
        self.was_ours = self.program.take_back(error)
        return self.was_ours


async def test_its_own_cancellation_is_taken_back() -> None:
    async with Block() as block:
        block.program.cancel()
        await asyncio.sleep(10)
    assert block.was_ours
    task = asyncio.current_task()
    assert task is not None
    assert task.cancelling() == 0
    await asyncio.sleep(0.1)


async def test_a_task_that_cancels_itself_leaves_in_peace() -> None:
    async with Block() as block:
        block.program.cancel()
    assert block.was_ours is False
    await asyncio.sleep(0.1)  # nothing comes behind the block


async def test_a_cancellation_of_somebody_else_is_let_through() -> None:
    block = Block()

    async def program() -> None:
        async with block:
            await asyncio.sleep(10)

    task = asyncio.create_task(program())
    await asyncio.sleep(0.1)
    block.program.cancel()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert block.was_ours is False


async def test_a_cancellation_that_the_program_swallowed_before_does_not_hide_ours() -> None:
    block = Block()

    async def program() -> None:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(10)
        # Nobody called uncancel(): that request stays counted.
        async with block:
            block.program.cancel()
            await asyncio.sleep(10)

    task = asyncio.create_task(program())
    await asyncio.sleep(0.1)
    task.cancel()
    await task
    assert block.was_ours


async def test_it_is_taken_back_once() -> None:
    """The next cancellation of the task is somebody else's."""
    block = Block()

    async def program() -> None:
        async with block:
            block.program.cancel()
            await asyncio.sleep(10)
        with pytest.raises(asyncio.CancelledError) as caught:
            await asyncio.sleep(10)
        assert not block.program.take_back(caught.value)

    task = asyncio.create_task(program())
    await asyncio.sleep(0.1)
    task.cancel()
    await task
    assert task.cancelling() == 1


async def test_it_works_inside_a_timeout_and_around_one() -> None:
    async with asyncio.timeout(5.0), Block() as block, asyncio.timeout(5.0):
        block.program.cancel()
        await asyncio.sleep(1.0)
    assert block.was_ours
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.5), Block():
            await asyncio.sleep(1.0)


async def test_two_blocks_of_one_task_each_take_their_own_back() -> None:
    async with Block() as outer:
        async with Block() as inner:
            inner.program.cancel()
            outer.program.cancel()
            await asyncio.sleep(10)
        pytest.fail("the outer block was cancelled, too")
    assert inner.was_ours is False
    assert outer.was_ours


async def test_a_task_group_in_the_block_ends_with_it() -> None:
    ended = []

    async def work() -> None:
        try:
            await asyncio.sleep(10)
        finally:
            ended.append("work")

    async with Block() as block:
        asyncio.get_running_loop().call_later(1.0, block.program.cancel)
        async with anyio.create_task_group() as group:
            group.start_soon(work)
    assert block.was_ours
    async with Block() as block:
        asyncio.get_running_loop().call_later(1.0, block.program.cancel)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(work())
    assert block.was_ours
    assert ended == ["work", "work"]
