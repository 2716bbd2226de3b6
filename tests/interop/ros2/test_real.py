"""ROS 2 itself, of wheels: rclpy on Fast DDS sees and flies the node, and is killed in flight.

The wheels and the messages take minutes to make; ``M100LINK_ROS2_WHEELS`` names a folder in which
they stay.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from random import Random

import pytest

from tests.interop.ros2 import wheels
from tests.interop.ros2.test_programs import HERE, KEY, PLACE, Site, child_of, line_of, started
from tests.tutorials import Reader
from tests.waiting import PATIENCE

pytestmark = [
    pytest.mark.timeout(1800),
    pytest.mark.skipif(
        sys.platform != "linux" or os.uname().machine != "x86_64" or not shutil.which("cmake"),
        reason="the wheels of ROS 2 are for Linux on x86-64, and cmake makes the messages",
    ),
]


class RealSite(Site):
    """A virtual aircraft and its node, both on DDS in a domain of their own."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:  # without a router
        self.stack, self.python = stack, str(folder / "bin" / "python")
        domain = Random(time.time_ns()).randrange(100, 200)
        alone = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self.environment = wheels.environment(folder) | alone
        where = ("--latitude", str(PLACE[0]), "--longitude", str(PLACE[1]))
        sim = self.begin("sim", "--tcp", "127.0.0.1:0", "--json", "--seed", "5", *where)
        self.sims = [json.loads(line_of(sim))]
        self.node = self.another()
        self.names = json.loads(line_of(self.node))["ros2"]

    def begin(self, *words: str) -> subprocess.Popen[str]:
        command = ("-m", "m100link", *words)
        return self.stack.enter_context(
            started(*command, python=self.python, env=self.environment, cwd=wheels.ROOT)
        )

    def another(self) -> subprocess.Popen[str]:
        url = f"a0={self.sims[0]['port']}"
        words = ("--json", "--app-id", "10086", "--key", KEY, "--no-record")
        return self.begin("ros2", url, "--rmw", "dds", *words)

    def run(self, program: str, *words: str) -> subprocess.Popen[str]:
        command = (str(HERE / program), *words)
        return self.stack.enter_context(started(*command, python=self.python, env=self.environment))

    def calls(self, *names: str) -> str:
        program = self.run("real.py", "call", *names)
        return program.communicate(timeout=PATIENCE)[0]

    def flying(self, what: str, faster_than: float) -> subprocess.Popen[str]:
        program = self.run("real.py", what)
        assert line_of(program) == "flies"
        self.until(lambda: self.speed() > faster_than)
        return program


@pytest.fixture(scope="module", params=sorted(wheels.VERSIONS))
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = os.environ.get("M100LINK_ROS2_WHEELS")
    made = Path(kept) if kept else tmp_path_factory.mktemp("ros2")
    wheels.make(made / request.param, request.param)
    return made / str(request.param)


@pytest.fixture
def site(folder: Path) -> Iterator[RealSite]:
    with ExitStack() as stack:
        yield RealSite(stack, folder)


def test_a_program_of_rclpy_checks_and_flies_it(site: RealSite) -> None:
    program = site.run("real.py", "checks")
    lines = program.communicate(timeout=8 * PATIENCE)[0].splitlines()
    assert [one for one in lines if not one.startswith("ok ")] == []
    assert len(lines) >= 30
    assert not site.truth()["motors_on"]
    assert site.truth()["control"] == "rc"


def test_the_tutorial_flies_by_rclpy(folder: Path, tmp_path: Path) -> None:
    alone = {"ROS_DOMAIN_ID": str(Random(time.time_ns()).randrange(100, 200))}
    python, names = str(folder / "bin" / "python"), wheels.environment(folder)
    Reader(tmp_path, python=python, environment=names | alone).follow("ros2")


def test_the_commander_is_killed(site: RealSite) -> None:
    site.flying("steer", 2.7).kill()
    site.hovers("commander on DDS killed")
    assert site.truth()["control"] == "onboard"
    assert "land True" in site.calls("land")


def test_the_client_of_a_goal_is_killed(site: RealSite) -> None:
    site.flying("goal", 3.0).kill()
    site.hovers("client of an action on DDS killed")
    assert site.truth()["north"] < 110.0


def test_the_client_of_a_goal_stands_still(site: RealSite) -> None:
    program = site.flying("goal", 3.0)
    os.kill(program.pid, signal.SIGSTOP)
    try:
        site.hovers("client of an action on DDS stopped (SIGSTOP)")
    finally:
        os.kill(program.pid, signal.SIGCONT)
    assert site.truth()["north"] < 110.0


def test_the_node_is_killed(site: RealSite) -> None:
    site.flying("steer", 2.7)
    os.kill(child_of(site.node), signal.SIGKILL)
    site.hovers("node on DDS killed, setpoints go on")
    site.until(lambda: site.truth()["control"] == "rc")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_the_node_ends_in_flight(site: RealSite, how: signal.Signals) -> None:
    site.flying("steer", 2.7)
    site.node.send_signal(how)
    site.hovers(f"node on DDS ended by {how.name}, setpoints go on")
    assert site.node.wait(PATIENCE) == 0
    assert site.truth()["control"] == "rc"


def test_a_namesake_gets_no_control(site: RealSite) -> None:
    other = site.another()
    assert json.loads(line_of(other))["ros2"] == site.names
    time.sleep(3.0)
    told = site.calls("obtain_control")
    assert "obtain_control False" in told
    assert "two nodes are called /m100" in told


GIDS = """
import os, time
import anyio, rclpy
from geometry_msgs.msg import TwistStamped
from m100link.apps.ros2.dds import open_dds
from m100link.apps.ros2.graph import EntityKind, NodeName, Qos, data_key, read_attachment

DOMAIN = int(os.environ["ROS_DOMAIN_ID"])
TOPIC, KIND = "/m100/cmd_vel", "geometry_msgs/TwistStamped"

async def main():
    rclpy.init()
    node = rclpy.create_node("publisher")
    publisher = node.create_publisher(TwistStamped, TOPIC, 10)
    async with open_dds(DOMAIN, 1000) as bus:
        name = NodeName(DOMAIN, "0", "/", "m100")
        bus.declare(name.token)
        bus.declare(name.token_of(1, EntityKind.SUBSCRIBER, TOPIC, KIND, Qos(False)))
        inbox, came = bus.inbox(data_key(DOMAIN, TOPIC, KIND), 8), []
        for _ in range(600):
            publisher.publish(TwistStamped())
            await anyio.sleep(0.1)
            came += inbox.take()
            [there] = node.get_publishers_info_by_topic(TOPIC) or [None]
            if there and came:
                sent = read_attachment(came[-1].attachment)
                age = time.time() - sent.at_ns / 1e9
                print(bytes(there.endpoint_gid) == sent.gid, abs(age) < 5)
                break

anyio.run(main)
"""


def test_the_gid_of_a_message_is_that_of_its_end(site: RealSite) -> None:
    """By which the node decides whose setpoints fly; ``rcl`` knows it, and rclpy hides it."""
    program = site.stack.enter_context(
        started("-c", GIDS, python=site.python, env=site.environment, cwd=wheels.ROOT)
    )
    assert program.communicate(timeout=PATIENCE)[0].split() == ["True", "True"]
