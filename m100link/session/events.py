"""Events of the session layer, its enumerations, its counters, and how long its answers take."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from m100link.wire.frame import Frame


class SessionMode(Enum):
    """How much the sender wants to know (document 1.4, its modes 1, 2 and 3).

    The document counts modes from 1, its enum from 0 and the wire has session ids; to keep them
    apart nothing here is called by a number.
    """

    NO_ACK = "session 0: sent and forgotten"
    ACK_ONCE = "session 1: one ack wanted, its loss tolerated, never repeated"
    RELIABLE = "sessions 2 to 31: repeated until acked, executed once"


class Acked(NamedTuple):
    """A request was answered."""

    token: int  #: What :meth:`Sender.request` returned.
    payload: bytes  #: The data of the ack.
    encrypted: bool  #: Whether the ack travelled encrypted.


class Expired(NamedTuple):
    """A request ran out of tries; its outcome is unknown."""

    token: int  #: What :meth:`Sender.request` returned.
    session: int  #: Session it used.
    sequence: int  #: Its sequence number.
    tries: int  #: Transmissions made.


Event = Acked | Expired | Frame
"""A report of the session layer. A frame is a command or push for the layer above; with a session
that is not 0, its sender wants an ack."""


@dataclass(slots=True)
class SessionStatistics:
    """Counters of one end of the line."""

    requests: int = 0  #: Requests transmitted at least once.
    transmissions: int = 0  #: Transmissions of them, repeats included.
    acks: int = 0  #: Acks that answered a request.
    duplicate_acks: int = 0  #: Acks of a request that was answered before.
    late_acks: int = 0  #: Acks of a request that had expired or was abandoned.
    foreign_acks: int = 0  #: Acks of nothing that this end sent lately.
    expired: int = 0  #: Requests that ran out of tries.
    commands: int = 0  #: Commands and pushes delivered.
    repeated_commands: int = 0  #: Repeats answered from the stored ack, not executed again.
    unanswered_repeats: int = 0  #: Repeats of a command whose ack is still being made.
    stale_replies: int = 0  #: Replies to a command that a newer one had replaced.


# -- how long answers take on a line, and how long they are therefore waited for ------------------


SLOW_S = 0.3
"""Round trip, s, from which a line counts as slow. By a cable an answer takes 10 to 50 ms."""

LONGEST_WAIT_S = 30.0
"""Seconds that an answer is waited for at most, after the last transmission of its request."""

_KEPT = 8  # answers that count: one is asked for every two seconds at least while a line is kept
_MARGIN = 1.5  # by how much the next one may take longer than the longest of them


class Latency:
    """How long answers took, from the first transmission of each request.

    A lost frame makes such a time longer by the pause before its repeat, never shorter. So the
    shortest of the newest eight is what the line takes. An answer is waited for as RFC 6298 has it
    (mean and four mean deviations), and half as long again as the longest of the eight at least.
    """

    __slots__ = ("_deviation", "_mean", "_newest", "is_slow", "round_trip_s", "slack_s")

    def __init__(self) -> None:
        self._newest: deque[float] = deque(maxlen=_KEPT)
        self._mean = self._deviation = 0.0
        #: Time of a question and its answer on this line, s; None before the first answer.
        self.round_trip_s: float | None = None
        self.is_slow = False  #: whether that is so long that ``doctor`` and ``link`` report it
        #: Seconds by which an order shows later than by a cable; 0 on a line that is not slow.
        self.slack_s = 0.0

    def note(self, seconds: float) -> None:
        """An answer came, in time or too late."""
        if not self._newest:
            self._mean, self._deviation = seconds, seconds / 2
        else:  # its alpha and beta
            self._deviation += (abs(seconds - self._mean) - self._deviation) / 4
            self._mean += (seconds - self._mean) / 8
        self._newest.append(seconds)
        self.round_trip_s = trip = min(self._newest)
        self.is_slow = trip >= SLOW_S
        self.slack_s = _MARGIN * trip if self.is_slow else 0.0

    def __str__(self) -> str:
        trip = self.round_trip_s
        if trip is None:
            return "nobody has measured how slow the line is"
        return f"the line is {'slow' if self.is_slow else 'quick'}: {trip:.2g} s round trip"

    def wait_s(self, least: float) -> float:
        """Seconds to wait for an answer that is usually waited for ``least`` seconds."""
        longest = _MARGIN * max(self._newest, default=0.0)
        return max(least, min(LONGEST_WAIT_S, max(longest, self._mean + 4 * self._deviation)))
