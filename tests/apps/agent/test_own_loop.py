"""A channel for one event loop: everybody else is refused, and the channel never hears of it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from m100link.apps.agent.client import OwnLoop
from m100link.apps.agent.messages import Message, Note
from m100link.apps.agent.transports import memory_channels
from tests.aircraft.test_other_loop import assert_told, elsewhere, plainly

pytestmark = pytest.mark.anyio


def ignore(_: object) -> None:
    """Nobody listens."""


@pytest.mark.parametrize(
    "call",
    [
        lambda channel: channel.require(),
        lambda channel: channel.open(ignore, ignore),
        lambda channel: channel.send(Note("info", "from elsewhere")),
        lambda channel: channel.close("from elsewhere"),
    ],
)
async def test_only_its_own_event_loop_uses_it(call: Callable[[OwnLoop], None]) -> None:
    ours, its = memory_channels()
    inbox: list[Message] = []
    closed: list[str] = []
    its.open(inbox.append, closed.append)
    channel = OwnLoop(ours)
    assert_told(elsewhere(lambda: plainly(lambda: call(channel))))
    assert (inbox, closed) == ([], [])
    call(channel)
    channel.send(Note("info", "from here"))
    channel.close("done")
    assert bool(inbox) is not (closed == ["from elsewhere"])
    assert closed
