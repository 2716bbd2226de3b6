"""What a view is made of: what the agent told last, and what the tab has."""

from __future__ import annotations

from dataclasses import dataclass, field

from m100link.apps.agent.messages import Event, LeaseChanged, LinkCounted, State
from m100link.errors import LossReason, M100Error
from m100link.missions.plan import WaypointPlan
from m100link.telemetry.state import AircraftState

__all__ = ["Inputs", "Ship"]


@dataclass(frozen=True, slots=True)
class Ship:
    """What is known of one aircraft of the station.

    Attributes:
        name: What it is called.
        state: Where its agent stands, as it told last.
        holder: Who has its lease.
        telemetry: Newest values and their ages; None while it is not connected.
        is_heard: Whether what its agent told is news.
        is_shown: Whether the page shows it and steers it.
        is_ours: Whether the operator of the page has its lease.
    """

    name: str
    state: State
    holder: LeaseChanged
    telemetry: AircraftState | None
    is_heard: bool
    is_shown: bool
    is_ours: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Everything that a view may know.

    Attributes:
        now: Time on the agent's clock, s.
        state: Where the agent stands, as it told last.
        holder: Who has the lease.
        telemetry: Newest values and their ages; None while no aircraft is connected.
        is_silent: Whether the agent was not heard for too long.
        is_gone: Whether the agent has gone for good.
        has_lease: Whether the tab that looks holds the lease.
        lease_end: How that tab lost the lease, and to whom; None unless something else than the
            tab ended it.
        loss: Who or what took authority while that tab had the lease; None while it is held.
        heard_at: When the agent was heard last, s.
        wall: The same moment as ``now``, in seconds since 1970.
        is_virtual: Whether the aircraft is known to be a simulated one.
        refusal: What was refused to that tab last.
        plan: What that tab uploaded last.
        events: What happened lately, oldest first.
        link: What was counted on the line; None while there is none.
        front_lag: Seconds that the front was late at worst in the last second.
        page_trip: Seconds to the page and back.
        fleet: Every aircraft of the station, this one among them.
        dropped: Messages and pictures that each client of the station did not get because it is
            slow, by its name.
    """

    now: float = 0.0
    state: State = field(default_factory=lambda: State(at=0.0))
    holder: LeaseChanged = field(default_factory=lambda: LeaseChanged(0, ""))
    telemetry: AircraftState | None = None
    is_silent: bool = False
    is_gone: bool = False
    has_lease: bool = False
    lease_end: LeaseChanged | None = None
    loss: LossReason | None = None
    heard_at: float = 0.0
    wall: float = 0.0
    is_virtual: bool = False
    refusal: M100Error | None = None
    plan: WaypointPlan | None = None
    events: tuple[Event, ...] = ()
    link: LinkCounted | None = None
    front_lag: float = 0.0
    page_trip: float | None = None
    fleet: tuple[Ship, ...] = ()
    dropped: tuple[tuple[str, int], ...] = ()

    @property
    def is_replay(self) -> bool:
        """Whether it is a recorded flight."""
        return self.state.replay is not None

    @property
    def is_heard(self) -> bool:
        """Whether what the agent told is news."""
        return not self.is_silent and not self.is_gone

    @property
    def is_connected(self) -> bool:
        """Whether the aircraft is connected, by an agent that is heard."""
        return self.state.connection == "connected" and self.is_heard

    @property
    def has_control(self) -> bool:
        """Whether what this tab wants is obeyed."""
        return self.has_lease and self.state.has_authority and self.is_heard

    @property
    def flies_mission(self) -> bool:
        """Whether the aircraft says that it flies a mission, whoever started it."""
        return self.state.mission not in ("", "no mission")
