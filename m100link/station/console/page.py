"""The page of the console: what stands where, and what a click does."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from m100link.agent.client import AgentClient
from m100link.agent.lease import LeaseHeld
from m100link.errors import M100Error
from m100link.protocol.codes import ActivationCode
from m100link.protocol.commands.control import Task
from m100link.protocol.records import Attitude
from m100link.station.console.fields import FIELDS, read
from m100link.station.console.mission import MissionCard
from m100link.station.console.orders import Orders
from m100link.station.console.simpanel import sim_panel
from m100link.station.console.tab import Tab

__all__ = ["Page"]

UPDATE_INTERVAL = 0.25
_CHANNELS = ("roll", "pitch", "yaw", "throttle")
_PAD = """
<div class="stick" aria-label="stick"></div>
<div>
  <div class="idle">click here, then hold keys to fly</div>
  <div><b>W A S D</b> move, <b>Q E</b> turn, <b>Z C</b> climb and sink, <b>Esc</b> leaves</div>
  <div><b>1–6</b> speed: <b data-level>1</b>, <b>8 9</b> mode: <b data-mode>1</b></div>
  <div>gamepad: hold a shoulder button</div>
</div>
"""


class Page:
    """One tab's page.

    Args:
        agent: The agent that owns the aircraft.
        tab: Who looks at it.
        orders: What the panel does to a virtual aircraft, or None.
    """

    def __init__(self, agent: AgentClient, tab: Tab, orders: Orders | None) -> None:
        self._agent, self._tab, self._orders = agent, tab, orders
        self._fields: dict[str, tuple[Any, Any, Any]] = {}
        self._numbers: dict[str, Any] = {}
        self._buttons: dict[str, Any] = {}
        self._last_event = 0
        self._mission = MissionCard(agent, tab)

    def build(self, key: str, *, has_tiles: bool) -> None:
        """Lay the page out and start its updates."""
        ui.add_head_html(
            '<link rel="stylesheet" href="/console/console.css">'
            '<script src="/console/console.js"></script>'
        )
        ui.add_body_html(
            f"<script>startConsole({json.dumps(key)}, {json.dumps(has_tiles)})</script>"
        )
        with ui.column().classes("w-full gap-2 p-2"):
            with ui.column().classes("top w-full gap-2"):
                self._build_top()
            with ui.row().classes("w-full gap-2 items-start no-wrap max-lg:flex-wrap"):
                with ui.column().classes("w-80 shrink-0 gap-2"):
                    self._build_fields()
                    self._build_link()
                with ui.column().classes("grow gap-2 min-w-0"):
                    self._build_attitude()
                    self._build_steering()
                    self._build_track()
                with ui.column().classes("w-96 shrink-0 gap-2"):
                    self._build_channels()
                    with _card("Mission"):
                        self._mission.build(self._mission_button)
                    if self._orders is not None:
                        with _card("Virtual aircraft"):
                            sim_panel(self._orders)
                    self._build_events()
        ui.timer(UPDATE_INTERVAL, self._update)

    # -- layout ----------------------------------------------------------------------------------

    def _build_top(self) -> None:
        tab = self._tab
        with ui.row().classes("w-full items-center gap-2"):
            self._banner = ui.label().classes("banner grow").props("id=banner")
            name = ui.input("your name", value=tab.name).props("dense id=name").classes("w-40")
            name.on_value_change(lambda event: setattr(tab, "name", str(event.value)[:64]))
            self._button("stop", "STOP", tab.stop, kind="stop")
        with ui.row().classes("w-full items-center gap-2"):
            self._button("activate", "Activate", tab.activate, kind="plain")
            self._button("obtain", "Obtain control", self._obtain)
            self._button("release", "Release control", tab.release, kind="plain")
            self._button("take_off", "Take off (hold)", lambda: tab.fly(Task.TAKE_OFF), hold=True)
            self._button("land", "Land (hold)", lambda: tab.fly(Task.LAND), hold=True)
            self._button("go_home", "Go home", lambda: tab.fly(Task.GO_HOME))
            self._button("simple_task", "Simple task", lambda: tab.simple_task(self._number()))
            legs = {0: "0: legs, angles", 1: "1: legs, velocity", 4: "4: whole flight"}
            self._task_number = ui.select(legs, value=0).props("dense id=task-number")
            self._task = ui.label().props("id=task")
        self._problem = ui.label().classes("problem").props("id=problem")
        self._activation = ui.label().props("id=activation")

    def _number(self) -> int:
        return int(self._task_number.value)

    def _build_fields(self) -> None:
        with _card("Flight"):
            for field in FIELDS:
                self._fields[field.name] = _field(field.name, field.label)

    def _build_link(self) -> None:
        with _card("Link"):
            for name, label in (
                ("connection", "Connection"),
                ("firmware", "Firmware"),
                ("aircraft_ms", "Aircraft and back"),
                ("browser_ms", "Browser and back"),
                ("age", "Newest package"),
                ("discards", "Damaged frames"),
                ("late", "Late and foreign acks"),
                ("dropped", "Frames not written"),
                ("mismatches", "Packages refused"),
                ("clients", "Lease"),
            ):
                self._numbers[name] = _field(name, label)[1]
            self._reason = ui.label().classes("problem").props("id=connection-error")

    def _build_attitude(self) -> None:
        with ui.row().classes("w-full gap-2 no-wrap"):
            with _card("Horizon").classes("w-1/2"):
                ui.element("canvas").props("id=horizon")
            with _card("Attitude").classes("w-1/2"):
                self._build_scene()

    def _build_track(self) -> None:
        with _card("Track").classes("w-full"):
            ui.element("canvas").props("id=track")
        with _card("Last minute").classes("w-full"), ui.grid(columns=2).classes("w-full"):
            for name in ("height", "speed", "yaw", "link"):
                ui.element("canvas").classes("plot").props(f"id=plot-{name}")

    def _build_scene(self) -> None:
        with ui.scene(width=320, height=180, grid=(10, 10), background_color="#dfe6ee") as scene:
            with scene.group() as self._model:
                scene.box(1.6, 0.16, 0.1).material("#444").rotate(0, 0, math.pi / 4)
                scene.box(1.6, 0.16, 0.1).material("#444").rotate(0, 0, -math.pi / 4)
                scene.box(0.5, 0.35, 0.25).material("#666")
                scene.box(0.35, 0.1, 0.1).material("#c62828").move(0.5, 0, 0.05)
                for x, y in ((0.57, 0.57), (0.57, -0.57), (-0.57, 0.57), (-0.57, -0.57)):
                    scene.cylinder(0.38, 0.38, 0.04).material(
                        "#c62828" if x > 0 else "#1565c0", opacity=0.6
                    ).rotate(math.pi / 2, 0, 0).move(x, y, 0.12)
            # Seen from behind a north-facing aircraft, a little from above: east to the right.
            scene.move_camera(0, -2.6, 1.4, 0, 0, 0, duration=0)

    def _build_steering(self) -> None:
        card = _card("Steering").classes("w-full")
        with card, ui.element("div").props("id=pad tabindex=0"):
            ui.html(_PAD, sanitize=False)

    def _build_channels(self) -> None:
        with _card("Remote control"):
            for name in _CHANNELS:
                with ui.row().classes("w-full items-center gap-2 no-wrap"):
                    ui.label(name).classes("w-20")
                    ui.element("div").classes("grow").props(f"data-rc={name}")

    def _build_events(self) -> None:
        with _card("Events").classes("w-full"):
            self._events = ui.log(max_lines=100).classes("events w-full").props("id=events")

    def _button(
        self,
        name: str,
        label: str,
        work: Callable[[], Awaitable[Any]],
        *,
        kind: str = "",
        hold: bool = False,
    ) -> None:
        button = ui.element("button").classes(f"act {kind}").props(f"type=button data-act={name}")
        with button:
            ui.label(label)
        if hold:
            button.classes("hold")

        async def clicked() -> None:
            # The page goes on while the aircraft flies.
            self._agent.background.spawn(self._tab.attempt(work), f"{name} of {self._tab.name}")
            await asyncio.sleep(0)

        button.on("held" if hold else "click", clicked)
        self._buttons[name] = button

    def _mission_button(self, name: str, label: str, work: Callable[[], Awaitable[Any]]) -> None:
        self._button(name, label, work, hold=name == "mission_start")

    async def _obtain(self) -> None:
        try:
            await self._tab.obtain()
        except LeaseHeld:
            self._wants_dialog = True

    _wants_dialog = False

    async def _ask_take_over(self) -> None:
        try:
            wanted = await self._tab.ask_take_over()
        except M100Error:
            return  # it is free by now
        with ui.dialog() as dialog, ui.card():
            ui.label(f"{wanted.from_name} has control. Take it over?").props("id=take-over")
            ui.label("The aircraft stops and hovers; the other side can steer no more.")
            with ui.row():

                async def confirm() -> None:
                    dialog.close()
                    await self._tab.attempt(lambda: self._tab.confirm_take_over(wanted))

                ui.button("Take over", on_click=confirm).props("color=red id=confirm")
                ui.button("Leave it", on_click=dialog.close).props("flat")
        dialog.open()

    # -- updates ---------------------------------------------------------------------------------

    async def _update(self) -> None:
        if self._wants_dialog:
            self._wants_dialog = False
            await self._ask_take_over()
        telemetry = self._agent.telemetry
        for field in FIELDS:
            row, value, note = self._fields[field.name]
            reading = read(field, telemetry)
            value.set_text(reading.text)
            note.set_text(reading.note)
            row.classes(add="stale") if reading.is_stale else row.classes(remove="stale")
        self._update_link()
        self._mission.update()
        self._update_banner()
        self._update_events()
        attitude = telemetry.fresh(Attitude, within=1.0) if telemetry is not None else None
        if attitude is not None:
            self._model.rotate(
                math.radians(attitude.roll_deg),
                -math.radians(attitude.pitch_deg),
                math.radians(90.0 - attitude.yaw_deg),
            )

    def _update_banner(self) -> None:
        agent, state, tab = self._agent, self._agent.state, self._tab
        holder = agent.holder
        if agent.is_silent or agent.is_gone:
            text, kind = "Nothing is heard of the aircraft: all values are old", "theirs"
        elif not holder.number:
            text, kind = "Nobody has control here: the pilot flies", ""
        elif not tab.has_lease:
            text, kind = f"{holder.name} has control", "theirs"
        elif agent.has_authority:
            text, kind = "You have control", "mine"
        else:
            text, kind = "You hold the lease, but the aircraft obeys the pilot", "theirs"
        self._banner.set_text(text)
        self._banner.classes(replace=f"banner grow {kind}")
        is_pilot = tab.has_lease and agent.has_authority
        is_mission = state.mission not in ("", "no mission")
        for name in ("take_off", "land", "go_home", "simple_task", "mission_start"):
            _enable(self._buttons[name], is_pilot and not state.task and not is_mission)
        for name in ("mission_pause", "mission_resume", "mission_stop"):
            _enable(self._buttons[name], is_pilot and is_mission)
        _enable(self._buttons["release"], tab.has_lease)
        _enable(self._buttons["obtain"], not is_pilot and agent.is_connected)
        _enable(self._buttons["activate"], agent.is_connected)
        task = state.task or ("simple task" if state.pattern else "")
        self._task.set_text(f"flying: {task}" if task else "")
        self._problem.set_text(tab.problem)
        self._activation.set_text(self._activation_text())

    def _activation_text(self) -> str:
        state = self._agent.state
        if state.activation_fault is not None:
            return f"Activation: {state.activation_fault.error()}"
        if state.is_activated:
            return "Activation: active"
        if state.activation_code is not None:
            return f"Activation: {ActivationCode(state.activation_code).meaning}"
        return "Activation: not done"

    def _update_link(self) -> None:
        agent, state, numbers = self._agent, self._agent.state, self._numbers
        numbers["connection"].set_text("silent" if agent.is_silent else state.connection)
        fault = state.connection_fault
        self._reason.set_text(str(fault.error()) if fault is not None else "")
        holder, remaining = agent.holder, state.lease_remaining
        numbers["clients"].set_text(
            f"{holder.name}, {remaining:.0f} s" if holder.number else "free"
        )
        if agent.telemetry is None:
            for name in ("firmware", "aircraft_ms", "discards", "late", "dropped"):
                numbers[name].set_text("–")
            return
        numbers["firmware"].set_text(state.firmware)
        trip = state.round_trip
        numbers["aircraft_ms"].set_text("no answer" if trip is None else f"{1000 * trip:.0f} ms")
        numbers["discards"].set_text(str(state.discards))
        numbers["late"].set_text(str(state.late_acks))
        numbers["dropped"].set_text(str(state.dropped_writes))
        numbers["mismatches"].set_text(str(state.mismatches))

    def _update_events(self) -> None:
        for event in self._agent.events:
            if event.number > self._last_event:
                self._last_event = event.number
                self._events.push(f"{event.at:9.1f}  {event.text}", classes=event.level)


def _card(title: str) -> Any:
    card = ui.element("div").classes("card w-full")
    with card:
        ui.html(f"<h3>{title}</h3>", sanitize=False)
    return card


def _field(name: str, label: str) -> tuple[Any, Any, Any]:
    with ui.element("div").classes("field") as row:
        ui.label(label).classes("name")
        with ui.element("div"):
            value = ui.label("–").classes("value").props(f"data-field={name}")
            note = ui.label("").classes("note")
    return row, value, note


def _enable(button: Any, is_enabled: bool) -> None:
    if is_enabled:
        button.props(remove="disabled")
    else:
        button.props("disabled")
