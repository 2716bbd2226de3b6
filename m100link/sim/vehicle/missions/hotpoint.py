"""Circling a point, and following a target.

The circle: to it at its height, then round and round until it is stopped.
"""

from __future__ import annotations

import math
from enum import Enum

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.hotpoint import FollowStart, FollowTarget, HotpointStart
from m100link.protocol.commands.missions import FollowStatus, HotpointStatus, WaypointEvent
from m100link.sim.vehicle.dynamics import (
    STEP_S,
    Airframe,
    Dynamics,
    DynamicsInput,
    ModelHorizontal,
    ModelVertical,
    ModelYaw,
)
from m100link.sim.vehicle.missions.plan import FinishAction
from m100link.sim.vehicle.missions.route import (
    LocalPlace,
    MissionSettings,
    MissionSteering,
    Nose,
    RouteLeg,
    Site,
    is_on_earth,
    slowed,
)
from m100link.sim.vehicle.remote import Sticks

SMALLEST_RADIUS, LARGEST_RADIUS, LOWEST = 5.0, 500.0, 5.0
_FASTEST_DEG, _TANGENTIAL = 30.0, 573.0  # °/s, and ° m/s: 10 m/s along the circle
_APPROACH_SPEED = 8.0
_INWARDS = 0.8  # m/s per metre beside the circle
_FASTEST_INWARDS = 4.0
_LEAD_S = 0.2


class CircleYaw:
    ALONG, CENTRE, OUTWARDS, BY_RC, AS_AT_START = range(5)


_START_BEARINGS = (0.0, math.pi, -math.pi / 2.0, math.pi / 2.0)  # north, south, west, east


def largest_rate(radius: float) -> float:
    """Degrees per second that a circle allows: 30, and 10 m/s along it."""
    return min(_FASTEST_DEG, _TANGENTIAL / radius)


def hotpoint_code(
    command: HotpointStart, site: Site, here: LocalPlace, home: LocalPlace
) -> MissionCode:
    """The code for 0x03/0x20, judged by its values and by where the aircraft is."""
    numbers = command.latitude, command.longitude, command.altitude, command.radius
    if not all(map(math.isfinite, (*numbers, command.angular_rate))):
        return MissionCode.BAD_NUMBER
    is_null = command.latitude == 0.0 and command.longitude == 0.0
    if is_null or not is_on_earth(command.latitude, command.longitude):
        return MissionCode.BAD_POSITION
    centre = site.place(command.latitude, command.longitude, command.altitude)
    reach = math.hypot(centre.north - home.north, centre.east - home.east) + command.radius
    checks = (
        (command.clockwise > 1, MissionCode.BAD_DIRECTION),
        (command.start_point > 4, MissionCode.BAD_START_POINT),
        (command.yaw_mode > 4, MissionCode.BAD_YAW_MODE),
        (not SMALLEST_RADIUS <= command.radius <= LARGEST_RADIUS, MissionCode.BAD_RADIUS),
        (command.altitude < LOWEST, MissionCode.TOO_LOW),
        (command.altitude > site.height_limit, MissionCode.TOO_HIGH),
        (
            not 0.0 <= command.angular_rate <= largest_rate(max(command.radius, 1.0)) + 0.01,
            MissionCode.RATE_TOO_HIGH,
        ),
        (reach > site.radius_limit, MissionCode.TOO_FAR_FROM_HOME),
        (
            math.hypot(centre.north - here.north, centre.east - here.east) > site.farthest_start,
            MissionCode.TOO_FAR_AWAY,
        ),
        (site.is_forbidden(centre, centre), MissionCode.CROSSES_NO_FLY_ZONE),
    )
    return next((code for is_wrong, code in checks if is_wrong), MissionCode.SUCCESS)


class _Phase(Enum):
    """A phase of the flight; the value is the status that the push shows."""

    CLIMB = "climbs", 0
    APPROACH = "flies to the circle", 0
    CIRCLE = "circles", 1


class HotpointExecution:
    """One hotpoint under way; :meth:`guide` once per step of the dynamics."""

    KIND = 2  # first byte of its status push

    def __init__(
        self,
        command: HotpointStart,
        centre: LocalPlace,  # the centre, at the height to circle at
        motion: Dynamics,
        airframe: Airframe,
        settings: MissionSettings,
    ) -> None:
        self.command = command  # as given, for those who ask
        self.events: list[WaypointEvent] = []
        self.then = FinishAction.NONE  # nothing comes after it
        self.is_over = self.flies_without_rc = False
        self._centre = centre
        self._motion = motion
        self._airframe = airframe
        self._settings = settings
        self._steering = MissionSteering(motion, airframe)
        self._nose = Nose(motion.yaw, settings.turn_rate_deg)
        self._locked = motion.yaw
        # Where the pilot's stick has turned the nose from what the yaw mode says, radians.
        self._nose_offset = 0.0
        self._phase = _Phase.CLIMB
        self._from = self._steering.here
        self._way: RouteLeg | None = None
        self._s = 0.0
        self._height = centre.up
        # Wanted radius, and the one flown now, which follows it; wanted rate in °/s, clockwise.
        self._radius = self._flown_radius = command.radius
        sign = 1.0 if command.clockwise == 1 else -1.0
        self._rate_deg = sign * command.angular_rate

    # --- what others see and do -------------------------------------------------------------

    def status(self, is_paused: bool) -> HotpointStatus:
        state = 2 if is_paused else self._phase.value[1]
        motion, rate = self._motion, 0.0
        if self._phase is _Phase.CIRCLE and not is_paused and self.distance > 0.1:
            north, east = self._outwards()
            across = motion.velocity_east * north - motion.velocity_north * east
            rate = math.degrees(abs(across) / self.distance)
        return HotpointStatus(
            status=state,
            radius_cm=min(65_500, round(100.0 * self.distance)),
            reason=0,
            rate=min(255, round(10.0 * rate)),
        )

    @property
    def doing(self) -> str:
        return self._phase.value[0]

    @property
    def distance(self) -> float:
        motion, centre = self._motion, self._centre
        return math.hypot(motion.north - centre.north, motion.east - centre.east)

    @property
    def is_out_of_reach(self) -> bool:
        """Whether the aircraft is too far outside the circle to fly it."""
        is_circling = self._phase is _Phase.CIRCLE
        return is_circling and self.distance > self._radius + self._settings.hotpoint_reach

    def set_rate(self, clockwise: int, rate_deg: float) -> None:
        """New direction and rate; too fast becomes as fast as the circle allows."""
        if clockwise > 1 or not math.isfinite(rate_deg):
            return
        rate = min(abs(rate_deg), largest_rate(self._radius))
        self._rate_deg = rate if clockwise == 1 else -rate

    def set_radius(self, radius: float) -> None:
        """New radius; one that no circle may have is ignored."""
        if SMALLEST_RADIUS <= radius <= LARGEST_RADIUS:
            self._radius = radius
            self.set_rate(1 if self._rate_deg >= 0.0 else 0, self._rate_deg)

    def reset_yaw(self) -> None:
        self._nose_offset = 0.0

    # --- each step --------------------------------------------------------------------------

    def resume(self) -> None:
        if self._phase is _Phase.APPROACH:
            self._approach_from_here()
        self._flown_radius = self.distance if self._phase is _Phase.CIRCLE else self._flown_radius

    def guide(self, sticks: Sticks) -> DynamicsInput:
        if self._phase is _Phase.CLIMB:
            if self._motion.height < self._height - 0.3:
                above = self._from._replace(up=self._height)
                return self._steering.hold(above, ModelYaw.ANGLE, self._nose.step())
            self._phase = _Phase.APPROACH
            self._approach_from_here()
        if self._phase is _Phase.APPROACH:
            assert self._way is not None
            if self._steering.is_at(self._way.at(self._way.length).place, within=0.5):
                self._phase = _Phase.CIRCLE
            else:
                return self._approach(self._way)
        return self._circle(sticks)

    def _approach_from_here(self) -> None:
        start = self.command.start_point
        bearing = _START_BEARINGS[start] if start < 4 else math.atan2(*reversed(self._outwards()))
        end = LocalPlace(
            self._centre.north + self._radius * math.cos(bearing),
            self._centre.east + self._radius * math.sin(bearing),
            self._height,
        )
        self._way = RouteLeg.straight(self._steering.here, end, 0, 0)
        self._s = 0.0
        self._flown_radius = self._radius

    def _approach(self, way: RouteLeg) -> DynamicsInput:
        steering = self._steering
        self._s = way.nearest(steering.here, self._s)
        on = way.at(self._s)
        speed = min(_APPROACH_SPEED, steering.steepest(on.tangent))
        speed, gain = slowed(speed, way.length - self._s)
        if math.hypot(on.tangent.north, on.tangent.east) > 0.1:
            self._nose.turn_to(math.atan2(on.tangent.east, on.tangent.north))
        return steering.along(on, on, speed, gain, ModelYaw.ANGLE, self._nose.step())

    def _outwards(self) -> tuple[float, float]:
        """Unit vector from the centre to the aircraft; north when it is right above."""
        away, motion = self.distance, self._motion
        if away < 0.1:
            return 1.0, 0.0
        return (motion.north - self._centre.north) / away, (motion.east - self._centre.east) / away

    def _circle(self, sticks: Sticks) -> DynamicsInput:
        self._obey(sticks)
        radius, away = self._flown_radius, max(self.distance, 0.5)
        north, east = self._outwards()
        rate = math.radians(self._rate_deg)
        around = rate * radius
        drift = max(-_FASTEST_INWARDS, min(_FASTEST_INWARDS, _INWARDS * (radius - away)))
        # The pull to the centre, of the place where it will be when its attitude has followed.
        pull = rate * rate * radius / self._airframe.velocity_gain
        turn = math.atan2(east, north) + rate * _LEAD_S
        return DynamicsInput(
            ModelHorizontal.VELOCITY,
            around * -east + drift * north - pull * math.cos(turn),
            around * north + drift * east - pull * math.sin(turn),
            vertical=ModelVertical.HEIGHT,
            up=self._height,
            yaw_mode=ModelYaw.ANGLE,
            yaw=self._heading(),
            steep=True,
        )

    def _obey(self, sticks: Sticks) -> None:
        """The pilot's sticks change height, radius and heading."""
        if abs(sticks.throttle) > 0.05:
            height = self._height + sticks.throttle * self._airframe.vertical_speed * STEP_S
            self._height = max(LOWEST, height)
        step = self._settings.radial_speed * STEP_S
        if abs(sticks.pitch) > 0.05:
            radius = self._radius - sticks.pitch * step  # forward is inwards
            self.set_radius(max(SMALLEST_RADIUS, min(LARGEST_RADIUS, radius)))
        if abs(sticks.yaw) > 0.05:
            turn = sticks.yaw * math.radians(self._airframe.yaw_rate_deg) * STEP_S
            self._nose_offset += turn
        self._flown_radius += max(-step, min(step, self._radius - self._flown_radius))

    def _heading(self) -> float:
        mode, (north, east) = self.command.yaw_mode, self._outwards()
        if mode == CircleYaw.ALONG:
            sign = 1.0 if self._rate_deg >= 0.0 else -1.0
            heading = math.atan2(sign * north, sign * -east)
        elif mode == CircleYaw.CENTRE:
            heading = math.atan2(-east, -north)
        elif mode == CircleYaw.OUTWARDS:
            heading = math.atan2(east, north)
        else:
            heading = self._locked
        # The aircraft turns towards an angle with a lag: ask for the one of a moment later.
        moves = mode < CircleYaw.BY_RC
        lag = 1.0 / self._airframe.yaw_gain + self._airframe.yaw_time_constant
        return heading + self._nose_offset + (math.radians(self._rate_deg) * lag if moves else 0.0)


# -- following a target: the distance kept that the two had at the start ---------------------------


_FARTHEST_TARGET = 20_000.0
_LOWEST = 5.0
_CLOSING = 0.7  # m/s per metre behind
_MOVING_S = 1.5  # how long the speed between two targets is believed


def follow_code(
    command: FollowStart, site: Site, here: LocalPlace, home: LocalPlace
) -> MissionCode:
    """The code for 0x03/0x30, judged by its values and by where the aircraft is."""
    if not is_on_earth(command.latitude, command.longitude):
        return MissionCode.BAD_PARAMETERS
    target = site.place(command.latitude, command.longitude, 0.0)
    checks = (
        (command.mode != 0 or command.yaw_mode > 1, MissionCode.BAD_PARAMETERS),
        (
            math.hypot(target.north - here.north, target.east - here.east) > _FARTHEST_TARGET,
            MissionCode.TARGET_TOO_FAR,
        ),
        (
            math.hypot(here.north - home.north, here.east - home.east) > site.radius_limit,
            MissionCode.TOO_FAR_FROM_HOME,
        ),
        (here.up < _LOWEST, MissionCode.TOO_LOW),
    )
    return next((code for is_wrong, code in checks if is_wrong), MissionCode.SUCCESS)


class FollowExecution:
    """One pursuit under way; :meth:`guide` once per step of the dynamics."""

    KIND = 3  # first byte of its status push

    def __init__(
        self,
        command: FollowStart,
        motion: Dynamics,
        airframe: Airframe,
        settings: MissionSettings,
        site: Site,
    ) -> None:
        self.events: list[WaypointEvent] = []
        self.then = FinishAction.NONE  # nothing comes after it
        self.is_over = self.flies_without_rc = False
        self.silence = 0.0  # seconds since the last target
        self._motion = motion
        self._airframe = airframe
        self._settings = settings
        self._site = site
        looks = command.yaw_mode == 1
        self._looks_at_target = looks is not settings.follow_yaw_reversed
        self._target = site.place(command.latitude, command.longitude, 0.0)
        self._offset = motion.north - self._target.north, motion.east - self._target.east
        # Of the target, m/s; taken from its last two places.
        self._velocity = (0.0, 0.0)
        self._height = motion.height
        # Height of the aircraft above the target's altitude, kept from the first one that is not 0.
        self._above: float | None = None
        self._heed_altitude(command.altitude)

    def status(self, is_paused: bool) -> FollowStatus:
        return FollowStatus()

    @property
    def doing(self) -> str:
        is_silent = self.silence > self._settings.follow_silence
        return "hovers: the target is silent" if is_silent else "follows"

    @property
    def is_lost(self) -> bool:
        """Whether the target has been silent for so long that it is given up."""
        return self.silence > self._settings.follow_lost

    def update(self, command: FollowTarget) -> None:
        """The target is there now; what cannot be is ignored."""
        if not is_on_earth(command.latitude, command.longitude):
            return
        target = self._site.place(command.latitude, command.longitude, 0.0)
        moved = target.north - self._target.north, target.east - self._target.east
        if math.hypot(*moved) > self._settings.follow_jump:
            return
        if 0.05 < self.silence < _MOVING_S:
            self._velocity = moved[0] / self.silence, moved[1] / self.silence
        elif self.silence >= _MOVING_S:
            self._velocity = (0.0, 0.0)
        self._target = target
        self.silence = 0.0
        self._heed_altitude(command.altitude)

    def _heed_altitude(self, altitude: int) -> None:
        if altitude == 0:
            return
        if self._above is None:
            self._above = self._height - altitude
        wanted = altitude + self._above
        self._height = max(_LOWEST, min(self._site.height_limit, wanted))

    def resume(self) -> None:
        """Go on after a pause with the distance that was kept before."""

    def guide(self, sticks: Sticks) -> DynamicsInput:
        self.silence += STEP_S
        motion, target = self._motion, self._target
        yaw_mode, yaw = ModelYaw.RATE, sticks.yaw * math.radians(self._airframe.yaw_rate_deg)
        north, east = target.north - motion.north, target.east - motion.east
        if self._looks_at_target and math.hypot(north, east) > 1.0:
            yaw_mode, yaw = ModelYaw.ANGLE, math.atan2(east, north)
        if self.silence > self._settings.follow_silence:
            return DynamicsInput(
                vertical=ModelVertical.HEIGHT, up=self._height, yaw_mode=yaw_mode, yaw=yaw
            )
        moves_north, moves_east = self._velocity
        age = min(self.silence, _MOVING_S)
        if self.silence > _MOVING_S:
            moves_north = moves_east = 0.0  # it is taken as standing still where it was seen last
            age = 0.0
        behind_north = north + self._offset[0] + moves_north * age
        behind_east = east + self._offset[1] + moves_east * age
        wanted_north = moves_north + _CLOSING * behind_north
        wanted_east = moves_east + _CLOSING * behind_east
        speed = math.hypot(wanted_north, wanted_east)
        share = min(1.0, self._settings.follow_speed / speed) if speed > 0.0 else 0.0
        return DynamicsInput(
            ModelHorizontal.VELOCITY,
            share * wanted_north,
            share * wanted_east,
            vertical=ModelVertical.HEIGHT,
            up=self._height,
            yaw_mode=yaw_mode,
            yaw=yaw,
        )
