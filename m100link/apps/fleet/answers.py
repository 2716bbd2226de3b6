"""Decide which answer to an order to believe.

Any program on the network may answer for an aircraft. An answer is believed if it comes from the
only session that shows the aircraft's token, and if no other answer of that session contradicts it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from m100link.apps.agent.fault import MessageError
from m100link.apps.bus.network import Answer
from m100link.apps.fleet.keys import Keys
from m100link.apps.fleet.payloads import Reply, unpack
from m100link.errors import OutcomeUnknown

__all__ = ["believed", "clocks_told"]


def clocks_told(answers: Iterable[Answer], name: str) -> list[float]:
    """Return the clock, s, of each session that claims to be the aircraft of that name."""
    found = set()
    for one in answers:
        try:
            reply: Reply = unpack(Reply, one.payload)
        except MessageError:
            continue
        if reply.name == name:
            found.add(reply.clock)
    return sorted(found)


def believed(
    answers: Iterable[Answer],
    keys: Keys,
    identity: str,
    sessions: Collection[str],
    digest: bytes = b"",
) -> Reply | MessageError | None:
    """Return the answer of an aircraft to an order.

    Args:
        answers: All answers to one question.
        keys: Keys of the aircraft.
        identity: Id of the order.
        sessions: Ids of the sessions that show the aircraft's token.
        digest: Digest of the order, where a reply may name another one of the same id.

    Returns:
        Its reply, or the reason why no reply can be read; None when it did not answer. Answers of
        other sessions do not count.

    Raises:
        OutcomeUnknown: Two agents have that name, two answers say different things, or what they
            say is of another order.
    """
    replies: list[Reply] = []
    unread: MessageError | None = None
    for one in answers:
        if one.session not in sessions:
            continue
        try:
            reply: Reply = unpack(Reply, one.payload)
        except MessageError as error:
            unread = error
            continue
        if reply.id in (identity, "") and reply.name == keys.name:
            replies.append(reply)
    if replies and (len(sessions) > 1 or len({one.boot for one in replies}) > 1):
        raise OutcomeUnknown(
            f"two agents are named {keys.name}: nobody knows which of them answered",
            cause="two were given one name, or a stranger says to be it",
            remedy="end one of them, and look at both aircraft",
        )
    # One agent gives one answer. When it was given, and whether it had been before, may differ.
    if len({repr(replace(one, clock=0.0, is_repeated=False)) for one in replies}) > 1:
        raise OutcomeUnknown(
            f"two answers of {keys.name} to one order disagree",
            cause="a stranger answers in its name",
            remedy="look at the aircraft; the rules of a router keep strangers out",
        )
    if replies and replies[0].order not in (b"", digest):
        raise OutcomeUnknown(
            f"{keys.name} tells of another order of the same id",
            cause="a stranger heard the id and used it",
            remedy="look at the aircraft, and ask anew",
        )
    return replies[0] if replies else unread
