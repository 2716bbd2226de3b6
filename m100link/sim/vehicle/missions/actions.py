"""What the aircraft does at a waypoint: one action after the other, all within a time limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from m100link.protocol.commands.gimbal import GimbalAngle, GimbalAngleMode
from m100link.sim.vehicle.dynamics import STEP_S, Dynamics
from m100link.sim.vehicle.flight import FlightController
from m100link.sim.vehicle.gimbal import Camera, GimbalMount
from m100link.sim.vehicle.missions.plan import ActionKind
from m100link.sim.vehicle.missions.settings import MissionSettings
from m100link.sim.vehicle.missions.steering import Nose, wrapped

if TYPE_CHECKING:
    from m100link.protocol.commands.waypoint import WaypointPoint

__all__ = ["ActionRunner", "Payload", "aim_gimbal"]

_LONGEST_CAMERA_ACTION_S = 6.0
_GIMBAL_RATE_DEG = 45.0
_TRY_AGAIN_S = 0.25
_TURNED = math.radians(2.0)
_PITCH_ALONE = GimbalAngleMode.ABSOLUTE | GimbalAngleMode.KEEP_YAW | GimbalAngleMode.KEEP_ROLL


def aim_gimbal(gimbal: GimbalMount, pitch_deg: float, seconds: float) -> None:
    """Let the gimbal reach a pitch in some seconds, and leave its other axes alone."""
    gimbal.point(GimbalAngle(pitch_deg=pitch_deg, mode=_PITCH_ALONE, duration_s=seconds))


class Payload:
    """What hangs below, as far as a mission uses it.

    Args:
        gimbal, camera: They.
        flight: Knows the time.
        log: Notes what happens at which waypoint, for people.

    Attributes:
        gimbal: As given.
    """

    __slots__ = ("_camera", "_flight", "_log", "gimbal")

    def __init__(
        self,
        gimbal: GimbalMount,
        camera: Camera,
        flight: FlightController,
        log: Callable[[str], None],
    ) -> None:
        self.gimbal = gimbal
        self._camera = camera
        self._flight = flight
        self._log = log

    def take_photo(self, index: int) -> bool:
        """Take a photograph at a waypoint. False while the camera still takes another one."""
        is_taken = self._camera.take_photo(self._flight.now)
        if is_taken:
            self._log(f"waypoint {index}: photo")
        return is_taken

    def record(self, on: bool, index: int) -> None:
        """Start or stop the video at a waypoint; what it does already changes nothing."""
        if self._camera.start_video() if on else self._camera.stop_video():
            self._log(f"waypoint {index}: video {'on' if on else 'off'}")


class ActionRunner:
    """The actions of one waypoint; :meth:`step` once per step of the dynamics until it is done.

    Args:
        point: The waypoint.
        payload: What hangs below.
        motion: The aircraft.
        nose: Where the mission points it.
        settings: How long things take.
    """

    __slots__ = (
        "_is_done",
        "_left",
        "_limit",
        "_motion",
        "_nose",
        "_payload",
        "_point",
        "_running",
        "_settings",
        "_waits_for_nose",
    )

    def __init__(
        self,
        point: WaypointPoint,
        payload: Payload,
        motion: Dynamics,
        nose: Nose,
        settings: MissionSettings,
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
        """Whether there is anything left to do."""
        return not self._is_done
