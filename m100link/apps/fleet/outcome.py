"""What became of an order: six answers, and none of them is silence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    LinkClosed,
    LinkLost,
    M100Error,
    NotAllowed,
    NotObserved,
    OutcomeUnknown,
    StaleLease,
    Unreachable,
)

__all__ = ["Outcome", "Result", "outcome_of"]


class Outcome(Enum):
    """What became of an order."""

    OK = "ok"  # carried out, and seen to be
    REFUSED = "refused"  # not carried out, or it failed: the reason says which
    STALE_LEASE = "stale_lease"  # not carried out: somebody else may steer, or nobody
    NOT_ALLOWED = "not_allowed"  # not carried out: this identity may not
    UNREACHABLE = "unreachable"  # never sent: there is no such agent
    UNKNOWN = "unknown"  # sent; nobody knows


# The first class that fits decides, so subclasses stand before their bases.
_OUTCOMES: tuple[tuple[type[M100Error], Outcome], ...] = (
    (LeaseHeld, Outcome.REFUSED),  # by who has it: this side never had it
    (LeaseRefused, Outcome.STALE_LEASE),
    (StaleLease, Outcome.STALE_LEASE),
    (NotAllowed, Outcome.NOT_ALLOWED),
    (Unreachable, Outcome.UNREACHABLE),
    (OutcomeUnknown, Outcome.UNKNOWN),
    (AckTimeout, Outcome.UNKNOWN),  # the aircraft itself did not answer
    # It had begun, and nobody saw how it went on.
    (NotObserved, Outcome.UNKNOWN),
    (AuthorityLost, Outcome.UNKNOWN),
    (LinkLost, Outcome.UNKNOWN),
    (LinkClosed, Outcome.UNKNOWN),
    (M100Error, Outcome.REFUSED),
)


def outcome_of(error: M100Error | None) -> Outcome:
    """The outcome that an error means; None means that all is well."""
    if error is None:
        return Outcome.OK
    return next(outcome for kind, outcome in _OUTCOMES if isinstance(error, kind))


@dataclass(frozen=True, slots=True)
class Result:
    """What became of an order to one aircraft.

    Attributes:
        name: Which one.
        outcome: What became of it.
        error: Why it is not ``ok``: what was seen, the likely cause, what to do.
        value: What the order gave, where it gives something.
    """

    name: str
    outcome: Outcome
    error: M100Error | None = None
    value: object = None

    @classmethod
    def of(cls, name: str, error: M100Error | None, value: object = None) -> Result:
        """What an error means."""
        return cls(name, outcome_of(error), error, value)

    @property
    def is_ok(self) -> bool:
        """Whether it was carried out."""
        return self.outcome is Outcome.OK

    def __str__(self) -> str:
        if self.error is None:
            return self.outcome.value
        return f"{self.outcome.value} ({self.error.seen})"
