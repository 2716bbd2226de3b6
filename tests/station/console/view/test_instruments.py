"""Instruments show a value, and that it is old."""

from __future__ import annotations

import anyio
import pytest

from m100link.protocol.records import Attitude
from m100link.station.console.view.inputs import Inputs
from m100link.station.console.view.instruments import FIELDS, instruments_of, live
from m100link.telemetry.state import AircraftState
from tests.station.conftest import Rig

pytestmark = pytest.mark.anyio


async def test_each_field_has_its_reading_and_grows_old(rig: Rig) -> None:
    telemetry = rig.front.telemetry
    assert isinstance(telemetry, AircraftState)
    shown = instruments_of(Inputs(telemetry=telemetry))
    assert set(shown.readings) == {field.name for field in FIELDS}
    assert not shown.readings["heading"].is_stale
    attitude = telemetry.get(Attitude)
    assert attitude is not None
    assert shown.attitude == (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)


async def test_the_socket_tells_speed_over_ground_and_where_to(rig: Rig) -> None:
    await anyio.sleep(1.5)  # the flight status comes once a second
    told = live(rig.front.telemetry, 1.0)
    assert told["op"] == "live"
    assert len(told["vel"]) == 4
    assert told["ground"]  # home is where it stands
    assert len(str(told)) < 400  # twenty times a second
