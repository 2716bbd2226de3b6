"""A tab of the console: beats move, and everything else stops."""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

import anyio
import anyio.lowlevel
import pytest
from hypothesis import given
from hypothesis import strategies as st

import m100link
from m100link.apps.agent import orders
from m100link.apps.agent.latency import (
    MAX_ORDER_LATE,
    MAX_ROUND_TRIP,
    MAX_UNHEARD,
    PAGE_GRAIN,
)
from m100link.apps.agent.lease import LeaseChange, LeaseHeld
from m100link.apps.agent.messages import State
from m100link.apps.agent.orders import Life, News
from m100link.apps.station.console.tab import (
    BEAT_LIFETIME,
    TOLD_S,
    Fate,
    IssuedOrder,
    Tab,
    _read,
)
from m100link.apps.station.console.view.fly import FIELDS, live, read
from m100link.apps.station.console.view.texts import Translator, tr
from m100link.errors import GuardRefused, LossReason, M100Error, NoAuthority
from m100link.geodesy import LocalFrame
from m100link.protocol.records import Attitude, Position, RcMode, Velocity
from m100link.protocol.setpoint import Setpoint
from m100link.sim.orders import perform
from tests.apps.station.conftest import Rig
from tests.known import seen

pytestmark = pytest.mark.anyio


class Browser:
    """What the page's script does."""

    def __init__(self, rig: Rig, name: str = "tab") -> None:
        self.rig = rig
        self.tab = Tab(rig.front, name)
        self.count = 0
        # What the page knows of the station: its time, and when that was heard.
        self.told: dict[str, float] | None = None
        self.heard_at = 0.0
        self.ahead = 0.0  # seconds that its clock is ahead of the station's

    @property
    def now(self) -> float:
        """What its clock shows, s."""
        return self.rig.agent.now + self.ahead

    @property
    def problem(self) -> str:
        """What its operator reads."""
        return str(self.tab.refusal or "")

    def message(self, op: str, **fields: Any) -> str:
        """What the page sends at this moment."""
        self.count += 1
        at = 1000 * self.now
        told = {} if self.told is None else {"told": self.told, "held": at - 1000 * self.heard_at}
        return json.dumps({"op": op, "n": self.count, "at": at, **told, **fields})

    def hear(self, answer: dict[str, Any] | None) -> dict[str, Any] | None:
        if answer is not None:
            self.told, self.heard_at = answer["told"], self.now
        return answer

    def say(self, op: str, **fields: Any) -> dict[str, Any] | None:
        if self.told is None:
            self.hear(self.tab.receive(self.message("alive")))
        return self.hear(self.tab.receive(self.message(op, **fields)))

    def beat(self, mode: int = 1, **axes: float) -> dict[str, Any] | None:
        return self.say("beat", mode=mode, **({"x": 0, "y": 0, "z": 0, "w": 0} | axes))

    async def hold(self, seconds: float, **axes: float) -> None:
        for _ in range(round(seconds / 0.05)):
            self.beat(1, **axes)
            await anyio.sleep(0.05)


async def airborne(rig: Rig) -> Browser:
    browser = Browser(rig)
    await browser.tab.session.ask(orders.Activate())
    await browser.tab.session.obtain()
    await keep_alive(browser, browser.tab.session.ask(orders.TakeOff()))
    return browser


async def keep_alive(browser: Browser, work: Any) -> None:
    """The page says twice a second that it is there."""
    async with anyio.create_task_group() as group:

        async def alive() -> None:
            while True:
                browser.say("alive")
                await anyio.sleep(0.5)

        group.start_soon(alive)
        await work
        group.cancel_scope.cancel()


async def test_a_whole_flight(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(2.0, x=-4)
    browser.say("rest")
    assert rig.aircraft.position[0] > 0.5
    assert browser.problem == ""
    await keep_alive(browser, browser.tab.session.ask(orders.Land()))
    await browser.tab.session.give_back()
    assert rig.aircraft.height == pytest.approx(0, abs=0.05)
    assert not rig.agent.holding.has_authority


async def test_keys_that_were_long_on_their_way_move_nothing(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(0.2, x=-4)
    browser.say("rest")
    waiting = [browser.message("beat", mode=1, x=-4, y=0, z=0, w=0) for _ in range(20)]
    await anyio.sleep(2.0)
    place = rig.aircraft.position
    for text in waiting:  # all at once, as after a stall of the network
        browser.tab.receive(text)
    await keep_alive(browser, anyio.sleep(1.0))
    assert "s late" in browser.problem
    assert browser.tab.refused == 20
    assert rig.aircraft.position == pytest.approx(place, abs=0.3)


@pytest.mark.parametrize("step", [3600.0, -3600.0, 10.0, -10.0])
async def test_a_page_whose_clock_was_set_steers_on_and_moves_nothing_by_what_waited(
    rig: Rig, step: float
) -> None:
    browser = await airborne(rig)
    await browser.hold(0.5, x=-4)
    waiting = [browser.message("beat", mode=1, x=-4, y=0, z=0, w=0) for _ in range(10)]
    browser.ahead = step
    before = browser.tab.beats
    await browser.hold(0.5, x=-4)
    assert browser.tab.beats - before >= 8, "once the station's time has come back"
    await anyio.sleep(1.0)
    before = browser.tab.beats
    for number, text in enumerate(waiting, browser.count + 1):  # by their times alone they are old
        browser.tab.receive(json.dumps(json.loads(text) | {"n": number}))
    assert browser.tab.beats == before


@pytest.mark.parametrize("seed", range(4))
async def test_no_page_that_lies_about_its_time_flies_by_a_picture_that_is_old(
    rig: Rig, seed: int
) -> None:
    """A picture is as old as what the station said with it, whatever the page says of times."""
    browser, chance = await airborne(rig), random.Random(seed)
    pictures, flown = [rig.agent.now], 0
    for number in range(1000, 1200):
        await anyio.sleep(chance.choice((0.01, 0.05, 0.3)))
        now = rig.agent.now
        pictures = [*pictures[-20:], now]
        told = chance.choice(pictures)
        held = 1000 * chance.choice((now - told, chance.uniform(-1, 3), now, 1e11, -1e11, 0.0))
        at = 1000 * chance.choice((now, told, chance.uniform(0, 2 * now), now + 3600, 1e11))
        message = {"op": "beat", "n": number, "at": at, "told": told, "held": held, "mode": 1}
        before = browser.tab.beats
        browser.tab.receive(json.dumps(message | {"x": -4, "y": 0, "z": 0, "w": 0}))
        if browser.tab.beats > before:
            flown += 1
            assert now - told <= MAX_UNHEARD + MAX_ROUND_TRIP + 1e-6
            assert held / 1000 <= now - told + PAGE_GRAIN + 1e-6, "it heard it before it was said"
    assert flown > 0


@pytest.mark.parametrize(("each_way", "flies"), [(0.1, True), (0.25, False), (1.0, False)])
async def test_nobody_steers_through_a_slow_network(rig: Rig, each_way: float, flies: bool) -> None:
    browser = await airborne(rig)
    north = rig.aircraft.position[0]
    browser.tab.lost()  # another way
    await browser.tab.session.obtain()

    async def answer(reply: dict[str, Any]) -> None:
        await anyio.sleep(each_way)
        browser.hear(reply)

    async def send(text: str, group: Any) -> None:
        await anyio.sleep(each_way)
        reply = browser.tab.receive(text)
        assert reply is not None
        group.start_soon(answer, reply)

    browser.told = None
    async with anyio.create_task_group() as group:
        for number in range(80):
            op = "alive" if number < 60 else "beat"
            axes = {} if op == "alive" else {"mode": 1, "x": -4, "y": 0, "z": 0, "w": 0}
            group.start_soon(send, browser.message(op, **axes), group)
            await anyio.sleep(0.05)
    assert browser.tab.beats == (20 if flies else 0)
    assert (rig.aircraft.position[0] - north > 0.05) is flies
    assert ("the round trip to the page takes" in browser.problem) is not flies


async def test_a_beat_is_on_the_line_at_once(rig: Rig) -> None:
    browser = await airborne(rig)
    count = len(rig.moves)
    browser.beat(x=-4)
    await anyio.lowlevel.checkpoint()
    await anyio.lowlevel.checkpoint()
    assert len(rig.moves) == count + 1


async def test_300_ms_without_a_beat_stop_the_motion(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(1.0, x=-4)
    last_beat = rig.agent.now - 0.05
    await rig.until(lambda: rig.moves[-1].pitch_or_y == 0, within=1.0)
    assert rig.agent.now - last_beat == pytest.approx(BEAT_LIFETIME, abs=0.03)


async def test_a_rest_stops_at_once(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(0.5, x=-4)
    browser.say("rest")
    await anyio.sleep(0.03)
    assert rig.moves[-1].pitch_or_y == 0


async def test_a_lost_socket_stops_at_once_and_frees_control(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(0.5, x=-4)
    browser.tab.lost()
    await anyio.sleep(0.03)
    assert rig.moves[-1].pitch_or_y == 0
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.0)


async def test_a_tab_that_is_silent_loses_its_lease(rig: Rig) -> None:
    browser = await airborne(rig)
    browser.say("alive")
    await anyio.sleep(2.9)
    assert rig.agent.leases.holder(rig.agent.now) == browser.tab.session.lease
    await rig.until(lambda: not browser.tab.session.has_lease, within=0.3)
    await rig.until(lambda: not rig.agent.holding.has_authority, within=1.0)
    browser.beat(x=-4)
    await anyio.sleep(0.1)
    assert all(move.pitch_or_y == 0 for move in rig.moves)


async def test_old_messages_again_do_nothing(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(0.2, x=-4)
    browser.say("rest")
    await anyio.sleep(0.5)
    count = len(rig.moves)
    old = {"op": "beat", "n": 5, "at": 1.0, "mode": 1, "x": -4, "y": 0, "z": 0, "w": 0}
    assert browser.tab.receive(json.dumps(old)) is None
    await anyio.sleep(0.1)
    assert len(rig.moves) == count


async def test_a_tab_without_the_lease_moves_nothing(rig: Rig) -> None:
    await airborne(rig)
    other = Browser(rig, "other")
    now = rig.agent.now
    told = {"op": "echo", "at": 1000 * now, "fate": "other", "order": 1, "told": now}
    assert other.beat(x=-4) == told
    with pytest.raises(LeaseHeld):
        await other.tab.session.obtain()
    with pytest.raises(NoAuthority, match="this page has no control: tab has control"):
        await other.tab.session.ask(orders.Land())
    await other.tab.session.give_back()  # what it does not have
    assert rig.agent.holding.has_authority
    await anyio.sleep(0.2)
    assert rig.moves == []


async def test_a_take_over_stops_the_motion_and_keeps_authority(rig: Rig) -> None:
    browser = await airborne(rig)
    other = Browser(rig, "other")
    await browser.hold(0.5, x=-4)
    wanted = await other.tab.session.ask_take_over()
    assert wanted.from_name == "tab"
    await other.tab.session.confirm(wanted)
    browser.beat(x=-4)
    await anyio.sleep(0.03)
    assert rig.moves[-1].pitch_or_y == 0
    assert rig.agent.holding.has_authority
    other.beat(y=2)
    await anyio.sleep(0.03)
    assert rig.moves[-1].roll_or_x == 2


async def test_an_operator_who_lost_the_lease_knows_to_whom(rig: Rig) -> None:
    browser, other = await airborne(rig), Browser(rig, "Anna")
    await other.tab.session.confirm(await other.tab.session.ask_take_over())
    end = browser.tab.session.lease_end
    assert end is not None
    assert (end.name, end.why) == ("Anna", LeaseChange.TAKEN_OVER)
    assert other.tab.session.lease_end is None
    await browser.tab.session.confirm(await browser.tab.session.ask_take_over())
    assert browser.tab.session.lease_end is None
    await browser.tab.session.give_back()
    await anyio.sleep(0.1)
    assert browser.tab.session.lease_end is None  # it was given back


async def test_a_lease_that_expired_was_taken_by_nobody(rig: Rig) -> None:
    browser = await airborne(rig)
    await rig.until(lambda: not browser.tab.session.has_lease, within=4.0)
    end = browser.tab.session.lease_end
    assert end is not None
    assert (end.name, end.why) == ("", LeaseChange.EXPIRED)


async def test_the_taker_of_authority_is_known_until_it_is_held_again(rig: Rig) -> None:
    browser = await airborne(rig)
    rig.aircraft.set_rc_mode(RcMode.P)
    await keep_alive(browser, rig.until(lambda: browser.tab.session.loss is not None, within=2.0))
    assert browser.tab.session.loss is LossReason.MODE_SWITCH
    rig.aircraft.set_rc_mode(RcMode.F)
    await keep_alive(browser, rig.until(lambda: rig.front.has_authority, within=2.0))
    await browser.tab.session.obtain()
    assert browser.tab.session.loss is None


async def test_a_tab_that_was_closed_hears_nothing_more(rig: Rig) -> None:
    browser = Browser(rig)

    def counts() -> tuple[int, int, int]:
        front = rig.front
        return len(front.on_lease), len(front.on_authority_taken), len(front.on_steer_refused)

    before = counts()
    browser.tab.close()
    browser.tab.close()
    assert counts() == tuple(count - 1 for count in before)


async def test_stop_ends_a_task_by_giving_authority_back(rig: Rig) -> None:
    browser = Browser(rig)
    await browser.tab.session.ask(orders.Activate())
    await browser.tab.session.obtain()
    async with anyio.create_task_group() as group:
        group.start_soon(browser.tab.attempt, lambda: browser.tab.session.ask(orders.TakeOff()))
        await anyio.sleep(2.0)
        await Browser(rig, "anybody").tab.stop()
    assert "control ended" in browser.problem
    assert not rig.agent.holding.has_authority


CLIMB = orders.ChangeHeight(20.0)

REPLACED = {
    "stop": lambda tab: tab.stop(),
    "pause": lambda tab: tab.attempt(lambda: hovers(tab)),
    "another place": lambda tab: tab.attempt(lambda: tab.session.ask(orders.ChangeHeight(2.0))),
    "land": lambda tab: tab.attempt(lambda: tab.session.ask(orders.Land())),
}


async def hovers(tab: Tab) -> None:
    tab.agent.hover("pause", tab.session.lease)


@pytest.mark.parametrize("by", [*REPLACED, "stick"])
async def test_what_an_order_of_the_same_tab_ended_did_not_fail(rig: Rig, by: str) -> None:
    browser = await airborne(rig)
    tab = browser.tab
    async with anyio.create_task_group() as group:
        climb = rig.front.background.spawn(tab.attempt(lambda: tab.session.ask(CLIMB)), "climb")
        await rig.until(lambda: rig.front.state.guided is not None)
        if by == "stick":
            await browser.hold(0.5, x=-1)
        else:
            group.start_soon(REPLACED[by], tab)
        await rig.until(climb.done)
        assert not climb.result()
        assert browser.problem == ""
        group.cancel_scope.cancel()


@pytest.mark.parametrize("refused", [False, True])
async def test_what_somebody_else_ended_is_reported(rig: Rig, refused: bool) -> None:
    """Also when the tab gave an order meanwhile, and that was refused, or moves nothing."""
    browser = await airborne(rig)
    tab = browser.tab
    climb = rig.front.background.spawn(tab.attempt(lambda: tab.session.ask(CLIMB)), "climb")
    await rig.until(lambda: rig.front.state.guided is not None)
    if refused:
        assert not await tab.attempt(lambda: tab.session.ask(orders.StartMission("no plan")))
    else:
        assert await tab.attempt(tab.session.obtain, replaces=False)
    rig.front.hover("console 7: pause")
    await rig.until(climb.done)
    assert "console 7: pause" in browser.problem


async def test_problems_are_kept_for_the_operator(rig: Rig) -> None:
    browser = Browser(rig)
    perform(rig.aircraft, "server-refuses on")
    assert not await browser.tab.attempt(browser.tab.session.obtain)
    assert "server" in browser.problem
    assert not browser.tab.session.has_lease
    perform(rig.aircraft, "server-refuses off")
    assert await browser.tab.attempt(browser.tab.session.obtain)  # which activates
    assert browser.problem == ""
    assert not await browser.tab.attempt(lambda: browser.tab.session.ask(orders.FlyPattern(3)))
    assert "random commands" in browser.problem
    browser.beat(x=-36)
    assert "outside" in browser.problem


@pytest.mark.parametrize("fault", ["silent", "late"])
async def test_a_refusal_under_a_held_key_is_set_once_and_cleared_once(
    rig: Rig, fault: str
) -> None:
    """A screen reader reads the line when it changes: with each beat it would read nothing else."""
    browser = await airborne(rig)
    session, shown = browser.tab.session, [browser.problem]
    # Its answer comes from another process: later than the beat has returned.
    refused, loop = session.on_refused, asyncio.get_running_loop()

    def refuse_later(error: M100Error) -> None:
        loop.call_later(0.01, refused, error)

    session.on_refused = refuse_later

    def look() -> None:
        if shown[-1] != browser.problem:
            shown.append(browser.problem)

    async def hold(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            look()
            browser.beat(x=-2)
            look()
            await anyio.sleep(0.05)

    await hold(1.0)
    if fault == "silent":
        perform(rig.aircraft, "stall on")
        await hold(3.0)
        assert "does not hold control authority" in browser.problem
        perform(rig.aircraft, "stall off")
        browser.say("rest")
        await keep_alive(browser, anyio.sleep(5.0))
        await keep_alive(browser, browser.tab.session.obtain())
        browser.say("rest")
    else:
        for beat in range(16):  # each later than the one before
            text = browser.message("beat", mode=1, x=-2, y=0, z=0, w=0)
            await anyio.sleep(0.4 + 0.01 * beat)
            browser.hear(browser.tab.receive(text))
            look()
        assert "s late" in browser.problem
        browser.say("rest")
    assert len(shown) == 2
    noted = [one.text for one in rig.front.events if one.text.startswith("tab: ")]
    assert 2 <= len(noted) <= 7, "one in a second, of 20 beats"
    await hold(1.0)
    assert len(shown) == 3
    assert shown[0] == shown[2] == ""


_VALUES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)


@given(
    st.dictionaries(
        st.sampled_from(["op", "n", "at", "mode", "x", "y", "z", "w"]),
        _VALUES | st.sampled_from(["beat", "rest", "alive"]),
    )
)
def test_a_message_is_whole_or_nothing(message: dict[str, Any]) -> None:
    result = _read(json.dumps(message))
    if result is not None:
        assert type(result["n"]) is int
        if result["op"] == "beat":
            assert all(isinstance(result[axis], int | float) for axis in "xyzw")


def test_no_field_shows_a_zero_below_zero_or_a_whole_turn() -> None:
    fields = {field.name: field for field in FIELDS}
    half = math.radians(-0.2) / 2
    a_bit_west = Attitude(q0=math.cos(half), q1=0.0, q2=0.0, q3=math.sin(half))
    assert Translator()(fields["heading"].text(a_bit_west)) == "0°"
    sinking = Velocity(north_m_s=0.0, east_m_s=0.0, up_m_s=-0.02, status=None)
    assert Translator()(fields["climb"].text(sinking)) == "+0.0 m/s"


@pytest.mark.parametrize("text", ["", "{", "[]", "1", "[" * 1000, "x" * 3000, b"\xff\xfe"])
def test_nonsense_is_nothing(text: str | bytes) -> None:
    assert _read(text) is None


async def test_fields_grey_out_by_their_own_age(rig: Rig) -> None:
    telemetry = rig.front.telemetry
    assert telemetry is not None
    await anyio.sleep(1.5)
    readings = {field.name: read(field, seen(telemetry)) for field in FIELDS}
    assert not readings["height"].is_stale
    assert Translator()(readings["flight_status"].text) == "on the ground"
    assert readings["control_device"].note == tr("instruments.never")  # not sent by default
    rig.aircraft.stall_line()
    await anyio.sleep(1.7)
    readings = {field.name: read(field, seen(telemetry)) for field in FIELDS}
    assert readings["height"].is_stale
    assert not readings["battery"].is_stale  # comes once a second only
    await anyio.sleep(4.0)
    readings = {field.name: read(field, seen(telemetry)) for field in FIELDS}
    assert readings["battery"].is_stale
    assert "att" not in live(seen(telemetry))
    assert read(FIELDS[0], seen(None)).is_stale
    assert live(seen(None, 1.0)) == {"op": "live", "t": 1.0}


def speed(rig: Rig) -> float:
    telemetry = rig.front.telemetry
    assert telemetry is not None
    velocity = telemetry.get(Velocity)
    assert velocity is not None
    return velocity.ground_speed_m_s


async def test_an_operator_who_holds_something_while_somebody_presses_stop_has_to_let_go(
    rig: Rig,
) -> None:
    flying, other = await airborne(rig), Browser(rig, "other")
    await flying.hold(1.0, x=-8)
    assert speed(rig) > 0.3
    other.say("stop")
    await flying.hold(0.2, x=-8)
    told, flying.told = flying.told, None
    flying.tab.receive(flying.message("rest"))  # it may have let go before
    flying.told = told
    await flying.hold(2.3, x=-8)  # the key stays pressed
    assert speed(rig) < 0.2
    assert "STOP was pressed" in flying.problem
    flying.say("rest")
    await flying.hold(1.0, x=-8)
    assert speed(rig) > 0.3
    assert flying.problem == ""


async def pilot_flies_a_while(flying: Browser) -> None:
    flying.rig.aircraft.leave_f()
    await flying.hold(3.0, x=-8)
    flying.rig.aircraft.return_to_f()
    await flying.hold(0.05, x=-8)


async def the_way_is_slow_a_while(flying: Browser) -> None:
    late: list[str] = []
    for _ in range(60):
        late.append(flying.message("beat", mode=1, x=-8, y=0, z=0, w=0))
        await anyio.sleep(0.05)
        if len(late) > 12:
            flying.hear(flying.tab.receive(late.pop(0)))
    for message in late:
        flying.hear(flying.tab.receive(message))


async def the_cable_is_out_a_while(flying: Browser) -> None:
    rig = flying.rig
    rig.aircraft.unplug()
    await flying.hold(2.0, x=-8)
    rig.aircraft.replug()
    while not rig.front.is_connected:
        await flying.hold(0.1, x=-8)
    await flying.hold(0.5, x=-8)
    obtaining = asyncio.create_task(flying.tab.session.obtain())
    while not obtaining.done():
        await flying.hold(0.1, x=-8)
    await obtaining


@pytest.mark.parametrize(
    ("happens", "why"),
    [
        (pilot_flies_a_while, "control was lost meanwhile"),
        (the_way_is_slow_a_while, "the network was too slow"),
        (the_cable_is_out_a_while, "meanwhile"),
    ],
)
async def test_what_is_held_while_nobody_could_steer_moves_nothing_when_somebody_can(
    rig: Rig, happens: Callable[[Browser], Awaitable[None]], why: str
) -> None:
    flying = await airborne(rig)
    await flying.hold(1.0, x=-8)
    assert speed(rig) > 0.3
    await happens(flying)
    await flying.hold(3.0, x=-8)
    assert rig.agent.holding.has_authority
    assert speed(rig) < 0.2
    assert f"{why}, and you still hold a key or stick" in flying.problem
    flying.say("rest")
    await flying.hold(1.0, x=-8)
    assert speed(rig) > 0.3
    assert flying.problem == ""


async def test_what_is_held_as_control_is_obtained_moves_nothing(rig: Rig) -> None:
    first = await airborne(rig)
    await first.tab.session.give_back()
    browser = Browser(rig)
    await browser.hold(1.0, x=-8)  # one hand on the stick, the other on the button
    obtaining = asyncio.create_task(browser.tab.session.obtain())
    while not obtaining.done():
        await browser.hold(0.1, x=-8)
    await browser.hold(2.0, x=-8)
    assert browser.tab.session.has_lease
    assert speed(rig) < 0.2
    assert "control was obtained meanwhile" in browser.problem
    await keep_alive(browser, anyio.sleep(1.5))  # let go, and that was not heard
    await browser.hold(1.0, x=-8)
    assert speed(rig) > 0.3


async def test_one_beat_that_is_late_asks_for_no_new_press(rig: Rig) -> None:
    flying = await airborne(rig)
    await flying.hold(1.0, x=-8)
    late = flying.message("beat", mode=1, x=-8, y=0, z=0, w=0)
    await anyio.sleep(0.6)
    flying.hear(flying.tab.receive(late))
    assert "s late" in flying.problem
    await keep_alive(flying, anyio.sleep(3.0))  # let go, and that was not heard
    late = flying.message("beat", mode=1, x=-8, y=0, z=0, w=0)
    await anyio.sleep(0.6)
    flying.hear(flying.tab.receive(late))  # the first of another press, and late again
    await flying.hold(1.0, x=-8)
    assert flying.problem == ""
    assert speed(rig) > 0.3


async def test_stop_by_the_socket_needs_no_lease_and_runs_once_at_a_time(rig: Rig) -> None:
    flying, other = await airborne(rig), Browser(rig, "other")
    flying.beat(1, x=-8)
    for _ in range(50):  # a page that says it in a loop
        other.say("stop")
        flying.beat(1, x=-8)
    assert sum("stop of other" in task.get_name() for task in asyncio.all_tasks()) == 1
    await anyio.sleep(2.0)
    assert speed(rig) < 0.2
    assert [event.text for event in rig.front.events].count("stop") == 1


async def test_one_press_of_stop_by_both_ways_is_one_entry(rig: Rig) -> None:
    other = Browser(rig, "other")
    for press in (1, 2):
        assert (other.say("stop", press=press) or {})["press"] == press  # for the page to know
        await anyio.sleep(0.1)
        await other.tab.stop(press)
        other.say("stop", press=press)  # late, or once more
        await anyio.sleep(0.1)
        assert [event.text for event in rig.front.events].count("stop") == press


async def test_a_press_of_stop_that_one_way_failed_to_bring_is_carried_out_by_the_other(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    tab = Browser(rig).tab
    with monkeypatch.context() as failing:

        async def fail(_: str) -> None:
            raise GuardRefused("no", guard="", measured=None, limit=None)

        failing.setattr(rig.front, "stop", fail)
        await tab.stop(1)
    await tab.stop(1)
    assert [event.text for event in rig.front.events].count("stop") == 1


async def test_beats_that_were_held_up_after_stop_do_not_count_as_let_go(rig: Rig) -> None:
    flying = await airborne(rig)
    await flying.hold(0.5, x=-1)
    await Browser(rig, "other").tab.stop()
    sent = []
    for _ in range(30):  # a network that stands still for longer than a beat lasts
        sent.append(flying.message("beat", mode=1, x=-1, y=0, z=0, w=0))
        await anyio.sleep(0.05)
    for message in sent:
        flying.hear(flying.tab.receive(message))
    await flying.hold(0.5, x=-1)
    assert "STOP was pressed" in flying.problem
    before = len(rig.moves)
    await flying.hold(0.5, x=-1)
    assert not any(move.pitch_or_y for move in rig.moves[before:])
    flying.say("rest")
    await flying.hold(0.5, x=-1)
    assert rig.moves[-1].pitch_or_y


@pytest.mark.parametrize("how", ["lets go", "pauses"])
async def test_what_a_page_said_before_stop_does_not_undo_it(rig: Rig, how: str) -> None:
    """A network holds it up for half a second, in which somebody else presses STOP."""
    flying = await airborne(rig)
    await flying.hold(0.5, x=-1)
    if how == "lets go":
        sent = [flying.message("rest")]
    else:
        sent = []
        flying.say("rest")
        for _ in range(3):
            await anyio.sleep(0.4)
            flying.say("alive")
    for step in range(10):  # pressed anew, and held
        sent.append(flying.message("beat", mode=1, x=-1, y=0, z=0, w=0))
        if step == 8:
            await Browser(rig, "other").tab.stop()
            before = len(rig.moves)
        await anyio.sleep(0.05)
    for message in sent:
        flying.hear(flying.tab.receive(message))
    await flying.hold(1.0, x=-1)
    assert not any(move.pitch_or_y for move in rig.moves[before:])
    assert "STOP was pressed" in flying.problem
    flying.say("rest")
    await flying.hold(0.5, x=-1)
    assert rig.moves[-1].pitch_or_y


async def test_a_button_that_was_pressed_before_stop_and_came_after_it_is_refused(rig: Rig) -> None:
    browser = Browser(rig)
    browser.say("alive")
    said_at = 1000 * rig.agent.now
    await anyio.sleep(0.3)
    await rig.agent.stop()
    await anyio.sleep(0.3)
    with pytest.raises(GuardRefused, match=r"arrived 0\.7 s late, and STOP came first"):
        browser.tab.check_order(said_at)
    now = rig.front.now
    oldest = now - browser.tab.way.oldest(now, now)
    rig.front.stopped_at = oldest  # in the same instant
    with pytest.raises(GuardRefused, match="and STOP came first"):
        browser.tab.check_order(1000 * now)
    rig.front.stopped_at = math.nextafter(oldest, 0.0)
    browser.tab.check_order(1000 * now)


async def test_a_press_counts_from_when_it_was_made_in_the_page(rig: Rig) -> None:
    """The STOP came between press and arrival, and this station has not heard of it."""
    browser = await airborne(rig)
    tab, said_at = browser.tab, 1000 * rig.agent.now
    await anyio.sleep(0.3)
    await rig.agent.stop()
    await anyio.sleep(0.3)
    rig.front.stopped_at = -math.inf

    async def pressed() -> None:
        tab.check_order(said_at)
        await tab.session.ask(orders.GoHome())

    # As each button does, in a task of its own.
    assert not await rig.front.background.spawn(tab.attempt(pressed), "go home")
    assert tab.refusal is not None
    assert "STOP was pressed after" in tab.refusal.seen
    said_at = 1000 * rig.agent.now
    going = rig.front.background.spawn(tab.attempt(pressed), "go home")
    await rig.until(
        lambda: rig.front.state.task != ""
    )  # the operator saw the STOP, and begins anew
    going.cancel()


async def test_stop_is_heard_from_a_page_that_is_slow(rig: Rig) -> None:
    browser = await airborne(rig)
    await browser.hold(1.0, x=-8)
    late = browser.message("stop")
    await browser.hold(1.0, x=-8)
    assert speed(rig) > 0.3
    browser.tab.receive(late)  # behind others that were said later
    await anyio.sleep(2.5)
    assert speed(rig) < 0.2


@pytest.mark.parametrize("said_at", [None, "now", True, math.nan, -1e300, 1e14, [1.0]])
async def test_an_order_without_a_time_is_refused(rig: Rig, said_at: object) -> None:
    browser = Browser(rig)
    browser.say("alive")
    with pytest.raises(GuardRefused, match="has no time"):
        browser.tab.check_order(said_at)


async def test_an_order_that_waited_is_refused(rig: Rig) -> None:
    browser = Browser(rig)
    tab, said_at = browser.tab, 1000 * rig.agent.now
    with pytest.raises(GuardRefused, match="has no time"):
        tab.check_order(said_at)  # how far off the page's clock is nobody knows
    browser.say("alive")
    await anyio.sleep(MAX_ORDER_LATE - 0.2)
    tab.check_order(said_at)
    await anyio.sleep(0.3)
    with pytest.raises(GuardRefused, match="2 s late") as refused:
        tab.check_order(said_at)
    await anyio.sleep(0.1)
    assert "2 s late; nothing was done" in rig.front.events[-1].text
    assert refused.value.limit == MAX_ORDER_LATE


@pytest.mark.parametrize("whose", ["own", "of another"])
async def test_what_ones_own_stop_ended_is_no_problem(rig: Rig, whose: str) -> None:
    browser = await airborne(rig)
    other = Browser(rig, "another")
    tab = browser.tab

    async def stop() -> None:
        await anyio.sleep(1.0)
        await (tab if whose == "own" else other.tab).stop()

    async with anyio.create_task_group() as group:
        group.start_soon(stop)
        group.start_soon(keep_alive, browser, anyio.sleep(3.0))
        assert not await tab.attempt(lambda: tab.session.ask(orders.Land()))
    assert (browser.problem == "") is (whose == "own")
    # What goes wrong afterwards is one.
    assert not await tab.attempt(lambda: tab.session.ask(orders.FlyPattern(99)))
    assert browser.problem


# -- the page hears the outcome of a press ---------------------------------------------------------


async def hold(browser: Browser, seconds: float, **axes: float) -> list[str]:
    """Beats for a time; the reports of each."""
    told = []
    for _ in range(round(seconds / 0.05)):
        answer = browser.beat(1, **axes)
        assert answer is not None
        told.append(answer["fate"])
        await anyio.sleep(0.05)
    return told


async def test_sent_becomes_flown_once_the_agent_has_taken_it(rig: Rig) -> None:
    browser = await airborne(rig)
    for _ in range(2):
        told = await hold(browser, 1.0, x=-4)
        steps = [Fate.SENT, Fate.ACCEPTED, Fate.FLOWN]
        assert sorted(told, key=lambda one: steps.index(Fate(one))) == told, (
            "each after the one before, and not back"
        )
        assert set(told) == set(steps)
        browser.say("rest")
        await keep_alive(browser, anyio.sleep(2.0))


@pytest.mark.parametrize(
    ("age", "north", "found"),
    [
        (0.55, 0.61, (True, True)),  # less than the grain of a page's clock before the press
        (0.55, 0.59, (True, False)),
        (0.55, -0.61, (True, False)),
        (0.65, 0.61, (False, None)),  # the aircraft has the setpoint of the press before
    ],
)
def test_a_press_is_flown_when_telemetry_shows_three_tenths_of_its_speed(
    age: float, north: float, found: tuple[bool, bool | None]
) -> None:
    wanted = Setpoint.velocity(north=2.0, east=0.0, up=0.0, yaw_rate_deg_s=0.0)
    velocity, state = Velocity(north, 0.0, 0.0, 5), State(10.5, setpoint_age=age)
    view: Any = SimpleNamespace(state=state, together={Velocity: velocity}.get)
    assert IssuedOrder(1, 10.0, wanted=wanted)._of_press(view) == found


def test_a_flight_that_was_accepted_is_not_flown_before_its_agent_says_so() -> None:
    flight = IssuedOrder(1, 10.0, order=orders.FlyTo(52.0, 4.3, height=5.0))
    view: Any = SimpleNamespace(is_heard=True, at=10.2, heard_at=10.0, state=State(10.2))
    flight.look(view, 10.05)
    assert flight.life is Life.SENT
    flight.hear(News.TAKEN, 10.1)
    assert flight._of_flight(view) == (True, False)


async def test_nobody_in_control_flies_nothing_by_its_pad(rig: Rig) -> None:
    browser = Browser(rig)
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.NO_CONTROL}
    await browser.tab.session.ask(orders.Activate())
    await browser.tab.session.obtain()
    browser.say("rest")
    # It has control, and stands with its motors off.
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.ON_GROUND}
    other = Browser(rig, "another")
    assert set(await hold(other, 0.5, x=-4)) == {Fate.OTHER}


async def test_a_pilot_who_takes_it_ends_what_is_flown(rig: Rig) -> None:
    browser = await airborne(rig)
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN
    rig.aircraft.leave_f()
    assert (await hold(browser, 1.0, x=-4))[-1] == Fate.PILOT


async def test_what_is_held_through_stop_is_reported_as_such(rig: Rig) -> None:
    browser = await airborne(rig)
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN
    await browser.tab.stop()
    assert set(await hold(browser, 0.5, x=-4)) == {Fate.LET_GO}
    browser.say("rest")
    assert (await hold(browser, 0.5, x=-4))[-1] == Fate.FLOWN


async def test_late_beats_are_reported_as_slow(rig: Rig) -> None:
    browser = await airborne(rig)
    await hold(browser, 0.5, x=-4)
    waiting = [browser.message("beat", mode=1, x=-4, y=0, z=0, w=0) for _ in range(3)]
    await anyio.sleep(0.6)
    for text in waiting:
        answer = browser.hear(browser.tab.receive(text))
        assert answer is not None
        assert answer["fate"] == Fate.SLOW


@pytest.mark.parametrize("seed", range(5))
async def test_flown_is_reported_only_while_the_tab_flies(rig: Rig, seed: int) -> None:
    """Drawn: whatever happens in whatever order, "flown" means control, in the air, not refused."""
    chance = random.Random(seed)
    browser = await airborne(rig)
    tab: Tab = browser.tab

    async def stop() -> None:
        await tab.stop()

    async def nothing() -> None:
        await anyio.sleep(chance.random())

    async def rest() -> None:
        browser.say("rest")

    async def leave_f() -> None:
        rig.aircraft.leave_f()

    async def return_to_f() -> None:
        rig.aircraft.return_to_f()

    async def lose() -> None:
        tab.lost()

    async def obtain() -> None:
        await tab.attempt(tab.session.obtain)

    events: list[Any] = [stop, nothing, rest, leave_f, return_to_f, lose, obtain]
    flown = 0
    for _ in range(60):
        await chance.choice(events)()
        await hold(browser, chance.uniform(0.0, 0.3), x=-1)
        fates = await hold(browser, 0.3, x=-1)  # for so long an old report may last
        flown += fates.count(Fate.FLOWN)
        if fates and fates[-1] == Fate.FLOWN:
            assert tab.session.has_lease
            assert browser.problem == ""
            assert rig.agent.holding.has_authority
            assert rig.aircraft.height > 0.3
    assert flown


async def lives(browser: Browser, order: orders.Order, meanwhile: Any = None) -> list[Life]:
    """The lives that the map shows of a flight, until it is over."""
    tab, shown = browser.tab, list[Life]()
    flight = tab.attempt(lambda: tab.ask(order))
    async with anyio.create_task_group() as group:
        group.start_soon(keep_alive, browser, flight)
        if meanwhile is not None:
            group.start_soon(meanwhile)
        while not shown or shown[-1] not in (Life.REFUSED, Life.DONE, Life.ENDED):
            await anyio.sleep(0.25)
            own = tab.shown_flight()
            if own is not None and (not shown or shown[-1] is not own.life):
                shown.append(own.life)
    return shown


def north_of(rig: Rig, metres: float) -> orders.FlyTo:
    place = rig.front.view.get(Position)
    assert place is not None
    frame = LocalFrame(place.latitude_deg, place.longitude_deg)
    return orders.FlyTo(*frame.to_geodetic(metres, 0.0), height=10.0, speed=5.0)


async def test_a_flight_to_a_point_is_accepted_flown_and_reached(rig: Rig) -> None:
    browser = await airborne(rig)
    number = browser.tab._count
    assert await lives(browser, north_of(rig, 40.0)) == [Life.ACCEPTED, Life.FLOWN, Life.DONE]
    assert browser.tab.flight is not None
    assert browser.tab.flight.number > number
    await keep_alive(browser, anyio.sleep(TOLD_S + 0.5))
    assert browser.tab.shown_flight() is None, "its end was shown"


@pytest.mark.parametrize(("dies", "within"), [("lost", 0.2), ("silent", 3.2)])
async def test_a_page_that_dies_ends_its_flight_to_a_point(
    rig: Rig, dies: str, within: float
) -> None:
    """A lost connection ends a lease at once, silence after 3 s; then the aircraft brakes and
    hovers, and authority goes back (explanation/safety.md of the manual)."""

    async def speed() -> float:
        before = rig.aircraft.position
        await anyio.sleep(0.1)
        return math.dist(rig.aircraft.position, before) / 0.1

    browser = await airborne(rig)
    async with anyio.create_task_group() as group:
        group.start_soon(browser.tab.attempt, lambda: browser.tab.ask(north_of(rig, 100.0)))
        await keep_alive(browser, anyio.sleep(3.5))
        assert await speed() == pytest.approx(5.0, abs=0.3)
        if dies == "lost":
            browser.tab.lost()
        await anyio.sleep(within)
        before = await speed()
        await anyio.sleep(0.2)
        assert await speed() < before - 0.3
        await anyio.sleep(3.0)
        assert await speed() < 0.1
        assert not rig.agent.holding.has_authority
    assert rig.aircraft.position[0] < 40.0


async def test_a_flight_that_is_refused_or_ended_says_by_what(rig: Rig) -> None:
    browser = await airborne(rig)
    assert await lives(browser, north_of(rig, 4000.0)) == [Life.REFUSED]
    assert "from the start" in browser.problem
    refused = browser.tab.shown_flight()
    assert refused is not None
    text = f"tab: order {refused.number}, flight to a place, was refused: "
    assert any(text in event.text for event in rig.front.events)

    async def stop() -> None:
        await anyio.sleep(4.0)
        await Browser(rig, "another").tab.stop()

    assert (await lives(browser, north_of(rig, 60.0), stop))[-2:] == [Life.FLOWN, Life.ENDED]
    assert browser.problem == "", "it hovers, and the map says why"
    own = browser.tab.shown_flight()
    assert own is not None
    assert "stop" in str(own.why)


async def test_a_flight_of_a_deaf_aircraft_or_without_news_is_not_called_flown(rig: Rig) -> None:
    browser = await airborne(rig)

    async def deafen() -> None:
        rig.aircraft.line.stall(to_host=False)

    found = await lives(browser, north_of(rig, 60.0), deafen)
    assert found == [Life.ACCEPTED, Life.ENDED]
    own = browser.tab.shown_flight()
    assert own is not None
    assert "control was lost" in str(own.why)


async def test_a_key_is_on_the_line_after_few_calls(rig: Rig) -> None:
    """From the message of the page to the frame: calls in m100link, outside the aircraft."""
    browser = await airborne(rig)
    await browser.hold(0.5, x=-4)
    browser.say("rest")
    await anyio.sleep(0.5)
    browser.say("alive")
    text = browser.message("beat", mode=1, x=-4, y=0, z=0, w=0)
    called: list[str] = []
    ours = str(Path(m100link.__file__).parent)

    def note(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        is_ours = name.startswith(ours) and f"{os.sep}sim{os.sep}" not in name
        if event == "call" and (is_ours or name == "<string>"):
            called.append(frame.f_code.co_name)

    sys.setprofile(note)
    try:
        answer = browser.tab.receive(text)
    finally:
        sys.setprofile(None)
    assert answer is not None
    assert answer["fate"] == Fate.SENT
    count = len(rig.moves)
    await anyio.lowlevel.checkpoint()
    await anyio.lowlevel.checkpoint()
    assert len(rig.moves) == count + 1
    assert len(called) <= 160, " ".join(called)
