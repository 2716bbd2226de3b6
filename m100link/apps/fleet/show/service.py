"""Orders about a show at one agent, and its answers.

Orders are those of the fleet, signed as all are. The stage of the aircraft admits each, so that an
order that comes twice does nothing. The conductor asks for the stage.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import ExitStack

from m100link.apps.agent.background import goes_on
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import MessageError
from m100link.apps.agent.orders import AfterStop
from m100link.apps.bus.network import Bus, Question
from m100link.apps.fleet import payloads
from m100link.apps.fleet.agent import DuplicateNames, Verify, admit
from m100link.apps.fleet.identity import Since
from m100link.apps.fleet.keys import Keys, name_in
from m100link.apps.fleet.show.plan.conflicts import ConflictMonitor, Neighbours
from m100link.apps.fleet.show.plan.track import MAX_POINTS, BadShow
from m100link.apps.fleet.show.track_executor import TrackExecutor
from m100link.errors import M100Error, NotAllowed

_TELL_S = 0.2
_MOST_ORDER = 4096
"""Bytes: a piece of a track has 2048 with all that is around it."""
_MOST_KNOWN = 1024
_MOST_BYTES = 32 * MAX_POINTS + 1024


class Beside:
    """The aircraft that one process serves: its session of the network does not hear itself."""

    def __init__(self) -> None:
        self._hear: list[Callable[[ConflictMonitor], None]] = []

    def hear(self, take: Callable[[ConflictMonitor], None]) -> Callable[[], None]:
        """Hear where each of them will be, until the returned function is called."""
        self._hear.append(take)
        return lambda: self._hear.remove(take)

    def tell(self, ahead: ConflictMonitor) -> None:
        for take in self._hear:
            take(ahead)


class ShowService:
    def __init__(
        self,
        client: AgentClient,  # what knows its agent
        bus: Bus,
        keys: Keys,
        boot: str,  # which run of the agent it is
        *,
        # Looks at each order; without it the router alone decides who may ask.
        verify: Verify | None = None,
        # Whether another agent has its name: then it does not begin.
        names: DuplicateNames | None = None,
        # Other aircraft of the same session; None where it has one of its own.
        beside: Beside | None = None,
        # Keeps an order and its outcome for the audit log.
        note: Callable[[payloads.OrderMessage, M100Error | None], None] = lambda *_: None,
    ) -> None:
        self._client = client
        self._bus = bus
        self._keys = keys
        self._boot = boot
        self._verify, self._note = verify, note
        self._duplicates = names
        self._beside = beside or Beside()
        self.performer = TrackExecutor(client, keys.name)
        # The outcome of orders that were let through: the network may bring one twice.
        self._known: dict[bytes, M100Error | None] = {}
        self._pieces = bytearray()
        self._placed_by = ""

    async def run(self) -> None:
        """Answer until this is cancelled; whatever flies then leaves the show, and hovers."""
        with ExitStack() as stack:
            stack.callback(self.performer.close)
            served = self._bus.serve(self._keys.show, self._on_order, is_first=payloads.ends)
            stack.callback(served.close)
            places = self._bus.publish(self._keys.place)
            stack.callback(places.close)
            everybody = Keys(self._keys.site).place
            stack.callback(self._bus.subscribe(everybody, self._on_place).close)
            stack.callback(self._beside.hear(self._hear))
            while True:
                # Whatever fails here: the track is flown by another task, which sees to that.
                self.performer.ages.look(self._client.now)
                with goes_on("the telling of its place"):
                    ahead = self.performer.ahead()
                    if ahead is not None:
                        self._beside.tell(ahead)
                        places.put(bytes([payloads.VERSION]) + ahead.to_bytes())
                await asyncio.sleep(_TELL_S)

    def shut_out(self, revoked: Since) -> None:
        """Leave the show of a revoked signer: the aircraft hovers."""
        since = self._placed_by and revoked(self._placed_by)
        if since:
            seen, remedy = f"{self._placed_by} is revoked since {since}", "conduct as somebody else"
            self.performer.give_way(NotAllowed(seen, remedy=remedy))

    def _on_place(self, key: str, payload: bytes) -> None:
        if self.performer.neighbours is None or payload[:1] != bytes([payloads.VERSION]):
            return
        try:
            ahead = ConflictMonitor.from_bytes(payload[1:])
        except BadShow:
            return  # nothing that an aircraft tells
        if ahead.name == name_in(key):
            self._hear(ahead)

    def _hear(self, ahead: ConflictMonitor) -> None:
        self.performer.hear(ahead)

    def _on_order(self, question: Question) -> None:
        if len(question.payload) > _MOST_ORDER:
            question.drop()  # before it costs the time that STOP needs
            return
        identity, fault = "", None
        try:
            order: payloads.OrderMessage = payloads.unpack(payloads.OrderMessage, question.payload)
            identity, digest = order.id, order.digest
            if digest not in self._known:  # by its id somebody else's would be taken for it
                asked = admit(order, self._keys, payloads.ShowOrder, self._verify, self._boot)
                try:
                    self._do(order, asked)
                    self._known[digest] = None
                except M100Error as error:
                    self._known[digest] = error
                self._note(order, self._known[digest])
                if len(self._known) > _MOST_KNOWN:
                    del self._known[next(iter(self._known))]
            fault = self._known[digest]
        except M100Error as error:
            fault = error
        question.answer(self._keys.show, payloads.pack(self._reply(identity, fault)))

    def _do(self, order: payloads.OrderMessage, asked: payloads.ShowOrder) -> None:
        performer = self.performer
        if not isinstance(asked, payloads.AskShow):  # the answer says where it stands
            performer.require_run(asked.run)
        performer.heard(asked.run)
        began_at = order.since or order.clock
        if isinstance(asked, payloads.LoadTrack | payloads.TakePlace | payloads.StartShow):
            # It takes off: not minutes later, when the conductor has given up, nor behind a STOP
            # since the show was begun, such as while its tracks were uploaded.
            performer.ages.check(AfterStop.ANEW, order.clock, self._client.now, began_at)
        flies = isinstance(asked, payloads.TakePlace | payloads.StartShow)
        if flies and self._duplicates is not None:
            self._duplicates.require_none(self._client.now)
        match asked:
            case payloads.SendTrack():
                self._take_piece(asked.at, asked.data)
            case payloads.LoadTrack():
                others = Neighbours(asked.show, self._keys.name, asked.least_m, asked.others)
                known = others if asked.show else None
                performer.load(bytes(self._pieces), asked.leave, known, asked.run)
            case payloads.TakePlace():
                self._placed_by = order.signer
                performer.place(order.signer or order.by, began_at)
            case payloads.StartShow():
                performer.start(asked.digest, asked.at, asked.bound)
            case payloads.LeaveShow():
                performer.end_early()

    def _take_piece(self, at: int, data: bytes) -> None:
        """A track comes in pieces: from the beginning, and each where the one before ended."""
        if not 0 <= at <= len(self._pieces) or at + len(data) > _MOST_BYTES:
            raise MessageError(
                f"a piece of a track at {at} comes behind {len(self._pieces)} bytes",
                cause="two programs upload tracks to the same aircraft, or a track is far too long",
                remedy="upload the track again from its beginning",
            )
        self._pieces[at:] = data

    def _reply(self, identity: str, error: M100Error | None) -> payloads.OrderReply:
        performer = self.performer
        track, why = performer.track, performer.fault
        card = payloads.ShowCard(
            # Its conductor waits for the end of the landing, too, and hears what came of it.
            payloads.ShowStage.FLYING if performer.is_landing else performer.stage,
            "" if track is None else track.digest,
            performer.farthest_m,
            "" if why is None else why.seen,
        )
        now = self._client.now
        return payloads.OrderReply.done(
            identity, self._keys.name, self._boot, error, clock=now, show=card
        )
