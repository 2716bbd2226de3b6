"""ROS 2 as a front of the station: a session, and a node for each aircraft."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from importlib.util import find_spec

from m100link.apps.agent.client import AgentClient
from m100link.apps.bus.session import ZenohBus
from m100link.apps.ros2.actions import FLIGHTS
from m100link.apps.ros2.dds import DdsBus, no_rclpy, open_dds
from m100link.apps.ros2.graph import Names
from m100link.apps.ros2.node import MOST_BYTES, Node, open_ros2
from m100link.apps.ros2.topics import INPUTS, SERVICES
from m100link.apps.station.config import Settings, namespace_of
from m100link.apps.station.listeners import Fronts, beside
from m100link.errors import UsageError
from m100link.errors.usage import of_extra

RMW = ("zenoh", "dds")
MOST_DOMAIN = 232  # the greatest domain that every middleware of ROS 2 knows


def nodes_of(settings: Settings, aircraft: list[str]) -> dict[str, Names]:
    """The node of each aircraft: of several, each is in a namespace of its own.

    Raises ``UsageError``: a name cannot be, or two things that move an aircraft would have one.
    """
    found = {}
    owners: dict[str, str] = {}
    for name in aircraft:
        inner = f"/{namespace_of(name)}" if len(aircraft) > 1 else ""
        namespace = settings.ros2_namespace.rstrip("/") + inner
        names = found[name] = Names.of(namespace, settings.ros2_node, settings.ros2_remap)
        for own in (*INPUTS, *SERVICES, *FLIGHTS):
            full = names.full(own)
            owner = f"{own} of {name}" if len(aircraft) > 1 else own
            if full in owners:
                raise UsageError(
                    f"{owners[full]} and {owner} would both be {full}",
                    cause="a call to one would move the other, too",
                    remedy="rename one by --remap, which is --ros2-remap of serve and console",
                )
            owners[full] = owner
    return found


def check_ros2(settings: Settings, aircraft: Sequence[str] = ("",)) -> None:
    """Look whether nodes can be served, before anything is opened.

    Raises ``UsageError``: it cannot.
    """
    if not settings.ros2:
        return
    if settings.ros2_rmw not in RMW:
        raise UsageError(
            f"there is no middleware {settings.ros2_rmw!r}", remedy=f"choose {' or '.join(RMW)}"
        )
    of_extra("xxhash", "ROS 2", "ros2")
    if settings.ros2_rmw == "zenoh":
        of_extra("zenoh", "ROS 2", "ros2")
    elif find_spec("rclpy") is None:
        raise no_rclpy("it is not installed")
    if not 0 <= settings.ros2_domain <= MOST_DOMAIN:
        raise UsageError(
            f"there is no domain {settings.ros2_domain}", remedy=f"choose 0 to {MOST_DOMAIN}"
        )
    nodes_of(settings, list(aircraft))


def prepare(stack: AsyncExitStack, settings: Settings) -> list[socket.socket]:
    """Look whether one node can be served; zenoh opens what it needs when it is.

    Raises ``UsageError``: it cannot.
    """
    check_ros2(settings)
    return []


async def serve(fronts: Fronts) -> None:
    agents = await fronts.reached("ROS 2")
    await fronts.stack.enter_async_context(serving_ros2(agents, fronts.settings))


@asynccontextmanager
async def serving_ros2(
    agents: Mapping[str, AgentClient], settings: Settings
) -> AsyncIterator[list[Node]]:
    """Serve while the block runs.

    Raises ``UsageError``: the session cannot be.
    """
    names = nodes_of(settings, list(agents))
    session: AbstractAsyncContextManager[ZenohBus | DdsBus] = (
        open_dds(settings.ros2_domain, MOST_BYTES) if settings.ros2_rmw == "dds" else open_ros2()
    )
    async with session as bus:
        nodes = [
            Node(
                agent,
                bus,
                names[name],
                domain=settings.ros2_domain,
                number=number,
                has_clock=settings.is_virtual and not number,
                has_dji_names=settings.ros2_dji_names,
            )
            for number, (name, agent) in enumerate(agents.items())
        ]
        for package, ends in bus.missing.items() if isinstance(bus, DdsBus) else ():
            for agent in agents.values():
                agent.note(f"{package} is not built here: there is no {', '.join(ends)}", "warning")
        async with beside({f"m100link station: {node.name.full}": node.run() for node in nodes}):
            yield nodes
