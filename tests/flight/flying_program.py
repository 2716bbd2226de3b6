"""A program that flies, for ``test_processes.py``: python -m tests.flight.flying_program PORT STOP.

The aircraft is in the air already; it flies north for ever. Whatever it does when a signal comes
is the library's doing.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Literal

import m100link
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.waiting import PATIENCE


async def main(port: str, stop: str) -> None:
    credentials = m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY)
    north = m100link.Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    async with m100link.connect(port) as aircraft:
        await aircraft.activate(credentials)
        await aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
        # On a busy machine the test comes to look when it is far away.
        far = m100link.Guards(envelope=m100link.Envelope(max_radius_m=10_000.0))
        stopping: Literal["land", "hover"] = "land" if stop == "land" else "hover"
        async with aircraft.control(stop=stopping, guards=far) as control:
            is_told = False
            async for tick in control.ticks():
                control.send(north)
                if tick.index >= 25 and not is_told:  # those that came too late are left out
                    is_told = True
                    print("flying", flush=True)  # noqa: T201 (the test waits for it)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
