"""Every error that m100link raises.

All of them derive from :class:`M100Error`, so one ``except`` catches the library and nothing else::

    M100Error
    ├── UsageError                 the caller's mistake, found before a byte is sent   (ValueError)
    │   ├── BadURL                 the connection string names no transport
    │   ├── BadKey                 not 32 bytes, not 64 hex digits
    │   ├── BadValue               a field of a command outside its documented range
    │   ├── BadSetpoint            a value outside the document's table, NaN or infinity
    │   ├── BadPlan                a waypoint mission that the aircraft would refuse
    │   ├── NoRouter               no zenoh router answered; nothing was sent
    │   ├── OnlyRecorded           an order to the aircraft of a replay
    │   └── PayloadTooLarge        more than 1007 bytes, or 100 to the mobile device
    ├── OutOfResources             the system has no file, thread or memory for it     (OSError)
    ├── LinkError                  the cable and its other end (ConnectionError)
    │   ├── PortNotFound           no such device (FileNotFoundError)
    │   ├── PortPermissionDenied   the device is there but not for this user (PermissionError)
    │   ├── PortBusy               another program has it
    │   ├── PortFailed             the system refused for another reason
    │   ├── LinkLost               the port went away under us
    │   ├── LinkClosed             we closed it
    │   ├── ReplayEnded            the recording has no more; no cable is lost
    │   ├── LineBlocked            it is open and takes no more bytes
    │   ├── AnotherAircraft        it came back, and another aircraft answers
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
    │   ├── MissionRefused         a mission, or an order to the one that flies
    │   └── TaskError              take-off, landing or go-home did not happen
    │       ├── TaskRefused        it was not begun
    │       └── TaskFailed         it was begun and the aircraft reports failure
    ├── MissionAborted             it was flying, and the aircraft broke it off
    ├── NotObserved                begun, but telemetry never showed the result (TimeoutError)
    ├── AuthorityError
    │   ├── NoAuthority            movement was asked for without authority
    │   │   └── MissionRunning     or while a mission flies: the aircraft would ignore it
    │   ├── AuthorityLost          the pilot, the app or the link took it away
    │   ├── GuardianFailed         the guardian of the flight did not start; nothing flies
    │   └── GuardianTookOver       the program stood still, and the guardian ended its flight
    ├── GuardRefused               a safety guard said no; it names itself and the measured value
    ├── ComputerSuspended          the computer slept in flight
    ├── FleetError                 an order to an aircraft of a fleet
    │   ├── Unreachable            no agent of that name is there; nothing was sent
    │   ├── OutcomeUnknown         sent, and nobody knows what became of it
    │   ├── StaleLease             it came under a lease that is not in force
    │   └── NotAllowed             the agent refused the sender
    └── TelemetryError
        ├── TelemetryOverflow      a lossless consumer fell behind
        ├── TelemetryStalled       it went silent, stands still, or comes ever later (TimeoutError)
        ├── NavigationLost         the position cannot be true
        ├── SetpointsIgnored       nothing begins to follow what is sent
        └── LayoutMismatch         a packet does not fit the firmware profile (ValueError)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from m100link.errors.aircraft import *  # noqa: F403 (all of its __all__, like those below)
from m100link.errors.base import *  # noqa: F403
from m100link.errors.line import *  # noqa: F403
from m100link.errors.usage import *  # noqa: F403

if not TYPE_CHECKING:  # mypy takes a list that is made of others for an empty one
    from m100link.errors import aircraft, base, line, usage

    __all__ = [*aircraft.__all__, *base.__all__, *line.__all__, *usage.__all__]
    # One place to catch them from, and one name in tracebacks: where one stands is not for users.
    for _name in __all__:
        globals()[_name].__module__ = __name__
