"""Every way in which a control block can end: what the aircraft received last, and that it hovers.

On virtual time, for each firmware. Ends of whole processes are in ``test_processes.py``.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import threading
import weakref
from unittest.mock import Mock

import anyio
import pytest

from m100link import (
    AuthorityLost,
    AuthorityRefused,
    AuthorityState,
    FlightPhase,
    FlightStatus,
    GuardRefused,
    Guards,
    LinkClosed,
    LinkLost,
    NoAuthority,
    Setpoint,
    TelemetryStalled,
    UsageError,
)
from m100link.errors import OutOfResources
from m100link.sim import LineFaults, VirtualClockEventLoop
from tests.rig import FIRMWARES, NORTH, Rig, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


async def assert_all_is_well(flown: Rig) -> None:
    """Neutral was the last word, authority was given back, the aircraft hovers."""
    flown.assert_stopped_in_order()
    assert flown.is_released
    assert flown.aircraft.authority.state is AuthorityState.NONE
    await flown.assert_hovers()


@each_firmware
async def test_normal_end_of_the_block(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            await flown.fly(control)
            assert flown.speed > 1.0
        await assert_all_is_well(flown)


@each_firmware
async def test_exception_in_the_block(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(ZeroDivisionError):
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly(control)
                _ = 1 / 0
        await assert_all_is_well(flown)


@each_firmware
async def test_cancelling_the_task(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:

        async def program() -> None:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly_on(control)

        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        assert flown.speed > 1.0
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_all_is_well(flown)


@pytest.mark.parametrize("after", [0.0, 0.001, 0.05, 0.15, 0.29, 0.301])
@each_firmware
async def test_a_second_cancel_does_not_cut_the_stop_path_short(
    firmware: str, after: float
) -> None:
    async with rig(firmware=firmware) as flown:

        async def program() -> None:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly_on(control)

        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        task.cancel()
        await asyncio.sleep(after)
        task.cancel()
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_all_is_well(flown)


async def test_cancelling_every_task_of_the_loop_twice_still_stops_the_aircraft() -> None:
    """What asyncio.run does on its way out after a second Ctrl-C."""
    async with rig() as flown:

        async def program() -> None:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly_on(control)

        before = asyncio.all_tasks()
        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        task.cancel()
        await asyncio.sleep(0.1)
        for other in asyncio.all_tasks() - before:
            other.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await assert_all_is_well(flown)


@each_firmware
async def test_an_outer_anyio_scope(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with anyio.move_on_after(8.0) as scope:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly_on(control)
        assert scope.cancelled_caught
        await assert_all_is_well(flown)


@each_firmware
async def test_an_outer_asyncio_timeout(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(8.0):
                async with flown.aircraft.control() as control:
                    await control.take_off()
                    await flown.fly_on(control)
        await assert_all_is_well(flown)


async def test_a_failure_in_a_task_group_inside_the_block() -> None:
    async with rig() as flown:
        with pytest.raises(ExceptionGroup) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                async with anyio.create_task_group() as group:
                    group.start_soon(flown.fly_on, control)
                    await anyio.sleep(2.0)
                    raise ZeroDivisionError
        assert caught.group_contains(ZeroDivisionError)
        await assert_all_is_well(flown)


@each_firmware
async def test_a_guard_that_refuses_ends_the_block_like_any_error(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(GuardRefused, match="GPS health is 2"):
            async with flown.aircraft.control() as control:
                await control.take_off()
                loop = asyncio.get_running_loop()
                loop.call_later(1.0, flown.virtual.vehicle.set_gps_health, 2)
                await flown.fly_on(control)
        flown.assert_stopped_in_order()
        assert flown.is_released


@pytest.mark.parametrize("phase", [0.0, 0.007], ids=["at a tick", "between ticks"])
@each_firmware
async def test_the_pilot_leaves_f_during_a_loop(firmware: str, phase: float) -> None:
    async with rig(firmware=firmware) as flown:
        left_at = 0.0

        def leave() -> None:
            nonlocal left_at
            left_at = flown.now
            flown.virtual.leave_f()

        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0 + phase, leave)
                await flown.fly_on(control)
        assert caught.value.reason == "mode_switch"
        assert flown.moves.times[-1] <= left_at + 0.02, "a setpoint followed the loss"
        assert flown.is_released
        await flown.assert_hovers()


@each_firmware
async def test_the_app_takes_control_during_a_loop(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.set_rates(control_device=50)
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                loop = asyncio.get_running_loop()
                loop.call_later(2.0, flown.virtual.app_takes_control)
                await flown.fly_on(control)
        assert caught.value.reason == "app"
        assert flown.aircraft.authority.state is AuthorityState.NONE
        await flown.assert_hovers()


async def test_without_the_control_device_item_the_reason_of_the_app_is_not_guessed() -> None:
    """Its default rate is 0 Hz. The switch still in F leaves the app and the aircraft itself."""
    async with rig() as flown:
        with pytest.raises(AuthorityLost, match="still in F") as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, flown.virtual.app_takes_control)
                await flown.fly_on(control)
        assert caught.value.reason == "unknown"
        assert "CTRL_DEVICE" in str(caught.value)


async def test_loss_without_a_notification_is_found_by_the_mode_switch() -> None:
    """The notification goes out once, on session 0: it may be lost on the line."""
    async with rig() as flown:
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly(control, 1.0)
                flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=LineFaults())
                flown.virtual.leave_f()
                await asyncio.sleep(0.1)
                flown.virtual.set_faults()
                await flown.fly_on(control)
        assert caught.value.reason == "mode_switch"
        await flown.assert_hovers()


@each_firmware
async def test_unplugged_during_flight(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(LinkLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, flown.virtual.unplug)
                await flown.fly_on(control)
        ended_at = flown.now
        assert flown.aircraft.authority.state is not AuthorityState.HELD
        await flown.assert_hovers()
        assert flown.moves.times[-1] <= ended_at


async def test_unplugged_while_the_program_sleeps_ends_the_block_at_once() -> None:
    async with rig() as flown:
        with pytest.raises(LinkLost) as caught:
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, flown.virtual.unplug)
                start = flown.now
                await asyncio.sleep(3600)
        assert flown.now - start < 3.0
        with pytest.raises(LinkLost) as asked_later:
            await flown.aircraft.version()
        assert caught.value.seen == asked_later.value.seen, "the block knows what happened, too"


@each_firmware
async def test_stalled_telemetry_ends_the_block(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        stalled_at = 0.0

        def stall() -> None:
            nonlocal stalled_at
            stalled_at = flown.now
            flown.virtual.line.stall(to_host=True, to_aircraft=False)

        with pytest.raises(TelemetryStalled, match="no telemetry for"):
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, stall)
                await flown.fly_on(control)
        assert flown.now - stalled_at < 6.0, "the stop path is bounded"
        flown.assert_stopped_in_order()
        assert flown.is_released, "the release reached the aircraft although its ack did not come"
        await flown.assert_hovers()


@pytest.mark.parametrize("doing", ["nothing", "a task"])
async def test_stalled_telemetry_ends_the_block_even_when_nothing_is_sent(doing: str) -> None:
    async with rig() as flown:
        with pytest.raises(TelemetryStalled):
            async with flown.aircraft.control() as control:
                await control.take_off()
                flown.virtual.line.stall(to_host=True, to_aircraft=False)
                start = flown.now
                await (control.land() if doing == "a task" else asyncio.sleep(3600))
        assert flown.now - start < 6.0


async def test_a_dead_line_both_ways_bounds_the_stop_path() -> None:
    async with rig() as flown:
        with pytest.raises(TelemetryStalled):
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly(control, 1.0)
                flown.virtual.stall_line()
                start = flown.now
                await flown.fly_on(control)
        assert flown.now - start < 70.0


# -- landing at the end ---------------------------------------------------------------------------


@each_firmware
async def test_stop_land_lands_and_then_releases(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        with pytest.raises(ZeroDivisionError):
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly(control)
                raise ZeroDivisionError
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.is_released


async def test_stop_land_on_the_ground_does_nothing() -> None:
    async with rig() as flown:
        start = flown.now
        async with flown.aircraft.control(stop="land"):
            pass
        assert flown.now - start < 0.5
        assert flown.is_released


async def test_stop_land_survives_a_second_cancel() -> None:
    async with rig() as flown:

        async def program() -> None:
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly_on(control)

        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        task.cancel()
        await asyncio.sleep(1.5)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert flown.virtual.height == 0.0
        assert flown.is_released


@pytest.mark.parametrize("delay", [0.5, 1.5, 2.5, 3.5])
@each_firmware
async def test_stop_land_lands_although_it_is_cancelled_during_take_off(
    firmware: str, delay: float
) -> None:
    """The aircraft rejects a landing while it executes another task (2.2.2.2)."""
    async with rig(firmware=firmware) as flown:

        async def program() -> None:
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly_on(control)

        task = asyncio.create_task(program())
        await asyncio.sleep(delay)
        assert flown.phase is not FlightPhase.STANDBY
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.is_released


@each_firmware
async def test_stop_land_does_not_interrupt_the_landing_it_was_cancelled_in(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:

        async def program() -> None:
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await control.climb_to(5.0)
                await control.land()

        task = asyncio.create_task(program())
        await flown.aircraft.wait_for(
            lambda state: state.flight_status == FlightStatus(FlightPhase.LANDING), timeout=60
        )
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert flown.virtual.height == 0.0
        assert flown.is_released


async def test_the_pilot_may_take_over_from_the_stop_path() -> None:
    async with rig() as flown:
        with pytest.raises(ZeroDivisionError):
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await control.climb_to(10.0)
                asyncio.get_running_loop().call_later(1.0, flown.virtual.leave_f)
                raise ZeroDivisionError
        assert flown.virtual.height > 5.0, "the pilot has it and does not land"
        assert flown.is_released


# -- pause and resume -----------------------------------------------------------------------------


@each_firmware
async def test_on_pause_wait_keeps_the_block_and_sends_nothing_until_the_program_says_so(
    firmware: str,
) -> None:
    async with rig(firmware=firmware) as flown:
        async with flown.aircraft.control(on_pause="wait") as control:
            await control.take_off()
            await flown.fly(control, 1.0)
            requests = sum(c.address == (1, 0) for c in flown.virtual.autopilot.received_commands)
            flown.virtual.leave_f()
            await asyncio.sleep(0.1)
            assert (control.is_paused, control.has_authority) == (True, False)
            count = len(flown.moves)
            with pytest.raises(NoAuthority, match="paused by the pilot"):
                control.send(NORTH)
            with pytest.raises(NoAuthority):
                control.resume()
            await asyncio.sleep(2.0)
            flown.virtual.return_to_f()
            await control.wait_resumable()
            # Authority is back without a request, and still nothing flies.
            assert (control.is_paused, control.has_authority) == (True, True)
            with pytest.raises(NoAuthority, match="resume"):
                control.send(NORTH)
            await asyncio.sleep(2.0)
            assert len(flown.moves) == count
            control.resume()
            await flown.fly(control, 2.0)
            assert flown.speed > 1.0
            assert len(flown.moves) > count + 90
            again = sum(c.address == (1, 0) for c in flown.virtual.autopilot.received_commands)
            assert again == requests
        await assert_all_is_well(flown)


@pytest.mark.parametrize("rate_hz", [50, 0.5])
async def test_a_held_setpoint_does_not_come_back_by_itself_after_a_pause(rate_hz: float) -> None:
    async with rig() as flown:
        async with flown.aircraft.control(on_pause="wait") as control:
            await control.take_off()
            control.send(NORTH, lifetime=60.0, rate_hz=rate_hz, allow_long_lifetime=True)
            await asyncio.sleep(1.0)
            flown.virtual.leave_f()
            await asyncio.sleep(0.1)
            count = len(flown.moves)
            flown.virtual.return_to_f()
            await control.wait_resumable()
            control.resume()
            await asyncio.sleep(2.0)
            assert len(flown.moves) == count


async def test_the_app_ends_a_waiting_block_too() -> None:
    async with rig() as flown:
        flown.virtual.set_rates(control_device=50)
        with pytest.raises(AuthorityLost) as caught:
            async with flown.aircraft.control(on_pause="wait") as control:
                await control.take_off()
                flown.virtual.app_takes_control()
                await control.wait_resumable()
                await asyncio.sleep(3600)
        assert caught.value.reason == "app"


async def test_after_a_loss_a_new_block_can_be_entered() -> None:
    async with rig() as flown:
        with pytest.raises(AuthorityLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                flown.virtual.leave_f()
                await asyncio.sleep(10)
        flown.virtual.return_to_f()
        async with flown.aircraft.control() as control:
            await flown.fly(control)
            assert flown.speed > 1.0
        await assert_all_is_well(flown)


async def test_a_block_that_is_over_is_let_go() -> None:
    """A program that flies block after block on one connection keeps none of them."""
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            await flown.fly(control)
            over = [weakref.ref(part) for part in (control, control._block)]
        del control
        await asyncio.sleep(1.0)
        gc.collect()
        assert [part() for part in over] == [None, None]


# -- one at a time --------------------------------------------------------------------------------


async def test_a_nested_block_is_refused_and_leaves_the_first_alone() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            with pytest.raises(UsageError, match="another control block"):
                async with flown.aircraft.control():
                    pytest.fail("entered")
            assert control.has_authority
            await flown.fly(control, 1.0)
        await assert_all_is_well(flown)


async def test_a_second_block_is_refused_while_the_first_waits_for_the_pilot() -> None:
    async with rig() as flown:
        async with flown.aircraft.control(on_pause="wait") as control:
            await control.take_off()
            flown.virtual.leave_f()
            await asyncio.sleep(0.1)
            with pytest.raises(UsageError, match="another control block"):
                async with flown.aircraft.control():
                    pytest.fail("entered")
            flown.virtual.return_to_f()
            await control.wait_resumable()


async def test_two_blocks_made_before_either_was_entered_do_not_share_authority() -> None:
    async with rig() as flown:
        first, second = flown.aircraft.control(), flown.aircraft.control()
        with pytest.raises(AuthorityLost):
            async with first as control:
                with pytest.raises(UsageError, match="another control block"):
                    await second.__aenter__()
                await control.take_off()
                # The first one still hears what happens to its authority.
                asyncio.get_running_loop().call_later(1.0, flown.virtual.leave_f)
                await asyncio.wait_for(flown.fly_on(control), 5.0)


async def test_a_block_is_entered_once_and_is_over_when_it_is_over() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            block = control._block
            assert (block.is_open, block.is_flying) == (True, True)
        assert (block.is_open, block.is_flying) == (False, False)
        with pytest.raises(NoAuthority, match="over with this block"):
            control.send(NORTH)
        with pytest.raises(NoAuthority):
            await control.take_off()
        with pytest.raises(UsageError, match="entered before"):
            await control.__aenter__()


async def test_setpoints_are_refused_while_a_task_flies_the_aircraft() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            take_off = asyncio.create_task(control.take_off())
            await asyncio.sleep(1.0)
            with pytest.raises(NoAuthority, match="take off"):
                control.send(NORTH)
            await take_off
            control.send(NORTH)


# -- entering -------------------------------------------------------------------------------------


@each_firmware
async def test_cancelled_while_entering_authority_is_released(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        flown.virtual.set_faults(LineFaults(delay=0.3))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.35):
                async with flown.aircraft.control():
                    pytest.fail("entered")
        flown.virtual.set_faults()
        await asyncio.sleep(1.0)
        assert flown.is_released
        assert flown.aircraft.authority.state is AuthorityState.NONE


async def test_a_lost_ack_while_entering_does_not_leave_authority_behind() -> None:
    async with rig() as flown:
        flown.virtual.set_faults(LineFaults(loss=1.0), to_aircraft=LineFaults())
        with pytest.raises(TimeoutError):
            async with flown.aircraft.control():
                pytest.fail("entered")
        flown.virtual.set_faults()
        assert flown.is_released


async def test_stop_actions_and_pause_actions_are_checked_when_asked_for() -> None:
    async with rig() as flown:
        with pytest.raises(UsageError, match="stop action 'crash'"):
            flown.aircraft.control(stop="crash")  # type: ignore[arg-type]
        with pytest.raises(UsageError, match="on_pause"):
            flown.aircraft.control(on_pause="never")  # type: ignore[arg-type]


async def test_a_setpoint_that_was_never_sent_needs_no_neutral_time() -> None:
    async with rig() as flown:
        start = flown.now
        async with flown.aircraft.control():
            pass
        assert flown.now - start < 0.3
        assert len(flown.moves) == 0


async def test_thrust_is_neutralised_into_no_climb() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
            for _ in range(20):
                control.send(
                    Setpoint.tilt(roll_deg=0, pitch_deg=0, thrust_percent=60, yaw_rate_deg_s=0)
                )
                await asyncio.sleep(0.05)
        await assert_all_is_well(flown)


# -- the program's own doing ---------------------------------------------------------------------


async def test_closing_the_aircraft_inside_the_block_ends_it() -> None:
    async with rig() as flown:
        with pytest.raises(LinkClosed):
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly(control, 1.0)
                await flown.aircraft.aclose()
                await flown.fly_on(control)
        await flown.assert_hovers()


async def test_a_landing_that_the_stop_path_cannot_begin_is_logged_and_bounded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with rig() as flown:
        with pytest.raises(ZeroDivisionError):
            async with flown.aircraft.control(
                stop="land", guards=Guards(stale_telemetry_s=None)
            ) as control:
                await control.take_off()
                flown.virtual.set_faults(LineFaults(), to_aircraft=LineFaults(loss=1.0))
                start = flown.now
                raise ZeroDivisionError
        assert flown.now - start < 70.0
        assert "the stop path could not land" in caplog.text
        assert "authority may not be released" in caplog.text


@pytest.mark.parametrize("handle", [True, False])
async def test_sigterm_is_taken_only_for_the_block_and_only_if_nobody_else_has_it(
    handle: bool,
) -> None:
    async with rig() as flown:
        before = signal.getsignal(signal.SIGTERM)
        async with flown.aircraft.control(handle_signals=handle):
            during = signal.getsignal(signal.SIGTERM)
        assert (during is not before) is handle
        assert signal.getsignal(signal.SIGTERM) is before is signal.SIG_DFL


async def test_a_programs_own_sigterm_handler_stays() -> None:
    def own(number: int, frame: object) -> None:
        """Whatever the program does."""

    signal.signal(signal.SIGTERM, own)
    try:
        async with rig() as flown, flown.aircraft.control():
            assert signal.getsignal(signal.SIGTERM) is own
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


async def test_a_block_refused_at_entry_gives_sigterm_back() -> None:
    async with rig() as flown:
        flown.virtual.leave_f()
        with pytest.raises(AuthorityRefused):
            async with flown.aircraft.control():
                pytest.fail("entered")
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_block_in_another_thread_leaves_signals_alone() -> None:
    async def fly() -> None:
        async with rig() as flown, flown.aircraft.control() as control:
            assert control.has_authority

    failures: list[BaseException] = []

    def work() -> None:
        try:
            with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
                runner.run(fly())
        except BaseException as error:  # noqa: BLE001 (raised in the test's own thread)
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert failures == []


async def test_a_block_that_cannot_begin_leaves_the_firmware_to_the_next_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """While one flies, no answer to a version query changes what is sent."""
    async with rig(firmware="3.1") as flown:
        block = flown.aircraft.control()
        with monkeypatch.context() as patch:
            patch.setattr("m100link.flight.block.reserve", Mock(side_effect=OutOfResources("no")))
            with pytest.raises(OutOfResources):
                await block.__aenter__()
        assert not block._commander.requests._is_fixed
