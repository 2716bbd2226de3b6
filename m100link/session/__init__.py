"""Sequence numbers, acks and repeats, without I/O and without a clock."""

TYPE_CHECKING = False
if TYPE_CHECKING:  # commands say by which sessions they go, and need no end of a line
    from m100link.session.endpoint import Endpoint, Receiver, Sender
    from m100link.session.events import Acked, Event, Expired, SessionMode, SessionStatistics

__all__ = [
    "Acked",
    "Endpoint",
    "Event",
    "Expired",
    "Receiver",
    "Sender",
    "SessionMode",
    "SessionStatistics",
]

if not TYPE_CHECKING:  # a checker that saw it would take every misspelt name for a name
    from m100link.errors.usage import loads

    __getattr__ = loads(__name__, "events", "endpoint")
