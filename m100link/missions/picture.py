"""A plan as a picture: SVG, for notebooks and pages. It takes the colours of what it stands in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate

from m100link.geodesy import LocalFrame
from m100link.missions.checks import leg_lengths
from m100link.missions.waypoint import PlanValues, TakePhoto, Trace

__all__ = ["svg"]

Spot = tuple[float, float]

_WIDTH, _MAP, _PROFILE, _EDGE = 480.0, 320.0, 90.0, 28.0
_NAMED = 30
"""So many waypoints have room for their numbers."""
_SCALES_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)


def svg(plan: PlanValues) -> str:
    """The way from above, north up and equal scales, and its heights over the way."""
    first = plan.waypoints[0]
    frame = LocalFrame(first.latitude_deg, first.longitude_deg)
    places = [frame.to_local(point.latitude_deg, point.longitude_deg) for point in plan.waypoints]
    height = _MAP + _PROFILE
    parts = [*_from_above(plan, places), *_from_the_side(plan)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height:g}" '
        f'width="{_WIDTH:g}" style="max-width:100%;height:auto" role="img" '
        f'aria-label="A plan of {len(places)} waypoints" font-family="sans-serif" font-size="11" '
        f'fill="currentColor">{"".join(parts)}</svg>'
    )


def _scaled(values: Sequence[float], begin: float, end: float) -> list[float]:
    low, high = min(values), max(values)
    span = high - low or 1.0
    return [begin + (value - low) / span * (end - begin) for value in values]


def _line(spots: Sequence[Spot]) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in spots)
    return f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="1.5"/>'


def _text(x: float, y: float, words: str, at: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{at}">{words}</text>'


def _from_above(plan: PlanValues, places: Sequence[Spot]) -> Iterator[str]:
    norths, easts = [place[0] for place in places], [place[1] for place in places]
    north, east = max(norths) - min(norths), max(easts) - min(easts)
    room_x, room_y = _WIDTH - 2 * _EDGE, _MAP - 2 * _EDGE
    scale = min(room_x / max(east, 1.0), room_y / max(north, 1.0))
    left, top = (_WIDTH - east * scale) / 2, (_MAP - north * scale) / 2
    spots = [(left + (e - min(easts)) * scale, top + (max(norths) - n) * scale) for n, e in places]
    yield _line(spots)
    for index, ((x, y), point) in enumerate(zip(spots, plan.waypoints, strict=True)):
        has_photo = any(isinstance(action, TakePhoto) for action in point.actions)
        fill = "currentColor" if has_photo else "none"
        yield (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{fill}" stroke="currentColor">'
            f"<title>{index}: {point.height:g} m</title></circle>"
        )
        if len(spots) <= _NAMED or index in (0, len(spots) - 1):
            yield _text(x + 6, y - 5, str(index))
    metres = next((one for one in _SCALES_M if one * scale >= 40), _SCALES_M[-1])
    yield f'<path d="M8 {_MAP - 6:g}v4h{metres * scale:.1f}v-4" fill="none" stroke="currentColor"/>'
    yield _text(14 + metres * scale, _MAP - 2, f"{metres} m")
    yield _text(_WIDTH - 8, 14, "N ↑", "end")
    if plan.trace is Trace.COORDINATED_TURNS:
        yield _text(8, 14, "corners are rounded")


def _from_the_side(plan: PlanValues) -> Iterator[str]:
    flown = list(accumulate(leg_lengths(plan.waypoints), initial=0.0))
    heights = [point.height for point in plan.waypoints]
    top, bottom = _MAP + 16, _MAP + _PROFILE - 18
    across = _scaled(flown, 44, _WIDTH - 8)
    up = _scaled(heights, bottom, top) if min(heights) < max(heights) else [top] * len(heights)
    yield _line(list(zip(across, up, strict=True)))
    yield _text(40, top + 4, f"{max(heights):g} m", "end")
    if min(heights) < max(heights):
        yield _text(40, bottom + 4, f"{min(heights):g} m", "end")
    yield _text(_WIDTH - 8, _MAP + _PROFILE - 4, f"{flown[-1]:.0f} m", "end")
