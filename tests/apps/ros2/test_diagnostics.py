"""What /diagnostics says, and that it says it when something is wrong."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent.client import AgentClient
from m100link.apps.ros2.publishers import Level, Status, diagnostics
from m100link.protocol.records import Battery, FlightPhase
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.integrity import Integrity, IntegrityState
from tests.apps.ros2.conftest import Program, Rig
from tests.known import Known

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


def found(known: Known, name: str, **clock: Any) -> Status:
    its = cast(DeviceClock, SimpleNamespace(**clock)) if clock else None
    every = diagnostics(cast(AgentClient, known), its, {"junk": 9})
    return next(one for one in every if one.name == name)


def test_numbers_are_in_the_units_of_their_names() -> None:
    known = Known()
    known.integrity = Integrity(IntegrityState.GOOD, "", 0.25, 0.375, 0.0123)
    assert found(known, "navigation").values == {
        "position test ratio": 0.25,
        "height test ratio": 0.38,  # two places
        "delay ms": 12.3,
    }
    clock = found(known, "clock", uncertainty_s=0.0123, skew_ppm=-4.56, resets=2)
    assert clock.values == {"bound of stamps ms": 12.3, "skew ppm": -4.56, "jumps": 2}
    assert found(known, "node").values == {"junk": 9}


@pytest.mark.parametrize(
    ("uncertainty_s", "level"), [(0.05, Level.OK), (0.051, Level.WARN), (float("inf"), Level.WARN)]
)
def test_stamps_are_uncertain_beyond_50_ms(uncertainty_s: float, level: Level) -> None:
    clock = found(Known(), "clock", uncertainty_s=uncertainty_s, skew_ppm=0.0, resets=0)
    assert clock.level is level
    assert found(Known(), "clock").level is Level.STALE


@pytest.mark.parametrize(
    ("percent", "level"),
    [(31, Level.OK), (30, Level.WARN), (0, Level.WARN), (100, Level.OK), (101, Level.STALE)],
)
def test_a_battery_is_low_from_thirty_percent_down(percent: int, level: Level) -> None:
    assert found(Known(Battery(percent)), "battery").level is level


@pytest.mark.parametrize(
    ("age", "level"), [(5.0, Level.OK), (5.1, Level.STALE), (None, Level.STALE)]
)
def test_a_line_without_telemetry_is_stale(age: float | None, level: Level) -> None:
    known = Known()
    known.newest_age = age
    assert found(known, "line").level is level
