"""The line itself: transports, and futures that acks resolve."""

import logging

from m100link.link.link import Link, open_link
from m100link.link.statistics import Direction, LinkStatistics, RoundTrips, Tap
from m100link.link.transport import MemoryTransport, connect_in_memory
from m100link.link.url import DEFAULT_BAUD_RATE, parse_url
from m100link.session.events import Latency

__all__ = [
    "DEFAULT_BAUD_RATE",
    "Direction",
    "Latency",
    "Link",
    "LinkStatistics",
    "MemoryTransport",
    "RoundTrips",
    "Tap",
    "connect_in_memory",
    "open_link",
    "parse_url",
]

# A library leaves it to the program whether and how its log is shown. Every module that logs stands
# on the link; a module below the link need not load logging.
logging.getLogger("m100link").addHandler(logging.NullHandler())
