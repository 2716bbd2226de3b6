"""Under which lease an aircraft flies, kept in the ledger for the agent after this one."""

from __future__ import annotations

import asyncio

from m100link.apps.agent.client import AgentClient
from m100link.apps.fleet.ledger import Ledger
from m100link.errors import M100Error

__all__ = ["KEPT_AGAIN_S", "Aloft"]

KEPT_AGAIN_S = 30.0
"""Seconds after which it is written again while somebody flies, so that its age means something."""


class Aloft:
    """Writes down who flies.

    Args:
        client: Where a disk that does not take it is told.
        ledger: Where it is kept.
    """

    def __init__(self, client: AgentClient, ledger: Ledger) -> None:
        self._client = client
        self._ledger = ledger
        self._number = 0 if ledger.aloft is None else ledger.aloft.fence
        self._changed = asyncio.Event()

    def flown_under(self, number: int) -> None:
        """From now on it is flown under the lease of that number; 0: under none."""
        if number != self._number:
            self._number = number
            self._changed.set()

    async def keep(self) -> None:
        """Write what changes, until this is cancelled.

        What is asked for under a lease after control was obtained is written behind it, so no task
        begins of which the agent after this one would not know whose it was.
        """
        is_kept = True
        while True:
            try:
                async with asyncio.timeout(KEPT_AGAIN_S if self._number or not is_kept else None):
                    await self._changed.wait()
            except TimeoutError:
                pass  # it still flies
            self._changed.clear()
            try:
                await self._ledger.flies(self._number)
                is_kept = True
            except M100Error as error:
                is_kept = False
                self._client.note(f"who flies is not kept: {error.seen}", "error")
