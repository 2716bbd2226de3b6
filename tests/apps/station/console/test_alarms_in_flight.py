"""Each alarm, driven by what can go wrong with a virtual aircraft or with who flies it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack

import anyio
import pytest

from m100link.apps.agent import orders
from m100link.apps.agent.orders import ChangeHeight
from m100link.apps.station.console.view.alarms import ALARMS, AlarmName, AlarmState
from m100link.apps.station.console.view.situation import Inputs
from m100link.apps.station.console.view.texts import Translator
from m100link.apps.station.console.view.view_model import Memory
from m100link.sim.orders import perform
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, airborne
from tests.apps.station.console.view.test_header import plan_of

pytestmark = pytest.mark.anyio

N = AlarmName


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        aircraft = VirtualAircraft(seed=5, firmware="3.1")
        yield await stack.enter_async_context(Rig(aircraft).running())


class Operator:
    """A page in flight: it tells that it is there, and looks four times a second."""

    def __init__(self, rig: Rig, browser: Browser) -> None:
        self.rig, self.browser = rig, browser
        self.memory = Memory()

    def look(self) -> None:
        front, tab = self.rig.front, self.browser.tab
        self.memory.look(
            Inputs(
                vehicle=front.view,
                has_lease=tab.session.has_lease,
                lease_end=tab.session.lease_end,
                loss=tab.session.loss,
                plan=front.plan,
                events=tuple(front.events),
            )
        )

    async def watch(self, until: Callable[[], bool], within: float = 60.0) -> None:
        with anyio.fail_after(within):
            while True:
                self.browser.say("alive")
                self.look()
                if until():
                    return
                await anyio.sleep(0.25)

    @property
    def raised(self) -> dict[AlarmName, str]:
        """What is shown and not acknowledged, in words."""
        shown = self.memory.alarms.shown
        return {one.name: Translator()(one.text) for one in shown if one.state is AlarmState.RAISED}


def order(words: str) -> Callable[[Operator], Awaitable[object]]:
    async def give(operator: Operator) -> None:
        perform(operator.rig.aircraft, words)

    return give


async def somebody_takes_over(operator: Operator) -> None:
    other = Browser(operator.rig, "Anna").tab
    await other.session.confirm(await other.session.ask_take_over())


async def fly_up(operator: Operator) -> None:
    front, tab = operator.rig.front, operator.browser.tab
    work = tab.session.ask(ChangeHeight(47.0), lambda: None)
    front.background.spawn(tab.attempt(lambda: work), "guided")


async def fly_a_mission(operator: Operator) -> None:
    tab = operator.browser.tab
    await tab.session.ask(orders.UploadPlan.of(plan_of(operator.rig)))
    await tab.session.ask(orders.StartMission(tab.session.uploaded))
    await operator.watch(lambda: operator.rig.front.state.mission_index >= 0)


async def a_guard_ends_a_mission(operator: Operator) -> None:
    await fly_a_mission(operator)
    perform(operator.rig.aircraft, "battery 15")


async def the_position_jumps(operator: Operator) -> None:
    operator.rig.aircraft.vehicle.flight.dynamics.north += 1000.0


CAUSES: dict[AlarmName, tuple[Callable[[Operator], Awaitable[object]], str]] = {
    N.LINK_LOST: (order("unplug"), "link to the aircraft is lost"),
    N.LANDS_ITSELF: (order("battery 9"), "lands by itself"),
    N.BATTERY_CRITICAL: (order("battery 10"), "Battery 10 %: the aircraft is about to land"),
    N.LEASE_TAKEN: (somebody_takes_over, "Anna took control from you"),
    N.LINK_OLD: (order("stall on"), "The aircraft is silent"),
    N.NAVIGATION: (the_position_jumps, "The telemetry cannot be true"),
    N.BATTERY_FLOOR: (order("battery 19"), "the station does not steer"),
    N.GPS: (order("gps 2"), "GPS is weak"),
    N.AUTHORITY_LOST: (order("rc-mode P"), "The pilot took control with the mode switch"),
    N.MISSION_ABORTED: (a_guard_ends_a_mission, "Mission broken off"),
    N.GUARD_NEAR: (fly_up, "of 50 m"),
    N.BATTERY_LOW: (order("battery 25"), "Battery 25 %: land soon"),
}


@pytest.mark.parametrize("name", AlarmName)
async def test_each_alarm_is_raised_by_its_cause_and_sounds(rig: Rig, name: AlarmName) -> None:
    operator = Operator(rig, await airborne(rig))
    await operator.watch(lambda: True)
    assert operator.raised == {}
    cause, text = CAUSES[name]
    await cause(operator)
    await operator.watch(lambda: name in operator.raised)
    assert text in operator.raised[name]
    levels = {one.name: one.level for one in ALARMS}
    sounding = operator.memory.alarms.sounding
    assert sounding in {levels[one] for one in operator.raised}
    english = Translator()
    said = [line.said(english) for line in operator.memory.diary.lines if line.source == "page"]
    assert f"Alarm: {operator.raised[name]}" in said
    for one in list(operator.raised):
        operator.memory.acknowledge(one)
    assert operator.memory.alarms.sounding is None


@pytest.mark.parametrize(
    ("words", "also", "why"),
    [
        ("rc-mode P", N.AUTHORITY_LOST, "ended: the pilot moved the mode switch out of F"),
        ("app-takes-control", N.AUTHORITY_LOST, "ended: authority passed away"),
        ("rc-off", N.AUTHORITY_LOST, "ended: the remote control is not heard any more"),
        ("unplug", N.LINK_LOST, "sim:// went away; the aircraft may fly on"),
        ("stall on", N.LINK_LOST, "no telemetry for 1.0 s while flying; the aircraft may fly on"),
    ],
)
async def test_control_that_is_lost_in_a_mission_tells_of_the_mission_too(
    rig: Rig, words: str, also: AlarmName, why: str
) -> None:
    operator = Operator(rig, await airborne(rig))
    await fly_a_mission(operator)
    perform(rig.aircraft, words)
    await operator.watch(lambda: {also, N.MISSION_ABORTED} <= operator.raised.keys())
    assert why in operator.raised[N.MISSION_ABORTED]


@pytest.mark.parametrize("how", ["stop", "release", "mission_stop"])
async def test_a_mission_that_the_operator_ends_raises_no_alarm(rig: Rig, how: str) -> None:
    operator = Operator(rig, await airborne(rig))
    tab = operator.browser.tab
    await fly_a_mission(operator)
    ends: dict[str, Callable[[], Awaitable[object]]] = {
        "stop": tab.stop,
        "release": tab.session.give_back,
        "mission_stop": lambda: tab.session.ask(orders.StopMission()),
    }
    await ends[how]()
    until = rig.front.now + 5.0
    await operator.watch(lambda: rig.front.now > until)
    assert rig.front.state.mission == "no mission"
    assert operator.raised == {}
