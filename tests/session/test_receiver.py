"""The answering side: each command once, repeats from memory."""

from __future__ import annotations

import pytest

from m100link.errors import PayloadTooLarge, UsageError
from m100link.session import Receiver
from m100link.wire import Cipher, Frame, FrameDecoder
from tests.support import KEY


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
