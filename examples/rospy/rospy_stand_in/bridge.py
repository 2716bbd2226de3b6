"""One connection to rosbridge for a program with threads, and its topics beside the station's.

Callbacks of a topic run in a thread of the topic, one after the other, as in rospy. Of
messages that are published faster than the station takes them the newest of each topic is sent.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from m100link.apps.agent.background import TokenBucket
from m100link.apps.station.ros.graph import canonical_name
from m100link.apps.station.ros.messages import Message
from m100link.errors import LinkError, LinkLost
from rospy_stand_in.peers import Peers

ADDRESS = "ws://127.0.0.1:9090"
"""Where ``m100link serve`` listens by default."""

_RATE, _AT_ONCE = 120.0, 60.0  # frames per second; the station takes 200
_WAITING = 1000  # messages of one topic that wait for its callbacks; the oldest are dropped
_SAME_AGAIN_S = 5.0  # between two prints of the same status
_LONGEST = 4 * 1024 * 1024  # bytes of a message that the station may send
_ANSWER_S = 120.0  # within which an answer has to come; a landing takes a while

Callback = Callable[[Message], None]


class _Topic:
    """The callbacks of a topic, and the thread that runs them."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.callbacks: list[Callback] = []
        self._messages: deque[Message] = deque(maxlen=_WAITING)
        self._are_there = threading.Semaphore(0)
        threading.Thread(target=self._run, name=f"topic {name}", daemon=True).start()

    def put(self, message: Message) -> None:
        self._messages.append(message)
        self._are_there.release()

    def _run(self) -> None:
        while True:
            self._are_there.acquire()
            try:
                message = self._messages.popleft()
            except IndexError:  # dropped, because the callbacks are slow
                continue
            for callback in tuple(self.callbacks):
                callback(message)


def address_of(given: str) -> str:
    """The station's, if none is given."""
    return given or os.environ.get("M100LINK_ROSBRIDGE") or ADDRESS


class RosbridgeClient:
    """The way of a program to a station. Everything here may be called from any thread.

    Raises ``LinkError``: nobody listens at the address, or the station refuses the connection.
    """

    def __init__(
        self,
        address: str = "",  # ``ws://host:port``; M100LINK_ROSBRIDGE, or the default, if empty
        token: str = "",  # M100LINK_TOKEN if empty
        *,
        on_lost: Callable[[str], None] = lambda _: None,  # the connection has ended
        on_status: Callable[[str, str], None] = lambda *_: None,  # level and text for people
    ) -> None:
        self.address = address_of(address)
        self._on_lost, self._on_status = on_lost, on_status
        self._lock = threading.RLock()
        self._topics: dict[str, _Topic] = {}
        self._answers: dict[str, queue.Queue[dict[str, Any]]] = {}
        self._advertised: set[str] = set()
        self._kept: dict[str, Message] = {}  # by topic that is not the station's: the latched one
        self._pace = TokenBucket(_RATE, _AT_ONCE)
        self._pending: dict[str, str] = {}  # by topic: the newest that waits for its turn
        self._waits = threading.Condition(self._lock)
        self._said: dict[str, float] = {}
        self._number = 0
        self.lost = ""  # why the connection has ended; empty while it holds
        self._stack = contextlib.ExitStack()
        token = token or os.environ.get("M100LINK_TOKEN", "")
        self._socket = self._stack.enter_context(_connected(self.address, token))
        for work in (self._read, self._send_pending):
            threading.Thread(target=work, name=f"rosbridge {work.__name__}", daemon=True).start()
        self._send_in_turn({"op": "set_level", "level": "warning"})
        listed = self.call("/rosapi/topics", {})
        #: Topics of the station, and their types.
        self.topics: Mapping[str, str] = dict(zip(listed["topics"], listed["types"], strict=True))
        self.peers = Peers(self.address, self._put)

    def close(self) -> None:
        with self._lock:
            self.lost = self.lost or "the program has ended"
        self.peers.close()
        self._stack.close()

    # -- what comes in ---------------------------------------------------------------------------

    def _read(self) -> None:
        try:
            for frame in self._socket:
                self._take(json.loads(frame))
        except Exception as error:  # noqa: BLE001 - whatever it is, nothing is heard any more
            why = str(error) or type(error).__name__
        else:
            why = "the station has closed the connection"
        with self._lock:
            is_new, self.lost = not self.lost, self.lost or why
            for waiting in self._answers.values():
                waiting.put({"result": False, "values": f"the station has gone: {why}"})
            self._waits.notify_all()
        if is_new:
            self._on_lost(why)

    def _put(self, name: str, message: Message) -> None:
        topic = self._topics.get(name)
        if topic is not None:
            topic.put(message)

    def _take(self, message: dict[str, Any]) -> None:
        operation = message.get("op")
        if operation == "publish":
            self._put(canonical_name(message["topic"]), message["msg"])
        elif operation == "service_response":
            waiting = self._answers.get(str(message.get("id")))
            if waiting is not None:
                waiting.put(message)
        elif operation == "status":
            text, now = str(message.get("msg")), time.monotonic()
            if now - self._said.get(text, -_SAME_AGAIN_S) >= _SAME_AGAIN_S:
                self._said = {one: at for one, at in self._said.items() if now - at < _SAME_AGAIN_S}
                self._said[text] = now
                self._on_status(str(message.get("level")), text)

    # -- what goes out ---------------------------------------------------------------------------

    def _send(self, frame: str) -> None:
        """Raises ``LinkLost``: the connection has ended."""
        from websockets.exceptions import ConnectionClosed

        try:
            self._socket.send(frame)
        except (ConnectionClosed, OSError) as error:
            raise LinkLost(f"the station has gone: {self.lost or error}") from None

    def is_of_station(self, name: str) -> bool:
        return name in self.topics

    def subscribe(self, name: str, kind: str, callback: Callback) -> None:
        """Call ``callback`` with each message of a topic, in the thread of the topic."""
        with self._lock:
            topic = self._topics.get(name)
            is_new = topic is None
            topic = topic or self._topics.setdefault(name, _Topic(name))
            topic.callbacks.append(callback)
        if is_new and self.is_of_station(name):
            self._send_in_turn({"op": "subscribe", "topic": name, "type": kind})
        elif is_new:
            self.peers.hear(name)
        if name in self._kept:
            callback(self._kept[name])

    def unsubscribe(self, name: str, callback: Callback) -> None:
        with self._lock:
            topic = self._topics.get(name)
            if topic is None or callback not in topic.callbacks:
                return
            topic.callbacks.remove(callback)

    def listeners(self, name: str) -> int:
        """How many receive what is published on a topic: the station or others, and here."""
        topic = self._topics.get(name)
        others = 1 if self.is_of_station(name) else self.peers.listeners(name)
        return others + (len(topic.callbacks) if topic else 0)

    def advertise(self, name: str, kind: str) -> None:
        with self._lock:
            if name in self._advertised or not self.is_of_station(name):
                return
            self._advertised.add(name)
        self._send_in_turn({"op": "advertise", "topic": name, "type": kind})

    def publish(self, name: str, message: Message, *, latch: bool = False) -> None:
        """Publish now, or as soon as the station takes more; the newest of a topic counts.

        ``latch``: who subscribes later gets the newest, too, unless the topic is the station's.

        Raises ``LinkLost``: the station has gone.
        """
        if not self.is_of_station(name):
            if latch:
                self._kept[name] = message
            self._put(name, message)
            self.peers.publish(name, message, latch=latch)
            return
        frame = json.dumps({"op": "publish", "topic": name, "msg": message})
        with self._lock:
            if self._pending or not self._pace.take(time.monotonic()):
                self._pending.pop(name, None)
                self._pending[name] = frame
                self._waits.notify_all()
                return
        self._send(frame)

    def _send_pending(self) -> None:
        while True:
            with self._lock:
                while not self._pending and not self.lost:
                    self._waits.wait()
                if self.lost:
                    return
                may = self._pace.take(time.monotonic())
                frame = self._pending.pop(next(iter(self._pending))) if may else ""
            if not may:
                time.sleep(1.0 / _RATE)
                continue
            try:
                self._send(frame)
            except LinkLost:
                return

    def _send_in_turn(self, message: dict[str, Any]) -> None:
        while True:
            with self._lock:
                if self._pace.take(time.monotonic()):
                    break
            time.sleep(1.0 / _RATE)
        self._send(json.dumps(message))

    def call(self, service: str, request: Message, timeout: float = _ANSWER_S) -> Message:
        """Call a service of the station, and wait for its answer.

        Raises ``LinkError``: the station refuses, with its reason. Raises ``LinkLost``: it has
        gone, or does not answer.
        """
        with self._lock:
            self._number += 1
            identity = str(self._number)
            waiting = self._answers[identity] = queue.Queue()
        try:
            if self.lost:
                raise LinkLost(f"the station has gone: {self.lost}")
            asked = {"op": "call_service", "id": identity, "service": service, "args": request}
            self._send_in_turn(asked)
            answer = waiting.get(timeout=timeout)
        except queue.Empty:
            raise LinkLost(f"{service} was not answered within {timeout:g} s") from None
        finally:
            del self._answers[identity]
        if not answer["result"]:
            raise LinkError(str(answer["values"]))
        values: Message = answer["values"]
        return values


@contextlib.contextmanager
def _connected(address: str, token: str) -> Iterator[Any]:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    headers = {"Authorization": f"Bearer {token}"} if token else None
    with contextlib.ExitStack() as stack:
        try:
            socket = stack.enter_context(
                connect(
                    address,
                    additional_headers=headers,
                    compression=None,
                    proxy=None,
                    max_size=_LONGEST,
                )
            )
        except InvalidStatus as error:
            raise LinkError(
                f"the station at {address} refuses: HTTP {error.response.status_code}",
                cause="it wants a token, or does not know itself by that name",
                remedy="set M100LINK_TOKEN; serve --allow-host names the host",
            ) from None
        except (OSError, TimeoutError, ValueError) as error:
            raise LinkError(
                f"no station answers at {address}: {error}",
                cause="`m100link serve` is not running, or listens elsewhere",
                remedy="start it: m100link serve --sim; or name its address with --station",
            ) from None
        yield socket


def report(level: str, text: str) -> None:
    """A status for the person at the terminal."""
    sys.stderr.write(f"[{level.upper()}] station: {text}\n")
