"""Every error that m100link raises.

All of them derive from :class:`M100Error`, so one ``except`` catches the library and nothing else::

    M100Error
    ├── UsageError                 the caller's mistake, found before a byte is sent   (ValueError)
    │   ├── BadURL                 the connection string names no transport
    │   ├── BadKey                 not 32 bytes, not 64 hex digits
    │   ├── BadSetpoint            a value outside the document's table, NaN or infinity
    │   └── PayloadTooLarge        more than 1007 bytes, or 100 to the mobile device
    ├── LinkError                  the cable and what is at its end (ConnectionError)
    │   ├── PortNotFound           no such device (FileNotFoundError)
    │   ├── PortPermissionDenied   the device is there but not for this user (PermissionError)
    │   ├── PortBusy               another program has it
    │   ├── PortFailed             the system refused for another reason
    │   ├── LinkLost               the port went away under us
    │   ├── LinkClosed             we closed it
    │   └── NoAircraft             opened, but no usable answer came (TimeoutError)
    │       ├── SilentLine         not one byte arrived
    │       ├── NoValidFrame       bytes, but no frame: baud rate or noise
    │       └── NoAnswer           frames arrive, our request is not answered
    ├── AckTimeout                 no ack after all tries: the outcome is unknown (TimeoutError)
    ├── KeyRejected                plain requests are answered, encrypted ones are not
    ├── BadAck                     an ack that is too short for its command
    ├── CommandRefused             the aircraft answered, and the answer was no
    │   ├── ActivationRefused
    │   ├── NotActivated           system code 0xFF01
    │   ├── LevelTooLow            system code 0xFF02
    │   ├── CommandNotSupported    system code 0xFF00
    │   ├── AuthorityRefused
    │   └── TaskError              take-off, landing or go-home did not happen
    │       ├── TaskRefused        it was not begun
    │       └── TaskFailed         it was begun and the aircraft reports failure
    ├── NotObserved                begun, but telemetry never showed the result (TimeoutError)
    ├── AuthorityError
    │   ├── NoAuthority            movement was asked for without authority
    │   └── AuthorityLost          the pilot, the app or the link took it away
    ├── GuardRefused               a safety guard said no; it names itself and the measured value
    └── TelemetryError
        ├── TelemetryOverflow      a lossless consumer fell behind
        ├── TelemetryStalled       the stream went silent
        └── LayoutMismatch         a packet does not fit the firmware profile
"""

from __future__ import annotations

from enum import StrEnum
from typing import Self, TypeVar

__all__ = [
    "AckTimeout",
    "ActivationRefused",
    "AuthorityError",
    "AuthorityLost",
    "AuthorityRefused",
    "BadAck",
    "BadKey",
    "BadSetpoint",
    "BadURL",
    "CommandNotSupported",
    "CommandRefused",
    "GuardRefused",
    "KeyRejected",
    "LayoutMismatch",
    "LevelTooLow",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LossReason",
    "M100Error",
    "NoAircraft",
    "NoAnswer",
    "NoAuthority",
    "NoValidFrame",
    "NotActivated",
    "NotObserved",
    "PayloadTooLarge",
    "PortBusy",
    "PortFailed",
    "PortNotFound",
    "PortPermissionDenied",
    "SilentLine",
    "TaskError",
    "TaskFailed",
    "TaskRefused",
    "TelemetryError",
    "TelemetryOverflow",
    "TelemetryStalled",
    "UsageError",
]

E = TypeVar("E", bound="M100Error")


class M100Error(Exception):
    """Base of every error of this package.

    Attributes:
        seen: What was observed, in one sentence.
        cause: The most likely cause, or an empty string.
        remedy: What to do about it, or an empty string.
    """

    def __init__(self, seen: str, *, cause: str = "", remedy: str = "") -> None:
        self.seen = seen
        self.cause = cause
        self.remedy = remedy
        super().__init__(seen, cause, remedy)

    def __str__(self) -> str:
        text = self.seen
        if self.cause:
            text += f"\n  likely cause: {self.cause}"
        if self.remedy:
            text += f"\n  what to do:   {self.remedy}"
        return text

    def again(self) -> Self:
        """The same error, to be raised in another place: one exception object has one traceback."""
        fresh = _rebuild(type(self), self.args, self.__dict__)
        fresh.__cause__ = self.__cause__
        return fresh

    def __reduce__(self) -> tuple[object, ...]:
        # Subclasses take keyword arguments that the default pickling would lose.
        return (_rebuild, (type(self), self.args, self.__dict__))


def _rebuild(cls: type[E], args: tuple[object, ...], attributes: dict[str, object]) -> E:
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(attributes)
    return error


class UsageError(M100Error, ValueError):
    """The call itself is wrong; nothing was sent."""


class BadURL(UsageError):
    """The connection string names no transport that exists."""


class BadKey(UsageError):
    """A key is 32 bytes or 64 hex digits. The message never contains the key."""


class BadSetpoint(UsageError):
    """A setpoint value is not finite or lies outside the range of its control mode."""


class PayloadTooLarge(UsageError):
    """The data do not fit into one frame (document 1.2) or one transparent message (2.2.1.3)."""


class LinkError(M100Error, ConnectionError):
    """The serial line, socket or memory pair and what is at its other end."""


class PortNotFound(LinkError, FileNotFoundError):
    """No such device."""


class PortPermissionDenied(LinkError, PermissionError):
    """The device exists, this user may not open it."""


class PortBusy(LinkError):
    """Another program holds the port.

    Attributes:
        owners: ``(pid, process name)`` of the holders, where the system tells.
    """

    def __init__(
        self,
        seen: str,
        *,
        owners: tuple[tuple[int, str], ...] = (),
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.owners = owners


class PortFailed(LinkError):
    """The system could not open the port; its own error is chained."""


class LinkLost(LinkError):
    """The port went away: unplugged, reset, or the other end closed. The cause is chained."""


class LinkClosed(LinkError):
    """This side closed the link."""


class NoAircraft(LinkError, TimeoutError):
    """The port opened, but no aircraft answered before the deadline.

    Attributes:
        bytes_received: Bytes read in that time.
        frames_received: Frames with good checksums among them.
    """

    def __init__(
        self,
        seen: str,
        *,
        bytes_received: int = 0,
        frames_received: int = 0,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.bytes_received = bytes_received
        self.frames_received = frames_received


class SilentLine(NoAircraft):
    """Not one byte arrived."""


class NoValidFrame(NoAircraft):
    """Bytes arrived, but no frame among them had good checksums."""


class NoAnswer(NoAircraft):
    """Frames arrive from the aircraft, but it does not answer requests."""


class AckTimeout(M100Error, TimeoutError):
    """No ack came after the last try.

    The outcome is *unknown*: the command may have been executed and its ack lost.

    Attributes:
        command: Name of the command.
        session: Session it used.
        sequence: Its sequence number.
        tries: How many times it was transmitted.
    """

    def __init__(
        self,
        seen: str,
        *,
        command: str = "",
        session: int = 0,
        sequence: int = 0,
        tries: int = 0,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.command = command
        self.session = session
        self.sequence = sequence
        self.tries = tries


class KeyRejected(M100Error):
    """Plain requests are answered and encrypted ones are not: the keys on both sides differ.

    Attributes:
        command: Name of the encrypted command.
    """

    def __init__(self, seen: str, *, command: str = "", cause: str = "", remedy: str = "") -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.command = command


class BadAck(M100Error):
    """The aircraft acknowledged with fewer bytes than the command's ack has.

    Attributes:
        command: Name of the command.
        payload: The bytes of the ack.
    """

    def __init__(
        self,
        seen: str,
        *,
        command: str = "",
        payload: bytes = b"",
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.command = command
        self.payload = payload


class CommandRefused(M100Error):
    """The aircraft answered with a code that means no.

    Attributes:
        command: Name of the command.
        code: The ack code as an integer; unknown codes keep their number.
    """

    def __init__(
        self, seen: str, *, command: str = "", code: int = -1, cause: str = "", remedy: str = ""
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.command = command
        self.code = code


class ActivationRefused(CommandRefused):
    """Activation ended with a code other than success (document 2.2.1.2)."""


class NotActivated(CommandRefused):
    """The aircraft wants to be activated first (system code 0xFF01)."""


class LevelTooLow(CommandRefused):
    """The registered level of this app id does not allow the command (system code 0xFF02)."""


class CommandNotSupported(CommandRefused):
    """The firmware does not know the command, or could not decrypt it (system code 0xFF00).

    Of a command that the firmware is known not to have, nothing was sent; ``code`` is -1 then.
    """


class AuthorityRefused(CommandRefused):
    """Control authority was not given (document 2.2.2.1)."""


class TaskError(CommandRefused):
    """Take-off, landing or go-home did not happen.

    Attributes:
        situation: Telemetry values at that moment which explain it.
    """

    def __init__(
        self,
        seen: str,
        *,
        command: str = "",
        code: int = -1,
        situation: dict[str, object] | None = None,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, command=command, code=code, cause=cause, remedy=remedy)
        self.situation = situation or {}


class TaskRefused(TaskError):
    """Take-off, landing or go-home was rejected and not begun (document 2.2.2.2).

    Attributes:
        situation: Telemetry values at the moment of the refusal that explain it.
    """


class TaskFailed(TaskError):
    """The task was begun and the aircraft reports that it failed.

    Attributes:
        situation: Telemetry values at the moment of the report that explain it.
    """


class NotObserved(M100Error, TimeoutError):
    """A task was accepted, but neither telemetry nor the result query showed it done in time.

    Attributes:
        situation: Telemetry values when waiting ended.
    """

    def __init__(
        self,
        seen: str,
        *,
        situation: dict[str, object] | None = None,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.situation = situation or {}


class AuthorityError(M100Error):
    """Something about who controls the aircraft."""


class NoAuthority(AuthorityError):
    """Movement or a task was asked for without control authority; nothing was sent."""


class LossReason(StrEnum):
    """Who or what took authority away."""

    NONE = ""  # nothing was lost
    MODE_SWITCH = "mode_switch"  # the pilot left F
    APP = "app"  # the app on the mobile device
    RELEASED = "released"  # we gave it back
    LINK = "link"  # nobody can be heard
    UNKNOWN = "unknown"  # a notification alone does not say


class AuthorityLost(AuthorityError):
    """Authority went away during control.

    Attributes:
        reason: Who or what took it; compares equal to its string, such as ``"mode_switch"``.
    """

    def __init__(
        self,
        seen: str,
        *,
        reason: LossReason = LossReason.UNKNOWN,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.reason = reason


class GuardRefused(M100Error):
    """A safety guard refused; nothing was sent.

    Attributes:
        guard: Name of the guard, as it is switched off by.
        measured: The value that made it refuse.
        limit: The limit that was crossed.
    """

    def __init__(
        self,
        seen: str,
        *,
        guard: str = "",
        measured: object = None,
        limit: object = None,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.guard = guard
        self.measured = measured
        self.limit = limit


class TelemetryError(M100Error):
    """Something about the telemetry stream."""


class TelemetryOverflow(TelemetryError):
    """A lossless consumer did not keep up and its bounded queue is full."""


class TelemetryStalled(TelemetryError, TimeoutError):
    """An item that was arriving, or is needed, stopped arriving."""


class LayoutMismatch(TelemetryError, ValueError):
    """The length of a telemetry packet does not fit its flags under the firmware profile."""
