"""``m100link echo``, ``hz`` and ``plot`` over a real pseudo-terminal. Real time."""

from __future__ import annotations

import csv
import io
import math
import signal
import subprocess
import sys
import time

import pytest

from m100link.apps.cli import telemetry
from m100link.apps.cli.telemetry import describe
from m100link.protocol.items import BY_NAME
from tests import known
from tests.apps.cli.conftest import NEARLY_100, CommandLine, Simulator, process
from tests.waiting import PATIENCE


@pytest.mark.pty
def test_echo_as_json_and_as_csv(simulator: Simulator) -> None:
    outcome = process("echo", simulator.port, "position", "battery", "--packages", "5")
    assert outcome.status == 0
    assert len(outcome.objects) == 5
    times = [line["received_at"] for line in outcome.objects]
    assert times == sorted(times)
    assert list(outcome.objects[0])[:2] == ["received_at", "utc"]
    utc = [line["utc"] for line in outcome.objects]
    assert utc[-1] == pytest.approx(time.time(), abs=60.0)
    assert [at - utc[0] for at in utc] == pytest.approx([at - times[0] for at in times], abs=1e-5)
    assert outcome.objects[0]["position.gps_health"] == 5
    table = process("echo", simulator.port, "position", "--csv", "--rate", "10", "--packages", "10")
    rows = list(csv.DictReader(io.StringIO(table.out)))
    assert len(rows) == 10
    seconds = float(rows[-1]["received_at"]) - float(rows[0]["received_at"])
    assert seconds > 0.75, "faster than asked for"
    assert float(rows[0]["utc"]) == pytest.approx(time.time(), abs=60.0)


@pytest.mark.pty
def test_hz_measures(simulator: Simulator) -> None:
    outcome = process("hz", simulator.port, "--duration", "2", "--json")
    assert outcome.status == 0
    [measured] = outcome.objects
    assert measured["items"]["quaternion"]["rate_hz"] == NEARLY_100
    assert measured["items"]["flight_status"]["rate_hz"] == pytest.approx(10, rel=0.3)
    assert measured["items"]["magnetometer"]["count"] == 0
    assert measured["items"]["magnetometer"]["rate_hz"] is None
    assert measured["device_clock"]["tick_hz"] == 600


@pytest.mark.pty
def test_plot_draws_what_comes(simulator: Simulator) -> None:
    live = process("plot", simulator.port, "position.height_m", "--duration", "1", "--table")
    assert live.status == 0
    assert any(0x2800 < ord(c) <= 0x28FF for c in live.out)


@pytest.mark.parametrize(
    "arguments",
    [
        ("echo", "sim://", "magnetometer"),
        ("echo", "sim://", "position", "magnetometer"),
        ("plot", "sim://", "magnetometer.x"),
    ],
    ids=" ".join,
)
def test_an_item_at_0_hz_is_named(cli: CommandLine, arguments: tuple[str, ...]) -> None:
    told = cli(*arguments, "--duration", "2.5").err
    assert "magnetometer is at 0 Hz: no package carries it" in told
    assert told.count("0 Hz") == 1


def test_what_is_plotted_live_has_its_time_and_its_value(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[dict[str, list[tuple[float, float]]]] = []
    monkeypatch.setattr(telemetry, "_draw", drawn.append)
    assert cli("plot", "sim://", "battery.percent", "--duration", "4").status == 0
    [[(_, points)]] = [list(one.items()) for one in drawn]
    assert {value for _, value in points} == {100.0}
    assert 1.5 < points[-1][0] - points[0][0] < 4.0


def test_echo_prints_its_table_as_csv(cli: CommandLine) -> None:
    table = cli("echo", "sim://?seed=1", "position", "--packages", "1", "--table")
    assert table.out.startswith("received_at,utc,position.latitude_rad,")


@pytest.mark.parametrize("record", known.EVERYTHING, ids=lambda one: type(one).__name__)
def test_each_record_has_its_words(record: object) -> None:
    kind = type(record).__name__
    told = describe(record)
    assert told, kind
    assert kind not in told, f"_WORDED of m100link/apps/cli/telemetry.py has no row for {kind}"


# -- ``m100link monitor`` over a real pseudo-terminal. Real time -----------------------------------


@pytest.mark.pty
def test_monitor_prints_one_object_per_second_and_ends_by_itself(simulator: Simulator) -> None:
    outcome = process("monitor", simulator.port, "--json", "--duration", "2.5")
    assert (outcome.status, outcome.err) == (0, "")
    lines = outcome.objects
    assert 1 <= len(lines) <= 2, "the machine may be late, not early"
    for line in lines:
        assert set(line) < set(BY_NAME)
        assert 0 <= line["quaternion"]["age_s"] < 1.0
        assert line["quaternion"]["rate_hz"] == NEARLY_100
        attitude = line["quaternion"]["value"]
        assert math.hypot(*attitude.values()) == pytest.approx(1.0, abs=1e-3)
        assert line["battery"]["value"] == {"percent": 100}
        assert "magnetometer" not in line, "an item that never came is absent, not zero"


@pytest.mark.pty
def test_monitor_ends_with_ctrl_c_and_with_the_plug(simulator: Simulator) -> None:
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "monitor", simulator.port, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert running.stdout is not None
    running.stdout.readline()
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=PATIENCE)
    assert running.returncode == 130
    assert err == "interrupted\n"
    second = subprocess.Popen(
        [sys.executable, "-m", "m100link", "monitor", simulator.port, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert second.stdout is not None
    second.stdout.readline()
    simulator.close()
    _, err = second.communicate(timeout=PATIENCE)
    assert second.returncode == 4
    assert "went away" in err
