"""The stop path runs whichever task leaves, whatever the program does and whatever else fails."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import pkgutil
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from m100link import (
    AuthorityLost,
    AuthorityState,
    FlightPhase,
    FlightStatus,
    Guards,
    LinkClosed,
    LinkLost,
    NoAuthority,
    Setpoint,
    TaskRefused,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.guards import GuardKeeper
from m100link.flight.stop_path import StopAction
from m100link.protocol.codes import TaskResultCode, VersionCode
from m100link.protocol.commands.activation import GetVersion, Version
from m100link.protocol.commands.control import QueryTask, RequestAuthority, StartTask, Task
from m100link.sim import LineFaults, VirtualClockEventLoop
from m100link.sim.vehicle.flight import Maneuver
from tests.flight.foreign_aircraft import ONBOARD
from tests.flight.missions.foreign import foreign, tell_standby_once
from tests.rig import FIRMWARES, NORTH, Rig, rig

pytestmark = pytest.mark.anyio

each_firmware = pytest.mark.parametrize("firmware", FIRMWARES)

UNKNOWN_VERSION = Version(VersionCode.ACTIVATED, 0, "SDK-v9.9 BETA M999-09.09.09.09")


async def assert_all_is_well(flown: Rig) -> None:
    """Neutral was the last word, authority was given back, and the next block may begin."""
    flown.assert_stopped_in_order()
    assert flown.is_released
    assert flown.aircraft.authority.state is AuthorityState.NONE
    await flown.assert_hovers()
    async with flown.aircraft.control() as control:
        assert control.has_authority


# -- left by another task -------------------------------------------------------------------------


async def legs(flown: Rig, *, stop: str = "hover") -> AsyncIterator[int]:
    """A program that flies as an async generator: the block is inside."""
    async with flown.aircraft.control(stop="land" if stop == "land" else "hover") as control:
        await control.take_off()
        for leg in range(100):
            control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
            await asyncio.sleep(1.0)
            yield leg


@each_firmware
async def test_a_generator_whose_consumer_breaks_is_closed_by_the_loop(firmware: str) -> None:
    async with rig(firmware=firmware) as flown:
        async for leg in legs(flown):
            if leg == 2:
                break
        assert flown.speed > 1.0
        await asyncio.sleep(1.0)
        await assert_all_is_well(flown)


async def test_a_generator_that_breaks_lands_where_the_program_wants_it() -> None:
    async with rig() as flown:
        async for leg in legs(flown, stop="land"):
            if leg == 2:
                break
        await asyncio.sleep(30.0)
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.is_released


async def test_a_generator_closed_by_another_task_while_its_own_task_is_gone() -> None:
    async with rig() as flown:
        program = legs(flown)
        await asyncio.create_task(anext(program))  # type: ignore[arg-type]  # it is a coroutine
        closing = asyncio.create_task(program.aclose())  # type: ignore[attr-defined]
        await closing
        await assert_all_is_well(flown)


async def test_an_exit_stack_that_another_task_unwinds() -> None:
    async with rig() as flown:
        stack = AsyncExitStack()

        async def begin() -> None:
            control = await stack.enter_async_context(flown.aircraft.control())
            await control.take_off()
            control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
            await asyncio.sleep(1.0)

        await asyncio.create_task(begin())
        assert flown.speed > 1.0
        await stack.aclose()
        await assert_all_is_well(flown)


async def test_a_loss_is_raised_in_the_task_that_leaves_when_the_one_that_entered_is_gone() -> None:
    async with rig() as flown:
        stack = AsyncExitStack()

        async def begin() -> None:
            control = await stack.enter_async_context(flown.aircraft.control())
            await control.take_off()

        await asyncio.create_task(begin())
        flown.virtual.leave_f()
        await asyncio.sleep(5.0)
        assert flown.is_released, "the stop path waits for nobody"
        with pytest.raises(AuthorityLost):
            await stack.aclose()


async def test_a_failure_in_the_block_does_not_disturb_the_task_that_left_it_long_ago() -> None:
    async with rig() as flown:
        async for leg in legs(flown):
            if leg == 1:
                break
        await asyncio.sleep(2.0)
        flown.virtual.leave_f()
        await asyncio.sleep(2.0)  # a cancellation would come out here


# -- a program that does not go -------------------------------------------------------------------


async def test_a_program_that_swallows_its_cancellation_cannot_keep_authority() -> None:
    async with rig() as flown:
        with pytest.raises(AuthorityLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, flown.virtual.leave_f)
                try:
                    await flown.fly_on(control)
                except asyncio.CancelledError:
                    await asyncio.sleep(60.0)
                assert flown.is_released
                assert control._block.state.name == "OVER"
                with pytest.raises(AuthorityLost):
                    control.send(NORTH)


async def test_a_program_that_cleans_up_slowly_does_not_hold_up_the_neutral() -> None:
    async with rig() as flown:
        stalled_at = 0.0

        def stall() -> None:
            nonlocal stalled_at
            stalled_at = flown.now
            flown.virtual.line.stall(to_host=True, to_aircraft=False)

        with pytest.raises(TelemetryStalled):
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_later(2.0, stall)
                try:
                    await flown.fly_on(control)
                finally:
                    await asyncio.sleep(20.0)
        assert flown.moves.times[-1] - stalled_at < 1.5
        flown.assert_stopped_in_order()
        assert flown.is_released


# -- leaving connect() ----------------------------------------------------------------------------


@each_firmware
@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_leaving_connect_ends_a_block_of_another_task_first(firmware: str, stop: str) -> None:
    async with rig(firmware=firmware) as flown:
        failures: list[BaseException] = []

        async def program() -> None:
            action = "land" if stop == "land" else "hover"
            try:
                async with flown.aircraft.control(stop=action) as control:  # type: ignore[arg-type]
                    await control.take_off()
                    await flown.fly_on(control)
            except LinkClosed as error:
                failures.append(error)

        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        assert flown.speed > 1.0
        await flown.aircraft.aclose()  # what leaving connect() does
        assert flown.is_released, "released before the line was closed"
        await task
        assert "disconnected while this block" in str(failures[0])
        if stop == "land":
            assert flown.virtual.height == 0.0
        else:
            flown.assert_stopped_in_order()
            await flown.assert_hovers()


async def test_cancelling_the_closing_does_not_spare_the_block_its_stop_path() -> None:
    async with rig() as flown:

        async def program() -> None:
            async with flown.aircraft.control() as control:
                await control.take_off()
                await flown.fly_on(control)

        task = asyncio.create_task(program())
        await asyncio.sleep(8.0)
        closing = asyncio.create_task(flown.aircraft.aclose())
        await asyncio.sleep(0.1)
        closing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await closing
        assert flown.is_released
        with pytest.raises(LinkClosed):
            await task
        with pytest.raises(LinkClosed):
            await flown.aircraft.version()


async def test_closing_while_a_block_is_entered_gives_back_what_may_be_granted() -> None:
    async with rig() as flown:
        task = asyncio.create_task(flown.aircraft.control().__aenter__())
        await asyncio.sleep(0)
        await flown.aircraft.aclose()
        assert flown.is_released
        with pytest.raises(LinkClosed):
            await task


@each_firmware
async def test_a_program_that_begins_again_and_again_does_not_outlive_the_connection(
    firmware: str,
) -> None:
    """It obtained authority between the end of its block and the end of the line, and kept it."""
    async with rig(firmware=firmware) as flown:

        async def program() -> None:
            for _ in range(50):
                with contextlib.suppress(LinkClosed):
                    async with flown.aircraft.control() as control:
                        control.send(NORTH)
                        await asyncio.sleep(0.1)

        async with flown.aircraft.control() as control:
            await control.take_off()
        task = asyncio.create_task(program())
        await asyncio.sleep(0.25)  # its stop path runs
        await flown.aircraft.aclose()
        await task
        await asyncio.sleep(0.1)
        assert flown.is_released


# -- what raises on the way in --------------------------------------------------------------------


@each_firmware
async def test_whatever_raises_after_the_grant_leaves_no_authority_behind(
    firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def explode(keeper: GuardKeeper) -> None:
        raise ValueError("an impossible position")

    async with rig(firmware=firmware) as flown:
        with monkeypatch.context() as patch:
            patch.setattr(GuardKeeper, "start", explode)
            with pytest.raises(ValueError, match="impossible"):
                async with flown.aircraft.control():
                    pytest.fail("entered")
        assert flown.is_released
        assert flown.aircraft.authority.state is AuthorityState.NONE
        async with flown.aircraft.control() as control:
            assert control.has_authority


async def test_a_step_that_fails_does_not_keep_the_release_from_its_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def explode(*_: object, **__: object) -> None:
        raise RuntimeError("a bug")

    async with rig() as flown:
        with pytest.raises(RuntimeError, match="a bug"):
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly(control)
                monkeypatch.setattr("m100link.flight.stop_path.run_task", explode)
        flown.assert_stopped_in_order()
        assert flown.is_released


@pytest.mark.parametrize(
    "what",
    [
        *("stop_path.StopPath.let_go", "stop_path.StopPath.run", "stop_path.StopPath._land"),
        *("stop_path.StopPath._end_setpoints", "stop_path.StopPath._release"),
        *("stop_path.run_task", "stop_path.release_authority", "guardian.Guardian.end"),
        *("cancellation.ShieldedTask.begin", "cancellation.undisturbed"),
    ],
)
async def test_one_call_without_memory_keeps_no_step_of_an_ending_from_its_turn(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    name = f"m100link.flight.{what}"
    call = pkgutil.resolve_name(name)
    failures: list[MemoryError] = []

    def fail_once(*args: object) -> object:
        if not failures:
            failures.append(MemoryError())
            raise failures[0]
        return call(*args)

    async with rig() as flown:
        with contextlib.suppress(MemoryError):
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()
                await flown.fly(control)
                monkeypatch.setattr(name, fail_once)
    assert failures
    flown.assert_stopped_in_order()
    assert flown.is_released
    assert flown.virtual.height == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("kind", [UsageError, RuntimeError])
async def test_a_neutral_that_cannot_be_sent_does_not_keep_the_block_from_its_end(
    kind: type[Exception], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def explode(*_: object) -> None:
        raise kind("cannot be said in this firmware")

    async with rig() as flown:
        control = flown.aircraft.control()
        await control.__aenter__()
        await control.take_off()
        control.send(NORTH, lifetime=1.0)
        await asyncio.sleep(0.519)  # the next frame is due: the neutral goes out at once
        with monkeypatch.context() as patch:
            patch.setattr(Setpoint, "encode", explode)
            await control.__aexit__(None, None, None)
        assert "no neutral was sent" in caplog.text
        await flown.assert_hovers()
        assert flown.is_released


@each_firmware
@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_a_version_answer_in_flight_changes_neither_firmware_nor_the_end_of_the_block(
    firmware: str, stop: StopAction, caplog: pytest.LogCaptureFixture
) -> None:
    """The aircraft names an unknown firmware: neutral, landing and release would all be refused."""
    async with rig(firmware=firmware) as flown:
        handlers = flown.virtual.autopilot._commands._handlers
        known, before = handlers[GetVersion], flown.aircraft.firmware
        async with flown.aircraft.control(stop=stop) as control:
            await control.take_off()
            handlers[GetVersion] = lambda _: UNKNOWN_VERSION
            assert (await flown.aircraft.version()).name == UNKNOWN_VERSION.name
            assert "which is flying: kept" in caplog.text
            assert flown.aircraft.firmware is before
            await flown.fly(control)
        flown.assert_stopped_in_order()
        assert flown.is_released
        assert flown.is_running is (stop == "hover")
        with pytest.raises(UsageError, match="unknown firmware"):
            await flown.aircraft.control().__aenter__()
        handlers[GetVersion] = known
        await flown.aircraft.version()
        assert flown.aircraft.firmware is before


@each_firmware
async def test_authority_can_be_given_back_to_a_firmware_that_became_unknown(firmware: str) -> None:
    """An earlier program left it, and the answer does not tell how many requests it wants."""
    async with rig(firmware=firmware) as flown:
        for _ in range(flown.aircraft.firmware.authority_requests):
            await flown.aircraft.execute(RequestAuthority(obtain=True))
        assert not flown.is_released
        flown.virtual.autopilot._commands._handlers[GetVersion] = lambda _: UNKNOWN_VERSION
        await flown.aircraft.version()
        with pytest.raises(UsageError, match="unknown firmware"):
            await flown.aircraft.execute(RequestAuthority(obtain=True))
        await flown.aircraft.release_authority()
        assert flown.is_released


# -- landing without a flight status --------------------------------------------------------------


async def test_a_take_off_that_was_refused_is_nothing_to_land_from() -> None:
    async with rig() as flown:
        await without_status(flown)
        start = flown.now
        with pytest.raises(TaskRefused):
            async with flown.aircraft.control(stop="land") as control:
                flown.virtual.vehicle.flight.maneuver = Maneuver.FINISH  # it refuses to take off
                await control.take_off()
        assert flown.now - start < 3.0
        assert flown.is_released


async def without_status(flown: Rig) -> None:
    flown.virtual.set_rates(flight_status=0)
    flown.aircraft.state._cells[FlightStatus].sample = flown.aircraft.state.believed_status = None
    assert flown.aircraft.state.flight_status is None
    assert flown.aircraft.state.position is not None


@each_firmware
async def test_stop_land_without_a_flight_status_lands_what_was_ordered_to_take_off(
    firmware: str,
) -> None:
    async with rig(firmware=firmware) as flown:
        await without_status(flown)
        async with flown.aircraft.control(stop="land") as control:
            await control.take_off()
            await flown.fly(control)
        assert flown.virtual.height == 0.0
        assert not flown.is_running
        assert flown.is_released


async def test_stop_land_lands_although_the_take_off_was_never_seen_to_end() -> None:
    async with rig() as flown:
        await without_status(flown)

        async def program() -> None:
            async with flown.aircraft.control(stop="land") as control:
                await control.take_off()

        task = asyncio.create_task(program())
        await asyncio.sleep(2.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert flown.virtual.height == 0.0


async def test_an_old_standby_does_not_keep_an_aircraft_in_the_air() -> None:
    """The item stopped on the ground: what it said then is not so any more."""
    async with rig() as flown:
        flown.virtual.set_rates(flight_status=0)
        status = flown.aircraft.state.flight_status
        assert status is not None
        assert status.status == FlightPhase.STANDBY
        async with flown.aircraft.control(stop="land") as control:
            await control.take_off()
            await flown.fly(control)
        assert flown.virtual.height == 0.0


async def test_one_false_standby_does_not_keep_an_aircraft_in_the_air() -> None:
    async with foreign() as (there, aircraft):
        async with aircraft.control(stop="land"):
            asyncio.get_running_loop().call_later(0.1, there.items.add, "status")
            tell_standby_once(there)
        assert there.tasks == [6]
        assert there.device != ONBOARD


async def test_stop_land_says_so_when_it_cannot_tell_whether_to_land(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
        await without_status(flown)
        with caplog.at_level(logging.ERROR):
            async with flown.aircraft.control(stop="land") as control:
                await flown.fly(control, 1.0)
        assert "stop='land' did not land: the flight status is unknown" in caplog.text
        assert flown.is_released


# -- a landing that is not answered ---------------------------------------------------------------


@pytest.mark.parametrize("to_aircraft", [1.0, 0.0])
@pytest.mark.parametrize("lost_s", [1.0, 5.0, 30.0, 90.0])
async def test_stop_land_lands_although_no_order_is_answered_for_a_while(
    to_aircraft: float, lost_s: float
) -> None:
    """Orders or only answers are lost. The aircraft lands, unless it hears nothing for a minute."""
    async with rig() as flown:
        async with flown.aircraft.control(
            stop="land", guards=Guards(stale_telemetry_s=None)
        ) as control:
            await control.take_off()
            await flown.fly(control, 1.0)
            loss = LineFaults(loss=1.0 - to_aircraft)
            flown.virtual.set_faults(loss, to_aircraft=LineFaults(loss=to_aircraft))
            asyncio.get_running_loop().call_later(lost_s, flown.virtual.set_faults)
            start = flown.now
        assert flown.now - start < 70.0, "bounded"
        is_unheard = to_aircraft == 1.0 and lost_s > 60.0
        assert (flown.virtual.height > 0.5) is is_unheard
        assert flown.is_running is is_unheard


async def test_a_landing_that_is_accepted_late_in_its_minute_has_all_its_time() -> None:
    """The release would break it off in the air."""
    async with rig() as flown:
        async with flown.aircraft.control(
            stop="land", guards=Guards(stale_telemetry_s=None)
        ) as control:
            await control.take_off()
            await control.climb_to(14.0)
            flown.virtual.set_faults(LineFaults(), to_aircraft=LineFaults(loss=1.0))
            asyncio.get_running_loop().call_later(57.0, flown.virtual.set_faults)
            start = flown.now
        assert flown.now - start > 60.0
        assert flown.virtual.height < 0.1
        assert not flown.is_running


async def test_a_landing_that_began_and_was_broken_off_is_not_ordered_again() -> None:
    """The aircraft says so when the pilot's sticks end it."""
    async with rig() as flown:
        async with flown.aircraft.control(stop="land") as control:
            await control.take_off()
            handlers = flown.virtual.autopilot._commands._handlers
            handlers[QueryTask] = lambda query: TaskResultCode.FAILED
        orders = flown.virtual.autopilot.received_commands
        tasks = [one.command.task for one in orders if isinstance(one.command, StartTask)]
        assert tasks == [Task.TAKE_OFF, Task.LAND]


# -- errors ---------------------------------------------------------------------------------------


async def test_a_failure_that_is_raised_again_and_again_does_not_grow() -> None:
    async with rig() as flown:
        depths = []
        with pytest.raises(LinkLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                asyncio.get_running_loop().call_soon(flown.virtual.unplug)
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(1.0)
                for _ in range(50):
                    try:
                        control.send(NORTH)
                    except LinkLost as error:
                        frames, traceback = 0, error.__traceback__
                        while traceback is not None:
                            frames, traceback = frames + 1, traceback.tb_next
                        depths.append(frames)
                await asyncio.sleep(1.0)
        assert len(set(depths)) == 1
        assert len(depths) == 50


async def test_after_the_block_it_is_over_whatever_ended_it() -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            pass
        with pytest.raises(NoAuthority, match="over with this block"):
            control.send(NORTH)


@pytest.mark.parametrize("after", [0.0, 0.001, 0.01, 0.019])
@pytest.mark.parametrize("stands_still", [0.25, 0.6, 5.0])
async def test_a_process_that_stands_still_on_its_way_out_sends_a_neutral_all_the_same(
    stands_still: float, after: float
) -> None:
    async with rig() as flown:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualClockEventLoop)

        def stand_still() -> None:
            loop._jumping.now += stands_still

        guards = Guards(stale_telemetry_s=None)
        async with flown.aircraft.control(guards=guards) as control:
            await control.take_off()
            await flown.fly(control, 0.5)
            control.send(NORTH)
            loop.call_later(after, stand_still)
        assert flown.is_neutral(flown.moves[-1])
        assert flown.is_released


@pytest.mark.parametrize(
    ("stands_still", "neutrals"), [(0.1, 15), (0.25, 12), (0.6, 15), (5.0, 15)]
)
async def test_a_process_that_stands_still_in_flight_sends_the_neutral_all_the_same(
    stands_still: float, neutrals: int
) -> None:
    """Of what expired meanwhile; how long an aircraft flies on by it is not known."""
    async with rig() as flown:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualClockEventLoop)

        def stand_still() -> None:
            loop._jumping.now += stands_still

        async with flown.aircraft.control(guards=Guards(stale_telemetry_s=None)) as control:
            await control.take_off()
            await flown.fly(control, 0.5)
            control.send(NORTH, lifetime=0.2)
            flown.moves.clear()
            loop.call_later(0.011, stand_still)
            await asyncio.sleep(6.0)
            are_neutral = [flown.is_neutral(move) for move in flown.moves]
            assert sum(are_neutral) == pytest.approx(neutrals, abs=1)
            assert are_neutral == sorted(are_neutral)
