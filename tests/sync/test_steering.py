"""A mission without ``await``: the same events, the same stop."""

from __future__ import annotations

import time

import pytest

import m100link
from m100link import Finished, MissionProgress, MissionRunning, Reached, Uploading
from tests.flight.foreign_aircraft import APP_ID, KEY, ForeignAircraft, foreign_aircraft
from tests.flight.missions.foreign import plan
from tests.rig import NORTH
from tests.waiting import PATIENCE

pty = pytest.mark.pty

SHORT = plan([(3.0, 0.0), (6.0, 0.0)], speed=10.0)


def connect(there: ForeignAircraft) -> m100link.sync.Aircraft:
    aircraft = m100link.sync.connect(there.name)
    aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
    aircraft.wait_for(lambda state: state.flight_status is not None, timeout=PATIENCE)
    return aircraft


@pty
@pytest.mark.smoke
def test_it_is_flown_in_a_with_block_and_reported_in_a_loop() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        uploading: list[Uploading] = []
        with aircraft.control() as control:
            with control.waypoint_mission(SHORT, progress=uploading.append) as mission:
                events = [e for e in mission if not isinstance(e, MissionProgress)]
        assert [event.index for event in events if isinstance(event, Reached)] == [0, 1]
        assert events[-1] == Finished()
        assert len(uploading) == 2
        assert mission.is_over


@pty
def test_an_exception_in_the_block_stops_it_and_setpoints_are_refused_before() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        with pytest.raises(ZeroDivisionError), aircraft.control() as control:
            with control.waypoint_mission(plan(speed=1.0)) as mission:
                assert mission.plan == plan(speed=1.0)
                with pytest.raises(MissionRunning):
                    control.send(NORTH)
                mission.pause()
                assert mission.is_paused
                mission.resume()
                assert mission.set_speed(2.0) == 2.0
                raise ZeroDivisionError
        assert not there.missions.flying


@pty
def test_one_that_is_detached_flies_on() -> None:
    with foreign_aircraft("3.1") as there, connect(there) as aircraft:
        with aircraft.control() as control, control.waypoint_mission(plan(speed=1.0)) as mission:
            mission.detach()
        time.sleep(0.2)
        assert there.missions.flying
        with aircraft.control() as control:
            assert control.stop_mission() is m100link.MissionKind.WAYPOINT
