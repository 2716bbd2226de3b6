"""Sequence numbers, acks and repeats, without I/O and without a clock."""

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
