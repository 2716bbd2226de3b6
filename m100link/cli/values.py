"""Telemetry records as flat rows of named numbers, for JSON, CSV and plots."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Any

from m100link.errors import UsageError
from m100link.protocol.firmware import ITEM_NAMES
from m100link.protocol.records import (
    RECORDS,
    AngularVelocity,
    Attitude,
    ControlDevice,
    FlightStatus,
    Position,
    RemoteControl,
    Time,
    Velocity,
)

__all__ = ["columns_of", "items_named", "row"]

# Views beside the raw fields, in the units of the API.
_VIEWS: dict[type[Any], tuple[str, ...]] = {
    Time: ("seconds",),
    Attitude: ("roll_deg", "pitch_deg", "yaw_deg"),
    Velocity: ("ground_speed_m_s",),
    AngularVelocity: ("roll_rate_deg_s", "pitch_rate_deg_s", "yaw_rate_deg_s"),
    Position: ("latitude_deg", "longitude_deg"),
    RemoteControl: ("mode_switch",),
    FlightStatus: ("phase",),
    ControlDevice: ("device",),
}


def columns_of(records: Iterable[type[Any]]) -> list[str]:
    """Names of the columns of those records, such as ``position.height_m``."""
    return [
        f"{ITEM_NAMES[RECORDS.index(record)]}.{field}"
        for record in records
        for field in (*record._fields, *_VIEWS.get(record, ()))
    ]


def row(record: Any) -> dict[str, Any]:
    """Fields and views of a record by column name."""
    item = ITEM_NAMES[RECORDS.index(type(record))]
    values = {field: getattr(record, field) for field in record._fields}
    values |= {view: getattr(record, view) for view in _VIEWS.get(type(record), ())}
    return {
        f"{item}.{field}": value.name if isinstance(value, Enum) else value
        for field, value in values.items()
    }


def items_named(names: Iterable[str]) -> list[type[Any]]:
    """Record classes by item name; all of them when no name is given.

    Raises:
        UsageError: A name that is no item; the message lists them.
    """
    found = []
    for name in names:
        if name not in ITEM_NAMES:
            raise UsageError(
                f"no telemetry item is called {name!r}", remedy=f"items: {', '.join(ITEM_NAMES)}"
            )
        found.append(RECORDS[ITEM_NAMES.index(name)])
    return found or list(RECORDS)
