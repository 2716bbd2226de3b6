"""Connections cost a descriptor until they say something; handshakes come one by one."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.web import intake
from m100link.apps.station.web.intake import Intake, SocketListener
from m100link.apps.station.web.limits import ConnectionLimit
from tests.apps.cli.test_serve import certificate
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


class Echo(asyncio.Protocol):
    """Answers what it gets."""

    events, steers = 0, False
    made = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        Echo.made += 1
        self.transport: Any = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)


@contextlib.asynccontextmanager
async def listening(
    door: ConnectionLimit, *, context: ssl.SSLContext | None = None, patience: float = 30.0
) -> AsyncIterator[tuple[SocketListener, int]]:
    Echo.made = 0
    with socket.create_server(("127.0.0.1", 0)) as one:
        one.setblocking(False)
        listener = SocketListener(one, Intake(), door, Echo, context=context, patience=patience)
        try:
            yield listener, one.getsockname()[1]
        finally:
            listener.close()


async def answers(port: int, context: ssl.SSLContext | None = None) -> bytes:
    async with asyncio.timeout(PATIENCE):
        reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
        writer.write(b"hello")
        answer = await reader.readexactly(5)
        writer.close()
    return answer


async def test_a_silent_visitor_is_counted_at_the_door_and_costs_no_more() -> None:
    door = ConnectionLimit()
    async with listening(door) as (_, port):
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(10)]
        await until(lambda: len(door) == 10)
        assert Echo.made == 0
        assert await answers(port) == b"hello"
        assert Echo.made == 1
        for _, writer in silent:
            writer.close()
        await until(lambda: len(door) == 0)


async def test_the_first_bytes_have_their_time() -> None:
    door = ConnectionLimit()
    async with listening(door, patience=0.05) as (_, port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        async with asyncio.timeout(PATIENCE):
            assert await reader.read() == b""
        assert len(door) == 0
        writer.close()


async def test_silent_ones_make_room() -> None:
    door = ConnectionLimit(per_peer=4)
    async with listening(door) as (_, port):
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(30)]
        assert await answers(port) == b"hello"
        assert len(door) <= 4
        for _, writer in silent:
            writer.close()


async def test_handshakes_that_nobody_ends_are_given_up(tmp_path: Path) -> None:
    paths = certificate(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*paths)
    trusting = ssl.create_default_context(cafile=str(paths[0]))
    trusting.check_hostname = False
    door = ConnectionLimit()
    async with listening(door, context=context, patience=0.5) as (_, port):
        begun = [await asyncio.open_connection("127.0.0.1", port) for _ in range(8)]
        for _, writer in begun:
            writer.write(b"\x16")  # the type of a handshake record, and no more
        assert await answers(port, trusting) == b"hello"
        for reader, writer in begun:
            async with asyncio.timeout(PATIENCE):
                with contextlib.suppress(ConnectionError):
                    assert await reader.read() == b""
            writer.close()
        await until(lambda: len(door) == 0)


async def test_without_descriptors_it_waits_and_takes_the_next_one_later() -> None:
    held: list[int] = []
    async with listening(ConnectionLimit()) as (_, port):
        loop = asyncio.get_running_loop()
        client = socket.socket()
        client.setblocking(False)
        try:
            with contextlib.suppress(OSError):
                while True:
                    held.append(os.dup(0))
            await loop.sock_connect(client, ("127.0.0.1", port))
            await asyncio.sleep(0.2)
        finally:
            for number in held:
                os.close(number)
        await loop.sock_sendall(client, b"later")
        async with asyncio.timeout(PATIENCE):
            assert await loop.sock_recv(client, 5) == b"later"
        client.close()


@pytest.mark.parametrize("lacking", ["EMFILE", "ENFILE", "ENOBUFS", "ENOMEM"])
async def test_it_looks_again_when_something_was_lacking_and_serves(
    monkeypatch: pytest.MonkeyPatch, lacking: str
) -> None:
    class Lacking(socket.socket):
        def accept(self) -> tuple[socket.socket, Any]:
            if refused:
                raise OSError(getattr(errno, refused.pop()), "lacking")
            return super().accept()

    refused = [lacking]
    monkeypatch.setattr(intake, "_FULL_PAUSE", 0.01)
    with Lacking() as one:
        one.bind(("127.0.0.1", 0))
        one.listen()
        one.setblocking(False)
        listener = SocketListener(one, Intake(), ConnectionLimit(), Echo, context=None, patience=30)
        assert await answers(one.getsockname()[1]) == b"hello"
        assert refused == []
        listener.close()


async def test_when_it_is_closed_newcomers_are_closed_and_others_stay() -> None:
    door = ConnectionLimit()
    async with listening(door) as (listener, port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"here")
        assert await reader.readexactly(4) == b"here"
        silent, other = await asyncio.open_connection("127.0.0.1", port)
        await until(lambda: len(door) == 1)
        listener.close()
        listener.close()
        assert await silent.read() == b""
        writer.write(b"here")
        assert await reader.readexactly(4) == b"here"
        writer.close()
        other.close()


@pytest.mark.parametrize("turns", [0, 1])
async def test_a_visitor_turned_out_while_it_comes_in_is_closed(turns: int) -> None:
    """Also between the turn that lets it in and the first step of its task."""
    door, made = ConnectionLimit(), list[Any]()
    enter = door.enter

    def watched(visitor: Any) -> None:
        enter(visitor)
        made.append(visitor)

    door.enter = watched  # type: ignore[method-assign]  # the door is all that knows it
    async with listening(door) as (_, port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        await until(lambda: bool(made))
        made[0].step()
        for _ in range(turns):
            await asyncio.sleep(0)
        made[0].turn_out()
        async with asyncio.timeout(PATIENCE):
            assert await reader.read() == b""
        assert len(door) == 0
        writer.close()
