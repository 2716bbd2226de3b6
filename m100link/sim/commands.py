"""Every command of the onboard device and its answer (document 2.2.1 and 2.2.2).

The order of the checks is the order of this list: no such command (0xFF00), not activated (0xFF01),
level too low (0xFF02), then the command's own codes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from m100link.errors import BadSetpoint
from m100link.protocol.codes import (
    ActivationCode,
    ArmCode,
    MobileDataCode,
    RatesCode,
    SystemCode,
    TaskResultCode,
    TaskStartCode,
    VersionCode,
)
from m100link.protocol.command import Address, Command, encode_code
from m100link.protocol.commands.activation import (
    Activate,
    GetVersion,
    SendToMobile,
    SetTelemetryRates,
)
from m100link.protocol.commands.control import Arm, Move, QueryTask, RequestAuthority, StartTask
from m100link.protocol.records import Device
from m100link.protocol.setpoint import Setpoint
from m100link.wire.frame import Frame

if TYPE_CHECKING:
    from m100link.sim.autopilot import Autopilot

__all__ = ["Commands", "LastCommand", "Reply"]

_GIMBAL_RATE, _GIMBAL_ANGLE = Address(0x01, 0x1A), Address(0x01, 0x1B)
_PHOTO, _START_VIDEO, _STOP_VIDEO = Address(0x01, 0x20), Address(0x01, 0x21), Address(0x01, 0x22)
_CAMERA = (_PHOTO, _START_VIDEO, _STOP_VIDEO)
_OWN_ACTIVATION = frozenset((GetVersion.ADDRESS, Activate.ADDRESS, SetTelemetryRates.ADDRESS))

_VIRTUAL_RC, _VIRTUAL_RC_DATA = Address(0x05, 0x00), Address(0x05, 0x01)

_WITHOUT_ACK = frozenset(
    (Move.ADDRESS, _GIMBAL_RATE, _GIMBAL_ANGLE, *_CAMERA, _VIRTUAL_RC, _VIRTUAL_RC_DATA)
)

LEVELS: dict[Address, int] = {
    GetVersion.ADDRESS: 0,
    Activate.ADDRESS: 0,
    SetTelemetryRates.ADDRESS: 0,
    SendToMobile.ADDRESS: 0,
    RequestAuthority.ADDRESS: 2,
    StartTask.ADDRESS: 2,
    QueryTask.ADDRESS: 2,
    Move.ADDRESS: 2,
    Arm.ADDRESS: 2,
    _GIMBAL_RATE: 1,
    _GIMBAL_ANGLE: 1,
    _PHOTO: 1,
    _START_VIDEO: 1,
    _STOP_VIDEO: 1,
    _VIRTUAL_RC: 0,
    _VIRTUAL_RC_DATA: 0,
}
"""Authorization level that each command needs (document 2.1)."""


class Reply(NamedTuple):
    """Answer to a command.

    Attributes:
        payload: Data of the ack.
        plain: Send it plain even if the command came encrypted.
    """

    payload: bytes
    plain: bool = False


class LastCommand(NamedTuple):
    """A command that arrived, for tests and the live view.

    Attributes:
        time: Seconds since power-on.
        address: Command set and id, None when the data were too short for them.
        session: Session that it used.
        encrypted: Whether it travelled encrypted.
        command: The parsed command, None when it could not be read.
        code: Its ack code, None when it has no ack.
    """

    time: float
    address: Address | None
    session: int
    encrypted: bool
    command: Command | None
    code: int | None


class Commands:
    """Executes commands for one autopilot."""

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._profile = profile = autopilot.profile
        self._last_move: tuple[bytes, Move, Setpoint | None] | None = None
        handlers: dict[Address, Callable[[Frame], Reply | None]] = {
            GetVersion.ADDRESS: self._version,
            Activate.ADDRESS: self._activate,
            SendToMobile.ADDRESS: self._to_mobile,
            RequestAuthority.ADDRESS: self._authority,
            StartTask.ADDRESS: self._start_task,
            QueryTask.ADDRESS: self._query_task,
            Move.ADDRESS: self._move,
        }
        if profile.has_rates_command:
            handlers[SetTelemetryRates.ADDRESS] = self._rates
        if profile.has_arm_command:
            handlers[Arm.ADDRESS] = self._arm
        if profile.has_virtual_rc:
            handlers[_VIRTUAL_RC] = handlers[_VIRTUAL_RC_DATA] = self._virtual_rc
        if profile.has_gimbal_commands:
            handlers[_GIMBAL_RATE] = handlers[_GIMBAL_ANGLE] = self._gimbal
            handlers.update(dict.fromkeys(_CAMERA, self._camera))
        self._handlers = handlers
        self._parsed: Command | None = None

    def knows(self, data: bytes) -> bool:
        """Whether data begin with the address of a command that this firmware has."""
        return len(data) >= 2 and Address(data[0], data[1]) in self._handlers

    def execute(self, frame: Frame) -> Reply | None:
        """Carry a command out; None where nothing is answered."""
        data = frame.data
        address = Address(data[0], data[1]) if len(data) >= 2 else None
        handler = self._handlers.get(address) if address is not None else None
        self._parsed = None
        if handler is None or address is None:
            reply: Reply | None = _code(SystemCode.NOT_SUPPORTED)
        else:
            reply = self._gate(address, frame)
            if reply is None:
                reply = handler(frame)
            elif address in _WITHOUT_ACK:
                reply = None
                if address == Move.ADDRESS:
                    self._autopilot.counters.movements += 1
                    self._autopilot.counters.ignored_movements += 1
        if address != Move.ADDRESS:
            code = int.from_bytes(reply.payload[:2], "little") if reply else None
            self._note(frame, address, code)
        return reply

    def _gate(self, address: Address, frame: Frame) -> Reply | None:
        """The system codes that come before the command's own. Movement gets no answer at all."""
        autopilot = self._autopilot
        active = autopilot.activation.active
        if address in _OWN_ACTIVATION:
            return None
        code: SystemCode | None = None
        if active is None:
            code = SystemCode.NOT_ACTIVATED
        elif active.level < LEVELS[address]:
            code = SystemCode.LEVEL_TOO_LOW
        elif (
            autopilot.settings.encrypted_control_only
            and address.command_set == 0x01
            and not frame.encrypted
        ):
            code = SystemCode.NOT_SUPPORTED
        return None if code is None else _code(code)

    def _note(self, frame: Frame, address: Address | None, code: int | None) -> None:
        autopilot = self._autopilot
        command = LastCommand(
            autopilot.time, address, frame.session, frame.encrypted, self._parsed, code
        )
        autopilot.received_commands.append(command)

    # --- set 0x00 ---------------------------------------------------------------------------

    def _version(self, frame: Frame) -> Reply:
        self._parsed = GetVersion()
        autopilot = self._autopilot
        is_active = autopilot.activation.active is not None
        code = VersionCode.ACTIVATED if is_active else VersionCode(SystemCode.NOT_ACTIVATED)
        return Reply(autopilot.version(code).encode(), plain=True)

    def _activate(self, frame: Frame) -> Reply:
        if frame.encrypted:
            return _code(ActivationCode.ENCRYPTED, plain=True)
        try:
            request = Activate.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(ActivationCode.INVALID_PARAMETERS, plain=True)
        self._parsed = request
        return _code(self._autopilot.activate(request), plain=True)

    def _rates(self, frame: Frame) -> Reply:
        try:
            command = SetTelemetryRates.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(RatesCode.INVALID_PARAMETERS)
        self._parsed = command
        self._autopilot.set_rates(command.rates_hz)
        return _code(RatesCode.SUCCESS)

    def _to_mobile(self, frame: Frame) -> Reply:
        try:
            command = SendToMobile.parse(frame.data[2:], self._profile)
        except ValueError:
            # The document lists success only; a message that cannot be one is no such command.
            return _code(SystemCode.NOT_SUPPORTED)
        self._parsed = command
        self._autopilot.app.receive(command.data)
        return _code(MobileDataCode.SUCCESS)

    # --- set 0x01 ---------------------------------------------------------------------------

    def _authority(self, frame: Frame) -> Reply:
        autopilot = self._autopilot
        try:
            command = RequestAuthority.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(autopilot.authority.refusal)
        self._parsed = command
        return _code(autopilot.request_authority(command.obtain))

    def _start_task(self, frame: Frame) -> Reply:
        try:
            command = StartTask.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(TaskStartCode.REJECTED)
        self._parsed = command
        flight = self._autopilot.flight
        code = flight.start_task(command.task_sequence, command.task, self._has_authority())
        self._autopilot.log(f"task {command.task}: {code.meaning}")
        return _code(code)

    def _query_task(self, frame: Frame) -> Reply:
        try:
            command = QueryTask.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(TaskResultCode.NOT_CURRENT)
        self._parsed = command
        return _code(self._autopilot.flight.query_task(command.task_sequence))

    def _move(self, frame: Frame) -> None:
        autopilot = self._autopilot
        value = frame.data[2:]
        last = self._last_move
        if last is None or last[0] != value:
            try:
                move = Move.parse(value, self._profile)
            except ValueError:
                autopilot.counters.movements += 1
                autopilot.counters.ignored_movements += 1
                return
            try:
                setpoint = Setpoint.from_move(move, self._profile, clamp=True)
            except BadSetpoint:
                setpoint = None
            last = self._last_move = (value, move, setpoint)
        _, move, setpoint = last
        autopilot.received_movements.append(move)
        autopilot.counters.movements += 1
        if setpoint is None or not self._has_authority() or not autopilot.flight.move(setpoint):
            autopilot.counters.ignored_movements += 1

    def _arm(self, frame: Frame) -> Reply:
        try:
            command = Arm.parse(frame.data[2:], self._profile)
        except ValueError:
            return _code(SystemCode.NOT_SUPPORTED)
        self._parsed = command
        code: ArmCode = self._autopilot.flight.arm(command.on, self._has_authority())
        return _code(code)

    def _gimbal(self, frame: Frame) -> None:
        autopilot, value = self._autopilot, frame.data[2:]
        if frame.data[1] == _GIMBAL_RATE.command_id:
            autopilot.gimbal.turn(value, autopilot.time)
        else:
            autopilot.gimbal.point(value, autopilot.heading_deg)

    def _camera(self, frame: Frame) -> None:
        camera, command_id = self._autopilot.camera, frame.data[1]
        if command_id == _PHOTO.command_id:
            camera.photos += 1
        else:
            camera.is_recording = command_id == _START_VIDEO.command_id

    # --- set 0x05 ---------------------------------------------------------------------------

    def _virtual_rc(self, frame: Frame) -> None:
        autopilot, value = self._autopilot, frame.data[2:]
        if frame.data[1] == _VIRTUAL_RC.command_id:
            autopilot.remote.virtual.switch(value)
        else:
            autopilot.remote.virtual.feed(value, autopilot.time)
        autopilot.refresh()

    def _has_authority(self) -> bool:
        return self._autopilot.authority.device is Device.ONBOARD


def _code(code: int, *, plain: bool = False) -> Reply:
    return Reply(encode_code(code), plain)
