"""Control of one aircraft of a fleet: the shape of :class:`m100link.Control`, over the network.

The agent on board flies: tasks, closed loops and missions go on there as long as the lease is
renewed. Setpoints go over the network, stamped by the agent's clock.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Literal, Self

from m100link import errors
from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.lease import LEASE_LIFETIME, Lease
from m100link.apps.agent.messages import LeaseChanged
from m100link.apps.agent.orders import SETPOINT_LIFETIME, Order
from m100link.apps.fleet.asking import STEP_S, Asker
from m100link.apps.fleet.carrier import FleetChannel
from m100link.apps.fleet.missions.flight import FleetMission, MissionOrders
from m100link.apps.fleet.payloads import OrderReply
from m100link.missions.plan import WaypointPlan
from m100link.protocol.setpoint import Setpoint

_logger = logging.getLogger(__name__)


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
            raise errors.UsageError(
                f"there is no stop action {stop!r}", remedy="use 'hover' or 'land'"
            )
        self._asker = asker
        self._name = name
        self._stop = stop
        self._is_take_over = take_over
        self._keys = asker.keys
        self._clock = asyncio.get_running_loop().time
        self._stack = AsyncExitStack()  # the renewals, and the way to the agent
        self._session: ControlSession | None = None
        self._owner: asyncio.Task[object] | None = None  # who is in the block, and not leaving it
        self._cancelled = 0  # how often others had cancelled him before
        self._has_entered = False
        self._began_at = 0.0  # s
        self._lost: errors.M100Error | None = None
        self._refused: errors.M100Error | None = None

    # -- the block -------------------------------------------------------------------------------

    @property
    def fence(self) -> int:
        """Number of the lease; 0 without one."""
        lease = None if self._session is None else self._session.lease
        return 0 if lease is None else lease.number

    @property
    def proof(self) -> tuple[int, str]:
        """Number and secret of the lease; a program that has both can give orders under it.

        Raises:
            StaleLease: It has ended.
        """
        lease = self._held()
        return lease.number, lease.token

    async def __aenter__(self) -> Self:
        self._asker.require(orders.Right.FLY)
        # A program whose steps are blocks of their own does not fly on after a STOP between two.
        asked_at = self._asker.unstopped_since()
        self._began_at = self._clock()
        # An order that says when it was made is not carried out when nobody waits for it any more.
        if await self._asker.is_there():
            await self._asker.look(within=STEP_S)
        self._owner = owner = asyncio.current_task()
        self._cancelled = 0 if owner is None else owner.cancelling()
        self._channel = FleetChannel(lambda _: self._asker, hears=False)
        self._stack.callback(self._channel.close)
        try:
            client = await self._stack.enter_async_context(AgentClient(self._channel, self._name))
            self._session = ControlSession(client, self._name)
            client.on_lease.append(self._lease_changed)
            client.on_steer_refused.append(self._steer_refused)
            self._stack.push_async_callback(self._give_back)  # once nothing renews it any more
            await self._stack.enter_async_context(self._session.kept())
            await self._session.obtain(take_over=self._is_take_over, asked_at=asked_at)
        except BaseException as error:
            await self._leave()
            self._raise_lost(error, owner)
            raise
        self._has_entered = True
        return self

    async def __aexit__(self, _type: object, exc: BaseException | None, _: object) -> None:
        owner, session = self._owner, self._session
        try:
            try:
                if self._lost is None and self._stop == "land" and session is not None:
                    # Not behind a STOP, which may be why the block ends.
                    await session.bring_down(orders.Land(), self._began_at)
            finally:
                await self._leave()
        except asyncio.CancelledError as error:
            self._raise_lost(error, owner)
            raise
        self._raise_lost(exc, owner)

    def _raise_lost(self, exc: BaseException | None, owner: asyncio.Task[object] | None) -> None:
        """Raise why the lease was lost, where that is what has ended the block."""
        if not isinstance(exc, asyncio.CancelledError) or self._lost is None or owner is None:
            return
        if owner.uncancel() <= self._cancelled:  # else somebody else wants it to end, too
            raise self._lost from exc

    async def _leave(self) -> None:
        self._owner = None
        try:
            await self._stack.aclose()
        finally:
            self._session = None

    async def _give_back(self) -> None:
        if self._lost is None:
            await self._channel.let_go(LEASE_LIFETIME)

    def _lease_changed(self, change: LeaseChanged) -> None:
        if change.number == 0 and self._lost is None and self._owner is not None:
            self._lost = self._channel.lost or self._silent()
            self._owner.cancel()

    def _steer_refused(self, _fence: int, error: errors.M100Error) -> None:
        self._refused = error

    def _silent(self) -> errors.M100Error:
        """Why the lease is over when no renewal was answered."""
        if not self._has_entered:  # nothing was asked for under it that moves anything
            return errors.StaleLease(
                f"{self._keys.name} answered no renewal within {LEASE_LIFETIME:g} s: the lease "
                "cannot be held",
                cause="the round trip is longer than a lease lasts, or the link is cut",
                remedy="land and stop need no lease",
            )
        return errors.OutcomeUnknown(
            f"{self._keys.name} gave no answer for {LEASE_LIFETIME:g} s: the lease has ended",
            remedy="the aircraft hovers, then does what `lost` of its agent says",
        )

    def _held(self) -> Lease:
        """The lease; StaleLease where it has ended."""
        lease = None if self._session is None else self._session.lease
        if lease is None:
            raise errors.StaleLease(
                f"{self._name} has no control of {self._keys.name}"
            ) from self._lost
        return lease

    # -- orders ----------------------------------------------------------------------------------

    async def ask(self, order: Order) -> OrderReply:
        """Ask for something under this lease; see :meth:`m100link.apps.fleet.asking.Asker.ask`."""
        lease = self._held()
        return await self._asker.ask(order, fence=lease.number, token=lease.token)

    async def take_off(self) -> None:
        """Start the motors and climb to about 1.2 m; returns when telemetry shows it done.

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
        """Fly straight to a position and hover there; the loop is closed on board.

        Args:
            latitude_deg: WGS 84.
            longitude_deg: WGS 84.
            height: Metres above the take-off point.
            speed: Greatest horizontal speed, m/s, up to 10.
            yaw_deg: Heading to fly with, °; None for the present one.

        Raises:
            M100Error: As :meth:`m100link.Control.fly_to`, and :class:`FleetError`.
        """
        await self.ask(orders.FlyTo(latitude_deg, longitude_deg, height, speed, yaw_deg))

    @property
    def missions(self) -> MissionOrders:
        return MissionOrders(self.ask)

    def waypoint_mission(self, plan: WaypointPlan, *, take_off: bool = False) -> FleetMission:
        """Let the aircraft fly a plan by itself, as ``async with``.

        The mission flies as long as this block has the lease.

        Args:
            plan: The plan.
            take_off: Take off first, from the ground, as a plan with ``take_off`` does.

        Raises (when it is entered):
            M100Error: As :meth:`m100link.Control.waypoint_mission`, and :class:`FleetError`.
        """
        takes_off = take_off or plan.take_off
        return FleetMission(self._asker, self.missions, plan, take_off=takes_off)

    async def pause_mission(self) -> None:
        """Pause the mission in flight. Raises: see :meth:`take_off`."""
        await self.missions.pause()

    async def resume_mission(self) -> None:
        """Resume a paused mission. Raises: see :meth:`take_off`."""
        await self.missions.resume()

    async def stop_mission(self) -> None:
        """End the mission that was started here. Raises: see :meth:`take_off`."""
        await self.missions.stop()

    async def stop(self) -> None:
        """Stop all motion, programs and tasks; needs no lease."""
        await self._asker.ask(orders.Stop())

    # -- setpoints -------------------------------------------------------------------------------

    def send(self, setpoint: Setpoint, *, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Send a setpoint once; without another one the aircraft brakes when it expires.

        A setpoint within half a second of another one continues a stream. The agent does not fly
        it if the stream was silent there for a second; the next call says so.

        Args:
            setpoint: The setpoint.
            lifetime: Its lifetime at the agent, s, at most 1.

        Raises:
            StaleLease: Control is lost.
            GuardRefused, NoAuthority, UsageError: The agent did not fly an earlier setpoint.
            UsageError: The agent's clock is not known well enough to say how old a setpoint is.
        """
        self._send(setpoint, lifetime)

    def _send(self, setpoint: Setpoint, lifetime: float, *, begins: bool | None = None) -> None:
        lease = self._held()
        refused, self._refused = self._refused, None
        if refused is not None:
            if isinstance(refused, errors.GuardRefused) and refused.guard == "stopped":
                self._asker.hear_of_stop()
            raise refused
        self._channel.fly(lease, setpoint, lifetime, begins=begins)

    @asynccontextmanager
    async def hold(self, setpoint: Setpoint, *, rate_hz: float = 20.0) -> AsyncIterator[FleetHold]:
        """Keep sending a setpoint while the block runs; the aircraft hovers at its end.

        Args:
            setpoint: The first one; :meth:`FleetHold.set` replaces it.
            rate_hz: Setpoints a second, at least 10 so that one may be lost.

        Raises: as :meth:`send`.
        """
        hold = FleetHold(setpoint)
        self._send(setpoint, SETPOINT_LIFETIME, begins=True)
        owner = asyncio.current_task()
        failed: list[errors.M100Error] = []

        async def keep() -> None:
            try:
                while True:
                    await asyncio.sleep(1 / rate_hz)
                    self._send(hold.setpoint, SETPOINT_LIFETIME, begins=False)
            except errors.M100Error as error:
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
                await self._hover()

    async def _hover(self) -> None:
        """Ask for the hover that follows anyway when the setpoint expires, only later."""
        hover = orders.Halt(f"{self._name} ended a hold")
        try:
            fence, token = self.proof
            await self._asker.ask(hover, fence=fence, token=token, patience=LEASE_LIFETIME)
        except errors.FleetError as error:
            _logger.warning("%s: the setpoint expires: %s", self._keys.name, error.seen)


class FleetHold:
    """The setpoint that is held."""

    def __init__(self, setpoint: Setpoint) -> None:
        self.setpoint = setpoint  #: the setpoint

    def set(self, setpoint: Setpoint) -> None:
        """Hold another setpoint from now on."""
        self.setpoint = setpoint
