"""A connection that is dropped and never closed: said, and the port is free again."""

from __future__ import annotations

import asyncio
import gc
import os
import pty
import subprocess
import sys
import tty
from collections.abc import Coroutine, Iterator

import pytest

import m100link
from m100link import Control, PortBusy
from m100link.link import open_link
from m100link.protocol.records import Device
from m100link.testing import VirtualPort
from tests.link.test_serial_pty import open_descriptors
from tests.rig import NORTH
from tests.waiting import blocking_until

pytestmark = [pytest.mark.pty, pytest.mark.usefixtures("owners_are_found")]


def run_and_collect(program: Coroutine[object, object, None]) -> None:
    """Run it, and whatever it left is gone."""
    asyncio.run(program)
    gc.collect()


@pytest.fixture
def device() -> Iterator[str]:
    """A terminal at whose other end nobody is."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_its_end_is_that_of_the_loop_and_it_is_named(device: str) -> None:
    async def drop() -> None:
        await open_link(device)
        with pytest.raises(PortBusy, match="by this program itself") as caught:
            await open_link(device)
        assert "aclose()" in caught.value.remedy
        assert caught.value.owners[0][0] == os.getpid()

    gc.collect()
    before = open_descriptors()
    with pytest.warns(ResourceWarning, match=f"{device} was not closed before its event loop"):
        run_and_collect(drop())
    assert open_descriptors() == before

    async def use() -> None:
        await (await open_link(device)).close()

    asyncio.run(use())


@pytest.mark.smoke
def test_what_flew_is_left_in_neutral_and_given_back() -> None:
    """Control by hand, kept by nobody: the end of the loop takes its stop path."""
    port = VirtualPort(seed=1)
    vehicle, autopilot = port.aircraft.vehicle, port.aircraft.autopilot

    async def fly() -> Control:
        aircraft = await m100link.connect(port.name)
        await aircraft.activate(port.aircraft.credentials)
        await asyncio.sleep(1.5)
        control = await aircraft.control().obtain()
        await control.take_off()
        for _ in range(25):
            control.send(NORTH)
            await asyncio.sleep(0.02)
        return control

    async def drop() -> None:
        await fly()
        gc.collect()

    with pytest.warns(ResourceWarning, match=f"{port.name} was not closed"):
        run_and_collect(drop())
    blocking_until(lambda: vehicle.authority.device is Device.RC)
    assert autopilot.received_movements[-1].roll_or_x == 0.0
    blocking_until(lambda: vehicle.flight.dynamics.speed < 0.1)
    assert vehicle.flight.dynamics.motors_on

    async def again() -> None:
        async with m100link.connect(port.name) as aircraft, aircraft.control(stop="land"):
            pass

    asyncio.run(again())
    port.close()


def test_a_program_that_ends_says_so_where_warnings_are_shown(device: str) -> None:
    program = f"""
import asyncio
from m100link.link import open_link

async def main():
    return await open_link({device!r})

kept = asyncio.run(main())
"""
    done = subprocess.run(
        [sys.executable, "-W", "always::ResourceWarning", "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert f"ResourceWarning: {device} was not closed" in done.stderr
    assert "Traceback" not in done.stderr
