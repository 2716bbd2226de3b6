"""What the aircraft does with command set 0x03, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from m100link.protocol.codes import MissionCode
from m100link.protocol.command import Acknowledged, Command
from m100link.protocol.commands.follow import (
    FollowPauseResume,
    FollowStart,
    FollowStop,
    FollowTarget,
)
from m100link.protocol.commands.hotpoint import (
    HotpointAutoRadius,
    HotpointDownload,
    HotpointDownloadAnswer,
    HotpointPauseResume,
    HotpointResetYaw,
    HotpointSetRadius,
    HotpointSetRate,
    HotpointStart,
    HotpointStartAnswer,
    HotpointStop,
)
from m100link.protocol.commands.registry import COMMANDS, address_of
from m100link.protocol.commands.waypoint import (
    IdleSpeedAnswer,
    WaypointDownloadedPoint,
    WaypointDownloadMission,
    WaypointDownloadPoint,
    WaypointGetIdleSpeed,
    WaypointMission,
    WaypointMissionAnswer,
    WaypointPauseResume,
    WaypointPoint,
    WaypointPointAnswer,
    WaypointSetIdleSpeed,
    WaypointStartStop,
)
from m100link.sim.vehicle.missions.computer import Flown, MissionComputer
from m100link.sim.vehicle.missions.follow import FollowFlight
from m100link.sim.vehicle.missions.hotpoint import HotpointFlight
from m100link.sim.vehicle.missions.plan import Order
from m100link.sim.vehicle.missions.waypoints import WaypointFlight

if TYPE_CHECKING:
    from m100link.sim.vehicle.vehicle import Vehicle


UNCONFIRMED = frozenset((HotpointSetRate, HotpointSetRadius, HotpointResetYaw))
"""Commands without an ack, except where ``MissionSettings.hotpoint_acks`` asks for one."""

_OK = MissionCode.SUCCESS


class MissionCommands:
    """Carries mission commands out: :attr:`handlers` by the class of the command."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.handlers: dict[type[Command], Callable[[Any], Any]] = {
            WaypointMission: lambda command: self._missions.begin_upload(command),
            WaypointPoint: self._add,
            WaypointStartStop: self._start_or_stop,
            WaypointPauseResume: self._pauses(WaypointFlight),
            WaypointDownloadMission: self._download_mission,
            WaypointDownloadPoint: self._download_point,
            WaypointSetIdleSpeed: self._set_idle_speed,
            WaypointGetIdleSpeed: self._idle_speed,
            HotpointStart: self._start_hotpoint,
            HotpointStop: lambda _: self._missions.stop(HotpointFlight),
            HotpointPauseResume: self._pauses(HotpointFlight),
            HotpointSetRate: self._set_rate,
            HotpointSetRadius: self._set_radius,
            HotpointResetYaw: self._reset_yaw,
            HotpointDownload: self._download_hotpoint,
            HotpointAutoRadius: lambda _: MissionCode.NOT_SUPPORTED,
            FollowStart: lambda command: self._missions.start_follow(command),
            FollowStop: lambda _: self._missions.stop(FollowFlight),
            FollowPauseResume: self._pauses(FollowFlight),
            FollowTarget: self._update_target,
        }

    @property
    def _missions(self) -> MissionComputer:
        return self._vehicle.missions

    def _pauses(self, kind: type[Flown]) -> Callable[[Any], MissionCode]:
        def pause_or_resume(
            command: WaypointPauseResume | HotpointPauseResume | FollowPauseResume,
        ) -> MissionCode:
            if command.resume > 1:
                return MissionCode.WRONG_VALUE
            act = self._missions.resume if command.resume else self._missions.pause
            return act(kind)

        return pause_or_resume

    # --- waypoints --------------------------------------------------------------------------

    def _add(self, point: WaypointPoint) -> WaypointPointAnswer:
        return WaypointPointAnswer(self._missions.add(point), point.index)

    def _start_or_stop(self, command: WaypointStartStop) -> MissionCode:
        if command.stop > 1:
            return MissionCode.WRONG_VALUE
        return self._missions.stop(WaypointFlight) if command.stop else self._missions.start()

    def _download_mission(self, command: WaypointDownloadMission) -> Any:
        code = self._missions.refusal(WaypointFlight, Order.DOWNLOAD)
        mission = self._missions.upload.mission
        return code if mission is None else WaypointMissionAnswer(_OK, mission)

    def _download_point(self, command: WaypointDownloadPoint) -> Any:
        point = self._missions.upload.points.get(command.index)
        return MissionCode.NO_POINTS if point is None else WaypointDownloadedPoint(_OK, point)

    def _set_idle_speed(self, command: WaypointSetIdleSpeed) -> IdleSpeedAnswer:
        code = self._missions.set_idle_speed(command.idle_speed)
        mission = self._missions.upload.mission
        return IdleSpeedAnswer(code, 0.0 if mission is None else mission.idle_speed)

    def _idle_speed(self, command: WaypointGetIdleSpeed) -> IdleSpeedAnswer:
        code = self._missions.refusal(WaypointFlight, Order.SPEED)
        mission = self._missions.upload.mission
        return IdleSpeedAnswer(code, 0.0 if mission is None else mission.idle_speed)

    # --- hotpoint and follow ----------------------------------------------------------------

    def _start_hotpoint(self, command: HotpointStart) -> HotpointStartAnswer:
        code = self._missions.start_hotpoint(command)
        return HotpointStartAnswer(code, self._missions.largest_radius(command))

    @property
    def _hotpoint(self) -> HotpointFlight | None:
        running = self._missions.running
        return running if isinstance(running, HotpointFlight) else None

    def _confirmed(self) -> MissionCode | None:
        """The answer to a command that a real aircraft does not answer."""
        if not self._vehicle.settings.missions.hotpoint_acks:
            return None
        return MissionCode.NOT_RUNNING if self._hotpoint is None else _OK

    def _set_rate(self, command: HotpointSetRate) -> MissionCode | None:
        if self._hotpoint is not None:
            self._hotpoint.set_rate(command.clockwise, command.angular_rate)
        return self._confirmed()

    def _set_radius(self, command: HotpointSetRadius) -> MissionCode | None:
        if self._hotpoint is not None:
            self._hotpoint.set_radius(command.radius)
        return self._confirmed()

    def _reset_yaw(self, command: HotpointResetYaw) -> MissionCode | None:
        if self._hotpoint is not None:
            self._hotpoint.reset_yaw()
        return self._confirmed()

    def _download_hotpoint(self, command: HotpointDownload) -> Any:
        hotpoint = self._hotpoint
        if hotpoint is None:
            return MissionCode.NOT_RUNNING
        return HotpointDownloadAnswer(_OK, hotpoint.command)

    def _update_target(self, command: FollowTarget) -> None:
        running = self._missions.running
        if isinstance(running, FollowFlight):
            running.update(command)


def refusal(data: bytes) -> bytes | None:
    """The ack of a firmware that does not know a mission command; None for the one without an ack.

    It has the shape of the ack that the host expects: of 0xFF00, "not supported" elsewhere, DJI's
    programs read the first byte, and 0 is success.
    """
    address = address_of(data)
    kind = COMMANDS.get(address) if address else None
    if kind is FollowTarget:
        return None
    if kind is WaypointPoint:
        index = data[2] if len(data) > 2 else 0
        return kind.encode_ack(WaypointPointAnswer(MissionCode.NOT_SUPPORTED, index))
    if kind is not None and issubclass(kind, Acknowledged):
        return kind.encode_ack(MissionCode.NOT_SUPPORTED)
    return bytes((MissionCode.NOT_SUPPORTED,))
