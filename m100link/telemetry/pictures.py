"""What a notebook shows of telemetry: a track as a drawing."""

from __future__ import annotations

import math
from collections.abc import Iterable

__all__ = ["round_length", "track_svg"]

_SIZE, _MARGIN, _FOOT = 300.0, 12.0, 34.0
_MOST_POINTS = 600
_METRES_PER_DEGREE = 111_200.0
"""Of latitude, within half a per cent everywhere: a drawing of a flight needs no ellipsoid."""

_LEAST_M = 1.0  # what stands still is drawn as a point, not as its noise


def track_svg(places: Iterable[tuple[float, float]]) -> str:
    """A track seen from above, north up, in the colour of the text around it; empty of none.

    A ring is where it begins, a dot where it ends.

    Args:
        places: Latitude and longitude, degrees, in order; what is not a number is passed over.
    """
    known = [place for place in places if all(map(math.isfinite, place))]
    if not known:
        return ""
    (latitude, longitude), narrowing = known[0], math.cos(math.radians(known[0][0]))

    def metres(place: tuple[float, float]) -> tuple[float, float]:
        east = math.remainder(place[1] - longitude, 360.0) * narrowing
        return (place[0] - latitude) * _METRES_PER_DEGREE, east * _METRES_PER_DEGREE

    track = [metres(place) for place in known[:: 1 + len(known) // _MOST_POINTS]]
    track.append(metres(known[-1]))
    norths, easts = zip(*track, strict=True)
    extent = max(max(norths) - min(norths), max(easts) - min(easts), _LEAST_M)
    scale = _SIZE / extent

    def at(north: float, east: float) -> str:
        x = _MARGIN + (east - min(easts)) * scale
        y = _MARGIN + (max(norths) - north) * scale
        return f"{x:.1f},{y:.1f}"

    bar = round_length(extent / 2)
    foot = _MARGIN + (max(norths) - min(norths)) * scale + _FOOT
    height, width = foot + _MARGIN, _SIZE + 2 * _MARGIN
    begin, end = (at(*place).split(",") for place in (track[0], track[-1]))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" fill="none" stroke="currentColor">'
        "<title>The track from above, north up</title>"
        f'<polyline points="{" ".join(at(*place) for place in track)}" stroke-width="1.5"/>'
        f'<circle cx="{begin[0]}" cy="{begin[1]}" r="5"/>'
        f'<circle cx="{end[0]}" cy="{end[1]}" r="3" fill="currentColor"/>'
        f'<path d="M{_MARGIN:g},{foot:.1f} h{bar * scale:.1f}" stroke-width="3"/>'
        f'<text x="{_MARGIN + bar * scale + 6:.1f}" y="{foot + 4:.1f}" font-size="12" '
        f'fill="currentColor" stroke="none">{bar:g} m, north up</text></svg>'
    )


def round_length(most: float) -> float:
    """The longest of 1, 2, 5, 10, … that is not longer."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1, 2, 5) if step * power <= most)
