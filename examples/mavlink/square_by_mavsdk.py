"""Fly a square by MAVSDK: nothing in here knows that the aircraft is an M100.

pip install mavsdk-grpc
m100link mavlink sim://                                    # in another terminal
python examples/mavlink/square_by_mavsdk.py                # where it speaks to by itself
python examples/mavlink/square_by_mavsdk.py udpin://127.0.0.1:14540

With mavsdk below 4 the same program begins with `import mavsdk`.
"""

import asyncio
import sys

from mavsdk_grpc import System
from mavsdk_grpc.offboard import VelocityNedYaw

LEGS = [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)]  # m/s north, m/s east
LEG_SECONDS = 3.0


async def main(address: str) -> None:
    drone = System()
    await drone.connect(system_address=address)
    async for health in drone.telemetry.health():
        if health.is_global_position_ok and health.is_home_position_ok:
            break
    await drone.action.arm()  # obtains control authority: the pilot's switch has to be in F
    await drone.action.takeoff()
    async for position in drone.telemetry.position():
        if position.relative_altitude_m > 2.0:
            break
    # The library repeats the newest setpoint; when this program ends, the aircraft hovers.
    await drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await drone.offboard.start()
    for number, (north, east) in enumerate(LEGS, 1):
        await drone.offboard.set_velocity_ned(VelocityNedYaw(north, east, 0.0, 0.0))
        await asyncio.sleep(LEG_SECONDS)
        print(f"corner {number}")
    await drone.offboard.stop()
    await drone.action.land()
    async for armed in drone.telemetry.armed():
        if not armed:
            break
    print("landed")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "udpin://127.0.0.1:14540"))
