"""What goes on on board when a verb of the fleet is ended by Ctrl-C, and how to see and end it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from m100link.apps.cli.common import err
from m100link.apps.fleet.client import FleetAircraft
from m100link.apps.fleet.outcome import Result
from m100link.errors import M100Error, OutcomeUnknown

__all__ = ["Begun", "Left", "told_when_interrupted"]


@dataclass(frozen=True, slots=True)
class Left:
    """What an order leaves behind that was given, and whose end nobody waited for.

    Attributes:
        seen: What goes on, or ends.
        remedy: How to see it and how to end it, with ``{name}`` for the aircraft.
    """

    seen: str
    remedy: str

    def of(self, name: str) -> Result:
        """What is told of one aircraft: nobody knows what became of the order."""
        remedy = self.remedy.format(name=name)
        return Result.of(name, OutcomeUnknown(f"interrupted: {self.seen}", remedy=remedy))


class Begun:
    """What was asked of several aircraft, and what of it has ended.

    Args:
        do: What is asked of each.
        left: What it leaves behind.
    """

    def __init__(self, do: Callable[[FleetAircraft], Awaitable[object]], left: Left) -> None:
        self._do, self._left = do, left
        self._results: dict[str, Result] = {}

    async def __call__(self, aircraft: FleetAircraft) -> object:
        """Ask one.

        Raises: as what is done.
        """
        name = aircraft.name
        self._results[name] = self._left.of(name)
        try:
            value = await self._do(aircraft)
        except M100Error as error:
            self._results[name] = Result.of(name, error)
            raise
        self._results[name] = Result.of(name, None, value)
        return value

    @property
    def results(self) -> dict[str, Result]:
        """What is known of each that was asked."""
        return dict(self._results)


@contextmanager
def told_when_interrupted(name: str, left: Left) -> Iterator[None]:
    """Tell what one order leaves behind, if the block is ended by Ctrl-C."""
    try:
        yield
    except asyncio.CancelledError:
        result = left.of(name)
        if result.error is not None:
            err.print(f"{name}: {result.error.seen}", markup=False, soft_wrap=True)
            err.print(result.error.remedy, markup=False, soft_wrap=True)
        raise
