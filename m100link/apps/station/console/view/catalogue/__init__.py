"""Every text of the console, English beside German, a file for each part of it.

A key begins with the name of its file. Whatever stands in braces stands in both languages.
"""

from __future__ import annotations

from m100link.apps.station.console.view.catalogue import (
    actions,
    alarms,
    browser,
    checklist,
    click,
    errors,
    events,
    fleet,
    instruments,
    link,
    mission,
    page,
    plan,
    plots,
    replay,
    settings,
    sim,
    status,
    unit,
)

__all__ = ["CATALOGUE", "PARTS"]

PARTS = (
    *(actions, alarms, browser, checklist, click, errors, events, fleet, instruments, link),
    *(mission, page, plan, plots, replay, settings, sim, status, unit),
)
"""The files."""

CATALOGUE: dict[str, tuple[str, str]] = {
    key: entry for part in PARTS for key, entry in part.WORDS.items()
}
"""Key, then English and German."""
