"""A program with a virtual RC, for ``test_virtual_rc_processes.py``: ... PORT.

The aircraft is in the air already; the stick is held forward for ever.
"""

from __future__ import annotations

import asyncio
import sys

import m100link
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY


async def main(port: str) -> None:
    credentials = m100link.Credentials(app_id=DEMO_APP_ID, key=DEMO_KEY)
    async with m100link.connect(port) as aircraft:
        await aircraft.activate(credentials)
        async with aircraft.virtual_rc() as rc:
            print("flying", flush=True)  # noqa: T201 (the test waits for it)
            await rc.hold(600.0, pitch=0.4)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
