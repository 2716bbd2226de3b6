"""Sequence numbers, acks and repeats, without I/O and without a clock."""

from m100link.session.endpoint import Endpoint
from m100link.session.events import (
    Acked,
    Event,
    Expired,
    SessionMode,
    SessionStatistics,
)
from m100link.session.receiver import Receiver
from m100link.session.sender import Sender

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
