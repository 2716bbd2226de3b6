"""What is known at one moment, as plain values: all that the view models read.

A value that is old counts as unknown here, and None says so: a view model that has None cannot
claim anything by mistake.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

from m100link.apps.agent.messages import LeaseChanged, Limits, Topic
from m100link.errors import LossReason
from m100link.geodesy import distance_m
from m100link.protocol.records import (
    Battery,
    ControlDevice,
    Device,
    FlightPhase,
    FlightStatus,
    Position,
    RcMode,
    RemoteControl,
)
from m100link.telemetry.integrity import GOOD_GPS

if TYPE_CHECKING:
    from m100link.apps.station.console.view.inputs import Inputs
    from m100link.telemetry.state import AircraftState

__all__ = [
    "FRESH_S",
    "Hearing",
    "Level",
    "Situation",
    "situation_of",
]

FRESH_S: dict[type[Any], float] = {
    Position: 1.2,
    RemoteControl: 1.2,
    ControlDevice: 2.0,
    FlightStatus: 2.0,
    Battery: 5.0,
}
"""Seconds for which an item is believed: more than one period of an item that is sent once a
second. The charge changes slowly and may miss four packages."""

R = TypeVar("R", bound=tuple[Any, ...])


class Level(Enum):
    """How urgent something is; the value is the class of the style sheet."""

    GOOD = "good"
    NEUTRAL = "neutral"
    WARNING = "warning"
    DANGER = "danger"


class Hearing(Enum):
    """How the station hears the agent that owns the aircraft."""

    HEARD = "heard"
    SILENT = "silent"  # for more than 2 s; it may hang, and may speak again
    GONE = "gone"  # for good


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What is known now. None is: unknown, or too old to be believed.

    Attributes:
        now: Time on the station's clock, s.
        hearing: Whether the agent is heard; while it is not, nothing below is up to date.
        heard_at: When it was heard last, s.
        connection: ``"connecting"``, ``"connected"`` or ``"lost"``.
        fault: Why it is not connected, in English; empty when nobody knows.
        is_activated: Whether the aircraft is active and its key in use.
        holding: State of control authority, by the agent's names.
        has_authority: Whether setpoints and tasks are obeyed.
        has_lease: Whether this tab may steer.
        holder: Who may steer; empty for nobody.
        lease_end: How this tab lost its lease, and to whom; None unless somebody or something
            else ended it.
        loss: Why authority was lost while this tab had the lease; None when it was not.
        task: What the aircraft flies by itself because it was told to; empty for nothing.
        pattern: Name of the program that flies; empty for none.
        mission: Kind of mission that flies, by the agent's names; empty when nobody knows.
        mission_index: Waypoint that it flies to, counted from 0.
        round_trip: Seconds to the aircraft and back.
        page_trip: Seconds to the page and back.
        telemetry_at: When any telemetry came last, s.
        switch: The pilot's mode switch.
        device: Who controls the aircraft, as the aircraft says.
        phase: Flight status.
        battery: Charge, %.
        gps: GPS health, 0 to 5.
        height: Above the take-off point, m.
        place: Latitude and longitude, °; None without good GPS.
        distance: From where control was obtained, m.
        contradiction: What cannot be true in telemetry, in English; empty while nothing is known
            to speak against it.
        limits: What the agent's guards allow.
        aborted: Number of the newest event that tells of a mission broken off; 0 for none.
        aborted_why: Its text, in English.
        is_virtual: Whether the aircraft is a simulated one.
        is_replay: Whether it is a recorded flight.
    """

    now: float = 0.0
    hearing: Hearing = Hearing.HEARD
    heard_at: float = 0.0
    connection: str = "connected"
    fault: str = ""
    is_activated: bool = False
    holding: str = "none"
    has_authority: bool = False
    has_lease: bool = False
    holder: str = ""
    lease_end: LeaseChanged | None = None
    loss: LossReason | None = None
    task: str = ""
    pattern: str = ""
    mission: str = ""
    mission_index: int | None = None
    round_trip: float | None = None
    page_trip: float | None = None
    telemetry_at: float | None = None
    switch: RcMode | None = None
    device: Device | None = None
    phase: FlightPhase | None = None
    battery: int | None = None
    gps: int | None = None
    height: float | None = None
    place: tuple[float, float] | None = None
    distance: float | None = None
    contradiction: str = ""
    limits: Limits = field(default_factory=Limits)
    aborted: int = 0
    aborted_why: str = ""
    is_virtual: bool = False
    is_replay: bool = False

    @property
    def telemetry_age(self) -> float | None:
        """Seconds since any telemetry came, None when none ever did."""
        return None if self.telemetry_at is None else self.now - self.telemetry_at

    @property
    def is_connected(self) -> bool:
        """Whether the aircraft is connected, by an agent that is heard."""
        return self.hearing is Hearing.HEARD and self.connection == "connected"

    @property
    def is_flown_here(self) -> bool:
        """Whether this tab steers: it has the lease, and the aircraft obeys the station."""
        return self.is_connected and self.has_lease and self.has_authority

    @property
    def has_mission(self) -> bool:
        """Whether a mission flies the aircraft, whoever started it."""
        return self.mission not in ("", "no mission", "IOC")

    @property
    def is_on_ground(self) -> bool | None:
        """Whether it stands; None when nobody knows."""
        return None if self.phase is None else self.phase is FlightPhase.STANDBY


def situation_of(inputs: Inputs) -> Situation:
    """What is known now."""
    state, holder = inputs.state, inputs.holder
    aborted = max(
        (event for event in inputs.events if event.topic is Topic.MISSION_ABORTED),
        key=lambda event: event.number,
        default=None,
    )
    return Situation(
        now=inputs.now,
        hearing=_hearing(inputs),
        heard_at=inputs.heard_at,
        connection=state.connection,
        fault=state.connection_fault.seen if state.connection_fault is not None else "",
        is_activated=state.is_activated,
        holding=state.holding,
        has_authority=state.has_authority,
        has_lease=inputs.has_lease,
        holder=holder.name if holder.number else "",
        lease_end=inputs.lease_end,
        loss=inputs.loss,
        task=state.task,
        pattern=state.pattern,
        mission=state.mission,
        mission_index=state.mission_index if state.mission_index >= 0 else None,
        round_trip=state.round_trip,
        page_trip=inputs.page_trip,
        limits=state.limits,
        aborted=aborted.number if aborted is not None else 0,
        aborted_why=aborted.text if aborted is not None else "",
        is_virtual=inputs.is_virtual,
        is_replay=inputs.is_replay,
        **_measured(inputs.telemetry, state.limits),
    )


def _hearing(inputs: Inputs) -> Hearing:
    if inputs.is_gone:
        return Hearing.GONE
    return Hearing.SILENT if inputs.is_silent else Hearing.HEARD


def _fresh(telemetry: AircraftState, record: type[R]) -> R | None:
    return telemetry.fresh(record, within=FRESH_S[record])


def _measured(telemetry: AircraftState | None, limits: Limits) -> dict[str, Any]:
    """What the telemetry tells, as far as it is fresh and possible."""
    if telemetry is None:
        return {}
    position = _fresh(telemetry, Position)
    if position is not None and not position.is_possible:
        position = None
    rc, device = _fresh(telemetry, RemoteControl), _fresh(telemetry, ControlDevice)
    status, battery = _fresh(telemetry, FlightStatus), _fresh(telemetry, Battery)
    gps = position.gps_health if position is not None else None
    place = None
    if position is not None and (gps is None or gps >= GOOD_GPS):
        place = position.latitude_deg, position.longitude_deg
    return {
        "telemetry_at": telemetry.newest_at,
        "switch": rc.mode_switch if rc is not None else None,
        "device": device.device if device is not None else None,
        "phase": status.phase if status is not None else None,
        "battery": battery.percent if battery is not None and battery.percent <= 100 else None,
        "gps": gps,
        "height": position.height_m if position is not None else None,
        "place": place,
        "distance": _distance(place, limits),
        "contradiction": telemetry.integrity.seen,
    }


def _distance(place: tuple[float, float] | None, limits: Limits) -> float | None:
    if place is None or limits.latitude_deg is None or limits.longitude_deg is None:
        return None
    return distance_m(*place, limits.latitude_deg, limits.longitude_deg)
