"""The mission that a control block answers for, at most one, and its orders to any other."""

from __future__ import annotations

import asyncio
import logging
import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, Self

from m100link.errors import (
    LinkError,
    LossReason,
    M100Error,
    MissionRefused,
    MissionRunning,
    UsageError,
)
from m100link.flight.guards import known
from m100link.flight.mission_state import MissionKind
from m100link.flight.missions.context import MissionContext
from m100link.flight.missions.events import (
    ORDERS,
    STOPPED_CODES,
    MissionEvent,
    Ordered,
    RunInput,
    RunState,
    mission_refused,
)
from m100link.flight.missions.mission_session import MissionEnding, MissionSession, order
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Command
from m100link.protocol.records import FlightPhase, FlightStatus

if TYPE_CHECKING:
    from m100link.flight.tasks import Commander

__all__ = ["MissionFlight"]

_logger = logging.getLogger(__name__)

_LANDING = (FlightPhase.LANDING, FlightPhase.FINISHING_LANDING)
_REPORT_WITHIN_S = 0.5  # two or three pushes are lost, hardly five
_GOES_ON_S = 3.0  # after an order to stop, pushes count as about the mission that it ended
_REPORT_BY_S = 1.0  # after its start, by when the pushes tell of a mission
_SETTLED_BY_S = 0.6  # until when pushes that contradict each other are waited for at most


class MissionGuard:
    """Knows the mission of its control block, and that of somebody else in the pushes."""

    def __init__(self, commander: Commander) -> None:
        self.left_in_flight = ""  # the name of a mission that could, or should, not be stopped
        self._commander = commander
        self._watch = commander.missions
        self._run: MissionSession | None = None  # the newest that this block entered
        self._detached: MissionKind | None = None  # somebody else's, left in flight by name
        # The newest request for a stop. A mission that pushes first report long after is another.
        self._stop_asked_at = -math.inf

    # -- one at a time ---------------------------------------------------------------------------

    def claim(self, run: MissionSession) -> None:
        """A mission is to be uploaded or started; ``MissionRunning`` while another one flies."""
        self.require_none(f"a {run.name}")
        if self._run is not None and self._run.state is RunState.READY:
            raise UsageError(
                f"a {run.name} was asked for while another mission is being prepared",
                remedy="leave the block of that one first",
            )
        self._run = run
        self._watch.claim()

    def call_off(self) -> None:
        """A stop, or a way down: a mission that is being prepared does not begin any more."""
        if self._run is not None and self._run.state is RunState.READY:
            self._run.feed(RunInput.STOP)

    def give_back(self, run: MissionSession) -> None:
        """It could not be begun; one that may be flying all the same stays ours."""
        if self._run is run and not run.is_in_the_air:
            self._run = None

    @property
    def _ours(self) -> MissionSession | None:
        """The mission that flies, if it is one that this block answers for."""
        return self._run if self._run is not None and self._run.is_in_the_air else None

    @property
    def flying(self) -> str:
        """The name of the mission that flies the aircraft, ours or another's; empty: none does."""
        if (ours := self._ours) is not None:
            return ours.name
        kind = self._flying_kind
        return kind.value if kind is not None else ""

    @property
    def _flying_kind(self) -> MissionKind | None:
        """The mission that flies by the pushes, of which one alone is not believed."""
        return next(iter(self._watch.flying), None)

    @property
    def _flying_since(self) -> float | None:
        kind = self._flying_kind
        return None if kind is None else self._watch.reported_since(kind)

    def require_none(self, what: str, *, is_landing: bool = False) -> None:
        """Raise while a mission flies: the aircraft would ignore the order.

        ``is_landing``: it lands, here or at home, and so breaks off a mission that a stop did not
        end (inferred). Raises ``MissionRunning``: with the remedy.
        """
        name = self.flying
        if not name or (is_landing and self._was_stopped_in_vain):
            return  # a landing is the last means against a mission that a stop did not end
        if self._ours is not None:
            raise MissionRunning(
                f"{what} was asked for while a {name} flies the aircraft; nothing was sent",
                cause="the aircraft ignores everything else until the mission is over or stopped",
                remedy="await mission.stop(), or leave the block of the mission, first",
            )
        raise MissionRunning(
            f"{what} was asked for while a {name} flies the aircraft; nothing was sent",
            cause=self._why_it_flies(),
            remedy="let it end, or stop it first: await control.stop_mission()",
        )

    def _why_it_flies(self) -> str:
        """Where a mission comes from that this block does not answer for, or not any more."""
        run = self._run
        if run is not None and run.state is RunState.DETACHED:
            return "it was detached: it flies on until it ends, or is stopped"
        if run is not None and run.flies_all_the_same:
            return "the aircraft goes on to report it, although its end was reported"
        return (
            "this block did not start it, but a phone did, another program, one that is gone, or "
            "an earlier block that detached it"
        )

    @property
    def _was_stopped_in_vain(self) -> bool:
        """Whether the mission that flies is one that this block ordered to stop, in vain."""
        if (ours := self._ours) is not None:
            return ours.state is RunState.UNSTOPPED
        since = self._flying_since
        return since is not None and since < self._stopped_by

    @property
    def _stopped_by(self) -> float:
        """Until when pushes may tell of a mission that this block ordered to stop."""
        return self._stop_asked_at + _GOES_ON_S + self._commander.link.latency.slack_s

    # -- orders to a mission that flies, also somebody else's ------------------------------------

    async def stop_any(self) -> MissionKind:
        """Stop any mission. See :meth:`m100link.Control.stop_mission`."""
        if (ours := self._ours) is not None:
            await ours.stop()
            return ours.kind
        self.call_off()
        self._stop_asked_at = self._commander.link.loop.time()
        # Without pushes (a box of the PC assistant), every kind gets a stop.
        kinds = list(self._watch.flying or ORDERS)
        if self._run is not None and self._run.flies_all_the_same:
            kinds = [self._run.kind]
        stopped = MissionKind.NONE
        for kind in kinds:
            code = await self._commander.requests.execute(
                ORDERS[kind].stop, timeout=0.5, tries=3, refusal=MissionRefused
            )
            if code is MissionCode.SUCCESS:
                _logger.info("%s stopped", kind.value)
                stopped = kind
                self._watch.ended(kind, is_echoing=True)
            elif code not in STOPPED_CODES:
                raise mission_refused(f"the stop of the {kind.value}", code)
        self._detached = None
        if self._run is not None and self._run.state is RunState.DETACHED:
            self._run = None
        return stopped

    async def stopped_any(self) -> MissionKind:
        """The same, seen by pushes. Raises ``NotObserved``: they go on to report it."""
        if (ours := self._ours) is not None:
            await ours.stop_seen()
            return ours.kind
        kind = await self.stop_any()
        if kind.is_mission:
            ending = MissionEnding(self._commander, kind)
            ending.tell()
            await ending.require_over()
        return kind

    async def order_any(self, what: Ordered) -> MissionKind:
        """Pause or resume the mission that flies, which the pushes have to show.

        Raises ``UsageError``: nothing flies, as far as anybody knows. Raises ``MissionRefused``:
        see each class.
        """
        if (ours := self._ours) is not None:
            await ours.order(what)
            return ours.kind
        if (kind := self._flying_kind) is None:
            raise UsageError(
                f"a {what} was asked for, and no mission flies as far as the aircraft tells",
                cause="none does, or the box 'Ground Station Status' is not ticked in the PC "
                "assistant",
            )
        await order(self._commander, kind, what)
        return kind

    def detach_any(self) -> MissionKind:
        """Leave the mission in flight when the block ends; ``UsageError``: none flies."""
        if (ours := self._ours) is not None:
            ours.detach()
            return ours.kind
        if (kind := self._flying_kind) is None:
            raise UsageError("there is no mission that could be detached")
        self._detached = kind
        _logger.warning("%s left in flight: authority is not given back", kind.value)
        return kind

    # -- for the stop path -----------------------------------------------------------------------

    @property
    def is_detached(self) -> bool:
        """Whether a mission was left in flight by name, and nothing tells that it has ended.

        Giving authority back, or landing, would break it off (inferred).
        """
        run = self._run
        was_ours = run is not None and run.state is RunState.DETACHED
        if not was_ours and self._detached is None:
            return False
        if self._watch.state.kind is not MissionKind.NONE or self._watch.flying:
            return True
        # A push from before the start does not show which mission flies since.
        began_at = run.started_at if run is not None and was_ours else -math.inf
        slack = self._commander.link.latency.slack_s
        return self._watch.received_at < began_at + _REPORT_BY_S + slack

    @property
    def is_of_another(self) -> bool:
        """Whether a mission flies that this block neither started nor ordered to stop."""
        # A phone, a program that is gone or an earlier block started it, and leaving this block is
        # no order to break it off.
        run, since = self._run, self._flying_since
        if since is None:
            return False
        if run is not None and (run.is_in_the_air or run.flies_all_the_same):
            return False
        return since >= self._stopped_by

    @property
    def to_stop(self) -> MissionKind | None:
        """The mission that the program's end has to stop; one that may start any moment, too."""
        run = self._run
        if run is None:
            return None
        is_owed = run.state is RunState.READY or run.owes_a_stop or run.flies_all_the_same
        return run.kind if is_owed else None

    def ended_elsewhere(self, failure: M100Error | None) -> None:
        """The guardian has stopped our mission: nobody waits for it here any more."""
        if (ours := self._ours) is not None:
            ours.give_up(failure)

    async def settled(self) -> None:
        """Wait until pushes do not contradict each other any more, where they do."""
        clock, watch = self._commander.link.loop.time, self._watch
        until = clock() + _SETTLED_BY_S
        while watch.flying and watch.state.kind not in watch.flying:
            if clock() >= until:
                return
            await asyncio.sleep(0.02)

    @property
    def lands_by_plan(self) -> bool:
        """Whether our mission was flown, and the aircraft goes home or lands as planned."""
        # To give authority back then would leave it in the air, as far as anybody knows.
        return self._run is not None and self._run.state is RunState.RETURNING

    async def flies_on(self, failure: M100Error | None) -> bool:
        """Whether our mission flies on although somebody else has the aircraft now."""
        # The pushes show it within half a second; without pushes the aircraft is asked.
        run, clock = self._run, self._commander.link.loop.time
        since, give_up_at = clock(), clock() + _REPORT_WITHIN_S
        while run is not None and run.owes_a_stop and clock() < give_up_at:
            if self._watch.received_at > since:
                break
            await asyncio.sleep(0.02)
        else:
            if run is not None and run.owes_a_stop:
                await run.ask()
        if run is None:
            return False
        if not run.owes_a_stop:
            await run.ending.heard_out()
            return run.flies_all_the_same
        is_reported = self._watch.received_at > since
        if is_reported and self._watch.state.kind is not run.kind:
            return False
        # Told to fly on without an RC, and nobody is seen to have taken the aircraft: the RC is
        # lost, and a stop would leave it to hover without a pilot.
        rc = self._commander.state.remote_control
        is_silent = rc is not None and not rc.is_heard  # some aircraft show it so, at once
        is_unknown = getattr(failure, "reason", None) is LossReason.UNKNOWN
        if run.flies_without_rc and (is_silent or is_unknown):
            self.give_up(failure, "its plan orders that for a lost RC")
            return False
        # Without an answer it counts as flying on, unless it is seen to land.
        status = known(self._commander.state, FlightStatus)
        return is_reported or status is None or status.status not in _LANDING

    async def stop(self) -> M100Error | None:
        """Stop the mission, if one is owed a stop; returns why it may fly on, None: it does not."""
        run = self._run
        if run is None:
            return None
        # The push that reported its end may be wrong: the next two decide.
        await run.ending.heard_out()
        if not (run.owes_a_stop or run.flies_all_the_same):
            return None
        try:
            await (run.stop() if run.owes_a_stop else self.stop_any())
        except LinkError as error:
            return error  # give_up() says what that means
        except M100Error as error:
            _logger.error("%s", error)
            return error
        return None

    def give_up(self, failure: M100Error | None, why: str) -> None:
        """Leave the mission in flight."""
        if (ours := self._ours) is not None and not self.left_in_flight:
            self.left_in_flight = ours.name
            ours.give_up(failure)
            _logger.error("the %s flies on by itself: %s", ours.name, why)


# -- a mission for the program that flies it: a block, events, orders ------------------------------


class MissionFlight(ABC):
    """A mission for the time of a block; ``async for event in mission`` tells of it until its end.

    Leaving the block stops it if it still flies; then the aircraft hovers. **It flies on when this
    program is killed, loses its power or its cable**: it lives in the aircraft, and only the pilot,
    its own end or a stop ends it.
    """

    _FIRST: ClassVar[type[Command]]  # sent to begin it: firmware without it knows no such mission

    def __init__(self, context: MissionContext, guard: MissionGuard, run: MissionSession) -> None:
        self._context = context
        self._guard = guard
        self._run = run

    @abstractmethod
    async def _begin(self) -> None:
        """Check, upload, start."""

    async def __aenter__(self) -> Self:
        run = self._run
        with self._context.block.waiting(run.name):
            try:
                self._context.commander.requests.require_support(self._FIRST)
                self._context.block.require_flying(f"a {run.name}")
                if run.state is not RunState.READY:
                    raise UsageError("this mission was entered before; ask for a new one")
                self._guard.claim(run)
                await self._begin()
            except BaseException as error:
                await run.leave(error)
                self._guard.give_back(run)
                raise
        return self

    async def __aexit__(self, kind: object, exc: BaseException | None, traceback: object) -> None:
        await self._run.leave(exc)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> MissionEvent:
        return await self._run.next_event()

    @property
    def is_over(self) -> bool:
        """Whether it does not fly any more, or the program let go of it."""
        return self._run.state in (RunState.OVER, RunState.DETACHED)

    @property
    def is_paused(self) -> bool:
        """Whether it hovers by order of the program."""
        return self._run.state is RunState.PAUSED

    @property
    def is_unstopped(self) -> bool:
        """Whether its stop was refused or not answered: it may be flying on."""
        return self._run.state is RunState.UNSTOPPED

    async def pause(self) -> None:
        """Hover in place until :meth:`resume`; setpoints are ignored all the same.

        Raises:
            MissionRefused: With the aircraft's reason.
            MissionAborted: It was broken off meanwhile.
            AckTimeout: Nobody knows whether it hovers.
            NotObserved: It took the pause, and is seen to fly on.
            UsageError: It is over.
        """
        await self._run.order("pause")

    async def resume(self) -> None:
        """Go on where it was paused. Raises as :meth:`pause`."""
        await self._run.order("resumption")

    async def stop(self) -> None:
        """Stop it for good: the aircraft hovers and forgets the mission.

        Raises:
            AckTimeout, MissionRefused, NotObserved: It may be flying on; leaving the block tries
                again.
        """
        await self._run.stop_seen()

    def detach(self) -> None:
        """Let it fly on by itself when this block, and this program, end.

        Nothing here watches it any more: no guard, no stop path. Authority is **not** given back
        when the control block ends, because that would break the mission off. It flies on after a
        ``kill -9`` as well. A program that connects later finds it in
        :attr:`m100link.Aircraft.mission`, and ends it by :meth:`m100link.Control.stop_mission`.
        A warning is logged.

        Raises:
            UsageError: It does not fly.
        """
        self._run.detach()
