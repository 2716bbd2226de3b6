"""The words above every view: the mission, the status line, a replay, the aircraft."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePath

from m100link.apps.agent.client import Hearing
from m100link.apps.agent.messages import Replay
from m100link.apps.station.console.view.situation import (
    AlarmLevel,
    Inputs,
    RecordedFlight,
    Ship,
    Situation,
)
from m100link.apps.station.console.view.texts import Quantity, Text, clock, tr
from m100link.missions.plan import WaypointPlan
from m100link.protocol.records import Battery, Device, Position, RcMode
from m100link.telemetry.integrity import MAX_TELEMETRY_AGE

# -- the mission -----------------------------------------------------------------------------------

_NAMES = {
    "": "mission.unknown",
    "no mission": "mission.none",
    "waypoint mission": "mission.waypoint",
    "hotpoint": "mission.hotpoint",
    "follow mission": "mission.follow",
}


@dataclass(frozen=True, slots=True)
class MissionView:
    state: Text
    part: float  # how much of it is flown, 0 to 1


def mission_of(inputs: Inputs) -> MissionView:
    plan, state = inputs.plan, inputs.vehicle.state
    text, part = progress(plan, state.mission, state.mission_index)
    return MissionView(text, part)


def name_of(mission: str) -> Text:
    """The agent's name of a mission, to be said."""
    key = _NAMES.get(mission)
    return Text(key) if key is not None else tr("mission.other", name=mission)


def progress(plan: WaypointPlan | None, mission: str, index: int) -> tuple[Text, float]:
    """The mission that flies, to be said, and how much of it is flown, as a part of 1."""
    what = name_of(mission)
    if mission in ("", "no mission") or index < 0:
        return what, 0.0
    if plan is None or index >= len(plan.waypoints):
        return tr("mission.to", what=what, number=index + 1), 0.0
    count = len(plan.waypoints)
    return tr("mission.to_of", what=what, number=index + 1, count=count), index / count


# -- the status line -------------------------------------------------------------------------------
# :data:`RULES` is the whole of it: causes in the order of what the operator must do first, each
# with what has to be known for it. The line says the first that holds. None of them reads a value
# that may be old, so the line claims nothing that it cannot know: while nothing is heard of the
# aircraft, nobody is said to fly it.


class Cause(Enum):
    """The statements of the line; the value is the key of its words."""

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
    FREE_RC = "free_rc"  # nobody has the lease, CTRL_DEVICE names the remote controller
    FREE = "free"  # nobody has the lease, and who flies is not known


def _is_aircraft_silent(now: Situation) -> bool:
    return (now.telemetry_age or 0.0) > MAX_TELEMETRY_AGE


def _lacks_authority(now: Situation) -> bool:
    return now.has_lease and not now.has_authority


_C, _L = Cause, AlarmLevel

RULES: dict[Cause, tuple[AlarmLevel, Callable[[Situation], bool]]] = {
    _C.AGENT_GONE: (_L.DANGER, lambda now: now.hearing is Hearing.GONE),
    _C.AGENT_SILENT: (_L.DANGER, lambda now: now.hearing is Hearing.SILENT),
    _C.LINE_LOST: (_L.DANGER, lambda now: now.connection == "lost"),
    _C.CONNECTING: (_L.WARNING, lambda now: now.connection != "connected"),
    _C.NEVER_HEARD: (_L.WARNING, lambda now: now.telemetry_at is None),
    _C.AIRCRAFT_SILENT: (_L.DANGER, _is_aircraft_silent),
    _C.APP: (_L.WARNING, lambda now: now.device is Device.APP),
    _C.SWITCH: (_L.WARNING, lambda now: now.switch not in (None, RcMode.F)),
    _C.REPLAY: (_L.NEUTRAL, lambda now: now.is_replay),
    _C.OTHER: (_L.WARNING, lambda now: bool(now.holder) and not now.has_lease),
    _C.NOT_ACTIVATED: (_L.WARNING, lambda now: not now.is_activated),
    _C.PENDING: (_L.WARNING, lambda now: now.holding in ("obtaining", "resuming")),
    _C.GIVING_BACK: (_L.NEUTRAL, lambda now: now.holding == "releasing"),
    _C.MISSION: (_L.GOOD, lambda now: now.has_lease and now.has_authority and now.has_mission),
    _C.YOURS: (_L.GOOD, lambda now: now.has_lease and now.has_authority),
    _C.RC: (_L.WARNING, lambda now: _lacks_authority(now) and now.device is Device.RC),
    _C.TAKEN: (
        _L.WARNING,
        lambda now: _lacks_authority(now) and now.holding in ("taken", "paused"),
    ),
    _C.NO_AUTHORITY: (_L.WARNING, _lacks_authority),
    _C.FREE_RC: (_L.NEUTRAL, lambda now: now.device is Device.RC),
    _C.FREE: (_L.NEUTRAL, lambda now: True),
}
"""The causes, in the order of what has to be done first: how urgent each is, and when it holds."""

_TASKS = {
    "take off": "status.task.take_off",
    "land": "status.task.land",
    "go home": "status.task.go_home",
}


@dataclass(frozen=True, slots=True)
class StatusLine:
    cause: Cause  # why it says so
    level: AlarmLevel  # how urgent it is
    text: Text  # what it says
    remedy: Text | None = None  # what to do about it; None where there is nothing to do
    # The flight of the aircraft by itself or by a program; None for nothing, or unknown.
    flies: Text | None = None
    # From when on nothing was heard, on the station's clock, s: the page counts from there. None
    # where the cause is not a silence.
    since: float | None = None
    is_virtual: bool = False  # whether the aircraft is a simulated one


_WITHOUT_REMEDY = (Cause.PENDING, Cause.GIVING_BACK, Cause.YOURS)


def status_line(now: Situation) -> StatusLine:
    cause, level = next((cause, level) for cause, (level, holds) in RULES.items() if holds(now))
    key = f"status.{cause.value}"
    return StatusLine(
        cause=cause,
        level=level,
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
    """The flight that goes on, the aircraft's own before a program's."""
    if now.task:
        key = _TASKS.get(now.task)
        return tr(key) if key is not None else tr("status.program", name=now.task)
    if now.has_mission:
        what = name_of(now.mission)
        if now.mission_index is None:
            return what
        return tr("status.to_waypoint", mission=what, number=now.mission_index + 1)
    if now.pattern:
        return tr("status.program", name=now.pattern)
    return None


# -- where a replay is, in words -------------------------------------------------------------------

SPEEDS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)


@dataclass(frozen=True, slots=True)
class ReplayView:
    title: Text  # that it is one, and of what
    place: Text  # how far it is, and when that was
    note: Text | None  # that it is at its end, or that there is no more; None for nothing
    is_running: bool  # whether it goes on by itself
    source: Replay  # as the agent reported it
    # Where the alarm before and the one after this place begin, s as the place; None for none.
    alarm_before: float | None = None
    alarm_after: float | None = None


_HERE_S = 1.0  # an alarm that began so short ago is the present one


def replay_of(
    source: Replay | None, flight: RecordedFlight | None = None, fault: str = ""
) -> ReplayView | None:
    """The bar; ``fault``: why the file cannot be read."""
    if source is None:
        return None
    begins = [] if flight is None else [span.begin_s - flight.at for span in flight.story.alarms]
    before = max((one for one in begins if one < -_HERE_S), default=None)
    after = min((one for one in begins if one > 0.05), default=None)
    when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(source.utc))
    note = tr("replay.at_end") if source.is_at_end else None
    if fault or flight is None or not flight.is_whole:
        note = tr("replay.unread", why=fault) if fault else tr("replay.reading")
    if source.is_at_end and source.is_cut_off:
        note = tr("replay.written" if source.is_written else "replay.cut_off")
    return ReplayView(
        title=tr("replay.title", name=PurePath(source.path).name),
        place=tr(
            "replay.at",
            position=clock(source.position_s),
            duration=clock(source.duration_s),
            when=when,
        ),
        note=note,
        is_running=not (source.is_paused or source.is_at_end),
        source=source,
        alarm_before=None if before is None else source.position_s + before,
        alarm_after=None if after is None else source.position_s + after,
    )


# -- the aircraft of the station -------------------------------------------------------------------

_LOW_PERCENT = 25


@dataclass(frozen=True, slots=True)
class FleetRow:
    name: str  # what it is called
    is_shown: bool  # whether the page shows it and steers it
    kind: str  # ``"mine"``, ``"theirs"``, ``"free"`` or ``"lost"``: colour and shape
    control: Text  # who has control of it, or that nothing is known
    flies: Text  # what it does: height, and what it flies by itself; a dash where that is old
    battery: Text  # charge; a dash where that is old
    is_low: bool  # whether the charge is low


def fleet_of(ships: Sequence[Ship]) -> tuple[FleetRow, ...]:
    return tuple(map(_row, ships)) if len(ships) > 1 else ()


def _row(ship: Ship) -> FleetRow:
    position, battery = ship.vehicle.get(Position), ship.vehicle.get(Battery)
    kind, control = _control(ship)
    return FleetRow(
        ship.name,
        ship.is_shown,
        kind,
        control,
        _ship_flies(ship, position),
        tr("fleet.unknown") if battery is None else tr("fleet.percent", percent=battery.percent),
        is_low=battery is not None and battery.percent <= _LOW_PERCENT,
    )


def _control(ship: Ship) -> tuple[str, Text]:
    view = ship.vehicle
    if view.hearing is not Hearing.HEARD:
        return "lost", tr("fleet.not_heard")
    if not view.is_connected:
        return "lost", tr("fleet.not_connected")
    if ship.is_ours:
        ours = tr("fleet.ours"), tr("fleet.ours_pilot_has_it")
        return "mine", ours[not view.has_authority]
    if view.holder.number:
        return "theirs", tr("fleet.theirs", name=view.holder.name)
    return "free", tr("fleet.stands" if view.is_on_ground else "fleet.free")


def _ship_flies(ship: Ship, position: Position | None) -> Text:
    if position is None:
        return tr("fleet.unknown")
    stands = ship.vehicle.is_on_ground
    height = tr("instruments.phase.standby") if stands else Quantity.length(position.height_m)
    state = ship.vehicle.state
    by_itself = state.task or state.pattern or state.mission
    if by_itself in ("", "no mission"):
        return tr("fleet.height", height=height)
    return tr("fleet.flies", height=height, what=by_itself)
