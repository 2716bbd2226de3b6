"""Foxglove's own programs, where npm has them: its reader of logs, its client of live flights."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from m100link.log import read
from tests.waiting import PATIENCE

SCRIPTS = Path(__file__).parent / "foxglove"
PACKAGES = ("ws", "@mcap/core", "@mcap/nodejs", "@foxglove/ws-protocol", "@foxglove/wasm-zstd")
RUN = (sys.executable, "-m", "m100link")


@pytest.fixture
def place(npm: Callable[..., Path]) -> Path:
    return npm(*PACKAGES)


def told(place: Path, script: str, *arguments: str) -> Any:
    shutil.copy(SCRIPTS / script, place)
    command = ["node", str(place / script), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def test_the_reader_inside_foxglove_counts_as_we_do(place: Path, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    subprocess.run([*RUN, "record", "sim://", "-o", path, "--duration", "2"], check=True)
    counts = Counter(message.topic for message in read(path).messages())
    assert told(place, "reader.mjs", str(path))["counts"] == dict(counts)


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_the_client_of_foxglove_reads_a_station(place: Path, protocol: str) -> None:
    serve = [*RUN, "serve", "--sim", "--port", "0", "--foxglove", "0", "--json"]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as station:
        try:
            assert station.stdout is not None
            url = json.loads(station.stdout.readline())["foxglove"]
            counts = told(place, "viewer.mjs", url, protocol)["counts"]
        finally:
            station.terminate()
    assert counts["/m100/telemetry"] >= 50
    assert min(counts["/m100/fix"], counts["/tf"], counts["/m100/state"]) > 0
