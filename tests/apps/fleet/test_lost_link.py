"""A network that is lost is a hover, then what was configured, and nothing resumes by itself."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.background import TaskSet
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.lease import LeaseChange, LeaseHeld
from m100link.apps.agent.messages import Event, EventTopic, LeaseChanged
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.expiry import Dropped
from m100link.apps.fleet.lost_link import (
    LastFlight,
    LostAction,
    LostLinkAction,
    LostLinkPlan,
)
from m100link.apps.fleet.order_log import LastFlightRecord, MemoryOrderLog
from m100link.errors import (
    AuthorityLost,
    FleetError,
    GuardRefused,
    LossReason,
    M100Error,
    UsageError,
)
from m100link.protocol.records import FlightPhase, RcMode, RemoteControl
from m100link.protocol.setpoint import Setpoint
from tests.apps.fleet.conftest import OnBoard, Rig

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


async def fly_and_be_cut(rig: Rig, one: OnBoard, pilot: Fleet, *, seconds: float) -> None:
    """Fly north at 3 m/s, lose the network in flight, and come back after a while."""
    with pytest.raises(FleetError):
        async with pilot["a1"].control() as control:
            await control.take_off()
            async with control.hold(NORTH):
                await anyio.sleep(4.0)
                assert one.speed > 2.5
                rig.cut(pilot)
                await anyio.sleep(2.0)
                assert one.speed < 0.3
                await anyio.sleep(seconds)


async def test_hovers_within_two_seconds_and_the_lease_ends(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    await fly_and_be_cut(rig, one, pilot, seconds=10.0)
    assert one.client.holder.number == 0
    assert one.height > 1.0, "by default it hovers, and the pilot with the remote control flies"
    rig.join(pilot)
    await anyio.sleep(5.0)
    assert one.speed < 0.3, "nothing resumes by itself"


@pytest.mark.parametrize("action", ["land", "home"])
async def test_lands_or_goes_home_when_that_is_configured(rig: Rig, action: LostAction) -> None:
    plan = LostLinkPlan(action, 3.0)
    one, pilot = await rig.aircraft("a1", lost=plan), await rig.pilot()
    await fly_and_be_cut(rig, one, pilot, seconds=30.0)
    cut_at = anyio.current_time()
    await rig.until(lambda: one.height < 0.1, within=120.0)
    assert anyio.current_time() - cut_at < 120.0
    rig.join(pilot)
    await anyio.sleep(10.0)
    assert one.height < 0.1


async def test_a_landing_in_which_the_agent_fails_is_begun_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, land = await rig.aircraft("a1", lost=LostLinkPlan("land", 1.0)), ControlSession.bring_down
    fails = [MemoryError(), None]

    async def bring_down(*args: Any) -> None:
        if error := fails.pop(0):
            raise error
        await land(*args)

    monkeypatch.setattr(ControlSession, "bring_down", bring_down)
    await lose_the_pilot(rig, one)
    await rig.until(lambda: one.height < 0.1)
    assert not fails


async def test_a_client_that_takes_control_meanwhile_keeps_it(rig: Rig) -> None:
    one = await rig.aircraft("a1", lost=LostLinkPlan("land", 5.0))
    pilot, other = await rig.pilot(), await rig.pilot("other")

    async with anyio.create_task_group() as group:
        group.start_soon(partial(fly_and_be_cut, rig, one, pilot, seconds=30.0))
        await rig.until(lambda: one.client.holder.name == "pilot")
        await rig.until(lambda: one.client.holder.number == 0)
        async with other["a1"].control():
            await anyio.sleep(20.0)
            assert one.height > 1.0


async def test_an_operator_that_lets_go_is_not_lost(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1", lost=LostLinkPlan("land", 1.0)), await rig.pilot()
    await pilot["a1"].take_off()
    await anyio.sleep(20.0)
    assert one.height > 1.0


async def lose_the_pilot(rig: Rig, one: OnBoard) -> None:
    """He takes off and is cut off for good."""
    pilot = await rig.pilot("cut off")

    async def fly() -> None:
        with pytest.raises(FleetError):
            async with pilot["a1"].control() as control:
                await control.take_off()
                rig.cut(pilot)
                await anyio.sleep(30.0)

    one.agent.background.spawn(fly(), "a pilot")
    await rig.until(lambda: one.client.holder.number)
    await rig.until(lambda: not one.client.holder.number)
    assert one.height > 1.0


async def test_a_lease_alone_flies_nothing_and_its_end_lands_nothing(rig: Rig) -> None:
    """Who takes the lease and is not heard again has not flown: the pilot with the remote does."""
    one, pilot = await rig.aircraft("a1", lost=LostLinkPlan("land", 1.0)), await rig.pilot()
    await pilot["a1"].take_off()
    asker = pilot["a1"].asker
    await asker.take_lease(asker.lease_request())
    await anyio.sleep(30.0)
    assert one.height > 1.0


async def test_a_pilot_of_any_name_is_somebody(rig: Rig) -> None:
    one = await rig.aircraft("a1", lost=LostLinkPlan("land", 3.0))
    other = await rig.pilot("operator lost (land)")
    await lose_the_pilot(rig, one)
    async with other["a1"].control():
        await anyio.sleep(20.0)
        assert one.height > 1.0


@pytest.mark.parametrize("sign", ["stick", "mode", "stop", "lands already"])
async def test_an_operator_that_shows_to_be_there_is_left_alone(rig: Rig, sign: str) -> None:
    one = await rig.aircraft("a1", lost=LostLinkPlan("land", 3.0))
    other = await rig.pilot("other")
    await lose_the_pilot(rig, one)
    await anyio.sleep(1.0)
    if sign == "stick":
        one.aircraft.move_stick(throttle=0.3)
        await anyio.sleep(0.5)
        one.aircraft.release_sticks()
    elif sign == "mode":
        one.aircraft.set_rc_mode("P")
        await anyio.sleep(0.5)
        one.aircraft.set_rc_mode("F")
    elif sign == "stop":
        assert (await other.stop())["a1"].is_ok
    else:
        await rig.until(lambda: one.client.state.task == "land")
        one.aircraft.set_rc_mode("P")
        await anyio.sleep(1.0)
        one.aircraft.set_rc_mode("F")
    height = one.height
    assert height > 0.5
    await anyio.sleep(30.0)
    assert one.height > height - 0.1
    assert any("left alone" in event.text for event in one.client.events)


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize(
    ("value", "is_moved"), [(1001, True), (-1001, True), (1000, False), (-1000, False)]
)
def test_a_stick_is_moved_to_either_side(axis: int, value: int, is_moved: bool) -> None:
    """A tenth of its way: sticks run from -10000 to 10000."""
    roll, pitch, yaw, throttle = (value if one == axis else 0 for one in range(4))
    remote = RemoteControl(roll, pitch, yaw, throttle, RcMode.F, -4545)
    view = SimpleNamespace(get=lambda record: remote)
    lost = object.__new__(LostLinkAction)
    lost._client = cast(Any, SimpleNamespace(view=view))
    assert lost._by_remote() == ("a stick was moved" if is_moved else "")


def test_what_cannot_be_configured() -> None:
    with pytest.raises(UsageError, match="'dive'"):
        LostLinkPlan("dive")  # type: ignore[arg-type] # that is the test
    with pytest.raises(UsageError, match="-1 s"):
        LostLinkPlan("land", -1.0)


async def test_a_stream_that_was_cut_for_less_than_the_lease_does_not_go_on(rig: Rig) -> None:
    one, pilot = await rig.aircraft("a1"), await rig.pilot()
    with pytest.raises(GuardRefused, match="had ended"):
        async with pilot["a1"].control() as control:
            await control.take_off()
            async with control.hold(NORTH):
                await anyio.sleep(4.0)
                rig.cut(pilot)
                await anyio.sleep(1.5)
                rig.join(pilot)
                await anyio.sleep(10.0)
    assert one.speed < 0.3
    assert one.fleet_agent.dropped[Dropped.BROKEN] > 0


# -- an agent that is killed in flight takes its pilot with it: the next one does what that mea ----


LAND = LostLinkPlan("land", 3.0)


async def killed_in_flight(rig: Rig, lost: LostLinkPlan = LAND) -> OnBoard:
    """A pilot flies north as the agent is killed."""
    one, pilot = await rig.aircraft("a1", lost=lost), await rig.pilot()

    async def fly() -> None:
        with pytest.raises(M100Error):
            async with pilot["a1"].control() as control:
                await control.take_off()
                async with control.hold(NORTH):
                    await anyio.sleep(60.0)

    one.agent.background.spawn(fly(), "a pilot")
    await rig.until(lambda: one.speed > 2.5)
    one.kill()
    rig.cut(pilot)
    assert one.height > 1.0
    return one


def said(one: OnBoard) -> str:
    return "; ".join(event.text for event in one.client.events)


@pytest.mark.parametrize("action", ["land", "home"])
async def test_the_next_agent_does_what_was_configured(rig: Rig, action: LostAction) -> None:
    plan = LostLinkPlan(action, 3.0)
    one = await (await killed_in_flight(rig, plan)).next(lost=plan)
    began = anyio.current_time()
    await anyio.sleep(2.5)
    assert one.height > 1.0, "its operator may come back until then"
    assert one.speed < 0.3
    await rig.until(lambda: one.height < 0.1, within=120.0)
    assert anyio.current_time() - began > 3.0
    assert "the previous agent ended while the aircraft flew under lease 1" in said(one)
    await rig.until(lambda: one.client.holder.number == 0)
    await anyio.sleep(0.1)
    assert one.order_log.last_flight is not None
    assert isinstance(one.order_log, MemoryOrderLog)
    assert MemoryOrderLog(one.order_log).last_flight is None


async def test_one_that_hovers_by_its_plan_is_left_to_the_pilot_and_that_is_said(rig: Rig) -> None:
    one = await (await killed_in_flight(rig, LostLinkPlan())).next()
    await anyio.sleep(60.0)
    assert one.height > 1.0
    assert "it is left to the pilot with the remote control" in said(one)


async def test_an_operator_that_comes_back_flies_on(rig: Rig) -> None:
    one = await (await killed_in_flight(rig)).next(lost=LAND)
    pilot = await rig.pilot()
    async with pilot["a1"].control():
        await anyio.sleep(20.0)
        assert one.height > 1.0
    await anyio.sleep(20.0)
    assert one.height > 1.0, "he let go of it"


@pytest.mark.parametrize("sign", ["mode before", "mode", "stick"])
async def test_the_pilot_with_the_remote_control_is_never_fought(rig: Rig, sign: str) -> None:
    before = await killed_in_flight(rig)
    if sign == "mode before":
        before.aircraft.set_rc_mode("P")
    one = await before.next(lost=LAND)
    await anyio.sleep(1.0)
    if sign == "mode":
        one.aircraft.set_rc_mode("P")
    elif sign == "stick":
        one.aircraft.move_stick(throttle=0.3)
        await anyio.sleep(0.5)
        one.aircraft.release_sticks()
    await anyio.sleep(30.0)
    assert one.height > 1.0
    assert "left alone" in said(one)
    one.kill()
    again = await one.next(lost=LAND)
    await anyio.sleep(30.0)
    assert again.height > 1.0, "nor by a later agent"


async def test_one_that_is_killed_again_before_it_lands_is_landed_by_the_third(rig: Rig) -> None:
    second = await (await killed_in_flight(rig)).next(lost=LAND)
    await anyio.sleep(2.0)
    second.kill()
    third = await second.next(lost=LAND)
    await rig.until(lambda: third.client.state.task == "land")
    third.kill()
    assert third.height > 0.3
    last = await third.next(lost=LAND)
    await rig.until(lambda: last.height < 0.1)


async def test_one_on_the_ground_stays_there(rig: Rig) -> None:
    before, pilot = await rig.aircraft("a1", lost=LAND), await rig.pilot()
    before.agent.background.spawn(hold_on(pilot), "a pilot")
    await rig.until(lambda: before.client.state.has_authority)
    await anyio.sleep(1.0)
    before.kill()
    rig.cut(pilot)
    one = await before.next(lost=LAND)
    await anyio.sleep(20.0)
    assert one.height < 0.1
    assert "on the ground now" in said(one)
    assert "the operator is lost" not in said(one)


async def not_flown(rig: Rig, how: str) -> OnBoard:
    """In the air, and nobody of the fleet flies it."""
    one, pilot = await rig.aircraft("a1", lost=LAND), await rig.pilot()
    await pilot["a1"].take_off()
    if how.startswith("lease alone"):
        if how == "lease alone, later":  # when control that was given back has gone
            await anyio.sleep(1.0)
        asker = pilot["a1"].asker
        await asker.take_lease(asker.lease_request())
    elif how == "taken by the pilot":
        one.agent.background.spawn(hold_on(pilot), "a pilot")
        await rig.until(lambda: one.client.state.has_authority)
        one.aircraft.set_rc_mode("P")
    await anyio.sleep(1.0)
    one.kill()
    one.aircraft.set_rc_mode("F")
    return one


async def hold_on(pilot: Fleet) -> None:
    with pytest.raises(M100Error):
        async with pilot["a1"].control():
            await anyio.sleep(60.0)


@pytest.mark.parametrize(
    "how", ["let go", "lease alone", "lease alone, later", "taken by the pilot"]
)
async def test_one_that_nobody_of_the_fleet_flew_is_left_alone(rig: Rig, how: str) -> None:
    one = await (await not_flown(rig, how)).next(lost=LAND)
    await anyio.sleep(60.0)
    assert one.height > 1.0
    assert "previous agent ended" not in said(one)


@pytest.mark.parametrize("ago", [None, 301.0])
async def test_one_of_which_nobody_knows_who_flew_it_since_is_left_alone(
    rig: Rig, ago: float | None
) -> None:
    before = await killed_in_flight(rig)
    assert isinstance(before.order_log, MemoryOrderLog)
    order_log = MemoryOrderLog(before.order_log)
    assert order_log.last_flight is not None
    order_log.last_flight = replace(order_log.last_flight, ago_s=ago)
    one = await rig.aircraft("a1", virtual=before.aircraft, order_log=order_log, lost=LAND)
    await anyio.sleep(60.0)
    assert one.height > 1.0
    assert "left to the pilot" in said(one)


async def test_a_line_that_comes_too_late_is_one_of_which_nobody_knows(rig: Rig) -> None:
    before = await killed_in_flight(rig)
    assert isinstance(before.order_log, MemoryOrderLog)
    order_log = MemoryOrderLog(before.order_log)
    order_log.last_flight = LastFlightRecord(1, 290.0)
    before.aircraft.unplug()
    one = OnBoard(rig, "a1", before.aircraft, order_log)

    async def replug() -> None:
        await anyio.sleep(20.0)
        before.aircraft.replug()

    async with anyio.create_task_group() as group:
        group.start_soon(replug)
        await rig.stack.enter_async_context(one.running(lost=LAND))
    await anyio.sleep(60.0)
    assert one.height > 1.0
    assert "left to the pilot" in said(one)


async def test_it_is_written_again_while_it_flies_and_a_disk_that_fails_is_reported(
    rig: Rig,
) -> None:
    class Disk(MemoryOrderLog):
        is_full = False
        kept: list[int]

        async def flies(self, fence: int) -> None:
            if self.is_full:
                raise UsageError("the disk is full")
            self.kept.append(fence)

    disk = Disk()
    disk.kept = []
    one, pilot = await rig.aircraft("a1", order_log=disk), await rig.pilot()
    async with pilot["a1"].control(stop="land") as control:
        await control.take_off()
        assert disk.kept == [1]
        await anyio.sleep(60.0)
        assert disk.kept == [1, 1, 1]
        disk.is_full = True
        await anyio.sleep(30.0)
        assert "the order log does not keep who flies: the disk is full" in said(one)
        disk.is_full = False
    await anyio.sleep(60.0)
    assert disk.kept == [1, 1, 1, 0]


# -- what ends a lease, who shows to be there, and when it is begun: a table, without flights ------


class Watched:
    """An aircraft whose agent tells what a test wants, and what was done with it."""

    def __init__(self, plan: LostLinkPlan) -> None:
        self.began_at = anyio.current_time()
        self.state = SimpleNamespace(has_authority=True, holding="held")
        self.holder = LeaseChanged(4, "anna")
        self.phase: FlightPhase | None = FlightPhase.IN_AIR
        self.remote: RemoteControl | None = RemoteControl(0, 0, 0, 0, RcMode.F, -4545)
        self.descents: list[tuple[float, orders.Order, str]] = []
        self.fails: list[Exception] = []
        self.flown: list[int] = []
        self.notes: list[str] = []
        self.background = TaskSet()
        self.on_lease: list[Any] = []
        self.on_authority_taken: list[Any] = []
        self.on_event: list[Any] = []
        last = cast(Any, SimpleNamespace(flown_under=self.flown.append))
        self.lost = LostLinkAction(cast(Any, Told(self)), plan, self.descend, last)

    async def descend(self, task: orders.Order, why: str) -> None:
        self.descents.append((round(anyio.current_time() - self.began_at, 3), task, why))
        if self.fails:
            raise self.fails.pop(0)

    def tell(self, message: Any) -> None:
        if isinstance(message, LeaseChanged):
            self.holder = message
        kind = {LeaseChanged: self.on_lease, Event: self.on_event}
        for callback in kind.get(type(message), self.on_authority_taken):
            callback(message)


class Told:
    """The client of its agent."""

    def __init__(self, watched: Watched) -> None:
        self._watched = watched

    def __getattr__(self, name: str) -> Any:
        return getattr(self._watched, name)

    @property
    def now(self) -> float:
        return anyio.current_time()

    @property
    def view(self) -> Any:
        return SimpleNamespace(get=lambda _: self._watched.remote, phase=self._watched.phase)

    def note(self, text: str, _level: str = "info") -> None:
        self._watched.notes.append(text)


def ended(why: LeaseChange) -> LeaseChanged:
    return LeaseChanged(0, "", why)


LANDS = (orders.Land(), "operator lost (land)")
GOES_HOME = (orders.GoHome(), "operator lost (home)")


@pytest.mark.parametrize(
    ("plan", "why", "flies", "begun", "flown"),
    [
        (LostLinkPlan("land", 7.5), LeaseChange.EXPIRED, True, (7.5, *LANDS), [0]),
        (LostLinkPlan("land", 7.5), LeaseChange.FRONT_LOST, True, (7.5, *LANDS), [0]),
        (LostLinkPlan("home", 0.0), LeaseChange.EXPIRED, True, (0.0, *GOES_HOME), [0]),
        (LostLinkPlan("land"), LeaseChange.EXPIRED, True, (10.0, *LANDS), [0]),
        (LostLinkPlan("hover", 7.5), LeaseChange.EXPIRED, True, None, [0]),
        (LostLinkPlan("land", 7.5), LeaseChange.RELEASED, True, None, [0]),
        (LostLinkPlan("land", 7.5), LeaseChange.TAKEN_OVER, True, None, [0]),
        (LostLinkPlan("land", 7.5), LeaseChange.EXPIRED, False, None, [0]),
    ],
)
async def test_the_aircraft_of_an_operator_who_fell_silent_in_flight_is_brought_down(
    plan: LostLinkPlan, why: LeaseChange, flies: bool, begun: Any, flown: list[int]
) -> None:
    one = Watched(plan)
    one.state.has_authority = flies
    one.tell(ended(why))
    if begun:
        assert not one.flown, "until it is down, the agent after this one is to know"
    await anyio.sleep(60.0)
    assert one.descents == ([begun] if begun else [])
    assert one.flown == flown


async def test_what_fails_is_begun_again_after_five_seconds_and_never_from_who_has_it() -> None:
    one = Watched(LostLinkPlan("land", 2.0))
    one.fails += [M100Error("refused"), RuntimeError(), LeaseHeld("bert has control")]
    one.tell(ended(LeaseChange.EXPIRED))
    await anyio.sleep(60.0)
    assert [at for at, *_ in one.descents] == pytest.approx([2.0, 7.0, 12.0])
    assert [note.rpartition(": ")[2] for note in one.notes[1:]] == ["refused", "the agent failed"]
    assert one.notes[0] == "the operator is lost: the aircraft hovers, and lands in 2 s"
    other = Watched(LostLinkPlan("land", 2.0))
    other.fails.append(M100Error("refused"))
    other.tell(ended(LeaseChange.EXPIRED))
    other.holder = LeaseChanged(5, "bert")  # who took it while it was brought down
    await anyio.sleep(60.0)
    assert len(other.descents) == 1


@pytest.mark.parametrize(
    ("remote", "somebody"),
    [
        (RemoteControl(0, 0, 0, 0, RcMode.F, -4545), ""),
        (None, ""),
        (RemoteControl(0, 0, 0, 0, RcMode.P, -4545), "the remote control is not in F"),
        (RemoteControl(0, 0, 0, 0, RcMode.A, -4545), "the remote control is not in F"),
        (RemoteControl(0, 0, -1001, 0, RcMode.F, -4545), "a stick was moved"),
    ],
)
async def test_who_moves_the_remote_control_is_there(
    remote: RemoteControl | None, somebody: str
) -> None:
    one = Watched(LostLinkPlan("land", 3.0))
    one.tell(ended(LeaseChange.EXPIRED))
    await anyio.sleep(1.0)
    before, one.remote = one.remote, remote
    await anyio.sleep(0.5)
    one.remote = before
    await anyio.sleep(60.0)
    assert len(one.descents) == (not somebody)
    left = f"the operator is lost, but {somebody}: the aircraft is left alone"
    assert (left in one.notes) is bool(somebody)
    assert one.flown == [0]


async def test_a_new_lease_ends_the_waiting_and_a_stop_and_a_pilot_do() -> None:
    for sign, flown in (
        (LeaseChanged(5, "bert", LeaseChange.ACQUIRED), [5]),
        (Event(1, 0.0, "info", "stop", EventTopic.STOPPED), [0]),
        (AuthorityLost("P", reason=LossReason.MODE_SWITCH), [0]),
    ):
        one = Watched(LostLinkPlan("land", 3.0))
        one.tell(ended(LeaseChange.EXPIRED))
        await anyio.sleep(1.0)
        one.tell(sign)
        await anyio.sleep(60.0)
        assert (one.descents, one.flown) == ([], flown), sign


async def test_a_line_that_was_lost_leaves_the_flight_with_its_lease() -> None:
    one = Watched(LostLinkPlan("land", 3.0))
    one.tell(AuthorityLost("the line", reason=LossReason.LINK))
    one.state.has_authority = False
    one.tell(ended(LeaseChange.EXPIRED))
    one.tell(ended(LeaseChange.EXPIRED))  # said again: it waits already
    await anyio.sleep(60.0)
    assert [at for at, *_ in one.descents] == [3.0]
    other = Watched(LostLinkPlan("land", 3.0))
    other.tell(AuthorityLost("P", reason=LossReason.MODE_SWITCH))
    other.state.has_authority = False
    other.tell(ended(LeaseChange.EXPIRED))
    await anyio.sleep(60.0)
    assert (other.descents, other.flown) == ([], [0, 0]), "the pilot flies"


@pytest.mark.parametrize(
    ("number", "has_authority", "holding", "flown"),
    [
        (4, True, "held", [4]),
        (4, False, "held", []),
        (4, False, "releasing", [0]),
        (0, True, "held", []),
        (0, False, "releasing", []),
    ],
)
async def test_who_flies_is_known_from_each_event(
    number: int, has_authority: bool, holding: str, flown: list[int]
) -> None:
    one = Watched(LAND)
    one.holder = LeaseChanged(number, "anna")
    one.state = SimpleNamespace(has_authority=has_authority, holding=holding)
    one.tell(Event(1, 0.0, "info", "anything"))
    assert one.flown == flown


@pytest.mark.parametrize(
    ("ago", "after", "phase", "plan", "begun", "said"),
    [
        (10.0, 0.0, FlightPhase.IN_AIR, LAND, 3.0, "flew under lease 4"),
        (10.0, 0.0, FlightPhase.LANDING, LAND, 3.0, "flew under lease 4"),
        (10.0, 0.0, FlightPhase.STANDBY, LAND, None, "which is on the ground now"),
        (10.0, 0.0, FlightPhase.FINISHING_LANDING, LAND, None, "which is on the ground now"),
        (10.0, 0.0, FlightPhase.IN_AIR, LostLinkPlan(), None, "it is left to the pilot"),
        (290.0, 9.0, FlightPhase.IN_AIR, LAND, 12.0, "flew under lease 4"),
        (290.0, 11.0, FlightPhase.IN_AIR, LAND, None, "perhaps more than 300 s ago"),
        (301.0, 0.0, FlightPhase.IN_AIR, LAND, None, "perhaps more than 300 s ago"),
        (None, 0.0, FlightPhase.IN_AIR, LAND, None, "perhaps more than 300 s ago"),
    ],
)
async def test_what_the_agent_before_left_in_the_air_is_brought_down_for_five_minutes(
    ago: float | None,
    after: float,
    phase: FlightPhase,
    plan: LostLinkPlan,
    begun: float | None,
    said: str,
) -> None:
    one = Watched(plan)
    one.phase = phase if not after else None
    one.lost.inherit(LastFlightRecord(4, ago))
    if after:
        await anyio.sleep(after)
        one.phase = phase
    await anyio.sleep(60.0)
    assert [at for at, *_ in one.descents] == pytest.approx(
        [] if begun is None else [begun], abs=0.11
    )
    assert said in one.notes[0]
    assert one.flown == [0]


@pytest.mark.parametrize(
    ("seconds", "is_one"),
    [(0.0, True), (3600.0, True), (3600.1, False), (-0.1, False), (float("nan"), False)],
)
def test_it_waits_for_up_to_an_hour(seconds: float, is_one: bool) -> None:
    if is_one:
        assert LostLinkPlan("home", seconds).after_s == seconds
    else:
        with pytest.raises(UsageError, match="lost_after is"):
            LostLinkPlan("home", seconds)


async def test_who_flies_is_written_every_half_minute_and_what_was_not_kept_again() -> None:
    began_at = anyio.current_time()
    kept: list[tuple[float, int]] = []
    fails: list[M100Error] = []

    async def flies(number: int) -> None:
        kept.append((round(anyio.current_time() - began_at, 3), number))
        if fails:
            raise fails.pop()

    last = LastFlight(
        cast(Any, SimpleNamespace(note=lambda *_: None)),
        cast(Any, SimpleNamespace(last_flight=LastFlightRecord(3, 1.0), flies=flies)),
    )
    async with anyio.create_task_group() as group:
        group.start_soon(last.keep)
        await anyio.sleep(5.0)
        last.flown_under(3)  # as it was
        await anyio.sleep(30.0)
        fails.append(UsageError("the disk is full"))
        last.flown_under(0)
        await anyio.sleep(100.0)
        group.cancel_scope.cancel()
    assert kept == [(30.0, 3), (35.0, 0), (65.0, 0)]
