"""Asks one aircraft of a fleet for something, and finds out the outcome.

A missing answer says nothing. The asker then asks for the outcome by the id of the order: an agent
that never heard of it gets the same order again, any other agent says how it ended. An order that
may have been carried out never gets a new id.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
import uuid
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from functools import partial
from typing import Self

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.latency import ClockEstimate
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import MessageError, RemoteError
from m100link.apps.bus.network import Bus, QueryAnswer
from m100link.apps.fleet.identity import Signer
from m100link.apps.fleet.keys import Keys, session_in
from m100link.apps.fleet.payloads import (
    Asked,
    Half,
    LeaseRequest,
    OrderMessage,
    OrderReply,
    Outcome,
    Progress,
    pack,
    unpack,
)

PATIENCE_S = 10.0
"""Seconds without any answer after which the outcome counts as unknown.

With a delay of 3 s in each direction an answer takes 6.5 s, and lost messages are repeated.
"""

_logger = logging.getLogger(__name__)

_AGAIN_S = 0.1
_NEVER = (math.inf, 0.0, "")
RIGHTS = "m100link fleet acl check FILE --who NAME, with the router's fleet file"

Sign = Callable[[OrderMessage, str], OrderMessage]
"""Signs an order, with the proof of the lease of which it gets the secret; empty for none."""


def nobody_there(keys: Keys) -> errors.Unreachable:
    named = "" if keys.name == "*" else f" named {keys.name}"
    return errors.Unreachable(
        f"no agent{named} is there at site {keys.site}; nothing was sent",
        remedy="m100link fleet list shows the aircraft that are present",
    )


unsigned: Sign = OrderMessage.under
"""Without an identity the router alone decides who may ask."""


class Asker:
    def __init__(
        self,
        bus: Bus,
        keys: Keys,  # of the aircraft
        name: str,  # who asks, for people
        *,
        sign: Sign = unsigned,
        # Seconds without any answer after which the outcome is unknown.
        patience: float = PATIENCE_S,
        # Ids of those that are known to show its token, without asking anybody.
        sessions: Callable[[], Collection[str]] = frozenset,
        utc: Callable[[], float] = time.time,  # POSIX time, s
        # By aircraft: since when its program, which took control, has heard of no STOP, s; what the
        # agent's clock showed before then, s, and in which run.
        unstopped: dict[str, tuple[float, float, str]] | None = None,
    ) -> None:
        self._unstopped = {} if unstopped is None else unstopped
        self._known = sessions
        self._found: frozenset[str] = frozenset()
        self.bus, self.keys = bus, keys
        self._name = name
        self._sign = sign
        self.patience = patience
        self._utc = utc
        self._clock = asyncio.get_running_loop().time
        # The agent's own clock by the event loop's, from every answer that says what it shows.
        self.its_clock = ClockEstimate()
        self.its_boot = ""  # the run of the agent that answered last
        self._shown = 0.0  # what its clock showed in the answers of that run at most, s
        # Clocks of several agents that answered; which is the aircraft is unknown.
        self.doubtful_clocks: list[float] = []

    def require(self, right: orders.Right, *, ends: bool = False) -> None:
        """Name a missing right before anything is sent.

        An order that ends a flight is sent all the same: the file here may be an old one.

        Raises NotAllowed: the fleet file here does not give it, and nothing was sent.
        """
        sign = self._sign
        refused = sign.refusal(right, self.keys.name) if isinstance(sign, Signer) else None
        if refused is not None and not ends:
            raise refused
        if refused is not None:
            seen = refused.seen.partition(";")[0]
            _logger.warning("%s: %s; it is sent, and its agent decides", seen, refused.cause)

    async def is_there(self) -> bool:
        if self._known():
            return True
        tokens = await self.bus.tokens(self.keys.live, timeout=self.patience)
        self._found = frozenset(map(session_in, tokens))
        return bool(self._sessions)

    @property
    def _sessions(self) -> Collection[str]:
        return self._known() or self._found

    async def ask(
        self,
        asked: orders.Order,  # what
        *,
        fence: int = 0,  # number of the lease it is asked under; 0 for none
        token: str = "",  # secret of that lease; it is proved, and not sent
        # The agent's own clock, at the earliest, s; by default what it shows now, from its answers.
        # An order that moves has to say it, and is not carried out when it is old.
        clock: float = 0.0,
        identity: str = "",  # of the order; a new one by default
        # When the first step of its request was wanted, by the same clock; by default as `clock`.
        since: float = 0.0,
        patience: float | None = None,
    ) -> OrderReply:
        """Ask for something, and wait for what becomes of it.

        ``patience``: seconds without any answer after which the outcome is unknown.

        Raises:
            Unreachable: No agent of that name is there; nothing was sent.
            OutcomeUnknown: Its outcome is unknown.
            StaleLease: The lease is not in force.
            NotAllowed: The agent refused the signer, or the fleet file here does.
            M100Error: The error that the agent reports.
        """
        if not isinstance(asked, orders.AskVersion):  # by which an end learns the time there
            self.require(asked.right, ends=asked.ends)
        asked_at = self._clock()
        if not await self.is_there():
            raise nobody_there(self.keys)
        order = self.around(asked, fence, token, clock, identity, since)
        key = self.keys.lease if isinstance(asked, orders.LeaseOrder) else self.keys.command
        within = self.patience if patience is None else patience
        reply = await self._answered(key, order, within)
        if self._was_news(reply, order):
            order = self.around(asked, fence, token, self.its_time(asked_at), since=since)
            reply = await self._answered(key, order, within)
        if isinstance(asked, orders.Stop) and reply.outcome is not Outcome.NOT_ALLOWED:
            self.hear_of_stop()
        return self._raised(reply)

    def _was_news(self, reply: OrderReply, order: OrderMessage) -> bool:
        """Whether a refusal is the first to show the time there, by which the order is fresh.

        Where a calendar is wrong nothing else shows its age.
        """
        return reply.outcome is Outcome.NOT_ALLOWED and order.boot != self.its_boot

    def unstopped_since(self) -> float:
        """Since when this program has heard of no STOP, s; from now on at the latest."""
        return self._unstopped.setdefault(self.keys.name, (self._clock(), 0.0, ""))[0]

    def hear_of_stop(self) -> None:
        """The program ordered it, or is refused for it: what it asks for next it means."""
        _, shown, boot = self._unstopped.get(self.keys.name, _NEVER)
        shown = max(self._shown, shown) if boot == self.its_boot else self._shown
        self._unstopped[self.keys.name] = self._clock(), shown, self.its_boot

    def _raised(self, reply: OrderReply) -> OrderReply:
        try:
            return _raised(reply)
        except errors.GuardRefused as error:
            if error.guard == "stopped":
                self.hear_of_stop()
            raise

    def lease_request(
        self, offer: str = "", clock: float = 0.0, since: float = 0.0
    ) -> LeaseRequest:
        """For :meth:`take_lease`; an offer confirms a take-over. Times: as in :meth:`ask`."""
        half = Half()
        asked = orders.ConfirmTakeOver(offer) if offer else orders.AcquireLease(self._name)
        return LeaseRequest(self.around(asked, clock=clock, since=since, key=half.public), half)

    async def take_lease(self, request: LeaseRequest) -> tuple[Lease, float]:
        """Ask for the lease, whose secret this side and the agent then know and nobody else.

        Returns the lease, and the agent's time in its answer, s. Raises: as :meth:`ask`.
        """
        self.require(orders.AcquireLease.right)
        if not await self.is_there():
            raise nobody_there(self.keys)
        reply = self._raised(await self._answered(self.keys.lease, request.order, self.patience))
        return request.lease(reply), reply.clock

    async def renew(self, lease: Lease, *, within: float) -> OrderReply | None:
        """Renew a lease: what may be asked again, and nobody else can say.

        Returns the answer; None when none came in time that can be read, which says nothing.
        Raises: as :meth:`ask`.

        ``within``: seconds.
        """
        asked_at = self._clock()
        order = self.around(orders.RenewLease(), lease.number, lease.token)
        answers = await self.bus.ask(self.keys.lease, pack(order), timeout=within)
        reply = self._read(answers, order, asked_at)
        if not isinstance(reply, OrderReply) or reply.progress is not Progress.DONE:
            return None  # anybody may answer nonsense: it ends nothing that silence would not
        return _raised(reply)

    async def look(self, order: OrderMessage | None = None, *, within: float) -> OrderReply | None:
        """Ask once what became of an order; of none, what time it is there.

        Returns the answer, whatever it says; None when none came in time that can be read.

        ``within``: seconds. Raises OutcomeUnknown: two agents answered, or the reply belongs to
        another order.
        """
        asked = order or self.around(orders.AskVersion())
        asked_at = self._clock()
        answers = await self.bus.ask(self.keys.status(asked.id), timeout=within)
        reply = self._read(answers, asked, asked_at)
        return reply if isinstance(reply, OrderReply) else None

    async def once(
        self, key: str, asked: Asked, *, within: float, began_at: float = math.inf
    ) -> OrderReply | None:
        """Ask once, by a new order, what is asked under a key of its own.

        ``began_at``: when its request began, by the event loop's clock, s; by default now.

        Returns the answer, whatever it says; None when none came in time. Raises MessageError: the
        answer cannot be read. Raises OutcomeUnknown: two agents answered, or the reply belongs to
        another order. Raises NotAllowed: as :meth:`require`.
        """
        self.require(asked.right, ends=asked.ends)
        reply, order = await self._once(key, asked, within, began_at)
        if reply is not None and self._was_news(reply, order):
            reply, _ = await self._once(key, asked, within, began_at)
        return reply

    async def _once(
        self, key: str, asked: Asked, within: float, began_at: float
    ) -> tuple[OrderReply | None, OrderMessage]:
        asked_at = self._clock()
        order = self.around(asked, since=self.its_time(began_at))
        # Looked for beside it: what ends a show waits for nothing.
        answers, _ = await asyncio.gather(
            self.bus.ask(key, pack(order), timeout=within), self.is_there()
        )
        reply = self._read(answers, order, asked_at)
        if isinstance(reply, MessageError):
            raise reply
        return reply, order

    def its_time(self, at: float) -> float:
        """The earliest time that its clock may have shown at that time of ours, s; 0: unknown.

        An answer to STOP shows a later time than the STOP. Orders after that answer are newer,
        however slow the answers are by which the clock is estimated.
        """
        now = self._clock()
        its = self.its_clock.at_least(now)
        since, shown, boot = self._unstopped.get(self.keys.name, _NEVER)
        if not its or at < since or boot != self.its_boot:
            shown = -math.inf
        return its and max(shown, its - max(0.0, now - at))

    def is_of_aircraft(self, answer: QueryAnswer) -> bool:
        """Whether it is proved, or comes from a session that shows the aircraft's token."""
        return answer.is_proved or answer.session in self._sessions

    def around(
        self,
        asked: Asked,
        fence: int = 0,
        token: str = "",
        clock: float = 0.0,
        identity: str = "",
        since: float = 0.0,
        key: bytes = b"",
    ) -> OrderMessage:
        """A new order, signed; see :meth:`ask`."""
        head = (identity or uuid.uuid4().hex, self.keys.site, self.keys.name, self._name)
        clock = clock or self.its_time(math.inf)
        made = OrderMessage(
            *head, fence, self._utc(), asked, clock, self.its_boot, since=since, key=key
        )
        return self._sign(made, token)

    async def _answered(self, key: str, order: OrderMessage, patience: float) -> OrderReply:
        payload, status = pack(order), self.keys.status(order.id)
        silent_since = began = self._clock()
        sent = 0  # the question that the order was; 0: it is to be sent
        begun = 0  # the newest one that the agent reported as begun
        async with Questions(self.bus) as questions:
            while (left := silent_since + patience - self._clock()) > 0:
                if not sent:
                    # Only what never arrived is sent, and sent again.
                    sent = questions.ask(key, payload, within=left)
                elif questions.is_due:
                    questions.ask(status, within=left)
                ended = await questions.answered(min(left, questions.left))
                number, answers = ended or (0, [])
                reply = self._read(answers, order, began)
                if isinstance(reply, MessageError):
                    # The agent may well have done it, but its answer cannot be read.
                    raise errors.OutcomeUnknown(reply.seen, cause=reply.cause, remedy=reply.remedy)
                if reply is None:
                    if questions.is_due:  # nobody was there for the newest one, or it waits
                        await asyncio.sleep(_AGAIN_S)
                    continue
                silent_since = self._clock()
                if reply.progress is Progress.DONE:
                    return reply
                if reply.progress is Progress.RUNNING:
                    begun = max(begun, number)
                # Answers to questions before the order was sent again do not count.
                elif number > max(sent, begun):
                    if begun or self._clock() - began >= patience:
                        raise self._never_arrives(has_begun=bool(begun))
                    sent = 0
                    await asyncio.sleep(_AGAIN_S)
        raise errors.OutcomeUnknown(
            f"{self.keys.name} gave no answer for {patience:g} s",
            cause="the link is cut or slower than that, the agent hangs, or the router lets no "
            f"order of this identity pass: it has no right to {order.order.right.name.lower()}",
            remedy=f"look at the aircraft; {RIGHTS}",
        )

    def _never_arrives(self, *, has_begun: bool) -> errors.OutcomeUnknown:
        """It answers what became of the order, and does not know it, or not any more."""
        if has_begun:
            return errors.OutcomeUnknown(
                f"{self.keys.name} began the order, and does not know it any more",
                cause="its agent restarted without its order log",
            )
        return errors.OutcomeUnknown(
            f"{self.keys.name} answers, but has not heard of the order",
            cause="the router lets no such order of this identity pass, or the link loses it",
            remedy=RIGHTS,
        )

    def _read(
        self, answers: Iterable[QueryAnswer], order: OrderMessage, asked_at: float
    ) -> OrderReply | MessageError | None:
        """One answer, or why there are only such as cannot be read; None for none.

        ``asked_at``: when the question left at the earliest, s. Raises: as :func:`believed`.
        """
        came = list(answers)
        try:
            found = believed(came, self.keys, order.id, self._sessions, order.digest)
        except errors.OutcomeUnknown:
            self.doubtful_clocks = clocks_of(came, self.keys.name)
            raise
        if isinstance(found, OrderReply):
            self.its_clock.heard(asked_at, found.clock, self._clock())
            if found.boot not in ("", self.its_boot):
                self.its_boot, self._shown = found.boot, 0.0
            self._shown = max(self._shown, found.clock)
        return found


def reason_of(name: str, fault: RemoteError | None) -> errors.M100Error:
    return MessageError(f"{name} gave no reason") if fault is None else fault.error()


def _raised(reply: OrderReply) -> OrderReply:
    """The reply, if it is good; else raises the error that it means."""
    if reply.outcome is Outcome.OK:
        return reply
    error = reason_of(reply.name, reply.fault)
    kinds = {
        Outcome.STALE_LEASE: errors.StaleLease,
        Outcome.NOT_ALLOWED: errors.NotAllowed,
        Outcome.UNKNOWN: errors.OutcomeUnknown,
    }
    kind = kinds.get(reply.outcome)
    if kind is not None and not isinstance(error, kind):
        raise kind(error.seen, cause=error.cause, remedy=error.remedy) from error
    raise error


# -- questions to an agent that are open at the same time ------------------------------------------
# Over a way of seconds the answer to the first question comes when two others have been asked. It
# is an answer all the same, and what was lost is asked again without waiting for what may be under
# way.


STEP_S = 1.5
"""Seconds after which it is asked again, while earlier questions stay open."""

_MOST_DOUBLED = 5


class Questions:
    """Asks again and again; to be used as ``async with``, at whose end nothing is open."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._clock = asyncio.get_running_loop().time
        self._open: dict[asyncio.Task[list[QueryAnswer]], int] = {}
        self._asked_at = 0.0
        self._unanswered = 0
        self.newest = 0

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    @property
    def is_due(self) -> bool:
        """Whether it is to be asked again: the newest question has ended, or waits for long."""
        return self.left <= 0.0

    @property
    def left(self) -> float:
        """Seconds until it is to be asked again."""
        if self.newest not in self._open.values():
            return 0.0
        return self._asked_at + STEP_S - self._clock()

    def ask(self, key: str, payload: bytes = b"", *, within: float) -> int:
        """Ask; those that were asked before stay open.

        A question waits for longer, the more before it got no answer: where two agents serve a key
        and one of them hangs, the other one's answer is seen when the wait is over. Returns the
        number of the question.

        ``within``: seconds that an answer is of any use.
        """
        self._unanswered += 1
        longest = STEP_S * 2 ** min(self._unanswered, _MOST_DOUBLED)
        self.newest += 1
        self._asked_at = self._clock()
        asking = self._bus.ask(key, payload, timeout=min(within, longest))
        task = asyncio.create_task(asking, name="m100link: question to an agent")
        self._open[task] = self.newest
        return self.newest

    async def answered(self, within: float) -> tuple[int, list[QueryAnswer]] | None:
        """Wait until a question ends.

        Returns its number, and what was answered: nothing where nobody is there. None when none
        ended.

        ``within``: seconds.
        """
        if not self._open:
            return None
        done, _ = await asyncio.wait(
            self._open, timeout=within, return_when=asyncio.FIRST_COMPLETED
        )
        if not done:
            return None
        task = min(done, key=self._open.__getitem__)
        number = self._open.pop(task)
        answers = task.result()
        if answers and number == self.newest:
            self._unanswered = 0
        return number, answers


# -- decide which answer to an order to believe ----------------------------------------------------
# Any program on the network may answer for an aircraft. An answer is believed if the aircraft has
# signed it. Where nobody verifies signatures, it is believed if it comes from the only session that
# shows the aircraft's token. Answers that contradict each other are not believed.


def clocks_of(answers: Iterable[QueryAnswer], name: str) -> list[float]:
    """Return the clock, s, of each session that claims to be the aircraft of that name."""
    found = set()
    for one in answers:
        try:
            reply: OrderReply = unpack(OrderReply, one.payload)
        except MessageError:
            continue
        if reply.name == name:
            found.add(reply.clock)
    return sorted(found)


def believed(
    answers: Iterable[QueryAnswer],
    keys: Keys,
    identity: str,
    sessions: Collection[str],  # ids of the sessions that show the aircraft's token
    digest: bytes = b"",  # digest of the order, where a reply may name another one of the same id
) -> OrderReply | MessageError | None:
    """Return the answer of an aircraft to an order.

    Returns its reply, or the reason why no reply can be read; None when it did not answer. Answers
    of other sessions do not count. Raises OutcomeUnknown: two agents have that name, two answers
    say different things, or what they say is of another order.
    """
    replies: list[OrderReply] = []
    unread: MessageError | None = None
    is_proved = False  # then a token says nothing
    for one in answers:
        if not one.is_proved and one.session not in sessions:
            continue
        is_proved = is_proved or one.is_proved
        try:
            reply: OrderReply = unpack(OrderReply, one.payload)
        except MessageError as error:
            unread = error
            continue
        if reply.id in (identity, "") and reply.name == keys.name:
            replies.append(reply)
    is_double = len(sessions) > 1 and not is_proved
    if replies and (is_double or len({one.boot for one in replies}) > 1):
        raise errors.OutcomeUnknown(
            f"two agents are named {keys.name}: it is unknown which of them answered",
            cause="two agents were given one name, or a stranger poses as the aircraft",
            remedy="end one of them, and look at both aircraft",
        )
    # One agent gives one answer. When it was given, and whether it had been before, may differ.
    said = partial(replace, clock=0.0, is_repeated=False)
    if len(replies) > 1 and len(set(map(repr, map(said, replies)))) > 1:
        raise errors.OutcomeUnknown(
            f"two answers of {keys.name} to one order disagree",
            cause="a stranger answers in its name",
            remedy="look at the aircraft; a router with the rules of a fleet file stops strangers",
        )
    if replies and replies[0].order not in (b"", digest):
        raise errors.OutcomeUnknown(
            f"{keys.name} has another order under the same id",
            cause="a stranger heard the id and used it",
            remedy="look at the aircraft, and give the order again",
        )
    return replies[0] if replies else unread
