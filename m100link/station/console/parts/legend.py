"""What keys do, and what the last one just did."""

from __future__ import annotations

from nicegui import ui

from m100link.station.console.view.view import View

__all__ = ["LegendPart"]

_LEGEND = """
<div class="idle">click here, then hold keys to fly</div>
<div id="did" role="status"></div>
<div class="keys"><b>W A S D</b> move, <b>Q E</b> turn, <b>Z C</b> climb and sink,
<b>Esc</b> leaves, gamepad: hold a shoulder button</div>
<div class="choices">
<button type="button" data-steer="slower" aria-label="slower">−</button>
<span>speed</span><output data-level>1</output>
<button type="button" data-steer="faster" aria-label="faster">+</button>
<button type="button" data-steer="mode">mode <b data-mode>1</b>
<span class="hint" data-hint></span></button>
</div>
"""


class LegendPart:
    """Stands between the sticks; ``static/steer.js`` fills it in."""

    def build(self) -> None:
        """Lay it out."""
        ui.html(_LEGEND, sanitize=False).classes("legend")

    def update(self, view: View) -> None:
        """What it shows comes from the hand, not from the aircraft."""
