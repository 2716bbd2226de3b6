"""``m100link mavlink`` as a process: a ground station on a real socket."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time

import pytest

from m100link.apps.mavlink.translator.codec import Message, read_datagram, write_frame
from tests.waiting import PATIENCE

pytestmark = pytest.mark.pty


@pytest.mark.smoke
def test_a_ground_station_sees_the_aircraft_and_sigterm_ends_it() -> None:
    command = [sys.executable, "-m", "m100link", "mavlink", "sim://"]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        subprocess.Popen(
            [*command, "--listen", "udp://127.0.0.1:0"], stdout=subprocess.PIPE, text=True
        ) as bridge,
    ):
        assert bridge.stdout is not None
        found = re.search(r"mavlink: +udp://127\.0\.0\.1:(\d+)", bridge.stdout.readline())
        assert found is not None
        address = ("127.0.0.1", int(found[1]))
        station.bind(("127.0.0.1", 0))
        station.settimeout(PATIENCE)
        beat = write_frame(Message("HEARTBEAT", {"type": 6}), system=255, sequence=0)
        names: set[str] = set()
        ends = time.monotonic() + PATIENCE
        while not {"HEARTBEAT", "HOME_POSITION", "ATTITUDE"} <= names and time.monotonic() < ends:
            station.sendto(beat, address)
            names |= {one.name for one in read_datagram(station.recv(2048))}
        assert {"HEARTBEAT", "HOME_POSITION", "ATTITUDE"} <= names
        bridge.send_signal(signal.SIGTERM)
        assert bridge.wait(PATIENCE) == 0
