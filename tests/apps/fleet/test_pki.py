"""Certificates: verified by cryptography's own verifier, and files that nobody else reads."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from cryptography.x509.verification import (
    ClientVerifier,
    PolicyBuilder,
    ServerVerifier,
    Store,
    VerificationError,
)

from m100link.apps.agent.orders import Right
from m100link.apps.fleet.identity import Rights, Signer
from m100link.apps.fleet.pki import (
    BadAuthority,
    Kind,
    explain,
    init,
    issue,
    listed,
    make,
    revoke,
    router_config,
)
from m100link.apps.fleet.revocations import BadRevoked, Revocations
from m100link.link.keyfile import read_token
from tests.waiting import PATIENCE

NOW = datetime(2026, 11, 22, 14, 0, tzinfo=UTC)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "pki"
    init(place, now=NOW)
    return place


def loaded(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def policy(folder: Path, at: datetime) -> PolicyBuilder:
    return PolicyBuilder().store(Store([loaded(folder / "ca.pem")])).time(at)


def clients(folder: Path, at: datetime = NOW) -> ClientVerifier:
    return policy(folder, at).build_client_verifier()


def server(folder: Path, host: str) -> ServerVerifier:
    return policy(folder, NOW).build_server_verifier(x509.DNSName(host))


def test_the_owner_of_a_certificate_is_known_by_its_common_name(folder: Path) -> None:
    for kind, name in ((Kind.AGENT, "a1"), (Kind.PILOT, "anna")):
        made = issue(folder, kind, name, now=NOW)
        certificate = loaded(made.certificate)
        clients(folder).verify(certificate, [])
        [common_name] = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        assert common_name.value == name
        purposes = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert list(purposes) == [ExtendedKeyUsageOID.CLIENT_AUTH]
        key = load_pem_private_key(made.key.read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        assert key.public_key() == certificate.public_key()


def test_a_router_is_one_by_its_hosts_alone(folder: Path) -> None:
    hosts = ["base.example.org", "10.0.0.1", "b" * 253]
    made = issue(folder, Kind.ROUTER, "base", now=NOW, hosts=hosts)
    certificate = loaded(made.certificate)
    server(folder, "base.example.org").verify(certificate, [])
    with pytest.raises(VerificationError):
        server(folder, "other.example.org").verify(certificate, [])
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(one) for one in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.1"]
    pilot = issue(folder, Kind.PILOT, "anna", now=NOW)
    with pytest.raises(VerificationError):  # a pilot cannot be a router
        server(folder, "anna").verify(loaded(pilot.certificate), [])


def test_certificates_end_and_begin_a_little_early(folder: Path) -> None:
    made = issue(folder, Kind.AGENT, "a1", now=NOW)
    certificate = loaded(made.certificate)
    assert made.ends == NOW + timedelta(days=30) == certificate.not_valid_after_utc
    for at in (NOW - timedelta(minutes=4), NOW + timedelta(days=29, hours=23)):
        clients(folder, at).verify(certificate, [])
    for at in (NOW - timedelta(minutes=6), NOW + timedelta(days=30, seconds=1)):
        with pytest.raises(VerificationError):
            clients(folder, at).verify(certificate, [])
    nearly = NOW + timedelta(days=727)
    late = issue(folder, Kind.AGENT, "a2", now=nearly)
    assert late.ends == NOW + timedelta(days=730), "no longer than the authority"


def test_another_authority_is_not_believed(folder: Path, tmp_path: Path) -> None:
    init(tmp_path / "other", now=NOW)
    made = issue(tmp_path / "other", Kind.PILOT, "anna", now=NOW)
    with pytest.raises(VerificationError):
        clients(folder).verify(loaded(made.certificate), [])


USES = ("digital_signature", "key_cert_sign", "crl_sign", "content_commitment", "key_agreement")


def test_each_certificate_has_the_uses_of_its_owner_alone(folder: Path) -> None:
    """RFC 5280: the authority signs certificates of no other authority; others sign handshakes."""
    made = [issue(folder, Kind.AGENT, "a1", now=NOW), issue(folder, Kind.PILOT, "anna", now=NOW)]
    made.append(issue(folder, Kind.ROUTER, "base", now=NOW, hosts=["base"]))
    assert [one.signing_key for one in made] == [None, folder / "anna.signing.key", None]
    authority, *others = map(loaded, (folder / "ca.pem", *(one.certificate for one in made)))
    its_key = authority.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    for one in (authority, *others):
        is_authority = one is authority
        constraints = one.extensions.get_extension_for_class(x509.BasicConstraints)
        path_length = 0 if is_authority else None
        assert constraints.value == x509.BasicConstraints(is_authority, path_length)
        usage = one.extensions.get_extension_for_class(x509.KeyUsage)
        assert constraints.critical
        assert usage.critical
        found = [name for name in USES if getattr(usage.value, name)]
        assert found == (["key_cert_sign", "crl_sign"] if is_authority else ["digital_signature"])
        assert one.issuer == authority.subject
        if not is_authority:
            key = one.extensions.get_extension_for_class(x509.AuthorityKeyIdentifier).value
            assert key.key_identifier == its_key.digest
    purposes = others[-1].extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(purposes) == {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH}


# -- files ----------------------------------------------------------------------------------------


def test_nobody_else_reads_them(folder: Path) -> None:
    issue(folder, Kind.PILOT, "anna", now=NOW)
    issue(folder, Kind.ROUTER, "base", now=NOW, hosts=["base"])
    files = sorted(folder.iterdir())
    assert [path.name for path in files] == [
        *("anna.key", "anna.pem", "anna.pub", "anna.signing.key"),
        *("base.key", "base.pem", "ca.key", "ca.pem"),
    ]
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_an_operators_signing_key_fits_what_is_printed_and_outlives_the_certificate(
    folder: Path,
) -> None:
    made = issue(folder, Kind.PILOT, "anna", now=NOW)
    assert made.signing_key is not None
    signer = Signer("anna", bytes.fromhex(read_token(made.signing_key)))
    assert signer.public_key.hex() == made.public_key
    before = made.certificate.read_bytes()
    again = issue(folder, Kind.PILOT, "anna", now=NOW + timedelta(days=20), force=True)
    assert again.public_key == made.public_key
    assert again.certificate.read_bytes() != before


@pytest.mark.parametrize("name", ["a1.key", "a1.pem"])
def test_nothing_is_written_over_in_silence(folder: Path, name: str) -> None:
    (folder / name).write_text("mine")
    with pytest.raises(BadAuthority, match="is there already"):
        issue(folder, Kind.AGENT, "a1", now=NOW)
    assert (folder / name).read_text() == "mine"
    assert {path.name for path in folder.iterdir()} == {"ca.key", "ca.pem", name}
    before = (folder / "ca.key").read_bytes()
    with pytest.raises(BadAuthority, match="is there already"):
        init(folder, now=NOW)
    assert (folder / "ca.key").read_bytes() == before
    issue(folder, Kind.AGENT, "a1", now=NOW, force=True)
    clients(folder).verify(loaded(folder / "a1.pem"), [])
    issue(folder, Kind.PILOT, "anna", now=NOW)
    (folder / "anna.key").unlink()
    (folder / "anna.pem").unlink()
    with pytest.raises(BadAuthority, match=r"signing\.key is there already"):
        issue(folder, Kind.PILOT, "anna", now=NOW)


def test_a_link_that_somebody_laid_is_not_written_through(folder: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    (folder / "a1.key").symlink_to(elsewhere)
    with pytest.raises(BadAuthority, match="is there already"):
        issue(folder, Kind.AGENT, "a1", now=NOW)
    issue(folder, Kind.AGENT, "a1", now=NOW, force=True)
    assert not elsewhere.exists()


# -- what cannot be -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["", "ca", "a/b", "../x", ".x", "a b", "a" * 33])
def test_names_that_are_none(folder: Path, name: str) -> None:
    with pytest.raises(BadAuthority, match="is no name"):
        issue(folder, Kind.AGENT, name, now=NOW)


@pytest.mark.parametrize(
    ("kind", "hosts"),
    [
        (Kind.ROUTER, ["b" * 254]),
        (Kind.ROUTER, []),
        (Kind.AGENT, ["base"]),
        (Kind.ROUTER, ["a b"]),
        (Kind.ROUTER, ["base:7"]),
    ],
)
def test_hosts_are_those_of_a_router(folder: Path, kind: Kind, hosts: list[str]) -> None:
    with pytest.raises(BadAuthority, match="host"):
        issue(folder, kind, "x", now=NOW, hosts=hosts)


def test_an_authority_that_is_not_there_damaged_foreign_or_over(folder: Path) -> None:
    def refused(said: str, now: datetime = NOW) -> None:
        with pytest.raises(BadAuthority, match=said):
            issue(folder, Kind.AGENT, "a1", now=now)

    refused("expired on 2028-11-21", NOW + timedelta(days=730))
    issue(folder, Kind.AGENT, "b1", now=NOW)
    key = (folder / "ca.key").read_bytes()
    (folder / "ca.key").write_bytes((folder / "b1.key").read_bytes())
    refused("does not belong")
    (folder / "ca.key").write_bytes(key[:100])
    refused("are damaged")
    (folder / "ca.key").unlink()
    refused("there is no authority")


def test_a_signing_key_that_is_none_is_not_replaced(folder: Path) -> None:
    issue(folder, Kind.PILOT, "anna", now=NOW)
    (folder / "anna.signing.key").write_text("no key")
    with pytest.raises(BadAuthority, match="has no signing key"):
        issue(folder, Kind.PILOT, "anna", now=NOW, force=True)
    assert (folder / "anna.signing.key").read_text() == "no key"


# -- who lost a key -------------------------------------------------------------------------------


def test_lists_count_and_hold_everybody_who_was_ever_revoked(folder: Path) -> None:
    assert listed(folder) == []
    issue(folder, Kind.PILOT, "anna", now=NOW)
    first = revoke(folder, ["anna"], now=NOW)
    second = revoke(folder, ["bert", "anna"], now=NOW + timedelta(days=1))
    assert (first.number, dict(first.names)) == (1, {"anna": "2026-11-22"})
    assert (second.number, dict(second.names)) == (2, {"anna": "2026-11-22", "bert": "2026-11-23"})
    assert revoke(folder, ["bert"], now=NOW).data == second.data, "nobody new is no new list"
    evening = datetime(2026, 11, 23, 22, 30, tzinfo=timezone(timedelta(hours=-5)))
    third = revoke(folder, ["carl"], now=evening)
    assert third.names["carl"] == "2026-11-24", "the day by UTC"
    assert listed(folder) == [("anna", NOW + timedelta(days=30), "2026-11-22")]


def test_a_revoked_name_gets_no_certificate_again(folder: Path) -> None:
    issue(folder, Kind.PILOT, "anna", now=NOW)
    revoke(folder, ["anna"], now=NOW)
    with pytest.raises(BadAuthority, match="anna is revoked since 2026-11-22"):
        issue(folder, Kind.PILOT, "anna", now=NOW, force=True)
    assert issue(folder, Kind.PILOT, "anna-2", now=NOW).public_key


def test_a_list_of_somebody_else_in_the_folder_is_no_beginning(
    folder: Path, tmp_path: Path
) -> None:
    init(tmp_path / "other", now=NOW)
    revoke(tmp_path / "other", ["eve"], now=NOW)
    (folder / "revoked.list").write_bytes((tmp_path / "other" / "revoked.list").read_bytes())
    for do in (
        lambda: revoke(folder, ["anna"], now=NOW),
        lambda: issue(folder, Kind.PILOT, "anna", now=NOW),
        lambda: init(folder, now=NOW, force=True),
    ):
        with pytest.raises(BadRevoked):
            do()


def test_a_new_authority_in_the_folder_keeps_shut_out_who_was(folder: Path) -> None:
    """Keys that sign orders outlive certificates."""
    revoke(folder, ["anna"], now=NOW)
    init(folder, now=NOW, force=True)
    found = Revocations.of_folder(folder)
    assert (found.number, found.since("anna")) == (2, "2026-11-22")


def test_what_cannot_be_a_name_is_not_revoked(folder: Path) -> None:
    with pytest.raises(BadAuthority, match="no name of a certificate"):
        revoke(folder, ["anna.pem"], now=NOW)
    (folder / "x.pem").write_text("nothing")
    with pytest.raises(BadAuthority, match="no certificate"):
        listed(folder)


# -- rules of a router: that zenoh itself, with certificates, lets through what the file says ------


zenoh: Any = pytest.importorskip("zenoh", reason="the extra fleet is not installed")

FILE = """
[aircraft.a1]
[aircraft.a2]
[identity.anna]
fly = ["a1"]
[identity.bert]
stop = ["a*"]
[identity.wall]
watch = ["*"]
[identity.none]
"""
RIGHTS = Rights.parse(FILE)
_ROUTERS = ("base", "other")
LINKED = Rights.parse(
    FILE + "".join(f'[router.{one}]\nhosts = ["127.0.0.1"]\n' for one in _ROUTERS)
)

# -- the rules as they are written ----------------------------------------------------------------


def rules_of(who: str) -> list[dict[str, Any]]:
    found = router_config(RIGHTS)
    [ids] = [one["rules"] for one in found["policies"] if one["subjects"] == [who]] or [[]]
    return [rule for rule in found["rules"] if rule["id"] in ids]


def test_what_no_rule_allows_is_denied() -> None:
    found = router_config(RIGHTS)
    assert (found["enabled"], found["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in found["rules"]} == {"allow"}
    assert len({rule["id"] for rule in found["rules"]}) == len(found["rules"])


def test_an_agent_has_rules_for_nobody_elses_keys_but_a_question_and_places() -> None:
    """Where all stand is asked, and heard, by one pattern, which has to be allowed as it stands."""
    named = {key for rule in rules_of("agent a1") for key in rule["key_exprs"]}
    others = {key for key in named if not key.startswith("m100/site/a1/")}
    assert others == {*keys("*", f"{SENT} place"), "m100-live/site/a1/*"}
    [heard] = [one for one in rules_of("agent a1") if "m100/site/*/tel/**" in one["key_exprs"]]
    assert (heard["flows"], heard["messages"]) == (["egress"], ["declare_subscriber"])
    places = [one for one in rules_of("agent a1") if "m100/site/*/place" in one["key_exprs"]]
    assert not any("put" in one["messages"] and one["flows"] == ["ingress"] for one in places)
    states = [one for one in rules_of("agent a1") if "m100/site/*/state" in one["key_exprs"]]
    assert [one["flows"] for one in states] == [["egress"]] * 2
    assert [one["messages"] for one in states] == [["declare_subscriber"], ["query"]]


SENT = "tel tel/** state event told"
WATCHED, STOPPED, FLOWN = "state told log mission", "cmd status/** revoked", "lease show"


def keys(name: str, ends: str) -> list[str]:
    return [f"m100/site/{name}/{end}" for end in ends.split()]


def live(name: str) -> list[str]:
    return [f"m100-live/site/{name}/*", f"m100/site/{name}/live"]


def of_identity(name: str, asked: str, *, flies: bool = False) -> list[tuple[str, str, list[str]]]:
    """What may pass to and from an operator, by hand: into the router, and out of it."""
    found = [
        ("ingress", "declare_subscriber", keys("*", SENT)),
        ("egress", "put", keys(name, SENT)),
        ("ingress", "query", list(dict.fromkeys([*keys(name, asked), *keys("*", "state")]))),
        ("egress", "declare_queryable reply", keys(name, asked)),
        ("ingress", "liveliness_query declare_liveliness_subscriber", live("*")),
        ("egress", "liveliness_token", live(name)),
    ]
    setpoints = keys(name, "setpoint")
    flown = [("ingress", "put", setpoints), ("egress", "declare_subscriber", setpoints)]
    return [*found[:4], *(flown if flies else ()), *found[4:]]


SERVED = f"{WATCHED} {STOPPED} {FLOWN}"
RULES = {
    "identity anna": of_identity("a1", SERVED, flies=True),
    "identity bert": of_identity("a$*", f"{WATCHED} {STOPPED}"),  # part of a word, as zenoh has it
    "identity wall": of_identity("*", WATCHED),
    "identity none": [],
    "agent a1": [
        ("ingress", "put", keys("a1", SENT)),
        ("egress", "declare_subscriber", [*keys("a1", SENT), *keys("*", f"{SENT} place")]),
        ("ingress", "declare_queryable reply", keys("a1", SERVED)),
        ("egress", "query", [*keys("a1", SERVED), *keys("*", "state")]),
        ("ingress", "declare_subscriber", keys("a1", "setpoint state")),
        ("egress", "put", keys("a1", "setpoint state")),
        ("ingress", "put", keys("a1", "place")),
        ("ingress", "declare_subscriber", keys("*", "place")),
        ("egress", "put", keys("*", "place")),
        ("ingress", "query", keys("a1", "state")),
        ("egress", "declare_queryable reply", keys("a1", "state")),
        (
            "ingress",
            "liveliness_token liveliness_query declare_liveliness_subscriber",
            live("a1"),
        ),
        ("egress", "liveliness_token", live("a1")),
    ],
}


@pytest.mark.parametrize("who", RULES)
def test_each_right_lets_its_own_messages_pass_and_no_others(who: str) -> None:
    found = [
        (*rule["flows"], " ".join(rule["messages"]), rule["key_exprs"]) for rule in rules_of(who)
    ]
    assert found == RULES[who]
    assert [one["rules"] for one in router_config(RIGHTS)["policies"] if not one["rules"]] == []


def test_a_name_without_rights_has_no_rule_but_is_known() -> None:
    assert rules_of("identity none") == []
    found = router_config(RIGHTS)
    assert {"id": "identity none", "cert_common_names": ["none"]} in found["subjects"]


def test_what_somebody_may_do_in_words() -> None:
    assert explain(RIGHTS, "anna") == [("a1", Right.FLY), ("a2", None)]
    assert explain(RIGHTS, "wall") == [("a1", Right.WATCH), ("a2", Right.WATCH), ("*", Right.WATCH)]


# -- and as zenoh obeys them ----------------------------------------------------------------------


def free_port() -> int:
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return int(place.getsockname()[1])


def until(predicate: Callable[[], object]) -> None:
    """Wait for what other threads bring."""
    deadline = time.monotonic() + PATIENCE
    while not predicate():
        assert time.monotonic() < deadline
        time.sleep(0.01)


class Site:
    """A router of zenoh with the rules, certificates, and who comes with one."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.endpoint = self.first = f"tls/127.0.0.1:{free_port()}"
        self._stack = stack
        now = datetime.now(UTC)
        init(folder, now=now)
        issue(folder, Kind.ROUTER, "base", now=now, hosts=["127.0.0.1"])
        for name in ("a1", "a2", "anna", "bert", "wall", "stranger"):
            issue(folder, Kind.AGENT, name, now=now)
        issue(folder, Kind.AGENT, "late", now=now - timedelta(days=31))
        config = self._config("router", folder, listen="base")
        config.insert_json5("access_control", json.dumps(router_config(LINKED)))
        stack.enter_context(zenoh.open(config))

    def link(self) -> None:
        """Begin another router, which is linked with the first one."""
        now = datetime.now(UTC)
        issue(self.folder, Kind.ROUTER, "other", now=now, hosts=["127.0.0.1"])
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        config = self._config("router", self.folder, listen="other", connect="other")
        config.insert_json5("listen/endpoints", json.dumps([self.endpoint]))
        config.insert_json5("connect/endpoints", json.dumps([self.first]))
        config.insert_json5("access_control", json.dumps(router_config(LINKED)))
        self._stack.enter_context(zenoh.open(config))

    def _config(self, mode: str, folder: Path, *, listen: str = "", connect: str = "") -> Any:
        config = zenoh.Config()
        tls: dict[str, Any] = {"root_ca_certificate": str(folder / "ca.pem"), "enable_mtls": True}
        for name, side in ((listen, "listen"), (connect, "connect")):
            if name:
                tls[f"{side}_certificate"] = str(folder / f"{name}.pem")
                tls[f"{side}_private_key"] = str(folder / f"{name}.key")
        endpoints = "listen/endpoints" if listen else "connect/endpoints"
        for key, value in {
            "mode": mode,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/link/tls": tls,
            endpoints: [self.endpoint],
            "connect/timeout_ms": 1500,
            "connect/exit_on_failure": True,
        }.items():
            config.insert_json5(key, json.dumps(value))
        return config

    def come(self, name: str, folder: Path | None = None) -> Any:
        config = self._config("client", folder or self.folder, connect=name)
        return self._stack.enter_context(zenoh.open(config))

    def serve(self, session: Any, key: str) -> None:
        def answer(query: Any) -> None:
            with query:
                query.reply(key, b"done")

        self._stack.callback(session.declare_queryable(key, answer).undeclare)

    def hear(self, session: Any, key: str) -> list[tuple[str, bytes]]:
        heard: list[tuple[str, bytes]] = []

        def take(sample: Any) -> None:
            heard.append((str(sample.key_expr), sample.payload.to_bytes()))

        self._stack.callback(session.declare_subscriber(key, take).undeclare)
        return heard


def answers(session: Any, key: str) -> int:
    return sum(reply.ok is not None for reply in session.get(key, timeout=2.0))


def seen(session: Any) -> set[str]:
    replies = session.liveliness().get("m100-live/site/*/*", timeout=2.0)
    return {str(reply.ok.key_expr).split("/")[2] for reply in replies if reply.ok is not None}


Heard = list[tuple[str, bytes]]


def told(agents: dict[str, Any], twin: Any, places: dict[str, Heard], own: Heard) -> bool:
    """Each aircraft tells its own place, one a false one of another, until all are heard."""
    for name, session in agents.items():
        session.put(f"m100/site/{name}/place", name.encode())
    twin.put("m100/site/a1/state", b"twin")
    agents["a2"].put("m100/site/a1/place", b"false")
    is_heard = all(len({key for key, _ in one}) == 2 for one in places.values())
    return is_heard and own == [("m100/site/a1/state", b"twin")] * len(own) != []


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(tmp_path / "pki", stack)


@pytest.mark.parametrize("is_linked", [False, True])
def test_a_router_lets_everybody_do_what_the_file_says(site: Site, is_linked: bool) -> None:
    """Also between two that are linked, each of which has its own clients."""
    agents = {name: site.come(name) for name in ("a1", "a2")}
    if is_linked:
        site.link()
    people = {name: site.come(name) for name in ("anna", "bert", "wall", "stranger")}
    tokens = [
        agents[name].liveliness().declare_token(f"m100-live/site/{name}/{agents[name].zid()}")
        for name in agents
    ]
    for name, session in agents.items():
        for what in ("cmd", "lease", "state"):
            site.serve(session, f"m100/site/{name}/{what}")
    setpoints = site.hear(agents["a1"], "m100/site/a1/setpoint")
    heard = {name: site.hear(one, "m100/site/*/tel/5hz") for name, one in people.items()}
    wanted = [one.declare_publisher(f"m100/site/{name}/tel/5hz") for name, one in agents.items()]
    until(lambda: all(one.matching_status.matching for one in wanted))  # else agents send nothing
    until(lambda: seen(people["wall"]) == {"a1", "a2"})
    until(lambda: answers(people["anna"], "m100/site/a1/cmd") == 1)
    table = {
        (name, aircraft, what): answers(session, f"m100/site/{aircraft}/{what}") == 1
        for name, session in people.items()
        for aircraft in agents
        for what in ("state", "cmd", "lease")
    }
    allowed = {
        *(("anna", "a1", what) for what in ("state", "cmd", "lease")),
        *(("bert", aircraft, what) for aircraft in agents for what in ("state", "cmd")),
        *(("wall", aircraft, "state") for aircraft in agents),
    }
    assert {what for what, is_answered in table.items() if is_answered} == allowed
    assert {name: seen(one) for name, one in people.items()} == {
        "anna": {"a1"},
        "bert": {"a1", "a2"},
        "wall": {"a1", "a2"},
        "stranger": set(),
    }

    cards = {name: answers(session, "m100/site/*/state") for name, session in people.items()}
    assert cards == {"anna": 1, "bert": 2, "wall": 2, "stranger": 0}

    places = {name: site.hear(one, "m100/site/*/place") for name, one in agents.items()}
    own = site.hear(agents["a1"], "m100/site/a1/state")
    twin = site.come("a1")
    until(lambda: told(agents, twin, places, own))
    assert {word for _, word in places["a1"]} == {b"a1", b"a2"}

    for name, session in people.items():
        session.put("m100/site/a1/setpoint", name.encode())
    agents["a2"].put("m100/site/a1/tel/5hz", b"false")  # an aircraft that says to be another one
    people["bert"].put("m100/site/a1/tel/5hz", b"false")
    for name, session in agents.items():
        session.put(f"m100/site/{name}/tel/5hz", name.encode())
    both = {("m100/site/a1/tel/5hz", b"a1"), ("m100/site/a2/tel/5hz", b"a2")}
    until(lambda: set(heard["wall"]) >= both)
    until(lambda: len(heard["anna"]) >= 1 and len(setpoints) >= 1)
    assert set(heard["wall"]) == both
    assert heard["anna"] == [("m100/site/a1/tel/5hz", b"a1")]
    assert heard["stranger"] == []
    assert setpoints == [("m100/site/a1/setpoint", b"anna")]
    assert len(tokens) == 2


def test_nobody_comes_without_a_certificate_of_the_authority(site: Site, tmp_path: Path) -> None:
    now = datetime.now(UTC)
    init(tmp_path / "other", now=now)
    issue(tmp_path / "other", Kind.AGENT, "anna", now=now)
    # It has to believe the router, or it would go by itself.
    (tmp_path / "other" / "ca.pem").write_bytes((site.folder / "ca.pem").read_bytes())
    site.come("anna")
    for name, folder in (("anna", tmp_path / "other"), ("late", site.folder), ("", site.folder)):
        with pytest.raises(zenoh.ZError):
            site.come(name, folder)
    site.endpoint = site.endpoint.replace("tls/", "tcp/")
    with pytest.raises(zenoh.ZError):
        site.come("anna")


# -- everything that a fleet file needs ------------------------------------------------------------


@pytest.fixture
def rights(tmp_path: Path) -> Rights:
    (tmp_path / "fleet.toml").write_text(
        '[router.base]\nhosts = ["127.0.0.1"]\n[aircraft.a1]\n[identity.anna]\nfly = ["*"]\n'
    )
    return Rights.read(tmp_path / "fleet.toml")


def test_each_machine_gets_what_it_needs_and_no_key_of_another(rights: Rights) -> None:
    assert list(make(rights, now=NOW)) == ["base", "a1", "anna"]
    boards = rights.path.parent / "boards"
    files = {
        place.name: sorted(str(one.relative_to(place)) for one in place.rglob("*.*"))
        for place in boards.iterdir()
    }
    own = {name: [f"pki/{name}.key", f"pki/{name}.pem"] for name in files}
    shared = ["fleet.toml", "pki/ca.pem"]
    assert files == {
        "a1": sorted([*shared, *own["a1"], "m100link-a1.service", "pki/anna.pub"]),
        "base": sorted([*shared, *own["base"], "m100link-base.service", "pki/anna.pub"]),
        "anna": sorted([*shared, *own["anna"], "pki/anna.pub", "pki/anna.signing.key"]),
    }
    modes = {stat.S_IMODE(one.stat().st_mode) for one in [boards, *boards.rglob("*")]}
    assert modes == {0o600, 0o700}
    unit = (boards / "a1/m100link-a1.service").read_text()
    assert "m100link fleet up /var/lib/m100/a1/fleet.toml a1 --real\n" in unit


def test_only_what_is_missing_damaged_or_ends_soon_is_made_anew(rights: Rights) -> None:
    make(rights, now=NOW)
    key = (rights.pki / "anna.signing.key").read_bytes()
    assert make(rights, now=NOW + timedelta(days=19)) == {}
    (rights.pki / "a1.key").write_bytes(
        (rights.pki / "base.key").read_bytes()
    )  # killed between two
    (rights.pki / "anna.pub").write_text("0a" * 32)
    assert list(make(rights, now=NOW)) == ["a1", "anna"]
    assert (rights.pki / "anna.signing.key").read_bytes() == key
    assert list(make(rights, now=NOW + timedelta(days=21))) == ["base", "a1", "anna"]
    rights.path.write_text(rights.path.read_text().replace("127.0.0.1", "10.0.0.1"))
    assert list(make(Rights.read(rights.path), now=NOW + timedelta(days=21))) == ["base"]


def test_a_make_that_was_killed_is_ended_by_the_next_one(rights: Rights) -> None:
    rights.pki.mkdir()
    (rights.pki / "ca.key").write_text("half")
    make(rights, now=NOW)
    authority = (rights.pki / "ca.pem").read_bytes()
    (rights.pki / "ca.key").unlink()  # as on a board
    with pytest.raises(BadAuthority, match="there is no authority"):
        make(rights, now=NOW)
    assert (rights.pki / "ca.pem").read_bytes() == authority


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "make room on that disk"),
        (errno.EACCES, "name a folder that your account may write"),
    ],
)
def test_what_a_disk_does_not_take_has_a_remedy(
    rights: Rights, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    def write(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("m100link.apps.fleet.pki.replace_file", write)
    with pytest.raises(BadAuthority, match="cannot be made") as caught:
        make(rights, now=NOW)
    assert caught.value.remedy == remedy


@pytest.mark.parametrize("place", ["pki", "boards"])
def test_a_folder_that_cannot_be_made_is_named(rights: Rights, place: str) -> None:
    there = rights.path.parent / place
    there.write_text("a file")
    with pytest.raises(BadAuthority, match=f"{there}(/base)? cannot be made: (File exists|Not a)"):
        make(rights, now=NOW)
    with pytest.raises(BadAuthority, match=f"{there}/below cannot be made: Not a directory"):
        init(there / "below", now=NOW)
    assert there.read_text() == "a file"


def test_two_that_make_at_once_make_no_two_authorities(rights: Rights) -> None:
    rights.pki.mkdir()
    handle = os.open(rights.pki, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(BadAuthority, match="another program makes certificates"):
            make(rights, now=NOW)
    finally:
        os.close(handle)
    assert list(rights.pki.iterdir()) == []
