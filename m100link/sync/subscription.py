"""Telemetry for programs without ``await``."""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import Generic, Self, TypeVar

from m100link.errors import M100Error, TelemetryStalled
from m100link.sync.portal import Portal
from m100link.telemetry import subscription as aio

T = TypeVar("T")


class Subscription(Generic[T]):
    """Values as they arrive: ``for sample in aircraft.telemetry(Attitude, timeout=1):``.

    Attributes:
        timeout: Seconds that iterating waits for a value; None: for ever.
    """

    def __init__(
        self,
        portal: Portal,
        subscription: aio.Subscription[T],
        timeout: float | None,
    ) -> None:
        self._portal = portal
        self._subscription = subscription
        self.timeout = timeout

    def get(self, timeout: float | None = None) -> T:
        """The next value.

        Args:
            timeout: Seconds to wait; None: for ever.

        Raises:
            TelemetryStalled: None came in time.
            LinkLost, LinkClosed, TelemetryOverflow: See :meth:`m100link.Aircraft.telemetry`.
        """
        value = self._subscription.get_nowait()
        if value is not None:
            return value

        async def take() -> T:
            async with asyncio.timeout(timeout):
                return await anext(self._subscription)

        try:
            return self._portal.wait(lambda _: take())
        except StopAsyncIteration:
            raise StopIteration from None
        except TimeoutError as error:
            if isinstance(error, M100Error):
                raise
            raise TelemetryStalled(
                f"no value came for {timeout:g} s",
                cause="the item is not sent, or the line is broken",
                remedy="see which items arrive: m100link hz",
            ) from None

    def get_nowait(self) -> T | None:
        """The next queued value, None when there is none."""
        return self._subscription.get_nowait()

    @property
    def received(self) -> int:
        """Values that were queued."""
        return self._subscription.received

    @property
    def dropped(self) -> int:
        """Values that the policy dropped."""
        return self._subscription.dropped

    @property
    def thinned(self) -> int:
        """Values left out by the rate limit."""
        return self._subscription.thinned

    def close(self) -> None:
        """Stop receiving. May be called any number of times."""
        if self._portal.is_open:
            self._portal.call(self._subscription.close)

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> T:
        return self.get(self.timeout)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
