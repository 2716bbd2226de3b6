"""Errors of the aircraft: its refusals, failures, and the loss of control or telemetry."""

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
    "ComputerSuspended",
    "GuardRefused",
    "GuardianFailed",
    "GuardianTookOver",
    "KeyRejected",
    "LayoutMismatch",
    "LevelTooLow",
    "LossReason",
    "MissionAborted",
    "MissionRefused",
    "MissionRunning",
    "NavigationLost",
    "NoAuthority",
    "NotActivated",
    "NotObserved",
    "SetpointsIgnored",
    "TaskError",
    "TaskFailed",
    "TaskRefused",
    "TelemetryError",
    "TelemetryOverflow",
    "TelemetryStalled",
]


class AckTimeout(
    M100Error,
    TimeoutError,
    code="M100-ACK-TIMEOUT",
    cause="the frame or its ack was lost, or the aircraft ignores the command",
    remedy="the outcome is unknown: look at telemetry before you repeat it",
):
    """No ack came after the last try.

    The outcome is *unknown*: the command may have been executed and its ack lost.

    Attributes:
        command: Name of the command.
        session: Session it used.
        sequence: Its sequence number.
        tries: How many times it was transmitted.
    """

    command: str = ""
    session: int = 0
    sequence: int = 0
    tries: int = 0


class KeyRejected(
    M100Error,
    code="M100-KEY-REJECTED",
    cause="the key is not that of the app for which the aircraft was activated",
    remedy="copy the key of this app again, and activate",
):
    """Plain requests are answered and encrypted ones are not: the keys on both sides differ.

    Attributes:
        command: Name of the encrypted command.
    """

    command: str = ""


class BadAck(
    M100Error,
    code="M100-BAD-ACK",
    cause="a firmware that answers in another layout",
    remedy="force the profile with `firmware=`, and report the bytes in `payload`",
):
    """The aircraft acknowledged with fewer bytes than the command's ack has.

    Attributes:
        command: Name of the command.
        payload: The bytes of the ack.
    """

    command: str = ""
    payload: bytes = b""


class CommandRefused(
    M100Error,
    code="M100-COMMAND-REFUSED",
    cause="the aircraft is not in a state for the command",
    remedy="`code` is what it answered; nothing happened",
):
    """The aircraft answered with a code that means no.

    Attributes:
        command: Name of the command.
        code: The ack code as an integer; unknown codes keep their number.
    """

    command: str = ""
    code: int = -1


class ActivationRefused(
    CommandRefused,
    code="M100-ACTIVATION-REFUSED",
    cause="wrong app id, key or level, or no mobile device with internet at the remote control",
    remedy="the message says what the code means; the guide to activation has every one",
):
    """Activation ended with a code other than success (document 2.2.1.2)."""


class NotActivated(
    CommandRefused,
    code="M100-NOT-ACTIVATED",
    cause="the aircraft was switched on again since",
    remedy="`await aircraft.activate(credentials)` first",
):
    """The aircraft wants to be activated first (system code 0xFF01)."""


class LevelTooLow(
    CommandRefused,
    code="M100-LEVEL-TOO-LOW",
    cause="the app id is registered for a lower level",
    remedy="flight control takes level 2: ask for it at DJI's developer site",
):
    """The registered level of this app id does not allow the command (system code 0xFF02)."""


class CommandNotSupported(
    CommandRefused,
    code="M100-NOT-SUPPORTED",
    cause="a command of a later firmware, or one that could not be decrypted",
    remedy="the table of commands says which firmware knows it; check the key",
):
    """The firmware does not know the command, or could not decrypt it (system code 0xFF00).

    Of a command that the firmware is known not to have, nothing was sent; ``code`` is -1 then.
    """


class AuthorityRefused(
    CommandRefused,
    code="M100-AUTHORITY-REFUSED",
    cause="switch not in F, API control not enabled in the assistant, or the app holds control",
    remedy="switch to F and enable API control; the checklist of the console names what lacks",
):
    """Control authority was not given (document 2.2.2.1)."""


class TaskError(
    CommandRefused,
    code="M100-TASK",
    cause="take-off, landing or go-home is not possible now",
    remedy="look at `situation`: what telemetry showed then",
):
    """Take-off, landing or go-home did not happen.

    Attributes:
        situation: Telemetry values at that moment which explain it.
    """

    situation: dict[str, object] = {}  # noqa: RUF012 (each error gets a copy)


class TaskRefused(
    TaskError,
    code="M100-TASK-REFUSED",
    cause="another task runs, motors do not run, or it already flies",
    remedy="look at `situation`, and ask again when it fits",
):
    """Take-off, landing or go-home was rejected and not begun (document 2.2.2.2).

    Attributes:
        situation: Telemetry values at the moment of the refusal that explain it.
    """


class TaskFailed(
    TaskError,
    code="M100-TASK-FAILED",
    cause="the pilot moved a stick, or the aircraft broke it off",
    remedy="look at `situation`; the pilot decides",
):
    """The task was begun and the aircraft reports that it failed.

    Attributes:
        situation: Telemetry values at the moment of the report that explain it.
    """


class NotObserved(
    M100Error,
    TimeoutError,
    code="M100-NOT-OBSERVED",
    cause="it still happens, something holds the aircraft, or telemetry lacks the item",
    remedy="look at `situation`, and at the aircraft, before you ask again",
):
    """A task was accepted, but neither telemetry nor the result query showed it done in time.

    Attributes:
        situation: Telemetry values when waiting ended.
    """

    situation: dict[str, object] = {}  # noqa: RUF012 (each error gets a copy)


class MissionRefused(
    CommandRefused,
    code="M100-MISSION-REFUSED",
    cause="a plan beyond the aircraft's limits, or another mission flies",
    remedy="look at `code` and `point`; stop what flies first",
):
    """A mission, or an order to the one that flies, was refused (firmware 3.1, set 0x03).

    Attributes:
        point: Index of the waypoint that was refused, counted from 0; None when it is the whole.
    """

    point: int | None = None


class MissionAborted(
    M100Error,
    code="M100-MISSION-ABORTED",
    cause="the pilot, a low battery, a limit zone or lost GPS",
    remedy="`code` is the aircraft's reason; upload its waypoints from `index` on to fly the rest",
):
    """A mission was flying and the aircraft broke it off.

    Attributes:
        mission: Which kind, in words.
        code: The reason that the aircraft gave, as an ack code of missions; None when it gave none.
        index: The waypoint that it was flying to, counted from 0; None when nobody knows.
    """

    mission: str = ""
    code: int | None = None
    index: int | None = None


class AuthorityError(
    M100Error,
    code="M100-AUTHORITY",
    cause="somebody else controls the aircraft",
    remedy="see who in telemetry's `control_device`",
):
    """An error of control authority."""


class NoAuthority(
    AuthorityError,
    code="M100-NO-AUTHORITY",
    cause="the call stands outside of a control block, or it has ended",
    remedy="put it into `async with aircraft.control()`",
):
    """Movement or a task was asked for without control authority; nothing was sent."""


class MissionRunning(
    NoAuthority,
    code="M100-MISSION-RUNNING",
    cause="a mission flies the aircraft, which ignores movement meanwhile",
    remedy="stop or pause the mission first",
):
    """Movement or a task was asked for while a mission flies the aircraft; nothing was sent.

    The aircraft would ignore it, without a word.
    """


class LossReason(StrEnum):
    """The cause of a loss of control authority."""

    NONE = ""  # nothing was lost
    MODE_SWITCH = "mode_switch"  # the pilot left F
    APP = "app"  # the app on the mobile device
    RELEASED = "released"  # we gave it back
    LINK = "link"  # nobody can be heard
    UNKNOWN = "unknown"  # a notification alone does not say


class AuthorityLost(
    AuthorityError,
    code="M100-AUTHORITY-LOST",
    cause="the pilot left F, the app took control, or the link was lost: `reason` says which",
    remedy="the pilot flies; ask for control again only when he agrees",
):
    """Authority went away during control.

    Attributes:
        reason: The cause; compares equal to its string, such as ``"mode_switch"``.
    """

    reason: LossReason = LossReason.UNKNOWN


class GuardianFailed(
    AuthorityError,
    code="M100-GUARDIAN-FAILED",
    cause="no memory, no descriptors or no processes are left, or Python cannot be started again",
    remedy="close what is open, or fly without one: control(guardian=False)",
):
    """The guardian, which ends the flight when the program cannot, did not start.

    The program did not ask for authority.
    """


class GuardianTookOver(
    AuthorityError,
    code="M100-GUARDIAN-TOOK-OVER",
    cause="a call that blocks the event loop, a debugger, a suspended process or computer",
    remedy="see where the aircraft is, and keep what takes long out of the event loop "
    "(asyncio.to_thread)",
):
    """The program stood still in flight, and the guardian ended the flight for it.

    The guardian stopped the mission, if one flew, replaced the setpoint by its neutral, began a
    landing where ``stop="land"`` asks for it, and gave authority back. It did not read the
    aircraft's answers.
    """


class GuardRefused(
    M100Error,
    code="M100-GUARD-REFUSED",
    cause="battery, envelope, GPS or link are beyond a safety limit",
    remedy="`guard`, `measured` and `limit` say which; switch off a guard only with a reason",
):
    """A safety guard refused; nothing was sent.

    Attributes:
        guard: Name of the guard, as it is switched off by.
        measured: The value that made it refuse.
        limit: The limit that was crossed.
        outside: The target outside of the envelope, in words without the name of the flight.
        off: The argument by which a program allows it; empty where none does.
    """

    guard: str = ""
    measured: object = None
    limit: object = None
    outside: str = ""
    off: str = ""

    def __str__(self) -> str:
        return f"{super().__str__()}, or {self.off}" if self.off else super().__str__()


class TelemetryError(
    M100Error,
    code="M100-TELEMETRY",
    cause="what arrives of telemetry",
    remedy="`m100link hz` shows what arrives",
):
    """Something about the telemetry stream."""


class TelemetryOverflow(
    TelemetryError,
    code="M100-TELEMETRY-OVERFLOW",
    cause="the consumer is slower than telemetry, or something blocks the loop",
    remedy="take the newest samples only, fewer items, or a larger queue",
):
    """A lossless consumer did not keep up and its bounded queue is full."""


class TelemetryStalled(
    TelemetryError,
    TimeoutError,
    code="M100-TELEMETRY-STALLED",
    cause="the item is switched off in the PC assistant, or the line is interrupted",
    remedy="`m100link hz` shows what arrives; set rates in the assistant",
):
    """An item that was arriving, or is needed, stopped arriving."""


class NavigationLost(
    TelemetryError,
    code="M100-NAVIGATION-LOST",
    cause="GPS that jumps or is disturbed, a sensor that stands still, or a relay that mixes old "
    "packages with new ones",
    remedy="let the pilot take the aircraft; look at position and velocity in the log",
):
    """The position that the aircraft reports cannot be true; no program can steer by it."""


class SetpointsIgnored(
    TelemetryError,
    code="M100-SETPOINTS-IGNORED",
    cause="the wire to the aircraft is broken, or the autopilot does not allow it: a no-fly zone, "
    "its limit of height or distance, an obstacle",
    remedy="check TX of the cable; otherwise see what the pilot's app says",
):
    """Setpoints go out, and telemetry does not show the aircraft begin to follow them."""


class ComputerSuspended(
    M100Error,
    code="M100-COMPUTER-SUSPENDED",
    cause="suspend-to-RAM or hibernation: by a lid, a power key, or an idle desktop",
    remedy="forbid it while flying: systemd-inhibit --what=sleep:handle-lid-switch …",
):
    """The computer slept in flight. Telemetry and setpoints are old, whatever its clock says."""


class LayoutMismatch(
    TelemetryError,
    ValueError,
    code="M100-LAYOUT-MISMATCH",
    cause="another firmware than the profile's",
    remedy="ask for the version, or force the profile with `firmware=`",
):
    """The length of a telemetry packet does not fit its flags under the firmware profile."""
