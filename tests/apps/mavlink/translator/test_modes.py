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
    Mode,
    Phase,
    Running,
    Step,
    Verdict,
)


@pytest.mark.parametrize("phase", Phase)
def test_every_wish_has_an_answer_in_every_phase(phase: Phase) -> None:
    assert set(VERDICTS[phase]) == set(Mode)
    assert {phase} <= ARM_VERDICTS.keys() & DISARM_VERDICTS.keys()


@pytest.mark.parametrize("running", Running)
def test_every_wish_knows_how_it_takes_over(running: Running) -> None:
    assert set(RUNNING[running]) == set(Mode)


@pytest.mark.parametrize("mode", Mode)
def test_nothing_moves_an_aircraft_that_others_fly(mode: Mode) -> None:
    for phase in (Phase.AWAY, Phase.OTHER, Phase.PILOT):
        assert VERDICTS[phase][mode] is Verdict.REJECT


@pytest.mark.parametrize("mode", sorted(set(Mode) - {Mode.HOLD, Mode.LAND, Mode.RTL}, key=str))
def test_only_a_hover_and_a_way_to_the_ground_end_a_landing(mode: Mode) -> None:
    assert RUNNING[Running.LAND][mode] is RUNNING[Running.GO_HOME][mode] is Step.REFUSE


@pytest.mark.parametrize("phase", [Phase.AIRBORNE, Phase.FREE, Phase.PILOT])
def test_nothing_disarms_in_the_air(phase: Phase) -> None:
    assert DISARM_VERDICTS[phase] is Verdict.DENY


def test_no_two_modes_have_one_number() -> None:
    assert len({row.number for row in MODES.values()}) == len(MODES)
    assert MODES[Mode.RTL].number == 4 << 16 | 5 << 24


def test_numbers_are_those_of_the_definitions() -> None:
    common: Any = pytest.importorskip("pymavlink.dialects.v20.all")
    for prefix, kind in (
        ("MAV_RESULT_", numbers.Result),
        ("MAV_SEVERITY_", numbers.Severity),
        ("MAV_CMD_", numbers.Command),
        ("MAV_STATE_", numbers.SystemStatus),
        ("MAV_LANDED_STATE_", numbers.LandedState),
        ("MAV_PROTOCOL_CAPABILITY_", numbers.Capability),
        ("MAV_MISSION_TYPE_", numbers.MissionType),
        ("MAV_FRAME_", numbers.Frame),
    ):
        for one in kind:
            assert getattr(common, prefix + str(one.name)) == one.value, one
