"""What carries messages: inside one event loop, and between two processes."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.agent import transports
from m100link.apps.agent.codec import MAX_SIZE, encode
from m100link.apps.agent.messages import Event, JournalNote, Message, Telemetry
from m100link.apps.agent.transports import (
    AT_ONCE,
    CLOSE_ABOVE,
    DROP_ABOVE,
    UnixChannel,
    connect_unix,
    memory_channels,
    private_directory,
    serve_unix,
)
from m100link.errors import PortFailed, PortNotFound
from tests.waiting import PATIENCE

A, B = JournalNote("info", "a"), JournalNote("info", "b")


def test_a_message_has_arrived_when_it_was_sent() -> None:
    one, other = memory_channels()
    got: list[Message] = []
    other.open(got.append, got.append)  # type: ignore[arg-type]
    one.send(A)
    assert got == [A]


@pytest.mark.parametrize("as_bytes", [False, True])
def test_what_comes_before_the_end_is_open_waits_in_order(as_bytes: bool) -> None:
    one, other = memory_channels(as_bytes=as_bytes)
    one.send(A)
    one.send(B)
    got: list[Message] = []
    other.open(got.append, lambda reason: None)
    assert got == [A, B]


def test_of_what_comes_before_the_end_is_open_the_newest_thousand_wait() -> None:
    one, other = memory_channels()
    for number in range(1001):
        one.send(JournalNote("info", str(number)))
    got: list[Any] = []
    other.open(got.append, lambda reason: None)
    assert [note.text for note in got] == [str(number) for number in range(1, 1001)]


def test_closing_is_reported_once_and_ends_both_directions() -> None:
    one, other = memory_channels()
    got: list[Message] = []
    reasons: list[str] = []
    other.open(got.append, reasons.append)
    one.open(got.append, reasons.append)
    one.close("enough")
    one.close("again")
    other.close("too")
    one.send(A)
    other.send(A)
    assert (got, reasons) == ([], ["enough"])


def test_what_goes_wrong_at_one_end_stays_there(caplog: pytest.LogCaptureFixture) -> None:
    one, other = memory_channels()

    def fail(message: Message) -> None:
        raise RuntimeError("a front's mistake")

    other.open(fail, lambda reason: None)
    one.send(A)
    assert "a JournalNote was not taken" in caplog.text
    assert "a front's mistake" in caplog.text
    for _ in range(500):  # as with ten seconds of telemetry
        one.send(A)
    assert len(caplog.records) == 10


# -- the carrier between two processes: frames, an end that does not read, an end that goes --------


pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class End:
    """What one end got."""

    def __init__(self) -> None:
        self.inbox: list[Message] = []
        self.reasons: list[str] = []

    def listen(self, channel: UnixChannel) -> None:
        self.channel = channel
        channel.open(self.inbox.append, self.reasons.append)


async def until(predicate: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not predicate():  # noqa: ASYNC110 - a socket has no event for it
            await asyncio.sleep(0.001)


@asynccontextmanager
async def served() -> AsyncIterator[tuple[Path, End]]:
    end = End()
    with private_directory() as directory:
        assert stat.S_IMODE(directory.stat().st_mode) == 0o700
        async with serve_unix(directory / "agent.sock", end.listen):
            yield directory / "agent.sock", end


async def test_messages_go_both_ways_in_order() -> None:
    async with served() as (path, agent):
        front = End()
        front.listen(await connect_unix(path))
        notes: list[Message] = [
            JournalNote("info", f"{number} {'x' * number}") for number in range(500)
        ]
        for note in notes:
            front.channel.send(note)
        await until(lambda: len(agent.inbox) == 500)
        assert agent.inbox == notes
        told: list[Message] = [Event(1, 0.0, "info", "hello"), Telemetry(bytes(9), "1.0", 2.0)]
        for one in told:
            agent.channel.send(one)
        await until(lambda: front.inbox == told)
        front.channel.close()


async def test_bytes_may_come_one_by_one() -> None:
    async with served() as (path, agent):
        with socket.socket(socket.AF_UNIX) as raw:
            raw.connect(str(path))
            body = encode(JournalNote("info", "slow"))
            for byte in struct.pack("<I", len(body)) + body:
                raw.send(bytes([byte]))
                await asyncio.sleep(0)
            await until(lambda: agent.inbox == [JournalNote("info", "slow")])
        await until(lambda: agent.reasons == [""])


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<I", MAX_SIZE + 1),
        struct.pack("<I", 0xFFFFFFFF) + b"x" * 1000,
        struct.pack("<I", 2) + b"[]",
        struct.pack("<I", 0),
    ],
)
async def test_what_is_not_a_message_ends_the_connection(data: bytes) -> None:
    async with served() as (path, agent):
        loop = asyncio.get_running_loop()
        with socket.socket(socket.AF_UNIX) as raw:
            raw.connect(str(path))
            raw.setblocking(False)
            raw.send(data)
            async with asyncio.timeout(PATIENCE):
                while await loop.sock_recv(raw, 1000):
                    pass
        assert agent.inbox == []
        assert len(agent.reasons) == 1, "a listener has to know that the other end is gone"
        assert "message" in agent.reasons[0]


async def test_the_reason_of_a_close_is_reported() -> None:
    async with served() as (path, agent):
        front = End()
        front.listen(await connect_unix(path))
        await until(lambda: hasattr(agent, "channel"))
        agent.channel.close("the agent ends")
        agent.channel.close("again")
        await until(lambda: front.reasons == ["the agent ends"])
        assert agent.reasons == []
        front.channel.send(JournalNote("info", "into nothing"))


@pytest.mark.parametrize("other", [0, 1, -1])
def test_the_system_knows_the_other_end(other: int, monkeypatch: pytest.MonkeyPatch) -> None:
    own = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: own + other)
    one, two = socket.socketpair(socket.AF_UNIX)
    with one, two:
        assert transports._is_same_user(one) is (other == 0)


async def test_a_program_of_another_user_is_turned_away(monkeypatch: pytest.MonkeyPatch) -> None:
    def is_front(connected: socket.socket) -> bool:
        return not connected.getsockname()  # the agent's has the path

    monkeypatch.setattr(transports, "_is_same_user", is_front)
    async with served() as (path, agent):
        front = End()
        front.listen(await connect_unix(path))
        await until(lambda: front.reasons == ["another user"])
        assert not hasattr(agent, "channel")
        assert agent.inbox == []


async def test_an_end_that_does_not_read_loses_telemetry_and_then_the_connection() -> None:
    async with served() as (path, agent):
        front = await connect_unix(path)  # never opened: it does not read
        await until(lambda: hasattr(agent, "channel"))
        package = Telemetry(bytes(1000), "1.0", 0.0)
        for _ in range(DROP_ABOVE // 2000):
            agent.channel.send(package)
        assert agent.channel.dropped == 0
        for _ in range(2 * DROP_ABOVE // 1000):
            agent.channel.send(package)
        assert agent.channel.dropped > 0
        assert agent.reasons == []
        for number in range(2 * CLOSE_ABOVE // 4000):
            agent.channel.send(Event(number, 0.0, "info", "x" * 4000))
            assert agent.reasons == [], "not within what may go to many ends"
        await until(lambda: agent.reasons == ["the other end does not read"])
        front.close()


async def test_a_front_without_an_agent_is_reported(tmp_path: Path) -> None:
    with pytest.raises(PortNotFound):
        await connect_unix(tmp_path / "none.sock")
    with pytest.raises(PortFailed):
        async with serve_unix(tmp_path / "none" / "agent.sock", lambda channel: None):
            pass
    async with serve_unix(tmp_path / "agent.sock", lambda channel: None):
        pass
    with pytest.raises(PortNotFound):  # it has ended
        await connect_unix(tmp_path / "agent.sock")


async def test_who_listens_too_late_hears_of_the_end_all_the_same() -> None:
    channel, end = UnixChannel(), End()
    channel.connection_lost(None)
    end.listen(channel)
    assert (end.inbox, end.reasons) == ([], [""])
    channel.connection_lost(None)
    assert end.reasons == [""]


async def test_a_mistake_with_one_message_does_not_end_the_reader(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with served() as (path, agent):
        front = End()
        front.listen(await connect_unix(path))
        await until(lambda: hasattr(agent, "channel"))
        taken: list[Message] = []

        def take(message: Message) -> None:
            taken.append(message)
            raise RuntimeError("a mistake")

        agent.channel.open(take, agent.reasons.append)
        for _ in range(2):
            front.channel.send(JournalNote("info", "x"))
        await until(lambda: len(taken) == 2)
        assert "a JournalNote was not taken" in caplog.text
        for _ in range(50):
            front.channel.send(JournalNote("info", "x"))
        await until(lambda: len(taken) == 52)
        assert len([one for one in caplog.records if "was not taken" in one.message]) == 10
        front.channel.close()


async def test_a_flood_is_taken_by_turns_and_whole() -> None:
    """An agent flies at 50 Hz beside a front that sends whatever fits its socket."""
    count = 4000
    lengths: list[int] = []
    loop = asyncio.get_running_loop()

    def turns() -> None:
        lengths.append(len(end.inbox))
        if len(end.inbox) < count:
            loop.call_soon(turns)

    async with served() as (path, end):
        _, writer = await asyncio.open_unix_connection(path)
        body = [encode(JournalNote("info", str(number))) for number in range(count)]
        writer.write(b"".join(struct.pack("<I", len(one)) + one for one in body))
        loop.call_soon(turns)
        await until(lambda: len(end.inbox) == count)
        writer.close()
    taken = [later - earlier for earlier, later in pairwise([*lengths, count])]
    # A reader that goes on and one that was woken may come in one turn.
    assert max(taken) <= 2 * AT_ONCE
    assert [one.text for one in end.inbox if isinstance(one, JournalNote)] == [
        str(number) for number in range(count)
    ]
