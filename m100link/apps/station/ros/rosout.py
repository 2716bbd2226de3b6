"""The station's events as ROS has them: the topic ``/rosout``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.station.ros.graph import Graph
from m100link.apps.station.ros.messages import present
from m100link.apps.station.ros.rosapi import NODE

__all__ = ["LEVELS", "Rosout"]

LEVELS = {"info": 2, "warning": 4, "error": 8}
"""Level of an event, and its number in rosgraph_msgs/Log."""


class Rosout:
    """Publishes each event.

    Args:
        agents: Whose events, by the name of the aircraft.
        graph: Where the topic is offered.
    """

    def __init__(self, agents: Mapping[str, AgentClient], graph: Graph) -> None:
        self._graph = graph
        self._topic = graph.add_topic("/rosout", "rosgraph_msgs/Log")
        for name, agent in agents.items():
            node = f"{NODE}/{name}" if len(agents) > 1 else NODE
            agent.on_event.append(partial(self._tell, agent, node))

    def _tell(self, agent: AgentClient, node: str, event: Event) -> None:
        message = self._topic.type.default() | {
            "header": {"seq": event.number & 0xFFFFFFFF, "stamp": present(), "frame_id": ""},
            "level": LEVELS.get(event.level, 2),
            "name": node,
            "msg": event.text,
        }
        self._graph.publish(self._topic, message, agent.now)
