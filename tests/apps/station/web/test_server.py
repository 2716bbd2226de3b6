"""The station on real sockets: what independent clients do, and what attackers try."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
import tracemalloc
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock, PropertyMock, call

import pytest

from tests.apps.agent.conftest import task_of

pytest.importorskip("uvicorn")
pytest.importorskip("starlette")
from starlette.websockets import WebSocketDisconnect
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Opcode

from m100link.apps.agent import orders
from m100link.apps.station.config import Settings
from m100link.apps.station.ros.client import Client, ClientLimits
from m100link.apps.station.run import RunningStation, running
from m100link.apps.station.web import server
from m100link.errors import PortBusy, UsageError
from m100link.sim.virtual import VirtualAircraft
from tests.sockets import connect
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

TOKEN = "0123456789abcdefXY"


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


@contextlib.asynccontextmanager
async def station(**options: Any) -> AsyncIterator[RunningStation]:
    virtual = VirtualAircraft(seed=5)
    async with running(Settings(sim=True, port=0, **options), virtual=virtual) as one:
        await until(lambda: one.agent.connection.aircraft is not None)
        yield one


async def until(predicate: Callable[[], bool], within: float = PATIENCE) -> None:
    async with asyncio.timeout(within):
        while not predicate():  # noqa: ASYNC110 - polls what has no event
            await asyncio.sleep(0.005)


def address(one: RunningStation, query: str = "") -> str:
    return f"ws://127.0.0.1:{one.sockets.port('rosbridge')}/{query}"


async def send(client: ClientConnection, op: str, **fields: Any) -> None:
    await client.send(json.dumps({"op": op, **fields}))


async def publish(client: ClientConnection, topic: str, kind: str, **message: Any) -> None:
    await send(client, "advertise", topic=topic, type=kind)
    await send(client, "publish", topic=topic, msg=message)


async def receive(client: ClientConnection, within: float = PATIENCE) -> Any:
    async with asyncio.timeout(within):
        return json.loads(await client.recv())


async def opened(one: RunningStation, client: ClientConnection) -> None:
    await one.agent.ask(orders.Activate())
    await publish(client, "/nav_open_close_request", "std_msgs/Float32", data=1)
    await until(lambda: one.agent.holding.has_authority)


async def test_a_client_sees_telemetry_and_flies() -> None:
    async with station(also_ports=(0,)) as one:
        other_port = f"ws://127.0.0.1:{one.sockets.ports('rosbridge')[1]}/some/path"
        async with connect(address(one)) as pilot, connect(other_port) as watcher:
            await send(watcher, "subscribe", topic="/flight_status")
            assert (await receive(watcher))["msg"] == {"data": 1.0}
            await opened(one, pilot)
            await publish(pilot, "/sdk_request_cmd", "std_msgs/Float32", data=4)
            async with asyncio.timeout(PATIENCE):
                while (await receive(watcher))["msg"] != {"data": 3.0}:
                    pass
        await until(lambda: not one.agent.holding.has_authority)


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Host": "evil.example:9090"},
        {"Host": "evil.example:9090", "Origin": "http://evil.example:9090"},
    ],
)
async def test_foreign_origins_and_rebound_names_get_403(headers: dict[str, str]) -> None:
    async with station() as one:
        with pytest.raises(InvalidStatus) as caught:
            await raw_connect(address(one), headers)
        assert caught.value.response.status_code == 403


async def raw_connect(url: str, headers: dict[str, str]) -> None:
    """Connect with headers exactly as given: the client library would add its own Host."""
    host, port = url[5:].split("/")[0].split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    lines = {
        "Host": f"{host}:{port}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    } | headers
    head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    writer.write(f"GET / HTTP/1.1\r\n{head}\r\n".encode())
    status = (await reader.readline()).split()
    writer.close()
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    if status[1] != b"101":
        raise InvalidStatus(Response(int(status[1]), "", Headers()))


async def test_an_origin_can_be_allowed() -> None:
    async with station(allow_origin=("null",)) as one:
        await raw_connect(address(one), {"Origin": "null"})


async def test_without_the_token_nothing_works() -> None:
    async with station(token=TOKEN) as one:
        for query in ("", "?token=wrong-wrong-wrong"):
            with pytest.raises(InvalidStatus) as caught:
                async with connect(address(one, query)):
                    pass
            assert caught.value.response.status_code == 403
        async with connect(address(one, f"?token={TOKEN}")) as client:
            await send(client, "subscribe", topic="/flight_status")
            await receive(client)


async def test_binding_beyond_this_machine_needs_a_token() -> None:
    with pytest.raises(UsageError, match="no token"):
        async with station(host="0.0.0.0"):
            pass


async def test_a_port_that_is_taken_is_reported() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(PortBusy, match=f"127.0.0.1:{port}"):
            async with running(Settings(sim=True, port=port)):
                pass


async def test_oversized_frames_close_their_own_socket_only() -> None:
    async with station() as one, connect(address(one)) as calm:
        async with connect(address(one), max_size=None) as hostile:
            with contextlib.suppress(ConnectionClosed):
                await hostile.send("x" * 1_000_000)
            with pytest.raises(ConnectionClosed) as caught:
                await hostile.recv()
            assert caught.value.rcvd is not None
            assert caught.value.rcvd.code == 1009
        await send(calm, "subscribe", topic="/flight_status")
        await receive(calm)


@pytest.mark.parametrize(
    "frame", ["{", "[]", "null", '{"op":"publish"}', b"\x00\xff", "[" * 50_000, '{"op":"x"}']
)
async def test_malformed_frames_are_answered_and_nothing_else(frame: str | bytes) -> None:
    async with station() as one, connect(address(one)) as client:
        await client.send(frame)
        assert (await receive(client))["level"] == "error"
        await send(client, "subscribe", topic="/flight_status")
        assert (await receive(client))["op"] == "publish"


async def test_a_flood_does_not_delay_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted in frames of the flood, not in seconds: those are the machine's."""
    served: list[Client] = []
    receive_frame = Client.receive

    def counted(self: Client, *args: Any) -> None:
        served.append(self)
        receive_frame(self, *args)

    monkeypatch.setattr(Client, "receive", counted)
    async with (
        station() as one,
        connect(address(one)) as calm,
        connect(address(one), close_timeout=1) as hostile,
    ):
        asking = asyncio.create_task(drown(hostile))
        between = []
        for _ in range(40):
            before = len(served)
            await send(calm, "call_service", service="/rosapi/services")
            await receive(calm)
            between.append(len(served) - before)
        assert max(between) < 20, between  # a turn of the event loop for each
        assert sum(between) > 120, "the flood was over before"
        with contextlib.suppress(ConnectionClosed):
            await asking
        await until(lambda: len(one.bridge.graph.sessions) == 1)


async def drown(client: ClientConnection) -> None:
    for _ in range(4_000):
        await client.send('{"op":"subscribe","topic":"/x"}')


async def test_a_thousand_subscriptions_are_bounded() -> None:
    async with station() as one, connect(address(one)) as client:
        reading = asyncio.create_task(drain(client))
        for number in range(1000):
            await send(client, "subscribe", topic="/dji_sdk/imu", id=str(number))
            await asyncio.sleep(0.004)
        (session,) = one.bridge.graph.sessions
        assert isinstance(session, Client)
        await until(lambda: session.refused >= 900)
        assert session.close_reason is None
        reading.cancel()


async def drain_all(client: ClientConnection) -> None:
    while True:
        await client.recv()


async def drain(client: ClientConnection) -> None:
    async for _ in client:
        pass


async def test_a_client_that_does_not_read_is_disconnected_and_costs_little_until_then() -> None:
    async with station() as one:
        topics = [name for name in one.bridge.graph.topics if name.startswith("/dji_sdk")]
        reader = socket.create_connection(("127.0.0.1", one.sockets.port("rosbridge")))
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        key = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        head = f"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n{key}"
        reader.sendall(f"{head}Upgrade: websocket\r\n\r\n".encode())
        for name in topics:
            reader.sendall(client_frame(json.dumps({"op": "subscribe", "topic": name}).encode()))
        async with connect(address(one)) as calm:
            await send(calm, "subscribe", topic="/dji_sdk/attitude")
            tracemalloc.start()
            before = tracemalloc.get_traced_memory()[0]
            async with asyncio.timeout(PATIENCE):
                while (
                    len(one.bridge.graph.sessions) == 2
                ):  # who does not read does not answer pings
                    await receive(calm)
                grown = tracemalloc.get_traced_memory()[1] - before
                tracemalloc.stop()
                for _ in range(100):  # it costs the other one nothing
                    await receive(calm)
        reader.close()
    assert grown < 3_000_000


def client_frame(data: bytes) -> bytes:
    """A masked text frame of less than 64 kB; the mask is zeros."""
    length = (
        bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + len(data).to_bytes(2, "big")
    )
    return b"\x81" + length + bytes(4) + data


async def test_more_clients_than_allowed_are_refused() -> None:
    async with station(max_clients=2) as one, connect(address(one)), connect(address(one)):
        await until(lambda: len(one.bridge.graph.sessions) == 2)
        with pytest.raises(InvalidStatus):
            async with connect(address(one)):
                pass


async def test_silent_sockets_make_room_and_the_pilot_keeps_his(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def is_silent_after(seconds: float) -> None:
        monkeypatch.setattr("m100link.apps.station.web.limits.SILENCE", seconds)
        monkeypatch.setattr("m100link.apps.station.web.limits.FIRST_WORD", seconds)

    async with station(max_clients=2) as one, contextlib.AsyncExitStack() as stack:

        async def come() -> ClientConnection:
            return await stack.enter_async_context(connect(address(one), close_timeout=1))

        pilot = await come()
        await opened(one, pilot)
        watcher, idle = await come(), await come()  # the pilot takes none of the two places
        await send(watcher, "subscribe", topic="/flight_status")
        is_silent_after(3600.0)
        with pytest.raises(InvalidStatus):
            await come()
        is_silent_after(0.0)  # all of them are, and the pilot, too
        third = await come()
        await send(third, "subscribe", topic="/flight_status")
        await receive(third)
        with pytest.raises(ConnectionClosed) as caught:
            await idle.recv()
        assert caught.value.rcvd is not None
        assert "another client needs the place" in caught.value.rcvd.reason
        await receive(watcher)
        await come()
        await send(pilot, "call_service", service="/rosapi/services")
        while (await receive(pilot))["op"] != "service_response":
            pass


async def test_a_client_that_keeps_the_loop_from_running_is_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with station() as one, connect(address(one)) as calm:
        # It does not stay until the work that it caused is paid for: a quarter of an hour here.
        strict = partial(ClientLimits, work_rate=1e-3)
        monkeypatch.setattr("m100link.apps.station.ros.client.ClientLimits", strict)
        async with connect(address(one), close_timeout=1) as hostile:
            await until(lambda: len(one.bridge.graph.sessions) == 2)

            def block(call: Any) -> None:
                until = time.thread_time() + 0.3
                while time.thread_time() < until:
                    pass
                call.respond({})

            one.bridge.graph.add_service("/block", "std_srvs/Empty", block)
            for _ in range(3):
                await send(hostile, "call_service", service="/block")
            with pytest.raises(ConnectionClosed) as caught:
                await drain_all(hostile)
            assert caught.value.rcvd is not None
            assert "blocked the station" in caught.value.rcvd.reason
        await send(calm, "subscribe", topic="/flight_status")
        await receive(calm)


async def test_a_pong_that_comes_late_by_our_own_fault_cuts_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("m100link.apps.station.web.protocol.PING_INTERVAL", 0.1)
    monkeypatch.setattr("m100link.apps.station.web.protocol.PING_TIMEOUT", 0.2)
    async with station() as one, connect(address(one), ping_interval=None) as client:
        # A client whose pongs are late, and that goes on talking.
        send_frame = client.protocol.send_frame
        monkeypatch.setattr(
            client.protocol,
            "send_frame",
            lambda frame: None if frame.opcode is Opcode.PONG else send_frame(frame),
        )
        for _ in range(10):
            await send(client, "call_service", service="/rosapi/services")
            await receive(client)
            await asyncio.sleep(0.05)


async def test_a_replayed_lease_is_refused() -> None:
    async with station() as one, connect(address(one)) as first, connect(address(one)) as second:
        await one.agent.ask(orders.Activate())

        async def lease(client: ClientConnection, **args: str) -> Any:
            await send(client, "call_service", service="/m100link/lease", args=args)
            while (answer := await receive(client))["op"] != "service_response":
                pass
            return answer["values"]

        mine = await lease(first, action="acquire", name="first")
        assert mine["success"]
        held = await lease(second, action="acquire", name="second")
        assert (held["success"], held["holder"]) == (False, "first")
        asked = await lease(second, action="take_over", name="second")
        assert "first would lose control" in asked["message"]
        taken = await lease(second, action="confirm", token=asked["token"])
        assert (taken["success"], taken["holder"]) == (True, "second")
        for client in (first, second):
            replayed = await lease(client, action="renew", token=mine["token"])
            assert (replayed["success"], replayed["holder"]) == (False, "second")
        again = await lease(second, action="confirm", token=asked["token"])
        assert not again["success"]
        await publish(second, "/nav_open_close_request", "std_msgs/Float32", data=1)
        await until(lambda: one.agent.holding.has_authority)
        await publish(first, "/sdk_request_cmd", "std_msgs/Float32", data=4)
        while "second has control" not in (await receive(first)).get("msg", ""):
            pass
        assert task_of(one.agent) is None


async def test_pages_of_a_folder_are_served_and_nothing_outside_it(tmp_path: Path) -> None:
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "page.html").write_text("<p>page</p>")
    (tmp_path / "secret").write_text("secret")
    for name in (".env", ".git/config", "more/.env"):
        (tmp_path / "pages" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "pages" / name).write_text("secret")
    (tmp_path / "pages" / "link").symlink_to(tmp_path / "pages" / ".env")
    async with station(pages=tmp_path / "pages") as one:
        assert "<p>page</p>" in await get(one.sockets.port("rosbridge"), "/page.html")
        inside = ("/.env", "/%2eenv", "/.git/config", "/more/.env", "/more/../.env", "/link")
        for path in ("/../secret", "/%2e%2e/secret", "/..%2fsecret", *inside):
            answer = await get(one.sockets.port("rosbridge"), path)
            assert answer.startswith("HTTP/1.1 404")
        health = await get(one.sockets.port("rosbridge"), "/health")
        assert health.startswith("HTTP/1.1 200")
        assert '"aircraft"' not in health  # a station of several lists them under it
    async with station() as one:
        assert "rosbridge v2" in await get(one.sockets.port("rosbridge"), "/")


async def get(port: int, path: str) -> str:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n"
    writer.write(head.encode())
    answer = (await reader.read()).decode()
    writer.close()
    return answer


async def test_a_socket_that_is_cut_stops_the_motion() -> None:
    async with station() as one:
        client = await connect(address(one))
        await opened(one, client)
        await publish(client, "/sdk_request_cmd", "std_msgs/Float32", data=4)
        await until(lambda: task_of(one.agent) is not None)
        await until(lambda: task_of(one.agent) is None)
        assert one.virtual is not None
        moves = one.virtual.autopilot.received_movements
        await publish(client, "/sdk_request_ctrl", "geometry_msgs/Quaternion", x=-4)
        await until(lambda: any(move.pitch_or_y == -4 for move in moves))
        before = len(moves)
        client.transport.abort()
        await until(lambda: moves[-1].pitch_or_y == 0)
        # At 50 Hz the setpoint lasts 35 frames; the machine can only make fewer of them.
        flown = [move for move in list(moves)[before:] if move.pitch_or_y == -4]
        assert len(flown) <= 20
        await until(lambda: not one.agent.holding.has_authority)


def with_clients(*sessions: Any, **agent: Any) -> server.RosbridgeServer:
    one = object.__new__(server.RosbridgeServer)
    one.agents = {"": cast(Any, SimpleNamespace(**agent))}
    one.graph = cast(Any, SimpleNamespace(sessions=list(sessions)))
    return one


@pytest.mark.parametrize("count", [1, 2])
def test_who_makes_room_hears_why_and_has_ended_at_once(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Its topics and its lease do not wait for the end of its socket."""
    silent = [Mock(spec=Client, heard_at=40.0) for _ in range(count)]
    one = with_clients(*silent, now=43.5)
    one.clients, one._max_clients = {}, 2
    monkeypatch.setattr(server, "to_evict", lambda others, peer, now: others[0])
    assert one._make_room("a peer")
    why = "another client needs the place; this one was silent for 3.5 s"
    assert silent[0].method_calls == [call.disconnect(why), call.close(43.5)] * (count - 1)


@pytest.mark.parametrize(
    ("late", "work", "why"),
    [
        (0.11, 0.06, "it blocked the station for 60 ms"),
        (0.11, 0.04, ""),  # it has not done half of it
        (0.09, 9.0, ""),
    ],
)
async def test_the_heaviest_client_goes_when_the_loop_stood_for_a_tenth_of_a_second(
    late: float, work: float, why: str
) -> None:
    light, heavy = (Mock(spec=Client, recent_work=one) for one in (work / 2, work))
    one = with_clients(light, heavy)
    times = iter([8.0, 8.05 + late, *[9.0] * 99])
    one.agents = {"": cast(Any, Mock())}
    type(one.agent).now = PropertyMock(side_effect=times)  # type: ignore[method-assign]
    guard = asyncio.ensure_future(one._guard())
    await until(lambda: heavy.recent_work == 0.0)
    guard.cancel()
    assert heavy.method_calls == ([call.disconnect(why), call.close(9.0)] if why else [])
    assert (light.method_calls, light.recent_work) == ([], 0.0)


async def test_a_client_is_charged_for_what_it_sends_and_gets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Seconds of the processor: of a frame that is read, and of others that are packed."""
    session = Mock(close_reason=None)
    session.work_pause.return_value = 0.0

    async def frames(_: object) -> AsyncIterator[str]:
        yield "{}"

    async def send_all(_: object) -> None:
        if session.charge.call_count > 1:
            raise WebSocketDisconnect

    times = iter([5.0, 5.25, 6.0, 6.5, 7.0, 7.5])
    monkeypatch.setattr(server, "time", SimpleNamespace(thread_time=times.__next__))
    monkeypatch.setattr(server, "frames_of", frames)
    monkeypatch.setattr(server, "_frames", lambda _: ["{}"])
    socket = Mock(scope={"state": {"connection": SimpleNamespace(send_all=send_all)}})
    one = with_clients(now=7.0)
    await one._read(socket, session)
    await one._write(socket, session, asyncio.Event(), asyncio.Event())
    assert session.charge.call_args_list == [call(0.25, 7.0), call(0.5, 7.0)]


async def test_what_is_throttled_goes_when_it_is_due_and_what_is_short_goes_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = Mock()
    session.outbox.next_wakeup.return_value = 1000.01
    async with asyncio.timeout(PATIENCE):
        await with_clients(now=1000.0)._wait(session, asyncio.Event())
    monkeypatch.setattr(server, "_PACKING_TIME", PATIENCE)
    session.outbox.next_frame.side_effect = ["a" * 60_000, "b", "c" * 6000, "d"]
    assert [frame[0] for frame in server._frames(session)] == ["a", "b", "c"]  # 64 KiB
