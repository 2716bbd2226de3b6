"""The manual's table of endings, cell by cell: what the aircraft received last, and what it did.

On virtual time where the ending leaves the program able to act. What a guardian ends is flown by
``test_guardian.py``, each cell against an aircraft that shares no line with the library.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import math
import os
import signal
import sys
import time
import warnings
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from m100link import FlightPhase, LinkLost, Waypoint, WaypointPlan
from m100link.flight.stop_path import StopAction
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Device
from tests.attacks.endings import Draw, end_a_process
from tests.flight import foreign_aircraft as foreign
from tests.flight import guarded_program, test_guardian
from tests.flight.foreign_aircraft import foreign_aircraft
from tests.flight.test_signals import acted, come  # noqa: F401 - a fixture
from tests.rig import NORTH, Rig, rig
from tests.waiting import PATIENCE, blocking_until

if TYPE_CHECKING:
    import endings
else:  # of the manual, which is not a package
    _PLACE = Path(__file__).parents[2] / "docs" / "_ext" / "endings.py"
    _SPEC = importlib.util.spec_from_file_location("endings", _PLACE)
    endings = importlib.util.module_from_spec(_SPEC)
    sys.modules["endings"] = endings
    _SPEC.loader.exec_module(endings)

Ending = endings.Ending
# How test_guardian.py ends a program that cannot act any more.
BY_GUARDIAN = {
    Ending.HANG: {"sleep", "gil"},
    Ending.STOPPED: {"stopped"},
    Ending.KILL: {"kill", "fork", "descriptors", "disk", "SIGKILL"},
    Ending.CRASH: {"segv", "memory", "exit", "execv"},
}
# In processes of their own.
LOST = {
    Ending.FALLS_OFF: [("fall", "nothing")],
    Ending.OUT_OF_RESOURCES: [("raise", "table"), ("SIGTERM", "sealed"), ("SIGHUP", "log")],
}
KEEPING_THE_PROCESS = [one for one in Ending if one not in {*BY_GUARDIAN, Ending.UNGUARDED, *LOST}]
SIGNALS = {
    Ending.CTRL_C: [signal.SIGINT],
    Ending.CTRL_C_TWICE: [signal.SIGINT] * 2,
    Ending.CTRL_C_THRICE: [signal.SIGINT] * 3,
    Ending.SIGTERM: [signal.SIGTERM],
    Ending.SIGHUP: [signal.SIGHUP],
    Ending.SIGQUIT: [signal.SIGQUIT],
    Ending.SIGXCPU: [signal.SIGXCPU],
}


def expected(ending: endings.Ending, mode: str) -> endings.Outcome:
    return endings.ENDINGS[ending][endings.MODES.index(mode)]


def test_every_ending_has_its_row() -> None:
    assert set(endings.ENDINGS) == set(Ending)
    assert {len(row) for row in endings.ENDINGS.values()} == {len(endings.MODES)}


# -- the process lives on, or has time to act -----------------------------------------------------


def long_way(flown: Rig) -> WaypointPlan:
    """A minute of flight to the north."""
    position = flown.aircraft.state.position
    assert position is not None
    here = LocalFrame(position.latitude_deg, position.longitude_deg)
    corners = ((5.0, 0.0), (150.0, 0.0), (0.0, 0.0))
    return WaypointPlan([Waypoint(*here.to_geodetic(*one), height=10.0) for one in corners])


async def program(flown: Rig, mode: str) -> AsyncGenerator[None]:
    """Flies north, and comes by every so often."""
    stop: StopAction = "land" if mode == "land" else "hover"
    async with flown.aircraft.control(stop=stop) as control:
        if mode == "mission":
            async with control.waypoint_mission(long_way(flown), take_off=True):
                while True:
                    yield
                    await asyncio.sleep(0.02)
        await control.take_off()
        async for _ in control.ticks():
            control.send(NORTH)
            yield


async def run_to(flying: AsyncGenerator[None], seconds: float) -> None:
    """Consume it for so long."""
    loop = asyncio.get_running_loop()
    end = loop.time() + seconds
    async for _ in flying:
        if loop.time() >= end:
            return


async def end_inside(ending: endings.Ending, flown: Rig, mode: str, seconds: float) -> None:
    """End the program from within, after so long, and wait until it has done what it could."""
    flying = program(flown, mode)
    await run_to(flying, seconds)
    if ending is Ending.COLLECTED:
        del flying
        gc.collect()
        await asyncio.sleep(20.0)
        return
    error = SystemExit(1) if ending is Ending.EXIT else ZeroDivisionError()
    with pytest.raises(type(error)):
        await flying.athrow(error)


def fork() -> None:
    """Have a child, and see it end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


async def end_outside(ending: endings.Ending, flown: Rig, task: asyncio.Task[None]) -> None:
    """Let something happen to a program that flies."""
    if ending is Ending.FORK:
        fork()
        await asyncio.sleep(2.0)
        return
    if ending is Ending.CANCELLATION:
        task.cancel()
    elif ending is Ending.UNPLUGGED:
        flown.virtual.unplug()
    for number in SIGNALS.get(ending, ()):
        come(number)
        await asyncio.sleep(0.005)  # all of them before the stop path has ended
    await asyncio.wait([task])
    assert task.cancelled() or isinstance(task.exception(), LinkLost)


async def assert_is(outcome: endings.Outcome, flown: Rig) -> None:
    running = flown.virtual.vehicle.missions.running
    if outcome in (endings.HOVERS, endings.STOPS):
        assert flown.is_released
        assert running is None
        if outcome is endings.HOVERS:
            flown.assert_stopped_in_order()
        await flown.assert_hovers(within=6.0)
    elif outcome is endings.LANDS:
        assert flown.is_released
        assert flown.virtual.height == 0.0
        assert not flown.is_running
    else:
        assert flown.device is Device.ONBOARD
        assert flown.phase is FlightPhase.IN_AIR
        if outcome is endings.SILENCE:
            assert not flown.is_neutral(flown.moves[-1])
            await flown.assert_hovers()
        else:
            before = flown.virtual.position
            if outcome is endings.FLIES_ON:
                await asyncio.sleep(5.0)
                assert running is not None
                assert math.dist(before, flown.virtual.position) > 3.0
            else:
                assert flown.speed > 1.0


@pytest.mark.anyio
@pytest.mark.parametrize("mode", endings.MODES)
@pytest.mark.parametrize("ending", KEEPING_THE_PROCESS, ids=lambda one: one.name.lower())
async def test_what_becomes_of_the_aircraft(
    ending: endings.Ending,
    mode: str,
    acted: list[signal.Signals],  # noqa: F811 - the fixture
) -> None:
    async with rig(firmware="3.1") as flown:
        seconds = 25.0 if mode == "mission" else 8.0
        task: asyncio.Task[None] | None = None
        if ending in (Ending.EXCEPTION, Ending.EXIT, Ending.COLLECTED):
            await end_inside(ending, flown, mode, seconds)
        else:
            task = asyncio.create_task(run_to(program(flown, mode), math.inf))
            await asyncio.sleep(seconds)
            await end_outside(ending, flown, task)
        await assert_is(expected(ending, mode), flown)
        assert acted == SIGNALS.get(ending, [])[:1], "the signal acts once, behind the stop path"
        if task is not None:
            task.cancel()
            await asyncio.wait([task])


# -- it is alone with what it had before ----------------------------------------------------------


@pytest.mark.pty
@pytest.mark.parametrize("mode", endings.MODES)
@pytest.mark.parametrize(
    ("ending", "way", "loss"),
    [(ending, *one) for ending, ways in LOST.items() for one in ways],
    ids=lambda one: one.name.lower() if isinstance(one, Ending) else one,
)
def test_a_process_that_gets_nothing_more_of_the_system(
    ending: endings.Ending, way: str, loss: str, mode: str
) -> None:
    assert expected(ending, mode) in endings.IN_ORDER
    assert end_a_process(Draw(mode, way, loss)) == []


# -- the process is gone, or as good as gone ------------------------------------------------------


def test_every_ending_that_a_guardian_answers_for_is_flown() -> None:
    flown = {*guarded_program.ENDS, *test_guardian.FROM_OUTSIDE}
    assert set().union(*BY_GUARDIAN.values()) | {"SIGQUIT"} == flown
    assert test_guardian.MODES == endings.MODES
    for ending in BY_GUARDIAN:
        assert endings.ENDINGS[ending] is endings.BY_GUARDIAN


@pytest.mark.pty
@pytest.mark.parametrize("mode", ["hover", "land"])
def test_a_process_that_nobody_guards(mode: str) -> None:
    with foreign_aircraft("3.1") as there, test_guardian.flown(there, mode, "unguarded") as process:
        process.kill()
        process.wait(timeout=PATIENCE)
        time.sleep(1.0)
        assert expected(Ending.UNGUARDED, mode) is endings.SILENCE
        assert there.movements[-1].values[0] == 2.0
        assert there.device == foreign.ONBOARD
        assert there.tasks == []


@pytest.mark.pty
def test_a_mission_whose_process_nobody_guards() -> None:
    assert expected(Ending.UNGUARDED, "mission") is endings.FLIES_ON
    with foreign_aircraft("3.1") as there:
        with test_guardian.flown(there, "mission", "unguarded") as process:
            process.kill()
            process.wait(timeout=PATIENCE)
            flown, orders = there.missions.flown_m, len(there.missions.orders)
            blocking_until(lambda: there.missions.flown_m > flown + 0.5)
            assert len(there.missions.orders) == orders, "nobody ordered anything"
