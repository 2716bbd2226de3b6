"""``m100link monitor`` over a real pseudo-terminal. Real time."""

from __future__ import annotations

import math
import signal
import subprocess
import sys

import pytest

from m100link.protocol.items import BY_NAME
from tests.apps.cli.conftest import NEARLY_100, Simulator, process
from tests.waiting import PATIENCE

pytestmark = pytest.mark.pty


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
