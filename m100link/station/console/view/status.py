"""The status line: who has control, and what is going on, in one sentence each."""

from __future__ import annotations

from dataclasses import dataclass

from m100link.protocol.codes import ActivationCode
from m100link.station.console.view.inputs import Inputs

__all__ = ["StatusLine", "status_of"]


@dataclass(frozen=True, slots=True)
class StatusLine:
    """What a glance at the header tells.

    Attributes:
        text: Who has control, or why nobody knows.
        kind: ``"mine"``, ``"theirs"`` or ``"free"``: the colour.
        activation: How far activation is.
        task: What the aircraft flies by itself; empty for nothing.
        problem: What was refused last; empty for nothing.
    """

    text: str
    kind: str
    activation: str
    task: str
    problem: str


def status_of(inputs: Inputs) -> StatusLine:
    """The status line."""
    text, kind = _control(inputs)
    task = inputs.state.task or ("simple task" if inputs.state.pattern else "")
    return StatusLine(text, kind, _activation(inputs), task, inputs.problem)


def _control(inputs: Inputs) -> tuple[str, str]:
    if not inputs.is_heard:
        return "Nothing is heard of the aircraft: all values are old", "theirs"
    if not inputs.holder.number:
        return "Nobody has control here: the pilot flies", "free"
    if not inputs.has_lease:
        return f"{inputs.holder.name} has control", "theirs"
    if inputs.state.has_authority:
        return "You have control", "mine"
    return "You hold the lease, but the aircraft obeys the pilot", "theirs"


def _activation(inputs: Inputs) -> str:
    state = inputs.state
    if state.activation_fault is not None:
        return f"Activation: {state.activation_fault.error()}"
    if state.is_activated:
        return "Activation: active"
    if state.activation_code is not None:
        return f"Activation: {ActivationCode(state.activation_code).meaning}"
    return "Activation: not done"
