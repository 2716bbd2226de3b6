"""Telemetry for any number of consumers, each with a stated policy.

The reader of the line puts each sample into the queue of every subscription and never waits: what
happens when a consumer is slow is the consumer's choice, made when it subscribes.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from m100link.errors import M100Error, TelemetryOverflow, UsageError
from m100link.protocol.firmware import ITEM_NAMES, FirmwareProfile
from m100link.protocol.telemetry import (
    RECORDS,
    Acceleration,
    AngularVelocity,
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Gimbal,
    Magnetometer,
    Position,
    RemoteControl,
    TelemetryPacket,
    Time,
    Velocity,
)

__all__ = [
    "AircraftState",
    "ItemStatistics",
    "Latest",
    "Lossless",
    "Newest",
    "Policy",
    "Sample",
    "Subscription",
]

_TOLERANCE_S = 1e-6  # a value exactly one interval after the last is not early

T = TypeVar("T")
R = TypeVar("R", bound=tuple[Any, ...])


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


class Sample(TelemetryPacket):
    """One telemetry package and when it arrived.

    Items are read when asked for: ``sample.attitude`` is None when the package has none,
    ``sample[Attitude]`` raises instead.

    Attributes:
        received_at: Time of arrival on the event loop's clock, s.
    """

    __slots__ = ("received_at",)

    def __init__(self, value: bytes, profile: FirmwareProfile, received_at: float) -> None:
        super().__init__(value, profile)
        self.received_at = received_at

    def __getitem__(self, record: type[R]) -> R:
        """The record of that class.

        Raises:
            KeyError: The package does not carry it.
        """
        found = self.get(record)
        if found is None:
            raise KeyError(record.__name__)
        return found


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


class AircraftState:
    """The newest value of every telemetry item.

    An item that never arrived is None, never zero. Every value knows its age.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._samples: list[Sample | None] = [None] * len(ITEM_NAMES)
        self._statistics = [ItemStatistics(name) for name in ITEM_NAMES]
        self._newest_at: float | None = None

    def update(self, sample: Sample) -> None:
        """Take over what the sample carries."""
        self._newest_at = sample.received_at
        for index in sample.indices:
            self._samples[index] = sample
            self._statistics[index].count_arrival(sample.received_at)

    def get(self, record: type[R]) -> R | None:
        """The newest record of that class, None when it never arrived."""
        sample = self._samples[RECORDS.index(record)]
        return None if sample is None else sample.get(record)

    def received_at(self, record: type[Any]) -> float | None:
        """When the newest record arrived, on the event loop's clock."""
        sample = self._samples[RECORDS.index(record)]
        return None if sample is None else sample.received_at

    def age(self, record: type[Any]) -> float | None:
        """Seconds since the newest record arrived, None when it never did."""
        received_at = self.received_at(record)
        return None if received_at is None else self._clock() - received_at

    @property
    def newest_age(self) -> float | None:
        """Seconds since any telemetry arrived, None when none ever did."""
        return None if self._newest_at is None else self._clock() - self._newest_at

    def fresh(self, record: type[R], *, within: float) -> R | None:
        """The newest record if it is at most ``within`` seconds old, else None."""
        age = self.age(record)
        return None if age is None or age > within else self.get(record)

    def statistics(self, record: type[Any]) -> ItemStatistics:
        """Measured rate, jitter and longest gap of an item."""
        return self._statistics[RECORDS.index(record)]

    @property
    def time(self) -> Time | None:
        """Clock of the aircraft."""
        return self.get(Time)

    @property
    def attitude(self) -> Attitude | None:
        """Attitude."""
        return self.get(Attitude)

    @property
    def acceleration(self) -> Acceleration | None:
        """Linear acceleration."""
        return self.get(Acceleration)

    @property
    def velocity(self) -> Velocity | None:
        """Linear velocity."""
        return self.get(Velocity)

    @property
    def angular_velocity(self) -> AngularVelocity | None:
        """Angular velocity."""
        return self.get(AngularVelocity)

    @property
    def position(self) -> Position | None:
        """Position, altitude, height and GPS health."""
        return self.get(Position)

    @property
    def magnetometer(self) -> Magnetometer | None:
        """Magnetometer."""
        return self.get(Magnetometer)

    @property
    def remote_control(self) -> RemoteControl | None:
        """Channels of the remote controller."""
        return self.get(RemoteControl)

    @property
    def gimbal(self) -> Gimbal | None:
        """Gimbal attitude."""
        return self.get(Gimbal)

    @property
    def flight_status(self) -> FlightStatus | None:
        """Flight status."""
        return self.get(FlightStatus)

    @property
    def battery(self) -> Battery | None:
        """Battery charge."""
        return self.get(Battery)

    @property
    def control_device(self) -> ControlDevice | None:
        """Who controls the aircraft."""
        return self.get(ControlDevice)

    def situation(self) -> dict[str, object]:
        """What explains a refusal, for errors: status, battery, GPS health, mode switch, holder."""
        phase = self.flight_status and (self.flight_status.phase or self.flight_status.status)
        device = self.control_device and self.control_device.device
        rc = self.remote_control
        return {
            "flight_status": getattr(phase, "name", phase),
            "height_m": self.position and round(self.position.height_m, 2),
            "battery_percent": self.battery and self.battery.percent,
            "gps_health": self.position and self.position.gps_health,
            "mode_switch": rc.mode_switch.name if rc else None,
            "control_device": getattr(device, "name", device),
        }


class ItemStatistics:
    """How an item arrives.

    Attributes:
        name: Item name.
        count: Arrivals in all.
        longest_gap_s: Longest interval so far, s.
    """

    __slots__ = ("_arrivals", "count", "longest_gap_s", "name")

    WINDOW_S = 2.5
    """Rate and jitter speak of the newest arrivals, at most so many seconds apart."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = 0
        self.longest_gap_s = 0.0
        self._arrivals: deque[float] = deque(maxlen=256)

    def count_arrival(self, now: float) -> None:
        """Take an arrival into account."""
        self.count += 1
        arrivals = self._arrivals
        if arrivals:
            gap = now - arrivals[-1]
            if gap > self.longest_gap_s:
                self.longest_gap_s = gap
            oldest = now - self.WINDOW_S
            while len(arrivals) > 1 and arrivals[0] < oldest:
                arrivals.popleft()
        arrivals.append(now)

    @property
    def rate_hz(self) -> float | None:
        """Arrivals per second; None before the second arrival."""
        span = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0.0
        return (len(self._arrivals) - 1) / span if span > 0 else None

    @property
    def jitter_s(self) -> float | None:
        """Mean deviation of the intervals from their mean, s; None before the third arrival."""
        gaps = [later - earlier for earlier, later in pairwise(self._arrivals)]
        if len(gaps) < 2:
            return None
        mean = sum(gaps) / len(gaps)
        return sum(abs(gap - mean) for gap in gaps) / len(gaps)
