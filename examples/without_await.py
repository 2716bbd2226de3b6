"""The API without await: a flight in a script that knows nothing of asyncio.

python examples/without_await.py                 # a virtual aircraft
python examples/without_await.py /dev/ttyUSB0    # a real one: propellers off at first
"""

from __future__ import annotations

import sys

from m100link import Attitude, Credentials, Position, TaskProgress, sync

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft


def show(progress: TaskProgress) -> None:
    """Callbacks run in this thread: print() delays nobody."""
    print(f"  {progress.elapsed:4.1f} s  {progress.phase}  {progress.height_m or 0.0:.1f} m")


def main(url: str) -> None:
    with sync.connect(url) as aircraft:
        aircraft.activate(CREDENTIALS)
        print(aircraft)
        with aircraft.control() as control:
            control.take_off(progress=show)
            control.climb_to(4.0)
            for north, east in ((3.0, 0.0), (0.0, 3.0), (-3.0, -3.0)):
                arrival = control.fly_to(north=north, east=east, up=0.0)
                print(f"{north:+.0f} m north, {east:+.0f} m east: {arrival.elapsed:.1f} s")
            with aircraft.telemetry(Position, Attitude, timeout=2.0) as samples:
                for sample, _ in zip(samples, range(3), strict=False):
                    print(sample.position, sample.attitude)
            control.land()
        print("landed")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "sim://")
