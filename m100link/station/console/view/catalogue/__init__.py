"""Every text of the console, English beside German, a file for each part of it.

A key begins with the name of its file. Whatever stands in braces stands in both languages.
"""

from __future__ import annotations

from m100link.station.console.view.catalogue import alarms, click, fleet, link, plan, status, unit

__all__ = ["CATALOGUE", "PARTS"]

PARTS = (alarms, click, fleet, link, plan, status, unit)
"""The files."""

CATALOGUE: dict[str, tuple[str, str]] = {
    key: entry for part in PARTS for key, entry in part.WORDS.items()
}
"""Key, then English and German."""
