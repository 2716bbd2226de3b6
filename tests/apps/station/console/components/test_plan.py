"""The Plan view starts what its operator uploaded; the rest of it is seen in a browser."""

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
from m100link.apps.station.console.components.plan import PlanPart
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
    page = SimpleNamespace(tab=browser.tab, buttons=buttons, wording=MagicMock())
    part._page = cast(Any, page)
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
