"""Carries out orders of the fleet, on board.

Stop, hover and landing need no lease and wait for nobody. Everything else that moves the aircraft
needs the lease in force, and its proof.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.lease import Flown, Lease
from m100link.apps.agent.messages import MessageError, fault_of
from m100link.apps.fleet.identity import Since, nobody
from m100link.apps.fleet.missions.manager import MissionManager
from m100link.apps.fleet.order_log import OrderLog
from m100link.apps.fleet.payloads import OrderMessage, agree
from m100link.errors import M100Error, NotAllowed, StaleLease

_LOOK_S = 0.1


Answer = dict[str, Any]
"""The fields of :class:`~m100link.apps.fleet.payloads.OrderReply` that say what was asked for."""


@dataclass(slots=True)
class Granted:
    lease: Lease  # as the agent knows it; its token never leaves the aircraft
    secret: str = field(repr=False)  # what orders and setpoints under it are proved with
    signer: str  # who signed for it, who may be revoked meanwhile; empty when nobody did


class OrderService:
    def __init__(self, client: AgentClient, order_log: OrderLog, revoked: Since = nobody) -> None:
        self._revoked = revoked
        # The signers of the landing under way: they may be revoked meanwhile.
        self._descent_signers: set[str] = set()
        self._client = client
        self._order_log = order_log
        self.missions = MissionManager(client)  # what flies by plans
        # Those in force that were granted to the fleet, by number.
        self.leases: dict[int, Granted] = {}
        # Why the last setpoint was not flown; reported when the lease is renewed.
        self.refused: M100Error | None = None
        # A landing that nobody has to hold a lease for, and that all who ask for it wait for.
        self._descent: asyncio.Task[None] | None = None
        self._descends_by: orders.Order = orders.Land()
        # Orders under a lease that have begun: the aircraft may be about to leave the ground.
        self._underway = 0
        client.on_lease.append(lambda _: self._forget())

    def _forget(self) -> None:
        """Leases that have ended are of no use, nor is why a setpoint under one was not flown."""
        self.refused = None
        number = self._client.holder.number
        self.leases = {one: it for one, it in self.leases.items() if one >= number > 0}

    def secret(self, number: int) -> str | None:
        """Secret of the lease of that number; None when it is not in force, or not the fleet's."""
        granted = self.leases.get(number)
        return None if granted is None else granted.secret

    def shut_out(self) -> str:
        """Let no revoked signer steer any more; returns the last one who did, empty for nobody."""
        found = ""
        descent = None if self._descent is None or self._descent.done() else self._descent
        if descent is not None and all(map(self._revoked, self._descent_signers)):
            descent.cancel()
            found = ", ".join(sorted(self._descent_signers))
        for number, granted in list(self.leases.items()):
            if self._revoked(granted.signer):
                del self.leases[number]
                found = granted.signer
        return found

    async def carry_out(self, order: OrderMessage, asked: orders.Order) -> Answer:
        """Do what is asked for.

        Raises StaleLease: it needs the lease, and came without. Raises M100Error: as the agent
        tells.
        """
        client = self._client
        match asked:
            case orders.AcquireLease() | orders.ConfirmTakeOver():
                return await self._granted(order, asked)
            case orders.AskTakeOver():
                offer = await client.ask_take_over(order.by, order.wanted_at)
                return {"text": offer.from_name, "number": offer.number, "offer": offer.token}
            case orders.ReleaseLease():
                await client.release_lease(self.require_lease(order).token)
            case orders.RenewLease():
                lease = self.require_lease(order)
                await client.ask(orders.RenewLease(lease.token))
                refused, self.refused = self.refused, None
                return {"text": lease.name, "number": lease.number, "fault": fault_of(refused)}
            case orders.LeaseOrder():  # its token, which is no proof here, goes to no agent
                raise MessageError(f"a fleet has no order {asked.label}")
            case orders.Stop():
                await client.stop(order.by)
            case orders.Halt():
                # Not after a STOP since it was made.
                is_anew = asked.begins_anew and order.clock > client.stopped_at
                why = asked.why or f"{order.by}: hover"
                held = self._lease_if_any(order)
                client.hover(why, held, begins_anew=is_anew, at=order.clock)
            case orders.Land() if not order.fence:
                orders.require_newer(asked, order.since or order.clock, client.stopped_at)
                await self.descend(asked, f"landing for {order.by}", signer=order.signer)
            case orders.UploadPlan():
                lease = self.require_lease(order)
                return {"text": await self.missions.upload(lease, asked, order.by)}
            case _:
                self._underway += 1
                try:
                    return await self._do(asked, self.lease_for(order, asked), order.wanted_at)
                finally:
                    self._underway -= 1
        return {}

    async def _do(self, asked: orders.Order, lease: Lease | None, at: float | None) -> Answer:
        # By when it was asked for: a STOP since then may not have been heard here.
        if isinstance(asked, orders.Activate) and self._client.state.is_activated:
            return {}
        if isinstance(asked, orders.StartMission) and lease is not None:
            await self.missions.start(lease, asked, at)
            return {}
        outcome = await self._client.ask(asked, lease, asked_at=at)
        if isinstance(asked, orders.PauseMission | orders.ResumeMission):
            self.missions.paused(is_paused=isinstance(asked, orders.PauseMission))
        return {"text": outcome.text, "number": outcome.number}

    # -- the lease -------------------------------------------------------------------------------

    def _lease_if_any(self, order: OrderMessage) -> Lease | None:
        granted = self.leases.get(order.fence)
        if granted is None or order.fence != self._client.holder.number:
            return None
        return granted.lease if order.proves(granted.secret) else None

    def lease_for(self, order: OrderMessage, asked: orders.Order) -> Lease | None:
        """As :meth:`require_lease`; None where none is needed, as to activate while it is free."""
        if not asked.is_kept and asked.needs is orders.Needs.NOTHING:
            return None
        is_free = not order.fence and not self._client.holder.number
        if is_free and isinstance(asked, orders.Activate):
            return None
        return self.require_lease(order)

    def require_lease(self, order: OrderMessage) -> Lease:
        """The lease in force, if the order proves that its asker has it; else StaleLease."""
        lease = self._lease_if_any(order)
        if lease is None:
            holder = self._client.holder
            who = holder.name if holder.number else "nobody"
            raise StaleLease(f"lease {order.fence} is not in force; {who} has control")
        return lease

    async def _granted(self, order: OrderMessage, asked: orders.LeaseOrder) -> Answer:
        key, secret = agree(order)  # before anything is taken from anybody
        if isinstance(asked, orders.ConfirmTakeOver):
            lease = await self._client.confirm(asked.token, order.wanted_at)
        else:
            lease = await self._client.acquire(order.by, order.wanted_at)
        since = self._revoked(order.signer)
        if since:  # while it was being granted
            self._client.let_go(lease)
            raise NotAllowed(f"{order.signer} is revoked since {since}")
        self.leases[lease.number] = Granted(lease, secret, order.signer)
        await self._order_log.granted(lease.number)
        return {"text": lease.name, "number": lease.number, "key": key}

    # -- down ------------------------------------------------------------------------------------

    async def descend(
        self, task: orders.Order, who: str, *, take_over: bool = True, signer: str = ""
    ) -> None:
        """Land, here or at home: the lease is taken over for that long.

        An order that comes while the aircraft lands already waits for the same landing. Raises
        LeaseHeld: somebody has the lease, and it is not to be taken over. Raises M100Error: as the
        agent tells.
        """
        is_held = self._underway or self._client.holder.number
        if self._client.view.is_on_ground and not is_held:
            return  # it is where it is wanted, and nobody can be about to take off
        is_under_way = self._descent is not None and not self._descent.done()
        if self._descent is None or not is_under_way or task != self._descends_by:
            self._descends_by = task
            self._descent_signers.clear()
            self._descent = self._client.background.spawn(
                self._descended(task, who, take_over=take_over), who
            )
        self._descent_signers.add(signer)
        descent = self._descent
        await asyncio.wait([descent])
        descent.result()

    async def _descended(self, task: orders.Order, who: str, *, take_over: bool) -> None:
        control = ControlSession(self._client, who)
        try:
            async with control.kept():
                lease = await control.take(take_over=take_over)
                asked_at = await self._end_task()
                self._client.check(lease)  # somebody may have it who wants no landing
                if asked_at is None:
                    return
                await control.obtain(asked_at=asked_at)
                await control.bring_down(task, asked_at)
        finally:
            control.close()

    async def _end_task(self) -> float | None:
        """End the task that flies, but a landing. Returns since when a STOP is another's, s.

        None: it stands, and nothing flies.
        """
        client, asked_at = self._client, self._client.asked_at
        while client.state.task == Flown.LAND.value:  # noqa: ASYNC110 - no event says it
            await asyncio.sleep(_LOOK_S)
        if client.state.task:
            return await client.end_task(asked_at)
        return None if client.view.is_on_ground and not self._underway else asked_at
