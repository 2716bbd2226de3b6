"""Every stage of a mission with everything that may happen, by hand."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.payloads import MissionInput, MissionStage, after
from m100link.errors import MissionRunning

NONE, UPLOADED, STARTING, FLYING, OVER = MissionStage
PLAN, ASKED, BEGUN, ENDED, LEASE = MissionInput

EXPECTED = {
    (NONE, PLAN): UPLOADED,
    (NONE, ASKED): STARTING,  # of a plan that a front has brought in pieces
    (NONE, BEGUN): NONE,
    (NONE, ENDED): NONE,
    (NONE, LEASE): NONE,
    (UPLOADED, PLAN): UPLOADED,  # the newer one
    (UPLOADED, ASKED): STARTING,
    (UPLOADED, BEGUN): UPLOADED,
    (UPLOADED, ENDED): UPLOADED,
    (UPLOADED, LEASE): NONE,  # nobody flies what somebody else left
    (STARTING, PLAN): None,
    (STARTING, ASKED): None,
    (STARTING, BEGUN): FLYING,
    (STARTING, ENDED): OVER,  # refused, or stopped before it began
    (STARTING, LEASE): OVER,
    (FLYING, PLAN): None,
    (FLYING, ASKED): None,
    (FLYING, BEGUN): FLYING,
    (FLYING, ENDED): OVER,
    (FLYING, LEASE): OVER,
    (OVER, PLAN): UPLOADED,
    (OVER, ASKED): STARTING,  # the plan lies there still
    (OVER, BEGUN): OVER,  # what a lost lease overtook does not fly
    (OVER, ENDED): OVER,
    (OVER, LEASE): OVER,
}


def test_the_table_is_whole() -> None:
    assert EXPECTED.keys() == {(stage, one) for stage in MissionStage for one in MissionInput}


@pytest.mark.parametrize(("stage", "happens"), EXPECTED)
def test_each_pair(stage: MissionStage, happens: MissionInput) -> None:
    expected = EXPECTED[stage, happens]
    if expected is None:
        with pytest.raises(MissionRunning, match="nothing was changed"):
            after(stage, happens)
    else:
        assert after(stage, happens) is expected
