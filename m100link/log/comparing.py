"""What differs between two flights."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from difflib import SequenceMatcher
from statistics import fmean
from typing import NamedTuple

from m100link.log.story import Story

__all__ = ["Apart", "Comparison", "Difference", "compare"]

_STEP_S = 0.5


class Apart(NamedTuple):
    """How far two flights were apart.

    Attributes:
        after_s: Seconds after the take-off of each.
        metres: How far apart over ground, each measured from its own take-off point.
    """

    after_s: float
    metres: float


@dataclass(frozen=True)
class Difference:
    """One value of both flights.

    Attributes:
        name: What it is, with its unit at the end.
        first, second: Of each; None where it was never heard.
    """

    name: str
    first: float | None
    second: float | None

    @property
    def by(self) -> float | None:
        """The second less the first; None where one of them is not known."""
        if self.first is None or self.second is None:
            return None
        return self.second - self.first


@dataclass
class Comparison:
    """Two flights beside each other.

    Attributes:
        values: Durations, maxima and the line.
        apart: Twice a second; empty when one of them did not take off.
        commands: Lines of what was commanded: beginning with ``-`` only in the first, with ``+``
            only in the second.
        alarms: The same of alarms.
    """

    values: list[Difference] = field(default_factory=list)
    apart: list[Apart] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)

    @property
    def mean_apart_m(self) -> float | None:
        """How far apart they were in the mean."""
        return fmean(one.metres for one in self.apart) if self.apart else None

    @property
    def most_apart(self) -> Apart | None:
        """When they were farthest apart, and how far."""
        return max(self.apart, key=lambda one: one.metres) if self.apart else None


def compare(first: Story, second: Story) -> Comparison:
    """Lay two flights beside each other, aligned at their take-offs."""
    values = [Difference("duration_s", first.duration_s, second.duration_s)]
    for name in ("ground", "take-off", "flight", "landing"):
        values.append(Difference(f"{name}_s", _lasted(first, name), _lasted(second, name)))
    ours, theirs = asdict(first.maxima), asdict(second.maxima)
    values += [Difference(name, ours[name], theirs[name]) for name in ours]
    values += [
        Difference("packages", first.packages, second.packages),
        Difference("packages_per_s", _rate(first), _rate(second)),
        Difference("discarded_bytes", first.discarded_bytes, second.discarded_bytes),
        Difference("repeats", first.repeats, second.repeats),
        Difference("round_trip_ms", _mean_trip(first), _mean_trip(second)),
    ]
    return Comparison(
        values,
        list(_apart(first, second)),
        _changes([str(one) for one in first.commands], [str(one) for one in second.commands]),
        _changes([one.name for one in first.alarms], [one.name for one in second.alarms]),
    )


def _lasted(story: Story, phase: str) -> float:
    return sum(span.end_s - span.begin_s for span in story.phases if span.name == phase)


def _rate(story: Story) -> float | None:
    return story.packages / story.duration_s if story.duration_s else None


def _mean_trip(story: Story) -> float | None:
    found = [value for _, value in story.curves.round_trip_ms.points() if not math.isnan(value)]
    return fmean(found) if found else None


def _apart(first: Story, second: Story) -> Iterator[Apart]:
    one, other = first.took_off_s, second.took_off_s
    ours, theirs = first.track.places(), second.track.places()
    if one is None or other is None or not ours or not theirs:
        return
    ends = [spans[-1].end_s if spans[-1].name != "ground" else spans[-1].begin_s
            for spans in (first.phases, second.phases)]  # fmt: skip
    until = min(ends[0] - one, ends[1] - other)
    for step in range(int(until / _STEP_S) + 1):
        after = step * _STEP_S
        a, b = _place_at(ours, one + after), _place_at(theirs, other + after)
        yield Apart(after, math.hypot(a[1] - b[1], a[2] - b[2]))


def _place_at(places: list[tuple[float, float, float]], at_s: float) -> tuple[float, float, float]:
    return places[max(0, bisect_right(places, at_s, key=lambda place: place[0]) - 1)]


def _changes(first: list[str], second: list[str]) -> list[str]:
    lines: list[str] = []
    for kind, a, b, c, d in SequenceMatcher(a=first, b=second, autojunk=False).get_opcodes():
        if kind != "equal":
            lines += [f"- {line}" for line in first[a:b]]
            lines += [f"+ {line}" for line in second[c:d]]
    return lines
