"""Control that is obtained and released by hand: it ends like a block, and says so in its calls."""

from __future__ import annotations

import asyncio
import gc
import weakref

import pytest

from m100link import (
    AuthorityLost,
    AuthorityRefused,
    Control,
    LinkClosed,
    LinkError,
    LinkLost,
    NoAuthority,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.lifecycle import StopCause
from m100link.protocol.items import ITEMS
from m100link.sim import VirtualClockEventLoop
from tests.rig import FIRMWARES, NORTH, Rig, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)


async def flying(flown: Rig) -> Control:
    """Obtained by hand, in the air, with a setpoint that is being sent."""
    control = await flown.aircraft.control().obtain()
    await control.take_off()
    control.send(NORTH, lifetime=1.0)
    await asyncio.sleep(0.5)
    assert flown.speed > 0.3
    return control


@each_firmware
async def test_release_takes_the_stop_path(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        control = await flying(flown)
        assert repr(control).startswith("<Control flying, authority held, ")
        await control.release()
        assert repr(control).startswith("<Control over, authority none, ")
        flown.assert_stopped_in_order()
        assert flown.is_released
        await flown.assert_hovers()
        with pytest.raises(NoAuthority, match="over with this block"):
            control.send(NORTH)
        await control.release()
        async with flown.aircraft.control() as again:
            again.send(NORTH)


async def test_release_lands_where_that_was_asked_for() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control(stop="land").obtain()
        await control.take_off()
        await control.release()
        assert not flown.is_running
        assert flown.is_released


async def test_it_can_be_obtained_in_one_task_and_released_in_another() -> None:
    async with rig() as flown:
        control = await asyncio.create_task(flying(flown))
        await asyncio.create_task(control.release())
        assert flown.is_released
        await flown.assert_hovers()


async def test_what_waits_no_more_is_not_cancelled_by_an_end_in_the_same_turn() -> None:
    """The cancellation comes a turn later, and would hit whatever the program does then."""
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        with control._block.waiting("take_off"):
            control._block.end(StopCause.CLOSED)
        await asyncio.sleep(1.0)
        assert flown.is_released


async def test_what_was_never_obtained_needs_no_release() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as other:
            await flown.aircraft.control().release()
            assert other.has_authority
            other.send(NORTH)


async def test_another_block_is_left_alone_by_one_that_is_refused() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as first:
            second = flown.aircraft.control()
            with pytest.raises(UsageError, match="another control block"):
                await second.obtain()
            await second.release()
            await asyncio.sleep(1.0)
            assert first.has_authority
            assert not flown.is_released


async def test_a_refusal_is_raised_and_leaves_nothing_behind() -> None:
    async with rig() as flown:
        flown.virtual.leave_f()
        await asyncio.sleep(0.5)
        with pytest.raises(AuthorityRefused):
            await flown.aircraft.control().obtain()
        flown.virtual.return_to_f()
        await asyncio.sleep(0.5)
        control = await flown.aircraft.control().obtain()
        assert control.has_authority
        await control.release()


@each_firmware
async def test_a_refusal_is_raised_when_its_stop_path_has_ended(firmware: str) -> None:
    """The ack that refuses may be wrong or late: authority is given back before anybody goes on."""
    async with rig(firmware=firmware) as flown:
        flown.virtual.leave_f()
        await asyncio.sleep(0.5)
        control = flown.aircraft.control()
        with pytest.raises(AuthorityRefused):
            await control.obtain()
        assert control.is_over
        flown.virtual.return_to_f()
        await asyncio.sleep(0.5)
        again = await flown.aircraft.control().obtain()
        await again.release()


async def test_a_second_obtain_of_the_same_object_is_refused() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        with pytest.raises(UsageError, match="entered before"):
            await control.obtain()
        with pytest.raises(UsageError, match="entered before"):
            async with control:
                pass
        assert control.has_authority
        await control.release()
        assert flown.is_released


@each_firmware
async def test_a_task_under_way_raises_the_loss(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        control = await flown.aircraft.control().obtain()
        asyncio.get_running_loop().call_later(2.005, flown.virtual.leave_f)
        with pytest.raises(AuthorityLost):
            await control.take_off()
        await control.release()  # the reason was raised: nothing is raised again
        assert control.setpoints_sent == 0


async def test_a_loss_between_two_calls_is_raised_by_the_next_one() -> None:
    async with rig() as flown:
        control = await flying(flown)
        flown.virtual.leave_f()
        await asyncio.sleep(1.0)
        count = len(flown.moves)
        with pytest.raises(AuthorityLost):
            control.send(NORTH)
        with pytest.raises(AuthorityLost):
            await control.fly_to(north=1.0, east=0.0, up=0.0)
        await asyncio.sleep(1.0)
        assert len(flown.moves) == count
        await control.release()


async def test_a_loss_that_no_call_raised_is_raised_by_the_release() -> None:
    async with rig() as flown:
        control = await flying(flown)
        flown.virtual.leave_f()
        await asyncio.sleep(1.0)
        with pytest.raises(AuthorityLost):
            await control.release()
        await control.release()


async def test_a_loss_that_a_block_raised_is_not_raised_again_by_a_release() -> None:
    async with rig() as flown:
        control = flown.aircraft.control()
        with pytest.raises(AuthorityLost):
            async with control:
                flown.virtual.leave_f()
                await asyncio.sleep(1.0)
        await control.release()


async def test_a_closed_loop_ends_with_the_line() -> None:
    async with rig() as flown:
        control = await flying(flown)
        asyncio.get_running_loop().call_later(1.0, flown.virtual.unplug)
        with pytest.raises(LinkLost):
            await control.fly_to(north=100.0, east=0.0, up=0.0)
        await control.release()


async def test_waiting_for_the_pilot_ends_with_the_line() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control(on_pause="wait").obtain()
        flown.virtual.leave_f()
        await asyncio.sleep(0.5)
        assert control.is_paused
        asyncio.get_running_loop().call_later(1.0, flown.virtual.unplug)
        with pytest.raises(LinkError):
            await control.wait_resumable()


async def test_stalled_telemetry_ends_it() -> None:
    async with rig() as flown:
        control = await flying(flown)
        flown.virtual.set_rates(**dict.fromkeys((item.name for item in ITEMS), 0))
        await asyncio.sleep(3.0)
        assert flown.is_released
        with pytest.raises(TelemetryStalled):
            control.send(NORTH)


async def test_closing_the_aircraft_ends_it() -> None:
    async with rig() as flown:
        control = await flying(flown)
        await flown.aircraft.aclose()
        assert flown.is_released
        with pytest.raises(LinkClosed):
            control.send(NORTH)
        await flown.assert_hovers()


async def test_a_release_ends_what_waits_in_another_task() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        task = asyncio.create_task(control.take_off())
        await asyncio.sleep(0.5)
        await control.release()
        with pytest.raises(NoAuthority):
            await task
        assert flown.is_released


@pytest.mark.parametrize("after", [0.0, 0.001, 0.01, 0.05, 0.2])
async def test_a_release_while_it_is_being_obtained(after: float) -> None:
    async with rig(firmware="1.0") as flown:
        control = flown.aircraft.control()
        task = asyncio.create_task(control.obtain())
        await asyncio.sleep(after)
        await control.release()
        await asyncio.wait([task])
        await control.release()
        await asyncio.sleep(1.0)
        assert flown.is_released
        async with flown.aircraft.control() as again:
            assert again.has_authority


@pytest.mark.parametrize("after", [0.0, 0.001, 0.01, 0.05])
async def test_a_cancelled_obtain_leaves_nothing_behind(after: float) -> None:
    async with rig(firmware="1.0") as flown:
        task = asyncio.create_task(flown.aircraft.control().obtain())
        await asyncio.sleep(after)
        task.cancel()
        await asyncio.wait([task])
        await asyncio.sleep(1.0)
        if not task.cancelled():  # it came too late
            await task.result().release()
        assert flown.is_released
        async with flown.aircraft.control() as again:
            assert again.has_authority


async def test_a_cancelled_call_leaves_control_with_the_program() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        task = asyncio.create_task(control.take_off())
        await asyncio.sleep(0.5)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert control.has_authority
        await control.release()


async def test_a_task_whose_call_has_ended_is_let_go() -> None:
    """A service that flies by hand for days keeps none of those that waited in its calls."""
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        task = asyncio.create_task(control.wait_resumable())
        await task
        ended = weakref.ref(task)
        del task
        await asyncio.sleep(0.1)  # the event loop lets go of it
        gc.collect()
        assert ended() is None
        await control.release()


def test_it_can_be_made_where_no_event_loop_runs() -> None:
    """As at a prompt, where only what awaits runs inside the loop."""
    loop = VirtualClockEventLoop()
    scene = rig()
    try:
        flown = loop.run_until_complete(scene.__aenter__())
        control = flown.aircraft.control()
        subscription = flown.aircraft.telemetry()
        loop.run_until_complete(control.obtain())
        loop.run_until_complete(asyncio.sleep(0.5))
        loop.run_until_complete(control.release())
        assert flown.is_released
        assert subscription.received > 0
        loop.run_until_complete(scene.__aexit__(None, None, None))
    finally:
        loop.close()


@pytest.mark.parametrize("is_sending", [False, True])
def test_a_program_that_ends_without_release_lands_and_releases_first(is_sending: bool) -> None:
    """asyncio.run cancels every task on its way out; the stop path has to outlive that."""
    seen: list[Rig] = []
    scene = rig()

    async def program() -> None:
        flown = await scene.__aenter__()
        seen.append(flown)
        control = await flown.aircraft.control(stop="land").obtain()
        await control.take_off()
        if is_sending:
            control.send(NORTH)

    with asyncio.Runner(loop_factory=VirtualClockEventLoop) as runner:
        runner.run(program())
    assert not seen[0].is_running
    assert seen[0].is_released


async def test_after_its_end_every_call_says_what_ended_it() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control(stop="land").obtain()
        await control.take_off()
        await flown.aircraft.aclose()
        with pytest.raises(LinkClosed, match="disconnected while this block was flying"):
            await control.fly_to(north=1.0, east=0.0, up=0.0)


async def test_nothing_waits_for_its_end_any_more_when_it_was_released() -> None:
    async with rig() as flown:
        before = asyncio.all_tasks()
        control = await flown.aircraft.control().obtain()
        await control.release()
        await asyncio.sleep(0.1)
        assert asyncio.all_tasks() == before


async def test_what_stands_in_for_the_block_ends_behind_the_stop_path_and_stays_cancelled() -> None:
    """asyncio.run waits for it, and for nothing that was begun after its cancellation."""
    async with rig() as flown:
        control = await flown.aircraft.control(stop="land").obtain()
        await control.take_off()
        guard = control._block._stopping._task
        assert guard is not None
        guard.cancel()
        with pytest.raises(asyncio.CancelledError):
            await guard
        assert not flown.is_running
        assert flown.is_released
