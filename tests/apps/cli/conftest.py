"""The command line inside the test, and as a process with a simulator beside it."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from m100link.apps.cli.app import run
from m100link.apps.station import log_output
from m100link.sim.clock import VirtualClockEventLoop
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.waiting import PATIENCE

ROOT = Path(__file__).parents[3]

# Measured over a second or two of real time, in which a busy machine may do something else.
NEARLY_100 = pytest.approx(100, rel=0.3)


_TEXT = {"--table", "--csv", "--help", "--version", "-", "completion", "udev"}
_TEXTS = {("mission", "download"), ("log", "csv"), ("log", "layout")}
"""Where a text is itself the result; all else that a verb prints in a pipe is JSON."""


class Outcome(NamedTuple):
    """How a command ended and what it said."""

    status: int
    out: str
    err: str

    @property
    def objects(self) -> list[Any]:
        """Standard output as JSON lines."""
        return [json.loads(line) for line in self.out.splitlines()]


class CommandLine:
    """Runs commands inside the test's process; at ``sim://`` on virtual time."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: str) -> Outcome:
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(sys, "argv", ["m100link", *arguments])
            if any(word.startswith("sim://") for word in arguments):
                patched.setattr(asyncio.events, "new_event_loop", VirtualClockEventLoop)
            with pytest.raises(SystemExit) as caught:
                run()
        captured = self._capsys.readouterr()
        status = caught.value.code
        assert isinstance(status, int)
        is_text = _TEXT & set(arguments) or arguments[0] == "docs" or arguments[:2] in _TEXTS
        if not is_text and not sys.stdout.isatty():
            for line in captured.out.splitlines():  # of every verb, whatever a test looks for
                assert (line[:1], line[-1:]) == ("{", "}"), (arguments, line)
        return Outcome(status, captured.out, captured.err)


@pytest.fixture(autouse=True)
def configuration_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the user's configuration file would be; there is none."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "config").mkdir()
    return tmp_path / "config" / "m100link.toml"


@pytest.fixture
def cli(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[CommandLine]:
    """A command line whose environment says nothing of its own."""
    for name in list(os.environ):
        if name.startswith("M100LINK_"):
            monkeypatch.delenv(name)
    # Wide enough that nothing is broken over lines.
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(log_output, "_LAST_WORDS", PATIENCE)  # the machine may hold up the thread
    logger = logging.getLogger("m100link")
    handlers, level = list(logger.handlers), logger.level
    yield CommandLine(capsys)
    logger.handlers[:] = handlers
    logger.setLevel(level)


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """The demo app's key, readable by nobody else."""
    path = tmp_path / "key"
    path.touch(mode=0o600)
    path.write_text(DEMO_KEY.reveal().hex() + "\n", encoding="ascii")
    return path


@pytest.fixture
def app(key_file: Path) -> list[str]:
    """Options that name the demo app."""
    return ["--app-id", str(DEMO_APP_ID), "--key-file", str(key_file)]


def process(*arguments: str, timeout: float = PATIENCE, stdin: str = "") -> Outcome:
    """Run a command as users do."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("M100LINK_")}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "m100link", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=timeout,
        env=environment | {"COLUMNS": "200", "NO_COLOR": "1"},
        cwd=ROOT,
        check=False,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


class Simulator:
    """A running ``m100link sim``.

    Attributes:
        port: What to open.
    """

    def __init__(self, runtime: Path, *arguments: str) -> None:
        self._environment = os.environ | {"XDG_RUNTIME_DIR": str(runtime)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "m100link", "sim", "--json", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self._environment,
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, self._process.communicate()[1]
        self.port: str = json.loads(line)["port"]

    def close(self) -> None:
        self._process.terminate()
        self._process.communicate(timeout=PATIENCE)


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[Simulator]:
    """A virtual aircraft in a process of its own, behind a pseudo-terminal."""
    running = Simulator(tmp_path)
    yield running
    running.close()
