"""The channel from a client, such as a console on the ground, to an agent of a fleet.

The client says what it would say to an agent on its own machine. Here that becomes orders of the
fleet, with ids, signatures and ages, and setpoints stamped by the agent's clock. Messages of the
agent come back with times by the client's own clock: where two clocks differ, nothing old passes
for new.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import replace

from m100link.apps.agent import messages, orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.client import MAX_SILENCE
from m100link.apps.agent.lease import (
    LEASE_LIFETIME,
    TAKE_OVER_LIFETIME,
    Lease,
    LeaseRefused,
    TakeOver,
)
from m100link.apps.agent.transports import ChannelEnd
from m100link.apps.bus.network import Held
from m100link.apps.fleet.asking import Asker
from m100link.apps.fleet.payloads import OrderReply, pack_steer, unpack_message
from m100link.errors import GuardRefused, M100Error, StaleLease, UsageError
from m100link.protocol.setpoint import Setpoint

_logger = logging.getLogger(__name__)

_GREETING_S = 1.5
_CLOCK_S = 2.0
"""Seconds between two looks at the agent's clock."""

_RENEWAL_S = 0.4
"""A tab renews with each beat; that often it goes over the network, be the last answered or not."""

_LET_GO_S = 1.0
_UNANSWERED_S = 4.0

MOST_CLOCK_BOUND_S = 0.1
"""Seconds by which the agent's clock may be wrong; setpoints older than 0.2 s are not flown."""

_PAUSE_S = 0.5
"""Seconds without a setpoint after which the next one is a new decision."""

_MOST_LEASES = 8
_MOST_ASKS = 64


async def reach(asker: Callable[[str], Asker]) -> FleetChannel:
    channel, own = FleetChannel(asker), asker("")
    if not await own.is_there() or not await channel.look_at_clock():
        channel.close()
        why = channel.unread_why or f"{own.keys.name} does not answer"
        raise messages.agent_gone(why, messages.OTHER_RELEASE if channel.unread_why else "")
    return channel


class FleetChannel(ChannelEnd):
    """A front's end; see :class:`m100link.apps.agent.transports.Channel`.

    A lease that was granted here counts as lost when nothing that the agent says shows it in force
    for 3 s.
    """

    def __init__(
        self,
        asker: Callable[[str], Asker],
        *,
        # Whether what the agent tells is heard. Otherwise its answers are all that is known of it:
        # a program flies hundreds, and asks each for what it wants to know.
        hears: bool = True,
    ) -> None:
        super().__init__()
        self._hears = hears
        self._asker_of, self._asker = asker, asker("")
        self._bus, self._keys = self._asker.bus, self._asker.keys
        self._clock = asyncio.get_running_loop().time
        self._its_clock = self._asker.its_clock
        self._outlet = self._bus.publish(self._keys.setpoint)
        self._sent_at = -math.inf  # the newest setpoint
        self._background = TaskSet()
        self._held: list[Held] = []
        self._telemetry: Held | None = None
        self._is_full = False
        self._boot = ""
        self._is_closed = False
        # By the agent's clock: how new the word on the lease is that comes next, and when a lease
        # was granted to this front, whose answer overtakes earlier messages.
        self._newest_at = self._granted_at = 0.0
        self._holder = messages.LeaseChanged(0, "")
        self._leases: dict[int, Lease] = {}
        self._leasing: set[asyncio.Task[None]] = set()  # orders about the lease, under way
        self._renewed_at = -math.inf
        self._shown_at = 0.0  # when the agent showed the last time that the lease is in force
        self.lost: M100Error | None = None  # what the agent refused to renew it with
        # Why the newest setpoint with a report was not flown. A page shows what is true of
        # the newest beat: it is reported with each, until the agent says that they fly.
        self._unflown: messages.RemoteError | None = None
        self._asks = 0
        # Messages that this version cannot read, and that were too long on their way to say
        # anything.
        self.unread = self.old = 0
        self.unread_why = ""

    # -- the channel -----------------------------------------------------------------------------

    def open(
        self, on_message: Callable[[messages.Message], None], on_closed: Callable[[str], None]
    ) -> None:
        self._on_message, self._on_closed = on_message, on_closed
        bus, keys = self._bus, self._keys
        self._hand_over(messages.Hello(messages.VERSION, self._boot, self._clock()))
        if not self._hears:
            return
        self._held += [
            bus.subscribe(keys.told, self._hear),
            bus.subscribe(keys.event, self._hear),
            bus.watch(keys.live, self._token),
        ]
        self.watch(full=self._is_full)
        self._background.spawn(self._keep_clock(), "clock of an agent")

    def send(self, message: messages.Message) -> None:
        """Send a message; never waits. On a closed channel nothing happens."""
        if self._is_closed or isinstance(message, messages.Hello | messages.Goodbye):
            return
        # The journal on board takes no note from the network.
        if isinstance(message, messages.JournalNote):
            _logger.info("%s: %s", self._keys.name, message.text)
            return
        if isinstance(message, messages.Ask):
            self._send_ask(message)
        elif isinstance(message, messages.Steer):
            self._steer(message)
        else:
            raise messages.MessageError(f"a client does not send {type(message).__name__}")

    def close(self, reason: str = "") -> None:
        """Close it. Leases that were granted here end by silence; see :meth:`let_go`."""
        if self._is_closed:
            return
        self._is_closed, self._on_message = True, None
        for one in (*self._held, self._outlet, self._telemetry):
            if one is not None:
                one.close()
        self._background.cancel()

    def _end(self, reason: str) -> None:
        is_new, on_closed = not self._is_closed, self._on_closed
        self.close()
        if is_new and on_closed is not None:
            on_closed(reason)

    async def let_go(self, patience: float = _LET_GO_S) -> None:
        """Give back a lease granted here, or about to be: it hovers, and authority goes back.

        Before the close. ``patience``: seconds for the answer; then it is left to silence.
        """
        if self._leasing:
            await asyncio.wait(self._leasing, timeout=_LET_GO_S)
        lease = self._leases.get(self._holder.number)
        if lease is not None and not self._is_closed:
            try:
                await self._asker.ask(
                    orders.ReleaseLease(), fence=lease.number, token=lease.token, patience=patience
                )
            except StaleLease:
                pass  # it was on its way back already
            except M100Error as error:
                _logger.warning("%s: the lease ends by silence: %s", self._keys.name, error.seen)

    # -- what comes in ---------------------------------------------------------------------------

    def watch(self, *, full: bool) -> None:
        """Hear every package of telemetry, or what suffices for a wall."""
        if self._is_closed or (self._telemetry is not None and full is self._is_full):
            return
        before, self._is_full = self._telemetry, full
        key = self._keys.telemetry if full else self._keys.thinned
        self._telemetry = self._bus.subscribe(key, self._hear)
        if before is not None:
            before.close()

    def _token(self, _key: str, is_there: bool) -> None:
        if not is_there:
            self._end(f"the agent of {self._keys.name} is gone")

    async def _keep_clock(self) -> None:
        while True:
            await asyncio.sleep(_CLOCK_S)
            await self.look_at_clock()

    async def look_at_clock(self) -> bool:
        """Ask the agent what time it is there; whether it answered."""
        asked_at = self._clock()
        answers = await self._bus.ask(self._keys.told, timeout=_GREETING_S)
        answered_at = self._clock()
        for answer in answers:
            if not self._asker.is_of_aircraft(answer):
                continue
            message = self._read(answer.payload)
            if isinstance(message, messages.Hello) and self._greeted(message):
                self._its_clock.heard(asked_at, message.at, answered_at)
                return True
        return False

    def _greeted(self, hello: messages.Hello) -> bool:
        self._boot = self._boot or hello.name
        self._asker.its_boot = self._boot
        if hello.version != messages.VERSION:
            self.unread_why = f"it speaks version {hello.version}, this front {messages.VERSION}"
            self._hand_over(hello)  # the client closes it, and says what to do
            self.close()
        elif hello.name != self._boot:
            self._end(f"the agent of {self._keys.name} restarted")
        return not self._is_closed

    def _read(self, payload: bytes) -> messages.Message | None:
        try:
            return unpack_message(payload)
        except messages.MessageError as error:
            if not self.unread:
                _logger.warning(
                    "a message of %s cannot be read (more are only counted): %s",
                    self._keys.name,
                    error.seen,
                )
            self.unread, self.unread_why = self.unread + 1, error.seen
            return None

    def _hear(self, _key: str, payload: bytes) -> None:
        message = self._read(payload)
        if message is None or self._is_closed:
            return
        if isinstance(message, messages.Hello):
            self._newest_at = message.at if self._greeted(message) else self._newest_at
        elif isinstance(message, messages.LeaseChanged):
            self._lease_changed(message)
        else:
            self._deliver_in_time(message)

    def _deliver_in_time(self, message: messages.Message) -> None:
        """Hand over a message, with its time by this side's clock."""
        now = self._clock()
        if isinstance(message, messages.Telemetry):
            at = self._ours(message.received_at, now)
            message = replace(message, received_at=at)
        elif isinstance(message, messages.State | messages.LinkCounted | messages.Event):
            at = self._ours(message.at, now)
            message = replace(message, at=at)
        else:
            at = now
        # A message that waited in the network does not make a silent agent one that is heard.
        if now - at > MAX_SILENCE and not isinstance(message, messages.Event):
            self.old += 1
        else:
            self._hand_over(message)

    def _ours(self, its: float, now: float) -> float:
        known = self._its_clock.offset(now)
        return now if known is None else min(now, its - known.seconds)

    def _lease_changed(self, change: messages.LeaseChanged) -> None:
        if change.number >= self._holder.number or self._newest_at >= self._granted_at:
            self._shown_at = self._clock()
            self._hold(change)

    def _hold(self, change: messages.LeaseChanged) -> None:
        if change.number != self._holder.number:
            self._holder, self._unflown = change, None
            self._hand_over(change)

    # -- what goes out ---------------------------------------------------------------------------

    def _answer(
        self, identity: int, reply: OrderReply | None, error: M100Error | None = None
    ) -> None:
        if error is not None and not identity and not isinstance(error, StaleLease):
            _logger.warning("%s: %s", self._keys.name, error.seen)
        if not identity:
            return
        if error is not None:
            self._hand_over(
                messages.OrderOutcome(
                    identity, messages.Stage.FAILED, messages.RemoteError.of(error)
                )
            )
        elif reply is not None:
            self._hand_over(
                messages.OrderOutcome(identity, messages.Stage.DONE, None, reply.text, reply.number)
            )

    def _send_ask(self, ask: messages.Ask) -> None:
        order = ask.order
        if isinstance(order, orders.RenewLease) and not ask.id:
            lease = self._lease_of(order.token)
            if lease is not None:
                self._keep(lease)
            return
        if self._asks >= _MOST_ASKS and not order.ends:
            error = UsageError(f"{self._asks} orders of this client wait for answers already")
            self._answer(ask.id, None, error)
            return
        self._asks += 1
        # Stamped as it is said, not as its turn comes; it may be a step of an earlier request.
        clock = self._asker.its_time(math.inf)
        since = clock if ask.sent_at is None else self._asker.its_time(ask.sent_at)

        async def carry_out() -> None:
            try:
                if isinstance(order, orders.LeaseOrder):
                    await self._ask_lease(ask.id, order, clock, since)
                else:
                    lease = self._leases.get(ask.fence)
                    token = "" if lease is None else lease.token
                    asking = self._asker.ask(
                        order, fence=ask.fence, token=token, clock=clock, since=since
                    )
                    self._answer(ask.id, await asking)
            except M100Error as error:
                self._answer(ask.id, None, error)
            finally:
                self._asks -= 1

        asking = self._background.spawn(carry_out(), f"{order.label} of {self._keys.name}")
        if isinstance(order, orders.LeaseOrder):
            self._leasing.add(asking)
            asking.add_done_callback(self._leasing.discard)

    def _steer(self, steer: messages.Steer) -> None:
        try:
            lease = self._leases.get(steer.fence)
            # A client that steers renews nothing else meanwhile. A setpoint too late to be flown
            # renews no lease. Only renewals report that it was not flown, and how slow the link is.
            if lease is None or steer.fence != self._holder.number:
                raise LeaseRefused(f"lease {steer.fence} is not in force")
            self._keep(lease)
            self.fly(lease, steer.setpoint, steer.lifetime, made_at=steer.sent_at)
            if self._unflown is not None:
                self._hand_over(messages.SteerRefused(steer.fence, self._unflown))
        except M100Error as error:
            self._hand_over(messages.SteerRefused(steer.fence, messages.RemoteError.of(error)))

    def fly(
        self,
        lease: Lease,
        setpoint: Setpoint,
        lifetime: float,  # seconds that it lasts at the agent
        *,
        # When it was decided, on this event loop's clock, s; now by default.
        made_at: float | None = None,
        # Whether a stream begins with it; by default when none was sent for half a second.
        begins: bool | None = None,
    ) -> None:
        """Send a setpoint, by the agent's clock; UsageError: that is not known well enough."""
        now = self._clock()
        known = self._its_clock.offset(now)
        # The way may be slow since its clock was measured, or its clock was set since it was fast.
        if known is None or max(known.bound, self._its_clock.way_s) > MOST_CLOCK_BOUND_S:
            raise UsageError(
                f"the clock of {self._keys.name} is not known to {MOST_CLOCK_BOUND_S:g} s",
                cause="the round trip is too long for setpoints",
                remedy="fly by tasks and fly_to(), whose loops are closed on board",
            )
        # An old reading of its clock does not show how slow the link is by now.
        if (silent := self._its_clock.silent_s(now)) > _UNANSWERED_S:
            raise UsageError(
                f"{self._keys.name} has answered nothing for {silent:.0f} s: it is unknown whether "
                "it flies the setpoints",
                cause="the link is cut, or the round trip is too long",
                remedy="let go, and look where the aircraft is",
            )
        if begins is None:
            begins = now - self._sent_at > _PAUSE_S
        self._sent_at = now
        stamp = (now if made_at is None else made_at) + known.seconds
        steer = messages.Steer(lease.number, stamp, lifetime, setpoint)
        self._outlet.put(pack_steer(steer, lease.token, begins=begins))

    # -- the lease -------------------------------------------------------------------------------

    def _lease_of(self, token: str) -> Lease | None:
        """The lease that a front means, which was granted here."""
        return next((one for one in self._leases.values() if one.token == token), None)

    def _keep(self, lease: Lease) -> None:
        now, is_in_force = self._clock(), lease.number == self._holder.number
        if is_in_force and now - self._shown_at > LEASE_LIFETIME:
            self._lose()
        elif now - self._renewed_at >= _RENEWAL_S:
            # None waits for the answer to the one before: on board the lease ends 3 s after the
            # last one came, however long the answers take.
            self._renewed_at = now
            self._background.spawn(self._renew(lease), "renewal of a lease")

    async def _renew(self, lease: Lease) -> None:
        try:
            reply = await self._asker.renew(lease, within=LEASE_LIFETIME)
        except GuardRefused:
            return  # it came too late to renew anything, and says nothing of the lease
        except M100Error as error:
            if not self._hears and lease.number == self._holder.number:
                self._lose(error)  # else the agent tells who has it
            _logger.info("%s: %s", self._keys.name, error.seen)
            return
        if reply is not None and lease.number == self._holder.number:
            self._shown_at, self._unflown = self._clock(), reply.fault
            if reply.fault is not None:
                self._hand_over(messages.SteerRefused(lease.number, reply.fault))

    def _lose(self, error: M100Error | None = None) -> None:
        """The lease counts as ended; without an error: the agent was silent."""
        self.lost = error
        self._hold(messages.LeaseChanged(0, ""))

    async def _ask_lease(
        self, identity: int, order: orders.LeaseOrder, clock: float, since: float
    ) -> None:
        name, token = getattr(order, "name", ""), getattr(order, "token", "")
        asker = self._asker_of(name)
        asker.its_clock = self._its_clock
        if isinstance(order, orders.AcquireLease | orders.ConfirmTakeOver):
            request = asker.lease_request(token, clock, since)
            lease, its = await asker.take_lease(request)
            # No report ends any of them: it may be old, lost on the way, or of a stranger, and a
            # client that believes to have control has to be able to steer, and to give it back.
            kept = sorted({**self._leases, lease.number: lease}.items())
            self._leases = dict(kept[-_MOST_LEASES:])
            self._granted_at = self._newest_at = its
            self._lease_changed(messages.LeaseChanged(lease.number, lease.name))
            self._hand_over(messages.OrderOutcome(identity, messages.Stage.DONE, lease=lease))
            return
        held = self._lease_of(token)
        fence, secret = (0, "") if held is None else (held.number, held.token)
        plain = type(order)() if token else order
        reply = await asker.ask(plain, fence=fence, token=secret, clock=clock, since=since)
        if isinstance(order, orders.AskTakeOver):
            until = self._clock() + TAKE_OVER_LIFETIME
            offer = TakeOver(name, reply.text, reply.offer, reply.number, until)
            self._hand_over(messages.OrderOutcome(identity, messages.Stage.DONE, offer=offer))
        elif isinstance(order, orders.ReleaseLease):
            if fence == self._holder.number:
                self._hold(messages.LeaseChanged(0, ""))
            self._answer(identity, reply)
        else:
            lease = Lease(reply.text, token, reply.number)
            self._hand_over(messages.OrderOutcome(identity, messages.Stage.DONE, lease=lease))
