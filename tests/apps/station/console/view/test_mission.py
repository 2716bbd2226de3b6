"""The mission of a tab: a plan from a file, four buttons, and how far it is."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import anyio
import pytest

from m100link.apps.agent.messages import Action
from m100link.apps.station.console.view.mission import progress, summary
from m100link.apps.station.console.view.units import Language, LengthUnit, SpeedUnit, Units
from m100link.apps.station.console.view.words import Speaker
from m100link.geodesy import LocalFrame
from m100link.missions.plan import WaypointPlan
from m100link.missions.waypoint import Waypoint
from m100link.sim.virtual import VirtualAircraft
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, airborne, keep_alive

pytestmark = pytest.mark.anyio

SAY = Speaker()


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        aircraft = VirtualAircraft(seed=5, firmware="3.1")
        yield await stack.enter_async_context(Rig(aircraft).running())


def plan_of(rig: Rig) -> WaypointPlan:
    settings = rig.aircraft.vehicle.settings
    frame = LocalFrame(settings.latitude_deg, settings.longitude_deg)
    places = [frame.to_geodetic(*place) for place in ((15.0, 0.0), (15.0, 15.0), (0.0, 15.0))]
    return WaypointPlan([Waypoint(*place, height=8) for place in places], speed=4)


@pytest.mark.parametrize("as_qgroundcontrol", [False, True])
async def test_a_plan_from_a_file_is_flown(rig: Rig, as_qgroundcontrol: bool) -> None:
    browser = await airborne(rig)
    plan = plan_of(rig)
    text = plan.to_qgroundcontrol() if as_qgroundcontrol else plan.to_json()
    tab = browser.tab
    assert await tab.attempt(lambda: tab.upload_plan(text.encode())), tab.problem
    assert SAY(summary(tab.plan)) == "3 waypoints, 30 m at 4.0 m/s, height 8 m to 8 m"
    assert await tab.attempt(lambda: tab.order_mission(Action.MISSION_START)), tab.problem

    async def see() -> list[str]:
        seen: list[str] = []
        while not seen or rig.front.state.mission != "no mission":
            what, part = progress(tab.plan, rig.front.state.mission, rig.front.state.mission_index)
            text = SAY(what)
            assert 0.0 <= part < 1.0
            if text not in seen:
                seen.append(text)
            await anyio.sleep(0.25)
        return seen

    seen: list[str] = []

    async def watch() -> None:
        await anyio.sleep(0.5)
        seen.extend(await see())

    await keep_alive(browser, watch())
    wanted = [f"waypoint mission: to waypoint {number} of 3" for number in (1, 2, 3)]
    assert [text for text in seen if text in wanted] == wanted
    assert rig.aircraft.position == pytest.approx((0.0, 15.0), abs=1.0)


async def test_pause_resume_and_stop(rig: Rig) -> None:
    browser = await airborne(rig)
    tab = browser.tab
    await tab.upload_plan(plan_of(rig).to_json().encode())
    await keep_alive(browser, tab.order_mission(Action.MISSION_START))
    for action in (Action.MISSION_PAUSE, Action.MISSION_RESUME, Action.MISSION_STOP):
        await keep_alive(browser, anyio.sleep(1.5))
        assert await tab.attempt(lambda one=action: tab.order_mission(one)), tab.problem  # type: ignore[misc]
    await keep_alive(browser, anyio.sleep(1.0))
    assert rig.front.state.mission == "no mission"


async def test_what_is_not_a_plan_or_comes_from_somebody_without_control(rig: Rig) -> None:
    browser = await airborne(rig)
    assert not await browser.tab.attempt(lambda: browser.tab.upload_plan(b"\xff{"))
    assert browser.tab.plan is None
    other = Browser(rig, "other").tab
    content = plan_of(rig).to_json().encode()
    assert not await other.attempt(lambda: other.upload_plan(content))
    assert "tab has control" in other.problem
    assert not await other.attempt(lambda: other.order_mission(Action.MISSION_START))


@pytest.mark.parametrize(
    ("mission", "index", "said"),
    [
        ("", -1, "nothing is known of missions"),
        ("no mission", -1, "no mission"),
        ("hotpoint", -1, "circle around a point"),
        ("of another kind", -1, "program of another kind"),
        ("waypoint mission", 4, "waypoint mission: to waypoint 5"),
    ],
)
def test_how_far_it_is_without_a_plan(mission: str, index: int, said: str) -> None:
    what, part = progress(None, mission, index)
    assert (SAY(what), part) == (said, 0.0)


def test_a_plan_in_one_line_in_the_units_that_were_chosen() -> None:
    assert SAY(summary(None)) == "no plan"
    plan = WaypointPlan([Waypoint(52.1, 4.31, height=20), Waypoint(52.101, 4.31, height=30)])
    german = Speaker(Language.GERMAN, Units(LengthUnit.FOOT, SpeedUnit.KNOT))
    assert german(summary(plan)) == "2 Wegpunkte, 367 ft mit 9,7 kn, Höhe 66 ft bis 98 ft"
