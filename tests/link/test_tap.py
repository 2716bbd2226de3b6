"""A tap hears every byte of both directions, and nothing that it does stops the line."""

from __future__ import annotations

import asyncio
import logging

import pytest

from m100link import connect
from m100link.errors import LinkLost, UsageError
from m100link.link import Direction, connect_in_memory, open_link
from m100link.link.link import Link
from m100link.link.statistics import TappedProtocol
from tests.link.peer import settle

pytestmark = pytest.mark.anyio

GET_VERSION = b"\x00\x00\x00"


class Ears:
    """Keeps what a tap hears."""

    def __init__(self) -> None:
        self.heard: list[tuple[Direction, bytes, float]] = []

    def __call__(self, direction: Direction, data: bytes, now: float) -> None:
        self.heard.append((direction, data, now))

    def all(self, direction: Direction) -> bytes:
        return b"".join(data for heard, data, _ in self.heard if heard is direction)


async def test_every_byte_of_both_directions_is_heard_with_its_time() -> None:
    ears = Ears()
    async with connect("sim://", tap=ears) as aircraft:
        await asyncio.sleep(2.0)
        for _ in range(5):
            await aircraft.version()
        statistics = aircraft.statistics()
        assert len(ears.all(Direction.RECEIVED)) == statistics.bytes_received > 1000
        assert len(ears.all(Direction.SENT)) == statistics.bytes_sent > 100
        times = [now for *_, now in ears.heard]
        assert times == sorted(times)
        assert times[-1] - times[0] >= 2.0
        assert times[-1] <= asyncio.get_running_loop().time()


async def test_a_write_is_heard_before_its_answer() -> None:
    ears = Ears()
    link = await open_link("sim://", tap=ears)
    ears.heard.clear()
    answer = await link.request(GET_VERSION)
    assert answer in ears.all(Direction.RECEIVED)
    first_sent = next(i for i, (way, *_) in enumerate(ears.heard) if way is Direction.SENT)
    with_answer = next(
        i for i, (way, data, _) in enumerate(ears.heard) if answer in data and i != first_sent
    )
    assert first_sent < with_answer
    await link.close()


async def test_a_tap_that_raises_is_logged_once_and_the_line_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    calls = 0

    def broken(*_: object) -> None:
        nonlocal calls
        calls += 1
        raise RuntimeError("no room left")

    async with connect("sim://", tap=broken) as aircraft:
        await aircraft.version()
    assert calls == 1
    [record] = [one for one in caplog.records if one.name == "m100link.link.statistics"]
    assert record.levelno == logging.ERROR
    assert "not called again" in record.message


async def test_what_becomes_of_the_line_is_reported_through_a_tap() -> None:
    loop = asyncio.get_running_loop()
    lost: list[Exception] = []
    here, there = Link(on_lost=lost.append), Link()
    connect_in_memory(TappedProtocol(here, Ears(), loop.time), there)
    await settle()
    there._transport.pause_reading()  # type: ignore[union-attr] # a peer that never reads
    dropped = 0
    for _ in range(5000):
        dropped += not here.push(bytes(500))
    assert dropped, "the link did not hear that its line is full"
    there._transport.abort()  # type: ignore[union-attr]
    await settle()
    assert isinstance(here.failure, LinkLost)
    assert lost == [here.failure]
    await here.close()


async def test_a_line_that_is_open_already_cannot_be_tapped() -> None:
    link = await open_link("sim://")
    with pytest.raises(UsageError, match="open already"):
        await connect(link, tap=Ears())
    await link.close()
