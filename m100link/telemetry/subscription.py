"""Telemetry for any number of consumers, each with a stated policy.

The reader of the line puts each sample into the queue of every subscription and never waits: what
happens when a consumer is slow is the consumer's choice, made when it subscribes.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from asyncio import _get_running_loop  # the other one raises where none runs
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

from m100link.errors import (
    LayoutMismatch,
    LinkError,
    M100Error,
    TelemetryOverflow,
    TelemetryStalled,
    UsageError,
)
from m100link.errors.usage import of_another_loop
from m100link.protocol.firmware import FIRMWARE_1_0, FirmwareProfile
from m100link.protocol.items import item_of
from m100link.telemetry.device_clock import DeviceClock
from m100link.telemetry.sample import AccelerationReader, Sample
from m100link.telemetry.state import AircraftState

__all__ = ["Latest", "Lossless", "Newest", "Policy", "Subscription"]

_logger = logging.getLogger(__name__)


_TOLERANCE_S = 1e-6  # a value exactly one interval after the last is not early
ANY, _NONE = -1, 0  # kinds of values

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
    """Keep the newest value only, for control loops and displays."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(1)


Policy = Newest | Lossless
"""The treatment of a consumer that is slower than the aircraft."""


class SampleQueue(Generic[T]):
    """Values that wait for one consumer; the reader of the line fills it."""

    # Slots here and in the other parts that every package passes: a process with hundreds of
    # aircraft finds each of them cold, and attributes in a place of their own cost another miss.
    __slots__ = (
        *("_next_at", "_policy", "count", "dropped", "error", "is_closed", "loop", "min_interval"),
        *("received", "thinned", "values", "waiter", "wanted"),
    )

    def __init__(
        self,
        policy: Policy,
        *,
        min_interval: float = 0.0,
        wanted: int = ANY,
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        self.loop = loop  # in which values come and are waited for; None: any
        self._policy = policy
        self.count = policy.count
        self.min_interval = min_interval
        self._next_at = float("-inf")  # the next value of the rate limit's grid is due
        # Kinds of values that are queued, a bit for each; none once the stream has ended.
        self.wanted = wanted
        self.values: deque[T] = deque()  # what waits, oldest first
        # Resolved when there is something to take; None while nobody waits for it. The hub keeps a
        # waiting consumer alive by it, as nothing else needs to.
        self.waiter: asyncio.Future[None] | None = None
        self.error: M100Error | None = None  # how the stream ends, after what is queued
        self.is_closed = False  # nobody takes values any more
        self.received = 0  # values that were queued
        self.dropped = 0  # values that the policy dropped
        self.thinned = 0  # values left out by the rate limit

    @property
    def room(self) -> int:
        """How many values it takes without losing one."""
        return self.count - len(self.values)

    def thins(self, now: float) -> bool:
        """Whether the rate limit leaves out a value that arrives now."""
        if now < self._next_at - _TOLERANCE_S:
            self.thinned += 1
            return True
        # A late value does not shift the ones after it, a long gap does not let a burst in.
        is_on_grid = now - self._next_at < self.min_interval
        self._next_at = (self._next_at if is_on_grid else now) + self.min_interval
        return False

    def make_room(self) -> bool:
        """The queue is full: drop the oldest value, or end the stream."""
        if isinstance(self._policy, Lossless):
            self.fail(
                TelemetryOverflow(
                    f"{self.count} values wait and the consumer took none",
                    cause="the consumer is slower than the aircraft, or was blocked",
                    remedy="take values faster, ask for a lower rate or another policy",
                )
            )
            return False
        self.values.popleft()
        self.dropped += 1
        return True

    def fail(self, error: M100Error) -> None:
        """End the stream with an error, after the queued values."""
        if self.error is None:
            self.error = error
            self.wanted = _NONE
            self.wake()

    def close(self) -> None:
        """Nobody takes values any more. Marks only: it is called in whichever thread."""
        self.is_closed = True
        self.wanted = _NONE

    def wake(self) -> None:
        """Let the consumer look."""
        waiter, self.waiter = self.waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(None)


class Subscription(Generic[T]):
    """A bounded queue of values, to be used as ``async with … as s: async for value in s``.

    Without ``async with`` it ends when nobody refers to it any more, as after a ``break`` out of
    ``async for value in aircraft.telemetry(…)``. A task that waits for a value does refer to it.
    """

    __slots__ = ("__weakref__", "_queue")

    def __init__(self, queue: SampleQueue[T]) -> None:
        self._queue = queue

    @property
    def received(self) -> int:
        """Values that were queued."""
        return self._queue.received

    @property
    def dropped(self) -> int:
        """Values that the policy dropped."""
        return self._queue.dropped

    @property
    def thinned(self) -> int:
        """Values left out by the rate limit."""
        return self._queue.thinned

    def get_nowait(self) -> T | None:
        """The next queued value, None when there is none."""
        values = self._queue.values
        return values.popleft() if values else None

    def close(self) -> None:
        """Stop receiving. May be called any number of times."""
        queue = self._queue
        if not queue.is_closed:
            queue.close()
            queue.values.clear()
            queue.wake()

    def __del__(self) -> None:
        # In whichever thread and at whichever moment: marks, on which the hub acts in its own.
        self._queue.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        queue = self._queue
        while not queue.values:
            if queue.is_closed:
                raise StopAsyncIteration
            if queue.error is not None:
                raise queue.error.again()
            if queue.waiter is not None and not queue.waiter.done():
                raise RuntimeError("two tasks iterate over one subscription; give each its own")
            loop = asyncio.get_running_loop()
            if queue.loop is not loop and queue.loop is not None:
                raise of_another_loop()
            queue.waiter = loop.create_future()
            await queue.waiter
        return queue.values.popleft()


class Hub(Generic[T]):
    """Gives each value to every subscription.

    It holds the queues and not the subscriptions: those belong to their consumers, and a queue
    that has ended, or whose subscription is gone, is dropped with the next value.
    """

    __slots__ = ("_error", "_loop", "_queues")

    def __init__(self) -> None:
        self._loop = _get_running_loop()
        # A tuple: what happens while a value is handed out makes a new one.
        self._queues: tuple[SampleQueue[T], ...] = ()
        self._error: M100Error | None = None  # of the line, for those who come later

    def subscribe(
        self,
        policy: Policy,
        *,
        min_interval: float = 0.0,
        wanted: int = ANY,
    ) -> Subscription[T]:
        """A new subscription for values of the kinds whose bits are in ``wanted``."""
        queue: SampleQueue[T] = SampleQueue(
            policy, min_interval=min_interval, wanted=wanted, loop=self._loop
        )
        if self._error is not None:
            queue.fail(self._error)
        self._queues = (*(other for other in self._queues if other.wanted), queue)
        return Subscription(queue)

    def publish(self, value: T, now: float, kinds: int = ANY) -> None:
        """Queue the value wherever one of its kinds is wanted, as the policy says.

        Called by the reader of the line: never waits or raises.
        """
        has_any_ended = False
        for queue in self._queues:
            if not queue.wanted & kinds:
                has_any_ended = has_any_ended or not queue.wanted
                continue
            if queue.min_interval and queue.thins(now):
                continue
            queue.received += 1
            values = queue.values
            if len(values) < queue.count or queue.make_room():
                values.append(value)
                if queue.waiter is not None:
                    queue.wake()
        if has_any_ended:
            self._queues = tuple(queue for queue in self._queues if queue.wanted)

    @property
    def has_consumers(self) -> bool:
        """Whether somebody takes values."""
        return any(queue.wanted for queue in self._queues)

    @property
    def room(self) -> float:
        """How many values every queue takes without losing one; infinite without any."""
        return min((queue.room for queue in self._queues if queue.wanted), default=math.inf)

    def fail(self, error: M100Error) -> None:
        """End every subscription, present and future, with the error."""
        self._error = error
        for queue in self._queues:
            queue.fail(error)


# -- the telemetry of one aircraft: read once, kept as the newest state, handed to all ------------


_PACKAGE = 1 << 16  # what a package with no item is, for those who want every package


class TelemetryStream:
    """Takes packages as they arrive."""

    __slots__ = (
        *("_clock", "_firmware", "_observe"),
        *("acceleration", "hub", "mismatches", "state", "utc_offset_s"),
    )

    def __init__(
        self,
        observe: Callable[[Sample], None],
        clock: Callable[[], float],
        acceleration: AccelerationReader | None = None,
    ) -> None:
        # Called with each package when state and clock know it, before the consumers.
        self._observe = observe
        self.acceleration = acceleration or AccelerationReader()
        self.state = AircraftState(clock)  # newest value and age of every item
        self.mismatches = 0  # packages refused because they do not fit the firmware profile
        # Once: a wall clock that is set during a flight must not bend its columns.
        self.utc_offset_s = time.time() - clock()  # see :attr:`m100link.Aircraft.utc_offset_s`
        self.hub: Hub[Sample] = Hub()  # the consumers
        # The firmware by which packages were read, or the clock was asked for, last.
        self._firmware = FIRMWARE_1_0
        self._clock = DeviceClock(FIRMWARE_1_0.tick_hz)  # by which packages arrive, s

    def forget(self) -> None:
        """Begin anew: a recording goes on from another place."""
        self.state.forget()
        self._clock = DeviceClock(self._clock.tick_hz)

    def clock_of(self, firmware: FirmwareProfile) -> DeviceClock:
        """The clock of the aircraft; a firmware with another tick rate begins a new one."""
        if firmware is not self._firmware:
            self._firmware = firmware
            if firmware.tick_hz != self._clock.tick_hz:
                self._clock = DeviceClock(firmware.tick_hz)
        return self._clock

    def receive(self, value: bytes, firmware: FirmwareProfile, now: float) -> None:
        """A package arrived now: state, clock and authority read it, then every consumer.

        One that does not fit the firmware is counted, and the first of them logged.
        """
        if not self.acceleration.is_idle:
            value = self.acceleration.read(value, firmware, now)
        try:
            sample = Sample(value, firmware, now)
        except LayoutMismatch as error:
            self.mismatches += 1
            if self.mismatches == 1:
                _logger.warning("telemetry refused: %s", error)
            return
        self.state.update(sample)
        plan = sample._plan
        tick, observe = plan.tick, self._observe
        if tick is not None:
            # Of its record, which costs ten times as much, the clock wants nothing else.
            clock = self._clock if firmware is self._firmware else self.clock_of(firmware)
            clock.update(tick(value)[0], now)
        observe(sample)
        self.hub.publish(sample, now, plan.flags or _PACKAGE)

    def subscribe(
        self, records: Sequence[type[Any]], policy: Policy, rate_hz: float | None
    ) -> Subscription[Sample]:
        """See :meth:`m100link.Aircraft.telemetry`."""
        wanted = 0
        for record in records:
            wanted |= 1 << item_of(record).bit
        if rate_hz is not None and not rate_hz > 0:
            raise UsageError(f"a rate of {rate_hz} Hz is not a rate")
        return self.hub.subscribe(
            policy,
            min_interval=1.0 / rate_hz if rate_hz else 0.0,
            wanted=wanted or ANY,
        )

    async def wait_for(
        self, predicate: Callable[[AircraftState], bool], timeout: float | None, what: str
    ) -> None:
        """See :meth:`m100link.Aircraft.wait_for`."""
        if predicate(self.state):
            return
        try:
            async with asyncio.timeout(timeout), self.subscribe((), Latest(), None) as samples:
                async for _ in samples:
                    if predicate(self.state):
                        return
        except TimeoutError as error:
            if isinstance(error, LinkError):
                raise
            raise TelemetryStalled(
                f"{what} was not seen within {timeout:g} s; now: {self.state.situation()}",
                cause="it did not happen, or the items that show it are not sent",
                remedy="see which items arrive: m100link hz",
            ) from None
