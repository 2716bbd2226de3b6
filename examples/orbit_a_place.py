"""Circle around a place by the aircraft's own orbit, the camera on its centre all the time.

python examples/orbit_a_place.py                    # a virtual aircraft inside this program
python examples/orbit_a_place.py /dev/ttyUSB0       # a real one with firmware 3.1
"""

import asyncio
import math
import sys

import m100link
from m100link import Aircraft, CircleHeading, Credentials, Gimbal, MissionProgress
from m100link.geodesy import bearing_deg

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft

NORTH_OF_HERE, HEIGHT, RADIUS, RATE = 30.0, 15.0, 20.0, 12.0  # metres, degrees per second
LOOK_DOWN = -math.degrees(math.atan2(HEIGHT, RADIUS))


async def look_at(aircraft: Aircraft, centre: tuple[float, float]) -> None:
    """Point the camera at the centre, which moves around the aircraft; for ever."""
    while True:
        position = aircraft.state.position
        if position is not None:
            here = position.latitude_deg, position.longitude_deg
            # Where it will be seen when the gimbal has turned.
            yaw = bearing_deg(*here, *centre) + RATE * 0.5
            await aircraft.gimbal.set_angles(yaw=yaw, pitch=LOOK_DOWN, seconds=0.5)
        await asyncio.sleep(0.5)


async def main(url: str = "sim://?firmware=3.1") -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            centre = control.local_frame().to_geodetic(NORTH_OF_HERE, 0.0)
            await control.take_off()
            async with control.hotpoint(
                latitude_deg=centre[0],
                longitude_deg=centre[1],
                height=HEIGHT,  # above the take-off point, not above the sea
                radius=RADIUS,
                rate_deg_s=RATE,
                heading=CircleHeading.TO_CENTRE,
            ) as circle:
                looking = asyncio.create_task(look_at(aircraft, centre))
                try:
                    async for event in circle:
                        if isinstance(event, MissionProgress) and event.status == 1:
                            gimbal = aircraft.state.get(Gimbal)
                            pitch = math.nan if gimbal is None else gimbal.pitch_deg
                            print(f"{event.distance_m:.1f} m from the centre, camera {pitch:.0f}°")
                        if isinstance(event, MissionProgress) and event.elapsed > 40:
                            break  # leaving the block stops the circle
                finally:
                    looking.cancel()
            await control.land()
    print("landed")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
