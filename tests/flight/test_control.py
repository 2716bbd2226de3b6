"""Sending: hold, follow, ticks and stop, seen from the aircraft."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import nullcontext, suppress
from functools import partial
from itertools import pairwise
from math import inf
from random import Random
from typing import Any

import pytest

from m100link import (
    AuthorityState,
    BadSetpoint,
    CommandNotSupported,
    Control,
    GuardRefused,
    Guards,
    LinkLost,
    M100Error,
    MissionRunning,
    NoAuthority,
    Setpoint,
    TaskRefused,
    Tick,
    UsageError,
)
from m100link.flight.guards import GuardKeeper
from m100link.flight.setpoints import NEUTRAL_TIME
from m100link.flight.stop_path import StopAction
from m100link.link.requests import Requests
from m100link.protocol.commands.control import Move
from m100link.sim import VirtualClockEventLoop
from tests.flight.missions.foreign import foreign, spot
from tests.rig import FIRMWARES, NORTH, STILL, Rig, rig

pytestmark = pytest.mark.anyio


@pytest.fixture
async def flying() -> AsyncIterator[tuple[Rig, Control]]:
    """In the air, under control."""
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        yield flown, control


def north(speed: float) -> Setpoint:
    return Setpoint.velocity(north=speed, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def gaps(flown: Rig) -> list[float]:
    return [later - earlier for earlier, later in pairwise(flown.moves.times)]


# -- send -----------------------------------------------------------------------------------------


async def test_one_send_is_repeated_for_its_lifetime_then_neutral_then_silence(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    control.send(NORTH)
    await asyncio.sleep(3.0)
    speeds = [move.roll_or_x for move in flown.moves]
    assert 9 <= speeds.count(2.0) <= 11
    assert speeds.count(2.0) + speeds.count(0.0) == len(speeds)
    assert 14 <= speeds.count(0.0) <= 16
    assert speeds == sorted(speeds, reverse=True)
    assert control.setpoints_expired == 1
    await flown.assert_hovers()


async def test_setpoints_that_a_slow_computer_misses_are_counted(
    flying: tuple[Rig, Control], caplog: pytest.LogCaptureFixture
) -> None:
    """By whatever sends them: here a hold, which has no ticks of its own."""
    flown, control = flying
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    async with control.hold(NORTH, lifetime=5.0, allow_long_lifetime=True):
        for _ in range(50):
            await asyncio.sleep(1e-4)
            loop._jumping.now += 0.045
        assert control.pace.missed >= 40
        assert control.pace.rate_hz == pytest.approx(22.0, abs=2.0)
        assert flown.aircraft.statistics().missed_setpoints == control.pace.missed
    told = [record.message for record in caplog.records if "setpoints go out at" in record.message]
    assert len(told) == 1


async def test_a_hung_program_does_not_keep_the_aircraft_flying(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    await flown.fly(control, 2.0)
    hung_at = flown.now
    await asyncio.sleep(5.0)  # it awaits something that never comes
    last = max(t for t, m in zip(flown.moves.times, flown.moves, strict=True) if m.roll_or_x)
    assert last - hung_at < 0.2
    assert flown.moves.times[-1] - hung_at < 0.55


async def test_two_minutes_at_50_hz_are_6000_frames(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    start = flown.now
    count = 0
    async for tick in control.ticks():
        control.send(STILL)
        count += 1
        if tick.index == 5_999:
            break
    assert count == 6_000
    assert len(flown.moves.times) in (5_999, 6_000, 6_001)
    assert flown.now - start == pytest.approx(119.98, abs=1e-3)
    assert min(gaps(flown)) == pytest.approx(0.02, abs=1e-6)
    assert max(gaps(flown)) == pytest.approx(0.02, abs=1e-6)


async def test_each_tick_of_a_loop_gets_through_in_its_own_period(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    async for tick in control.ticks():
        control.send(north(tick.index / 100))
        if tick.index == 99:
            break
    await asyncio.sleep(0.001)
    speeds = [move.roll_or_x for move in flown.moves]
    assert speeds == pytest.approx([index / 100 for index in range(100)], abs=1e-6)


async def test_a_blocking_stall_of_the_program_is_a_gap_and_a_count(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualClockEventLoop)
    missed = []
    async for tick in control.ticks():
        control.send(NORTH)
        missed.append(tick.missed)
        if tick.index == 20:
            await asyncio.sleep(0.001)  # let the frame arrive before
            loop._jumping.now += 0.11
        if tick.index >= 50:
            break
    assert sum(missed) == 5
    assert sum(gap > 0.03 for gap in gaps(flown)) == 1
    assert min(gaps(flown)) > 0.009


@pytest.mark.parametrize("lifetime", [0.0, -1.0, float("nan")])
async def test_a_lifetime_that_is_none_is_refused(
    flying: tuple[Rig, Control], lifetime: float
) -> None:
    _, control = flying
    with pytest.raises(UsageError, match="lifetime"):
        control.send(NORTH, lifetime=lifetime)
    assert control.setpoints_sent == 0


async def test_a_lifetime_without_end_is_refused(flying: tuple[Rig, Control]) -> None:
    """A setpoint that outlives its program's attention is what lifetimes are there against."""
    _, control = flying
    with pytest.raises(UsageError, match="lifetime"):
        control.send(NORTH, lifetime=float("inf"))


@pytest.mark.parametrize("lifetime", [1.001, 60.0])
async def test_a_lifetime_above_a_second_needs_an_argument_that_says_so(
    flying: tuple[Rig, Control], lifetime: float
) -> None:
    """A program that hangs flies on for that long."""
    flown, control = flying
    with pytest.raises(UsageError, match="flies on for that long") as caught:
        control.send(NORTH, lifetime=lifetime)
    assert "allow_long_lifetime=True" in caught.value.remedy
    with pytest.raises(UsageError):
        async with control.hold(NORTH, lifetime=lifetime):
            pytest.fail("entered")
    with pytest.raises(UsageError):
        await control.follow(lambda _: NORTH, lifetime=lifetime)
    with pytest.raises(UsageError):
        await control.follow(lambda _: NORTH, rate_hz=1.0)
    assert len(flown.moves) == 0
    control.send(NORTH, lifetime=1.0)
    control.send(NORTH, lifetime=lifetime, allow_long_lifetime=True)


@pytest.mark.parametrize("rate", [0, 51, 1000])
async def test_a_rate_beyond_50_hz_is_refused(flying: tuple[Rig, Control], rate: float) -> None:
    _, control = flying
    with pytest.raises(UsageError, match="50 Hz"):
        control.send(NORTH, rate_hz=rate)
    with pytest.raises(UsageError, match="50 Hz"):
        control.ticks(rate)
    assert control.setpoints_sent == 0


async def test_before_the_block_nothing_is_sent() -> None:
    async with rig() as flown:
        control = flown.aircraft.control()
        with pytest.raises(NoAuthority, match="authority is none; nothing was sent") as caught:
            control.send(NORTH)
        assert "async with aircraft.control()" in caught.value.remedy
        await asyncio.sleep(0.1)
        assert len(flown.moves) == 0


async def test_a_setpoint_beside_a_closed_loop_hears_first_what_ended_the_block() -> None:
    async with rig() as flown:
        control = await flown.aircraft.control().obtain()
        await control.take_off()
        climbing = asyncio.create_task(control.climb_to(15.0))
        await asyncio.sleep(1.0)
        with pytest.raises(UsageError, match="closed loop"):
            control.send(NORTH)
        control.interrupt()
        with pytest.raises(NoAuthority, match="over with this block"):
            control.send(NORTH)
        await control.release()
        await asyncio.gather(climbing, return_exceptions=True)


async def test_where_a_block_is_in_its_life_can_be_asked() -> None:
    async with rig() as flown:
        control = flown.aircraft.control(stop="land")
        seen = []

        def look() -> None:
            life = control.is_flying, control.is_stopping, control.is_over
            seen.append((life, control.has_authority, control.is_paused))

        async def fly() -> None:
            async with control:
                await control.take_off()
                look()

        look()
        flight = asyncio.create_task(fly())
        await asyncio.sleep(8.0)  # it lands
        look()
        await flight
        look()
        assert seen == [
            ((False, False, False), False, False),
            ((True, False, False), True, False),
            ((False, True, False), True, False),
            ((False, False, True), False, False),
        ]
        assert control.state is flown.aircraft.state
        assert control.guards == Guards()
        position = control.state.position
        assert position is not None
        place = position.latitude_deg, position.longitude_deg
        assert control.origin == pytest.approx(place, abs=1e-5)


async def test_a_take_off_without_authority_is_not_first_a_matter_of_the_battery() -> None:
    async with rig() as flown:
        flown.virtual.battery_percent = 15
        await asyncio.sleep(1.5)
        with pytest.raises(NoAuthority):
            await flown.aircraft.control().take_off()


@pytest.mark.parametrize("task", [Control.land, Control.go_home])
async def test_nothing_is_flown_without_authority(
    task: Callable[[Control], Awaitable[None]],
) -> None:
    async with rig() as flown:
        async with flown.aircraft.control() as control:
            await control.take_off()
        count = len(flown.virtual.autopilot.received_commands)
        with pytest.raises(NoAuthority, match="over with this block"):
            await task(control)
        await asyncio.sleep(1.0)
        assert len(flown.virtual.autopilot.received_commands) == count
        await flown.assert_hovers()


# -- hold -----------------------------------------------------------------------------------------


async def test_hold_keeps_a_setpoint_that_is_renewed_and_leaves_it_neutral(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    async with control.hold(NORTH) as hold:
        for _ in range(20):
            await asyncio.sleep(0.15)
            hold.set(NORTH)
        assert {move.roll_or_x for move in flown.moves} == {2.0}
        assert flown.speed > 1.0
    left_at = flown.now
    await asyncio.sleep(1.0)
    after = [
        move.roll_or_x
        for time, move in zip(flown.moves.times, flown.moves, strict=True)
        if time > left_at
    ]
    assert set(after) == {0.0}
    assert 14 <= len(after) <= 16


async def test_hold_without_renewal_expires_like_any_setpoint(
    flying: tuple[Rig, Control], caplog: pytest.LogCaptureFixture
) -> None:
    flown, control = flying
    with caplog.at_level(logging.WARNING):
        async with control.hold(NORTH):
            await asyncio.sleep(5.0)
    assert control.setpoints_expired == 1
    assert "not renewed" in caplog.text
    assert flown.moves[-1].roll_or_x == 0.0
    assert flown.speed < 0.1


async def test_hold_may_be_given_a_longer_life(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    async with control.hold(NORTH, lifetime=2.0, rate_hz=10, allow_long_lifetime=True):
        await asyncio.sleep(1.95)
    assert {move.roll_or_x for move in list(flown.moves)[:19]} == {2.0}
    assert 19 <= sum(move.roll_or_x == 2.0 for move in flown.moves) <= 21


@pytest.mark.parametrize("rate_hz", [0.5, 2.0, 10.0])
async def test_leaving_a_hold_at_a_slow_rate_sends_neutral_at_once(
    flying: tuple[Rig, Control], rate_hz: float
) -> None:
    flown, control = flying
    async with control.hold(NORTH, rate_hz=rate_hz, lifetime=1.0):
        await asyncio.sleep(0.7)
    flown.moves.clear()
    await asyncio.sleep(1.0)
    assert len(flown.moves) >= 14
    flown.assert_stopped_in_order()


async def test_a_halt_does_not_wait_for_the_rate_of_what_it_ends(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    control.send(NORTH, rate_hz=1, lifetime=0.9)
    await asyncio.sleep(0.1)
    control.send(NORTH.neutral())
    await asyncio.sleep(0.022)
    assert flown.is_neutral(flown.moves[-1])


async def test_hold_that_fails_inside_leaves_neutral(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    with pytest.raises(ZeroDivisionError):
        async with control.hold(NORTH):
            await asyncio.sleep(0.1)
            raise ZeroDivisionError
    await asyncio.sleep(0.03)
    assert flown.moves[-1].roll_or_x == 0.0


async def test_hold_refuses_at_once_what_send_refuses(flying: tuple[Rig, Control]) -> None:
    _, control = flying
    with pytest.raises(GuardRefused):
        async with control.hold(Setpoint.velocity(north=9, east=9, up=0, yaw_rate_deg_s=0)):
            pytest.fail("entered")
    with pytest.raises(BadSetpoint):
        async with control.hold(
            Setpoint.velocity(north=1, east=0, up=0, yaw_rate_deg_s=0, stable=True)
        ):
            pytest.fail("entered")


# -- follow ---------------------------------------------------------------------------------------


async def test_follow_calls_a_function_at_each_tick_until_it_returns_none(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    ticks: list[Tick] = []

    def source(tick: Tick) -> Setpoint | None:
        ticks.append(tick)
        return north(1.0) if tick.elapsed < 1.0 else None

    await control.follow(source)
    assert len(ticks) == 51
    await asyncio.sleep(1.0)
    speeds = [move.roll_or_x for move in flown.moves]
    assert speeds[:50] == [1.0] * 50
    assert set(speeds[50:]) == {0.0}


async def test_follow_takes_setpoints_from_an_async_iterator_at_its_own_pace(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying

    async def source() -> AsyncIterator[Setpoint]:
        for step in range(10):
            yield north(1.0 + step)
            await asyncio.sleep(0.1)

    guarded = [1.0 + step for step in range(10)]
    await control.follow(source())
    seen = list(dict.fromkeys(move.roll_or_x for move in flown.moves if move.roll_or_x))
    assert seen == guarded
    await asyncio.sleep(0.03)
    assert flown.moves[-1].roll_or_x == 0.0


async def test_follow_at_a_slower_rate_keeps_the_setpoint_alive_between_its_ticks(
    flying: tuple[Rig, Control],
) -> None:
    """At 4 Hz a lifetime of 0.2 s would stop the aircraft between any two ticks."""
    flown, control = flying
    await control.follow(lambda tick: north(1.0) if tick.elapsed < 3.0 else None, rate_hz=4)
    await asyncio.sleep(0.1)
    flying_frames = [move for move in flown.moves if move.roll_or_x]
    first_neutral = next(i for i, move in enumerate(flown.moves) if not move.roll_or_x)
    assert first_neutral >= len(flying_frames)
    assert control.setpoints_expired == 0


async def test_a_slow_source_that_says_nothing_more_is_believed_for_two_of_its_ticks(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying

    async def source() -> AsyncIterator[Setpoint]:
        yield north(1.0)
        await asyncio.sleep(5.0)

    begun_at = flown.now
    await control.follow(source(), rate_hz=4)
    moves = zip(flown.moves.times, flown.moves, strict=True)
    last = max(time for time, move in moves if move.roll_or_x)
    assert 0.45 < last - begun_at < 0.51


async def test_follow_that_fails_leaves_neutral(flying: tuple[Rig, Control]) -> None:
    flown, control = flying

    def source(tick: Tick) -> Setpoint:
        if tick.index == 10:
            raise ZeroDivisionError
        return NORTH

    with pytest.raises(ZeroDivisionError):
        await control.follow(source)
    await asyncio.sleep(0.03)
    assert flown.moves[-1].roll_or_x == 0.0


async def test_follow_that_is_cancelled_leaves_neutral(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1.0):
            await control.follow(lambda tick: NORTH)
    await asyncio.sleep(0.03)
    assert flown.moves[-1].roll_or_x == 0.0


@pytest.mark.parametrize(
    ("order", "rate"),
    [("take_off", 5.0), ("disarm", 50.0), ("stop", 50.0), ("follow", 5.0), ("stop", None)],
)
async def test_follow_ends_by_what_another_task_asks_for_also_where_it_is_refused_within_a_tick(
    order: str, rate: float | None
) -> None:
    """In the air the aircraft refuses a take-off, and its motors are not stopped."""

    async def source() -> AsyncIterator[Setpoint]:
        await control.take_off()  # an order of its own ends nothing
        while True:
            yield NORTH
            await asyncio.sleep(0.1)

    async with rig(firmware="3.1") as flown, flown.aircraft.control() as control:
        if rate is None:
            work = asyncio.create_task(control.follow(source()))
            await asyncio.sleep(6.0)
        else:
            await control.take_off()
            work = asyncio.create_task(control.follow(lambda _: NORTH, rate_hz=rate))
            await asyncio.sleep(2.0)
        assert flown.speed > 1.5
        ask = partial(control.follow, lambda _: None) if order == "follow" else None
        with pytest.raises(TaskRefused) if order in ("take_off", "disarm") else nullcontext():
            await (ask or getattr(control, order))()
        with pytest.raises(NoAuthority, match=r"was ended|was sent during"):
            await work
        await asyncio.sleep(NEUTRAL_TIME + 0.1)
        await flown.assert_hovers()


# -- stop and experts -----------------------------------------------------------------------------


async def test_stop_sends_neutral_for_a_moment_and_the_aircraft_hovers(
    flying: tuple[Rig, Control],
) -> None:
    flown, control = flying
    await flown.fly(control, 2.0)
    await control.stop()
    flown.assert_stopped_in_order()
    await flown.assert_hovers()


async def test_stop_that_is_cancelled_still_falls_silent(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    await flown.fly(control, 1.0)
    task = asyncio.create_task(control.stop())
    await asyncio.sleep(0.1)
    task.cancel()
    await asyncio.sleep(0.5)
    flown.assert_stopped_in_order()


async def test_stop_does_not_silence_what_was_sent_after_it(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    control.send(NORTH)
    stopping = asyncio.create_task(control.stop())
    await asyncio.sleep(0.25)
    control.send(NORTH)
    await stopping
    count = len(flown.moves)
    await asyncio.sleep(0.1)
    assert len(flown.moves) > count + 3


async def test_a_task_ends_the_setpoint_before_it(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
    await asyncio.sleep(1.0)
    count, start = len(flown.moves), flown.now
    await control.land()
    later = list(flown.moves)[count + 1 :]
    assert all(map(flown.is_neutral, later)), "the autopilot lands: nobody steers beside it"
    assert later
    assert flown.moves.times[-1] - start < NEUTRAL_TIME + 0.05
    assert flown.virtual.height == 0.0


IDLE_IN_FLIGHT: dict[str, Callable[[Control], Coroutine[Any, Any, None]]] = {
    "take off": Control.take_off,
    "arm": Control.arm,
    "disarm": Control.disarm,
}


@pytest.mark.parametrize("order", IDLE_IN_FLIGHT)
@pytest.mark.parametrize("firmware", ["2.3", "3.1"])
async def test_an_order_that_does_nothing_in_flight_leaves_the_neutral_of_the_setpoint_before_it(
    order: str, firmware: str
) -> None:
    """Silence would leave the aircraft to the newest setpoint until the autopilot drops it."""
    chance = Random(f"{order} {firmware}")
    async with rig(firmware=firmware) as flown, flown.aircraft.control() as control:
        await control.take_off()
        for _ in range(5):
            control.send(NORTH, lifetime=1.0)
            # Also within the period of a frame, which gets no second one.
            await asyncio.sleep(wait := chance.uniform(0.3, 0.9))
            asked_at = flown.now
            with suppress(TaskRefused, CommandNotSupported):  # one that runs already is armed
                await IDLE_IN_FLIGHT[order](control)
            await asyncio.sleep(0.1)
            neutral_at = min(
                (
                    at
                    for at, move in zip(flown.moves.times, flown.moves, strict=True)
                    if at >= asked_at and flown.is_neutral(move)
                ),
                default=inf,
            )
            assert neutral_at - asked_at < 0.04, (wait, "s behind the setpoint")
            assert flown.is_neutral(flown.moves[-1])


async def test_stop_with_nothing_to_stop_takes_no_time(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    start = flown.now
    await control.stop()
    assert flown.now == start
    assert len(flown.moves) == 0


@pytest.mark.parametrize("state", [s for s in AuthorityState if s is not AuthorityState.HELD])
async def test_without_authority_no_frame_passes_the_last_gate_whatever_was_reported(
    flying: tuple[Rig, Control], state: AuthorityState
) -> None:
    """The state alone: nobody is notified, and the sending task has a setpoint that lives."""
    flown, control = flying
    control.send(NORTH, lifetime=1.0)
    await asyncio.sleep(0.1)
    assert len(flown.moves) > 3
    flown.aircraft.authority.state = state
    await asyncio.sleep(0.001)  # what is on the line arrives
    count = len(flown.moves)
    await asyncio.sleep(0.5)
    assert len(flown.moves) == count
    flown.aircraft.authority.state = AuthorityState.HELD


async def test_the_experts_door_sends_once_unchecked(flying: tuple[Rig, Control]) -> None:
    flown, control = flying
    move = Move(0xFF, 99.0, 99.0, 99.0, 999.0)
    assert control.send_raw_move_as_expert(move)
    await asyncio.sleep(1.0)
    assert list(flown.moves) == [move]


CIRCLE: dict[str, Any] = {
    "latitude_deg": spot(30.0, 0.0)[0],
    "longitude_deg": spot(30.0, 0.0)[1],
    "height": 20.0,
    "radius": 20.0,
    "rate_deg_s": 10.0,
}


async def push_raw(control: Control) -> None:
    control.send_raw_move_as_expert(Move(0, 0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("name", "fly"),
    [
        ("take off", Control.take_off),
        ("land", Control.land),
        ("fly_to", partial(Control.fly_to, north=1.0, east=0.0, up=0.0)),
        ("turn_to", partial(Control.turn_to, yaw_deg=90.0)),
        ("a raw movement command", push_raw),
    ],
)
async def test_while_a_mission_flies_what_else_would_fly_is_refused_by_name_and_at_once(
    name: str, fly: Callable[[Control], Awaitable[None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with foreign() as (there, aircraft), aircraft.control() as control:
        async with control.hotpoint(**CIRCLE):
            await asyncio.sleep(5.0)
            monkeypatch.setattr(GuardKeeper, "admit_take_off", lambda _: pytest.fail("battery"))
            count, began_at = len(there.movements), asyncio.get_running_loop().time()
            with pytest.raises(MissionRunning, match=f"{name} was asked for while a hotpoint"):
                await fly(control)
            assert asyncio.get_running_loop().time() == began_at
            assert len(there.movements) == count
            assert there.missions.flying == "hotpoint"


async def test_the_experts_door_needs_authority_too() -> None:
    async with rig() as flown:
        with pytest.raises(NoAuthority):
            flown.aircraft.control().send_raw_move_as_expert(Move(0, 0, 0, 0, 0))


async def test_movement_is_encrypted_once_there_is_a_key() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        control.send(NORTH)
        await asyncio.sleep(0.02)
        assert flown.virtual.autopilot.counters.movements >= 1
        assert flown.virtual.autopilot.counters.undecodable == 0


async def test_a_line_that_does_not_drain_drops_setpoints_instead_of_queueing_them() -> None:
    async with rig() as flown, flown.aircraft.control() as control:
        await control.take_off()
        flown.aircraft.link.pause_writing()
        for _ in range(20):
            control.send(north(2.0))
            await asyncio.sleep(0.02)
        assert len(flown.moves) == 0
        flown.aircraft.link.resume_writing()
        control.send(north(3.0))
        await asyncio.sleep(0.03)
        assert {move.roll_or_x for move in flown.moves} == {3.0}
        assert flown.aircraft.statistics().dropped_writes >= 18


# -- what nobody expected --------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("stop", ["hover", "land"])
async def test_an_error_in_the_sending_task_takes_the_stop_path_and_reaches_the_program(
    firmware: str,
    stop: StopAction,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The neutral can be sent, as another command can."""
    push = Requests.push

    def explode(requests: Requests, command: object) -> bool:
        if isinstance(command, Setpoint) and command.x:
            raise ZeroDivisionError("a bug")
        return push(requests, command)  # type: ignore[arg-type]  # passed on as it is

    async with rig(firmware=firmware) as flown:
        with pytest.raises(M100Error, match=r"cannot be sent: ZeroDivisionError") as caught:
            async with flown.aircraft.control(stop=stop) as control:
                await control.take_off()
                control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
                await asyncio.sleep(1.0)
                monkeypatch.setattr(Requests, "push", explode)
                failed_at = flown.now
                await asyncio.sleep(30.0)
        assert isinstance(caught.value.__cause__, ZeroDivisionError)
        assert "ZeroDivisionError" in caplog.text
        assert flown.now < failed_at + (1.0 if stop == "hover" else 20.0)
        flown.assert_stopped_in_order()
        assert flown.is_released
        assert flown.is_running is (stop == "hover")


async def test_a_line_that_is_found_gone_by_sending_ends_the_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def find_it_gone(*_: object) -> None:
        raise LinkLost("the line is gone")

    async with rig() as flown:
        with pytest.raises(LinkLost):
            async with flown.aircraft.control() as control:
                await control.take_off()
                control.send(NORTH, lifetime=1.0)
                monkeypatch.setattr(Requests, "push", find_it_gone)
                found_at = flown.now
                await asyncio.sleep(30.0)
        assert flown.now - found_at < 0.1
        monkeypatch.undo()


async def test_a_program_that_cancels_every_other_task_does_not_fly_on_unheard() -> None:
    async with rig() as flown:
        before = asyncio.all_tasks()
        with pytest.raises(M100Error, match="was cancelled"):
            async with flown.aircraft.control() as control:
                await control.take_off()
                control.send(NORTH, lifetime=30.0, allow_long_lifetime=True)
                await asyncio.sleep(1.0)
                for task in asyncio.all_tasks() - before:
                    task.cancel()
                await asyncio.sleep(30.0)
        flown.assert_stopped_in_order()
        assert flown.is_released
        await flown.assert_hovers()


async def test_when_nothing_can_be_sent_at_all_the_block_ends_all_the_same(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def explode(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    async with rig() as flown:
        with pytest.raises(M100Error, match=r"cannot be sent"):
            async with flown.aircraft.control() as control:
                await control.take_off()
                control.send(NORTH, lifetime=1.0)
                monkeypatch.setattr(Setpoint, "encode", explode)
                monkeypatch.setattr(Requests, "push", explode)
                await asyncio.sleep(30.0)
        assert "setpoints cannot be sent" in caplog.text
        assert flown.is_released
        await flown.assert_hovers()


async def test_a_guard_that_breaks_is_a_guard_that_says_no(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def explode(*_: object) -> None:
        raise ValueError("math domain error")

    async with rig() as flown:
        with pytest.raises(M100Error, match="math domain error"):
            async with flown.aircraft.control() as control:
                await control.take_off()
                control.send(NORTH, lifetime=1.0)
                monkeypatch.setattr(GuardKeeper, "check", explode)
                await asyncio.sleep(30.0)
        assert flown.is_released
        await flown.assert_hovers()
