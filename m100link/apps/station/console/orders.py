"""Orders of the console's panel to a virtual aircraft: the words of ``m100link sim ctl``."""

from __future__ import annotations

import asyncio
import shlex
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from m100link.errors import UsageError
from m100link.sim.orders import perform, send_order, status
from m100link.sim.virtual import VirtualAircraft


class SimulatorOrders:
    """Gives orders to a virtual aircraft, and keeps its last state."""

    def __init__(
        self, give: Callable[[list[str]], Awaitable[dict[str, Any]]], shown: dict[str, Any]
    ) -> None:
        self._give = give
        # As :func:`m100link.sim.orders.status` has it, after the last order.
        self.status = shown

    async def give(self, *lines: str) -> None:
        """Carry out orders, each a line of text.

        Raises ``M100Error``: one cannot be carried out.
        """
        for line in lines:
            self.status = await self._give(shlex.split(line))


def orders_in_process(virtual: VirtualAircraft) -> SimulatorOrders:
    async def give(words: list[str]) -> dict[str, Any]:
        perform(virtual, words)
        return status(virtual)

    return SimulatorOrders(give, status(virtual))


async def orders_by_socket(path: Path) -> SimulatorOrders:
    """Orders to the virtual aircraft behind a socket of :class:`m100link.sim.orders.CtlServer`.

    Raises ``M100Error``: nobody answers there.
    """

    async def give(words: list[str]) -> dict[str, Any]:
        answer = await asyncio.to_thread(send_order, words, path=path)
        if not answer.get("ok"):
            raise UsageError(str(answer.get("error", "the order was refused")))
        shown: dict[str, Any] = answer["status"]
        return shown

    return SimulatorOrders(give, await give(["status"]))
