"""What is told of the aircraft: telemetry, places and attitudes with Foxglove's schemas, events."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.station.config import namespace_of
from m100link.apps.station.foxglove.session import Channel
from m100link.log.channels import FIX, MESSAGE, SCHEMAS, STATE, TELEMETRY, TRANSFORM, Thinning
from m100link.log.witness import fix_of
from m100link.protocol.records import Attitude, Position
from m100link.telemetry.sample import Sample

__all__ = ["STATE_S", "Feed"]

STATE_S = 0.5
"""Between two messages about the agent."""

_INTERVAL_S = 0.05  # between two messages of a topic that comes with telemetry
_LEVELS = {"info": 2, "warning": 3, "error": 4}
_TOPICS = (TELEMETRY, FIX, TRANSFORM, MESSAGE, STATE)

Publish = Callable[[int, int, bytes], None]


class Feed:
    """Makes messages of what the agents tell, as long as somebody wants them.

    Args:
        agents: By the name of their aircraft; the topics of all but the first begin with it.
        utc_offset_s: What makes POSIX time of the event loop's.
        is_wanted: Whether anybody subscribed to a channel.
        publish: Takes the number of a channel, POSIX time in ns, and JSON.

    Attributes:
        channels: What there is.
    """

    def __init__(
        self,
        agents: Mapping[str, AgentClient],
        utc_offset_s: float,
        is_wanted: Callable[[int], bool],
        publish: Publish,
    ) -> None:
        self._utc_offset_s = utc_offset_s
        self._is_wanted, self._publish = is_wanted, publish
        self.channels: list[Channel] = []
        self._numbers: dict[tuple[str, str], int] = {}
        self._thinning = {name: Thinning(_INTERVAL_S) for name in agents}
        for place, name in enumerate(agents):
            prefix = f"/{namespace_of(name)}" if place else ""
            for topic in _TOPICS:
                number = len(self.channels) + 1
                self._numbers[name, topic] = number
                self.channels.append(Channel(number, prefix + topic, *SCHEMAS[topic]))
        for name, agent in agents.items():
            agent.on_event.append(partial(self.hear_event, name))

    def hear(self, name: str, sample: Sample) -> None:
        """A telemetry package; at most twenty a second are told."""
        at = sample.received_at
        told = self._thinning[name].hear(sample.value, sample.profile, at)
        if told is None:
            return
        if self._wants(name, TELEMETRY):
            self._tell(name, TELEMETRY, at, told.row)
        position = told.get(Position)
        if position is None or not position.is_possible:
            return
        if self._wants(name, FIX):
            self._tell(name, FIX, at, {"timestamp": self._stamp(at), **fix_of(position)})
        attitude = told.get(Attitude)
        if attitude is not None and self._wants(name, TRANSFORM):
            x, y, z, w = attitude.enu_flu_xyzw
            transform = {
                "timestamp": self._stamp(at),
                "parent_frame_id": "takeoff",
                "child_frame_id": "m100",
                "translation": {"x": 0.0, "y": 0.0, "z": position.height_m},
                "rotation": {"x": x, "y": y, "z": z, "w": w},
            }
            self._tell(name, TRANSFORM, at, transform)

    def hear_event(self, name: str, event: Event) -> None:
        """Something happened."""
        said = {
            "timestamp": self._stamp(event.at),
            "level": _LEVELS.get(event.level, 0),
            "message": event.text,
            "name": name,
            "file": "",
            "line": 0,
        }
        self._tell(name, MESSAGE, event.at, said)

    def hear_state(self, name: str, agent: AgentClient) -> None:
        """How the agent stands now."""
        if not self._wants(name, STATE):
            return
        state = agent.state
        said = {
            "connection": "silent" if agent.is_silent else state.connection,
            "firmware": state.firmware,
            "has_authority": agent.has_authority,
            "task": state.task,
            "mission": state.mission,
            "round_trip_ms": None if state.round_trip is None else 1000.0 * state.round_trip,
            "holder": agent.holder.name,
        }
        self._tell(name, STATE, agent.now, said)

    def _wants(self, name: str, topic: str) -> bool:
        return self._is_wanted(self._numbers[name, topic])

    def _stamp(self, at: float) -> dict[str, int]:
        nanoseconds = self._nanoseconds(at)
        return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}

    def _nanoseconds(self, at: float) -> int:
        return max(0, round((at + self._utc_offset_s) * 1e9))

    def _tell(self, name: str, topic: str, at: float, said: dict[str, Any]) -> None:
        data = json.dumps(_finite(said), separators=(",", ":")).encode()
        self._publish(self._numbers[name, topic], self._nanoseconds(at), data)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return value
