"""Write ten rows of telemetry a second to standard output as CSV, for five seconds.

Sends nothing that moves anything. ``m100link echo URL --csv`` has every column there is.

python examples/telemetry_to_csv.py > flight.csv                  # a virtual aircraft
python examples/telemetry_to_csv.py /dev/ttyUSB0 > flight.csv     # another one, or a real one
"""

import asyncio
import csv
import sys

import m100link
from m100link import Attitude, Lossless, Position

SECONDS, RATE_HZ = 5, 10
COLUMNS = [
    *("seconds", "utc", "latitude_deg", "longitude_deg", "height_m", "gps_health"),
    *("roll_deg", "pitch_deg", "yaw_deg", "battery_percent"),
]


async def main(url: str) -> None:
    writer = csv.writer(sys.stdout)
    writer.writerow(COLUMNS)
    async with m100link.connect(url) as aircraft:
        # Every package of these items, thinned to ten a second. If this program fell behind by more
        # than a hundred, TelemetryOverflow would report it instead of losing rows in silence.
        policy = Lossless(100)
        async with aircraft.telemetry(
            Position, Attitude, policy=policy, rate_hz=RATE_HZ
        ) as samples:
            start = None
            async for sample in samples:
                start = sample.received_at if start is None else start
                seconds = sample.received_at - start
                if seconds >= SECONDS:
                    return
                position, attitude = sample[Position], sample[Attitude]
                # The battery comes once a second: its newest value, and nothing before the first.
                battery = aircraft.state.battery
                writer.writerow(
                    [
                        f"{seconds:.3f}",
                        f"{sample.received_at + aircraft.utc_offset_s:.3f}",
                        f"{position.latitude_deg:.8f}",
                        f"{position.longitude_deg:.8f}",
                        f"{position.height_m:.3f}",
                        position.gps_health,
                        f"{attitude.roll_deg:.2f}",
                        f"{attitude.pitch_deg:.2f}",
                        f"{attitude.yaw_deg:.2f}",
                        "" if battery is None else battery.percent,
                    ]
                )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://"))
