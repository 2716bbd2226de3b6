"""Events of the session layer, and its enumerations."""

from __future__ import annotations

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
    """A request was answered.

    Attributes:
        token: What :meth:`Sender.request` returned.
        payload: The data of the ack.
        encrypted: Whether the ack travelled encrypted.
    """

    token: int
    payload: bytes
    encrypted: bool


class Expired(NamedTuple):
    """A request ran out of tries; its outcome is unknown.

    Attributes:
        token: What :meth:`Sender.request` returned.
        session: Session it used.
        sequence: Its sequence number.
        tries: Transmissions made.
    """

    token: int
    session: int
    sequence: int
    tries: int


Event = Acked | Expired | Frame
"""A report of the session layer. A frame is a command or push for the layer above; with a session
that is not 0, its sender wants an ack."""


@dataclass(slots=True)
class SessionStatistics:
    """Counters of one end of the line.

    Attributes:
        requests: Requests transmitted at least once.
        transmissions: Transmissions of them, repeats included.
        acks: Acks that answered a request.
        duplicate_acks: Acks of a request that was answered before.
        late_acks: Acks of a request that had expired or was abandoned.
        foreign_acks: Acks of nothing that this end sent lately.
        expired: Requests that ran out of tries.
        commands: Commands and pushes delivered.
        repeated_commands: Repeats answered from the stored ack, not executed again.
        unanswered_repeats: Repeats of a command whose ack is still being made.
        stale_replies: Replies to a command that a newer one had replaced.
    """

    requests: int = 0
    transmissions: int = 0
    acks: int = 0
    duplicate_acks: int = 0
    late_acks: int = 0
    foreign_acks: int = 0
    expired: int = 0
    commands: int = 0
    repeated_commands: int = 0
    unanswered_repeats: int = 0
    stale_replies: int = 0
