"""``m100link fleet``: a fleet of one file, a router, an agent, a console, certificates, rights."""

from __future__ import annotations

import asyncio
import json
import os
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from m100link.apps.agent.messages import JOURNAL_LOG
from m100link.apps.agent.orders import Right
from m100link.apps.cli.common import ended_by_signal, err, layer_of_settings
from m100link.apps.cli.fleet import (
    NO_OPTIONS,
    ROUTER,
    All,
    FleetOptions,
    Names,
    results_of,
    say,
    tell_results,
    write_out,
)
from m100link.apps.cli.options import Above0, Counted, Force, group
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
from m100link.apps.cli.terminal import AS_IT_IS, ExitCode, LogOptions, as_json, print_json, tell
from m100link.apps.fleet.client import FleetAircraft, open_fleet
from m100link.apps.fleet.identity import BadRights, Rights
from m100link.apps.fleet.keys import DEFAULT_SITE
from m100link.apps.fleet.logs.service import RATE
from m100link.apps.fleet.lost_link import LostAction, LostLinkPlan
from m100link.apps.fleet.pki import BOARDS, explain, router_config
from m100link.apps.fleet.pki import make as make_certificates
from m100link.apps.fleet.pki import revoke as revoke_names
from m100link.apps.fleet.revocations import AUTHORITY, LIST, Revocations, in_force
from m100link.apps.station.config import ONLY_NAME, Settings, resolve
from m100link.apps.station.fleet import (
    FleetSettings,
    default_order_logs,
    recorded_apart,
    serving_fleet,
    serving_fleet_console,
)
from m100link.apps.station.fleet_file import examine, parts_of, running_part, running_parts
from m100link.apps.station.log_output import FlightProgress, tell_elsewhere
from m100link.apps.station.supervisor import leave_what_stays
from m100link.errors import UsageError

FleetFile = Annotated[Path, Parameter(help="A fleet file, TOML.")]

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
    log: LogOptions = AS_IT_IS,
) -> None:
    """Run a router without certificates, until Ctrl-C. A zenohd works, too.

    Everybody who reaches it can fly every aircraft behind it: let it listen on loopback or in a
    network of your own. `fleet up` runs routers behind certificates.

    Args:
        listen: Where to listen, such as tcp/0.0.0.0:7447; may be repeated.
        connect: Endpoint of another router to link with, so that clients of both see each other;
            may be repeated. Routers may start in any order.
    """
    ended = ended_by_signal()
    async with open_fleet("router", listen=listen, connect=connect):
        tell({"listen": list(listen)}, f"router: {', '.join(listen)}")
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
    log_rate: Annotated[float, Above0] = RATE / 1e6,
    options: AgentOptions = AgentOptions(),
) -> int:
    """Own an aircraft on board and serve it to a fleet without certificates, until Ctrl-C.

    `fleet up` does so for the aircraft of a fleet file, with certificates and signatures. When the
    operator falls silent, the last setpoint ends after 0.2 s and the aircraft brakes; from 3 m/s it
    takes more than a second to hover. The lease ends after 3 s; then --lost applies.

    Args:
        name: Name of the aircraft in the fleet.
        count: Number of virtual aircraft of sim://, called NAME1, NAME2 and so on.
        connect: Endpoint of a router (M100LINK_FLEET); may be repeated.
        site: Name of the site (M100LINK_SITE).
        lost: Action of the aircraft when its operator is lost: hover, land or home.
        lost_after: Seconds of hovering before that.
        order_log: Folder in which the agent records orders that it begins, so that none runs twice
            after a restart; by default in the user's state folder, for real aircraft only.
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
        for called, settings in aircraft.items():
            show(settings, called)
        return ExitCode.OK
    is_virtual = all(settings.is_virtual for settings in aircraft.values())
    kept = order_log or (None if is_virtual else default_order_logs())
    fleet = FleetSettings(
        connect, site, LostLinkPlan(lost, lost_after), kept, log_rate=log_rate * 1e6
    )
    return await _serve(aircraft, fleet, options.run)


async def _serve(aircraft: dict[str, Settings], fleet: FleetSettings, run: RunOptions) -> int:
    ended = ended_by_signal()
    tell_elsewhere(JOURNAL_LOG)
    with FlightProgress("talk", MOST_UNWRITTEN) as teller:
        async with serving_fleet(aircraft, fleet, partial(tell_event, teller, run.log)) as agents:
            words = f"fleet:     {fleet.site}: {', '.join(agents)}"
            facts = {"fleet": fleet.site, "agents": list(agents)}
            tell(facts, words)
            leave_what_stays()
            await ended.wait()
            teller.do(lambda: err.print("ending: an aircraft that flies hovers"))
    return ExitCode.OK


# -- ``m100link fleet make`` and ``up``: a fleet of one file ---------------------------------------


def make(file: FleetFile, /, *, renew: bool = False) -> int:
    """Make all that a fleet file needs, beside it: an authority, certificates, keys and boards.

    pki/ gets the certificates and keys, with the key of the authority: keep it on a machine that
    does not fly. boards/NAME gets what one machine needs. Good files stay.

    Args:
        renew: Renew all certificates, not only those that end within ten days. Signing keys stay.
    """
    rights = Rights.read(file)
    made = make_certificates(rights, now=datetime.now(UTC), renews=renew)
    facts = {"made": {name: ends.isoformat(timespec="seconds") for name, ends in made.items()}}
    lines = [f"{rights.pki / name}.pem: until {ends:%Y-%m-%d}" for name, ends in made.items()]
    lines.append(f"{file.parent / BOARDS}: a folder for each machine; m100link fleet up {file}")
    return tell(facts, *lines)


async def up(
    file: FleetFile,
    /,
    *names: Annotated[str, Parameter(help="Routers, aircraft, or console; by default all.")],
    real: bool = False,
    log: LogOptions = AS_IT_IS,
) -> int:
    """Run the routers, agents and console of a fleet file, until Ctrl-C; each in its own process.

    Then each aircraft that flies hovers, control goes back, and the routers end last. A process
    that ends by itself is started again; the others run on.

    Args:
        real: Own the aircraft at the url of each in the file; else virtual ones.
    """
    rights = Rights.read(file)
    unknown = [name for name in names if name not in parts_of(rights)]
    if unknown:
        raise UsageError(
            f"{file} has no {', '.join(unknown)}",
            remedy=f"name some of {', '.join(parts_of(rights)) or 'nothing: it is empty'}",
        )
    parts = {
        name: _settings_of(rights, name, is_real=real) if name in rights.aircraft else None
        for name in parts_of(rights)
        if not names or name in names
    }
    ended = ended_by_signal()
    tell_elsewhere(JOURNAL_LOG)
    with FlightProgress("talk", MOST_UNWRITTEN) as teller:
        if len(parts) == 1:
            [(name, settings)] = parts.items()
            said = partial(tell_event, teller, log)
            running: Any = running_part(file, name, settings, said, is_real=real)
        else:

            def note(text: str, level: str) -> None:
                teller.do(lambda: err.print(text, style="red" if level == "error" else None))

            running = running_parts(file, parts, note, is_real=real)
        async with running as facts:
            found: dict[str, Any] = facts if len(parts) > 1 else dict.fromkeys(parts, facts)
            lines = [f"{key}: {value}" for one in found.values() for key, value in one.items()]
            kind = "real" if real else "virtual"
            lines = [line for line in lines if not line.startswith("agent")]
            own = ", ".join(name for name in parts if name in rights.aircraft)
            lines += [f"{kind} aircraft: {own}"] if own else []
            tell({"up": list(parts), "real": real, **found}, *lines)
            leave_what_stays()
            await ended.wait()
            teller.do(lambda: err.print("ending: an aircraft that flies hovers"))
    return ExitCode.OK


def _settings_of(rights: Rights, name: str, *, is_real: bool) -> Settings:
    """The settings of an aircraft of the file. Raises UsageError: it has no url."""
    table = dict(rights.settings[name])
    url = table.pop("url", None)
    if is_real and url is None:
        raise UsageError(
            f"{rights.path} [aircraft.{name}]: no url says where it is",
            remedy='write url = "/dev/ttyUSB0" there, or leave out --real for a virtual one',
        )
    if not is_real:
        firmware = table.pop("firmware", None)
        url = "sim://" if firmware is None else f"sim://?firmware={firmware}"
    known = {one.name for one in fields(AgentOptions)}
    options = AgentOptions(**{key: value for key, value in table.items() if key in known})
    [settings] = aircraft_of(options, (f"{name}={url}",)).values()
    return recorded_apart(settings, name)


async def doctor(file: FleetFile, /) -> int:
    """Prove each leg and each right of a fleet that runs, and name what is wrong before a flight.

    Each operator whose signing key is in pki/ beside the file asks each aircraft by each router for
    its state, its fleet file and who has control. Nothing moves, and nobody loses control.
    """
    found = await examine(Rights.read(file), lambda text: None if as_json() else say(f"✓ {text}"))
    for one in found:
        facts = {"fault": one.fault, "name": one.name, "seen": one.seen, "remedy": one.remedy}
        tell(facts, f"✗ {one.fault}: {one.seen}", f"  {one.remedy}")
    if not found and as_json():
        print_json({"ok": True})
    return ExitCode.FAILED if found else ExitCode.OK


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
    ended = ended_by_signal()
    if not names:
        options.tell_left_out()
    async with options.open() as fleet, serving_fleet_console(fleet, settings, names) as served:
        scheme = "http" if settings.tls_cert is None else "https"
        path, shown = served.console_path(), list(served.agents)
        url = f"{scheme}://{settings.authority(served.sockets.port('console'))}{path}"
        words = f"console:   {url}", f"aircraft:  {', '.join(shown)}"
        tell({"console": url, "aircraft": shown}, *words)
        warn_of(settings)
        if is_opened:
            await asyncio.to_thread(webbrowser.open, url)
        await ended.wait()
        err.print("ending: an aircraft that was flown from here hovers")
    return ExitCode.OK


# -- ``m100link fleet pki`` and ``fleet acl``: certificates, and who may do what -------------------


pki = group("pki", "Revoke certificates and signing keys of a fleet.")
acl = group("acl", "List the rights in a fleet file; write a router's rules from it.")


@pki.command
def revoke(
    *names: Annotated[str, Parameter(help="Certificates of operators, aircraft or routers.")],
    folder: Path = Path(),
) -> int:
    """Revoke certificates and keys before they expire; a revoked name stays revoked.

    The command writes revoked.list, which the authority signs. Programs on this machine read it
    within a second. Bring it to other agents by fleet pki push, and copy it to other routers.

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
        "m100link fleet pki push --all brings it to the agents; copy it to the routers",
    )


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
    place = (options.folder if folder is None else folder) / LIST
    try:
        data = place.read_bytes()
    except OSError as error:
        raise UsageError(
            f"{place} cannot be read: {error.strerror}",
            remedy="m100link fleet pki revoke writes it",
        ) from error

    async def one(it: FleetAircraft) -> int:
        it.asker.require(Right.STOP, ends=True)
        return (await in_force(it.bus, it.keys, data)).number

    return tell_results(await results_of(names, everybody, options, one), options)


@acl.command
def check(file: File, /, *, who: tuple[str, ...] = ()) -> int:
    """List what each identity may do with each aircraft; one that is revoked beside it: nothing.

    Args:
        file: A fleet file, TOML.
        who: Name of an identity; may be repeated. All identities by default.
    """
    rights = Rights.read(file)
    revoked = _revoked_beside(rights)
    for name in who or tuple(rights.identities):
        one = rights.identities.get(name)
        if one is None:
            raise BadRights(
                f"{file} has no identity {name}",
                cause="agents and routers refuse everything from an unknown name",
                remedy=f"name one of {', '.join(rights.identities) or 'none'}",
            )
        found = explain(rights, name)
        since = revoked.get(name, "")
        if since:
            found = [(aircraft, None) for aircraft, _ in found]
        may = {aircraft: right and right.name.lower() for aircraft, right in found}
        signs = one.public_key is not None
        facts = {"who": name, "signs": signs, "may": may}
        signs_text = "signs orders" if signs else "signs nothing: agents obey no order"
        signs_text = f"revoked since {since}" if since else signs_text
        tell(
            facts | ({"revoked": since} if since else {}),
            f"{name} ({signs_text})",
            *(f"  {aircraft}: {_words(right)}" for aircraft, right in found),
        )
    return ExitCode.OK


def _revoked_beside(rights: Rights) -> Mapping[str, str]:
    is_there = (rights.pki / AUTHORITY).exists()
    return Revocations.of_folder(rights.pki).revoked.names if is_there else {}


_MAY = {Right.WATCH: "watch and fetch logs", Right.STOP: "stop", Right.FLY: "fly"}


def _words(right: Right | None) -> str:
    if right is None:
        return "nothing"
    return ", ".join(_MAY[one] for one in Right if one <= right)


@acl.command
def zenoh(file: File, target: File, /, *, force: Force = False) -> int:
    """Write the rules of a zenoh router from a fleet file, none for names revoked beside it.

    They are the value of access_control in its configuration. The router knows clients by the
    common name of the certificate, so it has to ask for one.

    Args:
        file: A fleet file, TOML.
        target: The JSON file to write; - is standard output.
    """
    rights = Rights.read(file)
    rights = rights.without(_revoked_beside(rights))
    text = json.dumps({"access_control": router_config(rights)}, indent=2) + "\n"
    write_out(target, text, force=force)
    return ExitCode.OK
