"""Let the aircraft follow somebody who walks, at the distance that they have at the beginning.

python examples/follow_a_target.py                    # a virtual aircraft inside this program
python examples/follow_a_target.py /dev/ttyUSB0       # a real one with firmware 3.1
"""

import asyncio
import math
import sys
from collections.abc import AsyncIterator

import m100link
from m100link import Credentials, MissionProgress, Target
from m100link.geodesy import LocalFrame

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft


async def walk(start: LocalFrame) -> AsyncIterator[Target]:
    """Half a circle of 20 m in a minute; yours come from a GPS receiver, ten a second at most."""
    for step in range(120):
        angle = math.pi * step / 120
        north, east = 10.0 + 20.0 * math.sin(angle), 20.0 - 20.0 * math.cos(angle)
        yield Target(*start.to_geodetic(north, east))
        await asyncio.sleep(0.5)


async def main(url: str = "sim://?firmware=3.1") -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            start = control.local_frame()
            await control.take_off()
            await control.climb_to(8.0)  # it follows from 5 m on
            # It is stopped when the walk ends, and the aircraft hovers.
            async with control.follow_target(walk(start)) as mission:
                async for event in mission:
                    if isinstance(event, MissionProgress) and event.distance_m is not None:
                        print(f"{event.elapsed:3.0f} s: {event.distance_m:.1f} m away")
            position = aircraft.state.position
            assert position is not None
            north, east = start.to_local(position.latitude_deg, position.longitude_deg)
            print(f"{north:.0f} m north, {east:.0f} m east of where it began")
            await control.land()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
