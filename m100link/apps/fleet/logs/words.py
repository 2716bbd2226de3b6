"""What is asked of the logs on board, and what is answered (pure logic).

A question is an order like any other, so that it is signed like any other; its message begins with
:data:`LOG`. An answer is the version, a line of JSON, and behind it the bytes of a log as they are.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum
from typing import Any

from m100link.apps.agent.codec import BadValue, Fields
from m100link.apps.agent.fault import Fault, MessageError
from m100link.apps.fleet.outcome import Outcome
from m100link.apps.fleet.payloads import VERSION, body
from m100link.errors.texts import read_json
from m100link.log.folder import is_log_name

__all__ = [
    "LOG",
    "MOST_PIECE",
    "LogEntry",
    "LogQuestion",
    "LogReply",
    "What",
    "pack_entries",
    "pack_question",
    "pack_reply",
    "unpack_entries",
    "unpack_question",
    "unpack_reply",
]

LOG = b"log\n"
"""What the message of an order about logs begins with; behind it is JSON."""

MOST_PIECE = 256 * 1024
"""Bytes of a log that go in one answer at most."""

MOST_ENTRIES = 1000
"""Logs that a list names at most, the newest."""

_MOST_HEAD = 32 * 1024
_LAST_UTC = 253_402_300_799.0
"""End of the year 9999: no date can be said of what is later."""


class What(Enum):
    """What is wanted."""

    LIST = "list"
    PIECE = "piece"
    DIGEST = "digest"  # SHA-256 of the first bytes


@dataclass(frozen=True, slots=True)
class LogQuestion:
    """Something is asked of the logs of one aircraft.

    Attributes:
        what: What is wanted.
        log: Name of the log; empty for a list.
        offset: First byte of a piece.
        length: Bytes of a piece, or over how many of them the digest is.
    """

    what: What
    log: str = ""
    offset: int = 0
    length: int = 0


@dataclass(frozen=True, slots=True)
class LogReply:
    """What an agent says; the bytes stand behind it.

    Attributes:
        id: Of the order.
        name: The aircraft.
        outcome: Whether it is answered.
        fault: Why it is not.
        again_s: Seconds after which to ask again, when it is not ready; 0 when it is.
        offset: First byte of the piece.
        size: Bytes that the log has now.
        is_written: Whether it is being written still.
    """

    id: str
    name: str
    outcome: Outcome = Outcome.OK
    fault: Fault | None = None
    again_s: float = 0.0
    offset: int = 0
    size: int = 0
    is_written: bool = False


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log on board.

    Attributes:
        log: Its name.
        size: Bytes that it has now.
        at: When it was written last, POSIX time of the computer on board, s.
        is_written: Whether it is being written still.
    """

    log: str
    size: int
    at: float
    is_written: bool


_QUESTION, _REPLY, _ENTRY = Fields(LogQuestion), Fields(LogReply), Fields(LogEntry)


def pack_question(question: LogQuestion) -> bytes:
    """The message of the order that asks it."""
    return LOG + json.dumps(_QUESTION.write(question)).encode()


def unpack_question(message: bytes) -> LogQuestion:
    """What the message of an order asks.

    Raises:
        MessageError: Nothing about logs, or what cannot be.
    """
    if not message.startswith(LOG):
        raise MessageError("an order came where logs are asked, and is about none")
    question: LogQuestion = _read(_QUESTION, message[len(LOG) :], "question about logs")
    if question.what is not What.LIST and not is_log_name(question.log):
        raise MessageError(
            f"{question.log[:80]!r} is no name of a log", remedy="m100link fleet log list NAME"
        )
    is_piece = question.what is What.PIECE
    if question.offset < 0 or not 0 <= question.length <= (MOST_PIECE if is_piece else 1 << 50):
        raise MessageError(f"{question.length} bytes from {question.offset} are no part of a log")
    return question


def pack_reply(reply: LogReply, data: bytes = b"") -> bytes:
    """The bytes of an answer.

    Raises:
        MessageError: It cannot be written.
    """
    try:
        head = json.dumps(_REPLY.write(reply), separators=(",", ":")).encode()
    except BadValue as error:
        raise MessageError(f"an answer about logs cannot be sent: {error}") from None
    return bytes([VERSION]) + head + b"\n" + data


def unpack_reply(payload: bytes) -> tuple[LogReply, bytes]:
    """The answer in these bytes, and what stands behind it.

    Raises:
        MessageError: There is none, or of another version.
    """
    head, _, data = body(payload, MOST_PIECE + _MOST_HEAD).partition(b"\n")
    if len(data) > MOST_PIECE:
        raise MessageError(f"{len(data)} bytes of a log in one answer")
    reply: LogReply = _read(_REPLY, head, "answer about logs")
    return reply, data


def pack_entries(entries: list[LogEntry]) -> bytes:
    """The newest logs as an answer carries them."""
    return json.dumps([_ENTRY.write(one) for one in entries[:MOST_ENTRIES]]).encode()


def unpack_entries(data: bytes) -> list[LogEntry]:
    """The logs of a list. None has a name that leads out of a folder: it becomes one of a file.

    Raises:
        MessageError: It is none.
    """
    found = _json(data, "list of logs")
    if not isinstance(found, list) or len(found) > MOST_ENTRIES:
        raise MessageError("not a list of logs")
    try:
        entries = [_ENTRY.read(one) for one in found]
    except BadValue as error:
        raise MessageError(f"not a list of logs: {error}") from None
    return [
        one
        for one in entries
        if is_log_name(one.log) and one.size >= 0 and 0.0 <= one.at <= _LAST_UTC
    ]


def _json(data: bytes, what: str) -> object:
    try:
        return read_json(data)
    except ValueError:
        raise MessageError(f"this is no {what}: it is not JSON") from None


def _read(fields: Fields, data: bytes, what: str) -> Any:
    try:
        return fields.read(_json(data, what))
    except BadValue as error:
        raise MessageError(f"this is no {what}: {error}") from None
