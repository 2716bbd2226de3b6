"""``m100link fleet router``, ``agent``, ``console``, ``pki`` and ``acl``: set up a fleet."""

from __future__ import annotations

import asyncio
import json
import os
import time
import webbrowser
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.agent.messages import JOURNAL_LOG
from m100link.apps.agent.orders import Right
from m100link.apps.cli.common import Ended, err, layer_of_settings
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    ROUTER,
    All,
    FleetOptions,
    Names,
    results_of,
    tell,
    tell_results,
    write_out,
)
from m100link.apps.cli.options import Above0, AsJson, Counted, Force, Json, group
from m100link.apps.cli.plan import File
from m100link.apps.cli.serve import (
    AS_USUAL,
    IN_BROWSER,
    MOST_UNWRITTEN,
    OF_THE_AIRCRAFT,
    PageOptions,
    RunOptions,
    Urls,
    aircraft_of,
    require_packages,
    show,
    tell_event,
    warn_of,
)
from m100link.apps.cli.terminal import AS_IT_IS, ExitCode, LogOptions, wants_json
from m100link.apps.fleet.client import open_fleet
from m100link.apps.fleet.identity import BadRights, Rights, nobody
from m100link.apps.fleet.keys import DEFAULT_SITE
from m100link.apps.fleet.logs.service import RATE
from m100link.apps.fleet.lost_link import LostAction, LostLinkPlan
from m100link.apps.fleet.pki import Issued, Kind, explain, listed, router_config
from m100link.apps.fleet.pki import init as make_authority
from m100link.apps.fleet.pki import issue as make_certificate
from m100link.apps.fleet.pki import revoke as revoke_names
from m100link.apps.fleet.revocations import LIST, Revocations, bring
from m100link.apps.fleet.signing import Seal, tls_options, verifying
from m100link.apps.station.config import ONLY_NAME, Settings, resolve
from m100link.apps.station.fleet import (
    FleetSettings,
    default_order_logs,
    recorded_apart,
    serving_fleet,
    serving_fleet_console,
)
from m100link.apps.station.log_output import FlightProgress, tell_elsewhere
from m100link.apps.station.supervisor import leave_what_stays
from m100link.errors import UsageError

_FromSettings: Any = layer_of_settings(OF_THE_AIRCRAFT)


@Parameter(name="*")
@dataclass(frozen=True)
class AgentOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, how far it may fly, and where its flights are recorded.

    Each aircraft has a folder of its name in the folder of the logs.

    Attributes:
        run: How the agent runs and reports.
    """

    run: RunOptions = AS_USUAL


async def router(
    *,
    listen: tuple[str, ...] = (ROUTER,),
    connect: tuple[str, ...] = (),
    name: str = "router",
    pki: Annotated[Path | None, Parameter(env_var="M100LINK_PKI")] = None,
    rights: Path | None = None,
    json_output: Json = False,
    log: LogOptions = AS_IT_IS,
) -> None:
    """Run the router that agents and operators connect to, until Ctrl-C. A zenohd works, too.

    Everybody who reaches it can fly every aircraft behind it: let it listen on loopback, in a
    network of your own, or behind certificates.

    Args:
        listen: Where to listen, such as tcp/0.0.0.0:7447, or tls/… with --pki; may be repeated.
        connect: Endpoint of another router to link with, so that clients of both see each other;
            may be repeated. Routers may start in any order.
        name: Name of its certificate.
        pki: Folder with its certificate and key (M100LINK_PKI). Clients by tls/ need one, too.
        rights: File of rights: the router passes on only what it allows. Needs --pki, because the
            router knows clients by their certificates. Names in revoked.list there have no rights;
            the router reads a newer list at its next start.
    """
    options = {} if pki is None else tls_options(pki, name, listens=True)
    if rights is not None and connect:
        raise UsageError(
            "--rights and linked routers cannot be combined: nothing would pass between the two",
            remedy="let agents and operators --connect to both routers, and do not link them",
        )
    if rights is not None:
        if pki is None or not all(place.startswith("tls/") for place in listen):
            raise UsageError(
                "--rights needs certificates: the router knows clients by them",
                remedy="--pki FOLDER, and only --listen tls/…",
            )
        revoked = Revocations.of_folder(pki).revoked
        options["access_control"] = json.dumps(
            router_config(Rights.read(rights).without(revoked.names))
        )
    ended = Ended()
    async with open_fleet("router", listen=listen, connect=connect, options=options):
        tell({"listen": list(listen)}, f"router: {', '.join(listen)}", as_json=json_output)
        await ended.wait()


async def agent(
    *url: Urls,
    name: str = "a1",
    count: Annotated[int, Counted] = 1,
    connect: Annotated[tuple[str, ...], Parameter(env_var="M100LINK_FLEET")] = (ROUTER,),
    site: Annotated[str, Parameter(env_var="M100LINK_SITE")] = DEFAULT_SITE,
    lost: LostAction = "hover",
    lost_after: float = 10.0,
    order_log: Path | None = None,
    pki: Annotated[Path | None, Parameter(env_var="M100LINK_PKI")] = None,
    rights: Path | None = None,
    log_rate: Annotated[float, Above0] = RATE / 1e6,
    options: AgentOptions = AgentOptions(),
) -> int:
    """Own an aircraft on board and serve it to a fleet, until Ctrl-C.

    When the operator falls silent, the last setpoint ends after 0.2 s and the aircraft brakes; from
    3 m/s it takes more than a second to hover. The lease ends after 3 s; then --lost applies.

    Args:
        name: Name of the aircraft in the fleet.
        count: Number of virtual aircraft of sim://, called NAME1, NAME2 and so on.
        connect: Endpoint of a router (M100LINK_FLEET); may be repeated.
        site: Name of the site (M100LINK_SITE).
        lost: Action of the aircraft when its operator is lost: hover, land or home.
        lost_after: Seconds of hovering before that.
        order_log: Folder in which the agent records orders that it begins, so that none runs twice
            after a restart; by default in the user's state folder, for real aircraft only.
        pki: Folder with its certificate and key, for a router behind tls/ (M100LINK_PKI).
        rights: File of rights: the agent refuses orders that are not signed by an identity with the
            right to them. With --pki it also refuses those of names in revoked.list there, which
            fleet pki push updates.
        log_rate: Megabytes of flight logs per second that each aircraft sends at most.
    """
    words = url
    if count > 1:
        if url != ("sim://",):
            raise UsageError("--count is for virtual aircraft", remedy="give sim:// as URL")
        words = tuple(f"{name}{number}=sim://" for number in range(1, count + 1))
    aircraft = aircraft_of(options, words)
    if ONLY_NAME in aircraft:
        aircraft = {name: aircraft[ONLY_NAME]}
    aircraft = {called: recorded_apart(one, called) for called, one in aircraft.items()}
    if options.run.show_config:
        for settings in aircraft.values():
            show(settings)
        return ExitCode.OK
    is_virtual = all(settings.sim for settings in aircraft.values())
    kept = order_log or (None if is_virtual else default_order_logs())
    fleet = FleetSettings(
        connect, site, LostLinkPlan(lost, lost_after), kept, log_rate=log_rate * 1e6
    )
    if pki is not None:
        fleet = replace(
            fleet,
            options=tls_options(pki, name),
            seals={called: Seal.read(pki, called) for called in aircraft},
            authority=Revocations.of_folder(pki),
        )
    if rights is not None:
        fleet = replace(fleet, **_checking(Rights.read(rights), aircraft, pki))
    return await _serve(aircraft, fleet, options.run)


def _checking(rights: Rights, names: Iterable[str], pki: Path | None) -> dict[str, Any]:
    """How agents verify orders, and the names that are revoked."""
    found = None if pki is None else Revocations.of_folder(pki, rights)
    revoked = nobody if found is None else found.since
    known = {} if found is None else {"revocations": found, "authority": found}
    return {"verify": verifying(rights, names, time.time, revoked), **known}


async def _serve(aircraft: dict[str, Settings], fleet: FleetSettings, run: RunOptions) -> int:
    ended = Ended()
    tell_elsewhere(JOURNAL_LOG)
    with FlightProgress("talk", MOST_UNWRITTEN) as teller:
        async with serving_fleet(aircraft, fleet, partial(tell_event, teller, run.log)) as agents:
            words = f"fleet:     {fleet.site}: {', '.join(agents)}"
            facts = {"fleet": fleet.site, "agents": list(agents)}
            tell(facts, words, as_json=run.json_output)
            leave_what_stays()
            await ended.wait()
            teller.do(lambda: err.print("ending: an aircraft that flies hovers"))
    return ExitCode.OK


# -- ``m100link fleet console``: a page in the browser for aircraft that are elsewhere -------------


@Parameter(name="*")
@dataclass(frozen=True)
class AccessOptions(
    layer_of_settings(  # type: ignore[misc] # a class that is made has no type
        ("host", "allow_host", "allow_origin", "token_file", "tls_cert", "tls_key")
    )
):
    """The access to the page."""


async def console(
    *names: Names,
    options: FleetOptions = NO_OPTIONS,
    page: PageOptions = IN_BROWSER,
    access: AccessOptions = AccessOptions(),
) -> int:
    """Serve the console of a fleet, until Ctrl-C: a list and a map of all, one aircraft to fly.

    Without names it shows all aircraft that are present and those that appear later. The agent on
    board flies what you steer, under its lease and its guards. The aircraft that you look at sends
    every package, the others each item five times a second. When the command ends, it gives control
    back: the aircraft that was flown hovers.
    """
    known = {one.name for one in fields(Settings)}
    asked = {**vars(page), **vars(access)}
    given = {name: value for name, value in asked.items() if name in known and value != ()}
    settings = resolve(given, os.environ)
    require_packages()
    return await _serve_console(names, options, settings, is_opened=page.open_browser)


async def _serve_console(
    names: tuple[str, ...], options: FleetOptions, settings: Settings, *, is_opened: bool
) -> int:
    ended = Ended()
    async with options.open() as fleet, serving_fleet_console(fleet, settings, names) as served:
        scheme = "http" if settings.tls_cert is None else "https"
        path, shown = served.console_path(), list(served.agents)
        url = f"{scheme}://{settings.authority(served.sockets.port('console'))}{path}"
        words = f"console:   {url}", f"aircraft:  {', '.join(shown)}"
        tell({"console": url, "aircraft": shown}, *words, as_json=options.json_output)
        warn_of(settings)
        if is_opened:
            await asyncio.to_thread(webbrowser.open, url)
        await ended.wait()
        err.print("ending: an aircraft that was flown from here hovers")
    return ExitCode.OK


# -- ``m100link fleet pki`` and ``fleet acl``: certificates, and who may do what -------------------


pki = group("pki", "Certificates and signing keys of a fleet, and an authority that issues them.")
acl = group(
    "acl", "Check a file of rights (who may do what with which aircraft); write a router's rules."
)

Pki = Annotated[Path | None, Parameter(env_var="M100LINK_PKI")]


@pki.command
def init(folder: Path, /, *, force: bool = False, json: AsJson = None) -> int:
    """Make an authority: the key that every certificate of the fleet comes from.

    Anybody who has ca.key can issue certificates in any name. Keep the folder on a machine that
    does not fly.

    Args:
        folder: Folder for its files; readable by you alone.
        force: Overwrite an existing authority. All certificates that it issued become worthless.
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
    host: tuple[str, ...] = (),
    force: bool = False,
    json: AsJson = None,
) -> int:
    """Make a certificate for 30 days; for a pilot (an operator) also a key that signs orders.

    Args:
        kind: Whether it is for a router, an agent, or a pilot: a remote operator.
        name: Name of the aircraft, the operator or the router, as in the file of rights.
        folder: Folder of the authority.
        host: Name or address by which a router is reached; may be repeated.
        force: Overwrite the certificate of that name; an operator's signing key stays.
    """
    now = datetime.now(UTC)
    return _tell(make_certificate(folder, kind, name, now=now, hosts=host, force=force), json)


@pki.command
def revoke(
    *names: Annotated[str, Parameter(help="Certificates of operators, aircraft or routers.")],
    folder: Path = Path(),
    json: AsJson = None,
) -> int:
    """Revoke certificates and keys before they expire; a revoked name stays revoked.

    The command writes revoked.list, which the authority signs. Then bring the list to the agents by
    fleet pki push, and restart routers with it: nothing else informs them.

    Args:
        names: Names of certificates.
        folder: Folder of the authority.
    """
    if not names:
        raise UsageError(
            "no name is given", remedy="m100link fleet pki revoke NAME --folder FOLDER"
        )
    found = revoke_names(folder, names, now=datetime.now(UTC))
    return tell(
        {"number": found.number, "names": dict(found.names)},
        f"{folder / LIST}: list {found.number}",
        *(f"  {name}: revoked since {since}" for name, since in found.names.items()),
        "m100link fleet pki push --all brings it to the agents; restart routers with it",
        as_json=wants_json(json),
    )


@pki.command(name="list")
def list_(*, folder: Path = Path(), json: AsJson = None) -> int:
    """List the certificates in a folder: when each expires, and which are revoked.

    Args:
        folder: Folder of the authority, or another one with certificates and ca.pem.
    """
    for name, ends, since in listed(folder):
        facts = {"name": name, "ends": ends.isoformat(), "revoked": since or None}
        over = "d" if ends <= datetime.now(UTC) else "s"
        text = f"revoked since {since}" if since else f"expire{over} {ends:%Y-%m-%d}"
        tell(facts, f"{name}: {text}", as_json=wants_json(json))
    return ExitCode.OK


@pki.command
async def push(
    *names: Names,
    everybody: All = False,
    folder: Path | None = None,
    options: FleetOptions = NO_OPTIONS,
) -> int:
    """Bring revoked.list to agents: they refuse revoked operators, whose aircraft hover.

    It needs the right to stop the aircraft. An aircraft that is absent keeps its older list: push
    again when it is back.

    Args:
        everybody: All that are present.
        folder: Folder with revoked.list; that of --pki by default.
    """
    place = (options.pki if folder is None else folder) / LIST
    try:
        data = place.read_bytes()
    except OSError as error:
        raise UsageError(
            f"{place} cannot be read: {error.strerror}",
            remedy="m100link fleet pki revoke writes it",
        ) from error
    pushed = results_of(names, everybody, options, lambda one: bring(one.bus, one.keys, data))
    return tell_results(await pushed, options)


def _tell(made: Issued, json: bool | None) -> int:
    facts: dict[str, Any] = {
        "certificate": str(made.certificate),
        "key": str(made.key),
        "ends": made.ends.isoformat(timespec="seconds"),
    }
    if made.signing_key is not None:
        facts |= {"signing_key": str(made.signing_key), "public_key": made.public_key}
    lines = (f"{name.replace('_', ' ')}: {value}" for name, value in facts.items())
    return tell(facts, *lines, as_json=wants_json(json))


@acl.command
def check(
    file: File,
    /,
    *,
    who: tuple[str, ...] = (),
    pki: Pki = None,
    json: AsJson = None,
) -> int:
    """List what each identity may do with each aircraft.

    Args:
        file: A file of rights, TOML.
        who: Name of an identity; may be repeated. All identities by default.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): revoked names have no rights.
    """
    rights = Rights.read(file)
    as_json = wants_json(json)
    revocations = None if pki is None else Revocations.of_folder(pki, rights)
    for name in who or tuple(rights.identities):
        one = rights.identities.get(name)
        if one is None:
            raise BadRights(
                f"{file} has no identity {name}",
                cause="agents and routers refuse everything from an unknown name",
                remedy=f"name one of {', '.join(rights.identities) or 'none'}",
            )
        found = explain(rights, name)
        since = "" if revocations is None else revocations.since(name)
        if since:
            found = [(aircraft, None) for aircraft, _ in found]
        may = {aircraft: right and right.name.lower() for aircraft, right in found}
        signs = one.public_key is not None
        facts = {"who": name, "certificate": one.common_name, "signs": signs, "may": may}
        signs_text = "signs orders" if signs else "signs nothing: agents obey no order"
        signs_text = f"revoked since {since}" if since else signs_text
        tell(
            facts | ({"revoked": since} if since else {}),
            f"{name} (certificate {one.common_name}, {signs_text})",
            *(f"  {aircraft}: {_words(right)}" for aircraft, right in found),
            as_json=as_json,
        )
    return ExitCode.OK


_MAY = {Right.WATCH: "watch and fetch logs", Right.STOP: "stop", Right.FLY: "fly"}


def _words(right: Right | None) -> str:
    if right is None:
        return "nothing"
    return ", ".join(_MAY[one] for one in Right if one <= right)


@acl.command
def zenoh(file: File, target: File, /, *, pki: Pki = None, force: Force = False) -> int:
    """Write the rules of a zenoh router from a file of rights.

    They are the value of access_control in its configuration. The router knows clients by the
    common name of the certificate, so it has to ask for one.

    Args:
        file: A file of rights, TOML.
        target: The JSON file to write; - is standard output.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): revoked names get no rules.
    """
    rights = Rights.read(file)
    if pki is not None:
        rights = rights.without(Revocations.of_folder(pki).revoked.names)
    text = json.dumps({"access_control": router_config(rights)}, indent=2) + "\n"
    write_out(target, text, force=force)
    return ExitCode.OK
