"""How operators sign orders of a fleet, and how agents verify them on board."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from m100link.apps.fleet.agent import Verify
from m100link.apps.fleet.asking import Sign
from m100link.apps.fleet.identity import Gate, Rights, Signer, Since, nobody
from m100link.apps.fleet.payloads import OrderMessage
from m100link.link.keyfile import read_key


def signing(signer: Signer) -> Sign:
    """Return a function that signs orders in that name, for ``connect(sign=…)``."""

    def sign(order: OrderMessage, token: str) -> OrderMessage:
        named = replace(order, signer=signer.name).under(token)
        return named.sealed(signature=signer.sign(named))

    return sign


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


def read_signer(folder: Path, name: str) -> Signer:
    """Read an operator's signing key, as ``fleet pki issue pilot`` made it.

    Raises:
        UsageError: There is none, it is not a key, or others can read it.
    """
    return Signer(name, read_key(folder / f"{name}.signing.key").reveal())


def tls_options(folder: Path, name: str, *, listens: bool = False) -> dict[str, str]:
    """Options of a session that shows a certificate of ``fleet pki`` and asks for one.

    ``listens``: for a router, which also shows it to clients and other routers.
    """
    tls: dict[str, object] = {"root_ca_certificate": str(folder / "ca.pem"), "enable_mtls": True}
    for side in ("connect", *(("listen",) if listens else ())):
        tls[f"{side}_certificate"] = str(folder / f"{name}.pem")
        tls[f"{side}_private_key"] = str(folder / f"{name}.key")
    return {"transport/link/tls": json.dumps(tls)}
