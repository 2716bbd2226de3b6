"""The registry of listeners: sockets reach their front by name, and none is forgotten."""

from __future__ import annotations

import asyncio
import random
import socket
from contextlib import AsyncExitStack
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import pytest

from m100link.apps.station import listeners
from m100link.apps.station.config import Settings
from m100link.apps.station.listeners import FRONTS, Fronts, FrontSpec, Sockets, open_sockets
from m100link.errors import LinkLost, M100Error, PortBusy, PortFailed, UsageError, usage

pytestmark = pytest.mark.anyio


class Fake:
    """A front that takes its sockets, or forgets to."""

    def __init__(self, name: str, *, takes: bool = True) -> None:
        self.name, self.takes = name, takes
        self.ports: list[int] = []

    async def serve(self, fronts: Fronts) -> None:
        if self.takes:
            self.ports = [one.getsockname()[1] for one in fronts.take(self.name)]


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Fake]:
    made = {name: Fake(name) for name in ("one", "two", "three")}
    rows = {name: FrontSpec(name, name, lambda _: (0,)) for name in made}
    monkeypatch.setattr(listeners, "FRONTS", rows)
    monkeypatch.setattr(FrontSpec, "load", lambda row: made[row.name])
    return made


async def serve(sockets: Sockets) -> None:
    async with AsyncExitStack() as stack:
        for row in sockets.of.values():
            for one in row:
                stack.callback(one.close)
        await Fronts(stack, Settings(), sockets, {}, {}, is_kept=False).serve()


def test_each_row_names_a_module_that_serves() -> None:
    for name, row in FRONTS.items():
        assert name == row.name
        module = row.load()
        assert callable(module.serve), name
        assert hasattr(module, "prepare") is row.prepares, name
        assert row.beside in ("", *FRONTS), name


def test_each_port_of_the_settings_is_of_a_front() -> None:
    """Else it could be set, and nobody would listen there."""
    for name in (one.name for one in fields(Settings)):
        if name.endswith(("port", "ports")):
            port: Any = (4711,) if name.endswith("s") else 4711
            settings = replace(Settings(), **{name: port})
            listening = {port for row in FRONTS.values() for port in row.ports(settings) or ()}
            assert 4711 in listening, name


async def test_sockets_reach_their_front_by_name_in_whatever_order(
    fakes: dict[str, Fake],
) -> None:
    drawn = random.Random(30)
    for _ in range(20):
        names = drawn.sample(sorted(fakes), drawn.randrange(4))
        made = {
            name: [socket.create_server(("127.0.0.1", 0)) for _ in range(drawn.randrange(1, 3))]
            for name in names
        }
        opened = Sockets(made)
        wanted = {name: opened.ports(name) for name in names}
        for fake in fakes.values():
            fake.ports = []
        handed = opened.descriptors()
        # As another process gets them: duplicates of the same sockets, by name.
        copies = {
            name: [socket.fromfd(one, socket.AF_INET, socket.SOCK_STREAM).detach() for one in row]
            for name, row in handed.items()
        }
        await serve(Sockets.inherited(copies))
        assert {fake.name: fake.ports for fake in fakes.values() if fake.ports} == wanted
        for row in made.values():
            for one in row:
                one.close()


async def test_sockets_that_a_front_forgets_end_the_start_and_are_named(
    fakes: dict[str, Fake],
) -> None:
    fakes["two"].takes = False
    made = {name: [socket.create_server(("127.0.0.1", 0))] for name in fakes}
    with pytest.raises(M100Error, match="two: its module serves nobody"):
        await serve(Sockets(made))


async def test_sockets_without_a_row_end_the_start_and_are_named(fakes: dict[str, Fake]) -> None:
    made = {name: [socket.create_server(("127.0.0.1", 0))] for name in ("one", "four")}
    with pytest.raises(M100Error, match="'four', which is no front"):
        await serve(Sockets(made))
    assert fakes["one"].ports == []


def opened(settings: Settings, *, console: bool = False, rosbridge: bool = True) -> dict[str, int]:
    found = open_sockets(AsyncExitStack(), settings, with_console=console, with_rosbridge=rosbridge)
    for row in found.of.values():
        for one in row:
            one.close()
    return {name: len(row) for name, row in found.of.items()}


def test_what_is_opened_is_what_the_command_and_the_settings_ask_for(
    caplog: pytest.LogCaptureFixture,
) -> None:
    plain = Settings(port=0, console_port=0)
    assert opened(plain) == {"rosbridge": 1}
    assert opened(plain, console=True, rosbridge=False) == {"console": 1}
    every = Settings(
        port=0, also_ports=(0,), console_port=0, metrics_port=0, foxglove_port=0,
        mavlink=("udp://127.0.0.1:0",),
    )  # fmt: skip
    assert opened(every, console=True) == {
        "rosbridge": 2, "console": 1, "mavlink": 1, "metrics": 1, "foxglove": 1,
    }  # fmt: skip
    # Nothing serves the numbers without rosbridge: their port stays closed.
    assert "metrics" not in opened(every, rosbridge=False)
    assert "metrics: not served, for that needs rosbridge" in caplog.text


@pytest.mark.parametrize("setting", ["port", "console_port", "metrics_port", "foxglove_port"])
async def test_the_remedy_for_a_port_that_is_taken_names_the_option_of_that_port(
    setting: str,
) -> None:
    own = {"metrics_port": "--metrics", "foxglove_port": "--foxglove"}  # as the command has them
    with socket.create_server(("127.0.0.1", 0)) as other:
        ports = {"port": 0, "console_port": 0} | {setting: other.getsockname()[1]}
        async with AsyncExitStack() as stack:
            with pytest.raises(PortBusy) as busy:
                open_sockets(stack, replace(Settings(), **ports), with_console=True)
    option = own.get(setting, f"--{setting.replace('_', '-')}")
    assert busy.value.remedy == f"end it, or choose another {option}"


def test_no_tcp_port_is_bound_when_the_settings_of_a_front_cannot_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bound: list[object] = []
    monkeypatch.setattr(listeners, "bound", lambda _, address, *__, **___: bound.append(address))
    with pytest.raises(UsageError, match="other machines"):
        opened(Settings(mavlink=("udp://0.0.0.0:14550",)))
    assert bound == []


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> SimpleNamespace:
        raise ModuleNotFoundError("No module named 'prometheus_client'", name="prometheus_client")

    monkeypatch.setattr(usage, "import_module", missing)
    with pytest.raises(UsageError, match="metrics needs prometheus_client, which is not installed"):
        FRONTS["metrics"].load()


async def test_a_port_that_is_taken_and_an_address_of_others_have_their_own_errors() -> None:
    said = {"busy": "another bridge listens there", "remedy": "give another port"}
    async with AsyncExitStack() as stack:
        one = listeners.bound(stack, ("127.0.0.1", 0), socket.SOCK_DGRAM, **said)
        with pytest.raises(PortBusy, match="cannot be served") as busy:
            listeners.bound(stack, one.getsockname(), socket.SOCK_DGRAM, **said)
        assert (busy.value.cause, busy.value.remedy) == (said["busy"], said["remedy"])
        with pytest.raises(PortFailed, match=r"192\.0\.2\.1:0 cannot be served") as failed:
            # For documentation: no machine has it (RFC 5737).
            listeners.bound(stack, ("192.0.2.1", 0), socket.SOCK_DGRAM, **said)
    assert not isinstance(failed.value, PortBusy)
    assert (failed.value.cause, failed.value.remedy) == ("", said["remedy"])


async def test_a_front_without_memory_for_a_moment_finds_the_next_agent_all_the_same() -> None:
    """Or its STOP would go to nobody for good."""
    found: list[object] = []
    agent: Any = SimpleNamespace(is_gone=True, reopen=found.append)
    answers: list[object] = [MemoryError(), LinkLost("no agent"), "the next agent"]

    async def reach() -> Any:
        answer = answers.pop(0)
        if isinstance(answer, BaseException):
            raise answer
        agent.is_gone = False
        return answer

    looking = asyncio.ensure_future(listeners.keep_reached(agent, reach))
    await asyncio.wait([looking], timeout=4 * listeners.REACH_PAUSE)
    looking.cancel()
    assert found == ["the next agent"]
