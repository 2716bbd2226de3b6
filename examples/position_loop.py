"""Fly to a place by position-offset setpoints: measure what remains, send that, 50 times a second.

An offset is counted from where the aircraft *is*, not from where it was: sent once and repeated it
would fly for ever. ``control.fly_to(...)`` does what this program does, and more carefully.

python examples/position_loop.py                      # a virtual aircraft inside this program
python examples/position_loop.py /dev/ttyUSB0         # another one, or a real one
"""

import asyncio
import math
import sys

import m100link
from m100link import Credentials, Setpoint
from m100link.geodesy import LocalFrame

# The app id and key of the virtual aircraft. A real aircraft needs those of your own app.
CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))

NORTH, EAST, HEIGHT = 6.0, 4.0, 3.0  # m from take-off
NEAR = 0.3  # m


async def main(url: str) -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            position = aircraft.state.position
            assert position is not None
            start = LocalFrame(position.latitude_deg, position.longitude_deg)
            async for tick in control.ticks(rate_hz=50):
                position = aircraft.state.position or position
                north, east = start.to_local(position.latitude_deg, position.longitude_deg)
                to_north, to_east = NORTH - north, EAST - east
                if tick.index % 50 == 0:
                    distance = math.hypot(to_north, to_east)
                    print(f"{tick.elapsed:4.0f} s: {distance:.2f} m to go")
                if math.hypot(to_north, to_east, HEIGHT - position.height_m) < NEAR:
                    break
                if tick.elapsed > 30:
                    raise TimeoutError("the place was not reached in 30 s")
                control.send(
                    Setpoint.position_offset(
                        north=to_north, east=to_east, height=HEIGHT, yaw_rate_deg_s=0
                    )
                )
            print(f"arrived after {tick.elapsed:.0f} s")
            await control.stop()
            await control.land()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
