"""Texts of a page follow its language, each component stands on it, and it takes off."""

from __future__ import annotations

import ast
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast

import pytest

from m100link.apps.agent.orders import ChangeHeight, Order
from m100link.apps.station.console.components import component
from m100link.apps.station.console.components.component import PageContext, Wording
from m100link.apps.station.console.view.situation import Inputs
from m100link.apps.station.console.view.texts import (
    DisplaySettings,
    Language,
    LengthUnit,
    Quantity,
    tr,
)
from m100link.apps.station.console.view.view_model import Memory, ViewModel
from m100link.errors import GuardRefused, M100Error, UsageError
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, keep_alive

pytestmark = pytest.mark.anyio


def test_what_stands_on_the_page_follows_the_settings() -> None:
    wording, shown = Wording(), [""]
    wording.put(lambda text: shown.__setitem__(0, text), "actions.land")
    assert shown == ["Land (hold)"]
    wording.choose(DisplaySettings(language=Language.GERMAN))
    assert shown == ["Landen (halten)"]
    wording.choose(DisplaySettings())
    assert shown == ["Land (hold)"]


def test_what_is_said_once_is_said_as_it_was_chosen() -> None:
    wording = Wording()
    near = tr("alarms.guard_near.height", value=Quantity.length(40), limit=Quantity.length(50))
    wording.choose(replace(wording.settings, length=LengthUnit.FOOT))
    assert wording(near) == "Near the limit: height 131 ft of 164 ft"


# -- each part of the page is on it ----------------------------------------------------------------

PLACE = Path(component.__file__).parent
PROGRAMS = {
    str(path.relative_to(PLACE.parent)): ast.parse(path.read_text("utf-8"))
    for path in (*PLACE.glob("*.py"), PLACE.parent / "page.py")
}


def test_each_component_has_a_place_on_the_page() -> None:
    """One that is written and stands in no view would be missed by nobody."""
    made = {
        node.name: path
        for path, program in PROGRAMS.items()
        for node in ast.walk(program)
        if isinstance(node, ast.ClassDef)
        and any(
            isinstance(one, ast.FunctionDef)
            and [arg.arg for arg in one.args.args] == ["self", "view"]
            for one in node.body
        )
    }
    assert made.pop("Component", None)
    assert len(made) > 8
    used = {
        node.id
        for program in PROGRAMS.values()
        for node in ast.walk(program)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
    }
    homeless = {name: path for name, path in made.items() if name not in used}
    assert not homeless, f"VIEWS of console/page.py has no {homeless}"


def test_components_show_each_value_of_the_view_and_no_other() -> None:
    shown = {
        node.attr
        for program in PROGRAMS.values()
        for node in ast.walk(program)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "view"
    }
    values = {one.name for one in fields(ViewModel)}
    assert shown <= values, f"View of console/view/view.py has no {sorted(shown - values)}"
    unshown = values - shown
    assert not unshown, f"no component shows {sorted(unshown)} of View"


# -- taking off to a height ------------------------------------------------------------------------


async def ready(rig: Rig, height: float) -> tuple[Browser, PageContext]:
    """A page that has control of an aircraft on the ground, and a reason to take off."""
    browser, memory = Browser(rig), Memory()
    await browser.tab.session.obtain()
    memory.checklist.say_why("a test")
    memory.checklist.height = height
    memory.look(Inputs(vehicle=rig.front.view, has_lease=True))
    none = cast(Any, None)
    rest = none, memory, none, none, none, none, none, none
    return browser, PageContext(rig.front, browser.tab, None, *rest)


@pytest.mark.parametrize("height", [1.2, 8.0])
async def test_it_takes_off_and_climbs_to_the_chosen_height(rig: Rig, height: float) -> None:
    browser, page = await ready(rig, height)
    await keep_alive(browser, page.take_off())
    assert rig.aircraft.height == pytest.approx(height, abs=0.5)


async def test_a_stop_while_it_takes_off_ends_the_climb_too(rig: Rig) -> None:
    browser, page = await ready(rig, 8.0)
    work = rig.front.background.spawn(page.take_off(), "take-off")
    await keep_alive(browser, rig.until(lambda: rig.aircraft.height > 0.5))
    await browser.tab.stop()
    await keep_alive(browser, rig.until(work.done))
    with pytest.raises(M100Error):
        work.result()
    assert rig.front.state.guided is None
    assert rig.aircraft.height < 2.0


async def test_a_stop_between_take_off_and_climb_ends_the_climb(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The take-off is over, and the order to climb is not yet given."""
    browser, page = await ready(rig, 8.0)
    session = browser.tab.session
    ask = session.ask

    async def stop_first(order: Order, accepted: Any) -> Any:
        if isinstance(order, ChangeHeight):
            await browser.tab.stop()
        return await ask(order, accepted)

    monkeypatch.setattr(session, "ask", stop_first)
    work = rig.front.background.spawn(page.take_off(), "take-off")
    await keep_alive(browser, rig.until(work.done))
    with pytest.raises(GuardRefused, match="STOP was pressed after"):
        work.result()
    assert rig.aircraft.height < 2.0


async def test_beyond_the_limits_it_stays_on_the_ground(rig: Rig) -> None:
    _, page = await ready(rig, 51.0)
    with pytest.raises(UsageError, match="the limit is 50 m"):
        await page.take_off()
    assert rig.aircraft.height == pytest.approx(0.0, abs=0.1)
