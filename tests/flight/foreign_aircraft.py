"""An aircraft that shares no line with the library or its simulator: they may agree on mistakes.

Frames by the rules of the golden vectors' README and of DJI's code of 2015, with checksums of its
own; behind a pseudo-terminal with a thread, in real time, or a cable in memory, by the clock of the
event loop. It stands in the air, answers version, activation, authority, tasks and missions,
streams telemetry, and notes each movement with its time and whether a Matrice would have obeyed it.
"""

from __future__ import annotations

import asyncio
import functools
import math
import os
import random
import select
import struct
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, cast

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from tests.flight.foreign_missions import (
    COS_LATITUDE,
    EARTH_M,
    LATITUDE_DEG,
    LONGITUDE_DEG,
    ForeignMissions,
)

APP_ID, KEY = 77, bytes(range(32, 64))
PERIOD_S = 0.02
RC, APP, ONBOARD = 0, 1, 2
STANDBY, IN_AIR, LANDING, GOING_HOME = 1, 3, 4, 6
SINK_M_S = 3.0
MODE_P, MODE_F = -8000, 8000
VERSION_NAMES = {
    "1.0": b"SDK v1.0 M100",
    "2.3": b"SDK-v1.0 BETA M100-02.03.10.00",
    "3.1": b"SDK-v1.0 BETA M100-03.01.01.00",
}
ITEMS = {"time": 0, "position": 5, "rc": 7, "status": 9, "battery": 10, "device": 11}


def checksum(data: bytes, polynomial: int) -> int:
    """Reflected, start 0x3AA3, no final xor: 0xA001 for the header, 0xEDB88320 for the frame."""
    register, table = 0x3AA3, remainders(polynomial)
    for byte in data:
        register = register >> 8 ^ table[(register ^ byte) & 0xFF]
    return register


@functools.cache
def remainders(polynomial: int) -> list[int]:
    """What each byte leaves, bit by bit."""
    table = list(range(256))
    for _ in range(8):
        table = [one >> 1 ^ (polynomial if one & 1 else 0) for one in table]
    return table


def frame(data: bytes, *, session: int = 0, sequence: int = 0, is_ack: bool = False) -> bytes:
    """A plain frame."""
    length = len(data) + 16
    header = struct.pack(
        "<BHBB3xH", 0xAA, length, session | is_ack << 5, 0, sequence
    )  # version 0 in the upper bits of the length
    header += struct.pack("<H", checksum(header, 0xA001))
    return header + data + struct.pack("<I", checksum(header + data, 0xEDB88320))


class Movement(NamedTuple):
    """A movement command that arrived."""

    at: float  # by time.monotonic
    values: tuple[float, float, float, float]  # roll or x, pitch or y, throttle or z, yaw
    is_obeyed: bool  # the aircraft was under onboard control


class ForeignMatrice:
    """An aircraft that gets bytes and gives some; what carries them is for others.

    The attributes below may be set at any time; it looks at them fifty times a second.

    Attributes:
        mode: Mode switch of the remote controller, ``MODE_F`` or ``MODE_P``.
        device: Who has control, ``RC``, ``APP`` or ``ONBOARD``.
        items: Telemetry items that are sent.
        latitude_deg: What the position item says.
        status: Flight status.
        while_obtaining: What the pilot does when the request for authority is granted: nothing, or
            leaves F while its ack is lost (``"lost ack"``) or travels in one piece with the
            notification (``"one chunk"``).
        battery: Charge, percent.
        movements: Every movement command, oldest first.
        releases: Requests to release that arrived.
        tasks: Flight mode commands that arrived: 4 take-off, 6 land, 1 go home.
        missions: What it flies by itself.
    """

    def __init__(self, firmware: str = "1.0") -> None:
        self.firmware = firmware
        self.mode, self.device, self.status = MODE_F, RC, IN_AIR
        self.items = {"time", "position", "rc", "status", "battery"}
        self.latitude_deg = LATITUDE_DEG
        self.battery = 80
        self.while_obtaining = ""
        self.movements: list[Movement] = []
        self.releases = 0
        self.tasks: list[int] = []
        self.missions = ForeignMissions()
        self._asked = 0  # firmware from 2.3 on answers the first request "in progress"
        self._key: bytes | None = None
        self._stored: dict[int, tuple[int, bytes]] = {}
        self._buffer = b""
        self._lands_at = self._took_off_at = math.inf
        self._next_at = -math.inf
        self._flown_north = self._flown_east = 0.0  # by movements, m
        self._moves_until = -math.inf
        self._moves = 0.0, 0.0

    def now(self) -> float:
        """Seconds by the clock that it lives by."""
        raise NotImplementedError

    def _write(self, data: bytes) -> None:
        raise NotImplementedError

    def leave_f(self) -> None:
        """The pilot takes over."""
        self.mode = MODE_P
        if self.device == ONBOARD:
            self.device = RC
            self.missions.break_off(0xD0)
            self._write(frame(b"\x02\x01\x04"))

    def take_by_app(self) -> None:
        """The app takes over."""
        self.device = APP
        self.missions.break_off(0xD1)
        self._write(frame(b"\x02\x01\x04"))

    def step(self) -> None:
        """A fiftieth of a second has passed: fly, and tell."""
        now = self.now()
        self._next_at = max(self._next_at + PERIOD_S, now)
        if now >= self._lands_at:
            self.status, self._lands_at, self.missions.height = STANDBY, math.inf, 0.0
        # It does not fall: a position that jumps is none that the library believes.
        self.missions.height = min(self.missions.height, (self._lands_at - now) * SINK_M_S)
        if now >= self._took_off_at:
            self.status, self._took_off_at, self.missions.height = IN_AIR, math.inf, 1.2
        if now < self._moves_until and self.status == IN_AIR:
            self._flown_north += self._moves[0] * PERIOD_S
            self._flown_east += self._moves[1] * PERIOD_S
        if self.missions.advance(PERIOD_S) == "land":
            self._land(now)
        self._write(frame(b"\x02\x00" + self._telemetry(now)))
        for push in self.missions.pushes():
            self._write(frame(push))

    def _land(self, now: float) -> None:
        self.status = LANDING
        self._lands_at = now + max(0.5, self.missions.height / SINK_M_S)

    def receive(self, data: bytes) -> None:
        """Bytes came."""
        self._buffer += data
        while (start := self._buffer.find(b"\xaa")) >= 0:
            self._buffer = self._buffer[start:]
            if len(self._buffer) < 12:
                return
            _, length, flags, padding, sequence = struct.unpack("<BHBB3xH", self._buffer[:10])
            if checksum(self._buffer[:12], 0xA001) or not 16 < length < 1024:
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < length:
                return
            whole, self._buffer = self._buffer[:length], self._buffer[length:]
            data = whole[12:-4]
            if checksum(whole, 0xEDB88320) or flags & 0x20:
                continue  # damaged, or an ack of our notification
            if padding >> 5:
                if self._key is None:
                    continue
                decryptor = Cipher(algorithms.AES(self._key), modes.ECB()).decryptor()
                data = decryptor.update(data)[: len(data) - (padding & 0x1F)]
            self._take(flags & 0x1F, sequence, data[0], data[1], data[2:])

    def _take(self, session: int, sequence: int, group: int, number: int, value: bytes) -> None:
        if session > 1 and session in self._stored and self._stored[session][0] == sequence:
            self._write(self._stored[session][1])  # a repeated number is not executed again
            return
        answer = self._execute(group, number, value)
        if answer is None or session == 0:
            return
        ack = frame(answer, session=session, sequence=sequence, is_ack=True)
        self._stored[session] = sequence, ack
        happening = self.while_obtaining
        if (group, number) == (1, 0) and self.device == ONBOARD and happening:
            self.while_obtaining, self.mode, self.device = "", MODE_P, RC
            self._write((b"" if happening == "lost ack" else ack) + frame(b"\x02\x01\x04"))
        else:
            self._write(ack)

    def _execute(self, group: int, number: int, value: bytes) -> bytes | None:
        if (group, number) == (0, 0):
            return self._version()
        if (group, number) == (0, 1):
            self._key = KEY
            return b"\0\0"
        if (group, number) == (1, 3):
            flag_and_values = struct.unpack("<B4f", value)
            now = self.now()
            is_obeyed = self.device == ONBOARD and not self.missions.flying
            self.movements.append(Movement(now, flag_and_values[1:], is_obeyed))
            if is_obeyed and flag_and_values[0] & 0xC2 == 0x40:  # by velocity, ground frame
                self._moves, self._moves_until = flag_and_values[1:3], now + 0.5
            return None
        if (group, number) == (1, 0):
            return struct.pack("<H", self._authority(is_wanted=value == b"\1"))
        if (group, number) == (1, 1):
            self.tasks.append(value[1])
            if value[1] == 4:
                self._took_off_at = self.now() + 0.5
            elif value[1] == 6:
                self.missions.break_off(0xF1)
                self._land(self.now())
            return b"\2\0"
        if (group, number) == (1, 2):
            is_over = self._lands_at == self._took_off_at == math.inf
            return b"\5\0" if is_over else b"\3\0"
        if group == 3 and self.firmware == "3.1":
            is_ours = self.device == ONBOARD
            return self.missions.execute(number, value, is_ours=is_ours, status=self.status)
        return b"\0\xff"

    def _authority(self, *, is_wanted: bool) -> int:
        self.releases += not is_wanted
        if is_wanted and self.mode != MODE_F:
            return 3 if self.firmware == "1.0" else 0
        self._asked += 1
        if self.firmware != "1.0" and self._asked % 2:
            return 3 if is_wanted else 4
        self.device = ONBOARD if is_wanted else RC
        if not is_wanted:
            self.missions.break_off(0xD1)
        return 2 if is_wanted else 1

    def _version(self) -> bytes:
        name = VERSION_NAMES[self.firmware]
        code = b"\0\0" if self._key else b"\x01\xff"
        serial = b"041DABCDEF\0" if self.firmware == "3.1" else b""
        return (
            code
            + struct.pack("<I", checksum(name + b"\0", 0xEDB88320))
            + serial
            + (name.ljust(32, b"\0"))
        )

    def _telemetry(self, now: float) -> bytes:
        rate = 400 if self.firmware == "3.1" else 600
        tick = struct.pack("<I", int(now * rate) & 0xFFFFFFFF)
        missions = self.missions
        north, east = missions.north + self._flown_north, missions.east + self._flown_east
        latitude = self.latitude_deg + math.degrees(north / EARTH_M)
        longitude = LONGITUDE_DEG + math.degrees(east / EARTH_M) / COS_LATITUDE
        place = math.radians(latitude), math.radians(longitude), 400.0, missions.height, 5
        device = self.device | (self.device == ONBOARD) << 3
        values = {
            "time": tick + (bytes(5) if self.firmware == "3.1" else b""),
            "position": struct.pack("<ddffB", *place),
            "rc": struct.pack("<6h", 0, 0, 0, 0, self.mode, -10000),
            "status": bytes([self.status]),
            "battery": bytes([self.battery]),
            "device": {"1.0": bytes([self.device]), "2.3": bytes([device])}.get(
                self.firmware, bytes([0, device])
            ),
        }
        items = [name for name in ITEMS if name in self.items]
        flags = sum(1 << ITEMS[name] for name in items)
        return struct.pack("<H", flags) + b"".join(values[name] for name in items)


class ForeignAircraft(ForeignMatrice):
    """One at the other end of the port :attr:`name`, in a thread, in real time."""

    def __init__(self, firmware: str = "1.0") -> None:
        super().__init__(firmware)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name = os.ttyname(self._slave)
        self.is_mute = False  # a wire is broken
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="foreign aircraft", daemon=True)
        self._thread.start()

    def now(self) -> float:
        return time.monotonic()

    def close(self) -> None:
        """Unplug it."""
        self._is_over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def wait_for(self, what: str, count: int, timeout: float = 10.0) -> None:
        """Wait until the list or counter of that name has so many."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            value = getattr(self, what)
            if (value if isinstance(value, int) else len(value)) >= count:
                return
            time.sleep(0.005)
        raise TimeoutError(f"{count} {what} did not come, {getattr(self, what)!r} did")

    def _run(self) -> None:
        while not self._is_over.is_set():
            if self.now() >= self._next_at:
                self.step()
            if select.select([self._master], [], [], max(0.0, self._next_at - self.now()))[0]:
                self.receive(os.read(self._master, 4096))

    def _write(self, data: bytes) -> None:
        if self.is_mute:
            return
        if select.select([], [self._master], [], 0.0)[1]:  # a reader that hangs loses bytes
            os.write(self._master, data)


class ForeignInMemory(ForeignMatrice, asyncio.Protocol):
    """One at the other end of a cable in memory, on the time of the event loop.

    Args:
        loss: Which part of the frames is lost, in either direction.
        seed: Of the losses.
    """

    def __init__(self, firmware: str = "3.1", *, loss: float = 0.0, seed: int = 1) -> None:
        super().__init__(firmware)
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.WriteTransport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._chance = random.Random(seed)
        self.loss = loss
        self.is_deaf = self.is_mute = False  # a wire is broken

    def now(self) -> float:
        return self._loop.time()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.WriteTransport", transport)
        self._tick()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None

    def data_received(self, data: bytes) -> None:
        if not self.is_deaf and self._chance.random() >= self.loss:
            self.receive(data)

    def _tick(self) -> None:
        """It flies on when the cable is gone."""
        self.step()
        self._timer = self._loop.call_later(PERIOD_S, self._tick)

    def _write(self, data: bytes) -> None:
        is_lost = self.is_mute or self._chance.random() < self.loss
        if self._transport is not None and not is_lost:
            self._transport.write(data)

    def unplug(self) -> None:
        """The cable is pulled."""
        if self._transport is not None:
            self._transport.close()

    def close(self) -> None:
        """Its time stands still."""
        if self._timer is not None:
            self._timer.cancel()


@contextmanager
def foreign_aircraft(firmware: str = "1.0") -> Iterator[ForeignAircraft]:
    """One for the time of a block."""
    aircraft = ForeignAircraft(firmware)
    try:
        yield aircraft
    finally:
        aircraft.close()
