"""MAVLink of the station: what is kept of signatures while it serves, over a socket."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.apps.mavlink.bridge import signature_time
from m100link.apps.mavlink.translator.codec import MavlinkMessage, PacketSigner, write_frame
from m100link.apps.station import mavlink as module
from m100link.apps.station.config import Settings
from m100link.apps.station.mavlink import prepare, serving_mavlink
from m100link.errors import UsageError
from m100link.sim.clock import virtual_clock_loop
from tests.waiting import PATIENCE

KEY = bytes(range(32))
PING = MavlinkMessage("PING", {}, component=190)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    return Settings(mavlink=("udp://127.0.0.1:0",), signing_key_file=key)


async def served(settings: Settings, *frames: bytes) -> int:
    """Serve, send, and end. Returns how many were refused."""
    async with AsyncExitStack() as stack:
        [bound] = sockets = prepare(stack, settings)
        bridge = await stack.enter_async_context(serving_mavlink({}, settings, sockets))
        signer: Any = bridge._signer
        before = dict(signer.newest)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            for frame in frames:
                one.sendto(frame, bound.getsockname())
        async with asyncio.timeout(PATIENCE):
            while not signer.refused and before == signer.newest:  # noqa: ASYNC110 - a socket
                await asyncio.sleep(0.01)
        return int(signer.refused)


def test_what_was_recorded_is_refused_at_the_next_start(settings: Settings, tmp_path: Path) -> None:
    recorded = write_frame(
        PING, system=245, sequence=0, signer=PacketSigner(KEY), now=signature_time()
    )
    assert asyncio.run(served(settings, recorded)) == 0
    [file] = (tmp_path / "m100link" / "mavlink").iterdir()
    assert list(json.loads(file.read_text())["newest"]) == ["245.190.0"]
    assert asyncio.run(served(settings, recorded)) == 1


def test_what_came_before_it_serves_is_not_obeyed(settings: Settings) -> None:
    """Who sent a command while nobody listened does not expect it to be flown now."""

    async def served_late() -> list[Any]:
        async with AsyncExitStack() as stack:
            [bound] = sockets = prepare(stack, settings)
            one = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))

            def send(component: int) -> None:
                ping = replace(PING, component=component)
                signer, now = PacketSigner(KEY), signature_time()
                frame = write_frame(ping, system=245, sequence=0, signer=signer, now=now)
                one.sendto(frame, bound.getsockname())

            send(190)
            bridge = await stack.enter_async_context(serving_mavlink({}, settings, sockets))
            signer: Any = bridge._signer
            send(191)
            async with asyncio.timeout(PATIENCE):
                while not signer.newest:  # noqa: ASYNC110 - a socket
                    await asyncio.sleep(0.01)
            return list(signer.newest)

    [(system, component, *_)] = asyncio.run(served_late())
    assert (system, component) == (245, 191)


def test_an_autopilot_that_there_is_not_is_refused(settings: Settings) -> None:
    with pytest.raises(UsageError, match="there is no autopilot 'ardu'"):
        prepare(AsyncExitStack(), replace(settings, autopilot="ardu"))


@pytest.mark.parametrize("field", ["mavlink", "mavlink_to"])
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "192.0.2.7"])
def test_no_other_machine_is_let_in_or_sent_to_unsigned(field: str, host: str) -> None:
    address: dict[str, Any] = {field: (f"udp://{host}:{0 if field == 'mavlink' else 9}",)}
    if host == "127.0.0.1":
        [bound] = prepare(AsyncExitStack(), Settings(**address))
        bound.close()
        return
    with pytest.raises(UsageError, match=f"{host} lets other machines fly"):
        prepare(AsyncExitStack(), Settings(**address))


def test_a_folder_that_cannot_be_written_is_reported_and_it_serves(
    settings: Settings, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "m100link").write_text("a file")
    later = signature_time() + 100_000
    frame = write_frame(PING, system=245, sequence=0, signer=PacketSigner(KEY), now=later)
    with caplog.at_level(logging.WARNING):
        assert asyncio.run(served(settings, frame)) == 0
    assert "signatures are not remembered" in caplog.text


# -- what its bridge is given: no socket is opened -------------------------------------------------


class FakeBridge(SimpleNamespace):
    """What the station gives its bridge, and what reaches it; port 99 is a stranger's."""

    def __init__(self, agents: Any, send: Any, **given: Any) -> None:
        peers = SimpleNamespace(is_known=lambda address: address[1] != 99)
        super().__init__(agents=agents, send=send, peers=peers, came=[], **given)
        texts: list[list[str]] = [[], []]
        self.vehicles = [SimpleNamespace(told=told, tell=told.append) for told in texts]

    def received(self, data: bytes, address: Any) -> None:
        self.came.append((data, address))

    async def run(self) -> None:
        await asyncio.Event().wait()


class Waiting:
    """A socket at which these datagrams wait."""

    def __init__(self, *datagrams: bytes) -> None:
        self.datagrams = list(datagrams)

    def recvfrom(self, size: int) -> tuple[bytes, Any]:
        if not self.datagrams:
            raise BlockingIOError
        return self.datagrams.pop(0)[:size], ("127.0.0.1", 5)


def with_bridge(
    monkeypatch: pytest.MonkeyPatch,
    settings: Settings,
    use: Callable[[Any, list[Any], list[Any], list[list[Any]]], None],
) -> None:
    receivers: list[Any] = []
    sent: list[list[Any]] = []

    @asynccontextmanager
    async def serving(_: object, received: Any) -> AsyncIterator[Any]:
        receivers.append(received)
        sent.append(mine := [])
        yield lambda *what: mine.append(what)

    monkeypatch.setattr(module, "Bridge", FakeBridge)
    monkeypatch.setattr(module, "serving", serving)

    async def run() -> None:
        sockets: Any = [Waiting(b"old"), Waiting(b"older")]
        agents: Any = {"kite": "one", "gull": "two"}
        async with serving_mavlink(agents, settings, sockets) as bridge:
            use(bridge, sockets, receivers, sent)

    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(run())


@pytest.mark.parametrize("is_recorded", [True, False])
def test_a_bridge_is_that_of_the_settings(
    is_recorded: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    to = ("udp://127.0.0.1:14550",)
    asked = Settings(mavlink_to=to, sysid=7, autopilot="generic", record=tmp_path)

    def use(bridge: Any, sockets: list[Any], _: object, __: object) -> None:
        assert bridge.agents == {7: "one", 8: "two"}
        assert (bridge.to, bridge.signer, bridge.autopilot) == ((("127.0.0.1", 14550),), None, 0)
        assert bridge.logs == (tmp_path if is_recorded else None)
        assert bridge.came == [], "what waited from before is not obeyed"
        for place, one in enumerate(sockets):
            one.datagrams = [b"%d" % place, bytes(2000)]
        found = [data for data, _ in bridge.drain()]
        assert [len(data) for data in found] == [1, 65, 1, 65]  # a signed command, and a byte
        assert found[::2] == [b"0", b"1"]

    with_bridge(monkeypatch, replace(asked, no_record=not is_recorded), use)


def test_an_answer_leaves_by_the_socket_of_its_question(monkeypatch: pytest.MonkeyPatch) -> None:
    """Strangers take no place there, and of more than 65 peers all are learned anew."""

    def use(bridge: Any, _: object, receivers: list[Any], sent: list[list[Any]]) -> None:
        def way_of(port: int) -> int:
            before = [len(one) for one in sent]
            bridge.send(b"answer", ("h", port))
            [place] = [n for n, one in enumerate(sent) if len(one) > before[n]]
            return place

        assert way_of(1) == 0
        for place, port in ((1, 1), (1, 99), (0, 2)):
            receivers[place](b"asked", ("h", port))
        assert [way_of(port) for port in (1, 99, 2)] == [1, 0, 0]
        for port in range(200, 264):
            receivers[1](b"asked", ("h", port))
        assert [way_of(port) for port in (1, 263)] == [1, 1]
        receivers[1](b"asked", ("h", 264))
        assert [way_of(port) for port in (1, 263, 264)] == [0, 0, 1]
        assert len(bridge.came) == 3 + 65

    with_bridge(monkeypatch, Settings(mavlink=("udp://127.0.0.1:1",)), use)


def test_a_disk_that_takes_no_signatures_is_reported_once_for_each_reason(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """On the screen of each ground station, too."""
    writes: list[Any] = []
    met = [OSError(28, "No space left"), OSError(28, "No space left"), None, OSError(5, "I/O")]

    class Memory(SimpleNamespace):
        def recall(self, _: int) -> str:
            return "it cannot be read"

        def due(self) -> Any:
            return f"due {len(writes)}" if len(writes) < len(met) else None

        def last(self) -> Any:
            return "last"

        def write(self, snapshot: Any) -> None:
            writes.append(snapshot)
            error = met[len(writes) - 1] if len(writes) <= len(met) else None
            if error is not None:
                raise error

    async def at_once(work: Any, *what: Any) -> Any:
        return work(*what)

    monkeypatch.setattr(module, "SignatureMemory", lambda *_: Memory(path="file"))
    monkeypatch.setattr("asyncio.to_thread", at_once)
    bridge: Any = FakeBridge({}, None)

    async def run() -> float:
        clock = asyncio.get_running_loop().time
        began = clock()
        async with module._remembering(PacketSigner(KEY), bridge):
            while len(writes) < len(met):  # noqa: ASYNC110 - a clock that is virtual
                await asyncio.sleep(0.01)
            took = clock() - began
            await asyncio.sleep(1.0)
        return took

    with (
        caplog.at_level(logging.WARNING),
        asyncio.Runner(loop_factory=virtual_clock_loop) as runner,
    ):
        assert runner.run(run()) == pytest.approx(0.3, abs=0.02), "every 0.1 s"
    assert writes == ["due 0", "due 1", "due 2", "due 3", "last"]
    told = [
        f"signatures are not remembered: {why}"
        for why in ("it cannot be read", "file: No space left", "file: I/O")
    ]
    assert [one.getMessage() for one in caplog.records] == told
    assert [vehicle.told for vehicle in bridge.vehicles] == [told, told]
