"""The agent of a fleet, on board: one aircraft under keys of its own.

It is a client of the agent like any other, by an
:class:`~m100link.apps.agent.client.AgentClient`. Control, guards, lease and log belong to the
agent: when the network is lost, the aircraft hovers.
"""

from __future__ import annotations

import asyncio
import math
import re
import time
import uuid
import zlib
from collections import Counter, deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import m100link
from m100link.apps.agent import orders
from m100link.apps.agent.background import goes_on
from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.codec import pack_telemetry
from m100link.apps.agent.messages import Event, EventTopic, MessageError, RemoteError, fault_of
from m100link.apps.agent.orders import Age, Right
from m100link.apps.bus.network import Bus, Held, Question
from m100link.apps.fleet import payloads
from m100link.apps.fleet.expiry import ORDER_AGE, Dropped, OrderExpiry, SetpointStream, broken
from m100link.apps.fleet.identity import Since, nobody
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.lost_link import LastFlight, LostLinkAction, LostLinkPlan
from m100link.apps.fleet.order_log import AuditLog, OrderCache, OrderLog, is_time
from m100link.apps.fleet.orders import OrderService
from m100link.apps.fleet.publisher import WALL_WITHIN_S, Thinner
from m100link.errors import GuardRefused, M100Error, NotAllowed, OutcomeUnknown, UsageError
from m100link.protocol.records import Battery, FlightPhase, Position
from m100link.telemetry.sample import Sample

HOLD_S = 0.5
"""Seconds that a question waits for what becomes of its order; then it hears that it runs."""

_ID = re.compile(r"[0-9a-f]{32}")
_CARD_S = 1.0
_DISKS_S = 10.0
_DUPLICATE_S = 2.0
_READ_AT_ONCE_BYTES = 2048
"""Bytes of an order that is read at once: with its signature STOP has 300."""
_MOST_NAME = 80
_UNNOTED = (
    *(orders.RenewLease, orders.AskVersion, orders.AskTakeOver),
    *(payloads.AskShow, payloads.SendTrack),
)
"""Orders that change nothing are not in the audit log."""
_MAX_LONG_ORDERS = 16
_MOST_WAITING = 16
"""Questions about its mission; of a flood the oldest are dropped."""
_AS_GOOD_AS_NEW_S = 0.05
"""Seconds in which all questions about it get the same answer: flying comes before questions."""
_LONG_ORDER_PAUSE_S = 0.02

_PHASES = {phase: phase.name.lower().replace("_", " ") for phase in FlightPhase}

T = TypeVar("T")

Verify = Callable[[payloads.OrderMessage, str], None]
"""Checks an order to a run of an agent, before anything is done; raises
:class:`~m100link.errors.NotAllowed`."""


def admit(
    order: payloads.OrderMessage, keys: Keys, kind: type[T], verify: Verify | None, boot: str
) -> T:
    """Return what an order asks for; refuse another kind, another aircraft, or a missing right."""
    if not isinstance(order.order, kind):
        raise MessageError(f"{type(order.order).__name__} does not belong under this key")
    if (order.site, order.aircraft) != (keys.site, keys.name):
        there, here = f"{order.site}/{order.aircraft}", f"{keys.site}/{keys.name}"
        raise NotAllowed(f"an order to {there} came to {here}")
    if verify is not None:
        verify(order, boot)
    return order.order


class FleetAgent:
    def __init__(
        self,
        client: AgentClient,  # what knows its agent
        bus: Bus,
        keys: Keys,
        order_log: OrderLog,  # what outlives it
        *,
        lost: LostLinkPlan | None = None,  # what happens when the operator is lost
        # Looks at each order; without it the router alone decides who may ask.
        verify: Verify | None = None,
        revoked: Since = nobody,  # who is shut out
        utc: Callable[[], float] = time.time,  # POSIX time, s
        # Looks for room on the disks, which takes as long as they do; None: nothing is kept there.
        disks: Callable[[], M100Error | None] | None = None,
        audit: AuditLog | None = None,
    ) -> None:
        self.client = client
        self._disks = disks
        self._disk_fault: RemoteError | None = None
        self.audit = audit
        self._refused_at = -math.inf
        self._bus = bus
        self._keys = keys
        self._order_log = order_log
        self._lost_plan = lost or LostLinkPlan()
        self._verify = verify
        self._utc = utc
        self.boot = uuid.uuid4().hex[:8]  # which run of this agent it is
        self.duplicates = DuplicateNames(keys.name, self.boot)  # whether another agent has its name
        self._is_duplicate = False
        self.dropped: Counter[Dropped] = Counter()  # setpoints that were not flown, by reason
        unsure_before = client.now if order_log.damaged else -math.inf
        self._order_cache = OrderCache(order_log.begun, unsure_before=unsure_before)
        self._ages = OrderExpiry()
        self._orders = OrderService(client, order_log, revoked)
        self.missions = self._orders.missions
        self._last_flight = LastFlight(client, order_log)
        descend = partial(self._orders.descend, take_over=False)
        self._lost = LostLinkAction(client, self._lost_plan, descend, self._last_flight)
        self._running: dict[str, asyncio.Task[None]] = {}  # orders under way, by id
        # Long orders, which wait until short ones have been read.
        self._long: deque[tuple[str, Question]] = deque()
        self._has_long = asyncio.Event()
        self._stream = SetpointStream()
        self._thinner = Thinner()
        self._mission, self._mission_at = b"", -math.inf  # card as it was sent last, and when
        client.on_steer_refused.append(self._steer_refused)

    async def run(self) -> None:
        keys, bus = self._keys, self._bus
        with ExitStack() as stack:

            def hold(held: Held) -> None:
                stack.callback(held.close)

            self._event = bus.publish(keys.event)
            self._state = bus.publish(keys.state, within=WALL_WITHIN_S)
            self._full = bus.publish(keys.telemetry)
            self._wall = bus.publish(keys.thinned, within=WALL_WITHIN_S)
            for outlet in (self._event, self._state, self._full, self._wall):
                hold(outlet)
            for key in (keys.command, keys.lease):
                hold(bus.serve(key, partial(self._on_order, key), is_first=payloads.ends))
            hold(bus.serve(keys.status(), self._on_status))
            hold(bus.serve(keys.state, self._on_state))
            hold(bus.serve(keys.mission, self._on_mission, depth=_MOST_WAITING))
            hold(bus.subscribe(keys.setpoint, self._on_setpoint))
            hold(bus.subscribe(keys.state, self._on_own_state))
            self.client.on_event.append(self._on_event)
            # No task is woken for each of a hundred packages a second.
            self.client.on_sample.append(self._on_sample)
            for token in (keys.live_by(bus.session), keys.live_beside):
                hold(bus.declare(token))
            self._tell_state()
            stack.callback(_each_second(keys.name, self._tell_state))
            self._tell_damage()
            self._order_log.tell = partial(self.client.note, level="error")
            self._lost.inherit(self._order_log.last_flight)
            try:
                async with asyncio.TaskGroup() as group:
                    group.create_task(self._last_flight.keep())
                    group.create_task(self._answer_long())
                    if self._disks is not None:
                        group.create_task(self._look_at_disks(self._disks))
            finally:
                self.client.on_event.remove(self._on_event)
                self.client.on_sample.remove(self._on_sample)

    def shut_out(self) -> None:
        """An operator was revoked: the aircraft hovers, and the lease ends as after silence."""
        who = self._orders.shut_out()
        if who:
            self._ages.revoke(self.client.now)
            self.client.background.spawn(self.client.stop(), "stop of who is revoked")
            self.client.hover(f"{who} is revoked")  # at once: the task above begins a turn later
            self.client.note(f"{who} is revoked: this aircraft hovers", "error")

    def _tell_damage(self) -> None:
        if self._order_log.damaged:
            self.client.note(
                f"{self._order_log.damaged} records of the order log are damaged or gone: earlier "
                "orders are unknown and not carried out; no aircraft is landed for an earlier run",
                "error",
            )

    async def require_alone(self) -> None:
        """Refuse a name that another agent has: both would obey.

        The token of a killed agent can still be seen for a while.
        """
        deadline = self.client.now + _DUPLICATE_S
        while await self._bus.tokens(self._keys.live, timeout=1.0):
            if self.client.now >= deadline:
                raise UsageError(
                    f"another agent is named {self._keys.name}",
                    remedy="give this aircraft another name, or end the other agent",
                )
            await asyncio.sleep(0.2)

    # -- reports ---------------------------------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        if event.topic in (EventTopic.STOPPED, EventTopic.HALTED):
            self._ages.revoke(self.client.now)  # asked for at the station, too
        self._event.put(payloads.pack(event))

    def _on_sample(self, sample: Sample) -> None:
        if self._wall.is_wanted():
            self._wall.put_later(self._thinned, sample)
        if self._full.is_wanted():
            self._full.put(_package(sample))

    def _thinned(self, sample: Sample) -> bytes:
        goes_on = self._thinner.goes_on(sample.flags, sample.received_at)
        return _package(sample) if goes_on else b""

    def _tell_state(self) -> None:
        self._state.put_later(self._packed)
        self._look_for_duplicates()
        self._ages.look(self.client.now)

    def _packed(self) -> bytes:
        return payloads.pack(self.card())

    async def _look_at_disks(self, disks: Callable[[], M100Error | None]) -> None:
        while True:
            self._disk_fault = fault_of(await asyncio.to_thread(disks))
            await asyncio.sleep(_DISKS_S)

    def _on_own_state(self, key: str, payload: bytes) -> None:
        try:
            card: payloads.Card = payloads.unpack(payloads.Card, payload)
        except MessageError:
            return  # of another version, or nothing that an agent tells
        self.duplicates.hear(card.boot, self.client.now)
        self._look_for_duplicates()

    def _look_for_duplicates(self) -> None:
        """An operator would see two aircraft as one: the aircraft hovers, and reports it."""
        client, had = self.client, self._is_duplicate
        if not had and not self.duplicates:
            return
        self._is_duplicate = self.duplicates.is_there(client.now)
        if self._is_duplicate and not had:
            text = f"another agent is named {self._keys.name}: this aircraft hovers until one ends"
            if client.holder.number in self._orders.leases:  # a show flies by what is on board
                client.hover(text)
            client.note(text, "error")
        elif had and not self._is_duplicate:
            client.note(f"no other agent is named {self._keys.name} any more")

    def card(self) -> payloads.Card:
        view, state = self.client.view, self.client.state
        position, battery, phase = view.get(Position), view.get(Battery), view.phase
        return payloads.Card(
            name=self._keys.name,
            boot=self.boot,
            at=self._utc(),
            connection="lost" if view.hearing is Hearing.SILENT else state.connection,
            fault=state.connection_fault or state.activation_fault or self._disk_fault,
            firmware=state.firmware,
            holder=view.holder.name,
            fence=view.holder.number,
            has_authority=view.has_authority,
            task=state.task
            or state.pattern
            or (state.guided.what if state.guided else "")
            or self.missions.words,
            phase="" if phase is None else _PHASES[phase],
            height_m=position.height_m if position is not None else None,
            latitude_deg=position.latitude_deg if position is not None else None,
            longitude_deg=position.longitude_deg if position is not None else None,
            battery_percent=battery.percent if battery is not None else None,
            lost=self._lost_plan.action,
            lost_after=self._lost_plan.after_s,
            version=m100link.__version__,
        )

    def _on_state(self, question: Question) -> None:
        question.answer(self._keys.state, payloads.pack(self.card()))

    def _on_mission(self, question: Question) -> None:
        now = self.client.now
        if now - self._mission_at >= _AS_GOOD_AS_NEW_S:
            self._mission = payloads.pack(self.missions.card(self._keys.name, self.boot))
            self._mission_at = now
        question.answer(self._keys.mission, self._mission)

    # -- orders ----------------------------------------------------------------------------------

    def _on_order(self, key: str, question: Question) -> None:
        if len(question.payload) <= _READ_AT_ONCE_BYTES:
            self.client.background.spawn(self._answer_order(key, question), "order of the fleet")
        elif len(self._long) < _MAX_LONG_ORDERS:
            self._long.append((key, question))
            self._has_long.set()
        else:
            question.drop()  # its sender asks again

    async def _answer_long(self) -> None:
        """Long orders one after the other, with time between them: STOP is short."""
        while True:
            await self._has_long.wait()
            work = self._answer_order(*self._long.popleft())
            if not self._long:
                self._has_long.clear()
            self.client.background.spawn(work, "order of the fleet")
            await asyncio.sleep(_LONG_ORDER_PAUSE_S)

    async def _answer_order(self, key: str, question: Question) -> None:
        # The key of this aircraft, whatever pattern was asked: of several answers under one key
        # the network hands over one, and hides the other's failure.
        heard: payloads.OrderMessage | None = None
        try:
            order = payloads.unpack(payloads.OrderMessage, question.payload)
            heard = order
            is_repeated = self._order_cache.heard(order.id, order.digest)
            if not is_repeated:
                self._begin(order)
        except M100Error as error:
            if self.client.now - self._refused_at >= 1.0:  # a flood fills no disk
                self._refused_at = self.client.now
                self.note_order(heard, error)
            refused = self._reply("", error, clock=self.client.asked_at)
            question.answer(key, payloads.pack(refused))
            return
        await self._wait(order.id)
        question.answer(key, payloads.pack(self._reply_to(order.id, is_repeated=is_repeated)))

    def _begin(self, order: payloads.OrderMessage) -> None:
        if not _ID.fullmatch(order.id):
            raise MessageError("the id of an order is 32 hexadecimal digits")
        asked = admit(order, self._keys, orders.Order, self._verify, self.boot)
        now = self.client.now
        try:
            self._require_now(order, asked, now)
        except M100Error as error:
            if self._verify is None:
                raise
            # Signatures let an order through once: the same again hears the same.
            self._order_cache.begin(order.id, order.digest, now)
            self._end(order, error)
            return
        self._order_cache.begin(order.id, order.digest, now)
        work = self._carry_out(order, asked)
        self._running[order.id] = self.client.background.spawn(work, "order of the fleet")

    def _require_now(self, order: payloads.OrderMessage, asked: orders.Order, now: float) -> None:
        if asked.moves:
            self.duplicates.require_none(now)
        if self._may_have_begun(order, asked):  # whatever it comes under now
            raise _begun_before()
        if asked.is_kept:
            # Looked at before a stranger's words are worth a disk's time.
            if self._orders.lease_for(order, asked) is not None:
                self._ages.hear(order.fence, asked.after_stop, order.clock, now)
        elif asked.age is Age.YOUNG or (asked.age is Age.YOUNG_IF_KNOWN and order.clock):
            self._ages.require_young(asked.after_stop, order.clock, now)
        if asked.right is Right.STOP:
            self._ages.revoke(now)

    def _may_have_begun(self, order: payloads.OrderMessage, asked: orders.Order) -> bool:
        """Whether an agent before began it, or may have where its order log is damaged."""
        is_of_before = order.fence and asked.is_kept and self._order_cache.is_unsure(order.clock)
        return bool(is_of_before) or self._order_cache.was_begun_before(order.id)

    async def _carry_out(self, order: payloads.OrderMessage, asked: orders.Order) -> None:
        try:
            if asked.is_kept:
                keeping = self._order_log.begin(order.id)
                if asked.ends:  # a flight home waits for no disk, nor is refused for want of it
                    self.client.background.spawn(keeping, "order log")
                else:
                    await keeping
                    self._ages.check(asked.after_stop, order.clock, self.client.now)
            self._end(order, None, **await self._orders.carry_out(order, asked))
        except M100Error as error:
            self._end(order, error)
        except BaseException:
            failed = "the agent failed while it did this"
            self._end(order, OutcomeUnknown(failed, remedy="see its log"))
            raise
        finally:
            del self._running[order.id]

    def _end(self, order: payloads.OrderMessage, error: M100Error | None, **more: Any) -> None:
        reply = self._reply(order.id, error, order=order.digest, **more)
        self._order_cache.end(reply, self.client.now)
        self.note_order(order, error)

    def note_order(self, order: payloads.OrderMessage | None, error: M100Error | None) -> None:
        """Write an order and its outcome into the audit log."""
        if self.audit is None or order is None or isinstance(order.order, _UNNOTED):
            return
        if isinstance(error, GuardRefused) and error.guard == ORDER_AGE and not order.clock:
            return  # its program does not know the time here yet, and asks again by this answer
        who = {"by": order.by[:_MOST_NAME], "signer": order.signer[:_MOST_NAME]}
        what = getattr(order.order, "label", type(order.order).__name__)
        outcome = payloads.Outcome.OK if error is None else payloads.outcome_of(error)
        why = {} if error is None else {"why": error.seen}
        ordered = {"ordered_at": round(order.at, 3)} if is_time(order.at) else {}
        ended = {"order": what, **ordered, "outcome": outcome.value, **why}
        self.audit.add({**who, **ended, "id": order.id})

    def _reply(self, identity: str, error: M100Error | None, **more: Any) -> payloads.OrderReply:
        return payloads.OrderReply.done(identity, self._keys.name, self.boot, error, **more)

    async def _wait(self, identity: str) -> None:
        if identity in self._running:  # where it runs on, the reply says so
            await asyncio.wait({self._running[identity]}, timeout=HOLD_S)

    def _reply_to(self, identity: str, *, is_repeated: bool) -> payloads.OrderReply:
        reply = self._order_cache.reply(identity)
        if reply is None:
            if self._order_cache.is_known(identity):
                progress = payloads.Progress.RUNNING
            elif self._order_cache.was_begun_before(identity):
                return self._reply(identity, _begun_before(), clock=self.client.asked_at)
            else:
                progress = payloads.Progress.NEVER
            reply = payloads.OrderReply(identity, self._keys.name, self.boot, progress)
        return replace(reply, clock=self.client.asked_at, is_repeated=is_repeated)

    def _on_status(self, question: Question) -> None:
        self.client.background.spawn(self._answer_status(question), "status of an order")

    async def _answer_status(self, question: Question) -> None:
        identity = question.key.rpartition("/")[2]
        if not _ID.fullmatch(identity):  # a pattern asks for no order
            question.drop()
            return
        await self._wait(identity)
        reply = payloads.pack(self._reply_to(identity, is_repeated=True))
        question.answer(self._keys.status(identity), reply)

    def _on_setpoint(self, key: str, payload: bytes) -> None:
        if len(payload) > _READ_AT_ONCE_BYTES:
            self.dropped[Dropped.DAMAGED] += 1
            return
        try:
            found = payloads.unpack_steer(payload, self._orders.secret)
        except MessageError:
            self.dropped[Dropped.DAMAGED] += 1
            return
        if found is None:
            self.dropped[Dropped.STALE] += 1
            return
        steer, begins = found
        if self._is_duplicate:
            self.dropped[Dropped.DUPLICATE] += 1
            return
        holder = self.client.holder
        why = self._stream.drop(steer, begins=begins, fence=holder.number, now=self.client.now)
        if why is not None:
            self.dropped[why] += 1
            if why is Dropped.BROKEN:
                self._orders.refused = broken()
            return
        self.client.steer(self._orders.leases[steer.fence].lease, steer.setpoint, steer.lifetime)

    def _steer_refused(self, fence: int, error: M100Error) -> None:
        """The operator learns it with the next renewal of the lease, twice a second."""
        self._orders.refused = error


class _Moment:
    """One of five moments of a second, at which many agents of a process tell of themselves.

    Of hundreds at one moment some would be lost, and a timer for each would cost as much again.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, after_s: float) -> None:
        self._loop, self.tells = loop, list[Callable[[], None]]()
        self._due = loop.time() + (after_s - loop.time()) % _CARD_S
        self._timer = loop.call_at(self._due, self._tell)

    def _tell(self) -> None:
        late = max(0.0, self._loop.time() - self._due)
        self._due += _CARD_S * (1 + late // _CARD_S)
        self._timer = self._loop.call_at(self._due, self._tell)
        for tell in self.tells.copy():
            with goes_on("the state of an agent"):
                tell()

    def leave(self, tell: Callable[[], None]) -> None:
        self.tells.remove(tell)
        if not self.tells:
            self._timer.cancel()


_MOMENTS = 5
_moments: WeakKeyDictionary[asyncio.AbstractEventLoop, dict[int, _Moment]] = WeakKeyDictionary()


def _each_second(name: str, tell: Callable[[], None]) -> Callable[[], None]:
    """Call it once a second, at the moment of that name; returns what ends that."""
    loop, which = asyncio.get_running_loop(), zlib.crc32(name.encode()) % _MOMENTS
    known = _moments.setdefault(loop, {})
    moment = known.get(which)
    if moment is None or not moment.tells:
        moment = known[which] = _Moment(loop, _CARD_S / _MOMENTS * which)
    moment.tells.append(tell)
    return partial(moment.leave, tell)


_VERSION = bytes([payloads.VERSION])


def _package(sample: Sample) -> bytes:
    return _VERSION + pack_telemetry(sample.value, sample.profile.name, sample.received_at)


def _begun_before() -> OutcomeUnknown:
    return OutcomeUnknown(
        "the agent restarted after it had begun this order, or may have",
        cause="the agent was killed, or its computer restarted",
        remedy="look at the aircraft: the order may or may not have been carried out",
    )


# -- whether another agent has the name of this one (pure logic, ``now`` is an argument) -----------
# Each looks before it begins, but two behind routers that were joined later have both begun. Two
# aircraft then report under one name, and one order reaches both.


GONE_S = 5.0
"""Seconds without a word of the other one after which it is taken for gone."""

_SURE_S = 0.5
"""Seconds from its first word to its last that show that it lives: each tells once a second, and
one word alone may be the last of an agent that was killed."""
_MOST = 16


class DuplicateNames:
    """The other agents that one agent hears under its own name."""

    def __init__(self, name: str, boot: str) -> None:
        self._name, self._boot = name, boot
        # When each other run was heard first and last.
        self._heard: dict[str, tuple[float, float]] = {}

    def hear(self, boot: str, now: float) -> None:
        """A message came under this name. ``now``: s."""
        if boot == self._boot:
            return
        self._heard = {one: at for one, at in self._heard.items() if now - at[1] <= GONE_S}
        if boot in self._heard or len(self._heard) < _MOST:
            first, _ = self._heard.get(boot, (now, now))
            self._heard[boot] = first, now

    def __bool__(self) -> bool:
        """Whether any was heard."""
        return bool(self._heard)

    def is_there(self, now: float) -> bool:
        return any(
            last - first >= _SURE_S and now - last <= GONE_S for first, last in self._heard.values()
        )

    def require_none(self, now: float) -> None:
        """Refuse an order to this name where two aircraft have it."""
        if self.is_there(now):
            raise UsageError(
                f"two agents are named {self._name}: neither moves its aircraft",
                cause="they began behind different routers, which were linked later",
                remedy="end one of them, and rename its aircraft; both still obey stop and land",
            )
