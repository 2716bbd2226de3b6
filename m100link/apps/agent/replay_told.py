"""What fronts are told of a replay."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Replay"]


@dataclass(frozen=True, slots=True)
class Replay:
    """Where the replay of a recorded flight is.

    Attributes:
        name: Of the file.
        utc: POSIX time of then, s.
        clock: By which its telemetry is received, s.
        rate: Seconds by which that clock goes on in a second; 0 while it stands.
        position_s: Seconds that were played.
        duration_s: Of the whole.
        speed: Times as fast as it was flown; 0: as fast as it can be.
        is_paused: Whether it stands still on purpose.
        is_at_end: Whether everything was played.
        is_cut_off: Whether the file was not ended.
    """

    name: str
    utc: float
    clock: float
    rate: float
    position_s: float
    duration_s: float
    speed: float
    is_paused: bool
    is_at_end: bool
    is_cut_off: bool

    def time(self, since: float) -> float:
        """Its clock so many seconds after this was told, s."""
        return self.clock + since * self.rate
