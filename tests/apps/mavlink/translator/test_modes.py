"""The tables have an answer for every pair, and the numbers are those of others."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.apps.mavlink.translator import numbers
from m100link.apps.mavlink.translator.modes import (
    ARM_VERDICTS,
    DISARM_VERDICTS,
    MODES,
    RUNNING,
    VERDICTS,
    FlightSource,
    Mode,
    ModeTransition,
    ModeVerdict,
    VehiclePhase,
)


@pytest.mark.parametrize("phase", VehiclePhase)
def test_every_wish_has_an_answer_in_every_phase(phase: VehiclePhase) -> None:
    assert set(VERDICTS[phase]) == set(Mode)
    assert {phase} <= ARM_VERDICTS.keys() & DISARM_VERDICTS.keys()


@pytest.mark.parametrize("running", FlightSource)
def test_every_wish_knows_how_it_takes_over(running: FlightSource) -> None:
    assert set(RUNNING[running]) == set(Mode)


@pytest.mark.parametrize("mode", Mode)
def test_nothing_moves_an_aircraft_that_others_fly(mode: Mode) -> None:
    for phase in (VehiclePhase.AWAY, VehiclePhase.OTHER, VehiclePhase.PILOT):
        assert VERDICTS[phase][mode] is ModeVerdict.REJECT


@pytest.mark.parametrize("mode", sorted(set(Mode) - {Mode.HOLD, Mode.LAND, Mode.RTL}, key=str))
def test_only_a_hover_and_a_way_to_the_ground_end_a_landing(mode: Mode) -> None:
    assert (
        RUNNING[FlightSource.LAND][mode]
        is RUNNING[FlightSource.GO_HOME][mode]
        is ModeTransition.REFUSE
    )


@pytest.mark.parametrize("phase", [VehiclePhase.AIRBORNE, VehiclePhase.FREE, VehiclePhase.PILOT])
def test_nothing_disarms_in_the_air(phase: VehiclePhase) -> None:
    assert DISARM_VERDICTS[phase] is ModeVerdict.DENY


def test_no_two_modes_have_one_number() -> None:
    assert len({row.number for row in MODES.values()}) == len(MODES)
    assert MODES[Mode.RTL].number == 4 << 16 | 5 << 24


def test_numbers_are_those_of_the_definitions() -> None:
    common: Any = pytest.importorskip("pymavlink.dialects.v20.all")
    for prefix, kind in (
        ("MAV_RESULT_", numbers.MavResult),
        ("MAV_SEVERITY_", numbers.Severity),
        ("MAV_CMD_", numbers.MavCommand),
        ("MAV_STATE_", numbers.SystemStatus),
        ("MAV_LANDED_STATE_", numbers.LandedState),
        ("MAV_PROTOCOL_CAPABILITY_", numbers.Capability),
        ("MAV_MISSION_TYPE_", numbers.MissionType),
        ("MAV_FRAME_", numbers.MavFrame),
    ):
        for one in kind:
            assert getattr(common, prefix + str(one.name)) == one.value, one
