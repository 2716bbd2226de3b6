"""The requesting side of a session: numbers, repeats, time-outs (document 1.4).

No clock and no I/O: every method that depends on time takes ``now`` in seconds of any monotonic
clock, ``next_wakeup`` says when the sender next wants to be woken and ``handle_timer`` is the call.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass
from heapq import heappop, heappush

from m100link.errors import UsageError
from m100link.session.events import Acked, Expired, SessionMode, SessionStatistics
from m100link.wire.cipher import Cipher
from m100link.wire.frame import MAX_SESSION, Frame, encode_frame

NO_ACK_SESSION = 0
ACK_ONCE_SESSION = 1
RELIABLE_SESSIONS = range(2, MAX_SESSION + 1)

_ALWAYS_FITS = 991  # bytes of data that are not too many for a frame, encrypted or not
_REMEMBERED_UNANSWERED = 1024  # numbers per session that went unanswered one after the other
_REMEMBERED = 256  # finished requests whose acks are still told apart from foreign ones


@dataclass(slots=True)
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
        output: Frames to write, oldest first; whoever writes takes them out.
    """

    def __init__(
        self, *, first_sequence: int = 0, statistics: SessionStatistics | None = None
    ) -> None:
        self.cipher: Cipher | None = None
        self.statistics = statistics or SessionStatistics()
        self._sequence = first_sequence & 0xFFFF  # the next number that any session would take
        self._tokens = 0  # given out so far
        # By session and number, as an ack names what it answers.
        self._in_flight: dict[tuple[int, int], _Request] = {}
        self._by_token: dict[int, _Request] = {}  # those whose end somebody waits for
        self._waiting: OrderedDict[int, _Request] = OrderedDict()  # for a session, oldest first
        self._free = list(RELIABLE_SESSIONS)  # a heap: the lowest comes first
        # Per session the numbers that the other end may have an ack stored for.
        self._taken: dict[int, set[int]] = {}
        # What ended lately, and whether by an ack: a second ack of it is not a foreign one.
        self._finished: OrderedDict[tuple[int, int], bool] = OrderedDict()
        self.output: deque[bytes] = deque()
        self._events: deque[Expired] = deque()

    def push(self, data: bytes, *, encrypted: bool = False) -> bytes:
        """Encode a frame on session 0. It is returned, not queued: nothing will follow it.

        Raises:
            PayloadTooLarge: See :func:`~m100link.wire.encode_frame`.
            UsageError: Encryption without a key.
        """
        sequence = self._next_sequence(NO_ACK_SESSION)
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
        busy; its time-out runs from each transmission.

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
        if timeout <= 0 or tries < 1:
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
            was_answered = self._finished.get(address)
            if was_answered is None:
                self.statistics.foreign_acks += 1
            elif was_answered:
                self.statistics.duplicate_acks += 1
            else:
                self.statistics.late_acks += 1
            return None
        self._retire(request, was_answered=True)
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
        for request in [r for r in self._in_flight.values() if r.deadline <= now]:
            if request.tries_left > 0:
                self._transmit(request, now)
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
        request.tries += 1
        request.tries_left -= 1
        request.deadline = now + request.timeout
        self.statistics.transmissions += 1
        self.output.append(request.wire)

    def _retire(self, request: _Request, *, was_answered: bool) -> None:
        address = (request.session, request.sequence)
        del self._in_flight[address]
        self._by_token.pop(request.token, None)
        self._finished[address] = was_answered
        if len(self._finished) > _REMEMBERED:
            self._finished.popitem(last=False)
        if request.mode is SessionMode.RELIABLE:
            heappush(self._free, request.session)

    def _next_sequence(self, session: int) -> int:
        """One counter for all sessions, but no number that the other end may remember.

        It remembers one per session: the last that it acked, or one sent since whose ack was lost.
        """
        taken: set[int] = set()
        if session != NO_ACK_SESSION:
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
