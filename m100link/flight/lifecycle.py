"""The life of a control block as a table, and its stop path for each cause as another.

Whatever can happen to a block is an input or a cause; what it leads to stands in ``TRANSITIONS``. A
pair that is not in the table changes nothing. Why a block stops decides what can still be done for
the aircraft: that stands in ``STOP_PLANS``, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from enum import Enum
from typing import NamedTuple

from m100link.errors import LinkClosed, M100Error, UsageError


class BlockState(Enum):
    """Where a control block is in its life."""

    NEW = "made and not entered; nothing was asked of the aircraft"
    ENTERING = "authority is being obtained; nothing may be sent yet"
    FLYING = "setpoints and tasks go out"
    PAUSED = "the pilot has the aircraft; nothing goes out before resume()"
    STOPPING = "the stop path runs, whatever the program's block does meanwhile"
    OVER = "authority was given back, as far as the line allowed; it is never entered again"


class BlockInput(Enum):
    """The inputs of a block's life; each :class:`StopCause`, which ends it, is one more."""

    ENTER = "the program enters the block"
    OBTAINED = "authority was obtained"
    PAUSE = "the pilot took the aircraft, and the program waits for it"
    RESUME = "the program goes on after the pilot gave it back"
    STOPPED = "the stop path has ended"


class StopCause(Enum):
    """Why a block stops."""

    LEFT = "the program left the block: its end, an exception, a cancellation"
    NOT_ENTERED = "the block could not be entered"
    SIGNALLED = "a signal that ends programs: Ctrl-C, SIGTERM, SIGHUP, SIGQUIT, SIGXCPU"
    CLOSED = "the connection is being closed, by whatever task"
    AUTHORITY_LOST = "the pilot or the app took the aircraft"
    TELEMETRY_STALLED = "no new telemetry came for too long"
    NAVIGATION_LOST = "the position cannot be true"
    SETPOINTS_IGNORED = "nothing begins to follow what is sent"
    SUSPENDED = "the computer slept: whatever it knows is old"
    GUARD_REFUSED = "a guard refused the mission that flies, or nobody could watch it"
    SENDING_FAILED = "a setpoint could not be sent, and not because of the line"
    LINE_BLOCKED = "the line takes no more: setpoints do not reach the aircraft"
    LINK_LOST = "the line is gone"
    GUARDIAN = "the program stood still, and the guardian ended the flight"


class StopPlan(NamedTuple):
    """The steps of the stop path."""

    # Stop the mission that the block started: while one flies, the aircraft ignores setpoints, and
    # it would fly on behind the block. Where somebody else took the aircraft, only one that
    # is reported still, or of which nothing is heard.
    mission: bool
    explain: bool  # wait for a moment, in silence, for the items that show where authority went
    # Replace a setpoint that is being sent by its neutral for 0.3 s; otherwise nothing more is
    # sent.
    neutral: bool
    land: bool  # land where the program asked for ``stop="land"``
    release: bool


_C = StopCause

_OURS = StopPlan(mission=True, explain=False, neutral=True, land=True, release=True)
"""The aircraft is ours, and hears us as far as anybody knows."""

STOP_PLANS: dict[StopCause, StopPlan] = {
    _C.LEFT: _OURS,
    # Nothing was sent. The ack may be lost and authority ours all the same.
    _C.NOT_ENTERED: StopPlan(mission=False, explain=False, neutral=False, land=False, release=True),
    _C.SIGNALLED: _OURS,
    _C.CLOSED: _OURS,
    # The pilot or the app flies it now; the release makes sure that it does not come back to us.
    # That breaks a mission off, as far as anybody knows.
    _C.AUTHORITY_LOST: StopPlan(
        mission=True, explain=True, neutral=False, land=False, release=True
    ),
    # The aircraft may hear us although we do not hear it.
    _C.TELEMETRY_STALLED: _OURS,
    # The neutral asks for no place, and a landing needs none.
    _C.NAVIGATION_LOST: _OURS,
    # A landing is another command: it may be obeyed, or arrive, where setpoints are not.
    _C.SETPOINTS_IGNORED: _OURS,
    # Authority may be lost meanwhile; each step asks for it, and the aircraft hovers in any case.
    _C.SUSPENDED: _OURS,
    _C.GUARD_REFUSED: _OURS,
    # The neutral and the release are other commands: they may still be sent.
    _C.SENDING_FAILED: _OURS,
    # It may drain again at any moment, and then the release arrives.
    _C.LINE_BLOCKED: _OURS,
    # There is nobody to talk to.
    _C.LINK_LOST: StopPlan(mission=False, explain=False, neutral=False, land=False, release=False),
    # The guardian does all that; two processes that fly the end would disturb each other.
    _C.GUARDIAN: StopPlan(mission=False, explain=False, neutral=False, land=False, release=False),
}
"""The stop path of each cause. Every step still asks whether authority is held."""


_S, _I = BlockState, BlockInput

# From every state in which the aircraft may be ours, and also for what raises between the ack and
# the program's first line.
_STOPS: dict[BlockInput | StopCause, BlockState] = dict.fromkeys(_C, _S.STOPPING)

TRANSITIONS: dict[BlockState, dict[BlockInput | StopCause, BlockState]] = {
    _S.NEW: {_I.ENTER: _S.ENTERING},
    _S.ENTERING: {
        _I.OBTAINED: _S.FLYING,
        # The pilot may take the aircraft between the ack and the program's first line.
        _I.PAUSE: _S.PAUSED,
        **_STOPS,
    },
    _S.FLYING: {_I.PAUSE: _S.PAUSED, **_STOPS},
    _S.PAUSED: {_I.RESUME: _S.FLYING, **_STOPS},
    _S.STOPPING: {
        _I.STOPPED: _S.OVER,
        # The rest of the stop path has nobody to talk to; the program gets this error.
        _C.LINK_LOST: _S.STOPPING,
        # So is the rest of one that stands still.
        _C.GUARDIAN: _S.STOPPING,
    },
    _S.OVER: {},
}
"""State, input or cause, next state."""


class Lifecycle:
    """The life of one block."""

    def __init__(self) -> None:
        self.state = BlockState.NEW
        # Why it stops or stopped, None before; a line that is lost, or a guardian that takes over,
        # replaces any other cause.
        self.cause: StopCause | None = None
        # The error that the block will raise, the first one if there were several.
        self.failure: M100Error | None = None

    @property
    def plan(self) -> StopPlan:
        """The plan of the stop path; there is a cause before there is a stop path."""
        assert self.cause is not None
        return STOP_PLANS[self.cause]

    @property
    def is_open(self) -> bool:
        """Whether the program is in its block, and nothing has ended that."""
        return self.state in (BlockState.FLYING, BlockState.PAUSED)

    def feed(self, what: BlockInput | StopCause, failure: M100Error | None = None) -> bool:
        """Something happened. Returns whether it stands in the table for the present state."""
        after = TRANSITIONS[self.state].get(what)
        if after is None:
            return False
        if isinstance(what, StopCause):
            self.cause = what
            self.failure = self.failure or failure
        self.state = after  # last: no state without its cause
        return True


class BlockClaim:
    """One control block at a time: a second would release the authority of the first."""

    def __init__(self) -> None:
        self._close: Callable[[], Awaitable[None]] | None = None
        self._is_closed = False

    def take(self, close: Callable[[], Awaitable[None]]) -> None:
        """A block begins; ``close`` stops it and waits for its end.

        Raises ``UsageError``: another one has not ended. Raises ``LinkClosed``: the connection is
        being closed: nobody could end another one.
        """
        if self._is_closed:
            raise LinkClosed("the aircraft was disconnected: no control block begins any more")
        if self._close is not None:
            raise UsageError(
                "another control block of this program has not ended: it runs, or it lands",
                remedy="share its object, or leave or release() that one, which waits for its end",
            )
        self._close = close

    def give_back(self) -> None:
        """The block that took it has ended."""
        self._close = None

    async def close(self) -> None:
        """Let none begin any more, stop the one that runs, and wait for the end of its path."""
        self._is_closed = True
        if self._close is not None:
            await self._close()
