"""A program that knows zenoh alone sees keys, tokens and the bytes of the aircraft's wire."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from m100link.apps.fleet.payloads import VERSION
from tests.apps.cli.test_fleet import Site
from tests.waiting import PATIENCE

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

pytestmark = pytest.mark.pty

PLAIN = Path(__file__).parent / "plain.py"
EXAMPLE = Path(__file__).parents[3] / "examples" / "fleet" / "plain_zenoh.py"
HEAD = 1 + 13
"""Before the wire value: the version; kind, time and profile of the agent's message."""


class Witness:
    """Stands between agent and aircraft, and keeps what the aircraft said."""

    def __init__(self, stack: ExitStack, port: int) -> None:
        self.heard = bytearray()
        self._aircraft = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        self._listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        agent, _ = self._listener.accept()
        with agent:
            back = threading.Thread(target=self._pump, args=(agent, self._aircraft), daemon=True)
            back.start()
            self._pump(self._aircraft, agent, self.heard)

    def end(self) -> None:
        """End both ways."""
        self._aircraft.shutdown(socket.SHUT_RDWR)
        self._thread.join(PATIENCE)

    @staticmethod
    def _pump(source: socket.socket, sink: socket.socket, kept: bytearray | None = None) -> None:
        try:
            while data := source.recv(4096):
                if kept is not None:
                    kept += data
                sink.sendall(data)
        except OSError:
            return  # one of both has ended: the test is over


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[Site, ExitStack]]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with ExitStack() as stack:
        one = Site(stack, place, tmp_path)
        router = one.start("router", "--listen", place, "--json")
        assert router.stdout is not None
        assert router.stdout.readline()
        yield one, stack


def test_keys_tokens_and_bytes(site: tuple[Site, ExitStack], tmp_path: Path) -> None:
    one, stack = site
    command = (sys.executable, "-m", "m100link", "sim", "--tcp", "0", "--json")
    aircraft = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    stack.enter_context(aircraft)
    stack.callback(aircraft.kill)
    assert aircraft.stdout is not None
    told = json.loads(aircraft.stdout.readline())
    witness = Witness(stack, int(str(told["port"]).rpartition(":")[2]))
    stack.callback(witness.end)
    one.start(
        "agent", f"tcp://127.0.0.1:{witness.port}", "--name", "a1", "--order-log", str(tmp_path)
    )
    assert [card["connection"] for card in one.listed(1)] == ["connected"]
    done = subprocess.run(
        (sys.executable, str(PLAIN), one.place, "5"),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    tokens, states, *samples = [json.loads(line) for line in done.stdout.splitlines()]
    [token] = tokens["tokens"]
    assert re.fullmatch("m100-live/site/a1/[0-9a-f]+", token)
    [(key, (version, state))] = states["states"].items()
    assert (key, version, state["connection"]) == ("m100/site/a1/state", VERSION, "connected")
    by_key: dict[str, list[bytes]] = {}
    for sample in samples:
        by_key.setdefault(sample["key"], []).append(bytes.fromhex(sample["payload"]))
    assert set(by_key) == {"m100/site/a1/tel", "m100/site/a1/tel/5hz"}
    assert len(by_key["m100/site/a1/tel"]) > 100
    assert 20 <= len(by_key["m100/site/a1/tel/5hz"]) <= 40
    values = [payload[HEAD:] for payloads in by_key.values() for payload in payloads]
    # Until a second at rest has shown its mode, the agent leaves acceleration (bit 2) out.
    values = [value for value in values if value[0] & 4]
    assert len(values) > 100
    assert all(value in witness.heard for value in values)
    assert max(map(len, values)) > 90


def test_the_example_lists_hears_and_stops(site: tuple[Site, ExitStack]) -> None:
    one, _ = site
    one.start("agent", "sim://", "--name", "a", "--count", "2")
    assert len(one.listed(2, lambda card: card["battery_percent"] == 100)) == 2
    command = [sys.executable, str(EXAMPLE), one.place]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    *told, heard = done.stdout.splitlines()
    assert told == [
        line
        for name in ("a1", "a2")
        for line in (f"{name} connected standby 100 %", f"{name} stop: ok")
    ]
    key, size, _ = heard.split()
    assert key in {"m100/site/a1/tel/5hz", "m100/site/a2/tel/5hz"}
    assert int(size) > 20
