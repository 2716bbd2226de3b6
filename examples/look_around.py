"""Look around from the ground: rates, gimbal, photographs. Nothing flies, nothing asks for control.

python examples/look_around.py                    # a virtual aircraft inside this program
python examples/look_around.py /dev/ttyUSB0       # another one, or a real one with firmware 3.1
"""

import asyncio
import sys

import m100link
from m100link import Credentials

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft


async def main(url: str = "sim://?firmware=3.1") -> None:
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        seen = await aircraft.set_telemetry_rates(gimbal=50, attitude=10)
        print(f"gimbal at {seen['gimbal']:.0f} Hz, attitude at {seen['attitude']:.0f} Hz")
        for yaw in (0, 90, 180, 270):
            await aircraft.gimbal.set_angles(yaw=yaw, pitch=-30, seconds=1.5, wait=True)
            await aircraft.camera.take_photo()  # sent: nobody confirms it
            print(aircraft.gimbal)
            await asyncio.sleep(1.0)  # the camera takes that long
        await aircraft.camera.start_video()
        async with aircraft.gimbal.hold_angular_rates(pitch=-20) as rates:
            await asyncio.sleep(2.0)
            rates.set(pitch=10, yaw=15)
            await asyncio.sleep(2.0)
        await aircraft.camera.stop_video()
        await aircraft.gimbal.set_angles(yaw=0, pitch=0, seconds=2, wait=True)
        print(aircraft.gimbal)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
