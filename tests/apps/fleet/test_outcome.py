"""What an error means for whoever asked."""

from __future__ import annotations

import pytest

from m100link.apps.agent.lease import LeaseHeld, LeaseRefused
from m100link.apps.fleet.payloads import Outcome, Result, outcome_of
from m100link.errors import (
    AckTimeout,
    AuthorityLost,
    GuardRefused,
    LinkError,
    LinkLost,
    M100Error,
    NotAllowed,
    NotObserved,
    OutcomeUnknown,
    StaleLease,
    Unreachable,
)


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (None, Outcome.OK),
        (GuardRefused("low", guard="battery"), Outcome.REFUSED),
        (LeaseHeld("held", holder="other"), Outcome.REFUSED),
        (LeaseRefused("ended"), Outcome.STALE_LEASE),
        (StaleLease("ended"), Outcome.STALE_LEASE),
        (NotAllowed("no"), Outcome.NOT_ALLOWED),
        (Unreachable("nobody"), Outcome.UNREACHABLE),
        (OutcomeUnknown("silence"), Outcome.UNKNOWN),
        # The aircraft itself gave no answer: it may have done it.
        (AckTimeout("no ack", tries=3), Outcome.UNKNOWN),
        # It had begun: the aircraft may have done it, or do it yet.
        (NotObserved("not seen to be done"), Outcome.UNKNOWN),
        (AuthorityLost("the pilot left F"), Outcome.UNKNOWN),
        (LinkLost("unplugged"), Outcome.UNKNOWN),
        (LinkError("not connected: nothing was sent"), Outcome.REFUSED),
    ],
)
def test_each_error_has_one(error: M100Error | None, outcome: Outcome) -> None:
    assert outcome_of(error) is outcome
    assert Result.of("a1", error).is_ok is (error is None)


def test_a_result_says_why() -> None:
    assert str(Result.of("a1", None)) == "ok"
    assert str(Result.of("a1", StaleLease("it ended"))) == "stale_lease (it ended)"
