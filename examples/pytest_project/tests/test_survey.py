"""The suite of a user: what the program does when all is well, and when it is not."""

from __future__ import annotations

import asyncio

import pytest
from survey import fly_square, main

import m100link
from m100link.sim import LineFaults
from m100link.testing import ConnectableAircraft, VirtualPort


@pytest.mark.anyio
async def test_the_square_ends_where_it_began(virtual_aircraft: ConnectableAircraft) -> None:
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.activate(virtual_aircraft.credentials)
        highest = await fly_square(aircraft)
    assert 2.5 < highest < 3.5
    assert virtual_aircraft.height == 0.0
    assert virtual_aircraft.position == pytest.approx((0.0, 0.0), abs=1.0)


@pytest.mark.anyio
async def test_it_stops_when_the_pilot_takes_over(virtual_aircraft: ConnectableAircraft) -> None:
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.activate(virtual_aircraft.credentials)
        asyncio.get_running_loop().call_later(12.0, virtual_aircraft.leave_f)
        with pytest.raises(m100link.AuthorityLost):
            await fly_square(aircraft)
    sent = len(virtual_aircraft.autopilot.received_movements)
    assert 0 < sent < 50 * 12
    assert virtual_aircraft.height > 1.0, "it hovers; landing is the pilot's now"


@pytest.mark.anyio
@pytest.mark.aircraft(seed=7, faults=LineFaults(loss=0.03, damage=0.01, jitter=0.01))
async def test_a_bad_line_does_not_matter(virtual_aircraft: ConnectableAircraft) -> None:
    async with virtual_aircraft.connect() as aircraft:
        await aircraft.activate(virtual_aircraft.credentials)
        await fly_square(aircraft)
    assert virtual_aircraft.height == 0.0


@pytest.mark.anyio
async def test_without_the_app_activation_fails(virtual_aircraft: ConnectableAircraft) -> None:
    virtual_aircraft.disconnect_app()
    async with virtual_aircraft.connect() as aircraft:
        with pytest.raises(m100link.ActivationRefused, match="app"):
            await aircraft.activate(virtual_aircraft.credentials)


def test_a_program_that_opens_a_port_by_name(virtual_aircraft_port: VirtualPort) -> None:
    """In real time, and cut short: the pilot takes over after two seconds."""
    credentials = virtual_aircraft_port.aircraft.credentials

    async def run() -> None:
        asyncio.get_running_loop().call_later(4.0, virtual_aircraft_port.call, "leave_f")
        await main(virtual_aircraft_port.name, credentials)

    with pytest.raises(m100link.AuthorityLost):
        asyncio.run(run())
