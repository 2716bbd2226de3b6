"""How an aircraft is reached: what is passed on, and which log a connection leaves."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from m100link.apps.agent import connect
from m100link.apps.agent.connect import by_driver, by_url, envelope_of
from m100link.errors import LinkError, PortNotFound, UsageError
from m100link.protocol.firmware import FIRMWARE_2_3
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft

pytestmark = pytest.mark.anyio


class Logs:
    """A folder of logs that notes what becomes of each."""

    def __init__(self, log: Any = None) -> None:
        self.log, self.seen = log, list[str]()

    async def begin(self) -> Any:
        self.seen.append("begin")
        return self.log

    def keep(self, log: Any) -> None:
        assert log is self.log
        self.seen.append("keep")

    def drop(self, log: Any) -> None:
        assert log is self.log
        self.seen.append("drop")

    async def close(self) -> None:
        self.seen.append("close")


def test_an_envelope_has_its_height_and_its_radius_in_metres() -> None:
    envelope = envelope_of(50.0, 300.0)
    assert (envelope.max_height_m, envelope.max_radius_m) == (50.0, 300.0)


@pytest.mark.parametrize("is_recorded", [True, False])
@pytest.mark.parametrize("is_found", [True, False])
async def test_all_that_a_user_said_goes_to_the_connection_and_a_failed_one_leaves_no_log(
    monkeypatch: pytest.MonkeyPatch, is_recorded: bool, is_found: bool
) -> None:
    logs = Logs()
    logs.log = SimpleNamespace(aclose=logs.close) if is_recorded else None
    seen: dict[str, Any] = {}

    async def connected(url: str, **options: Any) -> str:
        seen.update(options, url=url)
        if not is_found:
            raise LinkError("no such port")
        return "aircraft"

    monkeypatch.setattr(connect, "connect", connected)
    opened = by_url(
        "serial:///dev/ttyUSB0",
        baud_rate=115200,
        firmware="2.3",
        timeout=7.0,
        flights=cast(Any, logs),
        acceleration="raw",
    )
    if is_found:
        assert await opened() == cast(Any, "aircraft")
    else:
        with pytest.raises(LinkError, match="no such port"):
            await opened()
    ended = ["keep"] if is_found else ["close", "drop"]
    assert logs.seen == ["begin", *(ended if is_recorded else [])]
    assert seen == {
        "url": "serial:///dev/ttyUSB0",
        "firmware": FIRMWARE_2_3,
        "baud_rate": 115200,
        "timeout": 7.0,
        "record": logs.log,
        "acceleration": "raw",
    }


async def test_what_a_user_did_not_say_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, Any] = {}

    async def connected(url: str, **options: Any) -> None:
        seen.update(options)

    monkeypatch.setattr(connect, "connect", connected)
    await by_url("tcp://host:1")()
    names = ("firmware", "baud_rate", "timeout", "record", "acceleration")
    assert seen == dict.fromkeys(names)


@pytest.mark.parametrize("wrong", [{"firmware": "9.9"}, {"acceleration": "half"}])
def test_what_there_is_not_is_said_before_anything_is_opened(wrong: dict[str, str]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong.values()))):
        by_url("tcp://host:1", **cast(Any, wrong))


async def test_a_virtual_aircraft_has_its_name_its_log_and_its_error(
    monkeypatch: pytest.MonkeyPatch, virtual_clock: None
) -> None:
    heard: list[Any] = []
    logs = Logs()
    logs.log = SimpleNamespace(
        aclose=logs.close, tap=lambda *what: heard.append(what), watch=lambda *_: None
    )
    virtual = VirtualAircraft(seed=5)
    driver = Driver(virtual)
    aircraft = await by_driver(driver, flights=cast(Any, logs))()
    try:
        assert aircraft.link.name == "sim://"
        assert heard, "the log hears the line from its first byte"
        assert logs.close in aircraft._at_end
        virtual.unplug()
        with pytest.raises(PortNotFound, match="plug it in again"):
            await by_driver(driver)()
    finally:
        await aircraft.aclose()
        driver.stop()
    assert logs.seen == ["begin", "keep", "close"]
    unrecorded = await by_driver(Driver(VirtualAircraft(seed=6)))()
    assert not unrecorded._at_end
    await unrecorded.aclose()
    await asyncio.sleep(0)
