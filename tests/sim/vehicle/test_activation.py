"""Registration and activation: each rule and each return code of document 2.2.1.1 and 2.2.1.2."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from m100link.protocol import (
    Activate,
    ActivationCode,
    Credentials,
    GetVersion,
    QueryTask,
    RequestAuthority,
    SendToMobile,
    SetTelemetryRates,
    StartTask,
    SystemCode,
)
from m100link.sim import DEMO_KEY, ActivationServer, VirtualAircraft
from m100link.wire import Cipher
from m100link.wire.crc import frame_crc32
from tests.sim.host import Host, aircraft

FIRMWARES = ["1.0", "2.3", "3.1", "1.0-document"]


# --- the codes ------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_code_0_success_loads_the_key(firmware: str) -> None:
    host = Host(firmware=firmware)
    host.activate()
    assert host.ask(RequestAuthority(True), encrypted=True) in (2, 3)


@pytest.mark.parametrize("size", [0, 40, 43, 45, 87])
def test_code_1_invalid_parameters_for_another_length(size: int) -> None:
    host = Host()
    ack = host.ask_raw(bytes(Activate.ADDRESS) + bytes(size))
    assert ack is not None
    assert ack.data == b"\x01\x00"


def test_code_2_encrypted_package_before_there_is_a_key() -> None:
    host = Host()
    request = host.activation()
    host.use_key(Cipher(DEMO_KEY))
    ack = host.ask_raw(request.encode(host.profile), encrypted=True)
    assert ack is not None
    assert ack.data == b"\x02\x00"
    assert not ack.encrypted


def test_code_2_encrypted_package_that_could_be_read() -> None:
    host = Host()
    host.activate()
    ack = host.ask_raw(host.activation().encode(host.profile), encrypted=True)
    assert ack is not None
    assert ack.data == b"\x02\x00"
    assert not ack.encrypted


def test_code_3_first_attempt_on_a_new_aircraft_then_0() -> None:
    host = Host()
    assert [host.ask(host.activation()) for _ in range(3)] == [3, 0, 0]


def test_code_3_as_long_as_the_server_takes() -> None:
    host = Host(aircraft(settings={"server_delay": 2.0}))
    codes = []
    for _ in range(5):
        codes.append(host.ask(host.activation()))
        host.wait(0.6)
    assert codes == [3, 3, 3, 3, 0]


def test_what_the_server_was_asked_before_a_restart_is_asked_anew() -> None:
    host = Host(aircraft(settings={"server_delay": 2.0}))
    assert host.ask(host.activation()) == ActivationCode.NEW_DEVICE
    host.aircraft.reboot()
    host.wait(4.0)  # it is silent for two seconds
    assert host.ask(host.activation()) == ActivationCode.NEW_DEVICE
    host.wait(2.5)
    assert host.ask(host.activation()) == ActivationCode.SUCCESS


def test_code_4_app_not_connected() -> None:
    host = Host()
    host.aircraft.disconnect_app()
    assert host.ask(host.activation()) == ActivationCode.APP_NOT_CONNECTED
    host.aircraft.connect_app()
    assert host.ask(host.activation()) == ActivationCode.NEW_DEVICE


def test_code_5_app_without_internet() -> None:
    host = Host()
    host.aircraft.connect_app(internet=False)
    assert host.ask(host.activation()) == ActivationCode.NO_INTERNET


def test_code_6_server_refuses_an_unknown_app_id() -> None:
    host = Host()
    assert host.ask(host.activation(app_id=4711)) == ActivationCode.NEW_DEVICE
    host.wait(5.0)
    assert host.ask(host.activation(app_id=4711)) == ActivationCode.SERVER_REFUSED


def test_an_unknown_app_gets_3_as_in_djis_own_test_though_another_is_active() -> None:
    host = Host()
    host.ask(host.activation())
    host.wait(5.0)
    assert host.ask(host.activation()) == ActivationCode.SUCCESS
    assert host.ask(host.activation(app_id=1000000)) == ActivationCode.NEW_DEVICE
    assert host.ask(host.activation()) == ActivationCode.SUCCESS


def test_unknown_apps_without_end_are_not_all_remembered() -> None:
    host = Host()
    for app_id in range(20_000, 20_040):
        host.ask(host.activation(app_id=app_id))
    host.wait(5.0)
    assert host.ask(host.activation(app_id=20_039)) == ActivationCode.SERVER_REFUSED
    assert host.ask(host.activation(app_id=20_000)) == ActivationCode.NEW_DEVICE


def test_code_6_server_refuses_everybody() -> None:
    host = Host()
    host.aircraft.server_refuses()
    assert host.ask(host.activation()) == ActivationCode.SERVER_REFUSED
    host.aircraft.server_refuses(False)
    assert host.ask(host.activation()) == ActivationCode.NEW_DEVICE


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_code_7_insufficient_level(firmware: str) -> None:
    host = Host(level=1, firmware=firmware)
    assert host.ask(host.activation(level=2)) == ActivationCode.LEVEL_TOO_HIGH
    assert host.ask(host.activation(level=1)) == ActivationCode.NEW_DEVICE


def test_code_7_level_that_does_not_exist() -> None:
    host = Host()
    assert host.ask(host.activation(level=3)) == ActivationCode.LEVEL_TOO_HIGH


def test_firmware_3_1_ignores_the_level_field() -> None:
    host = Host(firmware="3.1", level=1)
    assert host.ask(host.activation(level=2)) == ActivationCode.NEW_DEVICE
    assert host.ask(host.activation(level=0)) == ActivationCode.SUCCESS
    active = host.vehicle.activation.active
    assert active is not None
    assert active.level == 1


@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
def test_code_8_version_mismatch(firmware: str) -> None:
    host = Host(firmware=firmware)
    assert host.ask(host.activation(version=1)) == ActivationCode.VERSION_MISMATCH


@pytest.mark.parametrize("version", [0, 1, 0x02030A00, 0xFFFFFFFF])
def test_firmware_1_0_leaves_the_version_to_the_developer(version: int) -> None:
    host = Host()
    assert host.ask(host.activation(version=version)) == ActivationCode.NEW_DEVICE


@pytest.mark.parametrize("bundle_id", ["", "1234567890", "9" * 32, "0" * 32])
def test_any_bundle_id_is_accepted(bundle_id: str) -> None:
    host = Host(firmware="3.1")
    assert host.ask(host.activation(bundle_id=bundle_id)) == ActivationCode.NEW_DEVICE


@pytest.mark.parametrize(
    ("trouble", "code"),
    [
        ({"version": 1, "app": False, "server": False}, 8),
        ({"app": False, "internet": False, "server": False}, 4),
        ({"internet": False, "server": False}, 5),
        ({"server": False, "level": 2}, 6),
        ({"level": 2}, 7),
        ({}, 3),
    ],
)
def test_order_of_the_failure_codes(trouble: dict[str, Any], code: int) -> None:
    """The first fault is reported first: version, app, Internet, server, level, new aircraft."""
    host = Host(firmware="2.3", level=1)
    host.aircraft.connect_app(internet=trouble.get("internet", True))
    if not trouble.get("app", True):
        host.aircraft.disconnect_app()
    host.aircraft.server_refuses(not trouble.get("server", True))
    version = trouble.get("version", host.profile.activation_version)
    request = host.activation(version=version, level=trouble.get("level", 1))
    assert host.ask(request) == code


# --- registration ---------------------------------------------------------------------------


def test_app_id_key_and_level_come_from_the_registration() -> None:
    key = bytes(range(100, 132))
    host = Host(app_id=4711, key=key, level=1)
    host.activate(Credentials(4711, key, level=1))
    assert host.ask(RequestAuthority(True), encrypted=True) == SystemCode.LEVEL_TOO_LOW


def test_the_key_reaches_the_aircraft_by_the_app_and_never_over_the_line() -> None:
    host = Host().ready()
    host.wait(1.0)
    assert DEMO_KEY.reveal() not in bytes(host.wire)
    assert DEMO_KEY.reveal().hex().encode() not in bytes(host.wire)


def test_dan_each_new_autopilot_counts_once() -> None:
    server = ActivationServer()
    host = Host(server=server)
    host.activate()
    host.activate()
    assert len(server.apps[10086].autopilots) == 1
    Host(server=server, seed=2).activate()
    assert len(server.apps[10086].autopilots) == 2


def test_dan_at_the_limit_a_new_autopilot_is_refused_and_known_ones_go_on() -> None:
    server = ActivationServer()
    hosts = [Host(server=server, seed=seed) for seed in range(6)]
    for host in hosts[:5]:
        host.activate()
    sixth = hosts[5]
    assert [sixth.ask(sixth.activation()) for _ in range(2)] == [6, 6]
    hosts[0].aircraft.reboot()
    hosts[0].wait(3.0)
    hosts[0].activate()


def test_dan_limit_is_5_by_default_and_can_be_raised() -> None:
    server = ActivationServer()
    hosts = [Host(server=server, seed=seed) for seed in range(6)]
    assert server.apps[10086].device_limit == 5
    server.register(10086, DEMO_KEY, device_limit=6)
    for host in hosts:
        host.activate()


def test_serial_numbers_differ_by_seed_and_look_like_real_ones() -> None:
    numbers = {VirtualAircraft(seed=seed).vehicle.serial_number for seed in range(20)}
    assert len(numbers) == 20
    assert all(len(number) == 10 and number.startswith("041D") for number in numbers)


def test_registration_refuses_what_cannot_be() -> None:
    server = ActivationServer()
    with pytest.raises(ValueError, match="level"):
        server.register(1, DEMO_KEY, level=3)
    with pytest.raises(ValueError, match="32 bits"):
        server.register(1 << 32, DEMO_KEY)


@pytest.mark.parametrize(
    ("asks_version", "seconds"),
    [(False, 6.0), (True, 1.0)],
    ids=["activation alone", "version first"],
)
def test_the_sample_of_2015_started_three_times_activates_at_the_second(
    asks_version: bool, seconds: float
) -> None:
    """It begins each time with the same session and number, and gets its answer from no memory."""
    host = Host()
    request = host.activation().encode(host.profile)
    codes = []
    for _ in range(3):
        if asks_version:
            host.send(b"\x00\x00\x00", session=2, sequence=0)
        host.send(request, session=3, sequence=1)
        codes.append(host.acks(3, 1)[-1].data)
        host.wait(seconds)
    assert codes == [b"\x03\x00", b"\x00\x00", b"\x00\x00"]


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_aircraft_can_start_activated(firmware: str) -> None:
    host = Host(VirtualAircraft(firmware=firmware, activated=True))
    assert host.ask(GetVersion()).is_activated
    host.use_key(Cipher(DEMO_KEY))
    host.obtain()
    assert host.ask(host.activation(), encrypted=False) == ActivationCode.SUCCESS
    host.aircraft.reboot()
    host.wait(3.0)
    assert not host.ask(GetVersion()).is_activated
    assert host.ask(host.activation(), encrypted=False) == ActivationCode.SUCCESS


def test_an_app_that_the_server_refuses_cannot_be_active_from_the_start() -> None:
    server = ActivationServer()
    server.is_refusing = True
    with pytest.raises(ValueError, match="refuses"):
        VirtualAircraft(activated=True, server=server)
    aircraft = VirtualAircraft(level=1)
    aircraft.credentials = replace(aircraft.credentials, level=2)
    with pytest.raises(ValueError, match="does not cover the requested level"):
        aircraft.activate()


# --- version query --------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_the_version_query_shows_the_state_and_always_the_version(firmware: str) -> None:
    host = Host(firmware=firmware)
    before = host.ask(GetVersion())
    host.activate()
    after = host.ask(GetVersion())
    assert (before.code, after.code) == (0xFF01, 0)
    for version in (before, after):
        assert version.name == host.profile.version_name
        assert version.crc == frame_crc32(version.name.encode() + b"\0")
        assert (version.serial is not None) == (firmware == "3.1")


@pytest.mark.parametrize(
    ("firmware", "size"), [("1.0", 38), ("2.3", 38), ("3.1", 49), ("1.0-document", 38)]
)
def test_size_of_the_version_ack(firmware: str, size: int) -> None:
    ack = Host(firmware=firmware).ask_raw(b"\x00\x00\x00")
    assert ack is not None
    assert len(ack.data) == size


@pytest.mark.parametrize(
    ("firmware", "name", "crc"),
    [
        ("2.3", "SDK-v1.0 BETA M100-02.03.10.00", 0xD3D21804),
        ("3.1", "SDK-v1.0 BETA M100-03.01.01.00", 0xA6453AAC),
    ],
)
def test_version_names_and_checksums_of_real_aircraft(firmware: str, name: str, crc: int) -> None:
    version = Host(firmware=firmware).ask(GetVersion())
    assert (version.name, version.crc) == (name, crc)


@pytest.mark.parametrize("value", [b"", b"\x00", b"\x01", b"\xff", b"\x00\x00\x00"])
def test_any_value_of_the_version_query_is_accepted(value: bytes) -> None:
    ack = Host().ask_raw(b"\x00\x00" + value)
    assert ack is not None
    assert len(ack.data) == 38


# --- before activation, levels --------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [RequestAuthority(True), StartTask(1, 4), QueryTask(1), SendToMobile(b"x")]
)
def test_0xff01_before_activation(command: Any) -> None:
    assert Host().ask(command) == SystemCode.NOT_ACTIVATED


def test_before_activation_version_activation_rates_and_telemetry_work() -> None:
    host = Host(firmware="3.1")
    assert host.ask(GetVersion()) is not None
    assert host.ask(SetTelemetryRates({"battery": 10})) == 0
    host.wait(1.0)
    assert len(host.packets()) == 100
    assert host.ask(host.activation()) == 3


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("command", [RequestAuthority(True), StartTask(1, 4), QueryTask(1)])
def test_0xff02_when_the_level_is_too_low(level: int, command: Any) -> None:
    host = Host(level=level)
    host.activate()
    assert host.ask(command) == SystemCode.LEVEL_TOO_LOW


def test_level_0_may_send_to_the_mobile_device() -> None:
    host = Host(level=0)
    host.activate()
    assert host.ask(SendToMobile(b"x")) == 0


def test_movement_of_a_low_level_is_ignored_without_an_answer() -> None:
    host = Host(level=1)
    host.activate()
    assert host.ask_raw(b"\x01\x03" + bytes(17)) is None
    assert host.autopilot.counters.ignored_movements == 1


# --- again, after power-off -----------------------------------------------------------------


def test_activating_again_is_answered_0_even_without_the_app() -> None:
    host = Host()
    host.activate()
    host.aircraft.disconnect_app()
    assert host.ask(host.activation()) == 0


def test_another_app_replaces_the_active_one() -> None:
    host = Host()
    host.aircraft.server.register(2, bytes(32))
    host.activate()
    host.activate(Credentials(2, bytes(32)))
    active = host.vehicle.activation.active
    assert active is not None
    assert active.app_id == 2
    assert host.ask(RequestAuthority(True), encrypted=True) == 2


def test_reboot_ends_activation_but_the_aircraft_stays_known() -> None:
    host = Host()
    host.activate()
    host.aircraft.reboot()
    host.wait(3.0)
    host.decoder.cipher = None
    version = host.ask(GetVersion())
    assert version.code == 0xFF01
    host.aircraft.disconnect_app()
    assert host.ask(host.activation()) == 0


def test_a_changed_key_is_used_from_the_next_activation_on() -> None:
    host = Host().ready()
    host.aircraft.change_key(bytes(32))
    assert host.ask(QueryTask(9), encrypted=True) == 1
    host.activate(Credentials(10086, bytes(32)))
    assert host.ask(QueryTask(9), encrypted=True) == 1


# --- data to and from the mobile device -----------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 100])
def test_data_to_the_mobile_device_code_0(size: int) -> None:
    host = Host()
    host.activate()
    message = bytes(range(size))
    assert host.ask(SendToMobile(message)) == 0
    assert list(host.aircraft.app.received) == [message]


@pytest.mark.parametrize("size", [0, 101])
def test_data_to_the_mobile_device_of_impossible_length(size: int) -> None:
    host = Host()
    host.activate()
    ack = host.ask_raw(b"\x00\xfe" + bytes(size))
    assert ack is not None
    assert ack.data == b"\x00\xff"
    assert not host.aircraft.app.received


def test_data_to_an_app_that_is_not_there_are_lost_and_counted() -> None:
    host = Host()
    host.activate()
    host.aircraft.disconnect_app()
    assert host.ask(SendToMobile(b"x")) == 0
    assert host.aircraft.app.lost_messages == 1


def test_data_from_the_mobile_device_come_in_pieces_of_100_at_1_kb_per_s() -> None:
    host = Host()
    host.aircraft.send_from_mobile(bytes(range(250)))
    host.wait(1.0)
    pushes = host.pushes(0x02)
    assert b"".join(push.frame.data[2:] for push in pushes) == bytes(range(250))
    assert [len(push.frame.data) - 2 for push in pushes] == [100, 100, 50]
    assert {push.frame.session for push in pushes} == {0}
    assert pushes[1].time - pushes[0].time == pytest.approx(0.1, abs=0.051)
