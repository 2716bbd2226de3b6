"""Tasks of one owner: what is told of their end, and their end with the owner."""

from __future__ import annotations

import asyncio

import pytest

from m100link.apps.agent.background import BackgroundTasks
from m100link.errors import LinkLost

pytestmark = pytest.mark.anyio


async def fail(error: Exception) -> None:
    raise error


async def test_an_error_of_another_kind_is_logged_and_ours_is_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    background = BackgroundTasks()
    tasks = [
        background.spawn(fail(LinkLost("told already")), "ours"),
        background.spawn(fail(RuntimeError("a mistake")), "theirs"),
    ]
    await asyncio.wait(tasks)
    await asyncio.sleep(0)
    assert "m100link: theirs ended by an error" in caplog.text
    assert "ours" not in caplog.text


async def test_all_end_with_their_owner_also_those_that_take_a_while() -> None:
    background = BackgroundTasks()
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
