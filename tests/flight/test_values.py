"""Targets in, setpoints, tolerances and times out: of the closed loops, and of a control block."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import nullcontext
from itertools import pairwise
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock, MagicMock, call

import pytest

from m100link.errors import TaskRefused, UsageError
from m100link.flight import control as controls
from m100link.flight import tasks
from m100link.flight.control import Control
from m100link.flight.guidance import GuidanceProgress
from m100link.flight.loops import ClosedLoops
from m100link.flight.pacing import Tick
from m100link.flight.tasks import run_task, switch_motors
from m100link.geodesy import LocalFrame
from m100link.protocol.codes import ArmCode
from m100link.protocol.commands.control import Arm, Task
from m100link.protocol.setpoint import Setpoint
from m100link.sim import VirtualClockEventLoop
from m100link.telemetry.state import AircraftState
from tests import known, limits
from tests.known import LATITUDE, LONGITUDE, YAW

pytestmark = pytest.mark.anyio
near: Any = pytest.approx
HERE, HEIGHT = LocalFrame(LATITUDE, LONGITUDE), 12.34


@pytest.fixture
def anyio_backend() -> object:
    return "asyncio", {"loop_factory": VirtualClockEventLoop}


class Loops:
    """Closed loops of the known aircraft, none of which flies: what each would do."""

    def __init__(self) -> None:
        self.log: list[Any] = []
        self.runs: list[tuple[Any, ...]] = []
        self.state = AircraftState(lambda: 0.0)
        self.at(0.0, 0.0, HEIGHT)
        guards: Any = MagicMock(fastest_m_s=10.0)
        self.guards = guards
        prepare, admit = AsyncMock(side_effect=str), MagicMock(side_effect=str)  # the name
        guidance: Any = SimpleNamespace(prepare=prepare, admit=admit, run=self._run)
        self.guidance = guidance
        self.loops = ClosedLoops(self.state, guards, guidance)

    def at(self, north: float, east: float, height: float) -> None:
        """Be so far away from where it was at first, m."""
        latitude, longitude = HERE.to_geodetic(north, east)
        place = known.position(latitude=latitude, longitude=longitude, height=height)
        self.state.update(known.sample(at=0.0, changed=[place]))

    async def _run(self, *given: Any) -> str:
        self.runs.append(given)
        return "arrived"

    def step(self) -> tuple[tuple[float, ...], Setpoint, GuidanceProgress]:
        """Of the newest run: the numbers of its setpoint, that itself, and how far it is."""
        setpoint, progress = self.runs[-1][1]()
        return (setpoint.x, setpoint.y, setpoint.z, setpoint.yaw), setpoint, progress

    def ends(self, *found: float) -> bool:
        """Whether it has arrived with these errors: distance, height, heading."""
        return bool(self.runs[-1][2](GuidanceProgress(1.0, *found)))


OFFSET = Setpoint.position_offset(north=0.0, east=0.0, height=1.0, yaw_deg=0.0).mode
SPEED = Setpoint.velocity(north=0.0, east=0.0, height=1.0, yaw_deg=0.0).mode


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        # 50 m away: as the autopilot flies offsets, up to 10 m of them.
        ({"north": 30.0, "east": -40.0, "up": 5.0}, (6.0, -8.0, 17.34, YAW)),
        ({"north": 30.0, "east": -40.0, "height": 7.0, "yaw_deg": 100.0}, (6.0, -8.0, 7.0, 100.0)),
        ({"north": 3.0, "east": -4.0, "up": -2.0}, (3.0, -4.0, 10.34, YAW)),
        # At a speed, which falls by half of the distance that remains.
        ({"north": 30.0, "east": -40.0, "up": 0.0, "speed": 4.0}, (2.4, -3.2, 12.34, YAW)),
        ({"north": 3.0, "east": -4.0, "up": 0.0, "speed": 4.0}, (1.5, -2.0, 12.34, YAW)),
        ({"north": 0.0, "east": 0.0, "up": 1.0, "speed": 4.0}, (0.0, 0.0, 13.34, YAW)),
    ],
)
async def test_the_way_to_a_place(given: dict[str, float], expected: tuple[float, ...]) -> None:
    north, east = given["north"], given["east"]
    frame = LocalFrame(*HERE.to_geodetic(-100.0, 200.0))
    latitude, longitude = HERE.to_geodetic(north, east)
    there = {"latitude_deg": latitude, "longitude_deg": longitude}
    others = {name: value for name, value in given.items() if name not in ("north", "east")}
    in_frame = frame.to_local(latitude, longitude)
    for target in (
        {"north": north, "east": east},
        there,
        {"north": in_frame[0], "east": in_frame[1], "frame": frame},
    ):
        one, options = Loops(), dict[str, Any](target) | others
        assert await one.loops.fly_to(**options) == "arrived"  # type: ignore[comparison-overlap]
        values, setpoint, progress = one.step()
        assert values == near(expected, abs=1e-3)
        assert setpoint.mode == (SPEED if "speed" in given else OFFSET)
        turn = math.remainder(given["yaw_deg"] - YAW, 360.0) if "yaw_deg" in given else 0.0
        off = math.hypot(north, east), expected[2] - HEIGHT, turn
        errors = progress.distance_m, progress.height_error_m, progress.heading_error_deg
        assert errors == near(off, abs=1e-3)
        [checked] = one.guards.check_target.mock_calls
        assert checked == call(
            "fly_to",
            near((latitude, longitude), abs=1e-8),
            height=near(expected[2], abs=1e-6),
            speed=given.get("speed", 0.0),
        )
        assert one.guards.check_round_trip.mock_calls == [call("fly_to")]
        assert one.guidance.prepare.mock_calls == [call("fly_to")]


async def test_what_is_measured_anew_and_what_stays_on_the_way() -> None:
    one = Loops()
    await one.loops.fly_to(north=30.0, east=-40.0, up=5.0, speed=4.0)
    one.at(27.0, -36.0, 14.0)
    values, _, progress = one.step()
    assert values == near((1.5, -2.0, 17.34, YAW), abs=1e-3), "3 m and 4 m are left"
    assert (progress.distance_m, progress.height_error_m) == near((5.0, 3.34), abs=1e-3)


PROGRESS = MagicMock()
DEFAULTS: list[tuple[str, dict[str, Any], float, dict[str, Any]]] = [
    ("fly_to", {"north": 1.0, "east": 2.0, "up": 3.0}, 120.0, {"tolerance_m": 0.75}),
    ("climb_to", {"height": 20.0}, 60.0, {"tolerance_m": 0.75}),
    ("turn_to", {"yaw_deg": 100.0}, 30.0, {"tolerance_deg": 0.75}),
    ("orbit", {"center_north": 20.0, "center_east": 0.0}, 300.0, {}),
    # 60 s, and three times what 50 m take at 4 m/s.
    (
        "fly_path",
        {"points": [(30.0, -40.0, HEIGHT)], "speed": 4.0},
        60.0 + 37.5,
        {"tolerance_m": 0.75},
    ),
]


@pytest.mark.parametrize(("name", "given", "timeout", "more"), DEFAULTS)
async def test_how_long_a_loop_is_waited_for_and_when_it_has_arrived(
    name: str, given: dict[str, Any], timeout: float, more: dict[str, Any]
) -> None:
    one = Loops()
    await getattr(one.loops, name)(**given)
    assert (one.runs[-1][0], one.runs[-1][4]) == (name, None)
    assert one.runs[-1][3] == near(timeout, abs=0.01)
    usual = {"fly_to": 0.5, "fly_path": 0.5, "climb_to": 0.3, "turn_to": 2.0, "orbit": 2.0}[name]
    for limit in (usual, more.get("tolerance_m", more.get("tolerance_deg"))):
        if limit is None:
            continue
        if limit != usual:
            await getattr(one.loops, name)(**given, **more, timeout=7.5, progress=PROGRESS)
            assert one.runs[-1][3:] == (7.5, PROGRESS)
        below, above = limit - 1e-6, limit + 1e-6
        measured = {  # distance, height, heading
            "fly_to": (True, True, False),
            "fly_path": (True, True, False),
            "climb_to": (False, True, False),
            "turn_to": (False, False, True),
            "orbit": (False, False, True),
        }[name]
        for place, counts in enumerate(measured):
            for sign in (1.0, -1.0) if place else (1.0,):
                errors = [0.0, 0.0, 0.0]
                errors[place] = sign * (below if counts else 0.0)
                assert one.ends(*errors), (limit, errors)
                errors[place] = sign * (above if counts else 4.9)
                is_over = not counts or (name == "orbit" and sign < 0)
                if counts or name != "fly_to":
                    assert one.ends(*errors) is is_over, (limit, errors)
        if name == "fly_to":
            assert [one.ends(0.0, 0.0, turn) for turn in (5.0, -5.0, 5.1, -5.1)] == [True] * 2 + [
                False
            ] * 2


async def test_a_climb_and_a_turn_stay_in_their_place() -> None:
    one = Loops()
    await one.loops.climb_to(20.0)
    values, setpoint, progress = one.step()
    assert (values, progress.height_error_m) == ((0.0, 0.0, 20.0, 0.0), near(7.66))
    still = Setpoint.velocity(north=0.0, east=0.0, height=20.0, yaw_rate_deg_s=0.0)
    assert setpoint == still
    assert one.guards.check_target.mock_calls == [call("climb_to", height=20.0)]
    await one.loops.turn_to(100.0)
    values, setpoint, progress = one.step()
    assert setpoint == Setpoint.velocity(north=0.0, east=0.0, up=0.0, yaw_deg=100.0)
    assert progress.heading_error_deg == near(-130.0), "the short way from -130 to 100"
    assert one.guidance.admit.mock_calls == [call("turn_to")]


@pytest.mark.parametrize(
    ("given", "first", "yaw"),
    [
        # The centre is 20 m north: the circle goes through here, and is begun here.
        ({}, None, None),
        ({"start_deg": 180.0, "radius": 20.3}, None, None),
        # Seen from the centre in the east, 20 m from it, and looking at it.
        ({"start_deg": 90.0}, (20.0, 20.0), -90.0),
        ({"radius": 12.0}, (8.0, 0.0), 0.0),
        ({"height": 15.0}, (0.0, 0.0), 0.0),
        ({"height": 8.0}, (0.0, 0.0), 0.0),
    ],
)
async def test_a_circle_begins_where_it_is_or_where_somebody_wants_it(
    given: dict[str, Any], first: tuple[float, float] | None, yaw: float | None
) -> None:
    one, approach = Loops(), MagicMock()
    options: dict[str, Any] = {"timeout": 9.0, "progress": PROGRESS, "approach": approach}
    await one.loops.orbit(
        center_north=20.0, center_east=0.0, speed=3.0, turns=1.5, **given, **options
    )
    height, radius = given.get("height", HEIGHT), given.get("radius", 20.0)
    [checked] = one.guards.check_target.mock_calls
    assert checked == call(
        "orbit",
        near(HERE.to_geodetic(20.0, 0.0), abs=1e-8),
        height=near(height),
        radius=near(radius),
        speed=3.0,
    )
    approached = one.runs[:-1]
    assert bool(approached) is (first is not None)
    if first is not None:
        [(_, step, is_there, timeout, progress)] = approached
        setpoint, _ = step()
        away = math.hypot(*first)
        scale = min(1.0, 10.0 / away) if away else 1.0
        expected = first[0] * scale, first[1] * scale, height, yaw
        found = setpoint.x, setpoint.y, setpoint.z, setpoint.yaw
        assert found == near(expected, abs=1e-3)
        assert (timeout, progress) == (9.0, approach)
        assert is_there(GuidanceProgress(1.0, 0.49, 0.49, 0.0))
        assert not is_there(GuidanceProgress(1.0, 0.51, 0.0, 0.0))
        assert one.guidance.admit.mock_calls == [call("orbit")]
    assert one.runs[-1][3:] == (9.0, PROGRESS)
    one.at(20.0 - radius, 0.0, height)
    values, setpoint, progress = one.step()
    assert setpoint.mode == SPEED
    assert values[2:] == near((height, 0.0), abs=1e-3), "it looks at the centre, in the north"
    assert progress.heading_error_deg == near(540.0), "one turn and a half"
    assert progress.distance_m == near(0.0, abs=1e-3)


@pytest.mark.parametrize(
    "frame", [None, LocalFrame(*HERE.to_geodetic(-100.0, 200.0))], ids=["from here", "in a frame"]
)
@pytest.mark.parametrize("center", [(12.0, -16.0), (-16.0, 12.0)])
async def test_a_circle_around_a_place_goes_through_here_and_looks_at_it(
    center: tuple[float, float], frame: LocalFrame | None
) -> None:
    one, place = Loops(), HERE.to_geodetic(*center)
    north, east = center if frame is None else frame.to_local(*place)
    await one.loops.orbit(center_north=north, center_east=east, frame=frame)
    [checked] = one.guards.check_target.mock_calls
    assert checked.args == ("orbit", near(place, abs=1e-8))
    assert checked.kwargs == {"height": near(HEIGHT), "radius": near(20.0, abs=1e-3), "speed": 2.0}
    [(name, *_)] = one.runs  # no approach
    values, _, progress = one.step()
    bearing = math.degrees(math.atan2(center[1], center[0]))
    assert (name, values[3]) == ("orbit", near(bearing, abs=0.01))
    assert progress.distance_m == near(0.0, abs=1e-3)
    begun, there = Loops(), bearing + 180.0  # seen from the centre, it is there already
    await begun.loops.orbit(center_north=north, center_east=east, frame=frame, start_deg=there)
    assert [one[0] for one in begun.runs] == ["orbit"]


@pytest.mark.parametrize("face_ahead", [False, True])
async def test_a_path_is_flown_with_its_heading_and_each_point_is_looked_at(
    face_ahead: bool,
) -> None:
    one = Loops()
    points = [(30.0, 0.0, 14.0), (30.0, 40.0, 16.0)]
    await one.loops.fly_path(points, speed=4.0, corner_radius=3.0, face_ahead=face_ahead)
    assert [checked.args[0] for checked in one.guards.check_target.mock_calls] == [
        "point 0 of fly_path",
        "point 1 of fly_path",
    ]
    second = one.guards.check_target.mock_calls[1]
    assert second.args[1] == near(HERE.to_geodetic(30.0, 40.0), abs=1e-8)
    assert second.kwargs == {"height": 16.0, "speed": 4.0}
    _, setpoint, progress = one.step()
    assert setpoint.yaw == near(0.0 if face_ahead else YAW, abs=0.1)
    assert progress.height_error_m == near(16.0 - HEIGHT)
    assert 66.0 < progress.distance_m < 70.0, "the corner is rounded"
    await one.loops.fly_path(points, speed=4.0, yaw_deg=77.0)
    assert one.step()[1].yaw == 77.0


async def test_a_path_and_a_circle_become_faster_by_the_time_between_two_steps() -> None:
    """By 1 m/s² and by 0.8 m/s², the circle ahead of that by the lag of the velocity, 0.65 s."""
    one = Loops()
    north, east = math.cos(math.radians(YAW)), math.sin(math.radians(YAW))  # where it looks

    async def gained(ahead: tuple[float, float]) -> list[float]:
        along = []
        for _ in range(3):
            (x, y, *_), _, _ = one.step()
            along.append(x * ahead[0] + y * ahead[1])
            await asyncio.sleep(0.5)
        return [later - before for before, later in pairwise(along)]

    await one.loops.fly_path([(20.0 * north, 20.0 * east, HEIGHT)], speed=4.0)
    assert await gained((north, east)) == near([0.5, 0.5])
    await one.loops.orbit(center_north=20.0 * north, center_east=20.0 * east)
    assert await gained((east, -north)) == near([0.4 + 0.65 * 0.8, 0.4])


@pytest.mark.parametrize(
    "wrong",
    [
        {"north": 1.0, "up": 1.0},
        {"north": 1.0, "east": 1.0},
        {"north": 1.0, "east": 1.0, "up": 1.0, "height": 1.0},
        {"north": 1.0, "east": 1.0, "latitude_deg": 1.0, "longitude_deg": 1.0, "up": 1.0},
        {"latitude_deg": 1.0, "longitude_deg": 1.0, "frame": HERE, "up": 1.0},
        {"latitude_deg": 89.1, "longitude_deg": 1.0, "up": 1.0},
        {"latitude_deg": 1.0, "longitude_deg": math.nan, "up": 1.0},
        {"north": math.inf, "east": 1.0, "up": 1.0},
        {"north": 1.0, "east": 1.0, "up": -12.5},
        {"north": 1.0, "east": 1.0, "up": 1.0, "speed": 0.0},
        {"north": 1.0, "east": 1.0, "up": 1.0, "speed": 10.1},
    ],
)
async def test_what_is_no_target_is_not_flown_to(wrong: dict[str, Any]) -> None:
    one = Loops()
    with pytest.raises(UsageError):
        await one.loops.fly_to(**wrong)
    assert one.runs == []


# -- a control block: each option reaches its end --------------------------------------------------

NORTH = Setpoint.velocity(north=1.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def test_what_a_setpoint_is_sent_with() -> None:
    one: Any = MagicMock()
    one._guidance.flying = None
    Control.send(one, NORTH)
    Control.send(one, NORTH, lifetime=0.75, rate_hz=10.0, allow_long_lifetime=True)
    assert one._steering.steer.mock_calls == [
        call(NORTH, 0.2, 50.0, is_long_allowed=False),
        call(NORTH, 0.75, 10.0, is_long_allowed=True),
    ]


async def test_what_is_held_and_followed_is_sent_with() -> None:
    one: Any = MagicMock()
    one._steering.ends_neutral.side_effect = nullcontext
    given: dict[str, Any] = {"lifetime": 0.75, "allow_long_lifetime": True}
    async with Control.hold(one, NORTH, rate_hz=10.0, **given) as hold:
        hold.set(NORTH.neutral())
    async with Control.hold(one, NORTH):
        pass
    usual: dict[str, Any] = {"lifetime": 0.2, "allow_long_lifetime": False}
    assert one.send.mock_calls == [
        call(NORTH, rate_hz=10.0, **given),
        call(NORTH.neutral(), rate_hz=10.0, **given),
        call(NORTH, rate_hz=50.0, **usual),
    ]
    one.send.reset_mock()

    async def three() -> AsyncIterator[Any]:
        for number in range(3):
            yield Tick(number, 0.0, 0, 0.0)

    one.ticks.side_effect = lambda _: three()
    for rate, lifetime in ((50.0, 0.2), (5.0, 0.4)):
        await Control.follow(one, lambda tick: NORTH if tick.index < 2 else None, rate_hz=rate)
        assert one.ticks.mock_calls[-1] == call(rate)
        sent = call(NORTH, lifetime=near(lifetime), allow_long_lifetime=False)
        assert one.send.mock_calls == [sent] * 2, "two ticks, or a fifth of a second"
        one.send.reset_mock()
    await Control.follow(one, lambda tick: NORTH if tick.index < 1 else None, **given)
    assert one.send.mock_calls == [call(NORTH, **given)]


@pytest.mark.parametrize(
    ("name", "task"),
    [("take_off", Task.TAKE_OFF), ("land", Task.LAND), ("go_home", Task.GO_HOME)],
)
async def test_a_task_of_the_autopilot_has_its_time_and_its_listener(
    name: str, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = AsyncMock()
    monkeypatch.setattr(controls, "run_task", ran)
    one: Any = MagicMock()
    one._guards.admit_take_off = AsyncMock()
    one._run = lambda *given: Control._run(one, *given)
    await getattr(Control, name)(one, timeout=7.5, progress=PROGRESS)
    ran.assert_awaited_once_with(one._commander, task, timeout=7.5, progress=PROGRESS)
    is_up = task is Task.TAKE_OFF
    assert one._guards.admit_take_off.await_count == is_up
    assert one._block.taking_off.called is is_up
    assert one._make_way.mock_calls[0].kwargs == {"is_landing": not is_up}
    assert (one._unended_task, one._steering.running_task) == (None, None)


@pytest.mark.parametrize(
    ("task", "usual_s"), [(Task.TAKE_OFF, 20.0), (Task.LAND, 60.0), (Task.GO_HOME, 300.0)]
)
async def test_a_task_has_the_time_of_a_slow_line_besides(
    task: Task, usual_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch, commander = MagicMock(), MagicMock()
    watch.return_value.run = AsyncMock()
    monkeypatch.setattr(tasks, "_Watch", watch)
    commander.link.latency.slack_s = 0.7
    for given, limit in ((None, usual_s + 0.7), (1.5, 1.5)):
        await run_task(commander, task, timeout=given)
        assert watch.return_value.run.mock_calls[-1] == call(limit)


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("flight") == []


@pytest.mark.parametrize("on", [True, False])
@pytest.mark.parametrize(
    ("answer", "ends"),
    [(ArmCode.DONE, True), (ArmCode.ALREADY, True), (ArmCode.IN_THE_AIR, False)],
)
async def test_motors_are_asked_for_three_times_a_fifth_of_a_second_apart(
    answer: ArmCode, ends: bool, on: bool
) -> None:
    commander: Any = MagicMock()
    commander.requests.execute = AsyncMock(return_value=answer)
    commander.state = AircraftState(lambda: 0.0)
    with nullcontext() if ends else pytest.raises(TaskRefused):
        await switch_motors(commander, on=on)
    commander.requests.execute.assert_awaited_once_with(
        Arm(on), timeout=0.2, tries=3, refusal=TaskRefused
    )
