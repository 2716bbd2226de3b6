"""Launch files: which programs they start, under which names and parameters."""

from __future__ import annotations

from pathlib import Path

import pytest
from rospy_stand_in import launch, modules
from rospy_stand_in.launch import LaunchError, LaunchFile

from tests.examples_rospy.conftest import programs

LAUNCH = """<launch>
  <arg name="speed" default="2.5"/>
  <arg name="who" value="$(find pilot)"/>
  <param name="/everywhere" value="true"/>
  <param name="text" value="7" type="str"/>
  <node pkg="dji_sdk" type="dji_sdk_node" name="dji_sdk"/>
  <group ns="left">
    <remap from="cmd" to="/dji_sdk/cmd"/>
    <node pkg="pilot" type="fly.py" name="flyer" args="--fast $(arg speed)">
      <param name="rate" value="50"/>
      <rosparam command="load" file="$(arg who)/points.yaml"/>
      <rosparam>{height: 3.5}</rosparam>
      <remap from="a" to="b"/>
    </node>
    <node if="false" pkg="pilot" type="fly.py" name="never"/>
  </group>
  <include file="$(dirname)/more.launch"><arg name="name" value="second"/></include>
</launch>"""


MORE = """<launch>
  <arg name="name"/>
  <node pkg="pilot" type="fly.py" name="$(arg name)"/>
</launch>"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folders: dict[str, Path] = {}
    monkeypatch.setattr(modules, "FOLDERS", folders)
    monkeypatch.setattr(launch, "FOLDERS", folders)
    package = tmp_path / "src/pilot"
    for name, text in (
        ("package.xml", "<package><name>pilot</name></package>"),
        ("scripts/fly.py", "#!/usr/bin/env python\n"),
        ("points.yaml", "points: [{lat: 1.5}]\n"),
        ("launch/all.launch", LAUNCH),
        ("launch/more.launch", MORE),
    ):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    return package


def test_nodes_have_their_names_remappings_and_parameters(workspace: Path) -> None:
    pytest.importorskip("yaml")
    found = LaunchFile(workspace / "launch/all.launch", ["speed:=4"])
    first, second = found.nodes
    assert first.program == workspace / "scripts/fly.py"
    assert (first.name, first.namespace) == ("flyer", "/left")
    assert first.arguments == ["--fast", "4", "cmd:=/dji_sdk/cmd", "a:=b", "__name:=flyer"]
    assert (second.name, second.namespace) == ("second", "/")
    assert found.left_out == ["dji_sdk/dji_sdk_node"]
    assert found.parameters == {
        "/everywhere": True,
        "/text": "7",
        "/left/flyer/rate": 50,
        "/left/flyer/points": [{"lat": 1.5}],
        "/left/flyer/height": 3.5,
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<launch><arg name='a'/></launch>", "needs a:=value"),
        ("<launch><param name='a'/></launch>", "param a has no value"),
        ("<launch><param name='a' value='$(eval 1)'/></launch>", r"\$\(eval 1\) is not known"),
        ("<launch>", "no element found"),
    ],
)
def test_what_cannot_be_carried_out_is_named(workspace: Path, text: str, words: str) -> None:
    file = workspace / "launch/bad.launch"
    file.write_text(text)
    with pytest.raises(LaunchError, match=words):
        LaunchFile(file)


@pytest.mark.anyio
@pytest.mark.pty
async def test_a_launch_file_runs_its_programs(workspace: Path) -> None:
    pytest.importorskip("yaml")
    (workspace / "scripts/fly.py").write_text(
        "import rospy\nrospy.init_node('x')\nprint(rospy.get_name(), rospy.get_param('~rate', 0), "
        "rospy.get_param('/everywhere'), rospy.resolve_name('cmd'))\n"
    )
    async with programs(workspace) as station:
        lines = await station.run_file(workspace / "launch/all.launch")
    shown = [line for line in lines if not line.startswith("[INFO]")]
    assert sorted(shown) == [
        "/left/flyer 50 True /dji_sdk/cmd",
        "/second 0 True /cmd",
    ]
