"""An aircraft of a fleet in a show: on board, beside its agent, which has control and the guards.

It loads a track, takes its place, gets the time to begin, and flies by its own clock. From then on
it does not need the network; until then it leaves when the conductor falls silent. When it has to
leave (its tube, the clock, telemetry, a guard, another aircraft that it would come too near to), it
hovers or lands, as chosen. When somebody else wants the aircraft (STOP, a take-over, the pilot), it
lets go of the aircraft and does nothing more.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Literal

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.latency import DRIFT
from m100link.apps.agent.messages import Event, EventTopic
from m100link.apps.agent.orders import ChangeHeight, FlyTo
from m100link.apps.agent.preview import require_inside
from m100link.apps.fleet.expiry import OrderExpiry
from m100link.apps.fleet.payloads import (
    LeaveShow,
    LoadTrack,
    ShowOrder,
    ShowStage,
    StartShow,
    TakePlace,
)
from m100link.apps.fleet.show.plan import conflicts
from m100link.apps.fleet.show.plan.steering import LeftShow, TrackSteering, Why
from m100link.apps.fleet.show.plan.track import BadShow, TimedPoint, TimedTrack, Vector
from m100link.errors import M100Error, NoAuthority, TelemetryStalled, UsageError
from m100link.flight.guards import MAX_COMMAND_M_S
from m100link.flight.pacing import Ticker
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Position, Velocity
from m100link.protocol.setpoint import Setpoint

Leave = Literal["hover", "land"]

ATTENDED_S = 10.0
"""Seconds without a message of the conductor after which an aircraft that takes or has its place
leaves: nobody waits for it there any more."""

_LOOK_S = 0.2
_ASSURED_S = 1.0
"""Seconds before the beginning at which all have to be heard; soon after it they begin to move."""
_REMEMBERED_S = 600.0
"""Seconds after its track in which one still tells the others where it is."""


ALLOWED: dict[type[ShowOrder], frozenset[ShowStage]] = {
    LoadTrack: frozenset({ShowStage.EMPTY, ShowStage.LOADED, ShowStage.FLOWN, ShowStage.LEFT}),
    TakePlace: frozenset({ShowStage.LOADED}),
    StartShow: frozenset({ShowStage.READY}),
    # Leaving is always possible, any number of times.
    LeaveShow: frozenset(ShowStage),
}


_BUSY = (ShowStage.PLACING, ShowStage.READY, ShowStage.FLYING)
_IN_SHOW = (ShowStage.LOADED, *_BUSY)


class TrackExecutor:
    def __init__(self, client: AgentClient, name: str) -> None:
        self._client = client
        self._name = name
        self.stage = ShowStage.EMPTY  # how far it is
        self.fault: M100Error | None = None  # why it left, or did not land; None otherwise
        self.track: TimedTrack | None = None  # what it is loaded with; None for nothing
        self.farthest_m = 0.0  # farthest from its track, by its own telemetry
        # The others of the show; None when it was loaded without a word about them.
        self.neighbours: conflicts.Neighbours | None = None
        # Which orders come too late: nobody waits for them, or it was stopped since.
        self.ages = OrderExpiry()
        # The id of the conductor's run, another one each time; empty when none was given.
        self.run = ""
        self._rest: conflicts.RestOfTrack | None = None
        # When its show begins, by the agent's clock; None before that is known.
        self._start_at: float | None = None
        self._placed_at = 0.0  # when its flight was asked for, s: a STOP since then ends it
        self._leave = "land"
        self._control = ControlSession(client, f"show of {name}")
        self._control.on_refused = self._steer_refused
        self._refused: M100Error | None = None  # why the last setpoint was not flown
        self._work: asyncio.Task[None] | None = None
        self._heard_at = client.now  # the conductor, or a question for its stage
        client.on_event.append(self._hear)
        client.on_authority_taken.append(self.give_way)

    def close(self) -> None:
        """Leave, and hear nothing more of the agent; not even a landing is seen to its end."""
        self.leave()
        if self._work is not None:
            self._work.cancel()
        self._control.close()
        self._client.on_event.remove(self._hear)
        self._client.on_authority_taken.remove(self.give_way)

    def _hear(self, event: Event) -> None:
        if event.topic in (EventTopic.STOPPED, EventTopic.HALTED):
            # An order to take off may be on its way here, of somebody who has not seen it.
            self.ages.revoke(self._client.now)
            begins = "begin the show again when all of them hover or stand"
            self.give_way(NoAuthority(f"{self._name} was stopped: {event.text}", remedy=begins))

    def _steer_refused(self, error: M100Error) -> None:
        self._refused = error

    def give_way(self, error: M100Error) -> None:
        """Somebody else has the aircraft, or its conductor was revoked: it leaves."""
        if self.stage in _IN_SHOW:
            self.fault = error
            self.leave()
        elif self.stage is ShowStage.LEFT and isinstance(self.fault, NoAuthority):
            # The report that nothing is flown comes before that of the taker.
            self.fault = error

    def heard(self, run: str = "") -> None:
        """The conductor is present; questions of another run do not count."""
        if run in ("", self.run):
            self._heard_at = self._client.now

    def require_run(self, run: str) -> None:
        """Refuse an order of somebody who does not conduct the show that it is in."""
        silent = self._client.now - self._heard_at
        # A track is loaded, and nobody conducts any more.
        is_over = self.stage is ShowStage.LOADED and silent > ATTENDED_S
        if run not in ("", self.run) and self.stage in _IN_SHOW and not is_over:
            raise UsageError(
                f"{self._name} is {self.stage.value} in a show of another conductor",
                cause="two programs conduct shows with the same aircraft, or an order came late",
                remedy=f"wait until that show is over, or end it: m100link fleet stop {self._name}",
            )

    # -- orders ----------------------------------------------------------------------------------

    @property
    def is_landing(self) -> bool:
        """Whether it lands behind its track."""
        return self.stage is ShowStage.FLOWN and self._control.has_lease

    def _require(self, order: type[ShowOrder], what: str) -> None:
        is_landing = order is LoadTrack and self._control.has_lease
        if self.stage not in ALLOWED[order] or is_landing:
            stage = f"{self.stage.value}{' and landing' * is_landing}"
            left = "" if self.fault is None else f"it left: {self.fault.seen}"
            raise UsageError(
                f"{self._name} is {stage} and cannot {what}",
                cause=left or "two programs conduct the same show, or an order came late",
                remedy="let it leave, and begin again: load, place, start",
            )

    def load(
        self, data: bytes, leave: str, neighbours: conflicts.Neighbours | None = None, run: str = ""
    ) -> str:
        """Take a track.

        Returns its digest, for the sender to compare. ``leave``: what follows the track, or its
        early end. ``neighbours``: the others of the show; None: they are not looked at. ``run``: of
        the conductor; until it is over, orders of others are refused. Raises BadShow: it is none,
        or another aircraft's. Raises UsageError: it is in a show. Raises ShowRefused, GuardRefused:
        as :meth:`place`, which none is asked for before all are loaded.
        """
        self._require(LoadTrack, "load")
        track = TimedTrack.from_bytes(data)
        if track.name != self._name:
            raise BadShow(
                f"the track of {track.name} came to {self._name}",
                aircraft=(self._name,),
                remedy="upload to each aircraft the track of its own name",
            )
        if leave not in ("hover", "land"):
            raise UsageError(f"leave cannot be {leave!r}", remedy="hover or land")
        self._require_flyable(track)
        self.track, self._leave, self.fault = track, leave, None
        self.neighbours, self._rest = neighbours, conflicts.RestOfTrack(track)
        self._start_at, self.run = None, run
        self.heard()
        self.stage = ShowStage.LOADED
        return track.digest

    def place(self, who: str, asked_at: float) -> None:
        """Begin to take off and to fly to the first point; ``asked_at``: as an agent's client.

        Raises ShowRefused, GuardRefused: the guards of its agent would end its track.
        """
        self._require(TakePlace, "place")
        self._require_flyable(self._loaded())
        self.heard()
        self.stage, self._placed_at = ShowStage.PLACING, asked_at
        self._do(lambda: self._place(who, asked_at))

    def start(self, digest: str, start_at: float, bound: float) -> None:
        """Begin the track at a time.

        ``start_at``: by the agent's clock, s. ``bound``: by how much the sender may be wrong about
        that clock, s. Raises ShowRefused: the clock, the time or the place is wrong. Raises
        UsageError: it is not ready, or loaded with another track.
        """
        self._require(StartShow, "start")
        track = self._loaded()
        if digest != track.digest:
            raise UsageError(f"{self._name} is loaded with another track", remedy="load it again")
        steering = TrackSteering(track, self._fastest)
        steering.require_ready(start_at - self._client.now, bound, self._here(track))
        self.stage, self._start_at = ShowStage.FLYING, start_at
        self._do(lambda: self._fly(track, steering, start_at, bound))

    def end_early(self) -> None:
        """End it for its conductor: it hovers or lands, as chosen."""
        if self.stage in _BUSY and self._leave == "land" and self._control.has_control:
            self.ages.revoke(self._client.now)
            self.stage = ShowStage.LEFT
            self._do(self._end)
        else:
            self.leave()

    def leave(self) -> None:
        """End it, wherever it is: control is given back, and it hovers.

        An aircraft that lands because its show has ended lands on: STOP ends that.
        """
        self.ages.revoke(self._client.now)
        if self.stage not in _IN_SHOW:
            return
        if self._work is not None:
            self._work.cancel()
        self.stage = ShowStage.LEFT
        self._control.let_go()

    def ahead(self) -> conflicts.ConflictMonitor | None:
        """Where it will be, for the others of its show; None when there is nothing to tell."""
        track, show, start_at = self.track, self.neighbours, self._start_at
        if track is None or show is None or start_at is None:
            return None
        at = self._client.now - start_at
        if at > track.end + _REMEMBERED_S:
            return None
        try:
            here = self._here(track)
        except TelemetryStalled:
            return None  # nobody knows; it leaves for that, or has left
        if self.stage is ShowStage.FLYING:
            return conflicts.by_track(show.show, track, at, here)
        speed = self._client.view.to_steer_by(Velocity)
        moves = (0.0, 0.0, 0.0)
        if speed is not None:
            moves = speed.north_m_s, speed.east_m_s, speed.up_m_s
        ahead = conflicts.by_speed(show.show, self._name, at, here, moves)
        return replace(ahead, origin=track.origin)

    def hear(self, ahead: conflicts.ConflictMonitor) -> None:
        """Another aircraft tells where it will be, in this show or in another one."""
        others, now = self.neighbours, self._client.now
        if others is None:
            return
        if ahead.show != others.show and ahead.origin is not None and self._start_at is not None:
            ahead = ahead.seen_from(self._loaded().origin, now - self._start_at, others.show)
        others.hear(ahead, now)

    # -- what it does ----------------------------------------------------------------------------

    @property
    def _fastest(self) -> float:
        """The most that may be asked for horizontally, m/s: what the agent's guards let pass."""
        most = self._client.state.limits.max_speed_m_s
        return min(MAX_COMMAND_M_S, MAX_COMMAND_M_S if most is None else most) * (1 - 1e-6)

    def _require_flyable(self, track: TimedTrack) -> None:
        client, first = self._client, track.points[0]
        TrackSteering(track, self._fastest).require_fast_enough()
        highest = max(track.points, key=lambda one: one.height)
        farthest = max(
            track.points, key=lambda one: math.hypot(one.north - first.north, one.east - first.east)
        )
        legs = (self._flight_to(track, one) for one in (first, highest, farthest))
        require_inside(legs, client.view.telemetry, client.state.limits)

    def _loaded(self) -> TimedTrack:
        assert self.track is not None, "every stage from LOADED on has one"
        return self.track

    def _do(self, work: Callable[[], Awaitable[None]]) -> None:
        async def guarded() -> None:
            try:
                await work()
            except M100Error as error:
                await self._leave_for(error)
            except Exception:
                # Whatever failed: in its stage it would count as flying its track.
                failed = f"the agent of {self._name} failed in the show"
                await self._leave_for(M100Error(failed, remedy="read the log of its agent"))
                raise

        if self._work is not None:
            self._work.cancel()
        self._work = self._client.background.spawn(guarded(), "show")

    async def _leave_for(self, error: M100Error) -> None:
        self.fault, self.stage = error, ShowStage.LEFT
        self._client.note(f"show: {error.seen}", "error")
        await self._end()

    async def _place(self, who: str, asked_at: float) -> None:
        client, track = self._client, self._loaded()
        TrackSteering(track, 1.0).require_below(self._here(track))
        self._control.name = f"show of {who}"
        attending = client.background.spawn(self._attend(), "conductor of a show")
        try:
            # It keeps the lease until the order to begin.
            async with self._control.kept():
                await self._control.obtain(asked_at=asked_at)
                lease = client.check(self._control.lease)
                await self._take_place(partial(client.ask, lease=lease, asked_at=asked_at), track)
                self.stage = ShowStage.READY
                await asyncio.Event().wait()
        finally:
            attending.cancel()

    async def _take_place(self, ask: Callable[..., Awaitable[object]], track: TimedTrack) -> None:
        if not self._client.view.is_airborne:
            await ask(orders.TakeOff())
        first = self._flight_to(track, track.points[0])
        await ask(ChangeHeight(first.height))
        await ask(first)

    def _flight_to(self, track: TimedTrack, point: TimedPoint) -> FlyTo:
        speed = min(FlyTo.speed, self._fastest)
        place = LocalFrame(*track.origin).to_geodetic(point.north, point.east)
        return FlyTo(*place, point.height - track.ground_m, speed, track.heading_deg)

    async def _attend(self) -> None:
        while True:
            rest = self._heard_at + ATTENDED_S - self._client.now
            if rest <= 0.0:
                break
            await asyncio.sleep(rest)
        self._do(self._abandoned)

    async def _abandoned(self) -> None:
        raise LeftShow(
            f"{self._name} left the show before it began: the conductor was silent for "
            f"{ATTENDED_S:g} s",
            why=Why.CONDUCTOR,
            at=0.0,
            measured=self._client.now - self._heard_at,
            limit=ATTENDED_S,
            cause="its program ended, or the network is cut",
            remedy="begin the show again; let the conductor run until it has begun",
        )

    async def _fly(
        self, track: TimedTrack, steering: TrackSteering, start_at: float, bound: float
    ) -> None:
        client, told_at, self._refused = self._client, self._client.now, None
        lease = client.check(self._control.lease)
        heading = track.heading_deg if track.heading_deg is not None else self._heading()
        look_at = told_at
        is_assured = False
        async for _ in Ticker():
            client.check(lease)
            if self._refused is not None:
                raise self._refused
            now = client.now
            if now >= start_at - _ASSURED_S and not is_assured:
                is_assured = True
                self._require_all()
            if now >= look_at:
                look_at = now + _LOOK_S
                self._require_apart()
            wrong = bound + DRIFT * (now - told_at)
            velocity = steering.step(now - start_at, wrong, self._here(track))
            self.farthest_m = steering.farthest_m
            if velocity is None:
                break
            north, east, up = velocity
            client.steer(lease, Setpoint.velocity(north=north, east=east, up=up, yaw_deg=heading))
        self.stage = ShowStage.FLOWN
        client.note(f"show: {self._name} has flown its track")
        await self._end()

    def _require_all(self) -> None:
        """All of them begin, or none: one that did not hear it would stand in the others' way."""
        others = self.neighbours
        missing = 0 if others is None else others.missing(self._client.now)
        if missing:
            raise LeftShow(
                f"{self._name} does not begin the show: {missing} of the others are silent",
                why=Why.NEAR,
                at=0.0,
                measured=missing,
                limit=0,
                cause="they have no order to begin, were killed, or the network is cut",
                remedy="m100link fleet list shows who is there; begin again with all of them",
            )

    def _require_apart(self) -> None:
        """Leave, before another one comes too near."""
        own, others = self.ahead(), self.neighbours
        if own is None or others is None:
            return
        near = others.near(own, self._client.now, self._rest)
        if near is None:
            return
        reason, cause = "", f"{near.name} or {self._name} is beside its track, or has left it"
        if near.silent_s:
            reason = f"{near.name} has been silent for {near.silent_s:.1f} s and may stand there: "
            cause = f"{near.name} was killed, or one of the two is cut off"
        raise LeftShow(
            f"{self._name} left the show at {own.at:.1f} s: {reason}{near.name} would come as near "
            f"as {near.distance_m:.1f} m in {near.at - own.at:.1f} s; "
            f"{others.least_m:g} m are allowed",
            why=Why.NEAR,
            at=own.at,
            measured=near.distance_m,
            limit=others.least_m,
            cause=cause,
            remedy="it hovers or lands where it is, as --leave says; look at both",
        )

    async def _end(self) -> None:
        """It hovers or lands, and lets go of control."""
        control = self._control
        if self._leave == "land" and control.has_control:
            try:
                await control.bring_down(orders.Land(), self._placed_at)
            except M100Error as error:
                self.fault = self.fault or error
                self._client.note(f"show: {error.seen}", "error")
        control.let_go()

    def _here(self, track: TimedTrack) -> Vector:
        found = self._client.view.to_steer_by(Position)
        if found is None:
            raise TelemetryStalled(
                f"the position of {self._name} is unknown", remedy="wait for GPS, and begin again"
            )
        north, east = LocalFrame(*track.origin).to_local(found.latitude_deg, found.longitude_deg)
        return north, east, found.height_m + track.ground_m

    def _heading(self) -> float:
        found = self._client.view.to_steer_by(Attitude)
        if found is None:
            raise TelemetryStalled(
                f"the heading of {self._name} is unknown", remedy="look at its line: fleet list"
            )
        return found.yaw_deg
