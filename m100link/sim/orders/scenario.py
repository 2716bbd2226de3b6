"""Scenario files: what happens to an aircraft, and when.

TOML, one table per step, in any order; the words are those of :mod:`m100link.sim.orders.actions`::

    [[step]]
    at = 12.0                # seconds since power-on
    do = "rc-mode P"

    [[step]]
    at = 20.0
    do = ["faults loss=0.2", "gps 2"]
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from m100link.errors import UsageError
from m100link.sim.orders.actions import ACTIONS, perform
from m100link.sim.virtual import VirtualAircraft

__all__ = ["Scenario", "Step"]


@dataclass(frozen=True, slots=True)
class Step:
    """One order and when it is due.

    Attributes:
        at: Seconds since power-on.
        order: A line for :func:`~m100link.sim.orders.actions.perform`.
    """

    at: float
    order: str


class Scenario:
    """The steps of a scenario, in time; :meth:`advance` does those that are due."""

    def __init__(self, steps: list[Step]) -> None:
        self.steps = sorted(steps, key=lambda step: step.at)
        self._done = 0

    @classmethod
    def read(cls, path: str | Path) -> Scenario:
        """Read a file.

        Raises:
            UsageError: It is not there, is not TOML, or a step cannot be one.
        """
        try:
            content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise UsageError(f"{path}: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise UsageError(f"{path} is not TOML: {error}") from error
        steps = content.get("step", [])
        if not isinstance(steps, list) or set(content) - {"step"}:
            raise UsageError(
                f"{path}: a scenario is a list of [[step]] tables",
                remedy='[[step]]\n      at = 12.0\n      do = "rc-mode P"',
            )
        read: list[Step] = []
        for number, table in enumerate(steps, start=1):
            read += _read_step(table, f"{path}, step {number}")
        return cls(read)

    def next_due(self) -> float | None:
        """When the next step is due, None after the last."""
        return self.steps[self._done].at if self._done < len(self.steps) else None

    def advance(self, aircraft: VirtualAircraft) -> list[Step]:
        """Do what is due by now; returns the steps that were done.

        Raises:
            UsageError: A step cannot be done, such as the app taking control out of F.
        """
        done = []
        while self._done < len(self.steps):
            step = self.steps[self._done]
            if step.at > aircraft.vehicle.time + 1e-9:
                break
            self._done += 1
            perform(aircraft, step.order)
            aircraft.vehicle.log(f"scenario: {step.order}")
            done.append(step)
        return done


def _read_step(table: Any, place: str) -> list[Step]:
    if not isinstance(table, dict) or set(table) != {"at", "do"}:
        raise UsageError(f"{place}: a step has 'at' (seconds) and 'do' (an order or a list)")
    at, orders = table["at"], table["do"]
    if isinstance(at, bool) or not isinstance(at, int | float) or not 0 <= at < math.inf:
        raise UsageError(f"{place}: 'at' is seconds since power-on, not {at!r}")
    orders = [orders] if isinstance(orders, str) else orders
    if not isinstance(orders, list) or not all(isinstance(order, str) for order in orders):
        raise UsageError(f"{place}: 'do' is an order or a list of orders")
    for order in orders:
        words = order.split()
        if not words or words[0] not in ACTIONS:
            raise UsageError(
                f"{place}: there is no action called {order!r}",
                remedy=f"actions: {', '.join(ACTIONS)}",
            )
    return [Step(float(at), order) for order in orders]
