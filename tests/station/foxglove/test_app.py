"""A station that Foxglove looks at, asked by a client that others wrote. Real time and sockets."""

from __future__ import annotations

import asyncio
import json
import struct
from itertools import pairwise
from typing import Any

import pytest

pytest.importorskip("uvicorn")
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus

from m100link.station.run import Running
from tests.sockets import connect
from tests.station.web.test_server import TOKEN, station
from tests.waiting import PATIENCE, Standing

pytestmark = pytest.mark.anyio

SPOKEN: Any = ["foxglove.sdk.v1"]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


def url(one: Running, query: str = "") -> str:
    return f"ws://127.0.0.1:{one.foxglove_port}/{query}"


async def advertised(socket: ClientConnection) -> dict[str, Any]:
    """The channels by topic."""
    assert json.loads(await socket.recv())["capabilities"] == []
    told = json.loads(await socket.recv())
    assert told["op"] == "advertise"
    return {channel["topic"]: channel for channel in told["channels"]}


async def subscribe(socket: ClientConnection, channels: dict[str, Any], *topics: str) -> None:
    wanted = [{"id": channels[one]["id"], "channelId": channels[one]["id"]} for one in topics]
    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


async def message(socket: ClientConnection) -> tuple[int, int, Any]:
    while not isinstance(frame := await socket.recv(), bytes):
        pass
    number, at_ns = struct.unpack_from("<IQ", frame, 1)
    return number, at_ns, json.loads(frame[13:])


async def test_every_channel_brings_what_its_schema_says() -> None:
    async with (
        station(foxglove_port=0) as one,
        connect(url(one), subprotocols=SPOKEN) as socket,
        asyncio.timeout(PATIENCE),
    ):
        assert socket.subprotocol == "foxglove.sdk.v1"
        channels = await advertised(socket)
        by_number = {channel["id"]: channel for channel in channels.values()}
        await subscribe(socket, channels, *channels)
        await message(socket)  # it is heard
        one.agent.journal.note("somebody looks on")
        missing = set(channels)
        seen: list[int] = []
        jsonschema = pytest.importorskip("jsonschema")
        while missing or len(seen) < 40:
            number, at_ns, content = await message(socket)
            jsonschema.validate(content, json.loads(by_number[number]["schema"]))
            missing.discard(by_number[number]["topic"])
            if by_number[number]["topic"] == "/m100/telemetry":
                seen.append(at_ns)
        # However busy this machine is.
        assert min(after - before for before, after in pairwise(seen)) > 0.049e9


async def test_who_has_no_business_is_refused_before_the_socket_is_accepted() -> None:
    async with station(foxglove_port=0, token=TOKEN) as one:
        for query, options in (
            (f"?token={TOKEN}", {"origin": "http://evil.example"}),
            ("", {}),
            ("?token=wrong", {}),
            (f"?token={TOKEN}", {"subprotocols": ["another"]}),
        ):
            wanted: dict[str, Any] = {"subprotocols": SPOKEN, **options}
            with pytest.raises(InvalidStatus) as caught:
                async with connect(url(one, query), **wanted):
                    pass
            assert caught.value.response.status_code == 403
        async with connect(url(one, f"?token={TOKEN}"), subprotocols=SPOKEN) as socket:
            assert await advertised(socket)


async def test_one_that_does_not_read_delays_nobody() -> None:
    async with (
        station(foxglove_port=0) as one,
        asyncio.timeout(PATIENCE),
        connect(url(one), subprotocols=SPOKEN, max_queue=1) as slow,
        connect(url(one), subprotocols=SPOKEN) as quick,
        Standing() as machine,
    ):
        channels = await advertised(slow)
        await subscribe(slow, channels, *channels)
        await advertised(quick)
        await subscribe(quick, channels, "/m100/telemetry")
        slow.transport.pause_reading()
        times = [(await message(quick))[1] for _ in range(60)]
        assert max(after - before for before, after in pairwise(times)) < 1e9 * (
            1.5 + machine.total_s
        )
        slow.transport.abort()


async def test_who_publishes_is_told_and_who_talks_without_end_is_cut_off() -> None:
    async with (
        station(foxglove_port=0) as one,
        asyncio.timeout(PATIENCE),
        connect(url(one), subprotocols=SPOKEN) as socket,
    ):
        await advertised(socket)
        await socket.send(b"\x01publish")
        assert json.loads(await socket.recv())["op"] == "status"
        with pytest.raises(ConnectionClosed):
            await talk_without_end(socket)


async def talk_without_end(socket: ClientConnection) -> None:
    while True:
        await socket.send("{}")
        await asyncio.sleep(0)
