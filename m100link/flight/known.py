"""What is known of the aircraft: a value that is old, or impossible, is known to nobody."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeVar

from m100link.protocol.records import (
    Attitude,
    Battery,
    ControlDevice,
    FlightStatus,
    Position,
    RemoteControl,
)

if TYPE_CHECKING:
    from m100link.telemetry.state import AircraftState

__all__ = ["AGE_LIMITS_S", "known"]

R = TypeVar("R", bound=tuple[Any, ...])

AGE_LIMITS_S: dict[type[Any], float] = {
    Position: 1.2,
    Attitude: 1.2,
    ControlDevice: 1.2,
    RemoteControl: 1.2,
    FlightStatus: 2.5,
    Battery: 5.0,
}
"""Seconds after which the value of an item counts as unknown: more than one period of an item that
is sent once a second; the charge changes slowly and may miss four packages."""


def known(state: AircraftState, record: type[R], *, within: float | None = None) -> R | None:
    """The newest value of an item, None when it is old or impossible: nobody knows it then.

    Args:
        state: Telemetry.
        record: Which item.
        within: Seconds that it may be old; by default those of :data:`AGE_LIMITS_S`.
    """
    value = state.fresh(record, within=AGE_LIMITS_S[record] if within is None else within)
    return value if value is not None and _is_possible(value) else None


def _is_possible(value: tuple[Any, ...]) -> bool:
    numbers = value if None not in value else [field for field in value if field is not None]
    if not all(map(math.isfinite, numbers)):
        return False
    if isinstance(value, Attitude):
        return 0.5 < sum(part * part for part in value) < 2.0  # a unit quaternion, roughly
    return value.is_possible if isinstance(value, Position | Battery) else True
