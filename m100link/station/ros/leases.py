"""The leases of rosbridge clients: taken by opening control, alive as long as the socket.

A rosbridge client of 2015 knows nothing of leases. Opening control takes the lease if it is free;
it ends when the client closes control or its socket is gone. Newer clients use the service
``/m100link/lease``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

from m100link.agent.agent import Agent
from m100link.agent.lease import Lease, LeaseRefused
from m100link.errors import M100Error, NoAuthority
from m100link.station.ros.graph import Call, Graph, Listener

__all__ = ["Clients"]

_RENEWAL = 0.5
_COMPLAINT_PAUSE = 1.0
_LEASE, _COMPLAINED_AT = "lease", "complained at"


class Clients:
    """Which rosbridge client holds the lease.

    Args:
        agent: The aircraft and its lease.
        graph: Where the clients are.
    """

    def __init__(self, agent: Agent, graph: Graph) -> None:
        self._agent = agent
        self._graph = graph
        graph.on_leave(self._left)
        graph.add_service("/m100link/lease", "m100link/Lease", self._on_lease)
        agent.background.spawn(self._keep_renewing(), "renewal")

    def lease(self, session: Listener) -> Lease | None:
        """The lease in force of that client."""
        held = session.data.get(_LEASE)
        return held if held is not None and held == self._holder() else None

    def _holder(self) -> Lease | None:
        return self._agent.desk.holder(self._agent.now)

    def token(self, session: Listener) -> str:
        """The token of that client's lease, which is taken now if it is free.

        Raises:
            LeaseHeld: Another client has it.
        """
        held = self.lease(session)
        if held is None:
            held = self._agent.desk.acquire(session.name, self._agent.now)
            session.data[_LEASE] = held
        return held.token

    def held_token(self, session: Listener) -> str:
        """The token of that client's lease.

        Raises:
            NoAuthority: It has none; who has is in the error.
        """
        held = self.lease(session)
        if held is None:
            holder = self._holder()
            who = f"{holder.name} has control" if holder else "nobody has control"
            raise NoAuthority(
                f"{who}; nothing was sent", remedy="open control first (/nav_open_close_request 1)"
            )
        return held.token

    def let_go(self, session: Listener) -> None:
        """Give that client's lease back, if it has one."""
        held = self.lease(session)
        session.data.pop(_LEASE, None)
        if held is not None:
            self._agent.desk.release(held.token, self._agent.now)

    def complain(self, session: Listener, error: Exception) -> None:
        """Tell a client what is wrong, at most once a second: keys repeat thirty times."""
        now = self._agent.now
        if now - session.data.get(_COMPLAINED_AT, float("-inf")) >= _COMPLAINT_PAUSE:
            session.data[_COMPLAINED_AT] = now
            session.status("error", str(error))

    def run(self, session: Listener, work: Coroutine[Any, Any, None], name: str) -> None:
        """Run a client's wish; it is told when it fails."""

        async def guarded() -> None:
            try:
                await work
            except M100Error as error:
                session.status("error", str(error))

        self._agent.background.spawn(guarded(), f"{name} for {session.name}")

    def _left(self, session: Listener, now: float) -> None:
        self.let_go(session)

    async def _keep_renewing(self) -> None:
        while True:
            await asyncio.sleep(_RENEWAL)
            for session in list(self._graph.sessions):
                held = session.data.get(_LEASE)
                if held is None:
                    continue
                try:
                    self._agent.desk.renew(held.token, self._agent.now)
                except LeaseRefused as error:
                    del session.data[_LEASE]
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
        try:
            handler(call)
        except LeaseRefused as error:
            holder = self._holder()
            call.respond(
                {"success": False, "message": str(error), "holder": holder.name if holder else ""}
            )

    def _respond(self, call: Call, token: str = "", message: str = "") -> None:
        holder, desk = self._holder(), self._agent.desk
        call.respond(
            {
                "success": True,
                "message": message,
                "token": token,
                "holder": holder.name if holder else "",
                "remaining": desk.remaining(self._agent.now),
            }
        )

    def _status(self, call: Call) -> None:
        self._respond(call)

    def _acquire(self, call: Call) -> None:
        name = call.request["name"] or call.session.name
        lease = self._agent.desk.acquire(name, self._agent.now)
        call.session.data[_LEASE] = lease
        self._respond(call, lease.token)

    def _renew(self, call: Call) -> None:
        lease = self._agent.desk.renew(call.request["token"], self._agent.now)
        call.session.data[_LEASE] = lease
        self._respond(call, lease.token)

    def _release(self, call: Call) -> None:
        self._agent.desk.release(call.request["token"], self._agent.now)
        self._respond(call)

    def _ask_take_over(self, call: Call) -> None:
        name = call.request["name"] or call.session.name
        wanted = self._agent.desk.ask_take_over(name, self._agent.now)
        self._respond(
            call,
            wanted.token,
            f"{wanted.from_name} would lose control; confirm with this token",
        )

    def _confirm(self, call: Call) -> None:
        lease = self._agent.desk.confirm(call.request["token"], self._agent.now)
        call.session.data[_LEASE] = lease
        self._respond(call, lease.token)
