"""Orders over ways of seconds, and what is lost on them: each has its outcome."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import anyio
import pytest

from m100link.apps.agent.messages import Action, Ask
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.payloads import Outcome
from m100link.errors import OutcomeUnknown
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import OnBoard, Rig, with_camera

pytestmark = pytest.mark.anyio


async def told(
    rig: Rig, do: Callable[[FleetAircraft], Awaitable[object]], **options: Any
) -> Outcome:
    pilot = await rig.pilot(**options)
    return (await pilot.each(do, ["a1"]))["a1"].outcome


async def in_the_air(rig: Rig) -> OnBoard:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await pilot["a1"].take_off()
    await anyio.sleep(4.0)  # nobody has the lease any more
    return one


@pytest.mark.parametrize("way", [1.0, 2.0, 3.0])
async def test_what_needs_no_lease_has_its_outcome_over_long_ways(rig: Rig, way: float) -> None:
    await in_the_air(rig)
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.stop) is Outcome.OK


@pytest.mark.parametrize("way", [1.0, 2.0])
async def test_a_landing_is_flown_and_told_over_long_ways(rig: Rig, way: float) -> None:
    one = await in_the_air(rig)
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.land) is Outcome.OK
    assert one.height < 0.1


async def test_a_landing_over_a_way_of_three_seconds_is_refused_for_its_age(rig: Rig) -> None:
    """Nobody can say that it is younger than 5 s."""
    one = await in_the_air(rig)
    rig.network.weather = Weather(delay_s=3.0)
    assert await told(rig, FleetAircraft.land) is Outcome.REFUSED
    assert one.height > 1.0


async def test_a_lease_is_held_and_a_take_off_told_over_a_way_of_a_second(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=1.0)
    assert await told(rig, FleetAircraft.take_off) is Outcome.OK
    assert one.height > 1.0


async def test_a_mission_is_told_over_a_way_of_a_second(rig: Rig) -> None:
    await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=1.0)
    pilot = await rig.pilot()
    assert (await pilot["a1"].mission()).points == 0


@pytest.mark.parametrize("way", [2.0, 3.0])
async def test_no_lease_can_be_held_over_longer_ways_and_that_is_told(rig: Rig, way: float) -> None:
    """It ends 3 s after the last word, and the first word under it comes later."""
    one = await rig.aircraft("a1")
    rig.network.weather = Weather(delay_s=way)
    assert await told(rig, FleetAircraft.take_off) is Outcome.STALE_LEASE
    assert one.height < 0.1


@pytest.mark.parametrize("silent_s", [4.0, 8.0])
async def test_what_became_of_an_order_is_told_when_the_way_is_there_again(
    rig: Rig, silent_s: float
) -> None:
    """What answers is lost for longer than three questions wait."""
    one, pilot = await rig.aircraft("a1", virtual=with_camera()), await rig.pilot()
    await one.agent.activate()
    asker = pilot["a1"].asker
    lease, _ = await asker.take_lease(asker.lease_request())

    async def break_off() -> None:
        await rig.until(lambda: one.aircraft.vehicle.camera.photos)
        rig.network.cut(one.bus)
        await anyio.sleep(silent_s)
        rig.network.join(one.bus)

    async with anyio.create_task_group() as group:
        group.start_soon(break_off)
        await asker.ask(Ask(0, Action.TAKE_PHOTO), fence=lease.number, token=lease.token)
    assert one.aircraft.vehicle.camera.photos == 1


async def test_the_patience_is_what_one_asks_for(rig: Rig) -> None:
    await in_the_air(rig)
    rig.network.weather = Weather(delay_s=3.0)
    pilot = await rig.pilot(patience=4.0)
    began = anyio.current_time()
    with pytest.raises(OutcomeUnknown, match="no answer for 4 s"):
        await pilot["a1"].stop()
    assert anyio.current_time() - began == pytest.approx(4.0, abs=0.5)
    rig.network.weather = Weather(delay_s=7.0)
    assert await told(rig, FleetAircraft.stop, patience=20.0) is Outcome.OK


@pytest.mark.parametrize("seed", range(4))
async def test_what_is_lost_on_a_way_of_a_second_is_asked_again(rig: Rig, seed: int) -> None:
    await in_the_air(rig)
    rig.network.seed(seed)
    rig.network.weather = Weather(loss=0.3, delay_s=1.0, jitter_s=0.2)
    assert await told(rig, FleetAircraft.stop) is Outcome.OK, f"seed {seed}"
