"""The carrier inside one event loop."""

from __future__ import annotations

import pytest

from m100link.apps.agent.messages import Message, Note
from m100link.apps.agent.transports import memory_channels

A, B = Note("info", "a"), Note("info", "b")


def test_a_message_has_arrived_when_it_was_sent() -> None:
    one, other = memory_channels()
    got: list[Message] = []
    other.open(got.append, got.append)  # type: ignore[arg-type]
    one.send(A)
    assert got == [A]


@pytest.mark.parametrize("as_bytes", [False, True])
def test_what_comes_before_the_end_is_open_waits_in_order(as_bytes: bool) -> None:
    one, other = memory_channels(as_bytes=as_bytes)
    one.send(A)
    one.send(B)
    got: list[Message] = []
    other.open(got.append, lambda reason: None)
    assert got == [A, B]


def test_closing_is_told_once_and_ends_both_ways() -> None:
    one, other = memory_channels()
    got: list[Message] = []
    reasons: list[str] = []
    other.open(got.append, reasons.append)
    one.open(got.append, reasons.append)
    one.close("enough")
    one.close("again")
    other.close("too")
    one.send(A)
    other.send(A)
    assert (got, reasons) == ([], ["enough"])


def test_what_goes_wrong_at_one_end_stays_there(caplog: pytest.LogCaptureFixture) -> None:
    one, other = memory_channels()

    def fail(message: Message) -> None:
        raise RuntimeError("a front's mistake")

    other.open(fail, lambda reason: None)
    one.send(A)
    assert "a Note was not taken" in caplog.text
    assert "a front's mistake" in caplog.text
