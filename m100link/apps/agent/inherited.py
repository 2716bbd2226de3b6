"""Control authority that an agent before may have left: nobody here asked for it, so it goes back.

An agent that is killed in flight gives nothing back. The aircraft hovers for want of setpoints and
goes on obeying a program that is not there, or flies the task or mission that it was asked for, and
every lease has gone with the agent. What a lost lease leads to happens here, too, only later.
"""

from __future__ import annotations

import asyncio

from m100link.aircraft import Aircraft
from m100link.apps.agent.background import BackgroundTasks
from m100link.apps.agent.journal import Journal

__all__ = ["Inherited"]


class Inherited:
    """Gives back, once, what an agent before may have held.

    Args:
        journal: Where it is told.
        background: Where it is done.
        is_owed: Whether there was an agent before.
    """

    def __init__(self, journal: Journal, background: BackgroundTasks, *, is_owed: bool) -> None:
        self._journal = journal
        self._background = background
        self._is_owed = is_owed
        self._work: asyncio.Task[None] | None = None

    def connected(self, aircraft: Aircraft, *, is_activated: bool) -> None:
        """The aircraft answers; one that is not activated obeys nobody."""
        if self._is_owed and is_activated and self._work is None:
            self._work = self._background.spawn(self._give_back(aircraft), "inherited authority")

    async def settle(self) -> None:
        """Wait until nothing goes back any more: a request would overtake it, and be undone.

        Whoever asks now holds it in their own name, and nothing is owed.
        """
        self._is_owed = False
        if self._work is not None:
            await asyncio.wait([self._work])

    async def _give_back(self, aircraft: Aircraft) -> None:
        try:
            if await aircraft.release_authority():
                self._is_owed = False
                self._journal.note(
                    "control authority that the agent before may have left is given back: "
                    "the aircraft hovers, the pilot flies",
                    "warning",
                )
            else:
                self._journal.note(
                    "the agent before may have left control authority, and the aircraft does not "
                    "say that it has it back: the pilot gets it by leaving F",
                    "error",
                )
        finally:
            self._work = None  # the next connection tries it again, if it is still owed
