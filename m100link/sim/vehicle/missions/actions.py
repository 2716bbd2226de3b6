"""The actions at a waypoint: one after the other, all within a time limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode
from m100link.protocol.commands.waypoint import WaypointPoint
from m100link.protocol.records import Device
from m100link.sim.vehicle.dynamics import STEP_S, Dynamics, wrapped
from m100link.sim.vehicle.flight import GOOD_GPS, FlightController, Maneuver
from m100link.sim.vehicle.gimbal import Camera, GimbalMount
from m100link.sim.vehicle.missions.plan import ActionKind, StoredPlan
from m100link.sim.vehicle.missions.route import (
    LocalPlace,
    MissionSettings,
    Nose,
    Site,
    distance,
)
from m100link.sim.vehicle.remote import ControlArbiter, Obstacle
from m100link.sim.vehicle.settings import AircraftSettings

_LONGEST_CAMERA_ACTION_S = 6.0
_GIMBAL_RATE_DEG = 45.0
_TRY_AGAIN_S = 0.25
_TURNED = math.radians(2.0)
_PITCH_ALONE = GimbalAngleMode.ABSOLUTE | GimbalAngleMode.KEEP_YAW | GimbalAngleMode.KEEP_ROLL


def aim_gimbal(gimbal: GimbalMount, pitch_deg: float, seconds: float) -> None:
    """Let the gimbal reach a pitch in some seconds, and leave its other axes alone."""
    gimbal.point(GimbalAngle(pitch_deg=pitch_deg, mode=_PITCH_ALONE, duration_s=seconds))


@dataclass(slots=True)
class MissionPayload:
    """The payload below the aircraft, as far as a mission uses it."""

    gimbal: GimbalMount
    camera: Camera
    flight: FlightController
    log: Callable[[str], None]  # notes what happens at which waypoint, for people

    def take_photo(self, index: int) -> bool:
        """Take a photograph at a waypoint. False while the camera still takes another one."""
        is_taken = self.camera.take_photo(self.flight.now)
        if is_taken:
            self.log(f"waypoint {index}: photo")
        return is_taken

    def record(self, on: bool, index: int) -> None:
        """Start or stop the video at a waypoint; what it does already changes nothing."""
        if self.camera.record(on):
            self.log(f"waypoint {index}: video {'on' if on else 'off'}")


class ActionRunner:
    """The actions of one waypoint; :meth:`step` once per step of the dynamics until it is done."""

    def __init__(
        self,
        point: WaypointPoint,
        payload: MissionPayload,
        motion: Dynamics,
        nose: Nose,  # where the mission points it
        settings: MissionSettings,  # how long things take
    ) -> None:
        self._point = point
        self._payload = payload
        self._motion = motion
        self._nose = nose
        self._settings = settings
        listed = list(zip(point.actions, point.parameters, strict=True))[: point.action_count]
        # Still to do, the next one last.
        self._left = (listed * max(1, point.action_repeat))[::-1] if point.has_action else []
        # Seconds until all together are cut off, and until the present action ends.
        self._limit = float(point.action_time_limit)
        self._running = 0.0
        # It ends when the aircraft has turned, however long that takes.
        self._waits_for_nose = False
        self._is_done = not self._left

    def step(self) -> bool:
        """Go on for one step; whether all is done, or the time is over."""
        if self._is_done:
            return True
        self._limit -= STEP_S
        self._running -= STEP_S
        if self._waits_for_nose:
            is_off = abs(wrapped(self._motion.yaw - self._nose.heading)) > _TURNED
            if is_off or not self._nose.has_turned:
                self._running = STEP_S
        if self._limit <= 0.0:
            self._is_done = True
        elif self._running <= 0.0:
            if self._left:
                self._begin(*self._left.pop())
            else:
                self._is_done = True
        return self._is_done

    def _begin(self, kind: int, parameter: int) -> None:
        payload, index = self._payload, self._point.index
        seconds = min(self._settings.photo_seconds, _LONGEST_CAMERA_ACTION_S)
        self._waits_for_nose = kind == ActionKind.YAW
        if kind == ActionKind.STAY:
            seconds = parameter / 1000.0
        elif kind == ActionKind.PHOTO:
            if not payload.take_photo(index):
                self._left.append((kind, parameter))
                seconds = _TRY_AGAIN_S
        elif kind == ActionKind.YAW:
            self._nose.turn_to(math.radians(parameter), self._point.turn_mode)
        elif kind == ActionKind.GIMBAL_PITCH:
            seconds = max(0.1, abs(payload.gimbal.pitch - parameter) / _GIMBAL_RATE_DEG)
            aim_gimbal(payload.gimbal, parameter, seconds)
        else:
            payload.record(kind == ActionKind.START_VIDEO, index)
        self._running = seconds

    @property
    def has_actions(self) -> bool:
        return not self._is_done


# -- whether the aircraft may begin a mission: control, what it does, GPS, home, battery -----------


_OK = MissionCode.SUCCESS

_BUSY: dict[Maneuver, MissionCode] = {
    Maneuver.SPIN_UP: MissionCode.STARTING_MOTORS,
    Maneuver.TAKE_OFF: MissionCode.TAKING_OFF,
    Maneuver.CLIMB_HOME: MissionCode.GOING_HOME,
    Maneuver.FLY_HOME: MissionCode.GOING_HOME,
    Maneuver.DESCEND: MissionCode.LANDING,
    Maneuver.FINISH: MissionCode.LANDING,
}


@dataclass(slots=True)
class Conditions:
    """Judges the state of the aircraft; the codes are DJI's, their order is ours."""

    flight: FlightController
    settings: AircraftSettings
    authority: ControlArbiter  # who may give orders
    site: Site  # where missions may go

    def control(self) -> MissionCode:
        """Whether the onboard device may fly missions, and if not, why.

        IOC keeps missions out where it leaves control to the onboard device, too.
        """
        if self.authority.device is Device.ONBOARD:
            return MissionCode.IOC_ON if self.authority.assistant.ioc_on else _OK
        obstacle = self.authority.obstacle()
        if obstacle is Obstacle.NOT_IN_F:
            return MissionCode.RC_NOT_IN_F
        if obstacle is Obstacle.IOC_ON:
            return MissionCode.IOC_ON
        return MissionCode.AUTHORITY_NEEDED

    def to_start(self) -> MissionCode:
        return self.control() or self._readiness()

    def _readiness(self) -> MissionCode:
        flight, missions = self.flight, self.settings.missions
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
            (self.site.is_forbidden(self.here, self.here), MissionCode.IN_NO_FLY_ZONE),
        )
        return next((code for is_wrong, code in checks if is_wrong), _OK)

    def in_the_air(self) -> MissionCode:
        on_ground = self.flight.dynamics.on_ground
        return self.to_start() or (MissionCode.NOT_IN_THE_AIR if on_ground else _OK)

    def waypoints(self, plan: StoredPlan) -> MissionCode:
        missions, site, flight = self.settings.missions, self.site, self.flight
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

    def _seconds_of(self, plan: StoredPlan) -> float:
        """The whole flight, with the way to its first point."""
        way = distance(self.here, plan.places[0]) / plan.cruise_speed
        return way + plan.mission.repeat * plan.estimate()

    @property
    def _seconds_left(self) -> float:
        """How long the battery carries it until it would land by itself."""
        left = self.flight.battery_percent - self.settings.critical_battery_percent
        return max(0.0, left) / 100.0 * 60.0 * self.flight.dynamics.airframe.hover_minutes

    @property
    def here(self) -> LocalPlace:
        motion = self.flight.dynamics
        return LocalPlace(motion.north, motion.east, motion.height)

    @property
    def home(self) -> LocalPlace:
        """The home point, or the place of power-on."""
        return LocalPlace(*(self.flight.home or (0.0, 0.0)), 0.0)
