"""The shell of the page: header, views, STOP. What stands in a view is a part.

Header and bottom bar are there at every size and above every dialog: the status line at the top,
the views and STOP at the bottom, where a thumb is.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial

from nicegui import ui

from m100link.apps.agent.client import AgentClient
from m100link.apps.station.console import installable
from m100link.apps.station.console.history import History
from m100link.apps.station.console.orders import Orders
from m100link.apps.station.console.parts.alarms import AlarmsPart
from m100link.apps.station.console.parts.buttons import Buttons
from m100link.apps.station.console.parts.checklist import ChecklistPart
from m100link.apps.station.console.parts.events import EventsPart
from m100link.apps.station.console.parts.fleet import FleetPart
from m100link.apps.station.console.parts.fly import Fly
from m100link.apps.station.console.parts.link import LinkPart
from m100link.apps.station.console.parts.map import MapPart
from m100link.apps.station.console.parts.part import Deck, Part
from m100link.apps.station.console.parts.plan import PlanPart
from m100link.apps.station.console.parts.plots import PlotsPart
from m100link.apps.station.console.parts.replay import ReplayPart
from m100link.apps.station.console.parts.settings import SettingsPart, load_settings
from m100link.apps.station.console.parts.status import StatusPart
from m100link.apps.station.console.parts.telemetry import TelemetryPart
from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.tabs import Tabs
from m100link.apps.station.console.view.inputs import Inputs, Ship
from m100link.apps.station.console.view.memory import Memory
from m100link.apps.station.console.view.view import View, view_of
from m100link.apps.station.console.view.words import for_browser

__all__ = ["VIEWS", "Page"]

UPDATE_INTERVAL = 0.25

VIEWS: dict[str, tuple[str, tuple[Callable[[Deck], Part], ...]]] = {
    "fly": ("flight", (Fly,)),
    "plan": ("route", (PlanPart,)),
    "check": ("checklist", (ChecklistPart,)),
    "data": ("show_chart", (PlotsPart, TelemetryPart, LinkPart)),
    "events": ("list", (EventsPart,)),
    "settings": ("settings", (SettingsPart,)),
}
"""By name, ``page.view.<name>`` stands on its tab: its icon, and its parts in their order."""

_PATIENCE = 30.0  # seconds that a busy browser has to say what it kept
_SHELL = 'import("/console/shell.js").then(({m100}) => '
_MAP_VIEWS = ("fly", "plan")


class Page:
    """One tab's page.

    Args:
        agent: The agent that owns the aircraft.
        tab: Who looks at it.
        orders: What the panel does to a virtual aircraft, or None.
        has_tiles: Whether there are map tiles.
        history: The last minutes of every number.
        tabs: Who looks at this and at other aircraft.
    """

    def __init__(
        self,
        agent: AgentClient,
        tab: Tab,
        orders: Orders | None,
        *,
        has_tiles: bool,
        history: History,
        tabs: Tabs,
    ) -> None:
        self._agent, self._tab = agent, tab
        wording = Wording()
        self._deck = Deck(
            agent,
            tab,
            orders,
            Buttons(agent, tab, wording),
            Memory(),
            wording,
            ui.dark_mode(None),
            self._show,
            has_tiles,
            history,
            tabs,
        )
        self._header: tuple[Part, ...] = (
            FleetPart(self._deck),
            StatusPart(self._deck),
            AlarmsPart(self._deck),
            ReplayPart(self._deck),
        )
        self._map = MapPart(self._deck)
        self._sections: dict[str, ui.element] = {}
        self._parts: dict[str, list[Part]] = {}  # of the views that were built
        self._shown = "fly"

    def build(self, key: str) -> None:
        """Lay the page out and start its updates."""
        ui.add_head_html(f'<link rel="stylesheet" href="/console/console.css">{installable.HEAD}')
        told = json.dumps(for_browser(self._deck.wording.settings.speaker))
        ui.add_body_html(
            '<script type="module">'
            f'import {{choose}} from "/console/said.js"; choose({told});'
            f'import {{start}} from "/console/shell.js"; start({json.dumps(key)});</script>'
        )
        with ui.element("header").props("id=header"):
            for part in self._header:
                part.build()
        self._deck.buttons.add("stop", "actions.stop", self._tab.stop, kind="stop")
        self._build_bar()
        with ui.element("main").props("id=stage"):
            with ui.element("div").props("id=map-view"):
                self._map.build()
            for name in VIEWS:
                section = ui.element("section").props(f"data-view={name}")
                self._deck.wording.put(attribute(section), f"page.view.{name}")
                self._sections[name] = section
        self._show("fly")
        ui.timer(0.0, self._go_on, once=True)
        ui.timer(UPDATE_INTERVAL, self._update)

    async def _go_on(self) -> None:
        """Look and speak as it was chosen, and go on where the page was before a reload."""
        await load_settings(self._deck)
        deck, tab = self._deck, self._tab
        try:
            name, secret = await ui.run_javascript(_SHELL + "m100.kept())", timeout=_PATIENCE)
        except TimeoutError:
            return  # the page has gone, or hangs: it stays as it is
        looks = deck.tabs.looks
        tab.person = looks.person(secret)
        ui.run_javascript(f"{_SHELL}m100.keep({json.dumps(tab.person)}))")
        said_at = looks.said_at(tab.person, tab.aircraft, self._agent, deck.history)
        if said_at is not None:
            deck.memory.checklist.say_free(said_at, is_free=True)
        if name in VIEWS:
            self._show(name)

    def _build_bar(self) -> None:
        put = self._deck.wording.put
        with ui.element("nav").props("id=bar") as bar:
            put(attribute(bar), "page.views")
            for name, (icon, _) in VIEWS.items():
                tab = ui.element("button").props(f"type=button data-go={name}")
                with tab:
                    ui.icon(icon).props("aria-hidden=true")
                    put(ui.label().set_text, f"page.view.{name}")
                # The page shows the view by itself; here it is built, and kept up to date.
                tab.on("click", partial(self._show, name), args=[])

    def _show(self, name: str) -> None:
        self._shown = name
        if name not in self._parts:
            with self._sections[name]:
                self._parts[name] = [make(self._deck) for make in VIEWS[name][1]]
                for part in self._parts[name]:
                    part.build()
        self._update()

    def _update(self) -> None:
        view = self._view()
        for part in (*self._header, *self._parts[self._shown]):
            part.update(view)
        if self._shown in _MAP_VIEWS:
            self._map.update(view)
        self._deck.buttons.update(view.actions)

    def _fleet(self) -> tuple[Ship, ...]:
        tab = self._tab
        return tuple(
            Ship(
                name,
                agent.state,
                agent.holder,
                agent.telemetry,
                is_heard=not agent.is_silent and not agent.is_gone,
                is_shown=name == tab.aircraft,
                is_ours=tab.has_lease if name == tab.aircraft else name in tab.kept,
            )
            for name, agent in self._deck.tabs.agents.items()
        )

    def _dropped(self) -> tuple[tuple[str, int], ...]:
        tabs = self._deck.tabs
        return (*tabs.dropped().items(), *tabs.dropped_by_clients().items())

    def _view(self) -> View:
        agent, tab = self._agent, self._tab
        now = agent.state.flight_time(agent.now)  # of a replay: that of then
        return view_of(
            Inputs(
                now=now,
                state=agent.state,
                holder=agent.holder,
                telemetry=agent.telemetry,
                is_silent=agent.is_silent,
                is_gone=agent.is_gone,
                has_lease=tab.has_lease,
                refusal=tab.refusal,
                plan=agent.plan,
                events=tuple(agent.events),
                link=agent.link,
                front_lag=self._deck.history.lag,
                page_trip=tab.round_trip,
                fleet=self._fleet(),
                dropped=self._dropped() if self._shown == "data" else (),
                lease_end=tab.lease_end,
                loss=tab.loss,
                heard_at=now - (agent.now - agent.heard_at),
                wall=time.time(),
                is_virtual=self._deck.orders is not None,
            ),
            self._deck.memory,
        )
