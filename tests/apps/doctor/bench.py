"""A machine of files, a line on which anything may be said, and a bench where both are broken."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.doctor.machine import Machine, Permission, Process
from m100link.link.transport import connect_in_memory
from m100link.link.url import ConnectionString
from m100link.sim import VirtualAircraft
from m100link.sim.orders import perform
from m100link.sim.ports.driver import aircraft_of
from m100link.wire import encode_frame

TELEMETRY = encode_frame(bytes([2, 0, *range(80)]), session=0, sequence=7)

GPS = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n" * 4
CONSOLE = b"[    3.141592] usb 1-1: new device\r\nraspberrypi login: "


def mavlink(start: int, overhead: int) -> bytes:
    """Heartbeats."""
    return bytes([start, 9, *range(overhead - 2 + 9)]) * 6


class FakeMachine(Machine):
    """A machine of which a test writes the files.

    Attributes:
        root: Below which they are.
        locks: Files that another program holds locked.
    """

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.root = root
        self.locks: list[int] = []

    def unlock(self) -> None:
        """Let the other program go."""
        while self.locks:
            os.close(self.locks.pop())

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

    def close(self) -> None:
        """Hang up."""
        if self._transport is not None:
            self._transport.close()

    def _say(self) -> None:
        if self._transport is not None:
            self._transport.write(self._text)
            asyncio.get_running_loop().call_later(0.1, self._say)


class Bench:
    """Where a set-up is broken.

    Attributes:
        machine: What the machine shows of itself; a test writes it.
        port: A terminal that exists.
        patch: Changes modules until the set-up is whole again.
    """

    def __init__(self, patch: pytest.MonkeyPatch, machine: FakeMachine, port: str) -> None:
        self.patch = patch
        self.machine, self.port = machine, port

    def order(self, *orders: str, at: float = 0.0, make: Any = aircraft_of) -> None:
        """Give orders to each virtual aircraft that a URL makes, at once or later."""

        def made(url: str) -> VirtualAircraft:
            aircraft: VirtualAircraft = make(url)
            for order in orders:
                if at:
                    asyncio.get_running_loop().call_later(at, perform, aircraft, order)
                else:
                    perform(aircraft, order)
            return aircraft

        self.patch.setattr("m100link.sim.ports.driver.aircraft_of", made)

    def speak(
        self,
        said: bytes = b"",
        answer: Callable[[bytes], bytes] = lambda _: b"",
        *,
        rate: int | None = None,
        closes: bool = False,
    ) -> None:
        """Replace what is at the other end; at other rates than its own all is garbled."""

        async def open_transport(
            address: ConnectionString, protocol: asyncio.Protocol
        ) -> asyncio.Transport:
            is_right = rate is None or address.number == rate
            speaker = Speaker(said if is_right else garbled(said), answer)
            transport = connect_in_memory(protocol, speaker)
            if closes:
                asyncio.get_running_loop().call_later(0.01, speaker.close)
            return transport

        self.patch.setattr("m100link.apps.doctor.port.open_transport", open_transport)

    def forbid(self, group: str, *, is_member: bool = False) -> None:
        """Take the permission to open the port."""
        refused = Permission("crw-rw----", "root", group, is_granted=False, is_member=is_member)
        self.patch.setattr(self.machine, "permission", lambda _: refused)

    def give_to(self, process: Process) -> None:
        """Have another program open it."""
        self.patch.setattr(self.machine, "holders", lambda _: (process,))


def garbled(data: bytes) -> bytes:
    """Something like what a UART makes of another rate."""
    return bytes((byte * 0x1D ^ 0xE6 ^ index * 7) & 0xFF for index, byte in enumerate(data))
