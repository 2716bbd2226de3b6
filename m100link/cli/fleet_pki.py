"""``m100link fleet pki`` and ``fleet acl``: certificates of a fleet, and who may do what in it."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from m100link.cli.outcome import ExitCode, print_json
from m100link.cli.plan import File, require_free
from m100link.errors import UsageError
from m100link.fleet.acl import explain, router_config
from m100link.fleet.pki import Issued, Kind
from m100link.fleet.pki import init as make_authority
from m100link.fleet.pki import issue as make_certificate
from m100link.fleet.rights import BadRights, Right, Rights

__all__ = ["acl", "pki"]

pki = cyclopts.App(
    name="pki",
    help="Certificates and signing keys of a fleet: an authority of its own, and what it issues.",
    version_flags=(),
)
acl = cyclopts.App(
    name="acl",
    help="Who may do what with which aircraft: look at a file of rights, make a router's rules.",
    version_flags=(),
)

AsJson = Annotated[bool | None, Parameter(negative="--table")]


@pki.command
def init(folder: Path, /, *, force: bool = False, json: AsJson = None) -> int:
    """Make an authority: the key that every certificate of the fleet comes from.

    Whoever has ca.key can be anybody. Keep the folder on a machine that does not fly.

    Args:
        folder: Where its files go; for you alone.
        force: Write over an authority that is there. All that it issued is worth nothing then.
        json: One JSON object instead of text; the default when output is not a terminal.
    """
    made = make_authority(folder, now=datetime.now(UTC), force=force)
    return _tell(made, json)


@pki.command
def issue(
    kind: Kind,
    name: str,
    /,
    *,
    folder: Path = Path(),
    host: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    force: bool = False,
    json: AsJson = None,
) -> int:
    """Make a certificate for 30 days; for a pilot also a key that signs orders.

    Args:
        kind: What it is for.
        name: Of the aircraft, the pilot or the router, as the file of rights has it.
        folder: Of the authority.
        host: Name or address by which a router is reached; several times for several.
        force: Write over the certificate of that name; a pilot's signing key stays.
        json: One JSON object instead of text; the default when output is not a terminal.
    """
    now = datetime.now(UTC)
    return _tell(make_certificate(folder, kind, name, now=now, hosts=host, force=force), json)


def _tell(made: Issued, json: bool | None) -> int:
    facts: dict[str, Any] = {
        "certificate": str(made.certificate),
        "key": str(made.key),
        "ends": made.ends.isoformat(timespec="seconds"),
    }
    if made.signing_key is not None:
        facts |= {"signing_key": str(made.signing_key), "public_key": made.public_key}
    if _as_json(json):
        print_json(facts)
    else:
        _say([f"{name.replace('_', ' ')}: {value}" for name, value in facts.items()])
    return ExitCode.OK


def _as_json(json: bool | None) -> bool:
    return (not sys.stdout.isatty()) if json is None else json


def _say(lines: list[str]) -> None:
    from m100link.cli.common import out

    for line in lines:
        out.print(line, markup=False, soft_wrap=True)


@acl.command
def check(
    file: File,
    /,
    *,
    who: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    json: AsJson = None,
) -> int:
    """Say what identities may do with each aircraft.

    Args:
        file: A file of rights, TOML.
        who: Name of an identity, several times for several; all of them by default.
        json: One JSON object for each instead of text; the default when output is no terminal.
    """
    rights = Rights.read(file)
    as_json = _as_json(json)
    for name in who or tuple(rights.identities):
        one = rights.identity(name)
        if one is None:
            raise BadRights(
                f"nobody in {file} is called {name}",
                cause="agents and routers know nobody of that name: all is refused",
                remedy=f"one of {', '.join(rights.identities) or 'none'}",
            )
        found = explain(rights, name)
        if as_json:
            may = {aircraft: right and right.name.lower() for aircraft, right in found}
            signs = one.public_key is not None
            print_json({"who": name, "certificate": one.common_name, "signs": signs, "may": may})
            continue
        signs_text = "signs orders" if one.public_key else "signs nothing: agents obey no order"
        _say([f"{name} (certificate {one.common_name}, {signs_text})"])
        _say([f"  {aircraft}: {_words(right)}" for aircraft, right in found])
    return ExitCode.OK


_MAY = {Right.WATCH: "watch and fetch logs", Right.STOP: "stop", Right.FLY: "fly"}


def _words(right: Right | None) -> str:
    if right is None:
        return "nothing"
    return ", ".join(_MAY[one] for one in Right if one <= right)


@acl.command
def zenoh(file: File, target: File, /, *, force: bool = False) -> int:
    """Write the rules of a router of zenoh that a file of rights means.

    They are the value of access_control in its configuration. The router knows everybody by the
    common name of the certificate, so it has to ask for one.

    Args:
        file: A file of rights, TOML.
        target: The JSON file to write; - is standard output.
        force: Write over a file that is there.
    """
    text = json.dumps({"access_control": router_config(Rights.read(file))}, indent=2) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
        return ExitCode.OK
    require_free(target, force=force)
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{target} cannot be written: {error.strerror}", remedy="name another file"
        ) from error
    return ExitCode.OK
