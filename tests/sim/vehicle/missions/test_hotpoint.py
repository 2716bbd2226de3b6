"""Circles flown on virtual time, and the codes of a start."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.protocol.codes import MissionCode as Code
from m100link.protocol.commands.hotpoint import (
    FollowPauseResume,
    FollowStart,
    FollowTarget,
    HotpointPauseResume,
    HotpointResetYaw,
    HotpointSetRadius,
    HotpointSetRate,
    HotpointStart,
)
from m100link.protocol.commands.missions import HotpointStatus
from m100link.protocol.records import RcMode
from m100link.sim.vehicle.dynamics import Dynamics, ModelVertical, ModelYaw
from m100link.sim.vehicle.missions.hotpoint import (
    FollowExecution,
    HotpointExecution,
    follow_code,
    hotpoint_code,
    largest_rate,
)
from m100link.sim.vehicle.missions.route import LocalPlace, MissionSettings, Site
from m100link.sim.vehicle.remote import Sticks
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import OK, host, hotpoint, radians_at, where


def flying(north: float = 0.0, east: float = 0.0, height: float = 15.0, **missions: Any) -> Host:
    program = host(**missions)
    program.take_off()
    program.motion.place(north, east, height)
    return program


def circling(program: Host, **fields: Any) -> Host:
    assert program.ask(hotpoint(**fields)).code == OK
    for _ in range(600):
        if status(program).status == 1:
            break
        program.wait(0.1)
    program.wait(5.0)
    return program


def status(program: Host) -> HotpointStatus:
    told = program.vehicle.missions.status().status
    assert isinstance(told, HotpointStatus)
    return told


def radius(program: Host) -> float:
    return math.hypot(program.motion.north, program.motion.east)


def bearing(program: Host) -> float:
    return math.degrees(math.atan2(program.motion.east, program.motion.north))


def raw(program: Host, **fields: Any) -> Code:
    """The code of a start that no encoder of ours would send."""
    command = hotpoint()
    changed = {**command.raw(), **fields}
    ack = program.ask_raw(b"\x03\x20" + HotpointStart.LAYOUT.write(HotpointStart(**changed)))
    assert ack is not None
    assert len(ack.data) == 5
    return Code(ack.data[0])


def sticks(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, up: float = 0.0) -> Sticks:
    return Sticks(roll, pitch, yaw, up, RcMode.F, gear_down=True)


# --- codes ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "fields"),
    [
        (Code.BAD_NUMBER, {"latitude": math.nan, "clockwise": 7}),
        (Code.BAD_NUMBER, {"radius": math.inf}),
        (Code.BAD_NUMBER, {"angular_rate": math.nan}),
        (Code.BAD_POSITION, {"latitude": 0.0, "longitude": 0.0, "clockwise": 7}),
        (Code.BAD_POSITION, {"latitude": 1.6}),
        (Code.BAD_POSITION, {"longitude": -3.2}),
        (Code.BAD_DIRECTION, {"clockwise": 2, "start_point": 9}),
        (Code.BAD_START_POINT, {"start_point": 5, "yaw_mode": 9}),
        (Code.BAD_YAW_MODE, {"yaw_mode": 5, "radius": 1.0}),
        (Code.BAD_RADIUS, {"radius": 4.9, "altitude": 1.0}),
        (Code.BAD_RADIUS, {"radius": 500.5}),
        (Code.TOO_LOW, {"altitude": 4.9, "angular_rate": 99.0}),
        (Code.TOO_HIGH, {"altitude": 120.5, "angular_rate": 99.0}),
        (Code.RATE_TOO_HIGH, {"angular_rate": 30.1}),
        (Code.RATE_TOO_HIGH, {"radius": 100.0, "angular_rate": 5.8}),
        (Code.SUCCESS, {"radius": 100.0, "angular_rate": 5.73}),
        (Code.RATE_TOO_HIGH, {"angular_rate": -1.0}),
    ],
)
def test_what_is_wrong_with_a_start(code: Code, fields: dict[str, Any]) -> None:
    assert raw(flying(), **fields) == code


def test_where_a_circle_may_be() -> None:
    assert flying(radius_limit=math.inf).ask(hotpoint(2001.0)).code == Code.TOO_FAR_AWAY
    assert flying(radius_limit=math.inf).ask(hotpoint(1999.0)).code == OK
    assert flying().ask(hotpoint(501.0)).code == Code.TOO_FAR_FROM_HOME
    far = flying(north=-500.0, east=30.0, radius_limit=math.inf)  # from where it is
    assert far.ask(hotpoint(1501.0)).code == Code.TOO_FAR_AWAY
    assert far.ask(hotpoint(1499.0)).code == OK
    near = flying(radius_limit=100.0)
    answer = near.ask(hotpoint(60.0, radius=41.0, angular_rate=5.0))
    assert answer.code == Code.TOO_FAR_FROM_HOME
    assert answer.largest_radius == pytest.approx(40.0, abs=0.01)
    assert near.ask(hotpoint(60.0, radius=39.0, angular_rate=5.0)).code == OK
    away = flying(north=50.0, east=-20.0, radius_limit=100.0)  # from home, wherever it is now
    assert away.ask(hotpoint(60.0, radius=41.0, angular_rate=5.0)).code == Code.TOO_FAR_FROM_HOME
    assert away.ask(hotpoint(60.0, radius=39.0, angular_rate=5.0)).code == OK


def test_distances_count_on_both_axes() -> None:
    """56.6 m from home to the centre, and 113 m from the aircraft; 21.2 km and 56.6 m."""
    here, home = LocalPlace(-50.0, 50.0, 10.0), LocalPlace(-10.0, 10.0, 0.0)
    circle = hotpoint(30.0, -30.0, radius=5.0)
    for settings, code in (
        (MissionSettings(), Code.SUCCESS),
        (MissionSettings(radius_limit=60.0), Code.TOO_FAR_FROM_HOME),
        (MissionSettings(farthest_start=100.0), Code.TOO_FAR_AWAY),
    ):
        site = Site(22.5431, 113.9589, 120.0, settings)
        assert hotpoint_code(circle, site, here, home) == code
    site = Site(22.5431, 113.9589, 120.0, MissionSettings(radius_limit=50.0))
    target = FollowStart(*radians_at(12_000.0, -12_000.0))
    here, near = LocalPlace(-3000.0, 3000.0, 10.0), LocalPlace(-2960.0, 2960.0, 0.0)
    assert follow_code(target, site, here, near) == Code.TARGET_TOO_FAR
    target = FollowStart(*radians_at(0.0, 0.0))
    assert follow_code(
        target, site, LocalPlace(-30.0, 30.0, 10.0), LocalPlace(10.0, -10.0, 0.0)
    ) == (Code.TOO_FAR_FROM_HOME)


def test_on_the_ground_it_does_not_start() -> None:
    assert host().ask(hotpoint()).code == Code.NOT_IN_THE_AIR


@pytest.mark.parametrize(
    ("metres", "rate"), [(5.0, 30.0), (19.1, 30.0), (50.0, 11.46), (100.0, 5.73), (500.0, 1.146)]
)
def test_the_largest_rate_is_10_metres_per_second_along_the_circle(
    metres: float, rate: float
) -> None:
    assert largest_rate(metres) == pytest.approx(rate, abs=0.01)


# --- the circle -----------------------------------------------------------------------------


@pytest.mark.parametrize("wind", [0.0, 5.0])
@pytest.mark.parametrize(
    ("metres", "rate", "clockwise"),
    [(5.0, 30.0, 1), (10.0, 15.0, 0), (19.1, 30.0, 1), (50.0, 11.4, 0), (100.0, 2.0, 1)],
)
def test_the_circle_has_its_radius_rate_and_height(
    metres: float, rate: float, clockwise: int, wind: float
) -> None:
    program = flying(30.0, 0.0)
    program.aircraft.set_wind(wind, 0.0)
    circling(program, radius=metres, angular_rate=rate, clockwise=clockwise)
    turned, before = 0.0, bearing(program)
    for _ in range(100):
        program.wait(0.1)
        turned += math.remainder(bearing(program) - before, 360.0)
        before = bearing(program)
        assert radius(program) == pytest.approx(metres, abs=0.5)
        assert program.motion.height == pytest.approx(20.0, abs=0.2)
    assert turned == pytest.approx((1 if clockwise else -1) * 10.0 * rate, rel=0.05)
    told = status(program)
    assert told.radius_cm == pytest.approx(100.0 * metres, abs=60)
    assert told.rate == pytest.approx(min(255, 10.0 * rate), abs=5)


@pytest.mark.parametrize(
    ("start", "direction"), [(0, 0.0), (1, 180.0), (2, -90.0), (3, 90.0), (4, 45.0)]
)
def test_the_start_point(start: int, direction: float) -> None:
    program = flying(40.0, 40.0)
    assert program.ask(hotpoint(start_point=start, angular_rate=3.0)).code == OK
    assert status(program).status == 0
    while status(program).status == 0:
        program.wait(0.05)
    assert math.remainder(bearing(program) - direction, 360.0) == pytest.approx(0.0, abs=6.0)


@pytest.mark.parametrize("clockwise", [0, 1])
@pytest.mark.parametrize(("mode", "off"), [(0, 90.0), (1, 180.0), (2, 0.0)])
def test_the_nose_along_the_path_to_the_centre_or_outwards(
    mode: int, off: float, clockwise: int
) -> None:
    program = circling(flying(), yaw_mode=mode, clockwise=clockwise)
    wanted = off if clockwise or mode else -off
    for _ in range(50):
        program.wait(0.2)
        beside = math.remainder(program.vehicle.heading_deg - bearing(program) - wanted, 360.0)
        assert abs(beside) < 6.0


@pytest.mark.parametrize("mode", [3, 4])
def test_the_nose_as_it_was_or_by_the_stick(mode: int) -> None:
    program = circling(flying(), yaw_mode=mode)
    assert program.vehicle.heading_deg == pytest.approx(0.0, abs=1.0)
    program.aircraft.move_stick(yaw=0.3)
    program.wait(1.0)
    program.aircraft.release_sticks()
    program.wait(3.0)
    assert program.vehicle.heading_deg == pytest.approx(30.0, abs=3.0)
    program.ask(HotpointResetYaw())
    program.wait(4.0)
    assert program.vehicle.heading_deg == pytest.approx(0.0, abs=1.0)


def on_a_circle(settings: MissionSettings | None = None, **fields: Any) -> HotpointExecution:
    """Around (7, -17) at 20 m, 10 m away from it on the bearing of 53.13 degrees."""
    motion = Dynamics()
    motion.place(13.0, -9.0, 19.9, yaw_deg=25.0)
    command = hotpoint(7.0, -17.0, start_point=4, **fields)
    centre = LocalPlace(7.0, -17.0, 20.0)
    settings = settings or MissionSettings()
    execution = HotpointExecution(command, centre, motion, motion.airframe, settings)
    execution.guide(sticks())
    assert execution.doing == "circles"
    return execution


@pytest.mark.parametrize("clockwise", [1, 0])
@pytest.mark.parametrize(
    ("mode", "off"), [(0, 90.0), (1, 180.0), (2, 0.0), (3, 25.0 - 53.13), (4, 25.0 - 53.13)]
)
def test_the_velocity_and_heading_on_a_circle_that_it_has_left_by_two_metres(
    mode: int, off: float, clockwise: int
) -> None:
    """2.618 m/s along it, 0.8 m/s inwards per metre, and a lead for the pull of 0.685 m/s²."""
    execution = on_a_circle(yaw_mode=mode, clockwise=clockwise)
    motion, sign = execution._motion, 1.0 if clockwise else -1.0
    motion.north, motion.east = 7.0 + 7.2, -17.0 + 9.6  # 12 m away
    guidance = execution.guide(sticks())
    rate, ahead = math.radians(15.0), math.radians(53.130 + sign * 15.0 * 0.2)
    pull = rate**2 * 10.0 / 1.6
    assert (guidance.a, guidance.b, guidance.up) == pytest.approx(
        (
            sign * 10.0 * rate * -0.8 - 1.6 * 0.6 - pull * math.cos(ahead),
            sign * 10.0 * rate * 0.6 - 1.6 * 0.8 - pull * math.sin(ahead),
            20.0,
        ),
        abs=1e-4,
    )
    assert (guidance.vertical, guidance.yaw_mode) == (ModelVertical.HEIGHT, ModelYaw.ANGLE)
    # The yaw follows its order 1 / 2.0 + 0.15 s late.
    wanted = 53.13 + (sign * off if mode == 0 else off) + (sign * 15.0 * 0.65 if mode < 3 else 0.0)
    assert math.remainder(math.degrees(guidance.yaw) - wanted, 360.0) == pytest.approx(0, abs=0.01)
    motion.velocity_north, motion.velocity_east = -1.0, 2.0
    told = execution.status(is_paused=False)
    # Of (-1, 2) m/s, 2 x 0.6 + 1 x 0.8 m/s go round: 9.55 degrees a second at 12 m.
    assert (told.status, told.radius_cm, told.rate) == (1, 1200, 95)
    motion.east = -17.0 + 120.0
    assert execution.is_out_of_reach


def test_sticks_move_height_radius_and_nose_by_their_rates() -> None:
    """In 0.01 s: 4 m/s and 3 m/s and 100 degrees a second at the end of the travel."""
    execution = on_a_circle(yaw_mode=2, angular_rate=0.0)
    guidance = execution.guide(sticks(pitch=0.5, yaw=-0.25, up=-0.75))
    assert guidance.up == pytest.approx(20.0 - 0.03)
    assert execution._radius == pytest.approx(10.0 - 0.015)
    assert math.degrees(guidance.yaw) == pytest.approx(53.1301 - 0.25, abs=1e-3)
    execution.set_radius(40.0)
    execution.guide(sticks())
    assert execution._flown_radius == pytest.approx(10.0 - 0.015 + 0.03)
    execution.set_radius(5.0)
    execution.guide(sticks())
    assert execution._flown_radius == pytest.approx(10.0 - 0.015)


# --- changes on the way ---------------------------------------------------------------------


def test_a_new_rate_and_direction_and_one_that_is_too_fast() -> None:
    program = circling(flying())
    program.ask(HotpointSetRate(0, 5.0))
    program.wait(8.0)
    assert status(program).rate == pytest.approx(50, abs=3)
    before = bearing(program)
    program.wait(2.0)
    assert math.remainder(bearing(program) - before, 360.0) == pytest.approx(-10.0, abs=1.5)
    program.send(b"\x03\x23\x01" + bytes.fromhex("0000c842"), session=0)  # 100 °/s
    program.wait(10.0)
    assert status(program).rate == 255
    assert radius(program) == pytest.approx(10.0, abs=0.5)


def test_a_new_radius_comes_at_3_metres_per_second_and_slows_the_rate() -> None:
    program = circling(flying(), angular_rate=30.0)
    program.ask(HotpointSetRadius(70.0))
    program.wait(10.0)
    assert radius(program) == pytest.approx(40.0, abs=5.0)
    program.wait(16.0)
    assert radius(program) == pytest.approx(70.0, abs=0.7)
    assert status(program).rate == pytest.approx(10.0 * largest_rate(70.0), abs=3)
    for silly in ("0000803f", "00007a45", "0000c07f"):  # 1 m, 4000 m, NaN
        program.send(b"\x03\x24" + bytes.fromhex(silly), session=0)
    program.wait(3.0)
    assert radius(program) == pytest.approx(70.0, abs=0.7)


def test_sticks_change_height_and_radius() -> None:
    program = circling(flying())
    program.aircraft.move_stick(throttle=0.5, pitch=-1.0)
    program.wait(4.0)
    program.aircraft.release_sticks()
    program.wait(4.0)
    assert program.motion.height == pytest.approx(28.0, abs=0.5)
    assert radius(program) == pytest.approx(22.0, abs=0.7)


def test_changes_while_nothing_runs_are_ignored() -> None:
    program = flying()
    for command in (HotpointSetRadius(50.0), HotpointSetRate(0, 5.0), HotpointResetYaw()):
        assert program.ask(command) is None
    assert program.vehicle.missions.running is None


def test_a_pause_hovers_and_a_resume_far_outside_is_refused() -> None:
    program = circling(flying())
    assert program.ask(HotpointPauseResume(0)) == OK
    program.wait(4.0)
    assert status(program).status == 2
    assert program.motion.speed < 0.05
    assert program.ask(HotpointPauseResume(1)) == OK
    program.wait(6.0)
    assert status(program).status == 1
    assert status(program).rate == pytest.approx(150, abs=6)
    program.ask(HotpointPauseResume(0))
    program.motion.place(111.0, 0.0, 20.0)
    assert program.ask(HotpointPauseResume(1)) == Code.TOO_FAR_FROM_CIRCLE


def test_an_aircraft_pulled_away_breaks_the_circle_off() -> None:
    program = circling(flying())
    program.motion.place(125.0, 0.0, 20.0)
    program.wait(0.1)
    last = program.vehicle.missions.last
    assert (last.last_mission, last.flags, last.reason) == (2, 1, Code.TOO_FAR_FROM_CIRCLE)


# -- following a target on virtual time, and the codes of a start ----------------------------------


def beside_the_target(
    north: float = -10.0, east: float = 0.0, height: float = 15.0, **missions: Any
) -> Host:
    program = host(**missions)
    program.take_off()
    program.motion.place(north, east, height)
    return program


def start(program: Host, north: float = 0.0, east: float = 0.0, **fields: Any) -> Code:
    code: Code = program.ask(FollowStart(*radians_at(north, east), **fields))
    return code


def target(program: Host, north: float, east: float, altitude: int = 0) -> None:
    assert program.ask(FollowTarget(*radians_at(north, east), altitude), session=0) is None


def walk(
    program: Host, seconds: float, speed: float, *, rate_hz: float = 5.0, begin: float = 0.0
) -> float:
    """The target walks east; where it ends."""
    east = begin
    for _ in range(round(seconds * rate_hz)):
        east += speed / rate_hz
        target(program, 0.0, east)
        program.wait(1.0 / rate_hz)
    return east


def test_what_is_wrong_with_a_start_of_following() -> None:
    assert start(host()) == Code.NOT_IN_THE_AIR
    assert start(beside_the_target(height=4.9)) == Code.TOO_LOW
    assert start(beside_the_target(), 21_000.0) == Code.TARGET_TOO_FAR
    assert start(beside_the_target(north=-60.0, radius_limit=50.0)) == Code.TOO_FAR_FROM_HOME
    for fields in ({"mode": 1}, {"yaw_mode": 2}, {"latitude": 2.0}, {"longitude": math.nan}):
        program = beside_the_target()
        latitude, longitude = radians_at(0.0, 0.0)
        changed = {"latitude": latitude, "longitude": longitude} | fields
        value = FollowStart.LAYOUT.write(FollowStart(**changed))
        ack = program.ask_raw(b"\x03\x30" + value)
        assert ack is not None, fields
        assert ack.data == bytes((Code.BAD_PARAMETERS,)), fields


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_it_keeps_the_offset_of_the_start(rate_hz: float) -> None:
    program = beside_the_target()
    assert start(program) == OK
    end = walk(program, 20.0, 4.0, rate_hz=rate_hz)
    north, east, height = where(program)
    assert [north, height] == pytest.approx([-10.0, 15.0], abs=0.5)
    assert east == pytest.approx(end, abs=4.5 / rate_hz + 1.0)
    for _ in range(5):
        target(program, 0.0, end)
        program.wait(1.0)
    assert where(program)[1] == pytest.approx(end, abs=0.5)


@pytest.mark.parametrize(
    ("north", "east", "share"),
    [(3.0, -2.0, 1.0), (9.0, -6.0, 10.0 / math.hypot(24.426, -16.284))],
)
def test_the_velocity_that_follows_a_target(north: float, east: float, share: float) -> None:
    """That of the target, half a second after its last place, and 0.7 m/s per metre behind."""
    motion = Dynamics()
    motion.place(-10.0, 6.0, 15.0)
    site = Site(22.5431, 113.9589, 120.0, settings := MissionSettings())
    begun = FollowStart(*radians_at(2.0, -3.0), yaw_mode=0)
    follow = FollowExecution(begun, motion, motion.airframe, settings, site)
    follow.silence = 0.5
    follow.update(FollowTarget(*radians_at(2.0 + north, -3.0 + east)))
    guidance = follow.guide(sticks(yaw=0.5))
    wanted = [2.0 * by + 0.7 * (by + 0.01 * 2.0 * by) for by in (north, east)]
    assert [guidance.a, guidance.b] == pytest.approx([share * one for one in wanted], abs=2e-3)
    assert (guidance.up, guidance.yaw_mode) == (15.0, ModelYaw.RATE)
    assert math.degrees(guidance.yaw) == pytest.approx(50.0)
    motion.north, motion.east = -11.0, 7.0  # a metre behind it on each axis
    follow.silence = 2.0  # it is taken as standing still
    guidance = follow.guide(sticks())
    wanted = [0.7 * (north + 1.0), 0.7 * (east - 1.0)]
    assert [guidance.a, guidance.b] == pytest.approx(wanted, abs=2e-3)


def test_it_is_no_faster_than_10_metres_per_second() -> None:
    program = beside_the_target()
    start(program)
    walk(program, 20.0, 15.0)
    assert program.motion.velocity_east == pytest.approx(10.0, abs=0.3)


def test_height_follows_only_a_target_with_an_altitude() -> None:
    program = beside_the_target()
    start(program, altitude=100)
    target(program, 0.0, 0.0, 108)
    program.wait(5.0)
    assert program.motion.height == pytest.approx(23.0, abs=0.3)
    target(program, 0.0, 0.0, 0)
    program.wait(4.0)
    assert program.motion.height == pytest.approx(23.0, abs=0.3)
    target(program, 0.0, 0.0, 60)  # however deep the target goes, the aircraft stays up
    program.wait(10.0)
    assert program.motion.height == pytest.approx(5.0, abs=0.3)


def test_a_jump_is_ignored() -> None:
    program = beside_the_target()
    start(program)
    target(program, 0.0, 201.0)
    program.wait(3.0)
    assert where(program)[1] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(("mode", "is_reversed"), [(1, False), (0, True)])
def test_the_nose_towards_the_target(mode: int, is_reversed: bool) -> None:
    program = beside_the_target(-30.0, 10.0, follow_yaw_reversed=is_reversed)
    start(program, yaw_mode=mode)
    program.wait(4.0)
    assert program.vehicle.heading_deg == pytest.approx(-18.43, abs=2.0)


def test_the_nose_by_the_remote_control() -> None:
    program = beside_the_target(-10.0, -10.0)
    start(program, yaw_mode=0)
    program.wait(3.0)
    assert program.vehicle.heading_deg == pytest.approx(0.0, abs=1.0)
    program.aircraft.move_stick(yaw=0.2)
    program.wait(2.0)
    assert program.vehicle.heading_deg == pytest.approx(40.0, abs=4.0)


def test_silence_makes_it_hover_then_go_on_and_at_last_give_up() -> None:
    program = beside_the_target()
    start(program)
    end = walk(program, 10.0, 5.0)
    program.wait(8.0)
    assert program.motion.speed < 0.2
    end = walk(program, 6.0, 5.0, begin=end)
    assert where(program)[1] == pytest.approx(end, abs=3.0)
    program.wait(29.0)
    assert program.vehicle.missions.running is not None
    program.wait(2.0)
    last = program.vehicle.missions.last
    assert (last.last_mission, last.flags, last.reason) == (3, 1, Code.TARGET_LOST)


def test_a_pause_hovers_and_keeps_the_offset() -> None:
    program = beside_the_target()
    start(program)
    assert program.ask(FollowPauseResume(0)) == OK
    end = walk(program, 5.0, 4.0)
    assert where(program)[1] == pytest.approx(0.0, abs=0.3)
    assert program.ask(FollowPauseResume(1)) == OK
    walk(program, 10.0, 0.0, begin=end)
    assert where(program)[1] == pytest.approx(end, abs=0.5)


def test_a_target_off_the_earth_or_without_a_mission_is_ignored() -> None:
    program = beside_the_target()
    target(program, 0.0, 50.0)
    assert program.vehicle.missions.running is None
    start(program)
    silly = FollowTarget.LAYOUT.write(FollowTarget(math.nan, 99.0))
    program.send(b"\x03\x33" + silly, session=0)
    program.wait(2.0)
    assert list(where(program)[:2]) == pytest.approx([-10.0, 0.0], abs=0.1)
