"""Shows and tracks for tests."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

from m100link.apps.fleet.show.plan.document import Show
from m100link.apps.fleet.show.plan.track import TimedPoint, TimedTrack

ROOT = Path(__file__).parents[4]
FIVE = ROOT / "examples" / "fleet" / "five.json"
ORIGIN = 52.1, 4.31


def track(name: str, *points: tuple[float, float, float, float], **more: Any) -> TimedTrack:
    """A track from time, north, east and height of its points."""
    return TimedTrack(name, ORIGIN, tuple(TimedPoint(*point) for point in points), **more)


def row(count: int, apart: float = 10.0) -> list[TimedTrack]:
    """Tracks of so many in a row, each 16 s long: forth, up, back and down."""
    return [
        track(
            f"a{index + 1}",
            (0, 0, index * apart, 4),
            (6, 12, index * apart, 6),
            (10, 12, index * apart + 2, 6),
            (16, 0, index * apart, 4),
        )
        for index in range(count)
    ]


def random_track(chance: random.Random, name: str = "a") -> TimedTrack:
    at, points = chance.choice([0.0, chance.uniform(0, 5)]), []
    for _ in range(chance.randint(2, 7)):
        place = (chance.uniform(-30, 30), chance.uniform(-30, 30), chance.uniform(2, 20))
        points.append((at, *place))
        at += chance.uniform(0.5, 8)
    return track(name, *points)


def five() -> dict[str, Any]:
    """The example, to be changed."""
    found: dict[str, Any] = json.loads(FIVE.read_text(encoding="utf-8"))
    return found


def show_of(*tracks: TimedTrack, least: float = 3.0) -> Show:
    return Show("", tracks, least)
