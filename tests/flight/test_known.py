"""What counts as known: not old, not impossible, and by one limit for everybody."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.flight.guards import known
from m100link.protocol import Attitude, Battery, FlightStatus, Position, encode_telemetry, profile
from m100link.protocol.items import BY_RECORD
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import FRESH_S, AircraftState

FIRMWARE = profile("3.1")
POSSIBLE: dict[str, tuple[float, ...]] = {
    "time": (5, 0, 1),
    "acceleration": (0.0, 0.0, 0.0),
    "velocity": (0.0, 0.0, 0.0, 7),
    "angular_velocity": (0.0, 0.0, 0.0),
    "magnetometer": (1, 2, 3),
    "gimbal": (0.0, 0.0, 0.0, 0),
    "quaternion": (1.0, 0.0, 0.0, 0.0),
    "position": (0.8, 0.1, 400.0, 5.0, 5),
    "rc": (0, 0, 0, 0, 8000, -10000),
    "flight_status": (3,),
    "battery": (80,),
    "control_device": (0, 2),
}


def told(name: str, values: tuple[float, ...], age: float = 0.0) -> AircraftState:
    """What is had of an item that arrived so many seconds ago."""
    state = AircraftState(lambda: 100.0)
    state.update(Sample(encode_telemetry({name: values}, FIRMWARE), FIRMWARE, 100.0 - age))
    return state


@pytest.mark.parametrize("record", FRESH_S, ids=lambda record: record.__name__)
def test_a_value_is_known_until_its_age_limit_and_no_longer(record: type[Any]) -> None:
    name, limit = BY_RECORD[record].name, FRESH_S[record]
    assert limit > 1.0, "an item that is sent once a second is known all the time"
    assert known(told(name, POSSIBLE[name], limit - 1e-3), record) is not None
    assert known(told(name, POSSIBLE[name], limit + 1e-3), record) is None
    assert known(AircraftState(lambda: 0.0), record) is None


def test_of_a_status_that_is_sent_once_a_second_one_may_be_lost_and_not_two() -> None:
    assert known(told("flight_status", (3,), 2.1), FlightStatus) is not None
    assert known(told("flight_status", (3,), 3.0), FlightStatus) is None


def test_a_program_that_needs_a_younger_value_says_so() -> None:
    state = told("position", POSSIBLE["position"], 0.6)
    assert known(state, Position) is not None
    assert known(state, Position, within=0.5) is None


@pytest.mark.parametrize(
    ("record", "values"),
    [
        (Attitude, (math.nan, 0.0, 0.0, 0.0)),
        (Attitude, (0.0, 0.0, 0.0, 0.0)),
        (Attitude, (3.0, 0.0, 0.0, 0.0)),
        (Position, (math.inf, 0.1, 400.0, 5.0, 5)),
        (Position, (0.8, 0.1, 400.0, math.nan, 5)),
        (Position, (2.0, 0.1, 400.0, 5.0, 5)),
        (Battery, (101,)),
    ],
)
def test_an_impossible_value_is_known_to_nobody(
    record: type[Any], values: tuple[float, ...]
) -> None:
    state = told(BY_RECORD[record].name, values)
    assert state.get(record) is not None
    assert known(state, record) is None


def test_a_status_that_no_table_lists_is_a_value_all_the_same() -> None:
    assert known(told("flight_status", (77,)), FlightStatus) == (77,)
