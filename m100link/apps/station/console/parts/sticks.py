"""What one steers with: two sticks for fingers, and the place that takes the keys."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.legend import LegendPart
from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import Text

__all__ = ["SticksPart"]


class SticksPart:
    """The pad. ``static/steer.js`` makes beats of it while something is held.

    Args:
        wording: Says what stands there.
    """

    def __init__(self, wording: Wording) -> None:
        self._wording = wording
        self._legend = LegendPart(wording)

    def build(self) -> None:
        """Lay it out."""
        with ui.element("div").props("id=pad tabindex=0 role=group") as pad:
            self._build_stick("climb", "turn,up")
            with ui.element("div").classes("between"):
                self._legend.build()
            self._build_stick("move", "right,forward")
        self._wording.put(attribute(pad), "page.steering")

    def _build_stick(self, name: str, axes: str) -> None:
        key = f"page.stick.{name}"
        stick = ui.element("div").classes(f"stick {name}").props(f"data-axes={axes} role=img")
        with stick:
            self._wording.put(ui.label().set_text, key)
        self._wording.put(attribute(stick), "page.stick", what=Text(key))

    def update(self, view: View) -> None:
        """Show what is."""
        self._legend.update(view)
