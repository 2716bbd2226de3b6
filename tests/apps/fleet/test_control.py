"""Control over the network: one operator at a time, and the loser of it hears so."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import math
from random import Random
from typing import Any

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.latency import ClockEstimate
from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.agent.orders import FlyTo
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.control import FleetControl
from m100link.errors import (
    AckTimeout,
    GuardRefused,
    M100Error,
    OutcomeUnknown,
    StaleLease,
    TaskRefused,
    UsageError,
)
from m100link.geodesy import LocalFrame
from m100link.protocol.setpoint import Setpoint
from m100link.sim.vehicle.settings import AircraftSettings
from m100link.sim.virtual import VirtualAircraft
from tests.apps.bus.memory import Weather
from tests.apps.fleet.conftest import Rig
from tests.apps.fleet.missions.conftest import away

pytestmark = pytest.mark.anyio

NO_NUMBER = (math.nan, math.inf, -math.inf)
HUGE = (1e9, -1e9, 3.5e38, 1e300)
HERE = {"latitude_deg": 22.54, "longitude_deg": 113.95, "height": 4.0}
IMPOSSIBLE: list[
    tuple[type[orders.GuidedOrder], dict[str, float], dict[str, tuple[float, ...]]]
] = [
    (
        orders.FlyTo,
        HERE | {"speed": 3.0},
        {"latitude_deg": (91.0, *HUGE), "longitude_deg": (361.0, *HUGE), "height": (-1.0, *HUGE)}
        | {"speed": (0.0, -1.0, 10.5, *HUGE), "yaw_deg": ()},
    ),
    (
        orders.FlyAround,
        HERE | {"radius": 5.0, "speed": 2.0},
        {"latitude_deg": (91.0, *HUGE), "longitude_deg": (361.0, *HUGE), "height": (-1.0, *HUGE)}
        | {"radius": (0.5, -5.0, *HUGE), "speed": (0.0, -1.0, 10.5, *HUGE), "turns": (0.0, -1.0)},
    ),
    (orders.ChangeHeight, {}, {"height": (-1.0, 50.1, *HUGE)}),
    (orders.ChangeHeading, {}, {"yaw_deg": ()}),
]
"""Orders to fly, numbers that each takes, and those that no field takes beside what is none."""

NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def test_one_flies_to_a_place_and_lands_as_the_block_is_left(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control(stop="land") as control:
        await control.take_off()
        card = await pilot["a1"].card()
        assert card.holder == "pilot"
        assert card.latitude_deg is not None
        assert card.longitude_deg is not None
        frame = LocalFrame(card.latitude_deg, card.longitude_deg)
        latitude, longitude = frame.to_geodetic(10.0, 0.0)
        await control.fly_to(latitude_deg=latitude, longitude_deg=longitude, height=5.0)
        card = await pilot["a1"].card()
        assert card.height_m == pytest.approx(5.0, abs=0.6)
        assert one.height > 4.0
    assert one.height < 0.1
    assert one.client.holder.number == 0


@pytest.mark.parametrize("seed", range(2))
async def test_a_number_that_cannot_be_flown_moves_nothing(rig: Rig, seed: int) -> None:
    draw = Random(seed)
    settings = AircraftSettings(latitude_deg=22.54, longitude_deg=113.95)
    one = await rig.aircraft("a1", virtual=VirtualAircraft(seed=5, settings=settings))
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
        await rig.until(lambda: one.speed < 0.05)
        for _ in range(25):
            kind, good, fields = draw.choice(IMPOSSIBLE)
            field = draw.choice([*fields])
            order = kind(**good | {field: draw.choice((*NO_NUMBER, *fields[field]))})  # type: ignore[arg-type]  # drawn
            with pytest.raises(M100Error):
                await control.ask(order)
            assert abs(one.height - 1.2) < 0.2, (seed, order)
            assert one.speed < 0.05, (seed, order)


@pytest.mark.parametrize("what", ["unanswered", "refused", "of a take-off", "of a mission"])
async def test_the_landing_at_the_end_of_a_block_is_asked_for_again(rig: Rig, what: str) -> None:
    """Its lease goes back behind it: an aircraft that hovers then has nobody."""
    virtual = VirtualAircraft(seed=5, firmware="3.1")
    one, pilot = await rig.aircraft("a1", virtual=virtual), await rig.pilot()
    errors = {"unanswered": AckTimeout("land"), "refused": TaskRefused("another task ends")}
    left, asked = 20 if what in errors else 0, one.client.ask

    async def ask(order: orders.Order, *given: Any, **more: Any) -> Any:
        nonlocal left
        if isinstance(order, orders.Land) and left:
            left -= 1
            raise errors[what]
        return await asked(order, *given, **more)

    one.client.ask = ask  # type: ignore[method-assign]  # for this test
    async with pilot["a1"].control(stop="land") as control:
        if what == "of a take-off":
            taking_off = asyncio.ensure_future(control.take_off())
            await rig.until(lambda: one.client.state.task)
            taking_off.cancel()
        else:
            await control.take_off()
        if what == "of a mission":
            await control.missions.start(await control.missions.upload(away(one, 30, 90)))
    assert left == 0
    assert one.height < 0.1
    assert one.client.holder.number == 0


async def test_a_stop_ends_the_landing_at_the_end_of_a_block(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    asked, refused = one.client.ask, 0

    async def ask(order: orders.Order, *given: Any, **more: Any) -> Any:
        nonlocal refused
        if isinstance(order, orders.Land) and not refused:
            refused += 1
            raise TaskRefused("another task ends")
        return await asked(order, *given, **more)

    one.client.ask = ask  # type: ignore[method-assign]  # for this test
    with pytest.raises(GuardRefused, match="STOP was pressed after land was asked for"):
        async with pilot["a1"].control(stop="land") as control:
            await control.take_off()
            stopping = asyncio.ensure_future(rig.until(lambda: refused))
            stopping.add_done_callback(lambda _: one.agent.background.spawn(one.agent.stop(), ""))
    before = one.height
    await anyio.sleep(4.0)
    assert one.height == pytest.approx(before, abs=0.5)


async def test_a_program_whose_steps_are_blocks_does_not_fly_on_after_a_stop(rig: Rig) -> None:
    """It did not hear of it: the STOP came between two of them."""
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(), await rig.pilot("other")
    await pilot["a1"].take_off()
    await anyio.sleep(1.0)
    await one.agent.stop()
    await anyio.sleep(1.0)
    for take_over in (False, True):
        with pytest.raises(GuardRefused, match="STOP was pressed after acquire lease was asked"):
            async with pilot["a1"].control(take_over=take_over) as control:
                control.send(NORTH)
        assert one.client.holder.number == 0
        if not take_over:
            await anyio.sleep(0.1)
            await one.agent.stop()  # once more
    async with pilot["a1"].control() as control:  # it has heard of it
        control.send(NORTH)
    async with other["a1"].control():  # it began behind the STOP
        pass
    await pilot["a1"].stop()  # its own
    async with pilot["a1"].control():
        await anyio.sleep(0.1)
        await one.agent.stop()
    with pytest.raises(GuardRefused, match="STOP was pressed"):
        await pilot["a1"].take_off()


async def test_of_two_pilots_one_has_it_and_a_take_over_ends_the_other(rig: Rig) -> None:
    await rig.aircraft("a1")
    first, second = await rig.pilot("first"), await rig.pilot("second")
    with pytest.raises(M100Error):
        async with first["a1"].control() as control:
            with pytest.raises(LeaseHeld, match="first"):
                async with second["a1"].control():
                    pass
            async with second["a1"].control(take_over=True) as taken:
                assert taken.fence > control.fence
                await anyio.sleep(5.0)


@pytest.mark.parametrize("waits", ["as its clock is set", "as all before is forgotten"])
async def test_no_setpoint_is_stamped_by_a_clock_that_is_not_known_any_more(
    rig: Rig, waits: str
) -> None:
    """Answers that are slow now, where the last eight before were fast: it is 0.7 s wrong."""
    await rig.aircraft("a1")
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        clock, now = ClockEstimate(), anyio.current_time()
        control._channel._its_clock = clock
        begin = now - (4.0 if waits == "as its clock is set" else 100.0)
        for later in range(6):
            assert clock.heard(begin + later * 0.1, begin + later * 0.1, begin + later * 0.1)
        is_set = 500.0 if waits == "as its clock is set" else 0.0
        for ago in (50.0, 0.0)[-1 if is_set else 0 :]:
            at = now - ago
            assert clock.heard(at - 1.5, at - 0.1 + is_set, at)
        with pytest.raises(UsageError, match=r"the clock of a1 is not known to 0\.1 s"):
            control.send(NORTH)


async def test_an_operator_who_is_cut_off_longer_than_the_lease_hears_of_it(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    began = 0.0
    with pytest.raises(OutcomeUnknown, match="the lease has ended"):
        async with pilot["a1"].control() as control:
            await control.take_off()
            rig.cut(pilot)
            began = anyio.current_time()
            await anyio.sleep(60.0)
    assert 2.0 < anyio.current_time() - began < 5.0
    assert one.client.holder.number == 0


@pytest.mark.parametrize("seconds", [2.4, 3.6])
async def test_a_cut_that_is_shorter_than_the_lease_costs_nothing(rig: Rig, seconds: float) -> None:
    """A renewal goes every 0.5 s, and the lease lasts 3 s after the last one: 2.5 s are sure."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    ended: list[M100Error] = []
    try:
        async with pilot["a1"].control() as control:
            fence = control.fence
            rig.cut(pilot)
            await anyio.sleep(seconds)
            rig.join(pilot)
            await anyio.sleep(1.0)
            assert one.client.holder.number == control.fence == fence
    except M100Error as error:
        ended.append(error)
    assert [type(error) for error in ended] == ([OutcomeUnknown] if seconds > 3.0 else [])
    assert one.client.holder.number == 0


@pytest.mark.parametrize("fails", [False, True])
async def test_the_end_of_a_hold_is_a_halt_and_no_silence(
    rig: Rig, fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A setpoint expires by itself, and only later."""
    _, pilot = await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
        asked: list[orders.Order] = []
        ask = control._asker.ask

        async def noting(order: orders.Order, **more: Any) -> object:
            asked.append(order)
            return await ask(order, **more)

        monkeypatch.setattr(control._asker, "ask", noting)
        with contextlib.suppress(ZeroDivisionError):
            async with control.hold(NORTH):
                await anyio.sleep(0.5)
                assert not any(isinstance(order, orders.Halt) for order in asked)
                if fails:
                    raise ZeroDivisionError
        assert [order for order in asked if isinstance(order, orders.Halt)] == [
            orders.Halt("pilot ended a hold")
        ]


async def test_what_is_held_is_the_newest_that_was_set(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    async with pilot["a1"].control() as control:
        await control.take_off()
        async with control.hold(NORTH) as hold:
            await anyio.sleep(1.0)
            hold.set(Setpoint.velocity(north=0.0, east=-2.0, up=0.0, yaw_rate_deg_s=0.0))
            await anyio.sleep(3.0)
            motion = one.aircraft.vehicle.flight.dynamics
            assert (motion.velocity_north, motion.velocity_east) == pytest.approx(
                (0.0, -2.0), abs=0.3
            )


async def test_a_stop_ends_a_hold_until_the_pilot_begins_anew(rig: Rig) -> None:
    one = await rig.aircraft("a1")
    pilot, other = await rig.pilot(), await rig.pilot("other")

    async def hold() -> None:
        with pytest.raises(GuardRefused):
            async with pilot["a1"].control() as control:
                await control.take_off()
                async with control.hold(NORTH):
                    await anyio.sleep(30.0)

    async with anyio.create_task_group() as group:
        group.start_soon(hold)
        await rig.until(lambda: one.speed > 2.5)
        assert (await other.stop())["a1"].is_ok
        await anyio.sleep(3.0)
        assert one.speed < 0.3


async def test_a_lease_that_is_lost_before_the_block_begins_is_reported(rig: Rig) -> None:
    """And the task of who asked is not cancelled instead."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    control = pilot["a1"].control()

    async def cut() -> None:
        await rig.until(lambda: control.fence)
        rig.cut(pilot)

    async with anyio.create_task_group() as group:
        group.start_soon(cut)
        rig.network.weather = Weather(delay_s=0.4)
        with pytest.raises(StaleLease, match="cannot be held"):
            async with control:
                raise AssertionError("nobody can fly")
    assert one.height < 0.1


async def test_a_lease_that_nobody_waits_for_any_more_is_not_granted(rig: Rig) -> None:
    one, pilot, other = await rig.aircraft("a1"), await rig.pilot(patience=1.0), await rig.pilot()
    asker = pilot["a1"].asker
    await asker.ask(orders.AskVersion())  # its clock is known now
    rig.network.weather = Weather(delay_s=5.5)
    with pytest.raises(OutcomeUnknown):
        await asker.take_lease(asker.lease_request())
    rig.network.weather = Weather()
    for _ in range(100):
        await anyio.sleep(0.1)
        assert one.client.holder.number == 0
    async with other["a1"].control():
        assert one.client.holder.number


@pytest.mark.parametrize("after", [0.1, 0.3, 0.5])
async def test_a_lease_that_comes_to_who_was_ended_meanwhile_goes_back(
    rig: Rig, after: float
) -> None:
    """By Ctrl-C, while the order is on its way, or its answer."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()

    async def fly() -> None:
        async with pilot["a1"].control():
            raise AssertionError("it was ended before")

    rig.network.weather = Weather(delay_s=0.3)
    entering = asyncio.ensure_future(fly())
    await anyio.sleep(0.6 + after)  # the agent's clock is known
    entering.cancel()
    with pytest.raises(asyncio.CancelledError):
        await entering
    await anyio.sleep(0.35)  # the word that gives it back is on its way
    assert one.client.holder.number == 0
    assert [e.text for e in one.client.events if "has control" in e.text], "it was granted"
    assert not [e.text for e in one.client.events if "expired" in e.text]


@pytest.mark.parametrize("after", [0.1, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6])
async def test_a_take_over_of_what_is_given_back_meanwhile(rig: Rig, after: float) -> None:
    """Whichever of its steps the first pilot leaves in, the second one has the lease then."""
    one = await rig.aircraft("a1")
    first, second = await rig.pilot("first"), await rig.pilot("second")

    async def fly() -> None:
        with contextlib.suppress(M100Error):
            async with first["a1"].control():
                await anyio.sleep(after)

    async with anyio.create_task_group() as group:
        group.start_soon(fly)
        await rig.until(lambda: one.client.state.has_authority)
        rig.network.weather = Weather(delay_s=0.05)
        async with second["a1"].control(take_over=True):
            assert one.client.holder.name == "second"


@pytest.mark.parametrize("how", ["STOP", "hover"])
@pytest.mark.parametrize("what", ["setpoints", "a flight", "nothing", "its own"])
async def test_a_block_that_ends_by_or_behind_a_stop_does_not_land(
    rig: Rig, what: str, how: str
) -> None:
    """It is to stand still, perhaps because somebody is below it."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    anybody = await rig.pilot("anybody")

    async def fly() -> None:
        async with pilot["a1"].control(stop="land") as control:
            await control.take_off()
            card = await pilot["a1"].card()
            stop = control.stop if what == "its own" else anybody["a1"].stop
            if how == "STOP" or what == "its own":
                one.agent.background.spawn(stop(), "STOP")
            else:
                one.client.hover("somebody at the station")
            if what == "a flight":
                assert card.latitude_deg is not None
                assert card.longitude_deg is not None
                there = {"latitude_deg": card.latitude_deg, "longitude_deg": card.longitude_deg}
                await control.fly_to(**there, height=20.0)
            for _ in range(40):
                if what == "setpoints":
                    control.send(NORTH)
                await anyio.sleep(0.05)

    with pytest.raises(GuardRefused, match=r"(pressed|ordered) after land was asked for"):
        await fly()
    await anyio.sleep(6.0)
    assert one.height > 1.0
    assert one.client.holder.number == 0


async def test_a_lease_that_is_lost_in_the_landing_of_its_end_is_reported(rig: Rig) -> None:
    """And the task that flew does not count as cancelled by somebody."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()

    async def cut() -> None:
        await rig.until(lambda: one.client.state.task == "land")
        rig.cut(pilot)

    async def fly() -> None:
        async with pilot["a1"].control(stop="land") as control:
            await control.take_off()

    async with anyio.create_task_group() as group:
        group.start_soon(cut)
        with pytest.raises(OutcomeUnknown, match="the lease has ended"):
            await asyncio.create_task(fly())
    await anyio.sleep(10.0)
    assert one.height < 0.1


async def test_a_task_that_ends_as_the_lease_is_lost_is_ended(rig: Rig) -> None:
    """Ctrl-C at that moment is not taken for the loss."""
    await rig.aircraft("a1")
    pilot = await rig.pilot()
    lost: list[bool] = []

    async def fly() -> None:
        async with pilot["a1"].control():
            rig.cut(pilot)
            try:
                await anyio.sleep_forever()
            finally:
                lost.append(True)
                await anyio.sleep(0.1)

    flying = asyncio.create_task(fly())
    await rig.until(lambda: lost)
    flying.cancel()
    with pytest.raises(asyncio.CancelledError):
        await flying


async def attacked(pilot: Fleet, draw: Random) -> None:
    async with pilot["a1"].control(take_over=draw.random() < 0.5) as control:
        await control.take_off()
        async with control.hold(NORTH):
            await anyio.sleep(2.0)


@pytest.mark.parametrize("seed", range(2))
async def test_whatever_ends_a_pilot_nobody_has_control_then(rig: Rig, seed: int) -> None:
    """Cancelled, cut off for less or more than a lease lasts, or killed, at drawn moments."""
    draw, one = Random(seed), await rig.aircraft("a1")
    rig.network.seed(seed)
    for attempt in range(5):
        pilot = await rig.pilot()
        rig.network.weather = Weather(delay_s=draw.choice([0.0, 0.05]), loss=draw.choice([0, 0.1]))
        flying = asyncio.create_task(attacked(pilot, draw))
        await anyio.sleep(draw.choice([draw.uniform(0.0, 0.5), draw.uniform(0.0, 12.0)]))
        how = draw.choice(["cancelled", "cut", "killed"])
        if how != "cancelled":
            rig.cut(pilot)
        if how == "cut":
            await anyio.sleep(draw.choice([2.9, 3.1, 8.0]))
            rig.join(pilot)
            await anyio.sleep(draw.uniform(0.0, 1.0))
        flying.cancel()
        (ended,) = await asyncio.gather(flying, return_exceptions=True)
        assert isinstance(ended, M100Error | asyncio.CancelledError | None), (seed, attempt)
        await anyio.sleep(4.5)
        where = f"seed {seed}, attempt {attempt}, {how}"
        assert one.client.holder.number == 0, where
        assert not one.client.state.has_authority, where
        assert one.speed < 0.3, where


async def test_a_lease_goes_back_once_where_control_is_refused(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    one.aircraft.leave_f()
    await anyio.sleep(1.0)
    with pytest.raises(M100Error, match="mode switch P"):
        async with pilot["a1"].control():
            raise AssertionError("the pilot at the remote control flies")
    assert one.client.holder.number == 0
    assert not [it.message for it in caplog.records if "fleet" in it.name]


async def test_setpoints_need_a_clock_that_is_known(rig: Rig) -> None:
    await rig.aircraft("a1")
    pilot = await rig.pilot()
    rig.network.weather = Weather(delay_s=0.3)
    async with pilot["a1"].control() as control:
        with pytest.raises(UsageError, match="clock of a1"):
            control.send(NORTH)


async def test_what_cannot_be_asked(rig: Rig) -> None:
    pilot = await rig.pilot()
    with pytest.raises(UsageError, match="stop action"):
        pilot["a1"].control(stop="dive")  # type: ignore[arg-type] # that is the test
    with pytest.raises(StaleLease):
        pilot["a1"].control().send(NORTH)


async def test_nonsense_in_the_place_of_a_renewal_ends_nothing_but_silence_does(rig: Rig) -> None:
    """What answers beside the agent, or is damaged on the way, is no word of the agent."""
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    silent_since = 0.0
    with pytest.raises(OutcomeUnknown, match="the lease has ended"):
        async with pilot["a1"].control() as control:
            await control.take_off()
            real = next(o for o in rig.network.takers("serve", "m100/field/a1/lease"))
            answers = b"\x09{}", b"\x01{", b"", b"\x01" + b"[" * 60_000
            nonsense = iter(answers * 1000)
            serve = rig.network.session().serve
            other = serve(
                real.key, lambda question: question.answer("m100/x/a1/lease", next(nonsense))
            )
            await anyio.sleep(5.0)  # both answer
            take, real.take = real.take, None
            await anyio.sleep(1.5)  # nonsense alone, for less than the lease lasts
            real.take = take
            await anyio.sleep(5.0)
            assert one.client.holder.name == "pilot"
            assert control.fence == one.client.holder.number
            real.take = None
            silent_since = anyio.current_time()
            await anyio.sleep(60.0)
    other.close()
    assert 2.0 < anyio.current_time() - silent_since < 5.0
    assert one.height > 1.0


# What each verb of a control block is given, and the order that it makes of it.
VERBS: dict[str, tuple[dict[str, object], orders.Order]] = {
    "take_off": ({}, orders.TakeOff()),
    "land": ({}, orders.Land()),
    "go_home": ({}, orders.GoHome()),
    "fly_to": (
        {
            "latitude_deg": 52.1,
            "longitude_deg": -4.3,
            "height": 7.5,
            "speed": 3.25,
            "yaw_deg": -120.0,
        },
        FlyTo(52.1, -4.3, height=7.5, speed=3.25, yaw_deg=-120.0),
    ),
    "pause_mission": ({}, orders.PauseMission()),
    "resume_mission": ({}, orders.ResumeMission()),
    "stop_mission": ({}, orders.Halt("its operator stopped it")),  # waits for no disk
    "stop": ({}, orders.Stop()),
}


def test_each_verb_has_its_order_by_hand() -> None:
    coroutines = {n for n, one in vars(FleetControl).items() if inspect.iscoroutinefunction(one)}
    verbs = {name for name in coroutines if not name.startswith("_")} - {"ask"}
    lacks = sorted(verbs - set(VERBS))
    assert not lacks, f"VERBS of this file has no row for {lacks}"


async def test_each_verb_asks_for_what_it_says_under_its_lease(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of them is answered here: what was asked is looked at."""
    asked: list[tuple[orders.Order, object]] = []
    await rig.aircraft("a1")
    pilot = await rig.pilot()
    async with pilot["a1"].control() as control:
        fence = control.fence

        async def ask(message: orders.Order, *_: object, fence: int = 0, **__: object) -> None:
            asked.append((message, fence))

        with monkeypatch.context() as patch:
            patch.setattr(control._asker, "ask", ask)
            for verb, (given, _) in VERBS.items():
                await getattr(control, verb)(**given)
    assert fence > 0
    expected = [(order, 0 if verb == "stop" else fence) for verb, (_, order) in VERBS.items()]
    assert asked == expected
