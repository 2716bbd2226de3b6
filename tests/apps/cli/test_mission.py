"""Missions from the shell over a real pseudo-terminal: flown, killed, found, ended. Real time."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from m100link import Stay, Waypoint, WaypointPlan
from m100link.apps.cli.terminal import ExitCode
from m100link.geodesy import LocalFrame
from m100link.link.gate import GUARDIAN_NAME
from m100link.sim.vehicle.settings import AircraftSettings
from tests.apps.cli.conftest import ROOT, CommandLine, Simulator, process
from tests.waiting import PATIENCE, again_and_again

HOME = AircraftSettings()
SPOTS = ((0.0, 0.0), (4.0, 0.0))


def plan(*actions: Stay) -> WaypointPlan:
    here = LocalFrame(HOME.latitude_deg, HOME.longitude_deg)
    points = [Waypoint(*here.to_geodetic(*spot), height=3.0, actions=actions) for spot in SPOTS]
    return WaypointPlan(points, speed=8.0)


@pytest.fixture
def later(tmp_path: Path) -> Iterator[Simulator]:
    """One that knows missions."""
    running = Simulator(tmp_path, "--firmware", "3.1")
    yield running
    running.close()


@pytest.fixture
def short(tmp_path: Path) -> str:
    path = tmp_path / "short.json"
    path.write_text(plan().to_json(), encoding="utf-8")
    return str(path)


@pytest.fixture
def long(tmp_path: Path) -> str:
    """It hovers at its first waypoint for half a minute."""
    path = tmp_path / "long.json"
    path.write_text(plan(Stay(30.0)).to_json(), encoding="utf-8")
    return str(path)


def begin(*arguments: str) -> subprocess.Popen[str]:
    """A flight in a process of its own, up to its first waypoint."""
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "mission", "fly", *arguments, "--takeoff", "--yes"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={k: v for k, v in os.environ.items() if not k.startswith("M100LINK_")},
        cwd=ROOT,
    )
    assert running.stdout is not None
    for line in running.stdout:
        if json.loads(line)["event"] == "reached":
            return running
    raise AssertionError(running.communicate()[1])


@pytest.mark.pty
def test_a_plan_is_flown_and_reported_as_json(later: Simulator, app: list[str], short: str) -> None:
    outcome = process("mission", "fly", short, later.port, "--takeoff", "--yes", *app)
    assert outcome.status == 0, outcome
    steps = [told["event"] for told in outcome.objects if told["event"] != "mission_progress"]
    assert steps[:2] == ["uploaded", "started"]
    assert steps.count("reached") == len(SPOTS)
    assert steps[-1] == "finished"
    assert "On Linux, a guardian stops it if this program is killed" in outcome.err
    assert process("mission", "stop", later.port, *app).out == '{"stopped": null}\n'


def leave_in_flight(flying: subprocess.Popen[str]) -> None:
    """Kill it, and its guardian first, which would stop the mission."""
    children = Path(f"/proc/{flying.pid}/task/{flying.pid}/children").read_text("ascii").split()
    names = {int(child): Path(f"/proc/{child}/comm").read_text().strip() for child in children}
    (guardian,) = (child for child, name in names.items() if name == GUARDIAN_NAME)
    flying.send_signal(signal.SIGSTOP)  # before it has news of its guardian
    os.kill(guardian, signal.SIGKILL)
    flying.kill()
    flying.communicate(timeout=PATIENCE)


@pytest.mark.pty
def test_a_program_that_is_killed_has_a_guardian_that_stops_the_mission(
    later: Simulator, app: list[str], long: str
) -> None:
    flying = begin(long, later.port, *app)
    flying.kill()
    flying.communicate(timeout=PATIENCE)
    for _ in again_and_again():
        outcome = process("mission", "stop", later.port, *app)
        if outcome.status != ExitCode.PORT:  # the guardian has it
            break
    # The first one that gets the port would stop a mission that flies on.
    assert outcome.out == '{"stopped": null}\n', outcome


@pytest.mark.pty
def test_a_program_that_is_killed_with_its_guardian_leaves_it_in_flight_for_the_next_one(
    later: Simulator, app: list[str], long: str
) -> None:
    leave_in_flight(begin(long, later.port, *app))
    outcome = process("mission", "download", later.port, *app)
    assert outcome.status == 0, outcome
    assert WaypointPlan.parse(outcome.out.encode()) == plan(Stay(30.0))
    for verb, said in (("pause", "paused"), ("resume", "resumed"), ("stop", "stopped")):
        sure = ("--yes",) if verb == "resume" else ()
        outcome = process("mission", verb, later.port, *sure, *app)
        assert outcome.status == 0, outcome
        assert json.loads(outcome.out) == {said: "waypoint mission"}
    assert process("mission", "download", later.port, *app).status == ExitCode.REFUSED


@pytest.mark.pty
def test_what_is_refused_beside_a_mission_does_not_end_it_and_landing_does(
    later: Simulator, app: list[str], long: str
) -> None:
    leave_in_flight(begin(long, later.port, *app))
    for words in (["mission", "fly", long, later.port], ["fly", later.port, "1", "0", "0"]):
        outcome = process(*words, "--yes", *app)
        assert outcome.status == ExitCode.AUTHORITY, outcome
        assert "nothing was sent, and it flies on" in outcome.err
        assert "`m100link mission stop` first" in outcome.err
        assert "broken off" not in outcome.err
    outcome = process("land", later.port, *app)  # nobody is asked, nothing else has to come first
    assert outcome.status == 0, outcome
    assert "stopped: waypoint mission" in outcome.err
    assert '"done": "land"' in outcome.out


@pytest.mark.pty
def test_ctrl_c_stops_it(later: Simulator, app: list[str], long: str) -> None:
    flying = begin(long, later.port, *app)
    flying.send_signal(signal.SIGINT)
    said = flying.communicate(timeout=PATIENCE)[1]
    assert flying.returncode == ExitCode.INTERRUPTED
    assert re.search(
        r"mission stopped after waypoint 0; the aircraft hovers at [23]\.\d m: m100link land\n",
        said,
    )
    assert process("mission", "stop", later.port, *app).out == '{"stopped": null}\n'


@pytest.mark.pty
def test_output_that_nobody_reads_stops_it_and_is_not_success(
    later: Simulator, app: list[str], long: str
) -> None:
    flying = begin(long, later.port, *app)
    assert flying.stdout is not None
    assert flying.stderr is not None
    flying.stdout.close()
    said = flying.stderr.read()
    flying.stderr.close()
    assert flying.wait(PATIENCE) == ExitCode.FAILED
    assert "output closed: mission stopped after waypoint 0; the aircraft hovers at " in said
    assert process("mission", "stop", later.port, *app).out == '{"stopped": null}\n'


@pytest.mark.pty
def test_flying_wants_to_be_confirmed(later: Simulator, app: list[str], short: str) -> None:
    outcome = process("mission", "fly", short, later.port, *app)
    assert outcome.status == ExitCode.USAGE
    assert "what to do:   give --takeoff, or m100link takeoff first" in outcome.err
    outcome = process("mission", "fly", short, later.port, "--takeoff", *app)
    assert outcome.status == ExitCode.USAGE
    assert "fly this mission was not confirmed" in outcome.err
    outcome = process("mission", "resume", later.port, *app)
    assert outcome.status == ExitCode.USAGE


def test_nothing_is_announced_to_who_gave_no_app_id(cli: CommandLine, short: str) -> None:
    outcome = cli("mission", "fly", short, "/dev/no-such-port", "--takeoff")
    assert outcome.status == ExitCode.USAGE
    assert "app id" in outcome.err
    assert "waypoints, about" not in outcome.err


SIM = "sim://?firmware=3.1"


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("fly", "PLAN", SIM), ExitCode.USAGE, "m100link takeoff first; or --takeoff\n"),
        (
            ("fly", "PLAN", SIM + "&speed=9"),
            ExitCode.USAGE,
            "leave the speed out; an aircraft with",
        ),
        (("fly", "PLAN", "sim://", "--takeoff"), ExitCode.REFUSED, "firmware 1.0 does not know"),
        (
            ("fly", "PLAN", "/dev/no-such-port", "--max-height", "2"),
            ExitCode.REFUSED,
            "waypoint 0 of the waypoint mission to a height of",
        ),
        (
            ("fly", "PLAN", SIM, "--takeoff", "--max-height", "2"),
            ExitCode.REFUSED,
            "a target inside, or --max-height\n",
        ),
        (("fly", "nowhere.json", SIM), ExitCode.USAGE, "nowhere.json"),
        (("pause", SIM), ExitCode.USAGE, "no mission flies"),
        (("download", SIM), ExitCode.REFUSED, "download it while it flies"),
        (("download", SIM, "--output", "PLAN"), ExitCode.USAGE, "is there already"),
        (("stop",), ExitCode.USAGE, "no URL says where"),
        (("fly", "PLAN"), ExitCode.USAGE, "after PLAN in `mission fly`"),
        (("fly", SIM, "plan.json"), ExitCode.USAGE, "did you swap PLAN and URL?"),
    ],
)
def test_what_cannot_be_is_said(
    cli: CommandLine, short: str, arguments: tuple[str, ...], status: int, words: str
) -> None:
    outcome = cli("mission", *(short if word == "PLAN" else word for word in arguments))
    assert outcome.status == status, outcome
    assert words in outcome.err
