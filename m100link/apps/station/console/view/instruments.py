"""Instruments: names and texts of the values, and from when on each is stale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from m100link.apps.station.console.view.inputs import Inputs
from m100link.apps.station.console.view.units import Quantity
from m100link.apps.station.console.view.words import Text, say
from m100link.protocol.records import (
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightPhase,
    FlightStatus,
    Gimbal,
    Position,
    RemoteControl,
    Time,
    Velocity,
)
from m100link.telemetry.state import AircraftState, is_finite

__all__ = [
    "FIELDS",
    "Field",
    "Instruments",
    "Reading",
    "instruments_of",
    "live",
    "read",
    "seen_from_afar",
]


@dataclass(frozen=True, slots=True)
class Field:
    """A field of the console.

    Attributes:
        name: Identifies it in the page; ``instruments.<name>`` is what it is called.
        record: Telemetry record that it comes from.
        text: The value, to be said.
        stale_after: Seconds after which it is greyed out: a few times the slowest usual interval.
    """

    name: str
    record: type[Any]
    text: Callable[[Any], Text]
    stale_after: float = 1.0


@dataclass(frozen=True, slots=True)
class Reading:
    """A field as it is now.

    Attributes:
        text: The value, or a dash.
        is_stale: Whether it is too old to be believed, or was never there.
        note: Its age when it is stale; None where there is nothing to add.
    """

    text: Text
    is_stale: bool
    note: Text | None = None


def _phase(status: FlightStatus) -> Text:
    phase = status.phase
    if phase is None:
        return say("instruments.unknown_code", code=status.status)
    return Text(f"instruments.phase.{phase.name.lower()}")


def _device(item: ControlDevice) -> Text:
    device = item.device
    if device is None:
        return say("instruments.unknown_code", code=item.control)
    return Text(f"instruments.device.{device.name.lower()}")


def _charge(battery: Battery) -> Text:
    if battery.percent > 100:
        return say("instruments.unknown_code", code=battery.percent)
    return say("unit.percent", percent=battery.percent)


def _gps(position: Position) -> Text:
    health = position.gps_health
    if health is None:
        return say("instruments.gps.none")
    return Text(f"instruments.gps.{'good' if health >= 3 else 'low'}", {"health": health})


def _value(value: object) -> Text:
    return say("instruments.value", value=value)


def _place(degrees: float) -> Text:
    # With a point in every language: this is copied into other programs.
    return say("instruments.degrees", value=f"{degrees:.6f}")


def _gimbal(gimbal: Gimbal) -> Text:
    roll, pitch, yaw = map(round, (gimbal.roll_deg, gimbal.pitch_deg, gimbal.yaw_deg))
    return say("instruments.gimbal_angles", roll=roll, pitch=pitch, yaw=yaw)


FIELDS: tuple[Field, ...] = (
    Field("flight_status", FlightStatus, _phase, 2.0),
    Field("battery", Battery, _charge, 3.0),
    Field("gps", Position, _gps),
    Field("height", Position, lambda p: _value(Quantity.length(p.height_m, 1))),
    Field("altitude", Position, lambda p: _value(Quantity.length(p.altitude_m, 1))),
    Field("latitude", Position, lambda p: _place(p.latitude_deg)),
    Field("longitude", Position, lambda p: _place(p.longitude_deg)),
    Field("speed", Velocity, lambda v: _value(Quantity.speed(v.ground_speed_m_s))),
    Field("climb", Velocity, lambda v: _value(Quantity.speed(v.up_m_s, signed=True))),
    Field("heading", Attitude, lambda a: say("instruments.degrees", value=round(a.yaw_deg) % 360)),
    Field("gimbal", Gimbal, _gimbal),
    Field("mode_switch", RemoteControl, lambda rc: _value(rc.mode_switch.name)),
    Field("control_device", ControlDevice, _device, 2.0),
    Field("time", Time, lambda t: say("unit.seconds", seconds=t.seconds)),
)
"""The fields, in the order of the page."""


def read(field: Field, telemetry: AircraftState | None) -> Reading:
    """A field as it is now; without telemetry, as it is while no aircraft is connected."""
    record = telemetry.get(field.record) if telemetry is not None else None
    if telemetry is None or record is None:
        never = None if telemetry is None else say("instruments.never")
        return Reading(say("instruments.nothing"), is_stale=True, note=never)
    if not is_finite(record):
        return Reading(say("instruments.nothing"), is_stale=True)
    age = telemetry.age(field.record) or 0.0
    if age <= field.stale_after:
        return Reading(field.text(record), is_stale=False)
    return Reading(field.text(record), is_stale=True, note=say("instruments.old", age=round(age)))


@dataclass(frozen=True, slots=True)
class Instruments:
    """What the instruments show.

    Attributes:
        readings: A reading by the name of each of :data:`FIELDS`.
        attitude: Roll, pitch and yaw, degrees; None when it is older than a second.
    """

    readings: dict[str, Reading]
    attitude: tuple[float, float, float] | None


def instruments_of(inputs: Inputs) -> Instruments:
    """The instruments as they are now; what an agent told that is not heard any more is old."""
    telemetry = inputs.telemetry
    attitude = telemetry.finite(Attitude, within=1.0) if telemetry is not None else None
    return Instruments(
        {field.name: read(field, telemetry) for field in FIELDS},
        (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg) if attitude is not None else None,
    )


def live(state: AircraftState | None, now: float) -> dict[str, Any]:
    """What the instruments draw, twenty times a second; None for what is stale or missing."""
    message: dict[str, Any] = {"op": "live", "t": round(now, 3)}
    if state is None:
        return message
    age = state.newest_age
    if age is not None:
        message["age"] = round(age, 3)
    attitude, position = state.finite(Attitude, within=1.0), state.finite(Position, within=1.0)
    velocity, rates = state.finite(Velocity, within=1.0), state.finite(AngularVelocity, within=1.0)
    rc = state.fresh(RemoteControl, within=1.0)
    status = state.fresh(FlightStatus, within=2.0)
    if status is not None and status.phase is FlightPhase.STANDBY:
        message["ground"] = True
    if attitude is not None:
        message["att"] = [
            round(angle, 2) for angle in (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)
        ]
    if position is not None:
        message["pos"] = [
            round(position.latitude_deg, 8),
            round(position.longitude_deg, 8),
            round(position.height_m, 2),
        ]
    if velocity is not None:
        message["vel"] = [
            round(speed, 2)
            for speed in (
                velocity.ground_speed_m_s,
                velocity.up_m_s,
                velocity.north_m_s,
                velocity.east_m_s,
            )
        ]
    if rates is not None:
        message["yaw_rate"] = round(rates.yaw_rate_deg_s, 1)
    if rc is not None:
        message["rc"] = [rc.roll, rc.pitch, rc.yaw, rc.throttle]
    message["rate"] = round(state.statistics(Attitude).rate_hz or 0.0, 1)
    return message


def seen_from_afar(name: str, state: AircraftState | None) -> dict[str, Any]:
    """What the map draws of an aircraft that the page does not show; no place when it is old."""
    message: dict[str, Any] = {"name": name}
    position = state.fresh(Position, within=1.0) if state is not None else None
    attitude = state.finite(Attitude, within=1.0) if state is not None else None
    if position is not None and position.is_possible:
        message["pos"] = [
            round(position.latitude_deg, 7),
            round(position.longitude_deg, 7),
            round(position.height_m, 1),
        ]
    if attitude is not None:
        message["yaw"] = round(attitude.yaw_deg)
    return message
