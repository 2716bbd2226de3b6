"""An aircraft that shares no line with the library or its simulator: they may agree on mistakes.

Frames by the rules of the golden vectors' README and of DJI's code of 2015, with checksums of its
own; a pseudo-terminal and a thread, real time. It stands in the air, answers version, activation,
authority and tasks, streams telemetry, and notes each movement with its time and whether a Matrice
would have obeyed it.
"""

from __future__ import annotations

import math
import os
import select
import struct
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

APP_ID, KEY = 77, bytes(range(32, 64))
PERIOD_S = 0.02
RC, APP, ONBOARD = 0, 1, 2
STANDBY, IN_AIR, LANDING = 1, 3, 4
MODE_P, MODE_F = -8000, 8000
VERSION_NAMES = {
    "1.0": b"SDK v1.0 M100",
    "2.3": b"SDK-v1.0 BETA M100-02.03.10.00",
    "3.1": b"SDK-v1.0 BETA M100-03.01.01.00",
}
ITEMS = {"time": 0, "position": 5, "rc": 7, "status": 9, "battery": 10, "device": 11}


def checksum(data: bytes, polynomial: int) -> int:
    """Reflected, start 0x3AA3, no final xor: 0xA001 for the header, 0xEDB88320 for the frame."""
    register = 0x3AA3
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (polynomial if register & 1 else 0)
    return register


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


class ForeignAircraft:
    """What stands at the other end of the port :attr:`name`.

    The attributes below may be set at any time; the thread looks at them fifty times a second.

    Attributes:
        mode: Mode switch of the remote controller, ``MODE_F`` or ``MODE_P``.
        device: Who has control, ``RC``, ``APP`` or ``ONBOARD``.
        items: Telemetry items that are sent.
        latitude_deg: What the position item says.
        status: Flight status.
        while_obtaining: What the pilot does when the request for authority is granted: nothing, or
            leaves F while its ack is lost (``"lost ack"``) or travels in one piece with the
            notification (``"one chunk"``).
        movements: Every movement command, oldest first.
        releases: Requests to release that arrived.
        tasks: Flight mode commands that arrived: 4 take-off, 6 land, 1 go home.
    """

    def __init__(self, firmware: str = "1.0") -> None:
        self.firmware = firmware
        self.mode, self.device, self.status = MODE_F, RC, IN_AIR
        self.items = {"time", "position", "rc", "status", "battery"}
        self.latitude_deg = 47.0
        self.while_obtaining = ""
        self.movements: list[Movement] = []
        self.releases = 0
        self.tasks: list[int] = []
        self._asked = 0  # firmware from 2.3 on answers the first request "in progress"
        self._key: bytes | None = None
        self._stored: dict[int, tuple[int, bytes]] = {}
        self._buffer = b""
        self._landed_at = math.inf
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name = os.ttyname(self._slave)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="foreign aircraft", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug it."""
        self._is_over.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def leave_f(self) -> None:
        """The pilot takes over."""
        self.mode = MODE_P
        if self.device == ONBOARD:
            self.device = RC
            self._write(frame(b"\x02\x01\x04"))

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
        next_at = time.monotonic()
        while not self._is_over.is_set():
            now = time.monotonic()
            if now >= next_at:
                next_at = max(next_at + PERIOD_S, now)
                self._write(frame(b"\x02\x00" + self._telemetry(now)))
                if now >= self._landed_at:
                    self.status, self._landed_at = STANDBY, math.inf
            if select.select([self._master], [], [], max(0.0, next_at - time.monotonic()))[0]:
                self._buffer += os.read(self._master, 4096)
                self._decode()

    def _write(self, data: bytes) -> None:
        if select.select([], [self._master], [], 0.0)[1]:  # a reader that hangs loses bytes
            os.write(self._master, data)

    def _decode(self) -> None:
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
            now, is_obeyed = time.monotonic(), self.device == ONBOARD
            self.movements.append(Movement(now, flag_and_values[1:], is_obeyed))
            return None
        if (group, number) == (1, 0):
            return struct.pack("<H", self._authority(is_wanted=value == b"\1"))
        if (group, number) == (1, 1):
            self.tasks.append(value[1])
            if value[1] == 6:
                self.status, self._landed_at = LANDING, time.monotonic() + 0.5
            return b"\2\0"
        if (group, number) == (1, 2):
            return b"\5\0" if self._landed_at == math.inf else b"\3\0"
        return b"\0\xff"

    def _authority(self, *, is_wanted: bool) -> int:
        self.releases += not is_wanted
        if is_wanted and self.mode != MODE_F:
            return 3 if self.firmware == "1.0" else 0
        self._asked += 1
        if self.firmware != "1.0" and self._asked % 2:
            return 3 if is_wanted else 4
        self.device = ONBOARD if is_wanted else RC
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
        place = math.radians(self.latitude_deg), math.radians(8.0), 400.0, 5.0, 5
        device = self.device | (self.device == ONBOARD) << 3
        values = {
            "time": tick + (bytes(5) if self.firmware == "3.1" else b""),
            "position": struct.pack("<ddffB", *place),
            "rc": struct.pack("<6h", 0, 0, 0, 0, self.mode, -10000),
            "status": bytes([self.status]),
            "battery": b"\x50",
            "device": {"1.0": bytes([self.device]), "2.3": bytes([device])}.get(
                self.firmware, bytes([0, device])
            ),
        }
        items = [name for name in ITEMS if name in self.items]
        flags = sum(1 << ITEMS[name] for name in items)
        return struct.pack("<H", flags) + b"".join(values[name] for name in items)


@contextmanager
def foreign_aircraft(firmware: str = "1.0") -> Iterator[ForeignAircraft]:
    """One for the time of a block."""
    aircraft = ForeignAircraft(firmware)
    try:
        yield aircraft
    finally:
        aircraft.close()
