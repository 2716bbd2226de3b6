"""Virtual time, a machine of files, and a line on which anything may be said."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from m100link.doctor.machine import Machine
from m100link.link.memory import connect_in_memory
from m100link.link.url import ConnectionString
from m100link.sim import VirtualClockEventLoop


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


class FakeMachine(Machine):
    """A machine of which a test writes the files.

    Attributes:
        root: Below which they are.
    """

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.root = root

    def write(self, path: str, text: str) -> Path:
        """A file with its folders."""
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        return file

    def run(self, pid: int, *words: str) -> None:
        """A program of that command line."""
        self.write(f"proc/{pid}/cmdline", "\0".join(words) + "\0")
        self.write(f"proc/{pid}/comm", Path(words[0]).name[:15] + "\n")

    def plug_in(self, port: str, driver: str = "ftdi_sio", *, latency: int | None = 16) -> None:
        """An adapter on USB behind a port."""
        usb = self.root / "sys/devices/usb1/1-2"
        place = usb / "1-2:1.0" / port
        place.mkdir(parents=True)
        for name, text in {
            "idVendor": "0403",
            "idProduct": "6001",
            "manufacturer": "FTDI",
            "product": "FT232R USB UART",
            "serial": "A50285BI",
        }.items():
            (usb / name).write_text(text + "\n", encoding="utf-8")
        if latency is not None:
            (place / "latency_timer").write_text(f"{latency}\n", encoding="utf-8")
        known = self.root / "sys/bus/drivers" / driver
        known.mkdir(parents=True)
        (place / "driver").symlink_to(known)
        terminal = self.root / "sys/class/tty" / port
        terminal.mkdir(parents=True)
        (terminal / "device").symlink_to(place)


@pytest.fixture
def machine(tmp_path: Path) -> FakeMachine:
    return FakeMachine(tmp_path)


class Speaker(asyncio.Protocol):
    """The other end of a line: says something again and again, and answers.

    Args:
        text: What it says, every 100 ms.
        answer: What it says to what it hears.
    """

    def __init__(self, text: bytes, answer: Callable[[bytes], bytes] = lambda _: b"") -> None:
        self._text, self._answer = text, answer
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._say()

    def data_received(self, data: bytes) -> None:
        assert self._transport is not None
        self._transport.write(self._answer(data))

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None

    def _say(self) -> None:
        if self._transport is not None:
            self._transport.write(self._text)
            asyncio.get_running_loop().call_later(0.1, self._say)


Speak = Callable[..., None]


@pytest.fixture
def speak(monkeypatch: pytest.MonkeyPatch) -> Speak:
    """Replaces what is at the other end of every line that is opened to listen."""

    def replace(text: bytes, answer: Callable[[bytes], bytes] = lambda _: b"") -> None:
        async def open_transport(
            address: ConnectionString, protocol: asyncio.Protocol
        ) -> asyncio.Transport:
            return connect_in_memory(protocol, Speaker(text, answer))

        monkeypatch.setattr("m100link.doctor.port.open_transport", open_transport)

    return replace
