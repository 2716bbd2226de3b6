"""The map behind the Fly and Plan views."""

from __future__ import annotations

import json

from nicegui import ui

from m100link.apps.station.console.parts.part import Deck
from m100link.apps.station.console.parts.wording import attribute
from m100link.apps.station.console.view.chart import Chart
from m100link.apps.station.console.view.view import View

__all__ = ["MapPart"]

_TOOLS = (
    ("in", "add"),
    ("out", "remove"),
    ("follow", "my_location"),
    ("turn", "navigation"),
)
"""What each does, ``page.map.<that>`` is its name for people; its icon."""


class FlightMap(ui.leaflet):
    """A map whose place the page alone decides: where it was moved to is not kept here."""

    def _handle_move_or_zoom_end(self, e: object) -> None:
        """Nothing comes back: it would be sent to the page again, five times a second."""


class MapPart:
    """One map for both views; drawn on by ``static/map.js``.

    Args:
        deck: What it stands on.
    """

    def __init__(self, deck: Deck) -> None:
        self._deck = deck
        self._shown = Chart(None, ())

    def build(self) -> None:
        """Lay it out."""
        options = {"zoomControl": False, "attributionControl": False, "maxZoom": 22}
        with ui.element("div").props("id=map-frame"):
            self.leaflet = FlightMap(zoom=18, options=options | {"keyboard": False})
            self.leaflet.props(f"id=map data-vue={self.leaflet.id}").classes("map")
            self.leaflet.clear_layers()  # the tiles of the Internet
            if self._deck.has_tiles:
                self.leaflet.tile_layer(
                    url_template="/tiles/{z}/{x}/{y}.png",
                    options={"maxNativeZoom": 19, "maxZoom": 22},
                )
        with ui.element("div").classes("map-tools"):
            for what, icon in _TOOLS:
                tool = ui.element("button").props(f"type=button data-map={what}")
                with tool:
                    ui.icon(icon).props("aria-hidden=true")
                for name in ("title", "aria-label"):
                    self._deck.wording.put(attribute(tool, name), f"page.map.{what}")
        ui.label().props("id=map-home").classes("map-home")

    def update(self, view: View) -> None:
        """Show plan and envelope when they are others; what moves comes by the socket."""
        chart = view.chart
        if chart != self._shown:
            self._shown = chart
            fence = chart.fence and [
                [chart.fence.latitude_deg, chart.fence.longitude_deg],
                chart.fence.radius_m,
            ]
            ui.run_javascript(
                'import("/console/shell.js").then(({m100}) => m100.onMap('
                f"(map) => map.setChart({json.dumps(chart.route)}, {json.dumps(fence)})))"
            )
