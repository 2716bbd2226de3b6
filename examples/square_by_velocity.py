"""Fly a square by velocity setpoints: two seconds north, east, south, west.

python examples/square_by_velocity.py                 # a virtual aircraft inside this program
python examples/square_by_velocity.py /dev/ttyUSB0    # another one, or a real one
"""

import asyncio
import math
import sys

import m100link
from m100link import Aircraft, Credentials, Setpoint
from m100link.geodesy import LocalFrame

# The app id and key of the virtual aircraft. A real aircraft needs those of your own app.
CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))

LEGS = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]  # m/s north, m/s east
LEG_SECONDS = 2.0


def place(aircraft: Aircraft) -> tuple[float, float]:
    position = aircraft.state.position
    assert position is not None
    return position.latitude_deg, position.longitude_deg


async def main(url: str) -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        # However this block ends, the aircraft is landed and authority given back.
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            await control.climb_to(4.0)
            start = LocalFrame(*place(aircraft))
            corners: list[tuple[float, float]] = []
            # The loop is this task's own; late ticks are skipped and counted, never made up for.
            async for tick in control.ticks(rate_hz=50):
                leg = int(tick.elapsed / LEG_SECONDS)
                if leg > len(corners):
                    corners.append(start.to_local(*place(aircraft)))
                    print(
                        f"corner {leg}: {corners[-1][0]:5.2f} m north {corners[-1][1]:5.2f} m east"
                    )
                if leg == len(LEGS):
                    break
                north, east = LEGS[leg]
                # A setpoint lives 0.2 s: if this program hangs, the aircraft stops.
                control.send(Setpoint.velocity(north=north, east=east, up=0, yaw_rate_deg_s=0))
            await control.stop()
            print(f"back within {math.hypot(*start.to_local(*place(aircraft))):.1f} m")
            await control.land()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
