"""Telemetry for any number of consumers, each with a stated policy.

The reader of the line puts each sample into the queue of every subscription and never waits: what
happens when a consumer is slow is the consumer's choice, made when it subscribes.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Self, TypeVar

from m100link.errors import M100Error, TelemetryOverflow, UsageError

__all__ = [
    "Latest",
    "Lossless",
    "Newest",
    "Policy",
    "Subscription",
]

_TOLERANCE_S = 1e-6  # a value exactly one interval after the last is not early

T = TypeVar("T")


def _check_count(count: int) -> None:
    if count < 1:
        raise UsageError(f"a queue for {count} values keeps none", remedy="1 or more")


@dataclass(frozen=True, slots=True)
class Newest:
    """Keep the newest ``count`` values, 1 or more; older ones are dropped and counted."""

    count: int

    def __post_init__(self) -> None:
        _check_count(self.count)


@dataclass(frozen=True, slots=True)
class Lossless:
    """Keep every value; more than ``count`` waiting ends the subscription with an error."""

    count: int = 1000

    def __post_init__(self) -> None:
        _check_count(self.count)


class Latest(Newest):
    """Keep the newest value only: what control loops and displays want."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(1)


Policy = Newest | Lossless
"""What happens when a consumer is slower than the aircraft."""


class Subscription(Generic[T]):
    """A bounded queue of values, to be used as ``async with … as s: async for value in s``.

    Attributes:
        received: Values that were queued.
        dropped: Values that the policy dropped.
        thinned: Values left out by the rate limit.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        min_interval: float = 0.0,
        on_close: Callable[[Subscription[T]], None] | None = None,
    ) -> None:
        self._policy = policy
        self._min_interval = min_interval
        self._on_close = on_close
        self._queue: deque[T] = deque()
        self._waiter: asyncio.Future[None] | None = None
        self._error: M100Error | None = None
        self._is_closed = False
        self._next_at = float("-inf")
        self.received = 0
        self.dropped = 0
        self.thinned = 0

    def put(self, value: T, now: float) -> None:
        """Queue a value, as the policy says. Called by the reader; never waits, never raises."""
        if self._is_closed or self._error is not None:
            return
        if self._min_interval:
            if now < self._next_at - _TOLERANCE_S:
                self.thinned += 1
                return
            # A late value does not shift the ones after it, a long gap does not let a burst in.
            is_on_grid = now - self._next_at < self._min_interval
            self._next_at = (self._next_at if is_on_grid else now) + self._min_interval
        self.received += 1
        if len(self._queue) >= self._policy.count:
            if isinstance(self._policy, Lossless):
                self.fail(
                    TelemetryOverflow(
                        f"{self._policy.count} values wait and the consumer took none",
                        cause="the consumer is slower than the aircraft, or was blocked",
                        remedy="take values faster, ask for a lower rate or another policy",
                    )
                )
                return
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(value)
        self._wake()

    def fail(self, error: M100Error) -> None:
        """End the stream with an error, after what is queued."""
        if self._error is None:
            self._error = error
            self._wake()

    def get_nowait(self) -> T | None:
        """The next queued value, None when there is none."""
        return self._queue.popleft() if self._queue else None

    def close(self) -> None:
        """Stop receiving. May be called any number of times."""
        if not self._is_closed:
            self._is_closed = True
            self._queue.clear()
            if self._on_close is not None:
                self._on_close(self)
            self._wake()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        while not self._queue:
            if self._is_closed:
                raise StopAsyncIteration
            if self._error is not None:
                raise self._error
            if self._waiter is not None and not self._waiter.done():
                raise RuntimeError("two tasks iterate over one subscription; give each its own")
            self._waiter = asyncio.get_running_loop().create_future()
            await self._waiter
        return self._queue.popleft()


class Hub(Generic[T]):
    """Gives each value to every subscription."""

    def __init__(self) -> None:
        self._subscriptions: dict[Subscription[T], Callable[[T], bool] | None] = {}
        self._error: M100Error | None = None

    def subscribe(
        self,
        policy: Policy,
        *,
        min_interval: float = 0.0,
        accepts: Callable[[T], bool] | None = None,
    ) -> Subscription[T]:
        """A new subscription for the values that ``accepts`` accepts."""
        subscription: Subscription[T] = Subscription(
            policy, min_interval=min_interval, on_close=self._drop
        )
        if self._error is not None:
            subscription.fail(self._error)
        self._subscriptions[subscription] = accepts
        return subscription

    def _drop(self, subscription: Subscription[T]) -> None:
        self._subscriptions.pop(subscription, None)

    def publish(self, value: T, now: float) -> None:
        """Queue the value everywhere."""
        for subscription, accepts in self._subscriptions.items():
            if accepts is None or accepts(value):
                subscription.put(value, now)

    def fail(self, error: M100Error) -> None:
        """End every subscription, present and future, with the error."""
        self._error = error
        for subscription in self._subscriptions:
            subscription.fail(error)
