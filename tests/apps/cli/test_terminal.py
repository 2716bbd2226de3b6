"""The command line as people type it: Ctrl-C, closed pipes, terminals without Unicode."""

from __future__ import annotations

import asyncio
import io
import os
import re
import signal
import subprocess
import sys
import threading

import pytest

from m100link.apps.cli.outcome import ExitCode
from m100link.apps.cli.terminal import ReaderGone, read_line, speak_to_anybody
from tests.apps.cli.conftest import ROOT, Simulator
from tests.apps.cli.terminal import terminal
from tests.waiting import PATIENCE

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}


# -- a closed pipe ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",),
        ("--version",),
        ("fly", "--help"),
        ("decode", "AA"),
        ("info", "sim://"),
        ("activate", "sim://"),
        ("takeoff", "sim://"),
        ("release", "sim://"),
        ("echo", "sim://", "--csv"),
        ("echo", "sim://"),
        ("monitor", "sim://"),
        ("hz", "sim://", "--duration", "0.2"),
        ("plot", "sim://", "--duration", "0.5"),
        ("sim", "ctl"),
        ("serve", "--show-config"),
    ],
    ids=" ".join,
)
def test_a_closed_pipe_ends_quietly_with_0(arguments: tuple[str, ...]) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    kept = {k: v for k, v in os.environ.items() if not k.startswith("M100LINK_")}
    with os.fdopen(theirs, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "m100link", *arguments],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=kept,
            timeout=PATIENCE,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    assert "Traceback" not in done.stderr


def _closed_pipe() -> io.TextIOWrapper:
    ours, theirs = os.pipe()
    os.close(ours)
    return io.TextIOWrapper(os.fdopen(theirs, "wb"), encoding="ascii")


def test_data_that_nobody_reads_end_a_command_and_talk_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, err = _closed_pipe(), _closed_pipe()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with speak_to_anybody():
        for word in ("take-off", "landing"):
            sys.stderr.write(word)
            sys.stderr.flush()
        sys.stdout.write("data")
        with pytest.raises(ReaderGone):
            sys.stdout.flush()
    assert (sys.stdout, sys.stderr) == (out, err)
    out.close()  # does not raise: what was left went nowhere
    err.close()


# -- few characters -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\u2800\u2801\u2880\u28ff", " '.:"),
        ("12.5° m/s² ✓ … —", "12.5d m/s2 + ~ -"),
        ("山", "?"),
        ("\udcff", "?"),
    ],
    ids=["braille", "signs", "others", "a file name that is not text"],
)
def test_what_cannot_be_encoded_is_one_ascii_character(
    monkeypatch: pytest.MonkeyPatch, text: str, shown: str
) -> None:
    binary = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(binary, encoding="ascii"))
    with speak_to_anybody():
        sys.stdout.write(text)
    assert binary.getvalue().decode() == shown


@pytest.mark.pty
@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("plot", "sim://", "quaternion.yaw_deg", "--duration", "1"), " |"),
        (("demo", "--side", "1"), "mission flown"),
        (("monitor", "sim://", "--duration", "1"), "yaw "),
        (("sim", "--duration", "1"), "attitude"),
        (("sim", "ctl"), "rc-mode"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_terminal_that_is_not_utf_8_gets_ascii(arguments: tuple[str, ...], part: str) -> None:
    with terminal(*arguments, environment=ASCII) as running:
        assert running.end() == 0, running.shown
        assert part in running.shown
        assert running.shown.isascii()


# -- Ctrl-C ---------------------------------------------------------------------------------------


@pytest.mark.pty
@pytest.mark.parametrize("keys", ["\x03", "n\n", "\n", "\x04"], ids=["^C", "n", "Enter", "^D"])
def test_ctrl_c_and_everything_but_yes_end_a_question(
    simulator: Simulator, app: list[str], keys: str
) -> None:
    with terminal("takeoff", simulator.port, *app) as running:
        running.read_until("Really take off? [y/N]")
        running.type(keys)
        status = running.end()
        assert status == (ExitCode.INTERRUPTED if keys == "\x03" else ExitCode.USAGE)
        assert "Traceback" not in running.shown
        assert "done:" not in running.shown


@pytest.mark.smoke
@pytest.mark.pty
def test_yes_flies(simulator: Simulator, app: list[str]) -> None:
    with terminal("takeoff", simulator.port, *app) as running:
        running.read_until("Really take off? [y/N]")
        running.type("y\n")
        assert running.end() == 0
        assert "done: take off" in running.shown


@pytest.mark.pty
def test_ctrl_c_ends_a_plot_without_a_traceback() -> None:
    with terminal("plot", "sim://") as running:
        running.read_until("position.height_m")
        running.type("\x03")
        assert running.end() == ExitCode.INTERRUPTED
        assert "interrupted" in running.shown
        assert "Traceback" not in running.shown
        assert "never retrieved" not in running.shown


# -- 40 columns -----------------------------------------------------------------------------------


@pytest.mark.pty
@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("monitor", "sim://", "--duration", "1"), ("angular_velocity", "standby")),
        (("hz", "sim://", "--duration", "1"), ("angular_velocity", "count")),
        (("plot", "sim://", "--duration", "1"), ("1.0 s", "\u2524\u2800")),
        (("demo", "--side", "1"), ("mission flown", "setpoints sent", "height")),
        (("sim", "--duration", "1"), ("attitude", "velocity", "battery, GPS")),
        (("info", "sim://"), ("flight_status",)),
    ],
    ids=lambda value: value[0] if value and value[0].isalpha() else "",
)
def test_40_columns_are_enough(arguments: tuple[str, ...], parts: tuple[str, ...]) -> None:
    with terminal(*arguments, columns=40) as running:
        assert running.end() == 0, running.shown
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", running.shown)
    for part in parts:
        assert part in shown
    assert "\u2026" not in shown.replace("\u2026  ", "")  # nothing is cut off


def test_ctrl_c_that_interrupts_no_wait_ends_a_question_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # In another thread it is marked and wakes nobody, as one does that comes just before the wait.
    reading, writing = os.pipe()
    asked = threading.Event()

    def strike() -> None:
        asked.wait(PATIENCE)
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    async def ask() -> None:
        asyncio.get_running_loop().call_later(0.2, asked.set)
        await read_line()

    striking = threading.Thread(target=strike)
    with os.fdopen(reading) as stdin, os.fdopen(writing, "w"):
        monkeypatch.setattr(sys, "stdin", stdin)
        striking.start()
        with pytest.raises(KeyboardInterrupt):
            asyncio.run(ask())
    striking.join()
