"""Fly a square and take note of the highest point: a program to be tested."""

from __future__ import annotations

import asyncio
import sys

import m100link
from m100link import Position, Setpoint

LEGS = ((2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0))
LEG_S = 3.0


async def fly_square(aircraft: m100link.Aircraft) -> float:
    """Take off, fly a square of six metres, land. Returns the greatest height in metres."""
    highest = 0.0
    async with aircraft.control() as control:
        await control.take_off()
        for north, east in LEGS:
            async for tick in control.ticks(rate_hz=50):
                if tick.elapsed > LEG_S:
                    break
                control.send(
                    Setpoint.velocity(north=north, east=east, height=3.0, yaw_rate_deg_s=0.0)
                )
                position = aircraft.state.position
                if isinstance(position, Position):
                    highest = max(highest, position.height_m)
        await control.land()
    return highest


async def main(url: str, credentials: m100link.Credentials) -> float:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(credentials)
        return await fly_square(aircraft)


if __name__ == "__main__":
    demo = m100link.Credentials(10086, bytes(range(32)))
    print(f"highest point: {asyncio.run(main(sys.argv[1], demo)):.1f} m")
