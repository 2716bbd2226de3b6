"""Messages of the right types that cannot be true are refused as they are read."""

from __future__ import annotations

from dataclasses import replace

import pytest

from m100link.apps.agent.codec import BadValue, decode, encode, require_possible
from m100link.apps.agent.messages import (
    Activating,
    Event,
    Hello,
    LinkCounted,
    Message,
    Replay,
    State,
)
from m100link.apps.agent.remote_error import MessageError
from m100link.protocol.codes import ActivationCode

REPLAY = Replay("x.mcap", 1.8e9, 5.0, 1.0, 3.0, 60.0, 1.0, False, False, False)


@pytest.mark.parametrize(
    "message",
    [
        State(1.0, "lost", activation_code=int(ActivationCode.SUCCESS), replay=REPLAY),
        *(State(1.0, "connected", activation_code=int(code)) for code in ActivationCode),
        LinkCounted(1.0, {"acks": 3}, {"crc": 0}, 0.1, {"0.1": 3, "inf": 0}, 0.5),
        Event(1, -5.0, "warning", "what"),
        Hello(10, "a", 1e9),
        Activating(int(ActivationCode.SUCCESS)),
    ],
)
def test_what_agents_tell_is_possible(message: Message) -> None:
    require_possible(message)
    assert decode(encode(message)) == message


@pytest.mark.parametrize(
    ("message", "field"),
    [
        (State(1e300, "lost"), "at"),
        (State(1.0, "cheerful"), "connection"),
        (State(1.0, "lost", activation_code=-1), "activation_code"),
        (State(1.0, "lost", replay=replace(REPLAY, utc=1e300)), "utc"),
        (State(1.0, "lost", replay=replace(REPLAY, utc=-1.0)), "utc"),
        (State(1.0, "lost", replay=replace(REPLAY, duration_s=1e300)), "flight"),
        (LinkCounted(1.0, {"acks": "many"}, {}, 0.1), "counters"),
        (LinkCounted(1.0, {}, {"crc": None}, 0.1), "discards"),
        (LinkCounted(1.0, {}, {}, 0.1, {"0.1": True}), "round_trips"),
        (LinkCounted(-1e300, {}, {}, 0.1), "at"),
        (Event(1, 1e17, "info", "what"), "at"),
        (Event(1, 1.0, "shout", "what"), "level"),
        (Hello(10, "a", -1e300), "at"),
        (Activating(1 << 40), "code"),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(message: Message, field: str) -> None:
    with pytest.raises(BadValue, match=field):
        require_possible(message)
    with pytest.raises(MessageError, match=field):
        decode(encode(message))
