"""Names of telemetry items and columns: one of each is written, several are understood.

Written are item names and, for a column, ``item.field`` with the field of the record. Understood
are also the names of :class:`~m100link.telemetry.state.AircraftState` (``attitude``,
``remote_control``) and those of the document's table (2.2.3.1: ``q``, ``vgx``, ``pos.lati``),
whatever their case.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from m100link.protocol.items import ITEMS, Item

__all__ = ["ITEM_NAMES", "column_named", "snake"]

# Item → its name in the document, and its variables in the order of the record's fields.
_DOCUMENT = {
    "time": ("time", "time_stamp"),
    "quaternion": ("q", "q0 q1 q2 q3"),
    "acceleration": ("acc", "agx agy agz"),
    "velocity": ("vel", "vgx vgy vgz"),
    "angular_velocity": ("w", "wx wy wz"),
    "position": ("pos", "lati longti alti height health_flag"),
    "magnetometer": ("mag", "mx my mz"),
    "rc": ("rc", "roll pitch yaw throttle mode gear"),
    "gimbal": ("gimbal", "roll pitch yaw"),
    "flight_status": ("flight_status", "status"),
    "battery": ("battery", "status"),
    "control_device": ("ctrl_device", "status"),
}


def snake(record: type[Any]) -> str:
    """The name of a record's class as a name of a value: ``remote_control``."""
    words = "".join(f"_{letter}" if letter.isupper() else letter for letter in record.__name__)
    return words.lower().removeprefix("_")


ITEM_NAMES: Mapping[str, Item] = {
    **{_DOCUMENT[item.name][0]: item for item in ITEMS},
    **{snake(item.record): item for item in ITEMS},
    **{item.name: item for item in ITEMS},
}
"""Items by every name that is understood."""


def _columns(item: Item) -> dict[str, str]:
    """Column by the names of its field that are understood, the record's own above all."""
    fields = item.record._fields
    names = dict(zip(_DOCUMENT[item.name][1].split(), fields, strict=False))
    names |= dict(zip(item.fields, fields, strict=False))
    names |= {field: field for field in (*fields, *item.views)}
    return {name: f"{item.name}.{field}" for name, field in names.items()}


_COLUMNS = {item.name: _columns(item) for item in ITEMS}

# What the document calls one variable alone needs no item.
_VARIABLES = [name for _, names in _DOCUMENT.values() for name in names.split()]
_ALONE = {
    name: _COLUMNS[item][name]
    for item, (_, names) in _DOCUMENT.items()
    for name in names.split()
    if _VARIABLES.count(name) == 1
}


def column_named(name: str) -> str | None:
    """The column of that name, as it is written; None: there is none."""
    item, _, field = name.lower().partition(".")
    if not field:
        return _ALONE.get(item)
    known = ITEM_NAMES.get(item)
    return None if known is None else _COLUMNS[known.name].get(field)
