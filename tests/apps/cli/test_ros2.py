"""``m100link ros2`` as a process: a session of zenoh that is not ours sees the node."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from typing import Any

import pytest

from tests.waiting import PATIENCE

pytestmark = pytest.mark.pty

zenoh: Any = pytest.importorskip("zenoh", reason="the extra ros2 is not installed")


@pytest.mark.smoke
def test_a_session_sees_the_node_and_sigterm_ends_it() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = json.dumps([f"tcp/127.0.0.1:{probe.getsockname()[1]}"])
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", place)
    config.insert_json5("scouting/multicast/enabled", "false")
    command = [sys.executable, "-m", "m100link", "ros2", "sim://", "--node", "one", "--domain", "7"]
    environment = os.environ | {"ZENOH_CONFIG_OVERRIDE": f"connect/endpoints={place}"}
    with (
        zenoh.open(config) as session,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as node,
    ):
        ring = zenoh.handlers.RingChannel(64)
        imus = session.declare_subscriber("7/one/imu/**", ring)
        tokens = session.liveliness().declare_subscriber("@ros2_lv/7/*/*/*/NN/**", history=True)
        assert node.stdout is not None
        assert node.stdout.readline().split() == ["ros2:", "/one"]
        assert next(iter(tokens)).kind == zenoh.SampleKind.PUT
        ends = time.monotonic() + PATIENCE
        while (imu := imus.try_recv()) is None and time.monotonic() < ends:
            time.sleep(0.05)
        assert imu is not None
        assert bytes(imu.payload).startswith(b"\0\1\0\0")
        node.send_signal(signal.SIGTERM)
        assert node.wait(PATIENCE) == 0
        assert next(iter(tokens)).kind == zenoh.SampleKind.DELETE
