"""One aircraft, shared: the connection, the lease, and everything that clients may ask for.

The station opens the aircraft and opens it again when the link was lost. Whoever wants to move it
shows a lease; movement that nobody renews expires, and when the lease ends the aircraft hovers and
control authority goes back.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Self

from m100link.agent.connection import Connect, Connected, Connection
from m100link.agent.lease import Lease, LeaseChange, LeaseDesk
from m100link.aircraft import ActivationProgress, Aircraft
from m100link.errors import (
    AuthorityLost,
    AuthorityRefused,
    GuardRefused,
    M100Error,
    NoAuthority,
    TaskRefused,
    UsageError,
)
from m100link.flight.control import Control
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.activation import Credentials, Version
from m100link.protocol.commands.control import Task
from m100link.protocol.records import RemoteControl
from m100link.protocol.setpoint import Setpoint
from m100link.telemetry.subscription import Newest

__all__ = ["Connect", "Connection", "Pattern", "Station"]

SETPOINT_LIFETIME = 0.2
"""Seconds that a setpoint of a program lasts when it is not renewed."""

_AT_ONCE = 1e-3
_LEASE_CHECK = 0.1


Pattern = Callable[[Control, Callable[[Setpoint], None]], Coroutine[Any, Any, None]]
"""A program that flies: takes the control and what sends a setpoint."""


class Station(Connected):
    """The aircraft and who may do what with it. See also the attributes of its bases.

    Args:
        connect: Opens the aircraft.
        credentials: What activation needs; without them the station can only watch.
        lease_lifetime: Seconds that a lease lasts without renewal.

    Attributes:
        desk: Who may steer.
        activation: Last answer to an activation, None before the first.
        activation_error: Why it failed, with remedy.
        task: Name of the task that was asked of the aircraft and has not ended, or None.
        accepted: Set while the aircraft flies that task.
        on_activation_code: Called with each answer to an activation.
        on_authority_lost: Called when somebody else took control authority.
    """

    def __init__(
        self,
        connect: Connect,
        *,
        credentials: Credentials | None = None,
        lease_lifetime: float = 3.0,
    ) -> None:
        super().__init__(connect, credentials)
        self.desk = LeaseDesk(lifetime=lease_lifetime, on_change=self._lease_changed)
        self.activation: ActivationCode | None = None
        self.activation_error: M100Error | None = None
        self.task: str | None = None
        self.accepted = asyncio.Event()
        self.on_activation_code: list[Callable[[ActivationCode], None]] = []
        self.on_authority_lost: list[Callable[[AuthorityLost], None]] = []
        self._control: Control | None = None
        self._last: Setpoint | None = None
        self._let_go = asyncio.Event()
        self._obtaining = asyncio.Lock()
        self._holding: asyncio.Task[None] | None = None
        self._flight_task: asyncio.Task[None] | None = None
        self._pattern: asyncio.Task[None] | None = None
        self._resuming: asyncio.Task[None] | None = None

    # -- the block -------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        self.spawn(self._keep_connected(), "connection")
        self.spawn(self._watch_lease(), "lease")
        self.spawn(self._measure(), "round trip")
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self._give_back()
        await self.end_tasks()
        if self.aircraft is not None:
            await self.aircraft.aclose()

    # -- the lease -------------------------------------------------------------------------------

    async def _watch_lease(self) -> None:
        while True:
            await asyncio.sleep(_LEASE_CHECK)
            self.desk.advance(self.now)

    def _lease_changed(self, why: LeaseChange, old: Lease | None, new: Lease | None) -> None:
        if new is not None:
            whom = f" from {old.name}" if old is not None else ""
            self.note(f"{new.name} has control ({why.value}{whom})")
        elif old is not None:
            level = "warning" if why is LeaseChange.EXPIRED else "info"
            self.note(f"{old.name} gave control back ({why.value})", level)
        self.halt("control changed hands")
        if new is None:
            self._let_go.set()

    def _renewed(self, token: str) -> Lease:
        return self.desk.renew(token, self.now)

    # -- activation ------------------------------------------------------------------------------

    async def activate(self, token: str | None = None) -> Version:
        """Activate the aircraft. Needs the lease, or that nobody holds it.

        Raises:
            UsageError: The station has no credentials.
            LeaseRefused: Another client has control.
            ActivationRefused, AckTimeout, LinkError: See each class.
        """
        holder = self.desk.holder(self.now)
        if holder is not None:
            self.desk.check(token or "", self.now)
        aircraft = self.require_aircraft()
        if self.credentials is None:
            raise UsageError(
                "this station has no app id and key",
                remedy="start it with --app-id and --key-file",
            )
        self.note(f"activating for app {self.credentials.app_id}")
        try:
            version = await aircraft.activate(self.credentials, progress=self._activation_progress)
        except M100Error as error:
            self.activation_error = error
            self.note(f"activation failed: {error.seen}", "error")
            raise
        self.activation_error = None
        self.note("activated")
        return version

    def _activation_progress(self, progress: ActivationProgress) -> None:
        self.activation = progress.code
        for callback in self.on_activation_code:
            callback(progress.code)

    # -- control authority -----------------------------------------------------------------------

    @property
    def has_authority(self) -> bool:
        """Whether setpoints and tasks are obeyed now."""
        control = self._control
        return control is not None and not self._let_go.is_set() and control.has_authority

    async def obtain(self, token: str) -> None:
        """Obtain control authority for the holder of the lease.

        Raises:
            LeaseRefused: The token is not in force.
            AuthorityRefused, NotActivated, LinkError, AckTimeout: See each class.
        """
        self._renewed(token)
        await self._obtain()

    async def _obtain(self) -> None:
        async with self._obtaining:  # a double click asks once
            if not self.has_authority:
                await self._begin_holding()

    async def _begin_holding(self) -> None:
        aircraft = self.require_aircraft()
        await self._end_holding()
        granted: asyncio.Future[None] = self._loop.create_future()
        self._let_go = asyncio.Event()
        self._holding = self.spawn(self._hold(aircraft, granted, self._let_go), "authority")
        try:
            await granted
        except M100Error as error:
            self.note(f"no control authority: {error.seen}", "warning")
            raise

    async def _hold(
        self, aircraft: Aircraft, granted: asyncio.Future[None], let_go: asyncio.Event
    ) -> None:
        try:
            async with aircraft.control() as control:
                self._control = control
                self.note("control authority obtained")
                if not granted.done():
                    granted.set_result(None)
                try:
                    await let_go.wait()
                finally:
                    await self._stop_work()
            self.note("control authority released")
        except AuthorityLost as error:
            self.note(f"control authority lost: {error.seen}", "warning")
            for callback in self.on_authority_lost:
                callback(error)
            self._resume_later(error)
        except M100Error as error:
            if not granted.done():
                granted.set_exception(error)
            else:
                self.note(f"control ended: {error.seen}", "error")
        finally:
            self._control = None
            if not granted.done():
                granted.cancel()

    def _resume_later(self, error: AuthorityLost) -> None:
        """Coming back to F gives authority back without a new request (document, quick start)."""
        lease = self.desk.holder(self.now)
        aircraft = self.aircraft
        if lease is None or aircraft is None or error.reason in ("app", "link"):
            return
        if self._resuming is not None:
            self._resuming.cancel()
        has_left_f = error.reason == "mode_switch"
        self._resuming = self.spawn(self._resume(lease, aircraft, has_left_f), "resume")

    async def _resume(self, lease: Lease, aircraft: Aircraft, has_left_f: bool) -> None:
        # Only a switch that was seen out of F: what the app took has to be asked for anew.
        async with aircraft.telemetry(RemoteControl, policy=Newest(50)) as samples:
            async for sample in samples:
                switch = sample[RemoteControl]
                has_left_f = has_left_f or not switch.is_in_f
                if self.desk.holder(self.now) != lease:
                    return
                if has_left_f and switch.is_in_f:
                    try:
                        await self._obtain()
                    except AuthorityRefused:
                        has_left_f = False
                    else:
                        return

    async def release(self, token: str) -> None:
        """Give control authority back; the lease stays.

        Raises:
            LeaseRefused: The token is not in force.
        """
        self._renewed(token)
        await self._give_back()

    async def _give_back(self) -> None:
        if self._resuming is not None:
            self._resuming.cancel()
        self.halt()
        await self._end_holding()

    async def _end_holding(self) -> None:
        self._let_go.set()
        if self._holding is not None and not self._holding.done():
            await asyncio.wait([self._holding])
        self._holding = None

    def _require_control(self) -> Control:
        if self._control is None or not self.has_authority:
            raise NoAuthority(
                "the station does not hold control authority; nothing was sent",
                remedy="obtain control first",
            )
        return self._control

    # -- flying ----------------------------------------------------------------------------------

    def steer(self, token: str, setpoint: Setpoint, lifetime: float = SETPOINT_LIFETIME) -> None:
        """Fly this setpoint until it is renewed or its lifetime ends. Ends a pattern.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority, BadSetpoint: See :meth:`m100link.Control.send`.
        """
        self._renewed(token)
        control = self._require_control()
        if self._pattern is not None:
            if setpoint == setpoint.neutral():
                return
            self._end_pattern("the stick was moved")
        self._send(control, setpoint, lifetime)

    def _send(self, control: Control, setpoint: Setpoint, lifetime: float) -> None:
        try:
            control.send(setpoint, lifetime=lifetime)
        except M100Error:
            self.halt("a setpoint was refused")  # what flew until now is not wanted any more
            raise
        self._last = setpoint

    def halt(self, why: str = "") -> None:
        """Stop moving: end a pattern, replace the setpoint in force by its neutral.

        Anybody may call this at any time. A take-off, landing or go-home goes on in the autopilot.
        """
        self._end_pattern(why)
        last, self._last = self._last, None
        if last is not None and self._control is not None:
            try:
                self._control.send(last.neutral(), lifetime=_AT_ONCE)
            except GuardRefused:
                self.spawn(self._control.stop(), "neutral")  # guards do not keep it from stopping
            except M100Error:
                pass  # without authority nothing moves

    async def stop(self) -> None:
        """Stop whatever happens: motion, pattern, and the task that the aircraft flies.

        The protocol has no command that ends a task. Giving control authority back is the only
        thing this side can do about it.
        """
        self.note("stop")
        is_in_task = self.task is not None
        self.halt("stop")
        if is_in_task:
            self.note("control authority is given back to end the task", "warning")
            await self._give_back()

    async def fly(self, token: str, task: Task) -> None:
        """Take off, land or go home; done when seen to be done.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority, TaskRefused, TaskFailed, NotObserved, AckTimeout: See each class.
        """
        self._renewed(token)
        control = self._require_control()
        name = task.name.lower().replace("_", " ")
        if self.task is not None:
            raise TaskRefused(
                f"{name} was asked for during {self.task}", remedy="wait for its end, or stop it"
            )
        self._end_pattern(f"{name} was asked for")
        self.task, self._last = name, None
        work = self._flight_task = self.spawn(self._fly(control, task, name), name)
        try:
            await asyncio.shield(work)
        except asyncio.CancelledError:
            if work.cancelled():
                raise NoAuthority(f"{name}: control ended before it was seen to end") from None
            raise

    async def _fly(self, control: Control, task: Task, name: str) -> None:
        run = {Task.TAKE_OFF: control.take_off, Task.LAND: control.land}.get(task, control.go_home)
        try:
            self.note(f"{name} begins")
            await run(progress=lambda _: self.accepted.set())
            self.note(f"{name} is done")
        except M100Error as error:
            self.note(f"{name}: {error.seen}", "error")
            raise
        finally:
            self.task = self._flight_task = None
            self.accepted.clear()

    def start_pattern(self, token: str, name: str, fly: Pattern) -> None:
        """Let a program fly, until it ends, the stick is moved, or anything stops it.

        Raises:
            LeaseRefused: The token is not in force.
            NoAuthority: The station holds no control authority.
        """
        self._renewed(token)
        control = self._require_control()
        self._end_pattern("another one begins")
        self._pattern = self.spawn(self._run_pattern(control, name, fly), name)

    async def _run_pattern(self, control: Control, name: str, fly: Pattern) -> None:
        def send(setpoint: Setpoint) -> None:
            self._send(control, setpoint, SETPOINT_LIFETIME)

        self.note(f"{name} begins")
        try:
            await fly(control, send)
            self.note(f"{name} is done")
        except M100Error as error:
            self.note(f"{name} ended: {error.seen}", "error")
        finally:
            if self._pattern is asyncio.current_task():
                self._pattern = None

    @property
    def is_flying_pattern(self) -> bool:
        """Whether a program flies the aircraft."""
        return self._pattern is not None

    def _end_pattern(self, why: str) -> None:
        pattern, self._pattern = self._pattern, None
        if pattern is not None:
            pattern.cancel()
            self.note(f"{pattern.get_name().rpartition(': ')[2]} ended: {why}")

    async def _stop_work(self) -> None:
        """Control ends: so does what was using it."""
        self._end_pattern("control ended")
        if self._flight_task is not None:
            self._flight_task.cancel()
            with contextlib.suppress(asyncio.CancelledError, M100Error):
                await asyncio.wait([self._flight_task])
