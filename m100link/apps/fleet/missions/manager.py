"""The missions of one aircraft, at its agent on board.

A plan comes whole or not at all: in one order, and the start names the digest of what it starts. So
nothing flies of an upload that was lost half-way, and nothing of one plan in the middle of another.
The aircraft hears of it when it is started; whatever ends the lease or the agent's block stops it.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import LeaseChanged, MissionReport, RemoteError, fault_of
from m100link.apps.agent.orders import StartMission, UploadPlan
from m100link.apps.fleet.payloads import MissionCard, MissionInput, MissionStage, after
from m100link.errors import M100Error, UsageError
from m100link.geodesy import distance_m
from m100link.missions.plan import WaypointPlan
from m100link.protocol.records import Position

_REACHED, _FINISHED = 2, 1
_ARRIVED = 4
"""The second byte of a push that a waypoint was reached; it says, too, that its actions ended."""

_MOST_REACHED = 1024


class MissionManager:
    def __init__(self, client: AgentClient) -> None:
        self._client = client
        self.stage = MissionStage.NONE  # how far the mission is
        self._plan: WaypointPlan | None = None
        self._digest, self._by, self._points = "", "", 0
        # One plan at a time goes to the agent, and none while it begins to fly one.
        self._telling = asyncio.Lock()
        self._reached, self._reached_count = bytearray(), 0
        self._begun_at: float | None = None
        self._ended_at: float | None = None
        self._is_paused = self._is_finished = False
        self._fault: RemoteError | None = None
        client.on_mission_report.append(self._on_report)
        client.on_lease.append(self._lease_changed)

    # -- orders ----------------------------------------------------------------------------------

    async def upload(self, lease: Lease, plan: UploadPlan, by: str) -> str:
        """Take a plan; the aircraft does not get it yet.

        Returns its digest, by which it is started. Raises UsageError: it is none that this version
        can read, or cannot be flown. Raises MissionRunning: one flies. Raises M100Error: as the
        agent tells.
        """
        async with self._telling:
            after(self.stage, MissionInput.UPLOADED)
            # Until the agent has it the one before is void.
            self.void()
            await self._client.ask(plan, lease)
            self._client.check(lease)
            self.stage = after(self.stage, MissionInput.UPLOADED)
            self._digest, self._plan, self._by = plan.digest, self._client.plan, by
            self._points = len(plan.points)
            self._clear()
            return self._digest

    def _clear(self) -> None:
        self._reached, self._reached_count = bytearray(), 0
        self._begun_at = self._ended_at = self._fault = None
        self._is_paused = self._is_finished = False

    async def start(self, lease: Lease, order: StartMission, asked_at: float | None) -> None:
        """Let the plan fly; done when it has begun, or when it is over.

        Raises UsageError: it is another plan, there is none, or one is being uploaded. Raises
        MissionRunning: one flies. Raises M100Error: as the agent tells.
        """
        after(self.stage, MissionInput.ASKED)
        if self._telling.locked():
            # Not to be waited for: somebody may press STOP meanwhile, and it would start behind it.
            raise UsageError(
                "a plan is being uploaded; nothing was started", remedy="start it afterwards"
            )
        async with self._telling:
            if not self._digest or order.digest != self._digest:
                raise UsageError(
                    "the plan to start is not the one on board; nothing was started",
                    cause="another plan was uploaded since, or the lease of the upload ended",
                    remedy="upload it again, then start",
                )
            self.stage = after(self.stage, MissionInput.ASKED)
            self._clear()
            whole = replace(order, until_over=True)
            work = partial(self._fly, lease, whole, asked_at)
            flying = await self._client.background.begin(work, "mission of a fleet")
        if order.until_over:
            await asyncio.wait([flying])
            flying.result()

    async def _fly(
        self, lease: Lease, order: StartMission, asked_at: float | None, begun: asyncio.Event
    ) -> None:
        def accepted() -> None:
            self.stage = after(self.stage, MissionInput.BEGUN)
            self._begun_at = self._client.now
            begun.set()

        try:
            await self._client.ask(order, lease, accepted, asked_at)
            self._is_finished = True
        except M100Error as error:
            self._fault = fault_of(error)
            raise
        finally:
            self.stage = after(self.stage, MissionInput.ENDED)
            self._ended_at = self._client.now
            self._is_paused = False

    def void(self) -> None:
        """The plan on board is not the one that was named any more."""
        self._digest, self._plan = "", None

    def paused(self, *, is_paused: bool) -> None:
        self._is_paused = is_paused and self.stage is MissionStage.FLYING

    def _on_report(self, report: MissionReport) -> None:
        if report.event == _REACHED and report.data[1:2] == bytes([_ARRIVED]):
            self._reached += report.data[:1]
            del self._reached[:-_MOST_REACHED]
            self._reached_count += 1
        elif report.event == _FINISHED:
            self._is_finished = True

    def _lease_changed(self, change: LeaseChanged) -> None:
        self.stage = after(self.stage, MissionInput.LEASE_ENDED)
        self.void()  # the next holder starts nothing of it

    @property
    def words(self) -> str:
        """The mission that the aircraft flies by itself, in words; empty for none."""
        state = self._client.state
        if self.stage is MissionStage.FLYING:
            paused = ", paused" if self._is_paused else ""
            return f"mission, {len(set(self._reached))} of {self._points}{paused}"
        return "" if state.mission == "no mission" else state.mission

    def card(self, name: str, boot: str) -> MissionCard:
        client, state, plan = self._client, self._client.state, self._plan
        until = client.now if self._ended_at is None else self._ended_at
        index = state.mission_index
        position = client.view.get(Position)
        ahead = plan.waypoints[index:] if plan is not None and index >= 0 else ()
        distance = None
        if self.stage is MissionStage.FLYING and ahead and position:
            there = (ahead[0].latitude_deg, ahead[0].longitude_deg)
            distance = distance_m(position.latitude_deg, position.longitude_deg, *there)
        return MissionCard(
            name=name,
            boot=boot,
            stage=self.stage,
            by=self._by,
            digest=self._digest,
            points=self._points,
            reached=bytes(self._reached),
            reached_count=self._reached_count,
            is_paused=self._is_paused,
            is_finished=self._is_finished,
            fault=self._fault,
            kind=state.mission,
            index=None if index < 0 else index,
            status=None if state.mission_status < 0 else state.mission_status,
            elapsed_s=0.0 if self._begun_at is None else until - self._begun_at,
            distance_m=distance,
            height_m=None if position is None else position.height_m,
        )
