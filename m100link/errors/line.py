"""The cable and the aircraft at its other end; a fleet's network and the agents behind it."""

from __future__ import annotations

from m100link.errors.base import M100Error

__all__ = [
    "AnotherAircraft",
    "FleetError",
    "LineBlocked",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "NoAircraft",
    "NoAnswer",
    "NoValidFrame",
    "NotAllowed",
    "OutcomeUnknown",
    "PortBusy",
    "PortFailed",
    "PortNotFound",
    "PortPermissionDenied",
    "ReplayEnded",
    "SilentLine",
    "StaleLease",
    "Unreachable",
]


class LinkError(
    M100Error,
    ConnectionError,
    code="M100-LINK",
    cause="the cable, or what is at its end",
    remedy="`m100link doctor` looks at one stage after the other",
):
    """The serial line, socket or memory pair, and its other end."""


class PortNotFound(
    LinkError,
    FileNotFoundError,
    code="M100-PORT-NOT-FOUND",
    cause="the adapter is not plugged in, or has another name now",
    remedy="`m100link ports` lists those that are there; `m100link udev` gives it a name "
    "that stays",
):
    """No such device."""


class PortPermissionDenied(
    LinkError,
    PermissionError,
    code="M100-PORT-PERMISSION",
    cause="this user is not in the group that owns the device",
    remedy="`m100link ports` names the group, `m100link udev` prints a rule",
):
    """The device exists, this user may not open it."""


class PortBusy(
    LinkError,
    code="M100-PORT-BUSY",
    cause="another program of yours, ModemManager or a login console has the port",
    remedy="end it: `owners` and `m100link ports` say who it is",
):
    """Another program holds the port.

    Attributes:
        owners: ``(pid, process name)`` of the holders, where the system tells.
    """

    owners: tuple[tuple[int, str], ...] = ()


class PortFailed(
    LinkError,
    code="M100-PORT-FAILED",
    cause="not a serial port, or a driver that does not take the settings",
    remedy="the system's own error, where it is chained, says more",
):
    """The system could not open the port; its own error, if it gave one, is chained."""


class LinkLost(
    LinkError,
    code="M100-LINK-LOST",
    cause="unplugged, powered off, or the other end closed",
    remedy="check cable and power, then connect again, or let `supervise()` do it",
):
    """The port went away: unplugged, reset, or the other end closed. The cause is chained."""


class LinkClosed(
    LinkError,
    code="M100-LINK-CLOSED",
    cause="the connection's block was left, or another part of the program closed it",
    remedy="use the aircraft inside its `async with` only",
):
    """This side closed the link."""


class ReplayEnded(
    LinkError,
    code="M100-REPLAY-ENDED",
    cause="the recording was played to its end, or to where its process was killed",
    remedy="connect again to play it again; nothing is wrong with a cable",
):
    """A recording has no more. Whether the flight's own line was lost then, the cause says."""


class LineBlocked(
    LinkError,
    code="M100-LINE-BLOCKED",
    cause="the other end stands still, or more is sent than the baud rate carries",
    remedy="start the other end again; send less, or at a higher baud rate",
):
    """The line is open, and takes no more bytes: frames do not reach the aircraft."""


class AnotherAircraft(
    LinkError,
    code="M100-ANOTHER-AIRCRAFT",
    cause="a cable was put into another aircraft, or two ports have changed names",
    remedy="look at `expected` and `found`, and connect anew on purpose",
):
    """A line that came back leads to another aircraft than before.

    Attributes:
        expected: Serial number of the one before, or its version where the firmware tells none.
        found: The same of the one that answers.
    """

    expected: str = ""
    found: str = ""


class NoAircraft(
    LinkError,
    TimeoutError,
    code="M100-NO-AIRCRAFT",
    cause="no power, no cable, another baud rate, or crossed wires",
    remedy="`m100link doctor` tells these apart",
):
    """The port opened, but no aircraft answered before the deadline.

    Attributes:
        bytes_received: Bytes read in that time.
        frames_received: Frames with good checksums among them.
    """

    bytes_received: int = 0
    frames_received: int = 0


class SilentLine(
    NoAircraft,
    code="M100-SILENT-LINE",
    cause="no power, TX and RX swapped, or the wrong port",
    remedy="`m100link docs silent-line`; `m100link doctor` tells these apart",
):
    """Not one byte arrived."""


class NoValidFrame(
    NoAircraft,
    code="M100-NO-VALID-FRAME",
    cause="another baud rate than in the PC assistant, inverted levels, or another device",
    remedy="`m100link doctor` tries the usual rates, and names the right one",
):
    """Bytes arrived, but no frame among them had good checksums."""


class NoAnswer(
    NoAircraft,
    code="M100-NO-ANSWER",
    cause="our transmit wire does not reach the aircraft, or the line is slow",
    remedy="check the wire from our TX to the aircraft's RX; on a slow line connect(timeout=…)",
):
    """Frames arrive from the aircraft, but it does not answer requests."""


# -- outcomes of an order to an aircraft of a fleet that was not carried out as asked --------------


class FleetError(
    M100Error,
    code="M100-FLEET",
    cause="the way to the agent on board, or who else uses it",
    remedy="m100link fleet list",
):
    """An order to an aircraft of a fleet did not end as asked for."""


class Unreachable(
    FleetError,
    code="M100-UNREACHABLE",
    cause="its agent does not run, or is not connected to this router",
    remedy="start the agent; see that both name the same router and site",
):
    """No agent of that name is there: nothing was sent."""


class OutcomeUnknown(
    FleetError,
    code="M100-OUTCOME-UNKNOWN",
    cause="the way there or back was cut, or the agent was started anew meanwhile",
    remedy="look at the aircraft; an order is repeated with its own id, never with a new one",
):
    """It was sent, and nobody knows whether it was carried out."""


class StaleLease(
    FleetError,
    code="M100-STALE-LEASE",
    cause="the lease ended by silence, was given back, or was taken over",
    remedy="take control anew",
):
    """The order came under a lease that is not in force: it was not carried out."""


class NotAllowed(
    FleetError,
    code="M100-NOT-ALLOWED",
    cause="this identity has no right to give that order to this aircraft",
    remedy="`m100link fleet acl check FILE` says what each identity may do",
):
    """The agent refused the sender of the order."""
