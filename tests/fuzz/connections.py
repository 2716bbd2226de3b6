"""Connections: the serial line, HTTP and rosbridge; on virtual time."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import cache
from typing import Any

import cbor2
from uvicorn.server import ServerState
from websockets.frames import Frame, Opcode

from m100link.apps.station.config import Settings
from m100link.apps.station.ros.graph import Graph
from m100link.apps.station.ros.messages import MESSAGES, MessageType, _scalar_default
from m100link.apps.station.web.access_control import AccessControl
from m100link.apps.station.web.intake import Intake, Metered
from m100link.apps.station.web.protocol import ANSWER_TIME, Config, HttpConnection, Server
from m100link.errors import M100Error
from m100link.sim.clock import VirtualClockEventLoop
from m100link.testing import ConnectableAircraft
from tests.apps.station.web.test_intake import Line
from tests.fuzz.worlds import Spoiled, Still, Take, station
from tests.rig import STILL, put_in_the_air
from tests.support import raw_frame

__all__ = ["http_seeds", "line_seeds", "on_http", "on_line", "on_rosbridge", "rosbridge_seeds"]


# -- the serial line ------------------------------------------------------------------------------


def line_seeds(pushes: list[bytes], acks: list[bytes]) -> list[bytes]:
    """Session and whether it is an ack, sequence, and data.

    Args:
        pushes: Data of commands.
        acks: Data of answers.
    """
    pushes, acks = pushes[:: 1 + len(pushes) // 150], acks[:: 1 + len(acks) // 150]
    seeds = [b"\0\0" + one for one in pushes]
    return seeds + [bytes((0x20 | number % 32, number % 256)) + a for number, a in enumerate(acks)]


@asynccontextmanager
async def on_line() -> AsyncIterator[Take]:
    """A program hovers, and its line brings bytes and right frames besides those of the aircraft.

    They may be telemetry that cannot be true, or end control: it hovers on, and nothing else is
    raised than errors of the package.
    """
    virtual = ConnectableAircraft(seed=1)
    async with virtual.connect() as aircraft:
        await aircraft.activate(virtual.credentials)
        put_in_the_air(virtual)

        async def fly() -> None:
            async with aircraft.control() as control:
                async for _ in control.ticks():
                    control.send(STILL)

        flying = asyncio.create_task(fly())
        await asyncio.sleep(1.0)
        still = Still(virtual)

        async def take(data: bytes) -> None:
            head = (data + b"\0\0")[:2]
            frame = raw_frame(
                data[2:1000], session=head[0] % 32, is_ack=bool(head[0] & 0x20), sequence=head[1]
            )
            for part in (frame, data):
                aircraft.link.data_received(part)
            with suppress(M100Error):
                await aircraft.version()
            repr(aircraft.state)
            await asyncio.sleep(0.05)
            still.check()
            if flying.done():
                if not isinstance(error := flying.exception(), M100Error):
                    raise error or AssertionError("control ended without an error")
                raise Spoiled
            assert aircraft.is_connected, "the line was given up"

        try:
            yield take
        finally:
            flying.cancel()
            await asyncio.wait((flying,))
            virtual.stop()


# -- HTTP -----------------------------------------------------------------------------------------

_HEAD = b"GET / HTTP/1.1\r\nHost: station\r\n"
_UPGRADE = (
    b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


def http_seeds() -> list[bytes]:
    """Requests and frames, as bytes of a connection."""
    frames = [
        Frame(Opcode.TEXT, b'{"op":"x"}', fin=False),
        Frame(Opcode.CONT, b"y"),
        Frame(Opcode.BINARY, bytes(130)),
        *(Frame(Opcode.PING, b"p"), Frame(Opcode.PONG, b""), Frame(Opcode.CLOSE, b"\x03\xe8")),
    ]
    said = [one.serialize(mask=True) for one in frames]
    return [
        _HEAD + b"Accept: */*\r\nCookie: a=b\r\n\r\n" + _HEAD + b"\r\n",
        _HEAD.replace(b"GET", b"POST") + b"Content-Length: 2\r\n\r\n{}",
        _HEAD + b"Transfer-Encoding: chunked\r\nExpect: 100-continue\r\n\r\n1\r\n{\r\n0\r\n\r\n",
        *(_HEAD + _UPGRADE + one for one in said),
        _HEAD + _UPGRADE + b"".join(said),
    ]


async def _echo(scope: Any, receive: Any, send: Any) -> None:
    """An application behind the gate: it answers requests, and says what it heard."""
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": scope["path"].encode()})
        return
    await send({"type": "websocket.accept"})
    while (told := await receive())["type"] != "websocket.disconnect":
        if told["type"] == "websocket.receive":
            await send(told | {"type": "websocket.send"})


@asynccontextmanager
async def on_http() -> AsyncIterator[Take]:
    """One connection after the other brings bytes; each is closed in the end, or a WebSocket."""
    config = Server.make(AccessControl(_echo, hosts=["station"]), Settings(sim=True)).config
    assert isinstance(config, Config)
    state, intake = ServerState(), Intake()

    async def take(data: bytes) -> None:
        line = Line()
        line.metered = metered = Metered(intake, HttpConnection(config, state, {}))
        metered.connection_made(line)
        line.deliver(data)
        await asyncio.sleep(2 * ANSWER_TIME)
        is_socket = b"101 Switching" in line.written
        assert line.ended or is_socket, f"nothing ends it: {line.written!r}"
        metered.connection_lost(None)
        await asyncio.sleep(0.1)
        assert not state.connections, "a connection that has gone is remembered"
        assert not state.tasks, "an application serves nobody"
        assert not config.door._open, "a place at the door stays taken"

    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    yield take


# -- rosbridge ------------------------------------------------------------------------------------

_OBTAINS = ("/dji_sdk/sdk_control_authority", "/dji_sdk/sdk_permission_control", "/m100link/lease")
"""Services that take control, without which nothing moves."""


def _filled(kind: MessageType) -> dict[str, Any]:
    """A message as JSON has it, with one value in each list."""
    made: dict[str, Any] = {}
    for field in kind.fields:
        value = (
            _filled(MESSAGES[field.type]) if field.type in MESSAGES else _scalar_default(field.type)
        )
        if field.length is not None:
            value = (
                "AAEC" if field.is_bytes and not field.length else [value] * max(1, field.length)
            )
        made[field.name] = value
    return made


@cache
def _graph() -> Graph:
    async def make() -> Graph:
        async with station() as one:
            return one.client().session.graph

    loop = VirtualClockEventLoop()
    try:
        return loop.run_until_complete(make())
    finally:
        loop.close()


def rosbridge_seeds() -> list[bytes]:
    """Each service and each topic that the station reads, with a value in each field."""
    said: list[dict[str, Any]] = [
        {"op": "call_service", "service": "/rosapi/topics", "id": "a", "compression": "cbor"},
        {"op": "call_service", "service": "/rosapi/topics", "fragment_size": 64, "id": 1},
        {"op": "call_service", "service": "/rosapi/topics", "compression": "png"},
        {"op": "subscribe", "topic": "/rosout", "throttle_rate": 50, "queue_length": 3},
        {"op": "subscribe", "topic": "/dji_sdk/attitude", "compression": "cbor-raw"},
        {"op": "unsubscribe", "topic": "/rosout"},
        {"op": "set_level", "level": "info"},
        {"op": "fragment", "id": "x", "num": 0, "total": 2, "data": '{"op":'},
    ]
    graph = _graph()
    for name, service in graph.services.items():
        if name not in _OBTAINS:
            args = _filled(service.type.request)
            said.append({"op": "call_service", "service": name, "args": args})
    for name, topic in graph.topics.items():
        if topic.on_publish is not None and "open" not in name:
            said.append({"op": "publish", "topic": name, "msg": _filled(topic.type)})
    return [json.dumps(one).encode() for one in said]


@asynccontextmanager
async def on_rosbridge(*, has_control: bool) -> AsyncIterator[Take]:
    """Programs come, say something and go; without control nothing that they say moves anything.

    Args:
        has_control: Whether the program that says it opened control, on the ground.
    """
    async with AsyncExitStack() as stack:
        one = await stack.enter_async_context(station())
        pilot = (await one.open()).session if has_control else None
        still = Still(one.aircraft)

        async def take(data: bytes) -> None:
            page = pilot or one.client().session
            for number, part in enumerate(data.split(b"\n\n")[:8]):
                text = part.decode("utf-8", "replace")
                page.receive(part if number % 2 else text, one.agent.now)
            await asyncio.sleep(0.02)
            page.outbox.advance(one.agent.now)
            for _ in range(200):
                if (frame := page.outbox.next_frame()) is None:
                    break
                cbor2.loads(frame) if isinstance(frame, bytes) else json.loads(frame)
            if pilot is None:
                page.close(one.agent.now)
                if b"open" not in data and not one.agent.holding.has_authority:
                    return still.check()
            elif one.agent.holding.has_authority and not still.has_moved:
                return None
            raise Spoiled  # it opened control or gave it back, and may have flown

        yield take
