"""Control of one aircraft of a fleet: the shape of :class:`m100link.Control`, over the network.

What flies, flies at the agent on board: tasks, closed loops and missions go on there as long as the
lease is renewed. Setpoints go over the network, stamped by the agent's clock.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Literal, Self

from m100link.apps.agent import orders
from m100link.apps.agent.background import BackgroundTasks
from m100link.apps.agent.lease import Lease, LeaseHeld
from m100link.apps.agent.messages import Steer
from m100link.apps.agent.orders import SETPOINT_LIFETIME, Order
from m100link.apps.fleet.asking import STEP_S, Asker
from m100link.apps.fleet.missions.flight import FleetMission, MissionOrders
from m100link.apps.fleet.payloads import LeaseRequest, Progress, Reply, pack_steer
from m100link.errors import (
    FleetError,
    GuardRefused,
    M100Error,
    OutcomeUnknown,
    StaleLease,
    UsageError,
)
from m100link.missions.plan import WaypointPlan
from m100link.protocol.setpoint import Setpoint

_logger = logging.getLogger(__name__)


_RENEWAL_S = 0.5
_LEASE_S = 3.0
_GIVEN_BACK_S = 1.0
_AGAIN_S = 0.1


class FleetControl:
    """Obtains the lease and control authority; to be used as ``async with``."""

    def __init__(
        self,
        asker: Asker,
        name: str,
        *,
        stop: Literal["hover", "land"] = "hover",
        take_over: bool = False,
    ) -> None:
        if stop not in ("hover", "land"):
            raise UsageError(f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'")
        self._asker = asker
        self._name = name
        self._stop = stop
        self._is_take_over = take_over
        self._keys = asker.keys
        self._clock = asyncio.get_running_loop().time
        self._lease: Lease | None = None
        self._renewed_at = 0.0
        self._renewing: asyncio.Task[None] | None = None
        self._owner: asyncio.Task[object] | None = None
        self._has_entered = False
        self._lost: M100Error | None = None
        self._refused: M100Error | None = None

    # -- the block -------------------------------------------------------------------------------

    @property
    def fence(self) -> int:
        """Number of the lease; 0 without one."""
        return 0 if self._lease is None else self._lease.number

    @property
    def proof(self) -> tuple[int, str]:
        """Number and secret of the lease; a program that has both can order under it.

        Raises:
            StaleLease: It has ended.
        """
        lease = self._held()
        return lease.number, lease.token

    @property
    def clock_bound_s(self) -> float | None:
        """By how much the agent's clock is known, s."""
        known = self._asker.its_clock.offset(self._clock())
        return None if known is None else known.bound

    async def __aenter__(self) -> Self:
        # An order that says when it was made is not carried out when nobody waits for it any more.
        if await self._asker.is_there():
            await self._asker.look(within=STEP_S)
        lease = await self._take_lease()
        self._lease, self._renewed_at = lease, self._clock()
        self._setpoints = SetpointSender(self._asker)
        self._owner = asyncio.current_task()
        self._renewing = asyncio.create_task(self._renew(), name="m100link: lease of a fleet")
        try:
            await self.ask(orders.Activate())
            await self.ask(orders.Obtain())
        except BaseException as error:
            await self._leave()
            self._raise_lost(error)
            raise
        self._has_entered = True
        return self

    async def __aexit__(self, _type: object, exc: BaseException | None, _: object) -> None:
        is_lost = self._lost is not None
        try:
            if not is_lost and self._stop == "land":
                await self.land()
        finally:
            await self._leave()
        if is_lost:
            self._raise_lost(exc)

    def _raise_lost(self, exc: BaseException | None) -> None:
        """Raise why the lease was lost, where that is what has ended the block."""
        if isinstance(exc, asyncio.CancelledError) and self._lost is not None:
            assert self._owner is not None
            self._owner.uncancel()
            raise self._lost from exc

    async def _leave(self) -> None:
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)
        self._setpoints.close()
        lease, self._lease = self._lease, None
        if lease is None or self._lost is not None:
            return
        await self._try(orders.ReleaseLease(), lease)

    async def _try(self, order: Order, lease: Lease | None = None) -> None:
        """Ask for what happens by itself as well, only later: expiry ends setpoint and lease."""
        fence, token = (0, "") if lease is None else (lease.number, lease.token)
        try:
            await self._asker.ask(order, fence=fence, token=token, patience=_LEASE_S)
        except FleetError as error:
            _logger.warning("%s is left to silence: %s", self._keys.name, error.seen)

    # -- the lease -------------------------------------------------------------------------------

    async def _take_lease(self, offer: str = "") -> Lease:
        request = self._asker.lease_request(offer)
        try:
            lease, _ = await self._asker.take_lease(request)
        except LeaseHeld:
            if not self._is_take_over or offer:
                raise
            found = await self._asker.ask(orders.AskTakeOver(self._name))
            return await self._take_lease(found.offer)
        except (OutcomeUnknown, asyncio.CancelledError):
            await self._give_back(request)
            raise
        return lease

    async def _give_back(self, request: LeaseRequest) -> None:
        """Give a lease back that was granted, or is about to be, to who waits for it no more."""
        until = self._clock() + _GIVEN_BACK_S
        while (left := until - self._clock()) > 0:
            try:
                found = await self._asker.look(request.order, within=left)
            except FleetError as error:  # what ended the wait for it is what is told
                _logger.warning("%s: its lease is left to silence: %s", self._keys.name, error.seen)
                return
            if found is not None and found.progress is Progress.DONE:
                if found.key:
                    lease = request.lease(found)
                    await self._try(orders.ReleaseLease(), lease)
                return
            await asyncio.sleep(_AGAIN_S)

    async def _renew(self) -> None:
        """Renew the lease until it is lost; then whoever flies is told.

        None waits for the answer to the one before: on board the lease ends 3 s after the last one
        came, however long the answers take.
        """
        asking = BackgroundTasks()
        try:
            while self._lost is None and self._lease is not None:
                asking.spawn(self._renew_once(self._lease), "renewal of a lease")
                await asyncio.sleep(_RENEWAL_S)
                if self._clock() - self._renewed_at > _LEASE_S:
                    self._lose(self._silent())
        finally:
            asking.cancel()

    def _silent(self) -> M100Error:
        """Why the lease is over when no renewal was answered."""
        if not self._has_entered:  # nothing was asked for under it that moves anything
            return StaleLease(
                f"{self._keys.name} answered no renewal within {_LEASE_S:g} s: the lease cannot be "
                "held",
                cause="the way there and back takes longer than a lease lasts without a word, or "
                "is cut",
                remedy="land and stop need no lease",
            )
        return OutcomeUnknown(
            f"{self._keys.name} gave no answer for {_LEASE_S:g} s: the lease has ended",
            remedy="it hovers, then does what its agent was told by --lost",
        )

    async def _renew_once(self, lease: Lease) -> None:
        try:
            reply = await self._asker.renew(lease, within=_LEASE_S)
        except GuardRefused:
            return  # it came too late to renew anything, and says nothing of the lease
        except M100Error as error:
            self._lose(error)
            return
        if reply is not None:
            self._renewed_at = self._clock()
            if reply.fault is not None:
                self._refused = reply.fault.error()

    def _lose(self, error: M100Error) -> None:
        if self._lost is not None:
            return
        self._lost = error
        if self._owner is not None:
            self._owner.cancel()

    def _held(self) -> Lease:
        """The lease; StaleLease where it has ended."""
        if self._lease is None or self._lost is not None:
            raise StaleLease(f"{self._name} has no control of {self._keys.name}") from self._lost
        return self._lease

    # -- orders ----------------------------------------------------------------------------------

    async def ask(self, order: Order) -> Reply:
        """Ask for something under this lease; see :meth:`m100link.apps.fleet.asking.Asker.ask`."""
        lease = self._held()
        return await self._asker.ask(order, fence=lease.number, token=lease.token)

    async def take_off(self) -> None:
        """Start the motors and climb to about 1.2 m; done when it is seen to be done.

        Raises:
            M100Error: As :meth:`m100link.Control.take_off`, and :class:`FleetError`.
        """
        await self.ask(orders.TakeOff())

    async def land(self) -> None:
        """Land in place and stop the motors. Raises: see :meth:`take_off`."""
        await self.ask(orders.Land())

    async def go_home(self) -> None:
        """Fly to the home point and land. Raises: see :meth:`take_off`."""
        await self.ask(orders.GoHome())

    async def fly_to(
        self,
        *,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        speed: float = 5.0,
        yaw_deg: float | None = None,
    ) -> None:
        """Fly straight to a place and hover there; the loop is closed on board.

        Args:
            latitude_deg: WGS 84.
            longitude_deg: WGS 84.
            height: Metres above the take-off point.
            speed: Horizontally, at most, m/s up to 10.
            yaw_deg: Heading to fly with, °; None for the present one.

        Raises:
            M100Error: As :meth:`m100link.Control.fly_to`, and :class:`FleetError`.
        """
        await self.ask(orders.FlyTo(latitude_deg, longitude_deg, height, speed, yaw_deg))

    # -- missions --------------------------------------------------------------------------------

    @property
    def missions(self) -> MissionOrders:
        """What is ordered about missions, one by one."""
        return MissionOrders(self.ask)

    def waypoint_mission(self, plan: WaypointPlan, *, take_off: bool = False) -> FleetMission:
        """Let the aircraft fly a plan by itself, as ``async with``.

        It flies as long as this block has the lease: whoever loses it loses the mission.

        Args:
            plan: What to fly.
            take_off: Take off first, from the ground.

        Raises (when it is entered):
            M100Error: As :meth:`m100link.Control.waypoint_mission`, and :class:`FleetError`.
        """
        return FleetMission(self._asker, self.missions, plan, take_off=take_off)

    async def pause_mission(self) -> None:
        """Pause whatever mission flies. Raises: see :meth:`take_off`."""
        await self.missions.pause()

    async def resume_mission(self) -> None:
        """Let whatever mission is paused go on. Raises: see :meth:`take_off`."""
        await self.missions.resume()

    async def stop_mission(self) -> None:
        """End the mission that was started here. Raises: see :meth:`take_off`."""
        await self.missions.stop()

    async def stop(self) -> None:
        """Stop whatever happens; needs no lease."""
        await self._asker.ask(orders.Stop())

    # -- setpoints -------------------------------------------------------------------------------

    def send(self, setpoint: Setpoint, *, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Send a setpoint once. It flies until it is renewed or expires; then the aircraft brakes.

        One that follows another within half a second goes on with a stream: when the agent heard
        none of it for a second it is not flown, and the next call says so.

        Args:
            setpoint: What to fly.
            lifetime: Seconds that it lasts at the agent, at most 1.

        Raises:
            StaleLease: Control is lost.
            GuardRefused, NoAuthority, UsageError: The agent did not fly one of those before.
            UsageError: The agent's clock is not known well enough to say how old a setpoint is.
        """
        self._send(setpoint, lifetime)

    def _send(self, setpoint: Setpoint, lifetime: float, *, begins: bool | None = None) -> None:
        lease = self._held()
        refused, self._refused = self._refused, None
        if refused is not None:
            raise refused
        self._setpoints.send(lease.number, lease.token, setpoint, lifetime, begins=begins)

    @asynccontextmanager
    async def hold(self, setpoint: Setpoint, *, rate_hz: float = 20.0) -> AsyncIterator[FleetHold]:
        """A task keeps sending a setpoint while the block runs, and the neutral at its end.

        Args:
            setpoint: The first one; :meth:`FleetHold.set` replaces it.
            rate_hz: Times a second, at least 10 so that one may be lost.

        Raises: as :meth:`send`.
        """
        hold = FleetHold(setpoint)
        self._send(setpoint, SETPOINT_LIFETIME, begins=True)
        owner = asyncio.current_task()
        failed: list[M100Error] = []

        async def keep() -> None:
            try:
                while True:
                    await asyncio.sleep(1 / rate_hz)
                    self._send(hold.setpoint, SETPOINT_LIFETIME, begins=False)
            except M100Error as error:
                if self._lost is None and owner is not None:  # else the block is ended already
                    failed.append(error)
                    owner.cancel()

        keeping = asyncio.create_task(keep(), name="m100link: setpoints of a fleet")
        try:
            yield hold
        except asyncio.CancelledError:
            if not failed or owner is None:
                raise
            owner.uncancel()
            raise failed[0] from None
        finally:
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)
            if self._lost is None:
                await self._try(orders.Halt(f"{self._name} ended a hold"))


class FleetHold:
    """The setpoint that is held."""

    def __init__(self, setpoint: Setpoint) -> None:
        self.setpoint = setpoint  #: that one

    def set(self, setpoint: Setpoint) -> None:
        """Hold another one from now on."""
        self.setpoint = setpoint


# -- setpoints on their way to an agent, stamped by its clock --------------------------------------


MOST_CLOCK_BOUND_S = 0.1
"""Seconds by which the agent's clock may be wrong; setpoints older than 0.2 s are not flown."""

_UNANSWERED_S = 4.0
_PAUSE_S = 0.5
"""Seconds after which whoever sends again has decided so anew."""


class SetpointSender:
    """Sends to one aircraft until it is closed, by the agent's clock as its asker knows it."""

    def __init__(self, asker: Asker) -> None:
        self._name, self._agent_clock = asker.keys.name, asker.its_clock
        self._clock = asyncio.get_running_loop().time
        self._outlet = asker.bus.publish(asker.keys.setpoint)
        self._sent_at = -math.inf

    def close(self) -> None:
        """Send no more."""
        self._outlet.close()

    def send(
        self,
        fence: int,
        token: str,
        setpoint: Setpoint,
        lifetime: float,  # seconds that it lasts at the agent
        *,
        # When it was decided, on this event loop's clock, s; now by default.
        made_at: float | None = None,
        # Whether a stream begins with it; by default when none was sent for half a second.
        begins: bool | None = None,
    ) -> None:
        """Send one; never waits."""
        now = self._clock()
        known = self._agent_clock.offset(now)
        if known is None or self._agent_clock.way_s > MOST_CLOCK_BOUND_S:
            raise UsageError(
                f"the clock of {self._name} is not known to {MOST_CLOCK_BOUND_S:g} s",
                cause="the way there and back takes too long for setpoints",
                remedy="fly by tasks and fly_to(), whose loops are closed on board",
            )
        # What the agent's clock showed long ago says nothing of how slow the way is by now.
        if (silent := self._agent_clock.silent_s(now)) > _UNANSWERED_S:
            raise UsageError(
                f"{self._name} has answered nothing for {silent:.0f} s: nobody knows whether it "
                "flies what is sent",
                cause="the way there and back is cut, or takes too long",
                remedy="let go, and look where the aircraft is",
            )
        if begins is None:
            begins = now - self._sent_at > _PAUSE_S
        self._sent_at = now
        stamp = (now if made_at is None else made_at) + known.seconds
        steer = Steer(fence, stamp, lifetime, setpoint)
        self._outlet.put(pack_steer(steer, token, begins=begins))
