"""What was asked for is called off, or asked for again, before control is obtained."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.vehicle_state import Mode, VehiclePhase
from m100link.sim.vehicle.flight import FlightController
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio

_ARM, _DISARM = (MavCommand.COMPONENT_ARM_DISARM, 1), (MavCommand.COMPONENT_ARM_DISARM, 0)
_UP = (MavCommand.NAV_TAKEOFF,)
_LAND, _HOME = (MavCommand.NAV_LAND,), (MavCommand.NAV_RETURN_TO_LAUNCH,)


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.3, 1.0, 1.9, 2.1])
@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_what_is_disarmed_while_it_is_armed_does_not_take_off(
    firmware: str, gap: float
) -> None:
    async with Rig(firmware=firmware).running() as rig:
        for command in (_ARM, _DISARM, _UP):
            rig.ground.command(*command)
            await anyio.sleep(gap if command is _ARM else 0.0)
        await anyio.sleep(8.0)
        assert not rig.motors_on
        assert not rig.agent.holding.has_authority
        assert not rig.client.holder.number
        await rig.ground.arm()
        assert rig.agent.holding.has_authority


@pytest.mark.parametrize("commands", [(_DISARM, _UP), (_UP, _DISARM), (_DISARM, _UP, _UP)])
@pytest.mark.parametrize("gap", [0.0, 0.01, 0.02])
async def test_disarming_on_the_ground_wins_over_a_take_off(
    rig: Rig, ground: Ground, commands: tuple[tuple[float, ...], ...], gap: float
) -> None:
    await ground.arm()
    for number, *parameters in commands:
        ground.command(int(number), *parameters)
        await anyio.sleep(gap)
    await anyio.sleep(10.0)
    assert not rig.motors_on
    assert not rig.agent.holding.has_authority
    assert not ground.armed()


@pytest.mark.parametrize("end", [_LAND, _HOME, _DISARM])
@pytest.mark.parametrize("gap", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_a_take_off_is_called_off_before_the_motors_turn(
    firmware: str, end: tuple[float, ...], gap: float
) -> None:
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        await ground.arm()
        ground.command(*_UP)
        await anyio.sleep(gap)
        is_early = rig.vehicle.world.phase is VehiclePhase.ARMED
        assert await ground.ask(int(end[0]), *end[1:]) is (
            MavResult.ACCEPTED if is_early or end is not _DISARM else MavResult.DENIED
        )
        highest = 0.0
        for _ in range(250):
            await anyio.sleep(0.02)
            highest = max(highest, rig.height)
            assert ground.armed() or not rig.motors_on
        if is_early:
            assert highest < 0.1
            assert not rig.motors_on
            assert not rig.agent.holding.has_authority
            assert not rig.client.holder.number
            assert "the take-off is called off" in ground.texts
        elif end is not _DISARM:
            await rig.until(lambda: not rig.motors_on)
            assert "when the take-off is over" in ground.texts


@pytest.mark.parametrize("end", [_LAND, _HOME, _DISARM])
async def test_what_takes_off_although_it_was_called_off_is_landed(
    rig: Rig, ground: Ground, end: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No fact says that giving authority back ends a take-off: here it does not."""
    monkeypatch.setattr(FlightController, "interrupt", lambda _: None)
    await ground.arm()
    ground.command(*_UP)
    while not rig.motors_on:  # noqa: ASYNC110 - virtual time: it costs nothing
        await anyio.sleep(0.001)
    assert rig.vehicle.world.phase is VehiclePhase.ARMED, "telemetry does not show it yet"
    assert await ground.ask(int(end[0]), *end[1:]) is MavResult.ACCEPTED
    await rig.until(lambda: rig.height > 0.5)
    assert ground.armed()
    await rig.until(lambda: not rig.motors_on)
    await rig.until(lambda: not rig.client.holder.number)
    await rig.until(lambda: not ground.armed())


async def test_a_take_off_whose_ground_station_is_lost_on_the_ground_is_called_off(
    rig: Rig, ground: Ground
) -> None:
    await ground.arm()
    ground.command(*_UP)
    rig.vehicle.manager.operator_lost()
    await anyio.sleep(5.0)
    assert not rig.motors_on
    assert not rig.client.holder.number


async def test_arming_is_refused_while_a_take_off_is_called_off(rig: Rig, ground: Ground) -> None:
    await ground.arm()
    ground.command(*_UP)
    ground.command(*_LAND)
    await anyio.sleep(0.5)
    refused = await ground.ask(*_ARM)
    await anyio.sleep(3.0)
    held = [rig.agent.holding.has_authority]
    await ground.arm()
    held.append(rig.agent.holding.has_authority)
    assert (refused, held) == (MavResult.TEMPORARILY_REJECTED, [False, True])
    assert "the take-off is being called off" in ground.texts.replace("\n", "")
    assert not rig.motors_on


async def test_arming_after_disarming_waits_until_control_is_given_back(
    rig: Rig, ground: Ground
) -> None:
    await ground.arm()
    ground.command(*_DISARM)
    assert await ground.ask(*_ARM) is MavResult.ACCEPTED
    await anyio.sleep(1.0)
    assert rig.agent.holding.has_authority
    assert ground.armed()


async def in_the_air_and_free(rig: Rig, ground: Ground) -> None:
    """Another client flew it up and gave the lease back."""
    await ground.fly(6.0)
    rig.work.cancel()
    await rig.until(lambda: not rig.client.holder.number)
    rig.work = rig.agent.background.spawn(rig.bridge.run(), "bridge")
    await rig.until(lambda: rig.vehicle.world.phase is VehiclePhase.FREE)


@pytest.mark.parametrize("copies", [2, 3])
@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_copies_of_a_landing_are_one_while_control_is_obtained(
    firmware: str, copies: int
) -> None:
    async with Rig(firmware=firmware).running() as rig:
        await in_the_air_and_free(rig, rig.ground)
        for _ in range(copies):
            assert await rig.ground.ask(MavCommand.NAV_LAND) is MavResult.ACCEPTED
        await rig.until(lambda: not rig.motors_on)


async def test_a_landing_goes_on_when_who_asked_is_lost_before_control_is_obtained(
    rig: Rig, ground: Ground
) -> None:
    await in_the_air_and_free(rig, ground)
    ground.command(MavCommand.NAV_LAND)
    rig.vehicle.manager.operator_lost()
    await rig.until(lambda: not rig.motors_on)


async def test_the_newest_end_of_a_flight_counts_while_control_is_obtained(
    rig: Rig, ground: Ground
) -> None:
    await in_the_air_and_free(rig, ground)
    ground.command(MavCommand.NAV_LAND)
    ground.command(MavCommand.NAV_RETURN_TO_LAUNCH)
    await anyio.sleep(2.0)
    assert ground.mode is Mode.RTL
