"""A channel that only the event loop in which it was made may use."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from m100link.apps.agent.carriers import Channel
from m100link.apps.agent.messages import Message
from m100link.link.own_loop import require_loop

__all__ = ["OwnLoop"]


class OwnLoop:
    """A channel for whoever may be called by anybody: another thread would break what it carries.

    Args:
        channel: The way.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._loop = asyncio.get_running_loop()

    def require(self) -> None:
        """Refuse what comes from elsewhere.

        Raises:
            UsageError: Another event loop runs here, or this one elsewhere or nowhere.
        """
        require_loop(self._loop, "the loop in which the client was made")

    def open(self, on_message: Callable[[Message], None], on_closed: Callable[[str], None]) -> None:
        """Begin to receive. Raises as :meth:`require`."""
        self.require()
        self._channel.open(on_message, on_closed)

    def send(self, message: Message) -> None:
        """Send a message; never waits. Raises as :meth:`require`, and MessageError."""
        self.require()
        self._channel.send(message)

    def close(self, reason: str = "") -> None:
        """Close it. Raises as :meth:`require`."""
        self.require()
        self._channel.close(reason)
