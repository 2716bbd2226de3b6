"""The leases of rosbridge clients: taken by opening control, alive as long as the socket.

A rosbridge client of 2015 knows nothing of leases. Opening control takes the lease if it is free;
it ends when the client closes control or its socket is gone. Newer clients use the service
``/m100link/lease``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine
from functools import partial
from operator import attrgetter
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.background import TokenBucket
from m100link.apps.agent.client import AgentClient, given
from m100link.apps.agent.control_session import ControlSession, ControlState, Terms
from m100link.apps.agent.lease import LEASE_LIFETIME, LeaseRefused, not_in_force
from m100link.apps.station.ros.graph import Graph, GraphListener, ServiceCall
from m100link.apps.station.ros.messages import Message
from m100link.errors import CommandRefused, M100Error, UsageError
from m100link.protocol.firmware import FIRMWARE_3_1, PROFILES, FirmwareProfile
from m100link.protocol.setpoint import ReceivedMove, Yaw

TASKS: dict[int, orders.Order] = {4: orders.TakeOff(), 6: orders.Land(), 1: orders.GoHome()}
"""What DJI's nodes ask for by the number of a task."""

_COMPLAINT_PAUSE = 1.0
_CONTROL, _COMPLAINED_AT, _ORDERS = "control session", "complained at", "orders"
_RATE, _AT_ONCE = 2.0, 10.0
# Seconds between two notes to people about what one client is refused; all clients together have
# one in five seconds, and some more at once: they must not push out the events of others.
_NOTE_PAUSE, _NOTES_RATE, _NOTES_AT_ONCE = 10.0, 0.2, 4.0
_REFUSED, _NOTED_UNTIL = "refused", "noted until"
_ACTIONS = ("status", "acquire", "renew", "release", "take_over", "confirm")  # of the service
_COUNTED = ("acquire", "take_over", "confirm")  # as orders


class Clients:
    """The control session of each rosbridge client."""

    def __init__(self, agent: AgentClient, graph: Graph) -> None:
        self._agent = agent
        self._graph = graph
        ways = ("nav_open_close_request 1", "dji_sdk/sdk_control_authority 1")
        remedy = f"open control first ({' or '.join(f'{graph.prefix}/{way}' for way in ways)})"
        self._notes = TokenBucket(_NOTES_RATE, _NOTES_AT_ONCE)
        self._terms = Terms(activates=False, remedy=remedy)
        graph.on_leave.append(self._left)
        graph.add_service("/m100link/lease", "m100link/Lease", self._on_lease)
        graph.add_service("/m100link/stop", "std_srvs/Trigger", self._on_stop)

    def session(self, client: GraphListener) -> ControlSession:
        """The control session of that client; a closed one when the client has gone."""
        known = self._graph.known(client)
        session: ControlSession | None = known.get(_CONTROL)
        if session is None:
            session = known[_CONTROL] = ControlSession(self._agent, client.name, self._terms)
            session.on_refused = partial(self.complain, client)
            session.on_change = partial(self._changed, client)
            if client not in self._graph.sessions:
                session.close()
            # The client is there while its socket is.
            self._agent.background.spawn(session.keep(), f"lease of {client.name}")
        return session

    def _changed(self, client: GraphListener, state: ControlState) -> None:
        if state in (ControlState.LOST, ControlState.TAKEN_OVER):
            holder = self._agent.holder
            client.status("error", str(not_in_force(holder.name if holder.number else None)))

    def _left(self, client: GraphListener, now: float) -> None:
        self.session(client).close()

    async def switch(self, client: GraphListener, *, on: bool, activates: bool = False) -> None:
        """Open or close control. ``activates``: DJI's later nodes do that when they start.

        Raises ``LeaseHeld``: another client has it. Raises ``M100Error``: as
        :meth:`m100link.apps.agent.control_session.ControlSession.obtain`.
        """
        session = self.session(client)
        if on:
            asked_at = self._agent.asked_at
            if activates and not self._agent.state.is_activated:
                await session.ask(orders.Activate())
            await session.obtain(asked_at=asked_at)
            return
        if session.is_changing:
            session.let_go()  # the request under way ends by that, and may wait for long
        await session.take()
        try:
            await session.ask(orders.Release())
        finally:
            session.let_go()

    async def order(self, call: ServiceCall, order: orders.Order) -> Message:
        """Give an order for who calls; raises as the control session."""
        await self.session(call.session).ask(order)
        return {"result": True}

    @property
    def profile(self) -> FirmwareProfile:
        """The firmware of the aircraft, as far as it is known."""
        return PROFILES.get(self._agent.state.firmware, FIRMWARE_3_1)

    def fly(self, client: GraphListener, move: ReceivedMove) -> None:
        """Fly a movement as far as its limits allow, as an aircraft does; the client hears of it.

        Raises ``M100Error``: as :meth:`ControlSession.steer`, or it is no setpoint.
        """
        setpoint = move.limited(self.profile)
        self.session(client).steer(setpoint)
        values = attrgetter("x", "y", "z", *(["yaw"] if move.mode.yaw is Yaw.RATE else []))
        if values(move) != values(setpoint):
            flown = ", ".join(f"{one:g}" for one in values(setpoint))
            text = f"a setpoint beyond the limits of the aircraft: {flown} is flown"
            self._tell(client, "warning", text, f"sent {text}")

    def complain(self, client: GraphListener, error: Exception) -> None:
        """Tell a client what is wrong, at most once a second: keys repeat thirty times.

        People at the station hear it, too: a client may not listen, or not show it.
        """
        seen = error.seen if isinstance(error, M100Error) else str(error)
        self._tell(client, "error", str(error), f"is refused: {seen}")

    def _tell(self, client: GraphListener, level: str, text: str, note: str) -> None:
        known, now = self._graph.known(client), self._agent.now
        known[_REFUSED] = count = known.get(_REFUSED, 0) + 1
        if now >= known.get(_NOTED_UNTIL, -math.inf) and self._notes.take(now):
            known[_NOTED_UNTIL] = now + _NOTE_PAUSE
            more = f" ({count} times so far)" if count > 1 else ""
            self._agent.note(f"{client.name} {note}{more}", "warning")
        if now - client.data.get(_COMPLAINED_AT, float("-inf")) >= _COMPLAINT_PAUSE:
            client.data[_COMPLAINED_AT] = now
            client.status(level, text)

    def admits(self, client: GraphListener) -> bool:
        """Whether the client may order one more thing now; it hears when it may not.

        The station reports each order to people and sends it to the aircraft; a client could keep
        both busy. A client in control may always order, and so always give control back.
        """
        if self.session(client).has_lease:
            return True
        now = self._agent.now
        allowance: TokenBucket = client.data.setdefault(_ORDERS, TokenBucket(_RATE, _AT_ONCE))
        if allowance.take(now):
            return True
        self.complain(client, UsageError(f"more than {_RATE:g} orders per second: not done"))
        return False

    def hear(
        self,
        name: str,
        kind: str,
        order: Callable[[GraphListener, Message], Coroutine[Any, Any, object]],
    ) -> None:
        """Take messages of a topic as orders; the client hears when one fails, or is too many."""

        async def guarded(client: GraphListener, message: Message) -> None:
            try:
                await order(client, message)
            except M100Error as error:
                client.status("error", str(error))

        def on_publish(client: GraphListener, message: Message, now: float) -> None:
            if topic.ends(message) or self.admits(client):
                work = guarded(client, message)
                self._agent.background.spawn(work, f"{name} for {client.name}")

        topic = self._graph.add_topic(name, kind, on_publish)

    def offer(
        self, name: str, kind: str, handler: Callable[[ServiceCall], Coroutine[Any, Any, Message]]
    ) -> None:
        """Offer a service of ``dji_sdk``: a refusal is an answer, trouble is a failure.

        Generations of DJI's node tell more or less of one thing: each type has the fields it knows.
        """

        async def answer(call: ServiceCall) -> None:
            try:
                response = await handler(call)
            except CommandRefused as error:
                call.session.status("error", str(error))
                response = {"result": False, "ack_data": max(0, error.code)}
            except M100Error as error:
                call.fail(str(error))
                return
            known = call.service.type.response.default()
            call.respond({name: value for name, value in response.items() if name in known})

        def on_call(call: ServiceCall) -> None:
            if call.ends or self.admits(call.session):
                self._agent.background.spawn(answer(call), name)
            else:
                call.fail("more orders than one client may give")

        self._graph.add_service(f"/dji_sdk/{name}", f"dji_sdk/{kind}", on_call)

    # -- the service -----------------------------------------------------------------------------

    def _on_lease(self, call: ServiceCall) -> None:
        action = call.request["action"]
        if action not in _ACTIONS:
            call.fail(f"there is no action {action[:32]!r}: {', '.join(_ACTIONS)}")
        elif action in _COUNTED and not self.admits(call.session):
            call.fail("more orders than one client may give")
        else:
            self._agent.background.spawn(self._answer(call), f"lease {action}")

    async def _answer(self, call: ServiceCall) -> None:
        try:
            response = {"success": True, **await self._act(call)}
            response["remaining"] = self._remaining(call.request["action"])
        except LeaseRefused as error:
            response = {"success": False, "message": str(error)}
        except M100Error as error:
            call.fail(str(error))
            return
        call.respond(response | {"holder": self._agent.holder.name})

    def _remaining(self, action: str) -> float:
        """Seconds: the state that tells it comes after the answer to what changed it."""
        if action in ("acquire", "renew", "confirm"):
            return LEASE_LIFETIME
        return self._agent.state.lease_remaining if self._agent.holder.number else 0.0

    async def _act(self, call: ServiceCall) -> Message:
        agent, session, token = self._agent, self.session(call.session), call.request["token"]
        name = call.request["name"] or call.session.name
        match call.request["action"]:
            case "acquire":
                return {"token": (await session.take(partial(agent.acquire, name))).token}
            case "renew":
                lease = given((await agent.ask(orders.RenewLease(token))).lease)
                session.adopt(lease)
                return {"token": lease.token}
            case "release" if session.lease is not None and session.lease.token == token:
                await session.give_back()
            case "release":
                await agent.release_lease(token)
            case "take_over":
                wanted = await agent.ask_take_over(name)
                asked = f"{wanted.from_name} would lose control; confirm with this token"
                return {"token": wanted.token, "message": asked}
            case "confirm":
                return {"token": (await session.take(partial(agent.confirm, token))).token}
        return {}

    def _on_stop(self, call: ServiceCall) -> None:
        """Needs no control, and is never one order too many."""
        self._agent.background.spawn(self._stop(call), f"stop for {call.session.name}")

    async def _stop(self, call: ServiceCall) -> None:
        try:
            await self.session(call.session).stop()
        except M100Error as error:
            call.respond({"success": False, "message": str(error)})
        else:
            call.respond({"success": True, "message": ""})
