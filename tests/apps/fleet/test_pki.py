"""Certificates: verified by cryptography's own verifier, and files that nobody else reads."""

from __future__ import annotations

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

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

from m100link.apps.fleet.identity import BadRevoked, Signer
from m100link.apps.fleet.pki import (
    AUTHORITY_DAYS,
    ISSUED_DAYS,
    BadAuthority,
    Kind,
    init,
    issue,
    listed,
    revoke,
)
from m100link.apps.fleet.revocations import Revocations
from m100link.link.keyfile import read_token

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


def test_who_has_a_certificate_is_known_by_its_common_name(folder: Path) -> None:
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
    made = issue(folder, Kind.ROUTER, "base", now=NOW, hosts=["base.example.org", "10.0.0.1"])
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
    assert made.ends == NOW + timedelta(days=ISSUED_DAYS) == certificate.not_valid_after_utc
    for at in (NOW - timedelta(minutes=4), NOW + timedelta(days=29, hours=23)):
        clients(folder, at).verify(certificate, [])
    for at in (NOW - timedelta(minutes=6), NOW + timedelta(days=30, seconds=1)):
        with pytest.raises(VerificationError):
            clients(folder, at).verify(certificate, [])
    nearly = NOW + timedelta(days=AUTHORITY_DAYS - 3)
    late = issue(folder, Kind.AGENT, "a2", now=nearly)
    assert late.ends == NOW + timedelta(days=AUTHORITY_DAYS), "no longer than the authority"


def test_another_authority_is_not_believed(folder: Path, tmp_path: Path) -> None:
    init(tmp_path / "other", now=NOW)
    made = issue(tmp_path / "other", Kind.PILOT, "anna", now=NOW)
    with pytest.raises(VerificationError):
        clients(folder).verify(loaded(made.certificate), [])


def test_who_was_issued_a_certificate_issues_none(folder: Path) -> None:
    certificate = loaded(issue(folder, Kind.AGENT, "a1", now=NOW).certificate)
    constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints)
    assert constraints.critical
    assert constraints.value == x509.BasicConstraints(ca=False, path_length=None)


# -- files ----------------------------------------------------------------------------------------


def test_nobody_else_reads_them(folder: Path) -> None:
    issue(folder, Kind.PILOT, "anna", now=NOW)
    issue(folder, Kind.ROUTER, "base", now=NOW, hosts=["base"])
    files = sorted(folder.iterdir())
    assert [path.name for path in files] == [
        *("anna.key", "anna.pem", "anna.signing.key"),
        *("base.key", "base.pem", "ca.key", "ca.pem"),
    ]
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_a_pilots_signing_key_fits_what_is_told_and_outlives_the_certificate(folder: Path) -> None:
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
    [(Kind.ROUTER, []), (Kind.AGENT, ["base"]), (Kind.ROUTER, ["a b"]), (Kind.ROUTER, ["base:7"])],
)
def test_hosts_are_those_of_a_router(folder: Path, kind: Kind, hosts: list[str]) -> None:
    with pytest.raises(BadAuthority, match="host"):
        issue(folder, kind, "x", now=NOW, hosts=hosts)


def test_an_authority_that_is_not_there_damaged_foreign_or_over(folder: Path) -> None:
    def refused(said: str, now: datetime = NOW) -> None:
        with pytest.raises(BadAuthority, match=said):
            issue(folder, Kind.AGENT, "a1", now=now)

    refused("ended on 2028-11-21", NOW + timedelta(days=AUTHORITY_DAYS))
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
    with pytest.raises(BadAuthority, match="holds no signing key"):
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
    assert listed(folder) == [("anna", NOW + timedelta(days=ISSUED_DAYS), "2026-11-22")]


def test_who_is_revoked_gets_no_certificate_under_that_name_again(folder: Path) -> None:
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
