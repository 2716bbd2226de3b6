"""What ROS programs want of the aircraft, asked of its agent: one lease for all of them.

Control is asked for and given back by services, whoever calls them: a call from a shell is over
before anything flies. What keeps programs apart is the stick for setpoints, and the goal for what
flies by itself.
"""

from __future__ import annotations

import asyncio

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.lease import Lease
from m100link.apps.agent.messages import Action, Event, Topic
from m100link.apps.ros2.stick import Stick
from m100link.errors import GuardRefused, M100Error, MissionRunning, NoAuthority, UsageError
from m100link.protocol.commands.control import Task
from m100link.protocol.records import FlightStatus
from m100link.protocol.setpoint import Setpoint

__all__ = ["IDLE_S", "LIFETIME", "Helm"]

LIFETIME = 0.3
"""Seconds that a setpoint flies when no other one comes: after that the aircraft brakes."""

IDLE_S = 60.0
"""Seconds on the ground without an order after which control is given back."""

_RENEWAL_S = 0.5
_STATUS_S = 2.5


class Helm:
    """The lease, and what is asked under it.

    Args:
        agent: The agent of the aircraft.

    Attributes:
        stick: Whose setpoints fly.
        goal: What flies by itself for a program; empty for nothing.
    """

    def __init__(self, agent: AgentClient) -> None:
        self._agent = agent
        self.stick = Stick()
        self.goal = ""
        self._lease: Lease | None = None
        # One request for control, or its end, at a time: they would cross.
        self._changing = asyncio.Lock()
        self._renewed_at = self._ordered_at = agent.now
        agent.on_authority_taken.append(lambda _: self._lost())
        agent.on_steer_refused.append(self._steer_refused)
        agent.on_event.append(self._hear)

    # -- where it stands -------------------------------------------------------------------------

    @property
    def lease(self) -> Lease | None:
        """The lease, if it is in force."""
        return self._lease if self._agent.holds(self._lease) else None

    @property
    def has_control(self) -> bool:
        """Whether the aircraft obeys ROS programs."""
        return self.lease is not None and self._agent.has_authority

    @property
    def is_airborne(self) -> bool:
        """Whether it is seen to be off the ground."""
        telemetry = self._agent.telemetry
        status = None if telemetry is None else telemetry.fresh(FlightStatus, within=_STATUS_S)
        return status is not None and status.is_airborne

    def held(self) -> Lease:
        """The lease under which something can be asked.

        Raises:
            NoAuthority: Control is not held by ROS programs.
        """
        lease = self.lease
        if lease is None or not self._agent.has_authority:
            holder = self._agent.holder
            other = f": {holder.name} has control" if holder.number and lease is None else ""
            raise NoAuthority(
                f"ROS has no control{other}",
                cause="nobody called ~/obtain_control, or control was lost since",
                remedy="call ~/obtain_control first",
            )
        return lease

    # -- control ---------------------------------------------------------------------------------

    async def obtain(self, who: str) -> None:
        """Take the lease and obtain control authority.

        Args:
            who: For people.

        Raises:
            LeaseHeld: Somebody else has control.
            M100Error: As :meth:`m100link.apps.agent.client.AgentClient.obtain`.
        """
        agent = self._agent
        async with self._changing:
            if self.lease is None:
                self._lease = await agent.acquire(who)
            try:
                if not agent.state.is_activated:
                    await agent.activate(self._lease)
                await agent.obtain(self._lease)
            except BaseException:
                self._let_go()
                raise
            self._ordered_at = agent.now
            self.stick.begin(agent.now)

    async def release(self) -> None:
        """Give control back: motion ends, the pilot flies."""
        async with self._changing:
            self._let_go()

    def _let_go(self) -> None:
        lease, self._lease = self.lease, None
        self.stick.end()
        if lease is not None:
            self._agent.let_go(lease)

    def _lost(self) -> None:
        """The pilot, or the aircraft, took control: nothing goes on by itself when it is back."""
        self._let_go()

    # -- orders ----------------------------------------------------------------------------------

    async def fly(self, task: Task) -> None:
        """Let the autopilot take off, land or go home; returns when it has begun.

        After a landing control is given back. What fails later is in the events.

        Raises:
            M100Error: As :meth:`m100link.apps.agent.client.AgentClient.fly`.
        """
        lease = self.held()
        if task is Task.TAKE_OFF:
            self.require_free("take-off")
        else:
            self._agent.halt(f"{task.name.lower()} was asked for")
        self._ordered_at = self._agent.now
        begun = asyncio.Event()
        flying = self._agent.background.spawn(self._flown(lease, task, begun), task.name)
        waiting = asyncio.ensure_future(begun.wait())
        await asyncio.wait((flying, waiting), return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if flying.done():
            flying.result()

    async def _begin(self, lease: Lease, task: Task, begun: asyncio.Event) -> None:
        """Fly a task. A mission of the aircraft's own has to be over before a landing."""
        try:
            await self._agent.fly(lease, task, begun.set)
        except MissionRunning:
            if task is Task.TAKE_OFF:
                raise
        else:
            return
        try:
            await self._agent.ask(Action.MISSION_STOP, lease)
        except M100Error as error:  # it may be over by now, and landing matters more
            self._agent.note(f"the mission before {task.name.lower()}: {error.seen}")
        await self._agent.fly(lease, task, begun.set)

    async def _flown(self, lease: Lease, task: Task, begun: asyncio.Event) -> None:
        try:
            await self._begin(lease, task, begun)
        except M100Error as error:
            if not begun.is_set():
                raise
            self._agent.note(f"{task.name.lower()}: {error.seen}", "error")
            return
        if task is not Task.TAKE_OFF and not self.is_airborne:
            await self.release()
        self._ordered_at = self._agent.now

    def require_free(self, what: str) -> None:
        """Nothing else flies for a program.

        Raises:
            UsageError: Something does.
        """
        if self.goal:
            raise UsageError(f"{what}: {self.goal} flies", remedy="cancel that goal first")

    async def do(self, action: Action, *, number: int = 0, data: bytes = b"") -> None:
        """Something that needs the lease and is done when it is answered.

        Args:
            action: What.
            number: As in :class:`m100link.apps.agent.messages.Ask`.
            data: Likewise.

        Raises:
            M100Error: As :meth:`m100link.apps.agent.client.AgentClient.ask`.
        """
        lease = self.held()
        self._ordered_at = self._agent.now
        await self._agent.ask(action, lease, number=number, data=data)

    async def stop(self) -> None:
        """Stop whatever happens; anybody may. Setpoints fly after the next ~/obtain_control."""
        self.stick.end()
        await self._agent.stop()

    # -- setpoints -------------------------------------------------------------------------------

    def refusal(self) -> str:
        """Why no setpoint can be flown now, empty where one can."""
        state = self._agent.state
        if not self.has_control:
            return "ROS has no control: call ~/obtain_control"
        if not self.stick.is_open:
            return "it was stopped: call ~/obtain_control"
        if self.goal:
            return f"{self.goal} flies: cancel it first"
        if state.task or (state.mission and state.mission != "no mission"):
            return f"{state.task or state.mission} flies"
        return "" if self.is_airborne else "on the ground: call ~/takeoff first"

    def steer(self, setpoint: Setpoint) -> None:
        """Fly this until the next one, for :data:`LIFETIME` at most."""
        self._ordered_at = self._agent.now
        self._agent.steer(self.held(), setpoint, LIFETIME)

    def _hear(self, event: Event) -> None:
        """STOP, by whomever, is for those who send setpoints, too."""
        if event.topic is Topic.STOPPED:
            self.stick.end()

    def _steer_refused(self, fence: int, error: M100Error) -> None:
        lease = self._lease
        if lease is None or lease.number != fence:
            return
        if isinstance(error, GuardRefused) and error.guard == "stopped":
            self.stick.end()

    # -- time passes -----------------------------------------------------------------------------

    def advance(self) -> None:
        """Keep the lease; give it back when nobody has use for it."""
        now = self._agent.now
        self.stick.look(now)
        lease = self.lease
        if lease is None:
            if self._lease is not None and not self._changing.locked():
                self._lease = None
                self.stick.end()
            return
        if now - self._renewed_at >= _RENEWAL_S:
            self._renewed_at = now
            self._agent.keep(lease)
        if self.is_airborne or self.goal or self._agent.state.task:
            self._ordered_at = now
        elif now - self._ordered_at >= IDLE_S and not self._changing.locked():
            self._agent.note(f"ROS gives control back: no order in {IDLE_S:g} s on the ground")
            self._let_go()
