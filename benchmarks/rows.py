"""What a benchmark is made of: sides that are timed by turns, and rows that compare them.

A :class:`Side` does a piece of work and says what it cost. The sides of a program run once in each
round, in random order. A :class:`Row` makes one figure of the costs of a round, mostly one cost
divided by another, so that what slows the machine slows both. Over the rounds a row has a median
and quartiles, and a :class:`Goal` to be held against.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NamedTuple

ROUNDS = 15
QUICK_ROUNDS = 1


class NotMeasured(Exception):
    """A figure that this run does not have, and why: no compiler, a line that was too slow."""


class UnknownName(Exception):
    """A row or program that was asked for does not exist."""


class Quartiles(NamedTuple):
    """The middle of the rounds' figures, and the quarters below and above it."""

    median: float
    low: float
    high: float


def quartiles(values: Iterable[float]) -> Quartiles:
    """Median and quartiles, interpolated between the values; one value is all three."""
    found = list(values)
    if len(found) < 2:
        return Quartiles(*found * 3)
    low, median, high = statistics.quantiles(found, n=4, method="inclusive")
    return Quartiles(median, low, high)


def percentile(values: Iterable[float], part: float) -> float:
    """The value that such a part of the values does not exceed; ``part`` 0.5 is the middle."""
    found = sorted(values)
    return found[min(len(found) - 1, int(len(found) * part))]


@dataclass(frozen=True)
class Goal:
    """What a figure must reach, and what it should.

    Attributes:
        must: Missing it is a defect; None: there is no goal.
        aim: What is hoped for beyond.
        is_floor: Figures above are better; otherwise those below.
    """

    must: float | None = None
    aim: float | None = None
    is_floor: bool = True

    def verdict(self, figure: float) -> str:
        """``aim``, ``must``, ``missed``, or nothing where there is no goal."""
        for name, bound in (("aim", self.aim), ("must", self.must)):
            if bound is not None and (figure >= bound if self.is_floor else figure <= bound):
                return name
        return "" if self.must is None else "missed"


def at_least(must: float, aim: float | None = None) -> Goal:
    """A goal that figures above it reach."""
    return Goal(must, aim, is_floor=True)


def at_most(must: float, aim: float | None = None) -> Goal:
    """A goal that figures below it reach."""
    return Goal(must, aim, is_floor=False)


def belongs(cost: str, side: str) -> bool:
    """Whether a side of that name has a cost of that name, see :class:`Side`."""
    return cost == side or cost.startswith(f"{side}, ")


class Costs:
    """What the sides cost in one round.

    Args:
        ours: By name, of the tree that is judged.
        others: By name, of rivals and floors.
        today: What ``ours`` is in the other tree that ``--beside`` names; None without one.
        absent: Why a name has no cost.
    """

    def __init__(
        self,
        ours: Mapping[str, float],
        others: Mapping[str, float],
        *,
        today: Mapping[str, float] | None = None,
        absent: Mapping[str, str] | None = None,
    ) -> None:
        self._known = {**others, **ours}
        self._absent = absent or {}
        self._today = today

    @property
    def today(self) -> Costs:
        """Those of the other tree, for rows that compare with it."""
        if self._today is None:
            raise NotMeasured("needs another tree: --beside")
        return Costs(self._today, {})

    def __getitem__(self, name: str) -> float:
        if name in self._known:
            return self._known[name]
        whys = (why for side, why in self._absent.items() if belongs(name, side))
        raise NotMeasured(next(whys, f"{name!r} was not measured"))


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        name: What it says, with the direction of a ratio: ``movement command, pymavlink ÷ ours``.
        figure: Makes it of the costs of a round.
        goal: To hold the median against.
        unit: Of the figure; empty for a ratio.
    """

    name: str
    figure: Callable[[Costs], float]
    goal: Goal = Goal()
    unit: str = ""


def ratio(dividend: str, divisor: str) -> Callable[[Costs], float]:
    """One cost divided by another."""
    return lambda costs: costs[dividend] / costs[divisor]


def times(name: str, factor: float) -> Callable[[Costs], float]:
    """One cost in another unit: seconds times 1e6 are µs."""
    return lambda costs: costs[name] * factor


def beside_today(name: str) -> Callable[[Costs], float]:
    """A cost divided by the same of the other tree."""
    return lambda costs: costs[name] / costs.today[name]


@dataclass(frozen=True)
class Side:
    """One contestant.

    Attributes:
        name: What rows call its cost.
        run: Does the work once and returns what a unit of it cost, in seconds where it is time;
            several figures by name become costs named ``"side, figure"``. May raise
            :class:`NotMeasured` when the machine was too busy for this round.
        is_time: The figures are seconds; otherwise each name says what it is.
    """

    name: str
    run: Callable[[], float | Mapping[str, float]]
    is_time: bool = True

    def costs(self) -> dict[str, float]:
        """Run, with a clean heap."""
        gc.collect()
        found = self.run()
        if isinstance(found, Mapping):
            return {f"{self.name}, {part}": cost for part, cost in found.items()}
        return {self.name: found}


@dataclass(frozen=True)
class Absent:
    """A contestant that is not there, and why; ``name`` as a :class:`Side` would have it."""

    name: str
    reason: str


def timed(name: str, units: int, work: Callable[[], int]) -> Side:
    """A side that is timed by the CPU time of this thread, per unit.

    ``work`` returns how many units it handled: what is timed is checked.
    """

    def run() -> float:
        began = time.thread_time()
        handled = work()
        cost = (time.thread_time() - began) / units
        if handled != units:
            raise RuntimeError(f"{name}: {handled} of {units} came through")
        return cost

    return Side(name, run)


@dataclass(frozen=True)
class Setting:
    """What a run was asked for.

    Attributes:
        is_quick: Only show that everything works.
        codec: Program that times a decoder of another language, see :mod:`benchmarks.frames`.
    """

    is_quick: bool = False
    codec: str | None = None

    def count(self, usual: int) -> int:
        """How much work to do at once."""
        return max(4, usual // 100) if self.is_quick else usual

    def seconds(self, usual: float) -> float:
        """How long to watch what runs in real time."""
        return usual / 20 if self.is_quick else usual


Sides = Callable[[Setting, ExitStack], Iterable[Side | Absent]]


def _none(setting: Setting, stack: ExitStack) -> Iterable[Side | Absent]:
    return ()


@dataclass(frozen=True)
class Program:
    """A benchmark program.

    Attributes:
        name: Of its module in :mod:`benchmarks`.
        rows: What it adds to the table.
        ours: Prepares the sides that are ours; what must be ended goes on the stack. With
            ``--beside`` it runs in a process for each tree.
        others: Prepares rivals and floors.
        rounds: How often all sides run.
        is_pinned: Keep to one CPU: right for work of one thread, wrong where processes talk.
    """

    name: str
    rows: tuple[Row, ...]
    ours: Sides
    others: Sides = _none
    rounds: int = ROUNDS
    is_pinned: bool = True
