"""The start of QGroundControl, replayed: its requests in its order, with its time-outs and retries.

From its source: InitialConnectStateMachine, StandardModes, ComponentInformationManager,
ParameterManager, PlanManager, and what versions 4 and 5 ask for beside it. A request that gets no
answer in time is sent again, as often as there.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from random import Random
from typing import Any
from zlib import crc32

import anyio
import pytest

from m100link.apps.mavlink.translator.codec import LAYOUTS, MavlinkMessage
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult
from m100link.apps.mavlink.translator.parameters import PARAMETERS
from tests.apps.mavlink.conftest import Ground, Rig
from tests.apps.mavlink.test_files import ACK, OPEN, READ, TERMINATE, Client
from tests.apps.mavlink.translator.test_missions import SQUARE, Exchange
from tests.apps.mavlink.translator.test_parameters import INTEGERS, SETUP

pytestmark = pytest.mark.anyio

ACK_S, MESSAGE_S, MOST_TRIES = 3.0, 0.5, 3  # of a command; of the message behind it
HASH_S, LIST_S, LISTS, INDEX_S, INDEXES, BATCH = 1.0, 5.0, 5, 1.0, 5, 10
PLAN_S, ITEM_S, PLAN_TRIES = 1.5, 0.25, 5
PROTOCOL_VERSION = 300
CAMERA_INFORMATION, GIMBAL_MANAGER_INFORMATION = 259, 280
FENCE, RALLY = 0x4000, 0x8000  # MAV_PROTOCOL_CAPABILITY: plans that it downloads
INT32, REAL32 = 6, 9


class Start:
    """QGroundControl's half, over a line that loses datagrams."""

    def __init__(self, ground: Ground, *, loss: float = 0.0, seed: int = 0) -> None:
        self.ground, self.loss, self.random = ground, loss, Random(seed)
        self.read = len(ground.heard)
        self.unanswered: list[str] = []
        self.repeats = 0  # requests that were sent again

    def fresh(self) -> Iterator[MavlinkMessage]:
        heard, self.read = self.ground.heard[self.read :], len(self.ground.heard)
        return (one for one in heard if self.random.random() >= self.loss)

    def send(self, name: str, **fields: Any) -> None:
        if self.random.random() >= self.loss:
            self.ground.send(name, target_system=1, **fields)

    async def ask(
        self,
        what: str,
        send: Callable[[], None],
        is_answer: Callable[[MavlinkMessage], bool],
        patience: float,
        tries: int,
    ) -> MavlinkMessage | None:
        """What is answered to a request; None after so many tries of so many seconds."""
        for count in range(tries):
            self.repeats += count > 0
            send()
            for _ in range(round(patience / 0.05)):
                await anyio.sleep(0.05)
                if found := [one for one in self.fresh() if is_answer(one)]:
                    return found[0]
        self.unanswered.append(what)
        return None

    async def message(self, number: int, parameter: float = 0.0) -> list[MavlinkMessage]:
        """REQUEST_MESSAGE: the messages of that number around its answer; none if refused."""
        heard: list[MavlinkMessage] = []
        name = next((one for one, row in LAYOUTS.items() if row.number == number), "")

        def is_answer(one: MavlinkMessage) -> bool:
            heard.extend([one] if one.name == name else [])
            return one.name == "COMMAND_ACK" and one["command"] == MavCommand.REQUEST_MESSAGE

        def send() -> None:
            if self.random.random() >= self.loss:
                self.ground.command(MavCommand.REQUEST_MESSAGE, number, parameter)

        told = await self.ask(f"message {number}", send, is_answer, ACK_S, MOST_TRIES)
        if told is None or told["result"] != MavResult.ACCEPTED:
            assert told is None or told["result"] == MavResult.UNSUPPORTED
            return []
        for _ in range(round(MESSAGE_S / 0.05)):
            heard += [one for one in self.fresh() if one.name == name]
            await anyio.sleep(0.05)
        return heard

    async def whole(self, number: int, is_whole: Callable[[list[MavlinkMessage]], bool]) -> Any:
        """The same, again until it is there, as its states do after their time-outs."""
        for count in range(MOST_TRIES):
            self.repeats += count > 0
            if is_whole(heard := await self.message(number)):
                return heard
        raise AssertionError(f"message {number} is not whole after {MOST_TRIES} tries")

    async def parameters(self) -> dict[str, float]:
        """Each as _HASH_CHECK, the list, and single ones that were lost bring it."""
        found: dict[int, tuple[str, float]] = {}
        counts: set[int] = set()

        def take(one: MavlinkMessage) -> bool:
            if one.name == "PARAM_VALUE":
                value = one["param_value"]
                if one["param_type"] == INT32:
                    (value,) = struct.unpack("<i", struct.pack("<f", value))
                assert one["param_type"] == (INT32 if one["param_id"] in INTEGERS else REAL32)
                found[one["param_index"]] = one["param_id"], value
                counts.add(one["param_count"])
            return one.name == "PARAM_VALUE"

        def hash_check() -> None:
            self.send("PARAM_REQUEST_READ", param_id="_HASH_CHECK", param_index=-1)

        def is_refusal(one: MavlinkMessage) -> bool:
            return take(one) or one.name == "PARAM_ERROR"

        await self.ask("_HASH_CHECK", hash_check, is_refusal, HASH_S, 1)
        if self.loss:
            self.unanswered.clear()  # it goes on without
        await self.ask("PARAM_REQUEST_LIST", self._list, take, LIST_S, LISTS)
        await anyio.sleep(INDEX_S)
        list(map(take, self.fresh()))
        [count] = counts
        for _ in range(INDEXES * count):
            lost = [index for index in range(count) if index not in found][:BATCH]
            self.repeats += len(lost)
            if not lost:
                break
            for index in lost:
                self.send("PARAM_REQUEST_READ", param_id="", param_index=index)
            await anyio.sleep(INDEX_S)
            list(map(take, self.fresh()))
        return dict(found.values())

    def _list(self) -> None:
        self.send("PARAM_REQUEST_LIST")

    async def plan(self, kind: int) -> list[MavlinkMessage]:
        """PlanManager: the count, each item, and the thanks."""

        def send_list() -> None:
            self.send("MISSION_REQUEST_LIST", mission_type=kind)

        def is_count(one: MavlinkMessage) -> bool:
            return one.name == "MISSION_COUNT" and one["mission_type"] == kind

        told = await self.ask(f"plan {kind}", send_list, is_count, PLAN_S, PLAN_TRIES)
        assert told is not None
        items = []
        for number in range(told["count"]):

            def send_item(number: int = number) -> None:
                self.send("MISSION_REQUEST_INT", seq=number, mission_type=kind)

            def is_item(one: MavlinkMessage, number: int = number) -> bool:
                return one.name == "MISSION_ITEM_INT" and one["seq"] == number

            what = f"item {number} of plan {kind}"
            items.append(await self.ask(what, send_item, is_item, ITEM_S, PLAN_TRIES * 4))
        self.send("MISSION_ACK", type=0, mission_type=kind)
        return [one for one in items if one is not None]


async def fetched(rig: Rig, uri: str, crc: int) -> Any:
    """A JSON file of version 1 by MAVLink FTP."""
    assert uri.startswith("mftp:///")
    ftp = Client(rig, rig.ground)
    answer, size, session = await ftp.ask(OPEN, uri.removeprefix("mftp://").encode())
    assert answer == ACK
    data = b""
    while len(data) < int.from_bytes(size, "little"):
        answer, piece, _ = await ftp.ask(READ, session=session, at=len(data), size=239)
        assert answer == ACK
        data += piece
    assert (await ftp.ask(TERMINATE, session=session))[0] == ACK
    assert crc32(data) == crc
    document = json.loads(data)
    assert document["version"] == 1, "it reads no other"
    return document


async def parameter_metadata(rig: Rig, metadata: MavlinkMessage) -> dict[str, Any]:
    """What COMPONENT_METADATA leads to, by the name of the parameter."""
    general = await fetched(rig, metadata["uri"], metadata["file_crc"])
    [kind] = general["metadataTypes"]
    assert kind["type"] == 1
    document = await fetched(rig, kind["uri"], kind["fileCrc"])
    return {one["name"]: one for one in document["parameters"]}


@pytest.mark.parametrize(("loss", "seed"), [(0.0, 0), (0.1, 1), (0.1, 2), (0.1, 3)])
async def test_its_start_finds_a_whole_vehicle(
    rig: Rig, ground: Ground, loss: float, seed: int
) -> None:
    assert await Exchange(ground).upload(SQUARE) == 0
    start = Start(ground, loss=loss, seed=seed)
    begun = rig.client.now

    [version, *_] = await start.whole(LAYOUTS["AUTOPILOT_VERSION"].number, bool)
    release = version["flight_sw_version"]
    assert release >= 0x01040100, "it warns of a PX4 before 1.4.1"
    assert release & 0xFF != 255, "it warns of an official one that is not the newest"
    assert await start.message(PROTOCOL_VERSION) == []  # asked for up to version 4.4

    def is_last_there(modes: list[MavlinkMessage]) -> bool:
        return any(one["mode_index"] == one["number_modes"] for one in modes)

    modes = await start.whole(LAYOUTS["AVAILABLE_MODES"].number, is_last_there)
    assert loss or [one["mode_index"] for one in modes] == [*range(1, len(modes) + 1)]
    assert ground.last("HEARTBEAT")["custom_mode"] in {one["custom_mode"] for one in modes} or loss
    [metadata, *_] = await start.whole(LAYOUTS["COMPONENT_METADATA"].number, bool)
    described = {} if loss else await parameter_metadata(rig, metadata)
    start.read = len(ground.heard)

    found = await start.parameters()
    assert found.keys() == PARAMETERS.keys()
    for name, is_set_up in SETUP.items():
        assert is_set_up(found[name]), name
    for name, one in described.items():
        assert one["type"] == ("Int32" if name in INTEGERS else "Float")
        assert one.get("readOnly", False) is not PARAMETERS[name].is_settable
        assert one.get("default", found[name]) == found[name]
        assert one["shortDesc"] == PARAMETERS[name].meaning
    assert loss or described.keys() == found.keys()
    for _ in range(2):
        start.send("SYSTEM_TIME", time_unix_usec=1_700_000_000_000_000)  # has no answer
    items = await start.plan(0)
    assert [one["command"] for one in items] == [one["command"] for one in SQUARE]
    for kind, capability in ((1, FENCE), (2, RALLY)):
        if version["capabilities"] & capability:
            assert await start.plan(kind) == []
    for number in (CAMERA_INFORMATION, GIMBAL_MANAGER_INFORMATION):
        await start.message(number)

    # Three tries of a message may all be lost; what it needs is whole in any case.
    assert not [one for one in start.unanswered if not loss or "message" not in one]
    assert bool(start.repeats) is bool(loss)
    assert rig.client.now - begun < (10.0 if not loss else 90.0)
    severe = [one for one in ground.all("STATUSTEXT") if one["severity"] <= 4]
    assert [one["text"] for one in severe] == [], "a warning that nobody caused"
