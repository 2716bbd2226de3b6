"""One aircraft, shared: who may move it, and what they may ask for.

The agent opens the aircraft and opens it again when the link was lost. Whoever wants to move it
shows a lease; movement that nobody renews expires, and when the lease ends the aircraft hovers and
control authority goes back.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Self

from m100link.aircraft import Aircraft, AircraftCamera
from m100link.apps.agent.background import BackgroundTasks
from m100link.apps.agent.guided import SETPOINT_LIFETIME, GuidedOrder
from m100link.apps.agent.journal import Journal
from m100link.apps.agent.lease import Flown, Lease, LeaseChange, LeaseDesk
from m100link.apps.agent.messages import Topic
from m100link.apps.agent.server.authority import (
    Activation,
    Holding,
    HoldingInput,
    HoldingState,
    Inherited,
)
from m100link.apps.agent.server.connection import Connect, Connection
from m100link.apps.agent.server.flight import MissionOrder, Pattern, ignore
from m100link.apps.agent.server.replays import Replays
from m100link.errors import GuardRefused, UsageError
from m100link.flight.guards import Envelope, Guards
from m100link.flight.missions.hotpoint import HotpointFlight
from m100link.flight.missions.waypoint import WaypointFlight
from m100link.missions.plan import WaypointPlan
from m100link.protocol.commands.activation import Credentials, Version
from m100link.protocol.commands.control import Task
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.setpoint import Setpoint

LONGEST_KEPT = 60.0
"""Seconds that control authority is kept for nobody at most."""

_LEASE_CHECK = 0.1
_LONGEST_STEP = 0.3
"""Seconds between two looks at the lease; in what is longer than that this program did not run."""

_LOST = (LeaseChange.EXPIRED, LeaseChange.FRONT_LOST)
"""How a lease ends when nobody wanted it to."""


class Agent:
    """The aircraft and who may do what with it.

    Args:
        connect: Opens the aircraft.
        credentials: What activation needs; without them the aircraft can only be watched.
        lease_lifetime: Seconds that a lease lasts without renewal.
        keep_authority: Seconds that control authority is kept, hovering, when whoever flew is lost
            with its front; 0 gives it back at once.
        leases_before: Number of the last lease that an agent before may have granted; above 0 what
            that one may have held is given back, once the aircraft answers.
        envelope: How far whoever has the lease may fly; that of every control block by default.
        replay: The recording that stands in the place of an aircraft; nobody gets a lease.
    """

    def __init__(
        self,
        connect: Connect,
        *,
        credentials: Credentials | None = None,
        lease_lifetime: float = 3.0,
        keep_authority: float = 0.0,
        leases_before: int = 0,
        envelope: Envelope | None = None,
        replay: Replays | None = None,
    ) -> None:
        if not 0.0 <= keep_authority <= LONGEST_KEPT:
            raise UsageError(
                f"control authority cannot be kept for {keep_authority:g} s",
                remedy=f"choose 0 to {LONGEST_KEPT:g} s: somebody has to be there to fly",
            )
        self._clock = asyncio.get_running_loop().time
        self.replay = replay  #: as given
        self.journal = Journal(self._clock)  #: what happened
        self.background = BackgroundTasks()  #: tasks that end with the agent
        self.connection = Connection(connect, self.journal)  #: the line to the aircraft
        #: How the aircraft was activated.
        self.activation = Activation(credentials, self.journal)
        #: Who may steer.
        self.desk = LeaseDesk(
            lifetime=lease_lifetime,
            longest_step=_LONGEST_STEP,
            leases_before=leases_before,
            on_change=self._lease_changed,
        )
        guards = Guards(envelope=envelope or Envelope())
        #: Control authority for whoever may.
        self.holding = Holding(self.journal, self.background, guards)
        self.holding.on_change.append(self._holding_changed)
        self._inherited = Inherited(self.journal, self.background, is_owed=leases_before > 0)
        self._keep_authority = keep_authority
        # Ends a time in which authority is held for nobody.
        self._unclaimed: asyncio.TimerHandle | None = None
        # After STOP nobody's stream of setpoints flies on: whoever sends it has to begin anew.
        self._is_stopped = False
        #: Called after each change with the reason, the lease in force, or None, and what was
        #: flown for the one before.
        self.on_lease: list[Callable[[LeaseChange, Lease | None, Flown], None]] = []
        self.connection.on_aircraft.append(self._aircraft_changed)

    @property
    def now(self) -> float:
        """Time on the event loop's clock, s."""
        return self._clock()

    async def __aenter__(self) -> Self:
        self.background.spawn(self.connection.keep(), "connection")
        self.background.spawn(self._watch_lease(), "lease")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._give_back()
        await self.background.end()

    def _aircraft_changed(self, aircraft: Aircraft | None) -> None:
        if aircraft is not None and self.replay is not None:
            self.background.spawn(self.replay.watch(aircraft), "replay")
            return
        version = self.connection.version
        if aircraft is None or version is None:
            return
        if version.is_activated:
            self.activation.adopt(aircraft)
        self._inherited.connected(aircraft, is_activated=version.is_activated)

    # -- the lease -------------------------------------------------------------------------------

    async def _watch_lease(self) -> None:
        while True:
            await asyncio.sleep(_LEASE_CHECK)
            self.desk.advance(self.now)

    def _lease_changed(self, why: LeaseChange, old: Lease | None, new: Lease | None) -> None:
        flown = self.holding.flown
        self.halt("control changed hands")  # before anybody is told
        self._is_stopped = self._is_stopped and new is None
        self._claim()
        if new is not None:
            self.holding.feed(HoldingInput.TAKEN_OVER)
        elif why in _LOST and self._keep_authority and self.holding.has_authority:
            self._keep_for_nobody()
        else:
            self.holding.feed(HoldingInput.LET_GO)
        for callback in self.on_lease:
            callback(why, new, flown)
        if new is not None:
            whom = f" from {old.name}" if old is not None else ""
            self.journal.note(f"{new.name} has control ({why.value}{whom})")
        elif old is not None:
            level = "warning" if why in _LOST else "info"
            self.journal.note(f"{old.name} gave control back ({why.value})", level)

    def _keep_for_nobody(self) -> None:
        self._unclaimed = asyncio.get_running_loop().call_later(
            self._keep_authority, self._end_unclaimed, "nobody came back for it"
        )
        self.journal.note(
            f"the aircraft hovers, control authority is kept for {self._keep_authority:g} s",
            "warning",
        )

    def _claim(self) -> bool:
        """Authority is not held for nobody any more; returns whether it was."""
        timer, self._unclaimed = self._unclaimed, None
        if timer is not None:
            timer.cancel()
        return timer is not None

    def _end_unclaimed(self, why: str) -> None:
        if self._claim():
            self.journal.note(f"control authority is given back: {why}", "warning")
            self.holding.let_go()

    def _holding_changed(self, before: HoldingState, after: HoldingState) -> None:
        # The pilot who comes back to F would give it to nobody.
        if after is not HoldingState.RELEASING:
            self._end_unclaimed("it was lost meanwhile")

    def _renewed(self, token: str) -> Lease:
        return self.desk.renew(token, self.now)

    # -- what the aircraft is asked --------------------------------------------------------------

    async def activate(self, token: str | None = None) -> Version:
        """Activate the aircraft. Needs the lease, or that nobody holds it.

        Raises:
            UsageError: The agent has no credentials.
            LeaseRefused: Another client has control.
            ActivationRefused, AckTimeout, LinkError: See each class.
        """
        if self.desk.holder(self.now) is not None:
            self.desk.check(token or "", self.now)
        return await self.activation.activate(self.connection.require_aircraft())

    async def version(self) -> Version:
        """The version of the aircraft; it was asked for lately, whoever wants to know it.

        Raises:
            AckTimeout, LinkError: See each class.
        """
        aircraft = self.connection.require_aircraft()
        return self.connection.version or await aircraft.version()

    async def send_to_mobile(self, token: str, data: bytes) -> None:
        """Send up to 100 bytes to the app on the pilot's phone.

        Raises:
            LeaseRefused, PayloadTooLarge, CommandRefused, AckTimeout, LinkError: See each class.
        """
        self._renewed(token)
        await self.connection.require_aircraft().send_to_mobile(data)

    async def order_replay(self, text: str) -> None:
        """Move, stop or go on with a recording; anybody may.

        Raises:
            UsageError: It is not one, or there is no such order.
        """
        if self.replay is None:
            raise UsageError("this is not a replay", remedy="m100link replay FILE")
        await self.replay.order(text)

    def _camera_of(self, token: str | None) -> Aircraft:
        """The aircraft, for what needs no authority: for the holder of the lease, or without one.

        Raises:
            LeaseRefused, LinkError: Another client has control; there is no aircraft.
        """
        if self.desk.holder(self.now) is not None:
            self.desk.check(token or "", self.now)
        return self.connection.require_aircraft()

    async def move_gimbal(self, token: str | None, command: GimbalAngle | GimbalSpeed) -> None:
        """Point or turn the gimbal; done when it is sent.

        Raises:
            LeaseRefused, NotActivated, LevelTooLow, CommandNotSupported, UsageError, LinkError:
                Nothing was sent.
        """
        gimbal = self._camera_of(token).gimbal
        if isinstance(command, GimbalSpeed):
            await gimbal.set_angular_rates(
                yaw=command.yaw_deg_s, pitch=command.pitch_deg_s, roll=command.roll_deg_s
            )
            return
        mode = command.mode
        await gimbal.set_angles(
            yaw=None if mode & GimbalAngleMode.KEEP_YAW else command.yaw_deg,
            pitch=None if mode & GimbalAngleMode.KEEP_PITCH else command.pitch_deg,
            roll=None if mode & GimbalAngleMode.KEEP_ROLL else command.roll_deg,
            seconds=command.duration_s,
            relative=not mode & GimbalAngleMode.ABSOLUTE,
        )

    async def use_camera(
        self, token: str | None, use: Callable[[AircraftCamera], Awaitable[None]]
    ) -> None:
        """Take a photograph, start or stop video; done when it is sent.

        Raises: as :meth:`move_gimbal`.
        """
        await use(self._camera_of(token).camera)

    # -- control authority -----------------------------------------------------------------------

    async def obtain(self, token: str) -> None:
        """Obtain control authority for the holder of the lease.

        Raises:
            LeaseRefused: The token is not in force.
            AuthorityRefused, NotActivated, NoAuthority, LinkError, AckTimeout: See each class.
        """
        self._renewed(token)
        aircraft = self.connection.require_aircraft()
        await self._inherited.settle()
        await self.holding.settle()
        self.desk.check(token, self.now)  # it may have ended while authority went back
        self._is_stopped = False
        await self.holding.obtain(aircraft)

    async def release(self, token: str) -> None:
        """Give control authority back; the lease stays.

        Raises:
            LeaseRefused: The token is not in force.
        """
        self._renewed(token)
        await self._give_back()

    async def _give_back(self) -> None:
        self._claim()
        self.halt()
        self.holding.let_go()
        await self.holding.settle()

    # -- flying ----------------------------------------------------------------------------------

    def steer(self, token: str, setpoint: Setpoint, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Fly this setpoint until it is renewed or its lifetime ends. Ends a program.

        Raises:
            LeaseRefused: The token is not in force.
            GuardRefused: STOP was pressed, and nothing has begun anew since; or see below.
            NoAuthority, GuardRefused, UsageError: See :meth:`m100link.Control.send`.
        """
        self._renewed(token)
        if self._is_stopped:
            raise GuardRefused(
                "STOP was pressed; setpoints that go on are not flown",
                guard="stopped",
                cause="whoever sends them has not begun anew since",
                remedy="let go of the sticks, or ask for control once more",
            )
        self.holding.require().steer(setpoint, lifetime)

    def halt(self, why: str = "", token: str = "") -> None:
        """Stop moving; anybody may call this at any time. A task goes on in the autopilot.

        With the token of the lease whoever steers has let go, and after a STOP begins anew.
        """
        if self.holding.flying is not None:
            self.holding.flying.halt(why)
        holder = self.desk.holder(self.now)
        if token and holder is not None and token == holder.token:
            self._is_stopped = False

    async def stop(self) -> None:
        """Stop whatever happens: motion, program, and the task that the aircraft flies.

        Setpoints that somebody goes on sending are refused until the holder of the lease lets go
        (:meth:`halt` under it) or asks for control once more (:meth:`obtain`), or somebody else
        gets the lease.

        No command ends a task: giving control authority back is all that this side can do.
        """
        self._is_stopped = True
        self.journal.note("stop", topic=Topic.STOPPED)
        is_in_task = self.holding.task is not None or await self.holding.stop_landing()
        self.halt("stop")
        if is_in_task or self._unclaimed is not None:
            self.journal.note("control authority is given back to end the task", "warning")
            await self._give_back()

    async def fly(self, token: str, task: Task, accepted: Callable[[], None] = ignore) -> None:
        """Take off, land or go home; accepted when begun, done when seen to be done.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority, TaskRefused, TaskFailed, NotObserved, AckTimeout: See each class.
        """
        self._renewed(token)
        await self.holding.require().fly(task, accepted)

    async def guide(
        self, token: str, order: GuidedOrder, accepted: Callable[[], None] = ignore
    ) -> None:
        """Fly to where somebody points; done when it is there, and the newest one wins.

        It ends, and the aircraft hovers, when whoever asked for it loses the lease, when a stick is
        moved, by :meth:`halt`, and when anything else is asked for.

        Raises:
            LeaseRefused: The token is not in force.
            MissionRunning, TaskRefused: A mission or a task flies the aircraft.
            NotObserved: Something else ended it, or it did not arrive in time.
            GuardRefused, NoAuthority, TelemetryStalled, UsageError: See
                :meth:`m100link.Control.fly_to`.
        """
        self._renewed(token)
        await self.holding.require().guide(order, accepted)

    async def fly_mission(
        self,
        token: str,
        plan: WaypointPlan,
        *,
        take_off: bool = False,
        begun: Callable[[], None] | None = None,
    ) -> None:
        """Upload a plan and let the aircraft fly it by itself; done when it has begun.

        It is stopped when whoever asked for it loses the lease, by :meth:`halt` and by
        :meth:`stop`. Should this process die, **it flies on**. With ``begun``, which is called when
        it has begun, this is done when the mission is over.

        Raises:
            LeaseRefused, GuardRefused, NoAuthority, MissionRefused, MissionRunning, AckTimeout,
            LinkError, NotObserved, MissionAborted: See each class; the last two with ``begun``.
        """
        self._renewed(token)
        await self.holding.require().start_mission(plan, take_off=take_off, begun=begun)

    async def fly_hotpoint(self, token: str, request: HotpointStart) -> None:
        """Let the aircraft fly around a place by itself; done when it has begun.

        Raises: as :meth:`fly_mission`.
        """
        self._renewed(token)
        await self.holding.require().start_hotpoint(request)

    async def set_hotpoint(
        self, token: str, *, radius: float | None = None, rate: float | None = None
    ) -> None:
        """Change the circle that is flown, or turn the nose back. Sent, and not waited for.

        Args:
            token: Proof of the lease.
            radius: m.
            rate: Degrees per second, clockwise positive.

        Raises:
            UsageError: Out of range, or no circle is flown.
            LeaseRefused, NoAuthority, GuardRefused, MissionAborted: See each class.
        """
        self._renewed(token)
        flight = self.holding.require().mission.flight(HotpointFlight)
        if radius is not None:
            await flight.set_radius(radius, wait=False)
        elif rate is not None:
            await flight.set_rate(abs(rate), clockwise=rate > 0, wait=False)
        else:
            await flight.reset_heading()

    async def order_mission(self, token: str, what: MissionOrder) -> None:
        """Pause, resume or stop the mission that flies, whoever started it.

        Raises: as :meth:`fly_mission`.
        """
        self._renewed(token)
        await self.holding.require().order_mission(what)

    async def set_mission_speed(self, token: str, speed: float) -> float:
        """Change the speed of the mission that flies, m/s; returns the one in force.

        Raises:
            UsageError: Beyond the plan's greatest speed, or no mission flies.
            LeaseRefused, NoAuthority, MissionRefused, AckTimeout: See each class.
        """
        self._renewed(token)
        return await self.holding.require().mission.flight(WaypointFlight).set_speed(speed)

    async def switch_motors(self, token: str, *, on: bool) -> None:
        """Start or stop the motors on the ground.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority, GuardRefused, TaskRefused, TelemetryStalled, AckTimeout: See each class.
        """
        self._renewed(token)
        await self.holding.require().switch_motors(on=on)

    def start_pattern(self, token: str, name: str, fly: Pattern) -> None:
        """Let a program fly, until it ends, the stick is moved, or anything stops it.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority: Control authority is not held.
            MissionRunning: A mission flies.
        """
        self._renewed(token)
        self.holding.require().start_pattern(name, fly)
