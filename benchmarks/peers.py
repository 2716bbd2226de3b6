"""pymavlink on messages of like size, with its faster checksum fastcrc where that is installed."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Iterable
from typing import Any

from benchmarks.rows import Absent, Side, timed

IMU = "pymavlink HIGHRES_IMU"
MIX = "pymavlink mix of four kinds"
PACK = "pymavlink SET_POSITION_TARGET encode + pack"
MISSING = "pymavlink is not installed"


def dialect() -> Any | None:
    """pymavlink's messages, None where it is not installed."""
    if importlib.util.find_spec("pymavlink") is None:
        return None
    return importlib.import_module("pymavlink.dialects.v20.common")


def mix(mavlink: Any, count: int) -> list[bytes]:
    """That many messages of four kinds as bytes of the line, 120 on average."""
    wave = [0.5 + n / 7 for n in range(21)]
    kinds = [
        mavlink.MAVLink_highres_imu_message(10**12, *wave[:13], 0x1FFF, 1),
        mavlink.MAVLink_attitude_quaternion_cov_message(10**12, wave[:4], 0.1, 0.2, 0.3, wave[:9]),
        mavlink.MAVLink_odometry_message(
            10**12, 1, 8, *wave[:3], wave[:4], *wave[:6], wave, wave, 1, 1, 90
        ),
        mavlink.MAVLink_hil_state_quaternion_message(
            10**12, wave[:4], 0.1, 0.2, 0.3, 225000000, 1139000000, 31500, *range(150, 158)
        ),
    ]
    return packed(mavlink, (kinds[number % 4] for number in range(count)))


def imu(mavlink: Any, count: int) -> list[bytes]:
    """That many HIGHRES_IMU messages as bytes of the line, 74 each."""
    wave = [0.5 + n / 7 for n in range(13)]
    one = mavlink.MAVLink_highres_imu_message(10**12, *wave, 0x1FFF, 1)
    return packed(mavlink, (one for _ in range(count)))


def packed(mavlink: Any, messages: Iterable[Any]) -> list[bytes]:
    """Messages as one sender would number them."""
    sender = mavlink.MAVLink(None)
    wires = []
    for message in messages:
        wires.append(bytes(message.pack(sender)))
        sender.seq = (sender.seq + 1) % 256
    return wires


def parser(mavlink: Any) -> Callable[[bytes], int]:
    """What counts the good messages in a read, and keeps none."""
    parse_buffer = mavlink.MAVLink(None).parse_buffer

    def parse(read: bytes) -> int:
        found = 0
        for message in parse_buffer(read) or ():
            found += message.get_type() != "BAD_DATA"
        return found

    return parse


def parsing(name: str, reads: Callable[[Any, int], list[bytes]], count: int) -> Side | Absent:
    """pymavlink's parsing, a message per read."""
    mavlink = dialect()
    if mavlink is None:
        return Absent(name, MISSING)
    wires, parse = reads(mavlink, count), parser(mavlink)
    return timed(name, count, lambda: sum(map(parse, wires)))


def packing(count: int) -> Side | Absent:
    """A movement command as pymavlink's users write it: the fields given, encoded, packed."""
    mavlink = dialect()
    if mavlink is None:
        return Absent(PACK, MISSING)
    sender = mavlink.MAVLink(None)

    def pack() -> int:
        for number in range(count):
            message = sender.set_position_target_local_ned_encode(
                *(number, 1, 1, 1, 0x05C7, 0.0, 0.0, 0.0, 1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.17)
            )
            message.pack(sender)
        return count

    return timed(PACK, count, pack)
