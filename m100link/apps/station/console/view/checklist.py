"""Before take-off: what telemetry says about each thing that has to be right, and how to mend it.

Without some of it the aircraft would refuse (line, activation, control), so nobody is asked. About
the rest the operator decides, and says why; the reason goes into the list of events. What is
unknown is not right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from m100link.apps.agent.latency import MAX_ROUND_TRIP
from m100link.apps.station.console.view.situation import Situation
from m100link.apps.station.console.view.units import Quantity
from m100link.apps.station.console.view.words import Text, say
from m100link.protocol.records import RcMode
from m100link.telemetry.integrity import GOOD_GPS, MAX_TELEMETRY_AGE

__all__ = [
    "ENOUGH_BATTERY",
    "FREE_FOR_S",
    "ITEMS",
    "LEAST_REASON",
    "Check",
    "Checklist",
    "ChecklistDesk",
    "Finding",
    "Item",
    "ItemState",
]

ENOUGH_BATTERY = 30
"""Charge, %, above which a flight begins: missions do not start at it or below."""

FREE_FOR_S = 300.0
"""Seconds for which the operator's word that the place is free holds: people walk."""

LEAST_REASON = 3
"""Characters of a reason at least."""

_MAX_LINE_TRIP = 0.3
"""Seconds to the aircraft and back; the radio of a good line takes a tenth of it."""


class Item(Enum):
    """What has to be right, in the order of mending; the value is the key of its words."""

    LINE = "line"
    QUALITY = "quality"
    ACTIVATION = "activation"
    GROUND = "ground"
    SWITCH = "switch"
    CONTROL = "control"
    GPS = "gps"
    HOME = "home"
    BATTERY = "battery"
    GUARDS = "guards"
    FREE = "free"


class ItemState(Enum):
    """How it stands; the value is the class of the style sheet."""

    RIGHT = "right"
    WRONG = "wrong"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found.

    Attributes:
        state: How it stands.
        seen: What telemetry says.
    """

    state: ItemState
    seen: Text


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the list.

    Attributes:
        item: What it is about.
        state: How it stands.
        seen: What telemetry says.
        remedy: How to mend it; None where it is right.
        is_needed: Whether the aircraft or the station would refuse without it.
    """

    item: Item
    state: ItemState
    seen: Text
    remedy: Text | None
    is_needed: bool


@dataclass(frozen=True, slots=True)
class Checklist:
    """The whole list.

    Attributes:
        checks: Its lines.
        is_green: Whether everything is right.
        is_possible: Whether all that is needed is right.
        is_free_said: Whether the operator's word for the place holds.
        reason: Why the operator flies all the same; empty without one.
        may_take_off: Whether take-off is offered.
    """

    checks: tuple[Check, ...]
    is_green: bool
    is_possible: bool
    is_free_said: bool
    reason: str
    may_take_off: bool

    @property
    def missing(self) -> tuple[Check, ...]:
        """What is not right."""
        return tuple(check for check in self.checks if check.state is not ItemState.RIGHT)


# -- what is right --------------------------------------------------------------------------------


def _found(is_right: bool | None, seen: Text) -> Finding:
    states = {True: ItemState.RIGHT, False: ItemState.WRONG, None: ItemState.UNKNOWN}
    return Finding(states[is_right], seen)


_UNKNOWN = Text("unit.unknown")


def _line(now: Situation) -> Finding:
    age = now.telemetry_age
    if not now.is_connected or age is None:
        return _found(False, say("checklist.line.none"))
    is_heard = age <= MAX_TELEMETRY_AGE
    return _found(is_heard, say("checklist.line.heard" if is_heard else "checklist.line.silent"))


def _quality(now: Situation) -> Finding:
    line, page = now.round_trip, now.page_trip
    if line is None or page is None:
        return _found(None, _UNKNOWN)
    seen = say("checklist.quality.seen", line=round(1000 * line), page=round(1000 * page))
    return _found(line <= _MAX_LINE_TRIP and page <= MAX_ROUND_TRIP, seen)


def _activation(now: Situation) -> Finding:
    key = "checklist.activation.done" if now.is_activated else "checklist.activation.none"
    return _found(now.is_activated, say(key))


def _ground(now: Situation) -> Finding:
    stands = now.is_on_ground
    if stands is None:
        return _found(None, _UNKNOWN)
    return _found(stands, say("checklist.ground.yes" if stands else "checklist.ground.no"))


def _switch(now: Situation) -> Finding:
    if now.switch is None:
        return _found(None, _UNKNOWN)
    return _found(now.switch is RcMode.F, say("checklist.switch.seen", switch=now.switch.name))


def _control(now: Situation) -> Finding:
    if now.is_flown_here:
        return _found(True, say("checklist.control.yours"))
    if now.holder and not now.has_lease:
        return _found(False, say("status.other", name=now.holder))
    return _found(False, say("checklist.control.none"))


def _gps(now: Situation) -> Finding:
    if now.gps is None:
        return _found(None, _UNKNOWN)
    return _found(now.gps >= GOOD_GPS, say("checklist.gps.seen", health=now.gps))


def _home(now: Situation) -> Finding:
    is_known = now.place is not None
    return _found(is_known or None, say("checklist.home.here") if is_known else _UNKNOWN)


def _battery(now: Situation) -> Finding:
    if now.battery is None:
        return _found(None, _UNKNOWN)
    return _found(now.battery > ENOUGH_BATTERY, say("unit.percent", percent=now.battery))


def _guards(now: Situation) -> Finding:
    height, radius = now.limits.max_height_m, now.limits.max_radius_m
    if height is None or radius is None:
        return _found(False, say("checklist.guards.off"))
    seen = say(
        "checklist.guards.seen", height=Quantity.length(height), radius=Quantity.length(radius)
    )
    return _found(True, seen)


_FINDERS: dict[Item, Callable[[Situation], Finding]] = {
    Item.LINE: _line,
    Item.QUALITY: _quality,
    Item.ACTIVATION: _activation,
    Item.GROUND: _ground,
    Item.SWITCH: _switch,
    Item.CONTROL: _control,
    Item.GPS: _gps,
    Item.HOME: _home,
    Item.BATTERY: _battery,
    Item.GUARDS: _guards,
}

ITEMS: dict[Item, bool] = dict.fromkeys(Item, False) | dict.fromkeys(
    (Item.LINE, Item.ACTIVATION, Item.CONTROL), True
)
"""What has to be right, and whether it is refused without it."""


# -- what the operator says -----------------------------------------------------------------------


class ChecklistDesk:
    """What the operator of one tab said about this take-off; a flight ends it."""

    def __init__(self) -> None:
        self._free_said_at = -math.inf
        self._reason = ""

    def say_free(self, at: float, *, is_free: bool) -> None:
        """The operator looked around: nobody and nothing is near, and the way up is free."""
        self._free_said_at = at if is_free else -math.inf

    def is_free(self, now: float) -> bool:
        """Whether the operator's word for the place holds."""
        return now - self._free_said_at <= FREE_FOR_S

    def say_why(self, reason: str) -> None:
        """Why the operator takes off although not everything is right."""
        self._reason = " ".join(reason.split())[:200]

    def look(self, now: Situation) -> Checklist:
        """The list for a situation."""
        if now.is_on_ground is False:
            self._free_said_at, self._reason = -math.inf, ""  # the next take-off is another one
        is_free = self.is_free(now.now)
        findings = {item: find(now) for item, find in _FINDERS.items()}
        key = "checklist.free.said" if is_free else "checklist.free.unsaid"
        findings[Item.FREE] = _found(is_free, say(key))
        checks = tuple(_check(item, findings[item]) for item in Item)
        wrong = [check for check in checks if check.state is not ItemState.RIGHT]
        is_possible = not any(check.is_needed for check in wrong)
        has_reason = len(self._reason) >= LEAST_REASON
        return Checklist(
            checks=checks,
            is_green=not wrong,
            is_possible=is_possible,
            is_free_said=is_free,
            reason=self._reason if has_reason else "",
            may_take_off=is_possible and (not wrong or has_reason),
        )


def _check(item: Item, found: Finding) -> Check:
    is_right = found.state is ItemState.RIGHT
    remedy = None if is_right else Text(f"checklist.{item.value}.remedy")
    return Check(item, found.state, found.seen, remedy, ITEMS[item])
