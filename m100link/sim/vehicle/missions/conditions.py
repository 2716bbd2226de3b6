"""Whether the aircraft may begin a mission: control, what it does already, GPS, home, battery."""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.protocol.codes import MissionCode
from m100link.protocol.records import Device
from m100link.sim.vehicle.authority import ControlArbiter, Obstacle
from m100link.sim.vehicle.flight import GOOD_GPS, FlightController, Maneuver
from m100link.sim.vehicle.missions.plan import WaypointPlan
from m100link.sim.vehicle.missions.route import Place, distance
from m100link.sim.vehicle.missions.site import Site

if TYPE_CHECKING:
    from m100link.sim.vehicle.settings import AircraftSettings

__all__ = ["Conditions"]

_OK = MissionCode.SUCCESS

_BUSY: dict[Maneuver, MissionCode] = {
    Maneuver.SPIN_UP: MissionCode.STARTING_MOTORS,
    Maneuver.TAKE_OFF: MissionCode.TAKING_OFF,
    Maneuver.CLIMB_HOME: MissionCode.GOING_HOME,
    Maneuver.FLY_HOME: MissionCode.GOING_HOME,
    Maneuver.DESCEND: MissionCode.LANDING,
    Maneuver.FINISH: MissionCode.LANDING,
}


class Conditions:
    """Judges the state of the aircraft, in the order of facts M3 to M7.

    Args:
        flight: What it does.
        settings: The aircraft.
        authority: Who may give orders.
        site: Where missions may go.
    """

    def __init__(
        self,
        flight: FlightController,
        settings: AircraftSettings,
        authority: ControlArbiter,
        site: Site,
    ) -> None:
        self._flight = flight
        self._settings = settings
        self._authority = authority
        self._site = site

    def control(self) -> MissionCode:
        """Whether the onboard device may fly missions, and if not, why.

        IOC keeps missions out where it leaves control to the onboard device, too.
        """
        if self._authority.device is Device.ONBOARD:
            return MissionCode.IOC_ON if self._authority.assistant.ioc_on else _OK
        obstacle = self._authority.obstacle()
        if obstacle is Obstacle.NOT_IN_F:
            return MissionCode.RC_NOT_IN_F
        if obstacle is Obstacle.IOC_ON:
            return MissionCode.IOC_ON
        return MissionCode.AUTHORITY_NEEDED

    def to_start(self) -> MissionCode:
        """Whether any mission may start."""
        return self.control() or self._readiness()

    def _readiness(self) -> MissionCode:
        flight, missions = self._flight, self._settings.missions
        busy = _BUSY.get(flight.maneuver, _OK)
        if busy:
            return MissionCode.BUSY if missions.busy_is_one_code else busy
        checks = (
            (flight.gps_health < GOOD_GPS, MissionCode.GPS_TOO_WEAK),
            # On the ground it is recorded when the motors start.
            (
                flight.home is None and not flight.dynamics.on_ground,
                MissionCode.HOME_NOT_RECORDED,
            ),
            (
                flight.battery_percent <= missions.least_battery_percent,
                MissionCode.BATTERY_LOW,
            ),
            (missions.beginner_mode, MissionCode.BEGINNER_MODE),
            (self._site.is_forbidden(self.here, self.here), MissionCode.IN_NO_FLY_ZONE),
        )
        return next((code for is_wrong, code in checks if is_wrong), _OK)

    def in_the_air(self) -> MissionCode:
        """Whether a mission may start that does not take off."""
        on_ground = self._flight.dynamics.on_ground
        return self.to_start() or (MissionCode.NOT_IN_THE_AIR if on_ground else _OK)

    def waypoints(self, plan: WaypointPlan) -> MissionCode:
        """Whether a waypoint mission may start."""
        missions, site, flight = self._settings.missions, self._site, self._flight
        code = self.to_start()
        if code:
            return code
        grounded = flight.dynamics.on_ground and not missions.takes_off_by_itself
        checks = (
            (grounded, MissionCode.NOT_IN_THE_AIR),
            (max(place.up for place in plan.places) > site.height_limit, MissionCode.TOO_HIGH),
            (
                not all(site.is_within_radius(place, flight.home) for place in plan.places),
                MissionCode.TOO_FAR_FROM_HOME,
            ),
            (self._seconds_of(plan) > self._seconds_left, MissionCode.TAKES_TOO_LONG),
            (
                distance(self.here, plan.places[0]) > missions.farthest_start,
                MissionCode.TOO_FAR_AWAY,
            ),
        )
        return next((code for is_wrong, code in checks if is_wrong), _OK)

    def _seconds_of(self, plan: WaypointPlan) -> float:
        """The whole flight, with the way to its first point."""
        way = distance(self.here, plan.places[0]) / plan.cruise_speed
        return way + plan.mission.repeat * plan.estimate()

    @property
    def _seconds_left(self) -> float:
        """How long the battery carries it until it would land by itself."""
        settings = self._settings
        left = self._flight.battery_percent - settings.critical_battery_percent
        return max(0.0, left) / 100.0 * 60.0 * settings.hover_minutes

    @property
    def here(self) -> Place:
        """Where the aircraft is."""
        motion = self._flight.dynamics
        return Place(motion.north, motion.east, motion.height)

    @property
    def home(self) -> Place:
        """The home point, or the place of power-on."""
        return Place(*(self._flight.home or (0.0, 0.0)), 0.0)
