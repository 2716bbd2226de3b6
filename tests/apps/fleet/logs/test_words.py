"""What is said about logs: there and back, and nothing that cannot be is read."""

from __future__ import annotations

import contextlib
import json
import random

import pytest

from m100link.apps.agent.remote_error import MessageError, fault_of
from m100link.apps.fleet.logs.words import (
    LOG,
    MOST_PIECE,
    LogEntry,
    LogQuestion,
    LogReply,
    What,
    pack_entries,
    pack_question,
    pack_reply,
    unpack_entries,
    unpack_question,
    unpack_reply,
)
from m100link.apps.fleet.payloads import VERSION, Outcome
from m100link.errors import UsageError

NAME = "m100link-20260101-000000.mcap"


def test_what_is_said_comes_out_as_it_went_in() -> None:
    for question in (
        LogQuestion(What.LIST),
        LogQuestion(What.PIECE, NAME, 5, MOST_PIECE),
        LogQuestion(What.DIGEST, "m100link-20260101-000000-12.mcap", 0, 1 << 40),
    ):
        assert unpack_question(pack_question(question)) == question
    fault = fault_of(UsageError("no", remedy="none"))
    reply = LogReply("i" * 32, "a1", Outcome.REFUSED, fault, 0.5, 3, 7, True)
    assert unpack_reply(pack_reply(reply, b"\n\0{}")) == (reply, b"\n\0{}")
    entries = [LogEntry(NAME, 3, 1.5, True)]
    assert unpack_entries(pack_entries(entries)) == entries


@pytest.mark.parametrize(
    "name",
    [
        "",
        "..",
        "../a2/" + NAME,
        "/etc/passwd",
        f"{NAME}/..",
        f"./{NAME}",
        NAME + "\n",
        NAME + "\0",
        "ledger.jsonl",
    ],
)
def test_a_name_that_no_recorder_gives_is_no_log(name: str) -> None:
    for what in (What.PIECE, What.DIGEST):
        with pytest.raises(MessageError, match="no name of a log"):
            unpack_question(pack_question(LogQuestion(what, name)))
    assert unpack_entries(pack_entries([LogEntry(name, 3, 0.0, False)])) == []


@pytest.mark.parametrize("at", [-1.0, 1e12, 1e300])
def test_a_log_of_no_time_is_not_listed(at: float) -> None:
    """Whoever shows a list says dates."""
    assert unpack_entries(pack_entries([LogEntry(NAME, 3, at, False)])) == []


@pytest.mark.parametrize(("offset", "length"), [(-1, 5), (0, -1), (0, MOST_PIECE + 1)])
def test_no_more_than_a_piece_can_be_asked_for(offset: int, length: int) -> None:
    with pytest.raises(MessageError, match="no part of a log"):
        unpack_question(pack_question(LogQuestion(What.PIECE, NAME, offset, length)))


def test_another_version_is_said_and_too_much_is_not_read() -> None:
    good = pack_reply(LogReply("", "a1"))
    assert good[0] == VERSION
    with pytest.raises(MessageError, match="version 9"):
        unpack_reply(b"\x09" + good[1:])
    with pytest.raises(MessageError):
        unpack_reply(good + bytes(MOST_PIECE + 1))


def test_junk_is_refused_and_raises_nothing_else() -> None:
    chance = random.Random(4)
    good = [pack_question(LogQuestion(What.PIECE, NAME, 1, 2)), pack_reply(LogReply("", "a1"))]
    good.append(pack_entries([LogEntry(NAME, 3, 1.0, True)]))
    for number in range(6000):
        data = bytearray(good[number % 3])
        for _ in range(chance.randrange(1, 6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        for read in (unpack_question, unpack_reply, unpack_entries):
            with contextlib.suppress(MessageError):
                read(bytes(data))
    for text in ("[" * 100_000, "{}", "null", json.dumps({"what": "list"})):
        with pytest.raises(MessageError):
            unpack_question(LOG + text.encode())
