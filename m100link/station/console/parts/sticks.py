"""What one steers with: two sticks for fingers, and the place that takes the keys."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.parts.part import Part
from m100link.station.console.view.view import View

__all__ = ["SticksPart"]


class SticksPart:
    """The pad. ``static/steer.js`` makes beats of it while something is held.

    Args:
        legend: What stands between the sticks.
    """

    def __init__(self, legend: Part) -> None:
        self._legend = legend

    def build(self) -> None:
        """Lay it out."""
        with ui.element("div").props('id=pad tabindex=0 role=group aria-label="steering"'):
            _stick("climb", "turn,up", "climb and turn")
            with ui.element("div").classes("between"):
                self._legend.build()
            _stick("move", "right,forward", "move")

    def update(self, view: View) -> None:
        """Show what is."""
        self._legend.update(view)


def _stick(name: str, axes: str, label: str) -> None:
    with (
        ui.element("div")
        .classes(f"stick {name}")
        .props(f'data-axes={axes} role=img aria-label="stick: {label}"')
    ):
        ui.label(label)
