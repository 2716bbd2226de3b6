"""What /diagnostics says, and that it says it when something is wrong."""

from __future__ import annotations

import anyio
import pytest

from m100link.protocol.records import FlightPhase
from m100link.ros2.diagnostics import Level
from tests.ros2.conftest import Program, Rig

pytestmark = pytest.mark.anyio


def levels(rig: Rig) -> dict[str, Level]:
    told = rig.said("/diagnostics")[-1]["status"]
    assert all(one["name"].startswith("m100: ") for one in told)
    return {one["name"].removeprefix("m100: "): Level(one["level"]) for one in told}


async def test_all_is_well(rig: Rig) -> None:
    await anyio.sleep(6.0)
    assert set(levels(rig).values()) == {Level.OK}
    clock = next(one for one in rig.said("/diagnostics")[-1]["status"] if "clock" in one["name"])
    values = {one["key"]: one["value"] for one in clock["values"]}
    assert 0.0 < float(values["bound of stamps ms"]) < 50.0


async def test_a_low_battery_and_a_line_that_is_gone(rig: Rig) -> None:
    rig.aircraft.vehicle.flight.battery_percent = 20.0
    await anyio.sleep(3.0)
    assert levels(rig)["battery"] is Level.WARN
    rig.service.close()  # the agent has gone
    await anyio.sleep(10.0)
    assert levels(rig)["line"] is Level.ERROR
    assert levels(rig)["battery"] is Level.STALE


async def test_what_was_not_done_is_counted(rig: Rig, program: Program) -> None:
    program.speed(1.0)
    await anyio.sleep(2.0)
    node = next(one for one in rig.said("/diagnostics")[-1]["status"] if "node" in one["name"])
    assert {"key": "setpoints closed", "value": "1"} in node["values"]


async def test_a_position_that_cannot_be_true(rig: Rig) -> None:
    flight = rig.aircraft.vehicle.flight
    flight.start_motors()
    flight.phase = FlightPhase.IN_AIR
    flight.dynamics.place(0.0, 0.0, 10.0)
    await anyio.sleep(6.0)
    assert levels(rig)["navigation"] is Level.OK
    flight.dynamics.place(500.0, 0.0, 10.0)
    await anyio.sleep(1.5)
    assert levels(rig)["navigation"] is Level.ERROR
    await anyio.sleep(6.0)
    assert levels(rig)["navigation"] is Level.OK
