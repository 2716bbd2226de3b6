"""The Fly view: the list before take-off, the buttons that can be pressed, instruments."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from m100link.apps.agent.client import VehicleView
from m100link.apps.agent.latency import MAX_ROUND_TRIP
from m100link.apps.station.console.view.situation import Inputs, Situation
from m100link.apps.station.console.view.texts import Quantity, Text, clock, tr
from m100link.protocol import records
from m100link.protocol.commands.gimbal import TakePhoto
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.integrity import GOOD_GPS, MAX_TELEMETRY_AGE
from m100link.telemetry.state import is_finite

# -- the list before take-off ----------------------------------------------------------------------
# Without some of it the aircraft would refuse (line, activation, control), so nobody is asked.
# About the rest the operator decides, and says why; the reason goes into the list of events. An
# unknown item is not right.

ENOUGH_BATTERY = 30  # charge, %, above which a flight begins: missions do not start at it or below

FREE_FOR_S = 300.0
"""Seconds for which the operator's word that the place is free holds: people walk."""

LEAST_REASON = 3  # characters of a reason at least

TAKE_OFF_HEIGHT = 1.2  # metres to which the aircraft takes off by itself

_MAX_LINE_TRIP = 0.3
"""Seconds to the aircraft and back; the radio of a good line takes a tenth of it."""


class ChecklistItem(Enum):
    """The items of the list, in the order of mending; the value is the key of its words."""

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
class Check:
    item: ChecklistItem  # what it is about
    state: ItemState  # how it stands
    seen: Text  # what telemetry says
    remedy: Text | None  # how to mend it; None where it is right
    is_needed: bool  # whether the aircraft or the station would refuse without it


@dataclass(frozen=True, slots=True)
class Checklist:
    checks: tuple[Check, ...]
    is_green: bool  # whether everything is right
    is_possible: bool  # whether all that is needed is right
    is_free_said: bool  # whether the operator's word for the place holds
    reason: str  # why the operator flies all the same; empty without one
    may_take_off: bool  # whether take-off is offered

    @property
    def missing(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.state is not ItemState.RIGHT)


# -- what is right ---------------------------------------------------------------------------------


_Finding = tuple[bool | None, Text]  # whether it is right, None when unknown; what telemetry says

_STATES = {True: ItemState.RIGHT, False: ItemState.WRONG, None: ItemState.UNKNOWN}
_UNKNOWN = Text("unit.unknown")


def _line(now: Situation) -> _Finding:
    age = now.telemetry_age
    if not now.is_connected or age is None:
        return False, tr("checklist.line.none")
    is_heard = age <= MAX_TELEMETRY_AGE
    return is_heard, tr("checklist.line.heard" if is_heard else "checklist.line.silent")


def _quality(now: Situation) -> _Finding:
    line, page = now.round_trip, now.page_trip
    if line is None or page is None:
        return None, _UNKNOWN
    seen = tr("checklist.quality.seen", line=round(1000 * line), page=round(1000 * page))
    return line <= _MAX_LINE_TRIP and page <= MAX_ROUND_TRIP, seen


def _activation(now: Situation) -> _Finding:
    if now.is_activated:
        return True, tr("checklist.activation.done")
    return False, now.activation_problem or tr("checklist.activation.none")


def _ground(now: Situation) -> _Finding:
    stands = now.is_on_ground
    if stands is None:
        return None, _UNKNOWN
    return stands, tr("checklist.ground.yes" if stands else "checklist.ground.no")


def _switch(now: Situation) -> _Finding:
    if now.switch is None:
        return None, _UNKNOWN
    return now.switch is records.RcMode.F, tr("checklist.switch.seen", switch=now.switch.name)


def _control(now: Situation) -> _Finding:
    if now.is_connected and now.has_lease and now.has_authority:
        return True, tr("checklist.control.yours")
    if now.holder and not now.has_lease:
        return False, tr("status.other", name=now.holder)
    return False, tr("checklist.control.none")


def _gps(now: Situation) -> _Finding:
    if now.gps is None:
        return None, _UNKNOWN
    return now.gps >= GOOD_GPS, tr("checklist.gps.seen", health=now.gps)


def _home(now: Situation) -> _Finding:
    is_known = now.place is not None
    return is_known or None, tr("checklist.home.here") if is_known else _UNKNOWN


def _battery(now: Situation) -> _Finding:
    if now.battery is None:
        return None, _UNKNOWN
    return now.battery > ENOUGH_BATTERY, tr("unit.percent", percent=now.battery)


def _guards(now: Situation) -> _Finding:
    height, radius = now.limits.max_height_m, now.limits.max_radius_m
    if height is None or radius is None:
        return False, tr("checklist.guards.off")
    seen = tr(
        "checklist.guards.seen", height=Quantity.length(height), radius=Quantity.length(radius)
    )
    return True, seen


_FINDERS: dict[ChecklistItem, Callable[[Situation], _Finding]] = {
    ChecklistItem.LINE: _line,
    ChecklistItem.QUALITY: _quality,
    ChecklistItem.ACTIVATION: _activation,
    ChecklistItem.GROUND: _ground,
    ChecklistItem.SWITCH: _switch,
    ChecklistItem.CONTROL: _control,
    ChecklistItem.GPS: _gps,
    ChecklistItem.HOME: _home,
    ChecklistItem.BATTERY: _battery,
    ChecklistItem.GUARDS: _guards,
}

ITEMS: dict[ChecklistItem, bool] = dict.fromkeys(ChecklistItem, False) | dict.fromkeys(
    (ChecklistItem.LINE, ChecklistItem.ACTIVATION, ChecklistItem.CONTROL), True
)
"""The items, and whether the aircraft or the station would refuse without each."""


# -- what the operator says ------------------------------------------------------------------------


class ChecklistModel:
    """The statements of one tab's operator about this take-off; a flight ends them."""

    def __init__(self) -> None:
        self._free_said_at = -math.inf
        self._reason = ""
        self.height = TAKE_OFF_HEIGHT  # metres to which it is to take off

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
        if now.is_on_ground is False:
            self._free_said_at, self._reason = -math.inf, ""  # the next take-off is another one
        is_free = self.is_free(now.now)
        findings = {item: find(now) for item, find in _FINDERS.items()}
        key = "checklist.free.said" if is_free else "checklist.free.unsaid"
        findings[ChecklistItem.FREE] = is_free, tr(key)
        checks = tuple(_check(item, *findings[item]) for item in ChecklistItem)
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


def _check(item: ChecklistItem, is_right: bool | None, seen: Text) -> Check:
    remedy = None if is_right else Text(f"checklist.{item.value}.remedy")
    return Check(item, _STATES[is_right], seen, remedy, ITEMS[item])


# -- which buttons can be pressed ------------------------------------------------------------------

FLIGHTS = frozenset({"take_off", "land", "go_home", "simple_task", "mission_start", "guide"})
"""Orders with which the aircraft begins to fly by itself."""

MISSIONS = frozenset({"mission_resume", "mission_stop"})

HELD = FLIGHTS | {"mission_resume"}
"""Orders to be held for a second: all that make the aircraft fly by itself, home and down too.
A stray click must not; a second's hold does no harm while the aircraft hovers. One press ends a
motion."""

CAMERA = frozenset({"photo", "video_start", "video_stop", "gimbal_centre", "gimbal"})
"""Orders to gimbal and camera: everything that flies goes on."""

ACTIONS = FLIGHTS | MISSIONS | CAMERA | {"stop", "pause", "obtain", "release", "mission_upload"}
"""Every button that is an order."""


_WITHOUT_CAMERA = frozenset(
    name for name, one in PROFILES.items() if one.generation < TakePhoto.SINCE
)

FROM_GROUND = frozenset({"take_off", "simple_task", "mission_start"})
"""Orders with which the aircraft leaves the ground if it stands there."""


def actions_of(inputs: Inputs, now: Situation, checklist: Checklist) -> frozenset[str]:
    """The orders that can be given now; STOP always can, where something may fly.

    The checklist offers orders that leave the ground. Where nobody knows whether the aircraft
    stands, it counts as standing. An aircraft that flies does not take off.
    """
    if now.is_replay:
        return frozenset()  # nothing flies, and nothing would obey
    state = inputs.vehicle.state
    has_control = inputs.has_lease and inputs.vehicle.has_authority
    offered = {"stop"}
    if now.is_connected and not has_control:
        offered.add("obtain")
    if inputs.has_lease:
        offered |= {"release", "mission_upload"}
    has_camera = state.firmware not in ("", *_WITHOUT_CAMERA) and now.is_activated
    if now.is_connected and has_camera and (inputs.has_lease or not now.holder):
        offered |= CAMERA
    if state.guided is not None:
        offered.add("pause")  # anybody may
    if has_control and state.mission not in ("", "no mission"):  # of any program
        offered |= MISSIONS | {"pause"}
    elif has_control and not state.task:
        offered |= FLIGHTS
        if now.is_on_ground is not False and not checklist.may_take_off:
            offered -= FROM_GROUND
        if now.is_on_ground is False:
            offered.discard("take_off")
    return frozenset(offered)


# -- instruments -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FieldSpec:
    name: str  # identifies it in the page; ``instruments.<name>`` is what it is called
    record: type[Any]  # telemetry record that it comes from
    text: Callable[[Any], Text]  # the value, to be said


@dataclass(frozen=True, slots=True)
class FieldReading:
    text: Text  # the value, or a dash
    is_stale: bool  # whether it is too old to be believed, or was never there
    note: Text | None = None  # its age when it is stale; None where there is nothing to add


def _phase(status: records.FlightStatus) -> Text:
    phase = status.phase
    if phase is None:
        return tr("instruments.unknown_code", code=status.status)
    return Text(f"instruments.phase.{phase.name.lower()}")


def _device(item: records.ControlDevice) -> Text:
    device = item.device
    if device is None:
        return tr("instruments.unknown_code", code=item.control)
    return Text(f"instruments.device.{device.name.lower()}")


def _gps_reading(position: records.Position) -> Text:
    health = position.gps_health
    if health is None:
        return tr("instruments.gps.none")
    return Text(f"instruments.gps.{'good' if health >= 3 else 'low'}", {"health": health})


def _value(value: object) -> Text:
    return tr("instruments.value", value=value)


def _place(degrees: float) -> Text:
    # With a point in every language: this is copied into other programs.
    return tr("instruments.degrees", value=f"{degrees:.6f}")


def _gimbal(gimbal: records.Gimbal) -> Text:
    roll, pitch, yaw = map(round, (gimbal.roll_deg, gimbal.pitch_deg, gimbal.yaw_deg))
    return tr("instruments.gimbal_angles", roll=roll, pitch=pitch, yaw=yaw)


def _charge(battery: records.Battery) -> Text:
    if not battery.is_possible:
        return tr("instruments.unknown_code", code=battery.percent)
    return tr("unit.percent", percent=battery.percent)


FIELDS: tuple[FieldSpec, ...] = (
    FieldSpec("flight_status", records.FlightStatus, _phase),
    FieldSpec("battery", records.Battery, _charge),
    FieldSpec("gps", records.Position, _gps_reading),
    FieldSpec("height", records.Position, lambda p: _value(Quantity.length(p.height_m, 1))),
    FieldSpec("altitude", records.Position, lambda p: _value(Quantity.length(p.altitude_m, 1))),
    FieldSpec("latitude", records.Position, lambda p: _place(p.latitude_deg)),
    FieldSpec("longitude", records.Position, lambda p: _place(p.longitude_deg)),
    FieldSpec("speed", records.Velocity, lambda v: _value(Quantity.speed(v.ground_speed_m_s))),
    FieldSpec("climb", records.Velocity, lambda v: _value(Quantity.speed(v.up_m_s, signed=True))),
    FieldSpec(
        "heading",
        records.Attitude,
        lambda a: tr("instruments.degrees", value=round(a.yaw_deg) % 360),
    ),
    FieldSpec("gimbal", records.Gimbal, _gimbal),
    FieldSpec("mode_switch", records.RemoteControl, lambda rc: _value(rc.mode_switch.name)),
    FieldSpec("control_device", records.ControlDevice, _device),
    FieldSpec("time", records.Time, lambda t: tr("unit.seconds", seconds=t.seconds)),
)
"""The fields, in the order of the page."""


def read(field: FieldSpec, view: VehicleView) -> FieldReading:
    """A field as it is now; without telemetry, as it is while no aircraft is connected."""
    record = view.telemetry.get(field.record) if view.telemetry is not None else None
    if record is None:
        never = None if view.telemetry is None else tr("instruments.never")
        return FieldReading(tr("instruments.nothing"), is_stale=True, note=never)
    if not is_finite(record):
        return FieldReading(tr("instruments.nothing"), is_stale=True)
    if view.is_new(field.record):
        return FieldReading(field.text(record), is_stale=False)
    old = tr("instruments.old", age=round(view.age(field.record) or 0.0))
    return FieldReading(field.text(record), is_stale=True, note=old)


@dataclass(frozen=True, slots=True)
class Instruments:
    # A reading by the name of each of :data:`FIELDS`, and ``flight_time``.
    readings: dict[str, FieldReading]
    # Roll, pitch and yaw, degrees; None when nobody knows.
    attitude: tuple[float, float, float] | None


def instruments_of(inputs: Inputs) -> Instruments:
    """The instruments as they are now; values of an agent that is not heard any more are old."""
    view = inputs.vehicle
    attitude = view.get(records.Attitude)
    readings = {field.name: read(field, view) for field in FIELDS}
    flown, phase = inputs.airborne_s, readings["flight_status"]
    time = tr("instruments.nothing") if flown is None else _value(clock(flown))
    readings["flight_time"] = FieldReading(time, phase.is_stale, phase.note)
    return Instruments(
        readings,
        (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg) if attitude is not None else None,
    )


def live(view: VehicleView) -> dict[str, Any]:
    """The data of the instruments, twenty times a second; None for what is stale or missing."""
    message: dict[str, Any] = {"op": "live", "t": round(view.at, 3)}
    if view.telemetry is None:
        return message
    if view.telemetry_at is not None:
        message["age"] = round(view.now - view.telemetry_at, 3)
    attitude, position = view.get(records.Attitude), view.get(records.Position)
    velocity, rates = view.get(records.Velocity), view.get(records.AngularVelocity)
    rc = view.get(records.RemoteControl)
    if attitude is not None:
        message["att"] = _rounded(2, attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)
    if position is not None:
        place = _rounded(8, position.latitude_deg, position.longitude_deg)
        message["pos"] = [*place, round(position.height_m, 2)]
    if velocity is not None:
        over_ground = velocity.ground_speed_m_s, velocity.up_m_s
        message["vel"] = _rounded(2, *over_ground, velocity.north_m_s, velocity.east_m_s)
    if rates is not None:
        message["yaw_rate"] = round(rates.yaw_rate_deg_s, 1)
    if rc is not None:
        message["rc"] = [rc.roll, rc.pitch, rc.yaw, rc.throttle]
    message["rate"] = round(view.telemetry.statistics(records.Attitude).rate_hz or 0.0, 1)
    return message


def _rounded(digits: int, *numbers: float) -> list[float]:
    return [round(one, digits) for one in numbers]


def seen_from_afar(name: str, view: VehicleView) -> dict[str, Any]:
    """The data for the map of an aircraft that the page does not show; no place when it is old."""
    message: dict[str, Any] = {"name": name}
    position, attitude = view.get(records.Position), view.get(records.Attitude)
    if position is not None:
        place = _rounded(7, position.latitude_deg, position.longitude_deg)
        message["pos"] = [*place, round(position.height_m, 1)]
    if attitude is not None:
        message["yaw"] = round(attitude.yaw_deg)
    return message
