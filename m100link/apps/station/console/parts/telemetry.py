"""Every value of the telemetry, the attitude in three dimensions, and the sticks of the pilot."""

from __future__ import annotations

import math

from nicegui import ui

from m100link.apps.station.console.parts.fields import ReadingRow, card
from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.view.instruments import FIELDS
from m100link.apps.station.console.view.view import View
from m100link.apps.station.console.view.words import say

__all__ = ["TelemetryPart"]

_CHANNELS = ("roll", "pitch", "yaw", "throttle")


class TelemetryPart:
    """The values that the Fly view has no room for.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._rows: dict[str, ReadingRow] = {}

    def build(self) -> None:
        """Lay it out."""
        wording = self._deck.wording
        with card("instruments.title", wording):
            for one in FIELDS:
                self._rows[one.name] = ReadingRow(one.name, wording)
        with card("instruments.attitude", wording):
            self._age = ui.label().classes("note").props("id=attitude-age")
            self._frame = ui.element("div").classes("attitude")
            with self._frame:
                self._build_scene()
        with card("instruments.remote_control", wording):
            for name in _CHANNELS:
                with ui.row().classes("w-full items-center gap-2 no-wrap"):
                    wording.put(ui.label().classes("w-20").set_text, f"instruments.rc.{name}")
                    ui.element("div").classes("grow").props(f"data-rc={name}")

    def _build_scene(self) -> None:
        with ui.scene(
            width=320, height=180, grid=(10, 10), background_color="#dfe6ee", fps=10
        ) as scene:
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

    def update(self, view: View) -> None:
        """Show what is."""
        for name, row in self._rows.items():
            row.show(view.instruments.readings[name])
        attitude = view.instruments.attitude
        old = self._deck.wording(say("instruments.no_attitude"))
        self._age.set_text("" if attitude is not None else old)
        if attitude is None:
            self._frame.classes(add="stale")
            return
        self._frame.classes(remove="stale")
        roll, pitch, yaw = attitude
        self._model.rotate(math.radians(roll), -math.radians(pitch), math.radians(90.0 - yaw))
