"""The cable and what is at its other end."""

from __future__ import annotations

from m100link.errors.base import M100Error

__all__ = [
    "AnotherAircraft",
    "LinkClosed",
    "LinkError",
    "LinkLost",
    "NoAircraft",
    "NoAnswer",
    "NoValidFrame",
    "PortBusy",
    "PortFailed",
    "PortNotFound",
    "PortPermissionDenied",
    "SilentLine",
]


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


class AnotherAircraft(LinkError):
    """A line that came back leads to another aircraft than before.

    Attributes:
        expected: Serial number of the one before, or its version where the firmware tells none.
        found: The same of the one that answers.
    """

    def __init__(
        self,
        seen: str,
        *,
        expected: str = "",
        found: str = "",
        cause: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(seen, cause=cause, remedy=remedy)
        self.expected = expected
        self.found = found


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
