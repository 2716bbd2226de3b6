"""Points to fly through: a survey over a polygon, and how long a way is.

Plain numbers in metres north and east of an origin, heights above take-off: what
:meth:`m100link.Control.fly_path` takes, which checks every point against the envelope before it
starts. Nothing here knows an aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from m100link.errors import UsageError

__all__ = ["length_m", "survey"]

_MAX_LINES = 1000  # more are a mistake in the units

Point = tuple[float, float, float]


def survey(
    polygon: Sequence[tuple[float, float]],
    *,
    spacing: float,
    height: float,
    angle_deg: float = 0.0,
    start: tuple[float, float] = (0.0, 0.0),
) -> list[Point]:
    """Parallel lines over a polygon, to and fro.

    >>> field = [(0, 0), (0, 30), (20, 30), (20, 0)]
    >>> for point in survey(field, spacing=15, height=12):
    ...     print(point)
    (0.0, 7.5, 12)
    (20.0, 7.5, 12)
    (20.0, 22.5, 12)
    (0.0, 22.5, 12)

    Args:
        polygon: Its corners in order, metres north and east, 3 or more; edges must not cross. It
            may be concave: the way between two parts of a line then leads outside of it.
        spacing: Between lines, m; they lie half of it from the edges, or nearer.
        height: Above take-off, m.
        angle_deg: Direction of the lines, ° clockwise from north.
        start: Where the aircraft comes from: the pattern begins at its end nearest to that.

    Returns:
        The ends of the lines, north, east and height.

    Raises:
        UsageError: No polygon, a spacing that makes no lines or more than 1000, an area of nothing.
    """
    _check(polygon, spacing, height, angle_deg)
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    # Along the lines and across them.
    turned = [(n * cosine + e * sine, e * cosine - n * sine) for n, e in polygon]
    low, high = min(across for _, across in turned), max(across for _, across in turned)
    # By rounding, a width of whole spacings must not get a line more.
    count = max(1, math.ceil((high - low) / spacing - 1e-9))
    if high - low < 1e-6 or count > _MAX_LINES:
        raise UsageError(
            f"lines {spacing:g} m apart over {high - low:g} m make no survey",
            remedy=f"a polygon with an area, in metres, and at most {_MAX_LINES} lines",
        )
    gap = (high - low) / count
    lines = [_crossings(turned, low + (index + 0.5) * gap) for index in range(count)]
    ways = [_to_and_fro(order) for order in (lines, lines[::-1])]
    ways += [_to_and_fro([line[::-1] for line in order]) for order in (lines, lines[::-1])]
    flat = [
        [(a * cosine - c * sine, a * sine + c * cosine, height) for a, c in way] for way in ways
    ]
    return min(flat, key=lambda way: math.dist(way[0][:2], start))


def _check(
    polygon: Sequence[tuple[float, float]], spacing: float, height: float, angle_deg: float
) -> None:
    if len(polygon) < 3:
        raise UsageError(f"{len(polygon)} corners make no polygon", remedy="3 or more")
    numbers = [*(value for corner in polygon for value in corner), height]
    if not all(map(math.isfinite, numbers)):
        raise UsageError("a corner or the height is not finite", remedy="give numbers of metres")
    if not 0 < spacing < math.inf:
        raise UsageError(f"lines cannot be {spacing:g} m apart", remedy="more than 0")
    if not math.isfinite(angle_deg):
        raise UsageError(f"lines cannot have the direction {angle_deg:g}°", remedy="0 to 360°")


def _crossings(corners: Sequence[tuple[float, float]], across: float) -> list[tuple[float, float]]:
    """Where a line enters and leaves the polygon, in its order."""
    found = []
    for (a1, c1), (a2, c2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        # One end of an edge belongs to it: a line through a corner crosses there once.
        if (c1 <= across) != (c2 <= across):
            found.append(a1 + (a2 - a1) * (across - c1) / (c2 - c1))
    return [(along, across) for along in sorted(found)]


def _to_and_fro(lines: Sequence[list[tuple[float, float]]]) -> list[tuple[float, float]]:
    return [
        point
        for index, line in enumerate(line for line in lines if line)
        for point in (line[::-1] if index % 2 else line)
    ]


def length_m(points: Sequence[Point]) -> float:
    """Length of the way through the points, climbs included, m.

    >>> length_m([(0, 0, 0), (3, 4, 0), (3, 4, 2)])
    7.0
    """
    return sum(math.dist(here, there) for here, there in pairwise(points))
