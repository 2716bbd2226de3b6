"""A program of 2016 with DJI's helper, in Python 2: it flies as its author meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.examples_rospy.conftest import programs

pytestmark = [pytest.mark.anyio, pytest.mark.pty]

FLIGHT = """
#!/usr/bin/env python
from dji_sdk.dji_drone import DJIDrone
import dji_sdk.msg
import time
import rospy

drone = DJIDrone()
drone.request_sdk_permission_control()
drone.takeoff()
while drone.flight_status.data != 3 or drone.local_position.z < 1.0:
    time.sleep(0.05)
print "in the air", drone.power_status.percentage, 7 / 2
while drone.odometry.pose.pose.position.x < 2.0:
    drone.velocity_control(1, 2.0, 0, 0, 0)
    time.sleep(0.02)
print "north"
drone.local_position_navigation_send_request(0, 3, 4)
client = drone.local_position_navigation_action_client
print client.wait_for_result(rospy.Duration(60)), client.get_state(), client.get_result().result
print "at %d %d %d" % tuple(round(one) for one in (
    drone.local_position.x, drone.local_position.y, drone.local_position.z))
far = dji_sdk.msg.Waypoint(latitude=22.544, longitude=113.9589, altitude=5, staytime=0, heading=90)
drone.waypoint_navigation_send_request([far])
client = drone.waypoint_navigation_action_client
time.sleep(1)
client.cancel_goal()
print client.wait_for_result(rospy.Duration(60)), client.get_state()
drone.vrc_control(1024, 1024)
drone.gimbal_angle_control(0, 0, -450, 10)
drone.take_picture()
drone.landing()
while drone.flight_status.data != 1:
    time.sleep(0.05)
drone.release_sdk_permission_control()
print "landed"
"""


async def test_a_program_with_djis_helper_flies(tmp_path: Path) -> None:
    async with programs(tmp_path) as one:
        said = await one.run(FLIGHT)
        assert said == [
            "in the air 100 3",
            "north",
            "True 3 True",
            "at 0 3 4",
            "True 2",  # cancelled
            "landed",
        ]
        assert "virtual_rc_data_control does nothing here" in one.error
        assert one.aircraft.vehicle.camera.photos == 1
        assert not one.station.agent.holding.has_authority


async def test_a_goal_is_flown_to_its_end_after_the_program_as_by_djis_node(tmp_path: Path) -> None:
    program = """
        from dji_sdk.dji_drone import DJIDrone
        drone = DJIDrone()
        drone.request_sdk_permission_control()
        drone.takeoff()
        while drone.flight_status.data != 3 or drone.local_position.z < 1.0:
            pass
        drone.local_position_navigation_send_request(0, 0, 4)
    """
    async with programs(tmp_path) as one:
        said = await one.run(program)
        assert "the program has ended, its goal has not: Ctrl-C stops the aircraft" in said[-1]
        assert one.aircraft.height == pytest.approx(4.0, abs=1.0), one.error
        assert not one.station.agent.holding.has_authority


async def test_djis_own_helper_is_taken_where_it_lies(tmp_path: Path) -> None:
    helper = tmp_path / "dji_sdk/src/dji_sdk"
    helper.mkdir(parents=True)
    for name in ("dji_sdk", "own"):
        (tmp_path / name).mkdir(exist_ok=True)
        manifest = f"<package><name>{name}</name></package>"
        (tmp_path / name / "package.xml").write_text(manifest)
    (helper / "__init__.py").write_text("")
    (helper / "dji_drone.py").write_text("class DJIDrone:\n\tprint 'its own', 3 / 2\n")
    program = """
        import Queue, ConfigParser, StringIO, urllib2, thread
        import dji_sdk.msg
        from dji_sdk.dji_drone import DJIDrone
        print dji_sdk.msg.Velocity(vx=1.0).vx, dji_sdk.srv.DroneTaskControlRequest.TASK_LAND
        print Queue.Queue(3).maxsize, ConfigParser.ConfigParser().sections(), thread.allocate_lock
    """
    async with programs(tmp_path / "own") as one:
        said = await one.run(program)
        assert said[:2] == ["its own 1", "1.0 6"]
        assert said[2].startswith("3 [] <built-in function allocate_lock")
