"""Record a flight, then draw it: a page for a browser, and what it was in numbers.

It takes off, flies a square and lands. The files are in the folder where you are, unless a second
argument names another one. Needs the extra ``log``; with ``analysis`` there is a picture, too.

python examples/plot_a_flight.py                     # a virtual aircraft
python examples/plot_a_flight.py /dev/ttyUSB0 today  # another one, or a real one
"""

import asyncio
import sys
from pathlib import Path

import m100link
from m100link.errors import UsageError
from m100link.log import Recorder, read
from m100link.log.picture import facts, page, picture
from m100link.log.story import read_story
from m100link.sim import DEMO_APP_ID, DEMO_KEY

LEGS = ((8.0, 0.0, 2.0), (0.0, 8.0, 0.0), (-8.0, 0.0, -2.0), (0.0, -8.0, 0.0))


async def main(url: str, place: str = ".") -> None:
    recorder = Recorder(place)
    async with m100link.connect(url, record=recorder) as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY))
        async with aircraft.control(stop="land") as control:
            await control.take_off()
            await control.climb_to(4.0)
            for north, east, up in LEGS:
                await control.fly_to(north=north, east=east, up=up)
            await control.land()
    draw(recorder.path)


def draw(log: Path) -> None:
    story = read_story(read(log))
    for name, value in facts(story):
        print(f"{name:<16} {value}")
    log.with_suffix(".html").write_text(page(story), encoding="utf-8")
    print(f"drawn: {log.with_suffix('.html')}")
    try:
        log.with_suffix(".png").write_bytes(picture(story))
    except UsageError as error:  # matplotlib is not installed
        print(f"no picture: {error.seen}")


if __name__ == "__main__":
    asyncio.run(main(*(sys.argv[1:] or ["sim://"])))
