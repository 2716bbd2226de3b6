"""Notifications of the aircraft reach their subscribers, whatever they look like."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from m100link import AuthorityLost
from m100link.link.requests import Requests
from m100link.protocol import (
    AuthorityChanged,
    FirmwareProfile,
    FromMobile,
    PushTelemetry,
    profile,
)
from m100link.protocol.command import Address
from m100link.protocol.commands.missions import Reached, WaypointEvent
from m100link.session import SessionMode
from m100link.sim import AircraftSettings, AssistantSettings, VirtualClockEventLoop
from m100link.telemetry.notifications import Notifications
from tests.link.peer import Peer, connected
from tests.rig import Rig, rig

pytestmark = pytest.mark.anyio

FIRMWARE = profile("1.0")


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


class Program:
    """The program's end of a line, and what it heard."""

    def __init__(self) -> None:
        self.losses: list[AuthorityChanged] = []
        self.messages: list[bytes] = []
        self.telemetry: list[bytes] = []
        self.times: list[float] = []

    async def connect(self) -> Peer:
        link, peer, _ = await connected()
        notifications = Notifications(link, Requests(link, FIRMWARE), self._on_telemetry)
        notifications.subscribe(AuthorityChanged, lambda lost, now: self.losses.append(lost))
        notifications.subscribe(FromMobile, self._on_message)
        return peer

    def _on_telemetry(self, value: bytes, firmware: FirmwareProfile, now: float) -> None:
        assert firmware is FIRMWARE
        self.telemetry.append(value)

    def _on_message(self, message: FromMobile, now: float) -> None:
        self.messages.append(message.data)
        self.times.append(now)


async def test_telemetry_waits_until_its_firmware_is_known() -> None:
    link, peer, _ = await connected()
    requests = Requests(link)
    values: list[bytes] = []
    Notifications(link, requests, lambda value, firmware, now: values.append(value))
    package = bytes(PushTelemetry.ADDRESS) + b"\0\0"
    peer.link.push(package)
    await asyncio.sleep(0.1)
    assert values == []
    requests.knows_layout = True
    peer.link.push(package)
    await asyncio.sleep(0.1)
    assert values == [b"\0\0"]


async def test_a_kind_that_is_known_by_its_address_is_read_when_it_comes() -> None:
    link, peer, _ = await connected()
    notifications = Notifications(link, Requests(link, FIRMWARE), lambda *_: None)
    told: list[Any] = []
    notifications.subscribe_at(Address(0x02, 0x04), lambda event, now: told.append(event))
    for index in (3, 4):
        peer.link.push(WaypointEvent(Reached(index)).encode(FIRMWARE))
    peer.link.push(b"\x02\x04\x02")
    await asyncio.sleep(0.1)
    assert told == [WaypointEvent(Reached(3)), WaypointEvent(Reached(4))]


async def test_each_kind_goes_to_its_own_handler() -> None:
    program = Program()
    peer = await program.connect()
    before = asyncio.get_running_loop().time()
    for data in (
        AuthorityChanged().encode(FIRMWARE),
        FromMobile(b"hello").encode(FIRMWARE),
        bytes(PushTelemetry.ADDRESS) + b"\0\0",
    ):
        peer.link.push(data)
    await asyncio.sleep(0.01)
    assert program.losses == [AuthorityChanged()]
    assert program.messages == [b"hello"]
    assert program.telemetry == [b"\x00\x00"]
    assert before <= program.times[0] <= asyncio.get_running_loop().time()


@pytest.mark.parametrize("data", [b"\x02\x01\x04", b"\x02\x02hello", b"\x02\x02" + bytes(101)])
async def test_what_wants_an_ack_gets_code_0_even_if_it_cannot_be_read(data: bytes) -> None:
    program = Program()
    peer = await program.connect()
    ack = await peer.link.request(data, mode=SessionMode.RELIABLE, timeout=1.0, tries=1)
    assert ack == b"\0\0"


@pytest.mark.parametrize("value", [b"", b"\x04\x00"])
async def test_a_loss_of_authority_that_cannot_be_read_is_a_loss(value: bytes) -> None:
    program = Program()
    peer = await program.connect()
    peer.link.push(b"\x02\x01" + value)
    await asyncio.sleep(0.01)
    assert program.losses == [AuthorityChanged()]


@pytest.mark.parametrize("data", [b"\x02", b"\x02\x02", b"\x02\x02" + bytes(101), b"\x09\x09\x01"])
async def test_what_cannot_be_read_and_says_nothing_is_passed_over(data: bytes) -> None:
    program = Program()
    peer = await program.connect()
    peer.link.push(data)
    peer.link.push(FromMobile(b"next").encode(FIRMWARE))
    await asyncio.sleep(0.01)
    assert program.messages == [b"next"]
    assert not program.losses


async def lose_control(flown: Rig) -> None:
    async with flown.aircraft.control():
        flown.virtual.leave_f()
        await asyncio.sleep(2.0)


async def test_a_loss_after_a_restart_of_the_aircraft_is_not_taken_for_an_old_one() -> None:
    """Restarted, it counts its notifications from 0 again: the number of the first was used."""
    silent_items = AssistantSettings(rates_hz={"rc": 0, "control_device": 0})
    settings = AircraftSettings(authority_push_session=2)
    async with rig(settings=settings, assistant=silent_items) as flown:
        for _ in range(2):
            with pytest.raises(AuthorityLost):
                await lose_control(flown)
            flown.virtual.reboot()
            flown.virtual.return_to_f()
            await asyncio.sleep(6.0)
            await flown.aircraft.activate(flown.virtual.credentials)
