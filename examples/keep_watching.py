"""Watch an aircraft for as long as it takes: a pulled cable makes a gap, not an end.

python examples/keep_watching.py                    # a virtual aircraft inside this program
python examples/keep_watching.py /dev/ttyUSB0       # a real one: pull the cable, plug it in again
"""

import asyncio
import sys

import m100link
from m100link import Credentials, Gap, Position, SupervisionState

CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))  # those of the virtual aircraft
SECONDS = 10.0


async def tell(events: m100link.Subscription[m100link.SupervisionEvent]) -> None:
    """Say why nothing comes, and when it is tried again."""
    async for event in events:
        if event.after is SupervisionState.WAITING and event.error is not None:
            print(f"{event.error.seen}; again in {event.next_attempt_in:.1f} s")
        elif event.after is SupervisionState.CONNECTED:
            print("connected")


async def main(url: str = "sim://") -> None:
    async with m100link.supervise(url, CREDENTIALS) as supervised:
        telling = asyncio.create_task(tell(supervised.events()))
        try:
            async with asyncio.timeout(SECONDS):
                async for sample in supervised.telemetry(Position, rate_hz=1.0):
                    if isinstance(sample, Gap):
                        print(f"{sample.back_at - sample.lost_at:.1f} s are missing")
                    else:
                        place = sample[Position]
                        print(f"{place.latitude_deg:.6f} {place.longitude_deg:.6f}")
        except TimeoutError:
            print("enough seen")
        finally:
            telling.cancel()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
