"""What sensors get wrong: white noise, and errors that wander."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

__all__ = ["Wander", "noise_source"]

_AXES = 3
_TABLE = 4093  # prime, so that the columns of a packet do not repeat together


def noise_source(random: Random) -> Callable[[], list[float]]:
    """A function that returns three samples of normal noise of unit variance, one for each axis.

    Out of a table: repeatable, and ten times as fast as drawing each sample.
    """
    table = [random.gauss(0.0, 1.0) for _ in range(_TABLE)]
    table += table[:_AXES]
    position = 0

    def sample() -> list[float]:
        nonlocal position
        begin = position + 1
        position = (position + _AXES) % _TABLE
        return table[begin : begin + _AXES]

    return sample


class Wander:
    """A first-order Gauss-Markov process: an error with a memory.

    Over a time t short against the memory it changes by deviation x sqrt(2 t / memory).

    Args:
        random: Where it gets its chance from.
        deviation: Standard deviation in the long run.
        memory_s: Seconds after which 1/e of an error is left.
        step_s: Time from one :meth:`advance` to the next.

    Attributes:
        value: The error now.
    """

    __slots__ = ("_keep", "_kick", "_random", "value")

    def __init__(self, random: Random, deviation: float, memory_s: float, step_s: float) -> None:
        self._random = random
        self._keep = math.exp(-step_s / memory_s)
        self._kick = deviation * math.sqrt(1.0 - self._keep**2)
        self.value = 0.0

    def advance(self) -> None:
        """Let one step pass."""
        self.value = self._keep * self.value + self._kick * self._random.gauss(0.0, 1.0)
