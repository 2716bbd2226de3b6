"""A gate in front of a line: what it holds back never leaves, and it hears of what leaves."""

from __future__ import annotations

import asyncio

import pytest

from m100link.link.gate import descriptor_of
from tests.link.peer import connected, settle

pytestmark = pytest.mark.anyio


class Noted:
    """Lets through what the test chose, and notes what it is asked."""

    def __init__(self) -> None:
        self.is_open = True
        self.asked: list[int] = []
        self.told: list[int] = []

    def opens(self, size: int) -> bool:
        self.asked.append(size)
        return self.is_open

    def wrote(self, waiting: int) -> None:
        self.told.append(waiting)


async def test_each_write_is_asked_for_and_reported() -> None:
    link, peer, _ = await connected()
    gate = Noted()
    link.gate = gate
    assert link.push(b"\x01\x03abc")
    await settle()
    assert peer.data == [b"\x01\x03abc"]
    assert gate.asked == [5 + 16], "the data, and what a frame has around it"
    assert gate.told == [21], "a cable in memory carries it in the next turn of the loop"


async def test_what_is_held_back_is_dropped_and_never_comes_later() -> None:
    link, peer, _ = await connected()
    gate = Noted()
    link.gate = gate
    gate.is_open = False
    assert not link.push(b"\x01\x03abc"), "the sender hears it"
    gate.is_open = True
    assert link.push(b"\x01\x03new")
    await settle()
    assert peer.data == [b"\x01\x03new"]
    assert link.statistics().dropped_writes == 1


async def test_a_request_that_was_held_back_is_repeated_behind_it() -> None:
    link, peer, _ = await connected()
    gate = Noted()
    link.gate = gate
    gate.is_open = False
    asking = asyncio.ensure_future(link.request(b"\x00\x00", timeout=0.2, tries=2))
    await asyncio.sleep(0.1)
    assert peer.data == []
    gate.is_open = True
    assert await asking == b"ack of \x00\x00"


async def test_a_line_in_memory_has_no_descriptor() -> None:
    link, _, _ = await connected()
    assert link.descriptor is None
    assert descriptor_of(None) is None
