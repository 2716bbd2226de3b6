"""Sockets of tabs, and what their operators said of the place before a take-off."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Awaitable, Callable
from random import Random
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

pytest.importorskip("starlette")
from starlette.websockets import WebSocket

from m100link.apps.agent import orders
from m100link.apps.station.console import tabs as module
from m100link.apps.station.console.tabs import Tabs
from m100link.sim.clock import VirtualClockEventLoop
from tests.apps.station.conftest import Rig
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio


class Page:
    """A tab's page, from its socket on."""

    def __init__(self, rig: Rig, tabs: Tabs, peer: str = "127.0.0.1", key: str = "") -> None:
        self.rig = rig
        self.key, self.tab = (key, tabs.tabs.get(key)) if key else tabs.open()
        self._inbox: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._inbox.put_nowait({"type": "websocket.connect"})
        self.sent: list[dict[str, Any]] = []
        self._count = 0
        self.takes = 0.0  # seconds for each message
        self.writable = asyncio.Event()  # as uvicorn has it: cleared while too much waits
        self.writable.set()
        scope = {
            "type": "websocket",
            "path_params": {"key": self.key},
            "client": (peer, 1),
            "headers": [],
            "state": {"connection": SimpleNamespace(writable=self.writable)},
        }
        receive: Callable[[], Awaitable[Any]] = self._inbox.get
        self.work = asyncio.create_task(tabs.serve(WebSocket(scope, receive, self._send)))

    async def _send(self, message: Any) -> None:
        await asyncio.sleep(self.takes)
        self.sent.append(message)

    def say(self, op: str = "alive") -> None:
        """That it is alive, or STOP."""
        self._count += 1
        said = {"op": op, "n": self._count, "at": 1000 * self.rig.agent.now}
        self._inbox.put_nowait({"type": "websocket.receive", "text": json.dumps(said)})

    def leave(self) -> None:
        """Close the socket."""
        self._inbox.put_nowait({"type": "websocket.disconnect", "code": 1000})

    @property
    def is_open(self) -> bool:
        """Whether it has a place."""
        kinds = {message["type"] for message in self.sent}
        return "websocket.accept" in kinds and "websocket.close" not in kinds


@pytest.fixture
def places(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "PLACES", 3)
    return 3


async def test_a_tab_gets_instruments_until_it_leaves(rig: Rig) -> None:
    tabs = Tabs({"m100": rig.front, "kite": rig.front})
    page = Page(rig, tabs)
    await anyio.sleep(0.6)
    told = [message for message in page.sent if message["type"] == "websocket.send"]
    assert len(told) == pytest.approx(0.6 / module.LIVE_INTERVAL, abs=2)
    others = [json.loads(message["text"]).get("others", ()) for message in told]
    assert [one["name"] for row in others for one in row] == ["kite"] * 2  # twice a second
    page.leave()
    await page.work
    again = Page(rig, tabs, key=page.key)
    await anyio.sleep(0.1)
    assert again.is_open


async def test_what_a_slow_page_does_not_get_is_counted_for_its_tab(rig: Rig) -> None:
    tabs = Tabs({"m100": rig.front})
    fast, slow = Page(rig, tabs), Page(rig, tabs)
    assert fast.tab is not None
    assert slow.tab is not None
    fast.tab.session.name, slow.tab.session.name = "fast", "slow"
    await anyio.sleep(0.1)
    assert tabs.dropped() == {"fast": 0, "slow": 0}
    slow.takes = 20.5 * module.LIVE_INTERVAL
    await anyio.sleep(100 * module.LIVE_INTERVAL)
    assert tabs.dropped() == {"fast": 0, "slow": 80}
    slow.leave()
    await slow.work
    assert tabs.dropped() == {"fast": 0}


async def test_stop_is_heard_of_a_page_that_takes_nothing(rig: Rig) -> None:
    """Its answers wait on a slow way down; what it says came up long ago."""
    tabs = Tabs({"m100": rig.front})
    page = Page(rig, tabs)
    await anyio.sleep(0.1)
    page.takes = 60.0
    page.writable.clear()
    for op in ("alive", "stop"):
        page.say(op)
    await anyio.sleep(0.5)
    assert rig.front.stopped_at == pytest.approx(rig.agent.now, abs=0.6)
    page.leave()
    await page.work


@pytest.mark.parametrize(("turn_s", "times"), [(0.09, 0), (0.12, 1)])
async def test_a_computer_that_is_too_slow_for_its_pages_says_so_once(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, turn_s: float, times: int
) -> None:
    """20 updates a second are due, each 50 ms; the loop comes to run each so many seconds."""
    told: list[tuple[str, str]] = []
    monkeypatch.setattr(rig.front, "note", lambda text, level="info": told.append((level, text)))
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    page = Page(rig, Tabs({"m100": rig.front}))
    await anyio.sleep(0.2)
    for _ in range(250):
        await asyncio.sleep(1e-4)
        loop._jumping.now += turn_s
    assert page.is_open
    assert [level for level, _ in told] == ["warning"] * times
    assert all("Close tabs and other programs" in text for _, text in told)


@pytest.mark.parametrize("tabs", [1, 8])
async def test_one_stop_of_the_process_is_no_slow_computer(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tabs: int
) -> None:
    """Five seconds of Ctrl-Z said so, and then nothing more when it was true."""
    told: list[str] = []
    monkeypatch.setattr(rig.front, "note", lambda text, level="info": told.append(level))
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    shown = Tabs({"m100": rig.front})
    pages = [Page(rig, shown) for _ in range(tabs)]
    seed = Random().randrange(10**6)
    for stop_s in (5.0, 3600.0, Random(seed).uniform(0.5, 100.0)):
        await anyio.sleep(0.2)
        loop._jumping.now += stop_s
    await anyio.sleep(0.2)
    assert told == [], f"seed {seed}"
    for _ in range(250):
        await asyncio.sleep(1e-4)
        loop._jumping.now += 0.12
    assert told == ["warning"]
    assert all(page.is_open for page in pages)


async def test_a_socket_is_for_a_tab_that_was_opened_and_for_one_at_a_time(rig: Rig) -> None:
    tabs = Tabs({"m100": rig.front})
    page = Page(rig, tabs)
    await anyio.sleep(0.1)
    for other in (Page(rig, tabs, key=page.key), Page(rig, tabs, key="guessed")):
        await other.work
        assert not other.is_open
    assert page.is_open


async def test_an_operator_who_never_said_anything_makes_room(rig: Rig, places: int) -> None:
    tabs = Tabs({"m100": rig.front})
    pages = [Page(rig, tabs) for _ in range(places)]
    await anyio.sleep(0.1)
    for page in pages[1:]:
        page.say()
    await anyio.sleep(1.0)
    newcomer = Page(rig, tabs, peer="10.0.0.2")
    await anyio.sleep(0.1)
    assert newcomer.is_open
    assert [page.is_open for page in pages] == [False, True, True]
    assert pages[0].sent[-1]["reason"] == "another tab needs the place"


async def test_tabs_that_are_alive_are_not_turned_out(rig: Rig, places: int) -> None:
    tabs = Tabs({"m100": rig.front})
    pages = [Page(rig, tabs, peer=f"10.0.0.{number}") for number in range(places)]
    await anyio.sleep(0.1)
    for _ in range(30):
        for page in pages:
            page.say()
        await anyio.sleep(0.5)
    newcomer = Page(rig, tabs, peer="10.0.0.9")
    await newcomer.work
    assert not newcomer.is_open
    assert all(page.is_open for page in pages)


async def test_a_steering_client_needs_no_place_and_loses_none(rig: Rig, places: int) -> None:
    tabs = Tabs({"m100": rig.front})
    pages = [Page(rig, tabs) for _ in range(places)]
    await anyio.sleep(0.1)
    pilot = pages[0]
    assert pilot.tab is not None
    await pilot.tab.session.ask(orders.Activate())
    await pilot.tab.session.obtain()
    pilot.say()
    for _ in range(2):
        await anyio.sleep(0.6)
        pilot.say()
    newcomers = [Page(rig, tabs, peer="10.0.0.2") for _ in range(places)]
    await anyio.sleep(0.1)
    assert pilot.is_open
    assert pilot.tab.session.has_lease
    assert all(page.is_open for page in newcomers)
    assert [page.is_open for page in pages] == [True, False, False]


_UNHEARD = """
import asyncio
from nicegui import Client
from m100link.apps.station.config import Settings
from m100link.apps.station.console import app
from m100link.apps.station.run import running

app.MOST_UNHEARD = 3


async def main():
    settings = Settings(sim=True, port=0, console_port=0)
    async with running(settings, with_console=True) as one:
        host = f"127.0.0.1:{one.sockets.port('console')}"
        head = ["GET / HTTP/1.1", f"Host: {host}", "Connection: close", "", ""]
        seen = []
        for _ in range(6):
            reader, writer = await asyncio.open_connection("127.0.0.1", one.sockets.port("console"))
            writer.write("\\r\\n".join(head).encode())
            assert b" 200 " in await reader.readline()
            await reader.read()
            writer.close()
            seen.append([id for id, one in Client.instances.items() if one.page.path == "/"])
        assert [len(kept) for kept in seen] == [1, 2, 3, 3, 3, 3], seen
        assert not set(seen[-1]) & set(seen[2]), "the oldest gave way"


asyncio.run(main())
"""


@pytest.mark.pty  # a process has one console
def test_the_oldest_page_whose_browser_never_came_gives_way_to_a_new_one() -> None:
    """A minute of them would hold up keys and STOP: the garbage collector walks through all."""
    done = subprocess.run(
        [sys.executable, "-c", _UNHEARD],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
