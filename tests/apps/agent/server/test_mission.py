"""A plan in pieces, and the reports of its mission."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from random import Random
from types import SimpleNamespace
from typing import Any, Self, cast

import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.messages import EventTopic
from m100link.apps.agent.server.mission import ActiveMission, push_of
from m100link.errors import M100Error, MissionRunning, NotObserved, UsageError
from m100link.flight.missions.events import (
    Aborted,
    ActionsDone,
    Finished,
    MissionEvent,
    Paused,
    Reached,
    Started,
    Stopped,
    Uploaded,
)
from m100link.flight.missions.mission_guard import MissionFlight
from m100link.geodesy import LocalFrame
from m100link.missions.plan import AtEnd, WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.control import Task
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


# -- how a mission ends, and what the agent says then: a mission that follows a script -------------


class Script(MissionFlight):
    """Begins, tells its events, and then ends well, badly, or not at all."""

    is_unstopped = False

    def __init__(self, *told: MissionEvent | M100Error | None, fails: M100Error | None) -> None:
        self.told, self.fails, self.stops = list(told), fails, 0

    async def _begin(self) -> None:
        """Nothing is sent."""

    async def __aenter__(self) -> Self:
        await asyncio.sleep(0.0)
        if self.fails is not None:
            raise self.fails
        return self

    async def __aexit__(self, *_: object) -> None:
        """The stop is that of the library."""

    async def __anext__(self) -> MissionEvent:
        if not self.told:
            raise StopAsyncIteration
        match self.told.pop(0):
            case None:
                await asyncio.sleep(math.inf)
            case M100Error() as error:
                raise error
            case event:
                return event
        raise AssertionError

    async def stop(self) -> None:
        self.stops += 1
        self.is_unstopped = self.stops < 3


class Journal:
    def __init__(self) -> None:
        self.notes = list[tuple[str, str]]()
        self.topics = list[EventTopic]()

    def note(self, text: str, level: str = "info", topic: EventTopic = EventTopic.NONE) -> None:
        self.notes.append((level, text))
        self.topics.append(topic)


ANY_FLIGHT: Any = MissionFlight
WHAT = "mission of 2 waypoints"
BEGINS = ("info", f"a {WHAT} begins")
LANDS, HOVERS = AtEnd.LAND, AtEnd.HOVER


def scripted(flight: Script) -> tuple[ActiveMission, Journal, SimpleNamespace]:
    control = SimpleNamespace(is_flying=True, unended_task=Task.TAKE_OFF)
    control.waypoint_mission = lambda plan, take_off: flight
    journal = Journal()
    return ActiveMission(cast(Any, control), cast(Any, journal), TaskSet()), journal, control


def of_two(at_end: AtEnd = HOVERS) -> WaypointPlan:
    places = [Waypoint(50.0, 8.0 + east, height=6) for east in (0.0, 1e-4)]
    return WaypointPlan(places, speed=5, at_end=at_end)


BROKEN = M100Error("it broke off")
HOW_ONE_ENDS: list[tuple[list[Any], AtEnd, str, str, list[tuple[str, str]]]] = [
    # What it tells (None: it waits), its end, what its client does, its outcome, and the journal.
    (
        [Reached(0), Finished()],
        HOVERS,
        "",
        "",
        [BEGINS, ("info", "waypoint 0 reached"), ("info", f"the {WHAT} is over")],
    ),
    (
        [Stopped()],
        HOVERS,
        "",
        f"the {WHAT} was stopped: its client stopped it",
        [BEGINS, ("info", f"the {WHAT} is over")],
    ),
    (
        [Aborted(None, "wind"), BROKEN],
        HOVERS,
        "",
        "it broke off",
        [
            BEGINS,
            ("warning", "the aircraft broke the mission off: wind"),
            ("error", f"the {WHAT} ended: it broke off"),
        ],
    ),
    (
        [None],
        LANDS,
        "end",
        f"the {WHAT} was stopped: STOP",
        [
            BEGINS,
            ("info", "the mission is stopped: STOP"),
            ("warning", f"the {WHAT} was stopped"),
        ],
    ),
    (
        [Finished(), None],
        LANDS,
        "end",
        f"the {WHAT} was stopped: STOP",
        [BEGINS, ("warning", f"the {WHAT} is left: the aircraft lands, as planned")],
    ),
    ([None], HOVERS, "cut off", f"the {WHAT} was stopped: control ended", [BEGINS]),
]


@pytest.mark.anyio
@pytest.mark.parametrize(("told", "at_end", "act", "outcome", "notes"), HOW_ONE_ENDS)
async def test_how_a_mission_ends_and_what_is_said(
    told: list[Any], at_end: AtEnd, act: str, outcome: str, notes: list[tuple[str, str]]
) -> None:
    one, journal, _ = scripted(Script(*told, fails=None))
    events = list[MissionEvent]()
    one.on_event = events.append
    over = await one.start(of_two(at_end))
    await asyncio.sleep(0.1)
    if act:
        assert one.is_flying
        with pytest.raises(MissionRunning, match="a setpoint was asked for"):
            one.require_none("a setpoint")
        is_landing = at_end is LANDS and isinstance(told[0], Finished)
        assert one.is_landing is is_landing
        assert one.task is (Task.LAND if is_landing else None)
        if act == "end":
            one.end("STOP")
        else:
            assert one.cut_off() == WHAT
        await one.ended()
    assert not one.is_flying
    one.require_none("a setpoint")
    assert str(getattr(over.exception(), "seen", "")) == outcome
    assert journal.notes == notes
    aborted = [EventTopic.MISSION_ABORTED] * (told[-1] is BROKEN)
    assert [topic for topic in journal.topics if topic is not EventTopic.NONE] == aborted
    assert events == [event for event in told if event is not None and event is not BROKEN]
    with pytest.raises(UsageError, match="no mission flies"):
        one.flight(ANY_FLIGHT)


@pytest.mark.anyio
async def test_one_that_could_not_begin_has_no_end_to_wait_for() -> None:
    one, journal, _ = scripted(Script(fails=M100Error("on the ground")))
    beginning = asyncio.create_task(one.start(of_two()))
    await asyncio.sleep(0.0)
    assert one.task == Task.TAKE_OFF
    with pytest.raises(UsageError, match="has not begun yet"):
        one.flight(ANY_FLIGHT)
    with pytest.raises(M100Error, match="on the ground"):
        await beginning
    assert not one.is_flying
    assert not one.task
    assert journal.notes == [("error", f"the {WHAT} ended: on the ground")]
    assert journal.topics == [EventTopic.NONE], "nothing that flew was broken off"


@pytest.mark.anyio
@pytest.mark.parametrize("ends", ["", "control", "left"])
async def test_a_stop_without_an_answer_goes_out_again_as_long_as_there_is_control(
    ends: str,
) -> None:
    flight = Script(None, fails=None)
    one, journal, control = scripted(flight)
    over = await one.start(of_two())
    flight.is_unstopped = True
    control.is_flying = ends != "control"
    if ends == "left":
        one.control_ended()
    else:
        one.end("STOP")
    await one.ended()
    why = "control ended" if ends == "left" else "STOP"
    assert f"may be flying on, its stop was not answered: {why}" in str(over.exception())
    assert journal.notes[-1] == ("error", f"the stop of the {WHAT} was not answered")
    assert one.is_flying is (not ends)
    await asyncio.sleep(3.0)
    assert flight.stops == (0 if ends else 3)
    assert not one.is_flying
    assert (journal.notes[-1] == ("warning", f"the {WHAT} was stopped")) is (not ends)


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
