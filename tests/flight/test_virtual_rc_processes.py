"""How the aircraft fares when the program behind a virtual RC is interrupted, ended or killed.

A real process, a real pseudo-terminal, real time.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from m100link.protocol.commands.virtual_rc import CENTRE, VirtualRcData, VirtualRcSettings
from m100link.sim import AssistantSettings, Driver, PtyPort, VirtualAircraft
from tests.flight.test_processes import ROOT
from tests.rig import put_in_the_air
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.pty, pytest.mark.anyio]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time


@asynccontextmanager
async def flown() -> AsyncIterator[tuple[VirtualAircraft, asyncio.subprocess.Process]]:
    """An aircraft whose stick a process holds forward."""
    assistant = AssistantSettings(rates_hz={"control_device": 10})
    virtual = VirtualAircraft(seed=1, firmware="3.1", assistant=assistant)
    put_in_the_air(virtual)
    driver = Driver(virtual)
    port = PtyPort(driver)
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-W", "error", "-m", "tests.flight.stick_program", port.name),
        cwd=ROOT,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        async with asyncio.timeout(PATIENCE):
            said = await process.stdout.readline()
        if said != b"flying\n":
            pytest.fail(f"it does not fly: {(await process.stderr.read()).decode()}")
        await until(lambda: virtual.vehicle.flight.dynamics.speed > 1.0)
        yield virtual, process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()
        driver.stop()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_a_signal_centres_the_sticks_and_switches_it_off(number: signal.Signals) -> None:
    async with flown() as (virtual, process):
        process.send_signal(number)
        async with asyncio.timeout(PATIENCE):
            status = await process.wait()
        assert status != 0
        await until(lambda: not virtual.vehicle.remote.virtual.is_on)
        received = [one.command for one in virtual.autopilot.received_commands]
        data = [one.channels[:4] for one in received if isinstance(one, VirtualRcData)]
        assert data[-3:] == [(CENTRE,) * 4] * 3
        settings = [one.is_on for one in received if isinstance(one, VirtualRcSettings)]
        assert settings == [True, False]
        assert not virtual.vehicle.remote.virtual.is_locked
        await until(lambda: virtual.vehicle.flight.dynamics.speed < 0.1)


@pytest.mark.smoke
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
async def test_whatever_becomes_of_the_program_the_guardian_centres_and_switches_off(
    number: signal.Signals,
) -> None:
    """Whether the aircraft still has it on then (it waits a second for channels, V4) or not."""
    async with flown() as (virtual, process):
        process.send_signal(number)
        received = virtual.autopilot.received_commands

        def settings() -> list[bool]:
            commands = [one.command for one in received]
            return [one.is_on for one in commands if isinstance(one, VirtualRcSettings)]

        await until(lambda: settings() == [True, False])
        assert not virtual.vehicle.remote.virtual.is_on
        assert not virtual.vehicle.remote.virtual.is_locked
        data = [
            one.command.channels[:4] for one in received if isinstance(one.command, VirtualRcData)
        ]
        moved = [index for index, sticks in enumerate(data) if sticks != (CENTRE,) * 4]
        assert len(data) - moved[-1] > 20, "centred for as long as settings may not come"
        await until(lambda: virtual.vehicle.flight.dynamics.speed < 0.1)
        virtual.move_stick(pitch=-0.5)
        await until(lambda: virtual.vehicle.flight.dynamics.velocity_north < -1.0)
