"""A plan as a picture: SVG, for notebooks and pages. It takes the colours of what it stands in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate

from m100link.geodesy import LocalFrame, MapView, svg_dot, svg_line, svg_text
from m100link.geodesy import svg as drawing
from m100link.missions.checks import leg_lengths
from m100link.missions.waypoint import PlanValues, TakePhoto, Trace

_WIDTH, _MAP, _PROFILE, _EDGE = 480.0, 320.0, 90.0, 28.0
_NAMED = 30  # so many waypoints have room for their numbers


def svg(plan: PlanValues) -> str:
    """The way from above, north up and equal scales, and its heights over the way."""
    first = plan.waypoints[0]
    frame = LocalFrame(first.latitude_deg, first.longitude_deg)
    places = [frame.to_local(point.latitude_deg, point.longitude_deg) for point in plan.waypoints]
    parts = [*_from_above(plan, places), *_from_the_side(plan)]
    return drawing((_WIDTH, _MAP + _PROFILE), f"A plan of {len(places)} waypoints", parts)


def _scaled(values: Sequence[float], begin: float, end: float) -> list[float]:
    low, high = min(values), max(values)
    span = high - low or 1.0
    return [begin + (value - low) / span * (end - begin) for value in values]


def _from_above(plan: PlanValues, places: Sequence[tuple[float, float]]) -> Iterator[str]:
    view = MapView(places, (_WIDTH, _MAP), _EDGE)
    spots = [view.spot(*place) for place in places]
    yield svg_line(spots)
    for index, (spot, point) in enumerate(zip(spots, plan.waypoints, strict=True)):
        has_photo = any(isinstance(action, TakePhoto) for action in point.actions)
        fill = "currentColor" if has_photo else "none"
        yield svg_dot(spot, 4, fill, title=f"{index}: {point.height:g} m")
        if len(spots) <= _NAMED or index in (0, len(spots) - 1):
            yield svg_text((spot[0] + 6, spot[1] - 5), str(index))
    yield view.bar(8, _MAP - 2, 100)
    yield svg_text((_WIDTH - 8, 14), "N ↑", "end")
    if plan.trace is Trace.COORDINATED_TURNS:
        yield svg_text((8, 14), "corners are rounded")


def _from_the_side(plan: PlanValues) -> Iterator[str]:
    flown = list(accumulate(leg_lengths(plan.waypoints), initial=0.0))
    heights = [point.height for point in plan.waypoints]
    top, bottom = _MAP + 16, _MAP + _PROFILE - 18
    across = _scaled(flown, 44, _WIDTH - 8)
    up = _scaled(heights, bottom, top) if min(heights) < max(heights) else [top] * len(heights)
    yield svg_line(zip(across, up, strict=True))
    yield svg_text((40, top + 4), f"{max(heights):g} m", "end")
    if min(heights) < max(heights):
        yield svg_text((40, bottom + 4), f"{min(heights):g} m", "end")
    yield svg_text((_WIDTH - 8, _MAP + _PROFILE - 4), f"{flown[-1]:.0f} m", "end")
