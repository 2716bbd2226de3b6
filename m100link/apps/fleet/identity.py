"""Orders that are signed: who gave one, that nobody changed it, and that it is not an old one.

The router's rules are the fence, and the signature is the lock: an agent verifies it by itself,
whatever stands between it and the pilot. Pure logic; the time is an argument.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import (
    Ed25519PrivateKey,
    Ed25519PublicKey,
)

from m100link.apps.fleet.revoked import Since, nobody
from m100link.apps.fleet.rights import Right, Rights
from m100link.errors import NotAllowed, UsageError

__all__ = ["STOP_WINDOW_S", "WINDOW_S", "Claim", "Gate", "OrderRefused", "Reason", "Signer"]

WINDOW_S = 5.0
"""Seconds that an order may be old, or from the future: by so much clocks may differ."""
STOP_WINDOW_S = 600.0
"""The same for what stops: a wrong clock must keep nobody from stopping an aircraft. A recorded
stop that somebody repeats in that time stops it once more, which is a nuisance and not a danger."""

_MAGIC = b"m100link order 1\n"
_NUMBERS = struct.Struct(">Qd")
_PURGED_AT = 1024


class Reason(Enum):
    """Why an order is not obeyed."""

    UNKNOWN_KEY = "unknown key"
    BAD_SIGNATURE = "bad signature"
    WRONG_AIRCRAFT = "wrong aircraft"
    REVOKED = "revoked"
    NOT_ALLOWED = "not allowed"
    EXPIRED = "expired"
    REPLAYED = "replayed"


class OrderRefused(
    NotAllowed,
    code="M100-ORDER-REFUSED",
    cause="a key that the agent does not know, a clock that is wrong, or a right that is missing",
    remedy="look at `reason`; nothing was done",
):
    """A signed order is not obeyed.

    Attributes:
        reason: Why.
        signer: Who says to have signed it.
    """

    def __init__(
        self, seen: str, *, reason: Reason, signer: str, cause: str = "", remedy: str = ""
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.reason = reason
        self.signer = signer


@dataclass(frozen=True, slots=True)
class Claim:
    """What a signature is over.

    Attributes:
        id: Of the order.
        fence: Number of the lease that it is asked under; 0 for none.
        aircraft: For which one.
        at: When it was made, POSIX time, s.
        signer: Whose signature it is.
        body: What is ordered.
    """

    id: str
    fence: int
    aircraft: str
    at: float
    signer: str
    body: bytes

    def to_bytes(self) -> bytes:
        """What is signed: the same bytes for the same order, and others for every other one.

        ``m100link order 1`` and a line feed; fence and time as a 64-bit number and a double,
        big-endian; then id, aircraft, signer and body, each behind its length in four bytes.

        Raises:
            UsageError: The fence is no number of 64 bits.
        """
        if not 0 <= self.fence < 2**64:
            raise UsageError(f"a fence of {self.fence} is none", remedy="0 to 2⁶⁴-1")
        parts = self.id.encode(), self.aircraft.encode(), self.signer.encode(), self.body
        lengths = b"".join(struct.pack(">I", len(part)) + part for part in parts)
        return _MAGIC + _NUMBERS.pack(self.fence, self.at + 0.0) + lengths


class Signer:
    """Signs orders.

    Args:
        name: As the file of rights has it.
        key: The secret, 32 bytes.

    Raises:
        UsageError: The key is none.
    """

    def __init__(self, name: str, key: bytes) -> None:
        if len(key) != 32:
            raise UsageError(f"a signing key has 32 bytes, not {len(key)}")
        self.name = name
        self._key = Ed25519PrivateKey.from_private_bytes(key)

    @property
    def public_key(self) -> bytes:
        """For the file of rights, 32 bytes."""
        return self._key.public_key().public_bytes_raw()

    def sign(self, claim: Claim) -> bytes:
        """The signature, 64 bytes.

        Raises:
            UsageError: It names another signer.
        """
        if claim.signer != self.name:
            raise UsageError(f"{self.name} cannot sign for {claim.signer}")
        return self._key.sign(claim.to_bytes())


class Gate:
    """Lets orders through that somebody gave who may, for this aircraft, now, and once.

    Args:
        rights: Who may do what.
        aircraft: Which one this is.
        began_at: When it began to look, POSIX time, s: what was signed before may have been let
            through by who was there before, and is not, but for what stops. (A clock that is ahead
            gets around that by so much; what moves the aircraft has to be kept on disk besides.)
        revoked: Who is shut out.
    """

    def __init__(
        self,
        rights: Rights,
        aircraft: str,
        *,
        began_at: float,
        revoked: Since = nobody,
    ) -> None:
        self._revoked = revoked
        self._rights = rights
        self._aircraft = aircraft
        self._began_at = began_at
        self._keys = {
            name: Ed25519PublicKey.from_public_bytes(one.public_key)
            for name, one in rights.identities.items()
            if one.public_key is not None
        }
        # What was let through, and until when it could be let through again.
        self._seen: dict[tuple[str, str], float] = {}
        self._purged_at = _PURGED_AT

    def check(self, claim: Claim, signature: bytes, right: Right, now: float) -> None:
        """Whether an order may be obeyed; the id of one that may is used up.

        Args:
            claim: What it says.
            signature: 64 bytes.
            right: What it needs.
            now: POSIX time, s.

        Raises:
            OrderRefused: It may not, with the reason.
        """
        self._require_signature(claim, signature)
        who = claim.signer
        if claim.aircraft != self._aircraft:
            raise OrderRefused(
                f"an order of {who} to {claim.aircraft} came to {self._aircraft}",
                reason=Reason.WRONG_AIRCRAFT,
                signer=who,
                cause="somebody sent on what was meant for another aircraft",
                remedy="give the order to the aircraft it is for",
            )
        since = self._revoked(who)
        if since:
            raise OrderRefused(
                f"{who} is revoked since {since}",
                reason=Reason.REVOKED,
                signer=who,
                cause="its certificate and key are said to be lost, or it may not be here any more",
                remedy="whoever it is needs a certificate, a key and rights under another name",
            )
        identity = self._rights.identity(who)
        if identity is None or not identity.may(right, self._aircraft):
            raise OrderRefused(
                f"{who} may not {right.name.lower()} {self._aircraft}",
                reason=Reason.NOT_ALLOWED,
                signer=who,
                cause="the file of rights on board does not allow it",
                remedy=f"[identity.{who}] {right.name.lower()} = [{self._aircraft!r}] in it",
            )
        until = self._require_fresh(claim, right, now)
        if (who, claim.id) in self._seen:
            raise OrderRefused(
                f"order {claim.id} of {who} came a second time",
                reason=Reason.REPLAYED,
                signer=who,
                cause="somebody recorded and repeats it, or an id was used twice",
                remedy="ask what became of the order; a new one has a new id",
            )
        self._purge(now)
        self._seen[who, claim.id] = until

    def _require_signature(self, claim: Claim, signature: bytes) -> None:
        key = self._keys.get(claim.signer)
        if key is None:
            who = claim.signer or "nobody"
            raise OrderRefused(
                f"an order is signed by {who}, whose key {self._aircraft} does not know",
                reason=Reason.UNKNOWN_KEY,
                signer=claim.signer,
                cause="the file of rights on board has no public_key of that name",
                remedy="put it there, as `m100link fleet pki issue pilot` told it",
            )
        try:
            key.verify(signature, claim.to_bytes())
        except (InvalidSignature, UsageError, UnicodeEncodeError) as error:
            raise OrderRefused(
                f"the signature of {claim.signer} does not fit the order",
                reason=Reason.BAD_SIGNATURE,
                signer=claim.signer,
                cause="the order was changed on its way, or signed by another key",
                remedy="compare the public_key on board with that of the signer",
            ) from error

    def _require_fresh(self, claim: Claim, right: Right, now: float) -> float:
        """Until when it could come again, POSIX time."""
        window = STOP_WINDOW_S if right is Right.STOP else WINDOW_S
        age = now - claim.at
        is_before = right is not Right.STOP and claim.at < self._began_at
        if not abs(age) <= window or is_before:
            seen = f"{age:.1f} s old" if age >= 0 else f"from {-age:.1f} s ahead"
            if not math.isfinite(age):
                seen = "of no time"
            elif abs(age) <= window:
                seen = f"{age:.1f} s old, and older than this agent"
            raise OrderRefused(
                f"the order of {claim.signer} is {seen}",
                reason=Reason.EXPIRED,
                signer=claim.signer,
                cause=f"clocks may differ by {window:g} s; or somebody recorded and repeats it",
                remedy="let chrony or ntpd set the clocks of both, and order anew",
            )
        return claim.at + window

    def _purge(self, now: float) -> None:
        """Forget what would be refused as expired by now."""
        if len(self._seen) >= self._purged_at:
            self._seen = {one: until for one, until in self._seen.items() if until >= now}
            self._purged_at = max(_PURGED_AT, 2 * len(self._seen))
