"""One end of the line as a whole, and two of them over a channel that does everything wrong."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence

import pytest
from hypothesis import note, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, precondition, rule

from m100link.errors import PayloadTooLarge, UsageError
from m100link.session import Acked, Endpoint, Event, Expired, Receiver, Sender, SessionMode
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame
from tests import limits
from tests.support import KEY


class End(Endpoint):
    """Keeps what happened until a test takes it."""

    def __init__(self, *, first_sequence: int = 0) -> None:
        super().__init__(first_sequence=first_sequence)
        self._kept: list[Event] = []

    def receive_data(self, data: bytes, now: float) -> Sequence[Event]:
        events = super().receive_data(data, now)
        self._kept += events
        return events

    def handle_timer(self, now: float) -> Sequence[Event]:
        events = super().handle_timer(now)
        self._kept += events
        return events

    def events(self) -> list[Event]:
        """Take the events that happened, in order."""
        kept, self._kept = self._kept, []
        return kept


def transfer(source: End, target: End, now: float) -> int:
    """Carry everything over; how many frames there were."""
    wires = list(source.output())
    for wire in wires:
        target.receive_data(wire, now)
    return len(wires)


def received(endpoint: End) -> list[Frame]:
    """The commands among the events."""
    return [event for event in endpoint.events() if isinstance(event, Frame)]


def waits(*endpoints: End) -> list[bool]:
    """Which of them have something to write."""
    return [endpoint.has_output for endpoint in endpoints]


def test_whether_there_is_output_is_known_without_taking_it() -> None:
    host, aircraft = End(), End()
    assert waits(host, aircraft) == [False, False]
    host.push(b"push")
    assert waits(host, aircraft) == [True, False]
    transfer(host, aircraft, 0.0)
    host.request(b"request", now=0.0)
    assert waits(host, aircraft) == [True, False]
    transfer(host, aircraft, 0.0)
    _, command = received(aircraft)
    aircraft.acknowledge(command, b"ack", now=0.0)
    assert waits(host, aircraft) == [False, True]
    transfer(aircraft, host, 0.0)
    assert waits(host, aircraft) == [False, False]


def test_dropped_pushes_do_not_leave_and_requests_do() -> None:
    host = End()
    host.push(b"push")
    host.request(b"request", now=0.0)
    host.drop_pushes()
    assert [frame.data for frame in FrameDecoder().feed(b"".join(host.output()))] == [b"request"]


def test_what_one_read_brings_is_reported_in_the_order_in_which_it_arrived() -> None:
    host, aircraft = End(), Endpoint()
    tokens = [host.request(data, now=0) for data in (b"first", b"second")]
    wires = []
    for frame in aircraft.receive_data(b"".join(host.output()), 0):
        assert isinstance(frame, Frame)
        aircraft.push(b"before " + frame.data)
        aircraft.acknowledge(frame, b"ack", now=0)
        acks_first = list(aircraft.output())
        wires += acks_first[::-1]
    events = host.receive_data(b"".join(wires), 0.1)
    assert [event.data if isinstance(event, Frame) else event.token for event in events] == [
        b"before first",
        tokens[0],
        b"before second",
        tokens[1],
    ]
    assert host.statistics.commands == 2


@pytest.mark.parametrize("kind", [Endpoint, Sender])
def test_a_request_is_sent_three_times_half_a_second_apart(kind: type[Endpoint | Sender]) -> None:
    """Unless it says otherwise."""
    host = kind()
    host.request(b"question", now=0)
    times = []
    while (now := host.next_wakeup()) is not None:
        times.append(now)
        host.handle_timer(now)
    assert times == [0.5, 1.0, 1.5]
    assert host.statistics.transmissions == 3
    assert host.statistics.expired == 1


def test_pushes_alone_are_counted_like_those_beside_acks() -> None:
    host, aircraft = End(), End()
    for data in (b"a", b"b", b"c"):
        aircraft.push(data)
    assert host.receive_data(b"".join(aircraft.output()), 0) == received(host)
    assert host.statistics.commands == 3


def test_a_request_is_delivered_answered_and_reported() -> None:
    host, aircraft = End(first_sequence=9), End()
    token = host.request(b"question", now=0)
    transfer(host, aircraft, 0)
    (frame,) = received(aircraft)
    assert (frame.session, frame.sequence, frame.data) == (2, 9, b"question")
    aircraft.acknowledge(frame, b"answer", now=0)
    transfer(aircraft, host, 0)
    assert host.events() == [Acked(token, b"answer", False)]
    assert host.next_wakeup() is None


def test_both_ends_may_ask_at_once_with_the_same_session_and_number() -> None:
    one, two = End(), End()
    for end, data in ((one, b"from one"), (two, b"from two")):
        end.request(data, now=0)
    transfer(one, two, 0)
    transfer(two, one, 0)
    for end in (one, two):
        (frame,) = received(end)
        assert (frame.session, frame.sequence) == (2, 0)
        end.acknowledge(frame, b"ack of " + frame.data, now=0)
    transfer(one, two, 0)
    transfer(two, one, 0)
    assert one.events() == [Acked(1, b"ack of from one", False)]
    assert two.events() == [Acked(1, b"ack of from two", False)]


def test_acks_are_written_first_and_pushes_last() -> None:
    host, aircraft = End(), End()
    aircraft.request(b"command", now=0)
    transfer(aircraft, host, 0)
    (frame,) = received(host)
    host.push(b"push")
    host.request(b"request", now=0)
    host.acknowledge(frame, b"ack", now=0)
    written = FrameDecoder().feed(b"".join(host.output()))
    assert [sent.data for sent in written] == [b"ack", b"request", b"push"]


def test_a_key_serves_both_directions() -> None:
    host, aircraft = End(), End()
    for end in (host, aircraft):
        end.cipher = Cipher(KEY)
        assert end.cipher is end.decoder.cipher
    host.request(b"secret", now=0, encrypted=True)
    transfer(host, aircraft, 0)
    (frame,) = received(aircraft)
    aircraft.acknowledge(frame, b"secret too", now=0)
    transfer(aircraft, host, 0)
    (answer,) = host.events()
    assert isinstance(answer, Acked)
    assert (answer.payload, answer.encrypted) == (b"secret too", True)


def test_a_plain_ack_of_an_encrypted_request_is_taken() -> None:
    host, aircraft = End(), End()
    host.cipher = Cipher(KEY)
    host.request(b"secret", now=0, encrypted=True)
    list(host.output())
    refusal = encode_frame(b"\x00\xff", session=2, sequence=0, is_ack=True)
    host.receive_data(refusal, 0)
    assert host.events() == [Acked(1, b"\x00\xff", False)]
    assert aircraft.cipher is None


def test_expiry_is_an_event_of_the_endpoint() -> None:
    host = End()
    token = host.request(b"x", now=0, timeout=1, tries=1)
    host.handle_timer(1)
    assert host.events() == [Expired(token, 2, 0, 1)]


def test_an_abandoned_request_reports_nothing() -> None:
    host = End()
    token = host.request(b"x", now=0, timeout=1, tries=1)
    assert host.is_open(token)
    host.abandon(token)
    assert not host.is_open(token)
    host.handle_timer(1)
    assert host.events() == []


# -- sender against receiver -----------------------------------------------------------------------

HOST, AIRCRAFT = 0, 1
PLACES = st.integers(0, 40)
# Less than 2 ** 16 numbers apart, but on both sides of the wrap.
FIRST_SEQUENCES = st.sampled_from((0, 1, 0xFFF0, 0xFFFF))


class Channel:
    """Frames under way in one direction.

    A serial line loses and damages frames; a repeated or reordered one exists only where something
    between the ends queues and retries. Commands of one session keep their order, as on any line:
    the document's receiver remembers one number per session and would execute a command again that
    arrives after a newer one of its session. Between sessions, and among acks, any order goes.
    """

    def __init__(self) -> None:
        self.wires: list[bytes] = []

    def choices(self) -> list[int]:
        """Places of the frames that may arrive next."""
        places, sessions = [], set()
        for place, wire in enumerate(self.wires):
            (frame,) = FrameDecoder(Cipher(KEY)).feed(wire)
            if frame.is_ack or frame.session not in sessions:
                places.append(place)
            if not frame.is_ack:
                sessions.add(frame.session)
        return places


class SenderAgainstReceiver(RuleBasedStateMachine):
    """Reliable commands over a line that loses, repeats, delays and reorders frames."""

    tokens = Bundle("tokens")

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.host: End | None = None
        self.aircraft = End()
        self.aircraft.cipher = Cipher(KEY)
        self.lines = {HOST: Channel(), AIRCRAFT: Channel()}
        self.unanswered: list[Frame] = []
        self.executed: Counter[bytes] = Counter()
        self.asked: dict[int, bytes] = {}
        self.outcome: dict[int, Acked | Expired] = {}
        self.abandoned: set[int] = set()

    def _host(self) -> End:
        assert self.host is not None
        return self.host

    def _collect(self) -> None:
        """Put what both ends want written on the line, and take their events."""
        ends = ((self._host(), HOST), (self.aircraft, AIRCRAFT))
        for end, name in ends:
            self.lines[name].wires += end.output()
        for event in self._host().events():
            assert isinstance(event, Acked | Expired)
            assert event.token not in self.outcome, "a request ended twice"
            assert event.token not in self.abandoned, "an abandoned request reported"
            self.outcome[event.token] = event
            if isinstance(event, Acked):
                assert event.payload == b"ack of " + self.asked[event.token]
        for event in self.aircraft.events():
            assert isinstance(event, Frame)
            self.executed[event.data] += 1
            self.unanswered.append(event)

    @rule(
        target=tokens,
        first=FIRST_SEQUENCES,
        encrypted=st.booleans(),
        timeout=st.sampled_from((0.1, 0.5, 2.0)),
        tries=st.integers(1, 4),
    )
    def ask(self, first: int, encrypted: bool, timeout: float, tries: int) -> int:
        """Begin a request; its data say which one it is."""
        if self.host is None:
            self.host = End(first_sequence=first)
            self.host.cipher = Cipher(KEY)
        data = b"command %d" % len(self.asked)
        token = self.host.request(
            data, now=self.now, encrypted=encrypted, timeout=timeout, tries=tries
        )
        self.asked[token] = data
        self._collect()
        return token

    @precondition(lambda self: self.host is not None and len(self.asked) < 40)
    @rule()
    def ask_more_than_there_are_sessions(self) -> None:
        """So that some requests wait."""
        for _ in range(32):
            self.ask(first=0, encrypted=False, timeout=0.5, tries=2)

    @rule(token=tokens)
    def give_up(self, token: int) -> None:
        """Abandon a request, over or not."""
        self._host().abandon(token)
        if token not in self.outcome:
            self.abandoned.add(token)
        self._collect()

    @precondition(lambda self: any(line.wires for line in self.lines.values()))
    @rule(line=st.sampled_from((HOST, AIRCRAFT)), choice=PLACES, keep=st.booleans())
    def arrive(self, line: int, choice: int, keep: bool) -> None:
        """Some frame arrives; with ``keep`` a copy of it stays under way."""
        places = self.lines[line].choices()
        if not places:
            return
        wires = self.lines[line].wires
        wire = wires[places[choice % len(places)]]
        if not keep:
            wires.remove(wire)
        target = self.aircraft if line == HOST else self._host()
        target.receive_data(wire, self.now)
        self._collect()

    @precondition(lambda self: any(line.wires for line in self.lines.values()))
    @rule(keep=st.booleans())
    def all_arrive_and_are_answered(self, keep: bool) -> None:
        """A moment of good weather; with ``keep`` every frame arrives twice."""
        for line in (HOST, AIRCRAFT):
            under_way = list(self.lines[line].wires)
            self.lines[line].wires.clear()
            target = self.aircraft if line == HOST else self._host()
            for wire in under_way:
                for _ in range(1 + keep):
                    target.receive_data(wire, self.now)
                    self._collect()
            while self.unanswered:
                self.answer(choice=0)

    @precondition(lambda self: any(line.wires for line in self.lines.values()))
    @rule(line=st.sampled_from((HOST, AIRCRAFT)), choice=PLACES)
    def lose(self, line: int, choice: int) -> None:
        """Some frame is lost."""
        wires = self.lines[line].wires
        if wires:
            del wires[choice % len(wires)]

    @precondition(lambda self: self.unanswered)
    @rule(choice=PLACES)
    def answer(self, choice: int) -> None:
        """The aircraft finishes some command, not always the oldest."""
        frame = self.unanswered.pop(choice % len(self.unanswered))
        self.aircraft.acknowledge(frame, b"ack of " + frame.data, now=self.now)
        self._collect()

    @rule(seconds=st.sampled_from((0.05, 0.1, 0.5, 2.0)))
    def wait(self, seconds: float) -> None:
        """Time goes by; both ends are woken when they asked to be."""
        until = self.now + seconds
        if self.host is not None:
            while (wakeup := self.host.next_wakeup()) is not None and wakeup <= until:
                self.now = max(self.now, wakeup)
                self.host.handle_timer(self.now)
                self._collect()
        self.now = until

    @invariant()
    def no_command_is_executed_twice(self) -> None:
        """Whatever the line does."""
        assert all(count == 1 for count in self.executed.values()), self.executed

    def teardown(self) -> None:
        """When no frame arrives any more every request has an outcome, and an answer was earned."""
        if self.host is None:
            return
        for channel in self.lines.values():
            channel.wires.clear()
        for _ in range(20):
            self.wait(600.0)
            for channel in self.lines.values():
                channel.wires.clear()
        note(f"{len(self.asked)} asked, {len(self.executed)} executed")
        assert set(self.outcome) | self.abandoned >= set(self.asked)
        assert self.host.sender.busy_sessions == self.host.sender.waiting_requests == 0
        assert self.host.next_wakeup() is None
        for token, outcome in self.outcome.items():
            if isinstance(outcome, Acked):
                assert self.executed[self.asked[token]] == 1


SenderAgainstReceiver.TestCase.settings = settings(stateful_step_count=60)
TestSenderAgainstReceiver = SenderAgainstReceiver.TestCase


def test_over_a_line_that_only_loses_and_damages_every_command_runs_once_and_is_answered() -> None:
    seed = 20151121
    dice = random.Random(seed)
    host, aircraft = End(first_sequence=0xFFF0), End()
    executed: Counter[bytes] = Counter()
    answers: dict[int, bytes] = {}
    asked: dict[int, bytes] = {}
    now = 0.0

    def line(wires: list[bytes], target: End) -> None:
        for wire in wires:
            fate = dice.random()
            if fate < 0.2:
                continue
            if fate < 0.4:
                at = dice.randrange(len(wire))
                wire = wire[:at] + bytes((wire[at] ^ 1 << dice.randrange(8),)) + wire[at + 1 :]
            target.receive_data(wire, now)
        target.receive_data(bytes(1100), now)  # noise that ends what a damaged length swallowed

    while now < 400:
        if len(asked) < 200:
            data = b"command %d" % len(asked)
            asked[host.request(data, now=now, timeout=0.5, tries=40)] = data
        host.handle_timer(now)
        line(list(host.output()), aircraft)
        for frame in received(aircraft):
            executed[frame.data] += 1
            aircraft.acknowledge(frame, b"ack of " + frame.data, now=now)
        line(list(aircraft.output()), host)
        for event in host.events():
            assert isinstance(event, Acked), (seed, event)
            answers[event.token] = event.payload
        now += 0.5
    assert executed == dict.fromkeys(asked.values(), 1), seed
    assert answers == {token: b"ack of " + data for token, data in asked.items()}, seed
    assert host.statistics.transmissions > host.statistics.requests


def test_a_session_mode_has_no_number_of_its_own() -> None:
    # The document counts its modes from 1, its enum from 0, and neither is the session on the wire.
    assert all(isinstance(mode.value, str) for mode in SessionMode)


# -- the answering side: each command once, repeats from memory ------------------------------------


def command(session: int, sequence: int, data: bytes = b"do", *, encrypted: bool = False) -> Frame:
    """A command frame."""
    return Frame(session, False, sequence, encrypted, 0, data)


def sent(receiver: Receiver) -> list[Frame]:
    """Take the acks that the receiver wants written."""
    decoder = FrameDecoder(Cipher(KEY))
    frames = []
    while (wire := receiver.next_output()) is not None:
        frames += decoder.feed(wire)
    return frames


@pytest.mark.parametrize("sequence", [0, 1, 0xFFFF])
@pytest.mark.parametrize("session", range(32))
def test_the_first_command_of_a_session_is_delivered_whatever_its_number(
    session: int, sequence: int
) -> None:
    # "Nothing stored yet" is a state of its own: number 0 is no repeat of nothing.
    frame = command(session, sequence)
    assert Receiver().receive_command(frame, 0) is frame


@pytest.mark.parametrize("session", range(2, 32))
def test_a_repeated_number_is_answered_from_memory_and_not_delivered(session: int) -> None:
    receiver = Receiver()
    frame = command(session, 7)
    receiver.receive_command(frame, 0)
    receiver.acknowledge(frame, b"done", now=0)
    answer = Frame(session, True, 7, False, 0, b"done")
    assert sent(receiver) == [answer]
    for _ in range(3):
        assert receiver.receive_command(frame, 1) is None
        assert sent(receiver) == [answer]
    statistics = receiver.statistics
    assert (statistics.commands, statistics.repeated_commands) == (1, 3)


def test_the_number_decides_and_not_the_data() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7, b"one"), 0)
    receiver.acknowledge(command(2, 7), b"1", now=0)
    assert receiver.receive_command(command(2, 7, b"another"), 0) is None
    assert receiver.receive_command(command(2, 8, b"one"), 0) is not None


def test_a_new_number_replaces_the_memory() -> None:
    receiver = Receiver()
    for sequence in (7, 8, 7):
        assert receiver.receive_command(command(2, sequence), 0) is not None
        receiver.acknowledge(command(2, sequence), bytes((sequence,)), now=0)
    assert [frame.data for frame in sent(receiver)] == [b"\x07", b"\x08", b"\x07"]


def test_each_session_has_its_own_memory() -> None:
    receiver = Receiver()
    for session in (2, 3, 31):
        assert receiver.receive_command(command(session, 7), 0) is not None


@pytest.mark.parametrize("session", [0, 1])
def test_sessions_0_and_1_have_no_memory(session: int) -> None:
    receiver = Receiver()
    for _ in range(3):
        assert receiver.receive_command(command(session, 7), 0) is not None
        receiver.acknowledge(command(session, 7), b"done", now=0)
    assert len(sent(receiver)) == (3 if session == 1 else 0)


def test_a_repeat_that_overtakes_its_own_answer_is_dropped_and_counted() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7), 0)
    assert receiver.receive_command(command(2, 7), 1) is None
    assert sent(receiver) == []
    assert receiver.statistics.unanswered_repeats == 1
    receiver.acknowledge(command(2, 7), b"done", now=2)
    assert [frame.data for frame in sent(receiver)] == [b"done"]


def test_a_reply_to_a_command_that_a_newer_one_replaced_is_not_sent() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7), 0)
    receiver.receive_command(command(2, 8), 1)
    receiver.acknowledge(command(2, 7), b"stale", now=2)
    assert sent(receiver) == []
    assert receiver.statistics.stale_replies == 1
    receiver.acknowledge(command(2, 8), b"fresh", now=2)
    assert [frame.data for frame in sent(receiver)] == [b"fresh"]


def test_a_reply_to_a_command_that_never_came_is_not_sent() -> None:
    receiver = Receiver()
    receiver.acknowledge(command(2, 7), b"to nobody", now=0)
    assert sent(receiver) == []
    assert receiver.statistics.stale_replies == 1


def test_a_stored_ack_may_be_forgotten_after_a_time() -> None:
    receiver = Receiver(forget_after=5)
    receiver.receive_command(command(2, 7), 0)
    receiver.acknowledge(command(2, 7), b"done", now=10)
    assert receiver.receive_command(command(2, 7), 14.9) is None
    assert receiver.receive_command(command(2, 7), 15) is not None


def test_without_such_a_time_it_is_kept_for_ever() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7), 0)
    receiver.acknowledge(command(2, 7), b"done", now=0)
    assert receiver.receive_command(command(2, 7), 1e9) is None


def test_a_command_still_at_work_is_not_forgotten() -> None:
    receiver = Receiver(forget_after=5)
    receiver.receive_command(command(2, 7), 0)
    assert receiver.receive_command(command(2, 7), 100) is None


def test_what_is_at_work_is_answered_although_what_was_answered_is_forgotten() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7), 0)
    receiver.forget_answered()
    assert receiver.receive_command(command(2, 7), 0) is None, "it is at work"
    receiver.acknowledge(command(2, 7), b"done", now=0)
    assert len(sent(receiver)) == 1
    receiver.forget_answered()
    assert receiver.receive_command(command(2, 7), 0) is not None


def test_forgetting_is_as_after_power_on() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 0), 0)
    receiver.acknowledge(command(2, 0), b"done", now=0)
    receiver.forget()
    assert receiver.receive_command(command(2, 0), 0) is not None


@pytest.mark.parametrize("encrypted", [False, True])
def test_an_ack_is_encrypted_as_its_command_was(encrypted: bool) -> None:
    receiver = Receiver()
    receiver.cipher = Cipher(KEY)
    frame = command(2, 7, encrypted=encrypted)
    receiver.receive_command(frame, 0)
    receiver.acknowledge(frame, b"done", now=0)
    (answer,) = sent(receiver)
    assert (answer.encrypted, answer.data) == (encrypted, b"done")


@pytest.mark.parametrize("encrypted", [False, True])
def test_the_encryption_of_an_ack_can_be_chosen(encrypted: bool) -> None:
    receiver = Receiver()
    receiver.cipher = Cipher(KEY)
    frame = command(2, 7, encrypted=not encrypted)
    receiver.receive_command(frame, 0)
    receiver.acknowledge(frame, b"done", now=0, encrypted=encrypted)
    assert sent(receiver)[0].encrypted == encrypted


def test_an_encrypted_ack_without_a_key_is_refused() -> None:
    receiver = Receiver()
    frame = command(2, 7, encrypted=True)
    receiver.receive_command(frame, 0)
    with pytest.raises(UsageError, match="no key"):
        receiver.acknowledge(frame, b"done", now=0)


def test_an_ack_that_does_not_fit_is_refused_and_leaves_the_command_unanswered() -> None:
    receiver = Receiver()
    receiver.receive_command(command(2, 7), 0)
    with pytest.raises(PayloadTooLarge):
        receiver.acknowledge(command(2, 7), bytes(1008), now=0)
    receiver.acknowledge(command(2, 7), b"shorter", now=0)
    assert [frame.data for frame in sent(receiver)] == [b"shorter"]


def test_each_limit_is_as_agreed() -> None:
    assert limits.differences("session") == []
