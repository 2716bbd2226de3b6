"""Calls of the library raise what their docstrings say, in drawn states of the aircraft."""

from __future__ import annotations

import inspect
import re
from asyncio import ensure_future, sleep, wait_for
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from random import Random
from typing import Any

import pytest

from m100link import (
    Aircraft,
    AircraftCamera,
    AircraftGimbal,
    Attitude,
    Control,
    MissionFlight,
    Setpoint,
    Target,
    Waypoint,
    WaypointPlan,
    connect,
    errors,
)
from m100link.protocol.commands.hotpoint import FollowTarget
from m100link.sim import LineFaults
from m100link.testing import ConnectableAircraft
from tests.rig import FIRMWARES, put_in_the_air

pytestmark = pytest.mark.anyio

CLASSES = (Control, Aircraft, AircraftGimbal, AircraftCamera, MissionFlight)
HERE = {"latitude_deg": 22.5431, "longitude_deg": 113.9589}
PLAN = WaypointPlan([Waypoint(22.5431, 113.9589, 10.0), Waypoint(22.5441, 113.9589, 10.0)])
NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)

# The method, and a call of it whose arguments are right.
Calls = dict[Any, Callable[[Any], Any]]

OF_AIRCRAFT: Calls = {
    Aircraft.push: lambda one: one.push(FollowTarget(0.39, 1.98, 20)),
    Aircraft.set_telemetry_rates: lambda one: one.set_telemetry_rates(attitude=50),
    Aircraft.release_authority: lambda one: one.release_authority(),
    Aircraft.download_waypoint_plan: lambda one: one.download_waypoint_plan(),
    Aircraft.collect: lambda one: one.collect(Attitude, seconds=0.5),
    Aircraft.wait_for: lambda one: one.wait_for(lambda _: False, timeout=0.5),
    Aircraft.virtual_rc: lambda one: one.virtual_rc().__aenter__(),
    AircraftGimbal.set_angles: lambda one: one.gimbal.set_angles(yaw=10.0, wait=True),
    AircraftGimbal.set_angular_rates: lambda one: one.gimbal.set_angular_rates(yaw=9.0, seconds=1),
    AircraftCamera.take_photo: lambda one: one.camera.take_photo(),
    AircraftCamera.start_video: lambda one: one.camera.start_video(),
    Control.obtain: lambda one: one.control().obtain(),
}

OF_CONTROL: Calls = {
    Control.take_off: lambda one: one.take_off(),
    Control.land: lambda one: one.land(),
    Control.go_home: lambda one: one.go_home(),
    Control.arm: lambda one: one.arm(),
    Control.disarm: lambda one: one.disarm(),
    Control.send: lambda one: one.send(NORTH),
    Control.hold: lambda one: one.hold(NORTH).__aenter__(),
    Control.fly_to: lambda one: one.fly_to(north=2.0, east=0.0, height=3.0),
    Control.climb_to: lambda one: one.climb_to(5.0),
    Control.turn_to: lambda one: one.turn_to(90.0),
    Control.fly_path: lambda one: one.fly_path([(5.0, 0.0, 3.0), (5.0, 5.0, 3.0)], speed=2.0),
    Control.orbit: lambda one: one.orbit(center_north=10.0, center_east=0.0),
    Control.stop_mission: lambda one: one.stop_mission(),
    Control.pause_mission: lambda one: one.pause_mission(),
    Control.resume_mission: lambda one: one.resume_mission(),
    Control.detach_mission: lambda one: one.detach_mission(),
    Control.waypoint_mission: lambda one: one.waypoint_mission(PLAN).__aenter__(),
    Control.hotpoint: lambda one: one.hotpoint(
        **HERE, radius=10.0, height=10.0, rate_deg_s=5.0
    ).__aenter__(),
    Control.follow_target: lambda one: one.follow_target(Target(22.5431, 113.9589)).__aenter__(),
}


def documented(method: Any, depth: int = 2) -> set[str]:
    """The errors that it names behind "Raises", with those of the methods that it refers to."""
    text = (inspect.getdoc(method) or "").partition("Raises")[2]
    found = set(re.findall(r"\b[A-Z]\w+", text)) & set(dir(errors))
    others = re.findall(r":meth:`[\w.]*?(\w+)`", text if text else inspect.getdoc(method) or "")
    if "aircraft.control()" in text:
        others.append("control")
    for name in others if depth else ():
        for kind in CLASSES:
            found |= documented(getattr(kind, name, None), depth - 1)
    return found


@asynccontextmanager
async def an_aircraft(firmware: str, state: str) -> AsyncIterator[Aircraft]:
    virtual = ConnectableAircraft(seed=1, firmware=firmware)
    if state in ("in the air", "without GPS"):
        put_in_the_air(virtual, 5.0)
    if state == "without GPS":
        virtual.gps_health = 0
    try:
        async with connect(await virtual.open_link()) as aircraft:
            if state != "not activated":
                await aircraft.activate(virtual.credentials)
            await sleep(2.0)  # until each item came
            if state == "closed":
                await aircraft.aclose()
            if state == "unplugged":
                virtual.unplug()
            if state == "unheard":
                virtual.set_faults(LineFaults(loss=1.0))
            yield aircraft
    finally:
        virtual.stop()


STATES = ("not activated", "on the ground", "without GPS", "closed", "unplugged", "unheard")
BLOCKS = ("not obtained", "on the ground", "in the air", "without GPS", "released")
CASES = [
    *((method, call, state) for method, call in OF_AIRCRAFT.items() for state in STATES),
    *((method, call, state) for method, call in OF_CONTROL.items() for state in BLOCKS),
]


async def raised(method: Any, call: Callable[[Any], Any], firmware: str, state: str) -> Any:
    """What the call raised, None for nothing."""
    async with AsyncExitStack() as stack:
        stack.enter_context(suppress(errors.LinkError))  # as the aircraft is left
        one: Any = await stack.enter_async_context(an_aircraft(firmware, state))
        if method in OF_CONTROL:
            one = one.control()
            if state != "not obtained":
                await one.obtain()
            if state == "released":
                await one.release()
        try:
            answer = call(one)
            if inspect.isawaitable(answer):
                # A task of its own: a block that is entered and never left would end this one.
                await wait_for(ensure_future(answer), 5.0)  # it flies: no error came
        except errors.M100Error as error:
            return error
        except TimeoutError:
            return None
    return None


async def judge(seed: int, draws: int) -> None:
    print(f"seed {seed}")  # noqa: T201 (pytest shows it when the test fails)
    random = Random(seed)
    wrong = []
    for method, call, state in random.sample(CASES, min(draws, len(CASES))):
        firmware = random.choice(FIRMWARES)
        error = await raised(method, call, firmware, state)
        names = {kind.__name__ for kind in type(error).__mro__}
        if error is not None and not names & documented(method):
            wrong.append(f"{method.__qualname__}, {state}, {firmware}: {error!r}")
    assert wrong == []


async def test_a_drawn_call_raises_what_its_docstring_says() -> None:
    await judge(Random().randrange(1 << 30), 5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
async def test_every_call_raises_what_its_docstring_says(seed: int) -> None:
    await judge(seed, len(CASES))


def test_every_method_names_the_errors_that_it_raises() -> None:
    silent = [one for one in (*OF_AIRCRAFT, *OF_CONTROL) if not documented(one)]
    assert silent == [Aircraft.release_authority]  # which logs a failure, as its docstring says
