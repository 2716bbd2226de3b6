"""The processes of a station as tables: settings in, and what each process gets; seconds and order.

No process is started: stand-ins note what would be, on virtual time.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.apps.agent import transports
from m100link.apps.agent.background import Ended
from m100link.apps.agent.messages import RemoteError
from m100link.apps.station import listeners, process, run, supervisor
from m100link.apps.station.config import ONLY_NAME, Settings
from m100link.apps.station.listeners import Sockets, keep_reached
from m100link.apps.station.supervisor import ChildProcess, supervised
from m100link.errors import LinkError, M100Error, UsageError
from m100link.protocol.commands.activation import Credentials
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.wire import Key
from tests import limits
from tests.apps.station.conftest import apart, several

pytestmark = pytest.mark.anyio

KEY = Key("0f" * 32)
REAL: dict[str, Any] = {"app_id": 7, "key": "0f" * 32, "level": 1}


# -- the virtual aircraft of a station ------------------------------------------------------------

METRES_PER_DEGREE = 111_319.5  # on the equator of WGS 84


@pytest.mark.parametrize("place", [0, 1, 3])
def test_virtual_aircraft_stand_in_a_row_to_the_east(place: int) -> None:
    """10 m from one to the next."""
    usual = AircraftSettings()
    there = run._virtual(None, None, place).vehicle.settings
    east = (there.longitude_deg - usual.longitude_deg) * METRES_PER_DEGREE
    east *= math.cos(math.radians(usual.latitude_deg))
    north = (there.latitude_deg - usual.latitude_deg) * METRES_PER_DEGREE
    assert (north, east) == pytest.approx((0.0, 10.0 * place), abs=0.1)
    assert there.noise == 1.0


@pytest.mark.parametrize(("forced", "firmware"), [(None, "1.0"), ("3.1", "3.1")])
def test_a_virtual_aircraft_has_the_firmware_and_the_app_of_the_settings(
    forced: str | None, firmware: str
) -> None:
    virtual = run._virtual(Credentials(7, KEY, level=1), forced, 0)
    assert virtual.autopilot.profile.name == firmware
    assert (virtual.credentials.app_id, virtual.credentials.level) == (7, 1)
    assert virtual.credentials.key == KEY
    usual = run._virtual(None, forced, 0).credentials
    assert (usual.app_id, usual.key) == (DEMO_APP_ID, DEMO_KEY)


# -- who owns an aircraft -------------------------------------------------------------------------


class Noted(list[tuple[str, tuple[Any, ...], dict[str, Any]]]):
    """Calls with their values."""

    def call(self, name: str, answer: Any = None) -> Callable[..., Any]:
        def note(*values: Any, **named: Any) -> Any:
            self.append((name, values, named))
            return answer

        return note

    def context(self, name: str, answer: Any = None) -> Callable[..., Any]:
        @asynccontextmanager
        async def note(*values: Any, **named: Any) -> AsyncIterator[Any]:
            self.append((name, values, named))
            yield answer
            self.append((f"end of {name}", (), {}))

        return note

    def of(self, name: str) -> tuple[tuple[Any, ...], dict[str, Any]]:
        [found] = [(values, named) for called, values, named in self if called == name]
        return found

    @property
    def names(self) -> list[str]:
        return [name for name, _, _ in self]


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> Noted:
    """What an owner of an aircraft is made of."""
    made = Noted()
    journal = SimpleNamespace(note=made.call("note"))
    agent = SimpleNamespace(journal=journal, holding=SimpleNamespace(has_authority=True))
    monkeypatch.setattr(run, "Agent", made.context("agent", agent))
    service = SimpleNamespace(close=made.call("close"), attach=made.call("attach"))
    monkeypatch.setattr(run, "AgentServer", lambda _: service)
    monkeypatch.setattr(run, "by_url", made.call("by_url", "the way"))
    return made


URL = "serial:///dev/ttyUSB0"
OWNED: list[tuple[dict[str, Any], dict[str, Any], tuple[Any, ...]]] = [
    (
        {"url": URL, "baud_rate": 115_200, "firmware": "2.3", "timeout": 2.5, **REAL},
        {"baud_rate": 115_200, "firmware": "2.3", "timeout": 2.5, "acceleration": None},
        (7, KEY, 1),
    ),
    (
        {"url": URL, "acceleration": "raw"},
        {"baud_rate": None, "firmware": None, "timeout": None, "acceleration": "raw"},
        (),
    ),
    # A virtual aircraft by its URL knows this app, unless another one is set.
    ({"url": "sim://?seed=3"}, {}, (DEMO_APP_ID, DEMO_KEY, 2)),
    ({"url": "sim://?seed=3", **REAL}, {}, (7, KEY, 1)),
]


@pytest.mark.parametrize(("given", "how", "app"), OWNED)
async def test_whom_an_agent_connects_to_and_for_which_app(
    noted: Noted, given: dict[str, Any], how: dict[str, Any], app: tuple[Any, ...]
) -> None:
    settings = Settings(**given, max_height=30.0, max_radius=60.0)
    async with run.owning(settings, leases_before=11) as owner:
        assert owner.virtual is None
    (url,), options = noted.of("by_url")
    assert (url, options.pop("flights")) == (given["url"], None)
    assert how.items() <= options.items()
    (way,), agent = noted.of("agent")
    credentials, envelope = agent.pop("credentials"), agent.pop("envelope")
    found = credentials and (credentials.app_id, credentials.key, credentials.level)
    assert (way, found or ()) == ("the way", app)
    assert (envelope.max_height_m, envelope.max_radius_m) == (30.0, 60.0)
    assert agent == {"leases_before": 11, "replay": None}
    assert noted.names[-2:] == ["close", "end of agent"]  # first the leases, then the aircraft


async def test_a_virtual_aircraft_of_the_station_is_owned_for_its_own_app(noted: Noted) -> None:
    async with run.owning(Settings(sim=True, **REAL), place=1) as owner:
        assert owner.virtual is not None
        east = owner.virtual.vehicle.settings.longitude_deg - AircraftSettings().longitude_deg
    assert east > 0.0
    credentials = noted.of("agent")[1]["credentials"]
    assert (credentials.app_id, credentials.key, credentials.level) == (7, KEY, 1)


async def test_a_recorded_flight_has_neither_app_nor_log(
    noted: Noted, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It is looked at before anybody is served."""
    replay = SimpleNamespace(connect="the flight")

    async def look() -> None:
        noted.append(("look", (), {}))

    def replays(url: str, firmware: str | None) -> Any:
        assert (url, firmware) == ("replay:///x.mcap", "2.3")
        return replay

    replay.look = look
    monkeypatch.setattr(run, "Replays", replays)
    settings = Settings(url="replay:///x.mcap", firmware="2.3", record=tmp_path, **REAL)
    async with run.owning(settings):
        pass
    assert noted.names[:2] == ["look", "agent"]
    (way,), how = noted.of("agent")
    assert (way, how["credentials"], how["replay"]) == ("the flight", None, replay)


@pytest.mark.parametrize(
    ("folder", "no_record", "keeps"),
    [
        ("", False, None),
        ("ours", True, None),
        ("ours", False, (3, 40)),
        ("ours/a1", False, (3, 40)),
        ("ours/a1/b", False, (0, 0)),
        ("theirs", False, (0, 0)),
    ],
)
def test_room_is_made_in_folders_of_ours_alone(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    folder: str,
    no_record: bool,
    keeps: tuple[int, int] | None,
) -> None:
    """Logs and megabytes of them; 0 keeps all."""
    monkeypatch.setattr(run, "default_folder", lambda: tmp_path / "ours")
    monkeypatch.setattr(run, "Flights", lambda at, **how: (at, how["keep"], how["keep_mb"]))
    settings = Settings(
        record=tmp_path / folder if folder else None,
        no_record=no_record,
        record_keep=3,
        record_keep_mb=40,
    )
    found: Any = run._flights(settings, print)
    assert found == (None if keeps is None else (tmp_path / folder, *keeps))


async def test_no_aircraft_at_all_is_a_mistake(noted: Noted) -> None:
    with pytest.raises(UsageError, match="no aircraft was named"):
        async with run.owning(Settings()):
            pass
    assert noted == []


# -- what goes to which process -------------------------------------------------------------------


SECRETS = {"key", "key_file", "app_id", "token_file"}
AGENTS = {"url", "baud_rate", "firmware", "timeout", "acceleration", "sim", "app_id", "key"}
AGENTS |= {"key_file", "level", "app_version", "bundle_id", "max_height"}
AGENTS |= {"max_radius", "record", "no_record", "record_keep", "record_keep_mb"}


def test_each_process_gets_what_it_needs_and_no_secret_of_the_other(tmp_path: Path) -> None:
    every: dict[str, Any] = {
        "url": URL, "baud_rate": 1, "firmware": "3.1", "timeout": 1.5, "acceleration": "raw",
        "app_id": 7, "key": "0f" * 32, "key_file": tmp_path / "key", "record": tmp_path,
        "token": "0123456789abcdefXY", "host": "0.0.0.0", "tls_cert": tmp_path / "c",
        "tls_key": tmp_path / "k", "pages": tmp_path, "metrics_port": 1, "foxglove_port": 2,
    }  # fmt: skip
    settings = Settings(**every)
    front, agent = supervisor.front_settings(settings), run.agent_settings(settings)
    assert not front.keys() & (SECRETS | {"url", "record", "origins", "unused"})
    assert (front["token"], front["host"]) == ("0123456789abcdefXY", "0.0.0.0")
    assert (front["pages"], front["tls_key"]) == (str(tmp_path), str(tmp_path / "k"))
    assert agent.keys() == AGENTS
    assert (agent["key"], agent["key_file"]) == ("0f" * 32, str(tmp_path / "key"))
    named = {one.name for one in fields(Settings)}
    # All else is for the fronts, and what is None goes to nobody.
    assert named - AGENTS - {"token_file", "origins", "unused"} >= front.keys() - AGENTS
    assert front.keys() >= {"port", "console_port", "max_clients", "sysid"}
    assert "tiles" not in front
    mavlink = supervisor.front_settings(replace(settings, mavlink_to=("udp://127.0.0.1:14550",)))
    assert mavlink["record"] == str(tmp_path), "MAVLink programs fetch logs"


class Child:
    """A process that would be started."""

    made: list[Child]

    def __init__(self, role: str, called: str, request: Any, note: Any, **how: Any) -> None:
        self.role, self.called, self.request, self.note, self.how = role, called, request, note, how
        self.answer = {"console_path": "/?code=1", "is_virtual": called.endswith("left")}
        self.made.append(self)

    async def begin(self) -> None:
        """It loads what it needs."""

    async def end(self) -> None:
        """It has ended."""


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch, noted: Noted, tmp_path: Path) -> list[Child]:
    Child.made = []
    monkeypatch.setattr(run, "supervised", noted.context("supervised"))

    def opened(*values: Any, with_console: bool = False, **served: bool) -> Sockets:
        noted.append(("open_sockets", values, {"with_console": with_console, **served}))
        one: Any = SimpleNamespace(fileno=lambda: 44)
        return Sockets({"rosbridge": [one]} | ({"console": []} if with_console else {}))

    for module in (run, supervisor):
        monkeypatch.setattr(module, "open_sockets", opened)
        monkeypatch.setattr(module, "ChildProcess", Child)
    monkeypatch.setattr(transports, "serve_unix", noted.context("serve_unix"))

    async def step(name: str) -> None:
        noted.append((name, (), {}))

    def orders(aircraft: list[Any], path: Path) -> Any:
        noted.append(("orders", (len(aircraft), path.name), {}))
        return SimpleNamespace(
            path=path, start=lambda: step("start"), stop=lambda: step("end of orders")
        )

    monkeypatch.setattr(run, "CtlServer", orders)
    return Child.made


@pytest.mark.parametrize("with_console", [False, True])
@pytest.mark.parametrize("sim", [False, True])
async def test_the_process_of_the_fronts_of_one_aircraft(
    noted: Noted, children: list[Child], sim: bool, with_console: bool
) -> None:
    """A page gives orders to a virtual aircraft, and nothing else does."""
    settings = Settings(sim=True) if sim else Settings(url=URL)
    async with apart(settings, with_console=with_console) as one:
        assert one.console_path() == "/?code=1"
        assert one.has_authority is True
    assert noted.of("open_sockets")[1] == {"with_console": with_console, "with_rosbridge": True}
    [front] = children
    assert (front.role, front.called) == ("fronts", "the fronts")
    assert front.request["settings"] == supervisor.front_settings(settings)
    sockets = {"rosbridge": [44]} | ({"console": []} if with_console else {})
    assert front.request["sockets"] == sockets
    assert front.how == {"inherited": [44], "loads": (5, list(sockets), [])}
    agents, orders = front.request["agents"], front.request["orders"]
    assert [Path(one).name for one in agents.values()] == ["agent.sock"]
    assert agents.keys() == {ONLY_NAME}
    assert list(orders) == ([ONLY_NAME] if sim and with_console else [])
    # First of all leases end: a child that hangs must not fly on.
    assert noted.names.index("close") < noted.names.index("end of supervised")
    assert ("orders" in noted.names) is (sim and with_console)


async def test_the_fronts_read_recordings_from_the_beginning_on(children: list[Child]) -> None:
    files = [("/a/one.mcap", "3.1"), ("/a/two.mcap", "")]
    async with supervisor.beginning_fronts({"a": Settings(url=URL)}, recordings=files):
        assert children[-1].how["loads"][2] == files


@pytest.fixture
def clients(monkeypatch: pytest.MonkeyPatch) -> tuple[list[Any], list[tuple[str, str, str]]]:
    """Stand-ins for the station's clients of its agents, and the notes they are given."""
    clients: list[Any] = []
    told: list[tuple[str, str, str]] = []

    class Client(SimpleNamespace):
        def __init__(self, channel: str, called: str) -> None:
            super().__init__(
                channel=channel, called=called, on_event=[], is_gone=False, has_authority=False,
                background=SimpleNamespace(spawn=lambda work, _: work.close()),
                note=lambda text, level: told.append((channel, text, level)),
            )  # fmt: skip
            clients.append(self)

        async def __aenter__(self) -> Client:
            return self

        async def __aexit__(self, *_: object) -> None:
            """Nothing ends."""

    async def connect_unix(path: Path) -> str:
        return path.name

    monkeypatch.setattr(run, "AgentClient", Client)
    monkeypatch.setattr(transports, "connect_unix", connect_unix)
    return clients, told


@pytest.mark.parametrize("with_console", [False, True])
async def test_the_processes_of_several_aircraft(
    noted: Noted,
    children: list[Child],
    clients: tuple[list[Any], list[tuple[str, str, str]]],
    with_console: bool,
) -> None:
    agents_of, told = clients
    aircraft = {"left": Settings(sim=True, port=1), "right": Settings(url=URL)}

    def tell(name: str, event: Any) -> None:
        assert (event.number, event.at) == (0, asyncio.get_running_loop().time())
        told.append((name, event.text, event.level))

    async with several(aircraft, with_console=with_console, tell=tell) as one:
        left, right, front = sorted(children, key=lambda one: (one.role, one.called))
        assert [(c.role, c.called) for c in (left, right, front)] == [
            ("agent", "the agent of left"),
            ("agent", "the agent of right"),
            ("fronts", "the fronts"),
        ]
        for place, child, name in ((0, left, "left"), (1, right, "right")):
            found = dict(child.request)
            paths = [Path(found.pop(key)).name for key in ("agent", "orders")]
            assert paths == [f"agent{place}.sock", f"orders{place}.sock"]
            settings = run.agent_settings(aircraft[name])
            assert found == {"name": name, "settings": settings, "place": place}
        assert front.request["settings"]["port"] == 1  # those of the first
        agents = {name: Path(at).name for name, at in front.request["agents"].items()}
        assert agents == {"left": "agent0.sock", "right": "agent1.sock"}
        orders = {name: Path(at).name for name, at in front.request["orders"].items()}
        assert orders == ({"left": "orders0.sock"} if with_console else {})
        assert [(c.channel, c.called) for c in agents_of] == [
            ("agent0.sock", "the station"),
            ("agent1.sock", "the station"),
        ]
        held = [one.has_authority]
        agents_of[1].has_authority = True
        assert [*held, one.has_authority] == [False, True]
        # An agent keeps what happens to its process; without it the station tells.
        right.note("ended", "error")
        agents_of[1].is_gone = True
        right.note("ended", "error")
        front.note("serving again", "info")
        assert told == [
            ("agent1.sock", "ended", "error"),
            ("right", "ended", "error"),
            ("agent0.sock", "serving again", "info"),
            ("right", "serving again", "info"),
        ]
    assert [named for name, _, named in noted if name == "supervised"] == [{"timeout": 15.0}, {}]


@pytest.mark.parametrize(("count", "is_taken"), [(0, False), (8, True), (9, False)])
async def test_a_station_has_up_to_eight_aircraft(
    noted: Noted, children: list[Child], monkeypatch: pytest.MonkeyPatch, count: int, is_taken: bool
) -> None:
    class Enough(Exception):
        """So far it came."""

    def opened(*_: object, **__: object) -> None:
        raise Enough

    monkeypatch.setattr(supervisor, "open_sockets", opened)
    aircraft = {f"a{number}": Settings(sim=True) for number in range(count)}
    with pytest.raises(Enough if is_taken else UsageError):
        async with several(aircraft):
            pass


async def test_nodes_that_cannot_be_are_refused_before_anything_is_opened(
    noted: Noted, children: list[Child]
) -> None:
    aircraft = {name: Settings(sim=True, ros2=True, ros2_domain=233) for name in "ab"}
    with pytest.raises(UsageError, match="there is no domain 233"):
        async with several(aircraft):
            pass
    assert noted.names == []


async def test_in_one_event_loop_all_is_loaded_before_the_aircraft_is_connected(
    noted: Noted, children: list[Child], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To load a front takes a second, in which nobody would hear the aircraft."""
    front = SimpleNamespace(load=noted.call("load"))
    monkeypatch.setattr(run, "FRONTS", {"rosbridge": front})
    fronts = SimpleNamespace(console_path=lambda: "/?code=2", made={"rosbridge": "the bridge"})
    monkeypatch.setattr(run, "serving_fronts", noted.context("serving", fronts))
    async with run.running(Settings(url=URL)) as one:
        bridge: object = one.bridge
        assert (one.console_path(), bridge, one.has_authority) == (
            "/?code=2",
            "the bridge",
            True,
        )
        (_, _, reach, orders), _ = noted.of("serving")
        assert (list(reach), orders) == ([ONLY_NAME], {})
        channel = await reach[ONLY_NAME]()
        ((attached,), _) = noted.of("attach")
        assert channel is not attached
    assert noted.names[:5] == ["open_sockets", "load", "by_url", "agent", "serving"]


# -- what a process does --------------------------------------------------------------------------


@pytest.mark.parametrize(("starts", "leases"), [(0, 0), (1, 1_000_000), (3, 3_000_000)])
@pytest.mark.parametrize("is_virtual", [False, True])
async def test_an_agent_that_is_started_again_grants_other_leases(
    noted: Noted,
    children: list[Child],
    monkeypatch: pytest.MonkeyPatch,
    starts: int,
    leases: int,
    is_virtual: bool,
) -> None:
    owner = SimpleNamespace(
        virtual="virtual" if is_virtual else None,
        service=SimpleNamespace(attach=print, close=noted.call("close")),
    )
    monkeypatch.setattr(run, "owning", noted.context("owning", owner))
    monkeypatch.setattr("m100link.sim.orders.CtlServer", vars(run)["CtlServer"])
    monkeypatch.setattr(process, "serve_unix", noted.context("serve_unix"))
    for name in ("end_with_parent", "log_of", "tell_elsewhere", "leave_what_stays", "answer"):
        monkeypatch.setattr(process, name, noted.call(name))
    ended = Ended()
    ended.set()
    request = {"settings": {"url": URL, "level": 1}, "place": 2, "name": "left", "starts": starts}
    await process._own(request | {"agent": "/x/agent", "orders": "/x/orders"}, ended)
    (settings,), how = noted.of("owning")
    assert (settings.url, settings.level) == (URL, 1)
    assert how == {"place": 2, "leases_before": leases}
    assert noted.of("serve_unix")[0][0] == Path("/x/agent")
    assert noted.of("answer")[1] == {"is_virtual": is_virtual}
    assert noted.of("end_with_parent")[0] == (ended.end,)
    assert noted.of("log_of")[0] == ("left",)
    assert ("orders" in noted.names) is is_virtual
    ends = [name for name in noted.names if name.startswith(("end of", "close"))]
    between = ["end of orders"] if is_virtual else []
    assert ends == ["close", *between, "end of serve_unix", "end of owning"]


AFTER = [
    # agents that have gone, whether the supervisor has, seconds until the fronts end
    ([True], False, 5.0),
    ([True], True, 5.0),
    ([False], True, None),
    ([True, True], False, None),  # each is started again
    ([True, True], True, 5.0),
    ([True, False], True, None),
]


@pytest.mark.parametrize(("gone", "is_alone", "seconds"), AFTER)
async def test_fronts_outlive_the_last_agent_by_five_seconds(
    gone: list[bool], is_alone: bool, seconds: float | None
) -> None:
    loop, left = asyncio.get_running_loop(), list[float]()
    began = loop.time()
    agents = {str(n): SimpleNamespace(is_gone=is_gone) for n, is_gone in enumerate(gone)}
    fronts: Any = SimpleNamespace(
        agents=agents, stop_listening=lambda: left.append(loop.time() - began)
    )
    ended, parent = asyncio.Event(), asyncio.Event()
    if is_alone:
        parent.set()
    loop.call_later(300.0, ended.set)
    await process._until_ended(ended, fronts, parent)
    assert loop.time() - began == pytest.approx(seconds or 300.0, abs=0.5)
    # At once, and once: the next station needs the ports.
    assert len(left) == (seconds is not None)
    assert max(left, default=0.0) < 0.5


# -- a process that is started, and started again -------------------------------------------------


class Started:
    """A process that answers so, runs for so long, and ends so."""

    def __init__(
        self, answer: bytes = b"{}\n", code: int = 1, runs: float = math.inf, stays: float = 0.0
    ) -> None:
        self.asked = b""
        self.pid, self.returncode = 4711, None
        self.signals: list[str] = []
        self._answer, self._code, self._runs, self._stays = answer, code, runs, stays
        self._ended = asyncio.Event()
        self.stdin = self.stdout = self
        if runs < math.inf:
            asyncio.get_running_loop().call_later(runs, self._ended.set)

    def write(self, data: bytes) -> None:
        self.asked += data

    async def drain(self) -> None:
        """All was taken."""

    async def readline(self) -> bytes:
        if not self._answer:
            await asyncio.sleep(1000.0)
        return self._answer

    async def wait(self) -> int:
        await self._ended.wait()
        return self._code

    def terminate(self) -> None:
        self.signals.append("SIGTERM")
        asyncio.get_running_loop().call_later(self._stays, self._ended.set)

    def kill(self) -> None:
        self.signals.append("SIGKILL")
        self._ended.set()


class Machine:
    """Starts these processes one after the other, and notes how and when."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *made: Callable[[], Started]) -> None:
        self.left, self.begun = list(made), list[Started]()
        self.times: list[float] = []
        self.how: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
        self.notes: list[tuple[str, str]] = []
        monkeypatch.setattr(asyncio, "create_subprocess_exec", self._start)

    async def _start(self, *command: Any, **how: Any) -> Any:
        self.times.append(asyncio.get_running_loop().time())
        self.how.append((command, how))
        if not self.left:
            raise OSError("no process more")
        self.begun.append(self.left.pop(0)())
        return self.begun[-1]

    def child(self, **how: Any) -> ChildProcess:
        def note(text: str, level: str) -> None:
            self.notes.append((text, level))

        return ChildProcess("agent", "the agent of left", {"place": 2}, note, **how)


async def test_a_process_is_asked_by_a_line_and_answers_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("M100LINK_KEY", "a secret")
    monkeypatch.setenv("HOME", "/home/anna")
    monkeypatch.setattr(supervisor, "in_force", lambda: None)
    machine = Machine(monkeypatch, lambda: Started(b'{"console_path": "/"}\n'), Started)
    one = machine.child(inherited=(5, 6))
    pids = [one.pid]
    await one.start()
    assert ([*pids, one.pid], one.answer) == ([None, 4711], {"console_path": "/"})
    await one.start()
    asked = [json.loads(begun.asked) for begun in machine.begun]
    log = {"level": "warning", "as_json": False}
    assert asked == [{"place": 2, "starts": starts, "log": log} for starts in (0, 1)]
    assert all(begun.asked.endswith(b"\n") for begun in machine.begun)
    command, how = machine.how[0]
    assert command[1:] == ("-m", "m100link.apps.station.process", "agent")
    assert (how["pass_fds"], how["start_new_session"]) == ((5, 6), True)
    assert how["env"]["HOME"] == "/home/anna"
    assert not [name for name in how["env"] if name.startswith("M100LINK_")]


async def test_a_process_that_loads_before_it_is_asked_is_one_and_ends_without_a_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    machine = Machine(monkeypatch, Started, Started)
    one = machine.child(loads=(5, ["console"], [("a flight.mcap", "")]))
    await one.begin()
    assert machine.how[0][0][3] == "agent"
    assert json.loads(machine.how[0][0][4]) == [5, ["console"], [["a flight.mcap", ""]]]
    one.request["agents"] = {"left": "there"}  # known later
    await one.start()
    (begun,) = machine.begun
    assert json.loads(begun.asked)["agents"] == {"left": "there"}
    other = machine.child()
    await other.begin()
    await other.end()
    assert (machine.begun[1].asked, machine.begun[1].signals) == (b"", ["SIGTERM"])


@pytest.mark.parametrize(
    ("answer", "says", "seconds"),
    [
        (b"", "did not serve within 60 s", 60.0),
        (b"Traceback\n", "the process ended before it served", 0.0),
    ],
)
async def test_a_process_that_does_not_serve_is_named_and_ended(
    monkeypatch: pytest.MonkeyPatch, answer: bytes, says: str, seconds: float
) -> None:
    machine = Machine(monkeypatch, lambda: Started(answer))
    began = asyncio.get_running_loop().time()
    one = machine.child()
    with pytest.raises(M100Error, match=f"the agent of left: .*{says}") as caught:
        await one.start()
    assert "--single-process" in caught.value.remedy
    assert asyncio.get_running_loop().time() - began == pytest.approx(seconds, abs=0.1)
    assert (machine.begun[0].signals, one.pid) == (["SIGTERM"], None)


async def test_a_fault_of_a_process_is_raised_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    fault = asdict(RemoteError.of(UsageError("it cannot be", remedy="so")))
    machine = Machine(monkeypatch, lambda: Started(json.dumps({"fault": fault}).encode()))
    with pytest.raises(UsageError, match="it cannot be") as caught:
        await machine.child().start()
    assert caught.value.remedy == "so"


async def test_it_is_started_again_after_longer_and_longer_pauses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.5, 1, 2, 5 and 10 s; one that ran begins anew."""
    bad = [lambda: Started(b"no\n")] * 6
    good = lambda: Started(code=-9, runs=100.0)  # noqa: E731
    machine = Machine(monkeypatch, good, *bad, lambda: Started(code=3, runs=7.0), Started)
    one = machine.child()
    again: list[float] = []
    loop = asyncio.get_running_loop()
    one.on_restart.append(lambda: again.append(loop.time()))
    await one.start()
    keeping = asyncio.create_task(one.keep())
    await asyncio.sleep(300.0)
    keeping.cancel()
    pauses = [later - earlier for earlier, later in pairwise(machine.times)]
    assert pauses == pytest.approx([100.5, 1.0, 2.0, 5.0, 10.0, 10.0, 10.0, 7.5], abs=0.01)
    assert again == pytest.approx(machine.times[-2:], abs=0.01)
    levels = ["error"] * 7 + ["info", "error", "info"]
    assert [level for _, level in machine.notes] == levels
    texts = [text for text, _ in machine.notes]
    assert texts[0] == "the agent of left ended (SIGKILL), to be started again"
    assert texts[1].startswith("the agent of left: not started: the agent of left: the process")
    assert texts[7:] == [
        "the agent of left: serving again",
        "the agent of left ended (status 3), to be started again",
        "the agent of left: serving again",
    ]
    assert [json.loads(begun.asked)["starts"] for begun in machine.begun] == list(range(9))


@pytest.mark.parametrize(
    ("stays", "timeout", "signals", "seconds"),
    [
        (1.0, None, ["SIGTERM"], 1.0),
        (99.0, None, ["SIGTERM", "SIGKILL"], 5.0),
        (99.0, 15.0, ["SIGTERM", "SIGKILL"], 15.0),
        (14.0, 15.0, ["SIGTERM"], 14.0),
    ],
)
async def test_it_has_time_to_end_in_order(
    monkeypatch: pytest.MonkeyPatch,
    stays: float,
    timeout: float | None,
    signals: list[str],
    seconds: float,
) -> None:
    machine = Machine(monkeypatch, lambda: Started(stays=stays))
    one = machine.child()
    async with supervised(one, timeout=timeout):
        began = asyncio.get_running_loop().time()
    assert asyncio.get_running_loop().time() - began == pytest.approx(seconds, abs=0.01)
    await one.end()  # twice is once
    assert (machine.begun[0].signals, one.pid) == (signals, None)


async def test_where_one_does_not_start_none_runs_on(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, Started, lambda: Started(b"no\n"))
    with pytest.raises(M100Error, match="ended before it served"):
        async with supervised(machine.child(), machine.child()):
            pytest.fail("one of them does not run")
    assert [one.signals for one in machine.begun] == [["SIGTERM"], ["SIGTERM"]]


@pytest.mark.parametrize("error", [None, UsageError("it cannot be", remedy="so")])
def test_a_child_works_until_a_signal_and_tells_its_fault(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], error: M100Error | None
) -> None:
    line = json.dumps({"place": 2, "log": {}})
    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: line))
    asked: list[Any] = []

    async def work(request: dict[str, Any], ended: asyncio.Event) -> None:
        asked.append(request)
        if error is not None:
            raise error
        signal.raise_signal(signal.SIGTERM)
        await ended.wait()
        supervisor.answer(is_virtual=True)

    assert supervisor.run_child(work) == (0 if error is None else 1)
    told = json.loads(capfd.readouterr().out)
    assert asked == [{"place": 2, "log": {}}]
    if error is None:
        assert told == {"is_virtual": True}
    else:
        assert RemoteError(**told["fault"]).error().seen == "it cannot be"


@pytest.mark.parametrize("by", ["a signal", "the end of its supervisor"])
def test_a_child_that_still_waits_for_what_never_comes_ends_in_order(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], by: str
) -> None:
    """A process of a fleet file stayed for as long as its router was silent."""
    read, write = os.pipe()
    stdin = SimpleNamespace(readline=lambda: '{"log": {}}', fileno=lambda: read)
    monkeypatch.setattr("sys.stdin", stdin)
    in_order: list[str] = []

    async def work(_: dict[str, Any], ended: Ended) -> None:
        supervisor.end_with_parent(ended.end)
        if by == "a signal":
            signal.raise_signal(signal.SIGTERM)
        os.close(write)  # the second reason to end cuts nothing short
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.05)
            in_order.append("closed")

    assert supervisor.run_child(work) == 0
    os.close(read)
    assert in_order == ["closed"]
    assert capfd.readouterr() == ("", "")


def test_a_child_that_loaded_for_a_supervisor_that_has_gone_ends(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    async def work(*_: object) -> None:
        pytest.fail("nobody asked for anything")

    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: ""))
    assert supervisor.run_child(work) == 0
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("ending", ["killed as it serves", "gone as it failed"])
def test_a_child_of_a_supervisor_that_was_killed_tells_nobody(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], ending: str
) -> None:
    """It ended by a traceback on the terminal of a station that was there no more."""
    monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: '{"log": {}}'))

    async def work(*_: object) -> None:
        if ending == "gone as it failed":
            raise UsageError("no agent answers", remedy="start the station again")
        supervisor.answer(console_path="/")

    read, write = os.pipe()
    os.close(read)
    before = os.dup(1)
    os.dup2(write, 1)
    try:
        assert supervisor.run_child(work) == (ending == "gone as it failed")
    finally:
        os.dup2(before, 1)
        os.close(before)
        os.close(write)
    assert capfd.readouterr() == ("", "")


async def test_a_child_ends_when_nobody_writes_to_it_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read, write = os.pipe()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: read))
    ended = asyncio.Event()
    supervisor.end_with_parent(ended.set)
    await asyncio.sleep(1.0)
    lives = not ended.is_set()
    os.close(write)
    async with asyncio.timeout(1.0):
        await ended.wait()
    os.close(read)
    assert lives


# -- the way to an agent that is started again ----------------------------------------------------


async def test_an_agent_that_has_gone_is_looked_for_twice_a_second() -> None:
    loop, looked = asyncio.get_running_loop(), list[float]()
    opened: list[str] = []
    agent: Any = SimpleNamespace(is_gone=False, reopen=opened.append)

    async def reach() -> Any:
        looked.append(loop.time() - began)
        if len(looked) < 3:
            raise LinkError("none there")
        agent.is_gone = False
        return "a way"

    began = loop.time()
    keeping = asyncio.create_task(keep_reached(agent, reach))
    await asyncio.sleep(2.2)
    assert looked == []
    agent.is_gone = True
    await asyncio.sleep(4.0)
    keeping.cancel()
    assert looked == pytest.approx([2.5, 3.0, 3.5], abs=0.01)
    assert opened == ["a way"]


@pytest.mark.parametrize(
    ("port", "is_one"), [(-1, False), (0, True), (65_535, True), (65_536, False)]
)
def test_ports_are_numbers_of_16_bits(
    monkeypatch: pytest.MonkeyPatch, port: int, is_one: bool
) -> None:
    bound: list[tuple[str, int]] = []

    def bind(_: object, address: tuple[str, int], *__: object, **___: object) -> Any:
        bound.append(address)
        return SimpleNamespace(listen=lambda _: None)

    monkeypatch.setattr(listeners, "bound", bind)
    settings = Settings(host="192.0.2.1", port=port)
    how: dict[str, Any] = {"with_console": False}
    if is_one:
        listeners.open_sockets(AsyncExitStack(), settings, **how)
        assert bound == [("192.0.2.1", port)]
    else:
        with pytest.raises(UsageError, match=f"there is no port {port}"):
            listeners.open_sockets(AsyncExitStack(), settings, **how)
        assert bound == []


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("apps/station") == []
