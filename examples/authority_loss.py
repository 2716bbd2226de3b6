"""The pilot takes the aircraft away, and gives it back: what a program sees, and what it may do.

By default a control block ends with AuthorityLost. Here it waits (``on_pause="wait"``): back in F
the aircraft obeys again without a new request, but nothing flies before the program says
``resume()``.

python examples/authority_loss.py                     # a virtual aircraft, and a virtual pilot
python examples/authority_loss.py /dev/ttyUSB0        # a real one: move the mode switch yourself
"""

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import m100link
from m100link import Aircraft, AuthorityLost, Control, Credentials, Setpoint
from m100link.link import Link
from m100link.sim import Driver, VirtualAircraft

# The app id and key of the virtual aircraft. A real aircraft needs those of your own app.
CREDENTIALS = Credentials(app_id=10086, key=bytes(range(32)))


async def fly_north(control: Control, seconds: float) -> None:
    """Fly until the time is over or the pilot has the aircraft."""
    async for tick in control.ticks():
        if tick.elapsed >= seconds or control.is_paused:
            return
        control.send(Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0))


async def fly(aircraft: Aircraft) -> None:
    await aircraft.activate(CREDENTIALS)
    try:
        async with aircraft.control(stop="land", on_pause="wait") as control:
            await control.take_off()
            await control.climb_to(4.0)
            print("flying north; now the pilot may move the switch out of F")
            await fly_north(control, 10)
            if control.is_paused:
                await asyncio.sleep(0.1)  # the notification does not say who; telemetry does
                print(f"the pilot has it: {aircraft.authority.reason}; waiting")
                await control.wait_resumable()
                print("back in F: flying on, because this program wants to")
                control.resume()
                await fly_north(control, 3)
            await control.stop()
            await control.land()
            print("landed")
    except AuthorityLost as error:
        print(f"lost for good: {error}")  # the app took it, or the link is gone


@asynccontextmanager
async def with_virtual_pilot() -> AsyncIterator[Aircraft]:
    """A virtual aircraft whose pilot leaves F after 12 s and returns 4 s later."""
    virtual = VirtualAircraft(seed=1)
    driver = Driver(virtual)
    link = Link()
    driver.connect(link)
    await link.wait_connected()
    asyncio.get_running_loop().call_later(12, virtual.leave_f)
    asyncio.get_running_loop().call_later(16, virtual.return_to_f)
    try:
        async with m100link.connect(link) as aircraft:
            yield aircraft
    finally:
        driver.stop()


async def main(url: str | None = None) -> None:
    async with m100link.connect(url) if url else with_virtual_pilot() as aircraft:
        await fly(aircraft)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:2]))
