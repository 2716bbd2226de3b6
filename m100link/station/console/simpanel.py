"""The panel of a virtual aircraft: the pilot's switch, the app, and what can go wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from m100link.protocol.records import RcMode
from m100link.sim.line import NO_FAULTS, LineFaults

if TYPE_CHECKING:
    from m100link.sim.virtual import VirtualAircraft

__all__ = ["sim_panel"]

_FAULTS = {
    "clean": NO_FAULTS,
    "5 % lost": LineFaults(loss=0.05),
    "20 % lost": LineFaults(loss=0.2),
    "2 % damaged": LineFaults(damage=0.02),
    "80 ms late": LineFaults(delay=0.08, jitter=0.02),
    "433 MHz radio": LineFaults(radio=True),
}


def sim_panel(virtual: VirtualAircraft) -> None:
    """Lay the panel out inside the present element."""
    with ui.row().classes("items-center gap-2"):
        ui.label("Mode switch")
        ui.toggle(
            [mode.name for mode in RcMode],
            value=virtual.remote.mode.name,
            on_change=lambda event: virtual.set_rc_mode(str(event.value)),
        ).props("dense id=sim-mode")
    with ui.row().classes("items-center gap-2"):
        ui.switch(
            "remote control on",
            value=True,
            on_change=lambda event: virtual.rc_back() if event.value else virtual.rc_lost(),
        ).props("id=sim-rc")
        ui.switch(
            "app flies",
            on_change=lambda event: (
                virtual.app_takes_control() if event.value else virtual.app_releases_control()
            ),
        ).props("id=sim-app")
    with ui.row().classes("items-center gap-2"):
        ui.switch(
            "plugged in",
            value=True,
            on_change=lambda event: virtual.replug() if event.value else virtual.unplug(),
        ).props("id=sim-plug")
        ui.switch(
            "line stalled", on_change=lambda event: virtual.stall_line(bool(event.value))
        ).props("id=sim-stall")
        ui.switch(
            "server refuses", on_change=lambda event: virtual.server_refuses(bool(event.value))
        ).props("id=sim-refuse")
    with ui.row().classes("items-center gap-2 w-full"):
        ui.select(
            list(_FAULTS),
            value="clean",
            label="line",
            on_change=lambda event: virtual.set_faults(_FAULTS[str(event.value)]),
        ).props("dense id=sim-line").classes("w-32")
        ui.number(
            "GPS health",
            value=virtual.gps_health,
            min=0,
            max=5,
            precision=0,
            on_change=lambda event: _set_gps(virtual, event.value),
        ).props("dense id=sim-gps").classes("w-24")
        ui.number(
            "battery, %",
            value=round(virtual.battery_percent),
            min=0,
            max=100,
            on_change=lambda event: _set_battery(virtual, event.value),
        ).props("dense id=sim-battery").classes("w-24")


def _set_gps(virtual: VirtualAircraft, value: float | None) -> None:
    if value is not None and 0 <= value <= 5:
        virtual.gps_health = int(value)


def _set_battery(virtual: VirtualAircraft, value: float | None) -> None:
    if value is not None and 0 <= value <= 100:
        virtual.battery_percent = float(value)
