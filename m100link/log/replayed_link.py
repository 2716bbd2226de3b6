"""The line of a replay: it gives what came, and takes nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from m100link.errors import LinkClosed, ReplayEnded
from m100link.link.link import Link
from m100link.log.player import Player, only_recorded
from m100link.session.events import SessionMode
from m100link.wire.frame import Frame

__all__ = ["ReplayedLink"]


class ReplayedLink(Link):
    """A line whose other end is a recording.

    Args:
        player: What plays it.

    Attributes:
        player: What plays it: how far it is, and how fast.
    """

    is_recorded = True

    def __init__(self, player: Player) -> None:
        super().__init__(first_sequence=0)
        self.player = player
        self.name = f"replay of {player.flight.path.name}"
        self._connected.set_result(None)

    @property
    def clock(self) -> Callable[[], float]:
        """That of the recorded flight."""
        return self.player.time

    @property
    def is_open(self) -> bool:
        """Whether there is more to come."""
        return self._failure is None

    async def request(
        self,
        data: bytes,
        *,
        name: str = "request",
        mode: SessionMode = SessionMode.RELIABLE,
        encrypted: bool = False,
        timeout: float = 0.5,
        tries: int = 3,
    ) -> bytes:
        """Refused.

        Raises:
            OnlyRecorded: Always.
            ReplayEnded, LinkClosed: It is over.
        """
        raise self._refusal(name)

    def push(self, data: bytes, *, encrypted: bool = False) -> bool:
        """Refused, as :meth:`request`."""
        raise self._refusal("a push")

    def _refusal(self, what: str) -> Exception:
        self.require_loop()
        return only_recorded(what) if self._failure is None else self._failure.again()

    def acknowledge(self, command: Frame, payload: bytes, *, encrypted: bool | None = None) -> None:
        """Nobody is there to be answered."""

    def decode(self, data: bytes, now: float) -> Sequence[Frame]:
        """The frames of a read, for :meth:`deliver`."""
        self.last_received_at = now
        events: Sequence[Any] = self._endpoint.receive_data(data, now)
        if self._endpoint.only_pushes:
            return events
        return [event for event in events if type(event) is Frame]

    def deliver(self, frame: Frame, now: float) -> None:
        """Hand a frame on."""
        self.on_received(frame, now)

    def end(self, error: ReplayEnded) -> None:
        """There is no more."""
        if self._failure is None:
            self._failure = error
            self._disconnected.set()
            self._tell_of_failure()

    async def close(self) -> None:
        """Play no more."""
        self.require_loop()
        self.player.stop()
        if self._failure is None:
            self._failure = LinkClosed("the replay was closed by this side")
        self._disconnected.set()
        self._tell_of_failure()
