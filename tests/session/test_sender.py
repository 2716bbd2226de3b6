"""The requesting side: numbers, sessions, repeats, time-outs, and which ack answers what."""

from __future__ import annotations

import sys

import pytest

from m100link.errors import PayloadTooLarge, UsageError
from m100link.session import Acked, Expired, Sender, SessionMode
from m100link.wire import Cipher, Frame, FrameDecoder
from tests.support import KEY


def sent(sender: Sender) -> list[Frame]:
    """Take what the sender wants written, as frames."""
    decoder = FrameDecoder(Cipher(KEY))
    frames = []
    while (wire := sender.next_output()) is not None:
        frames += decoder.feed(wire)
    return frames


def expired(sender: Sender) -> list[Expired]:
    """Take the requests that ran out of tries."""
    events = []
    while (event := sender.next_event()) is not None:
        events.append(event)
    return events


def ack(frame: Frame, data: bytes = b"", *, encrypted: bool = False) -> Frame:
    """The ack of a command frame."""
    return Frame(frame.session, True, frame.sequence, encrypted, 0, data)


# -- sessions --------------------------------------------------------------------------------------


def test_a_push_goes_on_session_0_and_waits_for_nothing() -> None:
    sender = Sender(first_sequence=5)
    (frame,) = FrameDecoder().feed(sender.push(b"abc"))
    assert frame == Frame(0, False, 5, False, 0, b"abc")
    assert sender.next_wakeup() is None
    assert sent(sender) == []


def test_reliable_requests_take_the_lowest_free_session_from_2_to_31() -> None:
    sender = Sender()
    for _ in range(30):
        sender.request(b"x", now=0)
    frames = sent(sender)
    assert [frame.session for frame in frames] == list(range(2, 32))
    sender.receive_ack(ack(frames[7]), 0)
    sender.receive_ack(ack(frames[3]), 0)
    sender.request(b"y", now=0)
    sender.request(b"z", now=0)
    assert [(frame.session, frame.data) for frame in sent(sender)] == [(5, b"y"), (9, b"z")]


def test_with_all_thirty_busy_requests_wait_in_order() -> None:
    sender = Sender()
    for _ in range(30):
        sender.request(b"x", now=0, timeout=100)
    busy = sent(sender)
    for data in (b"first", b"second", b"third"):
        sender.request(data, now=0, timeout=100)
    assert sent(sender) == []
    assert (sender.busy_sessions, sender.waiting_requests) == (30, 3)
    sender.receive_ack(ack(busy[20]), 1)
    sender.receive_ack(ack(busy[10]), 2)
    assert [(f.session, f.data) for f in sent(sender)] == [(22, b"first"), (12, b"second")]
    assert (sender.busy_sessions, sender.waiting_requests) == (30, 1)


def test_a_session_freed_by_a_time_out_goes_to_the_next_in_line() -> None:
    sender = Sender()
    for _ in range(31):
        sender.request(b"x", now=0, timeout=1, tries=1)
    assert len(sent(sender)) == 30
    sender.handle_timer(1)
    assert len(expired(sender)) == 30
    assert [frame.session for frame in sent(sender)] == [2]


def test_the_time_out_of_a_waiting_request_runs_from_its_transmission() -> None:
    sender = Sender()
    tokens = [sender.request(b"x", now=0, timeout=10, tries=1) for _ in range(31)]
    first = sent(sender)[0]
    sender.receive_ack(ack(first), 3)
    sender.handle_timer(10)
    assert [event.token for event in expired(sender)] == tokens[1:30]
    assert sender.next_wakeup() == 13


def test_session_1_is_used_once_and_never_repeated() -> None:
    sender = Sender()
    token = sender.request(b"x", now=0, mode=SessionMode.ACK_ONCE, timeout=1, tries=1)
    (frame,) = sent(sender)
    assert frame.session == 1
    sender.handle_timer(1)
    assert sent(sender) == []
    assert expired(sender) == [Expired(token, 1, frame.sequence, 1)]


def test_several_requests_may_be_open_on_session_1() -> None:
    sender = Sender()
    tokens = [
        sender.request(b"x", now=0, mode=SessionMode.ACK_ONCE, timeout=1, tries=1) for _ in range(3)
    ]
    frames = sent(sender)
    assert [frame.session for frame in frames] == [1, 1, 1]
    # DJI's own programs take any ack of session 1 for theirs; here the number decides.
    for token, frame in zip(reversed(tokens), reversed(frames), strict=True):
        assert sender.receive_ack(ack(frame), 0) == Acked(token, b"", False)


# -- numbers ---------------------------------------------------------------------------------------


def test_one_counter_serves_all_sessions() -> None:
    sender = Sender(first_sequence=100)
    sender.request(b"x", now=0)
    pushed = FrameDecoder().feed(sender.push(b"x"))
    sender.request(b"x", now=0, mode=SessionMode.ACK_ONCE, tries=1)
    sender.request(b"x", now=0)
    assert [frame.sequence for frame in sent(sender)] == [100, 102, 103]
    assert pushed[0].sequence == 101


def test_numbers_wrap_from_65535_to_0() -> None:
    sender = Sender(first_sequence=0xFFFF)
    for _ in range(3):
        sender.request(b"x", now=0)
    assert [frame.sequence for frame in sent(sender)] == [0xFFFF, 0, 1]


def test_a_first_number_beyond_16_bits_is_cut_to_them() -> None:
    sender = Sender(first_sequence=0x1_0005)
    sender.request(b"x", now=0)
    assert sent(sender)[0].sequence == 5


def once_round(sender: Sender) -> None:
    """Let the counter go once round, but for one number, by pushes."""
    for _ in range(0xFFFF):
        sender.push(b"")


def test_a_session_never_uses_the_number_again_that_it_used_last() -> None:
    sender = Sender(first_sequence=7)
    sender.request(b"x", now=0)
    (first,) = sent(sender)
    sender.receive_ack(ack(first), 0)
    once_round(sender)  # 8, …, 65535, 0, …, 6: the counter is at 7 again
    sender.request(b"y", now=0)
    (second,) = sent(sender)
    assert (first.session, first.sequence) == (2, 7)
    assert (second.session, second.sequence) == (2, 8)


def test_a_number_that_only_the_other_end_may_remember_is_not_used_again() -> None:
    # The second command is lost with all its repeats, so the aircraft still remembers the first:
    # its number would be answered from memory and the command never executed.
    sender = Sender(first_sequence=7)
    sender.request(b"executed", now=0)
    (first,) = sent(sender)
    sender.receive_ack(ack(first), 0)
    sender.request(b"lost", now=0, timeout=1, tries=1)
    (lost,) = sent(sender)
    assert lost.sequence == 8
    sender.handle_timer(1)
    for _ in range(0x10000 - 2):
        sender.push(b"")  # 9, …, 65535, 0, …, 6: the counter is at 7 again
    sender.request(b"new", now=2)
    (new,) = sent(sender)
    assert (new.session, new.sequence) == (2, 9)


def test_numbers_that_nobody_answered_are_not_remembered_without_end() -> None:
    sender = Sender()
    for now in range(5000):
        sender.request(b"x", now=now, timeout=1, tries=1)
        sender.handle_timer(now + 1)
    assert sum(map(len, sender._taken.values())) <= 1024
    assert len(expired(sender)) == 5000


def test_a_number_still_in_flight_is_skipped() -> None:
    sender = Sender(first_sequence=3)
    for _ in range(2):
        sender.request(b"x", now=0, mode=SessionMode.ACK_ONCE, timeout=9e9, tries=1)
    for _ in range(0x10000 - 2):
        sender.push(b"")
    sender.request(b"x", now=0, mode=SessionMode.ACK_ONCE, timeout=1, tries=1)
    assert [frame.sequence for frame in sent(sender)] == [3, 4, 5]


# -- time ------------------------------------------------------------------------------------------


def test_a_request_is_repeated_with_the_same_bytes_until_its_tries_are_spent() -> None:
    sender = Sender()
    token = sender.request(b"x", now=10, timeout=0.5, tries=3)
    wires = [sender.next_output()]
    assert sender.next_wakeup() == 10.5
    for now in (10.5, 11.0):
        sender.handle_timer(now - 0.001)
        assert sender.next_output() is None
        sender.handle_timer(now)
        wires.append(sender.next_output())
        assert expired(sender) == []
    assert wires[0] == wires[1] == wires[2]
    assert wires[0] is not None
    sender.handle_timer(11.5)
    assert expired(sender) == [Expired(token, 2, 0, 3)]
    assert sender.next_output() is None
    assert sender.next_wakeup() is None
    statistics = sender.statistics
    assert (statistics.requests, statistics.transmissions, statistics.expired) == (1, 3, 1)


def test_the_next_wakeup_is_the_earliest_deadline() -> None:
    sender = Sender()
    assert sender.next_wakeup() is None
    sender.request(b"x", now=0, timeout=5)
    sender.request(b"x", now=0, timeout=2)
    sender.request(b"x", now=0, timeout=3)
    assert sender.next_wakeup() == 2


def test_all_that_is_due_is_repeated_at_once() -> None:
    sender = Sender()
    for data in (b"first", b"second", b"third"):
        sender.request(data, now=0, timeout=1)
    assert len(sent(sender)) == 3
    sender.handle_timer(1)
    assert [frame.data for frame in sent(sender)] == [b"first", b"second", b"third"]


def test_a_late_timer_repeats_once_and_counts_anew() -> None:
    sender = Sender()
    sender.request(b"x", now=0, timeout=1, tries=3)
    sender.handle_timer(50)
    assert len(sent(sender)) == 2
    assert sender.next_wakeup() == 51


# -- acks ------------------------------------------------------------------------------------------


def test_an_ack_matches_on_session_and_number() -> None:
    sender = Sender(first_sequence=40)
    token = sender.request(b"x", now=0)
    (frame,) = sent(sender)
    other_session = frame._replace(session=3)
    other_number = frame._replace(sequence=41)
    assert sender.receive_ack(ack(other_session), 0) is None
    assert sender.receive_ack(ack(other_number), 0) is None
    assert sender.statistics.foreign_acks == 2
    answer = sender.receive_ack(ack(frame, b"yes", encrypted=True), 0)
    assert answer == Acked(token, b"yes", True)
    assert (sender.statistics.acks, sender.busy_sessions) == (1, 0)


def test_a_second_ack_is_counted_as_duplicate() -> None:
    sender = Sender()
    sender.request(b"x", now=0)
    (frame,) = sent(sender)
    sender.receive_ack(ack(frame), 0)
    assert sender.receive_ack(ack(frame), 0) is None
    assert sender.statistics.duplicate_acks == 1


def test_an_ack_after_the_last_time_out_is_counted_as_late() -> None:
    sender = Sender()
    sender.request(b"x", now=40, timeout=1, tries=1)
    (frame,) = sent(sender)
    sender.handle_timer(41)
    assert sender.receive_ack(ack(frame), 42) is None
    assert sender.statistics.late_acks == 1
    assert sender.latency.round_trip_s == 2, "the next request is waited for accordingly"


def test_a_late_ack_answers_no_newer_request_on_its_session() -> None:
    sender = Sender()
    sender.request(b"old", now=0, timeout=1, tries=1)
    (old,) = sent(sender)
    sender.handle_timer(1)
    token = sender.request(b"new", now=1)
    (new,) = sent(sender)
    assert old.session == new.session
    assert sender.receive_ack(ack(old, b"old answer"), 2) is None
    assert sender.receive_ack(ack(new, b"new answer"), 2) == Acked(token, b"new answer", False)


def test_what_the_sender_remembers_of_finished_requests_is_bounded() -> None:
    sender = Sender()
    for _ in range(2000):
        sender.request(b"x", now=0)
        (frame,) = sent(sender)
        sender.receive_ack(ack(frame), 0)
    assert len(sender._finished) <= 256


def test_of_finished_requests_the_oldest_are_forgotten_first() -> None:
    sender = Sender()
    frames = []
    for _ in range(2000):
        sender.request(b"x", now=0)
        frames += sent(sender)
        sender.receive_ack(ack(frames[-1]), 0)
    sender.receive_ack(ack(frames[-1]), 0)
    assert (sender.statistics.duplicate_acks, sender.statistics.foreign_acks) == (1, 0)
    sender.receive_ack(ack(frames[0]), 0)
    assert (sender.statistics.duplicate_acks, sender.statistics.foreign_acks) == (1, 1)


def test_the_data_of_a_finished_request_is_let_go() -> None:
    sender = Sender()
    data = bytes(range(100))
    before = sys.getrefcount(data)
    for _ in range(100):
        sender.request(data, now=0)
        (frame,) = sent(sender)
        sender.receive_ack(ack(frame), 0)
    assert sys.getrefcount(data) == before


# -- giving up -------------------------------------------------------------------------------------


def test_an_abandoned_request_is_not_repeated_and_reports_nothing() -> None:
    sender = Sender()
    token = sender.request(b"x", now=0, timeout=1, tries=5)
    assert len(sent(sender)) == 1
    sender.abandon(token)
    for now in range(1, 10):
        sender.handle_timer(now)
    assert sent(sender) == []
    assert expired(sender) == []
    assert sender.statistics.expired == 0


def test_an_abandoned_request_keeps_its_session_until_its_ack_or_its_time_out() -> None:
    sender = Sender()
    first = sender.request(b"first", now=0, timeout=1)
    second = sender.request(b"second", now=0, timeout=1)
    frames = sent(sender)
    sender.abandon(first)
    sender.abandon(second)
    assert sender.busy_sessions == 2
    assert sender.receive_ack(ack(frames[0]), 0.5) is None
    assert (sender.busy_sessions, sender.statistics.late_acks) == (1, 1)
    sender.handle_timer(1.5)  # three times what the one answer took
    assert sender.busy_sessions == 0


def test_what_nobody_wants_any_more_does_not_leave_later() -> None:
    sender = Sender()
    sender.request(b"first", now=0)
    token = sender.request(b"one", now=0, timeout=1)
    assert sender.is_open(token)
    sender.abandon(token)
    assert not sender.is_open(token)
    assert [frame.data for frame in sent(sender)] == [b"first"]
    sender.handle_timer(1)
    assert [frame.data for frame in sent(sender)] == [b"first"]
    sender.request(b"two", now=1)
    assert [frame.data for frame in sent(sender)] == [b"two"]


def test_a_request_is_open_until_it_ends() -> None:
    sender = Sender()
    answered, unanswered = sender.request(b"x", now=0), sender.request(b"y", now=0, tries=1)
    frame, _ = sent(sender)
    assert (sender.is_open(answered), sender.is_open(unanswered)) == (True, True)
    sender.receive_ack(ack(frame), 0)
    assert (sender.is_open(answered), sender.is_open(unanswered)) == (False, True)
    sender.handle_timer(1)
    assert not sender.is_open(unanswered)


def test_a_request_abandoned_while_it_waits_is_never_sent() -> None:
    sender = Sender()
    for _ in range(30):
        sender.request(b"x", now=0)
    busy = sent(sender)
    gone = sender.request(b"gone", now=0)
    sender.request(b"stays", now=0)
    sender.abandon(gone)
    sender.receive_ack(ack(busy[0]), 1)
    assert [frame.data for frame in sent(sender)] == [b"stays"]


def test_abandoning_what_is_over_does_nothing() -> None:
    sender = Sender()
    token = sender.request(b"x", now=0)
    (frame,) = sent(sender)
    sender.receive_ack(ack(frame), 0)
    sender.abandon(token)
    sender.abandon(token)
    sender.abandon(999)
    assert sender.busy_sessions == 0


# -- misuse ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"mode": SessionMode.NO_ACK}, "needs an ack"),
        ({"mode": SessionMode.ACK_ONCE, "tries": 2}, "never repeated"),
        ({"tries": 0}, "0 tries"),
        ({"timeout": 0.0}, "no request"),
        ({"timeout": -1.0}, "no request"),
        ({"timeout": float("nan")}, "no request"),
        ({"timeout": float("inf")}, "no request"),
        ({"encrypted": True}, "no key"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused(words: dict[str, object], message: str) -> None:
    sender = Sender()
    with pytest.raises(UsageError, match=message):
        sender.request(b"x", now=0, **words)  # type: ignore[arg-type]  # words of several types
    assert sent(sender) == []
    assert sender.busy_sessions == 0


def test_a_payload_that_does_not_fit_takes_neither_session_nor_number() -> None:
    sender = Sender()
    with pytest.raises(PayloadTooLarge):
        sender.request(bytes(1008), now=0)
    with pytest.raises(PayloadTooLarge):
        sender.push(bytes(1008))
    sender.request(b"x", now=0)
    (frame,) = sent(sender)
    assert frame.session == 2


@pytest.mark.parametrize("cipher", [None, Cipher(KEY)])
def test_it_is_refused_although_it_would_have_to_wait(cipher: Cipher | None) -> None:
    """Later nobody could hear it: the request would never have ended."""
    sender = Sender()
    sender.cipher = cipher
    for _ in range(30):
        sender.request(b"x", now=0)
    with pytest.raises(PayloadTooLarge):
        sender.request(bytes(1008), now=0, encrypted=cipher is not None)
    assert sender.waiting_requests == 0


def test_an_encrypted_push_without_a_key_is_refused() -> None:
    with pytest.raises(UsageError, match="no key"):
        Sender().push(b"x", encrypted=True)


def test_requests_and_pushes_are_encrypted_when_asked_for() -> None:
    sender = Sender()
    sender.cipher = Cipher(KEY)
    sender.request(b"secret", now=0, encrypted=True)
    sender.request(b"plain", now=0)
    assert [(f.encrypted, f.data) for f in sent(sender)] == [(True, b"secret"), (False, b"plain")]
    (pushed,) = FrameDecoder(Cipher(KEY)).feed(sender.push(b"secret", encrypted=True))
    assert (pushed.encrypted, pushed.data) == (True, b"secret")


def test_a_request_that_was_to_be_encrypted_never_leaves_plain() -> None:
    sender = Sender()
    sender.cipher = Cipher(KEY)
    for _ in range(30):
        sender.request(b"x", now=0)
    busy = sent(sender)
    sender.request(b"secret", now=0, encrypted=True)
    sender.cipher = None  # the key goes away while the request waits for a session
    sender.receive_ack(ack(busy[0]), 1)
    assert [(f.encrypted, f.data) for f in sent(sender)] == [(True, b"secret")]
