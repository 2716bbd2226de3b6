"""Missions that the aircraft flies by itself, and stations that want another thing meanwhile."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import anyio
import pytest

from m100link.apps.agent import client as view
from m100link.apps.mavlink.translator.numbers import MavCommand, MavResult, MissionType
from m100link.apps.mavlink.translator.vehicle_state import Mode
from m100link.sim.line import LineFaults
from m100link.sim.vehicle.missions.route import MissionSettings
from m100link.sim.vehicle.settings import AircraftSettings
from tests.apps.agent.conftest import has_begun, hears_late, task_of
from tests.apps.mavlink.conftest import Ground, Rig
from tests.apps.mavlink.translator.test_missions import SQUARE, Exchange, Item, item, waypoint

pytestmark = pytest.mark.anyio

FAR = [waypoint(40.0, 0.1), waypoint(40.0, 40.0), waypoint(60.0, 40.0)]


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with Rig(firmware="3.1").running() as one:
        yield one


def mission(rig: Rig) -> dict[str, Any]:
    """The truth: what the aircraft flies by itself, or flew last."""
    return rig.aircraft.vehicle.missions.summary() or {"doing": "nothing", "is_paused": False}


def flies_itself(rig: Rig) -> bool:
    return rig.aircraft.vehicle.missions.running is not None


def reached(ground: Ground) -> list[int]:
    return [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")]


async def begin(rig: Rig, ground: Ground, items: list[Item]) -> None:
    """Upload, take off, and wait until the aircraft flies it by itself, fast."""
    assert await Exchange(ground).upload(items) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: flies_itself(rig) and rig.speed > 3.0)
    assert ground.mode is Mode.MISSION


async def assert_hovers(rig: Rig, after: float = 4.0) -> None:
    await anyio.sleep(after)
    before, height = rig.aircraft.position, rig.height
    await anyio.sleep(5.0)
    assert math.dist(before, rig.aircraft.position) < 0.3
    assert rig.height == pytest.approx(height, abs=0.3)
    assert rig.height > 2.0


async def test_the_aircraft_flies_it_and_says_so(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, SQUARE)
    assert "the aircraft flies it by itself" in ground.texts
    assert mission(rig)["waypoints"] == 3
    assert ground.last("MISSION_CURRENT")["seq"] == 2
    await rig.until(lambda: ground.mode is Mode.RTL, within=120.0)
    assert rig.aircraft.vehicle.missions.arrivals == [0, 1, 2]
    assert reached(ground) == [2, 4, 5, 6]
    await rig.until(lambda: ground.last("MISSION_CURRENT")["mission_state"] == 5)
    await rig.until(lambda: not ground.armed(), within=120.0)
    assert not rig.motors_on
    await rig.until(lambda: not rig.client.holder.number)


async def test_it_lands_where_the_mission_says(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, [*FAR[:2], item(MavCommand.NAV_LAND, 44.0, 44.0)])
    await rig.until(lambda: ground.mode is Mode.LAND, within=120.0)
    await rig.until(lambda: not ground.armed(), within=60.0)
    assert rig.aircraft.position[:2] == pytest.approx((44.0, 44.0), abs=1.5)


async def test_it_hovers_behind_a_mission_without_an_end(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, FAR)
    await rig.until(lambda: ground.mode is Mode.HOLD, within=120.0)
    assert reached(ground) == [0, 1, 2]
    assert not flies_itself(rig)
    await assert_hovers(rig)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not ground.armed())


async def test_an_item_is_reached_when_its_time_is_over(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, [waypoint(20.0, 0.1, param1=40.0), waypoint(40.0, 0.1)])
    await rig.until(lambda: rig.speed < 0.1)
    await anyio.sleep(30.0)
    assert reached(ground) == []
    assert ground.last("MISSION_CURRENT")["seq"] == 0
    await rig.until(lambda: reached(ground) == [0], within=15.0)


async def test_speeds_of_items_are_flown(rig: Rig, ground: Ground) -> None:
    slower = item(MavCommand.DO_CHANGE_SPEED, param1=1.0, param2=2.0)
    await begin(rig, ground, [FAR[0], slower, *FAR[1:]])
    await rig.until(lambda: rig.speed > 4.0)
    await rig.until(lambda: reached(ground) == [0])
    await anyio.sleep(6.0)
    assert rig.speed == pytest.approx(2.0, abs=0.3)
    assert await ground.ask(MavCommand.DO_CHANGE_SPEED, 1, 6.0) is MavResult.ACCEPTED
    await anyio.sleep(3.0)
    assert rig.speed == pytest.approx(6.0, abs=0.5)


async def test_headings_of_items_are_flown_the_short_way(rig: Rig, ground: Ground) -> None:
    items = [waypoint(30.0, 0.1), waypoint(60.0, 0.1, param4=-90.0), waypoint(60.0, 20.0)]
    await begin(rig, ground, items)
    turns: list[float] = []
    await rig.until(
        lambda: (
            turns.append(rig.vehicle.world.yaw_deg or 0.0)  # type: ignore[func-returns-value]
            or reached(ground) == [0, 1, 2]
        )
    )
    assert turns[-1] == pytest.approx(-90.0, abs=5.0)
    assert max(turns) < 10.0, "counter-clockwise"


# -- hold, and on ---------------------------------------------------------------------------------


async def test_hold_pauses_it_and_mission_resumes_it(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, FAR)
    uploads = rig.agent.journal.events[-1].number
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await rig.until(lambda: ground.mode is Mode.HOLD)
    await assert_hovers(rig)
    assert mission(rig)["is_paused"]
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    assert await ground.ask(MavCommand.MISSION_START, 0, 0) is MavResult.ACCEPTED
    await rig.until(lambda: rig.speed > 3.0)
    assert not mission(rig)["is_paused"]
    assert ground.mode is Mode.MISSION
    assert not [
        one for one in rig.agent.journal.events if one.number > uploads and "uploaded" in one.text
    ]
    await rig.until(lambda: reached(ground) == [0, 1, 2], within=120.0)


async def test_a_station_that_presses_hold_and_mission_fast_gets_the_last(
    rig: Rig, ground: Ground
) -> None:
    await begin(rig, ground, FAR)
    for mode in (Mode.HOLD, Mode.MISSION, Mode.HOLD, Mode.MISSION, Mode.HOLD):
        assert await ground.set_mode(mode) is MavResult.ACCEPTED
    await assert_hovers(rig)
    for mode in (Mode.MISSION, Mode.HOLD, Mode.MISSION):
        assert await ground.set_mode(mode) is MavResult.ACCEPTED
    await rig.until(lambda: rig.speed > 3.0)


@pytest.mark.parametrize("wait", [0.0, 0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7])
async def test_hold_while_it_begins_is_a_hover(rig: Rig, ground: Ground, wait: float) -> None:
    assert await Exchange(ground).upload(FAR) == 0
    await ground.fly(8.0)
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await anyio.sleep(wait)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await assert_hovers(rig)
    assert ground.mode is Mode.HOLD
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: reached(ground) == [0, 1, 2], within=120.0)


@pytest.mark.parametrize("is_paused", [False, True])
async def test_another_item_is_flown_to_when_it_is_named(
    rig: Rig, ground: Ground, is_paused: bool
) -> None:
    await begin(rig, ground, FAR)
    if is_paused:
        assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    assert await ground.ask(MavCommand.DO_SET_MISSION_CURRENT, 1) is MavResult.ACCEPTED
    if is_paused:
        await assert_hovers(rig)
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: reached(ground) == [1, 2], within=120.0)


async def test_a_mission_that_was_changed_while_it_was_paused_begins(
    rig: Rig, ground: Ground
) -> None:
    await begin(rig, ground, FAR)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    assert await Exchange(ground).upload([waypoint(10.0, -20.0), waypoint(10.0, -30.0)]) == 0
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: reached(ground) == [0, 1], within=60.0)
    assert rig.aircraft.position[:2] == pytest.approx((10.0, -30.0), abs=1.5)


async def test_a_mission_that_was_cleared_while_it_was_paused_is_not_flown(
    rig: Rig, ground: Ground
) -> None:
    await begin(rig, ground, FAR)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    ground.send("MISSION_CLEAR_ALL", target_system=1)
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    await assert_hovers(rig)


# -- another thing is wanted ----------------------------------------------------------------------


def setpoint(ground: Ground, east: float) -> None:
    fields = {"coordinate_frame": 1, "type_mask": 0b1101_1100_0111, "vy": east}
    ground.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields)


@pytest.mark.parametrize("is_paused", [False, True])
@pytest.mark.parametrize("wanted", [Mode.LAND, Mode.RTL, Mode.OFFBOARD, Mode.GOTO, Mode.ORBIT])
async def test_its_stop_comes_before_whatever_is_wanted(
    rig: Rig, ground: Ground, wanted: Mode, is_paused: bool
) -> None:
    await begin(rig, ground, FAR)
    if is_paused:
        assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
        await anyio.sleep(3.0)
    before = rig.aircraft.position
    if wanted is Mode.OFFBOARD:
        setpoint(ground, -2.0)
        assert await ground.set_mode(wanted) is MavResult.ACCEPTED
        for _ in range(120):
            setpoint(ground, -2.0)
            await anyio.sleep(0.05)
        assert rig.aircraft.vehicle.flight.dynamics.velocity_east == pytest.approx(-2.0, abs=0.3)
        assert ground.mode is Mode.OFFBOARD
    elif wanted is Mode.GOTO:
        args = (-1, 1, 0, math.nan, math.nan, math.nan, rig.ground_altitude + 20.0)
        assert await ground.ask(MavCommand.DO_REPOSITION, *args) is MavResult.ACCEPTED
        await rig.until(lambda: abs(rig.height - 20.0) < 0.5)
        assert math.dist(before, rig.aircraft.position) < 15.0
    elif wanted is Mode.ORBIT:
        assert await ground.ask(MavCommand.DO_ORBIT, 10.0, 3.0) is MavResult.ACCEPTED
        await anyio.sleep(12.0)
        assert ground.mode is Mode.ORBIT
        assert rig.speed > 1.5
    else:
        assert await ground.set_mode(wanted) is MavResult.ACCEPTED
        await rig.until(lambda: ground.mode is wanted)
        await rig.until(lambda: not ground.armed(), within=90.0)
        assert not rig.motors_on
    assert not flies_itself(rig)
    assert reached(ground) == []


@pytest.mark.parametrize("then", [MavCommand.NAV_RETURN_TO_LAUNCH, MavCommand.NAV_LAND])
async def test_hold_ends_the_way_down_behind_it(rig: Rig, ground: Ground, then: MavCommand) -> None:
    await begin(rig, ground, [*FAR, item(then)])
    wanted = Mode.LAND if then is MavCommand.NAV_LAND else Mode.RTL
    await rig.until(lambda: ground.mode is wanted, within=120.0)
    await anyio.sleep(1.0)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await assert_hovers(rig)
    assert ground.mode is Mode.HOLD
    assert ground.armed()


@pytest.mark.parametrize("wanted", [Mode.HOLD, Mode.LAND])
@pytest.mark.parametrize("wait", [0.0, 0.05, 0.1, 0.15, 0.2, 0.3])
async def test_what_is_wanted_at_the_end_of_it_is_flown(
    rig: Rig, ground: Ground, wanted: Mode, wait: float
) -> None:
    """The aircraft turns home while nobody has heard of that yet."""
    await begin(rig, ground, [*FAR, item(MavCommand.NAV_RETURN_TO_LAUNCH)])
    await rig.until(lambda: rig.aircraft.vehicle.missions.arrivals[-1:] == [2], within=120.0)
    await anyio.sleep(0.3 + wait)
    assert await ground.set_mode(wanted) is MavResult.ACCEPTED
    if wanted is Mode.LAND:
        await rig.until(lambda: not ground.armed(), within=60.0)
        assert math.hypot(*rig.aircraft.position) > 50.0
    else:
        await assert_hovers(rig)
        assert ground.mode is Mode.HOLD


async def test_an_agent_that_was_not_heard_for_a_while_flies_on_nothing(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    await begin(rig, ground, FAR)
    with monkeypatch.context() as silent:
        silent.setattr(view, "MAX_SILENCE", -1.0)
        await anyio.sleep(0.5)
    await assert_hovers(rig)
    assert not flies_itself(rig)
    assert ground.mode is Mode.HOLD


async def test_land_ends_the_way_home_behind_it(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, [*FAR, item(MavCommand.NAV_RETURN_TO_LAUNCH)])
    await rig.until(lambda: ground.mode is Mode.RTL, within=120.0)
    await anyio.sleep(1.0)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not ground.armed(), within=60.0)
    assert math.hypot(*rig.aircraft.position[:2]) > 40.0


async def test_it_is_landed_where_the_line_loses_half_of_all(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, FAR)
    rig.aircraft.line.to_aircraft.faults = LineFaults(loss=0.5)
    assert await ground.set_mode(Mode.LAND) is MavResult.ACCEPTED
    await rig.until(lambda: not rig.motors_on, within=60.0)


async def test_a_fence_holds_it(rig: Rig, ground: Ground) -> None:
    fence = [item(5003, 0.1, 0.0, param1=30.0)]
    await begin(rig, ground, FAR)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    assert await Exchange(ground).upload(fence, MissionType.FENCE) == 0
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    await rig.until(lambda: "outside of the fence" in ground.texts)
    await assert_hovers(rig)


# -- nobody wants it any more ---------------------------------------------------------------------


@pytest.mark.parametrize("is_paused", [False, True])
async def test_a_ground_station_that_is_lost_stops_it(
    rig: Rig, ground: Ground, is_paused: bool
) -> None:
    await begin(rig, ground, FAR)
    if is_paused:
        assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    ground.is_silent = True
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    await assert_hovers(rig, after=7.0)
    assert not flies_itself(rig)
    assert other.mode is Mode.HOLD
    assert "is lost: hold" in other.texts
    assert await other.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: reached(other) == [0, 1, 2], within=120.0)


async def test_the_way_home_behind_it_goes_on_when_the_ground_station_is_lost(
    rig: Rig, ground: Ground
) -> None:
    await begin(rig, ground, [*FAR, item(MavCommand.NAV_RETURN_TO_LAUNCH)])
    await rig.until(lambda: ground.mode is Mode.RTL, within=120.0)
    ground.is_silent = True
    await rig.until(lambda: not rig.motors_on, within=90.0)


@pytest.mark.parametrize("seconds", [0.3, 3.0])
async def test_the_pilot_breaks_it_off_and_nothing_resumes_it(
    rig: Rig, ground: Ground, seconds: float
) -> None:
    await begin(rig, ground, FAR)
    rig.aircraft.vehicle.remote.set_mode("P")
    await anyio.sleep(seconds)
    rig.aircraft.vehicle.remote.set_mode("F")
    await assert_hovers(rig, after=6.0)
    assert not flies_itself(rig)
    assert ground.mode is Mode.HOLD
    assert ground.armed()


async def test_a_mission_that_waits_for_the_pilot_is_not_resumed_by_his_return() -> None:
    settings = AircraftSettings(missions=MissionSettings(leaving_f_pauses=True))
    async with Rig(firmware="3.1", settings=settings).running() as rig:
        ground = rig.ground
        await begin(rig, ground, FAR)
        rig.aircraft.vehicle.remote.set_mode("P")
        await anyio.sleep(3.0)
        rig.aircraft.vehicle.remote.set_mode("F")
        await assert_hovers(rig, after=6.0)
        setpoint(ground, -2.0)
        assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
        for _ in range(80):
            setpoint(ground, -2.0)
            await anyio.sleep(0.05)
        assert not flies_itself(rig)
        assert rig.aircraft.vehicle.flight.dynamics.velocity_east == pytest.approx(-2.0, abs=0.3)


@pytest.mark.parametrize("how", ["stop", "halt", "takes over"])
async def test_another_client_of_the_station_ends_it(rig: Rig, ground: Ground, how: str) -> None:
    await begin(rig, ground, FAR)
    if how == "takes over":
        offer = rig.agent.leases.ask_take_over("the console", rig.agent.now)
        rig.agent.leases.confirm(offer.token, rig.agent.now)
    elif how == "stop":
        await rig.agent.stop()
    else:
        rig.agent.hover("the console")
    await assert_hovers(rig)
    assert not flies_itself(rig)
    assert ground.mode is (Mode.POSCTL if how == "takes over" else Mode.HOLD)


async def test_a_bridge_that_ends_stops_it(rig: Rig, ground: Ground) -> None:
    await begin(rig, ground, FAR)
    rig.work.cancel()
    await assert_hovers(rig)
    assert not flies_itself(rig)


async def test_it_flies_on_without_its_cable_and_the_next_hold_ends_it(
    rig: Rig, ground: Ground
) -> None:
    await begin(rig, ground, FAR)
    rig.aircraft.unplug()
    await anyio.sleep(3.0)
    assert flies_itself(rig), "nobody is heard who could stop it"
    known = len(ground.all("HEARTBEAT"))
    await anyio.sleep(2.0)
    assert len(ground.all("HEARTBEAT")) == known, "the vehicle is silent"
    rig.aircraft.replug()
    await rig.until(lambda: len(ground.all("HEARTBEAT")) > known)
    assert flies_itself(rig)
    # The aircraft says ten times a second which mission it flies.
    await rig.until(lambda: ground.mode is Mode.MISSION, within=0.5)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await rig.until(lambda: not flies_itself(rig), within=10.0)
    await assert_hovers(rig)
    assert ground.mode is Mode.HOLD


@pytest.mark.parametrize("wanted", ["arm", Mode.LAND, Mode.RTL])
async def test_a_mission_of_somebody_who_is_gone_is_stopped_first(
    rig: Rig, ground: Ground, wanted: Mode | str
) -> None:
    await begin(rig, ground, FAR)
    rig.aircraft.unplug()
    await anyio.sleep(2.0)
    rig.aircraft.replug()
    known = len(ground.all("HEARTBEAT"))
    await rig.until(lambda: len(ground.all("HEARTBEAT")) > known)
    await rig.until(lambda: ground.mode is Mode.MISSION, within=0.5)
    if isinstance(wanted, str):
        await ground.arm()
        await rig.until(lambda: not flies_itself(rig), within=10.0)
        await assert_hovers(rig)
    else:
        assert await ground.set_mode(wanted) is MavResult.ACCEPTED
        await rig.until(lambda: not rig.motors_on, within=90.0)
    assert not flies_itself(rig)


# -- what the aircraft does not fly by itself -----------------------------------------------------


@pytest.mark.parametrize(
    ("items", "why"),
    [
        (FAR[:1], "a plan of 1 waypoint cannot be flown"),
        ([FAR[0], waypoint(40.5, 0.1), FAR[1]], "item 1 is 0.50 m from the one before it"),
        ([waypoint(20.0 + one, 3.0 * (one % 2)) for one in range(100)], "a plan of 100 waypoints"),
        ([waypoint(20.0, 0.1, param1=500.0), FAR[0]], "item 0: it hovers for 500 s"),
    ],
)
async def test_what_a_plan_cannot_say_is_flown_from_here_and_reported(
    rig: Rig, ground: Ground, items: list[Item], why: str
) -> None:
    assert await Exchange(ground).upload(items) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.speed > 2.0)
    assert not flies_itself(rig)
    assert f"flown from here, {why}" in ground.texts.replace("\n", "")
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await assert_hovers(rig)


async def test_a_mission_that_the_aircraft_refuses_is_a_hover_with_its_reason(
    rig: Rig, ground: Ground
) -> None:
    rig.aircraft.battery_percent = 29.5  # the aircraft wants 30, the agent what it takes and 20
    assert await Exchange(ground).upload(SQUARE) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: "Mission: the start of the waypoint mission" in ground.texts)
    await assert_hovers(rig)


async def test_a_battery_that_does_not_last_refuses_it_on_the_ground(
    rig: Rig, ground: Ground
) -> None:
    rig.aircraft.battery_percent = 22
    await anyio.sleep(2.0)
    assert await Exchange(ground).upload(SQUARE) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    await rig.until(lambda: "of a battery" in ground.texts.replace("\n", ""))
    assert rig.height < 0.1


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
async def test_older_firmware_has_its_missions_flown_from_here(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        assert await Exchange(rig.ground).upload(FAR) == 0
        await rig.ground.arm()
        assert await rig.ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
        await rig.until(lambda: rig.speed > 3.0)
        told = rig.ground.texts.replace("\n", "")
        assert f"flown from here, firmware {firmware} has no missions" in told


# -- STOP between two steps of one order -----------------------------------------------------------


@pytest.mark.parametrize(("late", "after"), [(0.0, 0.005), (0.0, 0.03), (0.05, 0.1), (0.2, 0.25)])
async def test_a_stop_before_the_way_home_has_begun_ends_it(late: float, after: float) -> None:
    """The stop of the mission is under way; the bridge hears of the STOP, or not yet."""
    async with Rig(firmware="3.1", late=late).running() as rig:
        await begin(rig, rig.ground, FAR)
        rig.ground.set_mode_now(Mode.RTL)
        await anyio.sleep(after)
        await rig.agent.stop()
        await assert_hovers(rig)


@pytest.mark.parametrize("after", [0.005, 0.04, 0.1])
@pytest.mark.parametrize("late", [0.0, 0.1])
async def test_a_stop_beside_the_one_that_ends_a_landing_is_not_taken_for_it(
    late: float, after: float
) -> None:
    """To go home, the bridge ends its landing by a STOP of its own."""
    async with Rig(firmware="3.1", late=late).running() as rig:
        await begin(rig, rig.ground, FAR)
        rig.ground.set_mode_now(Mode.LAND)
        await rig.until(lambda: task_of(rig.agent) == "land")
        rig.aircraft.set_faults(LineFaults(delay=0.05))  # authority takes a while to go back
        await anyio.sleep(0.5)
        rig.ground.set_mode_now(Mode.RTL)
        await anyio.sleep(after)
        await rig.agent.stop()
        await anyio.sleep(3.0)
        assert task_of(rig.agent) is None
        assert not has_begun(rig.agent, "go home")
        assert rig.speed < 0.5


async def test_a_stop_after_the_take_off_ends_the_climb_that_follows(rig: Rig) -> None:
    hears_late(rig.channels[1], 0.3)
    await rig.ground.arm()
    altitude = rig.ground_altitude + 20.0
    rig.ground.command(MavCommand.NAV_TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, altitude)
    await rig.until(lambda: task_of(rig.agent) is not None)
    await rig.until(lambda: task_of(rig.agent) is None)
    await anyio.sleep(0.15)
    await rig.agent.stop()
    assert rig.agent.holding.has_authority
    await anyio.sleep(6.0)
    assert rig.height < 2.0
    assert not has_begun(rig.agent, "change of height")


async def test_what_was_to_begin_at_arming_is_forgotten_at_a_stop(rig: Rig) -> None:
    ground = rig.ground
    assert await Exchange(ground).upload(FAR) == 0
    ground.set_mode_now(Mode.MISSION)
    await rig.until(lambda: ground.mode is Mode.MISSION)
    await rig.agent.stop()
    await anyio.sleep(0.5)
    if not ground.armed():
        await ground.arm()
    await anyio.sleep(6.0)
    assert not rig.motors_on


@pytest.mark.parametrize("after", [0.002, 0.03, 0.06, 0.09])
@pytest.mark.parametrize("late", [0.05, 0.1])
async def test_a_hold_from_before_a_stop_does_not_undo_it(late: float, after: float) -> None:
    """A program whose steps are commands of its own hears of the STOP by one refusal."""
    async with Rig(late=late).running() as rig:
        ground = rig.ground
        await ground.fly(5.0)
        await anyio.sleep(1.0)
        ground.set_mode_now(Mode.HOLD)
        await anyio.sleep(after)
        await rig.agent.stop()
        await anyio.sleep(1.0)

        def go_up() -> None:
            args = (-1, 1, 0, math.nan, math.nan, math.nan, rig.ground_altitude + 20.0)
            ground.command(MavCommand.DO_REPOSITION, *args)

        go_up()
        await anyio.sleep(3.0)
        assert rig.height == pytest.approx(5.0, abs=0.5)
        assert "STOP was pressed" in ground.texts
        go_up()
        await rig.until(lambda: rig.height > 10.0)


async def test_arming_from_before_a_stop_obtains_nothing(rig: Rig, ground: Ground) -> None:
    for after in (0.001, 0.002, 0.01):  # the bridge looks at its orders 50 times a second
        ground.command(MavCommand.COMPONENT_ARM_DISARM, 1)
        await anyio.sleep(after)
        await rig.agent.stop()
        await anyio.sleep(3.0)
        assert not rig.agent.holding.has_authority, f"STOP came {after} s behind it"
        assert not rig.client.holder.number
        assert "arm: STOP was pressed" in ground.texts
    await ground.arm()
