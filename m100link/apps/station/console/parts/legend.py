"""What keys do, and what the last one just did."""

from __future__ import annotations

from nicegui import ui

from m100link.apps.station.console.parts.wording import Wording, attribute
from m100link.apps.station.console.view.view import View

__all__ = ["LegendPart"]


class LegendPart:
    """Stands between the sticks; ``static/steer.js`` fills it in.

    Args:
        wording: Says what stands there always.
    """

    def __init__(self, wording: Wording) -> None:
        self._wording = wording

    def build(self) -> None:
        """Lay it out."""
        put = self._wording.put
        with ui.element("div").classes("legend"):
            put(ui.label().classes("idle by-keys").set_text, "page.legend.idle")
            put(ui.label().classes("idle by-finger").set_text, "page.legend.idle.finger")
            ui.element("div").props("id=did role=status")
            put(ui.label().classes("keys").set_text, "page.legend.keys")
            with ui.element("div").classes("choices"):
                self._build_step("slower", "−")
                put(_span().set_content, "page.legend.speed")
                ui.element("output").props("data-level")
                self._build_step("faster", "+")
                with ui.element("button").props("type=button data-steer=mode"):
                    put(_span().classes("mode").set_content, "page.legend.mode")
                    ui.element("b").props("data-mode")
                    ui.element("span").classes("hint").props("data-hint")

    def _build_step(self, what: str, sign: str) -> None:
        button = ui.element("button").props(f"type=button data-steer={what}")
        with button:
            ui.label(sign).props("aria-hidden=true")
        self._wording.put(attribute(button), f"page.legend.{what}")

    def update(self, view: View) -> None:
        """What it shows comes from the hand, not from the aircraft."""


def _span() -> ui.html:
    return ui.html("", sanitize=False, tag="span")
