"""Following a target on virtual time, and the codes of a start."""

from __future__ import annotations

import math
from typing import Any

import pytest

from m100link.protocol.codes import MissionCode as Code
from m100link.protocol.commands.follow import FollowPauseResume, FollowStart, FollowTarget
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import OK, host, radians_at, where


def flying(north: float = -10.0, east: float = 0.0, height: float = 15.0, **missions: Any) -> Host:
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


def test_what_is_wrong_with_a_start() -> None:
    assert start(host()) == Code.NOT_IN_THE_AIR
    assert start(flying(height=4.9)) == Code.TOO_LOW
    assert start(flying(), 21_000.0) == Code.TARGET_TOO_FAR
    assert start(flying(north=-60.0, radius_limit=50.0)) == Code.TOO_FAR_FROM_HOME
    for fields in ({"mode": 1}, {"yaw_mode": 2}, {"latitude": 2.0}, {"longitude": math.nan}):
        program = flying()
        latitude, longitude = radians_at(0.0, 0.0)
        changed = {"latitude": latitude, "longitude": longitude} | fields
        value = FollowStart.LAYOUT.write(FollowStart(**changed))
        ack = program.ask_raw(b"\x03\x30" + value)
        assert ack is not None, fields
        assert ack.data == bytes((Code.BAD_PARAMETERS,)), fields


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_it_keeps_the_offset_of_the_start(rate_hz: float) -> None:
    program = flying()
    assert start(program) == OK
    end = walk(program, 20.0, 4.0, rate_hz=rate_hz)
    north, east, height = where(program)
    assert [north, height] == pytest.approx([-10.0, 15.0], abs=0.5)
    assert east == pytest.approx(end, abs=4.5 / rate_hz + 1.0)
    for _ in range(5):
        target(program, 0.0, end)
        program.wait(1.0)
    assert where(program)[1] == pytest.approx(end, abs=0.5)


def test_it_is_no_faster_than_10_metres_per_second() -> None:
    program = flying()
    start(program)
    walk(program, 20.0, 15.0)
    assert program.motion.velocity_east == pytest.approx(10.0, abs=0.3)


def test_height_follows_only_a_target_with_an_altitude() -> None:
    program = flying()
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
    program = flying()
    start(program)
    target(program, 0.0, 201.0)
    program.wait(3.0)
    assert where(program)[1] == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(("mode", "is_reversed"), [(1, False), (0, True)])
def test_the_nose_towards_the_target(mode: int, is_reversed: bool) -> None:
    program = flying(-10.0, -10.0, follow_yaw_reversed=is_reversed)
    start(program, yaw_mode=mode)
    program.wait(4.0)
    assert program.vehicle.heading_deg == pytest.approx(45.0, abs=2.0)


def test_the_nose_by_the_remote_control() -> None:
    program = flying(-10.0, -10.0)
    start(program, yaw_mode=0)
    program.wait(3.0)
    assert program.vehicle.heading_deg == pytest.approx(0.0, abs=1.0)
    program.aircraft.move_stick(yaw=0.2)
    program.wait(2.0)
    assert program.vehicle.heading_deg == pytest.approx(40.0, abs=4.0)


def test_silence_makes_it_hover_then_go_on_and_at_last_give_up() -> None:
    program = flying()
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
    program = flying()
    start(program)
    assert program.ask(FollowPauseResume(0)) == OK
    end = walk(program, 5.0, 4.0)
    assert where(program)[1] == pytest.approx(0.0, abs=0.3)
    assert program.ask(FollowPauseResume(1)) == OK
    walk(program, 10.0, 0.0, begin=end)
    assert where(program)[1] == pytest.approx(end, abs=0.5)


def test_a_target_off_the_earth_or_without_a_mission_is_ignored() -> None:
    program = flying()
    target(program, 0.0, 50.0)
    assert program.vehicle.missions.running is None
    start(program)
    silly = FollowTarget.LAYOUT.write(FollowTarget(math.nan, 99.0))
    program.send(b"\x03\x33" + silly, session=0)
    program.wait(2.0)
    assert list(where(program)[:2]) == pytest.approx([-10.0, 0.0], abs=0.1)
