"""The leases of rosbridge clients: taken by opening control, alive as long as the socket.

A rosbridge client of 2015 knows nothing of leases. Opening control takes the lease if it is free;
it ends when the client closes control or its socket is gone. Newer clients use the service
``/m100link/lease``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient, given
from m100link.apps.agent.lease import Lease, LeaseRefused
from m100link.apps.station.ros.graph import Call, Graph, Listener
from m100link.apps.station.ros.messages import Message
from m100link.apps.station.web.limits import TokenBucket
from m100link.errors import CommandRefused, M100Error, NoAuthority, UsageError

TASKS: dict[int, orders.Order] = {4: orders.TakeOff(), 6: orders.Land(), 1: orders.GoHome()}
"""What DJI's nodes ask for by the number of a task."""

_RENEWAL = 0.5
_COMPLAINT_PAUSE = 1.0
_LEASE, _COMPLAINED_AT, _ORDERS = "lease", "complained at", "orders"
_RATE, _AT_ONCE = 2.0, 10.0


class Clients:
    """Which rosbridge client holds the lease."""

    def __init__(self, agent: AgentClient, graph: Graph) -> None:
        self._agent = agent
        self._graph = graph
        graph.on_leave.append(self._left)
        graph.add_service("/m100link/lease", "m100link/Lease", self._on_lease)
        agent.on_steer_refused.append(self._steer_refused)
        agent.background.spawn(self._keep_renewing(), "renewal")

    def lease(self, session: Listener) -> Lease | None:
        """The lease in force of that client."""
        held: Lease | None = self._graph.known(session).get(_LEASE)
        return held if self._agent.holds(held) else None

    async def take(self, session: Listener) -> Lease:
        """The lease of that client, which is taken now if it is free.

        Raises ``LeaseHeld``: another client has it. Raises ``NoAuthority``: the client has gone
        meanwhile.
        """
        held = self.lease(session)
        if held is None:
            held = await self._agent.acquire(session.name)
            if session not in self._graph.sessions:
                self._agent.let_go(held)
                raise NoAuthority(f"{session.name} has gone; control was not taken for it")
            self._graph.known(session)[_LEASE] = held
        return held

    def held(self, session: Listener) -> Lease:
        """The lease of that client.

        Raises ``NoAuthority``: it has none; who has is in the error.
        """
        held = self.lease(session)
        if held is None:
            holder = self._agent.holder
            who = f"{holder.name} has control" if holder.number else "nobody has control"
            raise NoAuthority(
                f"{who}; nothing was sent",
                remedy=f"open control first ({self._graph.prefix}/nav_open_close_request 1)",
            )
        return held

    def let_go(self, session: Listener) -> None:
        """Give that client's lease back, if it has one."""
        held = self.lease(session)
        self._graph.known(session).pop(_LEASE, None)
        if held is not None:
            self._agent.let_go(held)

    def complain(self, session: Listener, error: Exception) -> None:
        """Tell a client what is wrong, at most once a second: keys repeat thirty times."""
        now = self._agent.now
        if now - session.data.get(_COMPLAINED_AT, float("-inf")) >= _COMPLAINT_PAUSE:
            session.data[_COMPLAINED_AT] = now
            session.status("error", str(error))

    def admits(self, session: Listener) -> bool:
        """Whether the client may order one more thing now; it is told when it may not.

        What is ordered is told to people and asked of the aircraft, both of which a client could
        keep busy. Who has control may always order, and so always give it back.
        """
        if self.lease(session) is not None:
            return True
        now = self._agent.now
        allowance: TokenBucket = session.data.setdefault(_ORDERS, TokenBucket(_RATE, _AT_ONCE))
        if allowance.take(now):
            return True
        self.complain(session, UsageError(f"more than {_RATE:g} orders per second: not done"))
        return False

    def run(
        self,
        session: Listener,
        wish: Callable[[], Coroutine[Any, Any, None]],
        name: str,
    ) -> None:
        """Run a client's wish, unless it wishes too much; it is told when it fails."""
        if not self.admits(session):
            return
        work = wish()

        async def guarded() -> None:
            try:
                await work
            except M100Error as error:
                session.status("error", str(error))

        self._agent.background.spawn(guarded(), f"{name} for {session.name}")

    def offer(
        self, name: str, kind: str, handler: Callable[[Call], Coroutine[Any, Any, Message]]
    ) -> None:
        """Offer a service of ``dji_sdk``: a refusal is an answer, trouble is a failure.

        Generations of DJI's node tell more or less of one thing: each type has the fields it knows.
        """

        async def answer(call: Call) -> None:
            try:
                told = await handler(call)
            except CommandRefused as error:
                call.session.status("error", str(error))
                told = {"result": False, "ack_data": max(0, error.code)}
            except M100Error as error:
                call.fail(str(error))
                return
            known = call.service.type.response.default()
            call.respond({name: value for name, value in told.items() if name in known})

        def on_call(call: Call) -> None:
            if self.admits(call.session):
                self._agent.background.spawn(answer(call), name)
            else:
                call.fail("more than the orders that one client may give")

        self._graph.add_service(f"/dji_sdk/{name}", f"dji_sdk/{kind}", on_call)

    def _steer_refused(self, fence: int, error: M100Error) -> None:
        for session in self._graph.sessions:
            held = self._graph.known(session).get(_LEASE)
            if held is not None and held.number == fence:
                self.complain(session, error)

    def _left(self, session: Listener, now: float) -> None:
        self.let_go(session)

    async def _keep_renewing(self) -> None:
        while True:
            await asyncio.sleep(_RENEWAL)
            for session in list(self._graph.sessions):
                held = self._graph.known(session).get(_LEASE)
                if held is None:
                    continue
                try:
                    await self._agent.ask(orders.RenewLease(held.token))
                except M100Error as error:
                    self._graph.known(session).pop(_LEASE, None)
                    session.status("error", str(error))

    # -- the service -----------------------------------------------------------------------------

    def _on_lease(self, call: Call) -> None:
        action = call.request["action"]
        handler = {
            "status": self._status,
            "acquire": self._acquire,
            "renew": self._renew,
            "release": self._release,
            "take_over": self._ask_take_over,
            "confirm": self._confirm,
        }.get(action)
        if handler is None:
            call.fail(f"there is no action {action[:32]!r}: status, acquire, renew, release, …")
            return
        if action in ("acquire", "take_over", "confirm") and not self.admits(call.session):
            call.fail("more than the orders that one client may give")
            return
        self._agent.background.spawn(self._answer(call, handler), f"lease {action}")

    async def _answer(
        self, call: Call, handler: Callable[[Call], Coroutine[Any, Any, Message]]
    ) -> None:
        try:
            told = {"success": True, **await handler(call)}
            told["remaining"] = self._agent.state.lease_remaining
        except LeaseRefused as error:
            told = {"success": False, "message": str(error)}
        except M100Error as error:
            call.fail(str(error))
            return
        call.respond(told | {"holder": self._agent.holder.name})

    async def _status(self, call: Call) -> Message:
        return {}

    def _granted(self, call: Call, lease: Lease) -> Message:
        if call.session in self._graph.sessions:
            self._graph.known(call.session)[_LEASE] = lease
        else:
            self._agent.let_go(lease)
        return {"token": lease.token}

    async def _acquire(self, call: Call) -> Message:
        name = call.request["name"] or call.session.name
        return self._granted(call, await self._agent.acquire(name))

    async def _renew(self, call: Call) -> Message:
        renewed = await self._agent.ask(orders.RenewLease(call.request["token"]))
        return self._granted(call, given(renewed.lease))

    async def _release(self, call: Call) -> Message:
        await self._agent.release_lease(call.request["token"])
        return {}

    async def _ask_take_over(self, call: Call) -> Message:
        name = call.request["name"] or call.session.name
        wanted = await self._agent.ask_take_over(name)
        asked = f"{wanted.from_name} would lose control; confirm with this token"
        return {"token": wanted.token, "message": asked}

    async def _confirm(self, call: Call) -> Message:
        return self._granted(call, await self._agent.confirm(call.request["token"]))
