"""The stop path of a control block: what the plan of its cause says, step by step."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from m100link.errors import AckTimeout, AuthorityLost, BadAck, M100Error, TaskRefused
from m100link.flight.authority import AuthorityState
from m100link.flight.guardian import NOTHING, Wanted
from m100link.flight.guards import known
from m100link.flight.handover import explained_loss, release_authority
from m100link.flight.lifecycle import STOP_PLANS, BlockState, Lifecycle, StopCause
from m100link.flight.missions.mission_guard import MissionGuard
from m100link.flight.setpoints import NEUTRAL_TIME, SetpointLoop
from m100link.flight.tasks import Commander, is_on_ground, run_task, stands, switch_motors
from m100link.protocol.commands.control import Task
from m100link.protocol.records import FlightPhase, FlightStatus

_logger = logging.getLogger(__name__)

StopAction = Literal["hover", "land"]  # what the stop path does after the neutral setpoint

_ATTEMPTS = 3  # of a step for which memory or stack did not suffice
_LANDING_DEADLINE_S = 60.0
_LANDING_RETRY_S = 0.5
_STATUS_POLL_S = 0.1
_LEAVES_THE_GROUND_S = 1.0  # after a take-off was commanded, if it does at all


class StopPath:
    """Stop of a mission, neutral, hover or land, release, as far as its cause allows."""

    def __init__(
        self,
        commander: Commander,
        life: Lifecycle,  # of the control block; its plan says what is to be done
        setpoints: SetpointLoop,  # what the block sends
        missions: MissionGuard,  # what the block lets the aircraft fly by itself
        action: StopAction,  # what the program asked for
    ) -> None:
        self._commander = commander
        self._life = life
        self._setpoints = setpoints
        self._missions = missions
        self._action: StopAction = action
        self._clock = commander.link.loop.time
        self._take_off_at: float | None = None  # the last one of this block that was not refused
        self._is_armed = False  # this block started the motors, and did not stop them

    @contextmanager
    def taking_off(self) -> Iterator[None]:
        """A take-off is commanded: while no flight status is newer, it counts as flown."""
        before, self._take_off_at = self._take_off_at, self._clock()
        try:
            yield
        except TaskRefused:
            self._take_off_at = before
            raise

    def armed(self, is_armed: bool) -> None:
        """The block starts the motors, or has stopped them."""
        self._is_armed = is_armed

    @property
    def wanted(self) -> Wanted:
        """The steps that a guardian would owe the aircraft if this program ended now."""
        state, life, missions = self._commander.authority.state, self._life, self._missions
        if state is AuthorityState.NONE or life.state in (BlockState.NEW, BlockState.OVER):
            return NOTHING
        # While nothing has ended the block: as if the program left it now.
        plan = STOP_PLANS[life.cause or StopCause.LEFT]
        if not self._has_authority:  # the pilot's, the app's, or nobody knows: only a release helps
            # While it is asked for, a foreign mission may fly by what a program before obtained.
            is_ours = state is AuthorityState.OBTAINING
            return Wanted(release=plan.release and not (is_ours and missions.is_of_another))
        is_kept = missions.is_detached or missions.is_of_another
        is_airborne = self._may_be_airborne()
        lands = plan.land and self._action == "land" and not is_kept and is_airborne
        flies_home = missions.lands_by_plan and is_airborne and not lands
        current = self._setpoints.current if plan.neutral else None
        return Wanted(
            neutral=None if current is None else current.neutral(),
            # After a loss only a mission that is seen to fly on is stopped: a guardian sees none.
            mission=missions.to_stop if plan.mission and not plan.explain else None,
            land=lands,
            release=plan.release and not is_kept and not flies_home,
        )

    def let_go(self) -> None:
        """At once: the neutral instead of the setpoint that is being sent, or nothing."""
        if self._life.plan.neutral:
            self._setpoints.neutralise()
        else:
            self._setpoints.silence()

    def _surely(self, send: Callable[[], None]) -> None:
        """A neutral that cannot be sent must not keep the steps after it from their turn."""
        for left in reversed(range(_ATTEMPTS)):
            try:
                return send()
            except Exception as error:  # noqa: BLE001 (whatever it is: the stop path must go on)
                if not left:
                    self._setpoints.silence()
                    _logger.error("no neutral was sent, and nothing more will be: %s", error)

    async def run(self) -> None:
        """Every step in its turn, however the one before ended; every wait is bounded.

        The plan is read before each step, because the line may be lost meanwhile. May be begun
        again.
        """
        self._surely(self.let_go)  # what ended the block may have had no room on its stack for it
        failed: Exception | None = None
        # During a mission the aircraft ignores setpoints; after the release it obeys no landing.
        first = self._explain, self._stop_mission, self._end_setpoints
        for step in (*first, self._land, self._disarm, self._release):
            for _ in range(_ATTEMPTS):
                try:
                    await step()
                    break
                except Exception as error:  # noqa: BLE001 (raised below: the release comes first)
                    failed = failed or error
                    if not isinstance(error, MemoryError | RecursionError):  # it will not pass
                        break
        if failed is not None:
            raise failed

    @property
    def _slack_s(self) -> float:
        """Seconds by which telemetry shows an order later than on a quick line."""
        return self._commander.link.latency.slack_s

    @property
    def _has_authority(self) -> bool:
        return self._commander.authority.state is AuthorityState.HELD

    async def _stop_mission(self) -> None:
        life = self._life
        # A stop needs no authority, so it is sent without. But a failsafe on its way home must not
        # be called off: where somebody else took the aircraft, only a mission is stopped that is
        # reported still, or of which nothing is heard while the aircraft is not seen to land.
        if life.plan.mission and (
            not life.plan.explain or await self._missions.flies_on(life.failure)
        ):
            # Unanswered, it keeps no step from its turn: landing and release break it off as well.
            failure = await self._missions.stop()
            life.failure = life.failure or failure
        if life.cause is StopCause.GUARDIAN:
            self._missions.ended_elsewhere(life.failure)
        elif not life.plan.mission:  # perhaps only since the line was lost meanwhile
            self._missions.give_up(life.failure, "no stop can reach it")
        if self._missions.left_in_flight and life.failure is not None:
            life.failure.remedy = (
                f"the {self._missions.left_in_flight} flies on by itself: take the aircraft by the "
                "mode switch, or connect again and stop it"
            )

    async def _explain(self) -> None:
        failure = self._life.failure
        if self._life.plan.explain and isinstance(failure, AuthorityLost):
            self._life.failure = await explained_loss(self._commander, failure)

    async def _end_setpoints(self) -> None:
        self._surely(self.let_go)  # when it was begun again, the task that sends may be gone
        if self._has_authority and self._setpoints.current is not None:
            await asyncio.sleep(NEUTRAL_TIME)
        if self._has_authority and self._life.plan.neutral:
            self._surely(self._setpoints.pay)  # nothing, unless this process stood still meanwhile
        await self._setpoints.stop()
        if self._is_armed and self._setpoints.sent:
            self._take_off_at = self._clock()  # any of them may have lifted it, up to now

    async def _land(self) -> None:
        """Land; asked again while it is refused (another task is under way) or unanswered."""
        if self._action != "land":
            return
        # A landing would break off a mission of somebody else: pushes that disagree are waited for.
        await self._missions.settled()
        if self._missions.is_detached:
            return
        if self._missions.is_of_another:
            _logger.error(
                "stop='land' did not land: a %s flies that this block did not start",
                self._missions.flying,
            )
            return
        # A landing that was under way is awaited as well: the release would leave it in the air.
        deadline = self._clock() + _LANDING_DEADLINE_S + 2 * self._slack_s
        while self._life.plan.land and self._has_authority and not await self._stands():
            try:
                # However late it is accepted: once it is, it has all the time of a landing.
                await run_task(self._commander, Task.LAND)
            except M100Error as error:
                # Unanswered, it may be flown, and the release would break it off. Where it began
                # and failed, perhaps the pilot broke it off.
                is_open = isinstance(error, TaskRefused | AckTimeout | BadAck)
                if is_open and self._clock() < deadline:
                    await asyncio.sleep(_LANDING_RETRY_S)
                    continue
                _logger.error("the stop path could not land: %s", error)
            return

    def _may_be_airborne(self, *, lands: bool = False) -> bool:
        """By what is believed of it; where nothing is, by whether a take-off was commanded."""
        state, take_off_at = self._commander.state, self._take_off_at
        status, status_at = state.believed_status, state.received_at(FlightStatus)
        is_new = known(state, FlightStatus) is not None
        if is_new if status is None else status.status != FlightPhase.STANDBY:
            return True
        if take_off_at is not None:  # a "standby" from before it left the ground proves nothing
            leaves_at = take_off_at + _LEAVES_THE_GROUND_S + self._slack_s
            return status_at is None or status_at < leaves_at
        if lands and not is_new:
            _logger.error(
                "stop='land' did not land: the flight status is %s, and no take-off was commanded",
                "unknown" if status is None else "old",
            )
        return False

    async def _disarm(self) -> None:
        """Blades that were started and never flew do not run on with nobody to answer for them."""
        if not self._is_armed or not self._has_authority or not self._life.plan.neutral:
            return
        # A status from before it could leave the ground proves nothing: time has to pass.
        state = self._commander.state
        until = self._clock() + 2 * _LEAVES_THE_GROUND_S + self._slack_s
        while self._clock() < until and (  # noqa: ASYNC110 - no event tells of a belief
            state.flight_status is None or (is_on_ground(state) and self._may_be_airborne())
        ):
            await asyncio.sleep(_STATUS_POLL_S)
        if not await self._stands() or not is_on_ground(state):
            if state.flight_status is None or state.flight_status.status == FlightPhase.STANDBY:
                _logger.error("the motors were not stopped: nobody knows whether it stands")
            return  # in the air nothing of the kind is ever sent
        try:
            await switch_motors(self._commander, on=False)
        except M100Error as error:
            _logger.error("the stop path could not stop the motors: %s", error)

    async def _stands(self) -> bool:
        """Whether it is not in the air, after statuses of standing could become several."""
        await stands(self._commander.state)
        return not self._may_be_airborne(lands=self._action == "land" and self._life.plan.land)

    async def _release(self) -> None:
        if not self._life.plan.release:
            return
        await self._missions.settled()
        if self._leaves_another_in_flight():
            return
        is_left = self._missions.is_detached or (
            self._missions.lands_by_plan and self._has_authority and not await self._stands()
        )
        if is_left and self._has_authority:  # asked again: that took time
            _logger.warning(
                "authority is kept: what the aircraft flies by itself would end without it"
            )
            return
        await release_authority(self._commander)

    def _leaves_another_in_flight(self) -> bool:
        """Whether authority is kept because the release would break off somebody else's mission."""
        # Not entered, too: a program that is gone may have obtained what this one would give back.
        may_have_it = self._has_authority or self._life.cause is StopCause.NOT_ENTERED
        is_left = may_have_it and self._missions.is_of_another
        if is_left:
            _logger.warning(
                "authority is not given back: a %s flies that this block did not start, and would "
                "be broken off; stop_mission() ends it, or the pilot's mode switch",
                self._missions.flying,
            )
        return is_left
