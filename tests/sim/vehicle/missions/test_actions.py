"""What the aircraft does at a waypoint, and how long that takes."""

from __future__ import annotations

from typing import Any

import pytest

from m100link.protocol.commands.gimbal import TakePhoto
from m100link.sim.vehicle.missions.plan import ActionKind as Do
from tests.sim.host import Host
from tests.sim.vehicle.missions.flights import begin, doing, fly, host, point, reached


def flown(*actions: tuple[int, int], **fields: Any) -> tuple[Host, float]:
    """A mission that does something at its point 1, and for how long."""
    mission = {name: fields.pop(name) for name in ("yaw_mode",) if name in fields}
    turn = {"turn_mode": fields.pop("turn_mode", 0)}
    missions = {name: fields.pop(name) for name in ("photo_seconds",) if name in fields}
    program = host(**missions)
    points = [
        point(0, 0, 0, 10),
        point(1, 15, 0, 10, **turn, **doing(*actions, **fields)),
        point(2, 30, 0, 10),
    ]
    begin(program, points, **mission)
    fly(program)
    times = [received.time for received in program.pushes(0x04)]
    told = reached(program)
    assert told == [(index, status) for index in range(3) for status in (4, 6)]
    before, after = times[-7:][2:4]
    return program, after - before - 0.2  # the moment in which the status says "reached"


@pytest.mark.parametrize("milliseconds", [0, 500, 3000, 20_000])
def test_staying(milliseconds: int) -> None:
    assert flown((Do.STAY, milliseconds))[1] == pytest.approx(milliseconds / 1000, abs=0.05)


def test_photos_one_after_the_other() -> None:
    program, seconds = flown((Do.PHOTO, 0), (Do.PHOTO, 0), (Do.PHOTO, 0))
    assert program.vehicle.camera.photos == 3
    assert seconds == pytest.approx(3.6, abs=0.1)


@pytest.mark.parametrize(("photo_seconds", "seconds"), [(3.0, 3.0), (9.0, 6.0)])
def test_a_photo_takes_six_seconds_at_most(photo_seconds: float, seconds: float) -> None:
    assert flown((Do.PHOTO, 0), photo_seconds=photo_seconds)[1] == pytest.approx(seconds, abs=0.1)


def test_a_photo_waits_for_one_that_the_program_takes() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 10, **doing((Do.PHOTO, 0))), point(1, 20, 0, 10)])
    while (0, 4) not in reached(program):
        program.wait(0.02)
    program.ask(TakePhoto())
    fly(program)
    assert program.vehicle.camera.photos == 2


def test_video_on_and_off() -> None:
    program, _ = flown((Do.START_VIDEO, 0))
    assert program.vehicle.camera.is_recording
    program, seconds = flown((Do.START_VIDEO, 0), (Do.STAY, 1000), (Do.STOP_VIDEO, 0))
    assert not program.vehicle.camera.is_recording
    assert seconds == pytest.approx(3.4, abs=0.1)
    log = [entry.text for entry in program.vehicle.events]
    assert log.index("waypoint 1: video on") < log.index("waypoint 1: video off")


@pytest.mark.parametrize(("turn_mode", "degrees"), [(0, 90.0), (1, 270.0)])
def test_turning_in_the_direction_of_the_point(turn_mode: int, degrees: float) -> None:
    _, seconds = flown((Do.YAW, 90), turn_mode=turn_mode, yaw_mode=1)
    assert seconds == pytest.approx(degrees / 45.0 + 1.5, abs=1.0)


def test_a_turn_ends_at_the_heading() -> None:
    program = host()
    begin(program, [point(0, 0, 0, 10, **doing((Do.YAW, -130))), point(1, 20, 0, 10)], yaw_mode=2)
    while (0, 6) not in reached(program):
        program.wait(0.02)
    assert program.vehicle.heading_deg == pytest.approx(-130.0, abs=2.5)


def test_the_gimbals_pitch() -> None:
    program, seconds = flown((Do.GIMBAL_PITCH, -90), (Do.GIMBAL_PITCH, -45))
    assert program.vehicle.gimbal.pitch == pytest.approx(-45.0)
    assert seconds == pytest.approx(2.0 + 1.0, abs=0.1)


@pytest.mark.parametrize(("repeat", "photos"), [(0, 1), (1, 1), (3, 3), (15, 15)])
def test_the_list_is_gone_through_as_often_as_it_says(repeat: int, photos: int) -> None:
    program, _ = flown((Do.PHOTO, 0), (Do.STAY, 100), repeat=repeat)
    assert program.vehicle.camera.photos == photos


@pytest.mark.parametrize(("limit", "photos"), [(0, 0), (1, 1), (5, 5), (65535, 15)])
def test_the_limit_cuts_all_of_them_off(limit: int, photos: int) -> None:
    program, seconds = flown((Do.PHOTO, 0), repeat=15, limit=limit)
    assert program.vehicle.camera.photos == photos
    assert seconds <= min(limit, 20) + 0.1


def test_without_has_action_the_list_is_ignored() -> None:
    program = host()
    fields = doing((Do.PHOTO, 0)) | {"has_action": 0, "action_count": 15}
    begin(program, [point(0, 0, 0, 10, **fields), point(1, 20, 0, 10)])
    fly(program)
    assert program.vehicle.camera.photos == 0


def test_in_coordinated_turns_there_are_no_actions() -> None:
    program = host()
    points = [
        point(i, *place, damping=2.0, **doing((Do.PHOTO, 0)))
        for i, place in enumerate([(0, 0, 10), (20, 0, 10), (20, 20, 10)])
    ]
    begin(program, points, trace_mode=1)
    fly(program)
    assert program.vehicle.camera.photos == 0
