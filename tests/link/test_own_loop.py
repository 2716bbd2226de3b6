"""Which event loop may use a connection."""

from __future__ import annotations

import asyncio

import pytest

from m100link import UsageError
from m100link.link.link import require_loop


def test_a_loop_is_its_own_while_it_runs_and_between_two_runs() -> None:
    loop, other = asyncio.new_event_loop(), asyncio.new_event_loop()

    async def use(own: asyncio.AbstractEventLoop) -> None:
        require_loop(own, "program.loop")

    loop.run_until_complete(use(loop))
    require_loop(loop)  # as at a prompt
    with pytest.raises(UsageError, match="another event loop") as caught:
        other.run_until_complete(use(loop))
    assert "program.loop.call_soon_threadsafe" in caught.value.remedy
    loop.close()
    other.close()
    with pytest.raises(UsageError, match="another event loop"):
        require_loop(loop)


async def _from_a_thread(own: asyncio.AbstractEventLoop) -> None:
    await asyncio.to_thread(require_loop, own)


def test_a_thread_without_a_loop_is_refused_while_it_runs() -> None:
    loop = asyncio.new_event_loop()
    with pytest.raises(UsageError, match="another event loop"):
        loop.run_until_complete(_from_a_thread(loop))
    loop.close()
