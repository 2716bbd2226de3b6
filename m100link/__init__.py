"""asyncio stack and virtual aircraft for DJI's Onboard API on the Matrice 100.

::

    async with m100link.connect("serial:///dev/ttyUSB0:230400") as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=10086, key="…64 hex digits…"))
        async with aircraft.control() as control:
            await control.take_off()
            ...
            await control.land()
"""

import logging

from m100link import errors
from m100link.activation import ActivationProgress
from m100link.aircraft import Aircraft, connect
from m100link.errors import (
    AckTimeout,
    ActivationRefused,
    AuthorityError,
    AuthorityLost,
    AuthorityRefused,
    BadAck,
    BadKey,
    BadSetpoint,
    BadURL,
    CommandNotSupported,
    CommandRefused,
    GuardRefused,
    KeyRejected,
    LayoutMismatch,
    LevelTooLow,
    LinkClosed,
    LinkError,
    LinkLost,
    LossReason,
    M100Error,
    NoAircraft,
    NoAnswer,
    NoAuthority,
    NotActivated,
    NotObserved,
    NoValidFrame,
    PayloadTooLarge,
    PortBusy,
    PortFailed,
    PortNotFound,
    PortPermissionDenied,
    SilentLine,
    TaskError,
    TaskFailed,
    TaskRefused,
    TelemetryError,
    TelemetryOverflow,
    TelemetryStalled,
    UsageError,
)
from m100link.flight.authority import Authority, AuthorityState
from m100link.flight.control import Control, Hold
from m100link.flight.guards import Envelope, Guards
from m100link.flight.guidance import Arrival, GuidanceProgress
from m100link.flight.pacing import Tick, Ticker
from m100link.flight.tasks import TaskProgress
from m100link.link import LinkStatistics
from m100link.protocol import (
    PROFILES,
    ActivationCode,
    AuthorityCode,
    ControlMode,
    Credentials,
    FirmwareProfile,
    ReferenceFrame,
    Setpoint,
    Task,
    TaskResultCode,
    TaskStartCode,
    Version,
    records,
)
from m100link.protocol.records import *  # noqa: F403 (all of records.__all__, nothing else)
from m100link.session import SessionMode
from m100link.telemetry.device_clock import DeviceClock, HostTime
from m100link.telemetry.sample import Sample
from m100link.telemetry.state import AircraftState, ItemStatistics
from m100link.telemetry.subscription import Latest, Lossless, Newest, Policy, Subscription
from m100link.wire import Key

__version__ = "0.1.0"

# A library leaves it to the program whether and how its log is shown.
logging.getLogger("m100link").addHandler(logging.NullHandler())

__all__ = [
    "PROFILES",
    "AckTimeout",
    "ActivationCode",
    "ActivationProgress",
    "ActivationRefused",
    "Aircraft",
    "AircraftState",
    "Arrival",
    "Authority",
    "AuthorityCode",
    "AuthorityError",
    "AuthorityLost",
    "AuthorityRefused",
    "AuthorityState",
    "BadAck",
    "BadKey",
    "BadSetpoint",
    "BadURL",
    "CommandNotSupported",
    "CommandRefused",
    "Control",
    "ControlMode",
    "Credentials",
    "DeviceClock",
    "Envelope",
    "FirmwareProfile",
    "GuardRefused",
    "Guards",
    "GuidanceProgress",
    "Hold",
    "HostTime",
    "ItemStatistics",
    "Key",
    "KeyRejected",
    "Latest",
    "LayoutMismatch",
    "LevelTooLow",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LinkStatistics",
    "LossReason",
    "Lossless",
    "M100Error",
    "Newest",
    "NoAircraft",
    "NoAnswer",
    "NoAuthority",
    "NoValidFrame",
    "NotActivated",
    "NotObserved",
    "PayloadTooLarge",
    "Policy",
    "PortBusy",
    "PortFailed",
    "PortNotFound",
    "PortPermissionDenied",
    "ReferenceFrame",
    "Sample",
    "SessionMode",
    "Setpoint",
    "SilentLine",
    "Subscription",
    "Task",
    "TaskError",
    "TaskFailed",
    "TaskProgress",
    "TaskRefused",
    "TaskResultCode",
    "TaskStartCode",
    "TelemetryError",
    "TelemetryOverflow",
    "TelemetryStalled",
    "Tick",
    "Ticker",
    "UsageError",
    "Version",
    "__version__",
    "connect",
    "errors",
]

__all__ += records.__all__
