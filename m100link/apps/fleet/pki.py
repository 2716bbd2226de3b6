"""Certificates of a fleet: an authority of its own, and certificates for 30 days.

:func:`make` makes all that a fleet file needs. Keys are ECDSA over P-256. Only the owner can read
the files; existing files are never overwritten without ``force``. The caller gives the time.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import secrets
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import Enum
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from m100link.apps.agent.orders import Right
from m100link.apps.fleet.identity import PUBLIC, Identity, Rights, Signer
from m100link.apps.fleet.keys import LIVE, NAME
from m100link.apps.fleet.revocations import (
    AUTHORITY,
    LIST,
    Revocations,
    Revoked,
    read_certificate,
    sign_revoked,
)
from m100link.errors import UsageError
from m100link.link.keyfile import locks, read_token, replace_file

ISSUED_DAYS = 30
RENEWED_DAYS = 10
"""A certificate that ends within so many days is made anew."""
AUTHORITY_DAYS = 730
_EARLY = timedelta(minutes=5)
"""Valid so long before it is made: clocks differ."""
_CA = "ca"


_COPY = "copy both files anew from your backup"


class BadAuthority(
    UsageError,
    code="M100-BAD-AUTHORITY",
    cause="the folder is the wrong one, or its files exist already",
    remedy="`m100link fleet make FILE` makes an authority and its certificates",
):
    """Certificates that cannot be made, or must not be overwritten."""


def _not_made(path: Path, error: OSError) -> BadAuthority:
    is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    remedy = "make room on that disk" if is_full else "name a folder that your account may write"
    return BadAuthority(f"{path} cannot be made: {error.strerror}", remedy=remedy)


class Kind(Enum):
    """The purpose of a certificate; ``pilot`` is for a remote operator."""

    ROUTER = "router"
    AGENT = "agent"
    PILOT = "pilot"


@dataclass(frozen=True, slots=True)
class Issued:
    """The files that were made."""

    certificate: Path
    key: Path  # PEM file with its key; mode 0600
    ends: datetime  # when it expires
    signing_key: Path | None = None  # file with an operator's key that signs orders; mode 0600
    public_key: str = ""  # its public key, for the fleet file, 64 hex digits


def init(folder: Path, *, now: datetime, force: bool = False) -> Issued:
    """Make an authority, in a folder that its owner alone can read.

    ``force`` overwrites an existing one: all certificates that it issued become worthless. Revoked
    names stay revoked.

    Raises:
        BadAuthority: One exists, or the folder cannot be written.
        BadRevoked: The list of revoked names there is not the authority's.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "m100link fleet")])
    ends = now + timedelta(days=AUTHORITY_DAYS)
    usage = _usage(digital_signature=False, key_cert_sign=True)
    certificate = (
        _builder(name, name, key, now, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, SHA256())
    )
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise _not_made(folder, error) from error
    made = Issued(folder / AUTHORITY, folder / f"{_CA}.key", ends)
    files = {made.key: _pem_of(key), made.certificate: _pem(certificate)}
    if force and (folder / LIST).exists():  # keys that sign outlive certificates
        before = Revocations.of_folder(folder).revoked
        files[folder / LIST] = sign_revoked(before.number + 1, before.names, key)
    _write(files, force=force)
    return made


def issue(
    folder: Path,
    kind: Kind,
    name: str,  # common name: of an aircraft, an operator, a router
    *,
    now: datetime,
    hosts: Sequence[str] = (),  # of a router: names and addresses by which others reach it
    force: bool = False,  # overwrite existing files; an operator's signing key stays
) -> Issued:
    """Make a certificate, its key, and for an operator a key that signs orders.

    Raises:
        BadAuthority: There is no authority, it has expired, a file exists, or the name or the hosts
            are not possible.
    """
    if not NAME.fullmatch(name) or name == _CA:
        raise BadAuthority(
            f"{name!r} is no name for a certificate",
            remedy=f"1 to 32 letters, digits, - and _; not {_CA!r}",
        )
    if (kind is Kind.ROUTER) != bool(hosts):
        raise BadAuthority(
            f"a certificate for {'a router' if kind is Kind.ROUTER else f'the {kind.value} {name}'}"
            f" with {len(hosts)} hosts",
            remedy="a router, and it alone, needs hosts: in [router.NAME] of the fleet file",
        )
    authority, its_key = _authority(folder, now)
    since = _revoked(folder, authority).names.get(name)
    if since is not None:
        raise BadAuthority(
            f"{name} is revoked since {since}",
            cause="a revoked name stays revoked: nobody could tell the new key from the lost one",
            remedy="give its owner another name, here and in the fleet file",
        )
    key = ec.generate_private_key(ec.SECP256R1())
    ends = min(now + timedelta(days=ISSUED_DAYS), authority.not_valid_after_utc)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if kind is Kind.ROUTER:  # one router is another one's client
        purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
    builder = (
        _builder(subject, authority.subject, key, now, ends)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(digital_signature=True, key_cert_sign=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(its_key.public_key()), critical=False
        )
    )
    names = [_host(host) for host in hosts] or [x509.DNSName(name)]
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    certificate = builder.sign(its_key, SHA256())
    place, its_place = folder / f"{name}.pem", folder / f"{name}.key"
    files = {its_place: _pem_of(key), place: _pem(certificate)}
    if kind is not Kind.PILOT:
        _write(files, force=force)
        return Issued(place, its_place, ends)
    signing = folder / f"{name}.signing.key"
    # It stands in the files of rights on board: a new certificate must not change it.
    secret = _kept(signing) if force and signing.exists() else None
    if secret is None:
        secret = secrets.token_bytes(32)
        files[signing] = secret.hex().encode() + b"\n"
    public = Signer(name, secret).public_key.hex()
    _write(files | {folder / f"{name}{PUBLIC}": f"{public}\n".encode()}, force=force)
    return Issued(place, its_place, ends, signing, public)


# -- everything that a fleet file needs ------------------------------------------------------------


BOARDS = "boards"
"""Folder beside the file, with a folder for each machine: the file, its certificate, its unit."""

_UNIT = """\
# Copy this folder to {place}, then: systemctl enable --now {place}/{unit}
[Unit]
Description=m100link fleet: {name}
Wants=network-online.target time-sync.target
After=network-online.target time-sync.target
StartLimitIntervalSec=120
StartLimitBurst=5

[Service]
User=m100
SupplementaryGroups=dialout
Environment=PYTHONUNBUFFERED=1 XDG_STATE_HOME=/var/lib/m100/state
StateDirectory=m100
ExecStart=/opt/m100/bin/m100link fleet up {place}/{file} {name} --real
Restart=on-failure
RestartSec=3
# SIGTERM lets an aircraft hover and gives control back; a landing may take a minute and a half.
TimeoutStopSec=120
Nice=-5
NoNewPrivileges=yes
CapabilityBoundingSet=
SystemCallFilter=@system-service
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
RestrictNamespaces=yes
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes

[Install]
WantedBy=multi-user.target
"""


def make(rights: Rights, *, now: datetime, renews: bool = False) -> dict[str, datetime]:
    """Make an authority, certificates, keys, and a folder for each machine, beside a fleet file.

    Good files stay; a certificate that ends soon is made anew.

    ``renews``: all certificates, not only those that end within ten days.

    Returns when each certificate ends that was made, by its name.

    Raises:
        BadAuthority: Something cannot be made, is revoked, or another program makes it.
    """
    wanted: dict[str, tuple[Kind, tuple[str, ...]]] = {
        **{name: (Kind.ROUTER, one.hosts) for name, one in rights.routers.items()},
        **dict.fromkeys(rights.aircraft, (Kind.AGENT, ())),
        **dict.fromkeys(rights.identities, (Kind.PILOT, ())),
    }
    folder, made = rights.pki, {}
    with _alone(folder):
        if not list(folder.glob("*.pem")):  # a key alone is left of one that was killed
            init(folder, now=now, force=True)
        for name, (kind, hosts) in wanted.items():
            if renews or not _is_good(folder, name, kind, hosts, now):
                made[name] = issue(folder, kind, name, now=now, hosts=hosts, force=True).ends
        for name, (kind, _) in wanted.items():
            _hand_out(rights, name, kind)
    return made


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Two at once would make two authorities."""
    if sys.platform == "win32":
        locks(-1)  # raises: no folder can be opened there, either
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _not_made(folder, error) from error
    try:
        if not locks(handle):
            raise BadAuthority(
                f"another program makes certificates in {folder}", remedy="wait until it has ended"
            )
        yield
    finally:
        os.close(handle)


def _is_good(folder: Path, name: str, kind: Kind, hosts: Sequence[str], now: datetime) -> bool:
    """Whether all its files are there, fit each other and the authority, and last."""
    authority, _ = _authority(folder, now)
    signing = folder / f"{name}.signing.key"
    try:
        found = read_certificate((folder / f"{name}.pem").read_bytes())
        key = load_pem_private_key((folder / f"{name}.key").read_bytes(), None)
        found.verify_directly_issued_by(authority)
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        public = Signer(name, _kept(signing)).public_key.hex() if kind is Kind.PILOT else ""
        known = (folder / f"{name}{PUBLIC}").read_text("ascii").strip() if public else ""
    except (OSError, ValueError, TypeError, InvalidSignature, x509.ExtensionNotFound):
        return False
    return (
        key.public_key() == found.public_key()
        and public == known
        and list(names) == ([_host(host) for host in hosts] or [x509.DNSName(name)])
        and found.not_valid_after_utc
        >= min(now + timedelta(days=RENEWED_DAYS), authority.not_valid_after_utc)
    )


def _hand_out(rights: Rights, name: str, kind: Kind) -> None:
    """The folder of one machine: no key of another one, and not that of the authority."""
    place, pki = rights.path.parent / BOARDS / name, rights.pki
    own = {f"{name}.pem", f"{name}.key", f"{name}.signing.key", AUTHORITY, LIST}
    files = {place / rights.path.name: rights.path.read_bytes()}
    for path in sorted(pki.iterdir()):
        if path.name in own or path.suffix == PUBLIC:
            files[place / pki.name / path.name] = path.read_bytes()
    if kind is not Kind.PILOT:
        unit = f"m100link-{name}.service"
        there = {"place": f"/var/lib/m100/{name}", "unit": unit, "file": rights.path.name}
        files[place / unit] = _UNIT.format(name=name, **there).encode()
    try:
        for made in (place.parent, place, place / pki.name):
            made.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise _not_made(place, error) from error
    _write(files, force=True)


def revoke(folder: Path, names: Sequence[str], *, now: datetime) -> Revoked:
    """Revoke names before their certificates expire: write the next list, with all earlier names.

    Raises:
        BadAuthority: There is no authority, it has expired, or a name is not possible.
        BadRevoked: The list in the folder is not the authority's, or is full.
    """
    authority, its_key = _authority(folder, now)
    before = _revoked(folder, authority)
    for name in names:
        if not NAME.fullmatch(name):
            raise BadAuthority(
                f"{name!r} is no name of a certificate", remedy="name it as issue did"
            )
    since = now.astimezone(UTC).date().isoformat()
    found = {**dict.fromkeys(names, since), **before.names}
    if found == before.names:
        return before  # all of them are shut out already
    data = sign_revoked(before.number + 1, found, its_key)
    _write({folder / LIST: data}, force=True)
    return Revoked.verified(data, authority)


def listed(folder: Path) -> list[tuple[str, datetime, str]]:
    """Certificates in a folder: name, when it expires, and since when it is revoked, or empty.

    Raises:
        UsageError: There is no authority, or the list of revoked names is not the authority's.
    """
    revoked = Revocations.of_folder(folder).revoked.names
    found = {}
    for place in sorted(folder.glob("*.pem")):
        if place.name == AUTHORITY:
            continue
        try:
            ends = read_certificate(place.read_bytes()).not_valid_after_utc
        except (OSError, ValueError) as error:
            raise BadAuthority(
                f"{place} has no certificate", remedy=f"take it out of {folder}"
            ) from error
        found[place.stem] = ends
    return [(name, ends, revoked.get(name, "")) for name, ends in found.items()]


def _revoked(folder: Path, authority: x509.Certificate) -> Revoked:
    found = Revocations(authority, folder / LIST)
    found.read()
    return found.revoked


def _kept(path: Path) -> bytes:
    try:
        return bytes.fromhex(read_token(path))
    except ValueError as error:
        raise BadAuthority(f"{path} has no signing key", remedy="move it away") from error


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass  # then it is a name
    if not re.fullmatch(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?", host):
        raise BadAuthority(f"{host!r} is no host", remedy="a name or an address, without a port")
    return x509.DNSName(host)


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    now: datetime,
    ends: datetime,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLY)
        .not_valid_after(ends)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _usage(*, digital_signature: bool, key_cert_sign: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=digital_signature,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=key_cert_sign,
        encipher_only=False,
        decipher_only=False,
    )


def _authority(folder: Path, now: datetime) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        certificate = read_certificate((folder / AUTHORITY).read_bytes())
        key = load_pem_private_key((folder / f"{_CA}.key").read_bytes(), None)
    except OSError as error:
        raise BadAuthority(
            f"there is no authority in {folder}: {error.strerror}",
            remedy="run m100link fleet make FILE where FILE and the authority's ca.key are",
        ) from error
    except (ValueError, TypeError) as error:
        raise BadAuthority(
            f"the files of the authority in {folder} are damaged", remedy=_COPY
        ) from error
    if (
        not isinstance(key, ec.EllipticCurvePrivateKey)
        or key.public_key() != certificate.public_key()
    ):
        raise BadAuthority(f"{_CA}.key in {folder} does not belong to {_CA}.pem", remedy=_COPY)
    if now >= certificate.not_valid_after_utc:
        raise BadAuthority(
            f"the authority in {folder} expired on {certificate.not_valid_after_utc:%Y-%m-%d}",
            remedy="make a new one in another folder, and issue all certificates again",
        )
    return certificate, key


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.PEM)


def _pem_of(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _write(files: dict[Path, bytes], *, force: bool) -> None:
    """Write all of them or none, each readable for its owner alone."""
    there = [path for path in files if path.exists() or path.is_symlink()]
    if there and not force:
        raise BadAuthority(
            f"{there[0]} is there already",
            cause="it was made before, and an overwritten key cannot be restored",
            remedy="move it away first; `m100link fleet make FILE --renew` renews certificates",
        )
    for path, data in files.items():
        try:
            # Nobody else can read it at any moment, and no reader sees a part of it.
            replace_file(path, data)
        except OSError as error:
            raise _not_made(path, error) from error


# -- rules for a router of zenoh, made of the fleet file; what somebody may do, in words -------
# Everything is denied that no rule allows, in both directions: a question has to come in from who
# asks and to go out to the agent, the answer the other way round, and so has every declaration that
# lets the two know of each other. A rule too few looks as if nobody were there. The router sees
# keys and not what an order says: whether one may stop or fly is what the agent's own gate decides.


_SENT = ("tel", "tel/**", "state", "event", "told")
_WATCHED = ("state", "told", "log", "mission")  # asked by who watches
_CARDS = ("state",)  # and of all at once
_ORDERED = ("cmd", "status/**", "revoked")  # by who may stop; of who flies besides:
_FLOWN = ("lease", "show")
_PUT = ("setpoint",)
_PLACES = ("place",)  # sent by each aircraft of a show, to the others


def router_config(rights: Rights) -> dict[str, Any]:
    """The value of ``access_control`` in a configuration of zenoh."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    parts = [
        *(("agent", name, _of_agent(rights, name)) for name in rights.aircraft),
        *(("identity", name, _of_identity(rights, one)) for name, one in rights.identities.items()),
        *(("router", name, _of_router(rights)) for name in rights.routers),
    ]
    for kind, name, made in parts:
        who = f"{kind} {name}"
        mine = [
            {"id": f"{who}: {number}", "permission": "allow"} | rule
            for number, rule in enumerate(made)
            if rule["key_exprs"]
        ]
        rules += mine
        subjects.append({"id": who, "cert_common_names": [name]})
        if mine:
            policies.append({"rules": [rule["id"] for rule in mine], "subjects": [who]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(flow: str, messages: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
    """In from who the rules are for, or out to it."""
    return {"flows": [flow], "messages": list(messages), "key_exprs": list(dict.fromkeys(keys))}


def _word(pattern: str) -> str:
    # A star of zenoh is a whole word; part of one has a sign of its own.
    return pattern if pattern == "*" else pattern.replace("*", "$*")


def _keys(rights: Rights, patterns: Iterable[str], ends: Iterable[str]) -> list[str]:
    words = [_word(one) for one in patterns]
    return [f"m100/{rights.site}/{word}/{end}" for word in words for end in ends]


def _tokens(rights: Rights, patterns: Iterable[str]) -> list[str]:
    words = [_word(one) for one in patterns]
    apart = [f"{LIVE}/{rights.site}/{word}/*" for word in words]
    return apart + [f"m100/{rights.site}/{word}/live" for word in words]


def _of_agent(rights: Rights, name: str) -> Iterator[dict[str, Any]]:
    """An agent tells of its own aircraft, and is asked for it."""
    served = _keys(rights, [name], (*_WATCHED, *_ORDERED, *_FLOWN))
    asked = [*served, *_keys(rights, ["*"], _CARDS)]
    sent, live = _keys(rights, [name], _SENT), _tokens(rights, [name])
    # Setpoints, and what another one of its name tells.
    heard = _keys(rights, [name], (*_PUT, *_CARDS))
    yield _rule("ingress", ["put"], sent)
    # Of an overview, too, which hears all by one pattern: an agent sends what somebody hears.
    heard_by = [*sent, *_keys(rights, ["*"], (*_SENT, *_PLACES))]
    yield _rule("egress", ["declare_subscriber"], heard_by)
    yield _rule("ingress", ["declare_queryable", "reply"], served)
    yield _rule("egress", ["query"], asked)
    yield _rule("ingress", ["declare_subscriber"], heard)
    yield _rule("egress", ["put"], heard)
    mine, everybodys = (_keys(rights, [one], _PLACES) for one in (name, "*"))
    yield _rule("ingress", ["put"], mine)
    yield _rule("ingress", ["declare_subscriber"], everybodys)
    yield _rule("egress", ["put"], everybodys)
    # It looks whether another one has its name, and asks what that says now.
    own = _keys(rights, [name], _CARDS)
    yield _rule("ingress", ["query"], own)
    yield _rule("egress", ["declare_queryable", "reply"], own)
    messages = ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"]
    yield _rule("ingress", messages, live)
    yield _rule("egress", ["liveliness_token"], live)


def _of_identity(rights: Rights, one: Identity) -> Iterator[dict[str, Any]]:
    """The right to watch hears; to stop asks, too; to fly takes the lease and sends setpoints."""
    watched, stopped, flown = (one.allowed(right) for right in Right)
    sent = _keys(rights, watched, _SENT)
    everybody = ["*"] if watched else []
    served = [
        *_keys(rights, watched, _WATCHED),
        *_keys(rights, stopped, _ORDERED),
        *_keys(rights, flown, _FLOWN),
    ]
    put, live = _keys(rights, flown, _PUT), _tokens(rights, watched)
    # It may ask for all by one pattern, which has to be allowed as it stands: the router
    # decides for each key as it goes out.
    asked = [*served, *_keys(rights, everybody, _CARDS)]
    yield _rule("ingress", ["declare_subscriber"], _keys(rights, everybody, _SENT))
    yield _rule("egress", ["put"], sent)
    yield _rule("ingress", ["query"], asked)
    yield _rule("egress", ["declare_queryable", "reply"], served)
    yield _rule("ingress", ["put"], put)
    yield _rule("egress", ["declare_subscriber"], put)
    messages = ["liveliness_query", "declare_liveliness_subscriber"]
    yield _rule("ingress", messages, _tokens(rights, everybody))
    yield _rule("egress", ["liveliness_token"], live)


_PASSED = (
    *("put", "declare_subscriber", "query", "declare_queryable", "reply"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


def _of_router(rights: Rights) -> Iterator[dict[str, Any]]:
    """Another router has looked at what comes from its clients, and looks at what goes to them."""
    keys = [f"m100/{rights.site}/**", f"{LIVE}/{rights.site}/**"]
    yield _rule("ingress", _PASSED, keys)
    yield _rule("egress", _PASSED, keys)


def explain(rights: Rights, who: str) -> list[tuple[str, Right | None]]:
    """The highest right of an identity to each aircraft, and to patterns of others; or None."""
    one = rights.identities[who]
    names = [*rights.aircraft, *(p for p in one.allowed(Right.WATCH) if p not in rights.aircraft)]
    return [
        (name, max((right for right in Right if one.may(right, name)), default=None))
        for name in names
    ]
