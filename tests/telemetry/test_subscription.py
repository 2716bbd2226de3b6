"""Telemetry for many consumers: policies, rate limits, ages, statistics, and how it ends."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

from m100link import (
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightPhase,
    FlightStatus,
    Gimbal,
    Latest,
    LayoutMismatch,
    LinkClosed,
    LinkLost,
    Lossless,
    Magnetometer,
    Newest,
    Position,
    RemoteControl,
    Sample,
    TelemetryOverflow,
    TelemetryStalled,
    Time,
    UsageError,
    Velocity,
)
from m100link.protocol.firmware import FIRMWARE_1_0, PROFILES
from m100link.protocol.items import BY_NAME, BY_RECORD
from m100link.sim import VirtualClockEventLoop
from m100link.telemetry.subscription import Hub, Policy, Subscription, TelemetryStream
from tests.rig import FIRMWARES, rig
from tests.support import load_vectors

pytestmark = pytest.mark.anyio


def filled(policy: Policy, count: int) -> Subscription[int]:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(policy)
    for value in range(count):
        hub.publish(value, 0.01 * value)
    return subscription


def drain(subscription: Subscription[int]) -> list[int]:
    values = []
    while (value := subscription.get_nowait()) is not None:
        values.append(value)
    return values


# -- policies -------------------------------------------------------------------------------------


def test_latest_keeps_the_newest_value_and_counts_the_others() -> None:
    subscription = filled(Latest(), 10)
    assert (drain(subscription), subscription.received, subscription.dropped) == ([9], 10, 9)


def test_newest_keeps_so_many_and_counts_what_it_drops() -> None:
    subscription = filled(Newest(3), 10)
    assert (drain(subscription), subscription.received, subscription.dropped) == ([7, 8, 9], 10, 7)


async def test_lossless_gives_every_value_then_tells_the_overflow() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Lossless(5))
    for value in range(7):
        hub.publish(value, 0.01 * value)
    assert [await anext(subscription) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(TelemetryOverflow, match="5 values wait") as caught:
        await anext(subscription)
    assert caught.value.remedy
    hub.publish(8, 1.0)
    with pytest.raises(TelemetryOverflow):
        await anext(subscription)


async def test_lossless_that_is_read_in_time_loses_nothing() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Lossless(5))
    seen = []
    for value in range(100):
        hub.publish(value, 0.0)
        if value % 3 == 2:
            seen += [await anext(subscription) for _ in range(3)]
    assert seen == list(range(99))
    assert subscription.dropped == 0


@pytest.mark.parametrize("policy", [Newest, Lossless])
@pytest.mark.parametrize("count", [0, -1])
def test_a_policy_that_keeps_nothing_is_refused(
    policy: type[Newest | Lossless], count: int
) -> None:
    """It would break in the reader of the line, at the first value."""
    with pytest.raises(UsageError, match=str(count)):
        policy(count)


# -- rate limit -----------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [1, 3, 7, 10, 25, 50, 99])
def test_a_rate_limit_lets_so_many_through_and_never_a_burst(rate: int) -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Lossless(10_000), min_interval=1 / rate)
    for index in range(100 * 60):
        hub.publish(index, index / 100)
    taken = drain(subscription)
    assert 60 * rate - 1 <= len(taken) <= 60 * rate + 1
    assert subscription.thinned == 100 * 60 - len(taken)
    # In any second no more than asked for.
    for first, last in zip(taken, taken[rate:], strict=False):
        assert (last - first) / 100 >= 1.0 - 0.02


def test_the_first_value_comes_at_once_and_the_second_waits_its_turn() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Newest(100), min_interval=0.1)
    for index in range(21):
        hub.publish(index, 5.0 + index / 100)
    assert drain(subscription) == [0, 10, 20]


def test_after_a_long_gap_there_is_no_burst() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Newest(100), min_interval=0.1)
    hub.publish(0, 0.0)
    for index in range(1, 12):
        hub.publish(index, 10.0 + index / 100)
    assert drain(subscription) == [0, 1, 11]


def test_a_late_value_does_not_shift_the_ones_after_it() -> None:
    hub: Hub[float] = Hub()
    subscription = hub.subscribe(Newest(100), min_interval=0.1)
    for time in (0.0, 0.1, 0.23, 0.3, 0.4):
        hub.publish(time, time)
    assert subscription.received == 5


@pytest.mark.parametrize("rate", [0, -5, float("nan")])
async def test_a_rate_that_is_no_rate_is_refused(rate: float) -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(UsageError, match="rate"):
            flown.aircraft.telemetry(rate_hz=rate)


async def test_only_records_can_be_asked_for() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(UsageError, match="not a telemetry record"):
            flown.aircraft.telemetry(int)


# -- ending ---------------------------------------------------------------------------------------


async def test_close_ends_the_iteration_also_of_a_task_that_waits() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Latest())

    async def consume() -> list[int]:
        return [value async for value in subscription]

    task = asyncio.create_task(consume())
    await asyncio.sleep(0)
    subscription.close()
    subscription.close()
    assert await task == []


async def test_two_tasks_on_one_subscription_are_a_mistake_that_is_reported() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Latest())
    first = asyncio.ensure_future(anext(subscription))
    await asyncio.sleep(0)
    with pytest.raises(RuntimeError, match="give each its own"):
        await anext(subscription)
    hub.publish(1, 0.0)
    assert await first == 1


async def test_a_cancelled_wait_loses_no_value() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Lossless())
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.1):
            await anext(subscription)
    hub.publish(1, 0.0)
    assert await anext(subscription) == 1


async def test_a_closed_subscription_leaves_the_hub() -> None:
    hub: Hub[int] = Hub()
    async with hub.subscribe(Latest()) as subscription:
        hub.publish(1, 0.0)
        assert await anext(subscription) == 1
    hub.publish(2, 0.0)
    assert subscription.received == 1


async def test_a_subscription_that_a_loop_breaks_out_of_costs_nothing_any_more() -> None:
    hub: Hub[int] = Hub()
    asyncio.get_running_loop().call_soon(hub.publish, 1, 0.0)
    async for value in hub.subscribe(Latest()):
        assert value == 1
        break
    (queue,) = hub._queues
    hub.publish(2, 0.0)
    assert queue.received == 1
    assert hub._queues == ()


async def test_a_task_that_nobody_refers_to_goes_on_waiting() -> None:
    hub: Hub[int] = Hub()
    taken: list[int] = []

    async def consume() -> None:
        with pytest.raises(LinkLost):
            async for value in hub.subscribe(Latest()):
                taken.append(value)
        taken.append(-1)

    asyncio.get_running_loop().call_soon(lambda: asyncio.create_task(consume()))
    for value in range(3):
        await asyncio.sleep(0.1)
        gc.collect()
        hub.publish(value, 0.0)
    await asyncio.sleep(0.1)
    hub.fail(LinkLost("gone"))
    await asyncio.sleep(0.1)
    assert taken == [0, 1, 2, -1]


async def test_a_subscription_that_goes_while_a_value_is_handed_out_disturbs_nobody() -> None:
    """As when a value that makes room for it is the last thing that refers to a subscription."""
    others: list[Subscription[object]] = []

    class Value:
        def __del__(self) -> None:
            others[:] = [hub.subscribe(Latest())]

    hub: Hub[object] = Hub()
    first = hub.subscribe(Latest())
    others.append(hub.subscribe(Latest()))
    last = hub.subscribe(Latest())
    for _ in range(4):
        hub.publish(Value(), 0.0)
    assert (first.received, last.received) == (4, 4)
    assert (first.dropped, last.dropped) == (3, 3)
    hub = Hub()  # the values that are left find another one


async def test_a_value_goes_where_one_of_its_kinds_is_wanted() -> None:
    hub: Hub[int] = Hub()
    one, two, both, every = (hub.subscribe(Latest(), wanted=bits) for bits in (1, 2, 3, -1))
    for kinds in (0, 1, 2, 3, 4):
        hub.publish(kinds, 0.0, kinds)
    hub.publish(5, 0.0)
    assert [queue.received for queue in (one, two, both, every)] == [3, 3, 4, 5]


async def test_an_error_that_is_raised_again_does_not_grow() -> None:
    hub: Hub[int] = Hub()
    subscription = hub.subscribe(Latest())
    cause = OSError(5, "unplugged")
    error = LinkLost("gone", remedy="plug it in")
    error.__cause__ = cause
    hub.fail(error)
    raised = []
    for _ in range(3):
        with pytest.raises(LinkLost, match="gone") as caught:
            await anext(subscription)
        raised.append((caught.value, len(caught.traceback)))
    assert len({depth for _, depth in raised}) == 1
    assert len({id(one) for one, _ in raised}) == 3
    assert all(one.__cause__ is cause and one.remedy == "plug it in" for one, _ in raised)


async def test_a_hub_that_failed_fails_those_who_come_later_too() -> None:
    hub: Hub[int] = Hub()
    hub.fail(LinkLost("gone"))
    with pytest.raises(LinkLost):
        await anext(hub.subscribe(Latest()))


# -- over the virtual aircraft --------------------------------------------------------------------


async def test_a_slow_a_blocked_and_a_dead_consumer_do_not_delay_the_others() -> None:
    """One sleeps ten seconds, one stopped reading for ever, one fell to an exception."""
    async with rig(activated=False) as flown:
        aircraft = flown.aircraft
        lateness: list[float] = []

        async def quick() -> None:
            async with aircraft.telemetry(Attitude) as samples:
                async for sample in samples:
                    lateness.append(flown.now - sample.received_at)

        async def sleepy() -> float:
            async with aircraft.telemetry(Attitude) as samples:
                await anext(samples)
                await asyncio.sleep(10.0)
                return flown.now - (await anext(samples)).received_at

        async def broken() -> None:
            async with aircraft.telemetry(policy=Lossless(10)) as samples:
                async for _ in samples:
                    raise ZeroDivisionError

        dead = aircraft.telemetry(policy=Newest(5))  # nobody ever reads it
        tasks = [asyncio.create_task(work()) for work in (quick, broken)]
        oldest = await sleepy()
        assert oldest <= 0.01 + 1e-9, "the newest value after ten seconds is no ten seconds old"
        assert len(lateness) >= 1000
        assert max(lateness) == 0.0
        assert dead.dropped == dead.received - 5
        with pytest.raises(ZeroDivisionError):
            await tasks[1]
        tasks[0].cancel()


async def test_a_program_that_blocks_for_ten_seconds_loses_old_values_and_no_new_ones() -> None:
    async with rig(activated=False) as flown:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualClockEventLoop)
        async with flown.aircraft.telemetry(Attitude) as samples:
            await anext(samples)
            loop._jumping.now += 10.0
            sample = await anext(samples)
            while flown.now - sample.received_at > 0.02:
                sample = await anext(samples)
            assert flown.now - sample.received_at <= 0.02


async def test_an_overflow_concerns_its_own_consumer_only() -> None:
    async with rig(activated=False) as flown:
        slow = flown.aircraft.telemetry(policy=Lossless(10))
        good = flown.aircraft.telemetry(policy=Lossless(1000))
        await asyncio.sleep(2.0)
        values = [await anext(slow) for _ in range(10)]
        assert len(values) == 10
        with pytest.raises(TelemetryOverflow):
            await anext(slow)
        assert len([await anext(good) for _ in range(190)]) == 190


@pytest.mark.parametrize("policy", [Latest(), Newest(3), Lossless()], ids=repr)
async def test_a_lost_link_ends_every_iterator_with_the_cause(policy: Policy) -> None:
    async with rig(activated=False) as flown:
        taken: list[Sample] = []

        async def consume() -> None:
            async with flown.aircraft.telemetry(policy=policy) as samples:
                async for sample in samples:
                    taken.append(sample)

        task = asyncio.create_task(consume())
        mobile = asyncio.ensure_future(anext(flown.aircraft.from_mobile()))
        await asyncio.sleep(0.5)
        flown.virtual.unplug()
        with pytest.raises(LinkLost):
            await task
        with pytest.raises(LinkLost):
            await mobile
        assert taken
        with pytest.raises(LinkLost):
            await anext(flown.aircraft.telemetry())
        with pytest.raises(LinkLost):
            await flown.aircraft.wait_for(lambda state: False, timeout=5)


async def test_closing_ends_every_iterator_too_and_says_who_closed() -> None:
    async with rig(activated=False) as flown:
        samples = flown.aircraft.telemetry(Attitude)
        await anext(samples)
        await flown.aircraft.aclose()
        with pytest.raises(LinkClosed):
            while True:
                await anext(samples)


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_an_item_that_never_came_is_none_with_no_age_and_no_rate(firmware: str) -> None:
    async with rig(activated=False, firmware=firmware) as flown:
        await asyncio.sleep(2.0)
        state = flown.aircraft.state
        for record, value in (
            (Magnetometer, state.magnetometer),
            (ControlDevice, state.control_device),
        ):
            assert value is None
            assert state.get(record) is None
            assert state.age(record) is None
            assert state.received_at(record) is None
            assert state.fresh(record, within=1e9) is None
            statistics = state.statistics(record)
            assert (statistics.count, statistics.rate_hz, statistics.jitter_s) == (0, None, None)
        assert state.battery == Battery(100)


@pytest.mark.parametrize("firmware", FIRMWARES)
async def test_every_item_arrives_with_its_rate_and_age(firmware: str) -> None:
    """Rates of document 2.2.3.1; the two that are off by default are switched on."""
    async with rig(activated=False, firmware=firmware) as flown:
        flown.virtual.set_rates(magnetometer=10, control_device=50)
        await asyncio.sleep(5.0)
        state = flown.aircraft.state
        arriving: dict[type[Any], int] = {
            Time: 100,
            Attitude: 100,
            Acceleration: 100,
            Velocity: 100,
            AngularVelocity: 100,
            Position: 100,
            Magnetometer: 10,
            RemoteControl: 50,
            Gimbal: 50,
            FlightStatus: 10,
            Battery: 1,
            ControlDevice: 50,
        }
        missing = [record.__name__ for record in BY_RECORD if record not in arriving]
        assert not missing, f"the rates of this test have no row for {missing}"
        sent = {BY_NAME[name].record for name in PROFILES[firmware].items}
        expected = {record: rate for record, rate in arriving.items() if record in sent}
        rates = {record: state.statistics(record).rate_hz for record in BY_RECORD if record in sent}
        assert rates == pytest.approx(expected, rel=0.01)
        for record, rate in expected.items():
            age, statistics = state.age(record), state.statistics(record)
            assert age is not None
            assert 0 <= age <= 1 / rate + 1e-9
            assert statistics.jitter_s == pytest.approx(0.0, abs=1e-6)
            assert statistics.longest_gap_s == pytest.approx(1 / rate, abs=0.02)


async def test_a_stall_shows_as_age_and_longest_gap() -> None:
    async with rig(activated=False) as flown:
        await asyncio.sleep(1.0)
        flown.virtual.line.stall(to_host=True, to_aircraft=False)
        await asyncio.sleep(3.0)
        age = flown.aircraft.state.age(Attitude)
        assert age == pytest.approx(3.0, abs=0.02)
        assert flown.aircraft.state.newest_age == age
        assert flown.aircraft.state.fresh(Attitude, within=1.0) is None
        assert flown.aircraft.state.fresh(Attitude, within=4.0) is not None
        flown.virtual.line.stall(to_host=False, to_aircraft=False)
        await asyncio.sleep(0.5)
        assert flown.aircraft.state.statistics(Attitude).longest_gap_s == pytest.approx(
            3.0, abs=0.05
        )


async def test_statistics_speak_of_the_newest_arrivals() -> None:
    async with rig(activated=False) as flown:
        await asyncio.sleep(3.0)
        flown.virtual.set_rates(quaternion=10)
        await asyncio.sleep(4.0)
        assert flown.aircraft.state.statistics(Attitude).rate_hz == pytest.approx(10, rel=0.02)


async def test_packages_without_the_wanted_items_are_left_out() -> None:
    async with rig(activated=False) as flown:
        async with flown.aircraft.telemetry(Battery, policy=Lossless()) as samples:
            await asyncio.sleep(5.05)
            assert 5 <= samples.received <= 6
            sample = await anext(samples)
            assert sample[Battery].percent == 100
            with pytest.raises(KeyError, match="Magnetometer"):
                sample[Magnetometer]
            assert sample.magnetometer is None


async def test_a_rate_limit_over_the_line() -> None:
    async with rig(activated=False) as flown:
        async with flown.aircraft.telemetry(Attitude, rate_hz=10, policy=Lossless()) as samples:
            await asyncio.sleep(10.0)
            assert samples.received in (100, 101)


# -- wait_for -------------------------------------------------------------------------------------


async def test_wait_for_returns_at_the_package_that_makes_it_true() -> None:
    async with rig() as flown:
        flown.virtual.pilot_takes_off()
        await flown.aircraft.wait_for(
            lambda state: state.flight_status == FlightStatus(FlightPhase.IN_AIR), timeout=10
        )
        assert flown.phase is FlightPhase.IN_AIR
        start = flown.now
        await flown.aircraft.wait_for(lambda state: state.position is not None)
        assert flown.now == start


async def test_wait_for_gives_up_with_what_it_saw() -> None:
    async with rig() as flown:
        start = flown.now
        with pytest.raises(TelemetryStalled, match="a take-off was not seen within 2 s") as caught:
            await flown.aircraft.wait_for(
                lambda state: state.flight_status == FlightStatus(FlightPhase.IN_AIR),
                timeout=2.0,
                what="a take-off",
            )
        assert flown.now - start == pytest.approx(2.0)
        assert isinstance(caught.value, TimeoutError)
        assert "STANDBY" in str(caught.value)


async def test_wait_for_leaves_no_subscription_behind() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(TelemetryStalled):
            await flown.aircraft.wait_for(lambda state: False, timeout=0.1)
        assert all(queue.is_closed for queue in flown.aircraft._telemetry.hub._queues)


async def test_a_timeout_of_the_callers_own_stays_the_callers() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(TimeoutError) as caught:
            async with asyncio.timeout(0.5):
                await flown.aircraft.wait_for(lambda state: False, timeout=5.0)
        assert not isinstance(caught.value, TelemetryStalled)


async def test_a_predicate_that_fails_fails_its_caller_only() -> None:
    async with rig(activated=False) as flown:
        with pytest.raises(ZeroDivisionError):
            await flown.aircraft.wait_for(lambda state: bool(1 / 0))
        await flown.aircraft.wait_for(lambda state: state.attitude is not None, timeout=1)


# -- layouts --------------------------------------------------------------------------------------


async def test_packages_that_do_not_fit_are_refused_counted_and_reported_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A 3.1 aircraft read as 1.0: every package has bytes that 1.0 does not know."""
    async with rig(activated=False, firmware="3.1") as flown:
        async with flown.virtual.connect(firmware="1.0") as misread:
            await asyncio.sleep(2.0)
            assert misread.telemetry_mismatches > 150
            assert misread.state.attitude is None
            assert misread.state.position is None
        told = [r.message for r in caplog.records if "telemetry refused" in r.message]
        assert len(told) == 1
        assert "3.1" in told[0], "the profile that fits is named"


def test_a_mismatch_names_the_profiles_that_fit() -> None:
    vector = next(
        v for v in load_vectors("telemetry") if v["firmware"] == "3.1" and v["flags"] == 4095
    )
    with pytest.raises(LayoutMismatch, match=r"3\.1"):
        Sample(bytes.fromhex(vector["value"]), FIRMWARE_1_0, 0.0)


def test_a_firmware_with_another_tick_has_another_clock() -> None:
    """600 ticks a second on 1.0 and 2.3, 400 on 3.1."""
    stream = TelemetryStream(lambda _: None, lambda: 0.0)
    clocks = [stream.clock_of(PROFILES[name]) for name in ("1.0", "2.3", "3.1", "3.1", "1.0")]
    assert [clock.tick_hz for clock in clocks] == [600, 600, 400, 400, 600]
    assert clocks[0] is clocks[1]
    assert clocks[2] is clocks[3]
    assert clocks[4] is not clocks[0]
