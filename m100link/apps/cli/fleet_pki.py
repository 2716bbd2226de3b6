"""``m100link fleet pki`` and ``fleet acl``: certificates of a fleet, and who may do what in it."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import cyclopts
from cyclopts import Parameter

from m100link.apps.cli.common import err, run_async
from m100link.apps.cli.fleet import NO_OPTIONS, All, FleetOptions, Names, tell_results, wanted_names
from m100link.apps.cli.outcome import ExitCode, print_json
from m100link.apps.cli.plan import File, require_free
from m100link.apps.fleet.identity import BadRights, Right, Rights
from m100link.apps.fleet.pki import Issued, Kind, explain, listed, router_config
from m100link.apps.fleet.pki import init as make_authority
from m100link.apps.fleet.pki import issue as make_certificate
from m100link.apps.fleet.pki import revoke as revoke_names
from m100link.apps.fleet.revocations import LIST, Revocations, bring
from m100link.errors import UsageError

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

Pki = Annotated[Path | None, Parameter(env_var="M100LINK_PKI")]
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


@pki.command
def revoke(
    *names: Annotated[str, Parameter(help="Names of certificates: of pilots, aircraft, routers.")],
    folder: Path = Path(),
    json: AsJson = None,
) -> int:
    """Shut out who lost a key before the certificate ends; for good, under that name.

    Writes revoked.list, which the authority signs. Bring it to the agents by fleet pki push and
    start routers anew with it: nothing else tells them.

    Args:
        names: Which.
        folder: Of the authority.
        json: One JSON object instead of text; the default when output is not a terminal.
    """
    if not names:
        raise UsageError("nobody is named", remedy="m100link fleet pki revoke NAME --folder FOLDER")
    found = revoke_names(folder, names, now=datetime.now(UTC))
    if _as_json(json):
        print_json({"number": found.number, "names": dict(found.names)})
        return ExitCode.OK
    _say([f"{folder / LIST}: list {found.number}"])
    _say([f"  {name}: revoked since {since}" for name, since in found.names.items()])
    _say(["m100link fleet pki push --all brings it to the agents; start routers anew with it"])
    return ExitCode.OK


@pki.command(name="list")
def list_(*, folder: Path = Path(), json: AsJson = None) -> int:
    """List the certificates of a folder: when each ends, and who is revoked.

    Args:
        folder: Of the authority, or of whoever has its own there.
        json: One JSON object for each instead of text; the default when output is no terminal.
    """
    for name, ends, since in listed(folder):
        if _as_json(json):
            told = {"name": name, "ends": ends.isoformat(), "revoked": since or None}
            print_json(told)
            continue
        over = " already" if ends <= datetime.now(UTC) else ""
        text = f"revoked since {since}" if since else f"ends{over} {ends:%Y-%m-%d}"
        _say([f"{name}: {text}"])
    return ExitCode.OK


@pki.command
def push(
    *names: Names,
    everybody: All = False,
    folder: Annotated[Path | None, Parameter(negative="")] = None,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Bring revoked.list to agents: whoever is in it steers no more, and what he flew hovers.

    Who may stop an aircraft may bring it there. An aircraft that is not there has the list before:
    bring it once more when it is back.

    Args:
        names: Which aircraft.
        everybody: All that are there.
        folder: With revoked.list; that of --pki by default.
    """
    wanted = wanted_names(names, everybody)
    place = (options.pki if folder is None else folder) / LIST
    try:
        data = place.read_bytes()
    except OSError as error:
        raise UsageError(
            f"{place} cannot be read: {error.strerror}", remedy="m100link fleet pki revoke makes it"
        ) from error

    async def run() -> int:
        async with options.open() as fleet:
            results = await fleet.each(lambda one: bring(fleet.bus, one.keys, data), wanted)
        if not results:
            err.print(f"no agent is there at site {options.site}")
            return ExitCode.NO_LINK
        return tell_results(results, as_json=options.json_output)

    return run_async(run())


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
    from m100link.apps.cli.common import out

    for line in lines:
        out.print(line, markup=False, soft_wrap=True)


@acl.command
def check(
    file: File,
    /,
    *,
    who: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    pki: Pki = None,
    json: AsJson = None,
) -> int:
    """Say what identities may do with each aircraft.

    Args:
        file: A file of rights, TOML.
        who: Name of an identity, several times for several; all of them by default.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): who is revoked may do nothing.
        json: One JSON object for each instead of text; the default when output is no terminal.
    """
    rights = Rights.read(file)
    as_json = _as_json(json)
    revocations = None if pki is None else Revocations.of_folder(pki, rights)
    for name in who or tuple(rights.identities):
        one = rights.identity(name)
        if one is None:
            raise BadRights(
                f"nobody in {file} is called {name}",
                cause="agents and routers know nobody of that name: all is refused",
                remedy=f"one of {', '.join(rights.identities) or 'none'}",
            )
        found = explain(rights, name)
        since = "" if revocations is None else revocations.since(name)
        if since:
            found = [(aircraft, None) for aircraft, _ in found]
        if as_json:
            may = {aircraft: right and right.name.lower() for aircraft, right in found}
            signs = one.public_key is not None
            told = {"who": name, "certificate": one.common_name, "signs": signs, "may": may}
            print_json(told | ({"revoked": since} if since else {}))
            continue
        signs_text = "signs orders" if one.public_key else "signs nothing: agents obey no order"
        signs_text = f"revoked since {since}" if since else signs_text
        _say([f"{name} (certificate {one.common_name}, {signs_text})"])
        _say([f"  {aircraft}: {_words(right)}" for aircraft, right in found])
    return ExitCode.OK


_MAY = {Right.WATCH: "watch and fetch logs", Right.STOP: "stop", Right.FLY: "fly"}


def _words(right: Right | None) -> str:
    if right is None:
        return "nothing"
    return ", ".join(_MAY[one] for one in Right if one <= right)


@acl.command
def zenoh(file: File, target: File, /, *, pki: Pki = None, force: bool = False) -> int:
    """Write the rules of a router of zenoh that a file of rights means.

    They are the value of access_control in its configuration. The router knows everybody by the
    common name of the certificate, so it has to ask for one.

    Args:
        file: A file of rights, TOML.
        target: The JSON file to write; - is standard output.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): who is revoked has no rules.
        force: Write over a file that is there.
    """
    rights = Rights.read(file)
    if pki is not None:
        rights = rights.without(Revocations.of_folder(pki).revoked.names)
    text = json.dumps({"access_control": router_config(rights)}, indent=2) + "\n"
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
