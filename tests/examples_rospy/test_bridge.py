"""The connection of a program with threads: what it sends, waits for, and how it ends."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

pytest.importorskip("websockets")
from rospy_stand_in.bridge import RosbridgeClient, report
from websockets.sync.server import ServerConnection, serve

from m100link.errors import LinkError, LinkLost
from tests.waiting import PATIENCE, again_and_again

Answer = Callable[[ServerConnection, dict[str, Any]], None]
TOPICS = {"topics": ["/joy", "/status"], "types": ["sensor_msgs/Joy", "std_msgs/UInt8"]}


class Played:
    """A station that answers as a test says, and keeps what it heard."""

    def __init__(self, answer: Answer) -> None:
        self.heard: list[dict[str, Any]] = []
        self.headers: list[str] = []
        self.level = ""  # of statuses that the client wants
        self._answer = answer

    def __call__(self, socket: ServerConnection) -> None:
        assert socket.request is not None
        self.headers.append(socket.request.headers.get("Authorization", ""))
        for frame in socket:
            message = json.loads(frame)
            if message.get("service") == "/rosapi/topics":
                respond(socket, message, TOPICS)
            elif message["op"] == "set_level":
                self.level = message["level"]
            else:
                self.heard.append(message)
                self._answer(socket, message)

    def of(self, operation: str) -> list[dict[str, Any]]:
        return [one for one in list(self.heard) if one["op"] == operation]


def respond(socket: ServerConnection, asked: dict[str, Any], values: Any, ok: bool = True) -> None:
    answer = {"op": "service_response", "id": asked["id"], "result": ok, "values": values}
    socket.send(json.dumps(answer))


@contextmanager
def station(answer: Answer = lambda *_: None) -> Iterator[tuple[Played, str]]:
    played = Played(answer)
    with serve(played, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield played, f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join(PATIENCE)


def until(predicate: Callable[[], bool]) -> None:
    pause = threading.Event()
    for _ in again_and_again():
        if predicate():
            return
        pause.wait(0.005)
    raise AssertionError("it does not happen")


def test_without_a_station_the_error_says_how_to_start_one() -> None:
    with pytest.raises(LinkError, match="serve --sim"):
        RosbridgeClient("ws://127.0.0.1:9")


def test_a_token_is_shown_and_topics_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    with station() as (played, address):
        monkeypatch.setenv("M100LINK_ROSBRIDGE", address)
        bridge = RosbridgeClient(token="0123456789abcdef")
        assert played.headers == ["Bearer 0123456789abcdef"]
        assert bridge.topics["/joy"] == "sensor_msgs/Joy"
        bridge.close()


def test_a_topic_is_subscribed_once_with_its_type_and_heard_by_all() -> None:
    def answer(socket: ServerConnection, message: dict[str, Any]) -> None:
        socket.send(json.dumps({"op": "publish", "topic": "/status", "msg": {"data": 3}}))

    with station(answer) as (played, address):
        bridge = RosbridgeClient(address)
        first, second = [], []  # type: ignore[var-annotated]
        bridge.subscribe("/status", "std_msgs/UInt8", first.append)
        until(lambda: first == [{"data": 3}])
        bridge.subscribe("/status", "std_msgs/UInt8", second.append)
        bridge.advertise("/joy", "sensor_msgs/Joy")
        until(lambda: second == [{"data": 3}])
        assert played.of("subscribe") == [
            {"op": "subscribe", "topic": "/status", "type": "std_msgs/UInt8"}
        ]
        bridge.unsubscribe("/status", first.append)
        assert bridge.listeners("/status") == 2
        bridge.close()


def test_topics_of_the_program_never_reach_the_station() -> None:
    with station() as (played, address):
        bridge = RosbridgeClient(address)
        heard: list[Any] = []
        bridge.advertise("/own", "std_msgs/String")
        bridge.publish("/own", {"data": "nobody listens"})
        bridge.subscribe("/own", "std_msgs/String", heard.append)
        bridge.publish("/own", {"data": "a"})
        until(lambda: heard == [{"data": "a"}])
        assert (played.heard, played.level) == ([], "warning")
        bridge.close()


def test_of_what_comes_too_fast_the_newest_counts() -> None:
    """The station takes 200 frames a second; setpoints are not to grow old in a queue."""
    with station() as (played, address):
        bridge = RosbridgeClient(address)
        for number in range(2000):
            bridge.publish("/joy", {"axes": [number]})
        until(lambda: [one["msg"] for one in played.of("publish")][-1:] == [{"axes": [1999]}])
        sent = [one["msg"]["axes"][0] for one in played.of("publish")]
        assert sent == sorted(sent)
        assert len(sent) < 1000
        bridge.close()


def test_answers_belong_to_their_calls_and_refusals_say_why() -> None:
    waiting: list[dict[str, Any]] = []

    def answer(socket: ServerConnection, message: dict[str, Any]) -> None:
        waiting.append(message)
        if len(waiting) == 2:  # the other way round
            for one in reversed(waiting):
                respond(socket, one, {"said": one["service"]})
        elif len(waiting) > 2:
            respond(socket, message, "no control", ok=False)

    with station(answer) as (_, address):
        bridge = RosbridgeClient(address)
        found: dict[str, Any] = {}
        threads = [
            threading.Thread(target=lambda n=name: found.update({n: bridge.call(n, {})}))
            for name in ("/a", "/b")
        ]
        for one in threads:
            one.start()
        for one in threads:
            one.join(PATIENCE)
        assert found == {"/a": {"said": "/a"}, "/b": {"said": "/b"}}
        with pytest.raises(LinkError, match="no control"):
            bridge.call("/c", {})
        bridge.close()


def test_a_call_that_nobody_answers_ends() -> None:
    with station() as (_, address):
        bridge = RosbridgeClient(address)
        with pytest.raises(LinkLost, match="not answered"):
            bridge.call("/a", {}, timeout=0.05)
        bridge.close()


def test_when_the_station_goes_everybody_who_waits_hears_of_it() -> None:
    lost: list[str] = []
    with station(lambda socket, _: socket.close()) as (_, address):
        bridge = RosbridgeClient(address, on_lost=lost.append)
        with pytest.raises(LinkError, match="has gone"):
            bridge.call("/a", {})
        until(lambda: len(lost) == 1)
        with pytest.raises(LinkLost):
            bridge.publish("/joy", {"axes": []})
        with pytest.raises(LinkLost):
            bridge.call("/a", {})
        assert len(lost) == 1


def test_a_status_is_told_once_in_a_while(capsys: pytest.CaptureFixture[str]) -> None:
    told: list[tuple[str, str]] = []

    def answer(socket: ServerConnection, message: dict[str, Any]) -> None:
        for text in ("a", "b", "a"):
            socket.send(json.dumps({"op": "status", "level": "error", "msg": text}))
        respond(socket, message, {})

    with station(answer) as (_, address):
        bridge = RosbridgeClient(address, on_status=lambda *said: told.append(said))
        bridge.call("/a", {})
        assert told == [("error", "a"), ("error", "b")]
        bridge.close()
    report("error", "why")
    assert capsys.readouterr().err == "[ERROR] station: why\n"
