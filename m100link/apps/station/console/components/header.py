"""The head of every view: the status line, alarms, a replay, the list of aircraft."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from typing import Any

from nicegui import events, ui
from nicegui.events import GenericEventArguments

from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.agent.orders import OrderReplay
from m100link.apps.station.console.components.component import (
    ORDER,
    PageContext,
    ReadingRow,
    Wording,
    answer,
    attribute,
)
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.view.alarms import ActiveAlarm, AlarmName, AlarmState
from m100link.apps.station.console.view.header import SPEEDS, FleetRow, ReplayView
from m100link.apps.station.console.view.situation import AlarmLevel
from m100link.apps.station.console.view.texts import DisplaySettings, Text, tr
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.errors import M100Error

# -- the status line -------------------------------------------------------------------------------

SHAPES = {
    AlarmLevel.GOOD: "●",
    AlarmLevel.NEUTRAL: "○",
    AlarmLevel.WARNING: "▲",
    AlarmLevel.DANGER: "◆",
}
"""Beside its colour each level has a shape: not everybody sees colours."""


_VALUES = {
    "battery": "battery_std",
    "gps": "satellite_alt",
    "height": "height",
    "climb": "swap_vert",
    "speed": "speed",
    "flight_time": "timer",
}
"""The values at the top, with their icons; the page itself adds the age of the link."""


class StatusPart:
    """Always on the page, above every view: who has control, what flies, how it is."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._level = ""
        self._since: float | None = None
        self._take_over = TakeOverDialog(page.tab, page.wording)
        wording = page.wording
        with ui.element("div").props("id=top"):
            self._build_banner()
            with ui.element("div").props("id=values role=group") as values:
                self._rows = {name: self._build_value(name, icon) for name, icon in _VALUES.items()}
                with ui.element("div").classes("chip"):
                    ui.icon("wifi").props("aria-hidden=true")
                    wording.field("age", "link.age")
            wording.put(attribute(values), "instruments.title")
        self._problem = ui.label().classes("problem").props("id=problem role=alert")
        with ui.element("div").classes("page-lost").props("id=page-lost role=alert") as lost:
            with ui.element("div"):
                wording.label("status.page_lost")
                wording.label("status.page_lost.remedy").classes("remedy")
            ui.label().classes("since").props("aria-hidden=true id=page-lost-since")
            wording.button("alarms.acknowledge", "id=page-lost-seen", looks="see")
        with ui.element("div").classes("unanswered").props("id=unanswered role=alert hidden"):
            ui.label().props("id=unanswered-said")
            wording.button("alarms.acknowledge", "id=unanswered-seen", looks="see")
        ui.label().classes("page-said").props("id=page-said role=status")
        wording.put(attribute(lost, "data-text"), "status.page_lost")
        # When this view was made, on the station's clock: the page knows how old it is.
        self._beat = ui.element("i").props("id=view-beat hidden")

    def _build_banner(self) -> None:
        with ui.element("div").classes("banner").props("id=banner") as self._banner:
            self._shape = ui.label().classes("shape").props("aria-hidden=true")
            with ui.element("div").classes("said").props("role=status"):
                self._text = ui.label().props("id=said")
                self._remedy = ui.label().classes("remedy").props("id=remedy")
            # Counted by the page itself; read aloud it would never end.
            self._counter = ui.label().classes("since").props("aria-hidden=true")
            with ui.element("div").classes("pills"):
                self._phase = ui.label().classes("flies").props("id=phase")
                self._flies = ui.label().classes("flies").props("id=task role=status")
                virtual = self._page.wording.label("status.virtual")
                self._virtual = virtual.classes("flies").props("id=virtual")
            add = self._page.buttons.add
            self._controls = {
                "obtain": add("obtain", "actions.obtain", self._take_over.obtain, kind="plain"),
                "release": add("release", "actions.release", self._release, kind="plain"),
            }

    async def _release(self) -> None:
        await self._page.tab.session.give_back()

    def _build_value(self, name: str, icon: str) -> ReadingRow:
        with ui.element("div").classes("chip"):
            ui.icon(icon).props("aria-hidden=true")
            return ReadingRow(name, self._page.wording)

    def update(self, view: ViewModel) -> None:
        line, said = view.status, self._page.wording
        self._take_over.update()
        self._text.set_text(said(line.text))
        self._remedy.set_text(said(line.remedy) if line.remedy is not None else "")
        self._show_what_flies(view)
        self._problem.set_text("" if view.problem is None else said(view.problem))
        for name, control in self._controls.items():
            control.set_visibility(name in view.actions)
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])
        if line.level.value != self._level:
            self._banner.classes(remove=self._level, add=line.level.value)
            self._level = line.level.value
            self._shape.set_text(SHAPES[line.level])
        # The page counts by the station's clock: not by that of a recorded flight.
        since = line.since if view.replay is None else None
        if since != self._since:
            self._since = since
            attribute(self._counter, "data-since")("" if since is None else f"{since:.1f}")
            self._counter.set_text("")
        attribute(self._beat, "data-at")(f"{self._page.agent.now:.1f}")

    def _show_what_flies(self, view: ViewModel) -> None:
        """The order that the aircraft carries out, or else whether it flies at all."""
        said, flies = self._page.wording, view.status.flies
        phase = view.instruments.readings["flight_status"]
        is_shown = flies is None and not phase.is_stale
        self._phase.set_text(said(phase.text) if is_shown else "")
        self._flies.set_text("" if flies is None else said(flies))
        self._virtual.set_visibility(view.status.is_virtual)


# -- the question whether to take control from somebody --------------------------------------------


class TakeOverDialog:
    def __init__(self, tab: Tab, wording: Wording) -> None:
        self._tab, self._wording = tab, wording
        # The order runs in the background, where no element can be made.
        self._is_wanted = False

    async def obtain(self) -> None:
        """Obtain control; if somebody has it, ask with the next update."""
        try:
            await self._tab.session.obtain()
        except LeaseHeld:
            self._is_wanted = True

    def update(self) -> None:
        if self._is_wanted:
            self._is_wanted = False
            ui.timer(0.0, self._ask, once=True)

    async def _ask(self) -> None:
        try:
            wanted = await self._tab.session.ask_take_over()
        except M100Error:
            return  # it is free by now
        with ui.dialog() as dialog, ui.card():
            asked = self._wording(tr("page.take_over", name=wanted.from_name))
            ui.label(asked).props("id=take-over")
            ui.label(self._wording(tr("page.take_over.effect")))
            with ui.row():

                async def confirm(event: GenericEventArguments) -> None:
                    said = answer(event)
                    dialog.close()

                    async def order() -> None:
                        self._tab.check_order(said.get("at"))
                        await self._tab.session.confirm(wanted)

                    await self._tab.attempt(order)

                for name, kind in (("confirm", "danger"), ("leave", "plain")):
                    with ui.element("button").classes(f"act {kind}") as button:
                        ui.label(self._wording(Text(f"page.take_over.{name}")))
                    button.props(f"type=button id={name}")
                    if name == "confirm":
                        button.on("click", confirm, js_handler=ORDER)
                    else:
                        button.on("click", dialog.close, args=[])
        dialog.open()


# -- alarms in the header --------------------------------------------------------------------------


@dataclass(slots=True)
class _Row:
    box: Any  # the whole row
    shape: Any
    text: Any  # what it says
    button: Any  # with which it is acknowledged
    state: str = ""  # what stands there now


class AlarmsPart:
    """Always on the page. Sound and speech are made by ``static/alarms.js``."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._spoken: dict[AlarmName, float] = {}  # what the page is to speak, and since when
        wording = page.wording
        with ui.element("ul").props("id=alarms").classes("alarms") as alarms:
            self._rows = {name: self._build_row(name) for name in AlarmName}
        wording.put(attribute(alarms), "alarms.title")
        # A screen reader says this at once, whatever it is saying.
        self._loud = ui.label().classes("unseen").props("id=alarm-loud role=alert")
        with ui.element("div").classes("sound-blocked").props("id=sound-blocked hidden"):
            wording.label("alarms.sound_blocked")
            wording.button("alarms.allow_sound", "id=allow-sound", looks="see")
        self._sound = ui.element("i").props("id=alarm-sound hidden data-level= data-say=[]")
        page.load("alarms.js")

    def _build_row(self, name: AlarmName) -> _Row:
        with ui.element("li").classes("alarm").props(f"data-alarm={name.value}") as box:
            shape = ui.label().classes("shape").props("aria-hidden=true")
            text = ui.label().classes("what")
            seen, props = partial(self._acknowledge, name), f"data-see={name.value}"
            see = self._page.wording.button("alarms.acknowledge", props, seen, looks="see")
        box.set_visibility(False)
        return _Row(box, shape, text, see)

    def _acknowledge(self, name: AlarmName) -> None:
        text = self._page.memory.acknowledge(name)
        if text is not None:
            # For a later reader of the station's log; in English, as everything there.
            english = type(self._page.wording.settings)().speaker
            self._page.agent.note(f"{self._page.tab.session.name} acknowledged: {english(text)}")

    def update(self, view: ViewModel) -> None:
        shown = {alarm.name: alarm for alarm in view.alarms}
        for name, row in self._rows.items():
            self._show(row, shown.get(name))
        self._tell(view)

    def _show(self, row: _Row, alarm: ActiveAlarm | None) -> None:
        state = "" if alarm is None else f"{alarm.level.value} {alarm.state.value}"
        if alarm is not None:
            wording = self._page.wording
            text = wording(_whole(alarm))
            row.text.set_text(text)
            row.shape.set_text(SHAPES[alarm.level])
            attribute(row.button)(wording(tr("alarms.acknowledge_named", alarm=alarm.text)))
        if state != row.state:
            row.box.classes(remove=row.state, add=state)
            row.state = state
            row.box.set_visibility(alarm is not None)
            is_known = alarm is not None and alarm.state is AlarmState.ACKNOWLEDGED
            row.button.set_visibility(not is_known)

    def _tell(self, view: ViewModel) -> None:
        """Hand what is new to sound and speech."""
        raised = [one for one in view.alarms if one.state is AlarmState.RAISED]
        since = {one.name: one.at for one in raised}
        new = [one for one in raised if self._spoken.get(one.name) != one.at]
        self._spoken = since
        settings, wording = self._page.wording.settings, self._page.wording
        if new:
            said = [wording(one.text) for one in new]
            self._loud.set_text(". ".join(said))
            if settings.speech:
                spoken = {"at": view.at, "texts": said, "language": settings.language.value}
                attribute(self._sound, "data-say")(json.dumps(spoken))
        elif not raised:
            self._loud.set_text("")
        sounds = settings.sound and view.sounding is not None
        level = view.sounding.value if sounds and view.sounding is not None else ""
        attribute(self._sound, "data-level")(level)


def _whole(alarm: ActiveAlarm) -> Text:
    if alarm.state is AlarmState.PASSED:
        return tr("alarms.passed", alarm=alarm.text)
    return alarm.text


# -- the bar of a replay ---------------------------------------------------------------------------

_STEP = 0.1  # of the place, s


class ReplayPart:
    """Says that it is a replay, and moves it. It is not there for an aircraft."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._is_showing = False  # what is set then was not chosen
        self._is_held = False  # a finger moves the place
        self._duration_s: float | None = None
        self._is_marked = False  # the page: what one flies with is hidden
        self._shown: ReplayView | None = None
        put = page.wording.put
        with ui.element("section").props("id=replay") as self._bar:
            put(attribute(self._bar), "replay.bar")
            with ui.element("div").classes("said"):
                self._title = ui.label().classes("title").props("id=replay-title")
                page.wording.label("replay.nothing").classes("nothing")
                self._place = ui.label().props("id=replay-place")
                self._note = ui.label().props("id=replay-note")
            with ui.element("div").classes("moves"):
                back, on = partial(self._order, "by -10"), partial(self._order, "by 10")
                page.wording.button("replay.back", "data-replay=back", back)
                toggle = ui.element("button").classes("act plain")
                with toggle.props("type=button data-replay=toggle"):
                    self._toggle = ui.label()
                toggle.on("click", partial(self._order, "toggle"), args=[])
                page.wording.button("replay.on", "data-replay=on", on)
                self._alarms = {
                    name: page.wording.button(f"replay.{name}", f"data-replay={name}", seek)
                    for name, seek in (
                        ("alarm_before", partial(self._to_alarm, "alarm_before")),
                        ("alarm_after", partial(self._to_alarm, "alarm_after")),
                    )
                }
                self._slider = ui.slider(min=0.0, max=1.0, step=_STEP, value=0.0)
                self._slider.props("id=replay-slider")
                put(attribute(self._slider), "replay.place")
                self._slider.on("pan", self._held)
                self._slider.on("change", self._moved)
                choices = {speed: f"{speed:g} ×" for speed in SPEEDS}
                self._speed = ui.select(choices, value=1.0).props("dense outlined for=replay-speed")
                put(attribute(self._speed, "label"), "replay.speed")
                self._speed.on_value_change(self._sped)
                self._other = ui.select([""], value="").props("dense outlined for=replay-other")
                put(attribute(self._other, "label"), "replay.other")
                self._other.on_value_change(self._compare)
                self._other.set_visibility(False)
        self._bar.set_visibility(False)

    def _order(self, text: str) -> None:
        agent, tab = self._page.agent, self._page.tab

        async def order() -> None:
            await agent.ask(OrderReplay(text))

        agent.background.spawn(tab.attempt(order), f"{text} of {tab.session.name}")

    def _held(self, event: events.GenericEventArguments) -> None:
        self._is_held = event.args == "start"

    def _moved(self) -> None:
        self._is_held = False
        self._order(f"seek {float(self._slider.value or 0.0):.1f}")

    def _to_alarm(self, name: str) -> None:
        if self._shown is not None and (place := getattr(self._shown, name)) is not None:
            self._order(f"seek {place:.2f}")

    def _compare(self, event: events.ValueChangeEventArguments[str]) -> None:
        self._page.memory.compared = event.value or ""

    def _sped(self, event: events.ValueChangeEventArguments[float]) -> None:
        if not self._is_showing and event.value is not None:
            self._order(f"speed {event.value:g}")

    def update(self, view: ViewModel) -> None:
        shown = self._shown = view.replay
        self._bar.set_visibility(shown is not None)
        if shown is not None:
            self._is_showing = True
            self._show(shown)
            self._is_showing = False

    def _show(self, shown: ReplayView) -> None:
        said, source = self._page.wording, shown.source
        if not self._is_marked:
            self._is_marked = True
            ui.run_javascript('document.body.dataset.replay = "yes"')
        self._title.set_text(said(shown.title))
        self._place.set_text(said(shown.place))
        self._note.set_text("" if shown.note is None else said(shown.note))
        has_alarms = (shown.alarm_before, shown.alarm_after) != (None, None)
        for name, button in self._alarms.items():
            button.set_visibility(has_alarms)
            is_on = getattr(shown, name) is not None
            if is_on is ("disabled" in button.props):  # a change goes to the page
                button.props(remove="disabled") if is_on else button.props("disabled")
        others = [name for name in self._page.tabs.agents if name != self._page.tab.aircraft]
        if others and self._other.options != ["", *others]:
            self._other.set_options(["", *others])
            self._other.set_visibility(True)
        self._toggle.set_text(said(Text("replay.pause" if shown.is_running else "replay.resume")))
        if source.duration_s != self._duration_s:
            self._duration_s = source.duration_s
            self._slider.props(f"max={max(_STEP, source.duration_s):.1f}")
        if not self._is_held:
            self._slider.set_value(round(source.position_s, 1))
        if source.speed in SPEEDS:
            self._speed.set_value(source.speed)


# -- the aircraft that this station serves ---------------------------------------------------------


class FleetPart:
    """A row of aircraft: a press turns to one, and each can be stopped without that."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        self._rows: dict[str, _ShipRow] = {}  # as they came
        self._place = ui.element("nav").props("id=fleet")
        self._place.set_visibility(False)  # of one aircraft there is no list
        page.wording.put(attribute(self._place), "fleet.label")

    def update(self, view: ViewModel) -> None:
        """Show what is; of a fleet more may come."""
        for row in view.fleet:
            if not self._rows:
                self._place.set_visibility(True)
            if row.name not in self._rows:
                with self._place:
                    self._rows[row.name] = _ShipRow(self._page, row.name)
            self._rows[row.name].show(row)


class _ShipRow:
    def __init__(self, page: PageContext, name: str) -> None:
        self._page, self._name = page, name
        self._shown: tuple[FleetRow, DisplaySettings] | None = None  # and what it was said in
        with ui.element("div").classes("ship") as self._box:
            turn = ui.element("button").props(f'type=button data-ship="{name}"')
            page.wording.put(attribute(turn, "title"), "fleet.show", name=name)
            with turn:
                ui.label(name).classes("ship-name")
                self._control = ui.label().classes("ship-control")
                self._flies = ui.label().classes("ship-flies")
                self._battery = ui.label()
            self._turn: Any = turn
            turn.on("click", self._turn_to, args=[])
            stop = page.wording.button("actions.stop", f'data-stop="{name}"', looks="ship-stop")
            page.wording.put(attribute(stop), "fleet.stop", name=name)
            stop.on("click", self._stop, js_handler=ORDER)

    def _turn_to(self) -> None:
        if self._name != self._page.tab.aircraft:
            address = self._page.tabs.move(self._page.tab, self._name)
            ui.run_javascript(f"location.replace({json.dumps(address)})")

    def _stop(self, event: GenericEventArguments) -> None:
        answer(event)
        agent, tab = self._page.tabs.agents[self._name], self._page.tab
        wanted = partial(agent.stop, tab.session.name)
        stop = tab.attempt(wanted, replaces=self._name == tab.aircraft)
        agent.background.spawn(stop, f"stop of {tab.session.name}")

    def show(self, row: FleetRow) -> None:
        said = self._page.wording
        before, self._shown = self._shown, (row, said.settings)
        if self._shown == before:
            return
        self._control.set_text(said(row.control))
        self._flies.set_text(said(row.flies))
        self._battery.set_text(said(row.battery))
        self._battery.classes(add="low") if row.is_low else self._battery.classes(remove="low")
        self._turn.props(f"aria-current={'page' if row.is_shown else 'false'}")
        self._box.classes(remove="mine theirs free lost", add=row.kind)
