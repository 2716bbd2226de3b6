"""Hours in the air in wind, noise and loss: does a flight end for a contradiction that is none?

Each flight draws its weather, its line, its firmware and its rates by its seed, and flies whatever
moves on a virtual clock: ``python -m tests.soak.integrity --hours 24``. A false alarm is printed
with its seed; ``--seed`` begins there.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import sys
from collections import Counter
from random import Random
from typing import NamedTuple

from m100link import Control, Guards, Setpoint
from m100link.errors import (
    ComputerSuspended,
    M100Error,
    NavigationLost,
    SetpointsIgnored,
    TelemetryStalled,
)
from m100link.sim import (
    AircraftSettings,
    Airframe,
    AssistantSettings,
    LineFaults,
    VirtualClockEventLoop,
)
from m100link.testing import ConnectableAircraft

__all__ = ["Flown", "flown"]

FLIGHT_S = 600.0
ALARMS = (NavigationLost, SetpointsIgnored, ComputerSuspended)
_LIES = ("the clock of the aircraft", "telemetry comes")
_RATES: tuple[dict[str, int], ...] = (
    {},
    {},
    {"velocity": 50, "position": 50, "time": 50},
    {"velocity": 10, "position": 10},
    {"velocity": 1, "time": 1},
    {"velocity": 0},
    {"time": 0},
    {"time": 0, "velocity": 10, "position": 50},
    {"quaternion": 10},
)


class Flown(NamedTuple):
    """What became of some flights.

    Attributes:
        hours: In the air, simulated.
        legs: What was flown, by name.
        ended: Why flights ended that were no alarm, by the name of the error.
        alarms: Seed and words of each false alarm.
    """

    hours: float
    legs: Counter[str]
    ended: Counter[str]
    alarms: list[str]


def _velocity(chance: Random, speed: float) -> Setpoint:
    x, y = chance.uniform(-speed, speed), chance.uniform(-speed, speed)
    up = chance.choice([0.0, 0.0, chance.uniform(-2.0, 2.0)])
    turn = chance.choice([0.0, chance.uniform(-100.0, 100.0)])
    if chance.random() < 0.5:
        return Setpoint.velocity(north=x, east=y, up=up, yaw_rate_deg_s=turn)
    return Setpoint.velocity(forward=x, right=y, up=up, yaw_rate_deg_s=turn)


async def _by_hand(control: Control, chance: Random) -> None:
    """Setpoints that change at random; back towards the middle, and neither high nor low."""
    wanted = _velocity(chance, 7.0)
    changes_at = 0.0
    async for tick in control.ticks():
        if tick.elapsed > 20.0:
            return
        if tick.elapsed >= changes_at:
            wanted = _velocity(chance, chance.choice([1.0, 4.0, 7.0]))
            changes_at = tick.elapsed + chance.choice([0.1, 0.5, 2.0, 6.0])
        control.send(wanted)


async def _by_tilt(control: Control, chance: Random) -> None:
    for _ in range(4):
        roll, pitch = chance.uniform(-12.0, 12.0), chance.uniform(-12.0, 12.0)
        for sign in (1, -1):
            tilt = Setpoint.tilt(
                roll_deg=sign * roll, pitch_deg=sign * pitch, height=20.0, yaw_rate_deg_s=0.0
            )
            async for tick in control.ticks():
                if tick.elapsed > 2.0:
                    break
                control.send(tilt)


async def _leg(control: Control, chance: Random) -> str:
    """One thing to fly, and its name."""
    name = chance.choice(
        ["by_hand", "by_hand", "tilt", "fly_to", "fast", "path", "orbit", "turn", "climb", "hover"]
    )
    north, east = chance.uniform(-60.0, 60.0), chance.uniform(-60.0, 60.0)
    frame = control.local_frame()
    if name == "by_hand":
        await _by_hand(control, chance)
    elif name == "tilt":
        await _by_tilt(control, chance)
    elif name == "fly_to":
        await control.fly_to(north=north / 3, east=east / 3, height=20.0, timeout=60.0)
    elif name == "fast":
        await control.fly_to(north=north / 3, east=east / 3, height=20.0, speed=8.0, timeout=60.0)
    elif name == "path":
        points = [(chance.uniform(-25, 25), chance.uniform(-25, 25), 20.0) for _ in range(4)]
        await control.fly_path(points, speed=chance.uniform(1.0, 8.0), frame=frame, timeout=90.0)
    elif name == "orbit":
        await control.orbit(center_north=12.0, center_east=0.0, speed=chance.uniform(1.0, 6.0))
    elif name == "turn":
        await control.turn_to(chance.uniform(-180.0, 180.0))
    elif name == "climb":
        await control.climb_to(chance.uniform(10.0, 40.0))
    else:
        await asyncio.sleep(chance.uniform(1.0, 20.0))
    return name


async def _flight(seed: int, legs: Counter[str]) -> None:
    """Fly for ten minutes.

    Raises:
        M100Error: What ended it before.
    """
    chance = Random(seed)
    settings = AircraftSettings(
        wind_north=chance.uniform(-8.0, 8.0),
        wind_east=chance.uniform(-8.0, 8.0),
        gusts=chance.choice([0.0, 0.5, 1.5, 2.5]),
        noise=chance.choice([0.0, 1.0, 2.0]),
        vertical_down=chance.random() < 0.2,
        airframe=Airframe(hover_minutes=60.0),
    )
    faults = LineFaults(
        loss=chance.choice([0.0, 0.0, 0.05, 0.3]),
        damage=chance.choice([0.0, 0.02]),
        duplicate=chance.choice([0.0, 0.1]),
        delay=chance.choice([0.0, 0.1]),
        jitter=chance.choice([0.0, 0.05, 0.2]),
    )
    virtual = ConnectableAircraft(
        seed=seed,
        firmware=chance.choice(["1.0", "2.3", "3.1"]),
        settings=settings,
        assistant=AssistantSettings(rates_hz=chance.choice(_RATES)),
    )
    clock = asyncio.get_running_loop().time
    guards = Guards(envelope=None, battery_floor_percent=None)
    try:
        async with virtual.connect() as aircraft:
            await aircraft.activate(virtual.credentials)
            await asyncio.sleep(1.1)
            async with aircraft.control(guards=guards) as control:
                await control.take_off()
                await control.climb_to(20.0)
                virtual.set_faults(faults)
                ends_at = clock() + FLIGHT_S
                while clock() < ends_at:
                    legs[await _leg(control, chance)] += 1
                virtual.set_faults()
                await control.go_home()
    finally:
        virtual.stop()


def flown(hours: float, seed: int, *, told: bool = False) -> Flown:
    """Fly until so many hours are over, each flight by the next seed."""
    found = Flown(0.0, Counter(), Counter(), [])
    while found.hours < hours:
        with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
            try:
                runner.run(_flight(seed, found.legs))
            except ALARMS as error:
                found.alarms.append(f"seed {seed}: {type(error).__name__}: {error.seen}")
            except M100Error as error:
                # Of items at 10 Hz, five in a row are lost now and then; that is no lie.
                if isinstance(error, TelemetryStalled) and error.seen.startswith(_LIES):
                    found.alarms.append(f"seed {seed}: {error.seen}")
                found.ended[f"{type(error).__name__}: {error.seen[:24]}"] += 1
            found = found._replace(hours=found.hours + runner.get_loop().time() / 3600.0)
        if told:
            print(f"{found.hours:6.2f} h, seed {seed}: {len(found.alarms)} alarms", flush=True)  # noqa: T201
        seed += 1
    return found


def main() -> int:
    """Fly, and tell of false alarms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    logging.getLogger("m100link").setLevel(logging.CRITICAL)
    found = flown(options.hours, options.seed, told=True)
    for line in (f"{found.hours:.1f} h", f"{found.legs}", f"{found.ended}", *found.alarms):
        print(line)  # noqa: T201 (it is a program)
    return bool(found.alarms)


if __name__ == "__main__":
    sys.exit(main())
