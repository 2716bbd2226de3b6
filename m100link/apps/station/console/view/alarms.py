"""The alarms, which the page reports loudly: each a row of a table, its life another table.

An alarm begins and ends by what is known. Between the two lies a gap, so that a value at the edge
rings once; an unknown value begins nothing and ends nothing. The alarm of an event (a lease that
was taken, a mission broken off) begins with the event and stays until somebody has seen it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from m100link.apps.agent.client import Hearing
from m100link.apps.agent.lease import Flown, LeaseChange
from m100link.apps.station.console.view.situation import AlarmLevel, RecordedFlight, Situation
from m100link.apps.station.console.view.texts import Quantity, Text, tr
from m100link.errors import LossReason
from m100link.protocol.records import FlightPhase
from m100link.telemetry.integrity import (
    BATTERY_CRITICAL,
    BATTERY_LOW,
    GOOD_GPS,
    MAX_TELEMETRY_AGE,
    is_low,
)

_NEAR, _CLEAR = 0.9, 0.85
_LINK_CLEAR_AGE = MAX_TELEMETRY_AGE / 2


class AlarmState(Enum):
    QUIET = "quiet"  # nothing to tell
    RAISED = "raised"  # it is so, and nobody has said that they know
    ACKNOWLEDGED = "acknowledged"  # it is so, and the operator knows
    PASSED = "passed"  # it was so, and nobody has said that they know


class AlarmInput(Enum):
    BEGINS = "it is so"
    ENDS = "it is so no more"
    SEEN = "the operator acknowledges it"


_S, _I = AlarmState, AlarmInput

TRANSITIONS: dict[AlarmState, dict[AlarmInput, AlarmState]] = {
    _S.QUIET: {_I.BEGINS: _S.RAISED},
    _S.RAISED: {_I.ENDS: _S.PASSED, _I.SEEN: _S.ACKNOWLEDGED},
    _S.ACKNOWLEDGED: {_I.ENDS: _S.QUIET},
    _S.PASSED: {_I.BEGINS: _S.RAISED, _I.SEEN: _S.QUIET},
}
"""State, input, next state. A pair that is not here changes nothing."""


class AlarmName(Enum):
    """The alarms, the most urgent first; the value is the key of its words."""

    LINK_LOST = "link_lost"
    LANDS_ITSELF = "lands_itself"
    BATTERY_CRITICAL = "battery_critical"
    LEASE_TAKEN = "lease_taken"
    LINK_OLD = "link_old"
    NAVIGATION = "navigation"
    BATTERY_FLOOR = "battery_floor"
    GPS = "gps"
    AUTHORITY_LOST = "authority_lost"
    MISSION_ABORTED = "mission_aborted"
    GUARD_NEAR = "guard_near"
    BATTERY_LOW = "battery_low"


@dataclass(frozen=True, slots=True)
class Definition:
    name: AlarmName
    level: AlarmLevel  # how urgent it is
    text: Callable[[Situation], Text]  # what is said
    # Whether it is so: True begins it, False ends it, None leaves it as it is.
    judge: Callable[[Situation], bool | None] | None = None
    begins_after: float = 0.0  # seconds for which it has to be so
    ends_after: float = 0.0  # seconds for which it has to be so no more
    # For what only happens: what tells one time from another; None while it has not happened.
    # An operator who sees the mark first was not there when it happened.
    mark: Callable[[Situation], object] | None = None
    within: AlarmName | None = None  # a stronger alarm: while that one is so, this one is not shown


# -- when each is so -------------------------------------------------------------------------------


def _link_lost(now: Situation) -> bool | None:
    if now.hearing is not Hearing.HEARD or now.connection == "lost":
        return True
    return False if now.connection == "connected" else None


def _link_old(now: Situation) -> bool | None:
    age = now.telemetry_age
    if not now.is_connected or age is None:
        return None
    return True if age > MAX_TELEMETRY_AGE else False if age < _LINK_CLEAR_AGE else None


def _lands_itself(now: Situation) -> bool | None:
    if now.phase is None:
        return None
    is_landing = now.phase in (FlightPhase.LANDING, FlightPhase.FINISHING_LANDING)
    return is_landing and now.task not in ("land", "go home") and not now.has_mission


def _battery_critical(now: Situation) -> bool | None:
    return False if now.is_on_ground else is_low(now.battery, BATTERY_CRITICAL)


def _battery_floor(now: Situation) -> bool | None:
    floor = now.limits.battery_floor_percent
    if floor is None or not now.has_authority or now.is_on_ground:
        return False
    return is_low(now.battery, floor - 1)


def _gps(now: Situation) -> bool | None:
    if now.is_on_ground:
        return False  # before take-off the checklist tells it
    return None if now.gps is None else now.gps < GOOD_GPS


def _authority_lost(now: Situation) -> bool | None:
    if not now.is_connected:
        return None
    return now.has_lease and not now.has_authority and now.loss is not None


def _nearness(now: Situation) -> list[tuple[float, float, str]]:
    """Height and distance that are known and limited: value, limit, key of the words."""
    limits = now.limits
    pairs = (
        (now.height, limits.max_height_m, "alarms.guard_near.height"),
        (now.distance, limits.max_radius_m, "alarms.guard_near.radius"),
    )
    return [
        (value, limit, key)
        for value, limit, key in pairs
        if value is not None and limit is not None
    ]


def _guard_near(now: Situation) -> bool | None:
    if not now.has_authority or now.is_on_ground:
        return False
    parts = [value / limit for value, limit, _ in _nearness(now)]
    if not parts:
        return None
    return True if max(parts) >= _NEAR else False if max(parts) < _CLEAR else None


# -- what each says --------------------------------------------------------------------------------

_LOSSES = {
    LossReason.MODE_SWITCH: "alarms.authority_lost.switch",
    LossReason.APP: "alarms.authority_lost.app",
    LossReason.LINK: "alarms.authority_lost.link",
}
_ENDS = {
    LeaseChange.TAKEN_OVER: "alarms.lease_taken.taken",
    LeaseChange.EXPIRED: "alarms.lease_taken.expired",
}


_TASKS = (Flown.TAKE_OFF, Flown.LAND, Flown.GO_HOME)
_GOES_ON = {one: f"alarms.flown.{one.value}.goes_on" for one in _TASKS}
_STOPPED = {one: f"alarms.flown.{one.value}" for one in Flown}


def _charge(key: str) -> Callable[[Situation], Text]:
    def text(now: Situation) -> Text:
        charge = tr("unit.unknown") if now.battery is None else now.battery
        return tr(key, percent=charge, floor=now.limits.battery_floor_percent)

    return text


def _guard_text(now: Situation) -> Text:
    value, limit, key = max(_nearness(now), key=lambda one: one[0] / one[1])
    return tr(key, value=Quantity.length(value), limit=Quantity.length(limit))


def _lands_text(now: Situation) -> Text:
    is_empty = now.battery is not None and now.battery <= BATTERY_CRITICAL
    return tr("alarms.lands_itself.battery" if is_empty else "alarms.lands_itself")


def _lease_text(now: Situation) -> Text:
    end = now.lease_end
    if end is None or end.why is None:
        return tr("alarms.lease_taken")
    lost = tr(_ENDS.get(end.why, "alarms.lease_taken"), name=end.name)
    is_kept = end.why is LeaseChange.TAKEN_OVER  # control authority, and by it a task
    if end.flown is Flown.NOTHING and not (is_kept and now.phase is FlightPhase.IN_AIR):
        return lost
    key = _GOES_ON if is_kept and end.flown in _TASKS else _STOPPED
    return tr("alarms.lease_taken.flown", lost=lost, flown=Text(key[end.flown]))


def _always(key: str) -> Callable[[Situation], Text]:
    return lambda now: tr(key)


_N, _L = AlarmName, AlarmLevel

ALARMS: tuple[Definition, ...] = (
    Definition(_N.LINK_LOST, _L.DANGER, _always("alarms.link_lost"), _link_lost),
    # The agent reports a landing that was asked for as a task a moment after it has begun.
    Definition(_N.LANDS_ITSELF, _L.DANGER, _lands_text, _lands_itself, begins_after=0.5),
    Definition(
        _N.BATTERY_CRITICAL, _L.DANGER, _charge("alarms.battery_critical"), _battery_critical
    ),
    Definition(_N.LEASE_TAKEN, _L.DANGER, _lease_text, mark=lambda now: now.lease_end),
    Definition(
        _N.LINK_OLD,
        _L.DANGER,
        _always("alarms.link_old"),
        _link_old,
        ends_after=1.0,
        within=_N.LINK_LOST,
    ),
    Definition(
        _N.NAVIGATION,
        _L.DANGER,
        lambda now: tr("alarms.navigation", what=now.contradiction),
        lambda now: bool(now.contradiction) if now.is_connected else None,
        ends_after=1.0,
        within=_N.LINK_LOST,
    ),
    Definition(
        _N.BATTERY_FLOOR,
        _L.DANGER,
        _charge("alarms.battery_floor"),
        _battery_floor,
        within=_N.BATTERY_CRITICAL,
    ),
    Definition(_N.GPS, _L.WARNING, _always("alarms.gps"), _gps, begins_after=1.0, ends_after=2.0),
    Definition(
        _N.AUTHORITY_LOST,
        _L.WARNING,
        lambda now: tr(_LOSSES.get(now.loss or LossReason.UNKNOWN, "alarms.authority_lost")),
        _authority_lost,
    ),
    Definition(
        _N.MISSION_ABORTED,
        _L.WARNING,
        lambda now: tr("alarms.mission_aborted", why=now.aborted_why),
        mark=lambda now: now.aborted or None,
    ),
    Definition(_N.GUARD_NEAR, _L.WARNING, _guard_text, _guard_near, ends_after=1.0),
    Definition(
        _N.BATTERY_LOW,
        _L.WARNING,
        _charge("alarms.battery_low"),
        lambda now: is_low(now.battery, BATTERY_LOW),
        within=_N.BATTERY_FLOOR,
    ),
)
"""The alarms, the most urgent first."""


# -- their life ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ActiveAlarm:
    name: AlarmName
    level: AlarmLevel  # how urgent it is
    state: AlarmState  # where it stands; quiet only in the report that it became so
    text: Text  # what it says; of one that has passed, what it said last
    at: float  # since when it stands so, on the station's clock, s


MOMENT_S = 10.0
"""Seconds of a replay for which the alarm of something that only happened is shown."""


def recorded_alarms(flight: RecordedFlight, now: Situation) -> tuple[ActiveAlarm, ...]:
    """The alarms of a recorded flight at the place of its replay: what its file says.

    Nothing is judged here, so a computer that is late raises none.
    """
    spans = {
        span.name: span
        for span in flight.story.alarms
        if 0.0 <= flight.at - span.begin_s <= (span.end_s - span.begin_s or MOMENT_S)
    }
    return tuple(
        ActiveAlarm(
            one.name,
            one.level,
            AlarmState.ACKNOWLEDGED,
            one.text(now),
            spans[one.name.value].begin_s,
        )
        for one in ALARMS
        if one.name.value in spans
    )


@dataclass(slots=True)
class _Watched:
    one: Definition
    state: AlarmState = AlarmState.QUIET  # where it stands
    is_so: bool = False  # what was judged last and was not unknown
    # When the judgement began to differ from the state; None while it does not.
    turned_at: float | None = None
    mark: object = None  # the newest that was seen
    text: Text = field(default_factory=lambda: Text("alarms.none"))  # what it said last
    at: float = 0.0  # since when it stands so, s

    def alarm(self) -> ActiveAlarm:
        return ActiveAlarm(self.one.name, self.one.level, self.state, self.text, self.at)


class AlarmManager:
    def __init__(self, definitions: tuple[Definition, ...] = ALARMS) -> None:
        self._watched = {one.name: _Watched(one) for one in definitions}
        self._has_looked = False

    @property
    def shown(self) -> tuple[ActiveAlarm, ...]:
        """Those that are not quiet, most urgent first, except those that a stronger one covers."""
        return tuple(
            watched.alarm()
            for watched in self._watched.values()
            if watched.state is not AlarmState.QUIET and not self._is_covered(watched.one)
        )

    @property
    def sounding(self) -> AlarmLevel | None:
        """The most urgent level that nobody has acknowledged; None for silence."""
        levels = {one.level for one in self.shown if one.state is AlarmState.RAISED}
        return next(
            (level for level in (AlarmLevel.DANGER, AlarmLevel.WARNING) if level in levels), None
        )

    def _is_covered(self, one: Definition) -> bool:
        stronger = one.within
        while stronger is not None:
            above = self._watched[stronger]
            if above.state in (AlarmState.RAISED, AlarmState.ACKNOWLEDGED):
                return True
            stronger = above.one.within
        return False

    def advance(self, now: Situation) -> list[ActiveAlarm]:
        changes: list[ActiveAlarm] = []
        for watched in self._watched.values():
            one = watched.one
            if one.mark is not None:
                changes += self._look_at_mark(watched, one.mark(now), now)
            elif one.judge is not None:
                changes += self._judge(watched, one.judge(now), now)
        self._has_looked = True
        return changes

    def acknowledge(self, name: AlarmName, at: float) -> list[ActiveAlarm]:
        """The operator knows of an alarm, and so of what it covers; returns what changed."""
        watched = self._watched[name]
        changes = self._feed(watched, AlarmInput.SEEN, at)
        if watched.one.mark is not None:  # what only happened is over when it is known
            changes += self._feed(watched, AlarmInput.ENDS, at)
        for covered, other in self._watched.items():
            if other.one.within is name and other.state is AlarmState.RAISED:
                changes += self.acknowledge(covered, at)
        return changes

    def _look_at_mark(self, watched: _Watched, mark: object, now: Situation) -> list[ActiveAlarm]:
        is_new = mark is not None and mark != watched.mark
        has_ended = mark is None and watched.mark is not None
        watched.mark = mark
        if is_new and self._has_looked:
            watched.text = watched.one.text(now)
            return self._feed(watched, AlarmInput.BEGINS, now.now)
        return self._feed(watched, AlarmInput.ENDS, now.now) if has_ended else []

    def _judge(self, watched: _Watched, verdict: bool | None, now: Situation) -> list[ActiveAlarm]:
        one = watched.one
        if verdict is not None and verdict is not watched.is_so:
            watched.turned_at = now.now if watched.turned_at is None else watched.turned_at
            needed = one.begins_after if verdict else one.ends_after
            if now.now - watched.turned_at >= needed:
                watched.is_so, watched.turned_at = verdict, None
                if verdict:
                    watched.text = one.text(now)
                what = AlarmInput.BEGINS if verdict else AlarmInput.ENDS
                return self._feed(watched, what, now.now)
        elif verdict is not None:
            watched.turned_at = None
            if verdict:
                watched.text = one.text(now)
        return []

    def _feed(self, watched: _Watched, what: AlarmInput, at: float) -> list[ActiveAlarm]:
        after = TRANSITIONS[watched.state].get(what)
        if after is None:
            return []
        watched.state, watched.at = after, at
        return [watched.alarm()]
