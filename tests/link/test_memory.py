"""The cable inside the process."""

from __future__ import annotations

import asyncio

import pytest

from m100link.link import MemoryTransport, connect_in_memory
from tests.link.peer import settle

pytestmark = pytest.mark.anyio


class Recorder(asyncio.Protocol):
    """Writes down what happens to it."""

    def __init__(self) -> None:
        self.log: list[object] = []
        self.transport: MemoryTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, MemoryTransport)
        self.transport = transport
        self.log.append("made")

    def data_received(self, data: bytes) -> None:
        self.log.append(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self.log.append(exc or "lost")

    def pause_writing(self) -> None:
        self.log.append("pause")

    def resume_writing(self) -> None:
        self.log.append("resume")


async def pair() -> tuple[Recorder, Recorder, MemoryTransport, MemoryTransport]:
    """Two recorders joined, their logs empty, and their ends."""
    here, there = Recorder(), Recorder()
    connect_in_memory(here, there)
    await settle()
    assert here.log == there.log == ["made"]
    assert here.transport is not None
    assert there.transport is not None
    here.log.clear()
    there.log.clear()
    return here, there, here.transport, there.transport


async def test_bytes_arrive_in_order_on_the_next_pass() -> None:
    here, there, end, _ = await pair()
    end.write(b"one ")
    end.write(bytearray(b"two"))
    assert there.log == []
    await settle()
    assert there.log == [b"one two"]
    assert here.log == [], "a sender that was not paused need not be resumed"


async def test_a_reader_that_pauses_makes_the_writer_pause() -> None:
    here, there, end, other = await pair()
    other.pause_reading()
    assert not other.is_reading()
    end.write(bytes(65_536))
    assert here.log == []
    end.write(b"x")
    end.write(b"y")
    assert here.log == ["pause"]
    assert end.get_write_buffer_size() == 65_538
    await settle()
    assert there.log == []
    other.resume_reading()
    await settle()
    assert there.log == [bytes(65_536) + b"xy"]
    assert here.log == ["pause", "resume"]
    assert end.get_write_buffer_size() == 0
    other.pause_reading()
    end.write(bytes(65_537))
    assert here.log == ["pause", "resume", "pause"]


async def test_a_reader_that_pauses_gets_nothing_that_was_under_way() -> None:
    _, there, end, other = await pair()
    end.write(b"under way")
    other.pause_reading()
    await settle()
    assert there.log == []
    other.resume_reading()
    await settle()
    assert there.log == [b"under way"]


async def test_bytes_under_way_are_lost_when_the_line_is_cut() -> None:
    here, there, end, other = await pair()
    end.write(b"under way")
    other.abort()
    end.write(bytes(70_000))
    await settle()
    assert there.log == here.log == ["lost"], "and nobody is asked to pause any more"


async def test_either_end_closes_both_once() -> None:
    here, there, end, other = await pair()
    other.close()
    end.abort()
    other.close()
    end.write(b"into nothing")
    other.write(b"into nothing")
    await settle()
    assert here.log == there.log == ["lost"]
    assert end.is_closing()
    assert other.is_closing()


@pytest.mark.parametrize("how", ["close", "abort"])
async def test_closing_and_aborting_are_the_same(how: str) -> None:
    here, there, end, _ = await pair()
    getattr(end, how)()
    await settle()
    assert here.log == there.log == ["lost"]


async def test_a_pulled_cable_shows_its_error_to_both() -> None:
    here, there, end, _ = await pair()
    end.break_off(OSError("pulled"))
    await settle()
    assert [str(event) for event in here.log] == ["pulled"]
    assert len(there.log) == 1


async def test_a_protocol_can_be_replaced() -> None:
    _, there, end, other = await pair()
    new = Recorder()
    other.set_protocol(new)
    assert other.get_protocol() is new
    end.write(b"for the new one")
    await settle()
    assert new.log == [b"for the new one"]
    assert there.log == []
