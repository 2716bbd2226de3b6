"""Where missions may go: places on the map in metres, no-fly zones, limits around home."""

from __future__ import annotations

import math

from m100link.geodesy import LocalFrame
from m100link.sim.vehicle.missions.route import Place
from m100link.sim.vehicle.missions.settings import MissionSettings

__all__ = ["Site", "is_on_earth"]

_UNKNOWN_APP_HEIGHT, _UNKNOWN_APP_RADIUS = 30.0, 50.0


def is_on_earth(latitude: float, longitude: float) -> bool:
    """Whether there is such a place, in radians; nothing is where a number is not finite."""
    return abs(latitude) <= math.pi / 2.0 and abs(longitude) <= math.pi


class Site:
    """The map around the place where the aircraft was switched on.

    Args:
        latitude_deg, longitude_deg: That place.
        height_limit: Nothing climbs beyond it, metres.
        settings: Of missions.

    Attributes:
        height_limit, radius_limit: Limits of missions, metres.
        farthest_start: How far away a mission may begin, metres.
    """

    __slots__ = ("_frame", "_zones", "farthest_start", "height_limit", "radius_limit")

    def __init__(
        self,
        latitude_deg: float,
        longitude_deg: float,
        height_limit: float,
        settings: MissionSettings,
    ) -> None:
        self._frame = LocalFrame(latitude_deg, longitude_deg)
        self._zones = [
            (*self._frame.to_local(zone.latitude_deg, zone.longitude_deg), zone.radius)
            for zone in settings.no_fly_zones
        ]
        self.farthest_start = settings.farthest_start
        limited = settings.never_logged_in
        self.height_limit = min(height_limit, _UNKNOWN_APP_HEIGHT) if limited else height_limit
        radius = settings.radius_limit
        self.radius_limit = min(radius, _UNKNOWN_APP_RADIUS) if limited else radius

    def place(self, latitude: float, longitude: float, height: float) -> Place:
        """A place given in radians, as on the wire; one that :func:`is_on_earth`."""
        north, east = self._frame.to_local(math.degrees(latitude), math.degrees(longitude))
        return Place(north, east, height)

    def is_within_radius(self, place: Place, home: tuple[float, float] | None) -> bool:
        """Whether a place is within the radius limit around home."""
        north, east = home or (0.0, 0.0)
        return math.hypot(place.north - north, place.east - east) <= self.radius_limit

    def is_forbidden(self, start: Place, end: Place) -> bool:
        """Whether the straight way between two places, or the one place, enters a no-fly zone."""
        return any(
            _distance_to_line(start, end, north, east) < radius
            for north, east, radius in self._zones
        )


def _distance_to_line(start: Place, end: Place, north: float, east: float) -> float:
    along_n, along_e = end.north - start.north, end.east - start.east
    square = along_n * along_n + along_e * along_e
    share = 0.0
    if square > 0.0:
        share = ((north - start.north) * along_n + (east - start.east) * along_e) / square
        share = max(0.0, min(1.0, share))
    return math.hypot(start.north + share * along_n - north, start.east + share * along_e - east)
