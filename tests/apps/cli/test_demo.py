"""``m100link demo``: the mission on the virtual clock, the rest as a user starts it."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from m100link.log import read
from tests.apps.cli.conftest import ROOT, CommandLine, process
from tests.waiting import PATIENCE


def check(summary: dict[str, Any], firmware: str, side: float = 8.0) -> None:
    """A square, up to 3 m high; a loop that runs late overshoots its corners."""
    assert summary["flown"] is True
    assert summary["error"] is None
    assert summary["returned_within_m"] <= 1.0
    assert summary["firmware"] == firmware
    assert list(summary["stages"]) == [
        *("connect", "activate", "obtain control", "take off", "square", "land", "release")
    ]
    assert 4 * side - 2 <= summary["path_length_m"] <= 4 * side + 8
    assert 2.5 <= summary["max_height_m"] <= 3.5
    norths = [north for north, _ in summary["track"]]
    easts = [east for _, east in summary["track"]]
    assert max(norths) == pytest.approx(side, abs=1.5)
    assert max(easts) == pytest.approx(side, abs=1.5)
    assert min(norths + easts) > -1.5


@pytest.mark.parametrize("firmware", ["1.0", "2.3", "3.1"])
def test_demo_flies_and_comes_back_within_a_metre(cli: CommandLine, firmware: str) -> None:
    outcome = cli("demo", "--speed", "max", "--json", "--firmware", firmware)
    assert outcome.status == 0, outcome.err
    [summary] = outcome.objects
    check(summary, firmware)
    assert summary["speed"] == "max"
    assert summary["returned_within_m"] < 0.5
    assert summary["line"]["discarded_bytes"] == summary["line"]["repeats"] == 0
    # Sent at 50 Hz: one every 20 ms of its own time, whatever the machine does meanwhile.
    assert summary["setpoints_sent"] == pytest.approx(50 * summary["stages"]["square"], rel=0.02)


def test_on_the_virtual_clock_equal_seeds_are_equal_flights(cli: CommandLine) -> None:
    command = ("demo", "--speed", "max", "--json", "--side", "3", "--seed")
    one, again = (cli(*command, "5").objects[0] for _ in range(2))
    for summary in (one, again):
        assert 0.0 < summary.pop("real_seconds") < time.monotonic()
        assert Path(summary.pop("recording")).exists()
    assert one == again


@pytest.mark.pty
@pytest.mark.smoke
def test_demo_flies_over_a_pseudo_terminal() -> None:
    # At its own speed: five-fold, a machine that is late by 50 ms is late by a quarter of a second.
    outcome = process("demo", "--side", "1", "--json")
    assert outcome.status == 0, outcome.err
    [summary] = outcome.objects
    check(summary, "1.0", side=1.0)
    assert summary["port"].startswith("/dev/pts/")
    assert summary["line"]["discarded_bytes"] <= 200  # opened in the middle of a frame
    assert summary["setpoints_sent"] > 100  # some 600 on an idle machine


def test_demo_shows_a_summary_and_pictures_to_people(cli: CommandLine) -> None:
    outcome = cli("demo", "--side", "4", "--speed", "max", "--table")
    assert outcome.status == 0
    assert "mission flown" in outcome.out
    assert "back within" in outcome.out
    assert any(0x2800 < ord(c) <= 0x28FF for c in outcome.out), "no picture of the track"
    assert "north up" in outcome.out


def test_demo_says_where_its_log_is_and_how_to_see_it_again(
    cli: CommandLine, tmp_path: Path
) -> None:
    folder = tmp_path / "my flights"
    outcome = cli("demo", "--side", "1", "--speed", "max", "--record", str(folder), "--table")
    assert outcome.status == 0
    [path] = folder.iterdir()
    assert f"recorded in {path}" in outcome.out
    assert f"m100link log report '{path}'" in outcome.out
    assert f"m100link replay '{path}'" in outcome.out
    assert read(path).summary().is_whole
    outcome = cli("demo", "--side", "1", "--speed", "max", "--no-record", "--table")
    assert outcome.status == 0
    assert "recorded" not in outcome.out


@pytest.mark.pty
def test_demo_that_is_interrupted_ends_with_130() -> None:
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "demo"],
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


@pytest.mark.pty
def test_demo_on_a_terminal_shows_live_progress() -> None:
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "-m", "m100link", "demo", "--side", "2"],
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
