"""Programs of others see and fly virtual aircraft; the truth is the simulator's."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.ros2.actions import FLIGHTS
from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.geodesy import LocalFrame
from m100link.log.cdr import DEFINITIONS, decode, full_name
from m100link.sim.orders import send_order
from tests.waiting import PATIENCE

HERE = Path(__file__).parent
KEY = bytes(range(32)).hex()
PLACE = (47.3977419, 8.5455938)

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("zenoh") is None or importlib.util.find_spec("zenoh_ros2_sdk") is None,
    reason="zenoh-ros2-sdk is not installed",
)


@contextmanager
def started(
    *words: str, python: str = sys.executable, **more: Any
) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [python, "-W", "ignore", *words], stdout=subprocess.PIPE, text=True, **more
    ) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    process.kill()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def child_of(process: subprocess.Popen[str]) -> int:
    """The process of the fronts."""
    found = subprocess.run(
        ["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=True
    )
    return int(found.stdout.split()[0])


class Site:
    """A router, virtual aircraft, and the nodes of them."""

    def __init__(self, stack: ExitStack, count: int = 1, firmware: str = "1.0") -> None:
        self.stack = stack
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            self.port = int(one.getsockname()[1])
        self.router = self.run("plain.py", "router")
        assert line_of(self.router) == "routes"
        self.sims = []
        for place in range(count):
            words = ("-m", "m100link", "sim", "--tcp", "127.0.0.1:0", "--json", "--seed", "5")
            where = ("--latitude", str(PLACE[0]), "--longitude", str(PLACE[1] + place * 2e-4))
            sim = stack.enter_context(started(*words, "--firmware", firmware, *where))
            self.sims.append(json.loads(line_of(sim)))
        urls = [f"a{place}={one['port']}" for place, one in enumerate(self.sims)]
        node = ("-m", "m100link", "ros2", *urls, "--json", "--app-id", "10086", "--key", KEY)
        endpoint = f'connect/endpoints=["tcp/127.0.0.1:{self.port}"]'
        environment = os.environ | {"ZENOH_CONFIG_OVERRIDE": endpoint}
        self.node = stack.enter_context(started(*node, env=environment))
        self.names = json.loads(line_of(self.node))["ros2"]

    def run(self, program: str, *words: str) -> subprocess.Popen[str]:
        command = (str(HERE / program), str(self.port), *words)
        return self.stack.enter_context(started(*command))

    def sdk(self, what: str, *words: str, node: str = "") -> str:
        program = self.run("sdk.py", node or self.names[0], what, *words)
        told, _ = program.communicate(timeout=PATIENCE)
        assert program.returncode == 0
        return told

    def truth(self, place: int = 0) -> dict[str, Any]:
        path = Path(self.sims[place]["control_socket"])
        answer = send_order(["status"], path=path)
        status = answer["status"]
        assert isinstance(status, dict)
        return status

    def order(self, *words: str) -> None:
        send_order(list(words), path=Path(self.sims[0]["control_socket"]))

    def speed(self, place: int = 0) -> float:
        return math.hypot(*self.truth(place)["velocity"])

    def until(self, predicate: Callable[[], bool], within: float = PATIENCE) -> float:
        began = time.monotonic()
        while not predicate():
            assert time.monotonic() - began < within, self.truth()
            time.sleep(0.02)
        return time.monotonic() - began

    def up(self) -> None:
        told = self.sdk("call", "obtain_control", "takeoff")
        assert told.count(" True ") == 2, told
        self.until(lambda: self.truth()["task_state"] == "succeeded")

    def hovers(self, what: str) -> None:
        """It comes to rest in the air, and stays there; tells how long that took."""
        took = self.until(lambda: self.speed() < 0.3, 5.0)
        before = self.truth()
        time.sleep(3.0)
        after = self.truth()
        moved = math.hypot(*(after[one] - before[one] for one in ("north", "east", "height")))
        with Path(os.environ.get("ROS2_FIGURES", os.devnull)).open("a", encoding="utf-8") as file:
            held = after["control"]
            file.write(f"{what}: {took:.2f} s, then {moved:.2f} m in 3 s, control {held}\n")
        assert moved < 0.5
        assert after["height"] > 0.8


@pytest.fixture
def site() -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(stack)


# -- the judge ------------------------------------------------------------------------------------


def test_it_lists_everything_and_receives_each_topic(site: Site) -> None:
    found = json.loads(site.sdk("look"))
    node = site.names[0]

    def full(name: str) -> str:
        return name.replace("~", node)

    kinds = {name: row.kind for name, row in OUTPUTS.items()}
    kinds |= {name: row.kind for name, row in INPUTS.items()}
    del kinds["/clock"]  # a simulator of another process is not known to be one
    for name, kind in kinds.items():
        assert found["topics"][full(name)] == [full_name(kind)], name
    for name, service in SERVICES.items():
        assert found["services"][full(name)] == [service.kind]
    for name in FLIGHTS:
        assert f"{full(name)}/_action/send_goal" in found["services"]
        assert f"{full(name)}/_action/feedback" in found["topics"]
    assert f"{node}/get_parameters" in found["services"]
    messages = found["messages"]
    # Firmware 1.0 does not send the magnetometer by itself.
    wanted = {name.strip("~/") for name, row in OUTPUTS.items() if row.hz}
    assert {one.strip("/") for one in messages} >= wanted - {"clock", "magnetic_field"}
    fix = messages["fix"]
    assert (fix["latitude"], fix["longitude"]) == pytest.approx(PLACE, abs=1e-4)
    assert messages["imu"]["linear_acceleration"]["z"] == pytest.approx(9.8, abs=0.3)
    assert messages["flight_status"]["phase"] == 1
    assert messages["battery"]["percentage"] > 0.9
    stamp = messages["odom"]["header"]["stamp"]
    assert abs(stamp["sec"] - time.time()) < 60.0


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_it_flies(firmware: str) -> None:
    with ExitStack() as stack:
        site = Site(stack, firmware=firmware)
        program = site.run("sdk.py", site.names[0], "fly")
        site.until(lambda: site.speed() > 1.7)
        told, _ = program.communicate(timeout=PATIENCE)
        assert told.split() == ["obtain_control", "True", "takeoff", "True", "land", "True"]
        site.until(lambda: not site.truth()["motors_on"])
        site.until(lambda: site.truth()["control"] == "rc")


def test_refusals_say_why(site: Site) -> None:
    told = site.sdk("call", "takeoff")
    assert "takeoff False ROS has no control" in told
    assert "what to do: call ~/obtain_control first" in told


# -- losses ---------------------------------------------------------------------------------------


def steering(site: Site) -> subprocess.Popen[str]:
    """A program that flies the aircraft forward."""
    site.up()
    program = site.run("sdk.py", site.names[0], "steer")
    assert line_of(program) == "steers"
    site.until(lambda: site.speed() > 2.7)
    return program


def test_the_commander_is_killed(site: Site) -> None:
    steering(site).kill()
    site.hovers("commander of setpoints killed")
    assert site.truth()["control"] == "onboard"
    assert "land True" in site.sdk("call", "land")  # anybody may


def test_the_node_is_killed(site: Site) -> None:
    program = steering(site)
    os.kill(child_of(site.node), signal.SIGKILL)
    site.hovers("process of the node killed, setpoints go on")
    site.until(lambda: site.truth()["control"] == "rc")
    program.kill()
    # The one that is started instead takes no control by itself.
    site.until(lambda: "obtain_control True" in site.sdk("call", "obtain_control"))


def test_the_token_of_a_killed_node_is_gone_within_a_second(site: Site) -> None:
    watcher = site.run("plain.py", "watch")
    _, is_there, key = line_of(watcher).split()
    assert (is_there, key.rpartition("/")[2]) == ("True", "m100")
    child = child_of(site.node)
    began = time.time()
    os.kill(child, signal.SIGKILL)
    at, is_there, _ = line_of(watcher).split()
    assert is_there == "False"
    assert float(at) - began < 1.0


def test_all_of_m100link_is_killed(site: Site) -> None:
    steering(site)
    child = child_of(site.node)
    site.node.kill()
    os.kill(child, signal.SIGKILL)
    site.hovers("agent and node killed")


def test_the_router_is_killed(site: Site) -> None:
    program = steering(site)
    site.router.kill()
    time.sleep(2.0)
    # The commander and the node know each other by now, and need no router.
    program.kill()
    site.hovers("router killed, then the commander")


def test_the_node_stands_still(site: Site) -> None:
    program = steering(site)
    child = child_of(site.node)
    os.kill(child, signal.SIGSTOP)
    site.hovers("node stopped for 8 s (SIGSTOP)")
    time.sleep(5.0)
    os.kill(child, signal.SIGCONT)
    site.hovers("the same, after it went on")
    program.kill()


def test_the_client_of_a_goal_is_killed(site: Site) -> None:
    site.up()
    north = LocalFrame(*PLACE).to_geodetic(120.0, 0.0)
    program = site.run("plain.py", "goal", site.names[0], *map(str, north))
    assert "'accepted': True" in line_of(program)
    site.until(lambda: site.speed() > 3.0)
    program.kill()
    site.hovers("client of an action killed")
    assert site.truth()["north"] < 110.0


def test_the_client_of_a_goal_stands_still(site: Site) -> None:
    site.up()
    north = LocalFrame(*PLACE).to_geodetic(120.0, 0.0)
    program = site.run("plain.py", "goal", site.names[0], *map(str, north))
    assert "'accepted': True" in line_of(program)
    site.until(lambda: site.speed() > 3.0)
    os.kill(program.pid, signal.SIGSTOP)
    try:
        # Its tokens stay for as long as the lease of its session, 10 s.
        site.hovers("client of an action stopped (SIGSTOP)")
    finally:
        os.kill(program.pid, signal.SIGCONT)
    assert site.truth()["north"] < 110.0


def test_the_commander_stands_still(site: Site) -> None:
    program = steering(site)
    os.kill(program.pid, signal.SIGSTOP)
    site.hovers("commander of setpoints stopped (SIGSTOP)")
    os.kill(program.pid, signal.SIGCONT)
    site.until(lambda: site.speed() > 2.0)  # it begins anew, as after a pause of its own
    program.kill()
    site.hovers("the same, went on and killed")


def test_a_goal_is_flown_to_its_end(site: Site) -> None:
    site.up()
    place = LocalFrame(*PLACE).to_geodetic(15.0, 5.0)
    program = site.run("plain.py", "goal", site.names[0], *map(str, place))
    told, _ = program.communicate(timeout=PATIENCE)
    assert "'status': 4" in told
    truth = site.truth()
    assert (truth["north"], truth["east"]) == pytest.approx((15.0, 5.0), abs=1.5)


def test_the_pilot_takes_it(site: Site) -> None:
    program = steering(site)
    site.order("rc-mode", "P")
    site.hovers("pilot leaves F, setpoints go on")
    site.order("rc-mode", "F")
    time.sleep(2.0)
    assert site.speed() < 0.3
    program.kill()


def test_a_flood_of_junk_lands_nothing_and_stops_nothing(site: Site) -> None:
    site.up()
    before = memory(site.node.pid)
    floods = [site.run("plain.py", "flood", site.names[0], "8") for _ in range(2)]
    time.sleep(4.0)
    truth = site.truth()
    assert truth["flight_status"] == "in_air"
    assert math.hypot(*truth["velocity"]) < 0.5
    sent = sum(json.loads(flood.communicate(timeout=PATIENCE)[0])["sent"] for flood in floods)
    site.hovers(f"flood of {sent / 8:.0f} messages a second")
    assert memory(site.node.pid) < before + 60_000
    assert "land True" in site.sdk("call", "land")


def memory(process: int) -> int:
    """Resident kilobytes of a process and its children."""
    listed = subprocess.run(
        ["ps", "-o", "rss=", "-p", str(process), "--ppid", str(process)],
        capture_output=True,
        text=True,
        check=True,
    )
    return sum(int(one) for one in listed.stdout.split())


def test_two_aircraft_are_two_nodes() -> None:
    with ExitStack() as stack:
        site = Site(stack, count=2)
        assert site.names == ["/a0/m100", "/a1/m100"]
        told = site.sdk("call", "obtain_control", "takeoff", node="/a1/m100")
        assert told.count(" True ") == 2
        site.until(lambda: site.truth(1)["height"] > 1.0)
        assert not site.truth(0)["motors_on"]
        program = site.run("sdk.py", "/a1/m100", "steer")
        site.until(lambda: site.speed(1) > 2.5)
        program.kill()
        site.until(lambda: site.speed(1) < 0.3, 5.0)
        assert not site.truth(0)["motors_on"]


def test_rosbags_reads_a_bag_of_what_came_by_the_wire(site: Site, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Reader

    from tests.interop.ros2.plain import store_of_types

    program = site.run("plain.py", "bag", "6", str(tmp_path / "bag"))
    lines = [line.split() for line in program.communicate(timeout=PATIENCE)[0].splitlines()]
    store = store_of_types()
    counted: dict[str, int] = {}
    with Reader(tmp_path / "bag") as reader:
        for connection, at, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            counted[connection.topic] = counted.get(connection.topic, 0) + 1
            # Ours reads of the bytes that came what rosbags reads of the bag.
            came = next(one for one in lines if one[0] == connection.topic and int(one[2]) == at)
            kind = connection.msgtype
            known = kind if kind in DEFINITIONS else kind.replace("/msg/", "/")
            assert same(message, decode(known, bytes.fromhex(came[3]))), connection.topic
            assert kind == came[1]
    assert sum(counted.values()) == len(lines)
    for name, row in OUTPUTS.items():
        # Firmware 1.0 sends no magnetometer, a simulator of another process is not known as one,
        # and what is latched or said at an event may have been said before.
        if row.hz and name not in ("~/magnetic_field", "/clock"):
            topic = name.replace("~", site.names[0])
            assert counted[topic] > 3.0 * row.hz, (topic, counted)


def same(message: Any, ours: Any) -> bool:
    """Whether a message of rosbags has just these fields, with these values."""
    if isinstance(ours, dict):
        named = [one.name for one in dataclasses.fields(message) if one.name != "__msgtype__"]
        named = [one for one in named if not one.isupper()]  # constants do not travel
        return named == list(ours) and all(same(getattr(message, k), v) for k, v in ours.items())
    if isinstance(ours, list):
        return len(message) == len(ours) and all(map(same, message, ours))
    return bool(message == ours) or (math.isnan(message) and math.isnan(ours))


def test_the_example_flies() -> None:
    program = Path(__file__).parents[3] / "examples" / "ros2" / "first_flight.py"
    done = subprocess.run(
        [sys.executable, "-W", "error", str(program)],
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE,
        check=True,
    )
    assert "m flown" in done.stdout
    assert done.stdout.splitlines()[-1] == "landed", done.stdout
