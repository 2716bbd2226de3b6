"""Lines that go away and come back, on virtual time."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from random import Random

import pytest

import m100link
from m100link import (
    Aircraft,
    AnotherAircraft,
    AuthorityLost,
    AuthorityState,
    BackOff,
    Credentials,
    Gap,
    LinkClosed,
    LinkError,
    Lossless,
    Position,
    Sample,
    Setpoint,
    Supervised,
    SupervisionState,
    TelemetryOverflow,
    UsageError,
)
from m100link.errors import ActivationRefused
from m100link.sim import DEMO_APP_ID, DEMO_KEY, VirtualClockEventLoop
from m100link.testing import ConnectableAircraft

pytestmark = pytest.mark.anyio

APP = Credentials(DEMO_APP_ID, DEMO_KEY)
STEADY = BackOff(first=1.0, factor=1.0, jitter=0.0)
S = SupervisionState


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


class Cable:
    """Leads to whatever is plugged in.

    Attributes:
        end: The aircraft at its other end, None for nothing.
        tries: Attempts to open it.
    """

    def __init__(self, end: ConnectableAircraft | None = None) -> None:
        self.end = end
        self.tries = 0

    async def open(self) -> Aircraft:
        self.tries += 1
        if self.end is None or not self.end.line.is_plugged:
            raise LinkError("nothing is plugged in")
        return await m100link.connect(await self.end.open_link())


def supervised(
    cable: Cable, credentials: Credentials | None = APP, back_off: BackOff = STEADY
) -> Supervised:
    return Supervised(cable.open, credentials=credentials, back_off=back_off, random=Random(7))


def virtual(**options: object) -> ConnectableAircraft:
    return ConnectableAircraft(seed=1, firmware="3.1", **options)


async def until(condition: Callable[[], bool], within: float = 60.0) -> None:
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.05)


async def test_what_is_not_there_yet_is_waited_for() -> None:
    cable = Cable()
    async with supervised(cable) as one:
        waiting = asyncio.create_task(one.connected())
        await asyncio.sleep(10.5)
        assert not waiting.done()
        assert (one.state, str(one.error)) == (S.WAITING, "nothing is plugged in")
        assert cable.tries == 11
        cable.end = virtual()
        aircraft = await waiting
        assert aircraft is one.aircraft
        assert aircraft.is_activated
        assert (one.state, one.error, one.attempts) == (S.CONNECTED, None, 0)
    assert one.state is S.CLOSED
    assert not aircraft.is_connected


async def test_each_change_is_reported_with_its_reason() -> None:
    cable = Cable()
    async with supervised(cable) as one:
        events = one.events()
        await asyncio.sleep(0.5)
        cable.end = virtual()
        await one.connected()
        told = [await anext(events) for _ in range(4)]
        assert [event.after for event in told] == [
            *(S.WAITING, S.CONNECTING, S.ACTIVATING, S.CONNECTED)
        ]
        assert (str(told[0].error), told[0].next_attempt_in) == ("nothing is plugged in", 1.0)
        assert all(event.error is None for event in told[1:])


async def test_telemetry_goes_on_across_a_loss_which_it_marks() -> None:
    cable = Cable(virtual())
    got: list[Sample | Gap] = []
    async with supervised(cable) as one:

        async def consume() -> None:
            async for sample in one.telemetry(Position, rate_hz=10.0):
                got.append(sample)

        consumer = asyncio.create_task(consume())
        first = await one.connected()
        await asyncio.sleep(2.0)
        assert cable.end is not None
        cable.end.unplug()
        await until(lambda: one.state is S.WAITING)
        lost_at = asyncio.get_running_loop().time()
        await asyncio.sleep(7.3)
        before = len(got)
        cable.end.replug()
        second = await one.connected()
        assert second is not first
        await asyncio.sleep(2.0)
    await consumer  # leaving the block ends the stream
    gaps = [one for one in got if isinstance(one, Gap)]
    assert got[before] is gaps[0]
    assert len(gaps) == 1
    assert gaps[0].lost_at == pytest.approx(lost_at, abs=0.2)
    assert 7.0 < gaps[0].back_at - gaps[0].lost_at < 12.0
    assert isinstance(gaps[0].error, LinkError)
    assert before > 15
    assert len(got) - before > 15


async def fly_until_the_plug_is_pulled(aircraft: Aircraft, end: ConnectableAircraft) -> None:
    async with aircraft.control() as control:
        await control.take_off()
        north = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
        control.send(north, lifetime=30.0, allow_long_lifetime=True)
        await asyncio.sleep(2.0)
        end.unplug()
        await asyncio.sleep(60.0)


async def test_control_never_resumes_by_itself() -> None:
    end = virtual()
    cable = Cable(end)
    async with supervised(cable) as one:
        aircraft = await one.connected()
        with pytest.raises((AuthorityLost, LinkError)):
            await fly_until_the_plug_is_pulled(aircraft, end)
        end.replug()
        again = await one.connected()
        at, moves = end.position, end.autopilot.received_movements
        moves.clear()
        await asyncio.sleep(20.0)
        assert not moves
        assert end.position == pytest.approx(at, abs=1.0)
        assert again.authority.state is not AuthorityState.HELD


@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
async def test_an_aircraft_that_falls_silent_is_lost_though_the_line_stays_open(
    firmware: str,
) -> None:
    end = ConnectableAircraft(seed=1, firmware=firmware)
    async with supervised(Cable(end)) as one:
        await one.connected()
        await asyncio.sleep(12.0)
        assert one.round_trip is not None
        assert 0.0 <= one.round_trip < 0.1
        end.stall_line()
        await until(lambda: one.state is S.WAITING)
        assert one.error is not None
        assert re.fullmatch("the aircraft is silent for [3-6] s", one.error.seen)
        end.stall_line(False)
        await one.connected()
        assert one.state is S.CONNECTED


async def test_loss_of_some_frames_is_not_the_loss_of_the_aircraft() -> None:
    end = virtual()
    async with supervised(Cable(end)) as one:
        await one.connected()
        end.set_faults(m100link.sim.LineFaults(loss=0.3))
        events = one.events()
        await asyncio.sleep(120.0)
        assert events.get_nowait() is None
        assert one.state is S.CONNECTED


async def test_an_aircraft_that_was_switched_off_and_on_is_activated_again() -> None:
    end = virtual()
    async with supervised(Cable(end)) as one:
        await one.connected()
        events = one.events()
        end.reboot()
        end.vehicle.activation.active = None
        await until(lambda: events.received >= 2)
        await one.connected()
        assert one.version is not None
        assert one.aircraft is not None
        assert (await one.aircraft.version()).is_activated


async def test_another_aircraft_ends_it() -> None:
    cable = Cable(virtual())
    async with supervised(cable) as one:
        first = await one.connected()
        await first.link.close()
        cable.end = ConnectableAircraft(seed=2, firmware="3.1")
        await until(lambda: one.state is S.REFUSED)
        with pytest.raises(AnotherAircraft) as caught:
            await one.connected()
        assert caught.value.expected != caught.value.found
        assert one.state is S.REFUSED
        tries = cable.tries
        await asyncio.sleep(100.0)
        assert cable.tries == tries  # nobody is asked again
        with pytest.raises(AnotherAircraft):
            await anext(one.telemetry(Position))


async def test_an_app_that_is_refused_for_good_is_not_asked_again_and_again() -> None:
    cable = Cable(virtual())
    async with supervised(cable, Credentials(4242, DEMO_KEY)) as one:
        with pytest.raises(ActivationRefused):
            await one.connected()
        assert (one.state, cable.tries) == (S.REFUSED, 1)


async def test_a_phone_without_network_is_waited_for() -> None:
    end = virtual()
    end.disconnect_app()
    end.vehicle.activation.active = None
    async with supervised(Cable(end)) as one:
        await until(lambda: one.state is S.WAITING)
        assert isinstance(one.error, ActivationRefused)
        end.connect_app(internet=True)
        await one.connected()


async def test_without_an_app_it_is_watched_only() -> None:
    end = virtual()
    async with supervised(Cable(end), None) as one:
        aircraft = await one.connected()
        assert not aircraft.is_activated
        await asyncio.sleep(30.0)
        assert one.state is S.CONNECTED


async def test_a_url_that_is_none_is_said_at_once() -> None:
    async with m100link.supervise("ttyUSB0") as one:
        with pytest.raises(UsageError):
            await one.connected()
        assert one.state is S.REFUSED


async def test_a_url_is_kept() -> None:
    async with m100link.supervise("sim://?seed=3&firmware=3.1", APP, random=Random(1)) as one:
        aircraft = await one.connected()
        await aircraft.link.close()
        await until(lambda: one.aircraft is not None and one.aircraft is not aircraft)


@pytest.mark.parametrize("moment", [0.001, 0.01, 0.5, 1.2, 3.0])
async def test_it_ends_at_any_moment_and_nobody_waits_for_ever(moment: float) -> None:
    cable = Cable(virtual() if moment != 1.2 else None)
    one = supervised(cable)
    await one.__aenter__()
    telemetry = one.telemetry(Position)
    consumer = asyncio.create_task(anext(telemetry, None))
    await asyncio.sleep(moment)
    await one.aclose()
    await one.aclose()
    async with asyncio.timeout(1.0):
        await asyncio.wait([consumer])
    with pytest.raises(LinkClosed):
        await one.connected()
    tries = cable.tries
    await asyncio.sleep(100.0)
    assert cable.tries == tries
    assert cable.end is None or not cable.end.driver.ports


async def test_it_is_begun_once() -> None:
    one = supervised(Cable())
    with pytest.raises(UsageError, match="has not begun"):
        await one.connected()
    async with one:
        pass
    with pytest.raises(UsageError, match="was begun before"):
        await one.__aenter__()


async def test_a_consumer_that_falls_behind_is_reported_as_ever() -> None:
    async with supervised(Cable(virtual())) as one:
        await one.connected()
        async with one.telemetry(policy=Lossless(5)) as samples:
            await anext(samples)
            await asyncio.sleep(2.0)
            for _ in range(5):  # what had been queued by then
                await anext(samples)
            with pytest.raises(TelemetryOverflow):
                await anext(samples)


async def test_a_fault_of_its_own_is_not_swallowed() -> None:
    async def broken() -> Aircraft:
        raise ZeroDivisionError

    one = Supervised(broken, credentials=None, back_off=STEADY, random=Random(1))
    await one.__aenter__()
    with pytest.raises(LinkClosed):
        await one.connected()
    with pytest.raises(ZeroDivisionError):
        await one.aclose()
