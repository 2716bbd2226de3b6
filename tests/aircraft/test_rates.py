"""Telemetry rates: what is asked for is sent, seen, or reported."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator

import pytest

from m100link import AircraftState, CommandNotSupported, CommandRefused, NotObserved, UsageError
from m100link.protocol.codes import RatesCode
from m100link.protocol.commands.activation import SetTelemetryRates
from m100link.protocol.items import ITEMS
from m100link.sim import LineFaults, VirtualClockEventLoop
from m100link.sim.commands import CommandTable
from m100link.telemetry.columns import ITEM_NAMES
from tests.rig import Rig, rig

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


@pytest.fixture
async def flown() -> AsyncIterator[Rig]:
    async with rig(firmware="3.1", activated=False) as made:  # DJI's start-up does it
        yield made


def asked(flown: Rig) -> list[SetTelemetryRates]:
    received = flown.virtual.autopilot.received_commands
    return [one.command for one in received if isinstance(one.command, SetTelemetryRates)]


def test_every_item_may_be_named_as_in_the_state_and_as_on_the_wire() -> None:
    views = [name for name in ITEM_NAMES if hasattr(AircraftState, name)]
    assert sorted(ITEM_NAMES[name].bit for name in views) == [item.bit for item in ITEMS]
    assert {item.name for item in ITEMS} <= set(ITEM_NAMES)


@pytest.mark.parametrize(
    ("rate", "seconds"), [(0, 1.5), (1, 3.5), (10, 1.5), (50, 1.5), (100, 1.5)]
)
async def test_the_observed_rate_is_what_was_asked_for(
    flown: Rig, rate: int, seconds: float
) -> None:
    began_at = flown.now
    observed = await flown.aircraft.set_telemetry_rates(attitude=rate)
    assert observed == {"attitude": pytest.approx(rate, rel=0.02, abs=0.35)}
    assert flown.now - began_at == pytest.approx(seconds, abs=0.1)
    assert asked(flown) == [SetTelemetryRates({"quaternion": rate})]
    assert flown.virtual.autopilot.rates_hz["velocity"] == 100, "not named, so kept"


async def test_an_item_that_was_never_sent_arrives(flown: Rig) -> None:
    assert flown.aircraft.state.control_device is None
    observed = await flown.aircraft.set_telemetry_rates(control_device=10, rc=0, battery=1)
    assert set(observed) == {"control_device", "rc", "battery"}
    assert flown.aircraft.state.control_device is not None


async def test_when_it_does_not_happen_it_is_reported(
    flown: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Too many packages, and too few, of a line that carries no more or of another program."""
    monkeypatch.setattr(flown.virtual.autopilot, "set_rates", lambda rates: None)
    with pytest.raises(NotObserved, match=r"gimbal arrives at (49|5\d)\.\d Hz instead of 100\n"):
        await flown.aircraft.set_telemetry_rates(gimbal=100)
    with pytest.raises(
        NotObserved, match=r"accepted, but attitude arrives at \d+\.\d Hz instead of 10, .*gimbal"
    ) as raised:
        await flown.aircraft.set_telemetry_rates(attitude=10, gimbal=0, velocity=100)
    assert raised.value.situation["observed_hz"] == {
        "attitude": pytest.approx(100, abs=2),
        "gimbal": pytest.approx(50, abs=2),
        "velocity": pytest.approx(100, abs=2),
    }


async def test_a_lossy_line_sends_at_that_rate_all_the_same() -> None:
    async with rig(firmware="3.1", activated=False, faults=LineFaults(loss=0.1)) as flown:
        observed = await flown.aircraft.set_telemetry_rates(attitude=50, position=10)
        assert observed["attitude"] == pytest.approx(45, abs=5)


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        ({}, "no rate was given"),
        ({"attitude": 20}, "attitude cannot be sent at 20 Hz.*0, 1, 10, 50, 100 Hz"),
        ({"attitude": 200}, "200 Hz"),
        ({"attitude": -1}, "-1 Hz"),
        ({"attitude": math.nan}, "nan Hz"),
        ({"attitude": True}, "True Hz"),
        ({"altitude": 10}, "no telemetry item is called 'altitude'.*attitude"),
        ({"attitude": 10, "quaternion": 50}, "two rates were given for one item"),
    ],
)
async def test_what_cannot_be_asked_is_not_sent(
    flown: Rig, rates: dict[str, int], words: str
) -> None:
    with pytest.raises(UsageError, match=f"(?s){words}"):
        await flown.aircraft.set_telemetry_rates(**rates)
    assert asked(flown) == []


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_k1_older_firmware_is_not_asked(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(CommandNotSupported, match="nothing was sent"):
            await flown.aircraft.set_telemetry_rates(attitude=10)
        await asyncio.sleep(0.1)
        assert not [
            one for one in flown.virtual.autopilot.received_commands if one.address == (0x00, 0x10)
        ]


async def test_a_refusal_keeps_its_code(flown: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CommandTable, "_rates", lambda *_: RatesCode.INVALID_PARAMETERS)
    flown.virtual.autopilot._commands = CommandTable(flown.virtual.autopilot)
    with pytest.raises(CommandRefused, match="nothing has changed") as raised:
        await flown.aircraft.set_telemetry_rates(attitude=10)
    assert raised.value.code == 1
