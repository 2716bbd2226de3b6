"""A connection that is kept for fronts: what they hear, and when. Virtual time."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import pytest

import m100link
from m100link.aircraft import Aircraft
from m100link.apps.agent.messages import Journal
from m100link.apps.agent.server import connection as server_connection
from m100link.apps.agent.server.connection import (
    AircraftConnection,
    ConnectionState,
    by_driver,
    by_url,
    envelope_of,
)
from m100link.errors import LinkError, PortNotFound, UsageError
from m100link.protocol.firmware import FIRMWARE_2_3
from m100link.sim.ports.driver import Driver
from m100link.sim.virtual import VirtualAircraft
from m100link.telemetry.sample import Sample
from m100link.testing import ConnectableAircraft
from tests.waiting import until

pytestmark = pytest.mark.anyio


class Plug:
    """Where an aircraft is plugged in, and what callbacks get of it.

    Attributes:
        end: The aircraft, None for none.
        told: What callbacks got: the aircraft, or None.
        samples: Telemetry that came.
    """

    def __init__(self, end: ConnectableAircraft | None) -> None:
        self.end = end
        self.told: list[Aircraft | None] = []
        self.samples: list[Sample] = []
        self.opened: list[Aircraft] = []
        self.journal = Journal(asyncio.get_running_loop().time)
        self.connection = AircraftConnection(self.open, self.journal)
        self.connection.on_aircraft.append(self.told.append)
        self.connection.on_sample.append(self.samples.append)

    async def open(self) -> Aircraft:
        if self.end is None or not self.end.line.is_plugged:
            raise PortNotFound("nothing is plugged in")
        self.opened.append(await m100link.connect(await self.end.open_link()))
        return self.opened[-1]

    @property
    def texts(self) -> list[str]:
        return [event.text for event in self.journal.events]

    def is_in(self, state: ConnectionState) -> bool:
        return self.connection.state is state


@asynccontextmanager
async def kept(end: ConnectableAircraft | None) -> AsyncIterator[Plug]:
    plug = Plug(end)
    keeping = asyncio.create_task(plug.connection.keep())
    yield plug
    keeping.cancel()
    await asyncio.wait([keeping])
    assert keeping.cancelled()
    assert plug.connection.aircraft is None
    assert not any(one.is_connected for one in plug.opened)


def virtual(seed: int = 1) -> ConnectableAircraft:
    return ConnectableAircraft(seed=seed, firmware="3.1")


async def test_what_is_not_there_is_tried_every_second_and_reported_once() -> None:
    async with kept(None) as plug:
        await asyncio.sleep(10.5)
        assert plug.texts == ["not connected: nothing is plugged in"]
        assert plug.is_in(ConnectionState.CONNECTING)
        with pytest.raises(LinkError, match="is not connected: nothing is plugged in"):
            plug.connection.require_aircraft()
        plug.end = virtual()
        await until(lambda: plug.is_in(ConnectionState.CONNECTED), within=1.2)
        assert plug.told == [plug.connection.require_aircraft()]
        assert plug.connection.error is None
        assert plug.connection.version is not None


async def test_a_loss_is_reported_at_once_and_telemetry_goes_on_behind_it() -> None:
    end = virtual()
    async with kept(end) as plug:
        await until(lambda: len(plug.samples) > 10)
        first = plug.connection.require_aircraft()
        end.unplug()
        await until(lambda: plug.is_in(ConnectionState.LOST), within=0.1)
        assert plug.told == [first, None]
        assert plug.connection.aircraft is None
        assert plug.connection.round_trip is None
        assert "connection lost: " in plug.texts[-1]
        before = len(plug.samples)
        end.replug()
        await until(lambda: plug.is_in(ConnectionState.CONNECTED), within=1.5)
        assert plug.told[2] is plug.connection.require_aircraft() is not first
        await until(lambda: len(plug.samples) > before + 10, within=1.0)


async def test_an_aircraft_that_is_switched_off_behind_an_open_line_is_lost() -> None:
    end = virtual()
    async with kept(end) as plug:
        await until(lambda: plug.connection.round_trip is not None)
        assert plug.connection.round_trip is not None
        assert 0.0 <= plug.connection.round_trip < 0.1
        end.stall_line()
        await until(lambda: plug.is_in(ConnectionState.LOST), within=10.0)
        assert "silent for" in plug.texts[-1]
        end.stall_line(False)
        await until(lambda: plug.is_in(ConnectionState.CONNECTED))


async def test_another_aircraft_is_reported_and_then_taken() -> None:
    async with kept(virtual()) as plug:
        await until(lambda: plug.is_in(ConnectionState.CONNECTED))
        first = plug.connection.require_aircraft()
        plug.end = ConnectableAircraft(seed=2, firmware="3.1")
        await first.link.close()
        await until(lambda: any("answers where" in text for text in plug.texts))
        assert plug.connection.aircraft is None
        await until(lambda: plug.is_in(ConnectionState.CONNECTED), within=5.0)
        assert plug.told[-1] is plug.connection.require_aircraft() is not first


async def test_a_fault_of_a_callback_is_logged_and_costs_no_connection(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Without its line nobody could end the mission that an autopilot flies."""
    heard: list[Sample] = []

    def broken(_: object) -> None:
        raise ZeroDivisionError

    plug = Plug(virtual())
    plug.connection.on_sample[:] = [broken, heard.append]
    plug.connection.on_aircraft.insert(0, broken)
    keeping = asyncio.create_task(plug.connection.keep())
    await until(lambda: len(heard) > 20)
    assert plug.is_in(ConnectionState.CONNECTED)
    assert plug.told == [plug.connection.require_aircraft()]
    assert "telling of telemetry failed" in caplog.text
    assert "ZeroDivisionError" in caplog.text
    keeping.cancel()
    await asyncio.gather(keeping, return_exceptions=True)
    assert not any(one.is_connected for one in plug.opened)


async def test_a_log_that_raises_at_the_end_does_not_keep_the_connection() -> None:
    class Full(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            raise OSError("No space left on device")

    plug, handler, log = Plug(virtual()), Full(), logging.getLogger("m100link")
    keeping = asyncio.create_task(plug.connection.keep())
    await until(lambda: plug.is_in(ConnectionState.CONNECTED))
    log.addHandler(handler)
    try:
        keeping.cancel()
        done, _ = await asyncio.wait([keeping], timeout=10.0)
        assert done
        await asyncio.gather(keeping, return_exceptions=True)
    finally:
        log.removeHandler(handler)
    assert plug.connection.aircraft is None


# -- how an aircraft is reached, and which log a connection leaves ------------------------------


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

    monkeypatch.setattr(server_connection, "connect", connected)
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

    monkeypatch.setattr(server_connection, "connect", connected)
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
