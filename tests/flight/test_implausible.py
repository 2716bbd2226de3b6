"""Each way in which telemetry may lie, against what flies by it: ended typed, soon, and near.

The acceptance: within 1.5 s and 10 m of the fault. A relay on the line alters, repeats or delays
the bytes; the virtual aircraft's own place is the truth that is judged.
"""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

from m100link import Control, Guards, Setpoint, connect
from m100link.errors import M100Error, NavigationLost, SetpointsIgnored, TelemetryStalled
from m100link.flight.block import ControlBlock
from m100link.flight.lifecycle import StopCause
from m100link.link import Link
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.packet import _plan
from m100link.protocol.records import Position, Velocity
from m100link.sim import LineFaults
from m100link.sim.line import is_telemetry, split_frames
from m100link.testing import ConnectableAircraft
from m100link.wire.frame import encode_frame
from tests.rig import Rig

pytestmark = pytest.mark.anyio

WITHIN_S, WITHIN_M = 1.5, 10.0
NORTH = Setpoint.velocity(north=5.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)

Change = Callable[["Package"], None]


class Package:
    """A telemetry value whose fields can be set."""

    def __init__(self, value: bytes, profile: FirmwareProfile) -> None:
        self.value = bytearray(value)
        self.profile = profile
        self.flags = value[0] | value[1] << 8

    def span(self, record: type[Any], field: str) -> slice | None:
        span = _plan(self.flags & self.profile.item_flags, self.profile).span(record, field)
        return span if span.stop else None

    def set(self, record: type[Any], **fields: float) -> None:
        for field, number in fields.items():
            span = self.span(record, field)
            if span is not None:
                code = {8: "<d", 4: "<f"}[span.stop - span.start]
                self.value[span] = struct.pack(code, number)


class Relay(asyncio.Protocol):
    """Hands a line on to its link, and may do something to the packages on their way.

    Attributes:
        change: Done to each package; None: nothing.
        bytes_per_s: What it carries; the rest waits.
        is_repeating: Each package is the one before that began.
    """

    def __init__(self, link: Link, profile: FirmwareProfile) -> None:
        self._link = link
        self._profile = profile
        self._loop = asyncio.get_running_loop()
        self._free_at = 0.0
        self._kept: bytes | None = None
        self._seen = self._since = 0.0
        self.change: Change | None = None
        self.share = math.inf
        self.is_repeating = False
        self.rate = 0.0
        self._counted = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link.connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._link.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        now = self._loop.time()
        self._counted += len(data)
        if now - self._since >= 1.0:
            self.rate, self._counted, self._since = self._counted / (now - self._since), 0, now
        data = b"".join(map(self._altered, split_frames(data)))
        if self.share == math.inf:
            self._link.data_received(data)
            return
        self._free_at = max(self._free_at, now) + len(data) / (self.share * self.rate)
        self._loop.call_at(self._free_at, self._link.data_received, data)

    def _altered(self, frame: bytes) -> bytes:
        if not is_telemetry(frame):
            return frame
        if self.is_repeating:
            self._kept = self._kept or frame
            return self._kept
        if self.change is None:
            return frame
        package = Package(frame[14:-4], self._profile)
        self.change(package)
        sequence = frame[8] | frame[9] << 8
        return encode_frame(frame[12:14] + bytes(package.value), session=0, sequence=sequence)


class Lying(Rig):
    """A rig with a relay.

    Attributes:
        relay: On the line from the aircraft.
    """

    relay: Relay


@asynccontextmanager
async def lying(**options: Any) -> AsyncIterator[Lying]:
    virtual = ConnectableAircraft(seed=1, **options)
    link = Link()
    link.name = "relay"
    relay = Relay(link, virtual.autopilot.profile)
    virtual.connect_protocol(relay)
    await link.wait_connected()
    async with connect(link) as aircraft:
        await aircraft.activate(virtual.credentials)
        await asyncio.sleep(1.1)
        flown = Lying(virtual, aircraft)
        flown.relay = relay
        yield flown
    virtual.stop()


# -- the faults -----------------------------------------------------------------------------------


def frozen(record: type[Any], *fields: str) -> Change:
    """These fields say for ever what they said first."""
    kept: dict[str, bytes] = {}

    def change(package: Package) -> None:
        for field in fields:
            span = package.span(record, field)
            if span is not None:
                package.value[span] = kept.setdefault(field, bytes(package.value[span]))

    return change


def repeats(flown: Lying) -> None:
    flown.relay.is_repeating = True


def stands(flown: Lying) -> None:
    flown.relay.change = frozen(Position, *PLACE)


def comes_later(flown: Lying) -> None:
    flown.relay.share = 3000 / 5750


def jumps(flown: Lying) -> None:
    def change(package: Package) -> None:
        span = package.span(Position, PLACE[0])
        if span is not None:
            (latitude,) = struct.unpack("<d", package.value[span])
            package.set(Position, **{PLACE[0]: latitude - 1000.0 / 6_378_137.0})

    flown.relay.change = change


def null(flown: Lying) -> None:
    flown.relay.change = lambda package: package.set(Position, **dict.fromkeys(PLACE[:2], 0.0))


def velocity_stands(flown: Lying) -> None:
    flown.relay.change = lambda package: package.set(Velocity, **dict.fromkeys(SPEED, 0.0))


def is_deaf(flown: Lying) -> None:
    flown.virtual.set_faults(LineFaults(deaf=True))


PLACE = ("latitude_rad", "longitude_rad", "altitude", "height")
SPEED = ("x", "y", "z")
Fault = Callable[[Lying], None]
FAULTS: dict[str, tuple[Fault, type[M100Error] | tuple[type[M100Error], ...]]] = {
    "the same package for ever": (repeats, (TelemetryStalled, SetpointsIgnored)),
    "the position stands": (stands, NavigationLost),
    "ever later": (comes_later, TelemetryStalled),
    "1 km within 20 ms": (jumps, NavigationLost),
    "0, 0 with health 5": (null, NavigationLost),
    "deaf": (is_deaf, SetpointsIgnored),
    # Where it stands from the begin on, the aircraft looks as if it flew nothing.
    "the velocity stands": (velocity_stands, (NavigationLost, SetpointsIgnored)),
}


# -- what flies by it -----------------------------------------------------------------------------


async def fly_to(control: Control) -> None:
    await control.fly_to(north=60.0, east=0.0, up=0.0)


async def fly_to_at_speed(control: Control) -> None:
    await control.fly_to(north=60.0, east=0.0, up=0.0, speed=5.0)


async def fly_path(control: Control) -> None:
    await control.fly_path([(60.0, 0.0, 1.2), (60.0, 40.0, 1.2)], speed=5.0)


async def ticks(control: Control) -> None:
    async for _ in control.ticks():
        control.send(NORTH)


async def hold(control: Control) -> None:
    async with control.hold(NORTH, lifetime=30.0, allow_long_lifetime=True):
        await asyncio.sleep(25.0)


FLIGHTS = [fly_to, fly_to_at_speed, fly_path, ticks, hold]


class Ended:
    """When and where a block ended."""

    def __init__(self, flown: Lying, monkeypatch: pytest.MonkeyPatch) -> None:
        self.at: float | None = None
        self.north = math.nan
        end = ControlBlock.end

        def watched(
            block: ControlBlock, cause: StopCause, failure: M100Error | None = None
        ) -> None:
            if self.at is None:
                self.at, self.north = flown.now, flown.virtual.position[0]
            end(block, cause, failure)

        monkeypatch.setattr(ControlBlock, "end", watched)


@pytest.mark.parametrize("firmware", ["3.1", pytest.param("1.0", marks=pytest.mark.slow)])
@pytest.mark.parametrize("flight", FLIGHTS, ids=lambda flight: cast(str, flight.__name__))
@pytest.mark.parametrize("fault", FAULTS)
async def test_each_lie_ends_each_flight_typed_soon_and_near(
    firmware: str,
    flight: Callable[[Control], Awaitable[None]],
    fault: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begin, expected = FAULTS[fault]
    async with lying(firmware=firmware) as flown:
        struck_at = math.inf
        struck = 0.0

        def strike() -> None:
            nonlocal struck_at, struck
            struck_at, struck = flown.now, flown.virtual.position[0]
            begin(flown)

        ended = Ended(flown, monkeypatch)  # before: the watchdog of the block has its method
        with pytest.raises(expected) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                if fault == "deaf":
                    strike()
                else:
                    asyncio.get_running_loop().call_later(2.5, strike)
                await flight(control)
        assert ended.at is not None
        print(f"{ended.at - struck_at:.2f} s, {ended.north - struck:.1f} m: {caught.value.seen}")  # noqa: T201 (pytest shows it when the test fails)
        is_slow = fault == "deaf" and flight is fly_path  # begins at 0 m/s, as the aircraft does
        assert ended.at - struck_at <= (2.5 if is_slow else WITHIN_S)
        assert abs(ended.north - struck) <= WITHIN_M
        if fault != "deaf":
            await asyncio.sleep(3.0)
            assert abs(flown.virtual.position[0] - struck) <= WITHIN_M + 5.0
            assert flown.speed < 0.2


@pytest.mark.parametrize("fault", [name for name in FAULTS if name not in ("deaf", "ever later")])
async def test_the_switch_of_that_name_lets_it_fly_on(fault: str) -> None:
    begin, _ = FAULTS[fault]
    async with lying() as flown:
        guards = Guards(integrity=False, stale_telemetry_s=None, envelope=None)
        async with flown.aircraft.control(guards=guards) as control:
            await control.take_off()
            begin(flown)
            async for tick in control.ticks():
                if tick.elapsed > 4.0:
                    break
                control.send(NORTH)
        assert flown.virtual.position[0] > 12.0
