"""A flight by MAVSDK's own library: python mavsdk_native_flights.py SYSTEMS PORT.

All systems are seen on one port; the last one flies, the others stay on the ground.
"""

from __future__ import annotations

import asyncio
import sys
from importlib import import_module
from typing import Any

native: Any = import_module("mavsdk.asyncio")
action: Any = import_module("mavsdk.asyncio.plugins.action")
telemetry: Any = import_module("mavsdk.asyncio.plugins.telemetry")


async def main(count: str, port: str) -> None:
    configuration = native.Configuration.create_with_component_type(
        native.ComponentType.GROUND_STATION
    )
    async with native.Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        systems: list[Any] = []
        while len(systems) < int(count):
            await asyncio.sleep(0.2)
            systems = await mavsdk.get_systems()
        by_number = {await one.get_system_id(): one for one in systems}
        print("systems", sorted(by_number))
        flying = by_number[max(by_number)]
        told = telemetry.TelemetryAsync(flying)
        while not (await told.health()).is_home_position_ok:
            await asyncio.sleep(0.2)
        fly = action.ActionAsync(flying)
        await fly.arm()
        await fly.takeoff()
        while (await told.position()).relative_altitude_m < 2.0:
            await asyncio.sleep(0.1)
        assert await told.armed()
        for number, one in by_number.items():
            if one is not flying:
                assert not await telemetry.TelemetryAsync(one).armed(), number
        await fly.return_to_launch()
        while await told.armed():
            await asyncio.sleep(0.2)
        print("native: done")


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
