"""The values from which on something is reported."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.protocol.records import (
    AngularVelocity,
    Attitude,
    Battery,
    FlightStatus,
    Gimbal,
    Position,
    Velocity,
)
from m100link.sim.vehicle.flight import GOOD_GPS as GOOD_GPS_OF_THE_AIRCRAFT
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.telemetry.integrity import BATTERY_CRITICAL, BATTERY_LOW, GOOD_GPS, has_fix, is_low
from m100link.telemetry.state import is_possible


def test_the_levels_are_those_of_the_virtual_aircraft() -> None:
    settings = AircraftSettings()
    assert settings.low_battery_percent == BATTERY_LOW
    assert settings.critical_battery_percent == BATTERY_CRITICAL
    assert GOOD_GPS == GOOD_GPS_OF_THE_AIRCRAFT


@pytest.mark.parametrize(
    ("charge", "found"), [(None, None), (24, True), (25, True), (26, None), (27, False)]
)
def test_a_charge_at_the_edge_rings_once(charge: int | None, found: bool | None) -> None:
    assert is_low(charge, BATTERY_LOW) is found


@pytest.mark.parametrize(
    ("latitude", "health", "known"),
    [(0.5, 3, True), (0.5, 2, False), (0.5, None, True), (1.6, 5, False), (math.nan, None, False)],
)
def test_a_place_is_known_from_health_three_where_it_can_be_one(
    latitude: float, health: int | None, known: bool
) -> None:
    assert has_fix(Position(latitude, 0.25, 80.0, 5.0, health)) is known


@pytest.mark.parametrize(
    ("record", "possible"),
    [
        (Attitude(0.6, 0.0, -0.8, 0.0), True),  # a quaternion has the length 1
        (Attitude(0.66, 0.0, -0.88, 0.0), True),
        (Attitude(6.0, 0.0, -8.0, 0.0), False),
        (Attitude(1.5, 0.0, 0.0, 0.0), False),
        (Attitude(0.6, 0.0, 0.3, 0.0), False),
        (Attitude(0.0, 0.0, 0.0, 0.0), False),
        (Attitude(1.0, 0.0, math.nan, 0.0), False),
        (Battery(0), True),
        (Battery(100), True),
        (Battery(101), False),
        (Velocity(-12.0, 8.0, -4.0, 7), True),
        (Velocity(-12.0, math.inf, -4.0, 7), False),
        (Velocity(0.0, 0.0, 0.0, None), True),
        (AngularVelocity(0.1, -0.2, math.nan), False),
        (Gimbal(1.0, -math.inf, 3.0, 0), False),
        (FlightStatus(3), True),
        (Position(0.5, 0.25, 80.0, math.nan, 5), False),
        (Position(1.6, 0.25, 80.0, 5.0, 5), False),
        (Position(0.5, 0.25, 80.0, -5.0, None), True),
    ],
    ids=str,
)
def test_nothing_flies_by_what_cannot_be(record: tuple[Any, ...], possible: bool) -> None:
    assert is_possible(record) is possible
