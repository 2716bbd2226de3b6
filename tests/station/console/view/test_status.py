"""The status line names what is known, and nothing else."""

from __future__ import annotations

import pytest

from m100link.agent.messages import LeaseChanged, State
from m100link.protocol.codes import ActivationCode
from m100link.station.console.view.inputs import Inputs
from m100link.station.console.view.status import status_of

OBEYED = State(at=0.0, connection="connected", has_authority=True)
IGNORED = State(at=0.0, connection="connected")
MINE, NOBODY = LeaseChanged(3, "tab"), LeaseChanged(0, "")


@pytest.mark.parametrize(
    ("inputs", "text", "kind"),
    [
        (Inputs(state=IGNORED), "Nobody has control here", "free"),
        (Inputs(state=OBEYED, holder=MINE, has_lease=True), "You have control", "mine"),
        (Inputs(state=IGNORED, holder=MINE, has_lease=True), "obeys the pilot", "theirs"),
        (Inputs(state=OBEYED, holder=MINE), "tab has control", "theirs"),
        (Inputs(state=OBEYED, holder=MINE, has_lease=True, is_silent=True), "old", "theirs"),
        (Inputs(state=OBEYED, holder=MINE, has_lease=True, is_gone=True), "old", "theirs"),
    ],
)
def test_who_has_control(inputs: Inputs, text: str, kind: str) -> None:
    status = status_of(inputs)
    assert text in status.text
    assert status.kind == kind


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (State(at=0.0), "not done"),
        (State(at=0.0, is_activated=True), "active"),
        (
            State(at=0.0, activation_code=ActivationCode.NEW_DEVICE),
            ActivationCode.NEW_DEVICE.meaning,
        ),
    ],
)
def test_activation(state: State, text: str) -> None:
    assert text in status_of(Inputs(state=state)).activation


def test_what_flies_by_itself_is_named() -> None:
    assert status_of(Inputs(state=State(at=0.0, task="landing"))).task == "landing"
    assert status_of(Inputs(state=State(at=0.0, pattern="legs"))).task == "simple task"
    assert status_of(Inputs(problem="refused")).problem == "refused"
