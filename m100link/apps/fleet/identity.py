"""Signed orders: who gave one, that it was not changed, and that it is not an old one.

The router's rules are the fence, and the signature is the lock: an agent verifies it by itself,
whatever stands between it and the operator. Pure logic; the time is an argument.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256

from m100link.apps.agent.orders import Halt, LeaseOrder, Right, Stop
from m100link.apps.fleet.keys import NAME
from m100link.apps.fleet.payloads import OrderMessage, StartShow, TakePlace
from m100link.errors import NotAllowed, UsageError
from m100link.errors.texts import read_json, read_toml
from m100link.link.keyfile import read_watched

# -- who may do what with which aircraft: one small file, from which router and agents take it -----
# ::
#     site = "site"
#     [aircraft.a1]                  # its certificate is a1, unless common_name says another one
#     [identity.anna]
#     public_key = "64 hex digits"   # of her signing key; without one she can sign nothing
#     fly = ["a1", "b*"]             # who may fly may stop and watch, too
#     stop = ["*"]                   # who may stop may watch


_PATTERN = re.compile(rf"{NAME.pattern}\*?|\*")
_KEY = re.compile(r"[0-9a-fA-F]{64}")
_LARGEST = 1024 * 1024
_FIELDS = ("common_name", "public_key", "watch", "stop", "fly")


class BadRights(
    UsageError,
    code="M100-BAD-RIGHTS",
    cause="an unknown field or a wrong value in the file of rights, or another kind of file",
    remedy="`m100link fleet acl check FILE` says what each identity may do",
):
    """A file of rights with an error."""


@dataclass(frozen=True, slots=True)
class Identity:
    """An operator or a program with rights."""

    name: str  # by which orders are signed
    common_name: str  # of the certificate
    public_key: bytes | None  # of the signing key, 32 bytes; None for who signs nothing
    # Which aircraft, by right: names, or a beginning and ``*``.
    patterns: Mapping[Right, tuple[str, ...]]

    def may(self, right: Right, aircraft: str) -> bool:
        return any(fits(pattern, aircraft) for pattern in self.allowed(right))

    def allowed(self, right: Right) -> tuple[str, ...]:
        """The aircraft to which it has that right, as the file names them."""
        found = [pattern for one in Right if one >= right for pattern in self.patterns[one]]
        return tuple(dict.fromkeys(found))


def fits(pattern: str, aircraft: str) -> bool:
    """Whether a pattern of the file means an aircraft."""
    if pattern.endswith("*"):
        return aircraft.startswith(pattern[:-1])
    return pattern == aircraft


@dataclass(frozen=True, slots=True)
class Rights:
    site: str  # whose aircraft they are
    aircraft: Mapping[str, str]  # name of each, and the common name of its agent's certificate
    identities: Mapping[str, Identity]

    def without(self, names: Collection[str]) -> Self:
        """The same without identities and aircraft whose name or certificate is among these."""
        return replace(
            self,
            aircraft={one: cn for one, cn in self.aircraft.items() if cn not in names},
            identities={
                name: one
                for name, one in self.identities.items()
                if name not in names and one.common_name not in names
            },
        )

    def identity(self, name: str) -> Identity | None:
        """The identity of that name, or None."""
        return self.identities.get(name)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            BadRights: It cannot be read, or has an error.
        """
        try:
            with Path(path).open("rb") as file:
                data = read_watched(file, Path(path), _LARGEST + 1)
        except OSError as error:
            raise BadRights(
                f"{path} cannot be read: {error.strerror}", remedy="check its name"
            ) from error
        if len(data) > _LARGEST:
            raise BadRights(f"{path} is too large for a file of rights", remedy="1 MiB at most")
        try:
            text = data.decode()
        except UnicodeDecodeError as error:
            raise BadRights(
                f"{path} is not text: {error.reason}", remedy="name the file of rights"
            ) from error
        return cls.parse(text)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read the text of such a file.

        Raises:
            BadRights: It has an error.
        """
        try:
            found = read_toml(text)
        except ValueError as error:
            raise BadRights(
                f"the file of rights is not TOML: {error}", remedy="mend that line"
            ) from error
        _refuse_unknown(found, ("site", "aircraft", "identity"), "the file")
        site = found.get("site", "site")
        _require(NAME, site, "site")
        aircraft = dict(_aircraft(_table(found, "aircraft")))
        people = {name: _identity(name, table) for name, table in _table(found, "identity").items()}
        shared = [*aircraft.values(), *(one.common_name for one in people.values())]
        for name in shared:
            if shared.count(name) > 1:
                raise BadRights(
                    f"two entries have the common name {name}",
                    cause="the router knows clients by their certificates alone",
                    remedy="give each of them a certificate of its own",
                )
        return cls(site, aircraft, people)


def _table(found: Mapping[str, Any], name: str) -> dict[str, dict[str, Any]]:
    tables = found.get(name, {})
    if not isinstance(tables, dict) or not all(isinstance(one, dict) for one in tables.values()):
        raise BadRights(f"{name} is not a table of tables", remedy=f"write [{name}.NAME]")
    return tables


def _aircraft(tables: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    for name, table in tables.items():
        _require(NAME, name, "aircraft")
        _refuse_unknown(table, ("common_name",), f"aircraft {name}")
        common_name = table.get("common_name", name)
        _require(NAME, common_name, f"common_name of {name}")
        yield name, common_name


def _identity(name: str, table: Mapping[str, Any]) -> Identity:
    _require(NAME, name, "identity")
    _refuse_unknown(table, _FIELDS, f"identity {name}")
    common_name = table.get("common_name", name)
    _require(NAME, common_name, f"common_name of {name}")
    key = table.get("public_key")
    if key is not None:
        _require(_KEY, key, f"public_key of {name}", "64 hex digits, as `fleet pki issue` prints")
    patterns = {}
    for right in Right:
        listed = table.get(right.name.lower(), [])
        if not isinstance(listed, list):
            raise BadRights(
                f"{right.name.lower()} of {name} is {listed!r}", remedy='a list such as ["a1"]'
            )
        for pattern in listed:
            _require(_PATTERN, pattern, f"{right.name.lower()} of {name}", 'a name, "b*" or "*"')
        patterns[right] = tuple(listed)
    return Identity(name, common_name, None if key is None else bytes.fromhex(key), patterns)


def _require(
    wanted: re.Pattern[str], value: object, what: str, remedy: str = "letters, digits, - and _"
) -> None:
    if not isinstance(value, str) or wanted.fullmatch(value) is None:
        raise BadRights(f"{what} is {value!r}", remedy=remedy)


def _refuse_unknown(found: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for name in found:
        if name not in known:
            raise BadRights(
                f"{where}: there is no field {name!r}", remedy=f"one of {', '.join(known)}"
            )


# -- names that are shut out before their certificates end: a list that the authority signs --------
# A list is two lines: what it says, as JSON, and the authority's signature over that line with its
# line feed (ECDSA over P-256 with SHA-256, as base64), so that ``openssl`` verifies it, too. It
# holds every name that was ever revoked and a number; one with a smaller number never takes its
# place. Pure logic.


LARGEST = 32 * 1024
"""Bytes of a list at most: some 700 names."""

Since = Callable[[str], str]
"""Since when a name is revoked, in words; empty if it is not."""

_KIND = "revoked 1"
_MOST_NUMBER = 1 << 53
_MOST_DATE = 32


def nobody(name: str) -> str:
    return ""


class BadRevoked(
    UsageError,
    code="M100-BAD-REVOKED",
    cause="another authority made the list, it was changed, or a newer one is in force",
    remedy="`m100link fleet pki push` brings the list of the authority",
):
    """A list of revoked names that an agent does not accept; the earlier one stays in force."""


@dataclass(frozen=True, slots=True)
class Revoked:
    """The content of a list."""

    number: int  # greater than that of every list before, from 1; 0 for none
    names: Mapping[str, str]  # who is revoked, and since which day, in words
    data: bytes = b""  # the bytes as they were signed; empty for no list

    @classmethod
    def verified(cls, data: bytes, authority: x509.Certificate) -> Self:
        """Read and verify a list of this authority.

        Raises:
            BadRevoked: It is not a list of this authority.
        """
        line, _, signature = data[: LARGEST + 1].partition(b"\n")
        if len(data) > LARGEST:
            raise BadRevoked(f"a list of revoked names has at most {LARGEST} bytes")
        try:
            key = authority.public_key()
            if not isinstance(key, ec.EllipticCurvePublicKey):
                raise BadRevoked("the authority has no key that signs lists of revoked names")
            signed = base64.b64decode(signature.strip(), validate=True)
            key.verify(signed, line + b"\n", ec.ECDSA(SHA256()))
        except (InvalidSignature, UnsupportedAlgorithm, ValueError) as error:
            if isinstance(error, BadRevoked):
                raise
            raise BadRevoked(
                "the signature of a list of revoked names is not that of the authority",
                cause="another authority made it, or it was changed on its way",
            ) from error
        return cls(*_read(line), data)


def sign_revoked(number: int, names: Mapping[str, str], key: ec.EllipticCurvePrivateKey) -> bytes:
    content = {"m100link": _KIND, "number": number, "names": dict(names)}
    line = json.dumps(content).encode() + b"\n"
    data = line + base64.b64encode(key.sign(line, ec.ECDSA(SHA256()))) + b"\n"
    if len(data) > LARGEST:
        raise BadRevoked(
            f"{len(names)} names are too many for a list",
            cause="names stay in it for good",
            remedy="make a new authority, and issue all certificates again",
        )
    return data


def _read(line: bytes) -> tuple[int, dict[str, str]]:
    """Number and names of a line that the authority has signed."""
    try:
        found: Any = read_json(line)
        number, names = found["number"], found["names"]
        if found["m100link"] != _KIND:
            raise ValueError(f"it is {found['m100link']!r}")
        if type(number) is not int or not 0 < number < _MOST_NUMBER:
            raise ValueError("its number is none")
        for name, since in names.items():
            if not NAME.fullmatch(name) or type(since) is not str or len(since) > _MOST_DATE:
                raise ValueError(f"{name!r} is no name")
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadRevoked(
            f"this release cannot read a list of revoked names: {error}",
            cause="the authority has a newer release, or signed something else",
            remedy="install the same release on both",
        ) from error
    return number, names


# -- identity --------------------------------------------------------------------------------------

WINDOW_S = 5.0
"""Seconds that an order may be old, or from the future: by so much clocks may differ."""
STOP_WINDOW_S = 600.0
"""The same for what stops: a wrong clock must keep nobody from stopping an aircraft. A recorded
stop that somebody repeats in that time stops it once more, which is a nuisance and not a danger.
A calendar may be wrong by years, as where it has no battery, or be set in flight: the agent's own
clock will do for all that moves nothing, with the run of the agent that shows it."""

_PURGED_AT = 1024


class Reason(Enum):
    """Why an agent refuses an order."""

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
    cause="an unknown key, a wrong clock, or a missing right",
    remedy="look at `reason`; nothing was done",
):
    """An agent refuses a signed order."""

    reason: Reason = Reason.NOT_ALLOWED  #: why
    signer: str = ""  #: who says to have signed it


class Signer:
    """Signs orders.

    ``key``: the secret, 32 bytes.

    Raises:
        UsageError: The key has another length.
    """

    def __init__(self, name: str, key: bytes) -> None:
        if len(key) != 32:
            raise UsageError(f"the signing key has {len(key)} bytes", remedy="32 bytes")
        self.name = name
        self._key = Ed25519PrivateKey.from_private_bytes(key)

    @property
    def public_key(self) -> bytes:
        """For the file of rights, 32 bytes."""
        return self._key.public_key().public_bytes_raw()

    def sign(self, order: OrderMessage) -> bytes:
        """The signature, 64 bytes.

        Raises:
            UsageError: It names another signer.
        """
        if order.signer != self.name:
            raise UsageError(f"{self.name} cannot sign for {order.signer}", remedy="take its key")
        return self._key.sign(order.signed())


class Gate:
    """Accepts each order once that an identity with the right to it gave now, for this aircraft."""

    def __init__(
        self,
        rights: Rights,  # who may do what
        aircraft: str,  # which one this is
        *,
        # When it began to look, POSIX time, s: what was signed before may have been let through by
        # who was there before, and is not, but for what stops. (A clock that is ahead gets around
        # that by so much; what moves the aircraft has to be kept on disk besides.)
        began_at: float,
        revoked: Since = nobody,  # who is shut out
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
        # Orders that were let through, and until when each could be let through again.
        self._seen: dict[tuple[str, str], float] = {}
        self._purged_at = _PURGED_AT

    def check(
        self, order: OrderMessage, now: float, clock: float = math.nan, boot: str = ""
    ) -> None:
        """Accept an order, and remember its id.

        ``now``: POSIX time, s. ``clock``: the agent's own, which nobody sets, s. ``boot``: which
        run of the agent this is.

        Raises:
            OrderRefused: It is not acceptable, for that reason.
        """
        self._require_signature(order)
        who, right = order.signer, order.order.right
        if order.aircraft != self._aircraft:
            raise OrderRefused(
                f"an order of {who} to {order.aircraft} came to {self._aircraft}",
                reason=Reason.WRONG_AIRCRAFT,
                signer=who,
                cause="somebody forwarded an order for another aircraft",
                remedy="send the order to its own aircraft",
            )
        since = self._revoked(who)
        if since:
            raise OrderRefused(
                f"{who} is revoked since {since}",
                reason=Reason.REVOKED,
                signer=who,
                cause="its key was lost, or its owner has no rights any more",
                remedy="issue a certificate and a key under another name, and give that one rights",
            )
        identity = self._rights.identity(who)
        if identity is None or not identity.may(right, self._aircraft):
            raise OrderRefused(
                f"{who} may not {right.name.lower()} {self._aircraft}",
                reason=Reason.NOT_ALLOWED,
                signer=who,
                cause="the file of rights on board does not allow it",
                remedy=f"write [identity.{who}] {right.name.lower()} = [{self._aircraft!r}] there",
            )
        until = self._require_fresh(order, now, clock, boot)
        if (who, order.id) in self._seen:
            raise OrderRefused(
                f"order {order.id} of {who} came a second time",
                reason=Reason.REPLAYED,
                signer=who,
                cause="somebody recorded and repeats it, or a program used an id twice",
                remedy="ask for the outcome of the first one; a new order has a new id",
            )
        self._purge(now)
        self._seen[who, order.id] = until

    def _require_signature(self, order: OrderMessage) -> None:
        key = self._keys.get(order.signer)
        if key is None:
            who = order.signer or "nobody"
            raise OrderRefused(
                f"an order is signed by {who}, whose key {self._aircraft} does not know",
                reason=Reason.UNKNOWN_KEY,
                signer=order.signer,
                cause="the file of rights on board has no public_key of that name",
                remedy="put it there, as `m100link fleet pki issue pilot` printed it",
            )
        try:
            key.verify(order.signature, order.signed())
        except InvalidSignature as error:
            raise OrderRefused(
                f"the signature of {order.signer} does not fit the order",
                reason=Reason.BAD_SIGNATURE,
                signer=order.signer,
                cause="the order was changed on its way, or another key signed it",
                remedy="compare the public_key on board with that of the signer",
            ) from error

    def _require_fresh(self, order: OrderMessage, now: float, clock: float, boot: str) -> float:
        """Until when it could come again, POSIX time."""
        asked, is_stop = order.order, order.order.right is Right.STOP
        its = order.clock or math.nan  # 0 is no time
        # A restart shows the same time again, a router a later one: movements need the calendar.
        moves = isinstance(asked, TakePlace | StartShow) or getattr(asked, "moves", False)
        is_safe = not moves or isinstance(asked, LeaseOrder) or getattr(asked, "ends", False)
        is_this_run = is_safe and bool(boot) and order.boot == boot
        if (is_this_run or isinstance(asked, Stop | Halt)) and abs(clock - its) <= WINDOW_S:
            return max(now, order.at) + STOP_WINDOW_S
        age, window = now - order.at, STOP_WINDOW_S if is_stop else WINDOW_S
        is_before = not is_stop and order.at < self._began_at
        if not abs(age) <= window or is_before:
            seen = f"{age:.1f} s old" if age >= 0 else f"from {-age:.1f} s ahead"
            if not math.isfinite(age):
                seen = "of no time"
            elif abs(age) <= window:
                seen = f"{age:.1f} s old, and older than this agent"
            raise OrderRefused(
                f"the order of {order.signer} is {seen}",
                reason=Reason.EXPIRED,
                signer=order.signer,
                cause=f"clocks differ by more than {window:g} s, or the order was recorded before",
                remedy="let chrony or ntpd set both clocks, and give the order again",
            )
        return order.at + window

    def _purge(self, now: float) -> None:
        """Forget what would be refused as expired by now."""
        if len(self._seen) >= self._purged_at:
            self._seen = {one: until for one, until in self._seen.items() if until >= now}
            self._purged_at = max(_PURGED_AT, 2 * len(self._seen))
