"""The names of DJI's node, when they are asked for."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.ros2.graph import data_key
from m100link.apps.ros2.publishers import ALL_OUTPUTS
from m100link.apps.ros2.topics import DJI_OUTPUTS, INPUTS, SERVICES, dji_makers
from m100link.log.cdr import DEFINITIONS, decode, definition
from m100link.log.ros2 import TOPICS
from tests.apps.ros2.conftest import Rig

pytestmark = pytest.mark.anyio


def said(rig: Rig, name: str) -> dict[str, Any]:
    kind = DJI_OUTPUTS[name].kind
    sent = rig.bus.outlets[data_key(0, rig.names.full(name), kind)].sent
    return decode(kind, sent[-1][0])


async def test_each_is_published_with_the_values_of_the_sample() -> None:
    assert dji_makers().keys() == DJI_OUTPUTS.keys()
    async with Rig(has_dji_names=True).running() as rig:
        await rig.program.up()
        await anyio.sleep(2.0)
        for name in DJI_OUTPUTS:
            assert said(rig, name)
        found = said(rig, "dji_sdk/velocity")
        assert found["header"]["frame_id"] == "ground_ENU"
        ours = rig.said("~/velocity")[-1]["twist"]["linear"]
        assert found["vector"] == pytest.approx(ours, abs=0.05)
        assert said(rig, "dji_sdk/flight_status")["data"] == 3
        assert said(rig, "dji_sdk/height_above_takeoff")["data"] == pytest.approx(1.2, abs=0.4)
        assert said(rig, "dji_sdk/rc")["axes"][4] == 8000.0
        assert said(rig, "dji_sdk/imu")["linear_acceleration"]["z"] == pytest.approx(9.8, abs=0.5)
        ours = rig.said("~/imu")[-1]["orientation"]
        assert said(rig, "dji_sdk/attitude")["quaternion"] == pytest.approx(ours, abs=1e-3)


def test_the_services_that_end_something_are_taken_by_their_order() -> None:
    """What ends nothing may be refused as too late or too many."""
    assert {name: row.ends for name, row in SERVICES.items() if row.ends} == {
        "~/release_control": orders.Release,
        "~/land": orders.Land,
        "~/go_home": orders.GoHome,
        "~/disarm": orders.StopMotors,
        "~/stop": orders.Stop,
        "~/mission/pause": orders.PauseMission,
        "~/mission/stop": orders.StopMission,
    }


async def test_nobody_has_them_unasked(rig: Rig) -> None:
    assert not any("dji_sdk" in key for key in rig.bus.outlets)


def test_each_message_that_is_defined_stands_on_a_topic() -> None:
    """Of a log or of the node, in a service or an action, or within one that does."""
    found = {row.kind for table in (ALL_OUTPUTS, INPUTS) for row in table.values()}
    found |= {*TOPICS.values(), "action_msgs/GoalStatusArray"}
    found |= {one for one in DEFINITIONS if one.count("/") == 2}
    texts = "\n".join(definition(one) for one in found)
    assert {one for one in DEFINITIONS.keys() - found if f"MSG: {one}\n" not in texts} == set()
