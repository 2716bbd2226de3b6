"""A session of ROS 2: what its environment may say, and the errors where that cannot be."""

from __future__ import annotations

import json
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from m100link.apps.ros2.node import open_ros2
from m100link.errors import UsageError
from tests.apps.bus.pair import free_place, until

pytest.importorskip("zenoh", reason="the extra ros2 is not installed")

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_two_meet_by_what_their_environment_says() -> None:
    place = json.dumps([free_place()])
    async with AsyncExitStack() as stack:
        one = await stack.enter_async_context(
            open_ros2({"ZENOH_CONFIG_OVERRIDE": f"listen/endpoints={place};connect/endpoints=[]"})
        )
        other = await stack.enter_async_context(
            open_ros2({"ZENOH_CONFIG_OVERRIDE": f"connect/endpoints={place};"})
        )
        assert one.session != other.session
        outlet, inbox = one.publish("0/a", kept=1), other.inbox("0/a", 8)
        seen: list[int] = []

        def arrives() -> bool:
            for size in (32768, 32769):
                outlet.put(bytes(size), b"")
            seen.extend(len(one.payload) for one in inbox.take())
            return len(set(seen)) == 2

        await until(arrives)
        assert set(seen) == {32768, 0}


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ZENOH_SESSION_CONFIG_URI", "/nowhere/session.json5"),
        ("ZENOH_CONFIG_OVERRIDE", "mode"),
        ("ZENOH_CONFIG_OVERRIDE", 'mode="nonsense"'),
        ("ZENOH_CONFIG_OVERRIDE", "connect/endpoints=[7]"),
        ("ZENOH_CONFIG_OVERRIDE", 'listen/endpoints=["tcp/127.0.0.1:1:2"]'),
    ],
)
async def test_a_configuration_that_cannot_be_is_reported(variable: str, value: str) -> None:
    with pytest.raises(UsageError) as refusal:
        async with open_ros2({variable: value}):
            pass
    assert variable in str(refusal.value) or value.partition("=")[0] in str(refusal.value)


async def test_a_file_is_taken_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "session.json5"
    path.write_text('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:1"], timeout_ms: 100}}')
    with pytest.raises(UsageError, match="no router") as caught:  # as a client it needs one at once
        async with open_ros2({"ZENOH_SESSION_CONFIG_URI": str(path)}):
            pass
    assert "ZENOH_SESSION_CONFIG_URI" in caught.value.remedy
