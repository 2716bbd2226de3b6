"""Where a replay is, in words."""

from __future__ import annotations

import time
from dataclasses import dataclass

from m100link.apps.agent.messages import Replay
from m100link.apps.station.console.view.words import Text, say

__all__ = ["SPEEDS", "ReplayView", "replay_of"]

SPEEDS = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)


@dataclass(frozen=True, slots=True)
class ReplayView:
    """What the bar of a replay shows.

    Attributes:
        title: That it is one, and of what.
        place: How far it is, and when that was.
        note: That it is at its end, or that there is no more; None for nothing.
        position_s: Seconds that were played.
        duration_s: Of the whole.
        speed: Times as fast as it was flown; 0: as fast as it can be.
        is_running: Whether it goes on by itself.
    """

    title: Text
    place: Text
    note: Text | None
    position_s: float
    duration_s: float
    speed: float
    is_running: bool


def replay_of(told: Replay | None) -> ReplayView | None:
    """The bar; None where it is not a replay."""
    if told is None:
        return None
    when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(told.utc))
    note = say("replay.at_end") if told.is_at_end else None
    if told.is_at_end and told.is_cut_off:
        note = say("replay.cut_off")
    return ReplayView(
        title=say("replay.title", name=told.name),
        place=say(
            "replay.at",
            position=_clock(told.position_s),
            duration=_clock(told.duration_s),
            when=when,
        ),
        note=note,
        position_s=told.position_s,
        duration_s=told.duration_s,
        speed=told.speed,
        is_running=not (told.is_paused or told.is_at_end),
    )


def _clock(seconds: float) -> str:
    whole = int(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"
