"""Where a connection that is kept stands, as a table; pauses between attempts; what consumers get.

See :func:`m100link.supervise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from m100link.errors import M100Error, UsageError

if TYPE_CHECKING:
    from random import Random

__all__ = [
    "ENDED",
    "TRANSITIONS",
    "BackOff",
    "Gap",
    "SupervisionEvent",
    "SupervisionInput",
    "SupervisionState",
]


class SupervisionState(Enum):
    """Where the connection is."""

    IDLE = "idle"  # not begun
    CONNECTING = "connecting"  # the line is opened and the aircraft asked for its version
    ACTIVATING = "activating"  # it answered and is the same one; the app is activated
    CONNECTED = "connected"  # telemetry flows, control can be obtained
    WAITING = "waiting"  # until the next attempt
    REFUSED = "refused"  # no attempt would end otherwise: a person has to do something
    CLOSED = "closed"  # by this program


class SupervisionInput(Enum):
    """What can happen."""

    START = "the block is entered"
    ANSWERED = "the same aircraft answered as before, or the first one"
    ACTIVATED = "it is activated, or need not be"
    FAILED = "an attempt failed, and a later one may not"
    LOST = "the line is gone, or the aircraft is silent"
    DEACTIVATED = "the aircraft was switched off and on meanwhile"
    REFUSED = "an attempt failed, and so would every other"
    DUE = "the pause is over"
    CLOSE = "the block is left"


_S, _I = SupervisionState, SupervisionInput

TRANSITIONS: dict[SupervisionState, dict[SupervisionInput, SupervisionState]] = {
    _S.IDLE: {_I.START: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.CONNECTING: {
        _I.ANSWERED: _S.ACTIVATING,
        _I.FAILED: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.ACTIVATING: {
        _I.ACTIVATED: _S.CONNECTED,
        _I.FAILED: _S.WAITING,
        _I.LOST: _S.WAITING,
        _I.REFUSED: _S.REFUSED,
        _I.CLOSE: _S.CLOSED,
    },
    _S.CONNECTED: {
        _I.LOST: _S.WAITING,
        _I.DEACTIVATED: _S.ACTIVATING,
        _I.REFUSED: _S.REFUSED,  # another aircraft was plugged in behind an adapter that stayed
        _I.CLOSE: _S.CLOSED,
    },
    _S.WAITING: {_I.DUE: _S.CONNECTING, _I.CLOSE: _S.CLOSED},
    _S.REFUSED: {_I.CLOSE: _S.CLOSED},
    _S.CLOSED: {},
}
"""State, input, next state. A pair that is not in it cannot happen, or changes nothing."""

ENDED = (_S.REFUSED, _S.CLOSED)
"""States in which no aircraft comes any more."""


@dataclass(frozen=True, slots=True)
class BackOff:
    """How long to wait before each attempt.

    Attributes:
        first: Seconds before the first repetition, above 0.
        factor: By which each pause is longer than the one before, 1 or more.
        most: Longest pause, s.
        jitter: Share by which a pause is longer or shorter by chance, 0 to below 1, so that many
            programs do not come back at the same moment.

    Raises:
        UsageError: One of them is out of its range.
    """

    first: float = 0.5
    factor: float = 2.0
    most: float = 15.0
    jitter: float = 0.2

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not (0 < self.first <= self.most < float("inf") and 1 <= self.factor < float("inf")):
            raise UsageError(
                f"{self} never ends or never begins", remedy="0 < first <= most, and factor >= 1"
            )
        if not 0 <= self.jitter < 1:
            raise UsageError(f"a jitter of {self.jitter} is not from 0 to below 1")

    def pause(self, attempt: int, random: Random) -> float:
        """Seconds before the attempt of that number, from 1."""
        # A power of it would overflow in a day of attempts.
        pause = self.first
        for _ in range(attempt - 1):
            pause *= self.factor
            if pause >= self.most or self.factor == 1:
                break
        return min(pause, self.most) * (1.0 + self.jitter * random.uniform(-1.0, 1.0))


class SupervisionEvent(NamedTuple):
    """The connection passed from one state to another.

    Attributes:
        before: State before.
        after: State now.
        error: Why, where something failed.
        next_attempt_in: Seconds until the next attempt, while one is waited for.
    """

    before: SupervisionState
    after: SupervisionState
    error: M100Error | None
    next_attempt_in: float | None


class Gap(NamedTuple):
    """Stands in a stream of telemetry for what did not arrive while there was no connection.

    Attributes:
        lost_at: Time of the event loop when the stream ended, s.
        back_at: When it went on, s.
        error: Why it had ended.
    """

    lost_at: float
    back_at: float
    error: M100Error
