"""The commands over a real pseudo-terminal, with ``m100link sim`` at its other end. Real time."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from m100link.protocol.items import BY_NAME
from m100link.sim.vehicle.mobile import DEMO_APP_ID
from tests.cli.conftest import ROOT, Simulator, process
from tests.waiting import PATIENCE

# Several programs in a row fly in real time: more than the usual time-out on a busy machine.
pytestmark = [pytest.mark.pty, pytest.mark.timeout(180)]

# Measured over a second or two of real time, in which a busy machine may do something else.
NEARLY_100 = pytest.approx(100, rel=0.3)


# -- demo -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_demo_flies_and_comes_back_within_a_metre(firmware: str) -> None:
    outcome = process("demo", "--speed", "20", "--json", "--firmware", firmware)
    # At this speed a busy machine may be late with a setpoint and say so; it flies all the same.
    assert outcome.status == 0, outcome.err
    [summary] = outcome.objects
    assert summary["flown"] is True
    assert summary["error"] is None
    assert summary["returned_within_m"] <= 1.0
    assert summary["firmware"] == firmware
    assert summary["speed"] == 20.0
    assert summary["port"].startswith("/dev/pts/")
    assert list(summary["stages"]) == [
        *("connect", "activate", "obtain control", "take off", "square", "land", "release")
    ]
    # A square with sides of 8 m, up to 3 m high.
    assert 30 <= summary["path_length_m"] <= 40
    assert 2.5 <= summary["max_height_m"] <= 3.5
    norths = [north for north, _ in summary["track"]]
    easts = [east for _, east in summary["track"]]
    assert max(norths) == pytest.approx(8.0, abs=0.8)
    assert max(easts) == pytest.approx(8.0, abs=0.8)
    assert min(norths + easts) > -0.8
    assert summary["line"]["discarded_bytes"] == 0
    assert summary["setpoints_sent"] > 500


def test_demo_shows_a_summary_and_pictures_to_people() -> None:
    outcome = process("demo", "--speed", "20", "--side", "4")
    assert outcome.status == 0
    assert "mission flown" in outcome.out
    assert "back within" in outcome.out
    assert any(0x2800 < ord(c) <= 0x28FF for c in outcome.out), "no picture of the track"
    assert "north up" in outcome.out


def test_demo_that_is_interrupted_ends_with_130() -> None:
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "demo", "--speed", "4"],
        stdout=slave,
        stderr=subprocess.PIPE,
        env=os.environ | {"COLUMNS": "100", "LINES": "40", "TERM": "xterm"},
        cwd=ROOT,
    )
    os.close(slave)
    shown = b""
    while "✓  take off".encode() not in _plain(shown):
        shown += os.read(master, 65_536)
    running.send_signal(signal.SIGINT)
    with contextlib.suppress(OSError):  # what a terminal says when its program has ended
        while os.read(master, 65_536):
            pass
    os.close(master)
    assert running.wait(timeout=PATIENCE) == 130
    assert running.stderr is not None
    err = running.stderr.read().decode()
    running.stderr.close()
    assert "interrupted" in err
    assert "Traceback" not in err


def _plain(shown: bytes) -> bytes:
    """Output of a terminal without its escape sequences."""
    return re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", shown)


def test_demo_on_a_terminal_shows_live_progress() -> None:
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "demo", "--speed", "10", "--side", "4"],
        stdout=slave,
        stderr=slave,
        stdin=slave,
        env=os.environ | {"COLUMNS": "100", "LINES": "40", "TERM": "xterm"},
        cwd=ROOT,
    )
    os.close(slave)
    shown = b""
    while True:
        try:
            piece = os.read(master, 65_536)
        except OSError:
            break  # the other end is closed
        if not piece:
            break
        shown += piece
    os.close(master)
    assert running.wait(timeout=PATIENCE) == 0
    text = shown.decode(errors="replace")
    assert text.count("square") > 5, "it was drawn once, not live"
    assert "✓" in text
    assert "mission flown" in text


# -- info, activate, monitor ----------------------------------------------------------------------


def test_info_tells_what_is_there(simulator: Simulator) -> None:
    outcome = process("info", simulator.port, "--json")
    assert (outcome.status, outcome.err) == (0, "")
    [described] = outcome.objects
    assert described["firmware"] == "1.0"
    assert described["firmware_is_forced"] is False
    assert described["activated"] is False
    assert described["version"].startswith("SDK-v1.0")
    assert described["telemetry"]["quaternion"] == NEARLY_100
    assert described["telemetry"]["rc"] == pytest.approx(50, rel=0.3)
    assert "magnetometer" not in described["telemetry"]
    assert described["telemetry_mismatches"] == 0
    assert described["line"]["discarded_bytes"] <= 200  # a port opened in the middle of a frame


def test_info_of_later_firmware_and_with_a_forced_profile(tmp_path: Path) -> None:
    running = Simulator(tmp_path, "--firmware", "3.1")
    try:
        [described] = process("info", running.port, "--json", "--seconds", "0.3").objects
        assert described["firmware"] == "3.1"
        assert len(described["serial"]) == 10
        [forced] = process(
            *("info", running.port, "--json", "--seconds", "0.3", "--firmware", "2.3")
        ).objects
        assert forced["firmware"] == "2.3"
        assert forced["firmware_is_forced"] is True
        assert forced["telemetry_mismatches"] > 10
    finally:
        running.close()


def test_activate_waits_for_the_server_and_a_second_time_is_success(
    simulator: Simulator, app: list[str]
) -> None:
    first = process("activate", simulator.port, *app)
    assert first.status == 0
    [told] = first.objects
    assert told["activated"] is True
    assert told["app_id"] == DEMO_APP_ID
    assert told["attempts"] == 2
    assert "attempt 1: first activation" in first.err
    assert "again in 2 s" in first.err
    second = process("activate", simulator.port, *app)
    assert second.objects[0]["attempts"] == 1
    [described] = process("info", simulator.port, "--json", "--seconds", "0.1").objects
    assert described["activated"] is True


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


def test_echo_as_json_and_as_csv(simulator: Simulator) -> None:
    outcome = process("echo", simulator.port, "position", "battery", "--count", "5")
    assert outcome.status == 0
    assert len(outcome.objects) == 5
    times = [line["received_at"] for line in outcome.objects]
    assert times == sorted(times)
    assert outcome.objects[0]["position.gps_health"] == 5
    table = process("echo", simulator.port, "position", "--csv", "--rate", "10", "--count", "10")
    rows = list(csv.DictReader(io.StringIO(table.out)))
    assert len(rows) == 10
    seconds = float(rows[-1]["received_at"]) - float(rows[0]["received_at"])
    assert seconds > 0.75, "faster than asked for"


def test_hz_measures(simulator: Simulator) -> None:
    outcome = process("hz", simulator.port, "--duration", "2", "--json")
    assert outcome.status == 0
    [measured] = outcome.objects
    assert measured["items"]["quaternion"]["rate_hz"] == NEARLY_100
    assert measured["items"]["flight_status"]["rate_hz"] == pytest.approx(10, rel=0.3)
    assert measured["items"]["magnetometer"]["count"] == 0
    assert measured["items"]["magnetometer"]["rate_hz"] is None
    assert measured["device_clock"]["tick_hz"] == 600


def test_plot_of_a_recorded_span_and_live(simulator: Simulator, tmp_path: Path) -> None:
    recorded = process("echo", simulator.port, "position", "--csv", "--count", "50")
    path = tmp_path / "span.csv"
    path.write_text(recorded.out)
    drawn = process("plot", str(path), "position.height_m")
    assert drawn.status == 0
    assert "position.height_m" in drawn.out
    live = process("plot", simulator.port, "position.height_m", "--duration", "1")
    assert live.status == 0
    assert any(0x2800 < ord(c) <= 0x28FF for c in live.out)


# -- flying ---------------------------------------------------------------------------------------


def test_take_off_fly_and_land_from_the_shell(simulator: Simulator, app: list[str]) -> None:
    """Three programs in a row on one aircraft: each obtains control and gives it back."""
    for arguments, what in (
        (("takeoff",), "take off"),
        (("fly", "3", "0", "2"), "fly 3 m north"),
        (("land",), "land"),
    ):
        command, *numbers = arguments
        outcome = process(command, simulator.port, *numbers, "--yes", *app)
        assert outcome.status == 0, outcome
        assert f"done: {what}" in outcome.out
    [line] = process("monitor", simulator.port, "--json", "--duration", "1.2").objects
    assert line["position"]["value"]["height_m"] == pytest.approx(0.0, abs=0.3)
    assert line["flight_status"]["value"] == {"status": 1}


def test_flying_wants_to_be_confirmed(simulator: Simulator, app: list[str]) -> None:
    outcome = process("takeoff", simulator.port, *app)
    assert outcome.status == 2
    assert "was not confirmed" in outcome.err
    assert "--yes" in outcome.err


def test_a_refused_landing_says_why(simulator: Simulator, app: list[str]) -> None:
    outcome = process("land", simulator.port, "--yes", *app)
    assert outcome.status == 7
    assert "land was refused" in outcome.err
    assert "STANDBY" in outcome.err


def test_release_is_always_possible(simulator: Simulator, app: list[str]) -> None:
    outcome = process("release", simulator.port, *app)
    assert outcome.status == 0
    assert outcome.out == "released\n"


def test_a_url_of_the_simulator_needs_no_credentials() -> None:
    outcome = process("takeoff", "sim://")
    assert outcome.status == 0
    assert "done: take off" in outcome.out
