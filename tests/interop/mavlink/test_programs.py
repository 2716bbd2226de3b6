"""Programs of others fly the virtual aircraft through the bridge; the truth is the simulator's."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from tests.tutorials import Reader, blocks

HERE = Path(__file__).parent
FIRMWARES = ["1.0", "2.3", "3.1"]
KEY = bytes(range(32)).hex()
PATIENCE = 240.0

GRPC = "mavsdk_grpc" if importlib.util.find_spec("mavsdk_grpc") else "mavsdk"
needs_grpc = pytest.mark.skipif(
    GRPC == "mavsdk"
    and (
        importlib.util.find_spec("mavsdk") is None
        or importlib.util.find_spec("mavsdk.generated") is None
    ),
    reason="MAVSDK over gRPC is not installed: mavsdk-grpc, or mavsdk below 4",
)
needs_native = pytest.mark.skipif(
    importlib.util.find_spec("mavsdk") is None or GRPC == "mavsdk",
    reason="MAVSDK's own library is not installed: mavsdk 4",
)
needs_pymavlink = pytest.mark.skipif(
    importlib.util.find_spec("pymavlink") is None, reason="pymavlink is not installed"
)


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Site:
    """Virtual aircraft, the bridge in front of them, and a port that it speaks to."""

    def __init__(
        self, bridge: subprocess.Popen[str], sims: list[dict[str, Any]], port: int
    ) -> None:
        self.bridge = bridge
        self.sims = sims
        self.port = port
        self.address = ""

    def order(self, *words: str, aircraft: int = 0) -> str:
        command = [sys.executable, "-m", "m100link", "sim", "ctl", "--socket"]
        place = self.sims[aircraft]["control_socket"]
        done = subprocess.run([*command, place, *words], capture_output=True, text=True, check=True)
        return done.stdout

    def truth(self, aircraft: int = 0) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.order("status", aircraft=aircraft))
        return found

    def until(self, predicate: Callable[[], bool], within: float = PATIENCE) -> None:
        ends = time.monotonic() + within
        while not predicate():
            assert time.monotonic() < ends, self.truth()
            time.sleep(0.1)

    def assert_hovers(self) -> None:
        """It comes to rest in the air, by the simulator's own truth."""
        time.sleep(4.0)
        before = self.truth()
        time.sleep(2.0)
        after = self.truth()
        moved = math.hypot(after["north"] - before["north"], after["east"] - before["east"])
        assert moved < 0.3
        assert abs(after["height"] - before["height"]) < 0.3
        assert after["height"] > 1.0


@contextmanager
def started(*words: str, **more: Any) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **more) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    process.kill()


def line_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    found: dict[str, Any] = json.loads(process.stdout.readline())
    return found


@contextmanager
def site(firmware: str, *options: str, count: int = 1) -> Iterator[Site]:
    port = free_port()
    with ExitStack() as stack:
        sims = []
        for place in range(count):
            words = ("-m", "m100link", "sim", "--tcp", "127.0.0.1:0", "--json")
            where = ("--latitude", "47.3977419", "--longitude", str(8.5455938 + place * 2e-4))
            sim = stack.enter_context(
                started(*words, "--firmware", firmware, *where, "--ground-altitude", "488")
            )
            sims.append(line_of(sim))
        urls = [one["port"] for one in sims]
        words = ("-m", "m100link", "mavlink", *urls, "--json", "--app-id", "10086", "--key", KEY)
        to = ("--listen", "udp://127.0.0.1:0", "--to", f"udp://127.0.0.1:{port}")
        bridge = stack.enter_context(started(*words, *to, *options))
        found = Site(bridge, sims, port)
        found.address = line_of(bridge)["mavlink"][0].removeprefix("udp://")
        yield found


def run(program: str, *words: str, within: float = PATIENCE) -> str:
    command = [sys.executable, "-W", "ignore", str(HERE / program), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=within, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


# -- MAVSDK ---------------------------------------------------------------------------------------


@needs_grpc
@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("flight", ["take_off", "go_to", "setpoints", "mission"])
def test_mavsdk_flies(firmware: str, flight: str) -> None:
    with site(firmware) as found:
        grpc = str(free_port(socket.SOCK_STREAM))
        told = run("mavsdk_grpc_flights.py", flight, str(found.port), grpc)
        assert f"{flight}: done" in told
        found.until(lambda: found.truth()["flight_status"] == "standby")
        assert found.truth()["control"] == "rc"


@needs_grpc
@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
def test_mavsdk_uses_camera_gimbal_and_logs(firmware: str, tmp_path: Path) -> None:
    with site(firmware, "--record", str(tmp_path)) as found:
        grpc = str(free_port(socket.SOCK_STREAM))
        told = run("mavsdk_grpc_flights.py", "payload", str(found.port), grpc)
        assert "payload: done" in told
        assert not found.truth()["motors_on"]


@needs_native
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_mavsdks_own_library_sees_two_and_flies_one(firmware: str) -> None:
    with site(firmware, count=2) as found:
        told = run("mavsdk_native_flights.py", "2", str(found.port))
        assert "systems [1, 2]" in told
        assert "native: done" in told
        assert found.truth(0)["flight_status"] == "standby"


# -- examples -------------------------------------------------------------------------------------

EXAMPLES = HERE.parents[2] / "examples" / "mavlink"


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_the_example_that_needs_no_library_flies_a_square(firmware: str) -> None:
    with site(firmware) as found:
        told = run(str(EXAMPLES / "square.py"), f"udp://{found.address}")
        assert told.count("corner") == 4
        assert told.endswith("landed\n")
        assert found.truth()["flight_status"] == "standby"
        assert found.truth()["control"] == "rc"


@pytest.mark.skipif(GRPC == "mavsdk", reason="it is written for mavsdk-grpc")
@pytest.mark.timeout(1800)
def test_the_tutorial_flies_a_square(tmp_path: Path) -> None:
    port = str(free_port())
    bridge = f"mavlink sim:// --listen udp://127.0.0.1:0 --to udp://127.0.0.1:{port}"
    Reader(tmp_path, {"mavlink sim://": bridge, ":14540": f":{port}"}).follow("mavsdk")


@pytest.mark.skipif(GRPC == "mavsdk", reason="it is written for mavsdk-grpc")
@pytest.mark.parametrize("end", ["SIGKILL", "SIGTERM", "SIGINT", "exception"])
def test_the_program_of_the_tutorial_fails_and_the_aircraft_stops(end: str, tmp_path: Path) -> None:
    [text] = [one.text for one in blocks("mavsdk") if one.name == "square.py"]
    leg = "await asyncio.sleep(3.0)"
    text = text.replace(leg, "await asyncio.sleep(2.0); 1 / 0" if end == "exception" else leg)
    text = text.replace(leg, "await asyncio.sleep(25.0)")
    text = text.replace("50051", str(free_port(socket.SOCK_STREAM)))
    program = tmp_path / "square.py"
    with site("1.0") as found:
        program.write_text(text.replace(":14540", f":{found.port}"))
        # Ctrl-C reaches the process group, as on a terminal.
        with started(str(program), start_new_session=True) as process:
            found.until(lambda: found.truth()["north"] > 2.0)
            if end != "exception":
                os.killpg(process.pid, signal.Signals[end])
            before = found.truth()
            assert process.wait(PATIENCE) != 0
            if end in ("SIGKILL", "SIGTERM"):
                found.assert_hovers()
            else:
                found.until(lambda: found.truth()["flight_status"] == "standby")
        after = found.truth()
    flown = math.hypot(after["north"] - before["north"], after["east"] - before["east"])
    assert flown < 8.0  # of 150 that a server of its own would fly


# -- pymavlink ------------------------------------------------------------------------------------


@needs_pymavlink
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_qgroundcontrols_order_is_answered(firmware: str) -> None:
    with site(firmware) as found:
        assert "done" in run("pymavlink_station.py", "ground_station", found.address)


def of_the_manual() -> list[str]:
    """The programs of the page: offboard, and the lines for camera and gimbal."""
    page = (HERE.parents[2] / "docs/howto/fly-by-mavlink.md").read_text("utf-8")
    page = page.partition("\n## Fly offboard\n")[2]
    return re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


@needs_pymavlink
def test_the_program_of_the_manual_flies_offboard(tmp_path: Path) -> None:
    program, _ = of_the_manual()
    assert ":14540" in program
    with site("1.0") as found:
        place = tmp_path / "offboard.py"
        place.write_text(program.replace(":14540", f":{found.port}"), "utf-8")
        assert "take off is done" in run(str(place))
        found.until(lambda: found.truth()["flight_status"] == "standby")
        assert found.truth()["north"] == pytest.approx(4.0, abs=1.0)


@needs_pymavlink
def test_the_lines_of_the_manual_for_camera_and_gimbal_are_accepted(tmp_path: Path) -> None:
    offboard, lines = of_the_manual()
    answers = "for _ in range(4):\n    print(line.recv_match(type='COMMAND_ACK', blocking=True))\n"
    program = offboard.partition("\nstream(")[0] + "\n" + lines + answers
    with site("3.1") as found:
        place = tmp_path / "camera.py"
        place.write_text(program.replace(":14540", f":{found.port}"), "utf-8")
        said = run(str(place))
    for number in (2000, 2500, 1000, 195):
        assert f"command : {number}, result : 0," in said


@needs_pymavlink
@pytest.mark.parametrize("what", ["parameters", "missions", "latency"])
def test_pymavlink_asks(what: str) -> None:
    with site("1.0") as found:
        print(run("pymavlink_station.py", what, found.address))  # noqa: T201 - figures


@needs_pymavlink
def test_junk_swallows_no_command_and_costs_no_memory() -> None:
    with site("1.0") as found:
        time.sleep(3.0)
        before = memory(found.bridge.pid)
        print(run("pymavlink_station.py", "junk", found.address))  # noqa: T201 - figures
        assert memory(found.bridge.pid) < before + 8_000


def memory(process: int) -> int:
    """Resident kilobytes of a process and its children."""
    listed = subprocess.run(
        ["ps", "-o", "rss=", "-p", str(process), "--ppid", str(process)],
        capture_output=True,
        text=True,
        check=True,
    )
    return sum(int(one) for one in listed.stdout.split())


@needs_pymavlink
def test_what_is_not_signed_is_not_obeyed(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text(KEY)
    key.chmod(0o600)
    with site("1.0", "--signing-key-file", str(key)) as found:
        assert "not" in run("pymavlink_station.py", "signing", found.address, KEY)


# -- endings --------------------------------------------------------------------------------------


@contextmanager
def flying(found: Site, flight: str = "stay") -> Iterator[subprocess.Popen[str]]:
    """MAVSDK flies north: by setpoints at 3 m/s, or by a mission."""
    words = [str(HERE / "mavsdk_grpc_flights.py"), flight, str(found.port)]
    grpc = str(free_port(socket.SOCK_STREAM))
    with started("-W", "ignore", *words, grpc, start_new_session=True) as program:
        assert program.stdout is not None
        assert "flying" in program.stdout.readline()
        found.until(lambda: found.truth()["north"] > 3.0)
        try:
            yield program
        finally:
            with suppress(ProcessLookupError):  # it may be what was tried
                os.killpg(program.pid, signal.SIGKILL)


@needs_grpc
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_program_that_is_killed_leaves_a_hover(firmware: str) -> None:
    with site(firmware) as found, flying(found) as program:
        os.killpg(program.pid, signal.SIGKILL)
        found.assert_hovers()


@needs_grpc
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_bridge_that_is_ended_leaves_a_hover(number: signal.Signals) -> None:
    with site("1.0") as found, flying(found):
        found.bridge.send_signal(number)
        found.bridge.wait(PATIENCE)
        found.assert_hovers()


@needs_grpc
def test_a_front_that_is_killed_leaves_a_hover_and_comes_back() -> None:
    with site("1.0") as found, flying(found):
        os.kill(front_of(found), signal.SIGKILL)
        found.assert_hovers()


def children_of(found: Site) -> dict[bool, int]:
    """The children of the process that has the aircraft: the guardian (True), and the front."""
    listed = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(found.bridge.pid)],
        capture_output=True,
        text=True,
        check=True,
    )
    rows = (line.split(maxsplit=1) for line in listed.stdout.splitlines())
    return {"guardian_process" in words: int(process) for process, words in rows}


def front_of(found: Site) -> int:
    """The process that strangers reach; the other one has the aircraft."""
    return children_of(found)[False]


def kill_with_its_guardian(found: Site) -> None:
    """Nobody is left who could stop a mission: the guardian first, or it would."""
    os.kill(children_of(found)[True], signal.SIGKILL)
    found.bridge.kill()


@needs_grpc
def test_the_pilot_takes_it_from_a_program() -> None:
    with site("1.0") as found, flying(found):
        found.order("rc-mode", "P")
        found.assert_hovers()
        assert found.truth()["control"] == "rc"


@needs_grpc
def test_a_cable_that_is_pulled_leaves_a_hover() -> None:
    with site("1.0") as found, flying(found):
        found.order("unplug")
        found.assert_hovers()


# -- endings of a mission that the aircraft flies by itself ---------------------------------------

ENDINGS: dict[str, Callable[[Site, subprocess.Popen[str]], object]] = {
    "the program is killed": lambda _, program: os.killpg(program.pid, signal.SIGKILL),
    "the bridge gets SIGTERM": lambda found, _: found.bridge.terminate(),
    "the front is killed": lambda found, _: os.kill(front_of(found), signal.SIGKILL),
    "the agent is killed": lambda found, _: found.bridge.kill(),
    "the pilot takes it": lambda found, _: found.order("rc-mode", "P"),
}
LOSSES: dict[str, Callable[[Site], object]] = {
    "the agent and its guardian are killed": kill_with_its_guardian,
    "the cable is pulled": lambda found: found.order("unplug"),
}


def flies_itself(found: Site) -> bool:
    mission = found.truth()["mission"]
    return mission is not None and mission.get("waypoint") is not None and not mission["is_paused"]


@needs_grpc
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_mission_that_nobody_wants_any_more_ends_in_a_hover(ending: str) -> None:
    with site("3.1") as found, flying(found, "patrol") as program:
        assert flies_itself(found)
        ENDINGS[ending](found, program)
        found.assert_hovers()
        assert not flies_itself(found)


@needs_grpc
@pytest.mark.parametrize("loss", LOSSES)
def test_a_mission_that_nobody_can_stop_is_flown_to_its_end(loss: str) -> None:
    with site("3.1") as found, flying(found, "patrol"):
        assert flies_itself(found)
        LOSSES[loss](found)
        found.until(lambda: found.truth()["flight_status"] == "standby")
        assert math.hypot(found.truth()["north"], found.truth()["east"]) < 3.0


@needs_grpc
def test_a_mission_that_flew_on_is_stopped_by_the_next_hold() -> None:
    with site("3.1") as found:
        with flying(found, "patrol"):
            found.order("unplug")
            time.sleep(2.0)
        assert flies_itself(found)
        found.order("replug")
        told = run("pymavlink_station.py", "hold", found.address)
        assert "mission, then hold" in told
        found.assert_hovers()
        assert not flies_itself(found)
