"""A page is built while others fly."""

from __future__ import annotations

import asyncio
import json
import re
from itertools import pairwise

import pytest

pytest.importorskip("nicegui", reason="the extra `station` is not installed")
from nicegui import Client, core, ui

from m100link.apps.station.console.kept import PlotHistory
from m100link.apps.station.console.page import Page, worker
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.console.view.texts import DisplaySettings, for_browser
from m100link.apps.station.web.tiles import MapTiles
from tests.apps.station.conftest import Rig

pytestmark = pytest.mark.anyio


async def test_a_page_is_built_in_steps_between_which_everything_else_has_its_turn(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(core, "loop", asyncio.get_running_loop())
    tabs = Tabs({"": rig.front})
    _, tab = tabs.open()
    client = Client(ui.page("/"), request=None)
    built: list[int] = []

    async def others() -> None:
        while True:
            built.append(len(client.elements))
            await asyncio.sleep(0)

    watching = asyncio.create_task(others())
    with client:
        page = Page(
            rig.front, tab, None, tiles=MapTiles(), history_of=lambda _: PlotHistory(), tabs=tabs
        )
        await page.build('a "key"')
    watching.cancel()
    steps = [after - before for before, after in pairwise(built)]
    assert sum(steps) > 200
    assert max(steps) < 0.4 * sum(steps)
    # What the shell gets: the secret of its own socket, and who speaks; both as JavaScript.
    body = client.body_html
    assert re.findall(r"start\((.*?)\);<", body) == [r'"a \"key\""']
    assert [json.loads(one) for one in re.findall(r"choose\((.*?)\);import", body)] == [
        for_browser(DisplaySettings().speaker)
    ]
    client.delete()
    assert vars(await worker(None))["path"].name == "sw.js"
