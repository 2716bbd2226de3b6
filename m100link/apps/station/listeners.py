"""The listeners: the fronts of a station, a row for each, and their sockets by name.

:data:`FRONTS` is the registry. A row says on which TCP ports of the settings a front is served, and
which module serves it. The process that owns the aircraft opens the sockets: a front that dies
leaves them open, and clients wait for the next one. The process of the fronts gets them under the
names of their rows and serves each name that came. A name without a row, and sockets that no front
took, end the start with an error that names them: no port accepts connections and never answers.

A new front is its module, its row, and its settings. The module has::

    async def serve(fronts: Fronts) -> None:
        # Serve on fronts.take("name"), and let fronts.stack end it.

    def prepare(stack: AsyncExitStack, settings: Settings) -> list[socket.socket]:
        # Where the row says so: check the settings, and open what is no TCP port.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from m100link.apps.agent.background import goes_on
from m100link.apps.station.config import Settings
from m100link.apps.station.web.access_control import Access
from m100link.apps.station.web.intake import Intake
from m100link.errors import LinkError, M100Error, PortBusy, PortFailed, UsageError
from m100link.errors.usage import of_extra

if TYPE_CHECKING:  # the process that opens sockets begins the fronts before it loads what flies
    from m100link.apps.agent.client import AgentClient
    from m100link.apps.agent.transports import Channel
    from m100link.sim.orders import SimulatorOrders

REACH_PAUSE = 0.5  # seconds between two looks whether an agent that has gone is there again

_BACKLOG = 100
_LAST_PORT = 65535

_logger = logging.getLogger(__name__)

Reach = Callable[[], "Awaitable[Channel]"]  # opens a channel to an agent


# -- the registry ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FrontSpec:
    name: str  # of its sockets
    module: str  # loaded in the process that serves it
    ports: Callable[[Settings], Sequence[int] | None]  # its TCP ports; None: it is not served
    scheme: str = "tcp"  # of the reported addresses; ``http`` and ``ws`` become those of TLS
    path: str = ""  # behind the port
    beside: str = ""  # another front, without which there is nothing that it could serve
    is_asked_for: bool = False  # whether it is served where a command says so, too
    prepares: bool = False  # whether its module has ``prepare``

    def load(self) -> Any:
        """Its module. Raises ``UsageError``: something that it needs is not installed."""
        return of_extra(f"m100link.apps.station.{self.module}", self.name, "station")


def _one(port: int | None) -> Sequence[int] | None:
    return None if port is None else (port,)


FRONTS = {
    one.name: one
    for one in (
        FrontSpec(
            "rosbridge", "web.server", lambda s: (s.port, *s.also_ports), "ws", is_asked_for=True
        ),
        FrontSpec("console", "console.app", lambda s: (s.console_port,), "http", is_asked_for=True),
        FrontSpec(
            "mavlink", "mavlink", lambda s: () if s.mavlink or s.mavlink_to else None, prepares=True
        ),
        FrontSpec("ros2", "ros2", lambda s: () if s.ros2 else None, prepares=True),
        FrontSpec(
            "metrics",
            "web.metrics",
            lambda s: _one(s.metrics_port),
            scheme="http",
            path="/metrics",
            beside="rosbridge",
        ),
        FrontSpec("foxglove", "foxglove", lambda s: _one(s.foxglove_port), "ws"),
    )
}
"""By name, in the order in which they begin to serve."""


# -- the sockets -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Sockets:
    """The sockets of each front that is served; one that needs none has an empty row."""

    of: Mapping[str, Sequence[socket.socket]]

    def ports(self, name: str) -> list[int]:
        """Ports of a front, in the order of the settings; none where it is not served."""
        return [one.getsockname()[1] for one in self.of.get(name, ())]

    def port(self, name: str) -> int:
        return self.ports(name)[0]

    def datagram_urls(self, name: str) -> list[str]:
        ends = (one.getsockname() for one in self.of.get(name, ()))
        return [f"udp://{host}:{port}" for host, port in ends]

    def descriptors(self) -> dict[str, list[int]]:
        return {name: [one.fileno() for one in row] for name, row in self.of.items()}

    @classmethod
    def inherited(cls, descriptors: Mapping[str, Sequence[int]]) -> Sockets:
        return cls(
            {
                name: [socket.socket(fileno=number) for number in numbers]
                for name, numbers in descriptors.items()
            }
        )


def open_sockets(
    stack: AsyncExitStack, settings: Settings, *, with_console: bool, with_rosbridge: bool = True
) -> Sockets:
    """The sockets of all fronts that the settings and the command ask for; closed with the stack.

    Raises ``PortBusy, PortFailed``: a port is taken, or the address cannot be bound. Raises
    ``UsageError``: something in the settings of a front cannot be.
    """
    asked = {"console": with_console, "rosbridge": with_rosbridge}
    ports: dict[str, Sequence[int]] = {}
    for name, front in FRONTS.items():
        found = front.ports(settings)
        if found is None or (front.is_asked_for and not asked[name]):
            continue
        if front.beside and front.beside not in ports:
            _logger.warning("%s: not served, for that needs %s", name, front.beside)
            continue
        ports[name] = found
    opened: dict[str, list[socket.socket]] = {}
    for name in ports:  # all that may be wrong, before a TCP port is bound
        opened[name] = FRONTS[name].load().prepare(stack, settings) if FRONTS[name].prepares else []
    for name, numbers in ports.items():
        for port in numbers:
            if not 0 <= port <= _LAST_PORT:
                raise UsageError(
                    f"there is no port {port}", remedy=f"choose 1 to {_LAST_PORT}, or 0 for any"
                )
            busy = "another station, or another program, serves at that port"
            option = {"rosbridge": "port", "console": "console-port"}.get(name, name)
            remedy = f"end it, or choose another --{option}"
            one = bound(stack, (settings.host, port), socket.SOCK_STREAM, busy=busy, remedy=remedy)
            one.listen(_BACKLOG)
            opened[name].append(one)
    return Sockets(opened)


def bound(
    stack: AsyncExitStack, address: tuple[str, int], kind: int, *, busy: str, remedy: str
) -> socket.socket:
    """A socket at an address, closed with the stack; ``busy``: why another program may have it.

    Raises ``PortBusy, PortFailed``: another program has the port, or the address cannot be bound.
    """
    host, port = address
    one = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind)
    stack.callback(one.close)
    one.setblocking(False)
    if kind == socket.SOCK_STREAM:
        # On Windows SO_REUSEADDR would let any program take the port of another one.
        name = "SO_EXCLUSIVEADDRUSE" if sys.platform == "win32" else "SO_REUSEADDR"
        one.setsockopt(socket.SOL_SOCKET, getattr(socket, name), 1)
    try:
        one.bind(address)
    except OSError as error:
        seen = f"{host}:{port} cannot be served: {error.strerror or error}"
        if error.errno == errno.EADDRINUSE:
            raise PortBusy(seen, cause=busy, remedy=remedy) from error
        raise PortFailed(seen, remedy=remedy) from error
    return one


# -- the fronts on them ----------------------------------------------------------------------------


class Fronts:
    """The fronts of a process: their common part, and the services of one for another."""

    def __init__(
        self,
        stack: AsyncExitStack,  # ends whatever is entered there
        settings: Settings,  # of access and of services
        sockets: Sockets,
        reach: Mapping[str, Reach],  # opens a channel to each agent, by the name of its aircraft
        orders: Mapping[str, SimulatorOrders],  # of the console's panel to virtual aircraft
        *,
        is_kept: bool,  # whether an agent that has gone is looked for again
    ) -> None:
        self.stack, self.settings, self.orders = stack, settings, orders
        self.sockets, self._reach, self._is_kept = sockets, reach, is_kept
        self._taken: set[str] = set()
        self.intake = Intake()  # of all servers of this process
        # The agents as the first front knows them, by the names of their aircraft; one that comes
        # later is shown by the console of a fleet, too.
        self.agents: dict[str, AgentClient] = {}
        self.made: dict[str, object] = {}  # the service of a front for others, by its name
        # Messages that slow clients of a front did not get, by the front's name.
        self.dropped: dict[str, Callable[[], Mapping[str, int]]] = {}
        self.leave_port: list[Callable[[], None]] = []  # of each server; its connections stay
        self.access: Access | None = None  # what browsers have to show; None: nothing
        # The aircraft that pages of the console show.
        self.shown: Callable[[], frozenset[str]] = frozenset

    def take(self, name: str) -> list[socket.socket]:
        """The sockets of a front, which serves on them from now on."""
        self._taken.add(name)
        return list(self.sockets.of[name])

    async def reached(self, client: str) -> dict[str, AgentClient]:
        """All agents, each for a front that they know by that name.

        Raises ``LinkError``: one of them cannot be reached.
        """
        from m100link.apps.agent.client import AgentClient

        agents = {}
        for aircraft, reach in self._reach.items():
            agent = await self.stack.enter_async_context(AgentClient(await reach(), client))
            if self._is_kept:
                agent.background.spawn(keep_reached(agent, reach), f"way to {aircraft}")
            agents[aircraft] = agent
        self.agents = self.agents or agents
        return agents

    async def serve(self) -> None:
        """Begin to serve all that sockets came for.

        Raises ``M100Error``: sockets came for a front that there is not, or nobody serves them.
        Raises ``UsageError``: something in the settings cannot be. Raises ``LinkError``: an agent
        cannot be reached.
        """
        for name in self.sockets.of:
            if name not in FRONTS:
                raise M100Error(f"sockets came for {name!r}, which is no front of a station")
        for name, front in FRONTS.items():
            if name in self.sockets.of:
                await front.load().serve(self)
        for name, row in self.sockets.of.items():
            if row and name not in self._taken:
                raise M100Error(f"{name}: its module serves nobody on its sockets")
        if not self.agents:
            await self.reached("fronts")

    def console_path(self) -> str:
        """Path that opens the console in a browser, with a code that works once where needed."""
        return "/" if self.access is None else f"/?code={self.access.new_code()}"

    def stop_listening(self) -> None:
        """Leave the ports to another station; connections that are there stay."""
        for leave_port in self.leave_port:
            leave_port()


@asynccontextmanager
async def serving_fronts(
    settings: Settings,  # of access and of services
    sockets: Sockets,
    reach: Mapping[str, Reach],
    orders: Mapping[str, SimulatorOrders],  # of the console's panel to virtual aircraft
    *,
    is_far: bool = False,  # whether agents are reached over a network
) -> AsyncIterator[Fronts]:
    """Serve while the block runs; raises as :meth:`Fronts.serve` does."""
    async with AsyncExitStack() as stack:
        is_kept = is_far or len(reach) > 1
        fronts = Fronts(stack, settings, sockets, reach, orders, is_kept=is_kept)
        await fronts.serve()
        yield fronts


@asynccontextmanager
async def beside(works: Mapping[str, Coroutine[Any, Any, None]]) -> AsyncIterator[None]:
    """Run these while the block runs, each in a task of its name.

    One that fails takes the process with it, which is started again.
    """
    async with asyncio.TaskGroup() as group:
        running = [group.create_task(work, name=name) for name, work in works.items()]
        try:
            yield
        finally:
            for one in running:
                one.cancel()


async def keep_reached(agent: AgentClient, reach: Reach) -> None:
    """Whenever the agent has gone, look for the one that is started instead, until cancelled."""
    while True:
        await asyncio.sleep(REACH_PAUSE)
        if agent.is_gone:
            with goes_on("the way to the agent"), suppress(LinkError):
                agent.reopen(await reach())
