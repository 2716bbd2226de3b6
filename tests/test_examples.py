"""Every example runs as it stands: against the virtual aircraft, on virtual time.

Each is a program with ``async def main(url)``; here main runs on an event loop whose time jumps, so
a flight takes a moment. That they also run as programs, in real time, is what ``nox -s examples``
shows.
"""

from __future__ import annotations

import ast
import asyncio
import csv
import importlib.util
import io
import json
import re
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from m100link.sim import LockstepEventLoop, VirtualClockEventLoop
from m100link.sync import aircraft as sync_aircraft
from m100link.sync.portal import Portal

EXAMPLES = Path(__file__).parent.parent / "examples"
PROGRAMS = sorted(path.stem for path in EXAMPLES.glob("*.py"))


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Run:
    """Runs an example; what it printed is the answer."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, name: str, *arguments: str) -> str:
        with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
            runner.run(load(name).main(*arguments))
        return self._capsys.readouterr().out


class Lockstep(Run):
    """Runs an example without ``async``: its aircraft's time passes while it waits."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(capsys)
        monkeypatch.setattr(sync_aircraft, "Portal", lambda _: Portal(LockstepEventLoop))

    def __call__(self, name: str, *arguments: str) -> str:
        load(name).main(*arguments)
        return self._capsys.readouterr().out


@pytest.fixture
def run(
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Run:
    return Lockstep(capsys, monkeypatch) if hasattr(request, "param") else Run(capsys)


FIRMWARE_URLS = ["sim://", "sim://?firmware=2.3", "sim://?firmware=3.1"]
each_firmware = pytest.mark.parametrize("url", FIRMWARE_URLS)


@each_firmware
@pytest.mark.parametrize("run", [Lockstep], indirect=True)
def test_without_await(run: Lockstep, url: str) -> None:
    text = run("without_await", url)
    assert "authority none" in text
    assert text.count(" m north, ") == 3
    assert text.endswith("landed\n")


def test_watching_goes_on_until_enough_was_seen(run: Run) -> None:
    first, *places, last = run("keep_watching", "sim://").splitlines()
    assert (first, last) == ("connected", "enough seen")
    assert len(places) == pytest.approx(8, abs=2)
    assert all(re.fullmatch(r"-?\d+\.\d{6} -?\d+\.\d{6}", place) for place in places)


def test_look_around(run: Run) -> None:
    lines = run("look_around", "sim://?firmware=3.1").splitlines()
    assert lines[0] == "gimbal at 50 Hz, attitude at 10 Hz"
    seen = [tuple(map(float, re.findall(r"-?\d+\.\d", line))) for line in lines[1:]]
    yaws = [yaw % 360.0 for yaw, _, _ in seen]
    assert yaws[1:4] == pytest.approx([90, 180, 270], abs=2.0)
    assert [pitch for _, pitch, _ in seen] == pytest.approx([-30, -30, -30, -30, 0], abs=2.0)


def test_a_survey_with_photos(run: Run) -> None:
    first, *lines, last = run("survey_with_photos").splitlines()
    assert re.match(r"\d+ m in \d:\d\d min, \d+ % of a battery", first)
    assert lines == [f"photograph {n} of {len(lines)}" for n in range(1, len(lines) + 1)]
    assert len(lines) > 8
    assert re.match(r"down \d\.\d m from where it took off", last)


def test_an_orbit_with_the_camera_on_its_centre(run: Run) -> None:
    *lines, last = run("orbit_a_place").splitlines()
    assert last == "landed"
    seen = [tuple(map(float, re.findall(r"-?\d+(?:\.\d+)?", line))) for line in lines]
    assert len(seen) > 20
    settled = seen[5:]
    assert [distance for distance, _ in settled] == pytest.approx([20.0] * len(settled), abs=1.0)
    assert [pitch for _, pitch in settled] == pytest.approx([-37.0] * len(settled), abs=2.0)


def test_following_somebody_who_walks(run: Run) -> None:
    *lines, last = run("follow_a_target").splitlines()
    distances = [float(line.split(": ")[1].split()[0]) for line in lines]
    assert len(distances) > 40
    assert all(7.0 < distance < 14.0 for distance in distances), "it keeps its distance"
    north, east = map(float, re.findall(r"-?\d+", last))
    assert abs(north) <= 3.0
    assert east == pytest.approx(40.0, abs=3.0)


def test_every_example_is_tested_here() -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    assert [name for name in PROGRAMS if f'run("{name}"' not in source] == []


@pytest.mark.parametrize("name", PROGRAMS)
def test_each_example_is_short_says_how_to_run_it_and_takes_a_url(name: str) -> None:
    source = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    tree = ast.parse(source)
    documentation = ast.get_docstring(tree)
    assert documentation is not None
    assert f"python examples/{name}.py" in documentation
    assert f"python examples/{name}.py /dev/ttyUSB0" in documentation
    assert len(source.splitlines()) <= 90
    assert "sys.argv" in source
    assert "asyncio.run(main(" in source or "without_await" in name


@each_firmware
def test_first_flight(run: Run, url: str) -> None:
    lines = run("first_flight", url).splitlines()
    assert lines[0].startswith("SDK-v1.0 BETA M100-0")
    assert lines[1:] == ["in the air", "landed"]


@each_firmware
def test_square_by_velocity(run: Run, url: str) -> None:
    out = run("square_by_velocity", url)
    corners = [tuple(map(float, re.findall(r"-?\d+\.\d+", line))) for line in out.splitlines()[:4]]
    assert len(corners) == 4
    # Two seconds at 1 m/s, with the lag of a second that the Matrice 100 has.
    assert corners[0][0] == pytest.approx(1.5, abs=0.5)
    assert corners[1][1] == pytest.approx(1.5, abs=0.5)
    assert corners[2][0] < corners[1][0] - 1
    [back] = re.findall(r"back within (\d+\.\d) m", out)
    assert float(back) <= 1.0


def test_replay_a_flight(run: Run) -> None:
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    ended, highest, refused = run("replay_a_flight", "sim://").splitlines()
    assert "has ended" in ended
    found = re.match(r"highest: ([\d.]+) m, [\d.]+ s after its beginning, of (\d+)", highest)
    assert found is not None
    assert 5.5 < float(found[1]) < 6.8
    assert int(found[2]) > 500
    assert "is a recording; nothing was sent" in refused


def test_record_a_flight(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    lines = run("record_a_flight", "sim://", str(tmp_path / "flight.mcap")).splitlines()
    assert "firmware 1.0" in lines[0]
    assert float(lines[1].split()[1]) > 1.8
    assert [line.split()[-1] for line in lines[2:]] == ["take_off", "land"]


def test_plot_a_flight(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `log` is not installed")
    out = run("plot_a_flight", "sim://", str(tmp_path / "flight.mcap"))
    told = dict(re.split(r"\s{2,}|: ", line, maxsplit=1) for line in out.splitlines())
    assert float(told["Farthest"].split()[0]) == pytest.approx(11.3, abs=0.6)
    assert float(told["Highest"].split()[0]) == pytest.approx(6.0, abs=0.3)
    assert "start_task" in (tmp_path / "flight.html").read_text("utf-8")


@each_firmware
def test_telemetry_to_csv(run: Run, url: str) -> None:
    rows = list(csv.DictReader(io.StringIO(run("telemetry_to_csv", url))))
    assert len(rows) == 50
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == pytest.approx([index / 10 for index in range(50)], abs=0.001)
    utc = [float(row["utc"]) for row in rows]
    assert utc[0] == pytest.approx(time.time(), abs=60.0)
    assert [at - utc[0] for at in utc] == pytest.approx(seconds, abs=0.002)
    assert {row["gps_health"] for row in rows} == {"5"}
    # Not yet received is empty, never 0.
    batteries = [row["battery_percent"] for row in rows]
    assert set(batteries) <= {"", "100"}
    assert batteries[-1] == "100"


def test_two_consumers(run: Run) -> None:
    out = run("two_consumers", "sim://")
    assert out.count("height") == 10
    [(count, lost)] = re.findall(r"(\d+) packages, (\d+) lost", out)
    assert int(count) >= 350  # in five seconds, of which the first shows the mode
    assert lost == "0"


def test_line_quality(run: Run) -> None:
    out = run("line_quality")
    assert "damaged, frame_crc: " in out
    assert "41 answers after " in out
    assert "questions were asked again" in out


def test_watch_telemetry(run: Run) -> None:
    out = run("watch_telemetry", "sim://")
    assert out.splitlines()[0] == "firmware 1.0"
    assert out.count("height") == 10
    assert "battery: Battery(percent=100)" in out


@each_firmware
def test_survey(run: Run, url: str) -> None:
    lines = run("survey", url).splitlines()
    assert re.fullmatch(r"4 lines, \d+ m", lines[0])
    to_go = [int(re.findall(r"(\d+) m to go", line)[0]) for line in lines[1:-2]]
    assert len(to_go) == 5
    assert to_go == sorted(to_go, reverse=True)
    assert lines[-2:] == ["back where it took off", "landed"]


def test_authority_loss(run: Run) -> None:
    assert run("authority_loss").splitlines() == [
        "flying north; now the pilot may move the switch out of F",
        "the pilot has it: mode_switch; waiting",
        "back in F: flying on, because this program wants to",
        "landed",
    ]


def test_authority_loss_without_any_loss(run: Run) -> None:
    assert run("authority_loss", "sim://").splitlines()[-1] == "landed"


def cells_of_the_notebook() -> list[str]:
    notebook = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["outputs"] for cell in cells] == [[]] * len(cells)  # kept without
    return ["".join(cell["source"]) for cell in cells]


def test_the_notebook_flies_cell_by_cell(
    capsys: pytest.CaptureFixture[str],
) -> None:
    names: dict[str, Any] = {}
    try:
        for index, cell in enumerate(cells_of_the_notebook()):
            exec(compile(cell, f"cell {index}", "exec"), names)
    finally:
        names["aircraft"].close()
    assert names["control"].is_over
    assert not names["aircraft"].is_connected
    assert capsys.readouterr().out.count("within 0.") == 3
    shown = eval(cells_of_the_notebook()[-1], names)  # what the last cell leaves
    assert "<svg" in shown._repr_html_()
    home = names["home"]
    track = [(*home.to_local(row[0], row[1]), row[2]) for row in shown.rows]
    assert len(track) >= 20
    assert max(north for north, _, _ in track) == pytest.approx(10.0, abs=1.0)
    assert max(east for _, east, _ in track) == pytest.approx(8.0, abs=1.0)
    assert track[-1] == pytest.approx((0.0, 0.0, 3.0), abs=0.6)
