"""What Foxglove and Lichtblick show of a flight while it is flown; nothing can be sent by it.

Subprotocol ``foxglove.sdk.v1``, and its former name. The server advertises channels and sends what
was subscribed to; it has no capability by which a viewer could publish, set or call anything.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import struct
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.status import WS_1008_POLICY_VIOLATION
from starlette.websockets import WebSocket, WebSocketDisconnect

from m100link.apps.agent.background import SparingLogger, TokenBucket
from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.station.config import Settings, namespace_of
from m100link.apps.station.listeners import Fronts, beside
from m100link.apps.station.web.access_control import AccessControl
from m100link.apps.station.web.protocol import (
    WebSocketConnection,
    frames_of,
    serve_http,
    until_one_ends,
)
from m100link.errors.texts import read_json, without_nan
from m100link.log.channels import (
    FIX,
    MESSAGE,
    SCHEMAS,
    STATE,
    TELEMETRY,
    TRANSFORM,
    RateLimiter,
    fix_of,
)
from m100link.protocol.records import Attitude, Position
from m100link.telemetry.sample import Sample
from m100link.telemetry.subscription import Newest

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")  # the newest first

_MESSAGE_DATA = 1
_WAITING = 64  # messages of a subscription that wait for a slow viewer
_MAX_SUBSCRIPTIONS = 200
_OPERATIONS_PER_S, _OPERATIONS_AT_ONCE = 20.0, 100.0
_WARNING = 1
_MAX_NUMBER = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class FoxgloveChannel:
    number: int
    topic: str
    schema_name: str  # name of the schema
    schema: str  # JSON schema of its messages

    def advertised(self) -> dict[str, Any]:
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": "json",
            "schemaName": self.schema_name,
            "schema": self.schema,
            "schemaEncoding": "jsonschema",
        }


class Viewer:
    """The subscriptions of one viewer, and the messages that wait for it."""

    def __init__(
        self,
        channels: Iterable[FoxgloveChannel],  # what there is
        session_id: str,  # tells this run of the station from the one before
        on_output: Callable[[], None] = lambda: None,  # called when there is something to send
    ) -> None:
        self.dropped = 0  # messages that it did not get because it is slow
        self.close_reason: str | None = None  # set when it has to go
        self._channels = {one.number: one for one in channels}
        self._by_subscription: dict[int, int] = {}
        self._waiting: dict[int, deque[bytes]] = {}
        self._operations = TokenBucket(_OPERATIONS_PER_S, _OPERATIONS_AT_ONCE)
        self._on_output = on_output
        info = {
            "op": "serverInfo",
            "name": "m100link",
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": {},
            "sessionId": session_id,
        }
        topics = [one.advertised() for one in self._channels.values()]
        self._texts = deque((json.dumps(info), json.dumps({"op": "advertise", "channels": topics})))

    def wants(self, channel: int) -> bool:
        return channel in self._by_subscription.values()

    def receive(self, frame: str | bytes, now: float) -> None:
        """Take a message of the viewer. Never raises: the viewer gets a status for a fault."""
        if not self._operations.take(now):
            self.close_reason = "too many messages: this server is read-only"
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
                self._warn(f"{str(operation)[:40]} cannot be done here: this server is read-only")
        except (ValueError, LookupError, TypeError):
            self._warn("a message that was not understood")

    def _subscribe(self, number: object, channel: object) -> None:
        if not isinstance(number, int) or not 0 <= number <= _MAX_NUMBER:
            self._warn("a subscription has a number of 32 bits")
        elif not isinstance(channel, int) or channel not in self._channels:
            self._warn(f"there is no channel {str(channel)[:20]}")
        elif number in self._by_subscription:
            self._warn(f"subscription {number} exists already")
        elif len(self._by_subscription) >= _MAX_SUBSCRIPTIONS:
            self._warn("too many subscriptions")
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

        ``data``: JSON.
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
        """The next frames to send: texts first, then from each subscription in turn."""
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


# -- the messages about the aircraft ---------------------------------------------------------------

STATE_S = 0.5  # between two messages about the agent

_INTERVAL_S = 0.05  # between two messages of a topic that comes with telemetry
_LEVELS = {"info": 2, "warning": 3, "error": 4}
_TOPICS = (TELEMETRY, FIX, TRANSFORM, MESSAGE, STATE)

Publish = Callable[[int, int, bytes], None]


class Feed:
    """Makes messages of the agents' telemetry, as long as somebody wants them."""

    def __init__(
        self,
        # By the name of their aircraft; the topics of all but the first begin with it.
        agents: Mapping[str, AgentClient],
        utc_offset_s: float,  # what makes POSIX time of the event loop's
        is_wanted: Callable[[int], bool],  # whether anybody subscribed to a channel
        publish: Publish,  # takes the number of a channel, POSIX time in ns, and JSON
    ) -> None:
        self._utc_offset_s = utc_offset_s
        self._is_wanted, self._publish = is_wanted, publish
        self.channels: list[FoxgloveChannel] = []  # what there is
        self._numbers: dict[tuple[str, str], int] = {}
        self._thinning = {name: RateLimiter(_INTERVAL_S) for name in agents}
        for place, name in enumerate(agents):
            prefix = f"/{namespace_of(name)}" if place else ""
            for topic in _TOPICS:
                number = len(self.channels) + 1
                self._numbers[name, topic] = number
                self.channels.append(FoxgloveChannel(number, prefix + topic, *SCHEMAS[topic]))
        for name, agent in agents.items():
            agent.on_event.append(partial(self.hear_event, name))

    def hear(self, name: str, sample: Sample) -> None:
        """Send a telemetry package to the viewers; at most twenty a second."""
        at = sample.received_at
        thinned = self._thinning[name].hear(sample.value, sample.profile, at)
        if thinned is None:
            return
        if self._wants(name, TELEMETRY):
            self._tell(name, TELEMETRY, at, thinned.row)
        position = thinned.get(Position)
        if position is None or not position.is_possible:
            return
        if self._wants(name, FIX):
            self._tell(name, FIX, at, {"timestamp": self._stamp(at), **fix_of(position)})
        attitude = thinned.get(Attitude)
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
        said = {
            "timestamp": self._stamp(event.at),
            "level": _LEVELS[event.level],
            "message": event.text,
            "name": name,
            "file": "",
            "line": 0,
        }
        self._tell(name, MESSAGE, event.at, said)

    def hear_state(self, name: str, agent: AgentClient) -> None:
        if not self._wants(name, STATE):
            return
        view, state = agent.view, agent.state
        said = {
            "connection": view.connection,
            "firmware": state.firmware,
            "has_authority": view.has_authority,
            "task": state.task,
            "mission": state.mission,
            "round_trip_ms": None if state.round_trip is None else 1000.0 * state.round_trip,
            "holder": view.holder.name,
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
        data = json.dumps(without_nan(said), separators=(",", ":")).encode()
        self._publish(self._numbers[name, topic], self._nanoseconds(at), data)


# -- the server that Foxglove and Lichtblick connect to --------------------------------------------
# The server that Foxglove's own library brings takes pages of any origin: whatever site somebody
# visits could read the flight. This one stands on the station's gate, and has nothing to send to.

_MAX_VIEWERS = 8
_WRITE_SIZE = 64 * 1024
_WAITING_SAMPLES = 20


class FoxgloveServer:
    def __init__(self, agents: Mapping[str, AgentClient]) -> None:
        self._agents = agents
        self._viewers: dict[Viewer, None] = {}
        self._log = SparingLogger(logging.getLogger(__name__))
        offset = time.time() - asyncio.get_running_loop().time()
        self._session_id = f"{time.time_ns()}"
        self._feed = Feed(agents, offset, self._is_wanted, self._publish)

    def app(self, settings: Settings) -> AccessControl:
        routes = [WebSocketRoute("/{path:path}", self._serve), Route("/", self._greet)]
        return settings.gate(Starlette(routes=routes))

    def feeding(self) -> AbstractAsyncContextManager[None]:
        """While the block runs, viewers get the telemetry and states of the agents."""
        works: dict[str, Coroutine[Any, Any, None]] = {}
        for name, agent in self._agents.items():
            works[f"m100link station: telemetry of {name}"] = self._telemetry(name, agent)
            works[f"m100link station: state of {name}"] = self._states(name, agent)
        return beside(works)

    async def _telemetry(self, name: str, agent: AgentClient) -> None:
        async with agent.samples(Newest(_WAITING_SAMPLES)) as samples:
            async for sample in samples:
                if self._viewers:
                    self._feed.hear(name, sample)

    async def _states(self, name: str, agent: AgentClient) -> None:
        while True:
            await asyncio.sleep(STATE_S)
            self._feed.hear_state(name, agent)

    def _is_wanted(self, channel: int) -> bool:
        return any(viewer.wants(channel) for viewer in self._viewers)

    def _publish(self, channel: int, at_ns: int, data: bytes) -> None:
        for viewer in self._viewers:
            viewer.publish(channel, at_ns, data)

    async def _greet(self, request: Request) -> Response:
        text = "m100link station: Foxglove and Lichtblick connect to this port by WebSocket.\n"
        return PlainTextResponse(text)

    async def _serve(self, websocket: WebSocket) -> None:
        offered = websocket.scope.get("subprotocols", ())
        spoken = next((one for one in SUBPROTOCOLS if one in offered), None)
        if spoken is None or len(self._viewers) >= _MAX_VIEWERS:
            why = "speaks another protocol" if spoken is None else "finds too many others"
            self._log.warning("a viewer was refused: it %s", why)
            await websocket.close(WS_1008_POLICY_VIOLATION)
            return
        wake = asyncio.Event()
        viewer = Viewer(self._feed.channels, self._session_id, wake.set)
        self._viewers[viewer] = None
        try:
            await websocket.accept(subprotocol=spoken)
            await until_one_ends(
                self._read(websocket, viewer), self._write(websocket, viewer, wake)
            )
        except WebSocketDisconnect:
            pass
        finally:
            del self._viewers[viewer]
            self._log.info("a viewer has gone (%d messages dropped)", viewer.dropped)

    async def _read(self, websocket: WebSocket, viewer: Viewer) -> None:
        loop = asyncio.get_running_loop()
        async for frame in frames_of(websocket):
            viewer.receive(frame, loop.time())

    async def _write(self, websocket: WebSocket, viewer: Viewer, wake: asyncio.Event) -> None:
        # A viewer that does not read waits here alone: what it misses is dropped, and its pings
        # stay without an answer, for which the server cuts it off.
        connection: WebSocketConnection = websocket.scope["state"]["connection"]
        with contextlib.suppress(WebSocketDisconnect):
            while viewer.close_reason is None:
                wake.clear()
                frames = viewer.next_frames(_WRITE_SIZE)
                if not frames:
                    await wake.wait()
                    continue
                await connection.send_all(frames)
                await asyncio.sleep(0)
            await websocket.close(WS_1008_POLICY_VIOLATION, viewer.close_reason)


async def serve(fronts: Fronts) -> None:
    server = FoxgloveServer(await fronts.reached("foxglove"))
    await fronts.stack.enter_async_context(server.feeding())
    await serve_http(fronts, "foxglove", server.app(fronts.settings))
