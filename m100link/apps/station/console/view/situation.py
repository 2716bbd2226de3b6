"""The situation at one moment, as plain values: all that the view models read.

A value that is old counts as unknown here, and None says so: a view model that has None cannot
claim anything by mistake.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from m100link.apps.agent.client import Hearing, VehicleView
from m100link.apps.agent.messages import (
    Event,
    EventTopic,
    GuardLimits,
    LeaseChanged,
    LinkCounted,
    State,
)
from m100link.apps.station.console.view.texts import Text, problem_text, tr
from m100link.errors import LossReason, M100Error
from m100link.geodesy import distance_m
from m100link.log.story import FlightSummary
from m100link.missions.plan import WaypointPlan
from m100link.protocol.codes import ActivationCode
from m100link.protocol.records import Battery, ControlDevice, Device, FlightPhase, Position, RcMode


class AlarmLevel(Enum):
    """How urgent something is; the value is the class of the style sheet."""

    GOOD = "good"
    NEUTRAL = "neutral"
    WARNING = "warning"
    DANGER = "danger"


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The situation now, as far as it is known. None is: unknown, or too old to be believed."""

    now: float = 0.0  # time on the station's clock, s
    # Whether the agent is heard; while it is not, nothing below is up to date.
    hearing: Hearing = Hearing.HEARD
    heard_at: float = 0.0  # when it was heard last, s
    connection: str = "connected"  # ``"connecting"``, ``"connected"`` or ``"lost"``
    fault: str = ""  # why it is not connected, in English; empty when nobody knows
    is_activated: bool = False  # whether the aircraft is active and its key in use
    activation_problem: Text | None = None  # why activation failed; None while it did not
    holding: str = "none"  # state of control authority, by the agent's names
    has_authority: bool = False  # whether setpoints and tasks are obeyed
    has_lease: bool = False  # whether this tab may steer
    holder: str = ""  # who may steer; empty for nobody
    # How this tab lost its lease, and to whom; None unless somebody or something else ended it.
    lease_end: LeaseChanged | None = None
    # Why authority was lost while this tab had the lease; None when it was not.
    loss: LossReason | None = None
    task: str = ""  # what the aircraft flies by itself, by order; empty for nothing
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
    # The part of telemetry that cannot be true, in English; empty while none is known.
    contradiction: str = ""
    limits: GuardLimits = field(default_factory=GuardLimits)  # what the agent's guards allow
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
        return self.hearing is Hearing.HEARD and self.connection == "connected"

    @property
    def has_mission(self) -> bool:
        return self.mission not in ("", "no mission", "IOC")

    @property
    def is_on_ground(self) -> bool | None:
        """Whether it stands; None when nobody knows."""
        return None if self.phase is None else self.phase is FlightPhase.STANDBY


def situation_of(inputs: Inputs) -> Situation:
    view = inputs.vehicle
    state, holder = view.state, view.holder
    aborted = max(
        (event for event in inputs.events if event.topic is EventTopic.MISSION_ABORTED),
        key=lambda event: event.number,
        default=None,
    )
    position, place, device = view.get(Position), view.place, view.get(ControlDevice)
    battery = view.get(Battery)
    here = None if place is None else (place.latitude_deg, place.longitude_deg)
    return Situation(
        now=view.now,
        hearing=view.hearing,
        heard_at=view.now - (view.at - view.heard_at),
        connection=state.connection,
        fault=state.connection_fault.seen if state.connection_fault is not None else "",
        is_activated=state.is_activated,
        activation_problem=_activation_problem(state),
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
        telemetry_at=view.telemetry_at,
        switch=view.switch,
        device=None if device is None else device.device,
        phase=view.phase,
        battery=None if battery is None else battery.percent,
        gps=None if position is None else position.gps_health,
        height=None if position is None else position.height_m,
        place=here,
        distance=_distance(here, state.limits),
        contradiction=view.integrity.seen,
        limits=state.limits,
        aborted=aborted.number if aborted is not None else 0,
        aborted_why=aborted.text if aborted is not None else "",
        is_virtual=inputs.is_virtual,
        is_replay=state.replay is not None,
    )


def _activation_problem(state: State) -> Text | None:
    """The answer of the aircraft to the last activation, or why there is none."""
    if state.activation_fault is not None:
        return problem_text(state.activation_fault.error())
    if state.activation_code is None or state.is_activated:
        return None
    meaning = ActivationCode(state.activation_code).meaning
    return tr("checklist.activation.failed", why=meaning)


def _distance(place: tuple[float, float] | None, limits: GuardLimits) -> float | None:
    if place is None or limits.latitude_deg is None or limits.longitude_deg is None:
        return None
    return distance_m(*place, limits.latitude_deg, limits.longitude_deg)


# -- what a view is made of ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ship:
    name: str  # what it is called
    vehicle: VehicleView  # what may be believed of it
    is_shown: bool  # whether the page shows it and steers it
    is_ours: bool  # whether the operator of the page has its lease


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """A replay: what its file says, and where in the file it is."""

    story: FlightSummary
    at: float  # s after the beginning of the log
    other: FlightSummary | None = None  # another flight that is laid over it
    is_whole: bool = True  # else alarms and commands are not in the story yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    vehicle: VehicleView  # what may be believed of the aircraft
    has_lease: bool = False  # whether the tab that looks holds the lease
    # How that tab lost the lease, and to whom; None unless something else than the tab ended it.
    lease_end: LeaseChanged | None = None
    # How authority was lost while that tab had the lease; None while it is held.
    loss: LossReason | None = None
    wall: float = 0.0  # the same moment as that of the view, in seconds since 1970
    is_virtual: bool = False  # whether the aircraft is known to be a simulated one
    refusal: M100Error | None = None  # what was refused to that tab last
    plan: WaypointPlan | None = None  # what that tab uploaded last
    events: tuple[Event, ...] = ()  # what happened lately, oldest first
    flight: RecordedFlight | None = None  # of a replay, once its file was read
    flight_fault: str = ""  # why it cannot be read
    airborne_s: float | None = None  # since the last take-off; None when none was seen
    link: LinkCounted | None = None  # what was counted on the line; None while there is none
    front_lag: float = 0.0  # seconds that the front was late at worst in the last second
    page_trip: float | None = None  # seconds to the page and back
    fleet: tuple[Ship, ...] = ()  # every aircraft of the station, this one among them
    # Messages and pictures that each client of the station did not get because it is slow, by its
    # name.
    dropped: tuple[tuple[str, int], ...] = ()
