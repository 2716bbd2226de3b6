"""One end of the line: decoder, sender and receiver as one machine without I/O and clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from m100link.session.events import Event, SessionMode, SessionStatistics
from m100link.session.receiver import Receiver
from m100link.session.sender import Sender
from m100link.wire.cipher import Cipher
from m100link.wire.frame import Frame, FrameDecoder


class Endpoint:
    """Bytes and time in, bytes and events out; the same class serves both ends of the cable.

    Args:
        first_sequence: See :class:`~m100link.session.Sender`.
        forget_after: See :class:`~m100link.session.Receiver`.

    Attributes:
        only_pushes: The last bytes brought nothing but pushes, which leave nothing to write.
    """

    __slots__ = ("_pushed", "decoder", "only_pushes", "receiver", "sender", "statistics")

    def __init__(self, *, first_sequence: int = 0, forget_after: float | None = None) -> None:
        self.statistics = SessionStatistics()
        self.decoder = FrameDecoder()
        self.sender = Sender(first_sequence=first_sequence, statistics=self.statistics)
        self.receiver = Receiver(forget_after=forget_after, statistics=self.statistics)
        self.only_pushes = True
        self._pushed: deque[bytes] = deque()

    @property
    def cipher(self) -> Cipher | None:
        """The cipher of both directions; None until there is a key."""
        return self.decoder.cipher

    @cipher.setter
    def cipher(self, cipher: Cipher | None) -> None:
        self.decoder.cipher = self.sender.cipher = self.receiver.cipher = cipher

    def receive_data(self, data: bytes, now: float) -> Sequence[Event]:
        """Take bytes from the line and return what happened, in order. Nothing that arrives raises.

        Pushes, which are most of what arrives, are their own events and pass without being touched.
        """
        frames = self.decoder.feed(data)
        for frame in frames:
            if frame[0] or frame[1]:  # session, is_ack: by name it takes twice as long
                self.only_pushes = False
                return self._sort_out(frames, now)
        self.only_pushes = True
        self.statistics.commands += len(frames)
        return frames

    def _sort_out(self, frames: list[Frame], now: float) -> list[Event]:
        events: list[Event] = []
        for frame in frames:
            event: Event | None
            if frame.is_ack:
                event = self.sender.receive_ack(frame, now)
            else:
                event = self.receiver.receive_command(frame, now)
            if event is not None:
                events.append(event)
        return events

    def push(self, data: bytes, *, encrypted: bool = False) -> None:
        """Queue a frame on session 0; see :meth:`Sender.push` for errors."""
        self._pushed.append(self.sender.push(data, encrypted=encrypted))

    def drop_pushes(self) -> None:
        """Forget pushes that were not taken for writing."""
        self._pushed.clear()

    def request(
        self,
        data: bytes,
        *,
        now: float,
        mode: SessionMode = SessionMode.RELIABLE,
        encrypted: bool = False,
        timeout: float = 0.5,
        tries: int = 3,
    ) -> int:
        """Begin a request; see :meth:`Sender.request`."""
        return self.sender.request(
            data, now=now, mode=mode, encrypted=encrypted, timeout=timeout, tries=tries
        )

    def abandon(self, token: int) -> None:
        """Forget a request; see :meth:`Sender.abandon`."""
        self.sender.abandon(token)

    def is_open(self, token: int) -> bool:
        """Whether a request has yet to end; see :meth:`Sender.is_open`."""
        return self.sender.is_open(token)

    def acknowledge(
        self, command: Frame, payload: bytes, *, now: float, encrypted: bool | None = None
    ) -> None:
        """Answer a delivered command; see :meth:`Receiver.acknowledge`."""
        self.receiver.acknowledge(command, payload, now=now, encrypted=encrypted)

    def next_wakeup(self) -> float | None:
        """When :meth:`handle_timer` should be called at the latest."""
        return self.sender.next_wakeup()

    def handle_timer(self, now: float) -> Sequence[Event]:
        """Repeat or expire what is due; returns what expired, in order."""
        self.sender.handle_timer(now)
        expired = []
        while (event := self.sender.next_event()) is not None:
            expired.append(event)
        return expired

    @property
    def has_output(self) -> bool:
        """Whether :meth:`output` has frames."""
        return bool(self._pushed or self.sender.output or self.receiver.output)

    def output(self) -> Iterator[bytes]:
        """Take the frames to write: acks first, then requests, then pushes."""
        for waiting in (self.receiver.output, self.sender.output, self._pushed):
            while waiting:
                yield waiting.popleft()
