"""Waypoint missions flown on virtual time: track, actions, headings, speed, what comes after."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest

from m100link.protocol.commands.missions import Finished, Uploaded
from m100link.protocol.commands.waypoint import (
    WaypointMission,
    WaypointPauseResume,
    WaypointSetIdleSpeed,
)
from m100link.protocol.records import FlightPhase, RcMode
from m100link.sim import Airframe
from m100link.sim.vehicle.missions.route import LocalPlace, legs_between
from m100link.sim.vehicle.missions.waypoints import WaypointExecution, WaypointPhase
from m100link.sim.vehicle.remote import Sticks
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import (
    OK,
    SQUARE,
    begin,
    doing,
    events,
    farthest_beside,
    fly,
    host,
    nearest,
    point,
    reached,
    where,
)

POINTS = [point(index, *place) for index, place in enumerate(SQUARE)]


def phase(program: Host) -> WaypointPhase:
    running = program.vehicle.missions.running
    assert isinstance(running, WaypointExecution)
    return running.phase


def wait_for(program: Host, wanted: WaypointPhase, index: int | None = None) -> None:
    for _ in range(6000):
        running = program.vehicle.missions.running
        assert isinstance(running, WaypointExecution)
        if running.phase is wanted and index in (None, running.index):
            return
        program.wait(0.02)
    raise AssertionError(f"never {wanted}")


# --- the track ------------------------------------------------------------------------------


def test_on_the_ground_it_takes_off_climbs_and_passes_each_point_within_a_metre() -> None:
    program = host()
    begin(program, POINTS)
    track = fly(program)
    assert max(nearest(track, place) for place in SQUARE) < 0.4
    assert farthest_beside(track, [(0, 0, 0), *SQUARE]) < 0.5
    assert program.phase() is FlightPhase.IN_AIR  # finish action 0 hovers
    assert math.dist(where(program), SQUARE[-1]) < 0.5


def test_from_below_it_climbs_first_and_from_above_it_flies_straight() -> None:
    for height, line in (
        (3.0, [(-30, 0, 3), (-30, 0, 10), (0, 0, 10)]),
        (30.0, [(-30, 0, 30), (0, 0, 10)]),
    ):
        program = host()
        program.take_off()
        program.motion.place(-30.0, 0.0, height)
        begin(program, POINTS)
        track = []
        while phase(program) in (WaypointPhase.CLIMB, WaypointPhase.APPROACH):
            program.wait(0.05)
            track.append(where(program))
        assert farthest_beside(track, line) < 0.5


@pytest.mark.parametrize(("damping", "wind"), [(1.0, 0.0), (3.0, 6.0), (10.0, 6.0)])
def test_curves_are_flown_within_a_fifth_of_the_damping(damping: float, wind: float) -> None:
    places = [(0, 0, 10), (40, 0, 10), (40, 40, 14), (0, 40, 8), (-30, 10, 15)]
    program = host(settings={"wind_north": wind})
    points = [point(index, *place, damping=damping) for index, place in enumerate(places)]
    begin(program, points, trace_mode=1, max_speed=12.0, idle_speed=10.0)
    wait_for(program, WaypointPhase.FLY)
    track = fly(program)
    legs = legs_between([LocalPlace(*place) for place in places], [damping] * 5)
    line = [tuple(leg.at(leg.length * k / 500).place) for leg in legs for k in range(501)]
    assert farthest_beside(track, line) < 0.2 * damping  # type: ignore[arg-type] # three numbers
    for place in places[1:3]:
        assert nearest(track, place) > 0.3 * damping  # never through the point


HALF, EARLY, LATE = (math.sin(math.pi / 4.0), math.pi / 4.0 - 0.1, math.pi / 4.0 + 0.1)


@pytest.mark.parametrize(
    ("damping", "at", "moves", "stick", "expected"),
    [
        # 4 m/s in a curve of 8 m; braking by 1.8 m/s², 2 m before it: the square root of
        # 16 + 2 x 1.8 x 2, less 1.8 / 1.6.
        (8.0, (30.0, 0.0), (4.8, 0.0), 1.0, (4.8166 - 1.125, 0.0)),
        (8.0, (40.0, 10.0), (0.0, -4.8), -1.0, (0.0, -4.8166 + 1.125)),
        # In it: the pull of 2 m/s² where it will be after 0.2 s.
        *(
            (
                8.0,
                (32.0 + 8.0 * HALF, 8.0 - 8.0 * HALF),
                (way * 4.0 * HALF, way * 4.0 * HALF),
                way,
                (
                    way * 4.0 * HALF - 1.25 * math.sin(then),
                    way * 4.0 * HALF + 1.25 * math.cos(then),
                ),
            )
            for way, then in ((1.0, LATE), (-1.0, EARLY))
        ),
        # Tighter ones than 1.5 m are flown more slowly: the square root of 2 x 1 x 1 / 1.5.
        (1.0, (38.5, 0.0), (1.7, 0.0), 1.0, (math.sqrt(4.0 / 3.0 + 1.8) - 1.125, 0.0)),
        # A corner is passed at 0.8 m/s; a metre before it, 0.8 m/s more would still stop.
        (0.0, (39.0, 0.0), (1.0, 0.0), 1.0, (0.8 * math.sqrt(2.0) * (1.0 - 0.8 / 1.6), 0.0)),
        (0.0, (1.0, 0.0), (-1.0, 0.0), -1.0, (-0.8 * (1.0 - 0.8 / 1.6), 0.0)),
    ],
)
def test_the_velocity_before_and_in_a_curve(
    damping: float,
    at: tuple[float, float],
    moves: tuple[float, float],
    stick: float,
    expected: tuple[float, float],
) -> None:
    program = host({"airframe": Airframe()})
    places = [(0.0, 0.0, 10.0), (40.0, 0.0, 10.0), (40.0, 30.0, 10.0)]
    points = [point(index, *place, damping=damping) for index, place in enumerate(places)]
    begin(program, points, trace_mode=1, idle_speed=5.0)
    flown, motion = program.vehicle.missions.running, program.motion
    assert isinstance(flown, WaypointExecution)
    assert [flown._is_passed(index) for index in range(3)] == [False, True, False]
    motion.place(*at, 10.0)
    motion.velocity_north, motion.velocity_east = moves
    flown.phase, flown._s = WaypointPhase.FLY, at[0] + at[1]
    guidance = flown.guide(Sticks(0.0, stick, 0.0, 0.0, RcMode.F, gear_down=True))
    assert (guidance.a, guidance.b) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ("turn_mode", "before", "after", "shown"),
    [
        (0, 90, -30, 150.0),
        (1, 90, -30, 60.0),
        (0, -30, 90, 0.0),
        (1, -30, 90, -90.0),
        (0, 40, 40, 40.0),
        (1, 40, 40, 40.0),
    ],
)
def test_a_quarter_of_the_way_it_has_turned_a_quarter_and_aims_half_a_second_ahead(
    turn_mode: int, before: int, after: int, shown: float
) -> None:
    program = host()
    points = [
        point(0, 0, 0, 10, yaw=before, gimbal_pitch=-10),
        point(1, 40, 0, 10, yaw=after, gimbal_pitch=-50, turn_mode=turn_mode),
    ]
    begin(program, points, yaw_mode=3, gimbal_pitch_mode=1, idle_speed=4.0)
    flown = program.vehicle.missions.running
    assert isinstance(flown, WaypointExecution)
    program.motion.place(10.0, 0.0, 10.0)
    flown.phase, flown._s, flown._since_aimed = WaypointPhase.FLY, 10.0, 0.5
    flown.guide(Sticks(0.0, 0.0, 0.0, 0.0, RcMode.F, gear_down=True))
    turned = math.degrees(flown._nose._target)
    assert math.remainder(turned - shown, 360.0) == pytest.approx(0.0, abs=0.01)
    gimbal = program.vehicle.gimbal
    for step in range(60):
        gimbal.advance(program.now + 0.01 * step, 0.01)
    assert gimbal.pitch == pytest.approx(-10.0 - 40.0 * (0.25 + 0.5 * 4.0 / 40.0), abs=0.01)


def test_a_corner_without_a_curve_is_passed_within_a_metre_and_without_a_stop() -> None:
    program = host()
    begin(program, POINTS, trace_mode=1, idle_speed=8.0)
    wait_for(program, WaypointPhase.FLY)
    speeds, track = [], []
    while phase(program) is WaypointPhase.FLY:
        program.wait(0.05)
        track.append(where(program))
        if math.dist(track[-1], SQUARE[3]) > 3.0 < math.dist(track[-1], SQUARE[0]):
            speeds.append(math.hypot(program.motion.speed, program.motion.velocity_up))
    assert max(nearest(track, place) for place in SQUARE[1:3]) < 0.5
    assert min(speeds) > 0.4
    assert max(speeds) > 5.0


def test_a_negative_height_ends_at_the_ground_and_breaks_the_mission_off() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 5), point(1, 20, 0, -20)])
    fly(program)
    last = program.vehicle.missions.last
    assert (last.flags, last.reason) == (1, 0xC1)
    assert program.motion.on_ground
    assert not program.motion.motors_on


# --- events ---------------------------------------------------------------------------------


def test_stopping_at_points_tells_of_each_twice_and_curves_of_the_ends() -> None:
    program = host()
    begin(program, POINTS)
    fly(program)
    assert reached(program) == [(index, status) for index in range(4) for status in (4, 6)]
    first, last = events(program)[0], events(program)[-1]
    assert isinstance(first, Uploaded)
    assert (first.valid, first.estimated_time) == (1, round((20 + 425**0.5 + 409**0.5) / 5 + 16))
    assert last == Finished(repeat=0)
    curved = host()
    begin(curved, [point(i, *place, damping=2.0) for i, place in enumerate(SQUARE)], trace_mode=1)
    fly(curved)
    assert reached(curved) == [(0, 4), (0, 6), (3, 4), (3, 6)]


def test_the_second_run_goes_back_to_the_first_point() -> None:
    program = host()
    begin(program, POINTS, repeat=2)
    track = fly(program)
    assert [index for index, status in reached(program) if status == 4] == [0, 1, 2, 3] * 2
    assert [e for e in events(program) if isinstance(e, Finished)] == [Finished(1), Finished(0)]
    assert max(nearest(track[-600:], place) for place in SQUARE) < 0.5


# --- what comes after -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("finish", "place", "lands"),
    [(0, SQUARE[-1], False), (1, (0, 0, 0), True), (2, (0, 60, 0), True), (3, SQUARE[0], False)],
)
def test_finish_actions(finish: int, place: tuple[float, float, float], lands: bool) -> None:
    places = [SQUARE[0], (20.0, 60.0, 10.0), (0.0, 60.0, 12.0) if lands else SQUARE[-1]]
    program = host()
    begin(program, [point(i, *p) for i, p in enumerate(places)], finish_action=finish)
    fly(program)
    program.wait(60.0)
    assert math.dist(where(program), place) < 0.6
    assert program.motion.motors_on is not lands
    assert program.vehicle.missions.last.flags == 0


def test_going_home_from_nearby_lands_in_place() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 10), point(1, 10, 0, 10)], finish_action=1)
    fly(program)
    program.wait(30.0)
    assert math.dist(where(program), (10, 0, 0)) < 0.5
    assert not program.motion.motors_on


def test_an_endless_mission_waits_and_flies_back_by_the_stick() -> None:
    program = host()
    begin(program, POINTS, finish_action=4)
    wait_for(program, WaypointPhase.WAIT)
    told = reached(program)
    program.wait(20.0)
    assert math.dist(where(program), SQUARE[-1]) < 0.3
    program.aircraft.move_stick(pitch=-1.0)
    program.wait(30.0)
    assert nearest([where(program)], SQUARE[0]) < 1.0
    program.aircraft.release_sticks()
    wait_for(program, WaypointPhase.WAIT)
    assert math.dist(where(program), SQUARE[-1]) < 0.5
    assert reached(program) == told
    assert program.vehicle.missions.running is not None


# --- speed ----------------------------------------------------------------------------------

LONG_PLACES = [(0.0, 0.0, 10.0), (150.0, 0.0, 10.0), (150.0, 100.0, 10.0)]
LONG = [point(index, *place) for index, place in enumerate(LONG_PLACES)]


@pytest.mark.parametrize(("stick", "speed"), [(0.0, 4.0), (0.5, 9.0), (1.0, 10.0), (-0.2, 2.0)])
def test_the_pitch_stick_adds_to_the_idle_speed(stick: float, speed: float) -> None:
    program = host()
    begin(program, LONG, idle_speed=4.0)
    wait_for(program, WaypointPhase.FLY)
    program.aircraft.move_stick(pitch=stick)
    program.wait(7.0)
    assert program.motion.velocity_north == pytest.approx(speed, abs=0.2)


def test_back_past_zero_it_flies_the_path_backwards_without_actions() -> None:
    program = host()
    points = [point(i, *place, **doing((1, 0))) for i, place in enumerate(LONG_PLACES)]
    begin(program, points)
    wait_for(program, WaypointPhase.FLY, 2)
    program.wait(3.0)
    photos = program.vehicle.camera.photos
    assert photos == 2
    program.aircraft.move_stick(pitch=-1.0)
    track = []
    for _ in range(1200):
        program.wait(0.05)
        track.append(where(program))
    assert math.dist(where(program), (0, 0, 10)) < 0.6  # hovers at the first point
    assert nearest(track, (150, 0, 10)) < 1.0
    assert farthest_beside(track, LONG_PLACES) < 1.0
    program.aircraft.release_sticks()
    fly(program)
    assert program.vehicle.camera.photos == 3  # once at each point, however often it is passed
    assert [index for index, status in reached(program) if status == 4] == [0, 1, 2]


@pytest.mark.parametrize("idle", [0.0, -3.0])
def test_without_a_forward_speed_it_waits_for_the_stick(idle: float) -> None:
    program = host()
    begin(program, LONG, idle_speed=idle)
    wait_for(program, WaypointPhase.FLY)
    program.wait(20.0)
    assert math.dist(where(program), (0, 0, 10)) < 0.5
    program.aircraft.move_stick(pitch=0.8)
    program.wait(10.0)
    assert program.motion.velocity_north == pytest.approx(idle + 8.0, abs=0.2)


def test_a_steep_leg_is_as_fast_as_the_aircraft_climbs() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 5), point(1, 2, 0, 60)], idle_speed=10.0)
    wait_for(program, WaypointPhase.FLY)
    track = fly(program)
    assert farthest_beside(track, [(0, 0, 5), (2, 0, 60)]) < 0.3


# --- heading --------------------------------------------------------------------------------


def heading(program: Host) -> float:
    return program.vehicle.heading_deg


def test_yaw_mode_0_points_along_the_path_and_4_is_the_same() -> None:
    for mode in (0, 4):
        program = host()
        # DJI's ROS demonstration sends 4; no encoder of ours does.
        program.ask_raw(b"\x03\x10" + _mission_bytes(3, yaw_mode=mode))
        for each in LONG:
            assert program.ask(each).code == OK
        program.ask_raw(b"\x03\x12\x00")
        wait_for(program, WaypointPhase.FLY, 2)
        program.wait(5.0)
        assert heading(program) == pytest.approx(90.0, abs=2.0)


def _mission_bytes(count: int, **fields: Any) -> bytes:
    mission = WaypointMission(count, 10.0, 5.0, **fields)
    return WaypointMission.LAYOUT.write(mission)


def test_yaw_mode_1_keeps_the_heading_of_the_start() -> None:
    program = host(settings={"heading_deg": 40.0})
    begin(program, LONG, yaw_mode=1, idle_speed=10.0)
    headings = []
    while program.vehicle.missions.running is not None:
        program.wait(0.1)
        headings.append(heading(program))
    assert min(headings) == pytest.approx(40.0, abs=1.0) == pytest.approx(max(headings), abs=1.0)


def test_yaw_mode_2_obeys_the_yaw_stick() -> None:
    program = host()
    begin(program, LONG, yaw_mode=2)
    wait_for(program, WaypointPhase.FLY)
    before = heading(program)
    program.wait(2.0)
    assert heading(program) == pytest.approx(before, abs=0.5)
    program.aircraft.move_stick(yaw=0.2)
    program.wait(2.0)
    assert heading(program) - before == pytest.approx(40.0, abs=5.0)


def test_yaw_mode_3_turns_evenly_to_the_heading_of_the_next_point() -> None:
    program = host()
    points = [point(0, 0, 0, 10, yaw=0), point(1, 100, 0, 10, yaw=90)]
    begin(program, points, yaw_mode=3)
    wait_for(program, WaypointPhase.FLY)
    shown = []
    while phase(program) is WaypointPhase.FLY:
        program.wait(0.1)
        shown.append((program.motion.north, heading(program)))
    for north, degrees in shown:
        assert degrees == pytest.approx(0.9 * north, abs=6.0)


@pytest.mark.parametrize(("turn_mode", "way"), [(0, 1.0), (1, -1.0)])
def test_a_point_turns_in_its_direction(turn_mode: int, way: float) -> None:
    program = host()
    begin(
        program,
        [point(0, 0, 0, 10, yaw=120, turn_mode=turn_mode), point(1, 30, 0, 10, yaw=120)],
        yaw_mode=3,
    )
    wait_for(program, WaypointPhase.TURN)
    turned, before = 0.0, heading(program)
    while phase(program) is WaypointPhase.TURN:
        program.wait(0.05)
        turned += math.remainder(heading(program) - before, 360.0)
        before = heading(program)
    assert turned == pytest.approx(120.0 if way > 0 else -240.0, abs=4.0)


# --- gimbal ---------------------------------------------------------------------------------


@pytest.mark.parametrize("trace", [0, 1])
def test_the_gimbals_pitch_changes_evenly_from_point_to_point(trace: int) -> None:
    program = host()
    points = [
        point(0, 0, 0, 10, gimbal_pitch=0),
        point(1, 60, 0, 10, gimbal_pitch=-60, damping=2.0),
        point(2, 60, 40, 10, gimbal_pitch=-20),
    ]
    begin(program, points, gimbal_pitch_mode=1, trace_mode=trace)
    wait_for(program, WaypointPhase.FLY, 1)
    shown = []
    while program.motion.north < 57.0:
        program.wait(0.1)
        shown.append((program.motion.north, program.vehicle.gimbal.pitch))
    for north, pitch in shown:
        assert pitch == pytest.approx(-north, abs=4.0)
    fly(program)
    assert program.vehicle.gimbal.pitch == pytest.approx(-20.0, abs=4.0)


def test_the_gimbal_has_the_pitch_of_the_first_point_a_second_after_it() -> None:
    """Inferred: it turns there while the aircraft waits, and not over the next leg."""
    program = host()
    points = [
        point(0, 0, 0, 10, gimbal_pitch=-30, **doing((0, 3000))),
        point(1, 60, 0, 10, gimbal_pitch=0),
    ]
    begin(program, points, gimbal_pitch_mode=1)
    wait_for(program, WaypointPhase.REACHED, 0)
    for seconds, pitch in ((0.5, -15.0), (0.6, -30.0), (1.5, -30.0)):
        program.wait(seconds)
        assert program.vehicle.gimbal.pitch == pytest.approx(pitch, abs=2.0)


def test_a_free_gimbal_is_left_alone() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 10, gimbal_pitch=-90), point(1, 20, 0, 10, gimbal_pitch=-30)])
    fly(program)
    assert program.vehicle.gimbal.pitch == 0.0


# --- pause ----------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [0.5, 3.0, 6.0, 9.0, 13.0, 16.0, 20.0, 25.0])
def test_a_pause_hovers_and_changes_nothing_about_the_rest(after: float) -> None:
    program = host()
    points = [
        point(i, *place, yaw=30 * i, **doing((0, 1500), (1, 0), (4, 45)))
        for i, place in enumerate(SQUARE)
    ]
    begin(program, points, yaw_mode=3)
    program.wait(after)
    assert program.ask(WaypointPauseResume(0)) == OK
    program.wait(8.0)
    at = where(program)
    program.wait(5.0)
    assert math.dist(where(program), at) < 0.1
    assert program.ask(WaypointPauseResume(1)) == OK
    track = fly(program)
    assert [index for index, status in reached(program) if status == 4] == [0, 1, 2, 3]
    assert program.vehicle.camera.photos == 4
    assert math.dist(track[-1], SQUARE[-1]) < 0.5


def test_after_a_pause_on_its_way_there_it_flies_straight_to_the_first_point() -> None:
    program = host()
    program.take_off()
    program.motion.place(-30.0, 0.0, 10.0)
    begin(program, POINTS)
    wait_for(program, WaypointPhase.APPROACH)
    assert program.ask(WaypointPauseResume(0)) == OK
    program.wait(3.0)
    program.motion.place(-20.0, 15.0, 10.0)  # the pilot moves it
    assert program.ask(WaypointPauseResume(1)) == OK
    track = []
    while phase(program) is WaypointPhase.APPROACH:
        program.wait(0.05)
        track.append(where(program))
    assert farthest_beside(track, [(-20, 15, 10), (0, 0, 10)]) < 0.5
    assert math.dist(track[-1], (0, 0, 10)) < 0.5


# --- the long one ---------------------------------------------------------------------------


def test_fifty_points_with_actions_each_once_and_in_order() -> None:
    program = host(settings={"airframe": Airframe(hover_minutes=60.0)})
    places = [
        (4.0 * (i // 10), 6.0 * (i % 10 if i // 10 % 2 == 0 else 9 - i % 10), 10 + i % 3)
        for i in range(50)
    ]
    actions = [((1, 0),), ((2, 0), (0, 500)), ((3, 0),), ((5, -10 * (1 % 9)),), ((4, 90), (1, 0))]
    points = [point(i, *place, **doing(*actions[i % 5])) for i, place in enumerate(places)]
    begin(program, points)
    track = fly(program, seconds=1200.0)
    assert max(nearest(track, place) for place in places) < 1.0
    assert farthest_beside(track, [(0, 0, 0), *places]) < 1.0
    assert reached(program) == [(index, status) for index in range(50) for status in (4, 6)]
    assert program.vehicle.camera.photos == 20
    log = [entry.text for entry in program.vehicle.events if entry.text.endswith(": photo")]
    assert log == [f"waypoint {i}: photo" for i in range(50) if i % 5 in (0, 4)]
    assert isinstance(events(program)[-1], Finished)


def test_the_speed_may_be_changed_while_paused() -> None:
    program = host()
    begin(program, LONG)
    wait_for(program, WaypointPhase.FLY)
    program.ask(WaypointPauseResume(0))
    program.ask(WaypointSetIdleSpeed(9.0))
    program.ask(WaypointPauseResume(1))
    program.wait(6.0)
    assert program.motion.velocity_north == pytest.approx(9.0, abs=0.2)


def test_all_phases_have_a_status_that_djis_programs_know() -> None:
    assert {each.status for each in WaypointPhase} <= set(range(7))
    assert all(a.value != b.value for a, b in pairwise(WaypointPhase))
