"""What a message of an agent may say besides being of the right types (pure logic).

Over a network anybody may tell something under an agent's name. A view of the console that meets a
word or a time that cannot be would raise, and with it everything else on the page: such a message
is refused as it is read, and costs itself alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from m100link.apps.agent.codec import BadValue
from m100link.apps.agent.messages import Activating, Event, Hello, LinkCounted, Message, State
from m100link.protocol.codes import ActivationCode

__all__ = ["require_possible"]

_CONNECTIONS = ("connecting", "connected", "lost")
_LEVELS = ("info", "warning", "error")
_CODES = frozenset(map(int, ActivationCode))
_LAST_UTC = 253_402_300_799.0
"""POSIX time of the end of the year 9999, s."""
_LONGEST_S = 1e10
"""No clock of an agent, nor a flight, is three centuries old."""


def _hello(hello: Hello) -> str:
    return "" if abs(hello.at) <= _LONGEST_S else "at is no time"


def _event(event: Event) -> str:
    if event.level not in _LEVELS:
        return "level is none"
    return "" if abs(event.at) <= _LONGEST_S else "at is no time"


def _state(state: State) -> str:
    if not abs(state.at) <= _LONGEST_S:
        return "at is no time"
    if state.connection not in _CONNECTIONS:
        return "connection is none"
    if state.activation_code is not None and state.activation_code not in _CODES:
        return "activation_code is none"
    replay = state.replay
    if replay is not None and not 0.0 <= replay.utc <= _LAST_UTC:
        return "replay: utc is no time"
    if replay is not None and not max(abs(replay.position_s), abs(replay.duration_s)) <= _LONGEST_S:
        return "replay: no flight is that long"
    return ""


def _counted(counted: LinkCounted) -> str:
    if not abs(counted.at) <= _LONGEST_S:
        return "at is no time"
    for name in ("counters", "discards", "round_trips"):
        numbers: Mapping[str, Any] = getattr(counted, name)
        if not all(type(one) in (int, float) for one in numbers.values()):
            return f"{name}: not a number"
    return ""


def _activating(activating: Activating) -> str:
    return "" if activating.code in _CODES else "code is none"


_WHY_NOT: dict[type[Any], Callable[[Any], str]] = {
    Event: _event,
    Hello: _hello,
    State: _state,
    LinkCounted: _counted,
    Activating: _activating,
}


def require_possible(message: Message) -> None:
    """Whether a message that was read can be true.

    Raises:
        BadValue: It cannot; the field is named.
    """
    why_not = _WHY_NOT.get(type(message))
    why = "" if why_not is None else why_not(message)
    if why:
        raise BadValue(why)
