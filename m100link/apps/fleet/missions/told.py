"""Tells whoever asks how far the mission of an aircraft is."""

from __future__ import annotations

import asyncio
import math
from contextlib import ExitStack

from m100link.apps.bus.network import Bus, Question
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.missions.board import Missions
from m100link.apps.fleet.payloads import pack

__all__ = ["MissionTeller"]

_MOST_WAITING = 16
"""Questions; of a flood the oldest are dropped."""

_AS_GOOD_AS_NEW_S = 0.05
"""Seconds in which all who ask hear the same: whoever flies must not wait for who asks."""


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
        self._clock = asyncio.get_running_loop().time
        self._told, self._told_at = b"", -math.inf

    async def run(self) -> None:
        """Answer until this is cancelled."""
        with ExitStack() as stack:
            served = self._bus.serve(self._keys.mission, self._on_question, depth=_MOST_WAITING)
            stack.callback(served.close)
            await asyncio.Event().wait()

    def _on_question(self, question: Question) -> None:
        now = self._clock()
        if now - self._told_at >= _AS_GOOD_AS_NEW_S:
            card = self._missions.card(self._keys.name, self._boot)
            self._told, self._told_at = pack(card), now
        question.answer(self._keys.mission, self._told)
