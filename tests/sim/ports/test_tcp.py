"""Programs that reach a virtual aircraft by TCP, in real time."""

from __future__ import annotations

import asyncio

import pytest

from m100link.sim import Driver, VirtualAircraft, serve_tcp
from tests.sim.ports.test_driver import Listener
from tests.waiting import until

pytestmark = pytest.mark.anyio


async def test_tcp_serves_one_program_at_a_time_and_a_new_one_replaces_it() -> None:
    driver = Driver(VirtualAircraft(seed=1))
    server = await serve_tcp(driver)
    loop = asyncio.get_running_loop()
    listeners: list[Listener] = []
    for _ in range(2):
        _, listener = await loop.create_connection(Listener, "127.0.0.1", server.port)
        listeners.append(listener)
        await until(lambda: listeners[-1].frames > 5)
    await until(lambda: listeners[0].lost == [None])
    await server.stop()
    driver.stop()
    await until(lambda: bool(listeners[1].lost))
    assert server.port > 0


async def test_tcp_refuses_while_the_aircraft_is_unplugged() -> None:
    aircraft = VirtualAircraft(seed=1)
    driver = Driver(aircraft)
    server = await serve_tcp(driver)
    loop = asyncio.get_running_loop()
    listeners: list[Listener] = []
    for plugged in (True, False, True):
        aircraft.replug() if plugged else aircraft.unplug()
        _, listener = await loop.create_connection(Listener, "127.0.0.1", server.port)
        listeners.append(listener)
        await until(lambda: bool(listeners[-1].bytes or listeners[-1].lost))
    assert [listener.bytes > 0 for listener in listeners] == [True, False, True]
    await server.stop()
    driver.stop()
