"""Records of a flight log besides the bytes of the line."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict
from enum import Enum

from m100link.aircraft.aircraft import Aircraft
from m100link.log.channels import EVENT, LINK, Entry

# The text of an error may quote its input: an address with its options, a key.
_SECRET = re.compile(r"\b((?:key|app[-_ ]?id)[=: ]+)[^\s&,;]+", re.IGNORECASE)
_KEY = re.compile(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])", re.IGNORECASE)

COUNTERS_S = 1.0  # between two records of the counters of the link


def observer(aircraft: Aircraft) -> Callable[[], list[Entry]]:
    """The function that gives the log new records: each event, counters once a second."""
    events = aircraft.events()
    counted_at = -math.inf

    def look() -> list[Entry]:
        nonlocal counted_at
        entries: list[Entry] = []
        while (event := events.get_nowait()) is not None:
            kind = type(event).__name__.removesuffix("Event").lower()
            values = {name: _plain(value) for name, value in event._asdict().items()}
            entries.append((EVENT, {"event": kind, **values}))
        now = aircraft.link.loop.time()
        if now - counted_at >= COUNTERS_S:
            counted_at = now
            counters = asdict(aircraft.statistics())
            known = {"firmware": aircraft.firmware.name, "acceleration": aircraft.acceleration_mode}
            entries.append((LINK, {**known, **counters}))
        return entries

    return look


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool):
        return value
    text = _SECRET.sub(r"\1…", str(value))
    return _KEY.sub("…", text)
