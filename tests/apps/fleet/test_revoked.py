"""Lists of revoked names: whose signature counts, and what no list can say."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from m100link.apps.fleet.identity import LARGEST, BadRevoked, Revoked, nobody, sign_revoked
from m100link.apps.fleet.pki import init, revoke

NOW = datetime(2026, 11, 22, 14, 0, tzinfo=UTC)
NAMES = {"anna": "2026-11-22", "a9": "2026-11-23"}


class Authority:
    def __init__(self, folder: Path) -> None:
        init(folder, now=NOW)
        self.folder = folder
        key = load_pem_private_key((folder / "ca.key").read_bytes(), None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        self.key = key
        self.certificate = x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes())

    def signed(self, told: object) -> bytes:
        """Whatever it is, with a signature that fits."""
        line = json.dumps(told).encode() + b"\n"
        return line + base64.b64encode(self.key.sign(line, ec.ECDSA(SHA256())))


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path / "pki")


def test_what_the_authority_signed_is_read(authority: Authority) -> None:
    data = sign_revoked(3, NAMES, authority.key)
    found = Revoked.verified(data, authority.certificate)
    assert (found.number, found.names, found.data) == (3, NAMES, data)
    assert nobody("anna") == ""


def test_of_another_authority_or_changed_it_is_refused(
    authority: Authority, tmp_path: Path
) -> None:
    data = sign_revoked(3, NAMES, authority.key)
    other = Authority(tmp_path / "other")
    with pytest.raises(BadRevoked, match="not that of the authority"):
        Revoked.verified(data, other.certificate)
    line_end = data.index(b"\n")
    for place in range(line_end + 1):  # each bit that is signed, the line feed, too
        changed = bytearray(data)
        changed[place] ^= 1
        with pytest.raises(BadRevoked):
            Revoked.verified(bytes(changed), authority.certificate)
    signature = base64.b64decode(data[line_end:])
    for place in range(len(signature)):
        wrong = bytearray(signature)
        wrong[place] ^= 1
        with pytest.raises(BadRevoked):
            changed_signature = data[: line_end + 1] + base64.b64encode(wrong)
            Revoked.verified(changed_signature, authority.certificate)


@pytest.mark.parametrize("cut", [b"", b"\n", b"{}", b"\n\n\n", b"\xff" * 100, bytes(LARGEST + 1)])
def test_what_is_no_list_is_refused(authority: Authority, cut: bytes) -> None:
    with pytest.raises(BadRevoked):
        Revoked.verified(cut, authority.certificate)


@pytest.mark.parametrize(
    "told",
    [
        {"m100link": "revoked 2", "number": 1, "names": {}},
        {"m100link": "revoked 1", "number": 0, "names": {}},
        {"m100link": "revoked 1", "number": True, "names": {}},
        {"m100link": "revoked 1", "number": 1 << 60, "names": {}},
        {"m100link": "revoked 1", "number": 1, "names": ["anna"]},
        {"m100link": "revoked 1", "number": 1, "names": {"an na": "2026-11-22"}},
        {"m100link": "revoked 1", "number": 1, "names": {"anna": 2026}},
        {"m100link": "revoked 1", "number": 1, "names": {"anna": "x" * 33}},
        {"number": 1, "names": {}},
        [],
        7,
    ],
)
def test_what_is_signed_and_says_what_cannot_be_is_refused(
    authority: Authority, told: object
) -> None:
    with pytest.raises(BadRevoked, match="cannot read"):
        Revoked.verified(authority.signed(told), authority.certificate)


def test_too_many_names_are_told_as_the_list_is_made(authority: Authority) -> None:
    many = {f"pilot-{number}-{'x' * 20}": "2026-11-22" for number in range(800)}
    with pytest.raises(BadRevoked, match="too many"):
        sign_revoked(1, many, authority.key)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_openssl_verifies_a_list(authority: Authority, tmp_path: Path) -> None:
    line, signature = revoke(authority.folder, ["anna"], now=NOW).data.splitlines(keepends=True)
    (tmp_path / "line").write_bytes(line)
    (tmp_path / "signature").write_bytes(base64.b64decode(signature))
    certificate = str(authority.folder / "ca.pem")
    key = subprocess.run(
        ["openssl", "x509", "-in", certificate, "-pubkey", "-noout"],
        check=True,
        capture_output=True,
    ).stdout
    (tmp_path / "key").write_bytes(key)
    words = ["-sha256", "-verify", "key", "-signature", "signature", "line"]
    ended = subprocess.run(
        ["openssl", "dgst", *words], check=False, capture_output=True, cwd=tmp_path
    )
    assert ended.returncode == 0, ended.stderr
