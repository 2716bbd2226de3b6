"""asyncio stack and virtual aircraft for DJI's Onboard API on the Matrice 100.

::

    async with m100link.connect("serial:///dev/ttyUSB0:230400") as aircraft:
        await aircraft.activate(m100link.Credentials(app_id=10086, key="…64 hex digits…"))
        async with aircraft.control() as control:
            await control.take_off()
            ...
            await control.land()


Importing :mod:`m100link` loads nothing else: each name is loaded when it is first asked for
(:pep:`562`), so that a program which decodes frames does not pay for asyncio, AES and serial ports.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # what checkers take for true, without a module of 10 ms to say so
if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from types import ModuleType

    # For type checkers and editors, which read one file and run nothing: mypy, pyright and jedi see
    # plain imports. A stub beside this file would be a second list to keep, and would hide it.
    # A star stands where each name of a module is public here, too (pyproject.toml: F403, F405).
    # Rooms by their own names again, which is how checkers tell what may be used from outside.
    from m100link import aircraft as aircraft
    from m100link import errors as errors
    from m100link import flight as flight
    from m100link import geodesy as geodesy
    from m100link import link as link
    from m100link import log as log
    from m100link import missions as missions
    from m100link import protocol as protocol
    from m100link import session as session
    from m100link import sim as sim
    from m100link import sync as sync
    from m100link import telemetry as telemetry
    from m100link import wire as wire
    from m100link.aircraft import (
        Aircraft,
        AircraftCamera,
        AircraftGimbal,
        AuthorityEvent,
        ConnectionEvent,
        GimbalRates,
        connect,
    )
    from m100link.aircraft import activation as activation
    from m100link.aircraft.activation import ActivationProgress
    from m100link.aircraft.supervising import *
    from m100link.apps import doctor as doctor
    from m100link.apps import fleet as fleet
    from m100link.errors.aircraft import *
    from m100link.errors.base import *
    from m100link.errors.line import *
    from m100link.errors.usage import *
    from m100link.flight.authority import Authority, AuthorityState
    from m100link.flight.control import Control, Hold
    from m100link.flight.guards import Envelope, Guards
    from m100link.flight.guidance import Arrival, GuidanceProgress
    from m100link.flight.mission_state import MissionKind, MissionState
    from m100link.flight.missions.events import *
    from m100link.flight.missions.hotpoint import *
    from m100link.flight.missions.mission_guard import MissionFlight
    from m100link.flight.missions.waypoint import WaypointFlight
    from m100link.flight.pacing import Tick, Ticker
    from m100link.flight.tasks import TaskProgress
    from m100link.link import LinkStatistics, RoundTrips
    from m100link.link import requests as requests
    from m100link.missions import patterns as patterns
    from m100link.missions.plan import *
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
    )
    from m100link.protocol.records import *
    from m100link.session import SessionMode
    from m100link.telemetry import notifications as notifications
    from m100link.telemetry.columns import Columns, Table
    from m100link.telemetry.device_clock import DeviceClock, HostTime
    from m100link.telemetry.integrity import Integrity, IntegrityState
    from m100link.telemetry.sample import Sample
    from m100link.telemetry.state import AircraftState, ItemStatistics
    from m100link.telemetry.subscription import Latest, Lossless, Newest, Policy, Subscription
    from m100link.wire import Key

__version__ = "1.0.0rc1"

__all__ = [
    "PROFILES",
    "Aborted",
    "Acceleration",
    "AccelerationMode",
    "AckTimeout",
    "ActionsDone",
    "ActivationCode",
    "ActivationProgress",
    "ActivationRefused",
    "Aircraft",
    "AircraftCamera",
    "AircraftGimbal",
    "AircraftState",
    "AngularVelocity",
    "AnotherAircraft",
    "Arrival",
    "AtEnd",
    "Attitude",
    "Authority",
    "AuthorityCode",
    "AuthorityError",
    "AuthorityEvent",
    "AuthorityLost",
    "AuthorityRefused",
    "AuthorityState",
    "BackOff",
    "BadAck",
    "BadKey",
    "BadPlan",
    "BadSetpoint",
    "BadURL",
    "BadValue",
    "Battery",
    "CircleHeading",
    "CircleStart",
    "Columns",
    "CommandNotSupported",
    "CommandRefused",
    "ComputerSuspended",
    "ConnectionEvent",
    "Control",
    "ControlDevice",
    "ControlMode",
    "Credentials",
    "Device",
    "DeviceClock",
    "Envelope",
    "Finished",
    "FirmwareProfile",
    "FleetError",
    "FlightPhase",
    "FlightStatus",
    "FollowFlight",
    "Gap",
    "Gimbal",
    "GimbalPitch",
    "GimbalRates",
    "GuardRefused",
    "GuardianFailed",
    "GuardianTookOver",
    "Guards",
    "GuidanceProgress",
    "Heading",
    "Hold",
    "HostTime",
    "HotpointFlight",
    "Integrity",
    "IntegrityState",
    "ItemStatistics",
    "Key",
    "KeyRejected",
    "Latest",
    "LayoutMismatch",
    "LevelTooLow",
    "LineBlocked",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "LinkStatistics",
    "LossReason",
    "Lossless",
    "M100Error",
    "Magnetometer",
    "MissionAborted",
    "MissionEvent",
    "MissionFlight",
    "MissionKind",
    "MissionProgress",
    "MissionRefused",
    "MissionRunning",
    "MissionState",
    "NavigationLost",
    "Newest",
    "NoAircraft",
    "NoAnswer",
    "NoAuthority",
    "NoRouter",
    "NoValidFrame",
    "NotActivated",
    "NotAllowed",
    "NotObserved",
    "OnRCLoss",
    "OnlyRecorded",
    "OutOfResources",
    "OutcomeUnknown",
    "Paused",
    "PayloadTooLarge",
    "PlanEstimate",
    "Policy",
    "PortBusy",
    "PortFailed",
    "PortNotFound",
    "PortPermissionDenied",
    "Position",
    "RcMode",
    "Reached",
    "ReferenceFrame",
    "RemoteControl",
    "ReplayEnded",
    "Resumed",
    "RoundTrips",
    "Sample",
    "SessionMode",
    "Setpoint",
    "SetpointsIgnored",
    "SilentLine",
    "StaleLease",
    "StartVideo",
    "Started",
    "Stay",
    "StopVideo",
    "Stopped",
    "Subscription",
    "Supervised",
    "SupervisedTelemetry",
    "SupervisionEvent",
    "SupervisionState",
    "Table",
    "TakePhoto",
    "Target",
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
    "Time",
    "Trace",
    "TurnTo",
    "Unreachable",
    "Uploaded",
    "Uploading",
    "UsageError",
    "Velocity",
    "Version",
    "Waypoint",
    "WaypointAction",
    "WaypointFlight",
    "WaypointPlan",
    "__version__",
    "connect",
    "errors",
    "supervise",
    "sync",
]

# Where the names are, in the order of the layers: to look into one loads what it loads anyway. Only
# the aircraft stands before what flies, which it loads when control is asked for.
_ROOMS = (
    "errors",
    "wire",
    "session",
    "protocol",
    "link",
    "telemetry.device_clock",
    "telemetry.sample",
    "telemetry.integrity",
    "telemetry.state",
    "telemetry.subscription",
    "telemetry.columns",
    "link.requests",
    "telemetry.notifications",
    "aircraft.activation",
    "geodesy",
    "aircraft",
    "flight.authority",
    "flight.pacing",
    "flight.tasks",
    "flight.guards",
    "flight.guidance",
    "flight.mission_state",
    "flight.missions.events",
    "flight.missions.mission_guard",
    "flight.missions.waypoint",
    "flight.missions.hotpoint",
    "flight.control",
    "aircraft.supervising",
)

# A plan needs no aircraft, and who flies by setpoints needs no plan: its room is not looked into
# for other names, nor other rooms for these. To connect loads what it needs when it connects.
_OF_PLANS = {
    *("AtEnd", "GimbalPitch", "Heading", "OnRCLoss", "PlanEstimate", "StartVideo", "Stay"),
    *("StopVideo", "TakePhoto", "Trace", "TurnTo", "Waypoint", "WaypointAction", "WaypointPlan"),
}
_OWN_ROOMS = {**dict.fromkeys(_OF_PLANS, ("missions.plan",)), "connect": ("aircraft.connecting",)}

# Rooms for users, not looked into for public names: those of the first are the same again.
_OTHER_ROOMS = (
    *("doctor", "fleet", "log", "missions", "sync", "sim"),
    *("activation", "notifications", "patterns", "requests"),
)

# Rooms that have moved, and their place now. The old names keep working, deep ones with a warning.
_MOVED = {
    **dict.fromkeys(("agent", "cli", "doctor", "fleet", "station"), "apps"),
    "activation": "aircraft",
    "keyfile": "link",
    "notifications": "telemetry",
    "patterns": "missions",
    "requests": "link",
}

# Modules of documented names that another one has taken in.
_JOINED = {
    "protocol.commands.camera": "protocol.commands.gimbal",
    "sync.steering": "sync.control",
}


def _now(name: str) -> str:
    """Where a room is, by its old or its present name, below this package."""
    return f"{__name__}.{_MOVED[name]}.{name}" if name in _MOVED else f"{__name__}.{name}"


class _OldNames:
    """Finds a module by the name that it had before it moved: one module under two names.

    It stands before the finder of files, which would load a second copy of what is below a room.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        package, _, place = name.partition(".")
        is_old = place in _JOINED or place.partition(".")[0] in _MOVED
        if package != "m100link" or not is_old:
            return None
        from importlib.util import spec_from_loader

        return spec_from_loader(name, _OldNames)  # type: ignore[arg-type] # its two functions suffice

    @staticmethod
    def create_module(spec: object) -> None:
        """An empty one, for a moment."""

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        from importlib import import_module
        from warnings import warn

        old = module.__name__
        _, room, *deep = old.split(".")
        joined = _JOINED.get(".".join((room, *deep)))
        now = f"{__name__}.{joined}" if joined else ".".join((_now(room), *deep))
        sys.modules[old] = import_module(now)
        if deep or room not in (*_ROOMS, *_OTHER_ROOMS):
            warn(f"{old} is {now} now", DeprecationWarning, stacklevel=2)


sys.meta_path.insert(0, _OldNames)


if not TYPE_CHECKING:  # a checker that saw it would take every misspelt name for a name

    def __getattr__(name: str) -> object:
        """Load a room by its name, or a public name from the room that has it, and keep it."""
        from importlib import import_module

        if any(room.partition(".")[0] == name for room in (*_ROOMS, *_OTHER_ROOMS)):
            return import_module(_now(name))
        if name in __all__:
            for room in _OWN_ROOMS.get(name, _ROOMS):
                module = import_module(f"{__name__}.{room}")
                if room not in _ROOMS or name in module.__all__:
                    value = globals()[name] = getattr(module, name)
                    return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
