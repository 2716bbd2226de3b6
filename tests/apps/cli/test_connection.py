"""``m100link doctor``, ``ports`` and ``udev``, as an owner has them in front of them. Real time."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from m100link.apps.cli import connection as doctor_module
from m100link.apps.cli.connection import _EXIT_CODES
from m100link.apps.doctor import Machine, Stage
from m100link.apps.doctor.first_contact import Contact
from m100link.apps.doctor.machine import Adapter
from m100link.sim.vehicle.activation import DEMO_APP_ID, DEMO_KEY
from tests.apps.cli.conftest import NEARLY_100, CommandLine, Simulator, process
from tests.apps.cli.terminal import Terminal
from tests.apps.cli.terminal import terminal as on_terminal

FTDI = Adapter("ftdi_sio", "0403", "6001", "FTDI FT232R", "A50285BI", 16)


def test_every_stage_has_an_exit_status() -> None:
    assert set(Stage) - _EXIT_CODES.keys() == {Stage.LATENCY}  # which never fails


def test_no_such_port_and_several_that_it_could_be(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = cli("doctor", "/dev/ttyUSB99")
    assert outcome.status == 3
    [found] = outcome.objects
    assert (found["ok"], found["failed"], found["exit_status"]) == (False, "port", 3)
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/ttyUSB7", "/dev/ttyUSB8"])
    outcome = cli("doctor")
    assert outcome.status == 2
    assert "several ports could be the aircraft's: /dev/ttyUSB7, /dev/ttyUSB8" in outcome.err
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/ttyUSB99"])
    assert cli("doctor").objects[0]["url"] == "/dev/ttyUSB99 at 230400 baud"
    monkeypatch.setattr(doctor_module, "serial_ports", list)
    assert "no URL says where the aircraft is" in cli("doctor").err


def test_ports_are_listed(cli: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/null"])
    monkeypatch.setattr(Machine, "adapter", lambda *_: FTDI)
    monkeypatch.setattr(Machine, "holders", lambda *_: ())
    [port] = cli("ports").objects
    assert port["port"] == "/dev/null"
    assert (port["adapter"], port["usb"], port["latency_ms"]) == ("FTDI FT232R", "0403:6001", 16)
    assert port["may_open"] is True
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    shown = cli("ports").out
    titles = ["port", "adapter", "may open", "used by", "latency", "stable name"]
    assert re.split(r" {2,}", shown.splitlines()[0].strip()) == titles
    assert "FTDI FT232R" in shown
    assert "16 ms" in shown
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/there-is-no-port"])
    assert "no: gone" in cli("ports").out
    monkeypatch.setattr(doctor_module, "serial_ports", list)
    assert "no serial port here" in cli("ports").err


def test_a_rule_is_printed_and_installed(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/ttyUSB99"])
    monkeypatch.setattr(Machine, "adapter", lambda *_: FTDI)
    printed = cli("udev", "--link", "left", "--group", "plugdev")
    assert printed.status == 0
    assert 'SYMLINK+="left", GROUP="plugdev"' in printed.out
    place = tmp_path / "70-m100.rules"
    monkeypatch.setattr(doctor_module, "RULES_FILE", place)
    installed = cli("udev", "--install")
    assert installed.status == 0
    assert place.read_text(encoding="utf-8") == cli("udev").out
    assert "sudo udevadm control --reload" in installed.err
    monkeypatch.setattr(doctor_module, "RULES_FILE", tmp_path / "none" / "70-m100.rules")
    refused = cli("udev", "--install")
    assert refused.status == 2
    assert "sudo tee" in refused.err


def test_a_port_that_is_not_there_is_said_to_be_missing(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ["/dev/ttyUSB7"])
    outcome = cli("udev", "/dev/m100-none")
    assert outcome.status == 3
    assert "there is no device /dev/m100-none" in outcome.err
    assert "ports on this machine: /dev/ttyUSB7" in outcome.err


@pytest.mark.parametrize(
    ("ports", "seen"),
    [
        ([], "no adapter on USB is plugged in"),
        (["/dev/ttyUSB7", "/dev/ttyUSB8"], "several adapters are plugged in"),
    ],
)
def test_which_adapter_is_meant_has_to_be_clear(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, ports: list[str], seen: str
) -> None:
    monkeypatch.setattr(doctor_module, "serial_ports", lambda: ports)
    monkeypatch.setattr(Machine, "adapter", lambda *_: FTDI)
    outcome = cli("udev")
    assert outcome.status == 2
    assert seen in outcome.err


@pytest.mark.pty
def test_all_is_well_and_the_report_has_no_secret(tmp_path: Path, app: list[str]) -> None:
    running = Simulator(tmp_path, "--activated")
    report = tmp_path / "report.json"
    try:
        outcome = process(
            *("doctor", running.port, "--json", "--authority", "--report", str(report)), *app
        )
    finally:
        running.close()
    [found] = outcome.objects
    assert (outcome.status, found["ok"]) == (0, True)
    assert found["stages"][-1]["seen"] == "obtained, and given back at once"
    written = report.read_text(encoding="utf-8")
    assert json.loads(written)["stages"] == found["stages"]
    assert DEMO_KEY.reveal().hex() not in written.lower()
    assert "10086" not in written


@pytest.mark.pty
@pytest.mark.parametrize(
    ("options", "status", "stage", "seen"),
    [
        (("--baud", "115200"), 4, "frames", "at 230400 baud; at 115200 baud they are frames"),
        (("--mute",), 4, "bytes", "not one byte"),
        (("--inverted",), 4, "frames", "whose levels are inverted"),
        (("--deaf",), 4, "version", "no answer to a version query"),
        ((), 5, "activation", "it is not activated"),
        (("--cold", "--activated"), 6, "mode_switch", "it is in P"),
    ],
)
def test_what_is_wrong_is_found_over_a_port(
    tmp_path: Path, options: tuple[str, ...], status: int, stage: str, seen: str
) -> None:
    running = Simulator(tmp_path, *options)
    try:
        outcome = process("doctor", running.port, "--json")
    finally:
        running.close()
    [found] = outcome.objects
    assert (outcome.status, found["failed"], outcome.err) == (status, stage, "")
    assert seen in found["stages"][-1]["seen"]


@pytest.mark.pty
def test_another_program_has_the_port(simulator: Simulator) -> None:
    program = (
        f"f = open({simulator.port!r}); print('open', flush=True); import time; time.sleep(600)"
    )
    pipe = subprocess.PIPE
    other = subprocess.Popen([sys.executable, "-c", program], stdin=pipe, stdout=pipe)
    try:
        assert other.stdout is not None
        other.stdout.readline()
        outcome = process("doctor", simulator.port, "--json")
    finally:
        other.kill()
        other.communicate()
    assert outcome.status == 3
    last = outcome.objects[0]["stages"][-1]
    assert (last["stage"], last["commands"][0]) == ("owner", f"end it: kill {other.pid}")


@pytest.mark.pty
@pytest.mark.parametrize(
    ("key", "said"), [("y", "obtained, and given back"), ("n", "no stage found a fault")]
)
def test_a_person_is_asked_before_authority(
    tmp_path: Path, app: list[str], key: str, said: str
) -> None:
    running = Simulator(tmp_path, "--activated")
    terminal = Terminal("doctor", running.port, *app, columns=160)
    try:
        terminal.read_until("[y/N]")
        terminal.type(key + "\r")
        terminal.read_until(said)
        assert terminal.end() == 0
        assert ("obtained" in terminal.shown) is (key == "y")
    finally:
        terminal.close()
        running.close()


@pytest.mark.pty
@pytest.mark.parametrize("when", ["bytes arrive", "[y/N]"])
def test_ctrl_c_ends_it_at_once_at_the_question_too(
    tmp_path: Path, app: list[str], when: str
) -> None:
    running = Simulator(tmp_path, "--activated")
    terminal = Terminal("doctor", running.port, *app, columns=160)
    try:
        terminal.read_until(when)
        terminal.type("\x03")
        assert terminal.end() == 130
        assert "interrupted" in terminal.shown
        assert "Traceback" not in terminal.shown
    finally:
        terminal.close()
        running.close()


@pytest.mark.pty
def test_an_end_of_input_is_a_no(tmp_path: Path, app: list[str]) -> None:
    running = Simulator(tmp_path, "--activated")
    terminal = Terminal("doctor", running.port, *app, columns=160)
    try:
        terminal.read_until("[y/N]")
        terminal.type("\x04")
        assert terminal.end() == 0
        assert "it was not to be tried" in terminal.shown
    finally:
        terminal.close()
        running.close()


# -- ``m100link info`` and ``activate`` over a real pseudo-terminal. Real time ---------------------


@pytest.mark.pty
def test_info_tells_what_is_there(simulator: Simulator) -> None:
    outcome = process("info", simulator.port, "--json")
    assert (outcome.status, outcome.err) == (0, "")
    [described] = outcome.objects
    assert described["firmware"] == "1.0"
    assert described["firmware_is_forced"] is False
    assert described["activated"] is False
    assert described["version"].startswith("SDK-v1.0")
    assert described["telemetry"]["quaternion"] == NEARLY_100
    assert described["telemetry"]["rc"] == pytest.approx(50, rel=0.3)
    assert "magnetometer" not in described["telemetry"]
    assert described["telemetry_mismatches"] == 0
    assert described["line"]["discarded_bytes"] <= 200  # a port opened in the middle of a frame


@pytest.mark.pty
def test_info_of_later_firmware_and_with_a_forced_profile(tmp_path: Path) -> None:
    running = Simulator(tmp_path, "--firmware", "3.1")
    try:
        [described] = process("info", running.port, "--json", "--duration", "0.3").objects
        assert described["firmware"] == "3.1"
        assert len(described["serial"]) == 10
        [forced] = process(
            *("info", running.port, "--json", "--duration", "0.3", "--firmware", "2.3")
        ).objects
        assert forced["firmware"] == "2.3"
        assert forced["firmware_is_forced"] is True
        assert forced["telemetry_mismatches"] > 10
    finally:
        running.close()


@pytest.mark.pty
def test_activate_waits_for_the_server_and_a_second_time_is_success(
    simulator: Simulator, app: list[str]
) -> None:
    first = process("activate", simulator.port, *app)
    assert first.status == 0
    [told] = first.objects
    assert told["activated"] is True
    assert told["app_id"] == DEMO_APP_ID
    assert told["attempts"] == 2
    assert "attempt 1: first activation" in first.err
    assert "again in 2 s" in first.err
    second = process("activate", simulator.port, *app)
    assert second.objects[0]["attempts"] == 1
    [described] = process("info", simulator.port, "--json", "--duration", "0.1").objects
    assert described["activated"] is True


# -- ``m100link link``, on virtual time ------------------------------------------------------------


def test_the_line_is_measured(cli: CommandLine) -> None:
    url = "sim://?seed=1&delay=0.02&key=" + "5a" * 32
    outcome = cli("link", url, "--duration", "0.4", "--rate", "50")
    assert outcome.status == 0
    [found] = outcome.objects
    assert "5a5a" not in outcome.out
    assert found["asked"] >= 5
    assert found["unanswered"] == 0
    assert found["round_trips"]["count"] >= found["asked"]
    assert sum(found["round_trips"]["up_to_ms"].values()) == found["round_trips"]["count"]
    assert found["round_trips"]["mean_ms"] == pytest.approx(40.0, abs=0.1)  # there and back
    assert found["line"]["frames_received"] > 10
    assert found["telemetry"]["position"] is not None
    assert "round_trips" not in found["line"]


def test_people_get_tables_and_what_is_wrong(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    outcome = cli("link", "sim://?seed=1&damage=0.3", "--duration", "0.6", "--firmware", "3.1")
    assert outcome.status == 0
    assert "frame_crc" in outcome.out
    assert "answers after" in outcome.out
    assert "do not fit this firmware" in outcome.out
    assert "█" in outcome.out


@pytest.mark.parametrize("wrong", [("--rate", "0"), ("--duration", "-1")])
def test_what_cannot_be_measured_is_refused(cli: CommandLine, wrong: tuple[str, str]) -> None:
    assert cli("link", "sim://", *wrong).status == 2


# -- the first hour with an aircraft --------------------------------------------------------------


def test_a_report_of_the_doctor_overwrites_nothing(cli: CommandLine, tmp_path: Path) -> None:
    old = tmp_path / "report.json"
    old.write_text("{}", encoding="utf-8")
    outcome = cli("doctor", "sim://", "--report", str(old))
    assert (outcome.status, outcome.out) == (2, "")
    assert "is there already" in outcome.err.replace("\n", " ")
    assert old.read_text(encoding="utf-8") == "{}"
    outcome = cli("doctor", "sim://", "--report", str(tmp_path / "no" / "report.json"))
    assert (outcome.status, outcome.out) == (2, "")
    assert "cannot be written" in outcome.err.replace("\n", " ")


def test_a_first_contact_asks_reports_and_is_remembered(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    configuration_file: Path,
) -> None:
    asked: list[str] = []

    async def agree(text: str) -> bool:
        asked.append(text)
        return True

    monkeypatch.setattr(doctor_module, "_asked", agree)
    place = tmp_path / "first.json"
    url = "sim://?firmware=3.1&acceleration=raw"
    outcome = cli("first-contact", url, "--name", "lab", "--report", str(place))
    assert outcome.status == 0
    [found] = outcome.objects
    assert found["differences"] == ["acceleration"]
    assert "PROPELLERS OFF" in asked[0]
    obtained = outcome.err.index("control authority is OBTAINED; nothing moves")
    assert outcome.err.index("control authority is given back") > obtained
    written = place.read_text(encoding="utf-8")
    report = json.loads(written)
    assert {name: report[name] for name in found} == found
    assert report["line"] == "sim"
    for secret in (DEMO_KEY.reveal().hex(), str(DEMO_APP_ID), "22.5"):
        assert secret not in written
    assert 'acceleration = "raw"' in configuration_file.read_text(encoding="utf-8")
    assert cli("config", "lab").objects[0]["in_force"]["acceleration"]["value"] == "raw"


def test_what_cannot_be_kept_is_refused_before_the_first_question(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    async def nobody(_: str) -> bool:
        raise AssertionError("it was asked")

    monkeypatch.setattr(doctor_module, "_asked", nobody)
    old = tmp_path / "first.json"
    old.write_text("{}", encoding="utf-8")
    for wrong, why in (
        (("--name", "my lab"), "cannot be called"),
        (("--report", str(old)), "is there already"),
        (("--report", str(tmp_path / "none" / "first.json")), "cannot be written"),
    ):
        outcome = cli("first-contact", "sim://", *wrong)
        assert outcome.status == 2
        assert why in outcome.err.replace("\n", " ")
    assert old.read_text(encoding="utf-8") == "{}"


def test_a_report_that_fails_at_last_costs_the_configuration_nothing(
    cli: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    configuration_file: Path,
) -> None:
    place = tmp_path / "first.json"

    async def fill_the_disk(_: str) -> bool:
        place.mkdir()
        return False

    monkeypatch.setattr(doctor_module, "_asked", fill_the_disk)
    assert cli("first-contact", "sim://", "--name", "lab", "--report", str(place)).status == 2
    assert "[aircraft.lab]" in configuration_file.read_text(encoding="utf-8")


def test_a_line_that_goes_is_told_by_the_status(
    cli: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def meet(*_: object, **__: object) -> Contact:
        return Contact(ended_by="the line went away (LinkLost)", is_cut_off=True)

    monkeypatch.setattr(doctor_module, "meet", meet)
    assert cli("first-contact", "sim://").status == 4


@pytest.mark.pty
def test_ctrl_c_at_a_late_question_writes_what_was_found(tmp_path: Path) -> None:
    place = tmp_path / "first.json"
    command = ("first-contact", "sim://?acceleration=raw", "--report", str(place))
    with on_terminal(*command) as shown:
        shown.read_until("Is that done?")
        shown.type("y\n")
        shown.read_until("Is it up?")
        shown.type("\x03")
        shown.read_until("it ended early: it was interrupted")
        assert shown.end() == 130
    report = json.loads(place.read_text(encoding="utf-8"))
    assert (report["ended_by"], report["given_back"]) == ("it was interrupted", True)
    found = {one["topic"]: one["found"] for one in report["observations"]}
    assert found["acceleration"] == "raw"


def test_without_a_terminal_nothing_is_tried(cli: CommandLine) -> None:
    outcome = cli("first-contact", "sim://")
    assert "no terminal" in outcome.err.replace("\n", " ")
    [found] = outcome.objects
    assert found["ended_by"] == "the propellers may be on: nothing was tried"
    assert [one["topic"] for one in found["observations"]] == ["version"]
