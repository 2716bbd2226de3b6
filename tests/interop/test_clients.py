"""Clients that others wrote: roslibpy, and roslib of npm in two generations."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.tutorials import Reader
from tests.waiting import PATIENCE

pytest.importorskip("starlette", reason="the extra `station` is not installed")
pytest.importorskip("roslibpy", reason="roslibpy is not installed: nox -s interop")

HERE = Path(__file__).parent

NAMES_OF_2015 = {
    *("/sdk_request_cmd", "/nav_open_close_request", "/sdk_request_ctrl", "/sdk_request_ctrl_mode"),
    *("/sdk_request_simple_task", "/sdk_request_activation", "/battery_status", "/flight_status"),
    *("/nav_open_close_status", "/activation_status", "/test_fre"),
}


@contextlib.contextmanager
def station() -> Iterator[str]:
    """The command, as a user starts it; yields the address of rosbridge."""
    command = [sys.executable, "-c", "from m100link.apps.cli import main; main()"]
    process = subprocess.Popen(
        [*command, "serve", "--sim", "--port", "0", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        line = process.stdout.readline()
        try:
            assert line
            yield json.loads(line)["rosbridge"][0]
        finally:
            process.terminate()
            _, talk = process.communicate(timeout=PATIENCE)
            print(talk)  # noqa: T201 - shown when a test fails
    assert process.returncode == 0


def run(*command: str, cwd: Path | None = None) -> Any:
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=2 * PATIENCE, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return json.loads(done.stdout.strip().splitlines()[-1])


def is_north(quaternion: dict[str, float]) -> bool:
    """Facing north in ENU: a quarter turn about the vertical."""
    half = math.sqrt(0.5)
    turn = abs(quaternion["z"]) - half, abs(quaternion["w"]) - half
    return max(abs(value) for value in turn) < 0.05


@pytest.mark.timeout(1800)
def test_the_tutorial_flies_by_roslibpy(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as one:
        port = str(one.getsockname()[1])
    Reader(tmp_path, {"serve --sim": f"serve --sim --port {port}", "9090": port}).follow("roslibpy")


@pytest.mark.smoke
def test_roslibpy() -> None:
    with station() as url:
        port = url.rpartition(":")[2]
        script = str(HERE / "roslibpy_client.py")
        seen = run(sys.executable, script, "127.0.0.1", port)
    assert set(seen["topics"]) >= NAMES_OF_2015
    assert seen["type"] == "sensor_msgs/Imu"
    assert "/dji_sdk/drone_task_control" in seen["services"]
    assert 0 < seen["attitude_rate"] <= 12  # at most 10 were asked for; a busy machine sends less
    assert is_north(seen["attitude"]["quaternion"])
    assert seen["activation"]["result"] is True
    assert seen["authority"] == {"result": True, "cmd_set": 1, "cmd_id": 0, "ack_data": 2}
    assert "/nothing" in seen["wrong_service"]
    assert {status["level"] for status in seen["statuses"]} == {"error"}
    assert seen["phases"][-1] == 3.0


@pytest.mark.parametrize("version", ["1.4.1", "2.1.0"])
def test_roslib(npm: Callable[..., Path], version: str) -> None:
    place = npm(f"roslib@{version}")
    shutil.copy(HERE / "roslib_client.mjs", place)
    # 1.x does not put fragments together.
    with_fragments = ["fragments"] if version.startswith("2") else []
    with station() as url:
        seen = run("node", "roslib_client.mjs", url, *with_fragments, cwd=place)
    assert set(seen["topics"]["topics"]) >= NAMES_OF_2015
    assert seen["type"] == "sensor_msgs/Imu"
    assert "/dji_sdk/activation" in seen["services"]
    assert 4 <= seen["imu_rate"] <= 12  # at most 10 were asked for; a busy machine sends less
    # The lower throttle of both, 20 a second, and not the 2 of the other.
    assert 8 <= seen["merged_rate"] <= 22
    assert abs(seen["imu"]["linear_acceleration"]["z"] - 9.8) < 1
    assert is_north(seen["attitude_png"]["quaternion"])
    assert seen["rc_cbor"]["axes"][4] == 8000
    if with_fragments:
        assert abs(seen["fragmented"]["latitude"] - 22.5431) < 0.01
    assert seen["wrong_service"]["ok"] is False
    assert "/nothing" in seen["wrong_service"]["error"]
    assert seen["activation"]["values"]["result"] is True
    assert seen["authority"]["values"]["result"] is True
    assert seen["phases"][-1] == 3
    assert seen["north"] > 1.0
    told = " ".join(status["msg"] for status in seen["statuses"])
    assert "/flight_status is of type std_msgs/Float32" in told
    assert "there is no topic '/nothing'" in told
