"""A network that is lost is a hover, then what was configured, and nothing resumes by itself."""

from __future__ import annotations

from functools import partial

import anyio
import pytest

from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.lost_link import LostAction, LostPlan
from m100link.apps.fleet.stream import Dropped
from m100link.errors import FleetError, GuardRefused, UsageError
from m100link.protocol.setpoint import Setpoint
from tests.apps.fleet.conftest import OnBoard, Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def fly_and_be_cut(rig: Rig, one: OnBoard, pilot: Fleet, *, seconds: float) -> None:
    """Fly north at 3 m/s, lose the network in flight, and come back after a while."""
    with pytest.raises(FleetError):
        async with pilot["a1"].control() as control:
            await control.take_off()
            async with control.hold(NORTH):
                await anyio.sleep(4.0)
                assert one.speed > 2.5
                rig.cut(pilot)
                await anyio.sleep(2.0)
                assert one.speed < 0.3
                await anyio.sleep(seconds)


async def test_hovers_within_two_seconds_and_the_lease_ends(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await fly_and_be_cut(rig, one, pilot, seconds=10.0)
    assert one.client.holder.number == 0
    assert one.height > 1.0, "by default it hovers, and the pilot with the remote control flies"
    rig.join(pilot)
    await anyio.sleep(5.0)
    assert one.speed < 0.3, "nothing resumes by itself"


@pytest.mark.parametrize("action", ["land", "home"])
async def test_lands_or_goes_home_when_that_is_configured(rig: Rig, action: LostAction) -> None:
    plan = LostPlan(action, 3.0)
    one, pilot = await rig.aircraft("a1", lost=plan), await rig.pilot()
    await fly_and_be_cut(rig, one, pilot, seconds=30.0)
    cut_at = anyio.current_time()
    await rig.until(lambda: one.height < 0.1, within=120.0)
    assert anyio.current_time() - cut_at < 120.0
    rig.join(pilot)
    await anyio.sleep(10.0)
    assert one.height < 0.1


async def test_who_takes_control_meanwhile_keeps_it(rig: Rig) -> None:
    one = await rig.aircraft("a1", lost=LostPlan("land", 5.0))
    pilot, other = await rig.pilot(), await rig.pilot("other")

    async with anyio.create_task_group() as group:
        group.start_soon(partial(fly_and_be_cut, rig, one, pilot, seconds=30.0))
        await rig.until(lambda: one.client.holder.name == "pilot")
        await rig.until(lambda: one.client.holder.number == 0)
        async with other["a1"].control():
            await anyio.sleep(20.0)
            assert one.height > 1.0


async def test_who_lets_go_is_not_lost(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1", lost=LostPlan("land", 1.0)), await rig.pilot()
    await pilot["a1"].take_off()
    await anyio.sleep(20.0)
    assert one.height > 1.0


async def lose_the_pilot(rig: Rig, one: OnBoard) -> None:
    """He takes off and is cut off for good."""
    pilot = await rig.pilot("cut off")

    async def fly() -> None:
        with pytest.raises(FleetError):
            async with pilot["a1"].control() as control:
                await control.take_off()
                rig.cut(pilot)
                await anyio.sleep(30.0)

    one.agent.background.spawn(fly(), "a pilot")
    await rig.until(lambda: one.client.holder.number)
    await rig.until(lambda: not one.client.holder.number)
    assert one.height > 1.0


async def test_a_lease_alone_flies_nothing_and_its_end_lands_nothing(rig: Rig) -> None:
    """Who takes the lease and is not heard again has not flown: the pilot with the remote does."""
    one, pilot = await rig.aircraft("a1", lost=LostPlan("land", 1.0)), await rig.pilot()
    await pilot["a1"].take_off()
    asker = pilot["a1"].asker
    await asker.take_lease(asker.lease_request())
    await anyio.sleep(30.0)
    assert one.height > 1.0


async def test_a_pilot_of_any_name_is_somebody(rig: Rig) -> None:
    one = await rig.aircraft("a1", lost=LostPlan("land", 3.0))
    other = await rig.pilot("pilot lost (land)")
    await lose_the_pilot(rig, one)
    async with other["a1"].control():
        await anyio.sleep(20.0)
        assert one.height > 1.0


@pytest.mark.parametrize("sign", ["stick", "mode", "stop", "lands already"])
async def test_who_shows_that_he_is_there_is_left_alone(rig: Rig, sign: str) -> None:
    one = await rig.aircraft("a1", lost=LostPlan("land", 3.0))
    other = await rig.pilot("other")
    await lose_the_pilot(rig, one)
    await anyio.sleep(1.0)
    if sign == "stick":
        one.aircraft.move_stick(throttle=0.3)
        await anyio.sleep(0.5)
        one.aircraft.release_sticks()
    elif sign == "mode":
        one.aircraft.set_rc_mode("P")
        await anyio.sleep(0.5)
        one.aircraft.set_rc_mode("F")
    elif sign == "stop":
        assert (await other.stop())["a1"].is_ok
    else:
        await rig.until(lambda: one.client.state.task == "land")
        one.aircraft.set_rc_mode("P")
        await anyio.sleep(1.0)
        one.aircraft.set_rc_mode("F")
    height = one.height
    assert height > 0.5
    await anyio.sleep(30.0)
    assert one.height > height - 0.1
    assert any("left alone" in event.text for event in one.client.events)


def test_what_cannot_be_configured() -> None:
    with pytest.raises(UsageError, match="'dive'"):
        LostPlan("dive")  # type: ignore[arg-type] # that is the test
    with pytest.raises(UsageError, match="-1 s"):
        LostPlan("land", -1.0)


async def test_a_stream_that_was_cut_for_less_than_the_lease_does_not_go_on(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    with pytest.raises(GuardRefused, match="had ended"):
        async with pilot["a1"].control() as control:
            await control.take_off()
            async with control.hold(NORTH):
                await anyio.sleep(4.0)
                rig.cut(pilot)
                await anyio.sleep(1.5)
                rig.join(pilot)
                await anyio.sleep(10.0)
    assert one.speed < 0.3
    assert one.fleet_agent.dropped[Dropped.BROKEN] > 0
