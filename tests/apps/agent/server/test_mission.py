"""A plan in pieces, and the reports of its mission."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from random import Random

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.server.mission import push_of
from m100link.errors import M100Error, NotObserved
from m100link.flight.missions.events import (
    ActionsDone,
    Finished,
    MissionEvent,
    Paused,
    Reached,
    Started,
    Uploaded,
)
from m100link.flight.missions.mission_guard import MissionFlight
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.hotpoint import HotpointStart
from m100link.protocol.records import Device
from m100link.protocol.setpoint import Setpoint
from m100link.sim.line import NO_FAULTS, LineFaults
from tests.apps.agent.conftest import Rig, airborne, mission


@pytest.mark.parametrize(
    ("event", "push"),
    [
        (Uploaded(3, 300.4), (0, b"\x01\x2c\x01\0\0")),
        (Uploaded(3, None), (0, b"\x01\0\0\0\0")),
        (Reached(7), (2, b"\x07\x04\0\0\0")),
        (ActionsDone(7), (2, b"\x07\x06\0\0\0")),
        (Finished(), (1, bytes(5))),
        (Started(), None),
        (Paused(), None),
    ],
)
def test_what_djis_push_says_of_an_event(
    event: MissionEvent, push: tuple[int, bytes] | None
) -> None:
    assert push_of(event) == push


@pytest.mark.anyio
async def test_what_a_mission_reaches_is_reported_to_people() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        state = rig.agent.connection.require_aircraft().state.position
        assert state is not None
        frame = LocalFrame(state.latitude_deg, state.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 10.0)]
        await mission(rig, WaypointPlan(places, speed=5), begun=lambda: None)
        told = [event.text for event in rig.agent.journal.events]
        assert told[-4:] == [
            "a mission of 2 waypoints begins",
            "waypoint 0 reached",
            "waypoint 1 reached",
            "the mission of 2 waypoints is over",
        ]


@pytest.mark.anyio
async def test_a_hover_in_the_turn_of_the_loop_in_which_a_mission_is_asked_for_ends_it() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        state = rig.agent.connection.require_aircraft().state.position
        assert state is not None
        frame = LocalFrame(state.latitude_deg, state.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 10.0)]
        plan = WaypointPlan(places, speed=5)
        flying = rig.holding.require()
        asked = asyncio.create_task(flying.start_mission(plan, take_off=False))
        asyncio.get_running_loop().call_soon(flying.hover, "hover")
        with pytest.raises(NotObserved, match="stopped before it began"):
            await asyncio.wait_for(asked, 5.0)
        assert not flying.mission.is_flying
        flying.steer(Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0))


# -- a flight ends while the line is bad: nothing flies on ----------------------------------------

LOST = LineFaults(loss=1.0)
STILL_M_S = 0.6
"""It may drift as much while it brakes, and in the virtual wind."""


async def plan_flies(rig: Rig) -> None:
    here = rig.agent.connection.require_aircraft().state.position
    assert here is not None
    frame = LocalFrame(here.latitude_deg, here.longitude_deg)
    places = [Waypoint(*frame.to_geodetic(north, 0.0), height=6) for north in (5.0, 140.0)]
    await mission(rig, WaypointPlan(places, speed=2.0))


async def circle_flies(rig: Rig) -> None:
    here = rig.agent.connection.require_aircraft().state.position
    assert here is not None
    place = math.radians(here.latitude_deg), math.radians(here.longitude_deg)
    circle = HotpointStart(*place, altitude=10.0, radius=10.0, angular_rate=10.0)
    await rig.agent.ask(orders.StartHotpoint(circle), rig.token)


FLIGHTS = {"plan": plan_flies, "circle": circle_flies}
ENDS = ("STOP", "STOP again", "hover", "take-over", "lease", "release", "stop mission")
LINES = ("deaf", "mute", "both", "unplugged")


def spoil(rig: Rig, line: str) -> None:
    if line == "unplugged":
        rig.aircraft.unplug()
    else:
        to_host = NO_FAULTS if line == "deaf" else LOST
        rig.aircraft.set_faults(to_host, to_aircraft=NO_FAULTS if line == "mute" else LOST)


def mend(rig: Rig, line: str) -> None:
    if line == "unplugged":
        rig.aircraft.replug()
    else:
        rig.aircraft.set_faults()


async def end(rig: Rig, how: str) -> str:
    """Nobody wants it any more; returns what was answered."""
    agent = rig.agent
    try:
        if how.startswith("STOP"):
            await agent.ask(orders.Stop())
        elif how == "hover":
            agent.hover("somebody")
        elif how == "take-over":
            rig.renewing.cancel()
            offer = agent.leases.ask_take_over("the other", agent.now)
            rig.token = agent.leases.confirm(offer.token, agent.now).token
            rig.renewing = agent.background.spawn(rig._renew(), "renewal")
        elif how == "lease":
            rig.renewing.cancel()
            agent.leases.release(rig.token, agent.now)
        elif how == "release":
            await agent.ask(orders.Release(), rig.token)
        else:
            await agent.ask(orders.StopMission(), rig.token)
    except M100Error as error:
        return type(error).__name__
    return "ok"


@pytest.mark.anyio
@pytest.mark.parametrize("seed", range(8))
async def test_nothing_flies_on_behind_a_line_that_was_bad(seed: int) -> None:
    chance = Random(f"bad line {seed}")
    flight, how = chance.choice(list(FLIGHTS)), chance.choice(ENDS)
    line, bad_s = chance.choice(LINES), chance.uniform(0.2, 7.0)
    early_s = chance.uniform(0.0, min(1.5, bad_s))
    if line == "unplugged" and how in ("hover", "take-over", "release", "stop mission"):
        how = "STOP"  # these end what the agent flies, and it flies nothing any more
    draw = f"seed {seed}: {flight}, {how}, {line} for {bad_s:.1f} s, {early_s:.1f} s before"
    async with Rig(firmware="3.1").running() as rig:
        motion = rig.aircraft.vehicle.flight.dynamics
        await airborne(rig)
        await FLIGHTS[flight](rig)
        await asyncio.sleep(13.0)
        assert motion.speed > STILL_M_S, f"{draw}: it does not fly"
        spoil(rig, line)
        began_at = rig.agent.now
        await asyncio.sleep(early_s)
        answer = await end(rig, how)
        if how.startswith("STOP") and answer == "ok":
            await asyncio.sleep(3.0)
            assert motion.speed < STILL_M_S, f"{draw}: STOP is ok, and it flies"
        await asyncio.sleep(max(0.0, began_at + bad_s - rig.agent.now))
        mend(rig, line)
        if how == "STOP again":
            await asyncio.sleep(0.5)
            await end(rig, how)
        await asyncio.sleep(9.0)
        assert motion.speed < STILL_M_S, f"{draw}: it flies on; answered {answer}"
        with suppress(M100Error):
            await rig.agent.ask(orders.Stop())


@pytest.mark.anyio
async def test_a_stop_ends_the_way_home_whose_client_has_left() -> None:
    async with Rig(firmware="3.1").running() as rig:
        await airborne(rig)
        here = rig.agent.connection.require_aircraft().state.position
        assert here is not None
        frame = LocalFrame(here.latitude_deg, here.longitude_deg)
        places = [Waypoint(*frame.to_geodetic(north, 0.0), height=20) for north in (30.0, 60.0)]
        await mission(rig, WaypointPlan(places, speed=8.0, at_end=AtEnd.GO_HOME))
        await rig.until(lambda: rig.holding.require().mission.is_landing, within=60.0)
        rig.renewing.cancel()
        rig.agent.leases.release(rig.token, rig.agent.now)
        await asyncio.sleep(2.0)
        said = [event.text for event in rig.agent.journal.events]
        assert said[-1].startswith("control authority is kept"), "as the plan wants"
        assert rig.aircraft.vehicle.flight.dynamics.speed > 5.0
        await rig.agent.ask(orders.Stop())
        await asyncio.sleep(4.0)
        assert rig.aircraft.vehicle.flight.dynamics.speed < STILL_M_S
        assert rig.aircraft.vehicle.authority.device is Device.RC


@pytest.mark.anyio
@pytest.mark.parametrize("flight", FLIGHTS)
async def test_a_stop_that_the_aircraft_takes_and_does_not_carry_out_is_not_enough(
    flight: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ack says ok, and its pushes say that it flies on: control goes back, which ends that."""
    async with Rig(firmware="3.1").running() as rig:
        vehicle = rig.aircraft.vehicle
        await airborne(rig)
        await FLIGHTS[flight](rig)
        await asyncio.sleep(13.0)
        monkeypatch.setattr(vehicle.missions, "stop", lambda _: MissionCode.SUCCESS)
        assert vehicle.flight.dynamics.speed > STILL_M_S
        await rig.agent.ask(orders.Stop())
        await asyncio.sleep(2.0)
        assert vehicle.flight.dynamics.speed < STILL_M_S
        assert vehicle.authority.device is Device.RC


@pytest.mark.anyio
async def test_a_stop_for_which_no_memory_was_left_goes_out_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its first ones were not answered, and nobody else would stop it."""
    async with Rig(firmware="3.1").running() as rig:
        motion = rig.aircraft.vehicle.flight.dynamics
        await airborne(rig)
        await plan_flies(rig)
        await asyncio.sleep(13.0)
        assert motion.speed > STILL_M_S
        spoil(rig, "deaf")
        rig.agent.hover("somebody")
        flying = rig.agent.holding.flying
        await rig.until(lambda: flying is not None and flying.mission.stopping is not None)
        stop, lacking = MissionFlight.stop, [MemoryError()]

        async def lacks(flight: MissionFlight) -> None:
            if lacking:
                raise lacking.pop()
            await stop(flight)

        monkeypatch.setattr(MissionFlight, "stop", lacks)
        await asyncio.sleep(1.0)
        mend(rig, "deaf")
        await asyncio.sleep(9.0)
        assert not lacking
        assert motion.speed < STILL_M_S
