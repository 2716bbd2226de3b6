"""``m100link fleet router`` and ``fleet agent``: what runs beside the pilots."""

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
from m100link.apps.cli.common import Told, err, layer_of_settings, run_async
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
from m100link.apps.cli.options import (
    Above0,
    AsJson,
    Counted,
    Force,
    Json,
    group,
)
from m100link.apps.cli.plan import File
from m100link.apps.cli.serve import (
    AS_USUAL,
    IN_BROWSER,
    MOST_UNTOLD,
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
from m100link.apps.fleet.signing import tls_options, verifying
from m100link.apps.station.config import ONLY_NAME, Settings, resolve
from m100link.apps.station.fleet import (
    FleetSettings,
    default_ledgers,
    recorded_apart,
    serving_fleet,
    serving_fleet_console,
)
from m100link.apps.station.log_output import FlightProgress, tell_elsewhere
from m100link.apps.station.supervisor import leave_what_stays
from m100link.errors import UsageError

_FromSettings: Any = layer_of_settings(
    (
        *("baud_rate", "firmware", "timeout", "app_id", "key", "key_file", "level"),
        *("app_version", "bundle_id", "max_height", "max_radius", "keep_authority"),
        *("record", "no_record", "record_keep", "record_keep_mb"),
    )
)


@Parameter(name="*")
@dataclass(frozen=True)
class AgentOptions(_FromSettings):  # type: ignore[misc] # a class that is made has no type
    """Where the aircraft is, how far it may fly, and where its flights are recorded.

    Each aircraft has a folder of its name in that of the logs.

    Attributes:
        run: How the agent is run and told of.
    """

    run: RunOptions = AS_USUAL


def router(
    *,
    listen: tuple[str, ...] = (ROUTER,),
    connect: tuple[str, ...] = (),
    name: str = "router",
    pki: Annotated[Path | None, Parameter(env_var="M100LINK_PKI")] = None,
    rights: Path | None = None,
    json_output: Json = False,
    log: LogOptions = AS_IT_IS,
) -> int:
    """Be the router that agents and pilots connect to, until Ctrl-C. Any zenohd does as well.

    Everybody who reaches it can fly every aircraft behind it: let it listen on loopback, in a
    network of your own, or behind certificates.

    Args:
        listen: Where, such as tcp/0.0.0.0:7447, or tls/… with --pki; several times for several.
        connect: Endpoint of another router, so that whoever is at one meets who is at the other;
            several times for several. They begin in any order.
        name: Of its certificate.
        pki: Folder with its certificate and key (M100LINK_PKI): who comes by tls/ needs one, too.
        rights: File of rights: what it does not allow is not routed. Needs --pki, because who
            somebody is stands in the certificate. Who is in revoked.list there may do nothing; a
            newer list counts from the next start.
    """
    options = {} if pki is None else tls_options(pki, name, listens=True)
    if rights is not None and connect:
        raise UsageError(
            "the rules of --rights know no other router: nothing would pass between the two",
            remedy="let agents and pilots --connect to both, without a way between them",
        )
    if rights is not None:
        if pki is None or not all(place.startswith("tls/") for place in listen):
            raise UsageError(
                "the rules of --rights know everybody by a certificate",
                remedy="--pki FOLDER, and --listen tls/… alone",
            )
        revoked = Revocations.of_folder(pki).revoked
        options["access_control"] = json.dumps(
            router_config(Rights.read(rights).without(revoked.names))
        )

    async def run() -> None:
        ended = Told()
        async with open_fleet("router", listen=listen, connect=connect, options=options):
            tell({"listen": list(listen)}, f"router: {', '.join(listen)}", as_json=json_output)
            await ended.wait()

    return run_async(run())


def agent(
    *url: Urls,
    name: str = "a1",
    count: Annotated[int, Counted] = 1,
    connect: Annotated[tuple[str, ...], Parameter(env_var="M100LINK_FLEET")] = (ROUTER,),
    site: Annotated[str, Parameter(env_var="M100LINK_SITE")] = DEFAULT_SITE,
    lost: LostAction = "hover",
    lost_after: float = 10.0,
    ledger: Path | None = None,
    pki: Annotated[Path | None, Parameter(env_var="M100LINK_PKI")] = None,
    rights: Path | None = None,
    log_rate: Annotated[float, Above0] = RATE / 1e6,
    options: AgentOptions = AgentOptions(),
) -> int:
    """Own an aircraft on board and serve it to a fleet, until Ctrl-C.

    When the operator falls silent, the last setpoint ends after 0.2 s and the aircraft brakes; from
    3 m/s it takes more than a second to hover. The lease ends after 3 s; then --lost applies.

    Args:
        name: What it is called in the fleet.
        count: So many virtual ones of sim://, called NAME1, NAME2 and so on.
        connect: Endpoint of a router (M100LINK_FLEET); several times for several.
        site: Name of the site (M100LINK_SITE).
        lost: What happens when the pilot is lost: hover, land or home.
        lost_after: Seconds of hovering before that.
        ledger: Folder in which orders that were begun are kept, so that none is carried out twice
            when the agent is killed; by default in the user's folder for the state of programs,
            and nowhere for virtual aircraft.
        pki: Folder with its certificate and key, for a router behind tls/ (M100LINK_PKI).
        rights: File of rights: orders that are not signed by who may are refused. With --pki so
            are those of who is in revoked.list there, which fleet pki push brings up to date.
        log_rate: Megabytes of flight logs a second that each aircraft gives away at most.
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
    kept = ledger or (None if is_virtual else default_ledgers())
    fleet = FleetSettings(
        connect, site, LostLinkPlan(lost, lost_after), kept, log_rate=log_rate * 1e6
    )
    if pki is not None:
        fleet = replace(fleet, options=tls_options(pki, name))
    if rights is not None:
        fleet = replace(fleet, **_checking(Rights.read(rights), aircraft, pki))
    return run_async(_serve(aircraft, fleet, options.run))


def _checking(rights: Rights, names: Iterable[str], pki: Path | None) -> dict[str, Any]:
    """What agents look at orders with, and whom they believe nothing any more."""
    found = None if pki is None else Revocations.of_folder(pki, rights)
    revoked = nobody if found is None else found.since
    return {"verify": verifying(rights, names, time.time, revoked), "revocations": found}


async def _serve(aircraft: dict[str, Settings], fleet: FleetSettings, run: RunOptions) -> int:
    ended = Told()
    tell_elsewhere(JOURNAL_LOG)
    with FlightProgress("talk", MOST_UNTOLD) as teller:
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
    """Who may open the page."""


def console(
    *names: str,
    options: FleetOptions = NO_OPTIONS,
    page: PageOptions = IN_BROWSER,
    access: AccessOptions = AccessOptions(),
) -> int:
    """Serve the console for a fleet, until Ctrl-C: all on a list and a map, one to look at and fly.

    Without names it shows whoever is there and whoever comes. What is steered flies on board, under
    the lease and the guards of that aircraft's agent. The one that is looked at sends every
    package, the others what suffices for a wall. When this ends, control that was taken here is
    given back: that aircraft hovers.

    Args:
        names: Names of aircraft.
    """
    known = {one.name for one in fields(Settings)}
    asked = {**vars(page), **vars(access)}
    given = {name: value for name, value in asked.items() if name in known and value != ()}
    settings = resolve(given, os.environ)
    require_packages()
    return run_async(_serve_console(names, options, settings, is_opened=page.open_browser))


async def _serve_console(
    names: tuple[str, ...], options: FleetOptions, settings: Settings, *, is_opened: bool
) -> int:
    ended = Told()
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


# -- ``m100link fleet pki`` and ``fleet acl``: certificates of a fleet, and who may do what in  ----


pki = group(
    "pki", "Certificates and signing keys of a fleet: an authority of its own, and what it issues."
)
acl = group(
    "acl", "Who may do what with which aircraft: look at a file of rights, make a router's rules."
)

Pki = Annotated[Path | None, Parameter(env_var="M100LINK_PKI")]


@pki.command
def init(folder: Path, /, *, force: bool = False, json: AsJson = None) -> int:
    """Make an authority: the key that every certificate of the fleet comes from.

    Whoever has ca.key can be anybody. Keep the folder on a machine that does not fly.

    Args:
        folder: Where its files go; for you alone.
        force: Write over an authority that is there. All that it issued is worth nothing then.
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
    """Make a certificate for 30 days; for a pilot also a key that signs orders.

    Args:
        kind: What it is for.
        name: Of the aircraft, the pilot or the router, as the file of rights has it.
        folder: Of the authority.
        host: Name or address by which a router is reached; several times for several.
        force: Write over the certificate of that name; a pilot's signing key stays.
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
    """
    if not names:
        raise UsageError("nobody is named", remedy="m100link fleet pki revoke NAME --folder FOLDER")
    found = revoke_names(folder, names, now=datetime.now(UTC))
    return tell(
        {"number": found.number, "names": dict(found.names)},
        f"{folder / LIST}: list {found.number}",
        *(f"  {name}: revoked since {since}" for name, since in found.names.items()),
        "m100link fleet pki push --all brings it to the agents; start routers anew with it",
        as_json=wants_json(json),
    )


@pki.command(name="list")
def list_(*, folder: Path = Path(), json: AsJson = None) -> int:
    """List the certificates of a folder: when each ends, and who is revoked.

    Args:
        folder: Of the authority, or of whoever has its own there.
    """
    for name, ends, since in listed(folder):
        facts = {"name": name, "ends": ends.isoformat(), "revoked": since or None}
        over = " already" if ends <= datetime.now(UTC) else ""
        text = f"revoked since {since}" if since else f"ends{over} {ends:%Y-%m-%d}"
        tell(facts, f"{name}: {text}", as_json=wants_json(json))
    return ExitCode.OK


@pki.command
def push(
    *names: Names,
    everybody: All = False,
    folder: Path | None = None,
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
    place = (options.pki if folder is None else folder) / LIST
    try:
        data = place.read_bytes()
    except OSError as error:
        raise UsageError(
            f"{place} cannot be read: {error.strerror}", remedy="m100link fleet pki revoke makes it"
        ) from error

    async def run() -> int:
        pushed = results_of(names, everybody, options, lambda one: bring(one.bus, one.keys, data))
        return tell_results(await pushed, options)

    return run_async(run())


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
    """Say what identities may do with each aircraft.

    Args:
        file: A file of rights, TOML.
        who: Name of an identity, several times for several; all of them by default.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): who is revoked may do nothing.
    """
    rights = Rights.read(file)
    as_json = wants_json(json)
    revocations = None if pki is None else Revocations.of_folder(pki, rights)
    for name in who or tuple(rights.identities):
        one = rights.identities.get(name)
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
    """Write the rules of a router of zenoh that a file of rights means.

    They are the value of access_control in its configuration. The router knows everybody by the
    common name of the certificate, so it has to ask for one.

    Args:
        file: A file of rights, TOML.
        target: The JSON file to write; - is standard output.
        pki: Folder with revoked.list and ca.pem (M100LINK_PKI): who is revoked has no rules.
    """
    rights = Rights.read(file)
    if pki is not None:
        rights = rights.without(Revocations.of_folder(pki).revoked.names)
    text = json.dumps({"access_control": router_config(rights)}, indent=2) + "\n"
    write_out(target, text, force=force)
    return ExitCode.OK
