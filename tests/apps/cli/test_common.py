"""What the command line says when something is wrong, and its exit status."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from rich.table import Table

from m100link.apps.cli.common import TextConsole
from m100link.apps.cli.terminal import ExitCode
from m100link.testing import VirtualPort
from m100link.wire import encode_frame
from tests.apps.cli.conftest import CommandLine

# -- URLs and ports -------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["info", "monitor", "hz", "echo"])
@pytest.mark.parametrize("url", ["ttyUSB0", "serial:///dev/ttyUSB0:fast", "pigeon://coop"])
def test_a_wrong_url_prints_three_that_work(cli: CommandLine, command: str, url: str) -> None:
    outcome = cli(command, url)
    assert outcome.status == ExitCode.USAGE
    assert outcome.out == ""
    for example in ("serial:///dev/ttyUSB0:230400", "/dev/ttyUSB0", "tcp://192.168.1.5:7000"):
        assert f"\n      {example}" in outcome.err


def test_no_url_at_all_is_a_usage_error(cli: CommandLine) -> None:
    outcome = cli("info")
    assert outcome.status == ExitCode.USAGE
    assert "URL" in outcome.out + outcome.err


def test_the_url_may_come_from_the_environment(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("M100LINK_URL", "sim://?firmware=2.3")
    outcome = cli("info", "--duration", "0.1")
    assert outcome.status == 0
    assert outcome.objects[0]["firmware"] == "2.3"


def test_a_virtual_aircraft_gets_the_firmware_that_was_asked_for(cli: CommandLine) -> None:
    outcome = cli("info", "sim://", "--firmware", "3.1", "--duration", "0.1")
    assert outcome.status == 0
    assert outcome.objects[0]["version"] == "SDK-v1.0 BETA M100-03.01.01.00"


@pytest.mark.parametrize(
    ("arguments", "verb"),
    [
        (("info", "--duration", "0.1"), "version"),
        (("activate",), "activated"),
        (("monitor", "--duration", "1.2", "--json"), "position"),
        (("echo", "position", "--packages", "1"), "position.height_m"),
        (("echo", "--packages", "1"), "received_at"),
        (("hz", "--duration", "0.1"), "items"),
        (("plot", "position.height_m", "--duration", "0.5"), "position.height_m"),
        (("plot", "--duration", "0.5"), "position.height_m"),
        (("takeoff",), '"done": "take off"'),
        (("release",), '"done": "release"'),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
@pytest.mark.parametrize("by_option", [False, True], ids=["environment", "option"])
def test_every_verb_finds_the_aircraft_without_an_argument(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    verb: str,
    by_option: bool,
) -> None:
    if by_option:
        arguments = (*arguments, "--url", "sim://")
    else:
        monkeypatch.setenv("M100LINK_URL", "sim://")
    outcome = cli(*arguments)
    assert outcome.status == 0, outcome
    assert verb in outcome.out


def test_fly_tells_its_url_from_its_numbers(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An aircraft on the ground refuses to fly: so far it came, with the numbers as they are."""
    for arguments in (("sim://", "-5", "0", "1"), ("--url", "sim://", "-5", "0", "1")):
        outcome = cli("fly", *arguments)
        assert outcome.status == ExitCode.USAGE
        assert "take off first" in outcome.err
    monkeypatch.setenv("M100LINK_URL", "sim://")
    assert "take off first" in cli("fly", "-5", "0", "1").err
    assert "take off first" in cli("fly", "--", "-5", "0", "1").err
    assert "'north' is not a number" in cli("fly", "sim://", "north", "0", "1").err
    assert "2 numbers were given" in cli("fly", "5", "0").err
    assert "'--yse' is not a number" in cli("fly", "5", "0", "1", "--yse").err
    assert "'nan' is not a number" in cli("fly", "sim://", "nan", "0", "1").err


def test_two_aircraft_are_one_too_many(cli: CommandLine) -> None:
    outcome = cli("takeoff", "sim://", "--url", "sim://?seed=2")
    assert outcome.status == ExitCode.USAGE
    assert "two aircraft are named: sim:// and sim://?seed=2" in outcome.err


def test_no_such_port(cli: CommandLine) -> None:
    outcome = cli("info", "/dev/m100-that-does-not-exist")
    assert outcome.status == ExitCode.PORT
    assert "there is no device /dev/m100-that-does-not-exist" in outcome.err
    assert "what to do:" in outcome.err


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_no_permission(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "tty"
    path.touch(mode=0o000)
    outcome = cli("info", str(path))
    assert outcome.status == ExitCode.PORT
    assert "usermod -aG dialout" in outcome.err


def test_no_permission_as_the_system_reports_it(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(13, "Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    outcome = cli("info", "/dev/ttyUSB0")
    assert outcome.status == ExitCode.PORT
    assert "this user may not open /dev/ttyUSB0" in outcome.err
    assert "usermod -aG dialout" in outcome.err


def test_what_is_no_serial_port(cli: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"")
    outcome = cli("info", str(path))
    assert outcome.status == ExitCode.PORT
    assert "not a serial port" in outcome.err


def test_nobody_listens_at_a_tcp_address(cli: CommandLine) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    outcome = cli("info", f"tcp://127.0.0.1:{port}")
    assert outcome.status == ExitCode.PORT
    assert f"nothing answers at tcp://127.0.0.1:{port}" in outcome.err


# -- what is at the other end ---------------------------------------------------------------------


@pytest.fixture
def port() -> Iterator[VirtualPort]:
    running = VirtualPort(seed=1)
    yield running
    running.close()


@pytest.mark.pty
def test_a_busy_port_names_its_owner(cli: CommandLine, port: VirtualPort) -> None:
    with serial.Serial(port.name, exclusive=True):
        outcome = cli("info", port.name)
    assert outcome.status == ExitCode.PORT
    assert f"{port.name} is in use by" in outcome.err
    assert f"(process {os.getpid()})" in outcome.err


@pytest.mark.pty
@pytest.mark.parametrize("rate", [115_200, 921_600])
def test_a_wrong_baud_rate_is_bytes_without_a_frame(
    cli: CommandLine, port: VirtualPort, rate: int
) -> None:
    outcome = cli("info", f"{port.name}:{rate}", "--timeout", "1")
    assert outcome.status == ExitCode.NO_LINK
    assert "bytes arrived and not one valid frame" in outcome.err
    assert "another baud rate" in outcome.err
    assert "try 230400, 115200, 921600" in outcome.err


@pytest.mark.pty
def test_the_right_baud_rate_by_option(cli: CommandLine, port: VirtualPort) -> None:
    outcome = cli("info", port.name, "--baud", "230400", "--duration", "0.2")
    assert outcome.status == 0


@contextlib.contextmanager
def raw_terminal(say: Callable[[], bytes] = bytes) -> Iterator[str]:
    """A terminal on which ``say`` talks every 10 ms, and nobody listens."""
    master, slave = os.openpty()
    tty.setraw(slave)
    done = threading.Event()

    def talk() -> None:
        while not done.wait(0.01):
            os.write(master, say())

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        done.set()
        thread.join()
        os.close(master)
        os.close(slave)


@pytest.mark.pty
def test_a_silent_line(cli: CommandLine) -> None:
    with raw_terminal() as name:
        outcome = cli("info", name, "--timeout", "0.5")
    assert outcome.status == ExitCode.NO_LINK
    assert "not one byte arrived" in outcome.err
    assert "swap TX and RX" in outcome.err


@pytest.mark.pty
def test_telemetry_without_an_answer(cli: CommandLine) -> None:
    package = encode_frame(b"\x02\x00\x00\x04\x64", session=0, sequence=1)
    with raw_terminal(lambda: package) as name:
        outcome = cli("info", name, "--timeout", "0.5")
    assert outcome.status == ExitCode.NO_LINK
    assert "frames arrived, but no answer to a version query" in outcome.err
    assert "from our TX to the aircraft's RX" in outcome.err


# -- app and key ----------------------------------------------------------------------------------


def test_no_app_id_and_no_key_name_the_options_before_a_port_is_opened(cli: CommandLine) -> None:
    outcome = cli("activate", "/dev/m100-that-does-not-exist")
    assert outcome.status == ExitCode.USAGE
    assert "--app-id" in outcome.err
    assert "M100LINK_APP_ID" in outcome.err
    outcome = cli("activate", "/dev/m100-that-does-not-exist", "--app-id", "7")
    assert outcome.status == ExitCode.USAGE
    assert "--key-file" in outcome.err


@pytest.mark.parametrize("text", ["00", "g" * 64, "0" * 65, ""])
def test_a_key_file_without_a_key(cli: CommandLine, key_file: Path, text: str) -> None:
    key_file.write_text(text)
    outcome = cli("activate", "sim://", "--app-id", "7", "--key-file", str(key_file))
    assert outcome.status == ExitCode.USAGE
    assert "the key" in outcome.err


def test_a_key_file_that_is_not_there(cli: CommandLine, tmp_path: Path) -> None:
    outcome = cli("activate", "sim://", "--app-id", "7", "--key-file", str(tmp_path / "none"))
    assert outcome.status == ExitCode.USAGE
    assert "cannot be read" in outcome.err


@pytest.mark.parametrize(
    "command", [("activate", "sim://", "--app-id", "7"), ("sim", "--duration=1")]
)
def test_a_key_file_that_others_may_read_is_not_used(
    cli: CommandLine, key_file: Path, command: tuple[str, ...]
) -> None:
    key_file.chmod(0o644)
    outcome = cli(*command, "--key-file", str(key_file))
    assert outcome.status == ExitCode.USAGE
    assert "chmod 600" in outcome.err


def test_a_key_on_the_command_line_is_warned_of_and_not_repeated(cli: CommandLine) -> None:
    outcome = cli("activate", "sim://", "--app-id", "7", "--key", "ab" * 32)
    assert "shows the key to every user" in outcome.err
    assert "abab" not in outcome.err + outcome.out


def test_an_app_that_the_server_does_not_know(cli: CommandLine, key_file: Path) -> None:
    outcome = cli("activate", "sim://", "--app-id", "7", "--key-file", str(key_file))
    assert outcome.status == ExitCode.ACTIVATION
    assert "the server refused (code 6, attempt 2)" in outcome.err
    assert "check app id and key" in outcome.err
    assert key_file.read_text().strip() not in outcome.err


def test_no_text_steers_a_terminal_alone_or_in_a_table() -> None:
    console = TextConsole(file=io.StringIO(), width=60, force_terminal=False)
    table = Table("a\x1b[2J")
    table.add_row("b\x07\x9b")
    for shown in (table, "c\x1b]0;x\x07 \u202e", "two\nlines\tand a tab"):
        console.print(shown, markup=False)
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert not [one for one in said if not one.isprintable() and one != "\n"]
    assert "c\ufffd]0;x\ufffd \ufffd\ntwo\nlines" in said
