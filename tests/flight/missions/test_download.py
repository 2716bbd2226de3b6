"""What the aircraft has stored is the plan that was uploaded."""

from __future__ import annotations

import pytest

from m100link import CommandNotSupported, GimbalPitch, MissionRefused, Stay, TakePhoto, Waypoint
from m100link.missions.plan import WaypointPlan
from tests.flight.missions.foreign import foreign, plan, spot

pytestmark = pytest.mark.anyio

BUSY = WaypointPlan(
    [
        Waypoint(*spot(0.0, 0.0), height=10.5, heading_deg=-90, actions=[Stay(1.5), TakePhoto()]),
        Waypoint(*spot(9.0, 3.0), height=12.25, gimbal_pitch_deg=-30, turn_clockwise=False),
        Waypoint(*spot(0.0, 9.0), height=10.0, actions=[GimbalPitch(-60)], action_repeat=2),
    ],
    speed=3.5,
    max_speed=7.5,
)


@pytest.mark.parametrize("loss", [0.0, 0.1])
@pytest.mark.parametrize("uploaded", [plan(), BUSY])
async def test_download_equals_upload(uploaded: WaypointPlan, loss: float) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        there.loss = loss
        async with control.waypoint_mission(uploaded):
            assert await aircraft.download_waypoint_plan() == uploaded
        there.loss = 0.0
        with pytest.raises(MissionRefused) as caught:
            await aircraft.download_waypoint_plan()
        assert caught.value.code == 0xEA
        assert "while it flies" in caught.value.remedy


async def test_a_waypoint_that_is_missing_is_named() -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.waypoint_mission(plan()):
            del there.missions.points[2]
            with pytest.raises(MissionRefused) as caught:
                await aircraft.download_waypoint_plan()
            assert (caught.value.code, caught.value.point) == (0xEB, 2)
            there.missions.answers[0x14] = 0xD1
            with pytest.raises(MissionRefused) as caught:
                await aircraft.download_waypoint_plan()
            assert (caught.value.code, "while it flies" in caught.value.remedy) == (0xD1, False)
            there.missions.flying = ""


async def test_firmware_before_3_1_has_none() -> None:
    async with foreign("2.3") as (_, aircraft):
        with pytest.raises(CommandNotSupported):
            await aircraft.download_waypoint_plan()
