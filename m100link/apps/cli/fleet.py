"""Shared by the verbs of a fleet: options, borrowed leases, and reports after Ctrl-C."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
import platform
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from m100link.apps.agent.orders import Right
from m100link.apps.cli.common import err, out
from m100link.apps.cli.options import Above0
from m100link.apps.cli.plan import File, require_free
from m100link.apps.cli.terminal import (
    AS_IT_IS,
    ExitCode,
    LogOptions,
    as_json,
    panel,
    tell,
    tell_text,
)
from m100link.apps.fleet.asking import PATIENCE_S
from m100link.apps.fleet.client import Fleet, FleetAircraft, connect
from m100link.apps.fleet.identity import Rights
from m100link.apps.fleet.keys import DEFAULT_SITE, check_name, in_order
from m100link.apps.fleet.payloads import Result
from m100link.apps.fleet.signing import credentials
from m100link.errors import M100Error, OutcomeUnknown, UsageError
from m100link.errors.texts import read_json
from m100link.link.keyfile import replace_file
from m100link.log.folder import state_folder

# -- what goes on on board after Ctrl-C, how to see it, and how to end it --------------------------


@dataclass(frozen=True, slots=True)
class Left:
    """The activity on board when Ctrl-C ends the wait for an order."""

    seen: str  # what goes on, or ends
    remedy: str  # how to see it and how to end it, with ``{name}`` for the aircraft

    def of(self, name: str) -> OutcomeUnknown:
        """The report for one aircraft: the outcome of the order is unknown."""
        return OutcomeUnknown(f"interrupted: {self.seen}", remedy=self.remedy.format(name=name))


# -- a lease that one command holds, and other commands of the same account use --------------------
# Its secret lies in a file that nobody else can read, until the command that holds it ends.


def lease_file(site: str, name: str) -> Path:
    """Where the proof lies: in the folder of the user's session, else in that of the state."""
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    base = Path(session) / "m100link" if Path(session).is_absolute() else state_folder(os.environ)
    return base / "leases" / check_name(site, "a site") / f"{check_name(name)}.json"


@contextmanager
def shared(site: str, name: str, proof: tuple[int, str]) -> Iterator[None]:
    """Let other commands of this account order under a lease while the block runs.

    Raises UsageError: the file cannot be written.
    """
    path = lease_file(site, name)
    fence, token = proof
    text = json.dumps({"fence": fence, "token": token})
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        replace_file(path, text.encode("ascii"))  # of one that was killed
    except OSError as error:
        raise UsageError(
            f"{path} cannot be written: {error.strerror or error}",
            remedy="make room there, and let your account write its folder",
        ) from error
    try:
        yield
    finally:
        if path.is_file() and path.read_text(encoding="ascii") == text:  # else it is another's
            path.unlink(missing_ok=True)


def borrowed(site: str, name: str) -> tuple[int, str]:
    """Number and secret of the lease that another command of this account holds.

    Raises UsageError: there is none.
    """
    path = lease_file(site, name)
    try:
        found = read_json(path.read_bytes())
        return int(found["fence"]), str(found["token"])
    except FileNotFoundError:
        raise UsageError(
            f"no command of this account has control of {name}",
            cause="orders to a mission need the lease of the operator who flies",
            remedy=f"m100link fleet mission fly {name} FILE in another shell; m100link fleet stop "
            f"{name} needs no lease",
        ) from None
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(f"{path} cannot be read: {error}", remedy="remove it") from error


# -- fleet -----------------------------------------------------------------------------------------

ROUTER = "tcp/127.0.0.1:7447"

Name = Annotated[str, Parameter(help="Name of the aircraft.")]
Names = Annotated[str, Parameter(help="Names of aircraft.")]
TakeOver = Annotated[bool, Parameter(help="Take control from its holder, in one step.")]
All = Annotated[bool, Parameter(name="--all", help="All aircraft that are present.")]


@Parameter(name="*", group=panel("Fleet"))
@dataclass(frozen=True)
class FleetOptions:
    """The fleet to connect to, and the operator's identity.

    Attributes:
        connect: A fleet file, or the endpoint of a router (M100LINK_FLEET); an endpoint may be
            repeated: the first one that answers serves.
        site: Name of the site (M100LINK_SITE).
        operator: Your name, shown to other people; the identity, or user and host, by default.
        identity: Identity that signs orders and shows its certificate to a router behind tls/
            (M100LINK_IDENTITY).
        pki: Folder with that certificate and key (M100LINK_PKI); pki beside a fleet file.
        patience: Seconds without any answer after which the outcome of an order is unknown. With a
            delay of 3 s in each direction an answer takes 6.5 s.
        log: Options of the log.
    """

    connect: Annotated[tuple[str, ...], Parameter(env_var="M100LINK_FLEET")] = (ROUTER,)
    site: Annotated[str, Parameter(env_var="M100LINK_SITE")] = DEFAULT_SITE
    operator: str | None = None
    identity: Annotated[str | None, Parameter(env_var="M100LINK_IDENTITY")] = None
    pki: Annotated[Path | None, Parameter(env_var="M100LINK_PKI")] = None
    patience: Annotated[float, Above0] = PATIENCE_S
    log: LogOptions = AS_IT_IS

    def open(self) -> AbstractAsyncContextManager[Fleet]:
        """The fleet."""
        ends = self.connect if self.file is None else self.file.endpoints
        how: dict[str, Any] = {"site": self.place, "name": self.who, "patience": self.patience}
        return connect(*ends, **how, **self.credentials)

    @cached_property
    def file(self) -> Rights | None:
        """The fleet file; None where endpoints were named. Raises BadRights: it has an error."""
        [first, *more] = self.connect
        return Rights.read(first) if first.endswith(".toml") and not more else None

    @property
    def place(self) -> str:
        """The name of the site."""
        return self.site if self.file is None else self.file.site

    @cached_property
    def credentials(self) -> dict[str, Any]:
        """The identity's signer, authority and options of TLS; nothing without one."""
        return credentials(self.folder, self.identity, self.file) if self.identity else {}

    def tell_left_out(self) -> None:
        """Name the aircraft of the file that no router shows to this identity."""
        sign, known = self.credentials.get("sign"), () if self.file is None else self.file.aircraft
        every = [(name, sign.refusal(Right.WATCH, name)) for name in known if sign is not None]
        if left_out := {name: refused.seen for name, refused in every if refused}:
            why = next(iter(left_out.values())).partition(";")[0]
            say(f"left out: {', '.join(left_out)}: {why}", to=err)

    @property
    def folder(self) -> Path:
        """The folder with certificates and keys."""
        beside = Path() if self.file is None else self.file.pki
        return beside if self.pki is None else self.pki

    @property
    def who(self) -> str:
        """The operator's name, for other people."""
        user = f"{getpass.getuser()}@{platform.node() or 'host'}"
        return self.operator or self.identity or user


NO_OPTIONS = FleetOptions()


async def results_of(
    names: tuple[str, ...],
    everybody: bool,
    options: FleetOptions,
    do: Callable[[FleetAircraft], Awaitable[object]],
) -> dict[str, Result]:
    """Do something with each aircraft that is named, or that is there.

    Raises UsageError: neither names were given nor that all are meant, or both.
    """
    if bool(names) == everybody:
        raise UsageError(
            "no aircraft was named" if not names else "aircraft were named, and --all given",
            remedy="name them, or give --all",
        )
    if everybody:
        options.tell_left_out()
    async with options.open() as fleet:
        return await fleet.each(do, await fleet.names() if everybody else names)


def say(*lines: str, to: Console = out) -> None:
    """Print lines as they are."""
    for line in lines:
        to.print(line, soft_wrap=True)


def write_out(target: File, text: str, *, force: bool) -> None:
    """Write a file; - is standard output.

    Raises UsageError: it is there already, or cannot be written.
    """
    if str(target) == "-":
        tell_text(text)
        return
    require_free(target, force=force)
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"{target} cannot be written: {error.strerror}", remedy="name another file"
        ) from error
    tell({"file": str(target)})


def tell_results(results: dict[str, Result], options: FleetOptions) -> int:
    """Print what became of an order to each; 0 only when all is well."""
    if not results:
        err.print(f"there is no agent at site {options.place}")
        return ExitCode.NO_LINK
    for name in in_order(results):
        result = results[name]
        error = result.error
        facts = {"name": name, "outcome": result.outcome.value}
        why = ""
        if error is not None:
            facts |= {"code": error.error_code, "seen": error.seen, "remedy": error.remedy}
            why = f"  {error.seen}"
        tell(facts, f"{name:12} {result.outcome.value}{why}")
        if error is not None and error.remedy and not as_json():
            say(f"{'':12} {error.remedy}", to=err)
    bad = [result for result in results.values() if not result.is_ok]
    if bad and not as_json():
        sys.stdout.flush()
        err.print(f"{len(results) - len(bad)} ok, {len(bad)} not")
    return ExitCode.FAILED if bad else ExitCode.OK


async def tell_each(
    names: tuple[str, ...],
    everybody: bool,
    options: FleetOptions,
    do: Callable[[FleetAircraft], Awaitable[object]],
    left: Left,
) -> int:
    """Do something with each, and print what became of it, also when Ctrl-C ends the wait."""
    known: dict[str, Result] = {}  # of each that was asked

    async def asked(aircraft: FleetAircraft) -> None:
        name = aircraft.name
        known[name] = Result.of(name, left.of(name))
        try:
            await do(aircraft)
        except M100Error as error:
            known[name] = Result.of(name, error)
            raise
        known[name] = Result.of(name, None)

    try:
        return tell_results(await results_of(names, everybody, options, asked), options)
    except asyncio.CancelledError:
        if known:
            tell_results(known, options)
        raise
