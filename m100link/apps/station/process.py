"""The other processes of a station: ``python -m m100link.apps.station.process`` and a role.

The supervisor starts them, and tells each by one line of JSON on its standard input what to do.

``agent`` owns one of several aircraft and serves the fronts. When the station has gone it ends in
order: the aircraft hovers, and control authority goes back.

``part`` is a router, an agent or the console of a fleet file, and ends in the same way.

``fronts`` talks to strangers, and owns nothing. It has inherited its sockets, by the names of
:mod:`m100link.apps.station.listeners`. When the agent has gone it says so to its clients for a
while, and ends. It loads nothing that could own an aircraft.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from m100link.apps.agent.background import Ended, is_set_within
from m100link.apps.agent.transports import connect_unix, serve_unix
from m100link.apps.station.config import resolve
from m100link.apps.station.listeners import FRONTS, Fronts, Sockets, serving_fronts
from m100link.apps.station.log_output import log_of, tell_elsewhere
from m100link.apps.station.supervisor import answer, end_with_parent, leave_what_stays, run_child
from m100link.errors import UsageError
from m100link.errors.texts import read_json

LEASES_PER_START = 1_000_000
"""Numbers of leases that one process may use: the lease of one that died never fits another."""

AFTERLIFE = 5.0  # seconds that fronts tell of an agent that has gone, before they end

_CHECK = 0.25


async def _own(request: dict[str, Any], ended: Ended) -> None:
    from m100link.apps.agent.messages import JOURNAL_LOG
    from m100link.apps.station.run import owning
    from m100link.sim.orders import CtlServer

    end_with_parent(ended.end)
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
        # First of all: the fronts' channels close, which releases the leases of their clients.
        stack.callback(owner.service.close)
        leave_what_stays()
        answer(is_virtual=owner.virtual is not None)
        await ended.wait()


async def _part(request: dict[str, Any], ended: Ended) -> None:
    from m100link.apps.station.fleet_file import running_part, tell_log

    end_with_parent(ended.end)
    log_of(request["name"])
    given = request["settings"]
    settings = None if given is None else resolve(given, {})
    place = Path(request["file"]), request["name"]
    async with running_part(*place, settings, tell_log, is_real=request["is_real"]) as facts:
        leave_what_stays()
        answer(**facts)
        await ended.wait()


async def _serve(request: dict[str, Any], ended: Ended) -> None:
    settings = resolve(request["settings"], {})
    sockets = Sockets.inherited(request["sockets"])
    reach = {name: partial(connect_unix, Path(path)) for name, path in request["agents"].items()}
    orders = {}
    if request["orders"]:
        from m100link.sim.orders import orders_by_socket  # loads a virtual aircraft, too

        orders = {name: await orders_by_socket(Path(at)) for name, at in request["orders"].items()}
    parent_ended = asyncio.Event()
    end_with_parent(parent_ended.set)
    async with serving_fronts(settings, sockets, reach, orders) as fronts:
        leave_what_stays()
        answer(console_path=fronts.console_path())
        await _until_ended(ended, fronts, parent_ended)


async def _until_ended(ended: asyncio.Event, fronts: Fronts, parent_ended: asyncio.Event) -> None:
    alone = 0.0
    while not ended.is_set() and alone < AFTERLIFE:
        await is_set_within(ended, _CHECK)
        # One of several agents is started again as long as its supervisor is there.
        is_last = len(fronts.agents) == 1 or parent_ended.is_set()
        if is_last and all(agent.is_gone for agent in fronts.agents.values()):
            if not alone:
                fronts.stop_listening()  # the next station needs the ports
            alone += _CHECK


def _load(niceness: int, fronts: Sequence[str], recordings: Sequence[Sequence[str]]) -> None:
    """Step back behind the process that flies, and load fronts while that one connects.

    ``recordings``: files of a replay, and the firmware profile of each, or empty.
    """
    os.nice(niceness)
    if "console" in fronts:
        # A fifth of the time: what engineio's client needs, and the models of FastAPI's own pages.
        # Nobody in this process uses either.
        sys.modules.update(dict.fromkeys(("aiohttp", "requests")))  # type: ignore[arg-type] # none
        with suppress(ImportError):  # the front says it
            import_module("pydantic").BaseModel.model_config["defer_build"] = True
    with suppress(UsageError):  # the front that serves says it
        for path, firmware in recordings:
            import_module("m100link.apps.station.console.kept").begin_analysis(path, firmware)
        for name in fronts:
            FRONTS[name].load()
    gc.freeze()  # NiceGUI searches all that the collector walks through for its server


if __name__ == "__main__":
    gc.disable()  # until it serves: what is loaded stays, and walking through it takes a fifth
    role, *loads = sys.argv[1:]
    if loads:
        _load(*read_json(loads[0].encode()))
    sys.exit(run_child({"agent": _own, "fronts": _serve, "part": _part}[role]))
