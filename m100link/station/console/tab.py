"""One browser tab of the console: its lease, its beats, its name.

A tab steers by *beats*: twenty a second while a key is held, with the numbers of the stick. A beat
lasts :data:`BEAT_LIFETIME`; without the next one the aircraft stops, whatever the reason: key
released, focus lost, tab closed, socket gone, browser hanging. Between times the tab tells that it
is alive, which keeps its lease.
"""

from __future__ import annotations

import json
import math
from collections.abc import Awaitable, Callable
from typing import Any

from m100link.agent.agent import Agent
from m100link.agent.lease import Lease, TakeOver
from m100link.agent.patterns import pattern
from m100link.agent.steering import setpoint_of
from m100link.errors import M100Error
from m100link.protocol.commands.control import Task

__all__ = ["BEAT_LIFETIME", "Tab"]

BEAT_LIFETIME = 0.3
"""Seconds that a beat lasts."""

MAX_BEAT = 2000
_COMPLAINT_PAUSE = 1.0


class Tab:
    """What one tab may do, and has.

    Args:
        agent: The aircraft.
        name: Who it is, for the banner.

    Attributes:
        name: As given; the operator may change it.
        lease: Its lease, in force or not.
        problem: What was refused last, for people.
        beats: Beats that moved the aircraft.
        refused: Messages that could not be used.
    """

    def __init__(self, agent: Agent, name: str) -> None:
        self._agent = agent
        self.name = name
        self.lease: Lease | None = None
        self.problem = ""
        self.beats = 0
        self.refused = 0
        self._last_number = -1
        self._complained_at = -math.inf

    @property
    def has_lease(self) -> bool:
        """Whether this tab may steer."""
        return self.lease is not None and self._agent.desk.holder(self._agent.now) == self.lease

    @property
    def token(self) -> str:
        """Proof of the lease; empty without one."""
        return self.lease.token if self.lease is not None else ""

    # -- what the buttons do ---------------------------------------------------------------------

    async def attempt(self, work: Callable[[], Awaitable[Any]]) -> bool:
        """Do something for the operator; what goes wrong is kept as the problem."""
        self.problem = ""
        try:
            await work()
        except M100Error as error:
            self.problem = str(error)
            return False
        return True

    async def activate(self) -> None:
        """Activate the aircraft."""
        await self._agent.activate(self.token or None)

    async def obtain(self) -> None:
        """Take the lease and control authority.

        Raises:
            LeaseHeld: Another client has the lease; see :meth:`ask_take_over`.
        """
        if not self.has_lease:
            self.lease = self._agent.desk.acquire(self.name, self._agent.now)
        try:
            await self._agent.obtain(self.token)
        except M100Error:
            self.let_go()
            raise

    def ask_take_over(self) -> TakeOver:
        """First step of a take-over."""
        return self._agent.desk.ask_take_over(self.name, self._agent.now)

    async def confirm_take_over(self, wanted: TakeOver) -> None:
        """Second step: take the lease, and authority if the station does not hold it."""
        self.lease = self._agent.desk.confirm(wanted.token, self._agent.now)
        await self._agent.obtain(self.token)

    async def release(self) -> None:
        """Give authority and lease back."""
        await self._agent.release(self.token)
        self.let_go()

    def let_go(self) -> None:
        """Give the lease back, if this tab has it; motion stops."""
        if self.has_lease:
            self._agent.desk.release(self.token, self._agent.now)
        self.lease = None

    async def fly(self, task: Task) -> None:
        """Take off, land or go home."""
        await self._agent.fly(self.token, task)

    async def simple_task(self, number: int) -> None:
        """Fly a simple task."""
        self._agent.start_pattern(self.token, f"simple task {number}", pattern(number))

    async def stop(self) -> None:
        """Stop. Any tab may."""
        await self._agent.stop()

    # -- what its socket says --------------------------------------------------------------------

    def receive(self, text: str | bytes) -> dict[str, Any] | None:
        """Take a message of the tab; returns what to answer. Never raises."""
        message = _read(text)
        if message is None:
            self.refused += 1
            return None
        number = message["n"]
        if number <= self._last_number:
            self.refused += 1  # an old message again
            return None
        self._last_number = number
        if self.has_lease:
            self._agent.desk.renew(self.token, self._agent.now)
            if message["op"] == "beat":
                self._steer(message)
            elif message["op"] == "rest":
                self._agent.halt()
        return {"op": "echo", "at": message["at"]}

    def _steer(self, message: dict[str, Any]) -> None:
        try:
            setpoint = setpoint_of(
                message["mode"], message["x"], message["y"], message["z"], message["w"]
            )
            self._agent.steer(self.token, setpoint, BEAT_LIFETIME)
            self.beats += 1
            self.problem = ""
        except M100Error as error:
            self.refused += 1
            self.problem = str(error)
            now = self._agent.now
            if now - self._complained_at >= _COMPLAINT_PAUSE:
                self._complained_at = now
                self._agent.journal.note(f"{self.name}: {error.seen}", "warning")

    def lost(self) -> None:
        """The socket is gone: stop, and let others have control."""
        self.let_go()


def _read(text: str | bytes) -> dict[str, Any] | None:
    """A message with every field of the right type, or None."""
    if len(text) > MAX_BEAT:
        return None
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict) or message.get("op") not in ("beat", "rest", "alive"):
        return None
    wanted = ("at", "x", "y", "z", "w") if message["op"] == "beat" else ("at",)
    for name in wanted:
        value = message.get(name)
        if not isinstance(value, int | float) or isinstance(value, bool):
            return None
        if not math.isfinite(value):
            return None
    for name in ("n", "mode") if message["op"] == "beat" else ("n",):
        if type(message.get(name)) is not int:
            return None
    return message
