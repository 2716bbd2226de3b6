"""Plans of waypoints at the shell."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from m100link import (
    AtEnd,
    GimbalPitch,
    Heading,
    OnRCLoss,
    Stay,
    TakePhoto,
    Waypoint,
    WaypointPlan,
)
from m100link.apps.cli.common import out
from m100link.apps.cli.terminal import ExitCode
from tests.apps.cli.conftest import ROOT, CommandLine
from tests.waiting import PATIENCE

PLAN = WaypointPlan(
    [
        Waypoint(52.1, 4.31, 20.0),
        Waypoint(52.1009, 4.31, 35.0, heading_deg=90, actions=[Stay(2), GimbalPitch(-60)]),
        Waypoint(52.1009, 4.3113, 20.0, actions=[TakePhoto()], action_repeat=3),
    ],
    heading=Heading.BY_WAYPOINT,
    at_end=AtEnd.GO_HOME,
)


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "plan.json"
    PLAN.write(path)
    return str(path)


# -- check ----------------------------------------------------------------------------------------


def test_a_sound_plan_is_reported_in_numbers(cli: CommandLine, file: str) -> None:
    outcome = cli("plan", "check", file)
    assert outcome.status == ExitCode.OK
    [told] = outcome.objects
    assert told["ok"] is True
    assert (told["problems"], told["remarks"]) == ([], [])
    assert (told["waypoints"], told["lowest_m"], told["highest_m"]) == (3, 20, 35)
    assert told["farthest_m"] == pytest.approx(134, abs=1)
    assert told["estimate"]["hover_minutes"] == 17
    assert 0 < told["estimate"]["battery_percent"] < 20
    more = cli("plan", "check", file, "--home", "-52.1,4.31", "--hover-minutes", "10").objects[0]
    assert more["farthest_m"] > 1e6


def test_a_sound_plan_is_reported_in_words(cli: CommandLine, file: str) -> None:
    replace(PLAN, on_rc_loss=OnRCLoss.CONTINUE).write(file)
    first, second, third = cli("plan", "check", file, "--table").out.splitlines()
    assert first == "! without the RC it flies on, and no pilot can stop it"
    assert second == "✓ 3 waypoints, 20 to 35 m high, at most 134 m from the first"
    assert third.startswith("  about 212 m in 1:0")


def broken(path: str) -> None:
    document = json.loads(PLAN.to_json()) | {"speed": 99}
    document["waypoints"][1]["height"] = 900
    Path(path).write_text(json.dumps(document), encoding="utf-8")


def test_everything_that_is_wrong_is_reported_at_once(cli: CommandLine, file: str) -> None:
    broken(file)
    outcome = cli("plan", "check", file, "--table")
    assert outcome.status == ExitCode.USAGE
    assert outcome.out.splitlines() == [
        "✗ speed 99 is above 10 m/s",
        "  -10 to 10 m/s, which is max_speed; that may be up to 15 m/s",
        "✗ waypoint 1: height 900 is above 500 m",
        "  -200 to 500 m above the take-off point",
    ]
    [told] = cli("plan", "check", file).objects
    assert told["ok"] is False
    assert told["problems"][0] == {
        "point": None,
        "field": "speed",
        "value": 99,
        "seen": "speed 99 is above 10 m/s",
        "remedy": "-10 to 10 m/s, which is max_speed; that may be up to 15 m/s",
    }
    one = told["problems"][1]
    assert (one["point"], one["field"], one["value"]) == (1, "height", 900)


@pytest.mark.parametrize("verb", ["check", "show", "convert"])
@pytest.mark.parametrize("name", ["missing.json", "", "text.txt", "x" * 300])
def test_what_is_not_a_plan_ends_with_an_error_and_no_traceback(
    cli: CommandLine, tmp_path: Path, verb: str, name: str
) -> None:
    (tmp_path / "text.txt").write_text("not JSON")
    target = ["-"] if verb == "convert" else []
    outcome = cli("plan", verb, str(tmp_path / name), *target)
    assert outcome.status == ExitCode.USAGE
    said = outcome.out + outcome.err
    assert "cannot be read" in said or "is not JSON" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("plan", "chekc", "x"),
        ("plan", "check"),
        ("plan", "check", "x", "--jsn"),
        ("plan", "check", "x", "--home", "52.1"),
        ("plan", "check", "x", "--home", "52.1,4.31,5"),
        ("plan", "check", "x", "--home", "nan,0"),
        ("plan", "check", "x", "--hover-minutes", "0"),
        ("plan", "convert", "x"),
        ("plan", "convert", "x", "y", "--format", "kml"),
    ],
    ids=" ".join,
)
def test_what_is_asked_wrongly_is_a_usage_error(
    cli: CommandLine, arguments: tuple[str, ...]
) -> None:
    outcome = cli(*arguments)
    assert outcome.status == ExitCode.USAGE
    assert outcome.err
    assert "Traceback" not in outcome.err


# -- show -----------------------------------------------------------------------------------------


def test_a_plan_is_shown_from_above_from_the_side_and_as_a_table(
    cli: CommandLine, file: str
) -> None:
    outcome = cli("plan", "show", file, "--table")
    assert outcome.status == ExitCode.OK
    lines = outcome.out.splitlines()
    [north, heights, table] = [
        next(index for index, line in enumerate(lines) if words in line)
        for words in ("north up; 100.1 m north", "35.00 ┤", "latitude")
    ]
    assert 0 < north < heights < table
    drawn = "\n".join(lines[:north])
    assert drawn.index("1") < drawn.index("0"), "the first waypoint is the southernmost"
    assert lines[table].split() == [*("latitude", "longitude", "height", "leg"), "heading", "there"]
    assert lines[table + 2].split(maxsplit=8) == [
        *("1", "52.1009000", "4.3100000", "35", "m", "101.3", "m", "90°"),
        "stay 2 s, gimbal -60°",
    ]
    assert lines[table + 3].rstrip().endswith("photo ×3")
    assert lines[-2:][0] == "by waypoint, stop at points, at the end go home, without RC failsafe"
    assert lines[-1].startswith("about 212 m in ")


def test_a_level_plan_has_no_profile_and_other_choices_their_words(
    cli: CommandLine, file: str
) -> None:
    WaypointPlan([Waypoint(1, 1, 9), Waypoint(1.001, 1, 19)]).write(file)
    shown = cli("plan", "show", file, "--table").out
    [top] = [line.partition("┤")[2] for line in shown.splitlines() if "19.00 ┤" in line]
    assert top.rstrip("\u2800 ") == top.rstrip(" "), "the way goes to the right, and it climbs"
    assert top[0] == "\u2800"
    points = [Waypoint(1, 1, 9, damping=3), Waypoint(1.001, 1, 9)]
    WaypointPlan(points, repeat=2, speed=0).write(file)
    shown = cli("plan", "show", file, "--table").out
    assert "┤" not in shown
    assert "heading" not in shown
    assert "corner 3 m" in shown
    assert "0 m/s, with the stick up to 10 m/s, flown twice" in shown
    assert "as fast as the pilot's stick" in shown
    assert "! dampings are ignored" in shown


def test_forty_columns_are_enough(
    cli: CommandLine, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(out, "width", 40)
    lines = cli("plan", "show", file, "--table").out.splitlines()
    assert max(map(len, lines)) <= 40
    assert "latitude" not in "\n".join(lines)


def test_a_terminal_without_unicode_and_a_reader_that_leaves(file: str) -> None:
    shown = f"{sys.executable} -m m100link plan show {file} --table"
    done = subprocess.run(
        ["sh", "-c", f"{shown}; {shown} | head -1; echo $?"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "COLUMNS": "80"},
        cwd=ROOT,
        timeout=PATIENCE,
        check=True,
    )
    lines = done.stdout.decode("ascii").splitlines()
    assert done.stderr == b""
    assert "north up; 100.1 m north to south" in "".join(lines)
    assert lines[-1] == "0"


@pytest.mark.parametrize("verb", ["check", "show", "convert"])
@pytest.mark.parametrize("where", ["PORT", "sim://", "/dev/ttyUSB99", "/dev/ttyUSB9:921600", "lab"])
def test_an_aircraft_in_place_of_a_plan_is_not_read(
    cli: CommandLine, configuration_file: Path, verb: str, where: str
) -> None:
    configuration_file.write_text('[aircraft.lab]\nurl = "sim://"\n', encoding="utf-8")
    ours, port = os.openpty()
    try:
        word = os.ttyname(port) if where == "PORT" else where
        outcome = cli("plan", verb, word, *(("-",) if verb == "convert" else ()))
    finally:
        os.close(ours)
        os.close(port)
    assert outcome.status == ExitCode.USAGE
    assert f"the plan is {word!r}, which names an aircraft" in outcome.err
    assert "did you swap PLAN and URL?" in outcome.err


# -- convert --------------------------------------------------------------------------------------


def test_json_becomes_a_plan_of_qgroundcontrol_and_back(
    cli: CommandLine, file: str, tmp_path: Path
) -> None:
    there, back = str(tmp_path / "x.plan"), str(tmp_path / "back.json")
    assert cli("plan", "convert", file, there).status == ExitCode.OK
    assert json.loads(Path(there).read_text())["fileType"] == "Plan"
    assert cli("plan", "convert", there, back).status == ExitCode.OK
    assert WaypointPlan.read(back) == PLAN


def test_nothing_is_written_over_that_nobody_named(cli: CommandLine, file: str) -> None:
    outcome = cli("plan", "convert", file, file, "--format", "plan")
    assert outcome.status == ExitCode.USAGE
    assert "is there already" in outcome.err
    assert WaypointPlan.read(file) == PLAN
    assert cli("plan", "convert", file, file, "--format", "plan", "--force").status == ExitCode.OK
    assert '"fileType"' in Path(file).read_text()


def test_standard_streams_are_files_too(
    cli: CommandLine, file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("plan", "convert", file, "-").out == PLAN.to_json()
    text = cli("plan", "convert", file, "-", "--format", "plan").out
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert cli("plan", "convert", "-", "-").out == PLAN.to_json()


def test_what_may_be_left_out_is_named(cli: CommandLine, tmp_path: Path) -> None:
    document = json.loads(PLAN.to_qgroundcontrol())
    del document["m100link"]
    document["rallyPoints"]["points"] = [[1, 2, 3]]
    camera = document["mission"]["items"][0] | {"command": 530}
    document["mission"]["items"].insert(0, camera)
    path = tmp_path / "qgc.plan"
    path.write_text(json.dumps(document))
    outcome = cli("plan", "convert", str(path), "-", "--leave-out", "rallyPoints")
    assert outcome.status == ExitCode.USAGE
    assert "item 1, SET_CAMERA_MODE (530)" in outcome.err
    for named in (
        ["--leave-out", "rallyPoints", "--leave-out", "530"],
        ["--leave-out", "rallyPoints,530"],
    ):
        assert cli("plan", "convert", str(path), "-", *named).status == ExitCode.OK


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("/proc/nowhere/x.json", ("there is no folder /proc/nowhere", "make it first")),
        ("/proc", ("/proc is a folder", "name a file: /proc/plan.json")),
        ("/proc/x.json", ("cannot be written", "folder")),
    ],
)
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_a_place_that_cannot_be_written_is_an_error(
    cli: CommandLine, file: str, target: str, words: tuple[str, str], force: tuple[str, ...]
) -> None:
    outcome = cli("plan", "convert", file, target, *force)
    assert outcome.status == ExitCode.USAGE
    assert all(word in outcome.err for word in words), outcome.err


FIELD = ("52.1,4.31", "52.1005,4.31", "52.1005,4.3108", "52.1,4.3108")


def test_a_survey_is_written_and_can_be_read(cli: CommandLine, tmp_path: Path) -> None:
    target = tmp_path / "field.plan"
    ended = cli("plan", "survey", str(target), *FIELD, "--height", "30", "--spacing", "15")
    assert ended.status == ExitCode.OK
    plan = WaypointPlan.read(target)
    assert {one.height for one in plan.waypoints} == {30.0}
    assert len(plan.waypoints) == 8
    assert (plan.take_off, plan.at_end) == (False, AtEnd.HOVER)


@pytest.mark.parametrize("kind", ["json", "plan"])
@pytest.mark.parametrize(
    ("words", "end"), [("go-home", AtEnd.GO_HOME), ("land", AtEnd.LAND), ("hover", AtEnd.HOVER)]
)
def test_a_survey_takes_off_and_ends_as_it_is_told(
    cli: CommandLine, tmp_path: Path, kind: str, words: str, end: AtEnd
) -> None:
    target = tmp_path / f"field.{kind}"
    lines = ("--height", "30", "--spacing", "15")
    ended = cli("plan", "survey", str(target), *FIELD, *lines, "--takeoff", "--at-end", words)
    assert ended.status == ExitCode.OK
    plan = WaypointPlan.read(target)
    assert (plan.take_off, plan.at_end) == (True, end)


@pytest.mark.parametrize("area", [FIELD[:2], ("52.1", *FIELD), ("x,y", *FIELD)])
def test_what_is_not_an_area_is_refused(
    cli: CommandLine, tmp_path: Path, area: tuple[str, ...]
) -> None:
    target = tmp_path / "field.json"
    ended = cli("plan", "survey", str(target), *area, "--height", "30", "--spacing", "15")
    assert ended.status == ExitCode.USAGE
    assert not target.exists()
