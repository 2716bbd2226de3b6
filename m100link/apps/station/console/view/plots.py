"""Plots: which numbers can be drawn, what each is called, and the chart that draws them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from m100link.apps.station.console.history import COLUMNS, INTERVAL
from m100link.apps.station.console.view.units import Kind, Units
from m100link.apps.station.console.view.words import Speaker, Text

__all__ = [
    "FIRST_CHOICE",
    "MOST",
    "RANGES",
    "chart",
    "height",
    "kind",
    "known",
    "label",
    "points",
    "step",
]

FIRST_CHOICE = (
    *("position.height_m", "velocity.ground_speed_m_s"),
    *("angular_velocity.yaw_rate_deg_s", "line.packages_per_s"),
)
"""What is drawn until somebody chooses."""

MOST = 6
"""Numbers that are drawn at once: more is not read, and costs the browser."""

RANGES = {30: "30 s", 60: "1 min", 120: "2 min", 300: "5 min", 600: "10 min"}
"""Seconds that a chart shows, and what that is called."""

_MOST_POINTS = 600  # of a line: more than pixels are not seen

_UNITS = (
    ("_m_s2", "m/s²"),
    ("_deg_s", "°/s"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_per_s", "1/s"),
    ("_percent", "%"),
    ("_deg", "°"),
    ("_rad", "rad"),
    ("_ms", "ms"),
    ("_hz", "Hz"),
    ("_m", "m"),
)

_TOP, _HEIGHT, _GAP = 28, 88, 40  # of each line's own stripe, in pixels
_COLOURS = ("#1e88e5", "#e53935", "#43a047", "#fb8c00", "#8e24aa", "#00897b")


def kind(name: str) -> Kind | None:
    """What a column measures, where the operator chooses the unit."""
    sign = _sign(name)
    return next((one for one in Kind if one.value == sign), None)


def _sign(name: str) -> str:
    if name.endswith(".percent"):
        return "%"
    return next((told for end, told in _UNITS if name.endswith(end)), "")


def label(name: str) -> Text:
    """A column for people: ``position: height, m``."""
    item, _, field = name.partition(".")
    sign = _sign(name)
    end = next((end for end, _ in _UNITS if field.endswith(end)), "")
    if field == "tick_hz":  # else it would be called as the tick itself
        end = ""
    values: dict[str, object] = {
        "item": Text(f"plots.item.{item}"),
        "field": Text(f"plots.field.{field.removesuffix(end)}"),
    }
    if not sign:
        return Text("plots.label", values)
    return Text("plots.label_unit", values | {"unit": kind(name) or sign})


def step(seconds: float) -> int:
    """Every how many rows of the history is drawn, so that a line has not too many points."""
    return max(1, math.ceil(seconds / INTERVAL / _MOST_POINTS))


def known(names: Iterable[str]) -> list[str]:
    """Those of the names that can be drawn, each once, at most :data:`MOST`."""
    return [name for name in dict.fromkeys(names) if name in COLUMNS][:MOST]


def points(
    rows: Sequence[tuple[float, ...]], names: Sequence[str], units: Units
) -> list[list[float | None]]:
    """Rows as the page takes them.

    Args:
        rows: Seconds since 1970, and a value for each name; not a number where there is none.
        names: The columns.
        units: What lengths and speeds are drawn in.

    Returns:
        Milliseconds since 1970, and values of six digits; None where there is none.
    """
    kinds = [kind(name) for name in names]
    factors = [1.0 if one is None else units.convert(1.0, one) for one in kinds]
    return [
        [
            round(1000.0 * utc),
            *(
                float(f"{factor * value:.6g}") if math.isfinite(value) else None
                for value, factor in zip(values, factors, strict=True)
            ),
        ]
        for utc, *values in rows
    ]


def chart(names: Sequence[str], speaker: Speaker) -> dict[str, Any]:
    """The options of an ECharts chart: a stripe for each number, one time and one cursor for all.

    Its points come later, by ``static/plots.js``: only what is new goes to the page.
    """
    stripes = range(len(names))
    labels = [speaker(label(name)) for name in names]
    return {
        "animation": False,
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "tooltip": {"trigger": "axis", "axisPointer": {"type": "cross"}},
        "dataZoom": [{"type": "inside", "xAxisIndex": list(stripes), "filterMode": "none"}],
        "grid": [
            {"left": 62, "right": 14, "top": _TOP + n * (_HEIGHT + _GAP), "height": _HEIGHT}
            for n in stripes
        ],
        "xAxis": [
            {
                "type": "time",
                "gridIndex": n,
                # A narrow chart has room for few times; they would be written over each other.
                "axisLabel": {"show": n == len(names) - 1, "hideOverlap": True},
            }
            for n in stripes
        ],
        "yAxis": [
            {
                "type": "value",
                "gridIndex": n,
                "scale": True,
                "name": labels[n],
                "nameGap": 12,
                "nameTextStyle": {"align": "left", "padding": [0, 0, 0, -54]},
                "splitNumber": 3,
            }
            for n in stripes
        ],
        "series": [
            {
                "type": "line",
                "name": labels[n],
                "xAxisIndex": n,
                "yAxisIndex": n,
                "showSymbol": False,
                "connectNulls": False,
                "lineStyle": {"width": 1.5},
                "color": _COLOURS[n % len(_COLOURS)],
                "data": [],
            }
            for n in stripes
        ],
    }


def height(names: Sequence[str]) -> int:
    """Pixels that a chart of so many stripes needs."""
    return _TOP + max(1, len(names)) * (_HEIGHT + _GAP) + 10
