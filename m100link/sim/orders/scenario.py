"""Scenario files: what happens to an aircraft, and when.

TOML, one table per step, in any order; the words are those of :mod:`m100link.sim.orders.actions`::

    [[step]]
    at = 12.0                # seconds since power-on
    do = "rc-mode P"

    [[step]]
    at = 20.0
    do = ["faults loss=0.2", "gps 2"]

    [[step]]
    when = "waypoint 3"      # a mission reaches its waypoint 3, counted from 0, for the first time
    after = 2.0              # seconds later; without it, at once
    do = "rc-off"
"""

from __future__ import annotations

import math
import re
from bisect import insort
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from m100link.errors import UsageError
from m100link.errors.texts import read_toml
from m100link.sim.orders.actions import ACTIONS, perform
from m100link.sim.virtual import VirtualAircraft

__all__ = ["Scenario", "Step"]

_WAYPOINT = re.compile(r"[0-9]{1,6}")
_EVENT = "waypoint"


@dataclass(frozen=True, slots=True)
class Step:
    """One order and when it is due.

    Attributes:
        at: Seconds since power-on, or since the waypoint was reached.
        order: A line for :func:`~m100link.sim.orders.actions.perform`.
        waypoint: The waypoint whose reaching it waits for, None when the time alone decides.
    """

    at: float
    order: str
    waypoint: int | None = None


class Scenario:
    """The steps of a scenario, in time; :meth:`advance` does those that are due."""

    def __init__(self, steps: list[Step]) -> None:
        self.steps = sorted(
            (step for step in steps if step.waypoint is None), key=lambda step: step.at
        )
        self._done = 0
        # Steps whose waypoint was not reached yet, and how many arrivals were looked at.
        self._waiting = [step for step in steps if step.waypoint is not None]
        self._seen = 0

    @classmethod
    def read(cls, path: str | Path) -> Scenario:
        """Read a file.

        Raises:
            UsageError: It is not there, is not TOML, or a step cannot be one.
        """
        try:
            content = read_toml(Path(path).read_bytes())
        except OSError as error:
            raise UsageError(f"{path}: {error.strerror}") from error
        except ValueError as error:
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
        """When the next step with a time is due, None when there is none."""
        return self.steps[self._done].at if self._done < len(self.steps) else None

    def advance(self, aircraft: VirtualAircraft) -> list[Step]:
        """Do what is due by now; returns the steps that were done.

        Raises:
            UsageError: A step cannot be done, such as the app taking control out of F.
        """
        if self._waiting:
            self._look_at_arrivals(aircraft)
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

    def _look_at_arrivals(self, aircraft: VirtualAircraft) -> None:
        """Give a time to the steps whose waypoint was reached."""
        arrivals = aircraft.vehicle.missions.arrivals
        new = set(arrivals[self._seen :])
        self._seen = len(arrivals)
        for step in [step for step in self._waiting if step.waypoint in new]:
            self._waiting.remove(step)
            due = replace(step, at=aircraft.vehicle.time + step.at)
            insort(self.steps, due, lo=self._done, key=lambda each: each.at)


def _time(value: Any, name: str, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise UsageError(f"{place}: {name!r} is seconds, not {value!r}")
    return float(value)


def _read_step(table: Any, place: str) -> list[Step]:
    keys = set(table) if isinstance(table, dict) else set()
    if keys not in ({"at", "do"}, {"when", "do"}, {"when", "after", "do"}):
        raise UsageError(
            f"{place}: a step has 'do' (an order or a list), and 'at' (seconds since power-on) or "
            "'when' (\"waypoint 3\") with 'after' (seconds) if that is not at once"
        )
    name = "at" if "at" in keys else "after"
    at, waypoint = _time(table.get(name, 0.0), name, place), None
    if "when" in keys:
        words = str(table["when"]).split()
        if len(words) != 2 or words[0] != _EVENT or not _WAYPOINT.fullmatch(words[1]):
            raise UsageError(f"{place}: 'when' is \"waypoint 3\", not {table['when']!r}")
        waypoint = int(words[1])
    orders = table["do"]
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
    return [Step(at, order, waypoint) for order in orders]
