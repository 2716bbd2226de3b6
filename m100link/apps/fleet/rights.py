"""Who may do what with which aircraft: one small file, from which router and agents take it.

::

    site = "site"

    [aircraft.a1]                  # its certificate is a1, unless common_name says another one

    [identity.anna]
    public_key = "64 hex digits"   # of her signing key; without one she can sign nothing
    fly = ["a1", "b*"]             # who may fly may stop and watch, too
    stop = ["*"]                   # who may stop may watch
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

from m100link.apps.fleet.keys import NAME
from m100link.errors import UsageError
from m100link.errors.texts import read_toml
from m100link.link.keyfile import read_watched

__all__ = ["BadRights", "Identity", "Right", "Rights"]

_PATTERN = re.compile(rf"{NAME.pattern}\*?|\*")
_KEY = re.compile(r"[0-9a-fA-F]{64}")
_LARGEST = 1024 * 1024
_FIELDS = ("common_name", "public_key", "watch", "stop", "fly")


class BadRights(
    UsageError,
    code="M100-BAD-RIGHTS",
    cause="a word in the file of rights that means nothing, or a file that is none",
    remedy="`m100link fleet acl check FILE` says what each identity may do",
):
    """A file of rights that says what cannot be."""


class Right(IntEnum):
    """What one may do; each includes those before it."""

    WATCH = 1
    STOP = 2
    FLY = 3


@dataclass(frozen=True, slots=True)
class Identity:
    """Somebody who is known.

    Attributes:
        name: By which orders are signed.
        common_name: Of the certificate.
        public_key: Of the signing key, 32 bytes; None for who signs nothing.
        patterns: Which aircraft, by right: names, or a beginning and ``*``.
    """

    name: str
    common_name: str
    public_key: bytes | None
    patterns: Mapping[Right, tuple[str, ...]]

    def may(self, right: Right, aircraft: str) -> bool:
        """Whether it may do this with that aircraft."""
        return any(fits(pattern, aircraft) for pattern in self.allowed(right))

    def allowed(self, right: Right) -> tuple[str, ...]:
        """With which aircraft it may do this, as the file names them."""
        found = (pattern for one in Right if one >= right for pattern in self.patterns[one])
        return tuple(dict.fromkeys(found))


def fits(pattern: str, aircraft: str) -> bool:
    """Whether a pattern of the file means an aircraft."""
    if pattern.endswith("*"):
        return aircraft.startswith(pattern[:-1])
    return pattern == aircraft


@dataclass(frozen=True, slots=True)
class Rights:
    """A file of rights.

    Attributes:
        site: Whose aircraft they are.
        aircraft: Name of each, and the common name of its agent's certificate.
        identities: By name.
    """

    site: str
    aircraft: Mapping[str, str]
    identities: Mapping[str, Identity]

    def without(self, names: Collection[str]) -> Self:
        """The same without who has a name, or a certificate of a name, among these."""
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
        """Who has the name; None for nobody."""
        return self.identities.get(name)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file.

        Raises:
            BadRights: It cannot be read, or says what cannot be.
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
            raise BadRights(f"{path} is not text: {error.reason}") from error
        return cls.parse(text)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read what such a file holds.

        Raises:
            BadRights: It says what cannot be.
        """
        try:
            found = read_toml(text)
        except ValueError as error:
            raise BadRights(f"the file of rights is not TOML: {error}") from error
        _refuse_unknown(found, ("site", "aircraft", "identity"), "the file")
        site = found.get("site", "site")
        _require(NAME, site, "site")
        aircraft = dict(_aircraft(_table(found, "aircraft")))
        people = {name: _identity(name, table) for name, table in _table(found, "identity").items()}
        shared = [*aircraft.values(), *(one.common_name for one in people.values())]
        for name in shared:
            if shared.count(name) > 1:
                raise BadRights(
                    f"two have the common name {name}",
                    cause="the router knows who somebody is by the certificate alone",
                    remedy="a certificate for each of them",
                )
        return cls(site, aircraft, people)


def _table(found: Mapping[str, Any], name: str) -> dict[str, dict[str, Any]]:
    tables = found.get(name, {})
    if not isinstance(tables, dict) or not all(isinstance(one, dict) for one in tables.values()):
        raise BadRights(f"{name} is no table of tables", remedy=f"[{name}.NAME]")
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
        _require(_KEY, key, f"public_key of {name}", "64 hex digits, as `fleet pki issue` tells")
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
