"""Obtaining authority: what is lost meanwhile is not forgotten, and a refusal names what is so."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

import m100link
from m100link import AuthorityLost, AuthorityRefused, AuthorityState
from m100link.flight.handover import obtain_authority, release_authority
from m100link.flight.tasks import Commander
from m100link.protocol.codes import AuthorityCode
from m100link.protocol.commands.control import RequestAuthority
from m100link.sim import NO_FAULTS, AircraftSettings, AssistantSettings, LineFaults
from tests.flight.foreign_aircraft import APP_ID, KEY, foreign_aircraft
from tests.rig import FIRMWARES, NORTH, Rig, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


async def put_into_the_air(flown: Rig) -> None:
    async with flown.aircraft.control() as control:
        await control.take_off()


async def lose_the_ack(flown: Rig) -> None:
    """The ack "obtained" does not arrive, and before the request is repeated the pilot leaves F."""
    if flown.aircraft.firmware.authority_requests > 1:
        await asyncio.sleep(0.02)  # the answer to the first request arrives
    flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=NO_FAULTS)
    await asyncio.sleep(0.1)
    flown.virtual.set_faults()
    flown.virtual.leave_f()


async def read_all_at_once(flown: Rig) -> None:
    """The ack "obtained", the notification and the first package without F are one read."""
    if flown.aircraft.firmware.authority_requests > 1:
        await asyncio.sleep(0.02)
    flown.virtual.line.stall(to_host=True, to_aircraft=False)
    await asyncio.sleep(0.1)
    flown.virtual.leave_f()
    await asyncio.sleep(0.05)
    flown.virtual.stall_line(False)


@each_firmware
@pytest.mark.parametrize("meanwhile", [lose_the_ack, read_all_at_once])
async def test_a_loss_that_comes_before_the_ack_is_not_forgotten(
    firmware: str, meanwhile: object
) -> None:
    async with rig(firmware=firmware) as flown:
        await put_into_the_air(flown)
        flown.moves.clear()
        trouble = asyncio.create_task(meanwhile(flown))  # type: ignore[operator]
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                await asyncio.wait_for(flown.fly_on(control), 5.0)
        await trouble
        assert caught.value.reason == "mode_switch"
        flown.virtual.return_to_f()
        await flown.assert_hovers()
        assert len(flown.moves) == 0


@each_firmware
@pytest.mark.parametrize("meanwhile", [lose_the_ack, read_all_at_once])
async def test_by_hand_a_loss_before_the_ack_is_raised_once_the_aircraft_is_released(
    firmware: str, meanwhile: object
) -> None:
    async with rig(firmware=firmware) as flown:
        await put_into_the_air(flown)
        flown.moves.clear()
        trouble = asyncio.create_task(meanwhile(flown))  # type: ignore[operator]
        with pytest.raises(AuthorityLost) as caught:
            await flown.aircraft.control().obtain()
        assert caught.value.reason == "mode_switch"
        assert flown.is_released
        await trouble
        assert len(flown.moves) == 0


@each_firmware
async def test_a_block_that_waits_for_the_pilot_hears_of_a_loss_before_the_ack(
    firmware: str,
) -> None:
    async with rig(firmware=firmware) as flown:
        await put_into_the_air(flown)
        trouble = asyncio.create_task(lose_the_ack(flown))
        async with flown.aircraft.control(on_pause="wait") as control:
            await trouble
            assert (control.is_paused, control.has_authority) == (True, False)
            flown.virtual.return_to_f()
            await control.wait_resumable()
            await asyncio.sleep(1.0)
            control.resume()
            await flown.fly(control, 1.0)
            assert flown.speed > 1.0


@each_firmware
@pytest.mark.parametrize("item", ["rc", "control_device"])
async def test_authority_that_an_item_denies_ends_the_block_although_no_change_was_seen(
    firmware: str, item: str
) -> None:
    """The notification is lost, and the item comes for the first time after the pilot left F."""
    assistant = AssistantSettings(rates_hz={"rc": 0})
    async with rig(firmware=firmware, assistant=assistant) as flown:
        await put_into_the_air(flown)
        flown.moves.clear()
        began_at = flown.now
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=NO_FAULTS)
                flown.virtual.leave_f()
                flown.virtual.set_rates(**{item: 50})
                await asyncio.sleep(0.05)
                flown.virtual.set_faults()
                await asyncio.wait_for(flown.fly_on(control), 5.0)
        assert caught.value.reason == "mode_switch"
        assert flown.moves.times[-1] < began_at + 0.5
        flown.virtual.return_to_f()
        await flown.assert_hovers()


@each_firmware
async def test_the_items_do_not_end_a_block_that_has_authority(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.set_rates(control_device=1)
        async with flown.aircraft.control() as control:
            await control.take_off()
            await flown.fly(control, 3.0)
        await flown.assert_hovers()


@each_firmware
async def test_a_listener_that_fails_does_not_keep_a_loss_from_the_block(
    firmware: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Else the block would fly on, untold, when the pilot comes back."""

    def explode(*_: object) -> None:
        raise ZeroDivisionError("a bug of the program")

    async with rig(firmware=firmware) as flown:
        flown.aircraft.authority.subscribe(explode)
        with pytest.raises(AuthorityLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                control.send(NORTH, lifetime=1.0)
                flown.virtual.leave_f()
                await asyncio.sleep(0.2)
                flown.virtual.return_to_f()
                await asyncio.sleep(5.0)
                pytest.fail("went on")
        assert "a listener of authority failed" in caplog.text
        await flown.assert_hovers()


# -- releases -------------------------------------------------------------------------------------


@each_firmware
@pytest.mark.parametrize("is_heard", [False, True])
async def test_a_release_without_an_answer_leaves_a_state_that_says_so(
    firmware: str, is_heard: bool
) -> None:
    """Nothing tells a lost request from a lost answer. Each is awaited twice 0.4 s."""
    async with rig(firmware=firmware) as flown:
        async with flown.aircraft.control():
            faults = LineFaults(loss=1.0)
            flown.virtual.set_faults(faults, to_aircraft=NO_FAULTS if is_heard else faults)
            left_at = flown.now
        requests = 1 if firmware == "1.0" else 2  # 50 ms apart
        assert flown.now - left_at == pytest.approx(0.8 * requests + 0.05 * (requests - 1))
        flown.virtual.set_faults()
        states = [flown.aircraft.authority.state]
        assert flown.is_released is is_heard
        assert await flown.aircraft.release_authority()
        states.append(flown.aircraft.authority.state)
        assert states == [AuthorityState.UNRELEASED, AuthorityState.NONE]
        assert flown.is_released
        async with flown.aircraft.control():
            pass
        assert flown.is_released


@each_firmware
@pytest.mark.parametrize("code", [AuthorityCode.NOT_IN_F, AuthorityCode.RELEASING])
async def test_a_release_that_is_answered_with_something_else_is_none(
    firmware: str, code: AuthorityCode, caplog: pytest.LogCaptureFixture
) -> None:
    async with rig(firmware=firmware) as flown:
        async with flown.aircraft.control():
            handlers = flown.virtual.autopilot._commands._handlers
            known = handlers[RequestAuthority]
            handlers[RequestAuthority] = lambda _: code
        assert flown.aircraft.authority.state is AuthorityState.UNRELEASED
        assert f"may not be released: code 0x{code:04X}" in caplog.text
        handlers[RequestAuthority] = known
        assert await flown.aircraft.release_authority()


class Slow:
    """Firmware that wants two requests, and an answer to each that comes after a while."""

    firmware = SimpleNamespace(authority_requests=2)
    knows_firmware = True

    def __init__(self, code: AuthorityCode, after: float) -> None:
        self._code = code
        self._after = after

    async def execute(self, _: object, **__: object) -> AuthorityCode:
        await asyncio.sleep(self._after)
        return self._code


@pytest.mark.parametrize("slack_s", [0.0, 0.4])
async def test_a_release_that_is_put_off_again_and_again_ends_after_two_seconds(
    slack_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    """Two requests may each take the slack of a slow line besides."""
    async with rig() as flown:
        await obtain_authority(flown.aircraft._commander)
        slow = Slow(AuthorityCode.RELEASING, after=0.35)
        link = SimpleNamespace(latency=SimpleNamespace(slack_s=slack_s))
        parts = SimpleNamespace(requests=slow, authority=flown.aircraft.authority, link=link)
        start = flown.now
        assert not await release_authority(cast(Commander, parts))
        assert flown.now - start == pytest.approx(2.0 + 2 * slack_s, abs=0.01)
        assert flown.aircraft.authority.state is AuthorityState.UNRELEASED
        assert "may not be released" in caplog.text


async def test_a_request_for_authority_that_is_lost_is_repeated_after_half_a_second() -> None:
    async with rig() as flown:
        flown.virtual.set_faults(NO_FAULTS, to_aircraft=LineFaults(loss=1.0))
        start = flown.now
        asyncio.get_running_loop().call_later(0.1, flown.virtual.set_faults)
        await obtain_authority(flown.aircraft._commander)
        assert flown.now - start == pytest.approx(0.55, abs=0.1)
        assert await flown.aircraft.release_authority()


# -- refusals -------------------------------------------------------------------------------------


async def refusal(flown: Rig) -> AuthorityRefused:
    await asyncio.sleep(0.1)
    with pytest.raises(AuthorityRefused) as caught:
        async with flown.aircraft.control():
            pytest.fail("entered")
    return caught.value


@each_firmware
async def test_a_refusal_in_f_lists_what_it_can_be_and_not_the_switch(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.enable_api(False)
        error = await refusal(flown)
        assert "mode switch F" in error.seen
        assert "not in F" not in str(error)
        assert "API control" in error.cause
        assert "enable API control" in error.remedy
        assert "mobile app" in error.cause
        # From 2.3 on there is a code of its own for it; the profile of 3.1 allows IOC.
        assert ("IOC" in error.cause) == (firmware == "1.0")
        assert ("power-on" in error.cause) == flown.aircraft.firmware.needs_f_toggle


@each_firmware
async def test_a_refusal_outside_f_begins_with_the_switch_where_it_stands(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.leave_f()
        error = await refusal(flown)
        assert error.cause.startswith("the mode switch is in P, not in F")
        assert error.remedy.startswith("move the mode switch to F")
        assert "power-on" not in error.cause


@each_firmware
async def test_a_refusal_tells_a_charge_at_which_nothing_flies(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.enable_api(False)
        for percent, is_told in ((11, False), (10, True), (9, True)):
            flown.virtual.battery_percent = percent
            await asyncio.sleep(1.5)
            error = await refusal(flown)
            assert error.cause.startswith(f"the battery is at {percent} %") is is_told
            assert "API control" in error.cause  # no charge hides what else it can be


@each_firmware
async def test_a_remote_control_that_is_off_is_among_what_it_can_be(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.remote.is_switched_on = False
        await asyncio.sleep(5.0)
        error = await refusal(flown)
        assert "mode switch unknown" in error.seen  # all channels read 0
        assert error.cause == "the remote control is off or out of reach"


@pytest.mark.parametrize(
    ("reads", "why"), [("zeros", "not heard any more"), ("kept", "authority passed away")]
)
async def test_a_remote_control_that_is_lost_in_flight_is_not_a_switch_that_was_moved(
    reads: Any, why: str
) -> None:
    async with rig(firmware="3.1", settings=AircraftSettings(rc_lost_reads=reads)) as flown:
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                flown.virtual.rc_lost()
                await asyncio.sleep(30.0)
        assert why in caught.value.seen
        assert "moved the mode switch" not in str(caught.value)


@each_firmware
@pytest.mark.parametrize("percent", [22, 9, 1])
async def test_a_low_battery_is_no_reason_by_itself(firmware: str, percent: int) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.battery_percent = percent
        await asyncio.sleep(1.5)
        async with flown.aircraft.control() as control:
            assert control is not None


async def test_a_refusal_without_an_rc_item_lists_everything() -> None:
    async with rig(assistant=AssistantSettings(rates_hz={"rc": 0}, ioc_on=True)) as flown:
        error = await refusal(flown)
        assert "mode switch unknown" in error.seen
        for part in ("not in F", "power-on", "API control", "IOC", "mobile app"):
            assert part in error.cause


@each_firmware
async def test_an_app_that_is_seen_to_hold_control_is_the_cause(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.set_rates(control_device=10)
        flown.virtual.app_takes_control()
        error = await refusal(flown)
        assert error.cause == "the mobile app holds control"
        assert error.remedy == "let the mobile app release control"


async def test_an_app_that_is_seen_not_to_hold_control_is_not_the_cause() -> None:
    async with rig() as flown:
        flown.virtual.set_rates(control_device=10)
        flown.virtual.enable_api(False)
        assert "app" not in (await refusal(flown)).cause.replace("DJI app", "")


@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
async def test_ioc_has_a_code_of_its_own_from_2_3_on(firmware: str) -> None:
    async with rig(firmware=firmware, assistant=AssistantSettings(ioc_on=True)) as flown:
        if not flown.aircraft.firmware.ioc_must_be_off:
            return
        error = await refusal(flown)
        assert "IOC is on" in error.seen
        assert error.remedy == "turn IOC off in the DJI app"


@pytest.mark.pty
@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("happening", ["lost ack", "one read"])
def test_against_a_foreign_aircraft_a_loss_before_the_ack_is_not_forgotten(
    firmware: str, happening: str
) -> None:
    async def fly(port: str) -> None:
        async with m100link.connect(port) as aircraft:
            await aircraft.activate(m100link.Credentials(app_id=APP_ID, key=KEY))
            await aircraft.wait_for(lambda state: state.position is not None, timeout=5)
            there.while_obtaining = happening
            async with aircraft.control() as control:
                async for _ in control.ticks():
                    control.send(NORTH)

    with foreign_aircraft(firmware) as there:
        with pytest.raises(AuthorityLost) as caught:
            asyncio.run(fly(there.name))
        assert caught.value.reason == "mode_switch"
        assert there.movements == []
