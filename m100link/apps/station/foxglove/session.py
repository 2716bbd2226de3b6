"""One viewer by Foxglove's WebSocket protocol, without a transport: it subscribes, and reads.

Subprotocol ``foxglove.sdk.v1``, and its former name. The server advertises channels and sends what
was subscribed to; it has no capability by which a viewer could publish, set or call anything.
"""

from __future__ import annotations

import json
import struct
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from m100link.apps.station.ros.allowance import Allowance
from m100link.errors.texts import read_json

__all__ = ["SUBPROTOCOLS", "Channel", "Viewer"]

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""What is spoken, the newest first."""

_MESSAGE_DATA = 1
_WAITING = 64  # messages of a subscription that wait for a slow viewer
_MAX_SUBSCRIPTIONS = 200
_OPERATIONS_PER_S, _OPERATIONS_AT_ONCE = 20.0, 100.0
_WARNING = 1
_MAX_NUMBER = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class Channel:
    """What can be subscribed to.

    Attributes:
        number: Its id.
        topic: Its name.
        schema_name: Name of the schema.
        schema: JSON schema of its messages.
    """

    number: int
    topic: str
    schema_name: str
    schema: str

    def advertised(self) -> dict[str, Any]:
        """As a viewer is told of it."""
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": "json",
            "schemaName": self.schema_name,
            "schema": self.schema,
            "schemaEncoding": "jsonschema",
        }


class Viewer:
    """What one viewer subscribed to, and what waits for it.

    Args:
        channels: What there is.
        session_id: Tells this run of the station from the one before.
        on_output: Called when there is something to send.

    Attributes:
        dropped: Messages that it did not get because it is slow.
        close_reason: Set when it has to go.
    """

    def __init__(
        self,
        channels: Iterable[Channel],
        session_id: str,
        on_output: Callable[[], None] = lambda: None,
    ) -> None:
        self.dropped = 0
        self.close_reason: str | None = None
        self._channels = {one.number: one for one in channels}
        self._by_subscription: dict[int, int] = {}
        self._waiting: dict[int, deque[bytes]] = {}
        self._operations = Allowance(_OPERATIONS_PER_S, _OPERATIONS_AT_ONCE)
        self._on_output = on_output
        info = {
            "op": "serverInfo",
            "name": "m100link",
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": {},
            "sessionId": session_id,
        }
        told = [one.advertised() for one in self._channels.values()]
        self._texts = deque((json.dumps(info), json.dumps({"op": "advertise", "channels": told})))

    def wants(self, channel: int) -> bool:
        """Whether it subscribed to a channel."""
        return channel in self._by_subscription.values()

    def receive(self, frame: str | bytes, now: float) -> None:
        """Take what it sent. Never raises: what is wrong with it is told to it."""
        if not self._operations.take(now):
            self.close_reason = "too many messages: this server is for looking"
            self._on_output()
            return
        if isinstance(frame, bytes):
            self._warn("nothing can be published here")
            return
        try:
            message = read_json(frame)
            operation = message["op"]
            if operation == "subscribe":
                for one in message["subscriptions"]:
                    self._subscribe(one["id"], one["channelId"])
            elif operation == "unsubscribe":
                for number in message["subscriptionIds"]:
                    self._unsubscribe(number)
            else:
                self._warn(f"{str(operation)[:40]} cannot be done here: this server is for looking")
        except (ValueError, LookupError, TypeError):
            self._warn("a message that was not understood")

    def _subscribe(self, number: object, channel: object) -> None:
        if not isinstance(number, int) or not 0 <= number <= _MAX_NUMBER:
            self._warn("a subscription has a number of 32 bits")
        elif not isinstance(channel, int) or channel not in self._channels:
            self._warn(f"there is no channel {str(channel)[:20]}")
        elif number in self._by_subscription:
            self._warn(f"subscription {number} is there already")
        elif len(self._by_subscription) >= _MAX_SUBSCRIPTIONS:
            self._warn("these are too many subscriptions")
        else:
            self._by_subscription[number] = channel
            self._waiting[number] = deque()

    def _unsubscribe(self, number: object) -> None:
        if not isinstance(number, int) or number not in self._by_subscription:
            self._warn(f"there is no subscription {str(number)[:20]}")
            return
        del self._by_subscription[number], self._waiting[number]

    def _warn(self, text: str) -> None:
        if len(self._texts) < _WAITING:
            self._texts.append(json.dumps({"op": "status", "level": _WARNING, "message": text}))
        self._on_output()

    def publish(self, channel: int, at_ns: int, data: bytes) -> None:
        """Let it have a message, if it subscribed; of a slow viewer the oldest are dropped.

        Args:
            channel: Number of the channel.
            at_ns: POSIX time, ns.
            data: JSON.
        """
        for number, wanted in self._by_subscription.items():
            if wanted == channel:
                waiting = self._waiting[number]
                if len(waiting) >= _WAITING:
                    waiting.popleft()
                    self.dropped += 1
                waiting.append(struct.pack("<BIQ", _MESSAGE_DATA, number, at_ns) + data)
        self._on_output()

    def next_frames(self, size: int) -> list[str | bytes]:
        """What goes out next: texts first, then from each subscription in turn."""
        frames: list[str | bytes] = list(self._texts)
        self._texts.clear()
        taken = sum(map(len, frames))
        while taken < size:
            before = len(frames)
            for waiting in self._waiting.values():
                if waiting:
                    frames.append(waiting.popleft())
                    taken += len(frames[-1])
            if len(frames) == before:
                break
        return frames
