"""One mission of this program: its start, its pushes, and the only path to stop it."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

from m100link.errors import (
    AckTimeout,
    BadAck,
    CommandRefused,
    KeyRejected,
    M100Error,
    MissionAborted,
    MissionRefused,
    NotObserved,
    UsageError,
)
from m100link.flight.cancellation import ShieldedTask
from m100link.flight.guards import known
from m100link.flight.lifecycle import StopCause
from m100link.flight.mission_state import DENIED_S, MissionKind
from m100link.flight.missions.context import MissionContext, MissionTracker, Over
from m100link.flight.missions.events import (
    DONE_CODES,
    IN_THE_AIR,
    ORDERS,
    OWES_A_STOP,
    STOPPED_CODES,
    TRANSITIONS,
    Aborted,
    Events,
    Finished,
    MissionEvent,
    Ordered,
    Paused,
    Resumed,
    RunInput,
    RunState,
    Started,
    Stopped,
    mission_refused,
)
from m100link.flight.tasks import Commander, is_on_ground
from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Request
from m100link.protocol.commands.missions import MissionStatus, Uploaded, WaypointEvent
from m100link.protocol.records import FlightPhase, FlightStatus, Velocity

_logger = logging.getLogger(__name__)


# -- a reported end of a mission, until the pushes behind the report agree -------------------------
# A push may be wrong, or about the mission before. One that tells of an end is followed within a
# tenth of a second by the next: where that tells of the mission again, the aircraft flies it on.


_GOES_ON_S = 3.0  # after it, pushes of its kind count as about the same mission
_SHOWN_S = 1.3  # behind a stop; pushes that tell of what it ended are under way for a second
_HEARD_OUT_S = 0.6  # until when contradicting pushes are waited for at most
_MAY_FLY_A_MISSION = (FlightPhase.TAKING_OFF, FlightPhase.IN_AIR)


class MissionEnding:
    """The end of one mission."""

    def __init__(self, commander: Commander, kind: MissionKind) -> None:
        self._commander = commander
        self._clock = commander.link.loop.time
        self._watch = commander.missions
        self._kind = kind  # which kind of mission
        # When it was taken for over, or for on its way home; minus infinity before.
        self.over_at = -math.inf
        self.is_answered = False  # whether the answer to a stop reported it, which is certain

    def tell(self, *, is_answered: bool = False) -> None:
        """Something tells that it is over."""
        self.over_at, self.is_answered = self._clock(), is_answered

    def over(self, *, is_answered: bool) -> None:
        """The same, and that the aircraft flies nothing behind it."""
        self.tell(is_answered=is_answered)
        self._watch.ended(self._kind, is_echoing=is_answered)

    @property
    def is_contradicted(self) -> bool:
        """Whether pushes went on to tell of the mission, whatever others say between them."""
        since = self._watch.reported_since(self._kind)
        # One that began later is somebody else's.
        slack = self._commander.link.latency.slack_s
        return since is not None and since < self.over_at + _GOES_ON_S + slack

    @property
    def is_way_home_contradicted(self) -> bool:
        """Whether pushes tell of the mission behind its end, and it is not seen to land."""
        watch = self._watch
        if watch.state.kind is not self._kind or not self.over_at < watch.received_at:
            return False
        status = known(self._commander.state, FlightStatus)
        return status is None or status.status in _MAY_FLY_A_MISSION

    async def heard_out(self) -> None:
        """Wait until two pushes more have come, and agree on whether it is flown on."""
        until, watch = self.over_at + _HEARD_OUT_S, self._watch
        # An answer to a stop is certain; and where nothing is pushed, nothing will contradict.
        while not self.is_answered and self._clock() < until:
            if watch.received_at < self.over_at - DENIED_S:
                return
            is_seen = watch.state.kind is self._kind
            if self._clock() >= self.over_at + DENIED_S and is_seen is (self._kind in watch.flying):
                return
            await asyncio.sleep(0.02)

    async def require_over(self) -> None:
        """Wait until pushes show the end that was answered; ``NotObserved``: they do not.

        Pushes that were under way as the answer left are not counted.
        """
        watch = self._watch
        until = self.over_at + _SHOWN_S + self._commander.link.latency.slack_s
        while watch.received_at <= self.over_at:
            if watch.received_at < self.over_at - DENIED_S or self._clock() >= until:
                return  # nothing is pushed, or not any more
            await asyncio.sleep(0.02)
        await asyncio.sleep(DENIED_S)  # one push alone may be wrong
        if self.is_contradicted:
            raise NotObserved(
                f"the aircraft took the stop of the {self._kind.value}, and reports it still",
                cause="it answered about another order, or pushes are of another mission",
                remedy="take the aircraft by the mode switch: that ends the mission",
            )


# -- run -------------------------------------------------------------------------------------------

_START_S = 0.5  # for the ack of one transmission of a start
_LOOK_S = 0.2  # between two looks at guards, pushes and telemetry
_BRAKES_S = 6.0  # in which a pause stops 15 m/s, the fastest that a mission flies
_HOVERS_M_S, _HOVERS_FOR_S = 1.0, 0.4
_PROGRESS_S = 1.0
_QUIET_S = 2.0  # without a push, after which the aircraft is asked instead
_POLL_S = 1.0
_HANDOVER_S = 0.5  # in which the notification of a lost authority follows the push


async def order(commander: Commander, kind: MissionKind, what: Ordered) -> None:
    """Have the mission that flies hover, or go on."""
    request: Request[MissionCode] = getattr(ORDERS[kind], what)
    code = await commander.requests.execute(request, timeout=0.5, tries=3, refusal=MissionRefused)
    if code not in DONE_CODES[what]:
        raise mission_refused(f"the {what} of the {kind.value}", code)
    if what == "pause":
        await _require_hover(commander, kind)


async def _require_hover(commander: Commander, kind: MissionKind) -> None:
    """Wait until its velocity, where it is known, shows that it hovers; ``NotObserved``: not so."""
    clock = commander.link.loop.time
    until = clock() + _BRAKES_S + commander.link.latency.slack_s
    since = clock()  # for how long it has been slow
    while (velocity := known(commander.state, Velocity)) is not None:
        now, speed = clock(), math.hypot(velocity.ground_speed_m_s, velocity.up_m_s)
        if speed >= _HOVERS_M_S:
            since = now
        elif now - since >= _HOVERS_FOR_S:
            return
        if now >= until:
            raise NotObserved(
                f"the aircraft took the pause of the {kind.value}, and flies on at {speed:.1f} m/s",
                situation=commander.state.situation(),
                cause="it answered about another order, or wind drives it",
                remedy="stop the mission, or take the aircraft by the mode switch",
            )
        await asyncio.sleep(_LOOK_S)


AUTHORITY_CODES = frozenset(
    {MissionCode.RC_NOT_IN_F, MissionCode.AUTHORITY_NEEDED, MissionCode.IOC_ON}
)  # somebody else has the aircraft: missions are broken off by that (inferred)


class MissionSession:
    """One mission, from before its start to its end."""

    def __init__(
        self,
        context: MissionContext,
        kind: MissionKind,
        track: MissionTracker,
        *,
        flies_without_rc: bool = False,
    ) -> None:
        self._context = context  # what it stands on
        self.kind = kind  # which kind of mission
        # Whether it was ordered to fly on when the RC is lost.
        self.flies_without_rc = flies_without_rc
        self._orders = ORDERS[kind]
        self._track = track  # reads what the aircraft says of it
        self._clock = context.commander.link.loop.time
        self.state = RunState.READY  # where it is in its life
        self.events = Events()
        self._is_failure_known = False  # the program knows why it was broken off
        # When the start was sent, on the event loop's clock; minus infinity before.
        self.started_at = -math.inf
        # When its end was reported, and whether pushes contradict.
        self.ending = MissionEnding(context.commander, kind)
        self._pushed_at = 0.0  # when a push reported this mission last, or it was started
        self._is_pushed = False  # whether one ever did
        # Whether pushes showed its end during a stop, for the case that nobody answers the stop.
        self._is_seen_over = False
        self._stopping: ShieldedTask | None = None  # the newest attempt
        self._is_others = False  # the aircraft refused it, because somebody else has it
        self._early: list[MissionEvent | Over] = []  # what was pushed while the start was under way
        self._watching: asyncio.Task[None] | None = None

    @property
    def name(self) -> str:
        """Its name for people."""
        return self.kind.value

    @property
    def is_in_the_air(self) -> bool:
        """Whether the aircraft flies by it, as far as anybody knows."""
        return self.state in IN_THE_AIR

    @property
    def owes_a_stop(self) -> bool:
        """Whether it must not be left behind like this."""
        return self.state in OWES_A_STOP or (
            self.state is RunState.RETURNING and self.ending.is_way_home_contradicted
        )

    @property
    def flies_all_the_same(self) -> bool:
        """Whether pushes go on to report it, although its end was reported."""
        return self.state is RunState.OVER and self.ending.is_contradicted

    def feed(self, what: RunInput) -> bool:
        """Something happened. Returns whether it stands in the table for the present state."""
        after = TRANSITIONS[self.state].get(what)
        if after is None:
            return False
        _logger.debug("%s: %s -> %s", self.name, self.state.name, after.name)
        self.state = after
        return True

    # -- start -----------------------------------------------------------------------------------

    def listen(self) -> None:
        """Take the pushes from here on."""
        self._context.commander.missions.listener = self._on_push

    async def start(self, request: Request[Any], code_of: Callable[[Any], int]) -> Any:
        """Send its start, and return the answer.

        Raises ``NotObserved``: it was stopped meanwhile. Raises ``MissionRefused``: the aircraft
        says no; nothing flies. Raises ``AckTimeout``: nobody knows whether it flies: a stop is
        owed.
        """
        self.require_wanted()
        self.listen()
        # Before the start leaves: from here on, any end of the block owes the aircraft a stop.
        self.feed(RunInput.START)
        self.started_at = self._pushed_at = self._clock()
        requests = self._context.commander.requests
        try:
            answer = await requests.execute(
                request, timeout=_START_S, tries=3, refusal=MissionRefused
            )
        except (CommandRefused, KeyRejected, UsageError):  # after any other error nobody knows
            self._refused()
            raise
        code = MissionCode(code_of(answer))
        if code is not MissionCode.SUCCESS:
            if code.is_known:  # what another one means nobody knows: perhaps that it flies
                self._refused()
            raise mission_refused(f"the start of the {self.name}", code)
        self.feed(RunInput.STARTED)
        _logger.info("%s started: the aircraft flies it by itself", self.name)
        self.events.add(Started())
        early, self._early = self._early, []
        self._apply(early)
        self._watching = asyncio.create_task(self._watch(), name=f"m100link {self.name}")
        return answer

    def require_wanted(self) -> None:
        """Raise ``NotObserved`` where a stop or a way down was asked for before the start."""
        if self.state is RunState.OVER:
            raise NotObserved(
                f"the {self.name} was stopped before it began; its start was not sent",
                cause="stop(), stop_mission(), land() or go_home() was called meanwhile",
            )

    def _refused(self) -> None:
        """The aircraft says no. Not to a repetition: the transmission before may have begun it."""
        if self._clock() - self.started_at < _START_S:
            self.feed(RunInput.REFUSED)

    # -- orders ----------------------------------------------------------------------------------

    async def order(self, what: Ordered) -> None:
        """Hover, or go on; it raises as :meth:`MissionFlight.pause`."""
        self.require_in_the_air(f"its {what}")
        with self._context.block.waiting(self.name):
            await order(self._context.commander, self.kind, what)
        if self.feed(RunInput.PAUSED if what == "pause" else RunInput.RESUMED):
            self.events.add(Paused() if what == "pause" else Resumed())

    def require_in_the_air(self, what: str) -> None:
        """Raise unless it flies.

        Raises ``MissionAborted``: it was broken off. Raises ``UsageError``: it has not begun, or it
        is over. Raises ``NoAuthority, M100Error``: what ended the control block.
        """
        self._context.block.require_flying(f"{what} ({self.name})")
        if self.is_in_the_air:
            return
        if self.events.failure is not None:
            self._is_failure_known = True
            raise self.events.failure.again()
        raise UsageError(
            f"{what} was asked for, but the {self.name} is {self.state.name.lower()}",
            cause=self.state.value,
            remedy="enter it by `async with`, once",
        )

    def detach(self) -> None:
        """Look away and let it fly on; ``UsageError`` where it does not fly."""
        self.require_in_the_air("to be detached")
        if not self.feed(RunInput.DETACH):
            raise UsageError(f"the {self.name} cannot be detached: {self.state.value}")
        _logger.warning(
            "%s detached: the aircraft flies on by itself, also when this program ends; "
            "authority is not given back, and only the pilot, its own end or a stop ends it",
            self.name,
        )
        self.events.end()
        self._let_go()

    # -- the stop --------------------------------------------------------------------------------

    async def stop(self) -> None:
        """Stop it, and wait for the answer: two tries, a second in all.

        A cancellation of the caller takes effect after that.

        Raises ``AckTimeout, MissionRefused, LinkError``: it may be flying on.
        """
        if self.feed(RunInput.STOP) and self.is_in_the_air:
            self._is_seen_over = False
            # When it has ended otherwise than by an answer, it was not heard.
            self._stopping = ShieldedTask(self._send_stop, lambda: self.feed(RunInput.NOT_STOPPED))
            self._stopping.begin()
        if self.state is RunState.STOPPING and self._stopping is not None:
            await self._stopping.ended()

    async def stop_seen(self) -> None:
        """The same, and wait until pushes show it. Raises ``NotObserved``: they do not."""
        await self.stop()
        if not self._is_others:
            await self.ending.require_over()

    async def _send_stop(self) -> None:
        requests = self._context.commander.requests
        try:
            code = await requests.execute(
                self._orders.stop, timeout=0.5, tries=2, refusal=MissionRefused
            )
        except AckTimeout as error:
            if self._is_seen_over:  # heard by the aircraft all the same
                self._end(RunInput.STOPPED)
                return
            raise self._unanswered() from error
        self._is_others = code in AUTHORITY_CODES
        if self._is_others:
            _logger.warning(
                "the stop of the %s was refused, because somebody else has the aircraft: %s",
                self.name,
                code.meaning,
            )
        elif code is not MissionCode.SUCCESS and code not in STOPPED_CODES:
            raise mission_refused(f"the stop of the {self.name}", code)
        self._end(RunInput.STOPPED, is_answered=True)

    async def end_by_program(self, failure: M100Error | None) -> None:
        """The source of its targets has ended, well or not: stop it, and tell the program why.

        A stop that fails is for the stop path to try again.
        """
        if not self.owes_a_stop:
            return
        if failure is not None:
            self.events.end(failure)
        try:
            await self.stop()
        except M100Error as error:
            _logger.error("%s", error)
            self.events.end(error)

    def _unanswered(self) -> AckTimeout:
        return AckTimeout(
            f"the stop of the {self.name} was not answered: the aircraft may be flying it on",
            command=self._orders.stop.NAME,
            tries=2,
            cause="the line is broken in one direction or in both",
            remedy="take the aircraft by the mode switch: that ends the mission",
        )

    async def leave(self, error: BaseException | None) -> None:
        """The program leaves the block of the mission: stop it if it still flies.

        When the control block itself has ended, its stop path does that.

        Raises ``MissionAborted``: it was broken off, and the program does not know. Raises
        ``AckTimeout, MissionRefused, LinkError``: it may be flying on.
        """
        # A program that leaves at once waits for two more pushes: one alone may be wrong.
        if self._context.block.is_open:
            await self.ending.heard_out()
        if self.owes_a_stop and self._context.block.is_open:
            try:
                await self.stop_seen()
            except M100Error as failure:
                if error is None:
                    raise
                _logger.error("%s", failure)  # the stop path of the control block tries again
        if self.state is RunState.RETURNING:
            _logger.info("the %s was left: the aircraft lands, as planned", self.name)
        if not self.is_in_the_air:
            self._let_go()
        if error is None and self.events.failure is not None and not self._is_failure_known:
            self._is_failure_known = True
            raise self.events.failure.again()

    # -- pushes of the aircraft ------------------------------------------------------------------

    async def next_event(self) -> MissionEvent:
        """The next event.

        Raises ``StopAsyncIteration``: there is none any more. Raises ``MissionAborted``: it was
        broken off. Raises ``M100Error``: what ended the control block.
        """
        with self._context.block.waiting(self.name):
            event = await self.events.take()
            failure = self.events.failure
            if event is None:
                await self.ending.heard_out()
            if event is None and getattr(failure, "code", None) in AUTHORITY_CODES:
                # The push overtakes the notification of what matters more: a lost authority.
                await asyncio.sleep(_HANDOVER_S)
        if event is not None:
            self._is_failure_known = self._is_failure_known or isinstance(event, Aborted)
            return event
        if failure is not None:
            self._is_failure_known = True
            raise failure.again()
        raise StopAsyncIteration

    def _on_push(self, push: MissionStatus | WaypointEvent) -> None:
        if self.state is RunState.READY and not isinstance(getattr(push, "event", None), Uploaded):
            return  # of a mission before
        self._apply(self._track.take(push))
        if self._context.commander.missions.state.kind is self.kind:
            self._pushed_at, self._is_pushed = self._clock(), True

    def _apply(self, news: Sequence[MissionEvent | Over]) -> None:
        for item in news:
            if self.state is RunState.STARTING:
                self._early.append(item)
            elif self.state is RunState.STOPPING:
                self._is_seen_over = self._is_seen_over or isinstance(item, Over | Aborted)
            elif isinstance(item, Over):
                if self.state is not RunState.RETURNING:  # that ends on the ground
                    self._end(RunInput.FINISHED)
            elif isinstance(item, Aborted):
                self._break_off(item)
            elif self.is_in_the_air:
                self.events.add(item)
                flown = RunInput.RETURNS if self._track.ends_by_landing else RunInput.FLOWN
                if isinstance(item, Finished) and self.feed(flown):
                    self.ending.tell()

    def _break_off(self, event: Aborted) -> None:
        if RunInput.BROKEN_OFF not in TRANSITIONS[self.state]:
            return
        where = "" if event.index is None else f" on the way to waypoint {event.index}"
        code = None if event.code is None else MissionCode(event.code)
        failure = MissionAborted(
            f"the aircraft broke off the {self.name}{where}: {event.reason}",
            mission=self.name,
            code=event.code,
            index=event.index,
            cause="" if code is None else code.cause,
            remedy="it does not go on by itself: look at the aircraft, and begin it again",
        )
        self.events.add(event)
        self._end(RunInput.BROKEN_OFF, failure)
        _logger.warning("%s", failure.seen)

    def _end(
        self, how: RunInput, failure: M100Error | None = None, *, is_answered: bool = False
    ) -> None:
        if not self.feed(how):
            return
        self.ending.over(is_answered=is_answered)
        if how is RunInput.STOPPED:
            self.events.add(Stopped())
        self.events.end(failure)
        self._let_go()

    def give_up(self, failure: M100Error | None) -> None:
        """End the events without waiting: a program must not wait for ever for the next one."""
        self.events.end(failure)
        self._let_go()

    def _let_go(self) -> None:
        watch = self._context.commander.missions
        # By now it may be the listener of a newer mission.
        if watch.listener == self._on_push:
            watch.listener = None
        # The watch comes here itself when it finds the end, and must not cancel itself.
        if self._watching is not None and self._watching is not asyncio.current_task():
            self._watching.cancel()

    # -- the watch -------------------------------------------------------------------------------

    async def _watch(self) -> None:
        """Look at guards, pushes and telemetry while it flies; a watch that fails ends all."""
        try:
            await self._look_again_and_again()
        except M100Error as error:
            self._context.block.end(StopCause.GUARD_REFUSED, error)
        except Exception as error:
            failure = M100Error(f"nobody watches the {self.name} any more: {error!r}")
            failure.__cause__ = error
            # Before the log, which may take its time: nobody watches what flies.
            self._context.block.end(StopCause.GUARD_REFUSED, failure)
            _logger.error("nobody watches the %s any more", self.name, exc_info=error)

    async def _look_again_and_again(self) -> None:
        next_progress_at = next_poll_at = self._clock()
        is_warned = False
        while self.is_in_the_air:
            await asyncio.sleep(_LOOK_S)
            now = self._clock()
            self._look()
            if now >= next_progress_at - _LOOK_S / 2:
                next_progress_at += _PROGRESS_S
                state = self._context.commander.state
                self.events.add(self._track.progress(now - self.started_at, state))
            if now - self._pushed_at < _QUIET_S:
                continue
            if not is_warned and not self._is_pushed:
                is_warned = True
                _logger.warning(
                    "the aircraft pushes nothing about the %s: tick 'Ground Station Status' in the "
                    "PC assistant; %s",
                    self.name,
                    "nothing tells its end" if self._track.poll is None else "it is asked instead",
                )
            if now >= next_poll_at:
                next_poll_at = now + _POLL_S
                await self.ask()

    def _look(self) -> None:
        """See the ground at the end; ``GuardRefused`` where a guard has something against it."""
        if self.state is RunState.RETURNING and not self.owes_a_stop:
            if is_on_ground(self._context.commander.state):
                self._end(RunInput.FINISHED)
        elif self.is_in_the_air and self.state not in (RunState.STOPPING, RunState.UNSTOPPED):
            self._context.guards.check_mission(self.name)

    async def ask(self) -> None:
        """Ask the aircraft whether it still flies it, where there is a question for that."""
        if self._track.poll is None or self.state is RunState.RETURNING:
            return
        requests = self._context.commander.requests
        try:
            answer = await requests.execute(self._track.poll, timeout=0.3, tries=2)
        except (AckTimeout, BadAck, CommandRefused, KeyRejected) as error:
            _logger.debug("nobody knows how far the %s is: %s", self.name, error)
            return
        self._apply(self._track.polled(answer))
