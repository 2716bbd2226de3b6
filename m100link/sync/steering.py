"""Ticks, and what is held while a block runs, for programs without ``await``."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from types import TracebackType
from typing import Self

from m100link.aircraft import gimbal
from m100link.flight import pacing, setpoints
from m100link.flight.pacing import Tick
from m100link.protocol.setpoint import Setpoint
from m100link.sync.portal import Caller, Portal

__all__ = ["GimbalRates", "Hold", "Ticks", "asked"]


class Ticks:
    """Ticks at a steady rate: ``for tick in control.ticks(20):``."""

    def __init__(self, portal: Portal, ticker: pacing.Ticker) -> None:
        self._portal = portal
        self._ticker = ticker

    @property
    def period(self) -> float:
        """Seconds between ticks."""
        return self._ticker.period

    @property
    def missed(self) -> int:
        """Deadlines skipped in all."""
        return self._ticker.missed

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Tick:
        return self._portal.wait(lambda _: self._ticker.__anext__())


class Hold:
    """A setpoint that is being sent while a ``with`` block runs; :meth:`set` renews it."""

    def __init__(
        self, portal: Portal, holding: AbstractAsyncContextManager[setpoints.Hold]
    ) -> None:
        self._portal = portal
        self._holding = holding
        self._hold: setpoints.Hold | None = None  # while the block runs

    def set(self, setpoint: Setpoint) -> None:
        """Send this setpoint from now on, for another lifetime.

        Raises:
            NoAuthority, GuardRefused, BadSetpoint: See :meth:`Control.send`.
        """
        assert self._hold is not None, "use it inside its `with` block"
        self._portal.call(self._hold.set, setpoint)

    def __enter__(self) -> Self:
        self._hold = self._portal.wait(lambda _: self._holding.__aenter__())
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._portal.wait(lambda _: self._holding.__aexit__(exc_type, exc, traceback))


class GimbalRates:
    """Angular rates that are repeated while a ``with`` block runs; :meth:`set` replaces them."""

    def __init__(
        self, portal: Portal, holding: AbstractAsyncContextManager[gimbal.GimbalRates]
    ) -> None:
        self._portal = portal
        self._holding = holding
        self._rates: gimbal.GimbalRates | None = None  # while the block runs

    def set(self, *, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> None:
        """Turn at these rates from the next repetition on, within 0.1 s.

        Raises:
            UsageError: Beyond 180 degrees per second, or not a number.
        """
        assert self._rates is not None, "use it inside its `with` block"
        self._portal.call(self._rates.set, yaw=yaw, pitch=pitch, roll=roll)

    def __enter__(self) -> Self:
        self._rates = self._portal.wait(lambda _: self._holding.__aenter__())
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._portal.wait(lambda _: self._holding.__aexit__(exc_type, exc, traceback))


async def asked(
    caller: Caller, source: Callable[[Tick], Setpoint | None], ticks: pacing.Ticker
) -> AsyncIterator[Setpoint]:
    """At each tick what ``source`` says in the thread of the caller, until that is None."""
    async for tick in ticks:
        wanted = await caller.ask(source, tick)
        if wanted is None:
            return
        yield wanted
