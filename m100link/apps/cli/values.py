"""Telemetry records as flat rows of named numbers, for JSON, CSV and plots."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from enum import Enum
from typing import Any

from m100link.errors import UsageError
from m100link.protocol.items import BY_NAME, BY_RECORD, ITEMS
from m100link.telemetry.columns import columns_of
from m100link.telemetry.names import ITEM_NAMES

__all__ = ["columns_of", "items_named", "row"]


def row(record: Any) -> dict[str, Any]:
    """Fields and views of a record by column name."""
    item = BY_RECORD[type(record)]
    values = {field: getattr(record, field) for field in (*record._fields, *item.views)}
    return {
        f"{item.name}.{field}": value.name if isinstance(value, Enum) else value
        for field, value in values.items()
    }


def items_named(names: Iterable[str]) -> list[type[Any]]:
    """Record classes by the names of items; all of them when no name is given.

    Raises:
        UsageError: A name that is not an item; the message lists them.
    """
    found = []
    for name in names:
        if name.lower() not in ITEM_NAMES:
            near = get_close_matches(name.lower(), ITEM_NAMES, n=2)
            meant = f"did you mean {' or '.join(near)}? " if near else ""
            raise UsageError(
                f"no telemetry item is called {name!r}",
                remedy=f"{meant}items: {', '.join(BY_NAME)}",
            )
        found.append(ITEM_NAMES[name.lower()].record)
    return found or [item.record for item in ITEMS]
