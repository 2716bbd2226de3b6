"""What was heard is known, for a while."""

from __future__ import annotations

import pytest

from m100link.apps.agent.remote_error import MessageError
from m100link.apps.fleet.order_log import KEPT_S, OrderBook
from m100link.apps.fleet.payloads import Outcome, Progress, Reply


def reply(identity: str) -> Reply:
    return Reply(identity, "a1", "boot", Progress.DONE, Outcome.OK, order=identity.encode())


def test_an_order_runs_then_has_an_outcome() -> None:
    book = OrderBook()
    assert not book.is_known("a")
    book.begin("a", b"a", 0.0)
    assert book.is_known("a")
    assert book.reply("a") is None
    book.end(reply("a"), 0.0)
    assert book.reply("a") == reply("a")


def test_what_is_old_is_forgotten_but_not_what_runs() -> None:
    book = OrderBook()
    book.begin("a", b"a", 0.0)
    book.end(reply("a"), 0.0)
    book.begin("b", b"b", KEPT_S - 1)
    assert book.is_known("a")
    book.begin("c", b"c", KEPT_S)
    assert not book.is_known("a")
    assert book.is_known("b")
    book.begin("d", b"d", 3 * KEPT_S)
    assert book.is_known("b"), "it runs"


def test_an_id_is_that_of_one_order() -> None:
    book = OrderBook()
    assert not book.heard("a", b"a")
    book.begin("a", b"a", 0.0)
    for _ in range(2):
        assert book.heard("a", b"a")
        with pytest.raises(MessageError, match="another order came under the id a"):
            book.heard("a", b"b")
        book.end(reply("a"), 0.0)


def test_what_an_agent_before_began_is_known_as_that() -> None:
    book = OrderBook(["a"])
    assert book.was_begun_before("a")
    assert not book.is_known("a")
    assert not book.was_begun_before("b")


def test_what_was_made_before_words_were_lost_may_have_been_begun() -> None:
    book = OrderBook(["a"], unsure_before=10.0)
    assert book.is_unsure(9.9)
    assert not book.is_unsure(10.0)
    assert not OrderBook(["a"]).is_unsure(-1e9)


def test_it_does_not_grow_without_end() -> None:
    book = OrderBook()
    for number in range(50_000):
        book.begin(str(number), b"", number * 1e-3)
        book.end(reply(str(number)), number * 1e-3)
    assert sum(book.is_known(str(number)) for number in range(50_000)) <= 20_001


def test_one_that_runs_for_long_keeps_no_other_one() -> None:
    """A mission of half an hour, begun first: what ended since is forgotten all the same."""
    book = OrderBook()
    book.begin("mission", b"", 0.0)
    for number in range(50_000):
        book.begin(str(number), b"", number * 1e-3)
        book.end(reply(str(number)), number * 1e-3)
    book.begin("last", b"", 2000.0)
    assert not any(book.is_known(str(number)) for number in range(50_000))
    assert book.is_known("mission")
    assert book.reply("mission") is None
    book.end(reply("mission"), 2000.0)
    book.begin("another", b"", 2000.0 + KEPT_S - 1)
    assert book.reply("mission") == reply("mission"), "whoever asked for it may still ask"
