"""Which buttons can be pressed in which state."""

from __future__ import annotations

from dataclasses import replace

import pytest

from m100link.apps.agent.guided import GuidedFlight
from m100link.apps.agent.messages import LeaseChanged, State
from m100link.apps.station.console.view.actions import (
    ACTIONS,
    FLIGHTS,
    FROM_GROUND,
    HELD,
    MISSIONS,
    actions_of,
)
from m100link.apps.station.console.view.catalogue import CATALOGUE
from m100link.apps.station.console.view.checklist import Checklist, ChecklistDesk
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.situation import Situation, situation_of
from m100link.protocol.records import FlightPhase

MINE = LeaseChanged(3, "tab")
KEPT = {"release", "mission_upload"}


def look(inputs: Inputs, *, has_reason: bool) -> Checklist:
    """The list of an operator who has a reason for everything, or none."""
    desk = ChecklistDesk()
    desk.say_why("a test" * has_reason)
    ready = replace(
        situation_of(inputs), is_activated=True, telemetry_at=inputs.now, phase=FlightPhase.STANDBY
    )
    return desk.look(ready)


def offered_of(inputs: Inputs) -> frozenset[str]:
    """What is offered to an operator who has a reason for everything."""
    return actions_of(inputs, situation_of(inputs), look(inputs, has_reason=True))


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
        (inputs_of(is_mine=True, obeyed=False), {"activate", "obtain", *KEPT}),
        (inputs_of(is_mine=True, obeyed=True), {"activate", *KEPT, *FLIGHTS}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="no mission"),
            {"activate", *KEPT, *FLIGHTS},
        ),
        (inputs_of(is_mine=True, obeyed=True, task="landing"), {"activate", *KEPT}),
        (
            inputs_of(is_mine=True, obeyed=True, mission="hotpoint"),
            {"activate", *KEPT, *MISSIONS},
        ),
        (inputs_of(is_mine=True, obeyed=True, is_silent=True), {*KEPT}),
    ],
)
def test_what_is_offered(inputs: Inputs, offered: set[str]) -> None:
    actions = offered_of(inputs)
    assert actions == {"stop", *offered}
    assert actions <= ACTIONS


FLIES = replace(situation_of(Inputs()), phase=FlightPhase.IN_AIR)


@pytest.mark.parametrize(
    ("now", "has_reason", "leaves"),
    [
        (replace(FLIES, phase=FlightPhase.STANDBY), False, False),
        (replace(FLIES, phase=FlightPhase.STANDBY), True, True),
        (replace(FLIES, phase=None), False, False),  # nobody knows: it counts as standing
        (FLIES, False, True),  # a mission or a task that begins in flight
    ],
)
def test_what_leaves_the_ground_is_offered_by_the_checklist(
    now: Situation, has_reason: bool, leaves: bool
) -> None:
    inputs = inputs_of(is_mine=True, obeyed=True)
    actions = actions_of(inputs, now, look(inputs, has_reason=has_reason))
    in_flight = {"take_off"} if now.is_on_ground is False else set()
    assert actions & FROM_GROUND == (FROM_GROUND - in_flight if leaves else set())
    assert actions >= {"land", "go_home"}


def test_anybody_may_let_a_guided_flight_hover() -> None:
    state = State(0.0, "connected", guided=GuidedFlight("change of height"))
    assert offered_of(Inputs(state=state)) == {"stop", "activate", "obtain", "hover"}


def test_what_flies_by_itself_has_to_be_held_and_its_button_says_so() -> None:
    assert HELD >= FLIGHTS
    assert not HELD & {"stop", "hover", "mission_pause", "mission_stop", "release"}
    labels = [key for key, (english, _) in CATALOGUE.items() if english.endswith("(hold)")]
    assert labels == [key for key, (_, german) in CATALOGUE.items() if german.endswith("(halten)")]
    assert len(labels) == len(HELD)
