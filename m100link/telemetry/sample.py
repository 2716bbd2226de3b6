"""One telemetry package with its time of arrival, as subscriptions deliver it.

Its acceleration is in one frame and unit, whatever the PC assistant is set to: see
:class:`AccelerationReader`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import lru_cache
from struct import Struct
from typing import Any, TypeVar

from m100link.errors import LayoutMismatch, UsageError
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.items import BY_RECORD
from m100link.protocol.packet import TelemetryPacket, mismatch, plan_of
from m100link.protocol.records import (
    Acceleration,
    AccelerationMode,
    Attitude,
    FlightPhase,
    FlightStatus,
    Velocity,
)

__all__ = ["Sample"]

_logger = logging.getLogger(__name__)

R = TypeVar("R", bound=tuple[Any, ...])


class Sample(TelemetryPacket):
    """One telemetry package and when it arrived.

    Items are read when asked for: ``sample.attitude`` is None when the package has none,
    ``sample[Attitude]`` raises instead.

    Attributes:
        received_at: Time of arrival on the event loop's clock, s.
    """

    __slots__ = ("received_at",)

    def __init__(self, value: bytes, profile: FirmwareProfile, received_at: float) -> None:
        # What TelemetryPacket does, written out: a call less for what comes a hundred times a
        # second on each line.
        try:
            plan = profile.plans[value[0] | value[1] << 8]
        except LookupError:
            plan = plan_of(value, profile)
        if plan.size != len(value):
            raise mismatch(value, profile)
        self._plan = plan
        self.flags = plan.flags
        self.profile = profile
        self.value = value
        self.received_at = received_at

    def __getitem__(self, record: type[R]) -> R:
        """The record of that class; ``KeyError`` where the package does not carry it."""
        found = self.get(record)
        if found is None:
            raise KeyError(record.__name__)
        return found


# -- acceleration, raw or fused --------------------------------------------------------------------
# The wire does not tell the mode, so one second at rest has to: raw values are gravity alone, 1 g
# along the body's axis, and fused ones nothing. Every consumer then gets fused values.

G_M_S2 = 9.80665
"""Standard gravity, m/s²: the unit of raw values."""

_ITEM, _ATTITUDE, _VELOCITY, _STATUS = (
    BY_RECORD[record].bit for record in (Acceleration, Attitude, Velocity, FlightStatus)
)
_VECTOR = Struct("<3f")
_WINDOW_S = 1.0  # what is judged at once
_LEAST_SAMPLES = 2
_AT_REST_M_S2 = 0.3  # length of the mean of fused values, at most: bias and noise of good sensors
_OFF_G = 0.15  # by which the length of the mean of raw values may differ from 1 g
_UPRIGHT = 0.7  # least share of it along the body's axis, so that a slope of 45° is a stand, too
_SPEED_CHANGE_M_S = 0.3  # in a window without acceleration; fused values of 1 m/s² make 1 m/s
# As many windows in a row decide: on the ground, in flight with a velocity, and without any, when
# an aircraft that accelerates down at 1 m/s² would sink at 6 m/s, faster than it can.
_STANDING, _FLYING, _BLIND = 1, 3, 6
# As many windows of fused values overturn raw: three seconds of free fall are no flight.
_MOST_SAMPLES = 1000  # of a window count, however many come
# An attitude is that of an acceleration for so long, s: both come from one estimate.
_ATTITUDE_S = 0.3
_MOST_G = 50.0


def acceleration_mode(name: str | None) -> AccelerationMode | None:
    """The mode of that name; None stays None. Raises UsageError: there is none of that name."""
    if name is None:
        return None
    try:
        return AccelerationMode(name)
    except ValueError:
        raise UsageError(
            f"no acceleration mode is called {name!r}",
            remedy=f"choose one of {', '.join(AccelerationMode)}, or leave it out to have it found",
        ) from None


_Place = tuple[int, Callable[[bytes, int], tuple[float, ...]]]
_Kept = tuple[_Place, bytes] | None


@lru_cache(maxsize=256)
def _places(plan: Any) -> tuple[_Place | None, _Place | None, _Place | None, _Place | None, bytes]:
    """Where a package has the four items, and its flag word without an acceleration."""
    found = map(plan.items.get, (_ATTITUDE, _VELOCITY, _STATUS, _ITEM))
    return (*found, (plan.flags & ~(1 << _ITEM)).to_bytes(2, "little"))


def _values(kept: _Kept) -> tuple[float, ...] | None:
    """The values of an item in the package that was kept for them."""
    if kept is None:
        return None
    (offset, unpack), value = kept
    return unpack(value, offset)


class AccelerationReader:
    """Makes the acceleration of telemetry packages fused, and finds out in which mode it comes.

    A package whose acceleration cannot be read loses the item: the mode is not known yet, or raw
    values come without an attitude. Unknown is better than in other axes, off by 9.8.

    Args:
        mode: The mode, if somebody fixed it; it stays, whatever is seen.

    Attributes:
        mode: By which packages are read; None while it is not known.
        seen: The mode that the values themselves showed at rest; None while they did not.
        is_idle: Whether every package passes as it is.
        has_arrived: Whether any package carried an acceleration.
    """

    __slots__ = (
        *("_against", "_attitude", "_attitude_at", "_felt", "_is_found", "_row", "_speed"),
        *("_start", "_status", "_velocity", "has_arrived", "is_idle", "mode", "seen"),
    )

    def __init__(self, mode: AccelerationMode | None = None) -> None:
        self.mode = mode
        self.seen: AccelerationMode | None = None
        self.is_idle = self.has_arrived = False
        # The newest of each, read when a second of values is judged, and the attitude for raw ones.
        self._attitude: _Kept = None
        self._attitude_at = 0.0
        self._velocity: _Kept = None
        self._status: _Kept = None
        self._row = 0  # windows in a row that look raw
        self._against = 0  # and, once raw was seen, fused
        self._is_found = False  # whether the mode is what was seen
        self._begin(0.0)

    def _begin(self, now: float) -> None:
        self._start = now
        self._felt: list[tuple[float, ...]] = []  # since then
        self._speed = self._velocity

    def fix(self, mode: AccelerationMode | None) -> None:
        """Read by this mode from now on: somebody else knows it."""
        self.mode, self.is_idle = mode, mode is AccelerationMode.FUSED
        self._is_found = False

    def read(self, value: bytes, profile: FirmwareProfile, now: float) -> bytes:
        """The value of a package with a fused acceleration, or without one.

        A value that does not fit the profile is returned as it is. Never raises.
        """
        try:
            plan = profile.plans.get(value[0] | value[1] << 8) or plan_of(value, profile)
        except (IndexError, LayoutMismatch):
            return value
        if plan.size != len(value):
            return value
        attitude, velocity, status, place, flags = _places(plan)
        if attitude is not None:
            self._attitude, self._attitude_at = (attitude, value), now
        if velocity is not None:
            self._velocity = velocity, value
        if status is not None:
            self._status = status, value
        if place is None:
            return value
        offset, unpack = place
        felt = unpack(value, offset)
        self.has_arrived = True
        if self.seen is not AccelerationMode.FUSED:
            self._look(felt, now)
        if self.mode is AccelerationMode.FUSED:
            self.is_idle = self.seen is not None
            return value
        if self.mode is AccelerationMode.RAW:
            turned = _values(self._attitude) if now - self._attitude_at <= _ATTITUDE_S else None
            fused = None if turned is None else fused_of(felt, turned)
            if fused is not None:
                return value[:offset] + _VECTOR.pack(*fused) + value[offset + _VECTOR.size :]
        return flags + value[2:offset] + value[offset + _VECTOR.size :]

    def _look(self, felt: tuple[float, ...], now: float) -> None:
        """Take a value into the window, and judge a window that is full."""
        passed = now - self._start
        if not 0.0 <= passed <= 3 * _WINDOW_S:
            self._row = 0
            self._begin(now)
            return
        if len(self._felt) < _MOST_SAMPLES:
            self._felt.append(felt)
        if passed < _WINDOW_S or len(self._felt) < _LEAST_SAMPLES:
            return
        found = self._shown()
        self._begin(now)
        if self.seen is not None:  # raw, as an aircraft in a hand or a lift may have looked
            self._against = self._against + 1 if found is AccelerationMode.FUSED else 0
            if self._against < _FLYING:
                return
        if found is not None:
            self._find(found)

    def _shown(self) -> AccelerationMode | None:
        """The mode that the window shows, if it and those before it are enough."""
        x, y, z = (sum(axis) / len(self._felt) for axis in zip(*self._felt, strict=True))
        length = math.hypot(x, y, z)
        # Fused values this small may come from any flight; raw ones from free fall alone.
        if length <= _AT_REST_M_S2:
            return AccelerationMode.FUSED
        before, now, status = map(_values, (self._speed, self._velocity, self._status))
        changed = None if before is None or now is None else math.dist(before[:3], now[:3])
        is_faster = changed is not None and not changed <= _SPEED_CHANGE_M_S  # or no number
        if (
            not math.isfinite(length)
            or is_faster
            or abs(length - 1.0) > _OFF_G
            or z > -_UPRIGHT * length
        ):
            self._row = 0
            return None
        self._row += 1
        is_standing = status is not None and status[0] == FlightPhase.STANDBY
        needed = _STANDING if is_standing else _BLIND if changed is None else _FLYING
        return AccelerationMode.RAW if self._row >= needed else None

    def _find(self, found: AccelerationMode) -> None:
        self.seen = found
        if self.mode is None or (self._is_found and self.mode is not found):
            self.mode, self._is_found = found, True
            _logger.info("acceleration comes %s, as its values at rest show", found)
        elif self.mode is not found:
            _logger.warning(
                "acceleration is read as %s, and its values at rest are %s: leave the mode out, or "
                "change it in the PC assistant",
                self.mode,
                found,
            )


def fused_of(
    raw: tuple[float, ...], attitude: tuple[float, ...]
) -> tuple[float, float, float] | None:
    """A raw acceleration as a fused one: north, east, up, m/s², without gravity.

    ``raw``: forward, right, down, g. ``attitude``: the quaternion from body to ground (north, east,
    down). None: one of them cannot be.
    """
    q0, q1, q2, q3 = attitude
    length = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3
    x, y, z = raw
    # No number at all, or one that no sensor reaches, is unknown, too; neither comparison is true
    # for a NaN.
    if not (0.5 < length < 2.0 and abs(x) + abs(y) + abs(z) <= _MOST_G):
        return None
    scale = G_M_S2 / length
    kept, along, across = 2 * q0 * q0 - length, 2 * (q1 * x + q2 * y + q3 * z), 2 * q0
    north = kept * x + along * q1 + across * (q2 * z - q3 * y)
    east = kept * y + along * q2 + across * (q3 * x - q1 * z)
    down = kept * z + along * q3 + across * (q1 * y - q2 * x)
    return north * scale, east * scale, -down * scale - G_M_S2
