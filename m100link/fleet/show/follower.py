"""One aircraft in a show: it takes its place, flies its track by the fleet's clock, or leaves.

Nobody streams positions to it: it needs its track, a time to begin and a clock. When it is farther
from its track than its tube is wide, or does not know any more what time it is, it leaves: that is
an error out of the control block, whose own stop path then hovers or lands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from m100link.errors import M100Error
from m100link.fleet.show.checks import SKEW_S
from m100link.fleet.show.clock import FleetClock
from m100link.fleet.show.track import Moment, TimedTrack, Vector
from m100link.flight.control import Control
from m100link.flight.guards import MAX_COMMAND_M_S
from m100link.flight.guidance import heading_of, position_of
from m100link.flight.known import known
from m100link.flight.pacing import Tick
from m100link.geodesy import LocalFrame
from m100link.protocol.records import FlightPhase, FlightStatus
from m100link.protocol.setpoint import Setpoint

__all__ = ["LeftShow", "ShowRefused", "TrackFlown", "TrackFollower", "Why"]

_LAG_S = 0.65
"""By how much the velocity follows what is asked for; of the model of the virtual aircraft."""
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
    PLACE = "place"
    TUBE = "tube"


class ShowRefused(
    M100Error,
    code="M100-SHOW-REFUSED",
    cause="a clock that nobody knows well enough, or an aircraft that stands elsewhere",
    remedy="look at `why`; nothing has begun",
):
    """An aircraft does not begin its track.

    Attributes:
        why: What is in the way.
        measured: As a number.
        limit: What it may be.
    """

    def __init__(
        self,
        seen: str,
        *,
        why: Why,
        measured: float,
        limit: float,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.why = why
        self.measured = measured
        self.limit = limit


class LeftShow(
    M100Error,
    code="M100-LEFT-SHOW",
    cause="wind, a battery that does not give enough, or a line that stood still",
    remedy="it hovers or lands where it is, as its control block was told; the others fly on",
):
    """An aircraft flew its track and could not keep to it.

    Attributes:
        why: What went wrong.
        at: Seconds from the beginning of the show.
        measured: As a number: metres from its track, or seconds by which the clock may be wrong.
        limit: What it may be.
    """

    def __init__(
        self, seen: str, *, why: Why, at: float, measured: float, limit: float, cause: str = ""
    ) -> None:
        super().__init__(seen, cause=cause)
        self.why = why
        self.at = at
        self.measured = measured
        self.limit = limit


@dataclass(frozen=True, slots=True)
class TrackFlown:
    """How a track was flown to its end.

    Attributes:
        farthest_m: Farthest from where it should have been, by its own telemetry, m.
        began_late_s: From the time at which it was to begin to its first setpoint, s.
        bound_s: The most by which its clock may have been wrong.
    """

    farthest_m: float
    began_late_s: float
    bound_s: float


class TrackFollower:
    """Flies one track in a control block.

    Args:
        control: Of the aircraft; what leaves this object as an error has to leave its block.
        track: What it flies.
        clock: The fleet's.
        tell: What happens, for people.
    """

    def __init__(
        self,
        control: Control,
        track: TimedTrack,
        clock: FleetClock,
        *,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self._control = control
        self._track = track
        self._clock = clock
        self._tell = tell
        self._frame = LocalFrame(*track.origin)
        envelope = control.guards.envelope
        most = MAX_COMMAND_M_S if envelope is None else envelope.max_speed_m_s
        self._fastest = min(most, MAX_COMMAND_M_S) * (1 - 1e-6)
        self._start_at = 0.0
        self._heading = 0.0
        self._began_late: float | None = None
        self._farthest = 0.0
        self._bound = 0.0

    # -- before ----------------------------------------------------------------------------------

    async def take_place(self) -> None:
        """Take off if need be, and hover at the first point of the track.

        Raises:
            ShowRefused: It is not below its first point, or above it: it has not moved.
            M100Error: As ``Control.take_off``, ``climb_to`` and ``fly_to``.
        """
        first = self._track.points[0]
        here = self._here()
        aside = math.dist(here[:2], (first.north, first.east))
        if aside > self._track.tube_m:
            raise ShowRefused(
                f"{self._track.name} is {aside:.1f} m from where its track begins, seen from "
                f"above; {self._track.tube_m:g} m are allowed",
                why=Why.PLACE,
                measured=aside,
                limit=self._track.tube_m,
                cause="it was put elsewhere, or the show has another origin",
                remedy="carry it below its first point: on the way there by air it could meet "
                "another one",
            )
        status = known(self._control.state, FlightStatus)
        if status is None or status.status != FlightPhase.IN_AIR:
            await self._control.take_off()
        height = first.height - self._track.ground_m
        await self._control.climb_to(height)
        latitude, longitude = self._frame.to_geodetic(first.north, first.east)
        await self._control.fly_to(
            latitude_deg=latitude,
            longitude_deg=longitude,
            height=height,
            yaw_deg=self._track.heading_deg,
        )
        self._tell(f"{self._track.name} is at its place")

    # -- flying ----------------------------------------------------------------------------------

    async def fly(self, start_at: float) -> TrackFlown:
        """Hover until a time of the fleet's clock, fly the track, and hover at its end.

        Args:
            start_at: When the show begins, s of the fleet's clock.

        Raises:
            ShowRefused: The clock may be wrong by more than 50 ms, the time is over, or it is not
                at its place: nothing was sent.
            LeftShow: It left its tube, or the clock became unsure.
            M100Error: As ``Control.follow``; telemetry stalled.
        """
        self._admit(start_at)
        self._start_at = start_at
        track_heading = self._track.heading_deg
        self._heading = heading_of(self._control.state) if track_heading is None else track_heading
        self._tell(f"{self._track.name} begins in {start_at - self._clock.now():.1f} s")
        await self._control.follow(self._step)
        self._tell(f"{self._track.name} is at the end of its track")
        return TrackFlown(self._farthest, self._began_late or 0.0, self._bound)

    def _admit(self, start_at: float) -> None:
        name, bound, tube = self._track.name, self._clock.bound(), self._track.tube_m
        if bound > SKEW_S:
            raise ShowRefused(
                f"{name} may be wrong about the time by {_milliseconds(bound)}; "
                f"{_milliseconds(SKEW_S)} are allowed",
                why=Why.CLOCK,
                measured=bound,
                limit=SKEW_S,
                cause="the way to the fleet's clock is slow or lossy, or it has not answered",
                remedy="wait for more round trips, or bring both into one network",
            )
        early = start_at - self._clock.now()
        if not 0 < early < math.inf:
            raise ShowRefused(
                f"{name} should have begun {-early:.2f} s ago",
                why=Why.LATE,
                measured=-early,
                limit=0.0,
                cause="the order took too long, or names a time of another clock",
                remedy="begin some seconds from now",
            )
        off = self._off(self._track.moment(0.0))
        if off > tube:
            raise ShowRefused(
                f"{name} is {off:.1f} m from where its track begins; {tube:g} m are allowed",
                why=Why.PLACE,
                measured=off,
                limit=tube,
                cause="it is on the ground, or was moved",
                remedy="let it take its place first",
            )

    def _here(self) -> Vector:
        """Where it is, in the show's frame."""
        found = position_of(self._control.state)
        north, east = self._frame.to_local(found.latitude_deg, found.longitude_deg)
        return north, east, found.height_m + self._track.ground_m

    def _off(self, wanted: Moment) -> float:
        return math.dist(self._here(), wanted.place)

    def _step(self, _tick: Tick) -> Setpoint | None:
        at, bound = self._clock.now() - self._start_at, self._clock.bound()
        self._require_clock(at, bound)  # where it should be means nothing before
        wanted, here = self._track.moment(at), self._here()
        self._require_near(at, math.dist(here, wanted.place))
        if at >= 0 and self._began_late is None:
            self._began_late = at
            self._tell(f"{self._track.name} began its track")
        if at >= self._track.end + _SETTLING_S:
            return None
        return self._steer(at, wanted, here)

    def _require_clock(self, at: float, bound: float) -> None:
        if bound > SKEW_S:
            raise LeftShow(
                f"{self._track.name} left the show at {at:.1f} s: it may be wrong about the time "
                f"by {_milliseconds(bound)}",
                why=Why.CLOCK,
                at=at,
                measured=bound,
                limit=SKEW_S,
                cause="the fleet's clock has not answered for long",
            )
        self._bound = max(self._bound, bound)

    def _require_near(self, at: float, off: float) -> None:
        if off > self._track.tube_m:
            raise LeftShow(
                f"{self._track.name} left its track: {off:.1f} m off at {at:.1f} s, "
                f"{self._track.tube_m:g} m are allowed",
                why=Why.TUBE,
                at=at,
                measured=off,
                limit=self._track.tube_m,
            )
        self._farthest = max(self._farthest, off)

    def _steer(self, at: float, wanted: Moment, here: Vector) -> Setpoint:
        """What is wanted once the velocity has followed, and back to where it should be now."""
        ahead_n, ahead_e, _ = self._track.moment(at + _LAG_S).velocity
        ahead_up = self._track.moment(at + _LAG_UP_S).velocity[2]
        off_n, off_e, off_up = (a - b for a, b in zip(wanted.place, here, strict=True))
        north, east = ahead_n + _GAIN_PER_S * off_n, ahead_e + _GAIN_PER_S * off_e
        up = max(-_MAX_UP_M_S, min(_MAX_UP_M_S, ahead_up + _GAIN_UP_PER_S * off_up))
        speed = math.hypot(north, east)
        scale = min(1.0, self._fastest / speed) if speed else 0.0
        return Setpoint.velocity(
            north=north * scale, east=east * scale, up=up, yaw_deg=self._heading
        )


def _milliseconds(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if math.isfinite(seconds) else "any amount"
