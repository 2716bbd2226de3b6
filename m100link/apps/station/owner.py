"""The process that owns one of several aircraft: ``python -m m100link.apps.station.owner``.

It is told by one line of JSON on its standard input whose aircraft it is and where to serve the
fronts, and answers with one line when it does. When whoever started it has gone it ends in order:
the aircraft hovers, and control authority goes back.
"""

from __future__ import annotations

import asyncio
import dataclasses
import signal
import sys
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from m100link.apps.agent.journal import JOURNAL_LOG
from m100link.apps.agent.remote_error import Fault
from m100link.apps.agent.transports import serve_unix
from m100link.apps.station.child import answer, end_with_parent, leave_what_stays, logging_as_told
from m100link.apps.station.config import resolve
from m100link.apps.station.log_output import log_of, tell_elsewhere
from m100link.apps.station.run import owning
from m100link.errors import M100Error
from m100link.errors.texts import read_json
from m100link.sim.orders.ctl import CtlServer

__all__ = ["LEASES_PER_START", "main"]

LEASES_PER_START = 1_000_000
"""Numbers of leases that one process may use: the lease of one that died never fits another."""


async def _own(request: dict[str, Any]) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    end_with_parent(ended)
    log_of(request["name"])
    tell_elsewhere(JOURNAL_LOG)  # by the process over this one, which gets every event
    async with AsyncExitStack() as stack:
        owner = await stack.enter_async_context(
            owning(
                resolve(request["settings"], {}),
                place=request["place"],
                leases_before=LEASES_PER_START * request["starts"],
            )
        )
        await stack.enter_async_context(serve_unix(Path(request["agent"]), owner.service.attach))
        if owner.virtual is not None:
            orders = CtlServer([owner.virtual], Path(request["orders"]))
            await orders.start()
            stack.push_async_callback(orders.stop)
        # First of all: the fronts are told, and whoever flies is let go.
        stack.callback(owner.service.close)
        leave_what_stays()
        answer(is_virtual=owner.virtual is not None)
        await ended.wait()


def main() -> int:
    """Own the aircraft until told to end."""
    request = read_json(sys.stdin.readline())
    try:
        with logging_as_told(request):
            asyncio.run(_own(request))
    except M100Error as error:
        answer(fault=dataclasses.asdict(Fault.of(error)))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
