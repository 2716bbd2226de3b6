"""``m100link mavlink``: aircraft as vehicles for MAVSDK, QGroundControl and every other program."""

from __future__ import annotations

import asyncio
import signal
from contextlib import AsyncExitStack

from m100link.agent.carriers.memory import memory_channels
from m100link.agent.client import AgentClient
from m100link.cli.common import AppOptions, LinkOptions, Url, err, out, run_async
from m100link.cli.outcome import ExitCode
from m100link.mavlink.bridge import Bridge
from m100link.mavlink.udp import bind, read_address, serving
from m100link.station.config import Settings
from m100link.station.run import owning

__all__ = ["mavlink"]


def mavlink(
    url: Url = None,
    *,
    listen: str = "udp://127.0.0.1:14550",
    to: tuple[str, ...] = (),
    sysid: int = 1,
    link: LinkOptions | None = None,
    app: AppOptions | None = None,
) -> int:
    """Let programs that speak MAVLink see and fly the aircraft, until Ctrl-C.

    Args:
        url: Where the aircraft is.
        listen: Where ground stations connect to.
        to: An address that is spoken to first, such as that of a program that listens itself; may
            be given several times.
        sysid: System id of the aircraft.
        link: How to talk to it.
        app: Whose app it is.
    """
    place = (link or LinkOptions()).place(url, app)
    settings = place.settings
    return run_async(_serve(settings, listen, to, sysid))


async def _serve(settings: Settings, listen: str, to: tuple[str, ...], sysid: int) -> int:
    import dataclasses

    if settings.url is not None and settings.url.startswith("sim:"):
        settings = dataclasses.replace(settings, url=None, sim=True)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    async with AsyncExitStack() as stack:
        bound = bind(read_address(listen))
        stack.callback(bound.close)
        owner = await stack.enter_async_context(owning(settings))
        ours, its = memory_channels()
        owner.service.attach(its)
        client = await stack.enter_async_context(AgentClient(ours, "mavlink"))
        holder: list[Bridge] = []
        send = await stack.enter_async_context(
            serving(bound, lambda data, address: holder[0].received(data, address))
        )
        bridge = Bridge({sysid: client}, send, to=tuple(map(read_address, to)))
        holder.append(bridge)
        running = asyncio.create_task(bridge.run())
        host, port = bound.getsockname()
        out.print(f"mavlink: udp://{host}:{port}, system {sysid}", markup=False)
        waiting = asyncio.create_task(ended.wait())
        await asyncio.wait((running, waiting), return_when=asyncio.FIRST_COMPLETED)
        if running.done():
            await running
        err.print("ending")
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
    return ExitCode.OK
