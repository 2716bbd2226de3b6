"""The status line: one sentence that a glance understands, and what to do about it.

:data:`RULES` is the whole of it: causes in the order of what the operator must do first, each with
what has to be known for it. The first that holds is told. None of them reads a value that may be
old, so the line claims nothing that it cannot know: while nothing is heard of the aircraft, nobody
is said to fly it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from m100link.apps.station.console.view.errors import problem_text
from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.mission import name_of
from m100link.apps.station.console.view.situation import (
    Hearing,
    Level,
    Situation,
)
from m100link.apps.station.console.view.words import Text, say
from m100link.protocol.codes import ActivationCode
from m100link.protocol.records import Device, RcMode
from m100link.telemetry.integrity import MAX_TELEMETRY_AGE

__all__ = ["RULES", "Cause", "Rule", "StatusLine", "activation_of", "status_line"]


class Cause(Enum):
    """What the line says; the value is the key of its words."""

    AGENT_GONE = "agent_gone"  # the process that owns the aircraft has ended
    AGENT_SILENT = "agent_silent"  # it may hang
    LINE_LOST = "line_lost"  # the line was open and is not any more
    CONNECTING = "connecting"  # the line is being opened
    NEVER_HEARD = "never_heard"  # the line is open, and no telemetry has come yet
    AIRCRAFT_SILENT = "aircraft_silent"  # the line is open, and telemetry has ended
    APP = "app"  # CTRL_DEVICE names the mobile app
    SWITCH = "switch"  # the mode switch is seen out of F: the pilot flies
    REPLAY = "replay"  # a recorded flight: nobody controls anything
    OTHER = "other"  # another client of the station has the lease
    NOT_ACTIVATED = "not_activated"
    PENDING = "pending"  # authority was asked for
    GIVING_BACK = "giving_back"  # authority is being released
    MISSION = "mission"  # the lease and authority, and a mission flies: sticks do nothing
    YOURS = "yours"  # the lease and authority
    RC = "rc"  # the lease without authority, and CTRL_DEVICE names the remote controller
    TAKEN = "taken"  # the lease without authority: somebody took it, nobody knows who
    NO_AUTHORITY = "no_authority"  # the lease without authority, which has to be asked for
    KEPT = "kept"  # nobody has the lease, authority is kept for a moment for whoever was lost
    FREE_RC = "free_rc"  # nobody has the lease, CTRL_DEVICE names the remote controller
    FREE = "free"  # nobody has the lease, and who flies is not known


@dataclass(frozen=True, slots=True)
class Rule:
    """When a cause is told.

    Attributes:
        cause: The cause.
        level: How urgent it is.
        holds: Whether it is so.
    """

    cause: Cause
    level: Level
    holds: Callable[[Situation], bool]


def _is_aircraft_silent(now: Situation) -> bool:
    return (now.telemetry_age or 0.0) > MAX_TELEMETRY_AGE


def _lacks_authority(now: Situation) -> bool:
    return now.has_lease and not now.has_authority


_C, _L = Cause, Level

RULES: tuple[Rule, ...] = (
    Rule(_C.AGENT_GONE, _L.DANGER, lambda now: now.hearing is Hearing.GONE),
    Rule(_C.AGENT_SILENT, _L.DANGER, lambda now: now.hearing is Hearing.SILENT),
    Rule(_C.LINE_LOST, _L.DANGER, lambda now: now.connection == "lost"),
    Rule(_C.CONNECTING, _L.WARNING, lambda now: now.connection != "connected"),
    Rule(_C.NEVER_HEARD, _L.WARNING, lambda now: now.telemetry_at is None),
    Rule(_C.AIRCRAFT_SILENT, _L.DANGER, _is_aircraft_silent),
    Rule(_C.APP, _L.WARNING, lambda now: now.device is Device.APP),
    Rule(_C.SWITCH, _L.WARNING, lambda now: now.switch not in (None, RcMode.F)),
    Rule(_C.REPLAY, _L.NEUTRAL, lambda now: now.is_replay),
    Rule(_C.OTHER, _L.WARNING, lambda now: bool(now.holder) and not now.has_lease),
    Rule(_C.NOT_ACTIVATED, _L.WARNING, lambda now: not now.is_activated),
    Rule(_C.PENDING, _L.WARNING, lambda now: now.holding in ("obtaining", "resuming")),
    Rule(_C.GIVING_BACK, _L.NEUTRAL, lambda now: now.holding == "releasing"),
    Rule(
        _C.MISSION,
        _L.GOOD,
        lambda now: now.has_lease and now.has_authority and now.has_mission,
    ),
    Rule(_C.YOURS, _L.GOOD, lambda now: now.has_lease and now.has_authority),
    Rule(_C.RC, _L.WARNING, lambda now: _lacks_authority(now) and now.device is Device.RC),
    Rule(
        _C.TAKEN,
        _L.WARNING,
        lambda now: _lacks_authority(now) and now.holding in ("taken", "paused"),
    ),
    Rule(_C.NO_AUTHORITY, _L.WARNING, _lacks_authority),
    Rule(_C.KEPT, _L.WARNING, lambda now: now.has_authority and not now.holder),
    Rule(_C.FREE_RC, _L.NEUTRAL, lambda now: now.device is Device.RC),
    Rule(_C.FREE, _L.NEUTRAL, lambda now: True),
)
"""What is told, in the order of what has to be done first."""

_TASKS = {
    "take off": "status.task.take_off",
    "land": "status.task.land",
    "go home": "status.task.go_home",
}


@dataclass(frozen=True, slots=True)
class StatusLine:
    """What the status line shows.

    Attributes:
        cause: Why it says so.
        level: How urgent it is.
        text: What it says.
        remedy: What to do about it; None where there is nothing to do.
        flies: What the aircraft flies by itself or by a program; None for nothing, or unknown.
        since: From when on nothing was heard, on the station's clock, s: the page counts from
            there. None where the cause is not a silence.
        is_virtual: Whether the aircraft is a simulated one.
    """

    cause: Cause
    level: Level
    text: Text
    remedy: Text | None = None
    flies: Text | None = None
    since: float | None = None
    is_virtual: bool = False


_WITHOUT_REMEDY = (Cause.PENDING, Cause.GIVING_BACK, Cause.YOURS)


def status_line(now: Situation) -> StatusLine:
    """The line for a situation."""
    rule = next(rule for rule in RULES if rule.holds(now))
    cause = rule.cause
    key = f"status.{cause.value}"
    return StatusLine(
        cause=cause,
        level=rule.level,
        text=Text(key, _values(cause, now)),
        remedy=None if cause in _WITHOUT_REMEDY else Text(f"{key}.remedy"),
        flies=_flies(now) if now.is_connected and not _is_aircraft_silent(now) else None,
        since=_since(cause, now),
        is_virtual=now.is_virtual,
    )


def _values(cause: Cause, now: Situation) -> dict[str, object]:
    if cause in (Cause.LINE_LOST, Cause.CONNECTING):
        return {"why": f": {now.fault}" if now.fault else ""}
    if cause is Cause.SWITCH and now.switch is not None:
        return {"switch": now.switch.name}
    if cause is Cause.OTHER:
        return {"name": now.holder}
    return {}


def _since(cause: Cause, now: Situation) -> float | None:
    if cause in (Cause.AGENT_SILENT, Cause.AGENT_GONE):
        return now.heard_at
    return now.telemetry_at if cause is Cause.AIRCRAFT_SILENT else None


def _flies(now: Situation) -> Text | None:
    """What flies, the aircraft's own before a program."""
    if now.task:
        key = _TASKS.get(now.task)
        return say(key) if key is not None else say("status.program", name=now.task)
    if now.has_mission:
        what = name_of(now.mission)
        if now.mission_index is None:
            return what
        return say("status.to_waypoint", mission=what, number=now.mission_index + 1)
    if now.pattern:
        return say("status.program", name=now.pattern)
    return None


def activation_of(inputs: Inputs) -> Text:
    """How far activation is; what the aircraft answered, in English."""
    state = inputs.state
    if state.activation_fault is not None:
        return say("status.activation.failed", why=problem_text(state.activation_fault.error()))
    if state.is_activated:
        return say("status.activation.done")
    if state.activation_code is not None:
        meaning = ActivationCode(state.activation_code).meaning
        return say("status.activation.failed", why=meaning)
    return say("status.activation.none")
