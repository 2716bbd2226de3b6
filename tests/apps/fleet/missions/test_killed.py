"""The agent is killed while a mission flies: the aircraft flies on, until the next one is there."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.fleet.lost_link import LostAction, LostPlan
from m100link.apps.fleet.payloads import MissionStage
from m100link.errors import M100Error
from tests.apps.fleet.conftest import Rig
from tests.apps.fleet.missions.conftest import away, kind, on_board

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("action", ["hover", "land"])
async def test_the_next_agent_ends_the_mission_and_does_what_lost_says(
    rig: Rig, action: LostAction
) -> None:
    plan = LostPlan(action, 4.0)
    one = await on_board(rig, lost=plan)
    pilot = await rig.pilot()
    with pytest.raises(M100Error):
        async with pilot["a1"].control() as control:
            digest = await control.missions.upload(away(one, 20, 140))
            await control.missions.start(digest, take_off=True)
            await rig.until(lambda: one.speed > 2.0)
            one.kill()
            await anyio.sleep(60.0)
    assert one.speed > 1.0, "nobody told the aircraft to stop"
    second = await one.next(lost=plan)
    await rig.until(lambda: second.speed < 0.3, within=5.0)
    assert kind(second) == "no mission"
    await anyio.sleep(30.0)
    assert second.speed < 0.3
    assert second.height < 0.1 if action == "land" else second.height > 5.0
    assert second.fleet_agent.missions.stage is MissionStage.NONE
