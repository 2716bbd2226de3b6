"""Instruments show a value, and that it is old."""

from __future__ import annotations

import anyio
import pytest

from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.instruments import FIELDS, Field, instruments_of, live
from m100link.apps.station.console.view.units import Language, LengthUnit, SpeedUnit, Units
from m100link.apps.station.console.view.words import Speaker
from m100link.protocol.records import (
    Attitude,
    ControlDevice,
    Device,
    FlightPhase,
    FlightStatus,
)
from m100link.telemetry.state import AircraftState
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio


async def test_each_field_has_its_reading_and_grows_old(rig: Rig) -> None:
    telemetry = rig.front.telemetry
    assert isinstance(telemetry, AircraftState)
    shown = instruments_of(Inputs(telemetry=telemetry))
    assert set(shown.readings) == {field.name for field in FIELDS}
    assert shown.readings["heading"].is_stale is False
    attitude = telemetry.get(Attitude)
    assert attitude is not None
    assert shown.attitude == (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)


async def test_the_socket_tells_speed_over_ground_and_where_to(rig: Rig) -> None:
    await anyio.sleep(1.5)  # the flight status comes once a second
    told = live(rig.front.telemetry, 1.0)
    assert told["op"] == "live"
    assert told["vel"] == [0.0, 0.0, 0.0, 0.0]  # it stands; test_numbers.py has it in flight
    assert told["ground"] is True  # home is where it stands
    assert told["att"][:2] == [0.0, 0.0]
    assert told["pos"][2] == 0.0
    assert len(str(told)) < 400  # twenty times a second


async def test_heights_and_speeds_are_in_the_units_and_the_language_that_were_chosen(
    rig: Rig,
) -> None:
    await anyio.sleep(1.5)
    readings = instruments_of(Inputs(telemetry=rig.front.telemetry)).readings
    said = Speaker(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KM_H))
    assert said(readings["height"].text) == "0,0 ft"
    assert said(readings["speed"].text) == "0,0 km/h"
    assert said(readings["climb"].text) == "+0,0 km/h"
    assert said(readings["flight_status"].text) == "bereit"
    assert said(readings["gps"].text) == "5 von 5"


@pytest.mark.parametrize("field", FIELDS, ids=lambda field: field.name)
def test_every_field_has_a_name(field: Field) -> None:
    assert f"instruments.{field.name}" in CATALOGUE


def test_every_phase_and_every_device_has_words() -> None:
    fields = {field.name: field.text for field in FIELDS}
    phases = [fields["flight_status"](FlightStatus(phase)) for phase in FlightPhase]
    devices = [fields["control_device"](ControlDevice(device, None)) for device in Device]
    assert all(text.key in CATALOGUE for text in (*phases, *devices))
    assert Speaker()(fields["flight_status"](FlightStatus(9))) == "9?"
