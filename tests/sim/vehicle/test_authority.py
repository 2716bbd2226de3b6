"""Control priority and the rules of control authority (document 2.2.2.1, 2.2.3.2)."""

from __future__ import annotations

import pytest

from m100link.protocol import Device, RequestAuthority, Setpoint
from m100link.sim import VirtualAircraft
from tests.sim.host import Host, aircraft

ONE, TWO, BOTH = ["1.0", "1.0-document"], ["2.3", "3.1"], ["1.0", "2.3", "3.1"]
OBTAIN, RELEASE = RequestAuthority(True), RequestAuthority(False)


def active(firmware: str = "1.0", virtual: VirtualAircraft | None = None) -> Host:
    host = Host(virtual, firmware=firmware) if virtual is None else Host(virtual)
    host.activate()
    return host


def holder(host: Host) -> Device:
    """Who the control device item says is in control."""
    host.aircraft.set_rates(control_device=100)
    host.wait(0.05)
    item = host.packets()[-1].control_device
    assert item is not None
    assert item.device is not None
    return item.device


# --- the codes ------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ONE)
def test_code_2_obtained_with_one_request_in_1_0(firmware: str) -> None:
    host = active(firmware)
    assert host.ask(OBTAIN) == 2
    assert holder(host) is Device.ONBOARD


@pytest.mark.parametrize("firmware", TWO)
def test_code_3_then_2_two_requests_from_2_3_on(firmware: str) -> None:
    host = active(firmware)
    assert host.ask(OBTAIN) == 3
    assert holder(host) is Device.RC
    assert host.ask(OBTAIN) == 2
    assert holder(host) is Device.ONBOARD


@pytest.mark.parametrize("firmware", ONE)
def test_code_1_released_with_one_request_in_1_0(firmware: str) -> None:
    host = active(firmware)
    host.obtain()
    assert host.ask(RELEASE) == 1
    assert holder(host) is Device.RC


@pytest.mark.parametrize("firmware", TWO)
def test_code_4_then_1_two_requests_release_from_2_3_on(firmware: str) -> None:
    host = active(firmware)
    host.obtain()
    assert [host.ask(RELEASE), host.ask(RELEASE)] == [4, 1]
    assert holder(host) is Device.RC


@pytest.mark.parametrize("firmware", BOTH)
def test_releasing_what_is_not_held_is_answered_1(firmware: str) -> None:
    assert active(firmware).ask(RELEASE) == 1


@pytest.mark.parametrize("firmware", BOTH)
def test_obtaining_what_is_held_is_answered_2(firmware: str) -> None:
    host = active(firmware)
    host.obtain()
    assert host.ask(OBTAIN) == 2


@pytest.mark.parametrize("mode", ["P", "A"])
def test_code_3_not_in_f_in_1_0(mode: str) -> None:
    host = active()
    host.aircraft.set_rc_mode(mode)
    assert host.ask(OBTAIN) == 3


@pytest.mark.parametrize("firmware", TWO)
def test_code_0_not_in_f_from_2_3_on(firmware: str) -> None:
    host = active(firmware)
    host.aircraft.leave_f()
    assert [host.ask(OBTAIN), host.ask(OBTAIN)] == [0, 0]


@pytest.mark.parametrize("refusing", ["the mode switch", "the app"])
@pytest.mark.parametrize("firmware", TWO)
def test_a_request_that_was_refused_is_not_the_first_of_two(firmware: str, refusing: str) -> None:
    host = active(firmware)
    if refusing == "the app":
        assert host.aircraft.app_takes_control()
    else:
        host.aircraft.leave_f()
    assert host.ask(OBTAIN) not in (2, 3)
    host.aircraft.app_releases_control()
    host.aircraft.set_rc_mode("F")
    assert [host.ask(OBTAIN), host.ask(OBTAIN)] == [3, 2]


def test_code_3_mobile_holds_control_in_1_0() -> None:
    host = active()
    assert host.aircraft.app_takes_control()
    assert host.ask(OBTAIN) == 3
    assert holder(host) is Device.APP


@pytest.mark.parametrize(("firmware", "code"), [("1.0", 3), ("2.3", 0xC9), ("3.1", 3)])
def test_ioc_keeps_the_api_out_before_3_1(firmware: str, code: int) -> None:
    """Code 3 of firmware 3.1 is the ordinary "in progress"."""
    host = active(firmware)
    host.aircraft.set_ioc()
    assert host.ask(OBTAIN) == code
    assert host.ask(OBTAIN) == (2 if firmware == "3.1" else code)


@pytest.mark.parametrize(("firmware", "code"), [("1.0", 3), ("2.3", 0), ("3.1", 0)])
def test_enable_api_control_must_be_ticked(firmware: str, code: int) -> None:
    host = active(firmware)
    host.aircraft.enable_api(False)
    assert host.ask(OBTAIN) == code


@pytest.mark.parametrize("value", [b"", b"\x02", b"\xff", b"\x01\x00"])
@pytest.mark.parametrize(("firmware", "code"), [("1.0", 3), ("2.3", 0)])
def test_a_request_that_is_none_changes_nothing(firmware: str, code: int, value: bytes) -> None:
    host = active(firmware)
    ack = host.ask_raw(b"\x01\x00" + value)
    assert ack is not None
    assert int.from_bytes(ack.data, "little") == code
    assert holder(host) is Device.RC


def test_a_pending_request_is_forgotten_when_f_is_left() -> None:
    host = active("3.1")
    assert host.ask(OBTAIN) == 3
    host.aircraft.leave_f()
    host.aircraft.return_to_f()
    assert host.ask(OBTAIN) == 3


# --- the F position -------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.0", "2.3"])
def test_f_at_power_on_needs_a_toggle(firmware: str) -> None:
    host = active(firmware)
    host.aircraft.remote.moved_since_power_on = False
    code = host.ask(OBTAIN)
    assert code == (3 if firmware == "1.0" else 0)
    host.aircraft.leave_f()
    host.aircraft.return_to_f()
    host.obtain()


def test_f_at_power_on_counts_at_once_in_3_1() -> None:
    host = active("3.1")
    host.aircraft.remote.moved_since_power_on = False
    host.obtain()


@pytest.mark.parametrize("firmware", BOTH)
@pytest.mark.parametrize("mode", ["P", "A"])
def test_leaving_f_ends_api_control_at_once_and_sends_0x02_0x01(firmware: str, mode: str) -> None:
    host = Host(firmware=firmware).flying()
    assert holder(host) is Device.ONBOARD
    host.aircraft.set_rc_mode(mode)
    host.wait(0.01)
    (push,) = host.pushes(0x01)
    assert push.frame.data == b"\x02\x01\x04"
    assert push.frame.session == 0
    assert holder(host) is Device.RC


@pytest.mark.parametrize("firmware", BOTH)
def test_coming_back_to_f_needs_no_new_request(firmware: str) -> None:
    host = Host(firmware=firmware).flying()
    host.aircraft.leave_f()
    host.wait(1.0)
    host.aircraft.return_to_f()
    host.wait(0.05)
    assert holder(host) is Device.ONBOARD
    assert len(host.pushes(0x01)) == 1, "coming back is not notified"
    before = host.motion.north
    host.fly(Setpoint.velocity(north=2, east=0, up=0, yaw_rate_deg_s=0), 3.0)
    assert host.motion.north > before + 2.0


def test_own_release_is_not_notified() -> None:
    host = Host().ready()
    host.ask(RELEASE)
    host.wait(1.0)
    assert host.pushes(0x01) == []


def test_unticking_api_control_and_ioc_take_authority_away() -> None:
    for method, value in (("enable_api", False), ("set_ioc", True)):
        host = Host().ready()
        getattr(host.aircraft, method)(value)
        host.wait(0.02)
        assert len(host.pushes(0x01)) == 1
        assert holder(host) is Device.RC


def test_notification_on_session_2_is_repeated_until_it_is_acknowledged() -> None:
    from m100link.wire import encode_frame

    host = Host(aircraft(settings={"authority_push_session": 2})).ready()
    host.aircraft.leave_f()
    host.wait(1.7)
    pushes = host.pushes(0x01)
    assert len(pushes) == 4
    assert len({push.frame.sequence for push in pushes}) == 1
    assert pushes[0].frame.session == 2
    sequence = pushes[0].frame.sequence
    host.send_raw(encode_frame(b"\0\0", session=2, sequence=sequence, is_ack=True))
    host.wait(3.0)
    assert len(host.pushes(0x01)) == 4


def test_notification_on_session_2_is_given_up_in_the_end() -> None:
    host = Host(aircraft(settings={"authority_push_session": 2})).ready()
    host.aircraft.leave_f()
    host.wait(20.0)
    assert len(host.pushes(0x01)) == 10


# --- the mobile app -------------------------------------------------------------------------


def test_the_app_interrupts_onboard_control() -> None:
    host = Host().flying()
    assert host.aircraft.app_takes_control()
    host.wait(0.02)
    assert len(host.pushes(0x01)) == 1
    assert holder(host) is Device.APP


def test_after_the_app_a_new_request_is_needed() -> None:
    host = Host().flying()
    host.aircraft.app_takes_control()
    host.aircraft.app_releases_control()
    assert holder(host) is Device.RC
    host.obtain()


def test_after_the_app_control_may_come_back_by_itself() -> None:
    virtual = aircraft(settings={"authority_resumes_after_app": True})
    host = Host(virtual).flying()
    virtual.app_takes_control()
    assert holder(host) is Device.APP
    virtual.app_releases_control()
    assert holder(host) is Device.ONBOARD


def test_the_app_cannot_take_control_out_of_f_or_unplugged() -> None:
    host = active()
    host.aircraft.leave_f()
    assert not host.aircraft.app_takes_control()
    host.aircraft.return_to_f()
    host.aircraft.disconnect_app()
    assert not host.aircraft.app_takes_control()


def test_rc_goes_before_the_app_too() -> None:
    host = active()
    host.aircraft.app_takes_control()
    host.aircraft.leave_f()
    assert holder(host) is Device.RC


def test_control_of_an_app_that_is_unplugged_goes_back() -> None:
    host = active()
    host.aircraft.app_takes_control()
    host.aircraft.disconnect_app()
    assert holder(host) is Device.RC


# --- movement without authority -------------------------------------------------------------


def test_movement_is_ignored_while_the_app_or_the_pilot_flies() -> None:
    host = Host().flying()
    setpoint = Setpoint.velocity(north=3, east=0, up=0, yaw_rate_deg_s=0)
    for take in (host.aircraft.leave_f, host.aircraft.app_takes_control):
        host.aircraft.return_to_f()
        take()
        host.wait(2.0)
        place = host.motion.north
        host.fly(setpoint, 2.0)
        assert host.motion.north == pytest.approx(place, abs=0.05)


# --- the control device item ----------------------------------------------------------------


@pytest.mark.parametrize("firmware", BOTH)
def test_control_device_item_tells_the_truth_throughout(firmware: str) -> None:
    host = active(firmware)
    seen = [holder(host)]
    host.obtain()
    seen.append(holder(host))
    host.aircraft.leave_f()
    seen.append(holder(host))
    host.aircraft.return_to_f()
    seen.append(holder(host))
    host.aircraft.app_takes_control()
    seen.append(holder(host))
    host.aircraft.app_releases_control()
    seen.append(holder(host))
    rc, app, onboard = Device
    assert seen == [rc, onboard, rc, onboard, app, rc]


@pytest.mark.parametrize("firmware", TWO)
def test_request_bit_of_the_control_device_item(firmware: str) -> None:
    host = active(firmware)
    host.aircraft.set_rates(control_device=100)
    bits = []
    for act in (None, host.obtain, host.aircraft.leave_f):
        if act is not None:
            act()
        host.wait(0.05)
        item = host.packets()[-1].control_device
        assert item is not None
        bits.append(item.is_requested)
    assert bits == [False, True, True]


def test_control_device_item_of_1_0_is_a_number() -> None:
    host = Host().ready()
    host.aircraft.set_rates(control_device=100)
    host.wait(0.05)
    item = host.packets()[-1].control_device
    assert item is not None
    assert item.control == 2


# --- cold start -----------------------------------------------------------------------------


def test_cold_start_needs_everything_done_in_order() -> None:
    virtual = VirtualAircraft(cold=True)
    host = Host(virtual)
    assert virtual.gps_health == 0
    assert host.ask(host.activation()) == 4
    virtual.connect_app()
    host.activate()
    assert host.ask(OBTAIN) == 3
    virtual.enable_api()
    assert host.ask(OBTAIN) == 3
    virtual.set_rc_mode("F")
    assert host.ask(OBTAIN) == 2
    host.wait(31.0)
    assert virtual.gps_health == 5
