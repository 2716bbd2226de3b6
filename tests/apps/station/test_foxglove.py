"""One viewer without a socket: what it hears, what it may ask for, what it loses when slow."""

from __future__ import annotations

import asyncio
import json
import random
import struct
import time
from contextlib import AsyncExitStack, suppress
from itertools import pairwise
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus

from m100link.apps.station import foxglove
from m100link.apps.station.foxglove import FoxgloveChannel, FoxgloveServer, Viewer
from m100link.apps.station.run import RunningStation
from tests.apps.station.web.test_server import TOKEN, station
from tests.sockets import connect
from tests.waiting import PATIENCE, Standing

CHANNELS = (FoxgloveChannel(1, "/a", "A", "{}"), FoxgloveChannel(2, "/b", "B", "{}"))


def viewer() -> Viewer:
    made = Viewer(CHANNELS, "now")
    made.next_frames(1 << 20)
    return made


def said(one: Viewer) -> list[Any]:
    return [json.loads(frame) for frame in one.next_frames(1 << 20) if isinstance(frame, str)]


def data(one: Viewer) -> list[tuple[int, int, bytes]]:
    frames = [frame for frame in one.next_frames(1 << 20) if isinstance(frame, bytes)]
    assert all(frame[0] == 1 for frame in frames)
    return [(*struct.unpack_from("<IQ", frame, 1), frame[13:]) for frame in frames]


def subscription(one: Viewer, *pairs: tuple[Any, Any]) -> None:
    wanted = [{"id": number, "channelId": channel} for number, channel in pairs]
    one.receive(json.dumps({"op": "subscribe", "subscriptions": wanted}), 0.0)


def test_it_hears_what_there_is_and_that_nothing_can_be_sent() -> None:
    info, advertised = said(Viewer(CHANNELS, "now"))
    assert info["op"] == "serverInfo"
    assert info["capabilities"] == []
    assert [one["topic"] for one in advertised["channels"]] == ["/a", "/b"]
    assert {one["schemaEncoding"] for one in advertised["channels"]} == {"jsonschema"}


def test_it_gets_what_it_subscribed_to_until_it_does_not_want_it_any_more() -> None:
    one = viewer()
    subscription(one, (7, 2))
    assert (one.wants(1), one.wants(2)) == (False, True)
    one.publish(1, 5, b"{}")
    one.publish(2, 6, b'{"x":1}')
    assert data(one) == [(7, 6, b'{"x":1}')]
    one.receive('{"op": "unsubscribe", "subscriptionIds": [7]}', 0.0)
    one.publish(2, 8, b"{}")
    assert data(one) == []
    assert not one.wants(2)


def test_a_slow_one_loses_the_oldest_and_nothing_grows() -> None:
    one = viewer()
    subscription(one, (1, 1), (2, 2))
    for number in range(1000):
        one.publish(1, number, b"{}")
    one.publish(2, 5, b"{}")
    found = data(one)
    assert [at for number, at, _ in found if number == 1] == list(range(1000 - 64, 1000))
    assert found[1] == (2, 5, b"{}"), "one subscription waits for the other"
    assert one.dropped == 1000 - 64


@pytest.mark.parametrize(
    "frame",
    [
        b"\x01publish",
        "no JSON",
        "[]",
        "5",
        '{"op": "advertise", "channels": []}',
        '{"op": "setParameters"}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": [], "channelId": {}}]}',
        '{"op": "unsubscribe", "subscriptionIds": [3]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}',
        "[" * 100_000,
    ],
)
def test_what_makes_no_sense_is_reported_and_does_nothing(frame: str | bytes) -> None:
    one = viewer()
    one.receive(frame, 0.0)
    [status] = said(one)
    assert (status["op"], status["level"]) == ("status", 1)
    assert not one.wants(1)
    assert one.close_reason is None


def test_a_client_that_talks_without_end_has_to_go() -> None:
    one = viewer()
    for _ in range(150):
        one.receive("{}", 0.0)
    assert one.close_reason is not None
    assert len(said(one)) <= 64


def test_too_many_subscriptions_are_not_taken() -> None:
    one = viewer()
    subscription(one, *((number, 1) for number in range(300)))
    one.publish(1, 0, b"{}")
    assert len(data(one)) == 200


def test_noise_raises_nothing() -> None:
    chance = random.Random(20261122)
    one = viewer()
    for _ in range(2000):
        junk = chance.randbytes(chance.randrange(40))
        one.receive(junk if chance.random() < 0.3 else junk.decode("latin-1"), chance.random())
        one.next_frames(1000)


# -- a station that Foxglove looks at --------------------------------------------------------------

pytest.importorskip("uvicorn")


pytestmark = pytest.mark.anyio

SPOKEN: Any = ["foxglove.sdk.v1"]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


def url(one: RunningStation, query: str = "") -> str:
    return f"ws://127.0.0.1:{one.sockets.port('foxglove')}/{query}"


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


async def test_a_stranger_is_refused_before_the_socket_is_accepted() -> None:
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


async def test_all_places_are_given_and_one_that_goes_makes_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(foxglove, "_MAX_VIEWERS", 2)
    async with station(foxglove_port=0) as one, AsyncExitStack() as stack:

        async def come() -> None:
            await stack.enter_async_context(connect(url(one), subprotocols=SPOKEN))

        leaver = await stack.enter_async_context(connect(url(one), subprotocols=SPOKEN))
        await come()
        try:
            await come()
            status = 101
        except InvalidStatus as error:
            status = error.response.status_code
        await leaver.close()
        async with asyncio.timeout(PATIENCE):
            while True:
                with suppress(InvalidStatus):  # until the server has seen it go
                    await come()
                    break
    assert status == 403


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


async def test_a_publisher_hears_of_it_and_an_endless_talker_is_cut_off() -> None:
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


async def test_stamps_are_posix_time() -> None:
    stamp = FoxgloveServer({})._feed._stamp(asyncio.get_running_loop().time())
    assert stamp["sec"] == pytest.approx(time.time(), abs=5.0)
