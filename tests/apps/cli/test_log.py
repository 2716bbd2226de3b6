"""``m100link record`` and ``m100link log`` as people type them."""

from __future__ import annotations

import csv
import errno
import json
import math
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from m100link import Aircraft
from m100link.apps.cli.log import new_file
from m100link.apps.cli.terminal import ExitCode
from m100link.errors import LinkError, LinkLost, UsageError
from m100link.log import read, recorder
from m100link.log.channels import COMMAND, EVENT
from m100link.sim.vehicle.activation import DEMO_KEY
from tests.apps.cli.conftest import ROOT, CommandLine
from tests.log.test_share import written
from tests.waiting import PATIENCE

pytest.importorskip("mcap", reason="the extra `log` is not installed")


@pytest.fixture
def flight(cli: CommandLine, tmp_path: Path) -> Path:
    """Half a second of a virtual aircraft."""
    path = tmp_path / "flight.mcap"
    outcome = cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    assert outcome.status == ExitCode.OK
    [told] = outcome.objects
    assert told == {"file": str(path), "bytes": path.stat().st_size}
    assert f"into {path}" in "".join(outcome.err.split("\n"))
    return path


def test_a_log_is_recorded_and_reported(cli: CommandLine, flight: Path) -> None:
    outcome = cli("log", "info", str(flight), "--json")
    [told] = outcome.objects
    assert told["is_whole"] is True
    assert told["firmware"] == "1.0"
    assert told["messages"]["/m100/raw/rx"] > 2
    assert [one["name"] for one in told["phases"]] == ["ground"]
    assert [one["name"] for one in told["control"]] == ["pilot"]
    assert told["alarms"] == []
    assert told["maxima"]["height_m"] == 0.0
    assert "closed" in told["ended"]
    told = [json.loads(one) for one in cli("log", "report", str(flight), "--json").out.splitlines()]
    [phase] = [one["text"] for one in told if one["kind"] == "flight"]
    assert phase.endswith("in phase ground.")
    assert "  The connection ended: " in cli("log", "report", str(flight), "--table").out
    assert (
        "[+0.0 m north, +0.0 m east, 0.0 m high, "
        in cli("log", "report", str(flight), "--table").out
    )
    for verb in ("info", "report"):
        said = cli("log", verb, str(flight), "--table").out
        assert "line: 0.0 % of frames lost; 0 frames damaged" in said
    text = cli("log", "info", str(flight), "--table").out
    assert "firmware 1.0" in text
    assert "  Longest silence  " in text
    assert "recover" not in text


def test_its_telemetry_is_a_table(cli: CommandLine, flight: Path, tmp_path: Path) -> None:
    out = cli("log", "csv", str(flight), "position").out
    rows = list(csv.DictReader(out.splitlines()))
    assert len(rows) > 20
    assert float(rows[0]["position.latitude_deg"]) == pytest.approx(22.5431, abs=1e-6)
    whole = csv.DictReader(cli("log", "csv", str(flight)).out.splitlines())
    shown = [float(one) for row in whole for one in row.values() if one]
    values = [one for row in read(flight).table().rows for one in row if not math.isnan(one)]
    assert shown == pytest.approx(values, abs=1e-9, rel=0.0)
    assert any(abs(one - round(one, 7)) > 1e-8 for one in values), "so many digits"
    table = tmp_path / "table.csv"
    assert cli("log", "csv", str(flight), "position", "-o", str(table)).status == ExitCode.OK
    assert table.read_text(encoding="utf-8") == out
    again = cli("log", "csv", str(flight), "-o", str(table))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err


def test_what_happened_is_a_line_each(cli: CommandLine, flight: Path) -> None:
    told = cli("log", "events", str(flight)).objects
    assert [one["command"] for one in told if "command" in one][:2] == ["get_version"] * 2
    assert told[-1]["event"] == "connection"
    when = [round(one.at, 6) for one in read(flight).messages(COMMAND, EVENT)]
    assert [one["at"] for one in told] == when, "microseconds"


def test_what_was_cut_off_is_reported_and_mended(cli: CommandLine, flight: Path) -> None:
    cut = flight.with_name("cut.mcap")
    cut.write_bytes(flight.read_bytes()[:-400])
    assert "log recover" in "".join(cli("log", "info", str(cut), "--table").out.split("\n"))
    assert cli("log", "recover", str(cut)).status == ExitCode.OK
    [told] = cli("log", "info", str(flight.with_name("cut-recovered.mcap")), "--json").objects
    assert told["is_whole"] is True
    again = cli("log", "recover", str(cut))
    assert again.status == ExitCode.USAGE


def test_a_cable_that_is_pulled_ends_the_recording_and_is_reported(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def wait_closed(_: Aircraft) -> LinkError:
        return LinkLost("the cable is gone")

    monkeypatch.setattr(Aircraft, "wait_closed", wait_closed)
    path = tmp_path / "flight.mcap"
    outcome = cli("record", "sim://", "-o", str(path))
    assert outcome.status == ExitCode.NO_LINK
    assert "the cable is gone" in outcome.err
    assert read(path).summary().is_whole


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_every_end_of_the_recording_leaves_a_whole_file(tmp_path: Path, number: int) -> None:
    path = tmp_path / "flight.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "m100link", "record", "sim://", "-o", str(path)],
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stderr is not None
    with process:
        assert "recording sim://" in process.stderr.readline()
        process.send_signal(number)
        status = process.wait(PATIENCE)
    assert status == (ExitCode.INTERRUPTED if number == signal.SIGINT else ExitCode.OK)
    assert read(path).summary().is_whole


def test_typing_errors_are_reported(cli: CommandLine, flight: Path, tmp_path: Path) -> None:
    for words, why in (
        (("log", "info", str(tmp_path / "none.mcap")), "No such file"),
        (("log", "csv", str(flight), "positon"), "position"),
        (("record", "sim://", "-o", str(flight)), "is there already"),
        (("record", "sim://", "-o", str(tmp_path), "--rate", "-1"), "rate"),
    ):
        outcome = cli(*words)
        assert outcome.status == ExitCode.USAGE, words
        assert why in " ".join(outcome.err.split()), words


def test_each_verb_says_what_a_damaged_log_lacks_and_ends_with_1(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "FLUSH_S", 0.0)  # of the wall clock: a part for each batch
    flight, bad = tmp_path / "flight.mcap", tmp_path / "bad.mcap"
    assert cli("record", "sim://", "-o", str(flight), "--duration", "1.6").status == ExitCode.OK
    data = bytearray(flight.read_bytes())
    parts = [at for at in range(len(data)) if data[at] == 6 and data[at + 41 : at + 45] == b"zstd"]
    assert len(parts) > 1
    data[parts[-1] + 80] ^= 1
    bad.write_bytes(data)
    lost = read(bad).damage.missing_messages
    assert lost > 0
    verbs = "info csv parquet events frames plot recover wireshark ros2"
    for name, *options in (["info", "--json"], *([verb] for verb in verbs.split())):
        shown = cli("log", name, str(bad), *options)
        assert shown.status == ExitCode.FAILED, name
        assert f"{lost} messages are missing" in " ".join((shown.out + shown.err).split()), name
        assert "killed" not in shown.out + shown.err
        whole = cli("log", name, str(flight), *options)
        assert whole.status == ExitCode.OK
        assert "missing" not in whole.err
    shown = cli("log", "compare", str(flight), str(bad))
    assert shown.status == ExitCode.FAILED
    assert f"{lost} messages are missing" in " ".join(shown.err.split())


# -- ``m100link log ros2`` and ``layout`` as people type them --------------------------------------


def test_a_log_becomes_a_bag_beside_it(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    before = path.read_bytes()
    outcome = cli("log", "ros2", str(path))
    assert outcome.status == ExitCode.OK
    assert (tmp_path / "flight-ros2.mcap").read_bytes()[8:100].find(b"ros2") > 0
    assert path.read_bytes() == before
    again = cli("log", "ros2", str(path))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err
    itself = cli("log", "ros2", str(path), "-o", str(path))
    assert itself.status == ExitCode.USAGE
    assert path.read_bytes() == before


def test_a_layout_is_json_in_a_pipe_or_a_file(cli: CommandLine, tmp_path: Path) -> None:
    target = tmp_path / "layout.json"
    assert cli("log", "layout", "-o", str(target)).status == ExitCode.OK
    assert json.loads(cli("log", "layout").out) == json.loads(target.read_text("utf-8"))
    assert cli("log", "layout", "-o", str(target)).status == ExitCode.USAGE


# -- ``m100link log frames`` and ``compare`` as people type them -----------------------------------


def test_frames_are_json_in_a_pipe_and_lines_for_people(cli: CommandLine, flight: Path) -> None:
    frames = cli("log", "frames", str(flight)).objects
    assert [one["command"] for one in frames][:2] == ["get_version", "get_version"]
    assert frames[1]["version"].startswith("SDK-v1.0")
    lines = cli("log", "frames", str(flight), "--table").out.splitlines()
    assert len(lines) == len(frames)
    assert " rx " in lines[1]
    assert "ack" in lines[1]


def test_the_head_of_many_frames_ends_without_a_word(flight: Path) -> None:
    command = f"{sys.executable} -m m100link log frames {flight} | head -n 2"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert len(done.stdout.splitlines()) == 2
    assert all(json.loads(line) for line in done.stdout.splitlines())
    assert done.stderr == ""


def test_a_key_that_others_can_read_is_not_used(
    cli: CommandLine, flight: Path, tmp_path: Path
) -> None:
    key = tmp_path / "key"
    key.write_bytes(DEMO_KEY.reveal())
    key.chmod(0o644)
    outcome = cli("log", "frames", str(flight), "--key-file", str(key))
    assert outcome.status == ExitCode.USAGE
    assert "can be read by others" in " ".join(outcome.err.split())
    key.chmod(0o600)
    assert cli("log", "frames", str(flight), "--key-file", str(key)).status == ExitCode.OK


def test_a_flight_does_not_differ_from_itself(cli: CommandLine, flight: Path) -> None:
    [found] = cli("log", "compare", str(flight), str(flight), "--json").objects
    assert {one["by"] for one in found["values"]} <= {0, None}
    assert found["commands"] == found["alarms"] == []
    text = cli("log", "compare", str(flight), str(flight), "--table").out
    assert "commands: the same" in text


# -- ``m100link log plot`` as people type it -------------------------------------------------------


def test_a_page_is_made_beside_the_log(cli: CommandLine, flight: Path) -> None:
    outcome = cli("log", "plot", str(flight))
    assert outcome.status == ExitCode.OK
    assert outcome.err == ""
    assert "flight.mcap</h1>" in flight.with_suffix(".html").read_text("utf-8")


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_half_of_a_file_is_not_left_behind(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "half"
    with pytest.raises((UsageError, KeyboardInterrupt)):
        break_off(target, error)
    assert not target.exists()


def break_off(target: Path, error: BaseException) -> None:
    with new_file(target) as stream:
        stream.write(b"half")
        raise error


def test_what_cannot_be_is_reported_and_nothing_is_written(
    cli: CommandLine, flight: Path, tmp_path: Path
) -> None:
    there = tmp_path / "there.html"
    there.write_text("mine", encoding="utf-8")
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"no log")
    for words, why in (
        ((str(flight), "-o", str(tmp_path / "x.svg")), "neither a page nor a picture"),
        ((str(flight), "-o", str(there)), "is there already"),
        ((str(flight), "-o", str(tmp_path / "no/where.html")), "cannot be written"),
        ((str(junk),), "is not a flight log"),
        ((str(tmp_path / "none.mcap"),), "No such file"),
    ):
        outcome = cli("log", "plot", *words)
        assert outcome.status == ExitCode.USAGE, words
        assert why in " ".join(outcome.err.split()), words
    assert there.read_text("utf-8") == "mine"
    assert sorted(path.name for path in tmp_path.glob("*.html")) == ["there.html"]


# -- ``m100link log csv`` and ``parquet`` as people type them, and the recipes of the manual -------


MANUAL = Path(__file__).parents[3] / "docs/howto/flight-logs.md"


def test_parquet_holds_what_csv_holds(cli: CommandLine, flight: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra `analysis` is not there")
    outcome = cli("log", "parquet", str(flight), "position")
    assert outcome.status == ExitCode.OK
    table = parquet.read_table(flight.with_suffix(".parquet"))
    rows = list(csv.DictReader(cli("log", "csv", str(flight), "position").out.splitlines()))
    assert table.column_names == list(rows[0])
    assert table.num_rows == len(rows)
    [told] = outcome.objects
    assert told == {"rows": len(rows), "file": str(flight.with_suffix(".parquet"))}


def test_a_file_that_is_there_stays(cli: CommandLine, flight: Path) -> None:
    there = flight.with_suffix(".parquet")
    there.write_bytes(b"mine")
    outcome = cli("log", "parquet", str(flight))
    assert outcome.status == ExitCode.USAGE
    assert "is there already" in outcome.err
    assert there.read_bytes() == b"mine"


def test_half_of_a_table_is_not_left_behind(cli: CommandLine, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra `analysis` is not installed")
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"\x89MCAP0\r\n")  # no firmware is known
    for verb in ("parquet", "csv"):
        target = tmp_path / f"table.{verb}"
        outcome = cli("log", verb, str(junk), "-o", str(target))
        assert outcome.status == ExitCode.USAGE
        assert "firmware" in outcome.err
        assert not target.exists()


@pytest.mark.parametrize("library", ["pandas", "polars", "numpy"])
def test_the_recipes_of_the_manual_run(
    library: str, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(library, reason="only the recipe needs it")
    blocks = re.findall(r"```python\n(.*?)```", MANUAL.read_text("utf-8"), re.DOTALL)
    recipes = [block for block in blocks if f"import {library}\n" in block]
    assert recipes
    monkeypatch.chdir(flight.parent)
    for recipe in recipes:
        exec(compile(recipe, str(MANUAL), "exec"), {})


# -- ``m100link log wireshark`` as people type it --------------------------------------------------


def test_a_log_becomes_packets(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    cli("record", "sim://", "-o", str(path), "--duration", "0.5")
    outcome = cli("log", "wireshark", str(path))
    assert outcome.status == ExitCode.OK
    assert path.with_suffix(".pcapng").read_bytes().startswith(b"\x0a\x0d\x0d\x0a")
    again = cli("log", "wireshark", str(path))
    assert again.status == ExitCode.USAGE
    assert "is there already" in again.err


def test_the_plugin_goes_where_wireshark_looks_for_it(
    cli: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for _ in range(2):  # a newer one replaces it
        assert cli("log", "wireshark", "--install").status == ExitCode.OK
    installed = tmp_path / ".local/lib/wireshark/plugins/m100.lua"
    plugin = tmp_path / "elsewhere.lua"
    assert cli("log", "wireshark", "--plugin", str(plugin)).status == ExitCode.OK
    assert plugin.read_text("utf-8") == installed.read_text("utf-8")
    assert "waypoint_point" in plugin.read_text("utf-8")
    monkeypatch.setenv("HOME", str(plugin))  # a file, where no folder can be made
    refused = cli("log", "wireshark", "--install")
    assert refused.status != ExitCode.OK
    assert "cannot be written" in refused.err.replace("\n", " ")


def test_nothing_at_all_is_asked_about(cli: CommandLine) -> None:
    outcome = cli("log", "wireshark")
    assert outcome.status == ExitCode.USAGE
    assert "--install" in outcome.err


@pytest.mark.parametrize("verb", ["info", "report", "compare", "recover", "share"])
def test_no_text_of_a_file_steers_a_terminal(cli: CommandLine, tmp_path: Path, verb: str) -> None:
    """Its topics, reasons and errors: strangers write files, too."""
    bad = "\x1b]0;x\x07\x1b[2J\n\u202e"
    path = str(tmp_path / "a.mcap")
    written(
        Path(path),
        ("/m100/link", {"firmware": "1.0", "discards": {bad: 3}}),
        ("/m100/event", {"event": "authority", "before": "held", "after": bad, "reason": bad}),
        ("/m100/event", {"event": "connection", "is_connected": False, "error": bad}),
        ("/m100/command", {"command": bad, "is_ack": False, "direction": "tx", "session": 2,
                           "sequence": 1, "task": bad}),
        (bad, {}),
    )  # fmt: skip
    outcome = cli("log", verb, *([path] * (1 + (verb == "compare"))))
    assert outcome.out
    for text in (outcome.out, outcome.err):
        assert not [one for one in text if not one.isprintable() and one != "\n"]
