"""From which values on something has to be told: read by the console, and by who looks at a log."""

from __future__ import annotations

from m100link.protocol.records import Position

__all__ = ["BATTERY_CRITICAL", "BATTERY_LOW", "GOOD_GPS", "MAX_TELEMETRY_AGE", "has_fix", "is_low"]

BATTERY_LOW = 25
"""Charge, %, from which down the aircraft warns. Set in the pilot's app; no command reads it, and
this is what the virtual aircraft has."""

BATTERY_CRITICAL = 10
"""Charge, %, from which down it lands by itself; the same holds for it."""

MAX_TELEMETRY_AGE = 1.0
"""Seconds without telemetry after which the aircraft counts as silent."""

GOOD_GPS = 3
"""From this health on the autopilot holds a position (document 2.2.3.1)."""

_BATTERY_GAP = 2


def has_fix(position: Position) -> bool:
    """Whether GPS knows the place: it can be one, and its health is good or not told."""
    health = position.gps_health
    return position.is_possible and (health is None or health >= GOOD_GPS)


def is_low(charge: int | None, limit: int) -> bool | None:
    """Whether a charge is below a limit; None between the two lines, or when it is not known.

    Between them lies a gap, so that a charge at the edge rings once.

    Args:
        charge: Charge, %.
        limit: From it down it is low, %.
    """
    if charge is None:
        return None
    return True if charge <= limit else False if charge >= limit + _BATTERY_GAP else None
