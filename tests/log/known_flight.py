"""A log of :mod:`tests.known`'s aircraft, made of bytes on a line and of times that are round."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.link import Direction
from m100link.log import Recorder
from m100link.log.channels import LINK
from m100link.protocol.firmware import PROFILES
from m100link.protocol.records import AccelerationMode, Velocity
from tests import known
from tests.support import raw_frame

UTC = 1_795_420_800.0
"""2026-11-23 08:00:00 UTC, when the clock of the event loop stood at 40 s."""

PUSH = b"\x02\x00"
SINKING = Velocity(3.21, -1.57, -0.62, 7)


def pushed(firmware: str, sequence: int, **options: Any) -> bytes:
    """A frame with a telemetry package, as the aircraft sends it."""
    return raw_frame(PUSH + known.package(firmware, **options), sequence=sequence)


def moved(forward: float, right: float, up: float, yaw: float) -> bytes:
    """A movement by velocity with a yaw rate, as firmware 3.1 takes it: up before yaw."""
    flag = 0x40 | 0x08 | 0x02  # velocities, a yaw rate, body frame; stable mode is off
    return b"\x01\x03" + struct.pack("<B4f", flag, forward, right, up, yaw)


async def write(
    path: Path,
    patch: pytest.MonkeyPatch,
    heard: Sequence[tuple[float, Direction, bytes]],
    firmware: str = "3.1",
) -> None:
    """Record what goes over a line.

    Args:
        path: The log.
        patch: Sets the calendar.
        heard: Seconds after :data:`UTC`, direction and bytes, in order of time.
        firmware: Which the aircraft has.
    """
    loop = asyncio.get_running_loop()
    patch.setattr(time, "time", lambda: UTC + loop.time() - 40.0)
    await asyncio.sleep(40.0 - loop.time())
    recorder = Recorder(path, rate_hz=0)
    recorder.begin()
    link = cast(Any, SimpleNamespace(cipher=None))
    fused = AccelerationMode.FUSED
    counted = {
        "firmware": firmware,
        "acceleration": fused,
        "discarded_bytes": 0,
        "repeats": 0,
        "acks": 0,
    }
    counted |= {"round_trips": {"total_s": 0.0}}
    told = iter([[(LINK, counted)]])
    recorder.watch(link, lambda: PROFILES[firmware], lambda: next(told, []), lambda: fused)
    for at, way, data in heard:
        await asyncio.sleep(40.0 + at - loop.time())
        recorder.tap(way, data, 40.0 + at)
    await recorder.aclose()
