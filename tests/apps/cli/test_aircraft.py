"""``m100link info`` and ``activate`` over a real pseudo-terminal. Real time."""

from __future__ import annotations

from pathlib import Path

import pytest

from m100link.sim.vehicle.activation import DEMO_APP_ID
from tests.apps.cli.conftest import NEARLY_100, Simulator, process

pytestmark = pytest.mark.pty


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
        [described] = process("info", running.port, "--json", "--duration", "0.3").objects
        assert described["firmware"] == "3.1"
        assert len(described["serial"]) == 10
        [forced] = process(
            *("info", running.port, "--json", "--duration", "0.3", "--firmware", "2.3")
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
    [described] = process("info", simulator.port, "--json", "--duration", "0.1").objects
    assert described["activated"] is True
