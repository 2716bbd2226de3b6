"""A connection used from another event loop or thread: a typed error, and the owner flies on."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import Any

import pytest

import m100link
from m100link import Aircraft, Attitude, Control, Setpoint, UsageError
from m100link.protocol.commands.activation import GetVersion
from m100link.protocol.commands.gimbal import StartVideo
from m100link.testing import ConnectableAircraft
from tests.rig import NORTH, rig

pytestmark = pytest.mark.anyio

SOUTH = Setpoint.velocity(north=-2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def first(values: AsyncIterator[object]) -> object:
    """Take one value."""
    async for value in values:
        return value
    return None


async def entered(block: Any) -> None:
    """Enter a block."""
    async with block:
        pass


async def plainly(call: Callable[[], object]) -> None:
    """What does not wait."""
    call()


AIRCRAFT: dict[str, Callable[[Aircraft], Awaitable[object]]] = {
    "aclose": lambda a: a.aclose(),
    "activate": lambda a: a.activate(m100link.Credentials(app_id=1, key=bytes(32))),
    "collect": lambda a: a.collect(Attitude, seconds=0.1),
    "control": lambda a: entered(a.control()),
    "control by hand": lambda a: a.control().obtain(),
    "events": lambda a: first(a.events()),
    "execute": lambda a: a.execute(GetVersion()),
    "from_mobile": lambda a: first(a.from_mobile()),
    "gimbal": lambda a: a.gimbal.set_angular_rates(yaw=1.0),
    "push": lambda a: plainly(lambda: a.push(StartVideo())),
    "release_authority": lambda a: a.release_authority(),
    "send_to_mobile": lambda a: a.send_to_mobile(b"x"),
    "set_telemetry_rates": lambda a: a.set_telemetry_rates(attitude=50),
    "telemetry": lambda a: first(a.telemetry(Attitude)),
    "version": lambda a: a.version(),
    "virtual_rc": lambda a: entered(a.virtual_rc()),
    "wait_closed": lambda a: a.wait_closed(),
    "wait_for": lambda a: a.wait_for(lambda _: False, timeout=0.1),
}
CONTROL: dict[str, Callable[[Control], Awaitable[object]]] = {
    "climb_to": lambda c: c.climb_to(20.0),
    "fly_to": lambda c: c.fly_to(north=1.0, east=0.0, up=0.0),
    "follow": lambda c: c.follow(lambda _: NORTH),
    "hold": lambda c: entered(c.hold(NORTH)),
    "interrupt": lambda c: plainly(c.interrupt),
    "land": lambda c: c.land(),
    "release": lambda c: c.release(),
    "resume": lambda c: plainly(c.resume),
    "send": lambda c: plainly(lambda: c.send(SOUTH)),
    "stop": lambda c: c.stop(),
    "take_off": lambda c: c.take_off(),
    "wait_resumable": lambda c: c.wait_resumable(),
}


def elsewhere(call: Callable[[], Awaitable[object]]) -> BaseException | None:
    """What another thread's event loop gets of it, while that of the test stands still."""
    raised: list[BaseException] = []

    async def run() -> None:
        await asyncio.wait_for(call(), 5.0)

    def begin() -> None:
        try:
            asyncio.run(run())
        except BaseException as error:  # noqa: BLE001 - handed to the test
            raised.append(error)

    thread = threading.Thread(target=begin)
    thread.start()
    thread.join()
    return raised[0] if raised else None


def assert_told(error: BaseException | None, name: str = "") -> None:
    assert isinstance(error, UsageError), (name, error)
    assert "another event loop" in error.seen
    assert "run_coroutine_threadsafe" in error.remedy


async def test_nothing_of_the_owner_is_disturbed() -> None:
    """The owner flies while another loop tries whatever there is, and lands afterwards."""
    async with rig(firmware="3.1") as flown:
        aircraft = flown.aircraft
        async with aircraft.control() as control:
            await control.take_off()
            async with control.hold(NORTH, lifetime=0.6) as hold:
                await asyncio.sleep(0.5)
                calls = {name: partial(call, aircraft) for name, call in AIRCRAFT.items()}
                calls |= {name: partial(call, control) for name, call in CONTROL.items()}
                for name, call in calls.items():
                    hold.set(NORTH)
                    sent, tasks = aircraft.statistics().frames_sent, asyncio.all_tasks()
                    assert_told(elsewhere(call), name)
                    assert aircraft.statistics().frames_sent == sent, name
                    await asyncio.sleep(0)
                    assert asyncio.all_tasks() == tasks, name
                    assert control.has_authority, name
                    await asyncio.sleep(0.1)
                    assert flown.moves[-1].roll_or_x == NORTH.x, f"{name}: it flies on"
            await control.land()
        assert (await aircraft.version()).is_activated
        assert flown.is_released


async def test_a_subscription_of_another_loop() -> None:
    async with rig() as flown, flown.aircraft.telemetry(Attitude) as samples:
        await anext(samples)
        assert_told(elsewhere(lambda: first(samples)))
        assert (await anext(samples)).attitude is not None


async def test_without_any_loop() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        raised: list[UsageError] = []

        def send() -> None:
            calls: list[Callable[[], object]] = [partial(control.send, NORTH), control.interrupt]
            for call in calls:
                try:
                    call()
                except UsageError as error:
                    raised.append(error)

        thread = threading.Thread(target=send)
        thread.start()
        thread.join()
        assert len(raised) == 2
        for error in raised:
            assert_told(error)


def test_of_a_loop_that_has_ended() -> None:
    """What a program gets that keeps the aircraft between two asyncio.run()."""
    virtual = ConnectableAircraft(seed=1, firmware="3.1")

    async def begin() -> Aircraft:
        return await m100link.connect(await virtual.open_link())

    aircraft = asyncio.run(begin())
    for call in AIRCRAFT.values():
        with pytest.raises(UsageError, match="another event loop"):
            asyncio.run(_awaited(call(aircraft)))


async def _awaited(waiting: Awaitable[object]) -> object:
    return await waiting
