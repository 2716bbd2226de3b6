"""The process that talks to strangers; the agent starts ``python -m m100link.apps.station.front``.

It is told by one line of JSON on its standard input where the agent is, which sockets it has
inherited and what it serves, and answers with one line when it does. It owns nothing: when the
agent has gone it says so to whoever is there for a while, and ends.
"""

from __future__ import annotations

import asyncio
import dataclasses
import os
import signal
import socket
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from m100link.apps.agent.remote_error import Fault
from m100link.apps.agent.transports import connect_unix
from m100link.apps.station.child import answer, end_with_parent, leave_what_stays, logging_as_told
from m100link.apps.station.config import resolve
from m100link.apps.station.console.orders import orders_by_socket
from m100link.apps.station.fronts import Fronts, Sockets, serving_fronts
from m100link.errors import M100Error
from m100link.errors.texts import read_json

__all__ = ["AFTERLIFE", "main"]

AFTERLIFE = 60.0
"""Seconds that it tells of an agent that has gone, before it ends."""

_CHECK = 0.25


async def _serve(request: dict[str, Any]) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    settings = resolve(request["settings"], {})
    os.nice(settings.niceness())
    console, metrics, foxglove = (request[one] for one in ("console", "metrics", "foxglove"))
    sockets = Sockets(
        [socket.socket(fileno=number) for number in request["rosbridge"]],
        None if console is None else socket.socket(fileno=console),
        None if metrics is None else socket.socket(fileno=metrics),
        tuple(socket.socket(fileno=number) for number in request["mavlink"]),
        None if foxglove is None else socket.socket(fileno=foxglove),
    )
    reach = {name: partial(connect_unix, Path(path)) for name, path in request["agents"].items()}
    orders = {name: await orders_by_socket(Path(path)) for name, path in request["orders"].items()}
    parent_ended = asyncio.Event()
    end_with_parent(parent_ended)
    async with serving_fronts(settings, sockets, reach, orders) as fronts:
        leave_what_stays()
        answer(console_path=fronts.console_path())
        await _until_ended(ended, fronts, parent_ended)


async def _until_ended(ended: asyncio.Event, fronts: Fronts, parent_ended: asyncio.Event) -> None:
    alone = 0.0
    while not ended.is_set() and alone < AFTERLIFE:
        with suppress(TimeoutError):
            async with asyncio.timeout(_CHECK):
                await ended.wait()
        # One of several agents is started again as long as whoever starts them is there.
        is_last = len(fronts.agents) == 1 or parent_ended.is_set()
        if is_last and all(agent.is_gone for agent in fronts.agents.values()):
            if not alone:
                fronts.stop_listening()  # the next station needs the ports
            alone += _CHECK


def main() -> int:
    """Serve until told to end."""
    request = read_json(sys.stdin.readline())
    try:
        with logging_as_told(request):
            asyncio.run(_serve(request))
    except M100Error as error:
        answer(fault=dataclasses.asdict(Fault.of(error)))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
