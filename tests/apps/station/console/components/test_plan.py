"""Cards of the map: what they start, choose and press; the rest is seen in a browser."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest

pytest.importorskip("nicegui")

from m100link.apps.agent import orders
from m100link.apps.station.console.components import plan as part_of_page
from m100link.apps.station.console.components.map import _SHOWN, ClickPart
from m100link.apps.station.console.components.plan import PlanPart
from m100link.apps.station.console.view.map import GuidedKind, Pointed
from m100link.apps.station.console.view.plan import Checked, DraftHistory
from tests.apps.station.conftest import Rig
from tests.apps.station.console.test_tab import Browser, airborne, keep_alive
from tests.apps.station.console.view.test_header import newer, plan_of

__all__ = ["newer"]

pytestmark = pytest.mark.anyio

Work = Callable[[], Awaitable[Any]]


def buttons_of(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> dict[str, Work]:
    """What the buttons of its card do, by their orders."""
    monkeypatch.setattr(part_of_page, "ui", MagicMock())
    works: dict[str, Work] = {}
    buttons = SimpleNamespace(add=lambda name, key, work: works.__setitem__(name, work))
    part = object.__new__(PlanPart)
    page = SimpleNamespace(
        tab=browser.tab,
        buttons=buttons,
        wording=MagicMock(),
        agent=browser.rig.front,
        memory=SimpleNamespace(situation=SimpleNamespace(is_on_ground=False)),
    )
    part._page, part._found = cast(Any, page), Checked(None, (), None)
    part._build_mission()
    return works


async def test_start_flies_what_was_uploaded_here_and_not_what_came_in_between(
    newer: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = await airborne(newer)
    tab, start = browser.tab, buttons_of(browser, monkeypatch)["mission_start"]
    mine = orders.UploadPlan.of(plan_of(newer))
    others = orders.UploadPlan.of(replace(plan_of(newer), speed=9.0))
    assert not await tab.attempt(start)
    assert "no plan was uploaded" in browser.problem
    lease = tab.session.lease
    assert lease is not None
    other = Browser(newer, "other").tab
    other.session.adopt(lease)  # another front of the same pilot
    for uploads in ([others], [mine, others]):
        for upload in uploads:
            await (tab if upload is mine else other).session.ask(upload)
        assert not await tab.attempt(start)
        assert "not the one on board; nothing was started" in browser.problem
        assert "upload it again" in browser.problem
    assert newer.front.state.mission in ("", "no mission")
    await tab.session.ask(mine)
    assert await tab.attempt(start), browser.problem
    assert newer.front.plan == mine.plan()
    await keep_alive(browser, newer.until(lambda: newer.front.state.mission_index >= 0))


@pytest.mark.parametrize(
    ("chosen", "points", "after"), [(1, 2, 1), (1, 1, None), (0, 0, None), (None, 3, None)]
)
def test_a_point_that_is_there_no_more_is_not_chosen(
    chosen: int | None, points: int, after: int | None
) -> None:
    part: Any = object.__new__(PlanPart)
    part._show, part._problem, part._chosen = MagicMock(), MagicMock(), chosen
    part._go(SimpleNamespace(draft=SimpleNamespace(points=(None,) * points)))
    assert part._chosen is after
    part._show.assert_called_once_with()


async def test_of_a_file_that_is_opened_no_point_is_chosen(
    newer: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_of_page, "_run", MagicMock())
    part: Any = object.__new__(PlanPart)
    part._show, part._problem, part._chosen = MagicMock(), MagicMock(), 1
    part._history = DraftHistory()
    part._opened(SimpleNamespace(args={"text": plan_of(newer).to_json()}))
    assert len(part._history.draft.points) > 1
    assert part._chosen is None


# -- the card of a point on the map --------------------------------------------------------------


@pytest.mark.parametrize("kind", GuidedKind)
def test_the_kind_that_was_chosen_is_pressed_and_its_fields_are_shown(kind: GuidedKind) -> None:
    part: Any = object.__new__(ClickPart)
    part._pointed = Pointed()
    names = {name for shown in _SHOWN.values() for name in shown}
    part._kinds = {one: MagicMock() for one in GuidedKind}
    part._fields = {name: MagicMock() for name in names}
    part._kind(kind)
    for one, choice in part._kinds.items():
        choice.props.assert_called_once_with(f"aria-pressed={str(one is kind).lower()}")
    for name, field in part._fields.items():
        field.set_visibility.assert_called_once_with(name in _SHOWN[kind])
    assert part._pointed.kind is kind
