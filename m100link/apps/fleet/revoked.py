"""Names that are shut out before their certificates end: a list that the authority signs.

A list is two lines: what it says, as JSON, and the authority's signature over that line with its
line feed (ECDSA over P-256 with SHA-256, as base64), so that ``openssl`` verifies it, too. It holds
every name that was ever revoked and a number; one with a smaller number never takes its place.
Pure logic.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256

from m100link.apps.fleet.keys import NAME
from m100link.errors import UsageError
from m100link.errors.texts import read_json

__all__ = ["LARGEST", "BadRevoked", "Revoked", "Since", "nobody", "sign_revoked"]

LARGEST = 32 * 1024
"""Bytes of a list at most: some 700 names."""

Since = Callable[[str], str]
"""Since when somebody is revoked, in words; empty for who is not."""

_KIND = "revoked 1"
_MOST_NUMBER = 1 << 53
_MOST_DATE = 32


def nobody(name: str) -> str:
    """Where there is no list."""
    return ""


class BadRevoked(
    UsageError,
    code="M100-BAD-REVOKED",
    cause="the list was made by another authority, was changed, or a newer one is in force",
    remedy="`m100link fleet pki push` brings the list of the authority",
):
    """A list of revoked names that is not believed; the one before it stays in force."""


@dataclass(frozen=True, slots=True)
class Revoked:
    """What a list says.

    Attributes:
        number: Counts lists from 1; 0 for none.
        names: Who is revoked, and since which day, in words.
        data: The bytes as they were signed; empty for no list.
    """

    number: int
    names: Mapping[str, str]
    data: bytes = b""

    @classmethod
    def verified(cls, data: bytes, authority: x509.Certificate) -> Self:
        """What a list of this authority says.

        Raises:
            BadRevoked: It is none of its lists.
        """
        line, _, signature = data[: LARGEST + 1].partition(b"\n")
        if len(data) > LARGEST:
            raise BadRevoked(f"more than {LARGEST} bytes are no list of revoked names")
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
                cause="it was made by another authority, or changed on its way",
            ) from error
        return cls(*_read(line), data)


def sign_revoked(number: int, names: Mapping[str, str], key: ec.EllipticCurvePrivateKey) -> bytes:
    """The bytes of a list.

    Args:
        number: Greater than that of every list before.
        names: Who is revoked, and since when, in words.
        key: Of the authority.

    Raises:
        BadRevoked: They are too many for one list.
    """
    told = {"m100link": _KIND, "number": number, "names": dict(names)}
    line = json.dumps(told).encode() + b"\n"
    data = line + base64.b64encode(key.sign(line, ec.ECDSA(SHA256()))) + b"\n"
    if len(data) > LARGEST:
        raise BadRevoked(
            f"{len(names)} names are too many for a list",
            cause="names stay in it for good",
            remedy="make a new authority, and issue all certificates anew",
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
            f"a list of revoked names says what this release cannot read: {error}",
            cause="the authority has a newer release, or signed something else",
            remedy="install the same release on both",
        ) from error
    return number, names
