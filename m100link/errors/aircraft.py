"""What the aircraft answers, does, or does not do any more."""

from __future__ import annotations

from enum import StrEnum

from m100link.errors.base import M100Error

__all__ = [
    "AckTimeout",
    "ActivationRefused",
    "AuthorityError",
    "AuthorityLost",
    "AuthorityRefused",
    "BadAck",
    "CommandNotSupported",
    "CommandRefused",
    "GuardRefused",
    "KeyRejected",
    "LayoutMismatch",
    "LevelTooLow",
    "LossReason",
    "MissionAborted",
    "MissionRefused",
    "MissionRunning",
    "NoAuthority",
    "NotActivated",
    "NotObserved",
    "TaskError",
    "TaskFailed",
    "TaskRefused",
    "TelemetryError",
    "TelemetryOverflow",
    "TelemetryStalled",
]


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


class MissionRefused(CommandRefused):
    """A mission, or an order to the one that flies, was refused (firmware 3.1, set 0x03).

    Attributes:
        point: Index of the waypoint that was refused, counted from 0; None when it is the whole.
    """

    def __init__(
        self,
        seen: str,
        *,
        command: str = "",
        code: int = -1,
        point: int | None = None,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, command=command, code=code, cause=cause, remedy=remedy)
        self.point = point


class MissionAborted(M100Error):
    """A mission was flying and the aircraft broke it off.

    Attributes:
        mission: Which kind, in words.
        code: The reason that the aircraft gave, as an ack code of missions; None when it gave none.
        index: The waypoint that it was flying to, counted from 0; None when nobody knows.
    """

    def __init__(
        self,
        seen: str,
        *,
        mission: str = "",
        code: int | None = None,
        index: int | None = None,
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.mission = mission
        self.code = code
        self.index = index


class AuthorityError(M100Error):
    """Something about who controls the aircraft."""


class NoAuthority(AuthorityError):
    """Movement or a task was asked for without control authority; nothing was sent."""


class MissionRunning(NoAuthority):
    """Movement or a task was asked for while a mission flies the aircraft; nothing was sent.

    The aircraft would ignore it, without a word.
    """


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
