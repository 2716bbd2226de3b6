"""Requests as futures, over a cable in memory and on virtual time."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from typing import Any

import pytest

from m100link.errors import (
    AckTimeout,
    LinkClosed,
    LinkError,
    LinkLost,
    M100Error,
    PayloadTooLarge,
    UsageError,
)
from m100link.link import Link, connect_in_memory
from m100link.protocol.commands.activation import Activate
from m100link.protocol.firmware import FIRMWARE_1_0
from m100link.session import SessionMode
from m100link.wire import Cipher, Frame, FrameDecoder, encode_frame
from tests.link.peer import Peer, connected, echo, settle, silent
from tests.support import KEY

pytestmark = pytest.mark.anyio


@pytest.fixture(autouse=True)
def nothing_reaches_the_exception_handler() -> Iterator[None]:
    """Fail a test in whose time the event loop logged an exception."""
    records: list[logging.LogRecord] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            records.append(record)

    logger, handler = logging.getLogger("asyncio"), Keep(logging.WARNING)
    logger.addHandler(handler)
    yield
    logger.removeHandler(handler)
    assert [record.getMessage() for record in records] == []


def now() -> float:
    """Virtual seconds."""
    return asyncio.get_running_loop().time()


# -- requests --------------------------------------------------------------------------------------


async def test_a_request_returns_the_data_of_its_ack() -> None:
    link, peer, _ = await connected()
    assert await link.request(b"hello") == b"ack of hello"
    assert peer.received == [Frame(2, False, 0, False, 0, b"hello")]
    await link.close()


async def test_many_requests_at_once_each_get_their_own_answer() -> None:
    link, peer, _ = await connected()
    asked = [b"request %d" % number for number in range(500)]
    answers = await asyncio.gather(*(link.request(data) for data in asked))
    assert answers == [b"ack of " + data for data in asked]
    assert now() == 0, "a request that waits for a session is sent as soon as one is free"
    assert sorted(peer.data) == sorted(asked)
    assert link.statistics().acks == 500
    await link.close()


async def test_answers_in_any_order_find_their_requests() -> None:
    kept: list[Frame] = []
    link, peer, _ = await connected(lambda peer, frame: kept.append(frame))
    tasks = [asyncio.ensure_future(link.request(b"%d" % n)) for n in range(10)]
    await settle()
    for frame in reversed(kept):
        echo(peer, frame)
    assert await asyncio.gather(*tasks) == [b"ack of %d" % n for n in range(10)]
    await link.close()


async def test_a_lost_frame_is_repeated_after_its_time_out() -> None:
    link, peer, _ = await connected(silent)
    task = asyncio.ensure_future(link.request(b"hello", timeout=0.5, tries=3))
    await asyncio.sleep(0.75)
    assert link.statistics().repeats == 1
    peer.link._endpoint.receiver.forget()
    peer.handler = echo
    assert await task == b"ack of hello"
    assert now() == pytest.approx(1.0)
    await link.close()


async def test_a_repeat_is_executed_once_and_answered_from_memory() -> None:
    link, peer, _ = await connected(silent)
    task = asyncio.ensure_future(link.request(b"hello", timeout=0.5, tries=3))
    await asyncio.sleep(0.75)
    echo(peer, peer.received[0])
    assert await task == b"ack of hello"
    await asyncio.sleep(5)
    assert peer.data == [b"hello"]
    await link.close()


class _Kept(asyncio.Protocol):
    """Keeps the bytes that come, as frames."""

    def __init__(self, cipher: Cipher | None = None) -> None:
        self.frames: list[Frame] = []
        self._decoder = FrameDecoder(cipher)

    def data_received(self, data: bytes) -> None:
        self.frames += self._decoder.feed(data)


async def test_a_repeated_command_is_answered_at_once() -> None:
    link, kept = Link(), _Kept()
    link.on_received = lambda frame, now: link.acknowledge(frame, b"once")
    end = connect_in_memory(kept, link)
    for _ in range(3):
        end.write(encode_frame(b"question", session=2, sequence=77))
        await settle()
    assert kept.frames == 3 * [Frame(2, True, 77, False, 0, b"once")]
    assert now() == 0
    await link.close()


async def test_the_same_number_is_another_command_after_five_seconds() -> None:
    """An aircraft that restarts counts from the start again."""
    received: list[float] = []
    link, kept = Link(), _Kept()
    link.on_received = lambda frame, now: received.append(now)
    end = connect_in_memory(kept, link)
    for wait in (0.0, 4.9, 5.1):
        await asyncio.sleep(wait)
        end.write(encode_frame(b"question", session=2, sequence=0))
        await settle()
        link.acknowledge(Frame(2, False, 0, False, 0, b"question"), b"answer")
    assert received == [pytest.approx(0.0), pytest.approx(10.0)]
    await link.close()


async def test_no_ack_after_all_tries_is_an_ack_timeout_that_tells_all() -> None:
    link, _, _ = await connected(silent)
    with pytest.raises(AckTimeout, match="no ack of take_off after 3 tries") as caught:
        await link.request(b"x", name="take_off", timeout=0.5, tries=3)
    assert now() == pytest.approx(1.5)
    error = caught.value
    assert (error.command, error.session, error.sequence, error.tries) == ("take_off", 2, 0, 3)
    assert "unknown" in error.seen
    assert isinstance(error, TimeoutError)
    assert link.statistics().expired == 1
    await link.close()


async def test_a_silent_line_is_named_as_the_likely_cause() -> None:
    link, peer, _ = await connected(silent)
    with pytest.raises(AckTimeout) as caught:
        await link.request(b"x", timeout=0.1, tries=1)
    assert "nothing arrives" in caught.value.cause
    peer.link.push(b"\x02\x00\x00\x00")
    await settle()
    with pytest.raises(AckTimeout) as caught:
        await link.request(b"x", timeout=0.1, tries=1)
    assert "ignores the command" in caught.value.cause
    await asyncio.sleep(0.9)
    with pytest.raises(AckTimeout) as caught:
        await link.request(b"x", timeout=0.1, tries=1)
    assert "nothing has come from the aircraft for 1.1 s" in caught.value.cause
    await link.close()


async def test_a_request_is_tried_three_times_half_a_second_apart() -> None:
    link, _, _ = await connected(silent)
    with pytest.raises(AckTimeout, match="after 3 tries"):
        await link.request(b"x")
    assert now() == pytest.approx(1.5)
    assert link.statistics().frames_sent == 3
    await link.close()


async def test_session_1_is_asked_once() -> None:
    link, peer, _ = await connected()
    mode = SessionMode.ACK_ONCE
    assert await link.request(b"x", mode=mode, tries=1) == b"ack of x"
    assert peer.received[0].session == 1
    peer.handler = silent
    with pytest.raises(AckTimeout):
        await link.request(b"x", mode=mode, timeout=0.1, tries=1)
    assert len(peer.received) == 2
    await link.close()


async def test_a_request_that_cannot_be_sent_raises_at_once_and_leaves_nothing() -> None:
    link, _, _ = await connected()
    cases: list[tuple[dict[str, Any], type[UsageError]]] = [
        ({"data": bytes(1008)}, PayloadTooLarge),
        ({"data": b"x", "encrypted": True}, UsageError),
        ({"data": b"x", "tries": 0}, UsageError),
    ]
    for words, error in cases:
        with pytest.raises(error):
            await link.request(**words)
    assert await link.request(b"x") == b"ack of x"
    assert link._pending == {}
    await link.close()


async def test_a_cancelled_request_is_not_repeated_and_its_late_ack_is_counted() -> None:
    link, peer, _ = await connected(silent)
    task = asyncio.ensure_future(link.request(b"old", timeout=0.5, tries=3))
    await settle()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    echo(peer, peer.received[0])
    await asyncio.sleep(5)
    assert peer.data == [b"old"]
    assert link.statistics().late_acks == 1
    peer.handler = echo
    assert await link.request(b"new") == b"ack of new"
    assert link._pending == {}
    await link.close()


async def test_a_request_cancelled_in_the_moment_of_its_ack_harms_nobody() -> None:
    link, peer, _ = await connected(silent)
    task = asyncio.ensure_future(link.request(b"x"))
    await settle()
    wire = encode_frame(b"yes", session=2, sequence=0, is_ack=True)
    task.cancel()  # the future is cancelled, its owner has not run yet
    link.data_received(wire)
    link.data_received(wire)
    with pytest.raises(asyncio.CancelledError):
        await task
    assert peer.data == [b"x"]
    assert await _one_more(link, peer) == b"ack of more"
    await link.close()


async def _one_more(link: Link, peer: Peer) -> bytes:
    peer.handler = echo
    return await link.request(b"more")


async def test_one_timer_serves_all_requests() -> None:
    link, _, _ = await connected(silent)
    tasks = [
        asyncio.ensure_future(link.request(b"x", timeout=timeout, tries=1))
        for timeout in (5.0, 1.0, 3.0)
    ]
    ended = []
    for task in tasks:
        task.add_done_callback(lambda _: ended.append(now()))
    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert all(isinstance(result, AckTimeout) for result in results)
    assert ended == pytest.approx([1.0, 3.0, 5.0])
    await link.close()


async def test_what_waited_for_a_session_is_repeated_after_its_own_time_out() -> None:
    """The ack that frees the session comes long before the timer of the others."""
    link, peer, _ = await connected(silent)
    others = [
        asyncio.ensure_future(link.request(b"%d" % n, timeout=5.0, tries=1)) for n in range(30)
    ]
    await settle()
    waiting = asyncio.ensure_future(link.request(b"waiting", timeout=0.2, tries=2))
    await asyncio.sleep(1.0)
    assert b"waiting" not in peer.data
    echo(peer, peer.received[0])
    with pytest.raises(AckTimeout, match="after 2 tries"):
        await waiting
    # Sent at 1.0 and 1.2 s; the one answer so far took 1 s, so the last is waited for three times
    # as long.
    assert now() == pytest.approx(4.2)
    await link.close()
    await asyncio.gather(*others, return_exceptions=True)


# -- pushes, acks, keys ----------------------------------------------------------------------------


async def test_a_push_goes_on_session_0() -> None:
    link, peer, _ = await connected()
    assert link.push(b"abc")
    await settle()
    assert peer.received == [Frame(0, False, 0, False, 0, b"abc")]
    await link.close()


async def test_commands_from_the_other_end_arrive_with_their_time_and_can_be_answered() -> None:
    arrived: list[tuple[Frame, float]] = []
    link = Link(on_received=lambda frame, at: arrived.append((frame, at)), first_sequence=0)
    _, peer, _ = await connected(link=link)
    await asyncio.sleep(2)
    task = asyncio.ensure_future(peer.link.request(b"\x02\x01\x04"))
    await settle()
    ((frame, at),) = arrived
    assert (frame.data, at, link.last_received_at) == (b"\x02\x01\x04", 2.0, 2.0)
    link.acknowledge(frame, b"\x00\x00")
    assert await task == b"\x00\x00"
    await link.close()


async def test_a_consumer_that_raises_costs_its_own_frame_only() -> None:
    """What came in the same read reaches who waits for it, in order, and before the next read."""
    arrived: list[bytes] = []

    def take(frame: Frame, now: float) -> None:
        arrived.append(frame.data)
        if frame.data.startswith(b"bad"):
            raise ZeroDivisionError(frame.data)

    link = Link(on_received=take, first_sequence=0)
    _, _, _ = await connected(silent, link=link)
    answer = asyncio.ensure_future(link.request(b"question"))
    await settle()
    told: list[str] = []
    asyncio.get_running_loop().set_exception_handler(
        lambda loop, context: told.append(str(context.get("exception")))
    )
    pushes = [
        encode_frame(data, session=0, sequence=number)
        for number, data in enumerate((b"one", b"bad 1", b"two", b"bad 2", b"three"))
    ]
    ack = encode_frame(b"answer", session=2, sequence=0, is_ack=True)
    with pytest.raises(ZeroDivisionError):
        link.data_received(b"".join(pushes) + ack)
    assert arrived == [b"one", b"bad 1"]
    assert await answer == b"answer"
    assert arrived == [b"one", b"bad 1", b"two", b"bad 2", b"three"]
    assert told == ["b'bad 2'"]
    await link.close()


async def test_a_key_encrypts_and_decrypts_in_both_directions() -> None:
    link, peer, _ = await connected()
    link.cipher = peer.link.cipher = Cipher(KEY)
    assert await link.request(b"secret", encrypted=True) == b"ack of secret"
    assert peer.received[0].encrypted
    await link.close()


async def test_a_command_that_came_encrypted_is_answered_plain_once_the_key_is_gone() -> None:
    kept: list[Frame] = []
    link, peer, _ = await connected(lambda peer, frame: kept.append(frame))
    link.cipher = peer.link.cipher = Cipher(KEY)
    task = asyncio.ensure_future(link.request(b"secret", encrypted=True))
    await settle()
    peer.link.cipher = None
    peer.link.acknowledge(kept[0], b"plain")
    assert await task == b"plain"
    await link.close()


@pytest.mark.parametrize("is_encrypted", [True, False])
async def test_a_command_is_answered_as_it_came(is_encrypted: bool) -> None:
    link, kept = Link(), _Kept(Cipher(KEY))
    link.cipher = Cipher(KEY)
    link.on_received = lambda frame, now: link.acknowledge(frame, b"answer")
    end = connect_in_memory(kept, link)
    cipher = Cipher(KEY) if is_encrypted else None
    end.write(encode_frame(b"question", session=2, sequence=7, cipher=cipher))
    await settle()
    (frame,) = kept.frames
    assert (frame.encrypted, frame.data) == (is_encrypted, b"answer")
    await link.close()


async def test_a_link_belongs_to_the_loop_in_which_it_was_made() -> None:
    assert Link().loop is asyncio.get_running_loop()


async def test_the_log_shows_frames_in_both_directions_cut_short_and_no_key(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "m100link")
    secret = "c0ffee" + "5a" * 29
    link, peer, _ = await connected()
    link.cipher = peer.link.cipher = Cipher(secret)
    await link.request(b"\x01\x00\x01" + bytes(500), encrypted=True)
    lines = [record.getMessage() for record in caplog.records]
    assert any(line.startswith("> aa") for line in lines)
    assert any(line.startswith("< session 2") for line in lines)
    assert max(map(len, lines)) < 200
    assert "5a5a" not in caplog.text.lower()
    assert "…" in caplog.text
    caplog.clear()
    await link.request(b"short")
    assert caplog.records
    assert "…" not in caplog.text, "what fits is shown whole"
    assert "5a5a" not in repr(vars(link)).lower()
    await link.close()


async def test_the_log_shows_nothing_of_an_activation_but_that_there_is_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Whichever end it is seen from; the app id is the first thing in it."""
    caplog.set_level(logging.DEBUG, "m100link")
    request = Activate(app_id=0x5A5B5C5D, level=2, version=1, bundle_id="my.own.app")
    data = bytes(Activate.ADDRESS) + request.value(FIRMWARE_1_0)
    link, _, _ = await connected()
    link.push(data)
    await settle()
    assert "5d5c5b5a" not in caplog.text
    assert b"my.own".hex() not in caplog.text
    assert sum(record.getMessage().endswith("0001…") for record in caplog.records) == 2
    await link.close()


async def test_the_log_can_be_switched_on_and_off_while_the_line_is_open(
    caplog: pytest.LogCaptureFixture,
) -> None:
    link, peer, _ = await connected()
    for level, told in ((logging.INFO, 0), (logging.DEBUG, 1), (logging.INFO, 0)):
        caplog.set_level(level, "m100link")
        await asyncio.sleep(0.1)  # the level is not looked at for each read
        caplog.clear()
        peer.link.push(b"\x02\x00 and nobody asked")
        await settle()
        lines = [record.getMessage() for record in caplog.records]
        assert sum(line.startswith("< session 0") for line in lines) == told
    await link.close()


async def test_statistics_count_both_directions() -> None:
    link, peer, _ = await connected()
    await link.request(b"x")
    link.data_received(b"\x00\x00" + b"\xaa" * 12 + bytes(12))
    here, there = link.statistics(), peer.link.statistics()
    assert (here.frames_sent, here.frames_received) == (1, 1)
    assert (here.bytes_sent, here.bytes_received) == (17, 16 + 8 + 26)
    assert there.bytes_received == here.bytes_sent
    assert here.discarded_bytes == 26
    assert here.discards == {"header_crc": 12}
    assert (here.dropped_writes, here.foreign_acks, here.duplicate_acks) == (0, 0, 0)
    await link.close()


async def test_acks_of_nothing_and_of_yesterday_are_distinguished() -> None:
    link, _, _ = await connected()
    link.data_received(encode_frame(b"", session=9, sequence=1, is_ack=True))
    await link.request(b"x")
    link.data_received(encode_frame(b"", session=2, sequence=0, is_ack=True))
    statistics = link.statistics()
    assert (statistics.foreign_acks, statistics.duplicate_acks) == (1, 1)
    await link.close()


async def test_two_links_rarely_begin_with_the_same_number() -> None:
    first = [Link()._endpoint.sender._sequence for _ in range(20)]
    assert len(set(first)) > 10


# -- a line that does not drain --------------------------------------------------------------------


class Line(asyncio.Transport):
    """Holds bytes, in its own buffer and in the system's, until they are taken.

    Attributes:
        size: Bytes in its own.
        out_waiting: Bytes in the system's.
    """

    def __init__(self) -> None:
        super().__init__({"serial": self})
        self.size = self.out_waiting = 0

    def get_write_buffer_size(self) -> int:
        return self.size


@pytest.mark.parametrize(("size", "out_waiting"), [(3, 0), (0, 3), (3, 3), (5, 2)])
async def test_closing_waits_for_what_is_in_either_buffer(size: int, out_waiting: int) -> None:
    link, line, began_at = Link(), Line(), now()
    link.connection_made(line)
    line.size, line.out_waiting = size, out_waiting

    def take() -> None:
        line.size = line.out_waiting = 0

    aborted_at: list[float] = []
    line.abort = lambda: aborted_at.append(now())  # type: ignore[method-assign] # to see when
    asyncio.get_running_loop().call_later(0.25, take)
    closing = asyncio.create_task(link.close())
    await asyncio.sleep(0.4)
    assert 0.25 <= aborted_at[0] - began_at < 0.27
    link.connection_lost(None)
    await closing


@pytest.mark.parametrize(
    ("met", "why"),
    [(None, ""), (MemoryError(), ": MemoryError()"), (OSError("unplugged"), ": unplugged")],
)
async def test_a_lost_line_says_why(met: Exception | None, why: str) -> None:
    link = Link()
    link.connection_made(Line())
    link.connection_lost(met)
    assert link.failure is not None
    assert link.failure.seen == f"link went away{why}"


async def test_pushes_that_come_in_one_read_arrive_in_order() -> None:
    taken: list[bytes] = []
    link = Link(on_received=lambda frame, _: taken.append(frame.data))
    _, peer, _ = await connected(link=link)
    for count in (1, 2, 3):
        for number in range(count):
            peer.link.push(bytes([number]))
        await settle()
        assert taken == [bytes([number]) for number in range(count)]
        taken.clear()


async def test_while_the_line_does_not_drain_pushes_are_dropped_and_counted() -> None:
    link, peer, transport = await connected()
    assert peer.link._transport is not None
    peer.link._transport.pause_reading()
    sent = 0
    while link.push(bytes(1000)):
        sent += 1
        assert sent < 100
    assert not link.push(b"stale")
    assert link.statistics().dropped_writes == 2
    assert transport.get_write_buffer_size() < 70_000
    with pytest.raises(AckTimeout) as caught:
        await link.request(b"x", timeout=0.1, tries=2)
    assert "does not take bytes" in caught.value.cause
    assert link.statistics().dropped_writes == 4
    peer.link._transport.resume_reading()
    await settle()
    assert link.push(b"fresh")
    await settle()
    assert peer.data[-1] == b"fresh"
    assert {b"stale", b"x"}.isdisjoint(peer.data)
    await link.close()


# -- the end ---------------------------------------------------------------------------------------


async def test_a_pulled_cable_fails_every_request_at_once_with_the_cause(
    caplog: pytest.LogCaptureFixture,
) -> None:
    lost: list[LinkError] = []
    link = Link(on_lost=lost.append)
    _, _, transport = await connected(silent, link=link)
    tasks = [asyncio.ensure_future(link.request(b"x", timeout=60)) for _ in range(40)]
    await settle()
    pulled = OSError(5, "Input/output error")
    transport.break_off(pulled)
    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert now() == 0
    assert {type(result) for result in results} == {LinkLost}
    assert {getattr(result, "__cause__", None) for result in results} == {pulled}
    assert len({id(result) for result in results}) == 40, "each has a traceback of its own"
    assert [type(error) for error in lost] == [LinkLost]
    assert not link.is_open
    assert isinstance(link.failure, LinkLost)
    for use in (link.request(b"x"), _pushing(link)):
        with pytest.raises(LinkLost, match="Input/output error"):
            await use
    await link.close()
    assert isinstance(link.failure, LinkLost), "closing later does not change what happened"
    await asyncio.sleep(100)
    assert link.statistics().repeats == 0, "what has failed is not tried again"
    assert "Input/output error" in caplog.text


async def _pushing(link: Link) -> None:
    link.push(b"x")


async def test_closing_fails_what_is_open_and_may_be_done_again() -> None:
    lost: list[LinkError] = []
    link = Link(on_lost=lost.append)
    await connected(silent, link=link)
    task = asyncio.ensure_future(link.request(b"x", timeout=60))
    await settle()
    await asyncio.gather(link.close(), link.close())
    await link.close()
    with pytest.raises(LinkClosed, match="by this side"):
        await task
    for use in (link.request(b"x"), _pushing(link)):
        with pytest.raises(LinkClosed):
            await use
    assert [type(error) for error in lost] == [LinkClosed]
    assert now() <= 2.5


async def test_after_closing_acks_go_nowhere_and_late_bytes_harm_nobody() -> None:
    link, _, _ = await connected()
    await link.close()
    link.acknowledge(Frame(2, False, 1, False, 0, b"x"), b"y")
    link.data_received(encode_frame(b"\x02\x00", session=0, sequence=0))


async def test_what_does_not_fit_is_dropped_frame_by_frame_and_none_leaves_later() -> None:
    link, peer, _ = await connected(silent)
    link.pause_writing()
    tasks = [asyncio.ensure_future(link.request(b"x", timeout=0.1, tries=2)) for _ in range(3)]
    await asyncio.sleep(0.15)
    assert link.statistics().dropped_writes == 6
    link.resume_writing()
    assert link.push(b"fresh")
    await settle()
    assert peer.data == [b"fresh"]
    await link.close()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_link_without_a_line_cannot_send_and_can_be_closed() -> None:
    link = Link()
    with pytest.raises(LinkClosed, match="not open yet"):
        await link.request(b"x")
    with pytest.raises(LinkClosed, match="not open yet"):
        link.push(b"x")
    waiting = asyncio.ensure_future(link.wait_connected())
    await settle()
    await link.close()
    with pytest.raises(LinkClosed, match="before it was open"):
        await waiting


async def test_a_peer_that_takes_nothing_delays_closing_by_a_second_at_most() -> None:
    link, peer, transport = await connected()
    assert peer.link._transport is not None
    peer.link._transport.pause_reading()
    link.push(b"x")
    await link.close()
    assert 0.9 < now() < 1.1
    assert transport.is_closing()


async def test_a_port_that_does_not_report_its_end_is_waited_for_a_second(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    link, _, transport = await connected()
    monkeypatch.setattr(transport, "abort", lambda: None)
    await link.close()
    assert now() == pytest.approx(1.0)
    assert "did not report its end" in caplog.text


async def test_closing_a_link_from_which_everything_has_left_takes_no_time() -> None:
    link, _, _ = await connected()
    assert await link.request(b"x") == b"ack of x"
    await link.close()
    assert now() == 0


async def test_cancelling_a_slow_close_closes_all_the_same() -> None:
    link, peer, transport = await connected()
    assert peer.link._transport is not None
    peer.link._transport.pause_reading()
    link.push(b"x")
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.1):
            await link.close()
    assert transport.is_closing()


async def test_no_timer_is_left_behind() -> None:
    link, _, _ = await connected(silent)
    with pytest.raises(AckTimeout):
        await link.request(b"x", timeout=1, tries=1)
    await link.close()
    await asyncio.sleep(100)
    assert link._timers == ()


async def test_everything_that_a_link_raises_is_an_m100_error() -> None:
    for error in (LinkLost, LinkClosed, AckTimeout, PayloadTooLarge):
        assert issubclass(error, M100Error)
