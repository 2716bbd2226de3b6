"""What programs of others need that is not in Python, or a reason why it is not there."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROSBRIDGE_SUITE, ROSBRIDGE_RELEASE = "https://github.com/RobotWebTools/rosbridge_suite", "0.11.17"
ROS_MODULES = (
    "rospy, rosmaster, rosservice, rostopic, bson, PIL, std_msgs, std_srvs, sensor_msgs, "
    "geometry_msgs, rosgraph_msgs"
)
ROS_PACKAGES = (
    "python3-rospy python3-rosmaster python3-rosservice python3-rostopic python3-bson python3-pil "
    "python3-std-msgs python3-std-srvs python3-sensor-msgs python3-geometry-msgs"
)


def brought(*command: str, cwd: Path) -> None:
    """Run a program that fetches something; where it cannot, the test is skipped."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"{' '.join(command)}: {done.stderr[-200:]}")


@pytest.fixture(scope="session")
def npm(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes a folder with packages of npm, once for the same packages."""
    made: dict[tuple[str, ...], Path] = {}

    def install(*packages: str) -> Path:
        for tool in ("node", "npm"):
            if shutil.which(tool) is None:
                pytest.skip(f"there is no {tool}")
        if packages not in made:
            place = tmp_path_factory.mktemp("npm")
            (place / "package.json").write_text('{"private": true}')
            words = ("install", "--silent", "--no-audit", "--no-fund", *packages)
            brought("npm", *words, cwd=place)
            made[packages] = place
        return made[packages]

    return install


@pytest.fixture(scope="session")
def ros_python() -> str:
    """A Python that has rospy: that of ROS_PYTHON, or the system's."""
    python = os.environ.get("ROS_PYTHON", "/usr/bin/python3")
    asked = (python, "-c", f"import {ROS_MODULES}")
    if (
        not Path(python).exists()
        or subprocess.run(asked, capture_output=True, check=False).returncode
    ):
        pytest.skip(f"{python} does not import {ROS_MODULES}: on Debian {ROS_PACKAGES}")
    return python


@pytest.fixture(scope="session")
def rosbridge_library(ros_python: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The folder with `rosbridge_library`: that of ROSBRIDGE_LIBRARY, or the release by git."""
    if library := os.environ.get("ROSBRIDGE_LIBRARY"):
        return library
    place = tmp_path_factory.mktemp("rosbridge")
    clone = ("clone", "--quiet", "--depth", "1", "--branch", ROSBRIDGE_RELEASE, ROSBRIDGE_SUITE)
    brought("git", *clone, ".", cwd=place)
    return str(place / "rosbridge_library" / "src")
