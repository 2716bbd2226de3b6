"""A survey: lines over a field, flown without stopping, then home and down.

python examples/survey.py                       # a virtual aircraft inside this program
python examples/survey.py /dev/ttyUSB0          # another one, or a real one
"""

import asyncio
import sys

import m100link
from m100link import Credentials, GuidanceProgress
from m100link.missions.patterns import length_m, survey

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft

FIELD = [(5.0, -10.0), (5.0, 10.0), (20.0, 14.0), (24.0, -8.0)]  # metres north and east of take-off
HEIGHT, SPEED = 12.0, 5.0


class Printer:
    """A line each time that a fifth of the way is behind the aircraft."""

    def __init__(self, length: float) -> None:
        self._step = length / 5
        self._next = length

    def __call__(self, progress: GuidanceProgress) -> None:
        if progress.distance_m < self._next:
            self._next -= self._step
            print(f"{progress.elapsed:5.1f} s  {progress.distance_m:5.0f} m to go")


async def main(url: str = "sim://") -> None:
    lines = survey(FIELD, spacing=6.0, height=HEIGHT, angle_deg=90.0)
    print(f"{len(lines) // 2} lines, {length_m(lines):.0f} m")
    async with m100link.connect(url) as aircraft:
        await aircraft.activate(CREDENTIALS)
        async with aircraft.control(stop="land") as control:
            home = control.local_frame()
            await control.take_off()
            await control.climb_to(HEIGHT)
            show = Printer(length_m(lines))
            await control.fly_path(lines, speed=SPEED, frame=home, face_ahead=True, progress=show)
            await control.fly_to(north=0.0, east=0.0, height=3.0, frame=home)
            print("back where it took off")
        print("landed")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
