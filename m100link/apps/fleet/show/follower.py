"""One aircraft in a show: it takes its place, flies its track by the fleet's clock, or leaves.

Nobody streams positions to it: it needs its track, a time to begin and a clock. When it is farther
from its track than its tube is wide, or does not know any more what time it is, it leaves: that is
an error out of the control block, whose own stop path then hovers or lands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from m100link.apps.fleet.show.clock import FleetClock
from m100link.apps.fleet.show.plan.steering import LeftShow, ShowRefused, TrackSteering, Why
from m100link.apps.fleet.show.plan.track import TimedTrack, Vector
from m100link.flight.control import Control
from m100link.flight.guards import MAX_COMMAND_M_S, known
from m100link.flight.guidance import heading_of, position_of
from m100link.flight.pacing import Tick
from m100link.geodesy import LocalFrame
from m100link.protocol.records import FlightPhase, FlightStatus
from m100link.protocol.setpoint import Setpoint

__all__ = ["LeftShow", "ShowRefused", "TrackFlown", "TrackFollower", "Why"]


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
        self._steering = TrackSteering(track, min(most, MAX_COMMAND_M_S) * (1 - 1e-6))
        self._start_at = 0.0
        self._heading = 0.0

    # -- before ----------------------------------------------------------------------------------

    async def take_place(self) -> None:
        """Take off if need be, and hover at the first point of the track.

        Raises:
            ShowRefused: It is not below its first point, or above it: it has not moved.
            M100Error: As ``Control.take_off``, ``climb_to`` and ``fly_to``.
        """
        first = self._track.points[0]
        self._steering.require_below(self._here())
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
        early, steering, name = start_at - self._clock.now(), self._steering, self._track.name
        steering.require_ready(early, self._clock.bound(), self._here())
        self._start_at = start_at
        track_heading = self._track.heading_deg
        self._heading = heading_of(self._control.state) if track_heading is None else track_heading
        self._tell(f"{name} begins in {early:.1f} s")
        await self._control.follow(self._step)
        self._tell(f"{name} is at the end of its track")
        return TrackFlown(steering.farthest_m, steering.began_late_s or 0.0, steering.bound_s)

    def _here(self) -> Vector:
        """Where it is, in the show's frame."""
        found = position_of(self._control.state)
        north, east = self._frame.to_local(found.latitude_deg, found.longitude_deg)
        return north, east, found.height_m + self._track.ground_m

    def _step(self, _tick: Tick) -> Setpoint | None:
        is_first = self._steering.began_late_s is None
        at = self._clock.now() - self._start_at
        velocity = self._steering.step(at, self._clock.bound(), self._here())
        if is_first and self._steering.began_late_s is not None:
            self._tell(f"{self._track.name} began its track")
        if velocity is None:
            return None
        north, east, up = velocity
        return Setpoint.velocity(north=north, east=east, up=up, yaw_deg=self._heading)
