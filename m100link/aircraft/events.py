"""What happens to a connection and to control authority, as a program is told."""

from __future__ import annotations

from typing import NamedTuple

from m100link.errors import LinkError, LossReason
from m100link.flight.authority import AuthorityState

__all__ = ["AuthorityEvent", "ConnectionEvent"]


class ConnectionEvent(NamedTuple):
    """Something happened to the connection.

    Attributes:
        is_connected: Whether the line is open now.
        error: Why it is not; None while it is.
    """

    is_connected: bool
    error: LinkError | None


class AuthorityEvent(NamedTuple):
    """Control authority passed from one state to another.

    Attributes:
        before: State before.
        after: State now.
        reason: Why it was lost or paused.
    """

    before: AuthorityState
    after: AuthorityState
    reason: LossReason
