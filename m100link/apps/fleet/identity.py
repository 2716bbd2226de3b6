"""Signed orders: who gave one, that it was not changed, and that it is not an old one.

The router's rules are the fence, and the signature is the lock: an agent verifies it by itself,
whatever stands between it and the operator. Pure logic; the time is an argument.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import math
import re
import stat
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from m100link.apps.agent.orders import Halt, LeaseOrder, Right, Stop
from m100link.apps.fleet.keys import NAME
from m100link.apps.fleet.payloads import OrderMessage, StartShow, TakePlace
from m100link.errors import NotAllowed, UsageError
from m100link.errors.texts import read_toml
from m100link.link.keyfile import mode_of
from m100link.protocol.firmware import PROFILES

# -- one file for a fleet: its routers, its aircraft, and the rights of its operators --------------
# ::
#     site = "site"
#     [router.base]
#     hosts = ["10.0.0.1"]           # names and addresses by which the others reach it
#     [defaults]                     # for every aircraft that does not say otherwise
#     lost = "land"
#     [aircraft.a1]
#     url = "/dev/ttyUSB0"
#     [identity.anna]
#     fly = ["a1", "b*"]             # who may fly may stop, land and watch, too
#     stop = ["*"]                   # stop, hover and land; who may stop may watch


PKI = "pki"
"""Folder beside the file: the certificates, the keys, and the public keys of signing keys."""

PUBLIC = ".pub"
"""Ending of the file with the public key of an operator's signing key, 64 hex digits."""

_PATTERN = re.compile(rf"{NAME.pattern}\*?|\*")
_KEY = re.compile(r"[0-9a-fA-F]{64}")
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")
_LARGEST = 1024 * 1024
_FIELDS = ("public_key", "watch", "stop", "fly")
_TABLES = ("router", "defaults", "aircraft", "identity", "console")
_CONSOLE = (
    *("identity", "host", "console_port", "allow_host", "allow_origin"),
    *("token_file", "tls_cert", "tls_key", "tiles", "video"),
)
_WANTED = {
    "url": "text, such as /dev/ttyUSB0",
    "firmware": f"one of {', '.join(PROFILES)}, as text",
    "baud_rate": "bits per second, such as 230400",
    "max_height": "metres, above 0",
    "max_radius": "metres, above 0",
    "lost": '"hover", "land" or "home"',
    "lost_after": "seconds, 0 to 3600",
}
"""Settings of an aircraft, and the value of each."""


class BadRights(
    UsageError,
    code="M100-BAD-RIGHTS",
    cause="an unknown field or a wrong value in the fleet file, or another kind of file",
    remedy="`m100link fleet acl check FILE` says what each identity may do",
):
    """A fleet file with an error."""

    line: int = 0  #: where it is, counted from 1; 0 where no line is wrong


@dataclass(frozen=True, slots=True)
class Identity:
    """An operator or a program with rights."""

    name: str  # by which orders are signed; the common name of its certificate
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
class Router:
    """A router of the fleet, behind certificates."""

    name: str  # also of its certificate
    hosts: tuple[str, ...]  # by which the others reach it
    port: int = 7447

    def at(self, host: str) -> str:
        return f"tls/{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def endpoint(self) -> str:
        """Where the others look for it."""
        return self.at(self.hosts[0])

    @property
    def listen(self) -> str:
        """Where it listens: on loopback, where nobody else is to reach it."""
        is_near = all(host in ("127.0.0.1", "localhost", "::1") for host in self.hosts)
        is_6 = ":" in self.hosts[0]
        return self.endpoint if is_near else self.at("::" if is_6 else "0.0.0.0")


@dataclass(frozen=True, slots=True)
class Rights:
    """A fleet file: routers, aircraft, their settings, and the rights of operators."""

    site: str  # whose aircraft they are
    aircraft: tuple[str, ...]  # names, which are the common names of their certificates
    identities: Mapping[str, Identity]
    routers: Mapping[str, Router] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of each aircraft
    console: Mapping[str, Any] = field(default_factory=dict)  # empty for a fleet without one
    path: Path = field(default=Path(), compare=False)  # where the file is

    @property
    def pki(self) -> Path:
        """The folder with the certificates."""
        return self.path.parent / PKI

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Where agents and operators look for the routers, in turn."""
        return tuple(router.endpoint for router in self.routers.values())

    @property
    def digest(self) -> str:
        """The rights and keys in 16 hex digits: others have another one."""
        people = [
            [name, (one.public_key or b"").hex()] + [sorted(one.patterns[right]) for right in Right]
            for name, one in sorted(self.identities.items())
        ]
        said = json.dumps([self.site, sorted(self.aircraft), people])
        return hashlib.sha256(said.encode()).hexdigest()[:16]

    def without(self, names: Collection[str]) -> Self:
        """The same without those whose name is among these."""
        return replace(
            self,
            routers={name: one for name, one in self.routers.items() if name not in names},
            aircraft=tuple(name for name in self.aircraft if name not in names),
            identities={name: one for name, one in self.identities.items() if name not in names},
        )

    def refusal(
        self,
        who: str,
        right: Right,
        aircraft: str,
        since: str,  # since when that name is revoked; empty: it is not
        *,
        is_on_board: bool,  # else an operator's program asks, before it sends
    ) -> OrderRefused | None:
        """Why somebody may not do something with an aircraft; None: it is allowed."""
        sent = "" if is_on_board else "; nothing was sent"
        if since:
            return OrderRefused(
                f"{who} is revoked since {since}{sent}",
                reason=Reason.REVOKED,
                signer=who,
                cause="its key was lost, or its owner has no rights any more",
                remedy="issue a certificate and a key under another name, and give that one rights",
            )
        one, word = self.identities.get(who), right.name.lower()
        if one is not None and one.may(right, aircraft):
            return None
        remedy = f"write [identity.{who}] {word} = [{aircraft!r}] there"
        if not is_on_board:
            may = [name for name, one in self.identities.items() if one.may(right, aircraft)]
            remedy += ", and bring the file to routers and boards"
            remedy += f"; or ask {', '.join(may)}, who may" if may else ""
        return OrderRefused(
            f"{who} may not {word} {aircraft}{sent}",
            reason=Reason.NOT_ALLOWED,
            signer=who,
            cause=f"{'the fleet file on board' if is_on_board else self.path} does not allow it",
            remedy=remedy,
        )

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            BadRights: It cannot be read, or has an error.
        """
        try:
            with Path(path).open("rb") as file:
                mode = mode_of(file)
                data = file.read(_LARGEST + 1)
        except OSError as error:
            raise BadRights(
                f"{path} cannot be read: {error.strerror}", remedy="check its name"
            ) from error
        if mode & stat.S_IWOTH:
            raise BadRights(
                f"{path} can be written by everybody (mode {mode:o})",
                cause="every user of this computer could give rights to anybody",
                remedy=f"chmod o-w {path}",
            )
        if len(data) > _LARGEST:
            raise BadRights(f"{path} is too large for a fleet file", remedy="1 MiB at most")
        try:
            text = data.decode()
        except UnicodeDecodeError as error:
            raise BadRights(
                f"{path} is not text: {error.reason}", remedy="name the fleet file"
            ) from error
        found = cls.parse(text)
        known = {name: _keyed(one, Path(path)) for name, one in found.identities.items()}
        return replace(found, identities=known, path=Path(path))

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read the text of such a file.

        Raises:
            BadRights: It has an error.
        """
        try:
            found = read_toml(text)
        except ValueError as error:
            at = re.search(r"at line (\d+)", str(error))  # else at the end of the document
            raise BadRights(
                f"the fleet file is not TOML: {error}",
                remedy="mend that line",
                line=int(at[1]) if at else len(text.splitlines()),
            ) from error
        try:
            return cls._of(found)
        except _Wrong as wrong:
            line = _line(text, wrong.where)
            seen = f"line {line}: {wrong.seen}" if line else wrong.seen
            raise BadRights(seen, cause=wrong.cause, remedy=wrong.remedy, line=line) from None

    @classmethod
    def _of(cls, found: Mapping[str, Any]) -> Self:
        _refuse_unknown(found, ("site", *_TABLES))
        site = found.get("site", "site")
        _require(NAME, site, "site", "site")
        routers = {name: _router(name, one) for name, one in _tables(found, "router").items()}
        defaults = _settings(_table(found, "defaults"), "defaults")
        settings = {
            name: {**defaults, **_settings(table, "aircraft", name)}
            for name, table in _tables(found, "aircraft").items()
        }
        people = {name: _identity(name, one) for name, one in _tables(found, "identity").items()}
        known = {"ca"}
        named = [("router", [*routers]), ("aircraft", [*settings]), ("identity", [*people])]
        for kind, name in [(kind, name) for kind, names in named for name in names]:
            if name == "console" and kind != "identity":
                seen = f"{'an aircraft' if kind == 'aircraft' else 'a router'} is named console"
                raise _Wrong(seen, kind, name, remedy="so `fleet up` names the console")
            if name.lower() in known:
                raise _Wrong(
                    f"two entries are named {name}",
                    *(kind, name),
                    cause="the router knows clients by their certificates alone, and some disks "
                    "take A1 for a1; ca is the authority's",
                    remedy="give each of them a name of its own",
                )
            known.add(name.lower())
        console = _table(found, "console")
        _refuse_unknown(console, _CONSOLE, "console")
        if console and console.get("identity") not in list(people):
            raise _Wrong(
                f"identity of the console is {console.get('identity')!r}",
                *("console", "identity"),
                remedy=f"one of {', '.join(people) or 'none: write [identity.NAME]'}",
            )
        return cls(site, tuple(settings), people, routers, settings, console)


class _Wrong(Exception):
    """A value that cannot be, and the names of the tables and the key that lead to it."""

    def __init__(self, seen: str, *where: str, remedy: str, cause: str = "") -> None:
        super().__init__(seen)
        self.seen, self.where, self.remedy, self.cause = seen, where, remedy, cause


def _line(text: str, where: tuple[str, ...]) -> int:
    """The line of a key, or of the nearest table around it; 0 where neither is found."""
    table: tuple[str, ...] = ()
    found = 0
    for number, line in enumerate(text.splitlines(), 1):
        is_head = line.lstrip().startswith("[")
        own = _names(line if is_head else f"{line.partition('=')[0]} = 0")
        table, names = (own, own) if is_head else (table, table + own)
        if own and names == where:
            return number
        if own and names == where[: len(names)]:
            found = number
    return found


def _names(line: str) -> tuple[str, ...]:
    """The names in the head of a table, or before the sign of equality; none in other lines."""
    try:
        found: Any = read_toml(line)
    except ValueError:
        return ()
    names = []
    while isinstance(found, dict) and found:
        [(name, found)] = found.items()
        names.append(name)
    return tuple(names)


def _keyed(one: Identity, path: Path) -> Identity:
    """With the public key that lies in a file of its own, where the fleet file has none."""
    place = path.parent / PKI / f"{one.name}{PUBLIC}"
    try:
        with place.open(encoding="ascii", errors="replace") as file:
            text = file.read(80).strip()
    except FileNotFoundError:
        return one
    except OSError as error:
        raise BadRights(f"{place} cannot be read: {error.strerror}", remedy="check it") from error
    if one.public_key is not None:
        return one
    if _KEY.fullmatch(text) is None:
        raise BadRights(
            f"{place} has no public key", remedy="copy it, or `m100link fleet make FILE` writes it"
        )
    return replace(one, public_key=bytes.fromhex(text))


def _table(found: Mapping[str, Any], name: str) -> dict[str, Any]:
    table = found.get(name, {})
    if not isinstance(table, dict):
        raise _Wrong(f"{name} is not a table", name, remedy=f"write [{name}]")
    return table


def _tables(found: Mapping[str, Any], name: str) -> dict[str, dict[str, Any]]:
    tables = found.get(name, {})
    if not isinstance(tables, dict) or not all(isinstance(one, dict) for one in tables.values()):
        raise _Wrong(f"{name} is not a table of tables", name, remedy=f"write [{name}.NAME]")
    for one in tables:
        _require(NAME, one, name, name, one)
    return tables


def _router(name: str, table: Mapping[str, Any]) -> Router:
    here = ("router", name)
    _refuse_unknown(table, ("hosts", "port"), *here)
    hosts, port = table.get("hosts"), table.get("port", 7447)
    if not isinstance(hosts, list) or not hosts or not all(map(_is_host, hosts)):
        raise _Wrong(
            f"hosts of {name} is {hosts!r}",
            *(*here, "hosts"),
            remedy='a list of names and addresses, without a port: ["base.local", "10.0.0.1"]',
        )
    if type(port) is not int or not 0 < port < 1 << 16:
        raise _Wrong(f"port of {name} is {port!r}", *here, "port", remedy="1 to 65535")
    return Router(name, tuple(hosts), port)


def _is_host(host: object) -> bool:
    try:
        return bool(ipaddress.ip_address(host if isinstance(host, str) else ""))
    except ValueError:
        return isinstance(host, str) and _HOST.fullmatch(host) is not None


def _settings(table: Mapping[str, Any], *here: str) -> dict[str, Any]:
    """The settings of an aircraft, or of all of them."""
    whose = here[-1]
    known = [name for name in _WANTED if here != ("defaults",) or name != "url"]
    _refuse_unknown(table, known, *here)
    for name, value in table.items():
        number = value if type(value) in (int, float) else math.nan
        is_right = {
            "url": isinstance(value, str) and value.isprintable() and value != "",
            "firmware": value in tuple(PROFILES),
            "baud_rate": type(value) is int and value > 0,
            "lost": value in ("hover", "land", "home"),
            "lost_after": 0 <= number <= 3600,
        }.get(name, 0 < number < math.inf)
        if not is_right:
            raise _Wrong(f"{name} of {whose} is {value!r}", *here, name, remedy=_WANTED[name])
    return dict(table)


def _identity(name: str, table: Mapping[str, Any]) -> Identity:
    here = ("identity", name)
    _refuse_unknown(table, _FIELDS, *here)
    key = table.get("public_key")
    if key is not None:
        wanted = "64 hex digits, as in pki/NAME.pub"
        _require(_KEY, key, f"public_key of {name}", *here, "public_key", remedy=wanted)
    patterns = {}
    for right in Right:
        word = right.name.lower()
        listed = table.get(word, [])
        if not isinstance(listed, list):
            raise _Wrong(
                f"{word} of {name} is {listed!r}", *here, word, remedy='a list such as ["a1"]'
            )
        for pattern in listed:
            wanted = 'a name, "b*" or "*"'
            _require(_PATTERN, pattern, f"{word} of {name}", *here, word, remedy=wanted)
        patterns[right] = tuple(listed)
    return Identity(name, None if key is None else bytes.fromhex(key), patterns)


def _require(
    wanted: re.Pattern[str],
    value: object,
    what: str,
    *where: str,
    remedy: str = "1 to 32 letters, digits, - and _",
) -> None:
    if not isinstance(value, str) or wanted.fullmatch(value) is None:
        raise _Wrong(f"{what} is {value!r}", *where, remedy=remedy)


def _refuse_unknown(found: Mapping[str, Any], known: Collection[str], *where: str) -> None:
    for name in found:
        if name not in known:
            raise _Wrong(
                f"{' '.join(where) or 'the file'}: there is no field {name!r}",
                *(*where, name),
                remedy=f"one of {', '.join(known)}",
            )


Since = Callable[[str], str]
"""Since when a name is revoked, in words; empty if it is not."""


def nobody(name: str) -> str:
    return ""


# -- identity --------------------------------------------------------------------------------------

WINDOW_S = 5.0
"""Seconds that an order may be old, or from the future: by so much clocks may differ."""
STOP_WINDOW_S = 600.0
"""The same for what stops: a wrong clock must keep nobody from stopping an aircraft. A recorded
stop that somebody repeats in that time stops it once more, which is a nuisance and not a danger.
A calendar may be wrong by years, as where it has no battery, or be set in flight: the agent's own
clock will do for all that moves nothing, with the run of the agent that shows it."""

_PURGED_AT = 1024


class Reason(StrEnum):
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
    """Signs orders in one name: :func:`m100link.apps.fleet.connect` takes it.

    Raises:
        UsageError: The key has another length.
    """

    def __init__(
        self,
        name: str,  # of its identity
        key: bytes,  # the secret, 32 bytes
        rights: Rights | None = None,  # the fleet file here; None: agents alone decide
        revoked: Since = nobody,  # who is shut out
    ) -> None:
        if len(key) != 32:
            raise UsageError(f"the signing key has {len(key)} bytes", remedy="32 bytes")
        self.name, self._rights, self._revoked = name, rights, revoked
        self._key = Ed25519PrivateKey.from_private_bytes(key)

    @property
    def public_key(self) -> bytes:
        """For the fleet file, 32 bytes."""
        return self._key.public_key().public_bytes_raw()

    def sign(self, order: OrderMessage) -> bytes:
        """The signature, 64 bytes.

        Raises:
            UsageError: It names another signer.
        """
        if order.signer != self.name:
            raise UsageError(f"{self.name} cannot sign for {order.signer}", remedy="take its key")
        return self._key.sign(order.signed())

    def __call__(self, order: OrderMessage, token: str) -> OrderMessage:
        """The order with its signature, and the proof of a lease with that secret."""
        named = replace(order, signer=self.name).under(token)
        return named.sealed(signature=self.sign(named))

    def refusal(self, right: Right, aircraft: str) -> OrderRefused | None:
        """The error for a right that the fleet file here does not give; None: nothing says so."""
        if self._rights is None:
            return None
        since = self._revoked(self.name)
        return self._rights.refusal(self.name, right, aircraft, since, is_on_board=False)


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
        refused = self._rights.refusal(who, right, self._aircraft, since, is_on_board=True)
        if refused is not None:
            raise refused
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
                cause="the fleet file on board has no public_key of that name",
                remedy="copy pki/NAME.pub there, which `m100link fleet make FILE` wrote",
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
