"""What carries messages between an agent and a front."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from m100link.apps.agent.messages import Message

__all__ = ["Channel"]


class Channel(Protocol):
    """One end of a way for messages, in order and without loss until it is closed."""

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        """Begin to receive.

        Args:
            on_message: Called with each message. What it raises is logged and ends there.
            on_closed: Called once, with the reason, when the other end has gone or closed it.
        """

    def send(self, message: Message) -> None:
        """Send a message; never waits. On a closed channel nothing happens.

        Raises:
            MessageError: This message cannot be sent at all.
        """

    def close(self, reason: str = "") -> None:
        """Close it, for a reason that the other end is told. May be called any number of times."""
