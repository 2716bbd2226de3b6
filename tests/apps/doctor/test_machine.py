"""What is read of a machine, from files that a test wrote."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from m100link.apps.doctor.machine import Adapter, Machine, rule
from m100link.errors import UsageError
from tests.apps.doctor.bench import FakeMachine
from tests.waiting import blocking_until

PORT = "/dev/ttyUSB9"
STATE = SimpleNamespace(st_mode=0o020660, st_uid=0, st_gid=20)


def test_an_adapter_on_usb_is_described(machine: FakeMachine) -> None:
    machine.plug_in("ttyUSB9")
    assert machine.adapter(PORT) == Adapter(
        "ftdi_sio", "0403", "6001", "FTDI FT232R USB UART", "A50285BI", 16
    )


def test_a_port_of_the_board_hangs_on_nothing(machine: FakeMachine) -> None:
    assert machine.adapter("/dev/ttyAMA0") == Adapter("")
    assert not machine.adapter("/dev/ttyAMA0").is_usb


def test_an_adapter_without_a_timer_keeps_nothing_back(machine: FakeMachine) -> None:
    machine.plug_in("ttyUSB9", "cp210x", latency=None)
    assert machine.adapter(PORT).latency_ms is None


@pytest.mark.parametrize(
    ("words", "is_one"),
    [
        (("/sbin/agetty", "-o", "-p -- \\u", "115200", "ttyUSB9", "vt100"), True),
        (("/sbin/agetty", "ttyUSB9"), True),
        (("/sbin/agetty", "115200", "tty1", "linux"), False),
        (("/usr/bin/vim", "ttyUSB9"), False),
        # One that names itself anew has blanks between its words.
        (("/sbin/agetty -o -p ttyUSB9 vt100",), True),
    ],
)
def test_the_program_that_asks_for_a_login_there(
    machine: FakeMachine, words: tuple[str, ...], is_one: bool
) -> None:
    machine.run(41, *words)
    assert [one.pid for one in machine.login_programs(PORT)] == ([41] if is_one else [])


def test_whether_the_kernel_writes_there(machine: FakeMachine) -> None:
    machine.write("proc/consoles", "tty0    -WU (EC p  )    4:7\nttyUSB9 -W- (E  p  )    4:64\n")
    assert machine.is_kernel_console(PORT)
    assert not machine.is_kernel_console("/dev/ttyUSB")
    assert not FakeMachine(machine.root / "empty").is_kernel_console(PORT)


def test_modem_manager_is_found_and_a_rule_against_it(machine: FakeMachine) -> None:
    assert machine.modem_manager() is None
    machine.run(7, "/usr/sbin/ModemManager")
    assert str(machine.modem_manager()) == "ModemManager (process 7)"
    device = Path("/dev/null").stat().st_rdev
    assert not machine.is_left_alone("/dev/null")
    place = f"run/udev/data/c{os.major(device)}:{os.minor(device)}"
    machine.write(place, "I:1\nE:ID_MM_DEVICE_IGNORE=1\nG:systemd\n")
    assert machine.is_left_alone("/dev/null")


def test_a_container_is_known_by_its_file(machine: FakeMachine) -> None:
    assert not machine.is_container
    machine.write(".dockerenv", "")
    assert machine.is_container


def test_stable_names_lead_to_the_device(machine: FakeMachine) -> None:
    folder = machine.root / "dev/serial/by-id"
    folder.mkdir(parents=True)
    (folder / "usb-FTDI_FT232R-if00").symlink_to("/dev/null")
    (folder / "usb-other-if00").symlink_to("/dev/zero")
    assert machine.stable_names("/dev/null") == (str(folder / "usb-FTDI_FT232R-if00"),)
    assert machine.stable_names("/dev/full") == ()


def test_the_permission_is_that_of_the_device() -> None:
    permission = Machine().permission("/dev/null")
    assert (permission.mode, permission.is_granted) == ("crw-rw-rw-", True)
    with pytest.raises(FileNotFoundError):
        Machine().permission("/dev/there-is-no-such-port")


@pytest.mark.parametrize(
    ("own_group", "members", "is_member"),
    [(20, [], True), (1000, ["pilot"], True), (1000, ["other"], False), (1000, [], False)],
)
def test_a_member_is_one_by_the_own_group_or_by_the_list(
    monkeypatch: pytest.MonkeyPatch, own_group: int, members: list[str], is_member: bool
) -> None:
    """The list of the group shows a user who was added and has not logged in again."""
    asked: list[str] = []

    def named(name: str) -> SimpleNamespace:
        asked.append(name)
        return SimpleNamespace(gr_mem=members)

    user = SimpleNamespace(pw_gid=own_group, pw_name="pilot")
    monkeypatch.setattr("pwd.getpwuid", lambda number: user)
    monkeypatch.setattr("grp.getgrgid", lambda number: SimpleNamespace(gr_name="dialout"))
    monkeypatch.setattr("grp.getgrnam", named)
    # Python 3.13 asks its own stat() for the group, with an option.
    monkeypatch.setattr("m100link.apps.doctor.machine.Path.stat", lambda path, **_: STATE)
    permission = Machine().permission("/dev/null")
    assert (permission.group, permission.is_member) == ("dialout", is_member)
    assert set(asked) <= {"dialout"}


@pytest.mark.pty
def test_the_holder_of_a_terminal_is_found_and_its_other_end_is_not(tmp_path: Path) -> None:
    master, slave = os.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    assert Machine().holders(name) == ()
    program = f"f = open({name!r}); print('open', flush=True); import time; time.sleep(600)"
    other = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        [holder] = Machine().holders(name)
        assert holder.pid == other.pid
        assert "python" in holder.name
    finally:
        other.kill()
        other.wait()
        assert other.stdout is not None
        other.stdout.close()
    blocking_until(lambda: Machine().holders(name) == ())
    os.close(master)


# -- the text of a rule ----------------------------------------------------------------------------


FTDI = Adapter("ftdi_sio", "0403", "6001", "FTDI FT232R USB UART", "A50285BI", 16)
CP2102 = Adapter("cp210x", "10c4", "ea60", "Silicon Labs CP2102", "")


def test_a_rule_names_the_adapter_its_group_and_keeps_others_away() -> None:
    title, port, timer = rule(FTDI, "m100").splitlines()
    assert title == "# FTDI FT232R USB UART of the aircraft: /dev/m100"
    assert port.split(", ") == [
        'SUBSYSTEM=="tty"',
        'ATTRS{idVendor}=="0403"',
        'ATTRS{idProduct}=="6001"',
        'SYMLINK+="m100"',
        'GROUP="dialout"',
        'MODE="0660"',
        'ENV{ID_MM_DEVICE_IGNORE}="1"',
    ]
    assert timer.endswith('SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"')


def test_only_ftdi_adapters_have_a_timer_and_only_this_one_its_number() -> None:
    assert "latency_timer" not in rule(CP2102, "m100")
    assert 'ATTRS{serial}=="A50285BI", ' in rule(FTDI, "left", group="plugdev", by_serial=True)
    assert 'GROUP="plugdev"' in rule(FTDI, "left", group="plugdev", by_serial=True)


@pytest.mark.parametrize(
    ("adapter", "name", "by_serial", "seen"),
    [
        (FTDI, 'm100", RUN+="rm', False, "cannot be the name"),
        (FTDI, "", False, "cannot be the name"),
        (FTDI, "../m100", False, "cannot be the name"),
        (Adapter("port"), "m100", False, "not on USB"),
        (CP2102, "m100", True, "tells no serial number"),
    ],
)
def test_what_cannot_be_a_rule_is_refused(
    adapter: Adapter, name: str, by_serial: bool, seen: str
) -> None:
    with pytest.raises(UsageError, match=seen):
        rule(adapter, name, by_serial=by_serial)
