"""The agent's side of its fronts: what each of them is told, and when."""

from __future__ import annotations

import asyncio
from dataclasses import asdict

from m100link.aircraft import Aircraft
from m100link.apps.agent.agent import Agent
from m100link.apps.agent.carriers import Channel
from m100link.apps.agent.connection import ConnectionState
from m100link.apps.agent.fault import Fault, fault_of
from m100link.apps.agent.front import Front
from m100link.apps.agent.lease import Flown, Lease, LeaseChange
from m100link.apps.agent.messages import (
    Activating,
    AuthorityTaken,
    Event,
    FromMobile,
    LeaseChanged,
    LinkCounted,
    Message,
    MissionTold,
    PlanTold,
    State,
    Telemetry,
)
from m100link.apps.agent.mission import push_of
from m100link.errors import AuthorityLost
from m100link.flight.mission_state import MissionKind, MissionState
from m100link.flight.missions.events import MissionEvent
from m100link.link.statistics import ROUND_TRIP_BOUNDS_S
from m100link.protocol.codes import ActivationCode
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.sample import Sample

__all__ = ["STATE_INTERVAL", "Service"]

STATE_INTERVAL = 0.25
"""Seconds between two states that nothing changed in."""

_NONE = MissionKind.NONE
_BOUNDS = (*(str(bound) for bound in ROUND_TRIP_BOUNDS_S), "inf")


class Service:
    """Serves any number of fronts.

    Args:
        agent: The agent, running.
    """

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._fronts: set[Front] = set()
        self._told: tuple[object, ...] = ()
        self._plan = PlanTold()  # of the lease in force: what came under another one is void
        agent.connection.on_sample.append(self._sample)
        agent.connection.on_aircraft.append(self._aircraft_changed)
        agent.journal.on_event.append(self._event)
        agent.activation.on_code.append(self._activating)
        agent.holding.on_lost.append(self._authority_taken)
        agent.holding.on_mission_event = self._mission_event
        agent.on_lease.append(self._lease_changed)
        agent.background.spawn(self._keep_telling(), "state")

    def attach(self, channel: Channel) -> None:
        """Serve the front at the other end of this channel."""
        front = Front(
            self._agent,
            channel,
            on_gone=self._gone,
            before_outcome=self._tell_state,
            on_plan=self._plan_uploaded,
        )
        self._fronts.add(front)
        front.greet(self._state(), self._plan)

    def close(self) -> None:
        """Close the channels of all fronts."""
        for front in list(self._fronts):
            front.close("the agent ends")

    def _gone(self, front: Front) -> None:
        self._fronts.discard(front)

    # -- what fronts are told --------------------------------------------------------------------

    def _tell(self, message: Message) -> None:
        for front in tuple(self._fronts):
            front.tell(message)

    def _sample(self, sample: Sample) -> None:
        self._tell_state()
        # A profile of one's own is not known to a front under its name.
        if self._fronts and PROFILES.get(sample.profile.name) is sample.profile:
            self._tell(Telemetry(sample.value, sample.profile.name, sample.received_at))

    def _aircraft_changed(self, aircraft: Aircraft | None) -> None:
        self._tell_state()
        if aircraft is not None:
            self._agent.background.spawn(self._watch_mobile(aircraft), "data of the app")

    async def _watch_mobile(self, aircraft: Aircraft) -> None:
        async with aircraft.from_mobile() as messages:
            async for data in messages:
                self._tell(FromMobile(data))

    def _event(self, event: Event) -> None:
        self._tell_state()
        self._tell(event)

    def _activating(self, code: ActivationCode) -> None:
        self._tell(Activating(int(code)))

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._tell_state()
        self._tell(AuthorityTaken(Fault.of(error)))

    def _mission_event(self, event: MissionEvent) -> None:
        push = push_of(event)
        if push is not None:
            self._tell(MissionTold(*push))

    def _lease_changed(self, why: LeaseChange, lease: Lease | None, flown: Flown) -> None:
        number, name = (lease.number, lease.name) if lease is not None else (0, "")
        for front in self._fronts:
            front.forget_leases(but=number)
        self._tell(LeaseChanged(number, name, why, flown))
        self._tell_state()
        if self._plan != PlanTold():
            self._plan_uploaded(PlanTold())

    def _plan_uploaded(self, plan: PlanTold) -> None:
        self._plan = plan
        self._tell(plan)

    async def _keep_telling(self) -> None:
        lags: list[float] = []
        while True:
            due = self._agent.now + STATE_INTERVAL
            await asyncio.sleep(STATE_INTERVAL)
            lags.append(max(0.0, self._agent.now - due))
            self._told = ()
            self._tell_state()
            if len(lags) * STATE_INTERVAL >= 1.0:
                self._tell_counters(max(lags))
                lags.clear()

    def _tell_counters(self, lag: float) -> None:
        aircraft = self._agent.connection.aircraft
        if aircraft is not None:
            counted = aircraft.statistics()
            counters = asdict(counted)
            discards = counters.pop("discards")
            del counters["round_trips"]
            trips = counted.round_trips
            classes = dict(zip(_BOUNDS, trips.counts, strict=True))
            self._tell(
                LinkCounted(self._agent.now, counters, discards, lag, classes, trips.total_s)
            )

    def _tell_state(self) -> None:
        """Tell the state if it has changed: always before what is told because of it."""
        agent = self._agent
        holding, connection = agent.holding, agent.connection
        told = (
            connection.state,
            connection.error,
            connection.aircraft is not None and connection.aircraft.is_activated,
            agent.activation.code,
            agent.activation.error,
            holding.state,
            holding.has_authority,
            holding.task,
            holding.pattern,
            holding.guided_order,
            connection.aircraft.mission if connection.aircraft is not None else None,
            self._replay_told(),
        )
        if told != self._told:
            self._told = told
            if self._fronts:
                self._tell(self._state())

    def _replay_told(self) -> object:
        """What people change of a replay; its place changes by itself."""
        told = None if self._agent.replay is None else self._agent.replay.told()
        return None if told is None else (told.rate, told.is_paused, told.clock - told.position_s)

    def _state(self) -> State:
        agent = self._agent
        connection, activation, holding = agent.connection, agent.activation, agent.holding
        is_connected = connection.state is ConnectionState.CONNECTED
        aircraft = connection.aircraft if is_connected else None
        link = aircraft.statistics() if aircraft is not None else None
        mission = aircraft.mission if aircraft is not None else MissionState()
        flying = holding.flying
        return State(
            at=agent.now,
            connection=connection.state.value,
            connection_fault=None if is_connected else fault_of(connection.error),
            firmware=str(aircraft.firmware) if aircraft is not None else "",
            is_activated=aircraft is not None and aircraft.is_activated,
            activation_code=None if activation.code is None else int(activation.code),
            activation_fault=fault_of(activation.error),
            holding=holding.state.value,
            has_authority=holding.has_authority,
            task=holding.task or "",
            pattern=holding.pattern or "",
            guided=flying.guiding.told() if flying is not None else None,
            mission=mission.kind.value if mission.is_running or mission.kind is _NONE else "",
            mission_index=-1 if mission.index is None else mission.index,
            mission_status=-1 if mission.status is None else mission.status,
            lease_remaining=agent.desk.remaining(agent.now),
            round_trip=connection.round_trip,
            discards=sum(link.discards.values()) if link else 0,
            late_acks=link.late_acks + link.foreign_acks if link else 0,
            dropped_writes=link.dropped_writes if link else 0,
            mismatches=aircraft.telemetry_mismatches if aircraft is not None else 0,
            limits=holding.limits,
            replay=None if agent.replay is None else agent.replay.told(),
        )
