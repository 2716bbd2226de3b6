"""The aircraft of the station, one line for each: where it is, who has it, what it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from m100link.apps.station.console.view.inputs import Ship
from m100link.apps.station.console.view.units import Kind, Quantity
from m100link.apps.station.console.view.words import Text, say
from m100link.protocol.records import Battery, FlightPhase, FlightStatus, Position

__all__ = ["FleetRow", "fleet_of"]

_FRESH = 2.0
_LOW_PERCENT = 25


@dataclass(frozen=True, slots=True)
class FleetRow:
    """One aircraft.

    Attributes:
        name: What it is called.
        is_shown: Whether the page shows it and steers it.
        kind: ``"mine"``, ``"theirs"``, ``"free"`` or ``"lost"``: colour and shape.
        control: Who has control of it, or that nothing is known.
        flies: What it does: height, and what it flies by itself; a dash where that is old.
        battery: Charge; a dash where that is old.
        is_low: Whether the charge is low.
    """

    name: str
    is_shown: bool
    kind: str
    control: Text
    flies: Text
    battery: Text
    is_low: bool


def fleet_of(ships: Sequence[Ship]) -> tuple[FleetRow, ...]:
    """A row for each aircraft; none where there is only one."""
    return tuple(map(_row, ships)) if len(ships) > 1 else ()


def _row(ship: Ship) -> FleetRow:
    telemetry = ship.telemetry if ship.is_heard else None
    position = telemetry.finite(Position, within=_FRESH) if telemetry is not None else None
    battery = telemetry.fresh(Battery, within=2 * _FRESH) if telemetry is not None else None
    if battery is not None and battery.percent > 100:
        battery = None
    kind, control = _control(ship)
    return FleetRow(
        ship.name,
        ship.is_shown,
        kind,
        control,
        _flies(ship, position),
        say("fleet.unknown") if battery is None else say("fleet.percent", percent=battery.percent),
        is_low=battery is not None and battery.percent <= _LOW_PERCENT,
    )


def _control(ship: Ship) -> tuple[str, Text]:
    if not ship.is_heard:
        return "lost", say("fleet.not_heard")
    if ship.state.connection != "connected":
        return "lost", say("fleet.not_connected")
    if ship.is_ours:
        ours = say("fleet.ours"), say("fleet.ours_pilot_has_it")
        return "mine", ours[not ship.state.has_authority]
    if ship.holder.number:
        return "theirs", say("fleet.theirs", name=ship.holder.name)
    status = None
    if ship.telemetry is not None:
        status = ship.telemetry.fresh(FlightStatus, within=_FRESH)
    stands = status is not None and status.status == FlightPhase.STANDBY
    return "free", say("fleet.stands" if stands else "fleet.free")


def _flies(ship: Ship, position: Position | None) -> Text:
    if position is None:
        return say("fleet.unknown")
    height = Quantity(position.height_m, Kind.LENGTH)
    state = ship.state
    by_itself = state.task or state.pattern or state.mission
    if by_itself in ("", "no mission"):
        return say("fleet.height", height=height)
    return say("fleet.flies", height=height, what=by_itself)
