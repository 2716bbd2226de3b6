"""A carrier inside one event loop: a message has arrived when ``send`` returns.

For tests on virtual time, and for an agent and its fronts in a single process.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from m100link.apps.agent.message_bytes import decode, encode
from m100link.apps.agent.messages import Message

__all__ = ["MemoryChannel", "memory_channels"]

_logger = logging.getLogger(__name__)

_MAX_WAITING = 1000


class MemoryChannel:
    """One end; see :class:`m100link.apps.agent.carriers.Channel`.

    Args:
        as_bytes: Let each message be written and read as bytes on its way: slower, and whatever
            the bytes cannot carry shows.
    """

    def __init__(self, *, as_bytes: bool = False) -> None:
        self._as_bytes = as_bytes
        self._peer: MemoryChannel | None = None
        self._on_message: Callable[[Message], None] | None = None
        self._on_closed: Callable[[str], None] | None = None
        # What came before this end was opened.
        self._waiting: deque[Message] = deque(maxlen=_MAX_WAITING)

    def join(self, peer: MemoryChannel) -> None:
        """Make the two ends of one way."""
        self._peer, peer._peer = peer, self

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        """Begin to receive; first what waits."""
        self._on_message, self._on_closed = on_message, on_closed
        while self._waiting:
            self._deliver(self._waiting.popleft())

    def send(self, message: Message) -> None:
        """The other end has it when this returns."""
        if self._peer is not None:
            self._peer._deliver(decode(encode(message)) if self._as_bytes else message)

    def _deliver(self, message: Message) -> None:
        if self._on_message is None:
            self._waiting.append(message)
            return
        try:
            self._on_message(message)
        except Exception:
            # As with a socket: what goes wrong at one end does not happen to the other.
            _logger.exception("a %s was not taken", type(message).__name__)

    def close(self, reason: str = "") -> None:
        """Close both ends."""
        peer, self._peer = self._peer, None
        if peer is not None:
            peer._peer = None
            if peer._on_closed is not None:
                peer._on_closed(reason)


def memory_channels(*, as_bytes: bool = False) -> tuple[MemoryChannel, MemoryChannel]:
    """The two ends of a way inside this event loop."""
    one, other = MemoryChannel(as_bytes=as_bytes), MemoryChannel(as_bytes=as_bytes)
    one.join(other)
    return one, other
