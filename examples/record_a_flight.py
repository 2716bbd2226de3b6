"""Record a short flight, then say from its log what was flown.

It takes off. The file is in the folder where you are, unless a second argument says where. Needs
the extra ``log``.

python examples/record_a_flight.py                          # a virtual aircraft
python examples/record_a_flight.py /dev/ttyUSB0 today.mcap  # another one, or a real one
"""

import asyncio
import sys

import m100link
from m100link import Position
from m100link.log import Recorder, read
from m100link.sim import DEMO_APP_ID, DEMO_KEY


async def main(url: str, place: str = ".") -> None:
    recorder = Recorder(place)
    async with m100link.connect(url, record=recorder) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            await control.fly_to(north=3.0, east=0.0, up=3.0)
            await control.land()

    flight = read(recorder.path)
    summary = flight.summary()
    print(f"{recorder.path}: {summary.duration_s:.0f} s, firmware {summary.firmware}")
    heights = flight.table(Position).column("position.height_m")
    print(f"highest: {max(heights):.1f} m, of {len(heights)} packages")
    began = summary.began_utc or 0.0
    for message in flight.messages("/m100/command"):
        content = message.content()
        if content["command"] == "start_task" and not content["is_ack"]:
            print(f"{message.utc - began:6.2f} s  {content['task']}")


if __name__ == "__main__":
    asyncio.run(main(*(sys.argv[1:] or ["sim://"])))
