"""The panel of a virtual aircraft: the pilot's switch, the app, and what can go wrong."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from m100link.errors import M100Error
from m100link.protocol.records import RcMode
from m100link.station.console.orders import Orders

__all__ = ["sim_panel"]

_LINES = {
    "clean": "",
    "5 % lost": "faults loss=0.05",
    "20 % lost": "faults loss=0.2",
    "2 % damaged": "faults damage=0.02",
    "80 ms late": "faults delay=0.08 jitter=0.02",
    "433 MHz radio": "faults radio=on",
}

# As a text: what comes with a change is not generic in every NiceGUI that is allowed.
_Handler: TypeAlias = "Callable[[ValueChangeEventArguments[Any]], Awaitable[None]]"


def _gives(orders: Orders, order: Callable[[Any], tuple[str, ...]]) -> _Handler:
    """What gives the orders for a new value; a refusal is shown to whoever wanted it."""

    async def give(event: ValueChangeEventArguments[Any]) -> None:
        if event.value is None:
            return
        try:
            await orders.give(*order(event.value))
        except M100Error as error:
            ui.notify(error.seen)

    return give


def _switch(orders: Orders, label: str, name: str, on: str, off: str, *, value: bool) -> None:
    ui.switch(
        label, value=value, on_change=_gives(orders, lambda is_on: (on if is_on else off,))
    ).props(f"id={name}")


def sim_panel(orders: Orders) -> None:
    """Lay the panel out inside the present element."""
    shown = orders.status
    with ui.row().classes("items-center gap-2"):
        ui.label("Mode switch")
        ui.toggle(
            [mode.name for mode in RcMode],
            value=shown["rc_mode"],
            on_change=_gives(orders, lambda mode: (f"rc-mode {mode}",)),
        ).props("dense id=sim-mode")
    with ui.row().classes("items-center gap-2"):
        _switch(orders, "remote control on", "sim-rc", "rc-on", "rc-off", value=shown["rc_is_on"])
        has_app = shown["control"] == "app"
        app = "app-takes-control", "app-releases-control"
        _switch(orders, "app flies", "sim-app", *app, value=has_app)
    with ui.row().classes("items-center gap-2"):
        _switch(orders, "plugged in", "sim-plug", "replug", "unplug", value=True)
        _switch(orders, "line stalled", "sim-stall", "stall on", "stall off", value=False)
        refuses = "server-refuses on", "server-refuses off"
        _switch(orders, "server refuses", "sim-refuse", *refuses, value=False)
    with ui.row().classes("items-center gap-2 w-full"):
        ui.select(
            list(_LINES),
            value="clean",
            label="line",
            on_change=_gives(
                orders,
                lambda name: ("no-faults", _LINES[name]) if _LINES[name] else ("no-faults",),
            ),
        ).props("dense id=sim-line").classes("w-32")
        ui.number(
            "GPS health",
            value=shown["gps_health"],
            min=0,
            max=5,
            precision=0,
            on_change=_gives(orders, lambda value: (f"gps {_within(value, 5):.0f}",)),
        ).props("dense id=sim-gps").classes("w-24")
        ui.number(
            "battery, %",
            value=round(shown["battery_percent"]),
            min=0,
            max=100,
            on_change=_gives(orders, lambda value: (f"battery {_within(value, 100):g}",)),
        ).props("dense id=sim-battery").classes("w-24")


def _within(value: float, high: float) -> float:
    return min(max(float(value), 0.0), high)
