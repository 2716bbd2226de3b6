"""RC lost, reboot, the pilot's sticks, the virtual remote control."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

import pytest

from m100link.protocol import Device, FlightPhase, RcMode, Setpoint, StartTask, Task
from m100link.protocol.firmware import profile
from m100link.protocol.records import RemoteControl
from m100link.sim import AircraftSettings, PilotRemote, Vehicle
from tests.sim.host import Host

NORTH = Setpoint.velocity(north=3, east=0, up=0, yaw_rate_deg_s=0)


def far(host: Host) -> Host:
    host.motion.place(100.0, 0.0, 30.0)
    return host


# --- RC lost --------------------------------------------------------------------------------


def test_rc_lost_for_3_s_goes_home_by_itself() -> None:
    host = far(Host().flying())
    host.aircraft.rc_lost()
    host.fly(NORTH, 2.8)
    assert host.device() is Device.ONBOARD, "not yet"
    host.wait(0.4)
    assert host.device() is Device.RC
    assert len(host.pushes(0x01)) == 1
    host.wait(60.0)
    assert host.phase() is FlightPhase.STANDBY
    assert host.motion.north == pytest.approx(0.0, abs=0.4)


def test_rc_lost_without_gps_lands_where_it_is() -> None:
    host = far(Host().flying())
    host.aircraft.gps_health = 0
    host.aircraft.rc_lost()
    host.wait(40.0)
    assert host.phase() is FlightPhase.STANDBY
    assert host.motion.north == pytest.approx(100.0, abs=1.0)


def test_rc_back_in_time_changes_nothing() -> None:
    host = far(Host().flying())
    host.aircraft.rc_lost()
    host.wait(2.0)
    host.aircraft.rc_back()
    host.wait(3.0)
    assert host.device() is Device.ONBOARD
    assert host.pushes(0x01) == []


def test_rc_back_ends_the_failsafe_and_f_gives_control_back() -> None:
    host = far(Host().flying())
    host.aircraft.rc_lost()
    host.wait(6.0)
    host.aircraft.rc_back()
    host.wait(0.2)
    assert host.device() is Device.ONBOARD
    assert host.phase() is FlightPhase.IN_AIR
    host.fly(NORTH, 6.0)
    assert host.motion.velocity_north == pytest.approx(3.0, abs=0.1)


def test_rc_lost_on_the_ground_takes_control_and_moves_nothing() -> None:
    host = Host().ready()
    host.aircraft.rc_lost()
    host.wait(5.0)
    assert host.ask(StartTask(1, Task.TAKE_OFF)) == 1
    assert not host.motion.motors_on


def test_a_lost_remote_reads_as_centred_sticks() -> None:
    remote = PilotRemote(RcMode.P)
    remote.move_stick(roll=1.0, throttle=-0.5)
    assert remote.channels() == (10000, 0, 0, -5000, -8000, -4545)
    remote.is_switched_on = False
    assert remote.channels() == (0, 0, 0, 0, -8000, -4545)


# --- sticks ---------------------------------------------------------------------------------


def test_the_pilot_flies_in_p() -> None:
    host = far(Host().flying())
    host.aircraft.leave_f()
    host.aircraft.move_stick(pitch=0.5, yaw=0.0)
    host.wait(5.0)
    assert host.motion.velocity_north == pytest.approx(5.0, abs=0.1)
    host.aircraft.release_sticks()
    host.wait(6.0)
    assert host.motion.speed < 0.02


def test_the_pilot_tilts_in_a() -> None:
    host = far(Host().flying())
    host.aircraft.set_rc_mode("A")
    host.aircraft.move_stick(roll=0.5, throttle=0.25)
    host.wait(1.0)
    assert host.motion.roll == pytest.approx(0.2618, abs=0.002)
    host.aircraft.move_stick(roll=0.0, pitch=0.5)
    host.wait(2.0)
    assert host.motion.pitch == pytest.approx(-0.2618, abs=0.002)
    assert host.motion.velocity_north > 3.0
    assert host.motion.velocity_up == pytest.approx(1.0, abs=0.1)


def test_sticks_do_nothing_while_the_onboard_device_is_in_control() -> None:
    host = far(Host().flying())
    host.aircraft.move_stick(pitch=1.0)
    host.wait(3.0)
    assert host.motion.speed < 0.02


def test_sticks_fly_in_f_without_onboard_control() -> None:
    host = Host()
    host.aircraft.pilot_takes_off()
    host.wait(6.0)
    host.aircraft.move_stick(roll=0.3)
    host.wait(4.0)
    assert host.motion.velocity_east == pytest.approx(3.0, abs=0.1)
    host.aircraft.release_sticks()
    host.aircraft.pilot_lands()
    host.wait(10.0)
    assert host.phase() is FlightPhase.STANDBY


@pytest.mark.parametrize("value", [-1.01, 1.5])
def test_a_stick_has_ends(value: float) -> None:
    remote = PilotRemote()
    with pytest.raises(ValueError, match="pitch stick"):
        remote.move_stick(pitch=value)


def test_the_corner_gesture_starts_and_stops_the_motors_on_the_ground() -> None:
    host = Host()
    corner = {"roll": -1.0, "pitch": -1.0, "throttle": -1.0, "yaw": 1.0}
    states = []
    for _ in range(2):
        host.aircraft.move_stick(**corner)
        host.wait(1.8)
        states.append(host.motion.motors_on)
        host.wait(3.0)
        states.append(host.motion.motors_on)
        host.aircraft.release_sticks()
        host.wait(0.2)
    assert states == [False, True, True, False]


# --- reboot ---------------------------------------------------------------------------------


def test_reboot_in_flight_is_silent_then_starts_afresh_in_the_air() -> None:
    host = far(Host().flying())
    silence_from = host.now
    host.aircraft.reboot()
    sequence = host.send(b"\x00\x00\x00", session=3)
    host.wait(1.9)
    assert host.acks(3, sequence) == []
    assert host.packets(silence_from) == []
    host.wait(0.5)
    times = [p.time.tick for p in host.packets(silence_from) if p.time]
    assert times
    assert times[0] < 200 * 6 + 10, "the clock began anew"
    assert host.phase() is FlightPhase.IN_AIR
    assert host.motion.height == pytest.approx(30.0, abs=0.1)
    assert host.vehicle.activation.active is None
    assert host.device() is Device.RC


def test_after_a_reboot_f_must_be_toggled_and_everything_done_again() -> None:
    host = far(Host().flying())
    host.aircraft.reboot()
    host.wait(3.0)
    host.activate()
    from m100link.protocol import RequestAuthority

    assert host.ask(RequestAuthority(True)) == 3
    host.aircraft.leave_f()
    host.aircraft.return_to_f()
    host.obtain()
    host.fly(NORTH, 3.0)
    assert host.motion.velocity_north > 2.0


# --- virtual remote control (firmware 3.1) --------------------------------------------------


def channels(
    *, roll: int = 1024, pitch: int = 1024, throttle: int = 1024, yaw: int = 1024, mode: int = 1552
) -> bytes:
    rest = [1024] * 9
    return b"\x05\x01" + struct.pack("<16I", roll, pitch, throttle, yaw, 1324, 1024, mode, *rest)


def virtual_rc(host: Host, seconds: float, **sticks: int) -> None:
    for _ in range(round(seconds / 0.05)):
        host.send(channels(**sticks), session=0)
        host.wait(0.05)


def flying_3_1() -> Host:
    host = far(Host(firmware="3.1").flying())
    host.send(b"\x05\x00\x03", session=0)
    return host


def virtual_is_on(host: Host) -> bool:
    return host.vehicle.remote.virtual.is_on


def test_virtual_rc_flies_and_needs_no_authority() -> None:
    host = flying_3_1()
    virtual_rc(host, 4.0, pitch=1024 + 330)
    assert host.motion.velocity_north == pytest.approx(5.0, abs=0.2)
    assert host.device() is Device.RC, "its switch is in P"


def test_virtual_rc_ends_1_s_after_the_last_data_and_the_real_one_flies() -> None:
    host = flying_3_1()
    virtual_rc(host, 1.0)
    assert host.device() is Device.RC
    host.wait(0.8)
    assert virtual_is_on(host)
    host.wait(0.4)
    assert not virtual_is_on(host)
    assert host.device() is Device.ONBOARD, "the real switch is in F"


def test_virtual_rc_without_fall_back_counts_as_rc_lost_when_the_data_stop() -> None:
    host = far(Host(firmware="3.1").flying())
    host.send(b"\x05\x00\x01", session=0)
    virtual_rc(host, 1.0)
    host.wait(1.0 + 2.5)
    assert not host.vehicle.authority.failsafe
    host.wait(1.0)
    assert host.vehicle.authority.failsafe


@pytest.mark.parametrize(("flags", "is_lost"), [(b"\x03", False), (b"\x01", True)])
def test_v1_the_first_data_have_a_second_too(flags: bytes, is_lost: bool) -> None:
    host = far(Host(firmware="3.1").flying())
    host.send(b"\x05\x00" + flags, session=0)
    host.wait(0.9)
    assert virtual_is_on(host)
    assert host.vehicle.remote.is_connected
    host.wait(0.3)
    assert virtual_is_on(host) is is_lost
    assert host.vehicle.remote.is_connected is not is_lost


def test_v1_control_and_switch_in_telemetry_with_any_authority() -> None:
    for begin in (Host.activate, Host.ready):
        host = Host(firmware="3.1")
        begin(host)
        host.aircraft.set_rates(control_device=50)
        host.send(b"\x05\x00\x03", session=0)
        virtual_rc(host, 0.5)
        shown = [p.control_device for p in host.packets() if p.control_device]
        assert (shown[-1].device, shown[-1].is_virtual_rc) == (Device.RC, True)
        host.wait(1.7)
        host.send(b"\x05\x00\x02", session=0)
        host.wait(0.1)
        shown = [p.control_device for p in host.packets() if p.control_device]
        assert not shown[-1].is_virtual_rc


def test_v2_settings_within_two_seconds_lock_it_until_a_restart() -> None:
    host = flying_3_1()
    virtual_rc(host, 1.9)
    host.send(b"\x05\x00\x02", session=0)
    assert host.vehicle.remote.virtual.is_locked
    host.aircraft.leave_f()
    host.aircraft.move_stick(pitch=1.0)
    host.wait(3.0)
    assert host.motion.speed < 0.1, "the real sticks and the mode switch do nothing"
    assert any("lock the autopilot" in entry.text for entry in host.vehicle.events)
    host.aircraft.reboot()
    host.wait(3.0)
    host.wait(3.0)
    assert host.motion.speed > 3.0


def test_v2_settings_every_two_seconds_are_fine() -> None:
    host = flying_3_1()
    for flags in (b"\x02", b"\x03", b"\x02"):
        virtual_rc(host, 2.0)
        host.send(b"\x05\x00" + flags, session=0)
    assert not host.vehicle.remote.virtual.is_locked


def test_v3_the_real_switch_leaving_f_ends_it() -> None:
    host = flying_3_1()
    virtual_rc(host, 1.0, pitch=1354)
    host.aircraft.leave_f()
    assert not virtual_is_on(host)
    virtual_rc(host, 4.0, pitch=1354)
    assert host.motion.speed < 0.1


@pytest.mark.parametrize(("value", "mode"), [(1552, RcMode.P), (1024, RcMode.A), (496, RcMode.F)])
def test_v3_the_mode_channel_acts_as_the_switch(value: int, mode: RcMode) -> None:
    host = flying_3_1()
    virtual_rc(host, 0.2, mode=value)
    assert host.vehicle.remote.sticks().mode is mode


@pytest.mark.parametrize(("value", "shown"), [(1324, -4545), (1684, -10_000)])
def test_v3_the_gear_channel_shows_in_telemetry(value: int, shown: int) -> None:
    """1684 is up and 1324 down; telemetry says −10000 and −4545."""
    host = flying_3_1()
    sent = struct.pack("<16I", *[1024] * 4, value, 1024, 1552, *[1024] * 9)
    host.send(b"\x05\x01" + sent, session=0)
    assert host.vehicle.remote.channels()[5] == shown


def test_v4_the_corner_for_two_seconds_starts_and_stops_the_motors_and_not_in_the_air() -> None:
    corner = {"roll": 364, "pitch": 364, "throttle": 364, "yaw": 1684}
    host = Host(firmware="3.1")
    host.activate()
    host.send(b"\x05\x00\x03", session=0)
    virtual_rc(host, 1.8, **corner)
    assert not host.motion.motors_on
    virtual_rc(host, 0.4, **corner)
    assert host.motion.motors_on
    virtual_rc(host, 0.2)
    virtual_rc(host, 2.2, **corner)
    assert not host.motion.motors_on
    host = flying_3_1()
    host.motion.place(0.0, 0.0, 100.0)
    virtual_rc(host, 3.0, **corner)
    assert host.motion.motors_on


def test_v4_a_lost_program_leaves_the_last_value_for_a_second() -> None:
    host = flying_3_1()
    virtual_rc(host, 3.0, pitch=1354)
    host.wait(0.9)
    assert host.motion.velocity_north > 4.0
    host.wait(4.0)
    assert host.motion.speed < 0.1


def test_k26_the_other_bits_of_the_settings_mean_nothing() -> None:
    host = far(Host(firmware="3.1").flying())
    host.send(b"\x05\x00\xff", session=0)
    virtual_rc(host, 0.5)
    assert virtual_is_on(host)
    host.wait(1.7)
    host.send(b"\x05\x00\xfe", session=0)
    assert not virtual_is_on(host)


def test_k27_channels_under_the_id_of_the_settings_do_nothing() -> None:
    host = flying_3_1()
    virtual_rc(host, 2.1)
    for _ in range(20):
        host.send(b"\x05\x00" + channels(pitch=1684)[2:], session=0)
        host.wait(0.1)
    assert not host.vehicle.remote.virtual.is_locked
    assert not virtual_is_on(host), "no data came for two seconds"
    assert host.motion.speed < 0.1


def test_k31_without_a_remote_only_the_virtual_one_controls() -> None:
    host = far(Host(firmware="3.1").flying())
    host.aircraft.rc_lost()
    host.wait(4.0)
    assert host.device() is Device.RC
    host.send(b"\x05\x00\x03", session=0)
    virtual_rc(host, 1.0)
    assert not host.vehicle.authority.failsafe
    virtual_rc(host, 4.0, pitch=1354)
    assert host.motion.speed == pytest.approx(5.0, abs=0.3)


def test_virtual_rc_in_f_position_lets_the_api_fly() -> None:
    host = far(Host(firmware="3.1").flying())
    host.aircraft.leave_f()
    host.wait(0.1)
    assert host.device() is Device.RC
    host.send(b"\x05\x00\x03", session=0)
    virtual_rc(host, 0.5, mode=496)
    assert host.device() is Device.ONBOARD


def test_virtual_rc_shows_in_telemetry() -> None:
    host = flying_3_1()
    host.aircraft.set_rates(control_device=50)
    virtual_rc(host, 0.5, roll=364, throttle=1684)
    packet = next(p for p in reversed(host.packets()) if p.control_device and p.remote_control)
    assert packet.remote_control is not None
    assert packet.control_device is not None
    assert packet.remote_control[:4] == (-10000, 0, 0, 10000)
    assert packet.remote_control.mode_switch is RcMode.P
    assert packet.control_device.is_virtual_rc


def test_virtual_rc_data_without_switching_it_on_do_nothing() -> None:
    host = far(Host(firmware="3.1").flying())
    virtual_rc(host, 1.0, pitch=1684)
    assert host.motion.speed < 0.02


@pytest.mark.parametrize("data", [b"\x05\x00", b"\x05\x00\x01\x01", b"\x05\x01" + bytes(63)])
def test_malformed_virtual_rc_is_ignored(data: bytes) -> None:
    host = far(Host(firmware="3.1").flying())
    host.send(data, session=2)
    assert not virtual_is_on(host)


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_virtual_rc_is_unknown_before_3_1(firmware: str) -> None:
    host = Host(firmware=firmware)
    ack = host.ask_raw(b"\x05\x00\x01")
    assert ack is not None
    assert ack.data == b"\x00\xff"


@pytest.mark.parametrize(
    ("reads", "channels"), [("zeros", (0,) * 6), ("kept", (0, 0, 0, 0, 8000, -4545))]
)
def test_the_channels_of_a_remote_control_that_is_off(reads: Any, channels: Any) -> None:
    vehicle = Vehicle(Random(1), profile("3.1"), settings=AircraftSettings(rc_lost_reads=reads))
    vehicle.remote.set_mode("F")
    read = vehicle.sensors.reader("rc")
    assert read() == (0, 0, 0, 0, 8000, -4545)
    vehicle.remote.is_switched_on = False
    assert read() == channels
    assert RemoteControl(*map(int, read())).is_heard is (reads == "kept")
