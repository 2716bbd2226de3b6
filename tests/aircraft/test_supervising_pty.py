"""A real terminal that goes away in flight and comes back under the same name."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import m100link
from m100link import AuthorityState, BackOff, Gap, LinkLost, Sample, SupervisionState
from m100link.protocol.records import Device
from m100link.sim import DEMO_APP_ID, DEMO_KEY, Driver, PtyPort, VirtualAircraft
from tests.rig import NORTH, TimedMoves
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.anyio, pytest.mark.pty]

APP = m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY)
ROUNDS = 3


@pytest.mark.smoke
async def test_telemetry_goes_on_behind_a_gap_and_control_never_does(tmp_path: Path) -> None:
    driver = Driver(VirtualAircraft(seed=1, firmware="3.1"))
    port = PtyPort(driver, link=tmp_path / "aircraft")
    driver.aircraft.autopilot.received_movements = moves = TimedMoves()
    back_off = BackOff(first=0.1, factor=1.0, jitter=0.0)
    supervised = m100link.supervise(f"serial://{port.name}:230400", APP, back_off=back_off)
    came: list[Sample | Gap] = []

    async def consume() -> None:
        async for one in supervised.telemetry():
            came.append(one)

    def device() -> Device:
        return driver.aircraft.vehicle.authority.device

    async def more(count: int) -> None:
        before = len(came)
        await until(lambda: len(came) >= before + count)

    async def fly() -> None:
        aircraft = await supervised.connected()
        async with aircraft.control() as control:
            if not driver.aircraft.vehicle.flight.dynamics.motors_on:
                await control.take_off()
            driver.loop.call_later(0.5, port.unplug)
            async for _ in control.ticks():
                control.send(NORTH)

    async with asyncio.timeout(PATIENCE), supervised:
        consumer = asyncio.create_task(consume())
        for number in range(ROUNDS):
            with pytest.raises(LinkLost):
                await fly()
            await until(lambda: supervised.state is SupervisionState.WAITING)
            sent = len(moves)
            await asyncio.sleep(0.5)
            port.replug()
            aircraft = await supervised.connected()
            await more(20)
            assert sum(isinstance(one, Gap) for one in came) == number + 1
            assert len(moves) == sent, "nothing flew it"
            assert aircraft.authority.state is AuthorityState.NONE
            await until(lambda: driver.aircraft.vehicle.flight.dynamics.speed < 0.1)
        consumer.cancel()
        await asyncio.wait([consumer])
        # It does not know: it hovers for the next program in control, which gives it back.
        assert device() is Device.ONBOARD
        async with aircraft.control(stop="land"):
            pass
        assert device() is Device.RC
        assert not driver.aircraft.vehicle.flight.dynamics.motors_on
    first_gap = next(index for index, one in enumerate(came) if isinstance(one, Gap))
    assert first_gap > 20
    assert isinstance(came[first_gap - 1], Sample)
    assert isinstance(came[first_gap + 1], Sample)
    driver.stop()
