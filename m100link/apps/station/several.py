"""A station with several aircraft: a process for each, one for all fronts, and this one over them.

This process owns no aircraft and serves nobody. It holds the listening sockets, starts the others,
starts again whichever ends, and tells what happens. An agent that dies or hangs costs its own
aircraft a hover, and the others nothing; the fronts find the next one by themselves.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.agent.transports import connect_unix, private_directory
from m100link.apps.station.apart import as_json, front_process, front_settings, kept
from m100link.apps.station.child import Child
from m100link.apps.station.config import MOST_AIRCRAFT, Settings
from m100link.apps.station.fronts import Sockets, keep_reached, open_sockets
from m100link.apps.station.ros2 import check_ros2
from m100link.errors import UsageError

__all__ = ["END_TIMEOUT", "RunningSeveral", "running_several"]

END_TIMEOUT = 15.0
"""Seconds that an agent has to give control authority back and end."""

_FOR_AGENTS = (
    *("url", "baud_rate", "firmware", "timeout", "sim", "app_id", "key", "key_file", "level"),
    *("app_version", "bundle_id", "keep_authority", "max_height", "max_radius"),
    *("record", "no_record", "record_keep", "record_keep_mb"),
)

Tell = Callable[[str, Event], None]


@dataclass(frozen=True, slots=True)
class RunningSeveral:
    """A station that runs.

    Attributes:
        owners: The process that owns an aircraft, by its name.
        agents: What is known here of each agent.
        front: The process of the fronts.
        sockets: Where the fronts listen.
    """

    owners: Mapping[str, Child]
    agents: Mapping[str, AgentClient]
    front: Child
    sockets: Sockets

    @property
    def has_authority(self) -> bool:
        """Whether one of the aircraft obeys this station, as far as is known here."""
        return any(agent.has_authority for agent in self.agents.values())

    @property
    def ports(self) -> list[int]:
        """Ports of rosbridge, in the order of the settings."""
        return self.sockets.ports

    @property
    def console_port(self) -> int | None:
        """Port of the console, None without it."""
        return self.sockets.console_port

    @property
    def metrics_port(self) -> int | None:
        """Port of the numbers for Prometheus, None without them."""
        return self.sockets.metrics_port

    @property
    def foxglove_port(self) -> int | None:
        """Port of Foxglove's viewers, None without them."""
        return self.sockets.foxglove_port

    @property
    def mavlink(self) -> list[str]:
        """Where MAVLink is served."""
        return self.sockets.mavlink_addresses

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return str(self.front.answer["console_path"])


def agent_settings(settings: Settings) -> dict[str, Any]:
    """What an agent has to know, as JSON takes it: nothing of who may connect."""
    found = {one.name: getattr(settings, one.name) for one in fields(settings)}
    return as_json({name: found[name] for name in _FOR_AGENTS})


@asynccontextmanager
async def running_several(
    aircraft: Mapping[str, Settings],
    *,
    with_console: bool = False,
    with_rosbridge: bool = True,
    tell: Tell = lambda *_: None,
) -> AsyncIterator[RunningSeveral]:
    """Run a station while the block runs.

    Args:
        aircraft: Settings by the name of the aircraft; those of the first say who may connect and
            what is served.
        with_console: Serve the console, too.
        with_rosbridge: Serve rosbridge.
        tell: Called with the name of an aircraft and each of its events.

    Raises:
        UsageError, PortBusy, PortFailed: Something in the settings cannot be, or a port is taken.
    """
    if not 1 <= len(aircraft) <= MOST_AIRCRAFT:
        raise UsageError(
            f"{len(aircraft)} aircraft are too many for one station",
            remedy=f"one station has at most {MOST_AIRCRAFT}: start another one beside it",
        )
    settings = next(iter(aircraft.values()))
    front_settings(settings)
    settings.niceness()
    check_ros2(settings, list(aircraft))  # all before anything is bound
    async with AsyncExitStack() as stack:
        sockets = open_sockets(
            stack, settings, with_console=with_console, with_rosbridge=with_rosbridge
        )
        directory = stack.enter_context(private_directory())
        agents: dict[str, AgentClient] = {}

        def note(name: str, text: str, level: str) -> None:
            # Without an agent there is nobody to keep it: told here alone.
            agent = agents.get(name)
            if agent is None or agent.is_gone:
                tell(name, Event(0, asyncio.get_running_loop().time(), level, text))
            else:
                agent.note(text, level)

        owners = {
            name: _owner(name, place, one, directory, partial(note, name))
            for place, (name, one) in enumerate(aircraft.items())
        }
        await _start(stack, list(owners.values()))
        paths = {name: _path(directory, place) for place, name in enumerate(aircraft)}
        for name, path in paths.items():
            reach = partial(connect_unix, path)
            agent = AgentClient(await reach(), "the station")
            agent.on_event.append(partial(tell, name))
            agents[name] = await stack.enter_async_context(agent)
            agent.background.spawn(keep_reached(agent, reach), "agent")
        virtual = {
            name: _path(directory, place, "orders")
            for place, name in enumerate(aircraft)
            if owners[name].answer["is_virtual"]
        }

        def note_all(text: str, level: str) -> None:
            for name in agents:
                note(name, text, level)

        front = front_process(settings, sockets, paths, virtual if with_console else {}, note_all)
        await stack.enter_async_context(kept(front))
        yield RunningSeveral(owners, agents, front, sockets)


def _path(directory: Path, place: int, kind: str = "agent") -> Path:
    return directory / f"{kind}{place}.sock"


def _owner(
    name: str, place: int, settings: Settings, directory: Path, note: Callable[[str, str], None]
) -> Child:
    request = {
        "name": name,
        "settings": agent_settings(settings),
        "place": place,
        "agent": str(_path(directory, place)),
        "orders": str(_path(directory, place, "orders")),
    }
    return Child("m100link.apps.station.owner", f"the agent of {name}", request, note)


async def _start(stack: AsyncExitStack, owners: list[Child]) -> None:
    """Start all of them at once, keep them, and end them all at once."""

    async def end() -> None:
        await asyncio.gather(*(one.end(END_TIMEOUT) for one in owners))

    stack.push_async_callback(end)
    for met in await asyncio.gather(*(one.start() for one in owners), return_exceptions=True):
        if met is not None:
            raise met
    keeping = [asyncio.create_task(one.keep(), name="m100link station: agent") for one in owners]

    async def stop_keeping() -> None:
        for task in keeping:
            task.cancel()
        await asyncio.gather(*keeping, return_exceptions=True)

    stack.push_async_callback(stop_keeping)
