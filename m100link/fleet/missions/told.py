"""Tells whoever asks how far the mission of an aircraft is."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

from m100link.bus.network import Bus, Question
from m100link.fleet.keys import Keys
from m100link.fleet.missions.board import Missions
from m100link.fleet.payloads import pack

__all__ = ["MissionTeller"]


class MissionTeller:
    """One aircraft's end.

    Args:
        missions: Of that aircraft.
        bus: The network.
        keys: Its keys.
        boot: Which run of its agent this is.
    """

    def __init__(self, missions: Missions, bus: Bus, keys: Keys, boot: str) -> None:
        self._missions, self._bus, self._keys, self._boot = missions, bus, keys, boot

    async def run(self) -> None:
        """Answer until this is cancelled."""
        with ExitStack() as stack:
            stack.callback(self._bus.serve(self._keys.mission, self._on_question).close)
            await asyncio.Event().wait()

    def _on_question(self, question: Question) -> None:
        card = self._missions.card(self._keys.name, self._boot)
        question.answer(self._keys.mission, pack(card))
