"""The operator's settings of this page, and the panel of a virtual aircraft."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from m100link.apps.station.console.components.component import PageContext, Wording, attribute
from m100link.apps.station.console.view import texts
from m100link.apps.station.console.view.view_model import ViewModel
from m100link.errors import M100Error
from m100link.protocol.records import RcMode

if TYPE_CHECKING:
    from m100link.sim.orders import SimulatorOrders

# -- settings, which the browser keeps -------------------------------------------------------------

_KEY = "m100link.settings"
_PATIENCE = 30.0  # seconds that a busy browser has to say what it kept
_CHOICES: tuple[tuple[str, type[Enum]], ...] = (
    ("language", texts.Language),
    ("length", texts.LengthUnit),
    ("speed", texts.SpeedUnit),
    ("theme", texts.Theme),
)
_NAMED = ("language", "theme")  # the others are signs of units


async def load_settings(page: PageContext) -> None:
    try:
        kept, ahead = await ui.run_javascript(
            f"[localStorage.getItem({json.dumps(_KEY)}), -new Date().getTimezoneOffset()]",
            timeout=_PATIENCE,
        )
    except TimeoutError:
        return  # the page has gone, or hangs: it stays as it is
    if isinstance(ahead, int) and abs(ahead) <= 14 * 60:
        page.wording.utc_offset_min = ahead
    apply_settings(page, texts.DisplaySettings.from_text(kept))


def apply_settings(page: PageContext, settings: texts.DisplaySettings) -> None:
    """Let the page look and speak as it was chosen."""
    if settings.name:
        page.tab.session.name = settings.name
    page.dark.set_value({texts.Theme.AUTO: None, texts.Theme.DARK: True}.get(settings.theme, False))
    speaker = json.dumps(texts.for_browser(settings.speaker))
    ui.run_javascript(
        f"document.body.classList.toggle('sun', {json.dumps(settings.theme is texts.Theme.SUN)});"
        f'import("/console/said.js").then((said) => said.choose({speaker}));'
    )
    page.wording.choose(settings)


class SettingsPart:
    """Language, units, looks, sound, and who it is."""

    def __init__(self, page: PageContext) -> None:
        self._page = page
        wording = self._page.wording
        with wording.card("settings.title"):
            name = ui.input(value=self._page.tab.session.name)
            name.props("for=name outlined maxlength=64").classes("w-60")
            name.on_value_change(lambda event: self._rename(str(event.value)))
            wording.put(attribute(name, "label"), "settings.name")
            for field, kind in _CHOICES:
                self._build_choice(field, kind)
            for field in ("sound", "speech"):
                box = ui.checkbox(value=getattr(wording.settings, field)).props(f"id={field}")
                box.on_value_change(self._chooser(field, bool))
                wording.put(box.set_text, f"settings.{field}")
            with ui.element("div").classes("acts"):
                wording.button("settings.try_sound", "id=try-sound", self._try_sound)
            for key in ("settings.english_errors", "settings.kept"):
                wording.label(key).classes("note-plain")
        with wording.card("settings.gamepad"), ui.element("div").props("id=gamepad") as card:
            wording.label("settings.gamepad.hint").classes("hint")
            ui.label().classes("which")
            with ui.element("div").classes("choices").props("aria-hidden=true"):
                for axes in ("turn,up", "right,forward"):
                    ui.element("div").classes("stick").props(f"data-axes={axes}")
            ui.element("div").classes("fields")
        with card:
            ui.run_javascript(
                'import("/console/gamepad.js").then('
                '({build}) => build(document.querySelector("#gamepad")))'
            )
        if self._page.orders is not None:
            with wording.card("status.virtual"):
                SimPanel(self._page.orders, wording)

    def _build_choice(self, field: str, kind: type[Enum]) -> None:
        wording = self._page.wording
        values = [str(one.value) for one in kind]
        chosen = getattr(wording.settings, field).value
        choice = ui.select({value: value for value in values}, value=chosen)
        choice.props(f"for={field} outlined").classes("w-60")
        choice.on_value_change(self._chooser(field, kind))
        wording.put(attribute(choice, "label"), f"settings.{field}")
        if field in _NAMED:
            wording.options(choice, {one: f"settings.{field}.{one}" for one in values})

    def _rename(self, name: str) -> None:
        self._page.tab.session.name = name[:64]
        self._choose(name=name[:64])

    def _chooser(self, field: str, kind: Callable[[Any], Any]) -> Callable[[Any], None]:
        return lambda event: self._choose(**{field: kind(event.value)})

    def _choose(self, **chosen: Any) -> None:
        settings = replace(self._page.wording.settings, **chosen)
        if settings == self._page.wording.settings:
            return
        ui.run_javascript(
            f"localStorage.setItem({json.dumps(_KEY)}, {json.dumps(settings.to_text())})"
        )
        apply_settings(self._page, settings)

    def _try_sound(self) -> None:
        wording = self._page.wording
        tried = {
            "text": wording(texts.Text("settings.tried")),
            "language": wording.settings.language.value,
            "sound": wording.settings.sound,
            "speech": wording.settings.speech,
        }
        ui.run_javascript(
            f'import("/console/alarms.js").then((module) => module.attempt({json.dumps(tried)}))'
        )

    def update(self, view: ViewModel) -> None:
        """Nothing of it comes from the aircraft."""


# -- the panel of a virtual aircraft ---------------------------------------------------------------

_LINES = {
    "clean": "",
    "lost_5": "faults loss=0.05",
    "lost_20": "faults loss=0.2",
    "damaged": "faults damage=0.02",
    "late": "faults delay=0.08 jitter=0.02",
    "radio": "faults radio=on",
}

# As a text: what comes with a change is not generic in every NiceGUI that is allowed.
_Handler: TypeAlias = "Callable[[ValueChangeEventArguments[Any]], Awaitable[None]]"


class SimPanel:
    def __init__(self, orders: SimulatorOrders, wording: Wording) -> None:
        self._orders, self._wording = orders, wording
        shown = orders.status
        with ui.row().classes("items-center gap-2"):
            wording.label("sim.mode")
            ui.toggle(
                [mode.name for mode in RcMode],
                value=shown["rc_mode"],
                on_change=self._gives(lambda mode: (f"rc-mode {mode}",)),
            ).props("id=sim-mode")
        with ui.row().classes("items-center gap-2"):
            self._switch("rc", "rc-on", "rc-off", value=shown["rc_is_on"])
            app = "app-takes-control", "app-releases-control"
            self._switch("app", *app, value=shown["control"] == "app")
        with ui.row().classes("items-center gap-2"):
            self._switch("plug", "replug", "unplug", value=True)
            self._switch("stall", "stall on", "stall off", value=False)
            self._switch("refuse", "server-refuses on", "server-refuses off", value=False)
        with ui.row().classes("items-center gap-2 w-full"):
            self._build_line()
            self._number("gps", "gps {:.0f}", 5, shown["gps_health"])
            self._number("battery", "battery {:g}", 100, round(shown["battery_percent"]))

    def _gives(self, order: Callable[[Any], tuple[str, ...]]) -> _Handler:
        """The sender of an order for a new value; it shows a refusal to the operator."""

        async def give(event: ValueChangeEventArguments[Any]) -> None:
            if event.value is None:
                return
            try:
                await self._orders.give(*order(event.value))
            except M100Error as error:
                ui.notify(error.seen)

        return give

    def _switch(self, name: str, on: str, off: str, *, value: bool) -> None:
        gives = self._gives(lambda is_on: (on if is_on else off,))
        switch = ui.switch(value=value, on_change=gives).props(f"id=sim-{name}")
        self._wording.put(switch.set_text, f"sim.{name}")

    def _build_line(self) -> None:
        line = ui.select(
            list(_LINES),
            value="clean",
            on_change=self._gives(
                lambda name: ("no-faults", _LINES[name]) if _LINES[name] else ("no-faults",)
            ),
        )
        line.props("outlined dense id=sim-line for=sim-line-input").classes("w-40")
        self._wording.options(line, {name: f"sim.line.{name}" for name in _LINES})
        self._wording.put(attribute(line, "label"), "sim.line")

    def _number(self, name: str, order: str, high: int, value: int) -> None:
        number = ui.number(
            value=value,
            min=0,
            max=high,
            precision=0,
            on_change=self._gives(lambda typed: (order.format(_within(typed, high)),)),
        )
        number.props(f"outlined dense id=sim-{name} for=sim-{name}-input").classes("w-28")
        self._wording.put(attribute(number, "label"), f"sim.{name}")


def _within(value: float, high: float) -> float:
    return min(max(float(value), 0.0), high)
