"""Each verb in a pipe: JSON of these fields, one object per line, and one text with ``--table``.

Fields of JSON are promised: they stand here by hand, first those of each object. A verb may get
more; one that goes, or another name, is a change of which CHANGELOG.md tells.
"""

from __future__ import annotations

import asyncio
import shlex
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

import m100link
from m100link.apps.cli import fleet_setup
from m100link.apps.cli.terminal import ExitCode
from m100link.sim import VirtualClockEventLoop
from tests.apps.cli.conftest import CommandLine
from tests.apps.cli.test_app import verbs
from tests.apps.cli.test_calls import Over, aircraft, fleet, notes, plan_file
from tests.apps.cli.test_fleet_plans import FILE as SHOW

__all__ = ["aircraft", "fleet", "notes", "plan_file"]

SITUATION = "done situation"
EVENTS = "event"
RESULT = "name outcome"
FILE = "file"
SETTING = "aircraft setting value source"

ON_THE_LINE = [
    ("info sim://", ("url version serial version_crc_matches activated firmware firmware_is_forced "
     "firmware_summary acceleration telemetry telemetry_mismatches latency line")),
    ("monitor sim:// --duration 1.5", ("time quaternion velocity angular_velocity "
     "position rc gimbal flight_status")),
    ("hz sim:// --duration 0.5", "items device_clock telemetry_mismatches"),
    ("echo sim:// position --packages 1", ("received_at utc position.latitude_rad "
     "position.longitude_rad position.altitude_m position.height_m position.gps_health")),
    ("plot sim:// --duration 0.5", "column values"),
    ("link sim:// --duration 0.3", "asked unanswered"),
    ("doctor sim://", "exit_status"),
    ("record sim:// --duration 0.2 -o NEW", "file bytes"),
]  # fmt: skip
IN_THE_AIR = [
    ("takeoff --yes", SITUATION),
    ("fly 1 0 0 --yes", SITUATION),
    ("home --yes", SITUATION),
    ("land", SITUATION),
    ("release", "done"),
    ("gimbal", "yaw_deg pitch_deg roll_deg limits"),
    ("camera photo", "sent confirmed"),
    ("activate", "activated app_id attempts version firmware"),
    ("mission fly PLAN --yes", EVENTS),
    ("mission pause", "paused"),
    ("mission resume --yes", "resumed"),
    ("mission stop", "stopped"),
]
OF_A_FLEET = [
    ("fleet takeoff a1", RESULT),
    ("fleet land a1", RESULT),
    ("fleet stop a1", RESULT),
    ("fleet goto a1 52.1 4.31 10", RESULT),
    ("fleet mission stop a1", RESULT),
    ("fleet mission progress a1", "name boot stage by digest points reached"),
    ("fleet log list a1", "name log size at is_written"),
    ("fleet log fetch a1", "name path size came is_written outcome"),
]
ALONE = [
    ("plan check PLAN", "ok problems remarks waypoints lowest_m highest_m farthest_m estimate"),
    ("plan show PLAN", "waypoints estimate remarks"),
    ("plan survey NEW 52.1,4.31 52.1,4.312 52.101,4.312 --height 30 --spacing 20", FILE),
    ("plan convert PLAN NEW", FILE),
    ("console --sim --show-config", SETTING),
    ("serve --sim --show-config", SETTING),
    ("mavlink sim:// --show-config", SETTING),
    ("ros2 sim:// --show-config", SETTING),
    ("replay LOG --show-config", SETTING),
    ("fleet agent sim:// --show-config", SETTING),
    ("fleet router", "listen"),
    ("fleet show check SHOW", "ok problems remarks duration_s closest tracks"),
    ("log info LOG", "phases control alarms maxima ended line lost_share"),
    ("log report LOG", "at_s kind who text flown"),
    ("log share LOG -o NEW", "removed file"),
    ("log plot LOG -o NEW.html", FILE),
    ("log events LOG", "utc at"),
    ("log compare LOG LOG", "values mean_apart_m apart commands alarms"),
    ("log csv LOG -o NEW", FILE),
    ("log parquet LOG -o NEW", "rows file"),
    ("log frames LOG", "utc at direction"),
    ("log wireshark LOG -o NEW", "packets file"),
    ("log ros2 LOG -o NEW", "messages file"),
    ("log recover LOG -o NEW", "messages file"),
    ("log layout -o NEW", FILE),
    ("decode aa230000000000000400757f0103480000803f000000000000003f0000204163c2ab89",
     "frames discarded_bytes discards"),
    ("sim ctl", "action arguments does"),
    ("config", "path exists default aircraft in_force"),
    ("docs", "topic title part"),
    ("docs --find propellers", "topic line heading"),
    ("docs M100-BAD-URL", "code class says usual_cause what_to_do"),
]  # fmt: skip
TEXTS = [
    ("docs safety", "text"),
    ("plan convert PLAN -", "waypoints"),
    ("log layout", "configById"),
    ("log csv LOG", "received_at utc"),
    ("mission download", "waypoints"),
    ("fleet show preview SHOW -", "text"),
]
"""What they print is itself the result, in a pipe, too: a script, a page, a file."""


@pytest.fixture(scope="module")
def flight_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "flight.mcap"

    async def watch() -> None:
        async with m100link.connect("sim://", record=path):
            await asyncio.sleep(1.0)

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(watch())
    return path


@pytest.fixture
def run(
    cli: CommandLine,
    plan_file: str,
    flight_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Any:
    """A command line whose words are files."""
    number = iter(range(99))

    @asynccontextmanager
    async def open_fleet(*_: object, **__: object) -> AsyncIterator[None]:
        yield

    monkeypatch.setattr(fleet_setup, "open_fleet", open_fleet)
    monkeypatch.setattr(fleet_setup, "ended_by_signal", Over)

    def command(words: str, *more: str) -> Any:
        names = {"PLAN": plan_file, "LOG": str(flight_log), "SHOW": SHOW}
        names["NEW"] = str(tmp_path / f"new{next(number)}")
        for word, name in names.items():
            words = words.replace(word, name)
        return cli(*shlex.split(words), *more)

    return command


def judged(run: Any, words: str, fields: str) -> None:
    """Objects with these fields in a pipe; with --table, text, and the same status."""
    printed = run(words)
    assert printed.status == ExitCode.OK, (words, printed)
    first = printed.objects[0]
    assert not [name for name in fields.split() if name not in first], (words, sorted(first))
    as_text = run(words, "--table")
    assert as_text.status == ExitCode.OK, (words, as_text)
    assert not as_text.out.startswith("{"), words
    assert "\x1b" not in printed.out + printed.err + as_text.out + as_text.err


@pytest.mark.parametrize(("words", "fields"), ON_THE_LINE)
def test_on_the_line(run: Any, words: str, fields: str) -> None:
    judged(run, words, fields)


@pytest.mark.usefixtures("aircraft")
@pytest.mark.parametrize(("words", "fields"), IN_THE_AIR)
def test_in_the_air(run: Any, words: str, fields: str) -> None:
    judged(run, words, fields)


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(("words", "fields"), OF_A_FLEET)
def test_of_a_fleet(run: Any, words: str, fields: str) -> None:
    judged(run, words, fields)


@pytest.mark.parametrize(("words", "fields"), ALONE)
def test_alone(run: Any, words: str, fields: str) -> None:
    judged(run, words, fields)


@pytest.mark.usefixtures("aircraft")
@pytest.mark.parametrize(("words", "fields"), TEXTS)
def test_a_text_is_printed_as_it_is_and_with_json_as_an_object(
    run: Any, words: str, fields: str
) -> None:
    plain, told = run(words), run(words, "--json")
    assert (plain.status, told.status) == (ExitCode.OK, ExitCode.OK), (plain, told)
    assert plain.out == run(words, "--table").out
    assert not [name for name in fields.split() if name not in told.objects[0]], told.objects[0]


def test_each_verb_prints_as_it_is_asked_to() -> None:
    """By one mechanism: the options are no argument of its own."""
    without = []
    for verb, found in verbs():
        names = {name for one in found.assemble_argument_collection() for name in one.names}
        without += [] if "--json" in names else [verb]
    assert not without


@pytest.mark.parametrize("words", ["position sim://", "sim:// position", "sim:// POS"])
def test_the_aircraft_stands_before_or_behind_the_items(cli: CommandLine, words: str) -> None:
    told = cli("echo", *words.split(), "--packages", "1")
    assert told.status == ExitCode.OK
    assert "position.height_m" in told.objects[0]


def test_no_line_of_an_error_is_broken_in_a_pipe(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A path in it can be copied; the width of a terminal nobody sees is 80."""
    monkeypatch.delenv("COLUMNS")
    place = tmp_path / ("folder " * 20).strip() / "plan.json"
    outcome = cli("plan", "show", str(place))
    assert str(place) in outcome.err
