"""Telemetry for the eye: a few rows a second, each with every item that came since the last."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar

from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import FirmwareProfile
from m100link.telemetry.sample import Sample

__all__ = ["Thinned", "Thinning", "row_of"]

R = TypeVar("R", bound=tuple[Any, ...])


def row_of(sample: Sample) -> dict[str, float]:
    """The numbers of a package by their columns; a NaN stays one, which JSON tells as null."""
    return dict(zip(sample.columns, sample.row(), strict=True))


class Thinned(NamedTuple):
    """What is let through.

    Attributes:
        packages: Those whose items are in the row; the last one is that which was due.
        row: Its numbers by their columns, and when it was received.
    """

    packages: list[Sample]
    row: dict[str, float]

    def get(self, record: type[R]) -> R | None:
        """The newest record of that class, None when no package brought one."""
        found = (one.get(record) for one in reversed(self.packages))
        return next((one for one in found if one is not None), None)


class Thinning:
    """Lets some packages through.

    Items come at rates of their own: every tenth package may never have the battery. So a row
    begins with the items of the packages that were not let through, and ends with those of its own.

    Args:
        interval_s: Between two rows, at least; 0: every package.
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = 0.999 * interval_s
        self._at = -math.inf
        self._packages: list[Sample] = []  # one for each item at most
        self._flags = 0

    def hear(self, value: bytes, profile: FirmwareProfile, now: float) -> Thinned | None:
        """A package, given by its value; what is let through when that is due.

        What does not fit the profile is passed over: the link counts it.
        """
        is_due = now - self._at >= self._interval_s
        flags = int.from_bytes(value[:2], "little")
        if not is_due and not flags & ~self._flags:
            return None  # its items will come once more
        try:
            sample = Sample(value, profile, now)
        except (LayoutMismatch, IndexError):
            return None
        self._packages.append(sample)
        self._flags |= flags
        if not is_due:
            return None
        packages, self._packages, self._flags = self._packages, [], 0
        self._at = now
        row: dict[str, float] = {"received_at": now}
        for one in packages:
            row |= row_of(one)
        return Thinned(packages, row)
