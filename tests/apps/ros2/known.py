"""A node on the known aircraft, whose agent is played; its messages as rosbags reads them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.transports import memory_channels
from m100link.apps.ros2 import MESSAGES
from m100link.apps.ros2.graph import Names, data_key
from m100link.apps.ros2.node import Node
from m100link.apps.ros2.publishers import ALL_OUTPUTS
from m100link.log.cdr import full_name
from tests.apps.ros2.conftest import Program, RecordingBus, Rig, judge
from tests.known import KnownAgent


class KnownRig(Rig):
    """A node, and a played agent instead of an aircraft."""

    def __init__(self) -> None:
        self.bus = RecordingBus()
        self.names = Names.of("/", "m100")

    @asynccontextmanager
    async def running(self) -> AsyncIterator[KnownRig]:
        ours, its = memory_channels(as_bytes=True)
        self.known = KnownAgent(its)
        async with AgentClient(ours, "ROS 2") as self.client:
            self.node = Node(
                self.client, self.bus, self.names, has_clock=True, has_dji_names=True, utc=self.utc
            )
            work = self.client.background.spawn(self.node.run(), "node")
            self.program = Program(self)
            yield self
            work.cancel()

    def newest(self, name: str) -> dict[str, Any] | None:
        """The last message of a topic, by the path of each of its values; None without one."""
        sent = self.sent(name)
        if not sent:
            return None
        return read(full_name(ALL_OUTPUTS[name].kind), sent[-1][0])

    def sent(self, name: str) -> list[tuple[bytes, bytes]]:
        """The messages of a topic, and their attachments."""
        key = data_key(0, self.names.full(name), ALL_OUTPUTS[name].kind)
        return self.bus.outlets[key].sent


@cache
def _store() -> Any:
    typesys = judge()
    store = typesys.get_typestore(typesys.Stores.LATEST)
    for path in sorted(MESSAGES.rglob("*.msg")):
        name = full_name(f"m100_msgs/{path.stem}")
        store.register(typesys.get_types_from_msg(path.read_text(), name))
    return store


def read(kind: str, data: bytes) -> dict[str, Any]:
    """A message by the path of each of its values."""
    return flat(_store().deserialize_cdr(data, kind))


def flat(message: Any, path: str = "") -> dict[str, Any]:
    """Each value of a message of rosbags; a rotation with the scalar part that is not negative."""
    fields = [one for one in vars(message) if one.islower() and not one.startswith("__")]
    inner = f"{path}." if path else ""
    found: dict[str, Any] = {}
    for name in fields:
        value = getattr(message, name)
        if hasattr(value, "__msgtype__"):
            found |= flat(value, inner + name)
        elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            for place, one in enumerate(value):
                found |= flat(one, f"{inner}{name}.{place}")
        else:
            is_text = isinstance(value, str) or not hasattr(value, "__len__")
            found[inner + name] = value if is_text else tuple(value)
    if fields == ["x", "y", "z", "w"] and message.w < 0.0:
        found = {name: -value for name, value in found.items()}
    return found
