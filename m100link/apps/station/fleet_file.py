"""A fleet that one file describes: its routers, agents and console, and what is wrong with it."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import ssl
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import m100link
from m100link.apps.agent.messages import Event
from m100link.apps.agent.orders import AskTakeOver, AskVersion, Right
from m100link.apps.fleet.client import Fleet, connect, open_fleet
from m100link.apps.fleet.identity import WINDOW_S, Reason, Rights, Router
from m100link.apps.fleet.keys import Keys, in_order
from m100link.apps.fleet.lost_link import LostLinkPlan
from m100link.apps.fleet.payloads import Card, OrderReply
from m100link.apps.fleet.pki import listed, router_config
from m100link.apps.fleet.revocations import AUTHORITY, Revocations, in_force
from m100link.apps.fleet.signing import Seal, credentials, read_signer, tls_options, verifying
from m100link.apps.station.config import Settings, resolve
from m100link.apps.station.fleet import (
    FleetSettings,
    default_order_logs,
    serving_fleet,
    serving_fleet_console,
)
from m100link.apps.station.listeners import beside
from m100link.apps.station.run import END_TIMEOUT, agent_settings
from m100link.apps.station.supervisor import ChildProcess, supervised
from m100link.errors import M100Error, NotAllowed, OutcomeUnknown, OutOfResources, UsageError

_logger = logging.getLogger(__name__)

CONSOLE = "console"
"""Name of the console of a fleet file, beside those of routers and aircraft."""

_LOOK_AT_LIST_S = 1.0


def parts_of(rights: Rights) -> list[str]:
    """The names of all that runs for a fleet file, in the order in which it starts."""
    return [*rights.routers, *rights.aircraft, *([CONSOLE] if rights.console else [])]


def console_settings(rights: Rights) -> Settings:
    """The settings of the console. Raises ``UsageError``: one of them cannot be."""
    given = {name: value for name, value in rights.console.items() if name != "identity"}
    return resolve({}, {}, of_aircraft=lambda _: [(f"{rights.path} [console]", given)])


def agent_of(rights: Rights, name: str, *, is_real: bool) -> FleetSettings:
    """How the agent of an aircraft is part of the fleet of a file.

    Raises ``UsageError``: it has no certificate, or the list of revoked names is none.
    """
    table = rights.settings[name]
    revocations = Revocations.of_folder(rights.pki, rights)
    return FleetSettings(
        rights.endpoints,
        rights.site,
        LostLinkPlan(table.get("lost", "hover"), table.get("lost_after", 10.0)),
        default_order_logs() if is_real else None,
        tls_options(rights.pki, name),
        seals={name: Seal.read(rights.pki, name)},
        verify=verifying(rights, [name], time.time, revocations.since),
        revocations=revocations,
    )


@asynccontextmanager
async def routing(rights: Rights, name: str) -> AsyncIterator[None]:
    """Be a router of the file, linked with the others, while the block runs.

    With a newer list of revoked names it begins anew: aircraft that somebody flies hover then.
    Raises ``UsageError``: it has no certificate, or its port is taken.
    """
    own = rights.routers[name]
    others = tuple(one.endpoint for other, one in rights.routers.items() if other != name)
    revocations = Revocations.of_folder(rights.pki)

    @asynccontextmanager
    async def opened() -> AsyncIterator[None]:
        rules = router_config(rights.without(revocations.revoked.names))
        options = tls_options(rights.pki, name, listens=True)
        options["access_control"] = json.dumps(rules)
        async with open_fleet("router", listen=(own.listen,), connect=others, options=options):
            yield

    async def renew(session: AsyncExitStack) -> None:
        while True:
            await asyncio.sleep(_LOOK_AT_LIST_S)
            try:
                is_new = await revocations.look()
            except M100Error as error:
                _logger.error("%s", error.seen)
                continue
            if is_new:
                _logger.warning("list %d of revoked names is in force", revocations.number)
                await session.aclose()
                await session.enter_async_context(opened())

    async with AsyncExitStack() as session:
        await session.enter_async_context(opened())
        async with beside({f"m100link router: {name}": renew(session)}):
            yield


@asynccontextmanager
async def running_part(
    path: Path,  # the fleet file
    name: str,  # one of :func:`parts_of`
    settings: Settings | None,  # of an aircraft
    tell: Callable[[str, Event], None],  # called with the name of an aircraft and each event
    *,
    is_real: bool,
) -> AsyncIterator[dict[str, Any]]:
    """Run one part of a fleet file while the block runs; facts for people.

    Raises ``UsageError``: as its kind of part.
    """
    rights = Rights.read(path)
    if settings is not None:
        fleet = agent_of(rights, name, is_real=is_real)
        async with serving_fleet({name: settings}, fleet, tell, rights.aircraft.index(name)):
            yield {"agent": name}
    elif name in rights.routers:
        async with routing(rights, name):
            yield {"router": rights.routers[name].listen}
    else:
        settings, who = console_settings(rights), rights.console["identity"]
        known = credentials(rights.pki, who, rights)
        async with (
            connect(*rights.endpoints, site=rights.site, name=who, **known) as one,
            serving_fleet_console(one, settings) as served,
        ):
            scheme = "http" if settings.tls_cert is None else "https"
            place = settings.authority(served.sockets.port(CONSOLE))
            yield {CONSOLE: f"{scheme}://{place}{served.console_path()}"}


def tell_log(name: str, event: Event) -> None:
    _logger.log(logging.getLevelNamesMapping()[event.level.upper()], "%s: %s", name, event.text)


@asynccontextmanager
async def running_parts(
    path: Path,
    parts: Mapping[str, Settings | None],  # by name, in the order of :func:`parts_of`
    note: Callable[[str, str], None],  # takes a text and a level: what happens to them
    *,
    is_real: bool,
) -> AsyncIterator[dict[str, dict[str, Any]]]:
    """Run parts of a fleet file, each in a process of its own, which is started again if it ends.

    Routers end last: each aircraft hovers and gives control back before. Raises ``M100Error``: one
    of them met an error.
    """
    rights = Rights.read(path)
    children = {
        name: ChildProcess(
            "part",
            name,
            {
                "file": str(path),
                "name": name,
                "settings": None if settings is None else agent_settings(settings),
                "is_real": is_real,
            },
            note,
        )
        for name, settings in parts.items()
    }
    routers = [one for name, one in children.items() if name in rights.routers]
    agents = [one for name, one in children.items() if parts[name] is not None]
    console = [one for name, one in children.items() if name == CONSOLE]
    async with (
        supervised(*routers),
        supervised(*agents, timeout=END_TIMEOUT),
        supervised(*console) if console else nullcontext(),
    ):
        yield {name: child.answer for name, child in children.items()}


# -- the doctor of a fleet: each leg and each right, before anybody flies --------------------------
# It moves nothing and takes no lease: the right to fly is proved by the first step of a take-over,
# which only names who has control.


@dataclass(frozen=True, slots=True)
class FleetFault:
    fault: str  # its kind, in two or three words
    name: str  # whose it is: an aircraft, a router, an operator
    seen: str
    remedy: str


_REASONS: dict[str, str] = {
    Reason.UNKNOWN_KEY: "wrong key",
    Reason.BAD_SIGNATURE: "wrong key",
    Reason.REVOKED: "revoked name",
    Reason.EXPIRED: "wrong clock",
}
_PATIENCE_S = 3.0
_PROBE_S = 1.0
_START_S, _AGAIN_S = 10.0, 0.5
_CUT, _UNLINKED, _KEY = "cut leg", "two routers not linked", "wrong key"
_OF_START = (_CUT, _UNLINKED, _KEY)  # of a fleet whose parts are not all there yet


async def examine(rights: Rights, tell: Callable[[str], None] = lambda _: None) -> list[FleetFault]:
    """The faults of a fleet that runs; ``tell`` takes what is well.

    Each operator whose signing key lies beside the file proves the own rights. It looks again for
    absent parts for a while: `fleet up` may still be starting them.

    Raises ``UsageError``: there is no authority beside the file.
    """
    clock, shown = asyncio.get_running_loop().time, set[str]()
    until = clock() + _START_S
    while True:
        well: list[str] = []
        found = await _examined(rights, well.append)
        for text in (one for one in well if one not in shown):
            tell(text)
        shown.update(well)
        if clock() >= until or not any(one.fault in _OF_START for one in found):
            return found
        await asyncio.sleep(_AGAIN_S)


async def _examined(rights: Rights, tell: Callable[[str], None]) -> list[FleetFault]:
    found = _of_files(rights)
    ready = [name for name in rights.identities if (rights.pki / f"{name}.signing.key").exists()]
    bad = {one.name for one in found}
    seen: dict[str, set[str]] = {}
    for router in (one for one in rights.routers.values() if one.name not in bad):
        for who in (one for one in ready if one not in bad):
            try:
                asking = credentials(rights.pki, who, rights)
                async with connect(
                    router.endpoint, site=rights.site, name=who, patience=_PATIENCE_S, **asking
                ) as fleet:
                    here = await _at_router(rights, router.name, who, fleet, seen)
            except UsageError as error:
                found.append(await asyncio.to_thread(_no_router, rights, router, error))
                break
            found += here
            if not here:
                tell(f"{who} by {router.name}: {', '.join(rights.aircraft)}")
    everywhere = set().union(*seen.values())
    for name, shown in seen.items():
        away = everywhere - shown
        if away:
            others = " and ".join(one for one in seen if one != name)
            found.append(
                FleetFault(
                    _UNLINKED,
                    name,
                    f"{name} does not show {', '.join(in_order(away))}, which {others} shows",
                    "start both from the same fleet file, and let each reach the other's port",
                )
            )
    absent = [name for name in rights.aircraft if seen and name not in everywhere]
    found += [
        FleetFault(
            _CUT,
            name,
            f"no agent named {name} is there, by any router",
            f"on its board: m100link fleet up {rights.path.name} {name} --real; then look at the "
            "network between the board and the router",
        )
        for name in absent
    ]
    return list(dict.fromkeys(found))


def _of_files(rights: Rights) -> list[FleetFault]:
    """The faults of certificates and keys beside the file."""
    found: list[FleetFault] = []
    remedy = f"m100link fleet make {rights.path}, and copy boards/{{}} there"
    own = {*rights.routers, *rights.aircraft, *rights.identities}
    for name, ends, since in listed(rights.pki):
        if since and name in own:
            why = f"give it another name in {rights.path}, then m100link fleet make {rights.path}"
            found.append(FleetFault("revoked name", name, f"{name} is revoked since {since}", why))
        elif ends <= datetime.now(UTC) and name in own:
            seen = f"the certificate of {name} expired on {ends:%Y-%m-%d}"
            found.append(FleetFault("expired certificate", name, seen, remedy.format(name)))
    for name, one in rights.identities.items():
        try:
            signer = read_signer(rights.pki, name)
        except UsageError:
            continue  # it is on another machine
        if signer.public_key != one.public_key:
            seen = f"the signing key of {name} does not fit the public key of the fleet file"
            found.append(FleetFault(_KEY, name, seen, remedy.format(name)))
    return found


def _no_router(rights: Rights, router: Router, error: UsageError) -> FleetFault:
    trusting = ssl.create_default_context(cafile=str(rights.pki / AUTHORITY))
    try:
        with (
            socket.create_connection((router.hosts[0], router.port), timeout=_PROBE_S) as probe,
            suppress(TimeoutError),
            trusting.wrap_socket(probe, server_hostname=router.hosts[0]),
        ):
            pass
    except ssl.SSLCertVerificationError as problem:
        seen = f"the certificate of {router.name} is not of this fleet: {problem.verify_message}"
        anew = f"m100link fleet make {rights.path}, and copy boards/{router.name} there anew"
        return FleetFault(_KEY, router.name, seen, anew)
    except ssl.SSLError as problem:  # it speaks something else
        _logger.debug("%s: %s", router.name, problem)
    except OSError:
        start = f"m100link fleet up {rights.path} {router.name}; then look at the network to "
        return FleetFault(_CUT, router.name, error.seen, start + router.hosts[0])
    return FleetFault(
        "port busy",
        router.name,
        f"port {router.port} of {router.hosts[0]} answers, and is no router of this fleet",
        f"end that program, or give [router.{router.name}] another port",
    )


async def _at_router(
    rights: Rights, router: str, who: str, fleet: Fleet, seen: dict[str, set[str]]
) -> list[FleetFault]:
    """The faults that one operator sees by one router."""
    one = rights.identities[who]
    watched = [name for name in rights.aircraft if one.may(Right.WATCH, name)]
    names = set(await fleet.names())
    cards = await fleet.cards()
    seen.setdefault(router, set()).update(names)
    found: list[FleetFault] = []
    for name in (name for name in watched if name in names):
        tokens = await fleet.bus.tokens(Keys(rights.site, name).live, timeout=_PATIENCE_S)
        if len(tokens) > 1:
            text = f"{len(tokens)} agents are named {name}"
            found.append(FleetFault("duplicate name", name, text, "end all of them but one"))
        found += _of_card(name, cards.get(name))
    there = [name for name in watched if name in cards and cards[name].boot]
    for more in await asyncio.gather(*(_of_rights(rights, who, fleet, name) for name in there)):
        found += more
    return found


def _of_card(name: str, card: Card | None) -> Iterator[FleetFault]:
    version, same = m100link.__version__, "install the same release on board and here"
    if card is None:
        seen = f"{name} gives no answer that its certificate has signed"
        yield FleetFault(_KEY, name, seen, f"copy boards/{name} there anew; {same}")
        return
    if not card.boot or card.version != version:
        seen = f"{name} has release {card.version or 'unknown'}, and this is {version}"
        yield FleetFault("wrong version", name, seen, same)
        if not card.boot:
            return
    ahead = card.at - time.time()
    if abs(ahead) > WINDOW_S:
        side = "ahead of" if ahead > 0 else "behind"
        seen = f"the clock of {name} is {abs(ahead):.0f} s {side} this one"
        yield FleetFault("wrong clock", name, seen, "let chrony or ntpd set both clocks")
    if card.fault is not None:
        is_disk = card.fault.kind == OutOfResources.__name__
        fault = card.fault.seen.partition(":")[0] if is_disk else "no aircraft"
        yield FleetFault(fault, name, f"{name}: {card.fault.seen}", card.fault.remedy)


async def _of_rights(rights: Rights, who: str, fleet: Fleet, name: str) -> list[FleetFault]:
    """Whether an operator has the rights to an aircraft that the file gives."""
    one, asker, found = rights.identities[who], fleet.asker(name), []

    async def prove(what: Coroutine[Any, Any, OrderReply], right: Right) -> OrderReply | None:
        try:
            return await what
        except NotAllowed as error:
            fault = _REASONS.get(getattr(error, "reason", ""), "missing right")
            found.append(FleetFault(fault, who, f"{name}: {error.seen}", error.remedy))
        except OutcomeUnknown:
            seen = f"no order of {who} to {right.name.lower()} {name} passes the router"
            why = "start the router anew from this fleet file"
            found.append(FleetFault("missing right", who, seen, why))
        except M100Error as error:
            _logger.debug("%s: %s", name, error)  # it has looked at the order, and let it through
        return None

    if not one.may(Right.STOP, name):
        return found
    await prove(asker.ask(AskVersion()), Right.STOP)
    if one.may(Right.FLY, name) and not found:
        await prove(asker.ask(AskTakeOver(who)), Right.FLY)
    reply = await prove(in_force(fleet.bus, asker.keys), Right.STOP)
    newest = Revocations.of_folder(rights.pki).number
    if reply is not None and reply.number < newest:
        seen = f"{name} has list {reply.number} of revoked names, and list {newest} is here"
        found.append(FleetFault("revoked name", name, seen, f"m100link fleet pki push {name}"))
    if reply is not None and reply.text not in ("", rights.digest) and not found:
        seen = f"{name} has another fleet file on board: other rights or keys"
        found.append(FleetFault("missing right", name, seen, f"copy boards/{name} there anew"))
    return found
