"""A ROS 2 of wheels in a folder, with m100link and its messages: ``python wheels.py FOLDER NAME``.

rosidl makes ``m100_msgs`` there by cmake, as colcon would. No wheel has ``tf2_msgs``: its one
message is made as well. It prints the variables of that environment, for a shell to read.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
VERSIONS = {"jazzy": "7.1.6", "kilted": "9.1.2"}  # of rclpy
WHEELS = ("rclpy[fastrtps]", "common-interfaces")
BUILD = (
    *("ament-package", "ament-cmake", "ament-cmake-python", "ament-cmake-ros"),
    *("ament-cmake-include-directories", "ament-cmake-export-include-directories"),
    *("ament-cmake-export-interfaces", "ament-cmake-export-link-flags"),
    *("ament-cmake-gtest", "ament-cmake-gmock", "ament-cmake-pytest"),
    *("gtest-vendor", "gmock-vendor", "rosidl-core-generators", "rosidl-default-generators"),
)
MORE = {"jazzy": ("python-cmake-module",), "kilted": ("ament-cmake-ros-core",)}

TF2 = {
    "msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n",
    "CMakeLists.txt": """\
cmake_minimum_required(VERSION 3.16)
project(tf2_msgs)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_package()
""",
}


def environment(folder: Path) -> dict[str, str]:
    """Variables in which Python of that folder has ROS 2 and the messages."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    ours = str(folder / "ros" / "lib" / version / "site-packages")
    libraries = [str(folder / "ros" / "lib"), str(folder / "lib")]
    return os.environ | {
        "PYTHONPATH": ours,
        "LD_LIBRARY_PATH": os.pathsep.join(libraries),
        "PATH": os.pathsep.join([str(folder / "bin"), os.environ["PATH"]]),
        "AMENT_PREFIX_PATH": str(folder),
        "CMAKE_PREFIX_PATH": str(folder),
    }


def make(folder: Path, name: str) -> None:
    """Make it, unless it is there; minutes."""
    done = folder / "made"
    if done.exists():
        return
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    wanted = [f"ros-{name}-{one}" for one in (*WHEELS, *BUILD, *MORE[name])]
    wanted[0] += f"=={VERSIONS[name]}"
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, *wanted, "catkin_pkg", f"{ROOT}[cli,log,ros2]"], check=True)
    correct_exports(folder)
    package = ROOT / "m100link" / "apps" / "ros2" / "m100_msgs"
    tf2 = folder / "tf2_msgs"
    for path, text in TF2.items():
        (tf2 / path).parent.mkdir(parents=True, exist_ok=True)
        (tf2 / path).write_text(text, encoding="utf-8")
    manifest = (package / "package.xml").read_text(encoding="utf-8")
    (tf2 / "package.xml").write_text(manifest.replace("m100_msgs", "tf2_msgs"), encoding="utf-8")
    for source in (package, tf2):
        build(folder, source)
    done.touch()


def correct_exports(folder: Path) -> None:
    """Let the exports of the wheels name this Python's headers, and not their builder's."""
    ask = "import numpy, sysconfig; print(sysconfig.get_paths()['include'], numpy.get_include())"
    asked = subprocess.run(
        [str(folder / "bin" / "python"), "-c", ask], capture_output=True, text=True, check=True
    )
    python, numpy = asked.stdout.split()
    for path in (folder / "share").glob("*/cmake/*Export.cmake"):
        text = path.read_text(encoding="utf-8")
        found = re.sub(r"/opt/python/[^;\"]*/numpy/_core/include", numpy, text)
        found = re.sub(r"/opt/python/[^;\"]*/include/python[\d.]+t?", python, found)
        if found != text:
            path.write_text(found, encoding="utf-8")


def build(folder: Path, source: Path) -> None:
    into = folder / "build" / source.name
    shutil.rmtree(into, ignore_errors=True)
    options = {
        "CMAKE_INSTALL_PREFIX": folder / "ros",
        "Python3_EXECUTABLE": folder / "bin" / "python",
        "BUILD_TESTING": "OFF",
    }
    defined = [f"-D{name}={value}" for name, value in options.items()]
    for words in (
        ["cmake", "-S", str(source), "-B", str(into), "-Wno-dev", *defined],
        ["cmake", "--build", str(into), "--target", "install", "--parallel", "2"],
    ):
        done = subprocess.run(words, env=environment(folder), capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{' '.join(words)}:\n{done.stdout[-2000:]}{done.stderr[-4000:]}")


if __name__ == "__main__":
    make(Path(sys.argv[1]).absolute(), sys.argv[2])
    for variable, value in environment(Path(sys.argv[1]).absolute()).items():
        if value != os.environ.get(variable):
            print(f"export {variable}={shlex.quote(value)}")  # noqa: T201 - for a shell to read
