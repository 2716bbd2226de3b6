"""A show as a picture: SVG. It takes the colour of its text from what it stands in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from m100link.apps.fleet.show.checks import Report, distances, places
from m100link.apps.fleet.show.document import Show

__all__ = ["svg"]

Spot = tuple[float, float]

_WIDTH, _MAP, _CURVE, _EDGE = 640.0, 420.0, 150.0, 32.0
_NAMED = 30
"""So many aircraft have room for their names."""
_SCALES_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def svg(show: Show, report: Report) -> str:
    """The tracks from above, north up and equal scales; below, the least distance over time."""
    parts = [*_from_above(show), *_apart(show, report)]
    height = _MAP + _CURVE
    label = escape(f"{show.name or 'A show'}: {len(show.tracks)} aircraft, {show.duration:g} s")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height:g}" '
        f'width="{_WIDTH:g}" style="max-width:100%;height:auto" role="img" aria-label="{label}" '
        f'font-family="sans-serif" font-size="11" fill="currentColor">{"".join(parts)}</svg>\n'
    )


def _line(spots: Sequence[Spot], colour: str, more: str = "") -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in spots)
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"{more}/>'


def _text(x: float, y: float, words: str, at: str = "start", colour: str = "currentColor") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{at}" fill="{colour}">{words}</text>'


def _colour(index: int, count: int) -> str:
    """One that is told from its neighbours, on white and on black."""
    return f"hsl({360 * index // count},70%,45%)"


def _from_above(show: Show) -> Iterator[str]:
    ways = list(zip(*(there for _, there in places(show)), strict=True))
    norths = [north for way in ways for north, _, _ in way]
    easts = [east for way in ways for _, east, _ in way]
    north, east = max(norths) - min(norths), max(easts) - min(easts)
    scale = min((_WIDTH - 2 * _EDGE) / max(east, 1.0), (_MAP - 2 * _EDGE) / max(north, 1.0))
    left, top = (_WIDTH - east * scale) / 2, (_MAP - north * scale) / 2

    def spot(place: tuple[float, float, float]) -> Spot:
        return left + (place[1] - min(easts)) * scale, top + (max(norths) - place[0]) * scale

    for index, (track, way) in enumerate(zip(show.tracks, ways, strict=True)):
        colour, spots, name = _colour(index, len(ways)), [*map(spot, way)], escape(track.name)
        yield f"<g><title>{name}</title>{_line(spots, colour)}"
        for point in track.points:
            x, y = spot(point.place)
            yield (
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colour}"><title>{name}, '
                f"{point.at:g} s: {point.height:g} m</title></circle>"
            )
        x, y = spots[0]
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="{colour}"/></g>'
        if len(ways) <= _NAMED:
            yield _text(x + 8, y - 6, name, colour=colour)
    metres = next((one for one in _SCALES_M if one * scale >= 40), _SCALES_M[-1])
    yield f'<path d="M8 {_MAP - 6:g}v4h{metres * scale:.1f}v-4" fill="none" stroke="currentColor"/>'
    yield _text(14 + metres * scale, _MAP - 2, f"{metres} m")
    yield _text(_WIDTH - 8, 14, "N ↑", "end")


def _apart(show: Show, report: Report) -> Iterator[str]:
    found, nearest = distances(show), report.closest
    if nearest is None:
        return
    highest = max(nearest.needed_m, *(distance for _, distance in found)) * 1.05
    top, bottom, first, last = _MAP + 24, _MAP + _CURVE - 22, 44.0, _WIDTH - 12

    def spot(at: float, distance: float) -> Spot:
        return (
            first + at / show.duration * (last - first),
            bottom - distance / highest * (bottom - top),
        )

    yield _text(8, top - 8, "least distance of any two, m")
    yield _line([(first, top), (first, bottom), (last, bottom)], "currentColor")
    needed = [spot(at, nearest.needed_m) for at in (0.0, show.duration)]
    yield _line(needed, "crimson", ' stroke-dasharray="5 4"')
    yield _text(last, needed[1][1] - 4, f"{nearest.needed_m:.1f} m needed", "end", "crimson")
    yield _line([spot(at, distance) for at, distance in found], "currentColor")
    x, y = spot(nearest.at, nearest.distance_m)
    words = escape(
        f"{nearest.first} and {nearest.second}: {nearest.distance_m:.1f} m at {nearest.at:.1f} s"
    )
    yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="none" stroke="currentColor"/>'
    at = "start" if x < _WIDTH / 2 else "end"
    yield _text(x + (8 if at == "start" else -8), min(y + 14, bottom - 4), words, at)
    yield _text(first - 4, top + 4, f"{highest:.0f}", "end")
    yield _text(first - 4, bottom, "0", "end")
    yield _text(last, bottom + 14, f"{show.duration:g} s", "end")
