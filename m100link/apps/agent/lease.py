"""The right to steer: one lease at a time, with an end (pure logic, ``now`` is an argument).

Any number of clients may watch. To steer, one takes the lease; it ends when its holder gives it
back, stops renewing it, or an operator takes it over. Time in which the station itself did not run
ends nothing: nobody could renew in it. A take-over has two steps: the first names the client that
would lose control, the second confirms exactly that. A lease that has ended stays ended: its token
is refused for ever, so a recorded message cannot bring it back.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from m100link.errors import M100Error
from m100link.errors.usage import renamed

LEASE_LIFETIME = 3.0
"""Seconds that a lease lasts without renewal; its holder renews it several times in that time."""

TAKE_OVER_LIFETIME = 10.0
"""Seconds in which a take-over has to be confirmed."""

MAX_NAME = 64
_MAX_TAKE_OVERS = 1024
"""More than the clients of a station can ask within the lifetime of one request."""


class LeaseRefused(
    M100Error,
    code="M100-LEASE-REFUSED",
    cause="somebody else may steer, or the lease has ended",
    remedy="ask for the lease again",
):
    """This client may not steer: the token is wrong, expired, given back or taken over."""


class LeaseHeld(
    LeaseRefused,
    code="M100-LEASE-HELD",
    cause="another client steers the aircraft",
    remedy="wait until it releases control, or ask its operator",
):
    """Another client holds the lease."""

    holder: str = ""  #: its name


def not_in_force(holder: str | None) -> LeaseRefused:
    return LeaseRefused(
        "this lease is not in force" + ("" if holder is None else f"; {holder} has control"),
        cause="it expired, was given back or was taken over; an ended lease never returns",
        remedy="take control anew",
    )


class LeaseChange(Enum):
    """Why the lease changed hands."""

    ACQUIRED = "acquired"
    RELEASED = "released"
    EXPIRED = "expired"
    TAKEN_OVER = "taken over"
    FRONT_LOST = "its front has gone"


class Flown(Enum):
    """The kind of flight as a lease ended."""

    NOTHING = "nothing"
    SETPOINTS = "setpoints"
    GUIDED = "guided flight"
    PROGRAM = "program"
    MISSION = "mission"
    TAKE_OFF = "take off"
    LAND = "land"
    GO_HOME = "go home"


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to steer."""

    name: str  #: the name of its holder, for people
    token: str  #: proof of it; only the holder knows it
    number: int  #: counts leases from 1; a later lease has a greater number

    def __repr__(self) -> str:
        # The token is a secret: a reader of the log must not be able to steer.
        return f"<Lease {self.number} of {self.name!r}>"


@dataclass(frozen=True, slots=True)
class TakeOver:
    """A take-over that waits for its confirmation."""

    name: str  #: the client that wants to steer
    from_name: str  #: the client that would lose the lease
    token: str  #: what :meth:`LeaseManager.confirm` takes
    number: int  #: number of the lease it is about; if that one ends first, this is void
    expires_at: float  #: time after which it is void

    def __repr__(self) -> str:
        return f"<TakeOver by {self.name!r} from {self.from_name!r}>"


class LeaseManager:
    """Hands out the lease of one aircraft.

    Args:
        lifetime: Seconds that a lease lasts without renewal.
        longest_step: Time between two calls that counts at most. Its owner calls :meth:`advance`
            more often than that, so a longer time means that the program did not run.
        leases_before: Number of the last lease of an earlier agent. Its leases never fit here.
        on_change: Called after each change with the reason, the old and the new lease.
    """

    def __init__(
        self,
        *,
        lifetime: float = LEASE_LIFETIME,
        longest_step: float = math.inf,
        leases_before: int = 0,
        on_change: Callable[[LeaseChange, Lease | None, Lease | None], None] | None = None,
    ) -> None:
        if not lifetime > 0:
            raise ValueError(f"a lease of {lifetime} s is none")
        self.lifetime = lifetime
        self._longest_step = longest_step
        self._on_change = on_change
        self._lease: Lease | None = None
        self._expires_at = 0.0
        self._count = leases_before
        self._advanced_at: float | None = None
        # Side by side: the request of one client does not cancel that of another.
        self._take_overs: list[TakeOver] = []

    def holder(self, now: float) -> Lease | None:
        """The lease in force."""
        self.advance(now)
        return self._lease

    def remaining(self, now: float) -> float:
        """Seconds until the lease in force ends if nobody renews it; 0 without one."""
        self.advance(now)
        return self._expires_at - now if self._lease is not None else 0.0

    def advance(self, now: float) -> None:
        """Let time pass: end a lease that nobody renewed."""
        step = now - self._advanced_at if self._advanced_at is not None else 0.0
        self._advanced_at = now
        if step > self._longest_step:  # the agent stood still, and nobody could renew
            self._expires_at += step - self._longest_step
        if self._lease is not None and now >= self._expires_at:
            self._change(LeaseChange.EXPIRED, None, now)

    def acquire(self, name: str, now: float) -> Lease:
        """Take the lease if it is free.

        Raises:
            LeaseHeld: It is not; the holder's name is in the error.
        """
        self.advance(now)
        if self._lease is not None:
            raise LeaseHeld(
                f"{self._lease.name} has control",
                holder=self._lease.name,
                remedy="ask its operator to release control, or take over and confirm it",
            )
        return self._grant(LeaseChange.ACQUIRED, name, now)

    def check(self, token: str, now: float) -> Lease:
        """The lease that the token proves.

        Raises:
            LeaseRefused: It proves none, or one that has ended.
        """
        self.advance(now)
        lease = self._lease
        # In constant time: how long a comparison takes tells how much of a guessed token is right.
        if lease is None or not secrets.compare_digest(lease.token.encode(), token.encode()):
            raise not_in_force(None if lease is None else lease.name)
        return lease

    def renew(self, token: str, now: float) -> Lease:
        """Let the lease last another lifetime from now. Raises as :meth:`check`."""
        lease = self.check(token, now)
        self._expires_at = now + self.lifetime
        return lease

    def release(self, token: str, now: float, why: LeaseChange = LeaseChange.RELEASED) -> None:
        """End the lease: its holder gives it back, or is gone. Raises as :meth:`check`."""
        self.check(token, now)
        self._change(why, None, now)

    def ask_take_over(self, name: str, now: float) -> TakeOver:
        """First step of a take-over: name the client that would lose control.

        Requests stand side by side until they are confirmed or too old.

        Raises:
            LeaseRefused: Nobody holds the lease; it can simply be acquired.
        """
        self.advance(now)
        if self._lease is None:
            raise LeaseRefused(
                "nobody has control", remedy="acquire the lease, there is no need to take it over"
            )
        wanted = TakeOver(
            _clean(name),
            self._lease.name,
            secrets.token_urlsafe(16),
            self._lease.number,
            now + TAKE_OVER_LIFETIME,
        )
        self._take_overs = [one for one in self._take_overs if now < one.expires_at]
        self._take_overs = [*self._take_overs[-_MAX_TAKE_OVERS + 1 :], wanted]
        return wanted

    def void_take_overs(self) -> None:
        """Let nobody confirm a take-over that was asked for until now."""
        self._take_overs.clear()

    def confirm(self, token: str, now: float) -> Lease:
        """Second step: take the lease from the client that the first step named.

        Raises:
            LeaseRefused: There is no such request, it is too old, used before, or the lease has
                changed hands since: then the operator confirmed something else.
        """
        self.advance(now)
        wanted = None
        for one in self._take_overs:
            if secrets.compare_digest(one.token.encode(), token.encode()):
                wanted = one
        if wanted is None or now >= wanted.expires_at:  # each change of the lease voids all
            raise LeaseRefused(
                "there is nothing to confirm",
                cause="the request is too old, was used, or control changed hands or STOP was "
                "pressed meanwhile",
                remedy="look who has control now, and ask again",
            )
        return self._grant(LeaseChange.TAKEN_OVER, wanted.name, now)

    def _grant(self, why: LeaseChange, name: str, now: float) -> Lease:
        self._count += 1
        lease = Lease(_clean(name), secrets.token_urlsafe(16), self._count)
        self._change(why, lease, now)
        return lease

    def _change(self, why: LeaseChange, lease: Lease | None, now: float) -> None:
        before, self._lease = self._lease, lease
        self._expires_at = now + self.lifetime
        self._take_overs.clear()
        if self._on_change is not None:
            self._on_change(why, before, lease)


def _clean(name: str) -> str:
    printable = "".join(letter for letter in name if letter.isprintable()).strip()
    return printable[:MAX_NAME] or "unnamed"


if not TYPE_CHECKING:
    __getattr__ = renamed(__name__, LeaseDesk="LeaseManager")
