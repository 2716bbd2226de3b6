"""The station's events as ROS has them: the topic ``/rosout``."""

from __future__ import annotations

from m100link.agent.client import AgentClient
from m100link.agent.messages import Event
from m100link.station.ros.graph import Graph
from m100link.station.ros.messages import present
from m100link.station.ros.rosapi import NODE

__all__ = ["LEVELS", "Rosout"]

LEVELS = {"info": 2, "warning": 4, "error": 8}
"""Level of an event, and its number in rosgraph_msgs/Log."""


class Rosout:
    """Publishes each event.

    Args:
        agent: Whose events.
        graph: Where the topic is offered.
    """

    def __init__(self, agent: AgentClient, graph: Graph) -> None:
        self._agent, self._graph = agent, graph
        self._topic = graph.add_topic("/rosout", "rosgraph_msgs/Log")
        agent.on_event.append(self._tell)

    def _tell(self, event: Event) -> None:
        message = self._topic.type.default() | {
            "header": {"seq": event.number & 0xFFFFFFFF, "stamp": present(), "frame_id": ""},
            "level": LEVELS.get(event.level, 2),
            "name": NODE,
            "msg": event.text,
        }
        self._graph.publish(self._topic, message, self._agent.now)
