"""``m100link sim`` as a process, in real time (few and short)."""

from __future__ import annotations

import io
import json
import os
import pty
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from cyclopts import CycloptsError
from rich.console import Console

from m100link.apps.cli.app import app
from m100link.apps.cli.sim import KEYS, LiveView
from m100link.apps.cli.terminal import read_keys
from m100link.errors import M100Error
from m100link.protocol.commands.waypoint import WaypointPauseResume
from m100link.sim import VirtualAircraft
from m100link.wire import FrameDecoder, encode_frame
from tests.sim.vehicle.missions.flights import begin, host, point
from tests.waiting import PATIENCE, blocking_until

KEY = "5837313ef98f1f7f1c50eebb0b06363d523a369289e042c4d00b66d8e49337a7"


class Simulator:
    """A running ``m100link sim``."""

    def __init__(self, runtime: Path, *arguments: str) -> None:
        self.environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime)}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "m100link", "sim", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.process.communicate()[1]
        self.hello: dict[str, Any] = json.loads(line)

    def ctl(self, *order: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "m100link", "sim", "ctl", *order],
            capture_output=True,
            text=True,
            env=self.environment,
            check=False,
            timeout=PATIENCE,
        )

    def end(self, number: int = signal.SIGTERM) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        out, err = self.process.communicate(timeout=PATIENCE)
        assert (out, err) == ("", "")
        return self.process.returncode


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Any]:
    running: list[Simulator] = []

    def run(*arguments: str) -> Simulator:
        simulator = Simulator(tmp_path, *arguments)
        running.append(simulator)
        return simulator

    yield run
    for simulator in running:
        if simulator.process.poll() is None:
            simulator.process.kill()
        simulator.process.communicate()


def version_of(port: Any) -> bytes:
    """Ask for the version over anything with read and write, and again, as a program would."""
    decoder = FrameDecoder()
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        port.write(encode_frame(b"\x00\x00\x00", session=2, sequence=77))
        ask_again = time.monotonic() + 1
        while time.monotonic() < ask_again:
            for frame in decoder.feed(port.read(64)):
                if frame.is_ack and frame.sequence == 77:
                    return frame.data
    raise AssertionError("no version")


@pytest.mark.pty
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_one_line_of_json_once_it_answers_and_a_clean_end(
    start: Any, tmp_path: Path, number: int
) -> None:
    link = tmp_path / "ttyUSB0"
    simulator = start(
        *("--link", str(link), "--app-id", "10086", "--key", KEY, "--level", "2"),
        *("--firmware", "1.0", "--seed", "1"),
    )
    hello = simulator.hello
    assert (hello["port"], hello["firmware"], hello["seed"]) == (str(link), "1.0", 1)
    with serial.Serial(str(link), 230400, timeout=0.2) as port:
        assert len(version_of(port)) == 38
    assert KEY not in json.dumps(hello)
    assert simulator.end(number) == 0
    assert not link.is_symlink()
    assert not Path(hello["control_socket"]).exists()


@pytest.mark.pty
@pytest.mark.parametrize(
    ("option", "least", "most"), [("--pace", 0, 960), ("--no-pace", 5000, 2**30)]
)
def test_bytes_take_their_time_unless_set_otherwise(
    start: Any, option: str, least: int, most: int
) -> None:
    simulator = start("--tcp", "0", "--baud", "9600", option)
    address = simulator.hello["port"].removeprefix("tcp://").split(":")
    with socket.create_connection((address[0], int(address[1]))) as connection:
        began, count = time.monotonic(), 0
        while time.monotonic() < began + 2.0:
            count += len(connection.recv(4096))
        elapsed = time.monotonic() - began
    assert count <= most * elapsed + 200  # one frame may have been on its way
    assert count >= least


@pytest.mark.pty
def test_orders_from_another_shell(start: Any) -> None:
    simulator = start("--seed", "2")
    answer = simulator.ctl("rc-mode", "P")
    assert answer.returncode == 0, answer.stderr
    assert json.loads(answer.stdout)["rc_mode"] == "P"
    wrong = simulator.ctl("rc-mode", "X")
    assert wrong.returncode == 2
    assert "the mode switch has no position 'X'\n  what to do:   P, A or F\n" in wrong.stderr
    assert wrong.stderr.count("what to do") == 1
    offered = [json.loads(line) for line in simulator.ctl().stdout.splitlines()]
    assert {one["action"]: one["arguments"] for one in offered}["rc-mode"] == "P|A|F"


@pytest.mark.pty
def test_tcp_many_and_scenario(start: Any, tmp_path: Path) -> None:
    file = tmp_path / "scenario.toml"
    file.write_text('[[step]]\nat = 0.2\ndo = "gps 1"\n')
    simulator = start(
        *("--tcp", "0", "--count", "3", "--scenario", str(file)),
        *("--firmware", "3.1", "--loss", "0.3", "--seed", "6"),
    )
    print(f"seed {simulator.hello['seed']}")  # noqa: T201 (pytest shows it when the test fails)
    ports = simulator.hello["ports"]
    assert len(set(ports)) == 3
    for port in ports:
        with serial.serial_for_url(port.replace("tcp://", "socket://"), timeout=0.2) as opened:
            assert len(version_of(opened)) == 49
    blocking_until(lambda: json.loads(simulator.ctl("status").stdout)["gps_health"] == 1)


@pytest.mark.pty
def test_it_starts_activated_for_a_program_that_does_not_activate(start: Any) -> None:
    simulator = start("--tcp", "0", "--activated")
    url = simulator.hello["port"].replace("tcp://", "socket://")
    with serial.serial_for_url(url, timeout=0.2) as port:
        assert version_of(port)[:2] == b"\0\0"


@pytest.mark.pty
def test_it_ends_by_itself_after_its_time(start: Any) -> None:
    simulator = start("--duration", "2")
    assert simulator.process.wait(timeout=PATIENCE) == 0


@pytest.mark.pty
@pytest.mark.parametrize(
    "arguments",
    [
        ["--key", "123"],
        ["--key-file", "/does/not/exist"],
        ["--speed", "0"],
        ["--speed", "inf"],
        ["--count", "0"],
        ["--tcp", "nowhere"],
        ["--tcp", "192.0.2.1:0"],  # an address of documents, not of this machine (RFC 5737)
        ["--app-id", "4294967296"],
        ["--rate", "battery=2"],
        ["--rate", "battery"],
        ["--firmware", "9.9"],
        ["--loss", "7"],
        ["--link", "/dev/null"],
        ["--scenario", "/does/not/exist"],
        ["--latitude", "95"],
    ],
)
def test_wrong_arguments_end_with_a_sentence_and_no_traceback(
    arguments: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises((M100Error, CycloptsError)) as ended:
        app(
            ["sim", *arguments],
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
    assert len(str(ended.value)) > 20
    assert capfd.readouterr().out == ""


@pytest.mark.pty
def test_on_a_terminal_it_is_shown_live_and_has_keys(tmp_path: Path) -> None:
    environment = os.environ | {"XDG_RUNTIME_DIR": str(tmp_path), "TERM": "xterm", "COLUMNS": "120"}
    child, master = pty.fork()
    if child == 0:  # pragma: no cover (the simulator itself)
        os.execve(
            sys.executable,
            [sys.executable, "-m", "m100link", "sim", "--seed", "3"],
            environment,
        )
    seen = b""
    keys = [(b"seed 3", b"p"), (b"the mode switch is not in F", b"\x03")]
    try:
        while chunk := os.read(master, 65_536):
            seen += chunk
            if keys and keys[0][0] in seen:
                os.write(master, keys.pop(0)[1])
    except OSError:
        pass  # the terminal closes with its last process
    finally:
        os.close(master)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert not keys


# -- the live view of the simulator: keys and pictures, without a terminal -------------------------


def shown(view: LiveView) -> str:
    console = Console(width=200, file=io.StringIO(), markup=False)
    with console.capture() as captured:
        console.print(view.render())
    return captured.get()


def test_arrows_and_letters_are_distinguished_in_one_read() -> None:
    assert read_keys(b"p\x1b[A\x1b[DX ") == ["p", "UP", "LEFT", "X", " "]
    assert read_keys(b"") == []


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_an_order_that_exists(key: str) -> None:
    aircraft = VirtualAircraft(seed=1)
    view = LiveView(aircraft, ["/dev/pts/9"])
    view.press(key)
    assert f"> {KEYS[key][0]}" in shown(view)


def test_a_key_does_what_it_says_and_is_shown() -> None:
    aircraft = VirtualAircraft(seed=7)
    view = LiveView(aircraft, ["/dev/pts/9"])
    view.press("p")
    text = shown(view)
    for part in ("/dev/pts/9", "seed 7", "> rc-mode P", "the mode switch is not in F"):
        assert part in text


def test_a_mission_is_shown_and_how_it_ended() -> None:
    program = host()
    view = LiveView(program.aircraft, [])
    assert "mission" not in shown(view)
    begin(program, [point(0, 0, 0, 10), point(1, 30, 0, 10)])
    program.wait(12.0)
    for part in ("waypoint: flies", "1 of 0 to 1", "waypoint 0 reached"):
        assert part in shown(view)
    program.ask(WaypointPauseResume(0))
    assert "waypoint: paused" in shown(view)
    program.aircraft.leave_f()
    program.wait(0.1)
    assert "last mission" in shown(view)
    assert "waypoint: broken off: the remote controller is not in F position" in shown(view)


def test_any_other_key_does_nothing() -> None:
    view = LiveView(VirtualAircraft(seed=1), [])
    before = shown(view)
    view.press("?")
    assert shown(view) == before
