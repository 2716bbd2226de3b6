"""The Fly view: over the map, what is needed to fly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from m100link.apps.agent.lease import LeaseHeld
from m100link.apps.agent.orders import FlyPattern, GoHome, Land
from m100link.apps.station.console.components import component
from m100link.apps.station.console.components.map import ClickPart
from m100link.apps.station.console.tab import Tab
from m100link.apps.station.console.view import fly
from m100link.apps.station.console.view.texts import Text, tr
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.errors import M100Error


class Fly:
    def __init__(self, page: component.PageContext) -> None:
        made: tuple[tuple[str, Callable[[component.PageContext], component.Component]], ...] = (
            ("hud", InstrumentsPart),
            ("orders", ActionsPart),
            ("clicked", ClickPart),
        )
        self._parts = []
        for place, make in made:
            with _place(place):
                self._parts.append(make(page))
        with _place("steering"):
            _build_sticks(page.wording)

    def update(self, view: ViewModel) -> None:
        for part in self._parts:
            part.update(view)


def _place(name: str) -> ui.element:
    """Where it stands is said by the style sheet, for every size."""
    return ui.element("div").classes(f"place {name}")


# -- what one steers with --------------------------------------------------------------------------
# The pad. ``static/steer.js`` makes beats of it while something is held, and fills in the legend
# between the sticks: what keys do, and what the last one just did.


def _build_sticks(wording: component.Wording) -> None:
    with ui.element("div").props("id=pad tabindex=0 role=group") as pad:
        _build_stick(wording, "climb", "turn,up")
        with ui.element("div").classes("between"):
            _build_legend(wording)
        _build_stick(wording, "move", "right,forward")
    wording.put(component.attribute(pad), "page.steering")


def _build_stick(wording: component.Wording, name: str, axes: str) -> None:
    key = f"page.stick.{name}"
    with ui.element("div").classes(f"stick {name}").props(f"data-axes={axes} role=img") as stick:
        wording.label(key)
    wording.put(component.attribute(stick), "page.stick", what=Text(key))


def _build_legend(wording: component.Wording) -> None:
    with ui.element("div").classes("legend"):
        wording.label("page.legend.idle").classes("idle by-keys")
        wording.label("page.legend.idle.finger").classes("idle by-finger")
        ui.element("div").props("id=did role=status")
        wording.label("page.legend.keys").classes("keys")
        with ui.element("div").classes("choices"):
            _build_step(wording, "slower", "−")
            wording.put(_span().set_content, "page.legend.speed")
            ui.element("output").props("data-level")
            _build_step(wording, "faster", "+")
            with ui.element("button").props("type=button data-steer=mode"):
                wording.put(_span().classes("mode").set_content, "page.legend.mode")
                ui.element("b").props("data-mode")
                ui.element("span").classes("hint").props("data-hint")


def _build_step(wording: component.Wording, what: str, sign: str) -> None:
    with ui.element("button").props(f"type=button data-steer={what}") as step:
        ui.label(sign).props("aria-hidden=true")
    wording.put(component.attribute(step), f"page.legend.{what}")


def _span() -> ui.html:
    return ui.html("", sanitize=False, tag="span")


# -- the instruments over the map ------------------------------------------------------------------

_SHOWN = ("flight_status", "battery", "gps", "height", "speed", "mode_switch")


class InstrumentsPart:
    """The flight instruments; ``static/instruments.js`` draws the canvas from the socket."""

    def __init__(self, page: component.PageContext) -> None:
        horizon = ui.element("canvas").props("id=horizon role=img")
        page.wording.put(component.attribute(horizon), "instruments.horizon")
        with ui.element("div").classes("values"):
            names = [one.name for one in fly.FIELDS if one.name in _SHOWN]
            self._rows = {name: component.ReadingRow(name, page.wording) for name in names}

    def update(self, view: ViewModel) -> None:
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])


# -- the question whether to take control from somebody --------------------------------------------


class TakeOverDialog:
    """Obtains control, and asks when somebody has it."""

    def __init__(self, tab: Tab, wording: component.Wording) -> None:
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
                    said = component.answer(event)
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
                        button.on("click", confirm, js_handler=component.ORDER)
                    else:
                        button.on("click", dialog.close, args=[])
        dialog.open()


# -- before take-off -------------------------------------------------------------------------------

_SHAPES = {fly.ItemState.RIGHT: "✔", fly.ItemState.WRONG: "✖", fly.ItemState.UNKNOWN: "?"}


@dataclass(slots=True)
class _Row:
    box: Any
    shape: Any
    state: Any
    seen: Any
    remedy: Any
    shown: fly.ItemState | None = None


class ChecklistPart:
    """What :class:`~m100link.apps.station.console.view.fly.Checklist` says."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        self._take_over = TakeOverDialog(page.tab, page.wording)
        wording, checklist = page.wording, page.memory.checklist
        with wording.card("checklist.title"):
            self._summary = ui.label().classes("summary").props("id=check-summary role=status")
            with ui.element("ul").classes("checks").props("id=checks"):
                self._rows = {item: self._build_row(item) for item in fly.ITEMS}
            free = ui.checkbox(on_change=lambda event: self._say_free(is_free=bool(event.value)))
            self._free = free.props("id=free-said").classes("free")
            wording.put(self._free.set_text, "checklist.free.box")
            self._why = ui.input(on_change=lambda event: checklist.say_why(str(event.value or "")))
            self._why.props("for=why outlined maxlength=200").classes("w-full")
            wording.put(lambda text: self._why.props(f'label="{text}"'), "checklist.why")
            wording.put(lambda text: self._why.props(f'hint="{text}"'), "checklist.why.note")
            with ui.element("div").classes("acts"):
                add = page.buttons.add
                add("activate", "actions.activate", page.activate, kind="plain")
                add("obtain", "actions.obtain", self._take_over.obtain, kind="plain")
                add("take_off", "actions.take_off", page.take_off)

    def _build_row(self, item: fly.ChecklistItem) -> _Row:
        wording = self._page.wording
        with ui.element("li").classes("check").props(f"data-check={item.value}") as box:
            shape = ui.label().classes("shape").props("aria-hidden=true")
            with ui.element("div"):
                with ui.element("div").classes("check-head"):
                    wording.label(f"checklist.{item.value}").classes("name")
                    state = ui.label().classes("unseen")
                    seen = ui.label().classes("seen")
                    if fly.ITEMS[item]:
                        wording.label("checklist.needed").classes("needed")
                remedy = ui.label().classes("remedy")
        return _Row(box, shape, state, seen, remedy)

    def _say_free(self, *, is_free: bool) -> None:
        page, checklist, now = self._page, self._page.memory.checklist, self._page.agent.now
        if is_free is checklist.is_free(now):
            return  # the box follows what was said, and says nothing by itself
        checklist.say_free(now, is_free=is_free)
        page.tabs.looks.say(page.tab.person, page.tab.aircraft, page.agent, is_free=is_free)

    def update(self, view: ViewModel) -> None:
        self._take_over.update()
        checklist, wording = view.checklist, self._page.wording
        for check in checklist.checks:
            self._show(self._rows[check.item], check)
        self._summary.set_text(wording(_summary(checklist)))
        if bool(self._free.value) is not checklist.is_free_said:
            self._free.set_value(checklist.is_free_said)
        self._why.set_visibility(not checklist.is_green and checklist.is_possible)
        if not checklist.reason and self._why.value and view.checklist.is_green:
            self._why.set_value("")

    def _show(self, row: _Row, check: fly.Check) -> None:
        wording = self._page.wording
        row.seen.set_text(wording(check.seen))
        row.remedy.set_text(wording(check.remedy) if check.remedy is not None else "")
        row.state.set_text(wording(Text(f"checklist.state.{check.state.value}")))
        if check.state is not row.shown:
            row.box.classes(remove=row.shown.value if row.shown else "", add=check.state.value)
            row.shape.set_text(_SHAPES[check.state])
            row.shown = check.state


def _summary(checklist: fly.Checklist) -> Text:
    if checklist.is_green:
        return tr("checklist.green")
    if not checklist.is_possible:
        return tr("checklist.impossible")
    return tr("checklist.missing", count=len(checklist.missing))


# -- the buttons that one flies with ---------------------------------------------------------------

_SIMPLE = (0, 1, 4)


class ActionsPart:
    """Control, take-off, landing, go home and simple tasks."""

    def __init__(self, page: component.PageContext) -> None:
        self._page = page
        self._take_over = TakeOverDialog(page.tab, page.wording)
        tab, add = page.tab, page.buttons.add
        with ui.element("div").classes("acts"):
            add("activate", "actions.activate", page.activate, kind="plain")
            add("obtain", "actions.obtain", self._take_over.obtain)
            add("release", "actions.release", lambda: tab.session.give_back(), kind="plain")
            add("take_off", "actions.take_off", page.take_off)
            add("land", "actions.land", lambda: tab.session.ask(Land()))
            add("go_home", "actions.go_home", lambda: tab.session.ask(GoHome()))
        with ui.element("div").classes("acts simple"):
            add(
                "simple_task",
                "actions.simple_task",
                lambda: tab.session.ask(FlyPattern(int(self._number.value))),
            )
            self._number = ui.select(list(_SIMPLE), value=0).classes("task-number")
            self._number.props("dense outlined id=task-number")
            keys = {number: f"page.simple.{number}" for number in _SIMPLE}
            page.wording.options(self._number, keys)
            page.wording.put(component.attribute(self._number), "page.which_task")
        # Behind the buttons: it comes and goes, and they stay where the finger is.
        with ui.element("div").classes("told"):
            self._activation = ui.label().props("id=activation")
            with ui.element("button").props("type=button data-go=check id=why-not") as why_not:
                self._why_not = ui.label()
            self._why_not_button = why_not.classes("see")
            why_not.on("click", lambda: page.show("check"), args=[])

    def update(self, view: ViewModel) -> None:
        self._take_over.update()
        wording = self._page.wording
        self._activation.set_text(wording(view.activation))
        missing = len(view.checklist.missing)
        is_asked = view.situation.is_on_ground is not False and not view.checklist.may_take_off
        self._why_not_button.set_visibility(is_asked)
        self._why_not.set_text(wording(tr("actions.why_not", count=missing)))
