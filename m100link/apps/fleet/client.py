"""An operator's end of a fleet: which aircraft are present, and orders to each."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self

from m100link.apps.agent.messages import MessageError, fault_of
from m100link.apps.agent.orders import AskVersion, Land, Right, Stop
from m100link.apps.bus.network import Bus
from m100link.apps.bus.session import LARGEST, Opening, open_session
from m100link.apps.fleet.asking import PATIENCE_S, Asker, Sign, nobody_there, unsigned
from m100link.apps.fleet.carrier import FleetChannel, reach
from m100link.apps.fleet.control import FleetControl
from m100link.apps.fleet.expiry import MOST_AGE_S, ORDER_AGE
from m100link.apps.fleet.keys import DEFAULT_SITE, Keys, in_order, name_in, session_in
from m100link.apps.fleet.logs.fetching import Fetched, LogFetcher, Progress
from m100link.apps.fleet.missions.flight import mission_card
from m100link.apps.fleet.payloads import Card, MissionCard, Result, unpack
from m100link.apps.fleet.revocations import Revocations
from m100link.apps.fleet.signing import Seal, SealedBus
from m100link.errors import GuardRefused, M100Error, OutcomeUnknown
from m100link.errors.texts import read_json
from m100link.log.folder import LogEntry

_ANSWER_S = 1.5
_LANDINGS_ASKED = 3
"""Once to hear what time it is there, once to be lost on the way."""

_SPARE_S = 0.5  # of a landing over a link whose round trip is longer than an order may be old
_CARDS_ASKED = 3
_MOST_CHANGES = 4096
_MOST_DOUBTFUL = 8


@dataclass(frozen=True, slots=True)
class Change:
    """An agent appeared or disappeared."""

    name: str  #: the aircraft
    is_there: bool  #: whether it appeared, else it disappeared


class FleetAircraft:
    """One aircraft of a fleet."""

    def __init__(self, asker: Asker, name: str) -> None:
        self._name = name  # who asks, for people
        self.asker = asker  # asks it, for what has no method here
        self.bus, self.keys = asker.bus, asker.keys

    def __repr__(self) -> str:
        return f"<FleetAircraft {self.name!r} of {self.keys.site!r}>"

    @property
    def name(self) -> str:
        """Its name."""
        return self.keys.name

    def control(
        self, *, stop: Literal["hover", "land"] = "hover", take_over: bool = False
    ) -> FleetControl:
        """Control of it, as ``async with``: the lease, authority, and orders to fly.

        Args:
            stop: Action of the aircraft when the block is left: ``hover`` or ``land``. Behind
                a STOP it does not land, and leaving the block raises ``GuardRefused``.
            take_over: Take the lease from its holder.

        Raises (when it is entered):
            LeaseHeld: Another operator has the lease.
            M100Error: As :meth:`m100link.Control.obtain`, and :class:`m100link.errors.FleetError`.
        """
        return FleetControl(self.asker, self._name, stop=stop, take_over=take_over)

    async def take_off(self) -> None:
        """Take control, take off, give control back: the aircraft hovers.

        Raises:
            M100Error: As :meth:`control` and :meth:`m100link.Control.take_off`.
        """
        async with self.control() as control:
            await control.take_off()

    async def land(self) -> None:
        """Land in place. Needs no lease: the agent takes it over until the aircraft is down.

        Raises:
            GuardRefused: The order arrived too late, three times, and the agent did not begin it:
                messages take longer and longer.
            M100Error: As :meth:`m100link.Control.land`, and :class:`m100link.errors.FleetError`.
        """
        asker, clock = self.asker, asyncio.get_running_loop().time
        asker.doubtful_clocks, began_at, its = [], clock(), 0.0
        for left in reversed(range(_LANDINGS_ASKED)):
            since = asker.its_time(began_at)
            try:
                # A STOP since the first time ends it.
                await asker.ask(Land(), since=since, clock=its)
            except GuardRefused as error:
                # It was not begun, and the answer had the time there: that is known now, or better.
                is_better = asker.its_time(began_at) > since
                if not left or not (error.guard == ORDER_AGE or is_better):
                    raise
                its = asker.its_time(clock())
                # Nobody knows which half of a round trip is the slow one. This program waits for
                # the landing, so it answers for an order that is one round trip old.
                trip = asker.its_clock.round_trip or 0.0
                its += max(0.0, trip + _SPARE_S - MOST_AGE_S)
            except OutcomeUnknown:
                await self._land_each(asker.doubtful_clocks, clock() - began_at)
                raise
            else:
                return

    async def _land_each(self, clocks: list[float], ago: float) -> None:
        """Ask each by its own time: it is unknown which of them is the aircraft."""
        ask = partial(self.asker.ask, Land())
        asked = (ask(clock=one, since=one - ago) for one in clocks[:_MOST_DOUBTFUL])
        await asyncio.gather(*asked, return_exceptions=True)

    async def stop(self) -> None:
        """Stop all motion, programs and tasks: the aircraft hovers. Needs no lease.

        Raises:
            FleetError: Unreachable, not allowed, or the outcome is unknown.
        """
        await self.asker.ask(Stop())

    async def logs(self) -> list[LogEntry]:
        """The flight logs on board, the newest first.

        Raises:
            Unreachable, NotAllowed: Its agent is absent, or refused the question.
        """
        return await LogFetcher(self.asker).logs()

    async def fetch_log(
        self, log: str = "", to: Path | str = "", progress: Progress | None = None
    ) -> Fetched:
        """Fetch a flight log; a transfer that was cut off continues where it ended.

        Args:
            log: Its name on board; the newest by default.
            to: Folder for the file ``NAME-LOG``; ``NAME-LOG.part`` until it is complete.
            progress: Called with the bytes that are here and the bytes that there will be.

        Raises:
            UsageError: There is no such log, or it cannot be written here.
            Unreachable: Its agent is absent, or stopped answering. The part that came is kept.
            NotAllowed: It refused the question.
            FleetError: The copy differs from the log on board.
        """
        return await LogFetcher(self.asker).fetch(log, to, progress)

    async def audit(self, number: int = 1) -> bytes:
        """The lines of its audit log: who ordered what, the outcome, and when; each is signed.

        Args:
            number: That of the first line.

        Raises:
            UsageError: Its agent has no certificate.
            Unreachable, NotAllowed: As :meth:`logs`.
        """
        return await LogFetcher(self.asker).audit(number)

    async def mission(self) -> MissionCard:
        """The state of its mission.

        Raises:
            Unreachable, OutcomeUnknown: Its agent is absent, or gives no answer.
            NotAllowed: The fleet file here gives no right to it.
        """
        self.asker.require(Right.WATCH)
        if not await self.asker.is_there():
            raise nobody_there(self.keys)
        return await mission_card(self.asker, patience=self.asker.patience)

    async def card(self) -> Card:
        """The state of its agent and aircraft.

        Raises:
            Unreachable, OutcomeUnknown, NotAllowed: As :meth:`mission`.
        """
        self.asker.require(Right.WATCH)
        for _ in range(_CARDS_ASKED):
            found = await cards(self.bus, self.keys)
            if self.name in found:
                return found[self.name]
            await self.asker.ask(AskVersion())  # which says why
        raise OutcomeUnknown(
            f"{self.name} answers, but does not say where it stands",
            cause="the link loses its answers, or the router lets none of them pass",
        )


async def cards(bus: Bus, keys: Keys) -> dict[str, Card]:
    """States of agents, by name: those that answered in time."""
    found = {}
    for answer in await bus.ask(keys.state, timeout=_ANSWER_S):
        name = name_in(answer.key)
        try:
            card: Card = unpack(Card, answer.payload)
            if card.name != name:  # rules of a router go by the key
                raise MessageError(f"the key of {name} has a state of {card.name}")
        except MessageError as error:
            # Another version, or a lie: it is listed with what is wrong, not left out.
            card = Card(name, "", 0.0, "unreadable", fault=fault_of(error))
        found[name] = card
    return found


class Fleet:
    """The aircraft of one site; to be used as ``async with``."""

    def __init__(
        self,
        bus: Bus,
        *,
        site: str = DEFAULT_SITE,
        name: str = "operator",
        sign: Sign | None = None,
        # Seconds without any answer after which an outcome is unknown. An order over a way of so
        # many seconds needs more than twice as long.
        patience: float = PATIENCE_S,
        utc: Callable[[], float] = time.time,  # POSIX time, s
    ) -> None:
        self.bus = bus
        self.keys = Keys(site)
        self._name = name
        self._options: dict[str, Any] = {"patience": patience, "utc": utc, "sign": sign or unsigned}
        self._options["unstopped"] = {}  # one for all of them
        # Ids of the sessions that show the token of each.
        self._present: dict[str, set[str]] = {}
        self._listeners: list[tuple[deque[Change], asyncio.Event]] = []

    async def __aenter__(self) -> Self:
        # Asked before anything is watched: while zenoh fills the tables of a watch, it answers
        # from what it has of them, and leaves out whom it does not have yet.
        for token in await self._tokens():
            self._on_token(token, is_there=True)
        self._watch = self.bus.watch(self.keys.live, self._on_token)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._watch.close()

    # -- who is there ----------------------------------------------------------------------------

    def _on_token(self, key: str, is_there: bool) -> None:
        name = name_in(key)
        if not name:
            return
        sessions = self._present.setdefault(name, set())
        had = bool(sessions)
        (sessions.add if is_there else sessions.discard)(session_in(key))
        if not sessions:
            del self._present[name]
        if had != bool(sessions):
            for waiting, event in self._listeners:
                waiting.append(Change(name, is_there))
                event.set()

    async def _tokens(self) -> list[str]:
        return await self.bus.tokens(self.keys.live, timeout=self._options["patience"])

    @property
    def present(self) -> frozenset[str]:
        """Names of the agents that are known to be present."""
        return frozenset(self._present)

    async def names(self) -> list[str]:
        """Names of the agents that are present: those known already, and those found now."""
        found = filter(None, map(name_in, await self._tokens()))
        return in_order(set(self._present).union(found))

    async def changes(self) -> AsyncIterator[Change]:
        """Agents that appear and disappear, without end; first those that are present."""
        waiting: deque[Change] = deque(
            (Change(name, True) for name in in_order(self._present)), maxlen=_MOST_CHANGES
        )
        event = asyncio.Event()
        listener = (waiting, event)
        self._listeners.append(listener)
        try:
            while True:
                while waiting:
                    yield waiting.popleft()
                event.clear()
                await event.wait()
        finally:
            self._listeners.remove(listener)

    async def cards(self) -> dict[str, Card]:
        """States of the agents, by name: those that answered in time."""
        found = await cards(self.bus, self.keys)
        # A router with rules lets nobody ask all who may not ask each.
        others = [Keys(self.keys.site, name) for name in await self.names() if name not in found]
        for more in await asyncio.gather(*(cards(self.bus, keys) for keys in others)):
            found |= more
        return found

    # -- what they are asked ---------------------------------------------------------------------

    def __getitem__(self, name: str) -> FleetAircraft:
        """One aircraft, present or not. Raises UsageError: that cannot be a name."""
        return FleetAircraft(self.asker(name), self._name)

    def asker(self, name: str, by: str = "") -> Asker:
        """The client of one aircraft; ``by``: the program that asks by this end, for people.

        Raises:
            UsageError: That cannot be a name.
        """
        return Asker(
            self.bus,
            Keys(self.keys.site, name),
            f"{self._name}: {by}" if by else self._name,
            sessions=lambda: self._present.get(name, frozenset()),
            **self._options,
        )

    async def reach(self, name: str) -> FleetChannel:
        """A link of a front to the agent of one aircraft, by which a console flies it.

        Raises:
            LinkError: It is not there, or it is older than this front.
            UsageError: That cannot be a name.
        """
        return await reach(lambda by: self.asker(name, by))

    async def each(
        self, do: Callable[[FleetAircraft], Awaitable[object]], names: Iterable[str] | None = None
    ) -> dict[str, Result]:
        """Do something with each aircraft, all at once.

        None waits for another one. An error of one aircraft is its result, and raises nothing.

        Args:
            do: Called with each; if it raises an error of this package, that is the result.
            names: Names of aircraft; all that are present by default.

        Returns:
            A result for every name.

        Raises:
            Unreachable: No names were given, and no agent is present at this site.
        """
        wanted = list(dict.fromkeys(await self.names() if names is None else names))
        if names is None and not wanted:
            raise nobody_there(self.keys)

        async def one(name: str) -> Result:
            try:
                return Result.of(name, None, await do(self[name]))
            except M100Error as error:
                return Result.of(name, error)

        results = await asyncio.gather(*map(one, wanted))
        return {result.name: result for result in results}

    async def land(self, names: Iterable[str] | None = None) -> dict[str, Result]:
        """Land each. Needs no lease; see :meth:`FleetAircraft.land`."""
        return await self.each(FleetAircraft.land, names)

    async def stop(self, names: Iterable[str] | None = None) -> dict[str, Result]:
        """Stop each. Needs no lease; see :meth:`FleetAircraft.stop`."""
        return await self.each(FleetAircraft.stop, names)


@asynccontextmanager
async def connect(
    *endpoints: str,
    site: str = DEFAULT_SITE,
    name: str = "operator",
    sign: Sign | None = None,
    authority: Revocations | None = None,
    options: dict[str, str] | None = None,
    patience: float = PATIENCE_S,
) -> AsyncIterator[Fleet]:
    """Connect to a fleet, as ``async with``, by the routers of its agents.

    Args:
        endpoints: Of routers, such as ``tcp/127.0.0.1:7447``; the first that answers serves.
        site: Name of the site.
        name: Name of the operator, shown to other people.
        sign: Signs orders: :func:`m100link.apps.fleet.signing.read_signer`.
        authority: Believe only what an aircraft has signed by a certificate of this authority:
            ``Revocations.of_folder(pki)``. Without it, the session with its token is believed.
        options: More options of zenoh, by name, as JSON: certificates, for example.
        patience: Seconds without any answer after which an outcome is unknown.

    Raises:
        UsageError: The package is missing, an endpoint or option is wrong, or no router answered
            within 2 s.
    """
    async with (
        open_fleet("client", connect=endpoints, options=options, authority=authority) as bus,
        Fleet(bus, site=site, name=name, sign=sign, patience=patience) as fleet,
    ):
        yield fleet


# -- a session of a fleet: how it differs from zenoh's default -------------------------------------


LEASE_MS = 1200
"""Milliseconds after which a silent end of a connection counts as gone; zenoh's own 10 s would
leave an aircraft on the wall that long after its cable was cut. Where only the way to an agent is
cut, what it sends goes on to arrive for 0.7 s: until as much waits as TCP sends unacknowledged."""

FIRST_S = 2.0
"""Seconds in which a router has to answer the first time."""

ANSWER_MS = 2000
"""Milliseconds that one router may take to answer before the next one is asked: zenoh's own 10 s
would be those of an aircraft that hovers because the first of two computers is dead."""


def _remedies(connect: tuple[str, ...], options: Mapping[str, str]) -> dict[str, str]:
    """The remedy where no session can be, by the mode."""
    place = ", ".join(connect)
    start = f"m100link fleet router --listen {place}, if none runs there; a router with "
    start += "certificates wants tls/… and --identity"
    if place.startswith("tls/"):
        start = "m100link fleet doctor FILE names the cause: router, port or certificate"
        if not any("tls" in name for name in options):
            start = f"give --identity: {place} wants a certificate"
    taken = ", ".join(read_json(options.get("listen/endpoints", "[]")))
    return {"client": start, "router": f"end the program that has {taken}, or listen elsewhere"}


@asynccontextmanager
async def open_fleet(
    mode: Literal["client", "router"],
    *,
    connect: tuple[str, ...] = (),  # such as ``tcp/127.0.0.1:7447``: of a router, other routers
    listen: tuple[str, ...] = (),
    options: Mapping[str, str] | None = None,  # more of zenoh's, by name, as JSON
    is_patient: bool = False,  # wait for the first router as long as it takes
    seals: Mapping[str, Seal] | None = None,  # of its own aircraft, by name
    authority: Revocations | None = None,  # whose certificates are believed
) -> AsyncIterator[SealedBus]:
    """A session while the block runs; a router that is lost meanwhile is found again.

    There is no discovery by multicast or gossip: only named endpoints are met. Raises UsageError:
    the package is missing, an option cannot be, a port is taken, or no router answered.
    """
    ours = {
        "mode": json.dumps(mode),
        "connect/endpoints": json.dumps(list(connect)),
        # Each of them is tried once, in turn. With any other time zenoh tries the first alone until
        # that is over, and a session that begins while that one is dead never tries the second.
        # A router looks for the others without end, and serves clients meanwhile.
        "connect/timeout_ms": "-1" if mode == "router" else "0",
        "connect/exit_on_failure": json.dumps(mode != "router"),
        "transport/unicast/open_timeout": str(ANSWER_MS),
        "listen/endpoints": json.dumps(list(listen)),
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "transport/link/tx/lease": str(LEASE_MS),
        "transport/link/rx/max_message_size": str(LARGEST),
        # Of what goes in one moment while others use the processor, two would drop the rest.
        "transport/link/tx/queue/size/data": "8",
    }
    given = ours | dict(options or {})
    remedies = _remedies(connect, given)
    opening = Opening(
        "a fleet", "fleet", given, patience_s=FIRST_S, is_patient=is_patient, remedies=remedies
    )
    async with open_session(opening) as bus:
        with closing(SealedBus(bus, seals, authority)) as sealed:
            yield sealed
