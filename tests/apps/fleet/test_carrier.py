"""A console far away: a front of an agent over the network of a fleet."""

from __future__ import annotations

import math
import random
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from types import SimpleNamespace
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.control_session import ControlSession
from m100link.apps.agent.latency import Offset
from m100link.apps.agent.lease import Lease, LeaseHeld, TakeOver
from m100link.apps.agent.messages import (
    VERSION,
    Ask,
    Event,
    EventTopic,
    Hello,
    LeaseChanged,
    Message,
    MessageError,
    OrderOutcome,
    Stage,
    State,
    Steer,
    SteerRefused,
    Telemetry,
)
from m100link.apps.agent.orders import FlyTo
from m100link.apps.fleet.carrier import FleetChannel
from m100link.apps.fleet.client import Fleet
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import OrderReply, Outcome, Progress, pack, unpack_steer
from m100link.apps.fleet.publisher import StatePublisher
from m100link.errors import GuardRefused, LinkError, M100Error, StaleLease, UsageError
from m100link.protocol.records import Position
from m100link.protocol.setpoint import Setpoint
from m100link.sim.virtual import VirtualAircraft
from tests.apps.agent.examples import EXAMPLES
from tests.apps.fleet.conftest import SITE, Rig
from tests.rig import put_in_the_air

pytestmark = pytest.mark.anyio

NORTH = Setpoint.velocity(north=3.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)


def place(client: AgentClient) -> Position:
    """Where it is now."""
    found = None if client.telemetry is None else client.telemetry.fresh(Position, within=0.5)
    assert found is not None
    return found


@asynccontextmanager
async def front(rig: Rig, fleet: Fleet, name: str = "a1") -> AsyncIterator[AgentClient]:
    async with AgentClient(await fleet.reach(name), "console") as client:
        await rig.until(lambda: client.is_connected)
        yield client


async def test_it_sees_what_a_front_on_board_sees(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        await rig.until(lambda: far.telemetry is not None and far.link is not None)
        assert far.state.firmware == one.client.state.firmware
        await anyio.sleep(1.0)
        assert place(far).latitude_deg == pytest.approx(place(one.client).latitude_deg, abs=1e-6)
        assert abs(far.heard_at - far.now) < 0.5


async def test_it_takes_off_flies_to_a_place_and_lands(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot("anna")) as far:
        lease = await far.acquire("console 1")
        assert far.holds(lease)
        assert one.client.holder.name == "anna: console 1"
        far.background.spawn(kept(far, lease), "page")
        await far.ask(orders.Activate(), lease)
        await far.ask(orders.Obtain(), lease)
        await far.ask(orders.TakeOff(), lease)
        assert one.height > 1.0
        here = place(far)
        await far.ask(FlyTo(here.latitude_deg, here.longitude_deg, 6.0), lease)
        assert one.height == pytest.approx(6.0, abs=0.5)
        await far.ask(orders.Land(), lease)
        assert one.height < 0.1
        await far.release_lease(lease.token)
        await rig.until(lambda: far.holder.number == 0, within=3.0)
        assert one.client.holder.number == 0


async def kept(far: AgentClient, lease: Lease) -> None:
    while True:  # as a page does, that is heard
        far.keep(lease)
        await anyio.sleep(0.05)


async def flying(far: AgentClient, *, is_kept: bool = True) -> Lease:
    lease = await far.acquire("console 1")
    page = far.background.spawn(kept(far, lease), "page")
    await far.ask(orders.Activate(), lease)
    await far.ask(orders.Obtain(), lease)
    await far.ask(orders.TakeOff(), lease)
    if not is_kept:
        page.cancel()
    return lease


async def test_a_stop_that_it_heard_of_overtakes_the_later_steps_of_an_order(rig: Rig) -> None:
    """The network gives each step the time at which it leaves: older ones would come too late."""
    one = await rig.served("a1")
    async with front(rig, await rig.pilot("anna")) as far:
        lease = await flying(far)
        asked_at = far.now
        await anyio.sleep(0.2)
        await one.agent.stop()
        await rig.until(lambda: far.events[-1].topic is EventTopic.STOPPED)
        for step in (orders.ChangeHeight(9.0), orders.GoHome(), orders.Obtain()):
            with pytest.raises(GuardRefused, match="STOP was pressed after"):
                await far.ask(step, lease, asked_at=asked_at)
        await anyio.sleep(3.0)
        assert one.height < 2.0
        await far.ask(orders.Release(), lease, asked_at=asked_at)
        await far.ask(orders.Obtain(), lease)
        await far.ask(orders.ChangeHeight(4.0), lease)
        assert one.height == pytest.approx(4.0, abs=0.5)


async def test_it_is_activated_by_anybody_while_nobody_has_control(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot("anna")) as far:
        await far.ask(orders.Activate())
        assert one.client.state.is_activated
        lease = await one.client.acquire("who is on board")
        await rig.until(lambda: far.holder.number == lease.number)
        with pytest.raises(StaleLease):
            await far.ask(orders.Activate())


async def test_setpoints_fly_and_expire_when_they_stop(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        lease = await flying(far)
        await steered(far, lease, 3.0)
        assert one.speed > 2.0
        await anyio.sleep(2.0)
        assert one.speed < 0.3


async def steered(far: AgentClient, lease: Lease, seconds: float) -> None:
    """As a page does while a key is held: its beats are all that it says."""
    for _ in range(round(seconds / 0.05)):
        far.steer(lease, NORTH)
        await anyio.sleep(0.05)


@pytest.mark.parametrize(
    ("delay", "told"),
    [
        (0.3, "the clock of a1 is not known"),
        (1.0, "the clock of a1 is not known"),
        (2.0, "has answered nothing for"),
    ],
)
async def test_an_operator_over_a_slow_network_hears_so_and_keeps_control(
    rig: Rig, delay: float, told: str
) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        lease = await flying(far, is_kept=False)
        refused: list[M100Error] = []
        far.on_steer_refused.append(lambda _, error: refused.append(error))
        await steered(far, lease, 2.0)
        rig.network.weather.delay_s = delay
        await steered(far, lease, 8.0)
        assert one.speed < 0.3
        assert one.client.holder.number == lease.number
        assert told in refused[-1].seen


async def test_a_key_held_through_a_cut_is_reported_to_fly_nothing(rig: Rig) -> None:
    one = await rig.served("a1")
    pilot = await rig.pilot()
    async with front(rig, pilot) as far:
        lease = await flying(far, is_kept=False)
        refused: list[M100Error] = []
        far.on_steer_refused.append(lambda _, error: refused.append(error))
        await steered(far, lease, 2.0)
        rig.network.weather.presence_s = 60.0
        rig.network.cut(one.bus)
        await steered(far, lease, 1.5)
        rig.network.join(one.bus)
        await steered(far, lease, 5.0)
        assert one.speed < 0.3
        assert one.client.holder.number == lease.number
        refused.clear()
        await steered(far, lease, 2.0)
        assert len(refused) >= 40, "a page forgets the last report with each beat"
        assert all("the stream of setpoints had ended" in error.seen for error in refused)
        await anyio.sleep(1.0)
        await steered(far, lease, 2.0)  # it was let go of, and pressed anew
        refused.clear()
        await steered(far, lease, 1.0)
        assert one.speed > 2.0
        assert not refused


async def test_a_cut_network_is_a_hover_and_a_front_that_says_so(rig: Rig) -> None:
    one = await rig.served("a1")
    pilot = await rig.pilot()
    async with front(rig, pilot) as far:
        lease = await flying(far)
        await steered(far, lease, 2.0)
        rig.network.weather.presence_s = 60.0  # nobody hears that it is gone
        rig.network.cut(one.bus)
        await steered(far, lease, 3.0)
        assert one.speed < 0.3
        assert far.view.hearing is Hearing.SILENT
        assert not far.is_connected
        for _ in range(50):  # refused here, which is no word of the agent
            far.steer(lease, NORTH)
            await anyio.sleep(0.1)
            assert far.view.hearing is Hearing.SILENT
        assert far.holder.number == 0, "nothing showed the lease for longer than it lasts"
        rig.network.join(one.bus)
        await steered(far, lease, 3.0)
        assert one.speed < 0.3, "a stream that was cut goes on"


async def test_stop_and_landing_need_no_lease(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot("anna")) as far:
        lease = await flying(far)
        async with front(rig, await rig.pilot("bert")) as other:
            await rig.until(lambda: other.holder.number == lease.number)
            with pytest.raises(LeaseHeld):
                await other.acquire("console 1")
            with pytest.raises(StaleLease):
                await other.ask(orders.TakeOff(), None)
            await other.stop()
            offer = await other.ask_take_over("console 1")
            assert offer.from_name == "anna: console 1"
            taken = await other.confirm(offer.token)
            await rig.until(lambda: far.holder.number == taken.number)
            assert not far.holds(lease)
            refused: list[M100Error] = []
            far.on_steer_refused.append(lambda _, error: refused.append(error))
            far.steer(lease, NORTH)
            await rig.until(lambda: refused, within=1.0)
            assert "is not in force" in refused[0].seen
            assert other.holds(taken)
        assert one.height > 1.0


async def test_old_words_do_not_make_a_silent_agent_one_that_is_heard(rig: Rig) -> None:
    await rig.served("a1")
    pilot = await rig.pilot()
    channel = await pilot.reach("a1")
    async with AgentClient(channel, "console") as far:
        await rig.until(lambda: far.is_connected)
        rig.network.weather.delay_s = 3.0
        await anyio.sleep(6.0)
        assert far.view.hearing is Hearing.SILENT
        assert channel.old > 0


async def test_a_lease_that_ended_before_it_was_granted_again_does_not_take_it(rig: Rig) -> None:
    await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        changes: list[LeaseChanged] = []
        far.on_lease.append(changes.append)
        for _ in range(5):
            lease = await far.acquire("console 1")
            assert far.holds(lease)
            await anyio.sleep(1.3)
            assert far.holds(lease)
            await far.release_lease(lease.token)
            await rig.until(lambda: not far.holder.number, within=2.0)
        assert [bool(one.number) for one in changes] == [True, False] * 5


async def test_an_agent_that_is_not_there_and_one_that_goes(rig: Rig) -> None:
    pilot = await rig.pilot()
    with pytest.raises(LinkError, match="a1 does not answer"):
        await pilot.reach("a1")
    one = await rig.served("a1")
    async with front(rig, pilot) as far:
        one.work.cancel()
        await rig.until(lambda: far.is_gone, within=2.0)
        with pytest.raises(M100Error):
            await far.stop()


async def test_an_agent_of_another_release_is_left_with_what_to_do(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    await rig.served("a1")
    fleet = await rig.pilot()
    async with front(rig, fleet) as far:
        greeting = Hello(VERSION + 1, far.state.firmware, 0.0)
        monkeypatch.setattr(StatePublisher, "_hello", lambda _: greeting)
        await rig.until(lambda: far.is_gone)
        fault = far.state.connection_fault
        assert fault is not None
        assert f"it speaks version {VERSION + 1}, this front {VERSION}" in fault.seen
        assert fault.remedy == "install the same release of m100link at both ends"
        with pytest.raises(LinkError, match=f"speaks version {VERSION + 1}") as caught:
            await fleet.reach("a1")
        assert caught.value.remedy == fault.remedy


async def test_however_much_waits_for_answers_stop_goes_out(rig: Rig) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        lease = await flying(far)
        here = place(far)
        rig.network.weather.presence_s = 60.0
        rig.network.cut(one.bus)
        for _ in range(100):
            far.background.spawn(wasted(far, lease, here), "clicks")
        await anyio.sleep(0.1)
        rig.network.join(one.bus)
        await far.stop()
        assert any(event.topic is EventTopic.STOPPED for event in one.client.events)


async def wasted(far: AgentClient, lease: Lease, here: Position) -> None:
    with pytest.raises(M100Error):
        await far.ask(FlyTo(here.latitude_deg, here.longitude_deg, 6.0), lease)


async def test_what_a_stranger_tells_of_the_lease_does_not_cost_its_holder_the_proof(
    rig: Rig,
) -> None:
    one = await rig.served("a1")
    async with front(rig, await rig.pilot()) as far:
        lease = await flying(far)
        stranger = rig.network.session().publish(Keys(SITE, "a1").told)
        stranger.put(pack(LeaseChanged(lease.number + 1000, "nobody")))
        await rig.until(lambda: not far.holds(lease), within=1.0)
        await rig.until(lambda: far.holds(lease), within=2.0)
        await steered(far, lease, 3.0)
        assert one.speed > 2.0
        await far.ask(orders.Land(), lease)
        assert one.height < 0.1


async def test_a_way_that_is_closed_listens_no_more(rig: Rig) -> None:
    await rig.served("a1")
    channel = await (await rig.pilot()).reach("a1")
    channel.close()
    channel.watch(full=True)
    assert not rig.network.takers("subscribe", Keys(SITE, "a1").telemetry)


async def test_a_pilot_hears_every_package_and_a_wall_what_suffices_for_it(rig: Rig) -> None:
    """100 packages a second of an aircraft, or five (documented with the keys)."""
    await rig.served("a1")
    channel = await (await rig.pilot()).reach("a1")
    keys = Keys(SITE, "a1")
    for full in (True, False, True):
        channel.watch(full=full)
        heard = [
            key for key in (keys.telemetry, keys.thinned) if rig.network.takers("subscribe", key)
        ]
        assert heard == [keys.telemetry if full else keys.thinned]
    channel.close()


async def test_what_cannot_be_costs_itself_alone_and_is_reported_once(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    await rig.served("a1")
    channel = await (await rig.pilot()).reach("a1")
    async with AgentClient(channel, "console") as far:
        await rig.until(lambda: far.is_connected)
        told = rig.network.session().publish(Keys(SITE, "a1").told)
        for _ in range(20):
            told.put(pack(State(far.now, "cheerful", activation_code=-1)))
            told.put(b"\x01{")
        await rig.until(lambda: channel.unread == 40)
        assert len([one for one in caplog.records if "cannot be read" in one.message]) == 1
        at = far.state.at
        await rig.until(lambda: far.state.at > at)
        assert far.is_connected


async def test_an_error_that_comes_again_and_again_does_not_fill_the_log(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    await rig.served("a1")
    channel = await (await rig.pilot()).reach("a1")
    async with AgentClient(channel, "console") as far:
        await rig.until(lambda: far.is_connected)

        failed: list[LeaseChanged] = []

        def fail(change: LeaseChanged) -> None:
            failed.append(change)
            raise ValueError("a mistake of this side")

        far.on_lease.append(fail)
        told = rig.network.session().publish(Keys(SITE, "a1").told)
        for number in range(10, 60):
            told.put(pack(LeaseChanged(number, "x")))
        await rig.until(lambda: len(failed) >= 50)
        assert len([one for one in caplog.records if "was not taken" in one.message]) == 10
        assert far.is_connected


# -- a request for control of several steps, and a STOP that its front does not hear ---------------


async def _moved(rig: Rig, kind: str, way_s: float, stop_after: float | None) -> tuple[float, bool]:
    """Ask for control, with a STOP meanwhile; then steer. How long it took, and whether it flew."""
    virtual = VirtualAircraft(seed=5)
    put_in_the_air(virtual, 2.4)
    one = await rig.served("a1", virtual=virtual)
    pilot, clock = await rig.pilot(), anyio.current_time
    async with AsyncExitStack() as stack:
        if "take-over" in kind:
            held = ControlSession(one.client, "another")
            await stack.enter_async_context(held.kept())
            await held.obtain()
        far = None
        if "page" in kind:
            far = await stack.enter_async_context(front(rig, pilot))
            session = ControlSession(far, "page")
            await stack.enter_async_context(session.kept())
            far.on_event.clear()  # it hears of no STOP
        rig.network.weather.delay_s, began = way_s, clock()
        if stop_after is not None:

            async def stop() -> None:
                await anyio.sleep(stop_after)
                await one.agent.stop()

            one.agent.background.spawn(stop(), "STOP")
        take_over = "take-over" in kind
        send = None
        with suppress(M100Error):
            if far is not None:
                await session.obtain(take_over=take_over)
                send = lambda: session.steer(NORTH)  # noqa: E731
            else:
                block = pilot["a1"].control(take_over=take_over)
                control = await stack.enter_async_context(block)
                send = lambda: control.send(NORTH)  # noqa: E731
        took = clock() - began
        rig.network.weather.delay_s = 0.0
        await anyio.sleep(max(3.0, (stop_after or 0.0) - took + 0.1))  # its clock is known again
        fastest = 0.0
        for _ in range(25):
            if send is not None:
                with suppress(M100Error):
                    send()
            await anyio.sleep(0.05)
            fastest = max(fastest, one.speed)
    return took, fastest > 0.3


@pytest.mark.parametrize("kind", ["page", "page, take-over", "block", "block, take-over"])
async def test_a_stop_between_two_steps_of_a_request_for_control_ends_all_of_it(kind: str) -> None:
    """Drawn: the STOP comes between any two steps, and the front does not hear of it."""
    draw = random.Random(kind)
    for way_s in (0.02, 0.3):
        took = 0.0
        for number in range(3):
            after = draw.uniform(0.0, took) if number else None
            rig = Rig()
            async with rig.stack:
                seconds, flew = await _moved(rig, kind, way_s, after)
            took = took or seconds
            assert flew == (after is None), (kind, way_s, after, took)


async def test_an_order_that_ends_something_waits_behind_no_others(rig: Rig) -> None:
    """An operator whose orders wait for answers may still stop, land and let go."""
    await rig.served("a1")
    pilot = await rig.pilot("anna")
    channel = await pilot.reach("a1")
    told: list[Message] = []
    channel.open(told.append, lambda _: None)
    rig.cut(pilot)
    for number in range(100):
        channel.send(Ask(1000 + number, orders.AskVersion()))
    for number, order in enumerate(EXAMPLES):
        channel.send(Ask(2000 + number, order))
        refused = [one.id for one in told if isinstance(one, OrderOutcome)]
        assert (2000 + number not in refused) is order.ends, order
    channel.close()


# -- times and leases, without a network: what goes out and comes in, by a given clock -----------


class Alone:
    """A channel to one agent, whose clock shows ``ahead`` seconds more."""

    def __init__(self, *, hears: bool = True, ahead: float = 100.0) -> None:
        self.now, self.known = 50.0, Offset(ahead, 0.03125)
        self.sent: list[bytes] = []
        self.given: list[Message] = []
        self.asked: list[tuple[str, orders.Order, dict[str, Any]]] = []
        self.replies: list[OrderReply | M100Error] = []
        self.clock: Any = SimpleNamespace(
            offset=lambda _now: self.known, way_s=0.0625, silent_s=lambda _now: 0.5
        )
        bus = SimpleNamespace(
            publish=lambda key: SimpleNamespace(put=self.sent.append, close=lambda: None, key=key)
        )

        def asker(name: str) -> Any:
            async def ask(order: orders.Order, **how: Any) -> OrderReply:
                self.asked.append((name, order, how))
                return self.answer()

            async def renew(lease: Lease, within: float) -> OrderReply:
                return await ask(orders.RenewLease(lease.token), within=within)

            async def take_lease(request: tuple[Lease, float]) -> tuple[Lease, float]:
                return request

            return SimpleNamespace(
                bus=bus,
                keys=Keys(SITE, "a1"),
                its_clock=self.clock,
                its_time=lambda at: 150.0 if at == math.inf else 100.0 + at,
                lease_request=lambda token, clock, since: (self.granted, clock - 1.0),
                take_lease=take_lease,
                ask=ask,
                renew=renew,
            )

        self.granted = Lease("anna", "s" * 64, 7)
        self.channel = FleetChannel(asker, hears=hears)
        self.channel._clock = lambda: self.now
        self.channel._on_message = self.given.append

    def answer(self) -> OrderReply:
        reply = self.replies.pop(0) if self.replies else LinkError("no answer")
        if isinstance(reply, M100Error):
            raise reply
        return reply

    async def grant(self, lease: Lease) -> None:
        self.granted = lease
        self.channel.send(Ask(1, orders.AcquireLease("anna")))
        await anyio.sleep(0.01)

    def steers(self) -> list[tuple[float, bool]]:
        """Stamp of each setpoint that left, and whether it begins a stream."""
        read = [unpack_steer(one, {7: "s" * 64}.get) for one in self.sent]
        assert all(one is not None for one in read)
        return [(one[0].sent_at, one[1]) for one in read if one is not None]


def reply(text: str = "", number: int = 0, offer: str = "") -> OrderReply:
    return OrderReply("", "a1", "5c", Progress.DONE, Outcome.OK, None, text, number, offer)


LEASE = Lease("anna", "s" * 64, 7)


async def test_a_setpoint_says_by_the_clock_of_the_agent_when_it_was_decided() -> None:
    one = Alone()
    one.channel.fly(LEASE, NORTH, 0.4)
    one.channel.fly(LEASE, NORTH, 0.4, made_at=49.75)
    assert one.steers() == [(150.0, True), (149.75, False)]
    steer = unpack_steer(one.sent[0], {7: "s" * 64}.get)
    assert steer is not None
    assert (steer[0].fence, steer[0].lifetime, steer[0].setpoint) == (7, 0.4, NORTH)


async def test_a_stream_begins_with_what_comes_after_half_a_second_of_none() -> None:
    one = Alone()
    for pause in (0.0, 0.5, 0.5625, 0.25):
        one.now += pause
        one.channel.fly(LEASE, NORTH, 0.4)
    one.channel.fly(LEASE, NORTH, 0.4, begins=True)
    one.now += 5.0
    one.channel.fly(LEASE, NORTH, 0.4, begins=False)
    assert [begins for _, begins in one.steers()] == [True, False, True, False, True, False]


@pytest.mark.parametrize(
    ("bound", "way", "silent", "refused"),
    [
        (0.1, 0.1, 4.0, ""),
        (0.11, 0.05, 0.5, "the clock of a1 is not known to 0.1 s"),
        (0.05, 0.11, 0.5, "the clock of a1 is not known to 0.1 s"),
        (None, 0.05, 0.5, "the clock of a1 is not known to 0.1 s"),
        (0.05, 0.05, 4.1, "a1 has answered nothing for 4 s"),
    ],
)
async def test_no_setpoint_leaves_by_a_clock_that_may_be_wrong_by_more_than_0_1_s(
    bound: float | None, way: float, silent: float, refused: str
) -> None:
    one = Alone()
    one.clock.offset = lambda _now: None if bound is None else Offset(100.0, bound)
    one.clock.way_s, one.clock.silent_s = way, lambda _now: silent
    if refused:
        with pytest.raises(UsageError, match=refused):
            one.channel.fly(LEASE, NORTH, 0.4)
    else:
        one.channel.fly(LEASE, NORTH, 0.4)
    assert len(one.sent) == (not refused)


@pytest.mark.parametrize(
    ("its", "ours"),
    [
        (149.75, 49.75),
        (150.0, 50.0),
        (151.0, 50.0),  # nothing is from later than now
        (148.0, 48.0),
        (147.9, None),  # older than two seconds
        (50.0, None),
    ],
)
async def test_what_the_agent_tells_has_the_time_of_this_side(
    its: float, ours: float | None
) -> None:
    one = Alone()
    told: list[Message] = [Telemetry(b"", "3.1", its)]
    told += [State(its), Event(4, its, "info", "text")]
    for message in told:
        one.channel._deliver_in_time(message)
    found = [message.received_at for message in one.given if isinstance(message, Telemetry)]
    found += [message.at for message in one.given if isinstance(message, State | Event)]
    # Events are kept for ever; what else is old says nothing of how it is.
    assert found == ([ours] * 3 if ours is not None else [its - 100.0])
    assert one.channel.old == (0 if ours is not None else 2)


async def test_before_the_clock_of_the_agent_is_known_it_is_now() -> None:
    one = Alone()
    one.clock.offset = lambda _now: None
    one.channel._deliver_in_time(State(3.0))
    assert [m.at for m in one.given if isinstance(m, State)] == [50.0]


async def test_the_eight_newest_leases_can_be_given_back() -> None:
    one = Alone()
    for number in range(1, 11):
        await one.grant(Lease("anna", f"secret {number}", number))
    assert [outcome.lease.number for outcome in outcomes(one)] == list(range(1, 11))  # type: ignore[union-attr]
    assert sorted(one.channel._leases) == list(range(3, 11))
    one.replies.append(reply())
    await one.channel.let_go()
    name, order, how = one.asked[-1]
    assert (name, order) == ("", orders.ReleaseLease())
    assert (how["fence"], how["token"]) == (10, "secret 10")


def outcomes(one: Alone) -> list[OrderOutcome]:
    return [message for message in one.given if isinstance(message, OrderOutcome)]


async def test_an_offer_names_both_and_holds_for_ten_seconds() -> None:
    one = Alone()
    one.replies.append(reply("bert", 6, "offered"))
    one.channel.send(Ask(3, orders.AskTakeOver("anna"), sent_at=49.5))
    await anyio.sleep(0.01)
    [outcome] = outcomes(one)
    assert (outcome.id, outcome.offer) == (3, TakeOver("anna", "bert", "offered", 6, 60.0))
    name, order, how = one.asked[-1]
    assert (name, order) == ("anna", orders.AskTakeOver("anna"))
    # Made now, by the agent's clock, and wanted when the front says.
    assert how == {"fence": 0, "token": "", "clock": 150.0, "since": 149.5}


async def test_a_lease_is_renewed_every_0_4_s_and_counts_as_lost_after_3_s_unseen() -> None:
    one = Alone()
    await one.grant(LEASE)
    for tick in range(16):  # a fifth of a second each
        one.now = 50.0 + tick * 0.2000001
        one.channel.send(Ask(0, orders.RenewLease(LEASE.token)))
        await anyio.lowlevel.checkpoint()
    renewed = [how["within"] for _, order, how in one.asked if order.label == "renew lease"]
    assert renewed == [3.0] * 8
    changes = [(m.number, m.name) for m in one.given if isinstance(m, LeaseChanged)]
    assert changes == [(7, "anna"), (0, "")]


@pytest.mark.parametrize("hears", [True, False])
async def test_a_refused_renewal_ends_the_lease_of_a_front_that_only_asks(hears: bool) -> None:
    one = Alone(hears=hears)
    await one.grant(LEASE)
    late, stale = GuardRefused("late", guard="order_age"), StaleLease("it is not in force")
    for error in (late, stale):
        one.now += 0.5
        one.replies.append(error)
        one.channel.send(Ask(0, orders.RenewLease(LEASE.token)))
        await anyio.sleep(0.01)
        is_lost = error is stale and not hears
        assert (one.channel._holder.number, one.channel.lost) == (
            (0, stale) if is_lost else (7, None)
        )


async def test_sixty_four_orders_wait_for_answers_and_what_has_its_answer_does_not() -> None:
    one, gate = Alone(), anyio.Event()

    async def ask(order: orders.Order, **_how: Any) -> OrderReply:
        await gate.wait()
        return reply(order.label)

    one.channel._asker.ask = ask  # type: ignore[assignment,method-assign]
    for number in range(1, 66):
        one.channel.send(Ask(number, orders.AskVersion()))
    one.channel.send(Ask(66, orders.Stop()))
    [refused] = outcomes(one)
    assert (refused.id, refused.stage) == (65, Stage.FAILED)
    gate.set()
    await anyio.sleep(0.01)
    assert [outcome.id for outcome in outcomes(one)[1:]] == [*range(1, 65), 66]
    assert {outcome.text for outcome in outcomes(one)[1:65]} == {orders.AskVersion().label}
    one.channel.send(Ask(67, orders.AskVersion()))
    await anyio.sleep(0.01)
    assert (outcomes(one)[-1].id, outcomes(one)[-1].stage) == (67, Stage.DONE)


async def test_a_setpoint_of_a_lease_that_is_not_in_force_leaves_nothing() -> None:
    one = Alone()
    await one.grant(LEASE)
    for fence in (6, 7):
        one.channel.send(Steer(fence, 49.75, 0.4, NORTH))
        assert sum(isinstance(message, SteerRefused) for message in one.given) == 1, fence
    assert one.steers() == [(149.75, True)]
    with pytest.raises(MessageError, match="a client does not send SteerRefused"):
        one.channel.send(one.given[-1])
