"""All aircraft of a fleet take off, climb to heights of their own, and land."""

import asyncio
import sys

import m100link
from m100link.apps.fleet import Fleet, FleetAircraft, Result, connect


def tell(what: str, results: dict[str, Result]) -> list[str]:
    """Print what became of each; returns the names of those that did it."""
    for name, result in results.items():
        print(f"{what} {name}: {result}")
    return [name for name, result in results.items() if result.is_ok]


async def climb(aircraft: FleetAircraft, height: float) -> None:
    card = await aircraft.card()
    if card.latitude_deg is None or card.longitude_deg is None:
        raise m100link.UsageError(f"{aircraft.name} does not know where it is")
    async with aircraft.control() as control:
        await control.fly_to(
            latitude_deg=card.latitude_deg, longitude_deg=card.longitude_deg, height=height
        )


async def fly(fleet: Fleet) -> None:
    try:
        flying = tell("take-off", await fleet.each(lambda one: one.take_off()))
        heights = {name: 3.0 + number for number, name in enumerate(flying)}
        tell("climb", await fleet.each(lambda one: climb(one, heights[one.name]), flying))
    finally:
        tell("landing", await fleet.land())


async def main(*endpoints: str) -> None:
    async with connect(*endpoints) as fleet:
        await fly(fleet)


if __name__ == "__main__":
    asyncio.run(main(*(sys.argv[1:] or ["tcp/127.0.0.1:7447"])))
