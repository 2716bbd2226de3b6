"""Following a target: the distance kept that the two had at the start."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from m100link.protocol.codes import MissionCode
from m100link.protocol.commands.missions import FollowStatus, WaypointEvent
from m100link.sim.vehicle.dynamics import STEP_S, Guidance, ModelHorizontal, ModelVertical, ModelYaw
from m100link.sim.vehicle.missions.plan import FinishAction
from m100link.sim.vehicle.missions.route import Site, is_on_earth

if TYPE_CHECKING:
    from m100link.protocol.commands.follow import FollowStart, FollowTarget
    from m100link.sim.vehicle.dynamics import Airframe, Dynamics
    from m100link.sim.vehicle.missions.route import MissionSettings, Place
    from m100link.sim.vehicle.remote import Sticks


_FARTHEST_TARGET = 20_000.0
_LOWEST = 5.0
_CLOSING = 0.7  # m/s per metre behind
_MOVING_S = 1.5  # how long the speed between two targets is believed


def follow_code(command: FollowStart, site: Site, here: Place, home: Place) -> MissionCode:
    """What is wrong with 0x03/0x30 by itself and where the aircraft is."""
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


class FollowFlight:
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
        self.then = FinishAction.NONE  # what comes after: nothing
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
        """What the push shows."""
        return FollowStatus()

    @property
    def doing(self) -> str:
        """What it does, in words."""
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

    def guide(self, sticks: Sticks) -> Guidance:
        """What the aircraft is to do now."""
        self.silence += STEP_S
        motion, target = self._motion, self._target
        yaw_mode, yaw = ModelYaw.RATE, sticks.yaw * math.radians(self._airframe.yaw_rate_deg)
        north, east = target.north - motion.north, target.east - motion.east
        if self._looks_at_target and math.hypot(north, east) > 1.0:
            yaw_mode, yaw = ModelYaw.ANGLE, math.atan2(east, north)
        if self.silence > self._settings.follow_silence:
            return Guidance(
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
        return Guidance(
            ModelHorizontal.VELOCITY,
            share * wanted_north,
            share * wanted_east,
            vertical=ModelVertical.HEIGHT,
            up=self._height,
            yaw_mode=yaw_mode,
            yaw=yaw,
        )
