"""Codes of errors that were published: they keep their meaning."""

from __future__ import annotations

PUBLISHED = {
    "M100-ERROR": "M100Error",
    "M100-ACK-TIMEOUT": "AckTimeout",
    "M100-ACTIVATION-REFUSED": "ActivationRefused",
    "M100-ANOTHER-AIRCRAFT": "AnotherAircraft",
    "M100-AUTHORITY": "AuthorityError",
    "M100-AUTHORITY-LOST": "AuthorityLost",
    "M100-AUTHORITY-REFUSED": "AuthorityRefused",
    "M100-BAD-ACK": "BadAck",
    "M100-BAD-AUTHORITY": "BadAuthority",
    "M100-BAD-KEY": "BadKey",
    "M100-BAD-PLAN": "BadPlan",
    "M100-BAD-REVOKED": "BadRevoked",
    "M100-BAD-RIGHTS": "BadRights",
    "M100-BAD-SETPOINT": "BadSetpoint",
    "M100-BAD-SHOW": "BadShow",
    "M100-BAD-URL": "BadURL",
    "M100-BAD-VALUE": "BadValue",
    "M100-COMMAND-REFUSED": "CommandRefused",
    "M100-COMPUTER-SUSPENDED": "ComputerSuspended",
    "M100-FLEET": "FleetError",
    "M100-GUARD-REFUSED": "GuardRefused",
    "M100-GUARDIAN-FAILED": "GuardianFailed",
    "M100-GUARDIAN-TOOK-OVER": "GuardianTookOver",
    "M100-KEY-REJECTED": "KeyRejected",
    "M100-LAYOUT-MISMATCH": "LayoutMismatch",
    "M100-LEASE-HELD": "LeaseHeld",
    "M100-LEASE-REFUSED": "LeaseRefused",
    "M100-LEFT-SHOW": "LeftShow",
    "M100-LEVEL-TOO-LOW": "LevelTooLow",
    "M100-LINE-BLOCKED": "LineBlocked",
    "M100-LINK": "LinkError",
    "M100-LINK-CLOSED": "LinkClosed",
    "M100-LINK-LOST": "LinkLost",
    "M100-MESSAGE": "MessageError",
    "M100-MISSION-ABORTED": "MissionAborted",
    "M100-MISSION-REFUSED": "MissionRefused",
    "M100-MISSION-RUNNING": "MissionRunning",
    "M100-NAVIGATION-LOST": "NavigationLost",
    "M100-NO-AIRCRAFT": "NoAircraft",
    "M100-NO-ANSWER": "NoAnswer",
    "M100-NO-AUTHORITY": "NoAuthority",
    "M100-NO-ROUTER": "NoRouter",
    "M100-NO-SIMULATOR": "NoSimulator",
    "M100-NO-VALID-FRAME": "NoValidFrame",
    "M100-NOT-ACTIVATED": "NotActivated",
    "M100-NOT-ALLOWED": "NotAllowed",
    "M100-NOT-OBSERVED": "NotObserved",
    "M100-NOT-SUPPORTED": "CommandNotSupported",
    "M100-ONLY-RECORDED": "OnlyRecorded",
    "M100-ORDER-REFUSED": "OrderRefused",
    "M100-OUT-OF-RESOURCES": "OutOfResources",
    "M100-OUTCOME-UNKNOWN": "OutcomeUnknown",
    "M100-PAYLOAD-TOO-LARGE": "PayloadTooLarge",
    "M100-PORT-BUSY": "PortBusy",
    "M100-PORT-FAILED": "PortFailed",
    "M100-PORT-NOT-FOUND": "PortNotFound",
    "M100-PORT-PERMISSION": "PortPermissionDenied",
    "M100-REPLAY-ENDED": "ReplayEnded",
    "M100-SETPOINTS-IGNORED": "SetpointsIgnored",
    "M100-SHOW-REFUSED": "ShowRefused",
    "M100-SILENT-LINE": "SilentLine",
    "M100-STALE-LEASE": "StaleLease",
    "M100-TASK": "TaskError",
    "M100-TASK-FAILED": "TaskFailed",
    "M100-TASK-REFUSED": "TaskRefused",
    "M100-TELEMETRY": "TelemetryError",
    "M100-TELEMETRY-OVERFLOW": "TelemetryOverflow",
    "M100-TELEMETRY-STALLED": "TelemetryStalled",
    "M100-UNREACHABLE": "Unreachable",
    "M100-USAGE": "UsageError",
}

# Exit status of the command line: classes. Scripts rely on it.
EXIT_STATUS: dict[int, str] = {
    # anything else failed
    1: """
        BadAck ComputerSuspended FleetError LayoutMismatch LeaseHeld LeaseRefused LeftShow
        M100Error MessageError MissionAborted NavigationLost NoSimulator NotAllowed
        OrderRefused OutOfResources OutcomeUnknown SetpointsIgnored ShowRefused StaleLease
        TelemetryError TelemetryOverflow Unreachable
    """,
    # called wrongly, or an input that cannot be
    2: """
        BadAuthority BadKey BadPlan BadRevoked BadRights BadSetpoint BadShow BadURL BadValue
        OnlyRecorded PayloadTooLarge UsageError
    """,
    # the port
    3: """
        AnotherAircraft LinkClosed LinkError PortBusy PortFailed PortNotFound
        PortPermissionDenied ReplayEnded
    """,
    # nobody answers, or the line is gone
    4: """
        LineBlocked LinkLost NoAircraft NoAnswer NoValidFrame SilentLine
    """,
    # activation
    5: """
        ActivationRefused KeyRejected LevelTooLow NotActivated
    """,
    # control authority
    6: """
        AuthorityError AuthorityLost AuthorityRefused GuardianFailed GuardianTookOver
        MissionRunning NoAuthority
    """,
    # refused
    7: """
        CommandNotSupported CommandRefused GuardRefused MissionRefused TaskError TaskFailed
        TaskRefused
    """,
    # took too long
    8: """
        AckTimeout NotObserved TelemetryStalled
    """,
    # no router of zenoh answers
    9: """
        NoRouter
    """,
}

# Classes that are older than the rule that the change log names each. None comes to them.
UNTOLD = """
    AckTimeout AnotherAircraft AuthorityError AuthorityRefused BadAuthority BadKey
    BadRevoked BadRights BadSetpoint BadShow BadURL CommandRefused GuardRefused
    KeyRejected LayoutMismatch LeaseHeld LeaseRefused LeftShow LevelTooLow M100Error
    MessageError NoAircraft NoAnswer NoAuthority NoSimulator NoValidFrame NotActivated
    NotObserved OrderRefused PayloadTooLarge PortNotFound PortPermissionDenied
    SilentLine TelemetryError TelemetryOverflow
"""
