"""The modules of ROS that a program imports beside rospy, and what it hears of those missing."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from rospy_stand_in import packages

from m100link.apps.station.ros import messages as station
from m100link.apps.station.ros.messages import types_of
from tests.examples_rospy.conftest import programs

IMPORTS = """
    import actionlib, cv_bridge, genpy, message_filters, rosgraph, roslib, rosparam, rospkg, tf
    import tf2_ros, tf_conversions, rospy
    from dynamic_reconfigure.msg import Config
    from nav_msgs.srv import GetPlan
    from rospy.rostime import wallsleep
    from std_srvs.srv import Trigger
    from tf.msg import tfMessage

    roslib.load_manifest("anything")
    print(rosgraph.is_master_online(), issubclass(tf2_ros.LookupException, Exception))
    turned = tf_conversions.transformations.quaternion_from_euler(0, 0, 1)
    print([float(round(one, 3)) for one in turned])
    rospy.init_node("a")
    rosparam.upload_params("/up", {"a": {"b": 3}})
    print(rospy.get_param("/up/a/b"), rospy.get_param("~list"), rospy.get_param("~text"))
    from guidance.msg import Motion
"""


@pytest.mark.anyio
@pytest.mark.pty
async def test_what_programs_import_is_there_and_what_is_not_is_named(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    pytest.importorskip("numpy")
    async with programs(tmp_path) as station:
        given = ("_list:=[{lat: 1.5}, {lat: 2}]", "_text:=a: b: c")
        lines = await station.run(IMPORTS, *given, status=1)
    assert lines == [
        "True True",
        "[0.0, 0.0, 0.479, 0.878]",
        "3 [{'lat': 1.5}, {'lat': 2}] a: b: c",
    ]
    assert "ModuleNotFoundError: No module named 'guidance'" in station.error
    assert "guidance is a package of ROS: name a folder that has it" in station.error


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("from guidance_xyz.msg import Motion", "of ROS"),
        ("import guidance_xyz.srv", "of ROS"),
        ("import mavros_msgs", "of ROS"),
        ("import guidance_xyz", "of Python"),
    ],
)
def test_a_missing_module_is_of_ros_or_of_python(tmp_path: Path, line: str, kind: str) -> None:
    (tmp_path / "program.py").write_text(f"{line}\n")
    with pytest.raises(ModuleNotFoundError) as caught:
        runpy.run_path(str(tmp_path / "program.py"))
    assert kind in packages._where_from(caught.value)


def test_types_are_those_that_the_station_lacks_and_complete() -> None:
    own = Path(packages.__file__).with_name("types.txt")
    messages, services = types_of(own)
    # From the file: a stand-in that another test installed has added its own to those in memory.
    theirs, their_services = types_of(Path(station.__file__).with_name("types.txt"))
    assert not messages.keys() & theirs.keys()
    assert not services.keys() & their_services.keys()
    known = messages.keys() | theirs.keys()
    halves = [half for one in services.values() for half in (one.request, one.response)]
    for kind in (*messages.values(), *halves):
        for field in kind.fields:
            assert "/" not in field.type or field.type in known, (kind.name, field.type)
