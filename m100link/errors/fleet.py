"""What may become of an order to an aircraft of a fleet, when it is not what was asked for."""

from __future__ import annotations

from m100link.errors.base import M100Error

__all__ = ["FleetError", "NotAllowed", "OutcomeUnknown", "StaleLease", "Unreachable"]


class FleetError(
    M100Error,
    code="M100-FLEET",
    cause="the way to the agent on board, or who else uses it",
    remedy="m100link fleet list",
):
    """An order to an aircraft of a fleet did not end as asked for."""


class Unreachable(
    FleetError,
    code="M100-UNREACHABLE",
    cause="its agent does not run, or is not connected to this router",
    remedy="start the agent; see that both name the same router and site",
):
    """No agent of that name is there: nothing was sent."""


class OutcomeUnknown(
    FleetError,
    code="M100-OUTCOME-UNKNOWN",
    cause="the way there or back was cut, or the agent was started anew meanwhile",
    remedy="look at the aircraft; an order is repeated with its own id, never with a new one",
):
    """It was sent, and nobody knows whether it was carried out."""


class StaleLease(
    FleetError,
    code="M100-STALE-LEASE",
    cause="the lease ended by silence, was given back, or was taken over",
    remedy="take control anew",
):
    """The order came under a lease that is not in force: it was not carried out."""


class NotAllowed(
    FleetError,
    code="M100-NOT-ALLOWED",
    cause="this identity has no right to give that order to this aircraft",
    remedy="m100link fleet acl check",
):
    """The agent refused who asked."""
