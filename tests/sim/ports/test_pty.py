"""The aircraft behind a pseudo-terminal, in real time (few and short)."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from pathlib import Path

import pytest
import serial

import m100link
from m100link.link import open_link
from m100link.protocol import TelemetryPacket, Time
from m100link.sim import Driver, PtyPort, VirtualAircraft
from m100link.wire import Frame, FrameDecoder, encode_frame
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.anyio, pytest.mark.pty]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def read(port: PtyPort, count: int) -> list[Frame]:
    """Open the port like any serial program does, and read so many frames or a few more."""
    decoder = FrameDecoder()
    frames: list[Frame] = []
    deadline = time.monotonic() + PATIENCE
    with serial.Serial(port.name, 230_400, timeout=0.05) as opened:
        while len(frames) < count:
            assert time.monotonic() < deadline, f"{len(frames)} frames"
            frames += decoder.feed(opened.read(4096))
    return frames


async def test_programs_may_open_and_close_the_port_as_often_as_they_like() -> None:
    driver = Driver(VirtualAircraft(seed=1))
    port = PtyPort(driver)
    for _ in range(3):
        assert await asyncio.to_thread(read, port, 20)
    driver.stop()


@pytest.mark.smoke
async def test_the_whole_stack_over_a_port() -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    port = PtyPort(driver)
    async with m100link.connect(port.name) as connected:
        await connected.activate(aircraft.credentials)
        async with connected.control():
            await asyncio.sleep(0.05)
    assert aircraft.autopilot.endpoint.statistics.commands >= 4
    driver.stop()


async def test_a_link_is_made_and_removed(tmp_path: Path) -> None:
    driver, link = Driver(VirtualAircraft()), tmp_path / "ttyUSB0"
    port = PtyPort(driver, link=link)
    assert port.name == str(link)
    assert str(link.readlink()) == port.device
    assert os.listdir(tmp_path) == ["ttyUSB0"]  # noqa: PTH208 (not blocking, says the linter)
    driver.stop()
    assert not link.is_symlink()


async def test_a_stale_link_is_replaced(tmp_path: Path) -> None:
    driver, link = Driver(VirtualAircraft()), tmp_path / "ttyUSB0"
    link.symlink_to(tmp_path / "gone")
    PtyPort(driver, link=link)
    assert link.exists()
    driver.stop()


@pytest.mark.parametrize("kind", ["file", "live link", "directory"])
async def test_anything_else_is_left_alone(tmp_path: Path, kind: str) -> None:
    driver, link = Driver(VirtualAircraft()), tmp_path / "ttyUSB0"
    if kind == "file":
        link.write_text("precious")
    elif kind == "directory":
        link.mkdir()
    else:
        link.symlink_to("/dev/null")
    with pytest.raises(m100link.PortBusy):
        PtyPort(driver, link=link)
    assert link.exists()
    assert driver.ports == []


async def test_a_link_that_cannot_be_made_says_so(tmp_path: Path) -> None:
    with pytest.raises(m100link.PortFailed, match="cannot be made"):
        PtyPort(Driver(VirtualAircraft()), link=tmp_path / "missing" / "ttyUSB0")


async def test_a_link_that_became_anothers_is_not_removed(tmp_path: Path) -> None:
    driver, link = Driver(VirtualAircraft()), tmp_path / "ttyUSB0"
    PtyPort(driver, link=link)
    link.unlink()
    link.symlink_to("/dev/null")
    driver.stop()
    assert link.is_symlink()


async def test_nobody_reading_grows_nothing_and_a_late_reader_gets_fresh_bytes() -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    port = PtyPort(driver)
    await until(lambda: port.flushes >= 1)
    assert port.unread <= 4096
    assert len(port.backlog) <= port.backlog.LIMIT
    first, *_ = await asyncio.to_thread(read, port, 30)
    stamp = TelemetryPacket(first.data[2:], aircraft.autopilot.profile).get(Time)
    assert stamp is not None
    assert stamp.seconds > 1.0, "not from the first second, which nobody read"
    driver.stop()


async def test_what_the_terminal_cannot_hold_waits_bounded_and_arrives_whole() -> None:
    driver = Driver(VirtualAircraft(seed=1))
    port = PtyPort(driver)
    driver.aircraft.stall_line()  # nothing but what is written here
    for number in range(3000):
        push = b"\x02\x00" + bytes(100)
        port.write([encode_frame(push, session=0, sequence=number)])
    ack = encode_frame(b"\x00\x00", session=2, sequence=9, is_ack=True)
    port.write([ack])
    assert len(port.backlog) == port.backlog.LIMIT
    assert port.backlog.dropped > 1000

    decoder = FrameDecoder()
    sequences: list[int] = []
    descriptor = os.open(port.device, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    async with asyncio.timeout(PATIENCE):
        while sequences[-1:] != [9]:
            await asyncio.sleep(0.01)
            with contextlib.suppress(BlockingIOError):
                frames = decoder.feed(os.read(descriptor, 65_536))
                sequences += [frame.sequence for frame in frames]
    os.close(descriptor)
    assert decoder.discarded_bytes == 0, "whole frames only"
    assert sequences[-2:] == [2999, 9], "the newest are there"
    assert len(port.backlog) == 0
    driver.stop()


async def test_another_baud_rate_reads_garbage_and_is_not_understood() -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    port = PtyPort(driver)
    link = await open_link(port.name, baud_rate=115_200)
    await until(lambda: link.statistics().bytes_received > 1000)
    with pytest.raises(m100link.AckTimeout):
        await link.request(b"\x00\x00\x00", name="version", timeout=0.1, tries=2)
    statistics = link.statistics()
    assert statistics.frames_received == 0
    assert aircraft.autopilot.endpoint.statistics.commands == 0
    await link.close()
    assert await asyncio.to_thread(read, port, 20), "the next program chooses its own"
    driver.stop()


async def test_unplugging_takes_the_port_away_and_replugging_brings_it_back(
    tmp_path: Path,
) -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    port = PtyPort(driver, link=tmp_path / "ttyUSB0")
    async with m100link.connect(port.name) as connected:
        aircraft.unplug()
        await until(lambda: not connected.link.is_open)
        assert isinstance(connected.link.failure, m100link.LinkLost)
    assert not (tmp_path / "ttyUSB0").exists()
    aircraft.replug()
    await until((tmp_path / "ttyUSB0").exists)
    async with m100link.connect(port.name) as connected:
        await connected.version()
    driver.stop()
