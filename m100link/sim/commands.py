"""The aircraft's side of each command of the onboard device: the action and the answer.

The order of the checks is the order of this list: no such command (0xFF00), not activated (0xFF01),
level too low (0xFF02), a value that cannot be read, then the command's own codes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from m100link.errors import BadSetpoint
from m100link.protocol.codes import (
    AckCode,
    ActivationCode,
    MissionCode,
    MobileDataCode,
    RatesCode,
    SystemCode,
    TaskStartCode,
    VersionCode,
)
from m100link.protocol.command import Acknowledged, Address, Command, Request, encode_code
from m100link.protocol.commands import activation, control, gimbal, hotpoint, virtual_rc, waypoint
from m100link.protocol.commands.missions import COMMAND_SET, PauseResume
from m100link.protocol.commands.registry import COMMANDS, address_of
from m100link.protocol.firmware import FirmwareProfile
from m100link.protocol.records import Device
from m100link.protocol.setpoint import ReceivedMove
from m100link.sim.vehicle.missions.computer import Flown
from m100link.sim.vehicle.missions.hotpoint import FollowExecution, HotpointExecution
from m100link.sim.vehicle.missions.plan import MissionOrder
from m100link.sim.vehicle.missions.waypoints import WaypointExecution
from m100link.sim.vehicle.vehicle import Vehicle
from m100link.wire.frame import Frame

_MISSIONS = bytes((COMMAND_SET,))

UNCONFIRMED = frozenset(
    (hotpoint.HotpointSetRate, hotpoint.HotpointSetRadius, hotpoint.HotpointResetYaw)
)
"""Commands without an ack, except where ``MissionSettings.hotpoint_acks`` asks for one."""

_OK = MissionCode.SUCCESS


class CommandReply(NamedTuple):
    """Answer to a command."""

    payload: bytes  # data of the ack
    plain: bool = False  # send it plain even if the command came encrypted
    begins_anew: bool = False  # a program begins: earlier answers are forgotten


class LastCommand(NamedTuple):
    """A command that arrived, for tests and the live view."""

    time: float  #: Seconds since power-on.
    address: Address | None  #: Command set and id, None when the data were too short for them.
    session: int  #: Session that it used.
    encrypted: bool  #: Whether it travelled encrypted.
    command: Command | None  #: The parsed command, None when it could not be read.
    code: int | None  #: Its ack code, None when it has no ack; missions have one byte of code.


@dataclass(slots=True)
class Counters:
    """Counts of the frames on the line and of their outcomes."""

    movements: int = 0  #: Movement commands received.
    #: Those without effect, by no authority, illegal, on the ground, no GPS.
    ignored_movements: int = 0
    undecodable: int = 0  #: Encrypted frames that could not be read as a command.
    dropped_frames: int = 0  #: Frames that nobody fetched in time.


class CommandedAircraft(Protocol):
    """An aircraft that carries out commands: a vehicle, answers of its own, and a record."""

    vehicle: Vehicle
    profile: FirmwareProfile
    counters: Counters  # of the frames on the line
    received_movements: deque[control.Move]  # newest last
    received_commands: deque[LastCommand]

    def version(self, code: VersionCode) -> activation.Version:
        """The answer to a version query."""
        ...

    def activate(self, request: activation.Activate) -> ActivationCode:
        """The answer to an activation."""
        ...

    def set_rates(self, rates_hz: dict[str, int]) -> None:
        """Send telemetry items at these rates."""


class CommandTable:
    """Executes commands for one autopilot: a table from the class of a command to its action."""

    def __init__(self, autopilot: CommandedAircraft) -> None:
        self._autopilot = autopilot
        self._vehicle = autopilot.vehicle
        self._profile = autopilot.profile
        # A program repeats a setpoint fifty times a second: read it once.
        self._last_move: tuple[bytes, control.Move, ReceivedMove | None] | None = None
        vehicle = autopilot.vehicle
        missions = self._missions = vehicle.missions
        self._handlers: dict[type[Command], Callable[[Any], Any]] = {
            activation.GetVersion: self._version,
            activation.Activate: autopilot.activate,
            activation.SetTelemetryRates: self._rates,
            activation.SendToMobile: self._to_mobile,
            control.RequestAuthority: lambda command: vehicle.request_authority(command.obtain),
            control.StartTask: self._start_task,
            control.QueryTask: lambda command: vehicle.flight.tasks.query(command.task_sequence),
            control.Arm: self._arm,
            gimbal.GimbalSpeed: lambda command: vehicle.gimbal.turn(command, vehicle.time),
            gimbal.GimbalAngle: vehicle.gimbal.point,
            gimbal.TakePhoto: lambda _: vehicle.camera.take_photo(vehicle.time),
            gimbal.StartVideo: lambda _: vehicle.camera.record(True),
            gimbal.StopVideo: lambda _: vehicle.camera.record(False),
            virtual_rc.Sync: lambda _: None,  # a Matrice 100 has no output for it
            virtual_rc.VirtualRcSettings: vehicle.switch_virtual_rc,
            virtual_rc.VirtualRcData: self._feed_virtual_rc,
            waypoint.WaypointMission: missions.begin_upload,
            waypoint.WaypointPoint: lambda point: waypoint.WaypointPointAnswer(
                missions.add(point), point.index
            ),
            waypoint.WaypointStartStop: self._start_or_stop,
            waypoint.WaypointPauseResume: self._pauses(WaypointExecution),
            waypoint.WaypointDownloadMission: self._download_mission,
            waypoint.WaypointDownloadPoint: self._download_point,
            waypoint.WaypointSetIdleSpeed: lambda command: self._idle_speed(
                missions.set_idle_speed(command.idle_speed)
            ),
            waypoint.WaypointGetIdleSpeed: lambda _: self._idle_speed(
                missions.refusal(WaypointExecution, MissionOrder.SPEED)
            ),
            hotpoint.HotpointStart: self._start_hotpoint,
            hotpoint.HotpointStop: lambda _: missions.stop(HotpointExecution),
            hotpoint.HotpointPauseResume: self._pauses(HotpointExecution),
            hotpoint.HotpointSetRate: self._changes(
                lambda circle, command: circle.set_rate(command.clockwise, command.angular_rate)
            ),
            hotpoint.HotpointSetRadius: self._changes(
                lambda circle, command: circle.set_radius(command.radius)
            ),
            hotpoint.HotpointResetYaw: self._changes(lambda circle, _: circle.reset_yaw()),
            hotpoint.HotpointDownload: self._download_hotpoint,
            hotpoint.HotpointAutoRadius: lambda _: MissionCode.NOT_SUPPORTED,
            hotpoint.FollowStart: missions.start_follow,
            hotpoint.FollowStop: lambda _: missions.stop(FollowExecution),
            hotpoint.FollowPauseResume: self._pauses(FollowExecution),
            hotpoint.FollowTarget: self._update_target,
        }
        kinds: tuple[type[Command], ...] = (control.Move, *self._handlers)
        self._kinds: dict[tuple[int, int], type[Command]] = {
            kind.ADDRESS: kind for kind in kinds if kind.is_known_to(self._profile)
        }

    def knows(self, data: bytes) -> bool:
        """Whether data begin with the address of a command that this firmware has."""
        return self._kind_of(data) is not None or data[:1] == _MISSIONS

    def _kind_of(self, data: bytes) -> type[Command] | None:
        return self._kinds.get((data[0], data[1])) if len(data) >= 2 else None

    def execute(self, frame: Frame) -> CommandReply | None:
        """Carry a command out; None where nothing is answered."""
        kind = self._kind_of(frame.data)
        if kind is control.Move:
            self._execute_move(frame)
            return None
        reply: CommandReply | None = None
        if kind is None:
            reply = _unknown(frame.data)
            self._note(frame, None, reply)
            return reply
        command, answer = self._execute(kind, frame)
        if answer is not None and issubclass(kind, Acknowledged) and self._answers(kind):
            begins_anew = issubclass(kind, activation.GetVersion)
            reply = CommandReply(kind.encode_ack(answer), kind.ACK_IS_PLAIN, begins_anew)
        self._note(frame, command, reply)
        return reply

    def _answers(self, kind: type[Command]) -> bool:
        """Whether a command has an ack: requests, and where chosen some that a real one lacks."""
        is_chosen = kind in UNCONFIRMED and self._vehicle.settings.missions.hotpoint_acks
        return issubclass(kind, Request) or is_chosen

    def _execute(self, kind: type[Command], frame: Frame) -> tuple[Command | None, Any]:
        code = self._refusal(kind, frame)
        if code is not None:
            return None, code
        try:
            command = kind.parse(frame.data[2:], self._profile)
        except ValueError:
            return None, kind.unreadable(self._profile) if issubclass(kind, Acknowledged) else None
        return command, self._handlers[kind](command)

    def _refusal(self, kind: type[Command], frame: Frame) -> AckCode | None:
        """The codes that come before the value is looked at."""
        active = self._vehicle.activation.active
        if kind is activation.Activate and frame.encrypted:
            return ActivationCode.ENCRYPTED
        if not kind.NEEDS_ACTIVATION:
            return None
        if active is None:
            return SystemCode.NOT_ACTIVATED
        if active.level < kind.LEVEL:
            return SystemCode.LEVEL_TOO_LOW
        is_control = kind.ADDRESS.command_set == 0x01
        if self._vehicle.settings.encrypted_control_only and is_control and not frame.encrypted:
            return SystemCode.NOT_SUPPORTED
        return None

    def _note(self, frame: Frame, command: Command | None, reply: CommandReply | None) -> None:
        address = address_of(frame.data)
        has_short_code = frame.data[:1] == _MISSIONS and not _is_system_code(reply)
        code_size = 1 if has_short_code else 2
        code = int.from_bytes(reply.payload[:code_size], "little") if reply else None
        self._autopilot.received_commands.append(
            LastCommand(self._vehicle.time, address, frame.session, frame.encrypted, command, code)
        )

    # --- set 0x00 ---------------------------------------------------------------------------

    def _version(self, command: activation.GetVersion) -> activation.Version:
        is_active = self._vehicle.activation.active is not None
        code = VersionCode.ACTIVATED if is_active else VersionCode(SystemCode.NOT_ACTIVATED)
        return self._autopilot.version(code)

    def _rates(self, command: activation.SetTelemetryRates) -> RatesCode:
        if not command.is_taken:
            return RatesCode.INVALID_PARAMETERS
        self._autopilot.set_rates(command.rates_hz)
        return RatesCode.SUCCESS

    def _to_mobile(self, command: activation.SendToMobile) -> MobileDataCode:
        self._vehicle.app.receive(command.data)
        return MobileDataCode.SUCCESS

    # --- set 0x01 ---------------------------------------------------------------------------

    def _has_authority(self) -> bool:
        return self._vehicle.authority.device is Device.ONBOARD

    def _start_task(self, command: control.StartTask) -> TaskStartCode:
        flight = self._vehicle.flight
        code = flight.start_task(command.task_sequence, command.task, self._has_authority())
        self._vehicle.log(f"task {command.task}: {code.meaning}")
        return code

    def _execute_move(self, frame: Frame) -> None:
        """The road of movement: as all others, without an answer, and read once per setpoint."""
        autopilot = self._autopilot
        autopilot.counters.movements += 1
        if self._refusal(control.Move, frame) is not None:
            autopilot.counters.ignored_movements += 1
            return
        value = frame.data[2:]
        last = self._last_move
        if last is None or last[0] != value:
            try:
                move = control.Move.parse(value, self._profile)
            except ValueError:
                autopilot.counters.ignored_movements += 1
                return
            last = self._last_move = (value, move, self._setpoint(move))
        autopilot.received_movements.append(last[1])
        self._fly(last[2])

    def _setpoint(self, move: control.Move) -> ReceivedMove | None:
        try:
            return ReceivedMove.read(move, self._profile)
        except BadSetpoint:
            return None

    def _fly(self, setpoint: ReceivedMove | None) -> None:
        flight = self._vehicle.flight
        if setpoint is None or not self._has_authority() or not flight.move(setpoint):
            self._autopilot.counters.ignored_movements += 1

    def _arm(self, command: control.Arm) -> AckCode:
        if command.problems():
            return control.Arm.unreadable(self._profile)
        return self._vehicle.flight.arm(bool(command.on), self._has_authority())

    # --- set 0x05 ---------------------------------------------------------------------------

    def _feed_virtual_rc(self, command: virtual_rc.VirtualRcData) -> None:
        self._vehicle.remote.virtual.feed(command, self._vehicle.time)
        self._vehicle.refresh()

    # --- set 0x03 ---------------------------------------------------------------------------

    def _pauses(self, kind: type[Flown]) -> Callable[[PauseResume], MissionCode]:
        def pause_or_resume(command: PauseResume) -> MissionCode:
            if command.resume > 1:
                return MissionCode.WRONG_VALUE
            act = self._missions.resume if command.resume else self._missions.pause
            return act(kind)

        return pause_or_resume

    def _start_or_stop(self, command: waypoint.WaypointStartStop) -> MissionCode:
        if command.stop > 1:
            return MissionCode.WRONG_VALUE
        return self._missions.stop(WaypointExecution) if command.stop else self._missions.start()

    def _download_mission(self, command: waypoint.WaypointDownloadMission) -> Any:
        code = self._missions.refusal(WaypointExecution, MissionOrder.DOWNLOAD)
        mission = self._missions.upload.mission
        return code if mission is None else waypoint.WaypointMissionAnswer(_OK, mission)

    def _download_point(self, command: waypoint.WaypointDownloadPoint) -> Any:
        point = self._missions.upload.points.get(command.index)
        return (
            MissionCode.NO_POINTS if point is None else waypoint.WaypointDownloadedPoint(_OK, point)
        )

    def _idle_speed(self, code: MissionCode) -> waypoint.IdleSpeedAnswer:
        mission = self._missions.upload.mission
        return waypoint.IdleSpeedAnswer(code, 0.0 if mission is None else mission.idle_speed)

    def _start_hotpoint(self, command: hotpoint.HotpointStart) -> hotpoint.HotpointStartAnswer:
        code = self._missions.start_hotpoint(command)
        return hotpoint.HotpointStartAnswer(code, self._missions.largest_radius(command))

    @property
    def _hotpoint(self) -> HotpointExecution | None:
        running = self._missions.running
        return running if isinstance(running, HotpointExecution) else None

    def _changes(
        self, change: Callable[[HotpointExecution, Any], None]
    ) -> Callable[[Any], MissionCode | None]:
        def answer(command: Any) -> MissionCode | None:
            """A real aircraft does not answer; see ``MissionSettings.hotpoint_acks``."""
            circle = self._hotpoint
            if circle is not None:
                change(circle, command)
            if not self._vehicle.settings.missions.hotpoint_acks:
                return None
            return MissionCode.NOT_RUNNING if circle is None else _OK

        return answer

    def _download_hotpoint(self, command: hotpoint.HotpointDownload) -> Any:
        circle = self._hotpoint
        if circle is None:
            return MissionCode.NOT_RUNNING
        return hotpoint.HotpointDownloadAnswer(_OK, circle.command)

    def _update_target(self, command: hotpoint.FollowTarget) -> None:
        running = self._missions.running
        if isinstance(running, FollowExecution):
            running.update(command)


def _is_system_code(reply: CommandReply | None) -> bool:
    """Whether an ack of set 0x03 is the two bytes 0xFF01 or 0xFF02: no waypoint is number 255."""
    return reply is not None and len(reply.payload) == 2 and reply.payload[1] == 0xFF


def _unknown(data: bytes) -> CommandReply | None:
    if data[:1] == _MISSIONS and len(data) >= 2:
        payload = refusal(data)
        return None if payload is None else CommandReply(payload)
    return CommandReply(encode_code(SystemCode.NOT_SUPPORTED))


def refusal(data: bytes) -> bytes | None:
    """The ack of a firmware that does not know a mission command; None for the one without an ack.

    It has the shape of the ack that the host expects: of 0xFF00, "not supported" elsewhere, DJI's
    programs read the first byte, and 0 is success.
    """
    address = address_of(data)
    kind = COMMANDS.get(address) if address else None
    if kind is hotpoint.FollowTarget:
        return None
    if kind is waypoint.WaypointPoint:
        index = data[2] if len(data) > 2 else 0
        return kind.encode_ack(waypoint.WaypointPointAnswer(MissionCode.NOT_SUPPORTED, index))
    if kind is not None and issubclass(kind, Acknowledged):
        return kind.encode_ack(MissionCode.NOT_SUPPORTED)
    return bytes((MissionCode.NOT_SUPPORTED,))
