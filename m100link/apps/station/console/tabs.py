"""The tabs that are open, and their sockets: beats in, instruments out."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from urllib.parse import urlencode

from starlette.status import WS_1008_POLICY_VIOLATION
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.control_session import RENEWAL_S, ControlSession
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.view.fly import live, seen_from_afar
from m100link.apps.station.web.limits import to_evict
from m100link.apps.station.web.protocol import WebSocketConnection, frames_of, until_one_ends

LIVE_INTERVAL = 0.05  # seconds between two updates of the instruments
WATCHED = 100  # of these, over which the average tells a slow computer from a moment's work
OTHERS_INTERVAL = 0.5  # seconds between two places of the aircraft that the page does not show

MOVE_PATIENCE = 8.0
"""Seconds for which control goes along to the page of another aircraft; then it is given back."""
UNHEARD_INTERVAL = 0.25
"""Seconds between two words that the station is there while the agent is not heard."""

PLACES = 32  # tabs that may have a socket


@dataclass(slots=True, eq=False)
class _Place:
    """A tab with its socket, as the allocation of places sees it."""

    tab: Tab
    peer: str  # address that it comes from
    heard_at: float  # when it last said anything; when it came, if it never did
    leaving: asyncio.Event  # set when another one gets the place
    has_spoken: bool = False  # whether it ever said anything
    subscribes: bool = True  # whether it gets anything: every tab does


@dataclass(slots=True)
class _Move:
    """An operator between the pages of two aircraft."""

    name: str  # who it is
    kept: dict[str, ControlSession]  # control that goes along, by the names of the aircraft
    tab: Tab | None = None  # the page of the other aircraft, once it was asked for

    def sessions(self) -> list[ControlSession]:
        return [*self.kept.values(), *([] if self.tab is None else [self.tab.session])]


class Tabs:
    """The tabs that are open, by the secret part of their socket's address."""

    def __init__(
        self,
        # The agent that owns an aircraft, by its name; more may come.
        agents: Mapping[str, AgentClient],
        # Messages that the station's other clients did not get, by their names.
        dropped_by_clients: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        self.agents = agents
        self.dropped_by_clients = dropped_by_clients
        self._agent = next(iter(agents.values()))  # the clock of all of them
        self._count = 0
        self._moves: dict[str, _Move] = {}  # by their codes
        self.tabs: dict[str, Tab] = {}  # those that are open
        self._places: dict[str, _Place] = {}
        self._slept = LIVE_INTERVAL  # between two updates, on average, s; nan once it was too long

    def open(self, aircraft: str = "", moved: str = "") -> tuple[str, Tab]:
        if aircraft not in self.agents:
            aircraft = next(iter(self.agents))
        self._count += 1
        key = secrets.token_urlsafe(16)
        move = self._moves.pop(moved, None) or _Move(f"console {self._count}", {})
        tab = move.tab = Tab(self.agents[aircraft], move.name, aircraft, move.kept)
        self.tabs[key] = tab
        return key, tab

    def move(self, tab: Tab, to: str) -> str:
        """The operator of a tab turns to another aircraft; returns the address of its page.

        A movement steered here stops and hovers, now and not when the page has gone. A mission or a
        task that the aircraft flies by itself goes on. Control of this aircraft is kept, if there
        was any, and given back when the other page is not there within :data:`MOVE_PATIENCE`.
        """
        agent, name = tab.agent, tab.session.name
        if lease := tab.session.lease:
            flies = agent.state.task or agent.state.mission not in ("", "no mission")
            if not flies:
                agent.hover(f"{name} turned to {to}", lease)
            agent.note(
                f"{name} turned to {to} and keeps control: "
                + ("the mission or task that it flies goes on" if flies else "it hovers")
            )
        code = secrets.token_urlsafe(16)
        move = self._moves[code] = _Move(name, tab.hand_on())
        self._agent.background.spawn(self._keep_until_heard(code, move), "move")
        return f"/?{urlencode({'aircraft': to, 'moved': code})}"

    async def _keep_until_heard(self, code: str, move: _Move) -> None:
        """Keep control until the page that it goes to says something, and not for longer than that.

        A page that was asked for and says nothing loses it when the leases run out.
        """
        until = self._agent.now + MOVE_PATIENCE
        while self._agent.now < until and not (move.tab is not None and move.tab.has_spoken):
            for session in move.sessions():
                session.heard()
            await asyncio.sleep(RENEWAL_S)
        if self._moves.pop(code, None) is not None:
            for session in move.sessions():
                session.close()

    def close(self, key: str) -> None:
        tab = self.tabs.pop(key, None)
        if tab is not None:
            tab.close()

    def shown(self) -> frozenset[str]:
        return frozenset(tab.aircraft for tab in self.tabs.values())

    def dropped(self) -> dict[str, int]:
        """Pictures that tabs did not get, by name; those of the same name together."""
        counts: dict[str, int] = {}
        for place in self._places.values():
            name = place.tab.session.name
            counts[name] = counts.get(name, 0) + place.tab.dropped
        return counts

    async def serve(self, websocket: WebSocket) -> None:
        """The socket of a tab, until either end leaves."""
        key = websocket.path_params["key"]
        peer = websocket.client.host if websocket.client else ""
        tab = self.tabs.get(key)
        if tab is None or key in self._places or not self._make_room(peer):
            await websocket.close(WS_1008_POLICY_VIOLATION)
            return
        place = self._places[key] = _Place(tab, peer, self._agent.now, asyncio.Event())
        try:
            await websocket.accept()
            connection: WebSocketConnection = websocket.scope["state"]["connection"]
            connection.is_steering = lambda: tab.session.has_lease
            await self._talk(websocket, place)
        except WebSocketDisconnect:
            pass
        finally:
            tab.lost()
            if self._places.get(key) is place:
                del self._places[key]

    def _make_room(self, peer: str) -> bool:
        """Whether one more may come, for which another may have to go.

        The tab that steers needs no place, and loses none.
        """
        others = [one for one in self._places.values() if not one.tab.session.has_lease]
        if len(others) < PLACES:
            return True
        goes = to_evict(others, peer, self._agent.now)
        if goes is None:
            return False
        goes.leaving.set()
        self._places = {key: one for key, one in self._places.items() if one is not goes}
        return True

    async def _talk(self, websocket: WebSocket, place: _Place) -> None:
        await until_one_ends(
            self._read(websocket, place),
            self._write(websocket, place.tab),
            place.leaving.wait(),
            at_once=place.tab.lost,  # motion stops
        )
        if place.leaving.is_set() and websocket.client_state is WebSocketState.CONNECTED:
            await websocket.close(WS_1008_POLICY_VIOLATION, "another tab needs the place")

    def _watch(self, agent: AgentClient, slept: float) -> None:
        """Report once that pages get half of their updates: nothing else would show it."""
        # One long stop, as of a suspended process, shows nothing about the computer.
        self._slept += (min(slept, 4 * LIVE_INTERVAL) - self._slept) / WATCHED
        if self._slept > 2 * LIVE_INTERVAL:
            agent.note(
                "this computer is too busy: pages get less than half of their 20 updates a second. "
                "Close tabs and other programs: m100link docs on-board",
                "warning",
            )
            self._slept = math.nan

    async def _read(self, websocket: WebSocket, place: _Place) -> None:
        connection: WebSocketConnection = websocket.scope["state"]["connection"]
        async for frame in frames_of(websocket):
            place.heard_at, place.has_spoken = self._agent.now, True
            answer, hearing = place.tab.receive(frame), place.tab.agent.view.hearing
            # STOP waits behind no answer that a slow way to the page holds up.
            if answer is not None and hearing is Hearing.HEARD and connection.writable.is_set():
                await websocket.send_json(answer)

    async def _write(self, websocket: WebSocket, tab: Tab) -> None:
        agent = tab.agent
        others_at = agent.now
        with contextlib.suppress(WebSocketDisconnect):
            while True:
                # A page that hears nothing shows everything as old.
                if agent.view.hearing is Hearing.HEARD:
                    message = live(agent.view)
                    if len(self.agents) > 1 and agent.now >= others_at:
                        others_at = agent.now + OTHERS_INTERVAL
                        message["others"] = [
                            seen_from_afar(name, one.view)
                            for name, one in self.agents.items()
                            if name != tab.aircraft
                        ]
                    began_at = agent.now
                    await websocket.send_json(message)  # waits for a page that takes nothing
                    tab.dropped += int((agent.now - began_at) / LIVE_INTERVAL)
                    began_at = agent.now
                    await asyncio.sleep(LIVE_INTERVAL)
                    self._watch(agent, agent.now - began_at)
                else:
                    # Else the page could not tell a silent agent from a silent station.
                    await websocket.send_json({"op": "unheard"})
                    await asyncio.sleep(UNHEARD_INTERVAL)
