"""Tokens that come and go."""

from __future__ import annotations

from m100link.apps.bus.network import DEPTH, TokenChange
from m100link.apps.ros2.graph import End, NodeName, Presence, Qos
from tests.apps.bus.memory import MemoryInbox

TOPIC = "/m100/land"


def token(session: str, end: End = End.CLIENT, topic: str = TOPIC) -> str:
    node = NodeName(0, session, "/", f"node_{session}")
    return node.token_of(1, end, topic, "std_srvs/srv/Trigger", Qos())


def test_those_who_can_call_are_known_until_one_is_gone() -> None:
    inbox = MemoryInbox[TokenChange](99)
    presence = Presence(lambda: inbox)
    others = (token("c", End.SERVER), token("d", topic="/other"), "@ros2_lv/junk")
    for key in (token("a"), token("b"), *others):
        inbox.waiting.append(TokenChange(key, True))
    presence.look()
    clients = presence.clients(TOPIC)
    assert set(clients) == {token("a"), token("b")}
    assert {one.node_name for one in clients.values()} == {"/node_a", "/node_b"}
    assert not presence.missing(clients)
    inbox.waiting.append(TokenChange(token("b"), False))
    presence.look()
    assert presence.missing(clients)
    assert set(presence.clients(TOPIC)) == {token("a")}


def test_who_went_and_is_back_within_a_step_was_gone() -> None:
    inbox = MemoryInbox[TokenChange](99)
    presence = Presence(lambda: inbox)
    inbox.waiting.append(TokenChange(token("a"), True))
    presence.look()
    clients = presence.clients(TOPIC)
    inbox.waiting.append(TokenChange(token("a"), True))  # the router tells it, too
    presence.look()
    assert not presence.missing(clients)
    inbox.waiting.extend(TokenChange(token("a"), is_there) for is_there in (False, True))
    presence.look()
    assert presence.missing(clients)


def test_a_flood_of_tokens_is_not_kept() -> None:
    inbox = MemoryInbox[TokenChange](DEPTH)
    presence = Presence(lambda: inbox)
    for number in range(10 * DEPTH):
        inbox.waiting.append(TokenChange(token(str(number)), True))
        if number % 1000 == 0:
            presence.look()
    assert len(presence.clients(TOPIC)) <= 4 * DEPTH


def test_of_a_flood_some_is_lost_and_then_all_count_as_gone() -> None:
    inboxes = [MemoryInbox[TokenChange](DEPTH), MemoryInbox(DEPTH)]
    waiting = iter(inboxes)
    presence = Presence(lambda: next(waiting))
    inboxes[0].waiting.append(TokenChange(token("a"), True))
    presence.look()
    clients = presence.clients(TOPIC)
    for number in range(2 * DEPTH):
        inboxes[0].waiting.append(TokenChange(token(str(number)), True))
    presence.look()
    assert presence.missing(clients)
    inboxes[1].waiting.append(TokenChange(token("a"), True))  # told once more
    presence.look()
    assert presence.clients(TOPIC) == clients
