"""Missions and fences: up, down, flown, broken off; with datagrams that are lost."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from functools import partial
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.agent.client import VehicleView
from m100link.apps.agent.server.connection import AircraftConnection
from m100link.apps.mavlink.translator.codec import MavlinkMessage
from m100link.apps.mavlink.translator.missions import read_fence
from m100link.apps.mavlink.translator.numbers import (
    MavCommand,
    MavResult,
    MissionResult,
    MissionType,
)
from m100link.apps.mavlink.translator.route import Refused
from m100link.apps.mavlink.translator.vehicle_state import MODES, Mode
from m100link.geodesy import LocalFrame, geodesic
from m100link.protocol.records import Position, Velocity
from m100link.sim.line import LineFaults
from tests.apps.mavlink.conftest import Ground, Rig

pytestmark = pytest.mark.anyio

Item = dict[str, Any]
TAKEOFF = 22.5431, 113.9589


def item(command: int, north: float = 0.0, east: float = 0.0, z: float = 0.0, **more: Any) -> Item:
    frame = LocalFrame(*TAKEOFF)
    latitude, longitude = frame.to_geodetic(north, east)
    place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)} if north or east else {}
    return {"command": command, "frame": 6, "z": z, "param4": math.nan} | place | more


def waypoint(north: float, east: float, z: float = 8.0, **more: Any) -> Item:
    return item(MavCommand.NAV_WAYPOINT, north, east, z, **more)


SQUARE = [
    item(MavCommand.NAV_TAKEOFF, z=6.0),
    item(MavCommand.DO_CHANGE_SPEED, param1=1.0, param2=4.0),
    waypoint(15.0, 0.0),
    item(2000, param1=0.0),
    waypoint(15.0, 15.0, param1=2.0),
    waypoint(0.1, 15.0),
    item(MavCommand.NAV_RETURN_TO_LAUNCH),
]


class Exchange:
    """A ground station's half of the protocol, over a line that loses datagrams."""

    def __init__(self, ground: Ground, *, loss: float = 0.0, seed: int = 1) -> None:
        self.ground, self.loss, self.random = ground, loss, Random(seed)
        self.read = len(ground.heard)

    def send(self, name: str, **fields: Any) -> None:
        if self.random.random() >= self.loss:
            self.ground.send(name, target_system=1, target_component=1, **fields)

    def heard(self, *names: str) -> Iterator[MavlinkMessage]:
        fresh, self.read = self.ground.heard[self.read :], len(self.ground.heard)
        for one in fresh:
            if one.name in names and self.random.random() >= self.loss:
                yield one

    async def upload(self, items: list[Item], kind: int = MissionType.MISSION) -> MissionResult:
        asked = -1
        with anyio.fail_after(200.0):
            self.send("MISSION_COUNT", count=len(items), mission_type=kind)
            while True:
                await anyio.sleep(0.05)
                fresh = list(self.heard("MISSION_ACK", "MISSION_REQUEST_INT"))
                for one in fresh:
                    if one.name == "MISSION_ACK":
                        return MissionResult(one["type"])
                    if one.name == "MISSION_REQUEST_INT":
                        asked = one["seq"]
                        self.send("MISSION_ITEM_INT", seq=asked, mission_type=kind, **items[asked])
                if not fresh and self.random.random() < 0.1:  # its own patience
                    if asked < 0:
                        self.send("MISSION_COUNT", count=len(items), mission_type=kind)
                    else:
                        self.send("MISSION_ITEM_INT", seq=asked, mission_type=kind, **items[asked])

    async def download(self, kind: int = MissionType.MISSION) -> list[MavlinkMessage]:
        found: list[MavlinkMessage] = []
        count = -1
        with anyio.fail_after(200.0):
            while count < 0:
                self.send("MISSION_REQUEST_LIST", mission_type=kind)
                await anyio.sleep(0.2)
                for one in self.heard("MISSION_COUNT"):
                    count = one["count"]
            while len(found) < count:
                self.send("MISSION_REQUEST_INT", seq=len(found), mission_type=kind)
                await anyio.sleep(0.1)
                for one in self.heard("MISSION_ITEM_INT"):
                    if one["seq"] == len(found):
                        found.append(one)
        return found


def same(found: MavlinkMessage, given: Item) -> bool:
    return all(
        found[name] == value or (math.isnan(value) and math.isnan(found[name]))
        for name, value in given.items()
    )


@pytest.mark.parametrize(("count", "loss"), [(3, 0.0), (200, 0.0), (40, 0.3)])
async def test_a_mission_comes_down_as_it_went_up(ground: Ground, count: int, loss: float) -> None:
    items = [waypoint(5.0 + place % 7, 3.0, 5.0 + place / 8) for place in range(count)]
    exchange = Exchange(ground, loss=loss)
    assert await exchange.upload(items) is MissionResult.ACCEPTED
    found = await exchange.download()
    assert [one["seq"] for one in found] == list(range(count))
    assert all(same(one, given) for one, given in zip(found, items, strict=True))


async def test_an_upload_that_breaks_off_changes_nothing(rig: Rig, ground: Ground) -> None:
    exchange = Exchange(ground)
    assert await exchange.upload([waypoint(5.0, 5.0), waypoint(9.0, 5.0)]) == 0
    exchange.send("MISSION_COUNT", count=50)
    exchange.send("MISSION_ITEM_INT", seq=0, **waypoint(1.0, 1.0))
    await rig.until(lambda: "broke off" in ground.texts, within=20.0)
    assert len(await Exchange(ground).download()) == 2


async def test_what_does_not_come_is_asked_for_again_four_times_a_second(
    rig: Rig, ground: Ground
) -> None:
    """As the protocol has it for items; after some seconds nobody is there any more."""
    exchange = Exchange(ground)
    exchange.send("MISSION_COUNT", count=2)
    await anyio.sleep(2.1)
    asked = list(exchange.heard("MISSION_REQUEST_INT", "MISSION_ACK"))
    assert {(one.name, one["seq"]) for one in asked} == {("MISSION_REQUEST_INT", 0)}
    assert 7 <= len(asked) <= 9
    await rig.until(lambda: bool(ground.all("MISSION_ACK")), within=8.0)
    assert MissionResult(ground.last("MISSION_ACK")["type"]) is MissionResult.OPERATION_CANCELLED
    ended = list(exchange.heard("MISSION_REQUEST_INT"))
    assert len(ended) >= 15
    await anyio.sleep(2.0)
    assert list(exchange.heard("MISSION_REQUEST_INT")) == []


@pytest.mark.parametrize("kind", [3, 7, 254])
async def test_a_list_of_a_kind_that_is_not_kept_is_refused(ground: Ground, kind: int) -> None:
    exchange = Exchange(ground)
    exchange.send("MISSION_COUNT", count=2, mission_type=kind)
    told = list(exchange.heard("MISSION_ACK"))
    assert [MissionResult(one["type"]) for one in told] == [MissionResult.UNSUPPORTED]
    assert {one["mission_type"] for one in told} == {kind}


async def test_of_two_uploads_at_a_time_the_last_that_is_whole_counts(
    rig: Rig, ground: Ground
) -> None:
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    first = Exchange(ground)
    first.send("MISSION_COUNT", count=2)
    assert await Exchange(other).upload([waypoint(5.0, 5.0)]) is MissionResult.ACCEPTED
    assert await first.upload([waypoint(15.0, 5.0)] * 2) is MissionResult.ACCEPTED
    assert len(await Exchange(other).download()) == 2


@pytest.mark.parametrize(
    ("given", "result"),
    [
        (item(MavCommand.DO_ORBIT, 5.0, 5.0, 5.0), MissionResult.UNSUPPORTED),
        (item(82, 5.0, 5.0, 5.0), MissionResult.UNSUPPORTED),
        (item(177, param1=0.0), MissionResult.UNSUPPORTED),
        (item(112, param1=5.0), MissionResult.UNSUPPORTED),
        (waypoint(5.0, 5.0, frame=10), MissionResult.UNSUPPORTED_FRAME),
        (waypoint(5.0, 5.0, -3.0), MissionResult.INVALID),
        (waypoint(5.0, 5.0, math.nan), MissionResult.INVALID),
        (waypoint(5.0, 5.0, param1=1e9), MissionResult.INVALID),
        (waypoint(5.0, 5.0, x=0, y=0), MissionResult.INVALID),
        (waypoint(5.0, 5.0, x=2_000_000_000), MissionResult.INVALID),
        (item(MavCommand.NAV_TAKEOFF, z=5.0), MissionResult.INVALID),
        (item(MavCommand.DO_CHANGE_SPEED, param2=30.0), MissionResult.INVALID),
    ],
)
async def test_what_is_not_flown_is_refused_with_its_item(
    rig: Rig, ground: Ground, given: Item, result: MissionResult
) -> None:
    found = await Exchange(ground).upload([waypoint(5.0, 0.1), given, waypoint(9.0, 0.1)])
    assert found is result
    await rig.until(lambda: "mission refused: item 1" in ground.texts)
    assert await Exchange(ground).download() == []


async def test_a_mission_that_does_not_fit_has_no_space(ground: Ground) -> None:
    ground.send("MISSION_COUNT", count=60000, target_system=1)
    assert ground.last("MISSION_ACK")["type"] == MissionResult.NO_SPACE


async def test_what_is_left_out_is_named(rig: Rig, ground: Ground) -> None:
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    await rig.until(lambda: "without effect: IMAGE_START_CAPTURE" in ground.texts)


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
async def test_a_mission_is_flown_from_the_ground_to_the_ground(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
        await rig.until(lambda: ground.mode is Mode.MISSION)
        assert rig.height < 0.1
        await ground.arm()
        away: list[float] = []
        await rig.until(
            lambda: (
                away.append(math.hypot(*rig.aircraft.position))  # type: ignore[func-returns-value]
                or ground.mode is Mode.RTL
            ),
            within=120.0,
        )
        assert max(away) == pytest.approx(21.2, abs=2.0)
        reached = [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")]
        assert reached == [2, 4, 5, 6]
        assert ground.last("MISSION_CURRENT")["total"] == 7
        await rig.until(lambda: not ground.armed(), within=120.0)
        assert math.hypot(*rig.aircraft.position) < 20.0


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
async def test_a_circle_and_a_heading_of_a_mission_are_flown_by_the_agent(firmware: str) -> None:
    mission = [
        item(MavCommand.NAV_TAKEOFF, z=6.0),
        waypoint(10.0, 0.0),
        item(MavCommand.CONDITION_YAW, param1=90.0, param4=0.0),
        item(MavCommand.NAV_LOITER_TURNS, 25.0, 0.0, z=8.0, param1=1.0, param3=5.0),
        item(MavCommand.NAV_LAND),
    ]
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        assert await Exchange(ground).upload(mission) is MissionResult.ACCEPTED
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
        await ground.arm()
        reached: list[tuple[int, float]] = []  # with the heading of the truth, °
        distances: list[float] = []  # from the centre, m, once it is on the circle

        def is_down() -> bool:
            known = [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")]
            yaw = math.degrees(rig.aircraft.vehicle.flight.dynamics.yaw)
            reached.extend((number, yaw) for number in known[len(reached) :])
            north, east = rig.aircraft.position
            away = math.hypot(north - 25.0, east)
            if ground.last("MISSION_CURRENT")["seq"] == 3 and (distances or abs(away - 5.0) < 0.3):
                distances.append(away)
            return not ground.armed() and len(reached) > 3

        await rig.until(is_down, within=180.0)
        assert [number for number, _ in reached] == [1, 2, 3, 4]
        assert reached[1][1] == pytest.approx(90.0, abs=3.0)
        assert min(distances[:1200]) > 4.0
        assert max(distances[:1200]) < 6.0
        assert len(distances) * 0.01 > 0.8 * math.tau * 5.0 / math.sqrt(5.0), "a whole turn"
        if firmware == "3.1":
            assert "flown from here, item 3: it is a circle" in ground.texts.replace("\n", "")


async def test_hold_pauses_a_mission_and_it_goes_on(rig: Rig, ground: Ground) -> None:
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    await ground.arm()
    assert await ground.ask(MavCommand.MISSION_START, 0, 0) is MavResult.ACCEPTED
    await rig.until(lambda: [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")] == [2])
    await anyio.sleep(1.0)
    assert await ground.set_mode(Mode.HOLD) is MavResult.ACCEPTED
    await anyio.sleep(4.0)
    assert rig.speed < 0.1
    assert ground.last("MISSION_CURRENT")["seq"] == 4
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: ground.mode is Mode.RTL, within=120.0)
    assert [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")] == [2, 4, 5, 6]


async def test_a_mission_goes_on_from_the_item_that_is_named(rig: Rig, ground: Ground) -> None:
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    ground.send("MISSION_SET_CURRENT", seq=5, target_system=1, target_component=1)
    assert ground.last("MISSION_CURRENT")["seq"] == 5
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: ground.mode is Mode.RTL, within=60.0)
    assert [one["seq"] for one in ground.all("MISSION_ITEM_REACHED")] == [5, 6]


async def test_a_mission_whose_ground_station_is_lost_holds(rig: Rig, ground: Ground) -> None:
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.speed > 2.0)
    ground.is_silent = True
    await anyio.sleep(7.0)
    assert rig.speed < 0.1
    assert rig.height > 3.0


TAKE_OFF = item(MavCommand.NAV_TAKEOFF, z=60.0)


@pytest.mark.parametrize(
    ("items", "why"),
    [
        (
            [waypoint(15.0, 0.1), waypoint(600.0, 0.1)],
            r"item 1, NAV_WAYPOINT \(16\): 600 m from the start was refused: .* 150 m; --max-r",
        ),
        (
            [waypoint(15.0, 0.1), waypoint(15.0, 9.0, z=51.0)],
            r"item 1, NAV_W.*: a height of 51.0 m .* 50 m",
        ),
        ([TAKE_OFF, waypoint(15.0, 0.1)], "take-off: .* 50 m"),
    ],
)
async def test_a_mission_beyond_the_envelope_is_refused_at_its_upload(
    rig: Rig, ground: Ground, items: list[Item], why: str
) -> None:
    """At its start is too late: the ground station has said "uploaded"."""
    assert await Exchange(ground).upload(SQUARE) == 0
    assert await Exchange(ground).upload(items) is MissionResult.INVALID
    await rig.until(lambda: bool(re.search(why, ground.texts.replace("\n", ""))))
    assert len(rig.vehicle._missions.items) == len(SQUARE), "the one before stays"


async def test_a_mission_beyond_the_envelope_is_denied_when_it_is_to_begin(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fitted the envelope from where the aircraft stood at its upload."""
    monkeypatch.setattr(rig.vehicle._missions, "_refusal_of", lambda _: "")
    assert await Exchange(ground).upload([waypoint(15.0, 0.1), waypoint(600.0, 0.1)]) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    await rig.until(lambda: "the envelope ends at 150 m" in ground.texts.replace("\n", ""))
    assert rig.height < 0.1


async def test_a_mission_that_flies_is_not_changed(rig: Rig, ground: Ground) -> None:
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
    await rig.until(lambda: rig.height > 3.0)
    assert await Exchange(ground).upload(SQUARE) is MissionResult.DENIED
    ground.send("MISSION_CLEAR_ALL", target_system=1)
    assert ground.last("MISSION_ACK")["type"] == MissionResult.DENIED


async def test_without_a_mission_there_is_none_to_fly(rig: Rig, ground: Ground) -> None:
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    assert await Exchange(ground).upload(SQUARE) is MissionResult.ACCEPTED
    ground.send("MISSION_CLEAR_ALL", target_system=1, mission_type=255)
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED


async def test_how_far_a_mission_is_has_the_numbers_of_the_definition(
    rig: Rig, ground: Ground
) -> None:
    """MISSION_STATE: none 1, not started 2, active 3, paused 4, complete 5."""

    async def told() -> tuple[int, int, int]:
        await anyio.sleep(1.1)
        found = ground.last("MISSION_CURRENT")
        return found["mission_state"], found["seq"], found["total"]

    assert await told() == (1, 0, 0)
    assert await Exchange(ground).upload([waypoint(5.0, 5.0), waypoint(9.0, 5.0)]) == 0
    assert await told() == (2, 0, 2)
    assert await ground.ask(MavCommand.DO_SET_MISSION_CURRENT, 1.0) is MavResult.ACCEPTED
    assert await told() == (4, 1, 2)
    missions = rig.vehicle._missions
    assert missions.current_message(is_flying=True)["mission_state"] == 3
    missions.over()
    assert (await told())[0] == 5


# -- fences ---------------------------------------------------------------------------------------


def fence(radius: float = 10.0, kind: int = 5003) -> list[Item]:
    return [item(kind, 0.01, 0.01, param1=radius)]


def square(half: float, kind: int = 5001) -> list[Item]:
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    return [item(kind, north, east, param1=4.0) for north, east in corners]


@pytest.mark.parametrize("given", [fence(12.0), square(12.0)], ids=["circle", "polygon"])
async def test_nobody_flies_out_of_a_fence(rig: Rig, ground: Ground, given: list[Item]) -> None:
    assert await Exchange(ground).upload(given, MissionType.FENCE) is MissionResult.ACCEPTED
    assert len(await Exchange(ground).download(MissionType.FENCE)) == len(given)
    await ground.fly(5.0)
    far, near = (item(0, 30.0, 0.01), item(0, 6.0, 0.01))
    for place, result in ((far, MavResult.DENIED), (near, MavResult.ACCEPTED)):
        args = (-1, 1, 0, math.nan, place["x"] / 1e7, place["y"] / 1e7)
        altitude = rig.ground_altitude + 5.0
        assert await ground.ask(MavCommand.DO_REPOSITION, *args, altitude) is result
    await rig.until(lambda: "fence" in ground.texts)

    async def north() -> None:
        for _ in range(400):
            mask = 0b0000_1101_1100_0111
            fields = {"coordinate_frame": 1, "type_mask": mask, "vx": 4.0}
            ground.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields)
            await anyio.sleep(0.05)

    async with anyio.create_task_group() as group:
        group.start_soon(north)
        await anyio.sleep(0.1)
        assert await ground.set_mode(Mode.OFFBOARD) is MavResult.ACCEPTED
        await anyio.sleep(15.0)
        assert rig.aircraft.position[0] < 13.0
        assert rig.speed < 0.1
        assert ground.mode is Mode.HOLD


def corners(*places: tuple[float, float], kind: int = 5001) -> list[Item]:
    return [item(kind, north, east, param1=float(len(places))) for north, east in places]


async def reposition(
    rig: Rig, ground: Ground, north: float, east: float, speed: float = -1.0
) -> int:
    place = item(0, north, east)
    args = (speed, 1, 0, math.nan, place["x"] / 1e7, place["y"] / 1e7, rig.ground_altitude + 5.0)
    return await ground.ask(MavCommand.DO_REPOSITION, *args)


async def test_an_area_that_lies_on_the_way_is_not_flown_to(rig: Rig, ground: Ground) -> None:
    await Exchange(ground).upload([item(5004, 25.0, 0.01, param1=5.0)], MissionType.FENCE)
    await ground.fly(5.0)
    assert await reposition(rig, ground, 45.0, 0.01) is MavResult.DENIED
    await rig.until(lambda: "an excluded area is on the path" in ground.texts)
    assert await reposition(rig, ground, 45.0, 40.0) is MavResult.ACCEPTED, "beside it"


async def test_asking_again_and_again_leads_nobody_out(rig: Rig, ground: Ground) -> None:
    """Each order flies a little before it is held, also one that comes while it still brakes."""
    bay = corners((-5, -5), (30, -5), (30, 30), (-5, 30), (-5, 20), (20, 20), (20, 5), (-5, 5))
    assert await Exchange(ground).upload(bay, MissionType.FENCE) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    farthest = 0.0
    for _ in range(100):  # ten seconds: to the other arm, across what does not belong to it
        await reposition(rig, ground, 0.01, 25.0)
        await anyio.sleep(0.1)
        farthest = max(farthest, rig.aircraft.position[1])
    assert 2.0 < farthest < 5.2
    assert "hold: outside of the fence" in ground.texts


async def test_out_of_an_excluded_area_only_the_straight_way_is_flown(
    rig: Rig, ground: Ground
) -> None:
    await ground.fly(5.0)
    drawn_later = [item(5004, 6.0, 0.01, param1=10.0)]  # around the aircraft, 6 m off its middle
    assert await Exchange(ground).upload(drawn_later, MissionType.FENCE) is MissionResult.ACCEPTED
    for _ in range(30):  # through all of it
        assert await reposition(rig, ground, 40.0, 0.01) is MavResult.DENIED
        await anyio.sleep(0.1)
    assert math.dist(rig.aircraft.position, (0.0, 0.0)) < 0.5
    await rig.until(lambda: "it does not lead out straight" in ground.texts)
    assert await reposition(rig, ground, -12.0, 0.01) is MavResult.ACCEPTED
    await rig.until(lambda: rig.aircraft.position[0] < -11.0, within=30.0)


@pytest.mark.parametrize("seed", range(4))
async def test_no_orders_lead_into_what_is_excluded(rig: Rig, ground: Ground, seed: int) -> None:
    """Places, areas and times are drawn; half of all orders come while the last is under way."""
    draw = Random(seed)
    areas: list[tuple[float, float, float]] = []
    while len(areas) < 4:
        north, east = draw.uniform(-40.0, 40.0), draw.uniform(-40.0, 40.0)
        radius = draw.uniform(3.0, 10.0)
        if math.hypot(north, east) > radius + 3.0:
            areas.append((north, east, radius))
    given = [item(5004, north, east, param1=radius) for north, east, radius in areas]
    assert await Exchange(ground).upload(given, MissionType.FENCE) is MissionResult.ACCEPTED
    await ground.fly(5.0)
    for _ in range(25):
        north, east = draw.uniform(-50.0, 50.0), draw.uniform(-50.0, 50.0)
        for _ in range(draw.choice((1, 1, 10))):
            await reposition(rig, ground, north, east)
            for _ in range(draw.choice((1, 2, 20))):
                await anyio.sleep(0.1)
                place = rig.aircraft.position[:2]
                deepest = min(math.dist(place, area[:2]) - area[2] for area in areas)
                assert deepest > -0.3, (seed, place, areas)
    assert math.dist(rig.aircraft.position, (0.0, 0.0)) > 1.0, "some of them were flown"


async def deepest_m(rig: Rig, seconds: float, each: Callable[[], object] = lambda: None) -> float:
    """How deep the aircraft gets into what the fence forbids."""
    frame, found = LocalFrame(*TAKEOFF), 0.0
    for _ in range(round(seconds * 10)):
        each()
        await anyio.sleep(0.1)
        place = frame.to_geodetic(*rig.aircraft.position[:2])
        found = max(found, rig.vehicle._missions.fence.depth_m(*place))
    return found


async def upload_fence(ground: Ground, *given: Item) -> None:
    assert await Exchange(ground).upload(list(given), MissionType.FENCE) is MissionResult.ACCEPTED


async def test_a_breach_of_the_fence_is_told_while_there_is_one(rig: Rig, ground: Ground) -> None:
    """MAVProxy said "fence breach" at each start: health without a fence was not good."""
    bit = 0x100000  # MAV_SYS_STATUS_GEOFENCE

    async def told() -> tuple[bool, bool, bool]:
        await anyio.sleep(1.0)
        status = ground.last("SYS_STATUS")
        parts = ("present", "enabled", "health")
        present, enabled, healthy = (status[f"onboard_control_sensors_{part}"] for part in parts)
        return bool(present & bit), bool(enabled & bit), bool(healthy & bit)

    assert await told() == (False, False, True)
    await upload_fence(ground, item(5003, 0.01, 0.01, param1=30.0))
    assert await told() == (True, True, True)
    await upload_fence(ground, item(5003, 60.0, 0.01, param1=30.0))
    assert await told() == (True, True, False)


def tilt_north(ground: Ground, degrees: float = 30.0) -> None:
    """Begun again as soon as it is held."""
    half = math.radians(-degrees) / 2.0
    q = (math.cos(half), 0.0, math.sin(half), 0.0)
    ground.send("SET_ATTITUDE_TARGET", target_system=1, type_mask=7, q=q, thrust=0.5)
    offboard = MODES[Mode.OFFBOARD]
    ground.command(MavCommand.DO_SET_MODE, 1, offboard.main, offboard.sub)


@pytest.mark.parametrize("north", [10, 100])
async def test_tilts_do_not_lead_out_of_a_fence(rig: Rig, ground: Ground, north: float) -> None:
    """Tilted by 30 degrees it flies 18 m/s, and a program begins again as soon as it is held."""
    await upload_fence(ground, *corners((-20, -20), (north, -20), (north, 20), (-20, 20)))
    await ground.fly(5.0)
    assert await deepest_m(rig, 15.0, lambda: tilt_north(ground)) < 0.5
    assert rig.aircraft.position[0] > north / 2.0, "it flew"


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [30.0, 35.0])
@pytest.mark.parametrize("north", [10, 60, 100])
async def test_an_aircraft_as_measured_stays_inside_of_a_fence(
    north: float, degrees: float
) -> None:
    """It has less drag than the document's: 22 m/s within 100 m, and 23 m too far once.

    The program begins again whenever it is held, and each time it creeps on a little.
    """
    async with Rig(firmware="3.1").running() as rig:
        ground = rig.ground
        await upload_fence(ground, *corners((-20, -20), (north, -20), (north, 20), (-20, 20)))
        await ground.fly(5.0)
        assert await deepest_m(rig, 15.0, lambda: tilt_north(ground, degrees)) < 2.0
        assert rig.aircraft.position[0] > north / 2.0, "it flew"


def fly_north(ground: Ground, speed: float) -> None:
    """A program that begins again as soon as it is held."""
    fields = {"coordinate_frame": 1, "type_mask": 0b0000_1101_1100_0111, "vx": speed}
    ground.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields)
    offboard = MODES[Mode.OFFBOARD]
    ground.command(MavCommand.DO_SET_MODE, 1, offboard.main, offboard.sub)


@pytest.mark.parametrize("lost", ["position", "GPS", "velocity"])
async def test_an_aircraft_without_a_position_flies_on_before_no_fence(
    rig: Rig, ground: Ground, lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    await upload_fence(ground, *corners((-20, -20), (50, -20), (50, 20), (-20, 20)))
    await ground.fly(5.0)
    await deepest_m(rig, 3.0, lambda: fly_north(ground, 10.0))
    known = VehicleView.get

    def get(view: VehicleView, record: type[Any]) -> Any:
        found = known(view, record)
        if record is (Velocity if lost == "velocity" else Position):
            return found._replace(gps_health=1) if lost == "GPS" and found else None
        return found

    monkeypatch.setattr(VehicleView, "get", get)
    assert await deepest_m(rig, 8.0, lambda: fly_north(ground, 10.0)) < 0.5
    assert rig.speed < 0.1
    assert "hold: the distance to the fence is unknown" in ground.texts


async def test_a_late_report_leads_nobody_out_of_a_fence(rig: Rig, ground: Ground) -> None:
    """It flies 18 m/s when nothing is reported for 0.9 s, just before it would be held."""
    await upload_fence(ground, *corners((-20, -20), (120, -20), (120, 20), (-20, 20)))
    await ground.fly(5.0)
    while rig.aircraft.position[0] < 86.0:
        tilt_north(ground)
        await anyio.sleep(0.05)
    rig.aircraft.line.to_host.faults = LineFaults(loss=1.0)
    before = await deepest_m(rig, 0.9, lambda: tilt_north(ground))
    rig.aircraft.line.to_host.faults = LineFaults()
    assert max(before, await deepest_m(rig, 8.0, lambda: tilt_north(ground))) < 0.5


async def test_on_a_slow_line_it_is_held_a_round_trip_earlier(
    rig: Rig, ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 5 m/s and 6 s, 30 m before the fence; without, some 9 m before it."""
    monkeypatch.setattr(AircraftConnection, "round_trip", property(lambda _: 6.0))
    await upload_fence(ground, *corners((-20, -20), (70, -20), (70, 20), (-20, 20)))
    await ground.fly(5.0)
    fly_north(ground, 5.0)
    fields = {"coordinate_frame": 1, "type_mask": 0b0000_1101_1100_0111, "vx": 5.0}
    send = partial(
        ground.send, "SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields
    )  # and not into the mode again, when it is held
    await deepest_m(rig, 20.0, send)
    assert rig.speed < 0.1
    assert 20.0 < rig.aircraft.position[0] < 42.0


async def test_the_way_out_of_an_area_leads_through_no_second_one(rig: Rig, ground: Ground) -> None:
    """At 10 m/s the look ahead ends behind a strip of 4 m, which lies 1 m behind the first."""
    await ground.fly(5.0)
    first = corners((-60, -60), (25, -60), (25, 60), (-60, 60), kind=5002)
    second = corners((26, -60), (30, -60), (30, 60), (26, 60), kind=5002)
    await upload_fence(ground, *first, *second)
    assert await reposition(rig, ground, 80.0, 0.01, speed=10.0) is MavResult.DENIED
    assert await reposition(rig, ground, 25.5, 0.01, speed=10.0) is MavResult.ACCEPTED


async def test_a_second_area_that_is_drawn_while_it_leaves_the_first_holds_it(
    rig: Rig, ground: Ground
) -> None:
    first = corners((-60, -60), (25, -60), (25, 60), (-60, 60), kind=5002)
    second = corners((30, -60), (34, -60), (34, 60), (30, 60), kind=5002)
    await ground.fly(5.0)
    await upload_fence(ground, *first)
    await reposition(rig, ground, 80.0, 0.01, speed=10.0)
    await rig.until(lambda: rig.speed > 2.0)
    await upload_fence(ground, *first, *second)
    await rig.until(lambda: rig.aircraft.position[0] > 12.0)
    await anyio.sleep(10.0)
    assert rig.aircraft.position[0] < 30.5


@pytest.mark.parametrize(("speed", "gap"), [(5.0, 1.0), (10.0, 1.0), (10.0, 4.0)])
async def test_a_flight_to_a_place_near_the_fence_arrives(
    rig: Rig, ground: Ground, speed: float, gap: float
) -> None:
    await upload_fence(ground, *corners((-20, -20), (60, -20), (60, 20), (-20, 20)))
    await ground.fly(5.0)
    assert await reposition(rig, ground, 60.0 - gap, 0.01, speed) is MavResult.ACCEPTED
    assert await deepest_m(rig, 25.0) < 0.5
    assert rig.aircraft.position[0] > 60.0 - gap - 0.5, "its own end, not a hold"
    assert "hold:" not in ground.texts


@pytest.mark.parametrize(("radius", "speed"), [(10.0, 5.0), (-20.0, 5.0)])
async def test_a_circle_near_the_fence_is_flown_around(
    rig: Rig, ground: Ground, radius: float, speed: float
) -> None:
    await upload_fence(ground, item(5003, 0.01, 0.01, param1=abs(radius) + 2.0))
    await ground.fly(5.0)
    here = LocalFrame(*TAKEOFF).to_geodetic(0.01, 0.01)
    args = (radius, speed, 0, math.nan, *here, rig.ground_altitude + 5.0)
    assert await ground.ask(MavCommand.DO_ORBIT, *args) is MavResult.ACCEPTED
    assert await deepest_m(rig, 20.0) < 0.5
    assert rig.speed > speed - 0.5
    assert "hold:" not in ground.texts


async def test_a_flight_that_does_not_stop_at_its_place_is_held_before_the_fence(
    rig: Rig, ground: Ground
) -> None:
    """What flies past its place, or beside it, is looked at all the way."""
    await upload_fence(ground, *corners((-20, -20), (60, -20), (60, 20), (-20, 20)))
    await ground.fly(5.0)
    await reposition(rig, ground, 57.0, 0.01, 10.0)
    await rig.until(lambda: rig.aircraft.position[0] > 30.0)
    assert (
        await reposition(rig, ground, 40.0, 18.0, 10.0) is MavResult.ACCEPTED
    )  # it still flies on
    assert await deepest_m(rig, 20.0) < 0.5


async def test_a_slow_flight_creeps_into_no_second_area(rig: Rig, ground: Ground) -> None:
    """From one strip the way out leads into the next, slower than a look ahead would notice."""
    near = corners((3.0, -20), (4.3, -20), (4.3, 20), (3.0, 20), kind=5002)
    far = corners((4.1, -20), (40, -20), (40, 20), (4.1, 20), kind=5002)
    await ground.fly(5.0)
    await reposition(rig, ground, 3.6, 0.01, speed=0.5)
    await rig.until(lambda: rig.aircraft.position[0] > 3.5, within=30.0)
    await upload_fence(ground, *near, *far)  # it stands in the first, 0.6 m from its middle
    before = await deepest_m(rig, 5.0)
    await reposition(rig, ground, 45.0, 0.01, speed=0.25)
    assert await deepest_m(rig, 60.0) < before + 0.5


async def test_a_mission_that_is_to_pause_is_still_held_before_a_fence() -> None:
    async with Rig(firmware="3.1").running() as rig:
        ground = rig.ground
        await ground.fly(8.0)
        await Exchange(ground).upload([waypoint(60.0, -10.0), waypoint(60.0, 95.0)])
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
        await upload_fence(ground, item(5004, 60.0, 40.0, param1=10.0))  # it flies already
        await rig.until(lambda: rig.aircraft.position[1] > 8.0, within=60.0)
        rig.aircraft.line.to_aircraft.faults = LineFaults(loss=0.3)
        for number in range(50):  # the order to pause waits behind them
            ground.command(MavCommand.DO_CHANGE_SPEED, 1, 5.0 + 0.01 * (number % 10))
            await anyio.sleep(0.005)
        ground.command(MavCommand.DO_SET_MODE, 1, MODES[Mode.HOLD].main, MODES[Mode.HOLD].sub)
        assert await deepest_m(rig, 30.0) < 0.5


@pytest.mark.parametrize("firmware", ["1.0", "3.1"])
async def test_a_fast_mission_is_held_before_a_fence(firmware: str) -> None:
    async with Rig(firmware=firmware).running() as rig:
        ground = rig.ground
        await ground.fly(8.0)
        fast = item(MavCommand.DO_CHANGE_SPEED, param1=1.0, param2=10.0)
        await Exchange(ground).upload([fast, waypoint(60.0, -10.0), waypoint(60.0, 75.0)])
        assert await ground.set_mode(Mode.MISSION) is MavResult.ACCEPTED
        await upload_fence(ground, item(5004, 60.0, 30.0, param1=6.0))
        assert await deepest_m(rig, 40.0) < 0.5
        assert "hold: an excluded area is on the path" in ground.texts


async def test_a_circle_that_leaves_the_fence_between_eight_places_is_denied(
    rig: Rig, ground: Ground
) -> None:
    """A bay cuts the circle for 18 degrees to both sides of a turn of 22.5 degrees."""

    def place(radius: float, turn_deg: float) -> tuple[float, float]:
        turn = math.radians(turn_deg)
        return radius * math.cos(turn), radius * math.sin(turn)

    around = [place(80, 22.4), (80.0, -80.0), (-80.0, -80.0), (-80.0, 80.0), (80.0, 80.0)]
    bay = [place(11, 22.6), place(11, 40.5), place(6, 40.5), place(6, 4.5), place(11, 4.5)]
    await upload_fence(ground, *corners(*around, place(80, 22.6), *bay, place(11, 22.4)))
    await ground.fly(5.0)
    here = LocalFrame(*TAKEOFF).to_geodetic(0.0, 0.0)
    for radius, result in ((-10.0, MavResult.DENIED), (-5.0, MavResult.ACCEPTED)):
        args = (radius, 2.0, 0, math.nan, *here, rig.ground_altitude + 5.0)
        assert await ground.ask(MavCommand.DO_ORBIT, *args) is result


async def test_a_mission_flies_around_an_area_but_not_through_it(rig: Rig, ground: Ground) -> None:
    await upload_fence(ground, item(5004, 30.0, 0.01, param1=10.0))
    await ground.fly(5.0)
    around = [waypoint(30.0, 30.0), waypoint(60.0, 0.01)]
    for route, result in (
        ([*around, waypoint(0.01, 0.01)], MavResult.DENIED),  # each place is allowed
        (around, MavResult.ACCEPTED),  # the straight way from here to the last place is not
    ):
        assert await Exchange(ground).upload(route) is MissionResult.ACCEPTED
        assert await ground.set_mode(Mode.MISSION) is result


async def test_another_ground_station_is_refused_before_its_flight_is_looked_at(
    rig: Rig, ground: Ground
) -> None:
    await upload_fence(ground, *fence(20.0))
    await ground.fly(5.0)
    outside = LocalFrame(*TAKEOFF).to_geodetic(40.0, 0.0)
    other = Ground(rig, ("127.0.0.1", 7000), 246)
    other.beat()
    args = (-1, 1, 0, math.nan, *outside, rig.ground_altitude + 5.0)
    assert await other.ask(MavCommand.DO_REPOSITION, *args) is MavResult.TEMPORARILY_REJECTED


async def test_a_return_point_is_kept_with_its_fence_and_said_to_mean_nothing(
    rig: Rig, ground: Ground
) -> None:
    """The first item of each fence of MAVProxy and Mission Planner: the whole fence was refused."""
    given = [item(5000, 1.0, 1.0), *square(20.0)]
    assert await Exchange(ground).upload(given, MissionType.FENCE) is MissionResult.ACCEPTED
    await rig.until(lambda: "its return point is only stored" in ground.texts)
    assert await Exchange(ground).upload([waypoint(15.0, 0.1), waypoint(30.0, 0.1)]) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED
    broken = [*given[:2], given[0], *given[2:]]
    assert await Exchange(ground).upload(broken, MissionType.FENCE) is MissionResult.UNSUPPORTED


async def test_an_area_that_is_excluded_is_not_flown_to(rig: Rig, ground: Ground) -> None:
    given = [item(5004, 20.0, 0.01, param1=5.0)]
    assert await Exchange(ground).upload(given, MissionType.FENCE) == 0
    assert await Exchange(ground).upload([waypoint(20.0, 0.01), waypoint(30.0, 0.01)]) == 0
    await ground.arm()
    assert await ground.set_mode(Mode.MISSION) is MavResult.DENIED


@pytest.mark.parametrize(
    "given",
    [
        square(9.0)[:3],
        [*square(9.0)[:2], *fence()],
        [item(5001, 1.0, 1.0, param1=2.0)],
        [item(5003, 1.0, 1.0, param1=math.nan)],
        [waypoint(1.0, 1.0)],
        [item(5001, 1.0, 1.0, param1=math.inf)],
        [*square(9.0)[:3], {**square(9.0)[3], "x": 2_000_000_000}],
    ],
)
async def test_a_fence_that_is_not_whole_is_refused(ground: Ground, given: list[Item]) -> None:
    found = await Exchange(ground).upload(given, MissionType.FENCE)
    assert found in (MissionResult.INVALID, MissionResult.UNSUPPORTED)
    assert await Exchange(ground).download(MissionType.FENCE) == []


async def test_rally_points_are_kept_and_said_to_mean_nothing(rig: Rig, ground: Ground) -> None:
    ground.send("MISSION_REQUEST_LIST", target_system=1, mission_type=MissionType.RALLY)
    assert ground.last("MISSION_COUNT")["count"] == 0
    given = [item(5100, 5.0, 5.0, 20.0), item(5100, 9.0, 5.0, 20.0)]
    assert await Exchange(ground).upload(given, MissionType.RALLY) is MissionResult.ACCEPTED
    found = await Exchange(ground).download(MissionType.RALLY)
    assert all(same(one, item) for one, item in zip(found, given, strict=True))
    await rig.until(lambda: "rally points are only stored" in ground.texts)


# -- fences as tables: items in, which places are inside out ---------------------------------------


FRAME = LocalFrame(47.4, -8.5)
INSIDE, OUTSIDE, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
# Higher than wide, with a notch in the east: no two sides are alike.
CORNERS = [(0.0, 0.0), (40.0, 0.0), (40.0, 10.0), (20.0, 4.0), (0.0, 20.0)]


def corner_item(command: int, north: float, east: float, param1: float) -> MavlinkMessage:
    latitude, longitude = FRAME.to_geodetic(north, east)
    place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}
    return MavlinkMessage("MISSION_ITEM_INT", {"command": command, "param1": param1} | place)


def polygon(
    command: int = INSIDE, corners: Any = CORNERS, count: float | None = None
) -> list[MavlinkMessage]:
    many = float(len(corners)) if count is None else count
    return [corner_item(command, north, east, many) for north, east in corners]


def is_free(items: list[MavlinkMessage], north: float, east: float, radius: float = 0.0) -> bool:
    return not read_fence(items).refusal(*FRAME.to_geodetic(north, east), radius)


PLACES = [
    (1.0, 1.0, True),
    (39.0, 1.0, True),
    (39.0, 9.0, True),
    (1.0, 18.0, True),
    (20.0, 3.5, True),
    (20.0, 4.5, False),
    (25.0, 8.0, False),
    (10.0, 13.0, False),
    (10.0, 11.0, True),
    (-0.5, 1.0, False),
    (40.5, 5.0, False),
    (20.0, -0.5, False),
    (0.5, 20.5, False),
]


@pytest.mark.parametrize(("north", "east", "is_in"), PLACES)
@pytest.mark.parametrize("turned", [False, True])
def test_a_polygon_is_what_its_corners_are_around(
    north: float, east: float, is_in: bool, turned: bool
) -> None:
    corners = CORNERS[::-1] if turned else CORNERS
    assert is_free(polygon(corners=corners), north, east) is is_in
    assert is_free(polygon(OUTSIDE, corners), north, east) is not is_in


@pytest.mark.parametrize(
    ("north", "east", "is_in"),
    [
        (5.0, 7.0, True),
        (14.9, 7.0, True),
        (15.1, 7.0, False),
        (5.0, -2.9, True),
        (5.0, -3.1, False),
    ],
)
def test_a_circle_has_its_radius_in_metres(north: float, east: float, is_in: bool) -> None:
    assert is_free([corner_item(CIRCLE_IN, 5.0, 7.0, 10.0)], north, east) is is_in
    assert is_free([corner_item(CIRCLE_OUT, 5.0, 7.0, 10.0)], north, east) is not is_in


def test_areas_to_stay_in_are_one_and_each_to_stay_out_of_counts() -> None:
    two = [corner_item(CIRCLE_IN, 0.0, 0.0, 10.0), corner_item(CIRCLE_IN, 30.0, 0.0, 10.0)]
    assert is_free(two, 0.0, 0.0)
    assert is_free(two, 30.0, 0.0)
    assert not is_free(two, 15.0, 0.0)
    three = [*two, corner_item(CIRCLE_OUT, 30.0, 5.0, 3.0), corner_item(CIRCLE_OUT, 0.0, 5.0, 3.0)]
    assert not is_free(three, 30.0, 5.0)
    assert not is_free(three, 0.0, 5.0)
    assert is_free(three, 30.0, 0.0)
    assert is_free([], 1000.0, 1000.0)
    assert is_free([corner_item(CIRCLE_IN, 0.0, 0.0, 0.0)], 1000.0, 1000.0), "a radius of 0 is none"


@pytest.mark.parametrize(("radius", "is_in"), [(0.0, True), (2.0, True), (4.0, False)])
def test_what_is_flown_around_a_place_counts(radius: float, is_in: bool) -> None:
    for north, east in ((7.0, 0.0), (-7.0, 0.0), (0.0, 7.0), (0.0, -7.0)):
        assert is_free([corner_item(CIRCLE_IN, 0.0, 0.0, 10.0)], north, east, radius) is is_in


@pytest.mark.parametrize(
    ("items", "result"),
    [
        (polygon()[:4], MissionResult.INVALID),
        ([*polygon()[:4], polygon(OUTSIDE)[4]], MissionResult.INVALID),
        ([*polygon()[:4], polygon(count=4.0)[4]], MissionResult.INVALID),
        ([polygon(count=6.0)[0], *polygon()[1:]], MissionResult.INVALID),
        ([*polygon()[:2], corner_item(CIRCLE_IN, 0.0, 0.0, 5.0)], MissionResult.UNSUPPORTED),
        (polygon(corners=CORNERS[:2]), MissionResult.INVALID),
        (polygon(count=4.5), MissionResult.INVALID),
        (polygon(count=1001.0), MissionResult.INVALID),
        (polygon(count=-5.0), MissionResult.INVALID),
        (polygon(count=math.nan), MissionResult.INVALID),
        (polygon(count=math.inf), MissionResult.INVALID),
        ([corner_item(CIRCLE_IN, 0.0, 0.0, -1.0)], MissionResult.INVALID),
        ([corner_item(CIRCLE_IN, 0.0, 0.0, math.nan)], MissionResult.INVALID),
        ([corner_item(CIRCLE_OUT, 0.0, 0.0, math.inf)], MissionResult.INVALID),
        ([corner_item(5100, 0.0, 0.0, 1.0)], MissionResult.UNSUPPORTED),
        ([corner_item(16, 0.0, 0.0, 1.0)], MissionResult.UNSUPPORTED),
    ],
)
def test_a_fence_that_contradicts_itself_is_refused(
    items: list[MavlinkMessage], result: MissionResult
) -> None:
    with pytest.raises(Refused) as caught:
        read_fence(items)
    assert caught.value.result is result


def test_two_polygons_follow_each_other() -> None:
    far = [(100.0, 0.0), (110.0, 0.0), (110.0, 10.0)]
    both = [*polygon(), *polygon(corners=far)]
    assert is_free(both, 1.0, 1.0)
    assert is_free(both, 108.0, 2.0)
    assert not is_free(both, 60.0, 2.0)


@pytest.mark.parametrize("x", [910_000_000, -2_000_000_000])
def test_a_place_that_is_none_is_refused(x: int) -> None:
    fields = {"command": CIRCLE_IN, "param1": 5.0, "x": x, "y": 0}
    with pytest.raises(Refused):
        read_fence([MavlinkMessage("MISSION_ITEM_INT", fields)])


@pytest.mark.parametrize(
    ("items", "north", "east", "depth"),
    [
        (polygon(), 1.0, 1.0, 0.0),
        (polygon(), -3.0, 1.0, 3.0),
        (polygon(), -3.0, -4.0, 5.0),  # off a corner
        (polygon(), 44.0, 13.0, 5.0),
        (polygon(OUTSIDE), 30.0, 2.0, 2.0),
        (polygon(OUTSIDE), -3.0, 1.0, 0.0),
        ([corner_item(CIRCLE_IN, 10.0, 0.0, 5.0)], 10.0, 12.0, 7.0),
        ([corner_item(CIRCLE_OUT, 10.0, 0.0, 5.0)], 10.0, 2.0, 3.0),
        (
            [corner_item(CIRCLE_OUT, 10.0, 0.0, 5.0), corner_item(CIRCLE_OUT, 12.0, 0.0, 5.0)],
            11.0,
            0.0,
            4.0,
        ),
        (
            [corner_item(CIRCLE_IN, 0.0, 0.0, 5.0), corner_item(CIRCLE_IN, 20.0, 0.0, 5.0)],
            12.0,
            0.0,
            3.0,
        ),
        ([], 0.0, 0.0, 0.0),
    ],
)
def test_how_deep_a_place_lies(
    items: list[MavlinkMessage], north: float, east: float, depth: float
) -> None:
    found = read_fence(items).depth_m(*FRAME.to_geodetic(north, east))
    assert found == pytest.approx(depth, abs=0.05)  # places have seven digits


@pytest.mark.parametrize(
    ("items", "begin", "end", "is_free"),
    [
        (polygon(OUTSIDE), (-5.0, 5.0), (-5.0, 40.0), True),
        (polygon(OUTSIDE), (-5.0, 5.0), (50.0, 5.0), False),  # both ends are allowed
        (polygon(OUTSIDE), (20.0, 20.0), (20.0, 5.0), True),  # into the notch
        (polygon(OUTSIDE), (20.0, 20.0), (20.0, 3.0), False),
        (polygon(OUTSIDE), (20.0, 20.0), (30.0, 5.0), False),
        ([corner_item(CIRCLE_OUT, 0.0, 0.0, 5.0)], (-20.0, 5.5), (20.0, 5.5), True),
        ([corner_item(CIRCLE_OUT, 0.0, 0.0, 5.0)], (-20.0, 4.5), (20.0, 4.5), False),
        (
            [corner_item(CIRCLE_OUT, 0.0, 0.0, 5.0)],
            (-20.0, 4.5),
            (-6.0, 4.5),
            True,
        ),  # ends before it
        ([corner_item(CIRCLE_IN, 0.0, 0.0, 5.0)], (0.0, 0.0), (4.0, 0.0), True),
        ([corner_item(CIRCLE_IN, 0.0, 0.0, 5.0)], (0.0, 0.0), (6.0, 0.0), False),
        ([], (0.0, 0.0), (6.0, 0.0), True),
    ],
)
def test_what_lies_on_a_straight_way(
    items: list[MavlinkMessage], begin: tuple[float, float], end: tuple[float, float], is_free: bool
) -> None:
    places = FRAME.to_geodetic(*begin), FRAME.to_geodetic(*end)
    assert (not read_fence(items).on_the_way(*places)) is is_free


@pytest.mark.parametrize(("north", "is_met"), [(-30.0, False), (30.0, True), (57.0, False)])
def test_a_way_near_the_pole_bends_away_from_its_latitude(north: float, is_met: bool) -> None:
    """The middle of 4 km from west to east is 17 m nearer to the pole than both ends."""
    frame = LocalFrame(88.9, 20.0)
    begin, end = frame.to_geodetic(0.0, -2000.0), frame.to_geodetic(0.0, 2000.0)
    latitude, longitude = frame.to_geodetic(north, 0.0)
    assert latitude - begin[0] == pytest.approx((north + 17.0) / 111_690, abs=5e-5)
    place = {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}
    radius = 35.0 if is_met else 20.0
    found = read_fence(
        [MavlinkMessage("MISSION_ITEM_INT", {"command": 5004, "param1": radius} | place)]
    )
    assert bool(found.on_the_way(begin, end)) is is_met


@pytest.mark.parametrize("seed", range(30))
def test_a_circle_anywhere_is_as_far_as_the_shortest_line(seed: int) -> None:
    draw = Random(seed)
    latitude = draw.choice([0.0, 22.5, -60.0, 88.9, -88.9])
    frame = LocalFrame(latitude, draw.choice([0.0, 114.0, 179.9999, -180.0]))
    radius = 10.0 ** draw.uniform(0.5, 4.5)
    x, y = (round(one * 1e7) for one in frame.to_geodetic(0.0, 0.0))
    item = {"command": draw.choice([5003, 5004]), "param1": radius, "x": x, "y": y}
    found = read_fence([MavlinkMessage("MISSION_ITEM_INT", item)])
    for _ in range(50):
        turn, away = draw.uniform(0.0, math.tau), radius * draw.uniform(0.5, 1.5)
        place = frame.to_geodetic(away * math.cos(turn), away * math.sin(turn))
        beyond = geodesic(x / 1e7, y / 1e7, *place)[0] - radius
        depth = max(0.0, beyond if item["command"] == 5003 else -beyond)
        assert found.depth_m(*place) == pytest.approx(depth, abs=0.01), (seed, place)


def many(kind: str, command: int) -> list[MavlinkMessage]:
    """As many areas as an upload has, of a kind that is hard to look at."""
    here = FRAME.latitude_deg
    if kind == "one latitude":  # on the other side of the Earth
        return [
            MavlinkMessage(
                "MISSION_ITEM_INT",
                {"command": command, "param1": 5.0, "x": round(here * 1e7), "y": 10**9 + place},
            )
            for place in range(1000)
        ]
    if kind == "in a row":
        return [corner_item(command, 0.0, 50.0 + 5.0 * place, 2.0) for place in range(1000)]
    return [
        corner_item(command - 2, 40.0 + 30.0 * north, 30.0 * east + 0.01 * place, 3.0)
        for place in range(333)
        for north, east in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    ]


@pytest.mark.parametrize("kind", ["one latitude", "in a row", "triangles"])
@pytest.mark.parametrize("command", [CIRCLE_IN, CIRCLE_OUT])
def test_a_look_at_a_thousand_areas_turns_few_places_into_metres(
    kind: str, command: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is what costs: it was 16 ms of the loop that flies, at each of its steps."""
    found, count = read_fence(many(kind, command)), 0
    known = LocalFrame.to_local

    def counted(frame: LocalFrame, latitude_deg: float, longitude_deg: float) -> Any:
        nonlocal count
        count += 1
        return known(frame, latitude_deg, longitude_deg)

    monkeypatch.setattr(LocalFrame, "to_local", counted)
    here, ahead = FRAME.to_geodetic(1.0, 2.0), FRAME.to_geodetic(19.0, 4.0)
    found.depth_m(*here)
    found.depth_m(*ahead)
    found.on_the_way(here, ahead)
    assert count <= 8
