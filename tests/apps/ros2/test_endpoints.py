"""Ends of a node: sessions that answer or do so no more, and types that are described."""

from __future__ import annotations

import hashlib
import json
import struct
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.bus.network import Inbox
from m100link.apps.ros2.endpoints import Endpoints, Heartbeat, Input, PublishedTopic
from m100link.apps.ros2.graph import NodeName, data_key
from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.log.cdr import full_name
from tests.apps.bus.memory import MemoryInbox
from tests.apps.ros2.conftest import Program, RecordingBus, Rig, judge

pytestmark = pytest.mark.anyio

STEP_S = 0.02


class Clock:
    def __init__(self, bus: RecordingBus, *sessions: str) -> None:
        self.now = 0.0
        self.heartbeat = Heartbeat(bus)
        self.heartbeat.follow(sessions)

    def until_missing(self, seconds: float) -> float | None:
        """After how long one is missing; None if none is."""
        ends = self.now + seconds
        began = self.now
        while self.now < ends:
            self.now += STEP_S
            if self.heartbeat.is_missing(self.now):
                return self.now - began
        return None


@pytest.fixture
def bus() -> RecordingBus:
    made = RecordingBus()
    made.answering = {"aa", "bb"}
    return made


def test_a_program_that_stops_answering_is_missing_within_two_seconds(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa", "bb")
    assert clock.until_missing(5.0) is None
    bus.answering.remove("bb")
    took = clock.until_missing(5.0)
    assert took is not None
    assert 1.0 <= took <= 1.54, "asked every half second, missed after a second and a half"
    assert bus.asked.count("aa") == pytest.approx(2 * clock.now, abs=2)


def test_a_caller_that_never_answers_is_left_to_its_lease(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa", "cc")
    assert clock.until_missing(10.0) is None
    assert "cc" in bus.asked


def test_one_answer_that_is_lost_is_not_missed(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    for _ in range(10):
        assert clock.until_missing(1.2) is None
        bus.answering = set()
        assert clock.until_missing(0.6) is None
        bus.answering = {"aa"}


def test_a_late_answer_is_one(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    assert clock.until_missing(2.0) is None
    waiting: list[tuple[float, MemoryInbox[bool]]] = []

    class Slow(RecordingBus):
        def probe(self, key: str, *, timeout: float) -> Inbox[bool]:
            waiting.append((clock.now, inbox := MemoryInbox[bool](1)))
            return inbox

    clock.heartbeat._bus = Slow()
    for _ in range(500):
        assert clock.until_missing(STEP_S) is None
        for at, inbox in waiting:
            if clock.now - at >= 0.9:
                inbox.waiting.append(True)
        waiting = [one for one in waiting if clock.now - one[0] < 0.9]


def test_those_of_before_are_not_asked_any_more(bus: RecordingBus) -> None:
    clock = Clock(bus, "aa")
    assert clock.until_missing(1.0) is None
    clock.heartbeat.follow(["bb"])
    bus.answering = {"bb"}
    bus.asked.clear()
    assert clock.until_missing(5.0) is None
    assert set(bus.asked) == {"bb"}


def test_what_a_stranger_calls_his_session_is_not_asked_unless_it_can_be_one(
    bus: RecordingBus,
) -> None:
    bad = ("**", "", "a/b", "A1", "g", "a" * 33, "a?b", "aa$*")
    clock = Clock(bus, *bad, *(f"{number:x}" for number in range(1000)))
    assert clock.until_missing(0.5) is None
    assert not set(bad) & set(bus.asked)
    assert len(set(bus.asked)) == 16


# -- attachments: what a message says of its sender, and an answer of its request ------------------


def test_a_message_says_its_number_and_when_it_left() -> None:
    """POSIX time in nanoseconds, little-endian, as rmw_zenoh has it."""
    sent: list[tuple[bytes, bytes]] = []
    put = lambda payload, attachment: sent.append((payload, attachment))  # noqa: E731
    outlet: Any = SimpleNamespace(put=put, is_wanted=lambda: False)
    topic = PublishedTopic(outlet, "std_msgs/Float32", "", lambda: 1_800_000_000.25)
    topic.put(b"one")
    topic.say({"data": -1.5})
    at_ns = pytest.approx(1_800_000_000_250_000_000, abs=500)  # of a double
    for number, (_, attachment) in enumerate(sent, start=1):
        assert struct.unpack("<QQB", attachment[:17]) == (number, at_ns, 16)
        # XXH3's 128 bits of nothing are 99aa06d3014798d8 6001c324468d497f: rmw_zenoh copies the
        # low half first, each as the processor has it.
        assert attachment[17:] == bytes.fromhex("7f498d4624c30160d8984701d306aa99")
    assert [payload for payload, _ in sent] == [
        b"one",
        b"\0\x01\0\0" + struct.pack("<f", -1.5),
    ]
    assert not topic.is_wanted


def question(key: str, sequence: int = 7, size: int = 16) -> Any:
    attachment = struct.pack("<QQB", sequence, 5, size) + bytes(range(size))
    return SimpleNamespace(
        key=key,
        attachment=attachment,
        payload=b"\0\x01\0\0\0",
        drop=Mock(),
        answer=Mock(),
    )


@pytest.mark.parametrize(
    ("ends", "is_deaf", "waiting", "is_answered"),
    [
        (None, False, 7, True),
        (None, False, 8, False),  # eight at once
        (None, True, 0, False),  # what came while it stood still is old
        (orders.Stop, True, 9, True),
        (orders.Land, True, 0, False),
        (orders.Land, False, 9, True),
    ],
)
async def test_a_request_is_answered_with_its_number_and_the_id_of_its_sender(
    ends: Any, is_deaf: bool, waiting: int, is_answered: bool
) -> None:
    inbox = MemoryInbox[Any](99)
    tokens: list[str] = []
    bus: Any = SimpleNamespace(
        questions=lambda *_: inbox, declare=tokens.append, publish=None, inbox=None
    )
    made = Endpoints(bus, NodeName(0, "aa", "/", "m100", 3), TaskSet(), lambda: 1.5)

    async def call(_request: Any) -> dict[str, Any]:
        return {"success": True, "message": "it flies"}

    made.serve("/m100/x", "std_srvs/srv/Trigger", call, ends=ends)
    assert [one.split("/")[3:6] for one in tokens] == [["3", "3", "NN"], ["3", "3001", "SS"]]
    made._services[0].calls = waiting
    key = data_key(0, "/m100/x", "std_srvs/srv/Trigger")
    good = question(key)
    inbox.waiting += [question("0/m100/*/x"), question(key, size=15), good]
    made.take_requests(is_deaf=is_deaf)
    await anyio.sleep(0.01)
    assert made.refused == (2 if is_answered else 3)
    why = "an attachment without an id of its sender" if is_answered else "too late, or too many"
    assert made.refusal == f"/m100/x: a request without an answer: {why}"
    assert good.drop.called is not is_answered
    if is_answered:
        [(where, _, attachment)] = [one.args for one in good.answer.mock_calls]
        assert where == key
        assert attachment == struct.pack("<QQB", 7, 1_500_000_000, 16) + bytes(range(16))
    assert made._services[0].calls == waiting


def test_what_cannot_be_read_is_counted_and_the_rest_is_taken() -> None:
    inbox, kind = MemoryInbox[Any](99), "std_msgs/Float32"
    head = struct.pack("<QQB", 3, 4, 16) + bytes(16)
    whole = b"\0\x01\0\0" + struct.pack("<f", 2.5)
    refused: list[str] = []
    one = Input(inbox, kind, refused.append)
    for payload, attachment in ((whole, head), (whole[:-1], head), (whole, head[:-1]), (b"", b"")):
        inbox.waiting.append(SimpleNamespace(payload=payload, attachment=attachment))
    [(found, message)] = one.take()
    assert (found.sequence, found.at_ns, message) == (3, 4, {"data": 2.5})
    assert refused == ["a message that cannot be read"] * 3


# -- types of the node by its service: rosbags makes the same hash of what is answered -------------

KIND = "type_description_interfaces/srv/GetTypeDescription"
NAME = "~/get_type_description"


async def described(program: Program, name: str, **more: Any) -> dict[str, Any]:
    asked = {"type_hash": "", "include_type_sources": False, **more}
    return await program.call(NAME, KIND, type_name=name, **asked)


def hash_of(description: dict[str, Any]) -> str:
    """As REP 2016 makes it of a description: without defaults."""
    types = [description["type_description"], *description["referenced_type_descriptions"]]
    for one in types:
        for field in one["fields"]:
            assert field.pop("default_value") == ""
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


async def test_each_message_of_the_table_is_described(rig: Rig, program: Program) -> None:
    typesys = judge()
    store = typesys.get_typestore(typesys.Stores.LATEST)
    kinds = {full_name(row.kind) for table in (OUTPUTS, INPUTS) for row in table.values()}
    for kind in sorted(kinds):
        answer = await described(program, kind)
        assert answer["successful"], answer
        if not kind.startswith("m100_msgs/"):
            assert hash_of(answer["type_description"]) == store.hash_rihs01(kind)


async def test_services_and_parts_of_actions_are_described(rig: Rig, program: Program) -> None:
    for kind in ("m100_msgs/action/FlyTo_SendGoal", KIND, *{s.kind for s in SERVICES.values()}):
        answer = await described(program, kind, include_type_sources=True)
        assert answer["type_description"]["type_description"]["type_name"] == kind
        encodings = {one["type_name"]: one["encoding"] for one in answer["type_sources"]}
        assert encodings[kind] == ("implicit" if "/action/" in kind else "srv")


async def test_sources_are_there_when_they_are_asked_for(rig: Rig, program: Program) -> None:
    name = "sensor_msgs/msg/Imu"
    assert (await described(program, name))["type_sources"] == []
    answer = await described(program, name, include_type_sources=True)
    texts = {one["type_name"]: one["raw_file_contents"] for one in answer["type_sources"]}
    assert "float64[9] orientation_covariance" in texts[name]
    made: dict[str, Any] = {}
    for kind, text in texts.items():
        made |= judge().get_types_from_msg(text, kind)
    assert set(made) == set(texts)


async def test_what_is_not_known_is_refused(rig: Rig, program: Program) -> None:
    for asked in (
        {"name": "sensor_msgs/msg/Image"},
        {"name": ""},
        {"name": "sensor_msgs/msg/Imu", "type_hash": "RIHS01_00"},
    ):
        answer = await described(program, **asked)
        assert not answer["successful"]
        assert answer["failure_reason"]
