"""Signatures of operators over orders of a fleet, and of aircraft over their words.

An agent verifies orders on board, and an operator verifies replies, cards and events, each without
trusting the router or any token.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import logging
import math
import os
import struct
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import NameOID

from m100link.apps.agent.background import TaskSet
from m100link.apps.bus.network import DEPTH, Bus, Held, Outlet, QueryAnswer, Question, Settles
from m100link.apps.fleet.identity import Gate, Rights, Signer, Since, nobody
from m100link.apps.fleet.keys import name_in
from m100link.apps.fleet.order_log import audit_digest, audit_facts, audit_kept
from m100link.apps.fleet.payloads import VERSION, OrderMessage
from m100link.apps.fleet.revocations import Revocations, read_certificate
from m100link.errors import UsageError
from m100link.errors.usage import unread
from m100link.link.keyfile import read_key, replace_file

if TYPE_CHECKING:
    from m100link.apps.fleet.agent import Verify

_logger = logging.getLogger(__name__)


def credentials(folder: Path, name: str, rights: Rights | None = None) -> dict[str, Any]:
    """The key and certificate of an operator, for :func:`m100link.apps.fleet.connect`.

    Args:
        folder: With certificates and keys: ``rights.pki`` beside a fleet file.
        name: Of the operator's identity.
        rights: The fleet file, by which a missing right is named before anything is sent.

    Raises:
        UsageError: One of the files is missing, or is none.
    """
    authority = Revocations.of_folder(folder, rights)
    sign, options = read_signer(folder, name, authority), tls_options(folder, name)
    return {"sign": sign, "authority": authority, "options": options}


def verifying(
    rights: Rights,
    names: Iterable[str],  # of their aircraft. An agent looks first whether an order names its own
    utc: Callable[[], float],  # POSIX time, s
    revoked: Since = nobody,
) -> Verify:
    """Return a function that verifies orders on board."""
    gates = {name: Gate(rights, name, began_at=utc(), revoked=revoked) for name in names}

    def verify(order: OrderMessage, boot: str) -> None:
        gates[order.aircraft].check(order, utc(), asyncio.get_running_loop().time(), boot)

    return verify


def read_signer(folder: Path, name: str, authority: Revocations | None = None) -> Signer:
    """Read an operator's signing key, as ``fleet make`` made it.

    ``authority``: with a fleet file, by which a missing right is named before anything is sent.

    Raises:
        UsageError: There is none, it is not a key, or others can read it.
    """
    path = folder / f"{name}.signing.key"
    if not path.exists():
        there = ", ".join(
            one.name.partition(".")[0] for one in sorted(folder.glob("*.signing.key"))
        )
        made = "m100link fleet make FILE makes it: name that folder by --pki"
        remedy = f"name one of {there}" if there else made
        raise UsageError(f"{folder} has no signing key of {name}", remedy=remedy)
    rights, since = (None, nobody) if authority is None else (authority.rights, authority.since)
    return Signer(name, read_key(path).reveal(), rights, since)


def tls_options(folder: Path, name: str, *, listens: bool = False) -> dict[str, str]:
    """Options of a session that shows a certificate of ``fleet pki`` and asks for one.

    ``listens``: for a router, which also shows it to clients and other routers.
    """
    _warn_of_end(folder / f"{name}.pem", name)
    tls: dict[str, object] = {"root_ca_certificate": str(folder / "ca.pem"), "enable_mtls": True}
    for side in ("connect", *(("listen",) if listens else ())):
        tls[f"{side}_certificate"] = str(folder / f"{name}.pem")
        tls[f"{side}_private_key"] = str(folder / f"{name}.key")
    return {"transport/link/tls": json.dumps(tls)}


def _warn_of_end(certificate: Path, name: str) -> None:
    """A router that refuses it does not say why, and a program may run for days."""
    try:
        ends = read_certificate(certificate.read_bytes()).not_valid_after_utc
    except (OSError, ValueError):
        return  # zenoh says so
    left = ends - datetime.now(UTC)
    if left < timedelta(days=3):
        _logger.warning(
            "the certificate of %s expire%s on %s: no router behind tls/ lets it in then; renew it "
            "by m100link fleet make FILE",
            name,
            "s" if left > timedelta() else "d",
            f"{ends:%Y-%m-%d}",
        )


# -- words of an aircraft, signed by the key of its certificate ------------------------------------
# Bytes of a sealed payload: a mark, the lengths of the certificate and of the signature, and a
# stamp; then certificate, signature and the payload. An answer is bound to the bytes of its
# question, which nobody asked before. A message that nobody asked for has its stamp, and counts
# when it is newer than an answer of that aircraft.

SEALED = 0x80 | VERSION
"""First byte of a payload that its aircraft has signed."""

_HEAD = struct.Struct(">BHBQ")
_TAG = b"m100link seal 4\n"
_TOLD = ("/state", "/event", "/told", "/place")
"""The last words of the keys under which an aircraft signs what nobody asked for. Not its
telemetry: to sign and verify a hundred packages a second costs more than all the rest."""

_NONCE = 16
_RECENT = 16
"""Messages under a key that may overtake each other."""
_LOOK_S = 1.0
_LOOKED_S = 1.5
_MOST_LOOKS = 64
_WARN_S = 5.0
_BACK_NS = 2_000_000_000
"""Nanoseconds by which messages may be older than an answer that overtook them."""
_MOST = 4096
_STATE = "state"


_Said = tuple[str, bytes, int, bytes]  # key, digest of the question, stamp and payload


class Seal:
    """Signs in the name of one aircraft."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
        self._key = key
        self._certificate = certificate.public_bytes(Encoding.DER)
        self._stamp = 0

    @classmethod
    def read(cls, folder: Path, name: str) -> Seal:
        """The certificate and key of an aircraft, as ``fleet make`` made them.

        Raises UsageError: one of them is missing, or is none.
        """
        try:
            certificate = read_certificate((folder / f"{name}.pem").read_bytes())
            key = load_pem_private_key((folder / f"{name}.key").read_bytes(), None)
        except (OSError, ValueError, TypeError) as error:
            raise UsageError(
                f"{name} has no certificate and key in {folder}: {error}",
                cause="each aircraft signs what it says by the certificate of its own name",
                remedy="make them: m100link fleet make fleet.toml",
            ) from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UsageError(
                f"{folder / name}.key is no key of this program",
                remedy="make them: m100link fleet make fleet.toml",
            )
        return cls(key, certificate)

    def seal(self, key: str, payload: bytes, question: Question | None = None) -> bytes:
        """The payload with its signature; ``question``: what it answers, None for nothing."""
        self._stamp = max(self._stamp + 1, time.time_ns())
        about = b"" if question is None else _about(question)
        signed = _signed(key, about, self._stamp, payload)
        signature = self._key.sign(signed, ec.ECDSA(SHA256()))
        # Other aircraft of a show ask it nothing: they have the certificate with its places.
        is_shown = question is not None or key.endswith("/place")
        certificate = self._certificate if is_shown else b""
        head = _HEAD.pack(SEALED, len(certificate), len(signature), self._stamp)
        return b"".join((head, certificate, signature, payload))

    @property
    def audit(self) -> tuple[bytes, Callable[[bytes], bytes]]:
        """The certificate, and how it signs lines of an audit log."""
        return self._certificate, lambda text: self._key.sign(_AUDIT + text, ec.ECDSA(SHA256()))


_AUDIT = b"m100link audit 1\n"


def audited(
    data: bytes, name: str, authority: x509.Certificate
) -> tuple[list[dict[str, Any]], list[str]]:
    """The lines of an audit log that its aircraft has signed, and what is wrong with the others."""
    found: list[dict[str, Any]] = []
    wrong: list[str] = []
    key, before, expected, first = None, "", 0, 0
    for line in data.splitlines(keepends=True):
        facts, (text, _, signature) = audit_facts(line), line.rstrip(b"\n").rpartition(b"\t")
        number = facts.get("number", expected)
        try:
            if "certificate" in facts:
                key = _issued(name, base64.b64decode(str(facts["certificate"])), authority)
            if not facts or key is None:
                raise ValueError
            key.verify(base64.b64decode(signature, None, True), _AUDIT + text, ec.ECDSA(SHA256()))
        except (InvalidSignature, ValueError):
            wrong.append(f"line {number} was altered: {name} has not signed it")
        else:
            if number > expected > 0:
                wrong.append(f"lines {expected} to {number - 1} are missing")
            elif number < expected:
                wrong.append(f"line {number} stands behind line {expected - 1}, not in its place")
            elif expected and facts.get("before") != before and not wrong:
                wrong.append(f"line {number - 1} stands in the place of another one")
            found.append(facts)
        first = first if expected else number
        before, expected = audit_digest(line), number + 1
    if found and first > (kept := audit_kept(found[-1]["number"])):
        wrong.insert(0, f"lines {kept} to {first - 1} are missing: the beginning was cut off")
    return found, wrong


def _copy(path: Path) -> bytes:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path.read_bytes() if path.exists() else b""


async def merge_audit(
    path: Path,  # the copy here; its folder is made
    name: str,
    fetch: Callable[[int], Awaitable[bytes]],  # the lines on board from a number on
    authority: x509.Certificate,
) -> tuple[list[dict[str, Any]], list[str]]:
    """Bring a copy up to date; its lines, and what is wrong with it or with the log on board.

    Raises UsageError: the copy cannot be read or written. Raises M100Error: as ``fetch``.
    """
    try:
        copy = await asyncio.to_thread(_copy, path)
        last = b"".join(copy.splitlines(keepends=True)[-1:])
        newest = audit_facts(last).get("number", 1)
        came = await fetch(newest)
        is_there = came.startswith(last)
        if is_there:
            copy += came[len(last) :]
            await asyncio.to_thread(replace_file, path, copy)
    except OSError as error:
        raise unread(path, error) from error
    found, wrong = audited(copy, name, authority)
    gone = f"line {newest} of {path} is not on board: altered, removed, or of a virtual run before"
    return found, wrong if is_there else [*wrong, gone]


def _nobody(*_: Any) -> None:
    """A question of which only the bytes count is answered to nobody."""


def _about(question: Question) -> bytes:
    asked = question.key.encode() + b"\n" + question.attachment + question.payload
    return hashlib.sha256(asked).digest()


def _signed(key: str, about: bytes, stamp: int, payload: bytes) -> bytes:
    return b"".join((_TAG, about, b"\n", key.encode(), b"\n", stamp.to_bytes(8, "big"), payload))


def _parts(payload: bytes) -> tuple[int, bytes, bytes, bytes]:
    """Stamp, certificate, signature and payload; the last alone where it is not sealed."""
    if payload[:1] != bytes([SEALED]) or len(payload) < _HEAD.size:
        return 0, b"", b"", payload
    _, certificate, signature, stamp = _HEAD.unpack_from(payload)
    middle = _HEAD.size + certificate
    end = middle + signature
    return stamp, payload[_HEAD.size : middle], payload[middle:end], payload[end:]


class _Sealing(Outlet):
    def __init__(self, outlet: Outlet, seal: Callable[[bytes], bytes]) -> None:
        self._outlet, self._seal = outlet, seal

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        self._outlet.put(self._seal(payload), attachment)

    def put_later(self, make: Callable[..., bytes], *what: Any) -> None:
        self._outlet.put_later(lambda: self._seal(make(*what)))

    def is_wanted(self) -> bool:
        return self._outlet.is_wanted()

    def close(self) -> None:
        self._outlet.close()


class SealedBus:
    """A session of a fleet that signs for its own aircraft, and verifies the words of others.

    Without an authority nothing is verified, and the token of an aircraft is believed.
    """

    def __init__(
        self,
        bus: Bus,
        seals: Mapping[str, Seal] | None = None,  # of its own aircraft, by name
        authority: Revocations | None = None,  # whose certificates are believed
    ) -> None:
        self._bus, self._seals, self._authority = bus, seals or {}, authority
        self.declare, self.watch, self.tokens = bus.declare, bus.watch, bus.tokens
        self.session = bus.session
        self._clock = asyncio.get_running_loop().time
        self._background = TaskSet()
        self._looking: set[asyncio.Task[Any]] = set()
        self.forged: Counter[str] = Counter()  # what others said in the name of an aircraft
        self._warned_at: dict[str, float] = {}
        self._known: dict[tuple[str, bytes], ec.EllipticCurvePublicKey | None] = {}
        # By aircraft: certificate, stamp of an answer, newest stamp, when it was asked for them.
        self._certificates: dict[str, bytes] = {}
        self._since: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        self._looked_at: dict[str, float] = {}
        self._recent: dict[str, deque[int]] = {}  # stamps by key

    def close(self) -> None:
        """Ask nobody any more who speaks."""
        self._background.cancel()

    def publish(self, key: str, *, within: float = 0.0) -> Outlet:
        outlet, seal = self._bus.publish(key, within=within), self._seals.get(name_in(key))
        if seal is None or not key.endswith(_TOLD):
            return outlet
        return _Sealing(outlet, lambda payload: seal.seal(key, payload))

    def serve(
        self,
        key: str,
        take: Callable[[Question], None],
        *,
        depth: int = DEPTH,
        is_first: Callable[[Question], bool] = lambda _: False,
    ) -> Held:
        seal = self._seals.get(name_in(key))

        def taken(question: Question, seal: Seal) -> None:
            def answer(key: str, payload: bytes, *more: Any) -> None:
                question.answer(key, seal.seal(key, payload, question), *more)

            take(replace(question, answer=answer))

        wrapped = take if seal is None else lambda question: taken(question, seal)
        return self._bus.serve(key, wrapped, depth=depth, is_first=is_first)

    def subscribe(
        self,
        pattern: str,
        take: Callable[[str, bytes], None],
        *,
        depth: int = DEPTH,
        within: float = 0.0,
    ) -> Held:
        def heard(key: str, payload: bytes) -> None:
            found = self._heard(key, payload)
            if found is not None:
                take(key, found)

        wrapped = heard if pattern.endswith(_TOLD) else take
        return self._bus.subscribe(pattern, wrapped, depth=depth, within=within)

    async def ask(
        self,
        key: str,
        payload: bytes = b"",
        *,
        timeout: float,
        attachment: bytes = b"",
        settles: Settles | None = None,
    ) -> list[QueryAnswer]:
        """As of any session; only answers that are proved, where that is verified."""
        if self._authority is None:
            found = await self._bus.ask(key, payload, timeout=timeout)
            return [replace(one, payload=_parts(one.payload)[-1]) for one in found]
        nonce = attachment or os.urandom(
            _NONCE
        )  # else an earlier answer to the same question would fit it
        about, is_one = _about(Question(key, payload, _nobody, _nobody, nonce)), "*" not in key
        proved: list[QueryAnswer] = []
        stamps: dict[str, int] = {}

        def hear(answer: QueryAnswer) -> bool:
            opened = self._opened(answer.key, answer.payload, about)
            if opened is None:
                return False
            name, stamp, inner = opened
            proved.append(replace(answer, payload=inner, is_proved=True))
            # Of two agents of one name the one whose calendar is behind is heard as well.
            stamps[name] = min(stamp, stamps.get(name, stamp))
            return is_one or bool(settles and settles(proved[-1]))

        await self._bus.ask(key, payload, timeout=timeout, attachment=nonce, settles=hear)
        for name, stamp in stamps.items():
            self._learn(name, stamp)
        return proved

    # -- whose words they are --------------------------------------------------------------------

    def _opened(self, key: str, payload: bytes, about: bytes) -> tuple[str, int, bytes] | None:
        """Whose it is, its stamp and payload; None for what its aircraft did not sign."""
        name, whose = name_in(key), _whose(key)
        stamp, certificate, signature, inner = _parts(payload)
        certificate = certificate or self._certificates.get(whose, b"")
        if signature and not certificate:
            self._look(whose)
        elif name and (why := self._flaw(name, certificate, signature, (key, about, stamp, inner))):
            self._warn(name, why)
        elif name:
            self._certificates[whose] = certificate
            return whose, stamp, inner
        return None

    def _flaw(self, name: str, certificate: bytes, signature: bytes, said: _Said) -> str:
        """Why it was not said by the aircraft of that name; empty when it was."""
        authority = self._authority
        assert authority is not None
        if not signature:
            return "it is not signed"
        if since := authority.revoked.names.get(name):
            return f"{name} is revoked since {since}"
        if (name, certificate) not in self._known:
            if len(self._known) >= _MOST:  # somebody makes them up
                self._known.clear()
            self._known[name, certificate] = _issued(name, certificate, authority.authority)
        public = self._known[name, certificate]
        if public is None:
            return "its certificate is not that of this aircraft"
        try:
            public.verify(signature, _signed(*said), ec.ECDSA(SHA256()))
        except InvalidSignature:
            return "its signature is wrong, or of another message"
        return ""

    def _warn(self, name: str, why: str) -> None:
        self.forged[name] += 1
        now = self._clock()
        if now - self._warned_at.get(name, -math.inf) < _WARN_S:
            return
        if len(self._warned_at) >= _MOST:  # names that somebody makes up
            self._warned_at.clear()
            self.forged.clear()
        self._warned_at[name] = now
        _logger.warning(
            "somebody else speaks in the name of %s, and is not believed: %s "
            "(or its agent has no fleet file)",
            name,
            why,
        )

    def _heard(self, key: str, payload: bytes) -> bytes | None:
        """The words of an aircraft that nobody asked for; None if not its own, or not new."""
        if self._authority is None:
            return _parts(payload)[-1]
        found = self._opened(key, payload, b"")
        if found is None:
            return None
        whose, stamp, inner = found
        if key.endswith("/place"):
            return inner  # it names the run of its show, and its time in that
        recent = self._recent.setdefault(key, deque(maxlen=_RECENT))
        since = self._since.get(whose, stamp)
        if len(recent) == _RECENT:
            since = max(since, min(recent))
        if stamp <= since:
            self._look(whose)
        if stamp <= since or stamp in recent:
            return None
        recent.append(stamp)
        self._newest[whose] = max(stamp, self._newest[whose])
        return inner

    def _learn(self, whose: str, stamp: int) -> None:
        """An aircraft answered a question, so that is its time now."""
        newest = self._newest.get(whose)
        if newest is None or stamp < newest - _BACK_NS:  # its calendar was set back
            self._since[whose] = self._newest[whose] = stamp
            for key in [key for key in self._recent if _whose(key) == whose]:
                del self._recent[key]

    def _look(self, whose: str) -> None:
        """Ask an aircraft of which nothing new is known, or whose calendar was set back."""
        now, before = self._clock(), self._looked_at.pop(whose, -math.inf)
        if now - before < _LOOK_S:
            self._looked_at[whose] = before
        elif len(self._looking) < _MOST_LOOKS:
            self._looked_at = {one: at for one, at in self._looked_at.items() if now - at < _LOOK_S}
            self._looked_at[whose] = now
            asking = self.ask(f"{whose}/{_STATE}", timeout=_LOOKED_S)
            task = self._background.spawn(asking, f"question who {whose} is")
            self._looking.add(task)
            task.add_done_callback(self._looking.discard)


def _whose(key: str) -> str:
    return "/".join(key.split("/")[:3])


def _issued(
    name: str, certificate: bytes, authority: x509.Certificate
) -> ec.EllipticCurvePublicKey | None:
    """The public key of the certificate that an authority issued for a name; None for no such."""
    try:
        found = x509.load_der_x509_certificate(certificate)
        found.verify_directly_issued_by(authority)
        key = found.public_key()
        names = [one.value for one in found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    except (InvalidSignature, UnsupportedAlgorithm, x509.InvalidVersion, ValueError, TypeError):
        return None
    is_one = names == [name] and isinstance(key, ec.EllipticCurvePublicKey)
    return key if is_one and isinstance(key, ec.EllipticCurvePublicKey) else None
