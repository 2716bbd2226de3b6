"""Where to steer to keep to a timed track, and when to leave it. No I/O, no clock.

The caller gives the time and the place. It gets the wanted velocity, or an error that says why the
aircraft leaves the show.
"""

from __future__ import annotations

import math
from enum import Enum

from m100link.apps.fleet.show.plan.document import SKEW_S
from m100link.apps.fleet.show.plan.track import TimedTrack, Vector
from m100link.errors import M100Error

MOST_EARLY_S = 120.0
"""Seconds from the order to begin to the beginning, at most: so long an aircraft hovers at its
place, and nobody who conducts is missed any more."""

_LAG_S = 0.65
"""By how much the velocity follows its setpoint; of the model of the virtual aircraft."""
_LAG_UP_S = 0.3
_GAIN_PER_S = 0.6
"""Speed towards where it should be, m/s for each metre: with that lag it hardly swings."""
_GAIN_UP_PER_S = 1.0
_MAX_UP_M_S = 3.0
_SETTLING_S = 1.0
"""Seconds at the last point before a track counts as flown."""


class Why(Enum):
    """Why an aircraft does not begin a show, or leaves one."""

    CLOCK = "clock"
    LATE = "late"
    EARLY = "early"
    PLACE = "place"
    TUBE = "tube"
    CONDUCTOR = "conductor"
    NEAR = "near"
    SPEED = "speed"


class ShowRefused(
    M100Error,
    code="M100-SHOW-REFUSED",
    cause="a clock that is not known well enough, or an aircraft at another place",
    remedy="look at `why`; nothing has begun",
):
    """An aircraft does not begin its track."""

    why: Why = Why.PLACE  #: the reason
    measured: float = math.nan  #: the measured value
    limit: float = math.nan  #: its limit


class LeftShow(
    M100Error,
    code="M100-LEFT-SHOW",
    cause="wind, a weak battery, or a link that stood still",
    remedy="it hovers or lands where it is, as --leave says; the others fly on",
):
    """An aircraft leaves a show."""

    why: Why = Why.TUBE  #: the reason
    at: float = math.nan  #: seconds from the beginning of the show
    measured: float = math.nan  #: the measured value, in m, s or aircraft
    limit: float = math.nan  #: its limit


class TrackSteering:
    def __init__(self, track: TimedTrack, fastest_m_s: float) -> None:
        self._track = track
        self._fastest = fastest_m_s
        self.farthest_m = 0.0  # farthest from where it should have been

    def require_below(self, here: Vector) -> None:
        """Refuse a take-off that is neither below its first point nor above it."""
        first, name, tube = self._track.points[0], self._track.name, self._track.tube_m
        aside = math.dist(here[:2], (first.north, first.east))
        if not aside <= tube:
            raise ShowRefused(
                f"{name} is {aside:.1f} m from where its track begins, seen from above; "
                f"{tube:g} m are allowed",
                why=Why.PLACE,
                measured=aside,
                limit=tube,
                cause="it stands elsewhere, or the show has another origin",
                remedy="carry it below its first point: if it flew there, it could meet another "
                "aircraft",
            )

    def require_fast_enough(self) -> None:
        """Refuse a track that needs more than may be asked for: it would fall behind, and leave."""
        needed = self._track.fastest[0]
        if needed > self._fastest:
            raise ShowRefused(
                f"the track of {self._track.name} needs {needed:.1f} m/s; "
                f"its guards allow {self._fastest:.1f} m/s",
                why=Why.SPEED,
                measured=needed,
                limit=self._fastest,
                cause="the guards of its agent are narrower than those of the check",
                remedy=f"m100link fleet show check FILE --max-speed {self._fastest:.1f}",
            )

    def require_ready(self, early: float, bound: float, here: Vector) -> None:
        """Whether it may begin.

        ``early``: seconds from now to the beginning. ``bound``: by how much the clock may be wrong,
        s. Raises ShowRefused: the clock may be wrong by more than 50 ms, the time is over or more
        than two minutes away, or it is not at its first point.
        """
        name, tube = self._track.name, self._track.tube_m
        if not 0 <= bound <= SKEW_S:  # NaN is none
            raise ShowRefused(
                f"{name} may be wrong about the time by {_milliseconds(bound)}; "
                f"{_milliseconds(SKEW_S)} are allowed",
                why=Why.CLOCK,
                measured=bound,
                limit=SKEW_S,
                cause="the link to the conductor is slow or lossy, or the conductor is silent",
                remedy="wait for more round trips, or bring both into one network",
            )
        if early > MOST_EARLY_S:
            raise ShowRefused(
                f"{name} would begin in {early:.0f} s; {MOST_EARLY_S:g} s are allowed",
                why=Why.EARLY,
                measured=early,
                limit=MOST_EARLY_S,
                cause="the order has a time of another clock, or the show begins much later",
                remedy="name a time within two minutes; wait on the ground for a later one",
            )
        if not early > 0:
            raise ShowRefused(
                f"{name} should have begun {0.0 - early:.2f} s ago",
                why=Why.LATE,
                measured=-early,
                limit=0.0,
                cause="the order took too long, or has a time of another clock",
                remedy="begin some seconds from now",
            )
        off = math.dist(here, self._track.moment(0.0).place)
        if not off <= tube:
            raise ShowRefused(
                f"{name} is {off:.1f} m from where its track begins; {tube:g} m are allowed",
                why=Why.PLACE,
                measured=off,
                limit=tube,
                cause="it is on the ground, or was moved",
                remedy="let it take its place first",
            )

    def step(self, at: float, bound: float, here: Vector) -> Vector | None:
        """The velocity to fly now, north, east and up, m/s; None when the track is flown.

        ``at``: seconds from the beginning of the show; negative before it. ``bound``: by how much
        that may be wrong, s. Raises LeftShow: it left its tube, or the time may be wrong by too
        much.
        """
        self._require_clock(at, bound)  # where it should be means nothing before
        wanted = self._track.moment(at).place
        self._require_near(at, math.dist(here, wanted))
        if at >= self._track.end + _SETTLING_S:
            return None
        # The velocity for when the aircraft has followed, and back to where it should be now.
        ahead_n, ahead_e, _ = self._track.moment(at + _LAG_S).velocity
        ahead_up = self._track.moment(at + _LAG_UP_S).velocity[2]
        off_n, off_e, off_up = (a - b for a, b in zip(wanted, here, strict=True))
        north, east = ahead_n + _GAIN_PER_S * off_n, ahead_e + _GAIN_PER_S * off_e
        up = max(-_MAX_UP_M_S, min(_MAX_UP_M_S, ahead_up + _GAIN_UP_PER_S * off_up))
        speed = math.hypot(north, east)
        scale = min(1.0, self._fastest / speed) if speed else 0.0
        return north * scale, east * scale, up

    def _require_clock(self, at: float, bound: float) -> None:
        if not bound <= SKEW_S:  # NaN is none
            raise LeftShow(
                f"{self._track.name} left the show at {at:.1f} s: it may be wrong about the time "
                f"by {_milliseconds(bound)}",
                why=Why.CLOCK,
                at=at,
                measured=bound,
                limit=SKEW_S,
                cause="the conductor has been silent for long",
                remedy="let the conductor and its network run until the end of the show",
            )

    def _require_near(self, at: float, off: float) -> None:
        if not off <= self._track.tube_m:
            raise LeftShow(
                f"{self._track.name} left its track: {off:.1f} m off at {at:.1f} s, "
                f"{self._track.tube_m:g} m are allowed",
                why=Why.TUBE,
                at=at,
                measured=off,
                limit=self._track.tube_m,
                remedy="fly in less wind, or a slower show with a wider tube_m",
            )
        self.farthest_m = max(self.farthest_m, off)


def _milliseconds(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if 0 <= seconds < math.inf else "any amount"
