"""What is drawn of a flight, whether as a picture or as a page: panels, their curves, colours."""

from __future__ import annotations

import math
from typing import NamedTuple

from m100link.log.curves import Curve
from m100link.log.story import Story

__all__ = ["PHASE_COLOURS", "Line", "Panel", "clock", "facts", "panels", "ticks"]

PHASE_COLOURS = {
    "ground": "#9aa0a6",
    "take-off": "#e8a33d",
    "flight": "#3b7dd8",
    "landing": "#2a9d8f",
    "unknown": "#b07cc6",
    "pilot": "#9aa0a6",
    "app": "#b07cc6",
    "program": "#3b7dd8",
}
"""Colour of a phase, and of who has control."""


class Line(NamedTuple):
    """A curve with its name and colour."""

    name: str
    colour: str
    curve: Curve


class Panel(NamedTuple):
    """Curves over one scale.

    Attributes:
        title: What they are, with the unit.
        lines: The curves.
        least: Values that the scale has at least.
    """

    title: str
    lines: tuple[Line, ...]
    least: tuple[float, float]

    def span(self) -> tuple[float, float]:
        """The scale: from the least to the largest value."""
        low, high = self.least
        for line in self.lines:
            for _, value in line.curve.points():
                if not math.isnan(value):
                    low, high = min(low, value), max(high, value)
        room = 0.04 * (high - low)
        return (low if low == self.least[0] else low - room), high + room


def panels(story: Story) -> list[Panel]:
    """What is drawn over time."""
    curves = story.curves
    return [
        Panel("Height, m", (Line("height", "#3b7dd8", curves.height_m),), (0.0, 2.0)),
        Panel(
            "Speed, m/s",
            (
                Line("over ground", "#3b7dd8", curves.ground_speed_m_s),
                Line("climb", "#e8a33d", curves.climb_m_s),
            ),
            (0.0, 1.0),
        ),
        Panel("Battery, %", (Line("charge", "#2a9d8f", curves.battery_percent),), (0.0, 100.0)),
        Panel(
            "Telemetry, packages/s", (Line("arrived", "#3b7dd8", curves.packages_per_s),), (0, 10)
        ),
        Panel(
            "Line",
            (
                Line("round trip, ms", "#e8a33d", curves.round_trip_ms),
                Line("bytes lost per s", "#d64545", curves.discarded_bytes_per_s),
            ),
            (0.0, 5.0),
        ),
    ]


def facts(story: Story) -> list[tuple[str, str]]:
    """The flight in numbers: what, and how much; what was never heard is left out."""
    most = story.maxima
    battery = None
    if most.battery_first_percent is not None:
        battery = f"{most.battery_first_percent} → {most.battery_last_percent} %"
    vertical = None
    if most.climb_m_s is not None and most.descent_m_s is not None:
        vertical = f"{max(0.0, most.climb_m_s):.1f} / {max(0.0, most.descent_m_s):.1f} m/s"
    found = [
        ("Recorded", clock(story.duration_s)),
        ("In the air", clock(most.airborne_s) if story.phases else None),
        ("Highest", _unit(most.height_m, "m")),
        ("Farthest", _unit(most.distance_m, "m")),
        ("Way over ground", _unit(most.track_m, "m")),
        ("Fastest", _unit(most.ground_speed_m_s, "m/s")),
        ("Climb / descent", vertical),
        ("Largest tilt", _unit(most.tilt_deg, "°")),
        ("Battery", battery),
        ("Longest silence", _unit(most.silence_s, "s", 2)),
        ("Repeats", str(story.repeats)),
        ("Firmware", story.firmware or "unknown"),
    ]
    return [(name, value) for name, value in found if value is not None]


def _unit(value: float | None, unit: str, digits: int = 1) -> str | None:
    return None if value is None else f"{value:.{digits}f} {unit}"


def clock(seconds: float) -> str:
    """A time as people say it: ``38.8 s``, ``2:05``, ``1:02:05``."""
    if round(seconds, 1) < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers between two others: at most so many steps of 1, 2 or 5 and zeros."""
    width = (high - low) / most
    if not 0 < width < math.inf:
        return [low]
    power = 10.0 ** math.floor(math.log10(width))
    step = next(one * power for one in (1, 2, 5, 10) if one * power >= width)
    first = math.ceil(low / step - 1e-9)
    return [n * step for n in range(first, math.floor(high / step + 1e-9) + 1)]
