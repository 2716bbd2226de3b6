"""A port that is looked at and not opened; each stage is made to fail."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from m100link.apps.doctor.machine import Machine, Permission, Process
from m100link.apps.doctor.port import Ear, Finding, Stage, Verdict, look_at_latency, look_at_port
from m100link.sim.clock import virtual_clock_loop
from tests.apps.doctor.bench import FakeMachine


class Port(NamedTuple):
    """A terminal that exists, and its name as the system's folders have it."""

    path: str
    name: str


@pytest.fixture
def port() -> Iterator[Port]:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    yield Port(path, Path(path).name)
    os.close(slave)
    os.close(master)


def looked_at(path: str, machine: Machine) -> list[Finding]:
    return list(look_at_port(path, machine))


def test_a_port_that_is_well(port: Port, machine: FakeMachine) -> None:
    machine.plug_in(port.name, latency=1)
    found = looked_at(port.path, machine)
    assert [one.stage for one in found] == [
        Stage.PORT,
        Stage.PERMISSION,
        Stage.OWNER,
        Stage.INTERFERENCE,
    ]
    assert {one.verdict for one in found} == {Verdict.GOOD}
    assert found[0].seen == f"{port.path}: FTDI FT232R USB UART"
    assert look_at_latency(port.path, machine).seen == "latency timer 1 ms"


def test_a_link_is_followed_and_reported(port: Port, machine: FakeMachine, tmp_path: Path) -> None:
    link = tmp_path / "m100"
    link.symlink_to(port.path)
    assert looked_at(str(link), machine)[0].seen == f"{link} → {port.path}"


def test_there_is_no_such_port(machine: FakeMachine) -> None:
    [found] = looked_at("/dev/ttyUSB99", machine)
    assert (found.stage, found.verdict) == (Stage.PORT, Verdict.FAILED)
    assert found.seen == "there is no device /dev/ttyUSB99"
    assert found.causes == ("the adapter is not plugged in, or has another name",)
    assert found.commands[0] == "m100link ports"


def test_a_folder_that_nobody_may_look_into_is_reported(
    machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(path: str) -> bool:
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(machine, "is_terminal_device", closed)
    [found] = looked_at("/dev/private/ttyUSB0", machine)
    assert (found.stage, found.verdict) == (Stage.PORT, Verdict.FAILED)
    assert "Permission denied" in found.seen
    assert found.commands[0] == "ls -ld /dev/private"


def test_in_a_container_it_may_not_have_been_given(machine: FakeMachine) -> None:
    machine.write(".dockerenv", "")
    [found] = looked_at("/dev/ttyUSB99", machine)
    assert found.causes[0].endswith("--device=/dev/ttyUSB99")


def test_a_file_is_not_a_port(machine: FakeMachine, tmp_path: Path) -> None:
    for path in (tmp_path, machine.write("notes.txt", "x")):
        [found] = looked_at(str(path), machine)
        assert found.seen == f"{path} is not a serial port"


@pytest.mark.parametrize(
    ("group", "is_member", "cause", "command"),
    [
        ("dialout", False, "you are not in the group dialout", "sudo usermod -aG dialout $USER"),
        ("dialout", True, "you were added to the group dialout", "log out and in again"),
        ("root", False, "no rule gives the device", "m100link udev --install"),
    ],
)
def test_it_may_not_be_opened(
    port: Port,
    machine: FakeMachine,
    monkeypatch: pytest.MonkeyPatch,
    group: str,
    is_member: bool,
    cause: str,
    command: str,
) -> None:
    refused = Permission("crw-rw----", "root", group, is_granted=False, is_member=is_member)
    monkeypatch.setattr(machine, "permission", lambda _: refused)
    found = looked_at(port.path, machine)[-1]
    assert (found.stage, found.verdict) == (Stage.PERMISSION, Verdict.FAILED)
    assert f"crw-rw---- root {group}" in found.seen
    assert found.causes[0].startswith(cause)
    assert found.commands[0] == command


def test_another_program_has_it(
    port: Port, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "holders", lambda _: (Process(4711, "minicom"),))
    found = looked_at(port.path, machine)[-1]
    assert (found.stage, found.verdict) == (Stage.OWNER, Verdict.FAILED)
    assert found.seen == "in use by minicom (process 4711)"
    assert found.commands[0] == "end it: kill 4711"


def test_a_login_prompt_runs_on_it(port: Port, machine: FakeMachine) -> None:
    machine.run(99, "/sbin/agetty", "115200", port.name, "vt100")
    found = looked_at(port.path, machine)[-1]
    assert (found.stage, found.verdict) == (Stage.INTERFERENCE, Verdict.FAILED)
    assert found.seen == "a login prompt runs on it: agetty (process 99)"
    assert found.commands == (f"sudo systemctl disable --now serial-getty@{port.name}.service",)


def test_the_kernel_writes_to_it(port: Port, machine: FakeMachine) -> None:
    machine.write("proc/consoles", f"{port.name} -W- (EC p  )    4:64\n")
    found = looked_at(port.path, machine)[-1]
    assert found.seen == "the kernel writes its messages to it"
    assert f"console={port.name}" in found.causes[0]


def test_modem_manager_is_a_doubt_for_adapters_on_usb_only(
    port: Port, machine: FakeMachine
) -> None:
    machine.run(7, "/usr/sbin/ModemManager")
    assert looked_at(port.path, machine)[-1].verdict is Verdict.GOOD
    machine.plug_in(port.name)
    found = looked_at(port.path, machine)[-1]
    assert found.verdict is Verdict.DOUBTFUL
    assert found.commands == ("m100link udev --install",)


def test_an_ftdi_adapter_as_it_comes_is_late(port: Port, machine: FakeMachine) -> None:
    machine.plug_in(port.name, latency=16)
    found = look_at_latency(port.path, machine)
    assert (found.stage, found.verdict) == (Stage.LATENCY, Verdict.DOUBTFUL)
    assert "latency timer 16 ms" in found.seen
    assert found.commands[1].endswith(f"/sys/bus/usb-serial/devices/{port.name}/latency_timer")


@pytest.mark.parametrize(
    ("latency", "verdict"),
    [(1, Verdict.GOOD), (4, Verdict.GOOD), (5, Verdict.DOUBTFUL), (16, Verdict.DOUBTFUL)],
)
def test_four_milliseconds_are_the_most_that_an_adapter_may_collect(
    port: Port, machine: FakeMachine, latency: int, verdict: Verdict
) -> None:
    """Setpoints go every 20 ms: a fifth of that is not seen, and 16 ms are what FTDI ships."""
    machine.plug_in(port.name, latency=latency)
    found = look_at_latency(port.path, machine)
    assert (found.verdict, found.seen[: len(f"latency timer {latency} ms")]) == (
        verdict,
        f"latency timer {latency} ms",
    )


@pytest.mark.parametrize("latency", [0, 1, 4, 5, 16, 255])
def test_more_than_four_milliseconds_are_late(
    port: Port, machine: FakeMachine, latency: int
) -> None:
    machine.plug_in(port.name, latency=latency)
    found = look_at_latency(port.path, machine)
    assert (found.verdict is Verdict.GOOD) is (latency <= 4)
    assert f"latency timer {latency} ms" in found.seen
    assert found.details == ({} if latency <= 4 else {"latency_ms": latency})


def test_an_adapter_without_a_timer_is_not_late(port: Port, machine: FakeMachine) -> None:
    machine.plug_in(port.name, "cp210x", latency=None)
    assert look_at_latency(port.path, machine).verdict is Verdict.GOOD


def test_modem_manager_is_no_doubt_where_a_rule_keeps_it_away(
    port: Port, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.run(7, "/usr/sbin/ModemManager")
    machine.plug_in(port.name)
    monkeypatch.setattr(machine, "is_left_alone", lambda _: True)
    assert looked_at(port.path, machine)[-1].verdict is Verdict.GOOD


class Line(asyncio.Transport):
    """A line that ends on request, or never."""

    def __init__(self, ear: Ear, *, ends: bool) -> None:
        super().__init__()
        self.written: list[bytes] = []
        self._ear, self._ends = ear, ends
        ear.connection_made(self)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.written.append(bytes(data))

    def abort(self) -> None:
        if self._ends:
            self._ear.connection_lost(None)


def on_virtual_time(work: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=virtual_clock_loop) as runner:
        runner.run(work)


@pytest.mark.parametrize(("ends", "took_s"), [(True, 0.0), (False, 1.0)])
def test_an_ear_hears_what_is_new_and_gives_the_line_back(ends: bool, took_s: float) -> None:
    """A line whose end nobody tells of is waited for one second."""

    async def heard() -> None:
        loop, ear = asyncio.get_running_loop(), Ear()
        line = Line(ear, ends=ends)
        await ear.made.wait()
        loop.call_later(0.3, ear.data_received, b"one")
        loop.call_later(0.7, ear.data_received, b"two")
        began = loop.time()
        await ear.listen(0.5)
        assert ear.data == b"one"
        assert loop.time() - began == pytest.approx(0.5)
        await ear.listen(0.5)
        assert (bytes(ear.data), ear.is_lost, ear.lost) == (b"onetwo", False, None)
        ear.say(b"?")
        began = loop.time()
        await ear.close()
        assert loop.time() - began == pytest.approx(took_s)
        assert line.written == [b"?"]

    on_virtual_time(heard())


def test_a_line_that_ends_is_not_listened_to_nor_spoken_on() -> None:
    async def heard() -> None:
        loop, ear = asyncio.get_running_loop(), Ear()
        line, why = Line(ear, ends=True), OSError("unplugged")
        loop.call_later(0.2, ear.connection_lost, why)
        began = loop.time()
        await ear.listen(5.0)
        assert loop.time() - began == pytest.approx(0.2)
        assert (ear.is_lost, ear.lost) == (True, why)
        ear.say(b"?")
        assert line.written == []

    on_virtual_time(heard())
