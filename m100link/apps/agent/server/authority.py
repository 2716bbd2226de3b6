"""Holding control authority for the client with the lease: a table of states and inputs.

A client asks once. From then on authority is held until it is given back: when the client says so,
when the lease ends, or when the app or the link takes it for good. A pilot who leaves F and comes
back gives it back without a new request (document, quick start), as long as the same client has
the lease.

Everything that can happen is an input; what it leads to stands in :data:`TRANSITIONS`. A pair that
is not in the table changes nothing.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from enum import Enum, IntEnum

from m100link import errors
from m100link.aircraft import Aircraft
from m100link.aircraft.activation import ActivationProgress
from m100link.apps.agent.background import TaskSet, call_each
from m100link.apps.agent.lease import Flown
from m100link.apps.agent.messages import EventTopic, GuardLimits, Journal
from m100link.apps.agent.server.flight import ActiveFlight, limits_of
from m100link.apps.agent.server.mission import MissionListener, look_at
from m100link.flight.authority import AuthorityState
from m100link.flight.control import Control
from m100link.flight.guards import Guards
from m100link.flight.tasks import is_on_ground
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Credentials, Version
from m100link.protocol.records import RemoteControl
from m100link.telemetry.subscription import Newest


class HoldingState(Enum):
    """Where control authority stands for the clients of one agent."""

    NONE = "none"  # nobody wants it
    OBTAINING = "obtaining"  # a client waits for it
    HELD = "held"  # setpoints and tasks are obeyed
    TAKEN = "taken"  # somebody took it; a switch seen out of F would show that it was the pilot
    PAUSED = "paused"  # the pilot left F; back in F it is obtained again
    RESUMING = "resuming"  # the pilot is back in F: it is obtained again, nobody waits for it
    RELEASING = "releasing"  # it is being given back


class HoldingInput(Enum):
    """The inputs of the table."""

    ASKED = "a client with the lease asks for authority"
    OBTAINED = "the aircraft gave it"
    REFUSED = "the aircraft refused it"
    FAILED = "not activated, no answer, or another error"
    LET_GO = "a client gives it back, or the lease has ended"
    TAKEN_OVER = "another client took the lease over"
    PILOT_TOOK = "lost: the pilot left F"
    SOMEBODY_TOOK = "lost: nobody knows to whom"
    APP_TOOK = "lost: the app took it"
    LINK_LOST = "the link is gone"
    LEFT_F = "the mode switch is not in F"
    IN_F = "the mode switch is in F"
    ENDED = "the control block was left"


_S, _I = HoldingState, HoldingInput

# The control block has ended when one of these is fed.
_LOST: dict[HoldingInput, HoldingState] = {
    _I.PILOT_TOOK: _S.PAUSED,
    _I.SOMEBODY_TOOK: _S.TAKEN,
    _I.APP_TOOK: _S.NONE,  # a client has to ask for it anew
    _I.LINK_LOST: _S.NONE,
    _I.FAILED: _S.NONE,
    _I.ENDED: _S.NONE,
}
# A pilot who comes back does so for the client that was flying, not for another one.
_WAITING: dict[HoldingInput, HoldingState] = {
    _I.ASKED: _S.OBTAINING,
    _I.LET_GO: _S.NONE,
    _I.TAKEN_OVER: _S.NONE,
    _I.LINK_LOST: _S.NONE,
}

TRANSITIONS: dict[HoldingState, dict[HoldingInput, HoldingState]] = {
    _S.NONE: {_I.ASKED: _S.OBTAINING},
    _S.OBTAINING: dict.fromkeys(_LOST, _S.NONE)  # the waiting client gets an error, and asks anew
    | {
        _I.OBTAINED: _S.HELD,
        _I.REFUSED: _S.NONE,
        _I.LET_GO: _S.RELEASING,
        _I.TAKEN_OVER: _S.RELEASING,  # another client asked for it; the new one has not
    },
    _S.HELD: _LOST | {_I.LET_GO: _S.RELEASING},
    _S.TAKEN: _WAITING | {_I.LEFT_F: _S.PAUSED},
    _S.PAUSED: _WAITING | {_I.IN_F: _S.RESUMING},
    _S.RESUMING: _LOST
    | {
        _I.ASKED: _S.OBTAINING,  # the request under way is now this client's
        _I.OBTAINED: _S.HELD,
        _I.REFUSED: _S.TAKEN,  # the switch has to be seen out of F and back once more
        _I.LET_GO: _S.RELEASING,
        _I.TAKEN_OVER: _S.RELEASING,  # the pilot came back for another client
    },
    _S.RELEASING: dict.fromkeys(_LOST, _S.NONE) | {_I.REFUSED: _S.NONE},
}
"""State, input, next state."""

_LOSSES = {
    errors.LossReason.MODE_SWITCH: _I.PILOT_TOOK,
    errors.LossReason.APP: _I.APP_TOOK,
    errors.LossReason.LINK: _I.LINK_LOST,
}

_LEFT = {
    AuthorityState.UNRELEASED: ("control authority may not be released: no answer", "warning"),
    AuthorityState.HELD: (
        "control authority is kept: what the aircraft flies by itself would end without it",
        "warning",
    ),
}
"""Notes on a control block that ended and did not give authority back."""

_UNSEEN = (errors.LinkError, errors.TelemetryStalled)
"""Errors that end control without a sight of the aircraft."""


class AuthorityManager:
    """Control authority for the clients of one agent, by default under all guards."""

    def __init__(self, journal: Journal, background: TaskSet, guards: Guards | None = None) -> None:
        self._journal = journal
        self._background = background
        self._guards = guards or Guards()
        self.state = HoldingState.NONE
        self.cause = HoldingInput.ENDED  # what led to this state
        self.flying: ActiveFlight | None = None  # what flies; None outside a control block
        # Called after each change with the old and the new state.
        self.on_change: list[Callable[[HoldingState, HoldingState], None]] = []
        # Called when somebody else took authority.
        self.on_lost: list[Callable[[errors.AuthorityLost], None]] = []
        # The task of the control block, and the event that lets it give authority back.
        self._block: asyncio.Task[None] | None = None
        self._let_go = asyncio.Event()
        # Resolved when the request under way has ended.
        self._granted: asyncio.Future[None] | None = None
        self.orphaned = OrphanedAuthority(journal, background)  # what no block here holds
        self.on_mission_event: MissionListener | None = None
        # The mission that a loss of control broke off, until the reason is known and reported.
        self._broken_off = ""
        # Watches the mode switch while the pilot may come back.
        self._watch: asyncio.Task[None] | None = None

    @property
    def has_authority(self) -> bool:
        flying = self.flying
        return self.state is HoldingState.HELD and flying is not None and flying.has_authority

    @property
    def flown(self) -> Flown:
        """The present flight, as far as this agent flies it."""
        return self.flying.flown if self.flying is not None else Flown.NOTHING

    @property
    def limits(self) -> GuardLimits:
        """The limits of the guards, also without control."""
        return limits_of(self._guards, None) if self.flying is None else self.flying.limits

    def require(self) -> ActiveFlight:
        """The present flight. Raises NoAuthority: authority is not held."""
        if self.flying is None or not self.has_authority:
            seen = "the station does not hold control authority; nothing was sent"
            raise errors.NoAuthority(seen, remedy="obtain control first")
        return self.flying

    def feed(self, what: HoldingInput) -> bool:
        """Something happened. Returns whether the state changed."""
        before = self.state
        after = TRANSITIONS[before].get(what, before)
        if after is before:
            return False
        self.state, self.cause = after, what
        if after is HoldingState.RELEASING:
            self._let_go.set()
        call_each(self.on_change, before, after)
        return True

    # -- requests of clients ---------------------------------------------------------------------

    async def obtain(self, aircraft: Aircraft) -> None:
        """Obtain authority; done when it is held. Asked for twice, it is requested once.

        NoAuthority says that it was given back before it was obtained.
        """
        await self.settle()
        self.feed(HoldingInput.ASKED)
        if self._block is None:
            self._begin(aircraft)
        # Shielded: others may wait for the same request, and cancelling one must not end theirs.
        if (granted := self._granted) is not None:
            await asyncio.wait([granted])
            granted.result()

    def let_go(self) -> None:
        """Give authority back; :meth:`settle` waits until that is done."""
        self.feed(HoldingInput.LET_GO)

    async def settle(self) -> None:
        """Wait until no control block is ending, and nothing that one left goes back."""
        while (ending := self._ending or self.orphaned.work) is not None:
            await asyncio.wait([ending])

    @property
    def _ending(self) -> asyncio.Task[None] | None:
        is_lost = self.state is HoldingState.HELD and not self.has_authority
        return self._block if is_lost or self.state is HoldingState.RELEASING else None

    async def insist(self) -> None:
        """Authority that nobody holds goes back now. Raises as :meth:`OrphanedAuthority.insist`."""
        await self.settle()  # a block that ends now may leave it behind
        if self._block is None:
            await self.orphaned.insist()

    def look(self, *, has_holder: bool) -> None:
        """Time passes: authority that nobody holds goes back."""
        if self.state is HoldingState.NONE and self._block is None:
            self.orphaned.look(Owed.AT_ONCE if has_holder else Owed.AFTER_LEASE)

    # -- the control block -----------------------------------------------------------------------

    def _begin(self, aircraft: Aircraft) -> None:
        self._let_go = asyncio.Event()
        granted = self._granted = asyncio.get_running_loop().create_future()
        granted.add_done_callback(look_at)
        self._block = self._background.spawn(self._hold(aircraft, granted), "authority")

    async def _hold(self, aircraft: Aircraft, granted: asyncio.Future[None]) -> None:
        try:
            try:
                async with aircraft.control(guards=self._guards) as control:
                    await self._use(control, granted)
            except errors.GuardianFailed as error:
                if is_on_ground(aircraft.state):
                    raise
                # A landing must not need a process that the system refuses.
                text = f"{error.seen}; control without a guardian lands or flies home, no more"
                self._journal.note(text, "error")
                async with aircraft.control(guards=self._guards, guardian=False) as control:
                    await self._use(control, granted, only_ends=True)
            self.feed(HoldingInput.ENDED)
            left = "control authority released", "info"
            self._journal.note(*_LEFT.get(aircraft.authority.state, left))
        except errors.AuthorityLost as error:
            self._lost(aircraft, error, granted)
        except errors.M100Error as error:
            is_refusal = isinstance(error, errors.AuthorityRefused)
            is_lost = isinstance(error, errors.LinkLost)
            self.feed(_I.REFUSED if is_refusal else _I.LINK_LOST if is_lost else _I.FAILED)
            if granted.done():
                self._journal.note(f"control ended: {error.seen}", "error")
                self._tell_mission(error.seen, is_seen=not isinstance(error, _UNSEEN))
            else:
                self._journal.note(f"no control authority: {error.seen}", "warning")
                granted.set_exception(error)
            self._wait_for_pilot(aircraft)
        finally:
            self._block = None
            if not granted.done():
                failed = "control was not obtained: the agent failed, or it ends"
                granted.set_exception(errors.NoAuthority(failed))
            self.orphaned.block_ended(aircraft)
            self.feed(HoldingInput.ENDED)  # nothing holds it now, whatever ended the block
            self._tell_mission("the agent ends")

    async def _use(
        self, control: Control, granted: asyncio.Future[None], *, only_ends: bool = False
    ) -> None:
        flying = self.flying = ActiveFlight(control, self._journal, self._background)
        flying.only_ends = only_ends
        flying.mission.on_event = self.on_mission_event
        try:
            self.feed(HoldingInput.OBTAINED)
            if self.state is HoldingState.HELD:
                self._journal.note("control authority obtained")
                granted.set_result(None)
            else:
                error = errors.NoAuthority("control was given back before it was obtained")
                granted.set_exception(error)
            await self._let_go.wait()
        finally:
            self.flying = None
            self._broken_off = await flying.end(is_lost=not self._let_go.is_set())

    def _lost(
        self, aircraft: Aircraft, error: errors.AuthorityLost, granted: asyncio.Future[None]
    ) -> None:
        self.feed(_LOSSES.get(error.reason, HoldingInput.SOMEBODY_TOOK))
        self._journal.note(f"control authority lost: {error.seen}", "warning")
        self._tell_mission(error.seen, is_seen=error.reason is not errors.LossReason.LINK)
        if not granted.done():
            granted.set_exception(error)
        # Whatever a callback raises: nobody else sees the pilot come back.
        try:
            call_each(self.on_lost, error)
        finally:
            self._wait_for_pilot(aircraft)

    def _tell_mission(self, why: str, *, is_seen: bool = True) -> None:
        """Note in the journal that a loss of control broke a mission off, if it did."""
        # Not seen, the aircraft may fly on, and nobody here knows.
        what, self._broken_off = self._broken_off, ""
        if not what:
            return
        text = f"the {what} ended: {why}"
        if not is_seen:
            text = f"nobody here flies the {what} now: {why}; the aircraft may fly on"
        self._journal.note(text, "error", EventTopic.MISSION_ABORTED)

    # -- the pilot comes back --------------------------------------------------------------------

    def _is_waiting(self) -> bool:
        return self.state in (HoldingState.TAKEN, HoldingState.PAUSED)

    def _wait_for_pilot(self, aircraft: Aircraft) -> None:
        if self._is_waiting():
            if self._watch is not None:
                self._watch.cancel()
            self._watch = self._background.spawn(self._watch_switch(aircraft), "mode switch")

    async def _watch_switch(self, aircraft: Aircraft) -> None:
        try:
            async with aircraft.telemetry(RemoteControl, policy=Newest(50)) as samples:
                async for sample in samples:
                    if not self._is_waiting():
                        return
                    is_in_f = sample[RemoteControl].is_in_f
                    self.feed(HoldingInput.IN_F if is_in_f else HoldingInput.LEFT_F)
                    if self.state is HoldingState.RESUMING:
                        self._begin(aircraft)
                        return
        except errors.M100Error:
            pass  # the connection tells it
        self.feed(HoldingInput.LINK_LOST)


# -- control authority that nobody holds and the aircraft may still obey: it goes back -------------
# An agent that is killed in flight gives nothing back, and neither does a control block whose line
# is lost, or whose release gets no answer. The aircraft hovers for want of setpoints and goes on
# obeying a program that is not there, or flies the task or mission that it was asked for.


_PAUSE_S = 1.0  # after a release that the aircraft did not confirm


class Owed(IntEnum):
    """Whether a release is owed, and from when on."""

    NOTHING = 0
    AFTER_STOP = 1  # authority was kept on purpose, such as for a landing by plan
    AFTER_LEASE = 2  # the line was lost: as long as somebody has the lease, the flight is theirs
    AT_ONCE = 3


class OrphanedAuthority:
    """Gives authority back that nobody holds, again and again until the aircraft confirms it."""

    def __init__(self, journal: Journal, background: TaskSet) -> None:
        self._journal = journal
        self._background = background
        self.owed = Owed.NOTHING
        self._whose = "the agent before"  # may have left it, for people
        self._is_reported = False  # that the aircraft does not confirm it
        self._aircraft: Aircraft | None = None  # None while it is not connected
        self.work: asyncio.Task[None] | None = None  # while a release is under way
        self._again_at = -math.inf

    def connected(self, aircraft: Aircraft | None, *, is_activated: bool) -> None:
        """The aircraft answers, or is gone."""
        self._aircraft = aircraft
        if aircraft is not None and not is_activated:
            self.owed = Owed.NOTHING  # it obeys nobody

    def block_ended(self, aircraft: Aircraft) -> None:
        authority = aircraft.authority
        self._whose, self._is_reported = "this agent", False
        if authority.reason is errors.LossReason.LINK:
            self.owed = Owed.AFTER_LEASE
        else:
            left = {AuthorityState.UNRELEASED: Owed.AT_ONCE, AuthorityState.HELD: Owed.AFTER_STOP}
            self.owed = left.get(authority.state, Owed.NOTHING)

    def look(self, least: Owed) -> None:
        """Ask for it to go back, where at least that much is owed."""
        is_due = self.owed >= least and asyncio.get_running_loop().time() >= self._again_at
        if is_due and self._aircraft is not None and self.work is None:
            work = self._give_back(self._aircraft)
            self.work = self._background.spawn(work, "inherited authority")

    async def _settle(self) -> None:
        if self.work is not None:
            await asyncio.wait([self.work])

    async def insist(self) -> None:
        """It goes back now, also while a client has the lease.

        Raises NotObserved: the aircraft does not confirm it; the release goes out again.
        """
        if self.owed is Owed.NOTHING:
            return
        self.owed, self._again_at = Owed.AT_ONCE, -math.inf
        await self._settle()
        self.look(Owed.AT_ONCE)
        await self._settle()
        if self.owed is not Owed.NOTHING:
            raise errors.NotObserved(
                "the aircraft does not confirm that it has control authority back",
                cause="the line is lost, or broken in one direction",
                remedy="it may fly on by itself: the pilot gets it by leaving F",
            )

    async def _give_back(self, aircraft: Aircraft) -> None:
        try:
            if await aircraft.release_authority():
                self.owed = Owed.NOTHING
                self._journal.note(
                    f"control authority that {self._whose} may have left is given back: "
                    "the aircraft hovers, the pilot flies",
                    "warning",
                )
            elif not self._is_reported:
                self._is_reported = True
                self._journal.note(
                    f"{self._whose} may have left control authority, and the aircraft does not "
                    "say that it has it back: the pilot gets it by leaving F",
                    "error",
                )
        finally:
            self.work, self._again_at = None, asyncio.get_running_loop().time() + _PAUSE_S


# -- the activation of the aircraft for one app, and how the last one went -------------------------


def _no_key() -> errors.UsageError:
    remedy = "start it with --app-id and --key-file"
    return errors.UsageError("this station has no app id and key", remedy=remedy)


class ActivationManager:
    """Activates the aircraft; without credentials it can only be watched."""

    def __init__(self, credentials: Credentials | None, journal: Journal) -> None:
        self._credentials = credentials
        self._journal = journal
        # Last answer to an activation, None before the first.
        self.code: ActivationCode | None = None
        # Why the last one failed, or each will, with remedy; None when it did not.
        self.error: errors.M100Error | None = None if credentials is not None else _no_key()
        # Called with each answer to an activation.
        self.on_code: list[Callable[[ActivationCode], None]] = []

    def adopt(self, aircraft: Aircraft) -> None:
        """Use the key on an aircraft that is active: it needs no new activation (DJI's node)."""
        if self._credentials is not None:
            aircraft.use_key(self._credentials)

    async def activate(self, aircraft: Aircraft) -> Version:
        if self._credentials is None:
            raise _no_key()
        self._journal.note("activating")
        try:
            version = await aircraft.activate(self._credentials, progress=self._progress)
        except errors.M100Error as error:
            self.error = error
            self._journal.note(f"activation failed: {error.seen}", "error")
            raise
        self.error = None
        self._journal.note("activated")
        return version

    def _progress(self, progress: ActivationProgress) -> None:
        self.code = progress.code
        for callback in self.on_code:
            callback(progress.code)
