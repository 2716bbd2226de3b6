"""Publications of an agent, and how others receive them.

A console on the ground receives what a client on board receives. Telemetry and events have keys of
their own. :class:`StatePublisher` sends the rest as messages of the agent: its state, the holder of
the lease, and the counters of the link. It sends while somebody listens.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from typing import TypeVar

from m100link.apps.agent import messages
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.orders import UploadPlan
from m100link.apps.bus.network import Bus, Question
from m100link.apps.fleet.keys import Keys, name_in
from m100link.apps.fleet.payloads import pack, unpack_message
from m100link.errors import AuthorityLost, LayoutMismatch
from m100link.missions.plan import WaypointPlan
from m100link.protocol.codes import ActivationCode
from m100link.protocol.firmware import PROFILES
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState

T = TypeVar("T")

STATE_S = 0.25
"""Seconds between two states, as an agent tells its own fronts."""

_SELDOM = 4
"""Of so many states one has lease and counters behind it: messages may be lost on the way."""

_PLAN = 20
"""Of so many one has the plan, which is long."""


class StatePublisher:
    def __init__(self, client: AgentClient, bus: Bus, keys: Keys, boot: str) -> None:
        self._client = client
        self._bus = bus
        self._keys = keys
        self._boot = boot
        self._plan: WaypointPlan | None = None

    async def run(self) -> None:
        client = self._client
        with ExitStack() as stack:
            self._outlet = self._bus.publish(self._keys.told)
            stack.callback(self._outlet.close)
            stack.callback(self._bus.serve(self._keys.told, self._greet).close)
            _hold(stack, client.on_lease, self._lease_changed)
            _hold(stack, client.on_authority_taken, self._authority_taken)
            _hold(stack, client.on_activating, self._activating)
            _hold(stack, client.on_mission_report, self._put)
            turn = 0
            while True:
                if self._outlet.is_wanted():
                    self._tell_state(turn)
                    turn += 1
                await asyncio.sleep(STATE_S)

    def _greet(self, question: Question) -> None:
        """Answer a new listener with the run of the agent, its time, and the version."""
        question.answer(self._keys.told, pack(self._hello()))

    def _hello(self) -> messages.Hello:
        return messages.Hello(messages.VERSION, self._boot, self._client.now)

    def _put(self, message: messages.Message) -> None:
        self._outlet.put(pack(message))

    def _tell_state(self, turn: int) -> None:
        client = self._client
        self._put(client.state)
        if turn % _SELDOM == 0:
            self._lease_changed(messages.LeaseChanged(client.holder.number, client.holder.name))
            if client.link is not None:
                self._put(client.link)
        if client.plan is not self._plan or turn % _PLAN == 0:
            plan = self._plan = client.plan
            self._put(
                messages.PlanChanged(client.plan_by, None if plan is None else UploadPlan.of(plan))
            )

    def _lease_changed(self, change: messages.LeaseChanged) -> None:
        self._put(self._hello())  # whose time says how new the word on the lease is
        self._put(change)

    def _authority_taken(self, error: AuthorityLost) -> None:
        self._put(messages.AuthorityTaken(messages.RemoteError.of(error)))

    def _activating(self, code: ActivationCode) -> None:
        self._put(messages.Activating(int(code)))


def _hold(stack: ExitStack, heard: list[Callable[[T], None]], tell: Callable[[T], None]) -> None:
    heard.append(tell)
    stack.callback(heard.remove, tell)


# -- telemetry of a fleet as an operator sees it: the newest values of each aircraft ---------------


_DEPTH = 20_000


class FleetTelemetry:
    def __init__(
        self,
        bus: Bus,
        keys: Keys,  # of one aircraft, or of all
        *,
        full: bool = False,  # every package; else what suffices for each item five times a second
        # Called with the name and each package, whose time is that of its arrival here.
        on_sample: Callable[[str, Sample], None] | None = None,
    ) -> None:
        self._clock = asyncio.get_running_loop().time
        self._on_sample = on_sample
        # Newest values by name; ages count from their arrival here.
        self.states: dict[str, AircraftState] = {}
        self.received: Counter[str] = Counter()  # packages by name
        self.unread = 0  # packages that this version cannot read
        key = keys.telemetry if full else keys.thinned
        # An operator who looks at one aircraft may fly it; an overview is for people.
        within = 0.0 if full else WALL_WITHIN_S
        self._held = bus.subscribe(key, self._heard, depth=_DEPTH, within=within)

    def close(self) -> None:
        """Hear no more: what nobody hears is not sent."""
        self._held.close()

    def _heard(self, key: str, payload: bytes) -> None:
        name = name_in(key)
        try:
            message = unpack_message(payload)
            if not isinstance(message, messages.Telemetry):
                raise messages.MessageError(f"{type(message).__name__} is no telemetry")
            sample = Sample(message.value, PROFILES[message.profile], self._clock())
        except (messages.MessageError, LayoutMismatch, KeyError):
            self.unread += 1
            return
        self.received[name] += 1
        if name not in self.states:
            self.states[name] = AircraftState(self._clock)
        self.states[name].update(sample)
        if self._on_sample is not None:
            self._on_sample(name, sample)


# -- telemetry for a wall: each item a few times a second, in packages as they came ----------------


WALL_HZ = 5.0
"""Times a second that an overview gets each item."""

WALL_WITHIN_S = 0.05
"""Seconds that a message to an overview may wait, to go or to be taken with others."""

_BITS = 16  # of the word that says which items are in a package


@cache
def _items(flags: int) -> tuple[int, ...]:
    return tuple(bit for bit in range(_BITS) if flags >> bit & 1)


class Thinner:
    """Chooses the packages that go on (pure logic, the time is an argument).

    A package has the items that were due at its time. It goes on for the sake of an item whose next
    one, by the time between its last two, would be farther from the interval of the wall than this
    one. So an item that comes often waits for the package with a rare one, one package has all of
    them, and each goes out at its own rate or that of the wall.
    """

    def __init__(self, rate_hz: float = WALL_HZ) -> None:
        self._interval = 1.0 / rate_hz
        self._sent_at = [0.0] * _BITS
        self._seen_at = [-math.inf] * _BITS

    def goes_on(self, flags: int, at: float) -> bool:
        """Whether a package goes on. ``at``: when it came, s."""
        sent, seen, is_due = self._sent_at, self._seen_at, False
        items = _items(flags)
        for bit in items:
            between = at - seen[bit]
            seen[bit] = at
            if at + between / 2 >= sent[bit] + self._interval:
                is_due = True
        if is_due:
            for bit in items:
                sent[bit] = at
        return is_due
