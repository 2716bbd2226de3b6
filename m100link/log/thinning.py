"""Telemetry for the eye: a few rows a second, each with every item that came since the last."""

from __future__ import annotations

import math

from m100link.errors import LayoutMismatch
from m100link.protocol.firmware import FirmwareProfile
from m100link.telemetry.sample import Sample

__all__ = ["Thinning", "row_of"]


def row_of(sample: Sample) -> dict[str, float | None]:
    """The numbers of a package by their columns; None for what is not a number."""
    return {
        name: None if math.isnan(number) else number
        for name, number in zip(sample.columns, sample.row(), strict=True)
    }


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
        self._row: dict[str, float | None] = {}
        self._flags = 0

    def hear(
        self, value: bytes, profile: FirmwareProfile, now: float
    ) -> tuple[Sample, dict[str, float | None]] | None:
        """A package, given by its value; the package and its row when one is due.

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
        self._row |= row_of(sample)
        self._flags |= flags
        if not is_due:
            return None
        row, self._row, self._flags = self._row, {}, 0
        self._at = now
        return sample, {"received_at": now, **row}
