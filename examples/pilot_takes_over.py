"""What a program sees when the pilot takes the aircraft away from it.

The pilot is played by the virtual aircraft: two seconds after take-off he moves the
mode switch to P.
The clock is virtual too, so the whole flight takes a moment.
"""

import asyncio

from m100link import Aircraft, AuthorityLost, Setpoint
from m100link.link import Link
from m100link.sim import Driver, VirtualAircraft
from m100link.sim.clock import virtual_clock_loop


async def main() -> None:
    virtual = VirtualAircraft(seed=1)
    driver = Driver(virtual)
    link = Link()
    driver.connect(link)
    await link.wait_connected()
    aircraft = Aircraft()
    await aircraft.attach(link)
    await aircraft.activate(virtual.credentials)
    try:
        async with aircraft.control() as control:
            await control.take_off()
            asyncio.get_running_loop().call_later(2.0, virtual.leave_f)
            async for _ in control.ticks():
                control.send(Setpoint.tilt(roll_deg=0, pitch_deg=-5, up=0, yaw_deg=0))
    except AuthorityLost as error:
        print(f"after {virtual.autopilot.time:.1f} s: {error}")
    print(f"setpoints received: {virtual.autopilot.counters.movements}, then none")
    await aircraft.aclose()
    driver.stop()


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(main())
