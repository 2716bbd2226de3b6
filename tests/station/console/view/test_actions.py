"""Which buttons can be pressed in which state."""

from __future__ import annotations

import pytest

from m100link.agent.guided import GuidedFlight
from m100link.agent.messages import LeaseChanged, State
from m100link.station.console.view.actions import ACTIONS, FLIGHTS, MISSIONS, actions_of
from m100link.station.console.view.inputs import Inputs

MINE = LeaseChanged(3, "tab")
HELD = {"release", "mission_upload"}


def inputs_of(
    *, is_mine: bool, obeyed: bool, task: str = "", mission: str = "", is_silent: bool = False
) -> Inputs:
    state = State(0.0, "connected", has_authority=obeyed, task=task, mission=mission)
    return Inputs(state=state, holder=MINE, has_lease=is_mine, is_silent=is_silent)


@pytest.mark.parametrize(
    ("inputs", "offered"),
    [
        (Inputs(), set()),
        (inputs_of(is_mine=False, obeyed=True), {"activate", "obtain"}),
        (inputs_of(is_mine=True, obeyed=False), {"activate", "obtain", *HELD}),
        (inputs_of(is_mine=True, obeyed=True), {"activate", *HELD, *FLIGHTS}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="no mission"),
            {"activate", *HELD, *FLIGHTS},
        ),
        (inputs_of(is_mine=True, obeyed=True, task="landing"), {"activate", *HELD}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="hotpoint"),
            {"activate", *HELD, *MISSIONS},
        ),
        (inputs_of(is_mine=True, obeyed=True, is_silent=True), {*HELD}),
    ],
)
def test_what_is_offered(inputs: Inputs, offered: set[str]) -> None:
    assert actions_of(inputs) == {"stop", *offered}
    assert actions_of(inputs) <= ACTIONS


def test_anybody_may_let_a_guided_flight_hover() -> None:
    state = State(0.0, "connected", guided=GuidedFlight("change of height"))
    assert actions_of(Inputs(state=state)) == {"stop", "activate", "obtain", "hover"}
