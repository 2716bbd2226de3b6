"""What is known at one moment, as plain values: all that the view models read.

A value that is old counts as unknown here, and None says so: a view model that has None cannot
claim anything by mistake.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any, TypeVar

from m100link.apps.agent.messages import Event, LeaseChanged, Limits, LinkCounted, State, Topic
from m100link.errors import LossReason, M100Error
from m100link.geodesy import distance_m
from m100link.missions.plan import WaypointPlan
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
from m100link.telemetry.state import AircraftState

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
    """What is known now. None is: unknown, or too old to be believed."""

    now: float = 0.0  # time on the station's clock, s
    # Whether the agent is heard; while it is not, nothing below is up to date.
    hearing: Hearing = Hearing.HEARD
    heard_at: float = 0.0  # when it was heard last, s
    connection: str = "connected"  # ``"connecting"``, ``"connected"`` or ``"lost"``
    fault: str = ""  # why it is not connected, in English; empty when nobody knows
    is_activated: bool = False  # whether the aircraft is active and its key in use
    holding: str = "none"  # state of control authority, by the agent's names
    has_authority: bool = False  # whether setpoints and tasks are obeyed
    has_lease: bool = False  # whether this tab may steer
    holder: str = ""  # who may steer; empty for nobody
    # How this tab lost its lease, and to whom; None unless somebody or something else ended it.
    lease_end: LeaseChanged | None = None
    # Why authority was lost while this tab had the lease; None when it was not.
    loss: LossReason | None = None
    task: str = ""  # what the aircraft flies by itself because it was told to; empty for nothing
    pattern: str = ""  # name of the program that flies; empty for none
    mission: str = ""  # kind of mission that flies, by the agent's names; empty when nobody knows
    mission_index: int | None = None  # waypoint that it flies to, counted from 0
    round_trip: float | None = None  # seconds to the aircraft and back
    page_trip: float | None = None  # seconds to the page and back
    telemetry_at: float | None = None  # when any telemetry came last, s
    switch: RcMode | None = None  # the pilot's mode switch
    device: Device | None = None  # who controls the aircraft, as the aircraft says
    phase: FlightPhase | None = None
    battery: int | None = None  # charge, %
    gps: int | None = None  # GPS health, 0 to 5
    height: float | None = None  # above the take-off point, m
    place: tuple[float, float] | None = None  # latitude and longitude, °; None without good GPS
    distance: float | None = None  # from where control was obtained, m
    # What cannot be true in telemetry, in English; empty while nothing is known to speak against
    # it.
    contradiction: str = ""
    limits: Limits = field(default_factory=Limits)  # what the agent's guards allow
    aborted: int = 0  # number of the newest event that tells of a mission broken off; 0 for none
    aborted_why: str = ""  # its text, in English
    is_virtual: bool = False  # whether the aircraft is a simulated one
    is_replay: bool = False  # whether it is a recorded flight

    @property
    def telemetry_age(self) -> float | None:
        """Seconds since any telemetry came, None when none ever did."""
        return None if self.telemetry_at is None else self.now - self.telemetry_at

    @property
    def is_connected(self) -> bool:
        """Whether the aircraft is connected, by an agent that is heard."""
        return self.hearing is Hearing.HEARD and self.connection == "connected"

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
        is_replay=state.replay is not None,
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


# -- what a view is made of ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ship:
    """What is known of one aircraft of the station."""

    name: str  # what it is called
    state: State  # where its agent stands, as it told last
    holder: LeaseChanged  # who has its lease
    telemetry: AircraftState | None  # newest values and their ages; None while it is not connected
    is_heard: bool  # whether what its agent told is news
    is_shown: bool  # whether the page shows it and steers it
    is_ours: bool  # whether the operator of the page has its lease


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Everything that a view may know."""

    now: float = 0.0  # time on the agent's clock, s
    # Where the agent stands, as it told last.
    state: State = field(default_factory=lambda: State(at=0.0))
    holder: LeaseChanged = field(default_factory=lambda: LeaseChanged(0, ""))  # who has the lease
    # Newest values and their ages; None while no aircraft is connected.
    telemetry: AircraftState | None = None
    is_silent: bool = False  # whether the agent was not heard for too long
    is_gone: bool = False  # whether the agent has gone for good
    has_lease: bool = False  # whether the tab that looks holds the lease
    # How that tab lost the lease, and to whom; None unless something else than the tab ended it.
    lease_end: LeaseChanged | None = None
    # Who or what took authority while that tab had the lease; None while it is held.
    loss: LossReason | None = None
    heard_at: float = 0.0  # when the agent was heard last, s
    wall: float = 0.0  # the same moment as ``now``, in seconds since 1970
    is_virtual: bool = False  # whether the aircraft is known to be a simulated one
    refusal: M100Error | None = None  # what was refused to that tab last
    plan: WaypointPlan | None = None  # what that tab uploaded last
    events: tuple[Event, ...] = ()  # what happened lately, oldest first
    link: LinkCounted | None = None  # what was counted on the line; None while there is none
    front_lag: float = 0.0  # seconds that the front was late at worst in the last second
    page_trip: float | None = None  # seconds to the page and back
    fleet: tuple[Ship, ...] = ()  # every aircraft of the station, this one among them
    # Messages and pictures that each client of the station did not get because it is slow, by its
    # name.
    dropped: tuple[tuple[str, int], ...] = ()

    @property
    def is_heard(self) -> bool:
        """Whether what the agent told is news."""
        return not self.is_silent and not self.is_gone
