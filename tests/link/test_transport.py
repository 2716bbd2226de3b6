"""What can go wrong when a port is opened, each with its own error."""

from __future__ import annotations

import asyncio
import errno
import importlib.metadata
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from m100link.errors import (
    BadURL,
    LinkError,
    PortBusy,
    PortFailed,
    PortNotFound,
    PortPermissionDenied,
)
from m100link.link import Link, connect_in_memory, open_link, transport
from m100link.link import link as opening
from m100link.link.transport import port_owners
from m100link.link.url import ConnectionString, parse_url
from tests.link.peer import Peer, settle
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.anyio, pytest.mark.usefixtures("owners_are_found")]


@pytest.fixture
def anyio_backend() -> str:
    """A thread opens ports, and sockets are the machine's: neither has a virtual clock."""
    return "asyncio"


def _refusing(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)


async def test_a_port_that_is_not_there_lists_what_is(tmp_path: Path) -> None:
    with pytest.raises(PortNotFound, match="there is no device") as caught:
        await open_link(str(tmp_path / "ttyNONE"))
    assert isinstance(caught.value, FileNotFoundError)
    assert "ttyNONE" in caught.value.seen
    assert caught.value.remedy
    assert isinstance(caught.value.__cause__, serial.SerialException)


async def test_the_ports_of_the_machine_are_in_the_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(transport, "serial_ports", lambda: ["/dev/ttyUSB7"])
    with pytest.raises(PortNotFound) as caught:
        await open_link(str(tmp_path / "ttyNONE"))
    assert "/dev/ttyUSB7" in caught.value.remedy
    monkeypatch.setattr(transport, "serial_ports", list)
    with pytest.raises(PortNotFound) as caught:
        await open_link(str(tmp_path / "ttyNONE"))
    assert "dmesg" in caught.value.remedy


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
async def test_a_port_of_another_group_says_which_group(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    _refusing(monkeypatch, serial.SerialException(number, "could not open port"))
    with pytest.raises(PortPermissionDenied, match="may not open /dev/ttyUSB0") as caught:
        await open_link("/dev/ttyUSB0")
    assert isinstance(caught.value, PermissionError)
    assert "dialout" in caught.value.cause
    assert "usermod" in caught.value.remedy


async def test_how_a_port_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """For this program alone, and so that an empty read means that the device is gone."""
    asked: dict[str, object] = {}

    def refuse(device: str, **options: object) -> None:
        asked.update(options, device=device)
        raise OSError(errno.ENOENT, "none")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(PortNotFound):
        await open_link("/dev/ttyUSB0:115200")
    assert asked == {
        "device": "/dev/ttyUSB0",
        "baudrate": 115200,
        "exclusive": True,
        "timeout": 0,
        "inter_byte_timeout": 0,
    }


@pytest.mark.parametrize("number", [errno.EBUSY, errno.EAGAIN])
@pytest.mark.parametrize(
    ("owners", "words"),
    [((), "is in use"), (((4711, "minicom"),), r"in use by minicom \(process 4711\)")],
)
async def test_a_port_in_use_names_its_owner_where_the_system_tells(
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    owners: tuple[tuple[int, str], ...],
    words: str,
) -> None:
    _refusing(monkeypatch, serial.SerialException(number, "locked"))
    monkeypatch.setattr(transport, "port_owners", lambda device: owners)
    with pytest.raises(PortBusy, match=words) as caught:
        await open_link("/dev/ttyUSB0")
    assert caught.value.owners == owners


async def test_the_owners_of_a_port_are_looked_for_beside_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In it they took up to 3.7 s, and ended the flight of another task as TelemetryStalled."""
    looked: list[int] = []

    def owners(_: str) -> tuple[tuple[int, str], ...]:
        looked.append(threading.get_ident())
        return ()

    _refusing(monkeypatch, serial.SerialException(errno.EBUSY, "locked"))
    monkeypatch.setattr(transport, "port_owners", owners)
    with pytest.raises(PortBusy):
        await open_link("/dev/ttyUSB0")
    assert looked
    assert threading.get_ident() not in looked


def test_the_owners_of_a_port_are_looked_for_no_longer_than_a_second(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    held = tmp_path / "held"
    with held.open("w"):
        assert (os.getpid(), Path("/proc/self/comm").read_text().strip()) in port_owners(str(held))
        monkeypatch.setattr(transport, "_LOOK_S", -1.0)
        assert port_owners(str(held)) == ()


def test_the_other_end_of_a_terminal_is_no_owner_of_it_until_it_opens_it_itself() -> None:
    master, slave = os.openpty()
    try:
        name = os.ttyname(slave)
        assert port_owners(name) == ()
        with Path(name).open("rb", buffering=0):
            assert [process for process, _ in port_owners(name)] == [os.getpid()]
    finally:
        os.close(master)
        os.close(slave)


async def test_a_tilde_is_the_home_of_the_user(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "tty").touch()
    with pytest.raises(PortFailed) as caught:
        await open_link("~/tty")
    assert caught.value.seen == f"{tmp_path / 'tty'} is not a serial port"


@pytest.mark.parametrize(
    ("ports", "words"), [([], "machine: none"), (["/dev/ttyUSB7"], "machine: /dev/ttyUSB7")]
)
async def test_what_is_no_port_names_those_that_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ports: list[str], words: str
) -> None:
    monkeypatch.setattr(transport, "serial_ports", lambda: ports)
    with pytest.raises(PortFailed) as caught:
        await open_link(str(tmp_path))
    assert caught.value.remedy.endswith(words)


class SlowLine(asyncio.Transport):
    """A line that opens late, and needs a moment to end."""

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link
        self.is_over = False

    def abort(self) -> None:
        asyncio.get_running_loop().call_later(0.01, self._end)

    def _end(self) -> None:
        self.is_over = True
        self._link.connection_lost(None)


async def test_an_opening_that_is_cut_off_gives_the_line_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[SlowLine] = []

    async def open_late(_: ConnectionString, link: Link) -> SlowLine:
        made.append(SlowLine(link))
        return made[0]

    monkeypatch.setattr(opening, "open_transport", open_late)
    task = asyncio.create_task(open_link("tcp://127.0.0.1:1"))
    await settle()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asyncio.wait_for(task, PATIENCE)
    assert made[0].is_over, "the next program finds it free"


async def test_a_file_is_no_serial_port(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for path in (file, tmp_path, Path("/dev/null")):
        with pytest.raises(PortFailed) as caught:
            await open_link(str(path))
        assert caught.value.seen == f"{path} is not a serial port"
        assert caught.value.cause.startswith("a folder" if path is tmp_path else "a file")
        assert "ports on this machine" in caught.value.remedy


async def test_a_rate_that_the_adapter_does_not_know_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _refusing(monkeypatch, ValueError("Invalid baud rate: 123457"))
    with pytest.raises(PortFailed, match="at 123457 baud") as caught:
        await open_link("/dev/ttyUSB0:123457")
    assert "baud rate" in caught.value.remedy


async def test_any_other_refusal_carries_the_systems_own_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _refusing(monkeypatch, OSError(errno.ENXIO, "No such device or address"))
    with pytest.raises(PortFailed, match=r"cannot be opened: .*No such device or address"):
        await open_link("/dev/ttyUSB0")


async def test_every_refusal_is_a_link_error_and_leaves_the_link_closed(tmp_path: Path) -> None:
    with pytest.raises(LinkError):
        await open_link(str(tmp_path / "none"))


async def test_a_scheme_that_nobody_installed_is_a_bad_url() -> None:
    with pytest.raises(BadURL, match="no transport called 'carrier-pigeon'") as caught:
        await open_link("carrier-pigeon://loft")
    assert "tcp://" in caught.value.remedy


async def test_a_host_that_nobody_knows_is_not_one_that_does_not_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def resolve(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", resolve)
    with pytest.raises(PortFailed, match="no host called ground-sation is known") as caught:
        await open_link("tcp://ground-sation:7000")
    assert "tcp://192.168.1.5:7000" in caught.value.remedy
    monkeypatch.undo()
    with pytest.raises(PortFailed, match=r"no host called no\.\.name is known"):
        await open_link("tcp://no..name:7000")


@pytest.fixture
def plug_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Peer]]:
    """A transport called ``loop``, installed as other packages would install theirs."""
    peers: list[Peer] = []

    async def opener(address: ConnectionString, protocol: asyncio.Protocol) -> asyncio.Transport:
        peers.append(Peer())
        return connect_in_memory(protocol, peers[-1].link)

    class EntryPoint:
        def load(self) -> object:
            return opener

    def entry_points(*, group: str, name: str) -> list[EntryPoint]:
        return [EntryPoint()] if (group, name) == ("m100link.transports", "loop") else []

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    yield peers
    assert importlib.metadata is not None


async def test_a_transport_can_be_plugged_in(plug_in: list[Peer]) -> None:
    link = await open_link(parse_url("loop://anything"))
    assert await link.request(b"x") == b"ack of x"
    assert plug_in[0].data == [b"x"]
    await link.close()


async def test_tcp_carries_frames_both_ways_and_its_end_is_a_lost_link() -> None:
    loop = asyncio.get_running_loop()
    peers: list[Peer] = []

    def accept() -> Link:
        peers.append(Peer())
        return peers[-1].link

    server = await loop.create_server(accept, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    lost = loop.create_future()
    link = await open_link(f"tcp://127.0.0.1:{port}", on_lost=lost.set_result)
    assert await link.request(b"x") == b"ack of x"
    await peers[0].link.close()
    error = await asyncio.wait_for(lost, PATIENCE)
    assert type(error).__name__ == "LinkLost"
    await link.close()
    server.close()
    await server.wait_closed()
    with pytest.raises(PortFailed, match=rf"nothing answers.*Errno {errno.ECONNREFUSED}"):
        await open_link(f"tcp://127.0.0.1:{port}")
