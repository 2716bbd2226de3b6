"""A peer that never reads, with every buffer on the way full: real terminals and sockets."""

from __future__ import annotations

import asyncio
import os
import pty
import socket
import time
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

import m100link
from m100link import AckTimeout, LineBlocked, SilentLine
from m100link.flight import stop_path
from m100link.flight.block import BLOCKED_S
from m100link.link import Link, open_link, transport
from m100link.link.link import CLOSE_TIMEOUT
from m100link.sim import DEMO_APP_ID, DEMO_KEY, Driver, PtyPort, VirtualAircraft
from m100link.sim.ports.driver import StreamPort, serve_tcp
from tests.rig import NORTH
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.anyio, pytest.mark.pty]

KINDS = ["pty", "tcp"]
MOST_UNSENT = 4096  # in this program: the limit and one frame
MOST_TAKEN = 16 << 20  # by the systems on the way, in all: a socket's receiver takes megabytes


@pytest.fixture(params=KINDS)
async def url(request: pytest.FixtureRequest) -> AsyncIterator[str]:
    """A line that opens, and whose other end does nothing at all."""
    if request.param == "pty":
        master, slave = pty.openpty()
        tty.setraw(slave)
        yield f"serial://{os.ttyname(slave)}:230400"
        os.close(master)
        os.close(slave)
        return
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield f"tcp://127.0.0.1:{listening.getsockname()[1]}"


async def fill(link: Link) -> None:
    """Push until the line takes no more, and is not only busy for a moment."""
    refused = 0
    while refused < 10:
        is_sent = link.push(bytes(1000))
        refused = 0 if is_sent else refused + 1
        assert link.statistics().bytes_sent < MOST_TAKEN
        await asyncio.sleep(0 if is_sent else 0.01)


@asynccontextmanager
async def unstalled(limit_s: float = 5.0) -> AsyncIterator[None]:
    """The loop gets its turns in time; the machine may be busy, so a stall is a long one."""
    lags: list[float] = []

    async def look() -> None:
        while True:
            at = time.monotonic()
            await asyncio.sleep(0.01)
            lags.append(time.monotonic() - at - 0.01)

    task = asyncio.create_task(look())
    yield
    task.cancel()
    assert max(lags) < limit_s


async def test_connecting_says_that_the_line_is_silent(url: str) -> None:
    async with unstalled():
        with pytest.raises(SilentLine):
            async with m100link.connect(url, timeout=0.5):
                pass


async def test_nothing_stalls_nothing_grows_and_each_call_says_why(url: str) -> None:
    link = await open_link(url)
    assert link._transport is not None
    async with unstalled(), asyncio.timeout(PATIENCE):
        await fill(link)
        sent = link.statistics().frames_sent
        requests = [link.request(b"x", timeout=0.1, tries=2) for _ in range(40)]
        ends = asyncio.gather(*requests, return_exceptions=True)
        for _ in range(1000):
            assert not link.push(bytes(1000))
        assert link._transport.get_write_buffer_size() < MOST_UNSENT
        for error in await ends:
            assert isinstance(error, AckTimeout)
            assert "does not take bytes" in error.cause
        assert link.statistics().frames_sent == sent
        begun = time.monotonic()
        await link.close()
        assert time.monotonic() - begun < 2 * CLOSE_TIMEOUT + 1.0
    with pytest.raises(m100link.LinkClosed):
        link.push(b"x")


@pytest.mark.parametrize("kind", KINDS)
async def test_what_flies_takes_the_stop_path_while_telemetry_arrives(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The aircraft sends and does not read: only the way there is blocked."""
    monkeypatch.setattr(stop_path, "_LANDING_DEADLINE_S", 1.0)  # a minute is waited otherwise
    driver = Driver(VirtualAircraft(seed=1))
    if kind == "pty":
        port = PtyPort(driver)
        url = port.name
    else:
        server = await serve_tcp(driver)
        url = f"tcp://127.0.0.1:{server.port}"

    def stand_still() -> None:
        if kind == "pty":
            driver.loop.remove_reader(port._master)
        else:
            (stream,) = driver.ports
            assert isinstance(stream, StreamPort)
            assert stream._transport is not None
            stream._transport.pause_reading()

    async with asyncio.timeout(PATIENCE), unstalled():
        aircraft = await m100link.connect(url)
        await aircraft.activate(m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        begun: list[float] = []

        async def fly() -> None:
            async with aircraft.control(stop="land") as control:
                await control.take_off()
                stand_still()
                await fill(aircraft.link)
                begun.append(time.monotonic())
                async for _ in control.ticks():
                    control.send(NORTH)

        with pytest.raises(LineBlocked, match="took no setpoint"):
            await fly()
        assert BLOCKED_S < time.monotonic() - begun[0] < 15.0
        age = aircraft.state.newest_age
        assert age is not None
        assert age < 1.0
        vehicle = driver.aircraft.vehicle
        await until(lambda: vehicle.flight.dynamics.speed < 0.1)
        assert vehicle.flight.dynamics.motors_on, "nobody could tell it to land"
        closing_at = time.monotonic()
        await aircraft.aclose()
        assert time.monotonic() - closing_at < 2 * CLOSE_TIMEOUT + 1.0
    driver.stop()
    if kind == "tcp":
        await server.stop()


async def test_a_host_that_takes_nothing_is_lost_in_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(transport, "_HOST_GONE_MS", 1000)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        link = await open_link(f"tcp://127.0.0.1:{listening.getsockname()[1]}")
        await fill(link)
        async with asyncio.timeout(PATIENCE):
            await link.wait_disconnected(None)
        assert isinstance(link.failure, m100link.LinkLost)
        assert "timed out" in link.failure.seen
        await link.close()
