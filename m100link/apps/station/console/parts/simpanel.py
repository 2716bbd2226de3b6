"""The panel of a virtual aircraft: the pilot's switch, the app, and what can go wrong."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from m100link.apps.station.console.orders import Orders
from m100link.apps.station.console.parts.fields import say_options
from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.errors import M100Error
from m100link.protocol.records import RcMode

__all__ = ["SimPanel"]

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
    """What plays pilot and weather.

    Args:
        orders: What it does to the virtual aircraft.
        wording: Says what stands there.
    """

    def __init__(self, orders: Orders, wording: Wording) -> None:
        self._orders, self._wording = orders, wording

    def build(self) -> None:
        """Lay it out inside the present element."""
        shown = self._orders.status
        with ui.row().classes("items-center gap-2"):
            self._wording.put(ui.label().set_text, "sim.mode")
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
        """What gives the orders for a new value; a refusal is shown to whoever wanted it."""

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
        say_options(line, {name: f"sim.line.{name}" for name in _LINES}, self._wording)
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
