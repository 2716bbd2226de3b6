"""The shell of the page: header, views, orders, STOP. A view consists of parts.

Header and dock are there in every view, at every size and above every dialog: who has control and
the values at the top; orders, views and STOP at the bottom, where a thumb is.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from starlette.responses import FileResponse, Response

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.config import Video
from m100link.apps.station.console.components.component import (
    Buttons,
    Component,
    PageContext,
    Wording,
    attribute,
)
from m100link.apps.station.console.components.data import (
    EventsPart,
    LinkPart,
    PlotsPart,
    TelemetryPart,
)
from m100link.apps.station.console.components.fly import (
    ChecklistPart,
    HudPart,
    PreparedPart,
    SticksPart,
    StripPart,
)
from m100link.apps.station.console.components.header import (
    AlarmsPart,
    FleetPart,
    ReplayPart,
    StatusPart,
)
from m100link.apps.station.console.components.map import MapPart
from m100link.apps.station.console.components.plan import PlanPart
from m100link.apps.station.console.components.settings import SettingsPart, load_settings
from m100link.apps.station.console.kept import PlotHistory
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.console.view.situation import Inputs, RecordedFlight, Ship
from m100link.apps.station.console.view.texts import for_browser
from m100link.apps.station.console.view.view_model import Memory, ViewModel, view_of
from m100link.apps.station.web.tiles import MapTiles

if TYPE_CHECKING:
    from m100link.sim.orders import SimulatorOrders

STATIC = Path(__file__).parent / "static"

UPDATE_INTERVAL = 0.25

_Make = Callable[[PageContext], Component]

VIEWS: dict[str, tuple[str, tuple[_Make, ...]]] = {
    "fly": ("flight", (PreparedPart, HudPart, SticksPart)),
    "plan": ("route", (PlanPart,)),
    "check": ("checklist", (ChecklistPart,)),
    "data": ("show_chart", (PlotsPart, TelemetryPart, LinkPart)),
    "events": ("list", (EventsPart,)),
    "settings": ("settings", (SettingsPart,)),
}
"""By name, ``page.view.<name>`` stands on its tab: its icon, and its parts in their order."""

_PATIENCE = 30.0  # seconds for a busy browser to return its stored secret
_MAP_VIEWS = ("fly", "plan")


class Page:
    def __init__(
        self,
        agent: AgentClient,  # the agent that owns the aircraft
        tab: Tab,  # who looks at it
        orders: SimulatorOrders | None,  # of the panel to a virtual aircraft, or None
        *,
        tiles: MapTiles,  # the pictures below the map
        video: Video | None = None,  # that is shown beside the map
        history_of: Callable[[str], PlotHistory],  # what was flown, by the name of an aircraft
        tabs: Tabs,  # who looks at this and at other aircraft
    ) -> None:
        self._agent, self._tab = agent, tab
        wording = Wording()
        self._context = PageContext(
            agent,
            tab,
            orders,
            Buttons(agent, tab, wording),
            Memory(),
            wording,
            ui.dark_mode(None),
            self._show,
            tiles,
            history_of,
            tabs,
            video,
        )
        self._sections: dict[str, ui.element] = {}
        self._header: list[Component] = []
        self._parts: dict[str, list[Component]] = {}  # of the views that were built

    async def build(self, key: str) -> None:
        """Build it in steps, between which everything else has its turn: keys, and STOP.

        ``key``: the secret part of the address of its socket.
        """
        ui.add_head_html(f'<link rel="stylesheet" href="/console/console.css">{_HEAD}')
        speaker = json.dumps(for_browser(self._context.wording.settings.speaker))
        ui.add_body_html(
            '<script type="module">'
            f'import {{choose}} from "/console/said.js"; choose({speaker});'
            f'import {{start}} from "/console/shell.js"; start({json.dumps(key)});</script>'
        )
        header: tuple[_Make, ...] = (FleetPart, StatusPart, AlarmsPart, ReplayPart)
        with ui.element("header").props("id=header"):
            await self._make(header, self._header)
        self._context.buttons.add("stop", "actions.stop", self._tab.stop, kind="stop")
        with ui.element("div").props("id=dock"):
            StripPart(self._context)
            self._build_bar()
        with ui.element("main").props("id=stage"):
            with ui.element("div").props("id=map-view"):
                self._map = MapPart(self._context)
            for name in VIEWS:
                section = ui.element("section").props(f"data-view={name}")
                self._context.wording.put(attribute(section), f"page.view.{name}")
                self._sections[name] = section
        await self._show("fly")
        ui.timer(0.0, self._go_on, once=True)
        ui.timer(UPDATE_INTERVAL, self._update)

    async def _make(self, makers: Iterable[_Make], parts: list[Component]) -> None:
        for make in makers:
            parts.append(make(self._context))
            await asyncio.sleep(0)

    async def _go_on(self) -> None:
        """Look and speak as it was chosen, and go on where the page was before a reload."""
        await load_settings(self._context)
        try:
            name = await ui.run_javascript("location.hash.slice(1)", timeout=_PATIENCE)
        except TimeoutError:
            return  # the page has gone, or hangs: it stays as it is
        if name in VIEWS:
            await self._show(name)

    def _build_bar(self) -> None:
        with ui.element("nav").props("id=bar") as bar:
            self._context.wording.put(attribute(bar), "page.views")
            for name, (icon, _) in VIEWS.items():
                tab = ui.element("button").props(f"type=button data-go={name}")
                with tab:
                    ui.icon(icon).props("aria-hidden=true")
                    self._context.wording.label(f"page.view.{name}")
                # The page shows the view by itself; here it is built, and kept up to date.
                tab.on("click", partial(self._show, name), args=[])

    async def _show(self, name: str) -> None:
        self._shown = name
        if name not in self._parts:
            parts = self._parts[name] = []
            with self._sections[name]:
                await self._make(VIEWS[name][1], parts)
        self._update()

    def _update(self) -> None:
        view = self._view()
        for part in (*self._header, *self._parts[self._shown]):
            part.update(view)
        if self._shown in _MAP_VIEWS:
            self._map.update(view)
        self._context.buttons.update(view.actions)

    def _fleet(self) -> tuple[Ship, ...]:
        tab = self._tab
        control = tab.kept | {tab.aircraft: tab.session}
        return tuple(
            Ship(
                name,
                agent.view,
                is_shown=name == tab.aircraft,
                is_ours=name in control and control[name].has_lease,
            )
            for name, agent in self._context.tabs.agents.items()
        )

    def _flight(self) -> RecordedFlight | None:
        """Of a replay: what its file says, once it was read, and where it is."""
        context, replay = self._context, self._agent.state.replay
        recorded = context.history.recorded
        if replay is None or recorded is None:
            return None
        is_compared = context.memory.compared in context.tabs.agents
        other = context.history_of(context.memory.compared).recorded if is_compared else None
        return RecordedFlight(
            recorded.story,
            recorded.at(replay.utc_at(self._agent.view.now)),
            None if other is None else other.story,
            is_whole=recorded.is_whole,
        )

    def _view(self) -> ViewModel:
        agent, tab, tabs = self._agent, self._tab, self._context.tabs
        is_data, flight, history = self._shown == "data", self._flight(), self._context.history
        path, at = (
            (history.path, history.newest) if flight is None else (flight.story.path, flight.at)
        )
        dropped = (*tabs.dropped().items(), *tabs.dropped_by_clients().items()) if is_data else ()
        return view_of(
            Inputs(
                vehicle=agent.view,
                has_lease=tab.session.has_lease,
                refusal=tab.refusal,
                plan=agent.plan,
                events=tuple(agent.events),
                airborne_s=path.airborne_s(at),
                flight=flight,
                flight_fault=history.fault,
                link=agent.link,
                front_lag=history.lag,
                page_trip=tab.way.round_trip,
                fleet=self._fleet(),
                dropped=dropped,
                lease_end=tab.session.lease_end,
                loss=tab.session.loss,
                wall=time.time(),
                is_virtual=self._context.orders is not None,
            ),
            self._context.memory,
        )


# -- what makes the console a program that can be installed ----------------------------------------
# A browser keeps one page of it, which says that the station is not reached, and nothing else: no
# telemetry, no answer of the station, no script of the console. Whatever shows a value was sent by
# a station that runs.

# With credentials: behind a token a client without the cookie gets nothing.
_HEAD = (
    '<link rel="manifest" href="/console/manifest.webmanifest" crossorigin="use-credentials">'
    '<link rel="icon" type="image/svg+xml" href="/console/icon.svg">'
    '<meta name="theme-color" content="#12202f">'
    '<meta name="mobile-web-app-capable" content="yes">'
    # The imports of shell.js, asked for with it and not after it.
    + "".join(
        f'<link rel="modulepreload" href="/console/{name}.js">'
        for name in (
            *("shell", "press", "orders", "said", "socket"),
            *("steer", "gamepad", "instruments", "map"),
        )
    )
    + "<script>navigator.serviceWorker?.register('/sw.js').catch(() => {})</script>"
)
"""The page's head. Beyond this machine workers need TLS; without, there is none."""


async def worker(request: object) -> Response:
    """The worker, from where it may stand before the whole console."""
    return FileResponse(
        STATIC / "sw.js", media_type="text/javascript", headers={"cache-control": "no-cache"}
    )
