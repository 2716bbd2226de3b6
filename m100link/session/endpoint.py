"""One end of the line: decoder, sender and receiver as one machine without I/O and clock."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

from m100link.errors import UsageError
from m100link.session.events import (
    Acked,
    Event,
    Expired,
    Latency,
    SessionMode,
    SessionStatistics,
)
from m100link.wire.cipher import Cipher
from m100link.wire.frame import MAX_SESSION, Frame, FrameDecoder, encode_frame


class Endpoint:
    """Bytes and time in, bytes and events out; the same class serves both ends of the cable.

    Args:
        first_sequence: See :class:`~m100link.session.Sender`.
        forget_after: See :class:`~m100link.session.Receiver`.
    """

    __slots__ = ("_pushed", "decoder", "receiver", "sender", "statistics")

    def __init__(self, *, first_sequence: int = 0, forget_after: float | None = None) -> None:
        self.statistics = SessionStatistics()
        self.decoder = FrameDecoder()
        self.sender = Sender(first_sequence=first_sequence, statistics=self.statistics)
        self.receiver = Receiver(forget_after=forget_after, statistics=self.statistics)
        self._pushed: deque[bytes] = deque()

    @property
    def cipher(self) -> Cipher | None:
        """The cipher of both directions; None until there is a key."""
        return self.decoder.cipher

    @cipher.setter
    def cipher(self, cipher: Cipher | None) -> None:
        self.decoder.cipher = self.sender.cipher = self.receiver.cipher = cipher

    def receive_data(self, data: bytes, now: float) -> Sequence[Event]:
        """Take bytes from the line; return what happened, in order. Nothing that arrives raises."""
        return self._sort_out(self.decoder.feed(data), now)

    def _sort_out(self, frames: list[Frame], now: float) -> Sequence[Event]:
        """The same of frames that were decoded."""
        for frame in frames:
            if frame[0] or frame[1]:  # session, is_ack: by name it takes twice as long
                break
        else:  # pushes, most of what arrives, are their own events
            self.statistics.commands += len(frames)
            return frames
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


# -- the answering side of a session: deliver once, answer repeats from memory (document 1.4) ------


@dataclass(slots=True, eq=False, repr=False)
class _Memory:
    """The last command of one session, and its ack once there is one."""

    sequence: int  # number of the command; another number means another command
    # The frame of its ack, to be sent again as it is; None while it is carried out.
    wire: bytes | None = None
    stored_at: float = 0.0  # when the ack was made, which is when forgetting begins to count


class Receiver:
    """Delivers commands and remembers the last ack of each of the sessions 2 to 31.

    "Nothing stored yet" is a state of its own: the first command of a session is delivered
    whatever its number is.

    Args:
        forget_after: Seconds after which a stored ack is forgotten. None, the document's rule,
            keeps it until a new sequence number comes.
        statistics: Counters to use; shared with the sender of the same end.

    Attributes:
        cipher: Encrypts acks that ask for it. May be set at any time.
        output: Frames to write, oldest first; the writer takes them out.
    """

    def __init__(
        self,
        *,
        forget_after: float | None = None,
        statistics: SessionStatistics | None = None,
    ) -> None:
        self.cipher: Cipher | None = None
        self.forget_after = forget_after
        self.statistics = statistics or SessionStatistics()
        self._memories: dict[int, _Memory] = {}  # per session; none is a state of its own
        self.output: deque[bytes] = deque()

    def receive_command(self, frame: Frame, now: float) -> Frame | None:
        """Take a command frame; None when it repeats one that was delivered before."""
        # Session 1 has no memory: its sender tolerates a lost ack, and repeats nothing (errata 31).
        if frame.session > ACK_ONCE_SESSION:
            memory = self._memories.get(frame.session)
            if memory is not None and self._is_repeat(memory, frame, now):
                # At work: the session exists so that nothing is executed twice (document 1.4).
                if memory.wire is None:
                    self.statistics.unanswered_repeats += 1
                else:
                    self.statistics.repeated_commands += 1
                    self.output.append(memory.wire)
                return None
            self._memories[frame.session] = _Memory(frame.sequence)
        self.statistics.commands += 1
        return frame

    def _is_repeat(self, memory: _Memory, frame: Frame, now: float) -> bool:
        if memory.sequence != frame.sequence:
            return False
        if self.forget_after is None or memory.wire is None:
            return True
        return now - memory.stored_at < self.forget_after

    def acknowledge(
        self, command: Frame, payload: bytes, *, now: float, encrypted: bool | None = None
    ) -> None:
        """Answer a delivered command. On session 0 nobody waits and nothing is sent.

        Args:
            command: The frame that was delivered.
            payload: Data of the ack.
            now: Present time, s.
            encrypted: Encrypt the ack; by default as the command was (errata, encryption of acks).

        Raises:
            UsageError: Encryption without a key.
            PayloadTooLarge: See :func:`~m100link.wire.encode_frame`.
        """
        if command.session == NO_ACK_SESSION:
            return
        encrypt = command.encrypted if encrypted is None else encrypted
        if encrypt and self.cipher is None:
            raise UsageError("an encrypted ack was asked for and there is no key")
        wire = encode_frame(
            payload,
            session=command.session,
            sequence=command.sequence,
            is_ack=True,
            cipher=self.cipher if encrypt else None,
        )
        if command.session > ACK_ONCE_SESSION:
            memory = self._memories.get(command.session)
            # The sender has gone on to another number in this session. Stored, this ack would
            # answer the repeats of a command that is still at work.
            if memory is None or memory.sequence != command.sequence:
                self.statistics.stale_replies += 1
                return
            memory.wire = wire
            memory.stored_at = now
        self.output.append(wire)

    def forget(self) -> None:
        """Lose all memory, as at power-on."""
        self._memories.clear()

    def forget_answered(self) -> None:
        """Forget the requests that were answered; those at work still get their answer."""
        # A version query forgets in the middle of a read: without their memory, the commands behind
        # it in the same bytes got no answer, and their repeats were carried out again.
        at_work = {s: memory for s, memory in self._memories.items() if memory.wire is None}
        self._memories = at_work

    def next_output(self) -> bytes | None:
        """The next bytes to write, oldest first."""
        return self.output.popleft() if self.output else None


# -- the requesting side of a session: numbers, repeats, time-outs (document 1.4) ------------------
# No clock and no I/O: every method that depends on time takes ``now`` in seconds of any monotonic
# clock. ``next_wakeup`` says when the sender next wants to be woken; ``handle_timer`` is the call.


NO_ACK_SESSION = 0
ACK_ONCE_SESSION = 1
RELIABLE_SESSIONS = range(2, MAX_SESSION + 1)

_ALWAYS_FITS = 991  # bytes of data that are not too many for a frame, encrypted or not
_REMEMBERED_UNANSWERED = 1024  # numbers per session that went unanswered one after the other
_REMEMBERED = 256  # finished requests whose acks are still distinguished from foreign ones


@dataclass(slots=True, eq=False, repr=False)
class _Request:
    """A request that waits for a session, or is in flight on one."""

    token: int  # what its event will carry
    data: bytes  # data of the frame, kept until a session gives it a number
    mode: SessionMode  # how it is sent
    # The key of the moment it was made: a key that changes meanwhile is not for it.
    cipher: Cipher | None
    timeout: float  # seconds to wait after each transmission
    tries_left: int  # transmissions still allowed; 0 when the next deadline ends it
    session: int = -1  # its session, -1 while it waits for one
    sequence: int = -1  # its number, the same for every repeat: by it the other end knows a repeat
    tries: int = 0
    first_at: float = 0.0  # when it was transmitted first, and when last
    last_at: float = 0.0
    deadline: float = 0.0  # when it is repeated, or ends
    wire: bytes = b""  # its frame: a repeat is the same bytes again
    # Nobody wants its end any more; it holds its session until then all the same.
    is_abandoned: bool = False


class Sender:
    """Sends requests and matches their acks.

    Args:
        first_sequence: Sequence number of the first request. Choose it at random for each
            connection: an aircraft answers a repeated number from memory, without executing.
        statistics: Counters to use; shared with the receiver of the same end.

    Attributes:
        cipher: Encrypts requests that ask for it. May be set at any time.
        latency: How long acks took lately, those that came too late included.
        output: Frames to write, oldest first; the writer takes them out.
    """

    def __init__(
        self, *, first_sequence: int = 0, statistics: SessionStatistics | None = None
    ) -> None:
        self.cipher: Cipher | None = None
        self.statistics = statistics or SessionStatistics()
        self.latency = Latency()
        self._sequence = first_sequence & 0xFFFF  # the next number that any session would take
        self._tokens = 0  # given out so far
        # By session and number, as an ack names what it answers.
        self._in_flight: dict[tuple[int, int], _Request] = {}
        self._by_token: dict[int, _Request] = {}  # those whose end somebody waits for
        self._waiting: OrderedDict[int, _Request] = OrderedDict()  # for a session, oldest first
        self._free = list(RELIABLE_SESSIONS)  # a heap: the lowest comes first
        # Per session the numbers that the other end may have an ack stored for.
        self._taken: dict[int, set[int]] = {}
        # Requests that ended lately: when one that no ack ended was first sent, None for the
        # others. A second ack of one is not foreign.
        self._finished: OrderedDict[tuple[int, int], float | None] = OrderedDict()
        self.output: deque[bytes] = deque()
        self._events: deque[Expired] = deque()

    def push(self, data: bytes, *, encrypted: bool = False) -> bytes:
        """Encode a frame on session 0. It is returned, not queued: nothing will follow it.

        Raises:
            PayloadTooLarge: See :func:`~m100link.wire.encode_frame`.
            UsageError: Encryption without a key.
        """
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFFFF
        cipher = self._cipher_for(encrypted)
        return encode_frame(data, session=NO_ACK_SESSION, sequence=sequence, cipher=cipher)

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
        """Begin a request; it ends in one :class:`Acked` or :class:`Expired` event.

        A reliable request takes the lowest free session, or waits its turn when all thirty are
        busy; its time-out runs from each transmission. After the last transmission it waits for at
        least as long as answers take on this line (:class:`~m100link.session.events.Latency`).

        Args:
            data: Data of the frame.
            now: Present time, s.
            mode: ``RELIABLE`` or ``ACK_ONCE``.
            encrypted: Encrypt the data.
            timeout: Seconds to wait for the ack of one transmission, more than 0.
            tries: Transmissions in all, at least 1; exactly 1 with ``ACK_ONCE``, because without
                a stored ack a repeat would be executed again.

        Returns:
            A token that the event will carry.

        Raises:
            PayloadTooLarge: See :func:`~m100link.wire.encode_frame`.
            UsageError: A mode without acks, a time-out or number of tries that makes no sense,
                or encryption without a key.
        """
        if mode is SessionMode.NO_ACK:
            raise UsageError("a request needs an ack", remedy="use push() on session 0")
        if not 0 < timeout < math.inf or tries < 1:
            raise UsageError(f"{tries} tries of {timeout} s make no request")
        if mode is SessionMode.ACK_ONCE and tries != 1:
            raise UsageError(
                "session 1 is never repeated",
                cause="its receiver stores no ack and would execute a repeat again",
                remedy="use tries=1, or SessionMode.RELIABLE",
            )
        cipher = self._cipher_for(encrypted)
        if len(data) > _ALWAYS_FITS:  # what cannot be sent fails before it takes a session
            encode_frame(data, session=0, sequence=0, cipher=cipher)
        self._tokens += 1
        request = _Request(self._tokens, data, mode, cipher, timeout, tries)
        if mode is SessionMode.ACK_ONCE:
            self._begin(request, ACK_ONCE_SESSION, now)
        elif self._free and not self._waiting:
            self._begin_reliable(request, now)
        else:
            self._waiting[request.token] = request
        self._by_token[request.token] = request
        return request.token

    def abandon(self, token: int) -> None:
        """Forget a request: no more repeats and no event; what has not left does not leave.

        One that was transmitted keeps its session until its ack or its time-out, so that no late
        ack can be taken for another's.
        """
        request = self._by_token.pop(token, None)
        if request is None:
            return
        if self._waiting.pop(token, None) is None:
            request.is_abandoned = True
            request.tries_left = 0
            if request.wire in self.output:
                self.output.remove(request.wire)

    def is_open(self, token: int) -> bool:
        """Whether a request has yet to end, and was not abandoned."""
        return token in self._by_token

    def receive_ack(self, frame: Frame, now: float) -> Acked | None:
        """Take an ack frame; None (and a count) when it answers nothing that is open."""
        session, _, sequence, encrypted, _, data = frame
        address = (session, sequence)
        request = self._in_flight.get(address)
        if request is None:
            if address not in self._finished:
                self.statistics.foreign_acks += 1
                return None
            first_at, self._finished[address] = self._finished[address], None
            if first_at is None:
                self.statistics.duplicate_acks += 1
            else:  # by it the next request knows how long to wait
                self.statistics.late_acks += 1
                self.latency.note(now - first_at)
            return None
        self.latency.note(now - request.first_at)
        self._retire(request, was_answered=True)
        # The other end stores the ack of its newest number alone (document 1.4): others are free.
        self._taken[session] = {sequence}
        if self._waiting:
            self._begin_waiting(now)
        if request.is_abandoned:
            self.statistics.late_acks += 1
            return None
        self.statistics.acks += 1
        # Acked(…) would go through a constructor in Python, at twice the cost.
        return tuple.__new__(Acked, (request.token, data, encrypted))

    def next_wakeup(self) -> float | None:
        """Time of the earliest deadline, None when nothing is open."""
        return min((request.deadline for request in self._in_flight.values()), default=None)

    def handle_timer(self, now: float) -> None:
        """Repeat or expire what is due."""
        # A list first: a request that expires leaves the table that is looked through.
        for request in [r for r in self._in_flight.values() if r.deadline <= now]:
            if request.tries_left > 0:
                self._transmit(request, now)
                continue
            # Asked now: an ack that came too late may have shown meanwhile how slow the line is.
            request.deadline = request.last_at + self.latency.wait_s(request.timeout)
            if request.deadline > now:
                continue
            self._retire(request, was_answered=False)
            if not request.is_abandoned:
                self.statistics.expired += 1
                self._events.append(
                    Expired(request.token, request.session, request.sequence, request.tries)
                )
        self._begin_waiting(now)

    def next_event(self) -> Expired | None:
        """The next expired request, oldest first."""
        return self._events.popleft() if self._events else None

    def next_output(self) -> bytes | None:
        """The next bytes to write, oldest first."""
        return self.output.popleft() if self.output else None

    @property
    def busy_sessions(self) -> int:
        """How many of the sessions 2 to 31 are taken."""
        return len(RELIABLE_SESSIONS) - len(self._free)

    @property
    def waiting_requests(self) -> int:
        """How many requests wait for a session."""
        return len(self._waiting)

    def _cipher_for(self, encrypted: bool) -> Cipher | None:
        if encrypted and self.cipher is None:
            raise UsageError(
                "an encrypted frame was asked for and there is no key",
                cause="the key is set when activation succeeds",
                remedy="activate first, or give the key when connecting",
            )
        return self.cipher if encrypted else None

    def _begin_waiting(self, now: float) -> None:
        while self._waiting and self._free:
            _, request = self._waiting.popitem(last=False)
            self._begin_reliable(request, now)

    def _begin_reliable(self, request: _Request, now: float) -> None:
        # Taken once its frame is made: a request that raises leaves the session free.
        self._begin(request, self._free[0], now)
        heappop(self._free)

    def _begin(self, request: _Request, session: int, now: float) -> None:
        request.session = session
        request.sequence = self._next_sequence(session)
        request.wire = encode_frame(
            request.data,
            session=session,
            sequence=request.sequence,
            cipher=request.cipher,
        )
        self._in_flight[session, request.sequence] = request
        self.statistics.requests += 1
        self._transmit(request, now)

    def _transmit(self, request: _Request, now: float) -> None:
        if not request.tries:
            request.first_at = now
        request.tries += 1
        request.tries_left -= 1
        request.last_at = now
        request.deadline = now + request.timeout
        self.statistics.transmissions += 1
        self.output.append(request.wire)

    def _retire(self, request: _Request, *, was_answered: bool) -> None:
        address = (request.session, request.sequence)
        del self._in_flight[address]
        self._by_token.pop(request.token, None)
        self._finished[address] = None if was_answered else request.first_at
        if len(self._finished) > _REMEMBERED:
            self._finished.popitem(last=False)
        if request.mode is SessionMode.RELIABLE:
            heappush(self._free, request.session)

    def _next_sequence(self, session: int) -> int:
        """One counter for all sessions, but no number that the other end may remember."""
        # It remembers one per session: the last that it acked, or one sent since whose ack was
        # lost. A request with such a number would be answered from memory and never executed.
        taken = self._taken.setdefault(session, set())
        while True:
            sequence = self._sequence
            self._sequence = (sequence + 1) & 0xFFFF
            if sequence not in taken and (session, sequence) not in self._in_flight:
                break
        if len(taken) >= _REMEMBERED_UNANSWERED:
            taken.clear()  # nobody is there, and memory is bounded
        taken.add(sequence)
        self._finished.pop((session, sequence), None)
        return sequence
